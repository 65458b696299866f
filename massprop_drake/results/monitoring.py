"""Findings during a flight: detections and verdict as its summary would have them, sample by sample.

By the functions that make the summary. What only a whole flight tells is not known yet: when a jump was at the
earliest and at the latest, what hindsight shows, and, of the thesis's detectors, which innovations a failure explains
until it was declared. Where hypotheses are followed the newest samples are kept one by one: another history may become
the likeliest that explains them otherwise.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.maths.arrays import NUMBER, Layout
from massprop_drake.maths.signals import SYMBOLS
from massprop_drake.results.consistency import (
    COMPONENTS,
    Consistency,
    Forks,
    Innovations,
    Tally,
    fork_signals,
    judge_consistency,
    likeliest_innovations,
)
from massprop_drake.results.detections import (
    JUMP,
    DetectionRecord,
    finalize_detections,
    note_mass_before_jumps,
    update_detections,
)
from massprop_drake.results.events import EventRecord, list_events

Array = NDArray[np.float64]

_COLUMNS = 5  # of a row: time, s, then the fields of `Innovations`
_COUNTS = Layout(
    "counts",
    rotation=len(Tally.NUMBERS),
    mass=len(Tally.NUMBERS),
    time_s=NUMBER,
    mass_reciprocal=NUMBER,
    variance=NUMBER,
    known_force="jets",
    known_force_variance="jets",
    recent_rotation=("window", _COLUMNS),
    recent_mass=("window", _COLUMNS),
)
_WINDOW = 512  # samples that are kept one by one: memory budget, of a fork that is older the newest part counts
_KEPT = ("mass_reciprocal", "variance", "known_force", "known_force_variance")  # signals of the last sample


class Declarations(NamedTuple):
    """Declarations of a detector so far. Never changed; an event makes a new one.

    Attributes:
        events: in the order in which they were declared.
        detections: see `results.detections.update_detections`.
    """

    events: tuple[EventRecord, ...] = ()
    detections: tuple[DetectionRecord, ...] = ()

    def __deepcopy__(self, _memo: Any) -> Declarations:
        """Returns itself: a clone of a context shares what is never changed."""
        return self


class FlightMonitor:
    """Detections and verdict of a flight so far, from the reports that the ports of its estimators give.

    It holds nothing of a flight: what is to be remembered goes in and comes out.

    Args:
        vehicle: for its jets.
        sensors: packages in use, gyros first, the preferred of either first.
        reports: layout of each report, by its port.

    Attributes:
        counts: at the start, what `count_innovations` goes on from, shape (17 + 2 n_jets + 10 w,), w samples being
            kept: 512 where hypotheses are followed, else 1.
        declarations: at the start, what `update_declarations` goes on from.
    """

    def __init__(self, vehicle: Vehicle, sensors: Sequence[str], reports: Mapping[str, Layout]):
        self._vehicle, self._sensors, self._reports = vehicle, sensors, reports
        followed_by = "hypothesis_report" in reports
        self._layout = _COUNTS.sized(jets=len(vehicle.jets), window=_WINDOW if followed_by else 1)
        self._no_force = np.zeros(len(vehicle.jets))
        self._places = {
            field: (port, layout.slice(field).start if shape == (1,) else layout.slice(field))
            for port, layout in reports.items()
            for field, shape in layout.shapes()
        }
        self._filters = [name for name in COMPONENTS if f"{name}_nis" in self._places]
        unknown = (math.nan,) * 3
        older, rows = empty_recent(_WINDOW if followed_by else 1)
        self.counts = self._layout.pack((older, older, *unknown, self._no_force, self._no_force, rows, rows))
        self.declarations = Declarations()

    def has_event(self, detector_report: Array) -> bool:
        """Tests whether the detector's report of a sample declares an event."""
        _, place = self._places["detector_event"]
        return bool(detector_report[place] != 0.0)

    def count_innovations(self, counts: Array, time_s: float, reports: Mapping[str, Array]) -> Array:
        """Returns the counts of innovations with those of a sample added.

        Args:
            counts: before the sample.
            time_s: of the sample, s.
            reports: by port.
        """
        after = counts.copy()
        for name in self._filters:
            recent = self._recent(counts, name).append_sample(time_s, *self._filter_result(name, reports))
            if "history_since" in self._places:
                since_s, nis, components = (self._value(signal, reports) for signal in fork_signals(name))
                if math.isfinite(since_s):
                    recent = recent.replace_history(since_s, nis, components)
            after[self._layout.slice(name)] = recent.older
            after[self._layout.slice(f"recent_{name}")] = recent.rows.ravel()
        after[self._layout.slice("time_s")] = time_s
        for name in _KEPT:
            if name in self._places:
                after[self._layout.slice(name)] = self._value(name, reports)
        return after

    def _filter_result(self, filter_name: str, reports: Mapping[str, Array]) -> tuple[float, float, float]:
        """Returns use (1 or 0), NIS and its expectation of a filter at one sample, from the reports by port."""
        used, nis = (self._value(f"{filter_name}_{what}", reports) for what in ("used", "nis"))
        return (
            used,
            nis,
            self._value(COMPONENTS[filter_name], reports) if COMPONENTS[filter_name] in self._places else 3.0,
        )

    def _recent(self, counts: Array, filter_name: str) -> Recent:
        """Unpacks the innovations of a filter, older counts and newest samples, from the array of counts."""
        rows = counts[self._layout.slice(f"recent_{filter_name}")].reshape(-1, _COLUMNS)
        return Recent(counts[self._layout.slice(filter_name)], rows)

    def _value(self, signal: str, reports: Mapping[str, Array]) -> Any:
        """Returns a signal's number, or array, at one sample from the reports by port."""
        port, place = self._places[signal]
        return reports[port][place]

    def update_declarations(
        self, declarations: Declarations, counts: Array, time_s: float, reports: Mapping[str, Array]
    ) -> Declarations:
        """Adds the events of a sample to the declarations; arguments as `count_innovations`."""
        signals = self._signals(reports)
        events = list_events(self._vehicle, self._sensors, np.array([time_s]), signals, declarations.events)
        records = update_detections(self._vehicle, events, declarations.detections)
        if "verdict" not in signals:
            last = self._layout.columns(np.vstack([counts, self.count_innovations(counts, time_s, reports)]))
            times_s, reciprocal, variance = (last[name][:, 0] for name in ("time_s", "mass_reciprocal", "variance"))
            records = note_mass_before_jumps(records, times_s, reciprocal, np.sqrt(variance))
        return Declarations((*declarations.events, *events), tuple(records))

    def _signals(self, reports: Mapping[str, Array]) -> dict[str, Array]:
        """Maps each signal of the reports to its values at one sample, shape (1, components)."""
        return {
            name: values
            for port, row in reports.items()
            for name, values in self._reports[port].columns(row[None]).items()
        }

    def detections(self, declarations: Declarations, counts: Array) -> tuple[DetectionRecord, ...]:
        """Returns the detections so far, with jump masses and forces by the newest estimates."""
        latest = self._layout.read(counts)
        forces = latest.known_force, latest.known_force_variance
        return finalize_detections(declarations.detections, *forces, latest.mass_reciprocal, math.sqrt(latest.variance))

    def failed_jets(self, declarations: Declarations) -> Array:
        """Flags with 1.0 the jets declared failed, alone, in a group or in a cluster, and not withdrawn, (n_jets,)."""
        failed = self._no_force.copy()
        for record in declarations.detections:
            if record.kind != JUMP and record.withdrawn_s is None:
                of_cluster = (jet.designation for jet in self._vehicle.jets if jet.cluster == record.cluster)
                for jet in record.jets or of_cluster:
                    failed[self._vehicle.jet_index(jet)] = 1.0
        return failed

    def verdict(self, counts: Array) -> Consistency:
        """Judges both filters' innovations so far: "consistent", "inconsistent" or "not enough data"."""
        rotation, mass = (self._recent(counts, name).tally for name in COMPONENTS)
        return judge_consistency(rotation, mass, np.full(len(SYMBOLS), np.nan), SYMBOLS)


# ------------------------------------------------------ innovations that another history may explain otherwise


class Recent(NamedTuple):
    """Innovations of one filter so far: counted, but for the newest. Never changed; a sample makes new ones.

    Attributes:
        older: counts of the samples that are no longer kept, `Tally.NUMBERS`.
        rows: of the newest samples, oldest first, shape (n, `_COLUMNS`); time -inf: there is no sample yet.
    """

    older: Array
    rows: Array

    def append_sample(self, time_s: float, used: float, nis: float, components: float) -> Recent:
        """Appends a sample, and moves the oldest to the counts if it was used; arguments see `Innovations`."""
        rows = np.vstack([self.rows, (time_s, used, nis, components, 0.0)])
        was_used = rows[0, 1] != 0.0
        return Recent(_add_counts(self.older, rows[:1]) if was_used else self.older, rows[1:])

    def replace_history(self, since_s: float, nis: float, components: float) -> Recent:
        """Replaces NIS since a fork, s, by the newly likeliest hypothesis's mean; arguments see `Forks`.

        Of a fork older than the rows only their share counts.
        """
        first_s, last_s = self.rows[[0, -1], 0].tolist()
        share = min((last_s - first_s) / (last_s - since_s), 1.0) if since_s < last_s else 1.0
        sums = (np.array([share * value]) for value in (nis, components))
        found = Forks(np.array([self.rows.shape[0] - 1]), np.array([since_s]), *sums)
        seen = likeliest_innovations(_innovations(self.rows), self.rows[:, 0], found)
        return Recent(self.older, np.column_stack([self.rows[:, 0], *seen]))

    @property
    def tally(self) -> Tally:
        """Tally of all innovations: older counts and newest samples together."""
        return Tally.from_counts(_add_counts(self.older, self.rows))


def empty_recent(window: int) -> Recent:
    """Makes the innovations before the first sample: zero counts, and a window of rows with time -inf."""
    rows = np.zeros((window, _COLUMNS))
    rows[:, 0] = -np.inf
    return Recent(np.zeros(len(Tally.NUMBERS)), rows)


def _innovations(rows: Array) -> Innovations:
    """Converts rows of Recent, shape (n, 5), to `Innovations`."""
    _, used, nis, components, averaged = rows.T
    return Innovations(used != 0.0, nis, components, averaged != 0.0)


def _add_counts(older: Array, rows: Array) -> Array:
    """Returns counts, see `Tally.NUMBERS`, with the used samples of rows, shape (n, 5), added."""
    tally = Tally.from_counts(older)
    tally.add_innovations(_innovations(rows))
    return tally.numbers

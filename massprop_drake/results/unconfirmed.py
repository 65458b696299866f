"""Suspicions of a detector that were never declared, and jets whose failure to fire nothing could have shown.

    single samples (cglr)   a sample counts that raised an alarm, or in which a jet has failed beyond doubt but several
                            look alike. A jet belongs to a suspicion while its sum of likelihood arguments is not
                            behind the largest by the detector's margin in each of its samples; a sample belongs to the
                            suspicion that has a jet in common with those that it does not tell apart
    sums (cusum)            a sum above half the threshold: healthy it gets there once in e^20 samples
    hypotheses              a jet that had failed with a probability above one half, and nothing said of it. Where the
                            probability went over from one jet to another, the two look alike
    thrust_factors          a comparison that ended, or had not ended, with a jet ahead of `nothing has happened` by
                            the lead that decides, and nothing said of it

A declaration takes with it the suspicions of its jets.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.errors import counted
from massprop_drake.inputs import params
from massprop_drake.inputs.estimation_blocks import CglrBlock, CusumBlock, HypothesesBlock, ThrustFactorsBlock
from massprop_drake.inputs.model import Count, Real, Text
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.results.events import EventRecord

Array = NDArray[np.float64]

_BEYOND_DOUBT = 25.0  # likelihood argument of a sample in which some jet has failed, whichever it is
NOTHING_TESTED = "no sample was tested: the estimates did not converge"
_MOST = 50  # suspicions that are told, the largest
_SMALL_GROUP = 3  # jets that a group may have to be of use
_PROBABLE = 0.5  # probability of a suspicion
_POSSIBLE = 0.01  # probability that a jet keeps that looks like another
_OF_RACES = {
    "failed",
    "group",
    "jump",
    "false_reading",
    "engine_failed",
    "disturbance",
    "unexplained",
}  # that end a comparison


class UnconfirmedRecord(NamedTuple):
    """Record of a suspicion that never became a declaration.

    Attributes:
        time_s, until_s: its first and last sample, s.
        jets: designations of the jets that the data do not tell apart, the likeliest first; none where it is of no jet.
        statistic: likelihood argument of the likeliest, summed over the samples; the largest sum; its largest
            probability; or its lead over the hypothesis that nothing has happened, nats.
        samples: how many bear on it.
        reason: why nothing was declared.
    """

    time_s: Real
    until_s: Real
    jets: tuple[Text, ...]
    statistic: Real
    samples: Count
    reason: Text


class UntestedRecord(NamedTuple):
    """Record of jets whose failure to fire nothing could have shown.

    Attributes:
        jets: designations.
        reason: why.
    """

    jets: tuple[Text, ...]
    reason: Text


class _Suspicion(NamedTuple):
    """Suspicion against some jets: time span, statistic by jet, shape (n_jets,), samples and alarms."""

    time_s: float
    until_s: float
    sums: Array
    jets: NDArray[np.int_]
    samples: int
    alarms: int
    reason: str = ""


class Suspicions:
    """Collects the suspicions of a detector against jets through a run, block by block.

    Args:
        scenario: as run.
        earlier: suspicions of the run that this one goes on from.
        counts: of it, samples in which each jet was commanded, and those of them that were tested, shape (2, n_jets).
    """

    def __init__(
        self,
        scenario: Scenario,
        earlier: Sequence[UnconfirmedRecord] = (),
        counts: Sequence[Sequence[int]] = (),
    ):
        vehicle = scenario.vehicle_data
        self._vehicle, self._block, self._earlier = vehicle, scenario.detector, list(earlier)
        self._detects = params.detector(scenario) is not None
        self._gathered: list[_Suspicion] = []
        self._race: _Suspicion | None = None
        self._counts = np.array(counts, dtype=int) if len(counts) else np.zeros((2, len(vehicle.jets)), dtype=int)
        self._command = np.zeros((1, len(vehicle.jets)))  # of the interval before the block
        self._any_tested = bool(self._counts[1].any())  # of the run that this one goes on from, as far as is known
        self._declared: set[int] = set()  # jets that are known to have failed
        self._known = self._counts[0] > 0  # jets of which a command was known, shape (n_jets,)

    @property
    def counts(self) -> list[list[int]]:
        """Numbers of samples in which each jet was commanded, and was also tested, shape (2, n_jets)."""
        found: list[list[int]] = self._counts.tolist()
        return found

    def add(self, time_s: Array, signals: Mapping[str, Array], events: Sequence[EventRecord]) -> None:
        """Updates suspicions and sample counts of jets by a block of samples.

        Args:
            time_s: sample times, s, shape (n,).
            signals: by name, shape (n, components).
            events: declared in them.
        """
        if "tested" not in signals:
            return
        tested = signals["tested"][:, 0] > 0.0
        self._any_tested |= bool(tested.any())
        self._known |= (~np.isnan(signals["command"])).any(axis=0)
        commanded = np.vstack([self._command, signals["command"][:-1]]) > 0.0
        self._counts += np.stack([commanded.sum(axis=0), commanded[tested].sum(axis=0)])
        self._command = signals["command"][-1:]
        events_by_time: dict[float, list[EventRecord]] = {}
        for event in events:
            events_by_time.setdefault(event.time_s, []).append(event)
        for row in np.flatnonzero(
            self._find_suspicious_samples(signals, tested) | (signals["detector_event"][:, 0] != 0.0)
        ):
            sample_s = float(time_s[row])
            if isinstance(self._block, HypothesesBlock):
                self._add_by_probability(sample_s, signals["fault_probability"][row])
            elif isinstance(self._block, ThrustFactorsBlock):
                self._add_by_thrust_factors(sample_s, signals, int(row), events_by_time.get(sample_s, ()))
            elif sample_s not in events_by_time:
                self._add_by_likelihood(sample_s, signals, int(row))
            self._drop_declared(events_by_time.get(sample_s, ()))

    def _find_suspicious_samples(self, signals: Mapping[str, Array], is_tested: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Flags samples in which a jet is suspected, or hypotheses are compared, shape (n,)."""
        block, likelihood = self._block, signals["suspected_likelihood"][:, 0]
        if isinstance(block, CusumBlock):
            return is_tested & (likelihood > 0.5 * block.threshold)
        if isinstance(block, HypothesesBlock):
            return np.any(signals["fault_probability"] > _PROBABLE, axis=1)
        if isinstance(block, ThrustFactorsBlock):
            racing = signals["racing"][:, 0] > 0.0
            ended = np.concatenate([[self._race is not None], racing[:-1]]) & ~racing
            return racing | ended
        limit = np.inf if block.unexplained_limit is None else block.unexplained_limit
        doubtless = (likelihood > _BEYOND_DOUBT) & (signals["unexplained"][:, 0] < limit)
        return is_tested & (doubtless | (signals["alarm"][:, 0] > 0.0))

    # ------------------------------------------------------------------------ detectors of samples

    def _add_by_likelihood(self, time_s: float, signals: Mapping[str, Array], row: int) -> None:
        """Adds a sample to a suspicion that shares a jet suspected by likelihood, or to a new one."""
        block, likelihood = self._block, signals["likelihood"][row]
        if int(likelihood.argmax()) in self._declared:
            return
        if isinstance(block, CusumBlock):
            jets = np.flatnonzero(likelihood > 0.5 * block.threshold)
        else:
            assert isinstance(block, CglrBlock)
            jets = np.flatnonzero(likelihood > likelihood.max() - block.margin)
        alarm = int(signals["alarm"][row, 0] > 0.0)
        for index, one in enumerate(self._gathered):
            if np.isin(jets, one.jets).any():
                sums = np.maximum(one.sums, likelihood) if isinstance(block, CusumBlock) else one.sums + likelihood
                samples = one.samples + 1
                least = 0.5 * block.threshold if isinstance(block, CusumBlock) else sums.max() - block.margin * samples
                alike = np.flatnonzero(sums > least)
                self._gathered[index] = _Suspicion(one.time_s, time_s, sums, alike, samples, one.alarms + alarm)
                return
        self._gathered.append(_Suspicion(time_s, time_s, likelihood, jets, 1, alarm))

    # -------------------------------------------------------------------- the detector by hypotheses

    def _add_by_probability(self, time_s: float, probabilities: Array) -> None:
        """Adds a sample to a suspicion of each undeclared jet with fault probability above one half."""
        for jet in np.flatnonzero(probabilities > _PROBABLE).tolist():
            if jet in self._declared:
                continue
            index = self._find_suspicion(jet, probabilities)
            if index is None:
                sums = np.zeros_like(probabilities)
                sums[jet] = probabilities[jet]
                self._gathered.append(_Suspicion(time_s, time_s, sums, np.array([jet]), 1, 0))
                continue
            suspicion = self._gathered[index]
            sums = suspicion.sums.copy()
            sums[jet] = max(sums[jet], probabilities[jet])
            samples = suspicion.samples + (suspicion.until_s < time_s)
            jets = np.union1d(suspicion.jets, [jet])
            self._gathered[index] = suspicion._replace(until_s=time_s, sums=sums, jets=jets, samples=samples)

    def _find_suspicion(self, jet: int, probabilities: Array) -> int | None:
        """Returns the index of the suspicion with a jet, or of one whose probability the jet took over; or None.

        Two jets of which each has failed with a probability above one half have both failed, and do not look alike.
        """
        for index, suspicion in enumerate(self._gathered):
            if jet in suspicion.jets:
                return index
        for index, suspicion in enumerate(self._gathered):
            others = probabilities[suspicion.jets]
            if (others <= _PROBABLE).all() and (others > _POSSIBLE).any():
                return index
        return None

    # ------------------------------------------------------------------ the detector by thrust factors

    def _add_by_thrust_factors(
        self, time_s: float, signals: Mapping[str, Array], row: int, events: Sequence[EventRecord]
    ) -> None:
        """Updates the comparison of hypotheses by a sample; stores an undeclared suspicion at its end."""
        block = self._block
        assert isinstance(block, ThrustFactorsBlock)
        if signals["racing"][row, 0] > 0.0:
            leads = np.nan_to_num(signals["likelihood"][row], nan=-np.inf)
            race = self._race
            if np.isfinite(leads).any() or race is None:
                jets = np.flatnonzero((leads > leads.max() - block.lead) & (leads > block.lead_nothing))
                began_s, samples = (time_s, 1) if race is None else (race.time_s, race.samples + 1)
                self._race = _Suspicion(began_s, time_s, leads, jets, samples, 0)
            else:
                self._race = race._replace(until_s=time_s, samples=race.samples + 1)
            names = {self._vehicle.designations[jet] for jet in self._race.jets}
            ends = [event for event in events if event.kind in _OF_RACES or names & set(event.jets)]
            if not ends:
                return
            event, race = ends[0], self._race
            if event.kind == "unexplained":
                why = "no failed jet, no jump and no false reading explains the readings"
                self._gathered.append(race._replace(reason=why))
            elif event.kind == "group" and len(event.jets) > _SMALL_GROUP:
                jets = np.array([self._vehicle.designations.index(jet) for jet in event.jets])
                self._gathered.append(race._replace(jets=jets, reason=f"{jets.size} jets look alike"))
        elif self._race is not None and self._race.jets.size:
            why = "hypotheses were compared, and none that is large enough to be declared stood out"
            self._gathered.append(self._race._replace(reason=why))
        self._race = None

    # --------------------------------------------------------------------------------- the outcome

    def _drop_declared(self, events: Sequence[EventRecord]) -> None:
        """Updates declared jets by events; removes suspicions of jets declared or withdrawn, not of large groups."""
        for event in events:
            if event.kind not in ("failed", "group", "withdrawn"):
                continue
            if event.jets:
                jets = {self._vehicle.designations.index(jet) for jet in event.jets}
            else:
                jets = {index for index, jet in enumerate(self._vehicle.jets) if jet.cluster == event.cluster}
            self._declared = self._declared - jets if event.kind == "withdrawn" else self._declared | jets
            if event.kind == "failed" or len(jets) <= _SMALL_GROUP:
                self._gathered = [one for one in self._gathered if not np.isin(one.jets, list(jets)).any()]
                names = {self._vehicle.designations[jet] for jet in jets}
                self._earlier = [one for one in self._earlier if not names & set(one.jets)]

    def list_records(self) -> tuple[UnconfirmedRecord, ...]:
        """Lists records of suspicions never declared, by time; the largest 50 if there are more."""
        gathered = list(self._gathered)
        if self._race is not None and self._race.jets.size:
            gathered.append(self._race._replace(reason="hypotheses were still compared at the end"))
        records = [*self._earlier, *map(self._make_record, gathered)]
        largest = sorted(records, key=lambda record: -record.statistic)[:_MOST]
        return tuple(sorted(largest, key=lambda record: record.time_s))

    def _make_record(self, suspicion: _Suspicion) -> UnconfirmedRecord:
        """Converts a suspicion to a record, its jets by decreasing statistic, with the reason."""
        jets = sorted(suspicion.jets.tolist(), key=lambda jet: -suspicion.sums[jet])
        statistic = float(suspicion.sums[jets[0]]) if jets else 0.0
        names = tuple(self._vehicle.designations[jet] for jet in jets)
        return UnconfirmedRecord(
            suspicion.time_s,
            suspicion.until_s,
            names,
            statistic,
            suspicion.samples,
            suspicion.reason or self._reason_undeclared(suspicion),
        )

    def _reason_undeclared(self, suspicion: _Suspicion) -> str:
        """Explains in words why the detector's rule did not declare a suspicion."""
        block = self._block
        if isinstance(block, CusumBlock):
            return f"the sum stayed below the {block.threshold:g} that declare a failure"
        if isinstance(block, HypothesesBlock):
            alone = "its probability never exceeded what a declaration needs"
            return alone if suspicion.jets.size == 1 else "these look alike"
        assert isinstance(block, CglrBlock)
        if suspicion.alarms and block.reconfigure_after is None:
            return f"{counted(suspicion.alarms, 'alarm')}; this scenario declares none"
        if suspicion.alarms * 2 < suspicion.samples:
            return (
                f"some jet has failed beyond doubt, but single samples do not tell which ({_alarms(suspicion.alarms)})"
            )
        return f"{counted(suspicion.alarms, 'alarm')}, never {block.reconfigure_after} of one cluster in a row"

    def untested(self, declared_jets: Collection[str | None] = ()) -> tuple[UntestedRecord, ...]:
        """Lists by reason, such as never commanded, the undeclared jets whose failure to fire could not show."""
        if not self._detects:
            return ()
        if not self._any_tested:
            return (
                UntestedRecord(
                    tuple(name for name in self._vehicle.designations if name not in declared_jets), NOTHING_TESTED
                ),
            )
        block = self._block
        needed = (block.reconfigure_after or 1) if isinstance(block, CglrBlock) else 1
        commanded, tested = self._counts
        found = []
        for chosen, why in (
            (~self._known, "their commands are unknown: nothing could have shown that they do not fire"),
            ((commanded == 0) & self._known, "never commanded: nothing could have shown that they do not fire"),
            (
                (commanded > 0) & (tested < needed),
                f"commanded, but in {'none' if needed == 1 else f'fewer than {needed}'} of the samples that could be "
                "tested: that they do not fire could not have been declared",
            ),
        ):
            names = (self._vehicle.designations[jet] for jet in np.flatnonzero(chosen))
            jets = tuple(name for name in names if name not in declared_jets)
            if jets:
                found.append(UntestedRecord(jets, why))
        return tuple(found)


def in_words(record: UnconfirmedRecord) -> str:
    """Describes a suspicion in a sentence: jets, time, samples, statistic and reason."""
    when = f"{record.time_s:.2f} s" if record.samples == 1 else f"{record.time_s:.2f} to {record.until_s:.2f} s"
    who = " or ".join(record.jets) if record.jets else "no jet"
    return f"{who}, {when}, {counted(record.samples, 'sample')}, statistic {record.statistic:.4g}: {record.reason}"


def _alarms(number: int) -> str:
    """Formats a number of alarms in words."""
    return counted(number, "alarm") if number else "no alarm"

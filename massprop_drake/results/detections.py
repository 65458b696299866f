"""Failures and jumps as they were declared, one record each, read from a run's signals."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.inputs.model import Count, NotNegative, Real, Text, Whole
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.maths.signals import format_with_deviation
from massprop_drake.results.events import (
    EventRecord,
    gained_mass_in_words,
    place_in_words,
    separation_in_words,
)

Array = NDArray[np.float64]

Kind = Literal["jet_on", "jet_off", "jet_degraded", "mass_property_jump"]
Mode = Literal[
    "stuck_on", "leak", "stuck_off", "loss", "intermittent", "drift", "release", "docking", "sensor"
]  # of a fault
JUMP: Kind = "mass_property_jump"


class DetectionRecord(NamedTuple):
    """Record of a declared jet failure or jump of the mass properties, and of its later course.

    Attributes:
        onset_s: best estimate of when it began, s; of a jump found by hypotheses where their comparison begins, and
            `earliest_s` and `latest_s` say more.
        time_s: when it was declared, s.
        kind: "jet_on" (stuck on or leaking), "jet_off", "jet_degraded" or "mass_property_jump".
        cluster: number of the suspected jet's cluster; None for a jump.
        jet: designation of the jet; None for a jump, and where the data name no more than its cluster.
        isolated_to: "jet", "group" (one of `jets`, which the data cannot tell apart) or "cluster"; None for a jump.
        magnitude: force too much (positive) or missing (negative), lbf or N; None for a jump.
        magnitude_std: its 1-sigma, lbf or N.
        statistic: likelihood argument of the failure; of a jump the NIS of the sample; None where there is none.
        alarms: how many alarms led to the declaration.
        probability: that the jet, or one of the group, had failed, when it was declared; None where none is given.
        withdrawn_s: when the declaration was withdrawn, s; None while it stands.
        jets: designations of the jets that it may be, the likeliest first; none where only a cluster is named.
        mass, mass_std: gained in a jump (released: negative), slug or kg, and its 1-sigma; of the detector by
            hypotheses as measured once the filter has settled after it, None while it is not known to 3 sigma; of
            others the difference of the estimates before it and at the end, or before the next.
        position, position_std: where, vehicle frame, ft or m; None where it is not known.
        measured_s: when the size of a jump was measured, s.
        earliest_s, latest_s: between when and when a jump was that the detector by hypotheses has found, s; None of
            other detectors, and of failures.
        told_apart_by: designation of the jet of a group that, fired alone, would tell it apart.
        told_apart_s: seconds without any jet after which it would be told apart; with neither nothing would.
        erratic_s: since when the jet is said to be erratic, s.
        pattern: of an erratic jet, "intermittent" or "drifting".
        thrust: full thrust of the likeliest jet, lbf or N; None for a jump.
        mode: of the fault, by what is known of its size now, see `fault_mode`; None where that tells none.
        jet_index: index of the likeliest jet of the vehicle, while the run goes on; None for a jump, and in a
            summary.
        before: reciprocal mass before a jump, and its 1-sigma, while the run goes on.
    """

    onset_s: Real
    time_s: Real
    kind: Kind
    cluster: Whole | None
    jet: Text | None
    isolated_to: Literal["jet", "group", "cluster"] | None
    magnitude: Real | None
    magnitude_std: NotNegative | None
    statistic: Real | None
    alarms: Count
    withdrawn_s: Real | None = None
    jets: tuple[Text, ...] = ()
    mass: Real | None = None
    mass_std: NotNegative | None = None
    position: tuple[Real, Real, Real] | None = None
    position_std: tuple[Real, Real, Real] | None = None
    measured_s: Real | None = None
    told_apart_by: Text | None = None
    told_apart_s: NotNegative | None = None
    erratic_s: Real | None = None
    pattern: Literal["intermittent", "drifting"] | None = None
    earliest_s: Real | None = None
    latest_s: Real | None = None
    thrust: NotNegative | None = None
    mode: Mode | None = None
    probability: Real | None = None
    jet_index: Count | None = None
    before: tuple[Real, NotNegative] | None = None

    @property
    def suspects(self) -> str:
        """Suspected jets in words: "jet T7", "one of T7, T8" or "a jet of cluster 2"."""
        if self.isolated_to == "group":
            return f"one of {', '.join(self.jets)}"
        return f"jet {self.jet}" if self.jet else f"a jet of cluster {self.cluster}"


_SAME_S = 1e-6  # times that are no farther apart are the same
_SIGNIFICANT = 3.0  # sigmas of a mass that is told, and of a force from that of a jet that is stuck
_NEARLY_ALL = 0.9  # share of the thrust that counts as all of it


def update_detections(
    vehicle: Vehicle, events: Sequence[EventRecord], earlier: Sequence[DetectionRecord] = ()
) -> list[DetectionRecord]:
    """Applies events in order to detection records: appends new ones, changes earlier; returns all of them.

    Args:
        vehicle: for its jets.
        events: in the order of declaration.
        earlier: records before them.
    """
    records = list(earlier)
    for event in events:
        match event.kind:
            case "failed" | "group":
                records.append(_make_failure_record(vehicle, event))
            case "jump":
                records.append(_make_jump_record(event))
            case "withdrawn":
                records = _change_records(records, event, withdrawn_s=event.time_s)
            case "changed":
                records = _change_records(records, event, newest=True, withdrawn_s=None, **_force_fields(event))
            case "erratic":
                erratic = {"erratic_s": event.time_s, "pattern": event.pattern} | _force_fields(event)
                records = _change_records(records, event, newest=True, withdrawn_s=None, **erratic)
            case "jump_measured":
                jumps = [index for index, record in enumerate(records) if record.kind == JUMP]
                if jumps:
                    size = _size_fields(event) | {"measured_s": event.time_s}
                    records[jumps[-1]] = records[jumps[-1]]._replace(**size)
    return [_with_mode(record) for record in records]


def _change_records(
    records: list[DetectionRecord], event: EventRecord, *, newest: bool = False, **fields: Any
) -> list[DetectionRecord]:
    """Sets fields in the unwithdrawn records of the event's jet, or in its newest one; returns all records."""
    of_jet = [index for index, record in enumerate(records) if record.jet_index == event.jet_index]
    chosen = of_jet[-1:] if newest else [index for index in of_jet if records[index].withdrawn_s is None]
    return [record._replace(**fields) if index in chosen else record for index, record in enumerate(records)]


def note_mass_before_jumps(
    records: Sequence[DetectionRecord], time_s: Array, mass_reciprocal: Array, deviation: Array
) -> list[DetectionRecord]:
    """Stores in each jump without a measured mass the 1/m and 1-sigma of the sample before; returns all records.

    Args:
        records: as `update_detections` gives them.
        time_s: of some samples and the one before them, s, shape (n,).
        mass_reciprocal, deviation: estimate of 1/m in these, and its 1-sigma, shape (n,) each.
    """

    def with_mass_before(record: DetectionRecord) -> DetectionRecord:
        """Returns the record with 1/m of the sample before its declaration if unknown."""
        row = int(np.searchsorted(time_s, record.time_s))
        known = record.kind != JUMP or record.before is not None or record.measured_s is not None
        if known or not 0 < row < time_s.size or not np.isfinite(mass_reciprocal[row - 1]):
            return record
        return record._replace(before=(float(mass_reciprocal[row - 1]), float(deviation[row - 1])))

    return [with_mass_before(record) for record in records]


def finalize_detections(
    records: Sequence[DetectionRecord],
    force: Array,
    variance: Array,
    mass_reciprocal: float = np.nan,
    deviation: float = np.nan,
) -> tuple[DetectionRecord, ...]:
    """Returns detections with jump masses and stuck-on forces as estimated at the end, and fault modes.

    What was withdrawn keeps the size that it had while it stood.

    Args:
        records: as `update_detections` gives them.
        force, variance: known force of each jet at the end, lbf or N, and its variance, shape (n_jets,).
        mass_reciprocal, deviation: estimate of 1/m at the end, and its 1-sigma.
    """

    def finalize(record: DetectionRecord) -> DetectionRecord:
        """Returns the record with the final force of a jet on, and without internal fields."""
        jet = record.jet_index
        is_tracked = record.kind == "jet_on" and record.erratic_s is None and record.withdrawn_s is None
        if is_tracked and jet is not None and variance[jet] > 0.0:
            record = record._replace(magnitude=float(force[jet]), magnitude_std=float(np.sqrt(variance[jet])))
        return _with_mode(record._replace(jet_index=None, before=None))

    return tuple(map(finalize, _compute_jump_sizes(records, (mass_reciprocal, deviation))))


def bound_jump_times(
    records: Sequence[DetectionRecord], blocks: Iterable[Mapping[str, Array]], reading_steps: Mapping[str, float]
) -> list[DetectionRecord]:
    """Bounds each jump's onset, s: from the last firing or reading step above its limit to the next alarm; returns all.

    It happened before the first alarm after the comparison of hypotheses begins, and no earlier than the end of the
    last interval before in which a jet fired or a reading moved.

    Args:
        records: as `update_detections` gives them.
        blocks: of the whole run in order, with `time_s`, `command`, `alarm` and readings.
        reading_steps: by sensor, least change of a reading from one sample to the next if something acts.
    """
    result = list(records)
    jumps = [index for index, record in enumerate(records) if record.kind == JUMP]
    if not jumps:
        return result
    ended, alarms = _find_activity(blocks, reading_steps)
    for index in jumps:
        onset_s, time_s = records[index].onset_s, records[index].time_s
        first = float(ended[ended <= onset_s + _SAME_S].max(initial=-np.inf))
        last = float(alarms[alarms > onset_s + _SAME_S].min(initial=time_s))
        if np.isfinite(first):
            result[index] = records[index]._replace(earliest_s=first, latest_s=last)
    return result


def _find_activity(blocks: Iterable[Mapping[str, Array]], reading_steps: Mapping[str, float]) -> tuple[Array, Array]:
    """Returns the run's start and ends of intervals with firings or reading steps above limits, s; alarm times, s."""
    ended, alarms = [], []
    before: dict[str, Array] = {}
    for block in blocks:
        rows = {name: np.concatenate((before[name], values)) if before else values for name, values in block.items()}
        time_s = rows["time_s"]
        if not before:
            ended.append(time_s[:1])
        before = {name: values[-1:] for name, values in rows.items()}
        moved = (np.nan_to_num(rows["command"][:-1]) != 0.0).any(axis=1)
        for name, step in reading_steps.items():
            moved |= (np.abs(np.diff(rows[name], axis=0)) > step).any(axis=1)
        ended.append(time_s[1:][moved])
        alarms.append(time_s[np.nan_to_num(rows["alarm"][:, 0]) != 0.0])
    return np.concatenate(ended), np.concatenate(alarms)


def _compute_jump_sizes(
    records: Sequence[DetectionRecord], final_reciprocal: tuple[float, float]
) -> list[DetectionRecord]:
    """Sets each jump's mass and 1-sigma from 1/m before it and before the next jump, or at the end."""
    result, after = [], final_reciprocal
    for record in reversed(records):
        if record.before is not None:
            (first, first_std), (last, last_std) = record.before, after
            mass, std = 1.0 / last - 1.0 / first, float(np.hypot(first_std / first**2, last_std / last**2))
            result.append(record._replace(mass=mass, mass_std=std))
            after = record.before
        else:
            result.append(record)
    return result[::-1]


def _make_failure_record(vehicle: Vehicle, event: EventRecord) -> DetectionRecord:
    """Makes the record of a declared jet failure; by its force "jet_on", "jet_off" or "jet_degraded"."""
    assert event.magnitude is not None
    assert event.magnitude_std is not None
    assert event.jet_index is not None
    alone = event.kind == "failed" and bool(event.jets)
    thrust = vehicle.jets[event.jet_index].thrust
    lost: Kind = "jet_off" if _is_full_thrust(event.magnitude, event.magnitude_std, thrust) else "jet_degraded"
    return DetectionRecord(
        onset_s=event.onset_s,
        time_s=event.time_s,
        kind="jet_on" if event.magnitude > 0.0 else lost,
        cluster=event.cluster,
        jet=event.jets[0] if alone else None,
        isolated_to="jet" if alone else "group" if event.jets else "cluster",
        magnitude=event.magnitude,
        magnitude_std=event.magnitude_std,
        statistic=event.statistic,
        alarms=event.alarms,
        jets=event.jets,
        told_apart_by=event.told_apart_by,
        told_apart_s=event.told_apart_s,
        thrust=thrust,
        probability=event.probability,
        jet_index=event.jet_index,
    )


def _make_jump_record(event: EventRecord) -> DetectionRecord:
    """Makes the record of a declared mass-property jump, with its mass if above 3 sigma."""
    record = DetectionRecord(
        onset_s=event.onset_s,
        time_s=event.time_s,
        kind=JUMP,
        cluster=None,
        jet=None,
        isolated_to=None,
        magnitude=None,
        magnitude_std=None,
        statistic=event.statistic,
        alarms=event.alarms,
    )
    if event.mass is None or event.mass_std is None or abs(event.mass) <= _SIGNIFICANT * event.mass_std:
        return record
    return record._replace(**_size_fields(event))


def _force_fields(event: EventRecord) -> dict[str, Any]:
    """Returns the fields of a record that hold an event's force and its 1-sigma."""
    return {"magnitude": event.magnitude, "magnitude_std": event.magnitude_std}


def _size_fields(event: EventRecord) -> dict[str, Any]:
    """Returns the fields of a record that hold a jump's mass and position with their 1-sigma."""
    return {name: getattr(event, name) for name in ("mass", "mass_std", "position", "position_std")}


def _is_full_thrust(magnitude: float, std: float, thrust: float) -> bool:
    """Tests whether an excess or missing force is above 90 % of the thrust, or within 3 sigma of it."""
    return abs(magnitude) > _NEARLY_ALL * thrust or abs(abs(magnitude) - thrust) < _SIGNIFICANT * std


def fault_mode(record: DetectionRecord) -> Mode | None:
    """Classifies a detection as "stuck_on", "leak", "loss", "docking" and so on; None where size is unknown.

    A jet is stuck where its force is within 3 sigma of its thrust, or above 90 % of it; else it leaks or has lost some.
    A jump is a payload that docks or is released where its mass is known to 3 sigma.
    """
    if record.kind == JUMP:
        mass, mass_std = record.mass, record.mass_std
        if mass is None or mass_std is None or not abs(mass) > _SIGNIFICANT * mass_std:
            return None
        return "docking" if mass > 0.0 else "release"
    if record.pattern is not None:
        return "drift" if record.pattern == "drifting" else "intermittent"
    if record.magnitude is None or record.magnitude_std is None or record.thrust is None:
        return None
    whole = _is_full_thrust(record.magnitude, record.magnitude_std, record.thrust)
    if record.magnitude > 0.0:
        return "stuck_on" if whole else "leak"
    return "stuck_off" if whole else "loss"


def _with_mode(record: DetectionRecord) -> DetectionRecord:
    """Returns the record with its fault mode set by its size."""
    return record._replace(mode=fault_mode(record))


# -------------------------------------------------------------------------------------------- in words


_MODES: dict[Mode | None, str] = {
    "stuck_on": "stuck on",
    "leak": "leaks",
    "stuck_off": "stuck off",
    "loss": "loses",
    "intermittent": "intermittent",
    "drift": "drifts",
    "release": "payload released",
    "docking": "payload docked",
    "sensor": "reads falsely",
}


def in_words(entry: DetectionRecord, units: Mapping[str, str], *, detailed: bool = False) -> str:
    """Describes a detection: jets and fault mode, such as 'jet T7: leaks 0.0500 N, 5 % of its thrust'.

    Args:
        entry: see `DetectionRecord`.
        units: names of the vehicle's units, see `Vehicle.unit_names`.
        detailed: whether to add its cluster, and every size and its 1-sigma.
    """
    how = _MODES.get(entry.mode) or entry.kind.replace("_", " ").removeprefix("jet ")
    if entry.magnitude is None or entry.magnitude_std is None:
        size = size_in_words(entry, units) if detailed else ""
        return f"{how}: {size}" if size else how
    signed = format_with_deviation(entry.magnitude, entry.magnitude_std)
    force = f"{signed if detailed else signed.partition(' ±')[0]} {units['force']}"
    share = "" if not entry.thrust else f", {_format_percent(abs(entry.magnitude) / entry.thrust)} of its thrust"
    if entry.mode in ("leak", "loss"):
        how = f"{how} {force[1:]}{share}"
    elif entry.mode in ("intermittent", "drift"):
        how = f"{how}, now {force}{share}" if detailed else how
    elif detailed:
        how = f"{how}, {force}"
    cluster = f" (cluster {entry.cluster})" if detailed and entry.jet else ""
    return f"{entry.suspects}{cluster}: {how}"


def _format_percent(share: float) -> str:
    """Formats a share (0 to 1) in percent, to two digits, three from 99.5 % on."""
    return f"{100.0 * share:.{2 if share < 0.995 else 3}g} %"


def size_in_words(entry: DetectionRecord, units: Mapping[str, str]) -> str:
    """Formats a failure's force, or a jump's mass and place, with 1-sigma and unit; "" where not known."""
    if entry.magnitude is not None and entry.magnitude_std is not None:
        return f"{format_with_deviation(entry.magnitude, entry.magnitude_std)} {units['force']}"
    mass, place = (
        gained_mass_in_words(entry.mass, entry.mass_std, units),
        place_in_words(entry.position, entry.position_std, units),
    )
    return f"{mass} at {place}" if mass and place else mass


def onset_in_words(entry: DetectionRecord) -> str:
    """Formats a detection's onset: 'since 12.00 s', or 'begun between ... and ... s' where it is bounded."""
    if entry.earliest_s is None or entry.latest_s is None:
        return f"since {entry.onset_s:.2f} s"
    return f"begun between {entry.earliest_s:.2f} and {entry.latest_s:.2f} s"


def remarks(entry: DetectionRecord) -> list[str]:
    """Lists phrases on a detection: how to separate its group, when it was measured, erratic or withdrawn."""
    phrases = []
    if entry.isolated_to == "group":
        phrases.append(separation_in_words(entry))
    if entry.measured_s is not None:
        phrases.append(f"measured at {entry.measured_s:.2f} s")
    if entry.erratic_s is not None:
        how = "drifting" if entry.pattern == "drifting" else "on and off"
        phrases.append(f"erratic ({how}) from {entry.erratic_s:.2f} s on")
    if entry.withdrawn_s is not None:
        phrases.append(f"withdrawn at {entry.withdrawn_s:.2f} s")
    return phrases

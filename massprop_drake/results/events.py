"""Events that a detector declared in a run, one record each, in the order of declaration."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.inputs.model import Count, NotNegative, Real, Text, Whole
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.maths.estimation.detector import STATUS
from massprop_drake.maths.estimation.detector import Verdict as Code
from massprop_drake.maths.estimation.faults.declarations import Word
from massprop_drake.maths.estimation.faults.fault_report import HYPOTHESIS_REPORT, jets_by_declaration
from massprop_drake.maths.signals import AXES, format_with_deviation

Array = NDArray[np.float64]

EventKind = Literal[
    "failed",
    "group",
    "changed",
    "withdrawn",
    "erratic",
    "jump",
    "jump_measured",
    "false_reading",
    "engine_failed",
    "unexplained",
    "disturbance",
]
_OF_HYPOTHESES = tuple(HYPOTHESIS_REPORT)
_OF_JETS: dict[Word, EventKind] = {
    Word.FAILED: "failed",
    Word.GROUP: "group",
    Word.CHANGED: "changed",
    Word.WITHDRAWN: "withdrawn",
    Word.ERRATIC: "erratic",
}
_OF_ENGINES = ("level", "gimbal_1", "gimbal_2")
_Three = tuple[Real, Real, Real]


class EventRecord(NamedTuple):
    """Record of an event that a detector declared.

    Attributes:
        time_s: when, s.
        kind: "failed" (a jet, or one of a cluster), "group" (one of `jets`, which look alike), "changed" (the force of
            a failed jet), "withdrawn", "erratic" (its force has changed again and again), "jump" (of the mass
            properties), "jump_measured" (the size of an earlier one), "false_reading", "engine_failed" (its level or an
            angle of its gimbal stays where it was), "disturbance" (something acts that nobody stated, and changes
            slowly) or "unexplained".
        onset_s: since when, s.
        jets: designations, the likeliest first; none where only a cluster is named, and where it is not of jets. What
            is said of a group later names all its members, until it is told apart.
        cluster: of the likeliest jet.
        magnitude, magnitude_std: force too much (positive) or missing (negative) of the likeliest jet, lbf or N.
        told_apart_by: designation of the jet of a group that, fired alone, would tell it apart.
        told_apart_s: seconds without any jet after which it would be; with neither nothing would.
        pattern: of an erratic jet, "intermittent" (its force comes and goes) or "drifting".
        mass, mass_std: gained in a jump (released: negative), slug or kg; None while no filter of it fits.
        position, position_std: where, vehicle frame, ft or m.
        sensor, axis: package and axis of a false reading; of a wheel "speed"; None: the attitude of a tracker; an
            engine, and "level", "gimbal_1" or "gimbal_2".
        torque_std, force_std: of a disturbance, 1-sigma about and along an axis to an order of magnitude, ft-lbf and
            lbf, or N-m and N; the force None without an accelerometer.
        statistic, alarms: likelihood argument, None where there is none, and how many alarms led to it.
        probability: that the jet, or one of the group, has failed, at this time; None of a detector that gives none.
        jet_index: index of the likeliest jet of the vehicle, while the run goes on; None in a summary.
    """

    time_s: Real
    kind: EventKind
    onset_s: Real
    jets: tuple[Text, ...] = ()
    cluster: Whole | None = None
    magnitude: Real | None = None
    magnitude_std: NotNegative | None = None
    told_apart_by: Text | None = None
    told_apart_s: NotNegative | None = None
    pattern: Literal["intermittent", "drifting"] | None = None
    mass: Real | None = None
    mass_std: NotNegative | None = None
    position: _Three | None = None
    position_std: _Three | None = None
    sensor: Text | None = None
    axis: Text | None = None
    torque_std: NotNegative | None = None
    force_std: NotNegative | None = None
    statistic: Real | None = None
    alarms: Count = 0
    probability: Real | None = None
    jet_index: Count | None = None


def list_events(
    vehicle: Vehicle,
    sensors: Sequence[str],
    time_s: Array,
    signals: Mapping[str, Array],
    earlier: Sequence[EventRecord] = (),
) -> list[EventRecord]:
    """Lists failures, jumps, false readings and other events that the detector declared in a block of samples.

    Args:
        vehicle: for its jets.
        sensors: packages in use, gyros first, the preferred of either first.
        time_s: sample times, s, shape (n,).
        signals: by name, shape (n, components).
        earlier: events declared before.
    """
    found = list(earlier)
    if "detector_event" in signals:
        for row in np.flatnonzero(signals["detector_event"][:, 0]):
            status = {name: float(signals[name][row, 0]) for name in STATUS}
            if "verdict" in signals:
                report = {name: signals[name][row] for name in _OF_HYPOTHESES}
                declared = _make_hypothesis_events(vehicle, sensors, float(time_s[row]), (status, report), found)
                found += map(_without_nan, declared)
            else:
                nis = float(signals["rotation_nis"][row, 0])
                found.append(_without_nan(_make_sample_event(vehicle, float(time_s[row]), status, nis)))
    return found[len(earlier) :]


def locate_reading(component: int, sensors: Sequence[str], vehicle: Vehicle) -> tuple[str, str | None]:
    """Maps the index of a reading's component to its sensor and axis ("x", "speed", "level"; None: attitude).

    Args:
        component: see `joint.hypotheses.Cause`.
        sensors: of three components each, in the filter's order.
        vehicle: for its wheels.
    """
    beyond, wheels = component - 3 * len(sensors), vehicle.wheels
    if beyond < 0:
        return sensors[component // 3], AXES[component % 3]
    if beyond < len(wheels):
        return wheels[beyond].name, "speed"
    beyond -= len(wheels)
    trackers = [pose.name for pose in vehicle.poses if pose.name in sensors]
    if beyond < len(trackers):
        return trackers[beyond], None
    engine, channel = divmod(beyond - len(trackers), len(_OF_ENGINES))
    return vehicle.engines[engine].name, _OF_ENGINES[channel]


def sensor_event_kind(sensor: str, vehicle: Vehicle) -> Literal["false_reading", "engine_failed"]:
    """Returns "engine_failed" for the name of an engine, "false_reading" for that of a sensor."""
    return "engine_failed" if any(engine.name == sensor for engine in vehicle.engines) else "false_reading"


def _without_nan(event: EventRecord) -> EventRecord:
    """Returns the event with None for each NaN, as JSON files hold it."""
    lacking: dict[str, Any] = {
        name: None for name, value in event._asdict().items() if isinstance(value, float) and math.isnan(value)
    }
    return event._replace(**lacking) if lacking else event


def _make_sample_event(vehicle: Vehicle, time_s: float, status: Mapping[str, float], nis: float) -> EventRecord:
    """Makes the event of a single-sample or CUSUM detector: a jet failure, a withdrawal, or a jump."""
    code, jet, alarms = int(status["detector_event"]), int(status["suspected_jet"]), int(status["alarms"])
    if code not in (Code.DECLARED, Code.WITHDRAWN):
        return EventRecord(time_s, "jump", status["onset"], statistic=nis, alarms=alarms)
    return EventRecord(
        time_s,
        "failed" if code == Code.DECLARED else "withdrawn",
        status["onset"],
        jets=(vehicle.designations[jet],) if status["jet_isolated"] or code == Code.WITHDRAWN else (),
        cluster=vehicle.jets[jet].cluster,
        magnitude=status["suspected_magnitude"],
        magnitude_std=status["suspected_magnitude_std"],
        statistic=status["suspected_likelihood"],
        alarms=alarms,
        jet_index=jet,
    )


def _make_hypothesis_events(
    vehicle: Vehicle,
    sensors: Sequence[str],
    time_s: float,
    status_and_report: tuple[Mapping[str, float], Mapping[str, Array]],
    earlier: Sequence[EventRecord],
) -> Iterator[EventRecord]:
    """Yields the events that the detector by hypotheses declared at a sample, from its status and its report."""
    status, report = status_and_report
    how: dict[str, Any] = {"statistic": status["suspected_likelihood"], "alarms": int(status["alarms"])}
    for jets in jets_by_declaration(report["verdict_group"], report["verdict_place"]):
        event = _make_jet_event(vehicle, time_s, jets, report)._replace(**how)
        yield event._replace(pattern=_classify_pattern(earlier, event)) if event.kind == "erratic" else event
    if not np.isnan(report["jump_measured"][0]):
        onsets = [one.onset_s for one in earlier if one.kind == "jump"]
        known, there = np.isfinite(report["jump_mass"][0]), np.isfinite(report["jump_position"]).all()
        yield EventRecord(
            time_s,
            "jump_measured" if report["jump_measured"][0] else "jump",
            onsets[-1] if report["jump_measured"][0] and onsets else status["onset"],
            mass=float(report["jump_mass"][0]) if known else None,
            mass_std=float(report["jump_mass_std"][0]) if known else None,
            position=_to_triple(report["jump_position"]) if there else None,
            position_std=_to_triple(report["jump_position_std"]) if there else None,
            **how,
        )
    if not np.isnan(report["lying_component"][0]):
        sensor, axis = locate_reading(int(report["lying_component"][0]), sensors, vehicle)
        yield EventRecord(time_s, sensor_event_kind(sensor, vehicle), status["onset"], sensor=sensor, axis=axis, **how)
    if not np.isnan(report["unexplained_since"][0]):
        yield EventRecord(time_s, "unexplained", float(report["unexplained_since"][0]), **how)
    if not np.isnan(report["disturbed_since"][0]):
        torque, force = (float(report[f"disturbance_{of}"][0]) for of in ("torque", "force"))
        event = EventRecord(time_s, "disturbance", float(report["disturbed_since"][0]), **how)
        yield event._replace(torque_std=torque, force_std=force)


def _make_jet_event(vehicle: Vehicle, time_s: float, jets: list[int], report: Mapping[str, Array]) -> EventRecord:
    """Makes the event of a declared jet, or of a group of jets that look alike."""
    jet, has_probabilities = jets[0], bool(np.isfinite(report["none_probability"][0]))
    separating_jet, after_s = float(report["verdict_apart_by"][jet]), float(report["verdict_apart_after"][jet])
    return EventRecord(
        time_s,
        _OF_JETS[Word(int(report["verdict"][jet]))],
        float(report["verdict_onset"][jet]),
        jets=tuple(vehicle.designations[index] for index in jets),
        cluster=vehicle.jets[jet].cluster,
        magnitude=float(report["verdict_magnitude"][jet]),
        magnitude_std=float(report["verdict_std"][jet]),
        told_apart_by=None if math.isnan(separating_jet) else vehicle.designations[int(separating_jet)],
        told_apart_s=None if math.isnan(after_s) else after_s,
        probability=min(float(report["fault_probability"][jets].sum()), 1.0) if has_probabilities else None,
        jet_index=jet,
    )


def _classify_pattern(earlier: Sequence[EventRecord], event: EventRecord) -> Literal["intermittent", "drifting"]:
    """Returns "drifting" if a jet's declared forces always change in one direction, else "intermittent"."""
    of_it = [one for one in (*earlier, event) if one.jet_index == event.jet_index and one.magnitude is not None]
    changes = np.diff([one.magnitude for one in of_it if one.magnitude is not None])
    return "drifting" if (changes > 0.0).all() or (changes < 0.0).all() else "intermittent"


def _to_triple(values: Array) -> tuple[float, float, float]:
    """Converts a vector, shape (3,), to a tuple of floats."""
    x, y, z = values.tolist()
    return x, y, z


# -------------------------------------------------------------------------------------------- in words


def in_words(event: EventRecord, units: Mapping[str, str]) -> str:
    """Describes an event in a sentence: the failed or changed component, the size and the onset.

    Args:
        event: see `EventRecord`.
        units: names of the vehicle's units, see `Vehicle.unit_names`.
    """
    since = f"since {event.onset_s:.2f} s"
    match event.kind:
        case "failed" | "group":
            what = f"{_jets_in_words(event)} has failed: {_force_in_words(event, units)}, {since}"
            return what if event.kind == "failed" else f"{what}; {separation_in_words(event)}"
        case "changed":
            return f"the failure of {_jets_in_words(event)} is now {_force_in_words(event, units)}"
        case "withdrawn":
            return f"nothing is left of the failure of {_jets_in_words(event)}"
        case "erratic":
            how = "drifts" if event.pattern == "drifting" else "comes and goes"
            which, force = _jets_in_words(event), _force_in_words(event, units)
            relied = "it is not relied on" if len(event.jets) == 1 else "what it gives is not relied on"
            return f"{which} is erratic: its failure {how}, now {force}; {relied}"
        case "jump" | "jump_measured":
            of = "a jump of the mass properties" if event.kind == "jump" else "the jump of the mass properties"
            unknown = event.mass is not None and event.mass_std is not None and abs(event.mass) < event.mass_std
            size = "" if unknown else gained_mass_in_words(event.mass, event.mass_std, units)
            where = place_in_words(event.position, event.position_std, units)
            told = f": {size}{f' at {where}' if where else ''}" if size else ""
            return f"{of}, seen after {event.onset_s:.2f} s{told}{'; how large it is will show' if unknown else ''}"
        case "false_reading":
            if event.axis is None:
                return f"{event.sensor} reads another attitude {since}, and turns on from there"
            until = "for good" if event.axis == "speed" else "until it fits again"
            return f"{event.sensor}_{event.axis} reads falsely {since}; it is left out {until}"
        case "engine_failed":
            stays = {"level": "its thrust", "gimbal_1": "the first angle of its gimbal", "gimbal_2": "the second angle"}
            return f"engine {event.sensor} has failed: {stays[str(event.axis)]} is not as told {since}"
        case "disturbance":
            return (
                f"{disturbance_in_words(event, units)} acts besides the jets {since}, "
                "which nobody stated; from then on it is taken "
                "into account"
            )
        case _:
            return (
                f"something {since} that no failed jet, no jump and no false reading explains; "
                "the estimates are less sure from here on"
            )


def disturbance_in_words(event: EventRecord, units: Mapping[str, str]) -> str:
    """Formats the torque, and the force if known, of a disturbance to one digit, with units."""
    force, length = units["force"], units["length"]
    unit = f"{force}-{length}" if force == "N" else f"{length}-{force}"
    torque = f"a torque of the order of {event.torque_std:.0e} {unit}"
    more = "" if event.force_std is None else f", and a force of {event.force_std:.0e} {force},"
    return torque + more


def separation_in_words(event: Any) -> str:
    """Describes the firing or wait that would separate the jets of a group; takes an `EventRecord` or a detection."""
    if event.told_apart_by is not None:
        return f"{event.told_apart_by} fired alone would tell them apart"
    if event.told_apart_s is not None:
        return f"{event.told_apart_s:.1f} s without firing would tell them apart"
    return "firing none of them alone, nor waiting, would tell them apart"


def gained_mass_in_words(mass: float | None, std: float | None, units: Mapping[str, str]) -> str:
    """Formats a mass gained, with 1-sigma and unit; "" where it is not known."""
    return "" if mass is None or std is None else f"{format_with_deviation(mass, std)} {units['mass']}"


def place_in_words(position: Sequence[float] | None, std: Sequence[float] | None, units: Mapping[str, str]) -> str:
    """Formats a position (x, y, z), with 1-sigma and unit; "" where it is not known."""
    if position is None or std is None:
        return ""
    parts = ", ".join(format_with_deviation(value, deviation) for value, deviation in zip(position, std, strict=True))
    return f"({parts}) {units['length']}"


def _jets_in_words(event: EventRecord) -> str:
    """Formats an event's jets: "jet T7", "one of T7, T8" or "a jet of cluster 2"."""
    if len(event.jets) == 1:
        return f"jet {event.jets[0]}"
    return f"one of {', '.join(event.jets)}" if event.jets else f"a jet of cluster {event.cluster}"


def _force_in_words(event: EventRecord, units: Mapping[str, str]) -> str:
    """Formats the force too much (positive) or missing (negative) with its 1-sigma and unit."""
    assert event.magnitude is not None
    assert event.magnitude_std is not None
    return f"{format_with_deviation(event.magnitude, event.magnitude_std)} {units['force']}"

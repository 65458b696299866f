"""Outcome of each failure of a simulated run: when it acted, when it was found, and as what."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.inputs import params, true_params
from massprop_drake.inputs.model import Real, Text
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.maths.vehicle.thrust import lag_factors, level_after, mean_level
from massprop_drake.results.detections import JUMP, DetectionRecord
from massprop_drake.results.spool import blocks

Array = NDArray[np.float64]

_ACTS = 1e-9  # of full thrust, between what a jet gives and what it was told to
Cause = Literal["healthy", "failure", "jump"]
InjectedOutcome = Literal["named", "group", "wrong", "missed", "never_acted", "not_tested"]
FOUND: tuple[InjectedOutcome, ...] = ("named", "group")


class InjectedRecord(NamedTuple):
    """Record of a failure of a jet, or a payload that came or left, and its outcome.

    Attributes:
        kind: as the scenario has it; of a payload "release" or "dock".
        jet: designation; None for a payload.
        start_s: onset, s.
        first_acted_s: when the jet first gave other than what it was told, or the payload came or left, s; None: never.
        first_alarm_s: first alarm from then on, and not after it was declared, s; None: none.
        declared_s: when it was declared as what it is, jet or cluster, s; or, with the outcome "wrong", as what it is
            not; None: never.
        outcome: "named": the jet, or a jump as one; "group": a cluster, or a group of jets, with the jet in it;
            "wrong": another jet, or a jump for a jet, or a jet for a jump; "missed": nothing was declared;
            "never_acted"; "not_tested": no sample was tested from when it acted.
        taken_for: what it was declared as, where that is wrong: a designation, a cluster, or "mass_property_jump".
        force: what the jet gave too much where it was to be quiet (positive), or too little where it was to fire
            (negative), of a whole sample, lbf or N: the median over the samples in which it acted; None for a payload
            and where it never acted.
        magnitude, magnitude_std: as declared, lbf or N, with 1-sigma; None likewise, and where it was not found.
    """

    kind: Text
    jet: Text | None
    start_s: Real
    first_acted_s: Real | None
    first_alarm_s: Real | None
    declared_s: Real | None
    outcome: InjectedOutcome
    taken_for: Text | None = None
    force: Real | None = None
    magnitude: Real | None = None
    magnitude_std: Real | None = None

    @property
    def is_jump(self) -> bool:
        """True if it is a payload's docking or release."""
        return self.jet is None

    @property
    def name(self) -> str:
        """Name of the failure or jump, such as 'R4R stuck on' or 'payload dock'."""
        return f"{self.jet or 'payload'} {self.kind.replace('_', ' ')}"

    @property
    def outcome_text(self) -> str:
        """Outcome of detection in words, such as 'named', 'not found' or 'taken for R3R'."""
        return _OUTCOME_TEXTS[self.outcome].format((self.taken_for or "").replace("_", " "))

    @property
    def good(self) -> bool | None:
        """True if the fault was declared as its jet, its group or a jump; None if it never acted."""
        return None if self.outcome == "never_acted" else self.outcome in FOUND


_OUTCOME_TEXTS: dict[InjectedOutcome, str] = {
    "named": "named",
    "group": "named in a group",
    "wrong": "taken for {}",
    "missed": "not found",
    "never_acted": "never acted",
    "not_tested": "not found: no sample was tested",
}


def injected_outcomes(
    scenario: Scenario, signals: Mapping[str, Array], detections: Sequence[DetectionRecord]
) -> tuple[InjectedRecord, ...]:
    """Compares each injected failure and payload jump with the declarations: named, wrong, missed and so on.

    Args:
        scenario: as run.
        signals: of the run, by name, with `time_s`.
        detections: all declarations, in their order.

    Returns:
        A record each, failures of jets first, in the scenario's order.
    """
    followers = _make_followers(scenario)
    if not followers:
        return ()
    names = [name for name in ("command", "thrust", "tested", "alarm") if name in signals]
    for block in blocks(signals, "time_s", *names):
        for follower in followers:
            follower.add(block["time_s"], block)
    vehicle = scenario.vehicle_data
    matched = _match_declarations(vehicle, [follower.record for follower in followers], detections)
    unmatched = [index for index in range(len(detections)) if index not in matched.values()]
    records = []
    for number, follower in enumerate(followers):
        record = follower.record
        acted = record.first_acted_s
        if number in matched:
            entry = detections[matched[number]]
            named = record.is_jump or entry.isolated_to == "jet"
            record = _with_declaration(record._replace(outcome="named" if named else "group"), entry)
            if acted is not None and entry.time_s < acted - _ACTS:  # it was known when it acted again
                record = record._replace(declared_s=acted)
        elif acted is not None:
            wrong = next((index for index in unmatched if detections[index].time_s >= acted - _ACTS), None)
            if wrong is not None:
                unmatched.remove(wrong)
                record = _with_declaration(
                    record._replace(outcome="wrong", taken_for=_name_declared(detections[wrong])), detections[wrong]
                )
            else:
                record = record._replace(outcome="missed" if follower.tested else "not_tested")
        records.append(_drop_late_alarm(record))
    return tuple(records)


def false_declarations(
    vehicle: Vehicle, injected: Sequence[InjectedRecord], detections: Sequence[DetectionRecord]
) -> dict[int, Cause]:
    """Maps the index of each declaration that no injected event explains to its cause.

    The cause is the last event that had acted before: "healthy" (none), "failure" or "jump".
    """
    matched = set(_match_declarations(vehicle, injected, detections).values())
    acted = [(event.first_acted_s, event.is_jump) for event in injected if event.first_acted_s is not None]
    causes: dict[int, Cause] = {}
    for index, entry in enumerate(detections):
        if index not in matched:
            _, jumped = max((action for action in acted if action[0] <= entry.time_s), default=(0.0, None))
            causes[index] = "healthy" if jumped is None else "jump" if jumped else "failure"
    return causes


def _match_declarations(
    vehicle: Vehicle, injected: Sequence[InjectedRecord], detections: Sequence[DetectionRecord]
) -> dict[int, int]:
    """Maps the index of each injected event to the index of the declaration that names it correctly.

    Each declaration matches one event; one that stands matches later failures of its jet, too.
    """
    matched: dict[int, int] = {}
    for number, event in sorted(enumerate(injected), key=lambda item: item[1].start_s):
        if event.first_acted_s is None:
            continue
        standing = next((index for index in matched.values() if _is_true_declaration(event, detections[index])), None)
        for index, entry in enumerate(detections):
            if (
                index not in matched.values()
                and entry.time_s >= event.first_acted_s - _ACTS
                and _is_match(vehicle, event, entry)
            ):
                matched[number] = index
                break
        else:
            if standing is not None:
                matched[number] = standing
    return matched


def _is_true_declaration(failure: InjectedRecord, detection: DetectionRecord) -> bool:
    """Tests whether a declaration names the failure's jet and still stands when the failure acts."""
    acted = failure.first_acted_s
    is_withdrawn = detection.withdrawn_s is not None and acted is not None and detection.withdrawn_s < acted
    return failure.jet is not None and detection.jet == failure.jet and not is_withdrawn


def _is_match(vehicle: Vehicle, event: InjectedRecord, detection: DetectionRecord) -> bool:
    """Tests whether a declaration names the injected jet, or a group or cluster with it; or both are jumps."""
    if event.jet is None or detection.kind == JUMP:
        return event.jet is None and detection.kind == JUMP
    if detection.jet is not None:
        return detection.jet == event.jet
    if detection.jets:
        return event.jet in detection.jets
    return detection.cluster == vehicle.jets[vehicle.designations.index(event.jet)].cluster


def _with_declaration(record: InjectedRecord, entry: DetectionRecord) -> InjectedRecord:
    """Returns the record with time and force of a declaration."""
    return record._replace(declared_s=entry.time_s, magnitude=entry.magnitude, magnitude_std=entry.magnitude_std)


def _drop_late_alarm(record: InjectedRecord) -> InjectedRecord:
    """Returns the record without its first alarm if that is later than the declaration."""
    alarm_s, declared_s = record.first_alarm_s, record.declared_s
    late = alarm_s is not None and declared_s is not None and alarm_s > declared_s + _ACTS
    return record._replace(first_alarm_s=None) if late else record


def _name_declared(entry: DetectionRecord) -> str:
    """Returns the name that a detection declares: designation of a jet, "mass_property_jump" or "cluster 2"."""
    return entry.jet or (entry.kind if entry.kind == JUMP else f"cluster {entry.cluster}")


# ----------------------------------------------------------------------------- when a failure acts


def _make_followers(scenario: Scenario) -> list[_EventFollower]:
    """Makes for each injected failure and payload jump a follower, which records when it acts in a run."""
    vehicle = scenario.vehicle_data
    thrusts = params.thrust_factors(scenario) * np.linalg.norm(vehicle.thrusts, axis=1)
    lag = lag_factors(params.plant_time_constants(scenario), vehicle.sample_period_s)
    followers = []
    for failure in true_params.jet_failures(scenario):
        kind, jet = failure.kind.name.lower(), failure.jet
        record = _unacted_record(kind, vehicle.designations[jet], failure.start_s)
        response = float(lag.remaining[jet]), float(lag.mean[jet])
        followers.append(
            _EventFollower(record, failure.end_s, jet, float(thrusts[jet]), response, vehicle.sample_period_s)
        )
    return followers + [
        _EventFollower(_unacted_record(jump.kind, None, jump.time_s), jump.time_s) for jump in scenario.jumps
    ]


def _unacted_record(kind: str, jet: str | None, start_s: float) -> InjectedRecord:
    """Makes the record of an injected event before the run: never acted, nothing declared."""
    return InjectedRecord(kind, jet, start_s, None, None, None, "never_acted")


class _EventFollower:
    """Failure or jump, followed through a run block by block.

    Args:
        record: with what the scenario says.
        end_s: when a failure is over, s.
        jet: its number; None for a jump, as of all that follow.
        thrust: of the jet at its best, lbf or N.
        response: of its lag: what remains of a level after a sample, and what of it the mean has.
        period_s: of a sample, s.
    """

    def __init__(
        self,
        record: InjectedRecord,
        end_s: float,
        jet: int | None = None,
        thrust: float = 0.0,
        response: tuple[float, float] | None = None,
        period_s: float = 0.0,
    ):
        self._begun, self.tested = record, False
        self._end_s, self._jet, self._thrust, self._response = end_s, jet, thrust, response
        self._period_s = period_s
        self._level = 0.0  # of the jet, were it well
        self._acted_s: float | None = None
        self._alarm_s: float | None = None
        self._forces: list[Array] = []  # of the samples in which it acted, rows of force and share of the sample

    @property
    def record(self) -> InjectedRecord:
        """Record of the injected event up to the last block: first action, first alarm, median force."""
        force = None
        if self._forces:
            forces, shares = np.hstack(self._forces)
            whole = shares >= min(
                0.5, shares.max()
            )  # a small part of a sample tells more of the lag than of the failure
            force = float(np.median(forces[whole]))
        return self._begun._replace(first_acted_s=self._acted_s, first_alarm_s=self._alarm_s, force=force)

    def add(self, time_s: Array, signals: Mapping[str, Array]) -> None:
        """Updates the record by a block of samples; signals by name, shape (n, components)."""
        acting = self._find_acting_rows(time_s, signals)
        if self._acted_s is None and acting.any():
            # a payload comes or leaves when it is told to, and a jet whose sample has begun no sooner than it fails
            start_s = self._begun.start_s
            self._acted_s = start_s if self._jet is None else max(float(time_s[acting][0]), start_s)
        if self._acted_s is None or "tested" not in signals:
            return
        after = time_s >= self._acted_s
        self.tested |= bool((signals["tested"][after, 0] > 0.0).any())
        alarms = time_s[after & (np.nan_to_num(signals["alarm"][:, 0]) > 0.0)]
        if self._alarm_s is None and alarms.size:
            self._alarm_s = float(alarms[0])

    def _find_acting_rows(self, time_s: Array, signals: Mapping[str, Array]) -> NDArray[np.bool_]:
        """Flags samples with thrust other than a healthy jet's, or after the jump, shape (n,)."""
        if self._jet is None or self._response is None:
            return time_s >= self._begun.start_s - _ACTS
        remaining, mean = self._response
        given = np.empty(time_s.size)
        for row, command in enumerate(signals["command"][:, self._jet].tolist()):
            given[row] = mean_level(self._level, command, mean)
            self._level = level_after(self._level, command, remaining)
        excess = signals["thrust"][:, self._jet] - self._thrust * given
        begun = (time_s > self._begun.start_s - self._period_s - _ACTS) & (time_s < self._end_s)
        acting = begun & (np.abs(excess) > _ACTS * self._thrust)
        if acting.any():
            share = np.where(excess < 0.0, given, 1.0 - given)[acting]
            self._forces.append(np.stack([excess[acting] / np.maximum(share, _ACTS), share]))
        return acting

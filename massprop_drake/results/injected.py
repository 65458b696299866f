"""What became of each failure that a simulated run had: when it acted, when it was found, and as what."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.inputs import params
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.maths.vehicle.thrust import lag_factors, level_after, mean_level
from massprop_drake.results.summary import DetectionRecord

Array = NDArray[np.float64]

_ACTS = 1e-9  # of full thrust, between what a jet gives and what it was told to
JUMP = "mass_property_jump"


class InjectedRecord(NamedTuple):
    """A failure of a jet, or a payload that came or left, and what was made of it.

    Attributes:
        kind: as the scenario has it; of a payload "release" or "dock".
        jet: designation; None for a payload.
        start_s: onset, s.
        first_acted_s: when the jet first gave other than what it was told, or the payload came or left, s; None: never.
        first_alarm_s: first alarm from then on, s; None: none.
        declared_s: when it was declared as what it is, jet or cluster, s; or, with the outcome "wrong", as what it is
            not; None: never.
        outcome: "named": the jet, or a jump as one; "group": a cluster, or a group of jets, with the jet in it;
            "wrong": another jet, or a jump for a jet, or a jet for a jump; "missed": nothing was declared;
            "never_acted"; "not_tested": no sample was tested from when it acted.
        taken_for: what it was declared as, where that is wrong: a designation, a cluster, or "mass_property_jump".
        force: mean of what the jet gave less what it was told over the samples in which it acted, lbf or N; None for
            a payload and where it never acted.
        magnitude, magnitude_std: as declared, lbf or N, with 1-sigma; None likewise, and where it was not found.
    """

    kind: str
    jet: str | None
    start_s: float
    first_acted_s: float | None
    first_alarm_s: float | None
    declared_s: float | None
    outcome: str
    taken_for: str | None = None
    force: float | None = None
    magnitude: float | None = None
    magnitude_std: float | None = None


class _Seen:
    """One injected failure, followed through a run."""

    def __init__(self, kind: str, jet: int | None, start_s: float, end_s: float):
        self.kind, self.jet, self.start_s, self.end_s = kind, jet, start_s, end_s
        self.level = 0.0  # of the jet, were it well
        self.acted_s: float | None = None
        self.alarm_s: float | None = None
        self.tested = False
        self.excess, self.samples = 0.0, 0


class InjectedFailures:
    """Follows the failures of a scenario through its signals, block by block.

    Args:
        scenario: as run.
    """

    def __init__(self, scenario: Scenario):
        vehicle = scenario.vehicle_data
        self._designations = vehicle.designations
        self._clusters = [jet.cluster for jet in vehicle.jets]
        self._thrusts = params.thrust_factors(scenario) * np.linalg.norm(vehicle.thrusts, axis=1)
        self._lag = lag_factors(params.plant_time_constants(scenario), vehicle.sample_period_s)
        self._seen = [
            *(_Seen(failure.kind.name.lower(), failure.jet, failure.start_s, failure.end_s)
              for failure in params.jet_failures(scenario)),
            *(_Seen(jump.kind, None, jump.time_s, jump.time_s) for jump in scenario.jumps),
        ]  # fmt: skip

    def add(self, time_s: Array, signals: Mapping[str, Array]) -> None:
        """Takes in a block of rows; signals by name, shape (n, components)."""
        for seen in self._seen:
            if seen.jet is None:
                if seen.acted_s is None and time_s[-1] >= seen.start_s - _ACTS:
                    seen.acted_s = float(time_s[np.searchsorted(time_s, seen.start_s - _ACTS)])
            else:
                self._follow(seen, seen.jet, time_s, signals)
            if seen.acted_s is not None and "tested" in signals:
                after = time_s >= seen.acted_s
                seen.tested |= bool((signals["tested"][after, 0] > 0.0).any())
                alarms = time_s[after & (np.nan_to_num(signals["alarm"][:, 0]) > 0.0)]
                if seen.alarm_s is None and alarms.size:
                    seen.alarm_s = float(alarms[0])

    def _follow(self, seen: _Seen, jet: int, time_s: Array, signals: Mapping[str, Array]) -> None:
        """Compares what the jet gives with what it would give were it well."""
        remaining, mean = self._lag.remaining[jet], self._lag.mean[jet]
        commands, level, given = signals["command"][:, jet], seen.level, np.empty(time_s.size)
        for row, command in enumerate(commands.tolist()):
            given[row] = mean_level(level, command, mean)
            level = level_after(level, command, remaining)
        seen.level = float(level)
        excess = signals["thrust"][:, jet] - self._thrusts[jet] * given
        period = float(time_s[-1] - time_s[0]) / max(time_s.size - 1, 1)
        begun = (time_s > seen.start_s - period - _ACTS) & (time_s < seen.end_s)
        acting = begun & (np.abs(excess) > _ACTS * self._thrusts[jet])
        if acting.any():
            if seen.acted_s is None:
                seen.acted_s = max(float(time_s[acting][0]), seen.start_s)
            seen.excess += float(excess[acting].sum())
            seen.samples += int(acting.sum())

    def finish(self, found: Sequence[DetectionRecord]) -> tuple[InjectedRecord, ...]:
        """What became of each, in the order of the scenario.

        Args:
            found: all that was declared, in its order.
        """
        right = self._matched(found)
        free = [index for index in range(len(found)) if index not in right.values()]
        records = []
        for number, seen in enumerate(self._seen):
            outcome, entry, taken_for = "missed", None, None
            if number in right:
                entry = found[right[number]]
                outcome = "named" if entry.kind == JUMP or entry.isolated_to == "jet" else "group"
            elif seen.acted_s is None:
                outcome = "never_acted"
            else:
                wrong = next((index for index in free if found[index].time_s >= seen.acted_s - _ACTS), None)
                if wrong is not None:
                    free.remove(wrong)
                    entry, outcome = found[wrong], "wrong"
                    taken_for = entry.jet or (entry.kind if entry.kind == JUMP else f"cluster {entry.cluster}")
                elif not seen.tested:
                    outcome = "not_tested"
            records.append(
                InjectedRecord(
                    kind=seen.kind,
                    jet=None if seen.jet is None else self._designations[seen.jet],
                    start_s=seen.start_s,
                    first_acted_s=seen.acted_s,
                    first_alarm_s=seen.alarm_s,
                    declared_s=None if entry is None else entry.time_s,
                    outcome=outcome,
                    taken_for=taken_for,
                    force=seen.excess / seen.samples if seen.samples else None,
                    magnitude=None if entry is None else entry.magnitude,
                    magnitude_std=None if entry is None else entry.magnitude_std,
                )
            )
        return tuple(records)

    def false(self, found: Sequence[DetectionRecord]) -> list[tuple[DetectionRecord, str]]:
        """The declarations that none of the failures explains, each with its cause.

        The cause is what had acted last before: "healthy" (nothing), "failure" or "jump".
        """
        right = set(self._matched(found).values())
        false = []
        for index, entry in enumerate(found):
            if index in right:
                continue
            before = [seen for seen in self._seen if seen.acted_s is not None and seen.acted_s <= entry.time_s]
            last = max(before, key=lambda seen: seen.acted_s or 0.0, default=None)
            cause = "healthy" if last is None else "jump" if last.jet is None else "failure"
            false.append((entry, cause))
        return false

    def _matched(self, found: Sequence[DetectionRecord]) -> dict[int, int]:
        """The declaration that is right for each failure, index by index; each declaration is right for one."""
        right: dict[int, int] = {}
        for number, seen in sorted(enumerate(self._seen), key=lambda item: item[1].start_s):
            if seen.acted_s is None:
                continue
            for index, entry in enumerate(found):
                if index in right.values() or entry.time_s < seen.acted_s - _ACTS:
                    continue
                if self._is(seen, entry):
                    right[number] = index
                    break
        return right

    def _is(self, seen: _Seen, entry: DetectionRecord) -> bool:
        if seen.jet is None or entry.kind == JUMP:
            return seen.jet is None and entry.kind == JUMP
        if entry.jet is not None:
            return entry.jet == self._designations[seen.jet]
        return entry.cluster == self._clusters[seen.jet]

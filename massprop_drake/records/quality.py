"""Data quality of recorded telemetry: gaps, missing cells, stuck sensors, wrong units, unused samples."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.errors import moment
from massprop_drake.inputs import factors, params
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.inputs.vehicle_sensors import Accelerometer, SensorPackage
from massprop_drake.maths.mass_properties import CENTER_OF_MASS, ELEMENT, MASS_RECIPROCAL
from massprop_drake.records.reader import Record, Rows
from massprop_drake.records.unknown_commands import UnknownCommands
from massprop_drake.signals import AXES, SYMBOLS, in_units

Array = NDArray[np.float64]

_STUCK = 10.0  # quanta or 1-sigma that a reading must be predicted to change by before standing still counts
_STUCK_SAMPLES = 5  # for which a reading must not change at all
_JUMP_FACTOR, _JUMP_SIGMAS = 3.0, 10.0  # beyond what all jets together, and the vehicle's rate, cause in a sample
_TURNED = 0.1  # of a predicted increment: what a turn may change a reading by, where that tells a wrong unit
_CLEAR = 5.0  # 1-sigma of an increment that a predicted one must exceed to tell the unit
_FEWEST = 10  # samples that tell the unit
_MOST = 4000  # samples whose slopes are kept, from the beginning: enough for their median
_UNIT_LIMIT = 2.5  # factor between measured and predicted that is called wrong; feet to meters is 3.28
_LISTED, _MOST_STUCK = 5, 100  # in warnings, and at all
_STANDS = 5.0  # of these by what has been learned of the vehicle by the end: a jet may turn out to move it hardly
_TAUGHT_S = 5.0  # a reading that stands still for longer may have taught the filter that nothing moves it
_NET = 0.25  # of the sum of what each jet alone should change it by: less cancels where thrusts are a quarter off
_AGAINST_S = 5.0  # for which jets may fire against one that has failed, and nothing changes
_ANSWERED = 0.5  # share of what is predicted that the other readings must show, or the jets have not fired
_HEARD = 25.0  # sum of squares of what is predicted of them, in 1-sigma of an increment, that says whether they do
_MOST_JETS = 2  # that are blamed for readings that do not follow; more, and the readings are wrong
_PERIOD_DIFFERS = 0.005  # of the sample period
_NOTHING = (-math.inf, math.inf)  # most and least change before the first sample of a stretch

# why a sample was not used, by the filter: the joint one takes what the jets do as it comes
_REASONS = (
    "first_after_start_or_gap",
    "gyro_missing",
    "accelerometer_missing",
    "saturated",
    "command_missing",
    "fractional_command",
    "jets_changed",
    "coasting",
    "rejected_by_detector",
    "other",
)
_POSE_REASONS = ("first_after_start_or_gap", "nothing_read")
_JOINT_REASONS = (
    "first_after_start_or_gap",
    "gyro_missing",
    "accelerometer_missing",
    "saturated",
    "command_missing",
    "within_a_quantum",
)


class _Package(NamedTuple):
    """A sensor package, and the readings expected of it on the nominal vehicle.

    Attributes:
        package: as the vehicle file has it.
        scale: quantum or 1-sigma of a reading, whichever is larger.
        increment_std: 1-sigma of an increment.
        each: size of the increments that each jet could cause in one sample, shape (n_jets, 3).
        by_turning: size of what the vehicle's own rate could change a component by in one sample, over its square, s or
            ft s or m s: dynamic coupling, and what turns the place of an accelerometer about the center of mass.
    """

    package: SensorPackage
    scale: float
    increment_std: float
    each: Array
    by_turning: float


class _Body(NamedTuple):
    """Mass properties by which predicted readings change.

    Attributes:
        inverse: inverse inertia, shape (3, 3).
        center: of mass, shape (3,).
        lightness: mass reciprocal.
    """

    inverse: Array
    center: Array
    lightness: float

    def changed(self, impulses: Array, package: SensorPackage) -> Array:
        """Computes increments of a package's readings, shape (n, 3), by impulses about the origin, shape (n, 6)."""
        turned: Array = (impulses[:, :3] - np.cross(self.center, impulses[:, 3:])) @ self.inverse
        if not isinstance(package, Accelerometer):
            return turned
        return impulses[:, 3:] * self.lightness + np.cross(turned, np.array(package.position) - self.center)


def _body(parameters: Array) -> _Body:
    """Makes a body of the ten parameters, shape (10,)."""
    return _Body(parameters[ELEMENT], parameters[CENTER_OF_MASS], float(parameters[MASS_RECIPROCAL]))


class _Stuck(NamedTuple):
    """Stretch in which a reading stood still.

    Attributes:
        entry: as the summary has it.
        package: it is of.
        axis: of it.
        impulse: between where the predicted change was least and where it was most, torque about the origin first,
            shape (6,).
    """

    entry: dict[str, Any]
    package: _Package
    axis: int
    impulse: Array

    @property
    def lasted_s(self) -> float:
        """Duration of the stretch, s."""
        return float(self.entry["to_s"] - self.entry["from_s"])

    def lasts(self, failed_s: float) -> bool:
        """Tests whether the stretch is real, not one of jets that fire against a failed one."""
        return bool(self.entry["to_s"] <= failed_s or self.lasted_s > _AGAINST_S)


class _Ratio(NamedTuple):
    """Ratio of a reading's change in a sample over the predicted change.

    Attributes:
        ratio: of both.
        time_s: of the sample.
        fired: jets that were told to fire, shape (n_jets,).
        turned: what the vehicle's turn may have changed the reading by, in what was predicted.
    """

    ratio: float
    time_s: float
    fired: Array
    turned: float


class _Standing:
    """Constancy of each component of a package: since when, and the change predicted meanwhile."""

    def __init__(self) -> None:
        self.value = np.full(3, np.nan)
        self.since_s = np.full(3, np.nan)
        self.until_s = np.full(3, np.nan)
        self.sum = np.zeros(3)
        self.least = np.zeros(3)
        self.most = np.zeros(3)
        self.at = np.zeros((3, 2, 6))  # impulses gathered since the beginning where that change was least and most
        self.sure = [False] * 3  # whether that change could not be what jets against each other leave
        self.gross = np.zeros(3)  # of what each jet alone should change it by, gathered since the beginning
        self.gross_since = np.zeros(3)  # at its first sample
        self.answer = np.zeros((3, 2))  # of the other readings, gathered since the beginning, see `_Answer`
        self.answer_since = np.zeros((3, 2))  # at its first sample
        self.fired_since = np.zeros((3, 1))  # samples with each jet told to fire and nothing shown, likewise


class _Repeats:
    """Repeats of a package's reading, all three components, where the jets should have changed it."""

    def __init__(self) -> None:
        self.count = self.of = 0
        self.times = 0  # that it began to
        self.changed = False  # whether the newest reading was another one than that before

    def add(self, increments: Array, meant: NDArray[np.bool_]) -> None:
        """Takes in a block.

        Args:
            increments: of the reading, NaN where one is missing, shape (n, 3).
            meant: whether it should have changed by much, shape (n,).
        """
        same = (increments == 0.0).all(axis=1)
        changed = ~same & ~np.isnan(increments).any(axis=1)
        before = np.concatenate([[self.changed], changed[:-1]])
        self.count += int((meant & same).sum())
        self.of += int((meant & (same | changed)).sum())
        self.times += int((meant & same & before).sum())
        self.changed = bool(changed[-1])


class _Answer(NamedTuple):
    """Answer of all readings to their predictions, sample by sample, in 1-sigma of an increment.

    Attributes:
        own: increment times predicted, and the square of the latter, of each component of each package, by its name,
            shape (n, 3, 2).
        fired: jets told to fire, where they count, shape (n, n_jets).
    """

    own: Mapping[str, Array]
    fired: Array

    @property
    def total(self) -> Array:
        """Sums over all components, shape (n, 2)."""
        nothing = np.zeros((self.fired.shape[0], 2))  # a vehicle may have no package in body axes
        result: Array = sum((part.sum(axis=1) for part in self.own.values()), start=nothing)
        return result

    @property
    def silent(self) -> Array:
        """Commanded jets of which the readings show little, sample by sample, shape (n, n_jets)."""
        shown, meant = self.total.T
        result: Array = self.fired * (shown < _ANSWERED * meant)[:, None]
        return result

    def beside(self, name: str, axis: int) -> Array:
        """Computes sums over all components but one, each sample weighted by its share in that one's prediction."""
        total, own = self.total, self.own[name][:, axis]
        share = np.divide(own[:, 1], total[:, 1], out=np.zeros(len(own)), where=total[:, 1] > 0.0)
        result: Array = share[:, None] * (total - own)
        return result


def _is_sure(total: Array, alone: Array, before: tuple[float, float], entry: _Package) -> bool:
    """Tests whether a predicted change counts, and exceeds at some sample what jets against each other leave.

    Args:
        total: change since the beginning, shape (n,).
        alone: what each jet alone should have changed the reading by, gathered, shape (n,).
        before: most and least change before these samples, see `_NOTHING`.
        entry: whose reading it is.
    """
    highest, lowest = np.maximum.accumulate(total), np.minimum.accumulate(total)
    change = np.maximum(highest, before[0]) - np.minimum(lowest, before[1])
    return bool(((change >= _STUCK * entry.scale) & (change >= _NET * alone)).any())


def _reached(total: Array, gathered: Array, before: tuple[float, float], held: Array) -> Array:
    """Returns impulses where the predicted change of a stretch was least and where it was most, shape (2, 6).

    Args:
        total: change since the beginning, shape (n,).
        gathered: impulses likewise, shape (n, 6).
        before: most and least change before these samples, see `_NOTHING`.
        held: the impulses there, least first, shape (2, 6).
    """
    at: Array = gathered[[int(total.argmin()), int(total.argmax())]]
    most, least = before
    at[0] = held[0] if least < total.min() else at[0]
    at[1] = held[1] if most > total.max() else at[1]
    return at


class QualityReport:
    """Accumulates the summary's `data_quality`, block by block.

    Args:
        scenario: for the vehicle, its nominal mass properties, and the packages in use.
    """

    def __init__(self, scenario: Scenario):
        vehicle = self._vehicle = scenario.vehicle_data
        self._nominal = _body(vehicle.nominal.vector())
        self._gyros = [package.name for package in params.gyros(scenario)]
        self._accelerometers = [package.name for package in params.accelerometers(scenario)]
        wrenches = vehicle.wrenches * vehicle.sample_period_s
        moments = np.linalg.eigvalsh(vehicle.nominal.inertia)
        coupling = vehicle.sample_period_s * float((moments[-1] - moments[0]) / moments[0])
        self._packages = []
        for package in vehicle.sensors:
            each, by_turning = np.abs(self._nominal.changed(wrenches, package)), coupling
            if isinstance(package, Accelerometer):
                arm = np.array(package.position) - self._nominal.center
                by_turning = (vehicle.sample_period_s + coupling) * float(np.linalg.norm(arm))
            std = math.sqrt(package.variance)
            self._packages.append(_Package(package, max(package.quantum, std), math.sqrt(2.0) * std, each, by_turning))
        names = vehicle.sensor_names()
        self._last = {name: np.full((1, 3), np.nan) for name in names}
        self._followed = {name: np.zeros((3, 2)) for name in names}  # sums of `_Answer.own`
        self._gathered = np.zeros(6)  # impulses of all samples that count
        self._last_gap = True  # nothing before the first row
        self._commands = np.zeros((1, len(vehicle.jets)))
        self._rows, self._unknown = 0, UnknownCommands(vehicle)
        self._standing = {name: _Standing() for name in names}
        self._stuck: list[_Stuck] = []
        self._n_stuck = 0
        self._unanswered: list[dict[str, Any]] = []
        self._fired = np.zeros(len(vehicle.jets))  # samples in which each jet was told to fire and nothing showed it
        self._repeats = {name: _Repeats() for name in names}
        self._saturated = dict.fromkeys(names, 0)
        self._jumps: dict[str, dict[str, Any]] = {}
        self._ratios: dict[str, list[_Ratio]] = {name: [] for name in names}
        self._weighs = params.weighs(scenario)
        filters = ["rotation", *(["mass"] if self._weighs else [])]
        self._filter, self._at_stamps = scenario.estimation.filter, scenario.joint.switching == "stamps"
        self._own_times = params.steps_by_readings(scenario)
        reasons = {"joint": _JOINT_REASONS, "pose": _POSE_REASONS}.get(self._filter, _REASONS)
        self._samples = {name: {"used": 0, **dict.fromkeys(reasons, 0)} for name in filters}

        self._limits = params.convergence_limits(scenario)
        self._detects = params.detector(scenario) is not None
        self._tested = 0  # samples that were tested for failed jets
        self._estimate = self._deviation = np.full(10, np.nan)

    def begin(self, command: Array) -> None:
        """Sets the command of the interval before the first row, shape (n_jets,)."""
        self._commands = command[None, :]

    # ------------------------------------------------------------------------------------ adding

    def add(self, rows: Rows, signals: Mapping[str, Array]) -> None:
        """Takes in a block of rows and the estimators' signals for them.

        Args:
            rows: of the record.
            signals: by name, as in a run, shape (n, components).
        """
        commands = np.vstack([self._commands, rows.commands[:-1]])  # of the interval that ended
        gap = ~rows.recorded
        self._rows += int((~gap).sum())
        self._unknown.add(rows.time_s, np.isnan(commands), ~gap)
        fresh = np.concatenate([[self._last_gap], gap[:-1]])  # nothing to take a difference from
        angular, linear = signals["angular_impulse"], signals["linear_impulse"]
        predictable = np.asarray(np.isfinite(np.hstack([angular, linear])).all(axis=1))
        impulses = np.where(predictable[:, None], np.hstack([angular, linear]), 0.0)
        steady = predictable & (signals["usable"][:, 0] != 0.0) & (signals["firing"][:, 0] != 0.0)
        saturated: dict[str, NDArray[np.bool_]] = {}
        missing: dict[str, NDArray[np.bool_]] = {}
        told = np.where(steady[:, None], commands > 0.0, False)
        increments, predicted, own = {}, {}, {}
        speed = np.full(len(rows.time_s) + 1, np.inf)
        for entry in self._packages:
            package, name = entry.package, entry.package.name
            readings = np.vstack([self._last[name], rows.readings[name]])
            increments[name] = np.diff(readings, axis=0)
            predicted[name] = self._nominal.changed(impulses, package)
            if not isinstance(package, Accelerometer):
                speed = np.fmin(speed, np.linalg.norm(readings, axis=1))
            limit = math.inf if package.range is None else package.range * (1.0 - 1e-9)
            at_limit = np.asarray((np.abs(readings) >= limit).any(axis=1))
            self._saturated[name] += int(at_limit[1:].sum())
            saturated[name] = at_limit[1:] | at_limit[:-1]
            missing[name] = np.asarray(np.isnan(increments[name]).any(axis=1))
            good = steady & ~missing[name] & ~saturated[name]
            seen, meant = (
                np.where(good[:, None], part, 0.0) / entry.increment_std for part in (increments[name], predicted[name])
            )
            own[name] = np.stack([seen * meant, meant**2], axis=-1)
            self._last[name] = readings[-1:]
        answer = _Answer(own, told)
        gathered = self._gathered + np.cumsum(np.where(steady[:, None], impulses, 0.0), axis=0)
        slower = np.fmin(speed[:-1], speed[1:])  # at either end of an interval: a spike is at one
        slower[~np.isfinite(slower)] = 0.0
        for entry in self._packages:
            name = entry.package.name
            # where the jets have just changed, how fast thrust builds up decides: not counted
            counted = np.where(steady[:, None], predicted[name], 0.0)
            self._watch_standing(entry, (rows.time_s, gathered), rows.readings[name], counted, answer)
            self._followed[name] = self._followed[name] + own[name].sum(axis=0)
            self._repeats[name].add(increments[name], np.asarray((np.abs(counted) >= _STUCK * entry.scale).any(axis=1)))
            self._watch_jumps(entry, rows.time_s, increments[name], slower)
            good = steady & ~missing[name] & ~saturated[name]
            self._watch_units(entry, (rows.time_s, told, slower), increments[name], predicted[name], good)
        self._gathered = gathered[-1]
        self._fired = self._fired + answer.silent.sum(axis=0)
        self._sort_samples(signals, commands, gap, fresh, missing, saturated)
        if "tested" in signals:
            self._tested += int(signals["tested"].sum())
        self._estimate, self._deviation = signals["estimate"][-1], signals["standard_deviation"][-1]
        self._commands = rows.commands[-1:]
        self._last_gap = bool(gap[-1])

    def _watch_standing(
        self, entry: _Package, when: tuple[Array, Array], readings: Array, predicted: Array, answer: _Answer
    ) -> None:
        standing, (time_s, gathered) = self._standing[entry.package.name], when
        fired = self._fired + np.cumsum(answer.silent, axis=0)
        if standing.fired_since.shape[1] != fired.shape[1]:
            standing.fired_since = np.zeros((3, fired.shape[1]))
        gross = standing.gross + np.cumsum(answer.fired @ entry.each, axis=0)
        for axis in range(3):
            values, total = readings[:, axis], standing.sum[axis] + np.cumsum(predicted[:, axis])
            others = standing.answer[axis] + np.cumsum(answer.beside(entry.package.name, axis), axis=0)
            changed = values != np.concatenate([[standing.value[axis]], values[:-1]])
            starts = np.flatnonzero(changed)
            edges = np.unique(np.concatenate([[0], starts]))
            most, least = np.maximum.reduceat(total, edges), np.minimum.reduceat(total, edges)
            lasts = np.append(edges[1:], values.size) - 1
            since, heard, firing = time_s[edges].copy(), others[edges].copy(), fired[edges].copy()
            weight = gross[edges, axis].copy()
            goes_on = not changed[0]
            if goes_on:  # the stretch that was under way goes on
                most[0] = max(most[0], standing.most[axis])
                least[0] = min(least[0], standing.least[axis])
                since[0] = standing.since_s[axis]
                heard[0], firing[0] = standing.answer_since[axis], standing.fired_since[axis]
                weight[0] = standing.gross_since[axis]
            else:
                self._note_standing(entry, axis, standing, self._fired)
            was_sure, sure = standing.sure[axis] and goes_on, np.zeros(edges.size, dtype=bool)
            before = (standing.most[axis], standing.least[axis]) if goes_on else _NOTHING
            held = standing.at[axis].copy()
            for index in np.flatnonzero(most - least >= _STUCK * entry.scale):
                rows = slice(edges[index], lasts[index] + 1)
                alone, first = gross[rows, axis] - weight[index], index == 0
                sure[index] = _is_sure(total[rows], alone, before if first else _NOTHING, entry) or (first and was_sure)
            for index in np.flatnonzero(sure[:-1]):
                standing.sure[axis] = True
                standing.since_s[axis], standing.until_s[axis] = since[index], time_s[lasts[index]]
                standing.value[axis] = values[edges[index]]
                standing.most[axis], standing.least[axis] = most[index], least[index]
                standing.answer_since[axis], standing.answer[axis] = heard[index], others[lasts[index]]
                standing.fired_since[axis] = firing[index]
                stretch = slice(edges[index], lasts[index] + 1)
                until_now = before if index == 0 else _NOTHING
                standing.at[axis] = _reached(total[stretch], gathered[stretch], until_now, held)
                self._note_standing(entry, axis, standing, fired[lasts[index]])
            standing.value[axis], standing.since_s[axis] = values[-1], since[-1]
            standing.until_s[axis], standing.sum[axis] = time_s[-1], total[-1]
            standing.most[axis], standing.least[axis] = most[-1], least[-1]
            standing.answer_since[axis], standing.answer[axis] = heard[-1], others[-1]
            standing.fired_since[axis] = firing[-1]
            stretch = slice(edges[-1], None)
            until_now = before if edges.size == 1 else _NOTHING
            standing.at[axis] = _reached(total[stretch], gathered[stretch], until_now, held)
            standing.gross_since[axis], standing.sure[axis] = weight[-1], bool(sure[-1])
        standing.gross = gross[-1]

    def _note_standing(self, entry: _Package, axis: int, standing: _Standing, fired: Array) -> None:
        """Notes a reading that stood still though it should have changed: its own fault if the others did change.

        Args:
            entry: its package.
            axis: of it.
            standing: of the stretch at its end.
            fired: samples in which each jet was told to fire and nothing showed it until then, shape (n_jets,).
        """
        change = float(standing.most[axis] - standing.least[axis])
        lasted_s = float(standing.until_s[axis] - standing.since_s[axis])
        brief = lasted_s < (_STUCK_SAMPLES - 0.5) * self._vehicle.sample_period_s  # a jet that does not fire at once
        if brief or not standing.sure[axis] or math.isnan(standing.value[axis]):
            return
        stretch = {"from_s": float(standing.since_s[axis]), "to_s": float(standing.until_s[axis])}
        shown, meant = (standing.answer[axis] - standing.answer_since[axis]).tolist()
        if meant > _HEARD and shown < _ANSWERED * meant:
            told = np.flatnonzero(fired > standing.fired_since[axis])
            jets = [self._vehicle.designations[jet] for jet in told]
            same = [one for one in self._unanswered if one["jets"] == jets and one["to_s"] >= stretch["from_s"]]
            for one in same[:1]:
                one["from_s"], one["to_s"] = min(one["from_s"], stretch["from_s"]), max(one["to_s"], stretch["to_s"])
            if not same and len(self._unanswered) < _MOST_STUCK:
                self._unanswered.append({"jets": jets, **stretch, "share": shown / meant})
            return
        self._n_stuck += 1
        if self._n_stuck > _MOST_STUCK:
            return
        sensor = {"sensor": entry.package.name, "axis": AXES[axis]}
        gathered = standing.at[axis, 1] - standing.at[axis, 0]
        self._stuck.append(_Stuck({**sensor, **stretch, "predicted_change": change}, entry, axis, gathered))

    def _watch_jumps(self, entry: _Package, time_s: Array, increments: Array, speed: Array) -> None:
        caused = entry.each.sum(axis=0) + entry.by_turning * speed[:, None] ** 2
        limit = _JUMP_FACTOR * caused + _JUMP_SIGMAS * entry.increment_std
        beyond = np.abs(increments) > limit  # NaN is not
        rows = np.flatnonzero(beyond.any(axis=1))
        if not rows.size:
            return
        name = entry.package.name
        found = self._jumps.setdefault(name, {"count": 0, "first_s": float(time_s[rows[0]]), "largest": 0.0})
        found["count"] += rows.size
        found["largest"] = max(found["largest"], float(np.abs(increments[beyond]).max()))

    def _watch_units(
        self,
        entry: _Package,
        when: tuple[Array, NDArray[np.bool_], Array],
        increments: Array,
        predicted: Array,
        rows: NDArray[np.bool_],
    ) -> None:
        size = (predicted**2).sum(axis=1)
        clear = rows & (size > (_CLEAR * entry.increment_std) ** 2)
        kept = self._ratios[entry.package.name]
        if clear.any() and len(kept) < _MOST:
            ratios = (increments[clear] * predicted[clear]).sum(axis=1) / size[clear]
            turned = entry.by_turning * when[2][clear] ** 2 / np.sqrt(size[clear])
            found = map(_Ratio, ratios.tolist(), when[0][clear].tolist(), when[1][clear], turned.tolist())
            kept.extend(list(found)[: _MOST - len(kept)])

    def _about_commands(self) -> list[str]:
        """Describes the jets whose commands are unknown, from when to when, and the consequences."""
        stretches = self._unknown.found()
        if not stretches:
            return []
        jets = [name for name in self._vehicle.designations if any(name in one["jets"] for one in stretches)]
        every = len(jets) == len(self._vehicle.jets)
        who = "" if every else f" of jet{'s' * (len(jets) > 1)} {', '.join(jets)}"
        when = ", ".join(map(self._when, stretches[:_LISTED]))
        if self._unknown.count > _LISTED:
            when += f" and {self._unknown.count - _LISTED} more times"
        taught = "nothing is learned there" if every else "what they may have given teaches nothing"
        then = {
            "thesis": "not tested for failures there, and these samples are not used",
            "pose": "what they gave there is guessed from the readings, and a failure of them does not show",
        }.get(self._filter, f"not tested for failures there, and {taught}")
        return [
            f"commands{who} unknown {when} ({self._unknown.samples} of {self._rows} samples): {then}; "
            "write 0 where a jet is off"
        ]

    def _when(self, stretch: Mapping[str, Any]) -> str:
        lasts = stretch["to_s"] >= self._unknown.until_s
        return f"from {moment(stretch['from_s'])} s {'on' if lasts else 'to ' + moment(stretch['to_s']) + ' s'}"

    def _sort_samples(
        self,
        signals: Mapping[str, Array],
        commands: Array,
        gap: NDArray[np.bool_],
        fresh: NDArray[np.bool_],
        missing: Mapping[str, NDArray[np.bool_]],
        saturated: Mapping[str, NDArray[np.bool_]],
    ) -> None:
        unknown: NDArray[np.bool_] = np.asarray(np.isnan(commands).any(axis=1))
        if self._filter == "joint":  # thrust settles in the sample that follows
            unknown[1:] |= unknown[:-1].copy()
        fractional = ((commands > 0.0) & (commands < 1.0)).any(axis=1)
        nothing = np.zeros(gap.size, dtype=bool)

        def none_of(packages: list[str], faults: Mapping[str, NDArray[np.bool_]]) -> NDArray[np.bool_]:
            """Finds samples where a fault leaves no package to use: any other would do."""
            return np.logical_and.reduce([faults[package] for package in packages])

        for name, counts in self._samples.items():
            mass = name == "mass"
            reasons = {
                "used": signals[f"{name}_used"][:, 0] != 0.0,
                "first_after_start_or_gap": fresh,
                "gyro_missing": none_of(self._gyros, missing),
                "accelerometer_missing": none_of(self._accelerometers, missing) if mass else nothing,
                "saturated": none_of(self._gyros, saturated)
                | (none_of(self._accelerometers, saturated) if mass else nothing),
                "command_missing": unknown,
                "fractional_command": fractional,
                "jets_changed": signals["usable"][:, 0] == 0.0,
                "coasting": signals["firing"][:, 0] == 0.0,
                "rejected_by_detector": signals["alarm"][:, 0] != 0.0 if "alarm" in signals else nothing,
                "within_a_quantum": ~nothing,
                "nothing_read": ~nothing,
                "other": ~nothing,
            }
            left = ~gap
            for reason in counts:
                counts[reason] += int((left & reasons[reason]).sum())
                left = left & ~reasons[reason]

    # --------------------------------------------------------------------------------- finishing

    def _telling(self, package: SensorPackage, units: Mapping[str, Mapping[str, Any]]) -> list[_Ratio]:
        """Selects the ratios that tell a package's unit: if it seems wrong, samples where a turn changes little.

        Args:
            package: a gyro, or an accelerometer after those.
            units: of the gyros: how fast it turns is read in the unit that they seem to have.
        """
        kept = self._ratios[package.name]
        if not kept or _plausible(own := float(np.median([each.ratio for each in kept]))):
            return kept
        slopes = (
            [own] if package.name in self._gyros else [units[name]["slope"] for name in self._gyros if name in units]
        )
        larger = max((slope for slope in slopes if slope > _UNIT_LIMIT), default=1.0)  # than it is in its unit
        return [each for each in kept if each.turned <= _TURNED * larger**2]

    def _stands(self, stuck: _Stuck) -> bool:
        """Tests whether a reading should have changed by the mass properties learned by the end, too.

        A jet turns the vehicle about an axis through a product of inertia, or moves the place of an accelerometer one
        way as it turns it another: of that the file may have hardly anything right. What is learned of a component that
        stands still for long, or does not follow the jets at all, says nothing.
        """
        shown, meant = self._followed[stuck.package.package.name][stuck.axis].tolist()
        if stuck.lasted_s > _TAUGHT_S or shown < _ANSWERED * meant or not np.isfinite(self._estimate).all():
            return True
        body = _body(self._estimate)
        change = float(body.changed(stuck.impulse[None], stuck.package.package)[0, stuck.axis])
        return abs(change) >= _STANDS * stuck.package.scale

    def finished(self, record: Record, ragged: tuple[int, int, bool], failed_s: float = math.inf) -> dict[str, Any]:
        """Composes the content of `data_quality`.

        Args:
            record: what the reader found.
            ragged: rows left out for their number of cells, line of the first, whether the last was cut.
            failed_s: since when a jet is known to have failed, s.
        """
        for entry in self._packages:
            standing = self._standing[entry.package.name]
            for axis in range(3):
                self._note_standing(entry, axis, standing, self._fired)
        # from then on others fire against it for a while, and nothing shows
        self._unanswered = [one for one in self._unanswered if one["to_s"] <= failed_s]
        told = [one for one in self._stuck if one.lasts(failed_s) and self._stands(one)]
        self._n_stuck, self._stuck = self._n_stuck - len(self._stuck) + len(told), told
        units: dict[str, dict[str, Any]] = {}
        for entry in self._packages:
            kept = self._telling(entry.package, units)
            if len(kept) < _FEWEST:
                continue
            ratios, times = np.array([each.ratio for each in kept]), np.array([each.time_s for each in kept])
            slope = units[entry.package.name] = {"slope": float(np.median(ratios)), "samples": len(kept)}
            before = ratios[times < failed_s]
            if not _plausible(slope["slope"]) and before.size >= _FEWEST and _plausible(float(np.median(before))):
                slope |= {"slope_before_failure": float(np.median(before))}
            elif not _plausible(slope["slope"]):
                jets = _to_blame(ratios, np.array([each.fired for each in kept]))
                slope |= {"jets": [self._vehicle.designations[jet] for jet in jets]} if jets else {}
        quality: dict[str, Any] = {
            "rows": record.rows,
            "first_s": record.first_s,
            "last_s": record.last_s,
            "sample_period_s": record.period_s,
            "jitter": {"count": record.jitter, "largest_s": record.largest_jitter_s},
            "gaps": {
                "count": record.gaps,
                "total_s": record.gap_sum_s,
                "longest_s": record.longest_gap_s,
                "first": [{"time_s": time, "length_s": length} for time, length in record.first_gaps],
            },
            "duplicates": record.duplicates,
            "backward": record.backward,
            "before_start": record.before_start,
            "without_time": record.without_time,
            "ragged": {"count": ragged[0], "first_line": ragged[1] or None, "last_row_incomplete": ragged[2]},
            "missing": record.missing,
            "absent_sensors": record.absent,
            "unknown_columns": {name: meant or None for name, meant in record.unknown.items()},
            "stuck": [one.entry for one in self._stuck],
            "unanswered": self._unanswered,
            "repeated": {
                name: {"count": found.count, "of": found.of}
                for name, found in self._repeats.items()
                if found.times >= _FEWEST
            },
            "saturated": self._saturated,
            "jumps": self._jumps,
            "units": units,
            "samples": self._samples,
            "unknown_commands": self._unknown.found(),
        }
        return {**quality, "warnings": [*record.notes, *self._warnings(quality)]}

    def _warnings(self, quality: dict[str, Any]) -> list[str]:
        return [
            *self._about_units(quality),
            *self._about_rows(quality),
            *self._about_sensors(quality),
            *self._about_samples(quality),
            *self._about_commands(),
            *self._about_tests(),
        ]

    def _about_tests(self) -> list[str]:
        """Explains why no sample was tested for failed jets, if none was."""
        if self._tested or not self._detects:
            return []
        diagonal, center, reciprocal = self._limits.tolist()
        relative = np.append(np.full(3, diagonal), reciprocal)
        with np.errstate(divide="ignore", invalid="ignore"):
            share = self._deviation / np.abs(self._estimate)
        wide = [
            f"{SYMBOLS[element]} is known to {100.0 * share[element]:.2g} % ({100.0 * limit:.2g} % is asked)"
            for element, limit in zip((0, 1, 2, 9), relative, strict=True)
            if not share[element] < limit
        ]
        length = self._vehicle.unit_names["length"]
        wide += [
            f"{SYMBOLS[element]} to {self._deviation[element]:.2g} {length} ({center:.2g} {length})"
            for element in (6, 7, 8)
            if not self._deviation[element] < center
        ]
        why = f": {'; '.join(wide)}" if wide else ""
        return [
            f"no sample was tested for failed jets, since the estimates did not converge{why}; it takes a "
            "record that excites them, or wider limits in estimation.convergence"
        ]

    def _about_units(self, quality: dict[str, Any]) -> list[str]:
        found = []
        blamed: dict[tuple[str, ...], list[str]] = {}
        for entry in self._packages:
            name = entry.package.name
            if name not in quality["units"]:
                continue
            slope, jets = quality["units"][name]["slope"], quality["units"][name].get("jets")
            if _plausible(slope) or "slope_before_failure" in quality["units"][name]:
                continue
            if jets:
                blamed.setdefault(tuple(jets), []).append(name)
                continue
            unit, known = "rad/s", factors.of_rates(self._vehicle.sample_period_s)
            if isinstance(entry.package, Accelerometer):
                unit = in_units("{length}/s", self._vehicle.unit_names)
                known = factors.of_velocities(self._vehicle.units, self._vehicle.sample_period_s)
            found.append(
                f"{name} changes by {slope:.3g} times what the nominal mass properties predict; it must be in {unit}, "
                f"body axes{_looks_like(slope, known)}"
            )
        found += [
            f"{', '.join(names)} {'follow' if len(names) > 1 else 'follows'} what is predicted but while "
            f"{' or '.join(jets)} {'is' if len(jets) == 1 else 'are'} told to fire: look there for a failure"
            for jets, names in blamed.items()
        ]
        return found

    def _about_rows(self, quality: dict[str, Any]) -> list[str]:
        found = []
        gaps = quality["gaps"]
        if gaps["count"]:
            first = gaps["first"][0]
            found.append(
                f"{_times(gaps['count'], 'gap')} in time, {gaps['longest_s']:.6g} s the longest, the first after "
                f"{moment(first['time_s'])} s; estimates are kept over it"
            )
        period, nominal = quality["sample_period_s"], self._vehicle.sample_period_s
        if self._filter == "joint" and quality["jitter"]["count"] and not self._own_times:
            regular = "at regular ticks, found from the stamps; where they do at these, set joint.switching=stamps"
            taken = f"commands are taken to switch {'at the stamps' if self._at_stamps else regular}"
            found.append(
                f"{_times(quality['jitter']['count'], 'interval')} between rows off the sample period, by "
                f"{quality['jitter']['largest_s']:.2g} s at the most: {taken}"
            )
        if self._filter == "thesis" and period is not None and abs(period - nominal) > _PERIOD_DIFFERS * nominal:
            found.append(f"rows are {period:.6g} s apart on average, not {nominal:g} s: forces seem off by as much")
        late = quality["duplicates"] + quality["backward"]
        if late:
            found.append(f"{_times(late, 'row')} left out whose time does not go on")
        if quality["without_time"]:
            found.append(f"{_times(quality['without_time'], 'row')} left out that have no time")
        for name, meant in quality["unknown_columns"].items():
            if meant is not None:
                found.append(f"column '{name}' is not used; is '{meant}' meant?")
        return found

    def _about_actuators(self, quality: dict[str, Any]) -> list[str]:
        """Warns of engines and wheels that a record does not cover."""
        found, absent = list[str](), quality["absent_sensors"]
        for engine in self._vehicle.engines:
            if engine.name in absent:
                found.append(f"the record has no {engine.columns[0]}: engine {engine.name} counts as shut")
        unread = [column for wheel in self._vehicle.wheels if wheel.name in absent for column in wheel.columns]
        if unread:
            found.append(
                f"the record has no {', '.join(unread)}: what these wheels do turns the vehicle untold, and hides the "
                "rest"
            )
        return found

    def _about_sensors(self, quality: dict[str, Any]) -> list[str]:
        found = []
        for name, count in quality["missing"].items():
            if count:
                found.append(f"{name} is missing in {_times(count, 'row')}")
        if not self._weighs:
            found.append("the vehicle has no accelerometer: its mass is not observable")
        elif self._accelerometers and set(self._accelerometers) <= set(quality["absent_sensors"]):
            found.append("the record has no accelerometer: the mass is not observable in it")
        found += self._about_actuators(quality)
        for entry in quality["unanswered"][:_LISTED]:
            found.append(
                f"{', '.join(entry['jets'])} told to fire {_during(entry)}, but no "
                f"sensor shows it: jets that did not fire, not sensors that stood still"
            )
        for entry in quality["stuck"][:_LISTED]:
            found.append(
                f"{entry['sensor']}_{entry['axis']} stands still {_during(entry)} "
                f"while the jets commanded should change it by {entry['predicted_change']:.3g}"
            )
        if self._n_stuck > _LISTED:
            found.append(f"and {self._n_stuck - _LISTED} more times a sensor stands still")
        for name, repeated in quality["repeated"].items():
            found.append(
                f"{name} repeats its reading in {repeated['count']} of {repeated['of']} samples in which the jets "
                "commanded should have changed it: what has not been read anew tells nothing new, but counts as if it "
                "did; leave such cells empty, or say `every` of it in a map"
            )
        for name, count in quality["saturated"].items():
            if count:
                found.append(f"{name} is at the end of its range in {_times(count, 'row')}")
        for name, jump in quality["jumps"].items():
            found.append(
                f"{name} jumps {_times(jump['count'], 'time')} by more than all jets could cause in a sample, first at "
                f"{moment(jump['first_s'])} s, the most {jump['largest']:.3g}"
            )
        return found

    def _about_samples(self, quality: dict[str, Any]) -> list[str]:
        names = {"rotation": "inverse inertia and center of mass", "mass": "mass"}
        found = []
        for name, counts in quality["samples"].items():
            if counts["used"]:
                continue
            worst = max(list(counts)[1:], key=lambda reason: counts[reason])
            found.append(
                f"no sample could be used for {names[name]}: they are as they were at the start; most often "
                f"({counts[worst]} times) the reason was: {worst.replace('_', ' ')}"
            )
        return found


def _plausible(slope: float) -> bool:
    """Tests whether mass properties may be so far from nominal that readings change by so much more or less."""
    return 1.0 / _UNIT_LIMIT <= slope <= _UNIT_LIMIT


def _to_blame(ratios: Array, fired: NDArray[np.bool_]) -> list[int]:
    """Finds the fewest jets without which readings change as predicted; none: jets are not the cause.

    Wrong units are wrong whichever jets fire; a jet that fails is so only while it is told to.

    Args:
        ratios: of measured and predicted, by sample, shape (n,).
        fired: jets told to fire, shape (n, n_jets).
    """
    left, blamed = np.ones(ratios.size, dtype=bool), []
    for _ in range(_MOST_JETS):
        wrong = ~((ratios >= 1.0 / _UNIT_LIMIT) & (ratios <= _UNIT_LIMIT))
        share = [int((left & wrong & jet).sum()) - int((left & ~wrong & jet).sum()) for jet in fired.T]
        blamed.append(int(np.argmax(share)))
        left &= ~fired[:, blamed[-1]]
        if left.sum() >= _FEWEST and _plausible(float(np.median(ratios[left]))):
            return blamed
    return []


def _looks_like(slope: float, known: Sequence[factors.Factor]) -> str:
    """Names the likely cause of a scale factor."""
    if slope <= 0.0:
        return "; it looks like a wrong sign or wrong axes"
    found = factors.near(slope, known)
    return f"; it looks like {found[0].name}" if found else ""


def _during(entry: dict[str, Any]) -> str:
    return f"from {moment(entry['from_s'])} to {moment(entry['to_s'])} s"


def _times(count: int, noun: str) -> str:
    return f"{count} {noun}{'' if count == 1 else 's'}"

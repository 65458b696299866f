"""Data quality of recorded telemetry: gaps, missing cells, stuck sensors, wrong units, unused samples."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from massprop_drake.errors import moment
from massprop_drake.inputs import params
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.inputs.vehicle_sensors import Accelerometer, SensorPackage
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.signals import AXES
from massprop_drake.records.quality_measures import (
    ANSWERED,
    FEWEST,
    STUCK,
    UNIT_LIMIT,
    Answer,
    Package,
    Ratio,
    Repeats,
    Standing,
    Stuck,
    UnknownCommands,
    could_be_off_nominal,
    impulses_at_extremes,
    is_significant_change,
    jets_to_blame,
    rigid_body,
)
from massprop_drake.records.quality_warnings import LISTED, KnownOfRecord, warnings_of
from massprop_drake.records.rows import Record, Rows

_STUCK_SAMPLES = 5  # for which a reading must not change at all
_JUMP_FACTOR, _JUMP_SIGMAS = 3.0, 10.0  # beyond what all jets together, and the vehicle's rate, cause in a sample
_TURNED = 0.1  # of a predicted increment: what a turn may change a reading by, where that tells a wrong unit
_CLEAR = 5.0  # 1-sigma of an increment that a predicted one must exceed to tell the unit
_MOST = 4000  # samples whose slopes are kept, from the beginning: enough for their median
_MOST_STUCK = 100  # stretches that are kept
_STANDS = 5.0  # of these by what has been learned of the vehicle by the end: a jet may turn out to move it hardly
_TAUGHT_S = 5.0  # a reading that stands still for longer may have taught the filter that nothing moves it
_HEARD = 25.0  # sum of squares of what is predicted of them, in 1-sigma of an increment, that says whether they do
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


class QualityReport:
    """Accumulates the summary's `data_quality`, block by block.

    Args:
        scenario: for the vehicle, its nominal mass properties, and the packages in use.
    """

    def __init__(self, scenario: Scenario):
        vehicle = self._vehicle = scenario.vehicle_data
        self._nominal = rigid_body(vehicle.nominal.vector())
        self._gyros = [package.name for package in params.gyros(scenario)]
        self._accelerometers = [package.name for package in params.accelerometers(scenario)]
        wrenches = vehicle.wrenches * vehicle.sample_period_s
        moments = np.linalg.eigvalsh(vehicle.nominal.inertia)
        coupling = vehicle.sample_period_s * float((moments[-1] - moments[0]) / moments[0])
        self._packages = []
        for package in vehicle.sensors:
            each, by_turning = np.abs(self._nominal.predict_increments(wrenches, package)), coupling
            if isinstance(package, Accelerometer):
                arm = np.array(package.position) - self._nominal.center
                by_turning = (vehicle.sample_period_s + coupling) * float(np.linalg.norm(arm))
            std = math.sqrt(package.variance)
            self._packages.append(Package(package, max(package.quantum, std), math.sqrt(2.0) * std, each, by_turning))
        names = vehicle.sensor_names()
        self._last = {name: np.full((1, 3), np.nan) for name in names}
        self._followed = {name: np.zeros((3, 2)) for name in names}  # sums of `Answer.own`
        self._gathered = np.zeros(6)  # impulses of all samples that count
        self._last_gap = True  # nothing before the first row
        self._commands = np.zeros((1, len(vehicle.jets)))
        self._rows, self._unknown = 0, UnknownCommands(vehicle)
        self._standing = {name: Standing() for name in names}
        self._stuck: list[Stuck] = []
        self._n_stuck = 0
        self._unanswered: list[dict[str, Any]] = []
        self._fired = np.zeros(len(vehicle.jets))  # samples in which each jet was told to fire and nothing showed it
        self._repeats = {name: Repeats() for name in names}
        self._saturated = dict.fromkeys(names, 0)
        self._jumps: dict[str, dict[str, Any]] = {}
        self._ratios: dict[str, list[Ratio]] = {name: [] for name in names}
        self._weighs = params.mass_is_observable(scenario)
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
        """Sets the commands of the interval before the first row, fractions, shape (n_jets,)."""
        self._commands = command[None, :]

    # ------------------------------------------------------------------------------------ adding

    def add(self, rows: Rows, signals: Mapping[str, Array]) -> None:
        """Accumulates the measures of quality over a block of rows, with the filters' signals for them.

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
            predicted[name] = self._nominal.predict_increments(impulses, package)
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
        answer = Answer(own, told)
        gathered = self._gathered + np.cumsum(np.where(steady[:, None], impulses, 0.0), axis=0)
        slower = np.fmin(speed[:-1], speed[1:])  # at either end of an interval: a spike is at one
        slower[~np.isfinite(slower)] = 0.0
        for entry in self._packages:
            name = entry.package.name
            # where the jets have just changed, how fast thrust builds up decides: not counted
            expected = np.where(steady[:, None], predicted[name], 0.0)
            self._watch_standing(entry, (rows.time_s, gathered), rows.readings[name], expected, answer)
            self._followed[name] = self._followed[name] + own[name].sum(axis=0)
            self._repeats[name].add(increments[name], np.asarray((np.abs(expected) >= STUCK * entry.scale).any(axis=1)))
            self._watch_jumps(entry, rows.time_s, increments[name], slower)
            good = steady & ~missing[name] & ~saturated[name]
            self._watch_units(entry, (rows.time_s, told, slower), increments[name], predicted[name], good)
        self._gathered = gathered[-1]
        self._fired = self._fired + answer.silent.sum(axis=0)
        self._count_samples_by_reason(signals, commands, gap, fresh, missing, saturated)
        if "tested" in signals:
            self._tested += int(signals["tested"].sum())
        self._estimate, self._deviation = signals["estimate"][-1], signals["standard_deviation"][-1]
        self._commands = rows.commands[-1:]
        self._last_gap = bool(gap[-1])

    def _watch_standing(
        self, entry: Package, when: tuple[Array, Array], readings: Array, predicted: Array, answer: Answer
    ) -> None:
        """Extends or ends the stretches in which a package's components do not change, and records stuck ones."""
        standing, (time_s, gathered) = self._standing[entry.package.name], when
        fired = self._fired + np.cumsum(answer.silent, axis=0)
        if standing.fired_since.shape[1] != fired.shape[1]:
            standing.fired_since = np.zeros((3, fired.shape[1]))
        gross = standing.gross + np.cumsum(answer.fired @ entry.each, axis=0)
        for axis in range(3):
            values, total = readings[:, axis], standing.sum[axis] + np.cumsum(predicted[:, axis])
            others = standing.answer[axis] + np.cumsum(answer.total_of_others(entry.package.name, axis), axis=0)
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
            for index in np.flatnonzero(most - least >= STUCK * entry.scale):
                rows = slice(edges[index], lasts[index] + 1)
                alone, first = gross[rows, axis] - weight[index], index == 0
                sure[index] = is_significant_change(total[rows], alone, before if first else _NOTHING, entry) or (
                    first and was_sure
                )
            for index in np.flatnonzero(sure[:-1]):
                standing.sure[axis] = True
                standing.since_s[axis], standing.until_s[axis] = since[index], time_s[lasts[index]]
                standing.value[axis] = values[edges[index]]
                standing.most[axis], standing.least[axis] = most[index], least[index]
                standing.answer_since[axis], standing.answer[axis] = heard[index], others[lasts[index]]
                standing.fired_since[axis] = firing[index]
                stretch = slice(edges[index], lasts[index] + 1)
                until_now = before if index == 0 else _NOTHING
                standing.at[axis] = impulses_at_extremes(total[stretch], gathered[stretch], until_now, held)
                self._note_standing(entry, axis, standing, fired[lasts[index]])
            standing.value[axis], standing.since_s[axis] = values[-1], since[-1]
            standing.until_s[axis], standing.sum[axis] = time_s[-1], total[-1]
            standing.most[axis], standing.least[axis] = most[-1], least[-1]
            standing.answer_since[axis], standing.answer[axis] = heard[-1], others[-1]
            standing.fired_since[axis] = firing[-1]
            stretch = slice(edges[-1], None)
            until_now = before if edges.size == 1 else _NOTHING
            standing.at[axis] = impulses_at_extremes(total[stretch], gathered[stretch], until_now, held)
            standing.gross_since[axis], standing.sure[axis] = weight[-1], bool(sure[-1])
        standing.gross = gross[-1]

    def _note_standing(self, entry: Package, axis: int, standing: Standing, fired: Array) -> None:
        """Records a stretch without a predicted change as a stuck sensor, or as jets that did not fire."""
        change = float(standing.most[axis] - standing.least[axis])
        lasted_s = float(standing.until_s[axis] - standing.since_s[axis])
        brief = lasted_s < (_STUCK_SAMPLES - 0.5) * self._vehicle.sample_period_s  # a jet that does not fire at once
        if brief or not standing.sure[axis] or math.isnan(standing.value[axis]):
            return
        stretch = {"from_s": float(standing.since_s[axis]), "to_s": float(standing.until_s[axis])}
        shown, meant = (standing.answer[axis] - standing.answer_since[axis]).tolist()
        if meant > _HEARD and shown < ANSWERED * meant:
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
        self._stuck.append(Stuck({**sensor, **stretch, "predicted_change": change}, entry, axis, gathered))

    def _watch_jumps(self, entry: Package, time_s: Array, increments: Array, speed: Array) -> None:
        """Counts increments of a reading larger than all jets and the vehicle's rotation can cause in a sample."""
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
        entry: Package,
        when: tuple[Array, NDArray[np.bool_], Array],
        increments: Array,
        predicted: Array,
        rows: NDArray[np.bool_],
    ) -> None:
        """Collects ratios of measured to predicted increments of a package, from which a wrong unit shows."""
        size = (predicted**2).sum(axis=1)
        clear = rows & (size > (_CLEAR * entry.increment_std) ** 2)
        kept = self._ratios[entry.package.name]
        if clear.any() and len(kept) < _MOST:
            ratios = (increments[clear] * predicted[clear]).sum(axis=1) / size[clear]
            turned = entry.by_turning * when[2][clear] ** 2 / np.sqrt(size[clear])
            found = map(Ratio, ratios.tolist(), when[0][clear].tolist(), when[1][clear], turned.tolist())
            kept.extend(list(found)[: _MOST - len(kept)])

    def _describe_unknown_commands(self) -> list[str]:
        """Returns a sentence on when which jets' commands are unknown, and its consequences; else empty."""
        stretches = self._unknown.first_stretches()
        if not stretches:
            return []
        jets = [name for name in self._vehicle.designations if any(name in one["jets"] for one in stretches)]
        every = len(jets) == len(self._vehicle.jets)
        who = "" if every else f" of jet{'s' * (len(jets) > 1)} {', '.join(jets)}"
        when = ", ".join(map(self._when, stretches[:LISTED]))
        if self._unknown.count > LISTED:
            when += f" and {self._unknown.count - LISTED} more times"
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
        """Formats a stretch of time as text: "from 1 s to 2 s", or "from 1 s on" at the record's end."""
        lasts = stretch["to_s"] >= self._unknown.until_s
        return f"from {moment(stretch['from_s'])} s {'on' if lasts else 'to ' + moment(stretch['to_s']) + ' s'}"

    def _count_samples_by_reason(
        self,
        signals: Mapping[str, Array],
        commands: Array,
        gap: NDArray[np.bool_],
        fresh: NDArray[np.bool_],
        missing: Mapping[str, NDArray[np.bool_]],
        saturated: Mapping[str, NDArray[np.bool_]],
    ) -> None:
        """Counts the samples that each filter used, and the unused ones by the first reason that holds."""
        unknown: NDArray[np.bool_] = np.asarray(np.isnan(commands).any(axis=1))
        if self._filter == "joint":  # thrust settles in the sample that follows
            unknown[1:] |= unknown[:-1].copy()
        fractional = ((commands > 0.0) & (commands < 1.0)).any(axis=1)
        nothing = np.zeros(gap.size, dtype=bool)

        def none_of(packages: list[str], faults: Mapping[str, NDArray[np.bool_]]) -> NDArray[np.bool_]:
            """Flags samples in which a fault affects every one of some packages, shape (n,)."""
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

    def _select_ratios(self, package: SensorPackage, units: Mapping[str, Mapping[str, Any]]) -> list[Ratio]:
        """Returns the ratios that tell a package's unit; where it seems wrong, those with little rotation alone."""
        kept = self._ratios[package.name]
        if not kept or could_be_off_nominal(own := float(np.median([each.ratio for each in kept]))):
            return kept
        slopes = (
            [own] if package.name in self._gyros else [units[name]["slope"] for name in self._gyros if name in units]
        )
        larger = max((slope for slope in slopes if slope > UNIT_LIMIT), default=1.0)  # than it is in its unit
        return [each for each in kept if each.turned <= _TURNED * larger**2]

    def _is_truly_stuck(self, stuck: Stuck) -> bool:
        """Tests whether a stuck reading should have changed by the estimated mass properties, too.

        A jet turns the vehicle about an axis through a product of inertia, or moves the place of an accelerometer one
        way as it turns it another: of that the file may have hardly anything right. What is learned of a component that
        stands still for long, or does not follow the jets at all, says nothing.
        """
        shown, meant = self._followed[stuck.package.package.name][stuck.axis].tolist()
        if stuck.lasted_s > _TAUGHT_S or shown < ANSWERED * meant or not np.isfinite(self._estimate).all():
            return True
        body = rigid_body(self._estimate)
        change = float(body.predict_increments(stuck.impulse[None], stuck.package.package)[0, stuck.axis])
        return abs(change) >= _STANDS * stuck.package.scale

    def summarize(self, record: Record, ragged: tuple[int, int, bool], failed_s: float = math.inf) -> dict[str, Any]:
        """Returns the summary's `data_quality`: measures by name, information and warnings.

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
        told = [one for one in self._stuck if one.is_real(failed_s) and self._is_truly_stuck(one)]
        self._n_stuck, self._stuck = self._n_stuck - len(self._stuck) + len(told), told
        units: dict[str, dict[str, Any]] = {}
        for entry in self._packages:
            kept = self._select_ratios(entry.package, units)
            if len(kept) < FEWEST:
                continue
            ratios, times = np.array([each.ratio for each in kept]), np.array([each.time_s for each in kept])
            slope = units[entry.package.name] = {"slope": float(np.median(ratios)), "samples": len(kept)}
            before = ratios[times < failed_s]
            if (
                not could_be_off_nominal(slope["slope"])
                and before.size >= FEWEST
                and could_be_off_nominal(float(np.median(before)))
            ):
                slope |= {"slope_before_failure": float(np.median(before))}
            elif not could_be_off_nominal(slope["slope"]):
                jets = jets_to_blame(ratios, np.array([each.fired for each in kept]))
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
                if found.times >= FEWEST
            },
            "saturated": self._saturated,
            "jumps": self._jumps,
            "units": units,
            "samples": self._samples,
            "unknown_commands": self._unknown.first_stretches(),
        }
        return {
            **quality,
            "information": record.information,
            "warnings": [*record.notes, *warnings_of(quality, self._collect_known())],
        }

    def _collect_known(self) -> KnownOfRecord:
        """Collects what the warnings need beside the measures: vehicle, settings and final estimates."""
        return KnownOfRecord(
            vehicle=self._vehicle,
            filter=self._filter,
            packages=self._packages,
            accelerometers=self._accelerometers,
            at_stamps=self._at_stamps,
            own_times=self._own_times,
            weighs=self._weighs,
            detects=self._detects,
            tested=self._tested,
            n_stuck=self._n_stuck,
            limits=self._limits,
            estimate=self._estimate,
            deviation=self._deviation,
            about_commands=self._describe_unknown_commands(),
        )

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
            by_jet, by_turning = np.abs(self._nominal.predict_increments(wrenches, package)), coupling
            if isinstance(package, Accelerometer):
                arm = np.array(package.position) - self._nominal.center
                by_turning = (vehicle.sample_period_s + coupling) * float(np.linalg.norm(arm))
            std = math.sqrt(package.variance)
            self._packages.append(Package(package, max(package.quantum, std), math.sqrt(2.0) * std, by_jet, by_turning))
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
        after_gap = np.concatenate([[self._last_gap], gap[:-1]])  # nothing to take a difference from
        angular, linear = signals["angular_impulse"], signals["linear_impulse"]
        predictable = np.asarray(np.isfinite(np.hstack([angular, linear])).all(axis=1))
        impulses = np.where(predictable[:, None], np.hstack([angular, linear]), 0.0)
        steady = predictable & (signals["usable"][:, 0] != 0.0) & (signals["firing"][:, 0] != 0.0)
        saturated: dict[str, NDArray[np.bool_]] = {}
        missing: dict[str, NDArray[np.bool_]] = {}
        fired = np.where(steady[:, None], commands > 0.0, False)
        increments, predicted, products = {}, {}, {}
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
            usable = steady & ~missing[name] & ~saturated[name]
            value, model = (
                np.where(usable[:, None], part, 0.0) / entry.increment_std
                for part in (increments[name], predicted[name])
            )
            products[name] = np.stack([value * model, model**2], axis=-1)
            self._last[name] = readings[-1:]
        answer = Answer(products, fired)
        totals = self._gathered + np.cumsum(np.where(steady[:, None], impulses, 0.0), axis=0)
        slower = np.fmin(speed[:-1], speed[1:])  # at either end of an interval: a spike is at one
        slower[~np.isfinite(slower)] = 0.0
        for entry in self._packages:
            name = entry.package.name
            # where the jets have just changed, how fast thrust builds up decides: not counted
            expected = np.where(steady[:, None], predicted[name], 0.0)
            self._track_stuck(entry, (rows.time_s, totals), rows.readings[name], expected, answer)
            self._followed[name] = self._followed[name] + products[name].sum(axis=0)
            self._repeats[name].add(increments[name], np.asarray((np.abs(expected) >= STUCK * entry.scale).any(axis=1)))
            self._count_jumps(entry, rows.time_s, increments[name], slower)
            usable = steady & ~missing[name] & ~saturated[name]
            self._collect_ratios(entry, (rows.time_s, fired, slower), increments[name], predicted[name], usable)
        self._gathered = totals[-1]
        self._fired = self._fired + answer.silent.sum(axis=0)
        self._count_samples_by_reason(signals, commands, gap, after_gap, missing, saturated)
        if "tested" in signals:
            self._tested += int(signals["tested"].sum())
        self._estimate, self._deviation = signals["estimate"][-1], signals["standard_deviation"][-1]
        self._commands = rows.commands[-1:]
        self._last_gap = bool(gap[-1])

    def _track_stuck(
        self, entry: Package, times_and_impulses: tuple[Array, Array], readings: Array, predicted: Array, answer: Answer
    ) -> None:
        """Extends or ends the stretches in which readings of a package do not change; records stuck ones."""
        state, (time_s, impulses) = self._standing[entry.package.name], times_and_impulses
        fired = self._fired + np.cumsum(answer.silent, axis=0)
        if state.fired_since.shape[1] != fired.shape[1]:
            state.fired_since = np.zeros((3, fired.shape[1]))
        gross = state.gross + np.cumsum(answer.fired @ entry.each, axis=0)
        for axis in range(3):
            values, total = readings[:, axis], state.sum[axis] + np.cumsum(predicted[:, axis])
            others = state.answer[axis] + np.cumsum(answer.total_of_others(entry.package.name, axis), axis=0)
            changed = values != np.concatenate([[state.value[axis]], values[:-1]])
            starts = np.flatnonzero(changed)
            edges = np.unique(np.concatenate([[0], starts]))
            most, least = np.maximum.reduceat(total, edges), np.minimum.reduceat(total, edges)
            lasts = np.append(edges[1:], values.size) - 1
            since, answers, firing = time_s[edges].copy(), others[edges].copy(), fired[edges].copy()
            weight = gross[edges, axis].copy()
            goes_on = not changed[0]
            if goes_on:  # the stretch that was under way goes on
                most[0] = max(most[0], state.most[axis])
                least[0] = min(least[0], state.least[axis])
                since[0] = state.since_s[axis]
                answers[0], firing[0] = state.answer_since[axis], state.fired_since[axis]
                weight[0] = state.gross_since[axis]
            else:
                self._record_stuck(entry, axis, state, self._fired)
            was_sure, sure = state.sure[axis] and goes_on, np.zeros(edges.size, dtype=bool)
            before = (state.most[axis], state.least[axis]) if goes_on else _NOTHING
            earlier = state.at[axis].copy()
            for index in np.flatnonzero(most - least >= STUCK * entry.scale):
                rows = slice(edges[index], lasts[index] + 1)
                alone, first = gross[rows, axis] - weight[index], index == 0
                sure[index] = is_significant_change(total[rows], alone, before if first else _NOTHING, entry) or (
                    first and was_sure
                )
            for index in np.flatnonzero(sure[:-1]):
                state.sure[axis] = True
                state.since_s[axis], state.until_s[axis] = since[index], time_s[lasts[index]]
                state.value[axis] = values[edges[index]]
                state.most[axis], state.least[axis] = most[index], least[index]
                state.answer_since[axis], state.answer[axis] = answers[index], others[lasts[index]]
                state.fired_since[axis] = firing[index]
                stretch = slice(edges[index], lasts[index] + 1)
                extremes = before if index == 0 else _NOTHING
                state.at[axis] = impulses_at_extremes(total[stretch], impulses[stretch], extremes, earlier)
                self._record_stuck(entry, axis, state, fired[lasts[index]])
            state.value[axis], state.since_s[axis] = values[-1], since[-1]
            state.until_s[axis], state.sum[axis] = time_s[-1], total[-1]
            state.most[axis], state.least[axis] = most[-1], least[-1]
            state.answer_since[axis], state.answer[axis] = answers[-1], others[-1]
            state.fired_since[axis] = firing[-1]
            stretch = slice(edges[-1], None)
            extremes = before if edges.size == 1 else _NOTHING
            state.at[axis] = impulses_at_extremes(total[stretch], impulses[stretch], extremes, earlier)
            state.gross_since[axis], state.sure[axis] = weight[-1], bool(sure[-1])
        state.gross = gross[-1]

    def _record_stuck(self, entry: Package, axis: int, state: Standing, fired: Array) -> None:
        """Records a stretch without the predicted change as a stuck sensor, or as jets that did not fire."""
        change = float(state.most[axis] - state.least[axis])
        lasted_s = float(state.until_s[axis] - state.since_s[axis])
        is_brief = lasted_s < (_STUCK_SAMPLES - 0.5) * self._vehicle.sample_period_s  # a jet that does not fire at once
        if is_brief or not state.sure[axis] or math.isnan(state.value[axis]):
            return
        stretch = {"from_s": float(state.since_s[axis]), "to_s": float(state.until_s[axis])}
        measured, predicted = (state.answer[axis] - state.answer_since[axis]).tolist()
        if predicted > _HEARD and measured < ANSWERED * predicted:
            indices = np.flatnonzero(fired > state.fired_since[axis])
            jets = [self._vehicle.designations[jet] for jet in indices]
            known = [one for one in self._unanswered if one["jets"] == jets and one["to_s"] >= stretch["from_s"]]
            for one in known[:1]:
                one["from_s"], one["to_s"] = min(one["from_s"], stretch["from_s"]), max(one["to_s"], stretch["to_s"])
            if not known and len(self._unanswered) < _MOST_STUCK:
                self._unanswered.append({"jets": jets, **stretch, "share": measured / predicted})
            return
        self._n_stuck += 1
        if self._n_stuck > _MOST_STUCK:
            return
        sensor = {"sensor": entry.package.name, "axis": AXES[axis]}
        impulse = state.at[axis, 1] - state.at[axis, 0]
        self._stuck.append(Stuck({**sensor, **stretch, "predicted_change": change}, entry, axis, impulse))

    def _count_jumps(self, entry: Package, time_s: Array, increments: Array, speed: Array) -> None:
        """Counts increments of a reading larger than all jets and the vehicle's rotation can cause in a sample."""
        caused = entry.each.sum(axis=0) + entry.by_turning * speed[:, None] ** 2
        limit = _JUMP_FACTOR * caused + _JUMP_SIGMAS * entry.increment_std
        too_large = np.abs(increments) > limit  # NaN is not
        rows = np.flatnonzero(too_large.any(axis=1))
        if not rows.size:
            return
        name = entry.package.name
        jumps = self._jumps.setdefault(name, {"count": 0, "first_s": float(time_s[rows[0]]), "largest": 0.0})
        jumps["count"] += rows.size
        jumps["largest"] = max(jumps["largest"], float(np.abs(increments[too_large]).max()))

    def _collect_ratios(
        self,
        entry: Package,
        samples: tuple[Array, NDArray[np.bool_], Array],
        increments: Array,
        predicted: Array,
        rows: NDArray[np.bool_],
    ) -> None:
        """Collects ratios of measured to predicted increments of a package, to detect a wrong unit."""
        size = (predicted**2).sum(axis=1)
        clear = rows & (size > (_CLEAR * entry.increment_std) ** 2)
        kept = self._ratios[entry.package.name]
        if clear.any() and len(kept) < _MOST:
            ratios = (increments[clear] * predicted[clear]).sum(axis=1) / size[clear]
            turned = entry.by_turning * samples[2][clear] ** 2 / np.sqrt(size[clear])
            ratios_ = map(Ratio, ratios.tolist(), samples[0][clear].tolist(), samples[1][clear], turned.tolist())
            kept.extend(list(ratios_)[: _MOST - len(kept)])

    def _describe_unknown_commands(self) -> list[str]:
        """Returns a sentence on jets with unknown commands, times and consequences; empty list: none."""
        stretches = self._unknown.first_stretches()
        if not stretches:
            return []
        jets = [name for name in self._vehicle.designations if any(name in one["jets"] for one in stretches)]
        all_jets = len(jets) == len(self._vehicle.jets)
        subject = "" if all_jets else f" of jet{'s' * (len(jets) > 1)} {', '.join(jets)}"
        times = ", ".join(map(self._format_interval, stretches[:LISTED]))
        if self._unknown.count > LISTED:
            times += f" and {self._unknown.count - LISTED} more times"
        nothing_learned = "nothing is learned there" if all_jets else "what they may have given teaches nothing"
        effect = {
            "thesis": "not tested for failures there, and these samples are not used",
            "pose": "what they gave there is guessed from the readings, and a failure of them does not show",
        }.get(self._filter, f"not tested for failures there, and {nothing_learned}")
        return [
            f"commands{subject} unknown {times} ({self._unknown.samples} of {self._rows} samples): {effect}; "
            "write 0 where a jet is off"
        ]

    def _format_interval(self, stretch: Mapping[str, Any]) -> str:
        """Formats a stretch of time as text: "from 1 s to 2 s", or "from 1 s on" at the record's end."""
        lasts = stretch["to_s"] >= self._unknown.until_s
        return f"from {moment(stretch['from_s'])} s {'on' if lasts else 'to ' + moment(stretch['to_s']) + ' s'}"

    def _count_samples_by_reason(
        self,
        signals: Mapping[str, Array],
        commands: Array,
        gap: NDArray[np.bool_],
        after_gap: NDArray[np.bool_],
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
                "first_after_start_or_gap": after_gap,
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
        if not kept or could_be_off_nominal(slope_ := float(np.median([each.ratio for each in kept]))):
            return kept
        slopes = (
            [slope_] if package.name in self._gyros else [units[name]["slope"] for name in self._gyros if name in units]
        )
        larger = max((slope for slope in slopes if slope > UNIT_LIMIT), default=1.0)  # than it is in its unit
        return [each for each in kept if each.turned <= _TURNED * larger**2]

    def _is_truly_stuck(self, stuck: Stuck) -> bool:
        """Tests whether a stuck reading should have changed by the estimated mass properties, too.

        A jet turns the vehicle about an axis through a product of inertia, or moves the place of an accelerometer one
        way as it turns it another: of that the file may have hardly anything right. What is learned of a component that
        stands still for long, or does not follow the jets at all, says nothing.
        """
        measured, predicted = self._followed[stuck.package.package.name][stuck.axis].tolist()
        if stuck.lasted_s > _TAUGHT_S or measured < ANSWERED * predicted or not np.isfinite(self._estimate).all():
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
            state = self._standing[entry.package.name]
            for axis in range(3):
                self._record_stuck(entry, axis, state, self._fired)
        # from then on others fire against it for a while, and nothing shows
        self._unanswered = [one for one in self._unanswered if one["to_s"] <= failed_s]
        stuck = [one for one in self._stuck if one.is_real(failed_s) and self._is_truly_stuck(one)]
        self._n_stuck, self._stuck = self._n_stuck - len(self._stuck) + len(stuck), stuck
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
            "unknown_columns": {name: similar or None for name, similar in record.unknown.items()},
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

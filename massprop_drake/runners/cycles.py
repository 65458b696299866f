"""Cycles of estimation without a diagram, one by one or for all rows of a record that are read together."""

from __future__ import annotations

import time
from functools import cached_property
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from massprop_drake.inputs.scenario import Scenario
from massprop_drake.maths.estimation import cycle, joint_desk, quiet_cycles, whole
from massprop_drake.maths.estimation.cycle import EstimationParams, EstimationState, EstimationStep, Sample
from massprop_drake.maths.estimation.detector import Verdict
from massprop_drake.maths.estimation.whole import Samples, ThesisAsked, ThesisRows
from massprop_drake.maths.kernels import compile_kernel_if, make_holder, make_shared_holder, read_holder
from massprop_drake.maths.linear_algebra import NotPositiveDefiniteError
from massprop_drake.runners.logs import EstimationLog
from massprop_drake.systems.stopwatch import DETECTOR, ESTIMATORS, Stopwatch, time_call

Array = NDArray[np.float64]

ESTIMATOR = "estimator"  # who has lost definiteness
_NO_ROWS = np.empty((0, 0))


class RecordRows(NamedTuple):
    """Samples of a record in the form that cycles of the estimation take.

    Attributes:
        samples: see `whole.Samples`.
        stamps_s: by the record's clock, s, shape (n,); None: as in `samples`.
        coming: fraction commanded from each row on, NaN where not known, shape (n, n_jets); None: never known.
        tracked: readings in a fixed frame, see `filter.Told`, shape (n, columns); None: the vehicle has none.
        onsets_s: of the commands of `samples`, and after the last row of those of `coming`, see
            `maths.vehicle.on_times`, shape (n + 1, n_jets); None: not told.
    """

    samples: Samples
    stamps_s: Array | None = None
    coming: Array | None = None
    tracked: Array | None = None
    onsets_s: Array | None = None


class Cycles(Protocol):
    """Interface of an estimation that advances cycle by cycle, one row of the record each.

    Attributes:
        spent_s: time spent in "estimators" and "detector"; in the former alone where they are not apart.
        asked: requests of the detector after the last cycle, written in place.
    """

    spent_s: dict[str, float]
    asked: ThesisAsked

    def state(self) -> EstimationState:
        """Returns the state of filter and detector with which the next cycle begins."""

    def begin(self, record: RecordRows, log: EstimationLog) -> None:
        """Sets the rows of a record to estimate from, and the log that the cycles write into."""

    def advance(self, end_row: int) -> None:
        """Runs and logs the cycles of all rows that are not done yet and come before a row."""

    @property
    def done(self) -> int:
        """Number of rows whose cycles are complete, also after an error."""

    def estimate_and_covariance(self) -> tuple[Array, Array]:
        """Returns estimate and covariance of the ten parameters after the last cycle, shapes (10,) and (10, 10)."""


class SteppedCycles:
    """Cycles by `cycle.step`, with any filter and detector, see `Cycles`.

    Args:
        params: parameters of the cycle.
        state: to begin with.
    """

    def __init__(self, params: EstimationParams, state: EstimationState):
        self._stopwatch = Stopwatch()
        self.spent_s = self._stopwatch.spent_s
        self.spent_s.update(dict.fromkeys((ESTIMATORS, DETECTOR), 0.0))
        self.asked = whole.empty_requests(state.level.size)
        self._params, self._state = params, state
        self._last_step: EstimationStep | None = None
        self._next = 0

    def state(self) -> EstimationState:
        """Returns the state of filter and detector with which the next cycle begins."""
        return self._state

    def begin(self, record: RecordRows, log: EstimationLog) -> None:
        """Sets the rows of a record to estimate from, and the log that the cycles write into."""
        self._record, self._log, self._next = record, log, 0

    def advance(self, end_row: int) -> None:
        """Runs and logs the cycles of all rows that are not done yet and come before a row."""
        for row in range(self._next, end_row):
            self._run_cycle(row_sample(self._record, row), row)
            self._next = row + 1

    @property
    def done(self) -> int:
        """Number of rows whose cycles are complete, also after an error."""
        return self._next

    def _run_cycle(self, sample: Sample, row: int) -> None:
        """Runs the estimation cycle of a row by `cycle.step`, logs it, and stores the detector's requests."""
        detector_before = self._state.detector
        try:
            with self._stopwatch:
                step = cycle.step(self._state, sample, self._params, time_call)
        except NotPositiveDefiniteError as error:
            raise error.at(sample.time_s, ESTIMATOR) from None
        self._log.put(row, step, detector_before)
        self._state, self._last_step = step.state, step
        if step.judgment is not None:
            after = step.judgment.state
            declared = step.judgment.status.detector_event == Verdict.DECLARED
            for part, value in zip(self.asked, (declared, after.force, after.removed, after.closed), strict=True):
                part[:] = value

    def estimate_and_covariance(self) -> tuple[Array, Array]:
        """Returns estimate and covariance of the ten parameters after the last cycle, shapes (10,) and (10, 10)."""
        published = None if self._last_step is None else self._last_step.filtered.known
        return published or cycle.estimate_and_covariance(self._state, self._params)


def row_sample(record: RecordRows, row: int) -> Sample:
    """Returns the sample in a row of a record: time, readings, commands and outside wrench."""
    time_s, rates, velocities, command, outside_wrench = (part[row] for part in record.samples)
    stamp_s, next_command, tracked = (
        None if part is None else part[row] for part in (record.stamps_s, record.coming, record.tracked)
    )
    stamp = None if stamp_s is None else float(stamp_s)
    onsets_s = (None, None) if record.onsets_s is None else record.onsets_s[row : row + 2]
    return Sample(float(time_s), rates, velocities, command, outside_wrench, stamp, next_command, tracked, *onsets_s)


class JointKernelCycles(SteppedCycles):
    """Cycles by the kernel of `maths.estimation.whole_joint`, and by `cycle.step` where something happens.

    Args:
        params: parameters of the cycle.
        state: to begin with.
        compiled: whether the kernel is.
    """

    def __init__(self, params: EstimationParams, state: EstimationState, *, compiled: bool):
        super().__init__(params, state)
        self._kernel, self._opens_within = quiet_cycles.Quiet(params, compiled=compiled), False
        self._own_times = params.filter_params.joint.rates.period_s > 0.0
        self._kernel.take_up(state)

    def state(self) -> EstimationState:
        """Returns the state of filter and detector with which the next cycle begins."""
        return self._kernel.state() if self._kernel.on else super().state()

    def begin(self, record: RecordRows, log: EstimationLog) -> None:
        """Sets the rows of a record to estimate from, and the log that the cycles write into."""
        super().begin(record, log)
        # within samples, whereas the kernel's jets switch with them
        self._opens_within = record.onsets_s is not None and not self._own_times
        if self._opens_within and self._kernel.on:
            self._state = self._kernel.state()
            self._kernel.on = False
        samples = _require_writable(record.samples)
        stamps_s = samples.time_s if record.stamps_s is None else np.require(record.stamps_s, requirements=["C", "W"])
        rows = joint_desk.JointRows(*(log.rows[name] for name in joint_desk.JointRows._fields))
        onsets_s = None if record.onsets_s is None else record.onsets_s[:-1]
        self._kernel.begin(samples, stamps_s, (record.tracked, onsets_s), rows)

    def advance(self, end_row: int) -> None:
        """Runs and logs the cycles of all rows that are not done yet and come before a row."""
        while self._next < end_row:
            if self._kernel.on:
                self._advance_by_kernel(end_row)
                continue
            self._run_cycle(row_sample(self._record, self._next), self._next)
            self._next += 1
            if not self._opens_within:
                self._kernel.take_up(self._state)

    def _advance_by_kernel(self, end_row: int) -> None:
        """Runs cycles by the kernel up to a row, or to the first row that needs `cycle.step`."""
        began = time.perf_counter()
        reached = self._kernel.advance(self._next, end_row)
        if reached > self._next:
            self._last_step, self.asked.declared[:] = None, 0.0
        if not self._kernel.on:
            self._state = self._kernel.state()
        self._next = reached
        self.spent_s[ESTIMATORS] += time.perf_counter() - began

    def estimate_and_covariance(self) -> tuple[Array, Array]:
        """Returns estimate and covariance of the ten parameters after the last cycle, shapes (10,) and (10, 10)."""
        return (
            super().estimate_and_covariance()
            if self._last_step is not None
            else cycle.estimate_and_covariance(self.state(), self._params)
        )


def _require_writable(samples: Samples) -> Samples:
    """Converts samples to contiguous, writable arrays, as compiled kernels need them."""
    return Samples(*(np.require(part, requirements=["C", "W"]) for part in samples))


class ThesisKernelCycles:
    """Cycles by the kernel of `maths.estimation.whole`, where it covers them, see `Cycles`.

    Args:
        params: parameters of the cycle.
        state: to begin with.
        compiled: whether the kernel is.

    Attributes:
        holder, given, block: of the state; the kernel's parameters and its rows: for a kernel that goes through the
            cycles itself, see `mark_done`.
    """

    def __init__(self, params: EstimationParams, state: EstimationState, *, compiled: bool):
        self.spent_s = {ESTIMATORS: 0.0}
        self.asked = whole.empty_requests(state.level.size)
        self._params, self._compiled = params, compiled
        self._advance = compile_kernel_if(whole.advance, compiled)
        self.given, self.holder = whole.kernel_params(params), make_holder(state, compiled)
        self._next, self._reached = 0, np.zeros(2, dtype=np.int_)  # rows
        self._shared: Any = None  # the rows

    @cached_property
    def _params_holder(self) -> Any:
        """Holder of the kernel's parameters, made at the first cycle."""
        return make_holder(self.given, self._compiled)

    def state(self) -> EstimationState:
        """Returns the state of filter and detector with which the next cycle begins."""
        state: EstimationState = read_holder(self.holder)
        return state

    def begin(self, record: RecordRows, log: EstimationLog) -> None:
        """Sets the rows of a record to estimate from, and the log that the cycles write into."""
        samples, rows = _require_writable(record.samples), log.rows
        filled = ThesisRows(
            rows["impulses"], rows["rotation_report"], rows["mass_report"], rows.get("detector_report", _NO_ROWS)
        )
        self.block = whole.ThesisBlock(samples, filled, self.asked)
        self._shared = None
        self._times_s, self._next = samples.time_s, 0

    def advance(self, end_row: int) -> None:
        """Runs and logs the cycles of all rows that are not done yet and come before a row."""
        reached = self._reached
        reached[:] = self._next, end_row
        began = time.perf_counter()
        if self._shared is None:
            self._shared = make_shared_holder(self.block, self._compiled)
        try:
            self._advance(self.holder, self._shared, reached, self._params_holder)
        except NotPositiveDefiniteError as error:
            raise error.at(float(self._times_s[reached[0]]), ESTIMATOR) from None
        finally:
            self._next = int(reached[0])
        self.spent_s[ESTIMATORS] += time.perf_counter() - began

    @property
    def done(self) -> int:
        """Number of rows whose cycles are complete, also after an error."""
        return self._next

    def mark_done(self, end_row: int) -> None:
        """Sets the number of rows whose cycles are complete, where another kernel has run them."""
        self._next = end_row

    def restart(self) -> None:
        """Resets to the first row, so that its cycle runs again on a replaced sample."""
        self._next = 0

    def estimate_and_covariance(self) -> tuple[Array, Array]:
        """Returns estimate and covariance of the ten parameters after the last cycle, shapes (10,) and (10, 10)."""
        return cycle.estimate_and_covariance(self.state(), self._params)


class IdleCycles(SteppedCycles):
    """Cycles without estimation, for a flight of which only states, commands and readings are wanted, see `Cycles`."""

    def _run_cycle(self, _: Sample, row: int) -> None:
        """Fills a row of the log with NaN, without estimation."""
        for rows in self._log.rows.values():  # nothing is known
            rows[row] = np.nan


def make_cycles(scenario: Scenario, params: EstimationParams, state: EstimationState | None = None) -> Cycles:
    """Returns the estimation for a scenario's filter and detector: in one kernel if it covers them, or stepwise.

    Args:
        scenario: for its `execution`.
        params: parameters of the cycle.
        state: to begin with; None: from the start.
    """
    start = cycle.initial_state(params) if state is None else state
    if whole.covers(params):
        return ThesisKernelCycles(params, start, compiled=scenario.execution.compiled)
    if quiet_cycles.covers(params):
        return JointKernelCycles(params, start, compiled=scenario.execution.compiled)
    return SteppedCycles(params, start)

"""Cycles of estimation without a diagram, one by one or for all rows of a record that are read together."""

from __future__ import annotations

import math
import time
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from massprop_drake.inputs.scenario import Scenario
from massprop_drake.maths.estimation import cycle, whole
from massprop_drake.maths.estimation.cycle import EstimationParams, EstimationState, EstimationStep, Sample
from massprop_drake.maths.estimation.detector import Event
from massprop_drake.maths.estimation.whole import Asked, Rows, Samples
from massprop_drake.maths.kernels import chosen, held, released
from massprop_drake.maths.linear_algebra import NotPositiveDefiniteError
from massprop_drake.runners.logs import EstimationLog, timed_cycle
from massprop_drake.systems.layouts import DETECTOR_REPORT, MASS_REPORT, ROTATION_REPORT

Array = NDArray[np.float64]

_ESTIMATOR = "estimator"  # who has lost definiteness
_NO_ROWS = np.empty((0, 0))


class RecordRows(NamedTuple):
    """Rows of a record as a cycle takes them.

    Attributes:
        samples: see `whole.Samples`.
        stamps_s: by the record's clock, s, shape (n,).
        coming: fraction commanded from each row on, NaN where not known, shape (n, n_jets).
        tracked: readings in a fixed frame, see `filter.Told`, shape (n, columns); None: the vehicle has none.
    """

    samples: Samples
    stamps_s: Array
    coming: Array
    tracked: Array | None = None


class Cycles(Protocol):
    """Estimation that goes on from cycle to cycle.

    Attributes:
        spent_s: time spent in "estimators" and "detector"; in the former alone where they are not apart.
    """

    spent_s: dict[str, float]

    def state(self) -> EstimationState:
        """What the next cycle begins with."""

    def one(self, sample: Sample, log: EstimationLog, index: int) -> Asked | None:
        """A cycle, which fills in a row of the log; what the detector has others do, None without one."""

    def many(self, record: RecordRows, log: EstimationLog) -> None:
        """A cycle for every row."""

    def reported(self) -> tuple[Array, Array]:
        """Estimate and 1-sigma of the ten parameters that the last cycle published, shape (10,) each."""

    def rotation_nis(self) -> float:
        """NIS of the rotation filter's innovation in the last cycle; NaN where the sample was not used."""

    def known(self) -> tuple[Array, Array]:
        """Estimate and covariance of the ten parameters that the last cycle published, shapes (10,) and (10, 10)."""


class Stepped:
    """Cycles by `cycle.step`, whatever filter and detector, see `Cycles`.

    Args:
        made: parameters of the cycle.
        state: to begin with.
    """

    def __init__(self, made: EstimationParams, state: EstimationState):
        self.spent_s = {"estimators": 0.0, "detector": 0.0}
        self._params, self._state = made, state
        self._done: EstimationStep | None = None

    def state(self) -> EstimationState:
        """What the next cycle begins with."""
        return self._state

    def one(self, sample: Sample, log: EstimationLog, index: int) -> Asked | None:
        """A cycle, which fills in a row of the log; what the detector has others do, None without one."""
        before = self._state.detector
        try:
            done = timed_cycle(self._state, sample, self._params, self.spent_s)
        except NotPositiveDefiniteError as error:
            raise error.at(sample.time_s, _ESTIMATOR) from None
        log.put(index, done, before)
        self._state, self._done = done.state, done
        if done.judgment is None:
            return None
        after = done.judgment.state
        declared = done.judgment.status.detector_event == Event.DECLARED
        return Asked(bool(declared), after.force, after.removed, after.closed)

    def many(self, record: RecordRows, log: EstimationLog) -> None:
        """A cycle for every row."""
        samples = record.samples
        for index, (coming, stamp_s) in enumerate(zip(record.coming, record.stamps_s.tolist(), strict=True)):
            time_s, rates, velocities, command, outside = (part[index] for part in samples)
            tracked = None if record.tracked is None else record.tracked[index]
            read = Sample(float(time_s), rates, velocities, command, outside, stamp_s, coming, tracked)
            self.one(read, log, index)

    def reported(self) -> tuple[Array, Array]:
        """Estimate and 1-sigma of the ten parameters that the last cycle published, shape (10,) each."""
        assert self._done is not None
        return cycle.reported(self._done)

    def rotation_nis(self) -> float:
        """NIS of the rotation filter's innovation in the last cycle; NaN where the sample was not used."""
        assert self._done is not None
        rotation = self._done.filtered.rotation
        return float(rotation.rotation_nis) if rotation.rotation_used else math.nan

    def known(self) -> tuple[Array, Array]:
        """Estimate and covariance of the ten parameters that the last cycle published, shapes (10,) and (10, 10)."""
        published = None if self._done is None else self._done.filtered.known
        return published or cycle.known(self._state, self._params)


class Whole:
    """Cycles by the kernel of `maths.estimation.whole`, where it covers them, see `Cycles`.

    Args:
        made: parameters of the cycle.
        state: to begin with.
        compiled: whether the kernel is.
    """

    def __init__(self, made: EstimationParams, state: EstimationState, *, compiled: bool):
        self.spent_s = {"estimators": 0.0}
        self._params = made
        self._advance = chosen(whole.advance, compiled)
        self._holder, self._held = held(state, compiled), held(whole.params_of(made), compiled)
        self._no_outside = np.zeros((1, 6))
        self._reached = np.zeros(1, dtype=np.int64)
        self._has_detector = made.detector is not None
        self._rows: Rows | None = None

    def state(self) -> EstimationState:
        """What the next cycle begins with."""
        state: EstimationState = released(self._holder)
        return state

    def one(self, sample: Sample, log: EstimationLog, index: int) -> Asked | None:
        """A cycle, which fills in a row of the log; what the detector has others do, None without one."""
        outside = self._no_outside if sample.outside_wrench is None else sample.outside_wrench[None]
        samples = Samples(
            np.array([sample.time_s]), sample.rates[None], sample.velocities[None], sample.command[None], outside
        )
        asked = self._made(samples, log, index)
        return asked if self._has_detector else None

    def many(self, record: RecordRows, log: EstimationLog) -> None:
        """A cycle for every row."""
        self._made(Samples(*map(np.ascontiguousarray, record.samples)), log, 0)

    def _made(self, samples: Samples, log: EstimationLog, first: int) -> Asked:
        rows = log.rows
        self._rows = Rows(
            rows["impulses"], rows["rotation_report"], rows["mass_report"], rows.get("detector_report", _NO_ROWS)
        )
        self._reached[0] = first
        began = time.perf_counter()
        try:
            asked: Asked = self._advance(self._holder, samples, self._rows, self._reached, self._held)
        except NotPositiveDefiniteError as error:
            raise error.at(float(samples.time_s[self._reached[0] - first]), _ESTIMATOR) from None
        self.spent_s["estimators"] += time.perf_counter() - began
        return asked

    def reports(self) -> tuple[Any, Any, Any]:
        """What both filters and the detector said in the last cycle, as logged; None without a detector."""
        assert self._rows is not None
        rows, last = self._rows, int(self._reached[0]) - 1
        status = None
        if self._has_detector:
            jets = self._params.impulse_per_level.shape[0]
            status = DETECTOR_REPORT.sized(jets=jets).read(rows.detector_report[last])
        return ROTATION_REPORT.read(rows.rotation_report[last]), MASS_REPORT.read(rows.mass_report[last]), status

    def reported(self) -> tuple[Array, Array]:
        """Estimate and 1-sigma of the ten parameters that the last cycle published, shape (10,) each."""
        rotation, mass, _ = self.reports()
        return (
            np.append(rotation.estimate, mass.mass_reciprocal),
            np.append(rotation.standard_deviation, np.sqrt(mass.variance)),
        )

    def rotation_nis(self) -> float:
        """NIS of the rotation filter's innovation in the last cycle; NaN where the sample was not used."""
        report, _, _ = self.reports()
        return float(report.rotation_nis) if report.rotation_used else math.nan

    def known(self) -> tuple[Array, Array]:
        """Estimate and covariance of the ten parameters that the last cycle published, shapes (10,) and (10, 10)."""
        return cycle.known(self.state(), self._params)


def cycles(scenario: Scenario, made: EstimationParams, state: EstimationState | None = None) -> Cycles:
    """Cycles as a scenario wants them.

    Args:
        scenario: for its `execution`.
        made: parameters of the cycle.
        state: to begin with; None: from the start.
    """
    begin = cycle.initial_state(made) if state is None else state
    if whole.covers(made):
        return Whole(made, begin, compiled=scenario.execution.compiled)
    return Stepped(made, begin)

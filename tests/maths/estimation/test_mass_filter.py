"""The mass filter: compensation of rotation, and the scalar update in information form."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.testing import assert_allclose
from params_probe import mass_params

from massprop_drake.maths.estimation.adaptation import NO_ADAPTATION
from massprop_drake.maths.estimation.filters.mass_filter import (
    Compensation,
    MassCycle,
    MassInnovation,
    MassInterval,
    MassParams,
    MassState,
    Rotation,
    finish,
    measure,
)
from massprop_drake.maths.estimation.filters.mass_jump import empty_window
from massprop_drake.maths.linear_algebra import Array, NotPositiveDefiniteError, skew

PERIOD = 0.08  # s
NONE, TRANSVERSE, CENTRIPETAL = Compensation
ARM = np.array([2.0, -1.0, 0.5])
CENTER = np.array([1.0, 0.5, -2.0])  # exact in binary, as ARM is: so is their sum
CENTER_COVARIANCE = np.array([[0.30, 0.05, -0.02], [0.05, 0.20, 0.04], [-0.02, 0.04, 0.10]])
NOISE = np.array([[4e-3, 1e-3, 0.0], [1e-3, 3e-3, 5e-4], [0.0, 5e-4, 2e-3]])
TURN, IMPULSE = np.array([0.2, -0.3, 0.1]), np.array([3.0, -1.0, 2.0])


class Given(NamedTuple):
    """A sample of one accelerometer, its noise given in full, and what is known before it."""

    params: MassParams = mass_params(period_s=PERIOD, compensation=CENTRIPETAL, compensation_covariance=True)
    mass_reciprocal: float = 0.3
    variance: float = 0.02
    before: Array = np.array([5.0, -3.0, 1.0])
    velocity: Array = np.array([6.2, -3.4, 1.9])
    noise: Array = NOISE
    arm: Array = ARM
    turn: Array = TURN
    rate: Array = np.array([0.5, 0.4, -0.8])
    rate_variance: float = 0.04
    center_covariance: Array = CENTER_COVARIANCE
    impulse: Array = IMPULSE

    def having(self, **params: Any) -> Given:
        return self._replace(params=self.params._replace(**params))

    @property
    def rotation(self) -> Rotation:
        return Rotation(self.turn, self.rate, self.rate_variance, CENTER, self.center_covariance)

    def cycled(self, usable: bool = True, firing: bool = True) -> tuple[MassCycle, MassInnovation]:
        state = MassState(self.mass_reciprocal, self.variance, empty_window(1))
        params = self.params._replace(positions=(CENTER + self.arm)[None])
        interval = MassInterval(self.impulse, self.noise)
        measured = measure(state, self.before[None], self.velocity[None], interval, self.rotation, params)
        return finish(state, measured, usable, firing, NO_ADAPTATION, params), measured.innovation


GIVEN = Given()


def moments(given: Given) -> tuple[Array, Array]:
    """What is taken out of an increment, and how much its covariance grows: (3-50), (3-55), (3-61b), (3-80b)."""
    if given.params.compensation == NONE:
        return np.zeros(3), np.zeros((3, 3))
    mixing, rotation = skew(given.turn), np.cross(given.turn, given.arm)
    if given.params.compensation == CENTRIPETAL:
        period = given.params.period_s
        mixing = mixing + period * skew(given.rate) @ skew(given.rate)
        # of the variance of an increment, a reading has half, and the mean of two a quarter
        rotation += period * np.cross(given.rate, np.cross(given.rate, given.arm))
        rotation -= period * 2.0 * given.rate_variance / 4.0 * given.arm
    moment = np.outer(given.arm, given.arm) + given.center_covariance
    grown = mixing @ given.center_covariance @ mixing.T  # one error of the center drives both compensations
    return rotation, grown + given.rate_variance * (np.trace(moment) * np.eye(3) - moment)


@pytest.mark.parametrize(
    ("compensation", "grow"), [(NONE, False), (TRANSVERSE, False), (TRANSVERSE, True), (CENTRIPETAL, True)]
)
def test_variants_differ_in_what_they_subtract_and_in_their_covariance(compensation: int, grow: bool) -> None:
    disturbance = np.diag([1e-3, 2e-3, 3e-3])
    given = GIVEN.having(compensation=compensation, compensation_covariance=grow, disturbance_covariance=disturbance)
    done, dut = given.cycled()
    rotation, growth = moments(given)
    noise = NOISE + disturbance + growth * grow
    expected = given.velocity - given.before - rotation - 0.3 * IMPULSE
    total = 0.02 * np.outer(IMPULSE, IMPULSE) + noise
    assert_allclose(dut.innovation, expected, rtol=1e-12)
    assert_allclose(dut.noise, noise, rtol=1e-13, atol=1e-16)
    assert_allclose(dut.covariance, total, rtol=1e-13)
    assert_allclose(dut.information @ total, np.eye(3), rtol=0.0, atol=1e-12)
    assert dut.nis == pytest.approx(expected @ np.linalg.solve(total, expected), rel=1e-11)
    weighted = np.linalg.solve(noise, IMPULSE)  # the update in information form
    variance = 1.0 / (1.0 / 0.02 + weighted @ IMPULSE)
    assert done.state[:2] == pytest.approx((0.3 + variance * (weighted @ expected), variance), rel=1e-11)


def test_innovation_covariance_that_is_not_positive_definite_is_an_error() -> None:
    with pytest.raises(NotPositiveDefiniteError, match="innovation covariance is not positive definite"):
        GIVEN._replace(noise=np.diag([1.0, -1.0, 1.0])).having(compensation=NONE).cycled()


@pytest.mark.parametrize("missing", ["velocity", "before", "turn", "steadiness", "firing"])
def test_a_sample_that_is_missing_or_cannot_be_used_keeps_the_state(missing: str) -> None:
    for axis in range(3):
        reading = {missing: np.where(np.arange(3) == axis, np.nan, 0.1)} if missing in Given._fields else {}
        given = GIVEN._replace(**reading).having(process_noise=1e-3, jump_threshold=0.0)
        dut, innovation = given.cycled(missing != "steadiness", missing != "firing")
        assert (dut.used, dut.jumped) == (False, False)
        assert np.isnan([innovation.nis, *innovation.innovation]).all() == bool(reading)
        assert dut.state[:2] == (0.3, 0.02 + 1e-3)


def test_a_couple_of_jets_shows_no_jump() -> None:
    # opposed thrusts leave an impulse of rounding errors; whatever the innovation, it says nothing of 1/m
    given = GIVEN._replace(variance=0.01, before=np.zeros(3), velocity=np.array([5.0, 0.0, 0.0]))
    given = given.having(compensation=NONE, jump_threshold=6.63, jump_variance=0.09)
    for push, jumps in ((1e-17, False), (1.0, True)):
        dut, _ = given._replace(noise=1e-3 * np.eye(3), impulse=np.array([push, 0.0, 0.0])).cycled()
        assert dut.jumped == jumps
        assert abs(dut.state.mass_reciprocal) < 10.0

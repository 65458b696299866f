"""The start of the joint filter, gone over again."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from joint_probe import unrounded

from massprop_drake import Run, load_scenario, simulate
from massprop_drake.inputs import params as inputs
from massprop_drake.maths.estimation.filter import Told
from massprop_drake.maths.estimation.filters import joint
from massprop_drake.maths.estimation.filters.joint import JointFilterState
from massprop_drake.maths.estimation.joint.joint_cycle import OWN_CHOICE, run_cycle
from massprop_drake.maths.estimation.joint.joint_sample import JointSample
from massprop_drake.maths.estimation.joint.layout import N_PROPERTIES, JointParams, JointState
from massprop_drake.maths.estimation.joint.relinearization import repeat_start_cycle
from massprop_drake.maths.estimation.joint.start import BEGUN, OVER
from massprop_drake.maths.estimation.joint.thrust_scale import parameters_with_scale
from massprop_drake.maths.estimation.joint.ticks import timing_on_ticks

ACCELEROMETERS = ("acc2", "acc1", "acc3")  # the preferred one first, as the filter has them


class Flown(NamedTuple):
    """A flight, and the filter's states with its start gone over again, and without."""

    run: Run
    params: JointParams
    again: list[JointFilterState]
    once: list[JointFilterState]

    def sample(self, row: int, command: int) -> JointSample:
        """Readings of a row and commands of another."""
        velocities = np.stack([self.run[name][row] for name in ACCELEROMETERS])
        fired, rates = self.run["command"][command].reshape(1, -1), self.run["gyro"][row].reshape(1, 3)
        return JointSample(
            float(self.run.time_s[row]), np.array([0.08]), fired, np.zeros(6), rates, velocities, timing_on_ticks()
        )

    def error(self, state: JointState) -> float:
        """Square of the errors of the ten parameters over their covariance: ten if it is honest."""
        estimate, rows = parameters_with_scale(state, self.params)
        deviation = np.sqrt(np.sum(rows * rows, axis=1))
        scaled, half = (estimate - self.run["truth"][-1]) / deviation, rows / deviation[:, None]
        return float(scaled @ np.linalg.solve(half @ half.T, scaled))


@pytest.fixture(scope="module")
def flown() -> Flown:
    """The beginning of a maneuver in which the second order alone leads to a wrong center of mass."""
    given = ["plant.lag_factor=0.9523809523809523", "plant.thrust_dispersion=0.01", "detector.kind=off", "seed=50009"]
    filtered = load_scenario("orbiter_maneuver", [*given, "joint.thrust_uncertainty=0.01"])
    run = simulate(
        load_scenario("sample_maneuver", [*given, "plant.thrust_transient=vehicle", "duration_s=10"]), look_back=False
    )
    params, states = inputs.estimation_params(filtered).filter_params, []
    velocities = np.stack([run[name] for name in ACCELEROMETERS], axis=1)
    for kept in (BEGUN, OVER):
        state = joint.initial_state(params)._replace(start=kept)
        for row, time_s in enumerate(run.time_s.tolist()):
            told = Told(time_s, time_s, run["command"][max(row - 1, 0)], None, np.zeros(6))
            state = joint.step(state, run["gyro"][row].reshape(1, 3), velocities[row], told, params).state
            states.append(state)
    rows = run.time_s.size
    return Flown(run, params.joint, states[:rows], states[rows:])


def test_a_start_from_zero_does_not_lock_on_wrongly(flown: Flown) -> None:
    """200 where outputs are linearized at the rate that was predicted."""
    assert flown.error(flown.once[-1].joint) < 30.0
    assert flown.error(flown.again[-1].joint) < 30.0
    assert flown.again[-1].joint.guarded
    assert flown.again[-1].start == OVER


def test_a_pass_about_the_filters_own_estimate_is_its_own_cycle(flown: Flown) -> None:
    own, known = unrounded(flown.params), flown.again[-1].joint
    known = known._replace(root=known.root.copy())
    known.root[:N_PROPERTIES] *= 1e-9  # nothing of second order
    sample = flown.sample(-1, int(np.flatnonzero(flown.run["command"].any(axis=1))[-1]))
    sample = sample._replace(time_s=known.time_s + 0.08)
    expected, report = run_cycle(known, sample, np.full_like(own.thresholds, np.inf), OWN_CHOICE, own)
    after, nis, components = repeat_start_cycle(known, sample, known.mean, own)
    np.testing.assert_allclose(after.mean, expected.mean, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(after.root @ after.root.T, expected.root @ expected.root.T, atol=1e-10)
    assert components == report.used.sum()
    assert nis == pytest.approx(report.nis, rel=1e-2)

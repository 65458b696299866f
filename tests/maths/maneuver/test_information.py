"""Information along a course: against the joint filter's own covariance, against forecasts, and its motion."""

from __future__ import annotations

import bound_probe as bound
import numpy as np
import pytest

from massprop_drake import Scenario
from massprop_drake.inputs import params
from massprop_drake.maths.estimation.joint.beginning import begin_from_readings, initial_joint_state
from massprop_drake.maths.estimation.joint.joint_sample import JointSample
from massprop_drake.maths.estimation.joint.layout import RATE, JointParams
from massprop_drake.maths.estimation.joint.orientation import UNTURNED
from massprop_drake.maths.estimation.joint.ticks import timing_on_ticks
from massprop_drake.maths.estimation.joint.wheels import Spun
from massprop_drake.maths.maneuver.information import (
    FollowedCourse,
    Step,
    advance_course,
    begin_failures,
    initial_course,
    n_known,
    prior_information,
)

Array = np.ndarray


def joint(name: str) -> JointParams:
    found: JointParams = params.estimation_params(Scenario(vehicle=name)).filter_params.joint
    return found


def steps(made: JointParams, count: int, period_s: float = 0.1) -> list[Step]:
    """Firings of one or two jets, and of wheels, now and then; nothing is missing."""
    random, places = np.random.default_rng(5), made.places
    found = []
    for _ in range(count):
        command = np.zeros(places.jets)
        if random.random() < 0.5:
            command[random.integers(places.jets, size=2)] = 1.0
        torques = 2e-3 * random.standard_normal(places.wheels)
        found.append(Step(command, torques, period_s, np.zeros(places.outputs, dtype=bool)))
    return found


def course(made: JointParams, flown: list[Step]) -> FollowedCourse:
    found = initial_course(made.nominal, np.zeros(3), np.zeros(made.places.wheels), made)
    for step in flown:
        found = advance_course(found, step, made)
    return found


def filtered(made: JointParams, flown: list[Step], means: list[Array]) -> Array:
    """Covariance of what is uncertain by the filter's recursion from its prior, along the same motion."""
    places = made.places
    speeds, mean = np.zeros(places.wheels), means[0]
    none = [np.full((n, 3), np.nan) for n in (places.gyros, places.accelerometers, places.trackers)]
    unspun = Spun(speeds, speeds, np.zeros(places.wheels), np.ones(places.wheels))
    first = JointSample(
        0.0, np.zeros(1), np.zeros((1, places.jets)), np.zeros(6), *none[:2], timing_on_ticks(), none[2]
    )
    first = first._replace(speeds=unspun, frames=np.stack((UNTURNED, UNTURNED)))
    state = begin_from_readings(initial_joint_state(made)._replace(mean=mean), first, made)._replace(
        mean=mean, reference=mean[RATE].copy()
    )
    for row, step in enumerate(flown):
        after = speeds + step.torques * step.period_s / made.wheels.inertias
        there = [np.zeros((n, 3)) for n in (places.gyros, places.accelerometers, places.trackers)]
        sample = JointSample(
            state.time_s + step.period_s, np.array([step.period_s]), step.command.reshape(1, -1), np.zeros(6),
            *there[:2], timing_on_ticks(), there[2],
            speeds=Spun(speeds, after, np.zeros(after.size), np.ones(after.size)),
        )  # fmt: skip
        state = bound.step(state, sample, means[row + 1], ~step.missing, made)
        speeds = after
    root = np.vstack((state.root[:10], state.root[places.thrust : places.force]))
    found: Array = root @ root.T
    return found


@pytest.mark.parametrize("name", ["small_satellite", "servicer"])
def test_with_a_prior_it_is_the_filters_covariance(name: str) -> None:
    made = joint(name)
    flown = steps(made, 25)
    courses = [initial_course(made.nominal, np.zeros(3), np.zeros(made.places.wheels), made)]
    for step in flown:
        courses.append(advance_course(courses[-1], step, made))
    information, of = prior_information(initial_joint_state(made), made)
    covariance = np.linalg.inv(information + courses[-1].shown[np.ix_(of, of)])
    expected = filtered(made, flown, [each.joint.mean for each in courses])[np.ix_(of, of)]
    size = np.sqrt(np.diagonal(expected))
    np.testing.assert_allclose(np.sqrt(np.diagonal(covariance)), size, rtol=2e-3)
    np.testing.assert_allclose(covariance / np.outer(size, size), expected / np.outer(size, size), atol=4e-3)


def test_a_reading_that_is_rounded_and_stands_still_tells_little() -> None:
    """The orbiter's sensors have no noise: a hundred samples at rest are worth no more than ten."""
    made = joint("orbiter")
    still = Step(np.zeros(made.places.jets), np.zeros(0), 0.08, np.zeros(made.places.outputs, dtype=bool))
    fires = still._replace(command=np.eye(made.places.jets)[0])
    few, many = (course(made, [still] * count + [fires] * 3) for count in (10, 100))
    assert many.shown[0, 0] == pytest.approx(few.shown[0, 0], rel=1e-3)
    missing = still._replace(missing=np.ones(made.places.outputs, dtype=bool))
    assert not course(made, [missing] * 3).shown.any()


def test_jets_that_fail_from_now_on_have_not_shown_yet() -> None:
    made = joint("small_satellite")
    first = n_known(made)
    begun_to_fail = begin_failures(course(made, steps(made, 10)), made)
    assert not begun_to_fail.shown[first:].any()
    assert not begun_to_fail.shown[:, first:].any()
    assert begun_to_fail.shown[:first, :first].any()
    one = np.eye(made.places.jets)[7]
    after = advance_course(begun_to_fail, steps(made, 1)[0]._replace(command=one), made)
    leaks, losses, jumps = np.split(np.diagonal(after.shown)[first:], np.array((1, 2)) * made.places.jets)
    assert jumps[:6].sum() > 0.0  # of the inertia, by the rates that there are
    assert (leaks > 0.0).all()  # whatever fires
    assert losses.argmax() == 7  # others by what their valves leave of the sample before
    assert np.delete(losses, 7).max() < 0.1 * losses[7]

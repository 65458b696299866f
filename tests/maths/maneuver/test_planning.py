"""Search for a maneuver: its plans keep their limits, and trimming leaves nothing that can go."""

from __future__ import annotations

import numpy as np
import pytest

from massprop_drake import Scenario
from massprop_drake.inputs.crafts import make_craft
from massprop_drake.maths.estimation.joint.beginning import initial_joint_state
from massprop_drake.maths.maneuver.actions import Craft, candidate_actions, coast_action, fly_action
from massprop_drake.maths.maneuver.aims import Aims, Known
from massprop_drake.maths.maneuver.information import n_known, prior_information
from massprop_drake.maths.maneuver.planning import (
    Cost,
    ManeuverLimits,
    Plan,
    Task,
    add_action,
    begin_plan,
    characterize_actions,
    extend_plan,
    plan_cost,
    rebuild_plan,
    trim_plan,
)

FREE = ManeuverLimits()
JETS = [(jet,) for jet in range(12)]


@pytest.fixture(scope="module")
def made() -> Craft:
    return make_craft(Scenario(vehicle="small_satellite"))


def task(made: Craft, share: float, limits: ManeuverLimits = FREE) -> Task:
    """Ixx to a share of its size, and the mass reciprocal to ten times that."""
    elements = np.eye(n_known(made.params))[[0, 9]]
    deviations = share * np.abs(made.properties[[0, 9]]) * np.array([1.0, 10.0])
    aims = Aims(elements, deviations, np.zeros((0, 2), dtype=int), *np.zeros((3, 0)))
    return Task(
        made,
        Known(*prior_information(initial_joint_state(made.params), made.params)),
        aims,
        limits,
        Cost(400.0, 0.05),
        0.0,
    )


@pytest.fixture(scope="module")
def found(made: Craft) -> tuple[Task, Plan]:
    asked = task(made, 0.02)
    choice = characterize_actions(candidate_actions(JETS, made, lengths=(1, 2)), asked)
    return asked, extend_plan(begin_plan(asked), choice, 1.0, asked)


def test_a_plan_reaches_its_aims_and_built_anew_is_the_same(found: tuple[Task, Plan]) -> None:
    asked, plan = found
    assert plan.reached[0].shortfall > 1.0
    assert plan.reached[-1].shortfall == 0.0
    assert (plan.reached[-1].deviations <= asked.aims.deviations).all()
    assert plan.propellant == pytest.approx(sum(action.propellant for action in plan.actions))
    again = rebuild_plan(plan.actions, 1, plan, asked)
    assert again is not None
    np.testing.assert_array_equal(again.reached[-1].deviations, plan.reached[-1].deviations)


def test_trimming_leaves_no_action_that_can_go(found: tuple[Task, Plan]) -> None:
    asked, plan = found
    less = trim_plan(plan, asked)
    assert less.reached[-1].shortfall == 0.0
    assert plan_cost(less, asked) <= plan_cost(plan, asked)
    for place in range(1, len(less.actions)):
        without = rebuild_plan(less.actions[:place] + less.actions[place + 1 :], place, less, asked)
        assert without is not None
        assert without.reached[-1].shortfall > 0.0


def test_actions_that_are_followed_together_show_what_each_shows_alone(made: Craft) -> None:
    asked = task(made, 0.02)
    actions = candidate_actions([(3,), (0, 1)], made, lengths=(1, 3))
    kept, shown = characterize_actions(actions, asked)
    assert kept == actions
    first = begin_plan(asked).flown[-1]
    for action, one in zip(actions, shown, strict=True):
        alone = fly_action((first.course, first.row), action, made).course.shown - first.course.shown
        np.testing.assert_array_equal(one, alone)


TIGHT = [
    ManeuverLimits(**{name: value})
    for name, value in {"rate": 1e-5, "angle": 1e-5, "displacement": 1e-6, "propellant": 1e-6, "time": 0.6}.items()
]


@pytest.mark.parametrize("limits", TIGHT)
def test_limits_are_kept(made: Craft, limits: ManeuverLimits) -> None:
    """Each is less than a single firing takes."""
    asked = task(made, 0.02, limits)
    assert characterize_actions(candidate_actions(JETS, made, lengths=(2,)), asked)[0] == []
    assert add_action(begin_plan(asked), candidate_actions(JETS, made, lengths=(2,))[0], asked) is None


def test_a_firing_lasts_no_less_than_a_valve_can_and_nothing_fires_while_it_coasts(made: Craft) -> None:
    slow = made._replace(least=np.full(12, 3))
    assert {action.samples for action in candidate_actions(JETS, slow, lengths=(1, 2, 4))} == {3, 4}
    before = begin_plan(task(made, 0.02)).flown[-1]
    after = fly_action((before.course, before.row), coast_action(4, made), made)
    assert (after.row, after.rate, after.displacement) == (before.row + 4, 0.0, 0.0)

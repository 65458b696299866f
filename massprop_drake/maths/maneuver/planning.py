"""Search for the maneuver of least cost: actions added one by one by the true recursion, then fewer and shorter."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.maneuver.actions import (
    Craft,
    FiringAction,
    FlownAction,
    coast_action,
    fly_action,
    fly_action_sample,
)
from massprop_drake.maths.maneuver.aims import Aims, Known, Reached, compare_with_aims
from massprop_drake.maths.maneuver.information import begin_failures, initial_course

LEAD = 5  # samples before the first action, after which the motion is known; compute budget
_TRIED = 8  # actions that are flown at each step; compute budget
_LEAST = 1e-3  # nats that an action must gain to be worth it; compute budget
_THRIFT = (1.0, 0.7, 0.5)  # powers of an action's cost by which its gain is divided, one search each; compute budget
_FOREVER = 1e6  # arithmetic: times that everything is flown, where only a floor is left

Choice = tuple[Sequence[FiringAction], Sequence[Array]]  # actions, and what each shows, shape (k, k)


class ManeuverLimits(NamedTuple):
    """Limits of a maneuver; infinity: none.

    Attributes:
        rate: rad/s.
        angle: from the first attitude, rad.
        displacement: from the first position, ft or m.
        propellant: slug or kg.
        time: s.
    """

    rate: float = math.inf
    angle: float = math.inf
    displacement: float = math.inf
    propellant: float = math.inf
    time: float = math.inf


class Cost(NamedTuple):
    """Price of a unit of propellant, and of a second."""

    propellant: float
    second: float


class Task(NamedTuple):
    """Task of a search for a maneuver: vehicle, aims, limits and cost.

    Attributes:
        craft: see `Craft`.
        known: see `Known`.
        aims: see `Aims`.
        limits: see `ManeuverLimits`.
        cost: see `Cost`.
        margin: by which share aims are narrower than what is asked.
        doubting: whether products of errors are noise, see `information.advance_course`: in a start that does not
            converge.
    """

    craft: Craft
    known: Known
    aims: Aims
    limits: ManeuverLimits
    cost: Cost
    margin: float
    doubting: bool = False

    @property
    def doubt(self) -> Known | None:
        """Prior knowledge by which products of errors count as noise, see `information.advance_course`; None: none."""
        return self.known if self.doubting else None


class Plan(NamedTuple):
    """Actions in their order, their information, and the course.

    Attributes:
        actions: in their order, the lead first.
        flown: after each.
        reached: likewise.
    """

    actions: tuple[FiringAction, ...]
    flown: tuple[FlownAction, ...]
    reached: tuple[Reached, ...]

    @property
    def propellant(self) -> float:
        """Propellant mass that the plan uses, slug or kg."""
        return math.fsum(action.propellant for action in self.actions)

    @property
    def samples(self) -> int:
        """Number of samples that the plan lasts."""
        return self.flown[-1].row


def begin_plan(task: Task) -> Plan:
    """Makes a plan of its lead alone: a coast, at whose end the failures of suspect jets begin."""
    craft = task.craft
    course = initial_course(craft.properties, craft.rate, craft.speeds, craft.params)
    lead = coast_action(LEAD, craft)
    flown = fly_action((course, 0), lead, craft)
    flown = flown._replace(course=begin_failures(flown.course, craft.params))
    return Plan((lead,), (flown,), (compare_with_aims(flown.course.shown, task.known, task.aims),))


def plan_cost(plan: Plan, task: Task) -> float:
    """Computes the cost of a plan: price of its propellant and of its duration."""
    return task.cost.propellant * plan.propellant + task.cost.second * plan.samples * task.craft.period_s


def _action_cost(action: FiringAction, task: Task) -> float:
    """Computes the cost of an action: price of its propellant and of its duration."""
    return task.cost.propellant * action.propellant + task.cost.second * action.length * task.craft.period_s


def add_action(plan: Plan, action: FiringAction, task: Task) -> Plan | None:
    """Appends an action to a plan; returns the longer plan, or None where a limit would be exceeded."""
    if not _is_affordable(plan, action, task):
        return None
    last = plan.flown[-1]
    flown = fly_action((last.course, last.row), action, task.craft, task.doubt)
    if not _keeps_limits(flown, task.limits):
        return None
    done = compare_with_aims(flown.course.shown, task.known, task.aims)
    return Plan((*plan.actions, action), (*plan.flown, flown), (*plan.reached, done))


def _is_affordable(plan: Plan, action: FiringAction, task: Task) -> bool:
    """Tests whether an action fits within the limits of propellant and time that a plan leaves."""
    time_s = (plan.flown[-1].row + action.length) * task.craft.period_s
    return plan.propellant + action.propellant <= task.limits.propellant and time_s <= task.limits.time


def _keeps_limits(flown: FlownAction, limits: ManeuverLimits) -> bool:
    """Tests whether a flown action stays within the limits of rate, angle and displacement."""
    return flown.rate <= limits.rate and flown.angle <= limits.angle and flown.displacement <= limits.displacement


def characterize_actions(actions: Sequence[FiringAction], task: Task) -> Choice:
    """Returns actions that keep all limits from rest, and the information that each adds, shape (k, k).

    Those of the same jets are followed together: a longer one goes on where a shorter one ends.
    """
    first = begin_plan(task)
    before, kept, information = first.flown[-1], list[FiringAction](), list[Array]()
    together, of = dict[tuple[int, int], FlownAction](), FiringAction((), (), 0, 0, 0.0)
    for action in actions:
        if (action.jets, action.torques) != (of.jets, of.torques):
            together, of = {(0, 0): before._replace(rate=0.0, angle=0.0, displacement=0.0)}, action
        flown = _fly_cached(together, (action.samples, action.coast), action, task.craft)
        if _is_affordable(first, action, task) and _keeps_limits(flown, task.limits):
            kept.append(action)
            information.append(flown.course.shown - before.course.shown)
    return kept, information


def _fly_cached(
    cache: dict[tuple[int, int], FlownAction], lengths: tuple[int, int], action: FiringAction, craft: Craft
) -> FlownAction:
    """Flies ``lengths`` numbers of firing and coasting samples of an action; keeps and reuses shorter ones."""
    if lengths not in cache:
        firing, coasting_for = lengths
        fewer = (firing, coasting_for - 1) if coasting_for else (firing - 1, 0)
        cache[lengths] = fly_action_sample(
            _fly_cached(cache, fewer, action, craft), action, craft, fires=not coasting_for
        )
    return cache[lengths]


def extend_plan(plan: Plan, candidates: Choice, cost_exponent: float, task: Task) -> Plan:
    """Appends the most informative actions per cost to a plan until its aims are reached or none adds.

    Those that add most for their cost, as if what they show added up, are flown, and the best of these is taken.

    Args:
        plan: to begin with.
        candidates: actions to choose from, and what each shows from rest, shape (k, k) each.
        cost_exponent: power of the cost by which a gain is divided.
    """
    actions, information = candidates
    prices = [_action_cost(action, task) ** cost_exponent for action in actions]
    while plan.reached[-1].shortfall > 0.0:
        missing, so_far = plan.reached[-1].shortfall, plan.flown[-1].course.shown
        added = [missing - compare_with_aims(so_far + more, task.known, task.aims).shortfall for more in information]
        longest, most, tried = None, 0.0, 0
        for place in np.argsort(-np.array(added) / prices, kind="stable").tolist():
            longer = add_action(plan, actions[place], task)
            if longer is None:
                continue
            gain = missing - longer.reached[-1].shortfall
            if gain > _LEAST and gain / prices[place] > most:
                longest, most = longer, gain / prices[place]
            tried += 1
            if tried == _TRIED:
                break
        if longest is None:
            return plan
        plan = longest
    return plan


def rebuild_plan(actions: Sequence[FiringAction], n_shared: int, plan: Plan, task: Task) -> Plan | None:
    """Builds a plan from actions, the first ``n_shared`` taken from another plan; None: a limit is exceeded."""
    made: Plan | None = Plan(plan.actions[:n_shared], plan.flown[:n_shared], plan.reached[:n_shared])
    for action in actions[n_shared:]:
        if made is None:
            return None
        made = add_action(made, action, task)
    return made


def trim_plan(plan: Plan, task: Task) -> Plan:
    """Removes or shortens actions of a plan while its aims stay reached; returns the cheapest plan found."""
    better = True
    while better:
        better = False
        for place in range(len(plan.actions) - 1, 0, -1):
            for fewer in _shorter_variants(plan.actions, place):
                shorter = rebuild_plan(fewer, place, plan, task)
                reaches = shorter is not None and shorter.reached[-1].shortfall == 0.0
                if shorter is not None and reaches and plan_cost(shorter, task) < plan_cost(plan, task):
                    plan, better = shorter, True
                    break
    return plan


def _shorter_variants(actions: tuple[FiringAction, ...], index: int) -> list[tuple[FiringAction, ...]]:
    """Lists variants of an action sequence: one action removed, halved, or its coast cut to a sample."""
    before, one, after = actions[:index], actions[index], actions[index + 1 :]
    found = [before + after]
    if one.samples > 1:
        half = one.samples // 2
        shorter = one._replace(samples=half, propellant=one.propellant * half / one.samples)
        found.append((*before, shorter, *after))
    if one.coast > 1:
        found.append((*before, one._replace(coast=1), *after))
    return found


class SearchResult(NamedTuple):
    """Result of a search.

    Attributes:
        plan: of least cost; the nearest one where none reaches all aims.
        trace: the plan from which it was trimmed, whose beginnings are plans for looser aims.
    """

    plan: Plan
    trace: Plan


def search_best_plan(candidates: Choice, task: Task) -> SearchResult:
    """Searches plans with several weights of cost; returns the cheapest that reaches the aims, or nearest.

    Args:
        candidates: see `extend_plan`.
    """
    first, found = begin_plan(task), list[SearchResult]()
    for thrift in _THRIFT:
        longest = extend_plan(first, candidates, thrift, task)
        found.append(
            SearchResult(trim_plan(longest, task) if longest.reached[-1].shortfall == 0.0 else longest, longest)
        )
    return min(found, key=lambda each: (each.plan.reached[-1].shortfall, plan_cost(each.plan, task)))


def aims_floor(information: Sequence[Array], task: Task) -> Reached:
    """Computes the best precision that any firing can reach, every action repeated without end.

    Args:
        information: what each action shows, shape (k, k) each.
    """
    return compare_with_aims(_unlimited_information(information), task.known, task.aims)


def unobservable_direction(information: Sequence[Array], task: Task, row: int) -> Array:
    """Computes the parameter error that dominates a wanted combination after all firings, (n_known,).

    Args:
        information: what each action shows, shape (k, k) each.
        row: of the combination.
    """
    of, combination = task.known.of, task.aims.combinations[row]
    total = task.known.information + _unlimited_information(information)[np.ix_(of, of)]
    direction = np.zeros(combination.size)
    direction[of] = np.linalg.solve(total, combination[of])
    return direction


def _unlimited_information(information: Sequence[Array]) -> Array:
    """Computes the information of all actions, each repeated without end, shape (k, k)."""
    return _FOREVER * np.sum(information, axis=0)

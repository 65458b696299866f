"""Limits of designs: aims that no firing reaches, and rules that forbid all firings, in words."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from massprop_drake.errors import InputError
from massprop_drake.inputs.asked import Suspicion, Target
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.maths.estimation.joint.layout import N_PROPERTIES, thrust_sigmas
from massprop_drake.maths.maneuver.actions import candidate_actions
from massprop_drake.maths.maneuver.aims import Reached
from massprop_drake.maths.maneuver.planning import (
    ManeuverLimits,
    Plan,
    Task,
    aims_floor,
    characterize_actions,
    unobservable_direction,
)
from massprop_drake.maths.signals import SYMBOLS

Array = NDArray[np.float64]
_UNKNOWN = "the vehicle is not known well enough for failures to be looked for"


def require_within_reach(
    jet_sets: Sequence[tuple[int, ...]], task: Task, request: tuple[Sequence[Target], Suspicion], vehicle: Vehicle
) -> Reached:
    """Checks that firings can reach all aims, else InputError; returns the least sigmas that firings reach."""
    (targets, suspicion), unlimited_task = request, task._replace(limits=ManeuverLimits())
    information = characterize_actions(candidate_actions(jet_sets, task.craft, lengths=(4,)), unlimited_task)[1]
    floors = aims_floor(information, task)
    unreachable = np.flatnonzero(floors.ratios > 1.0)
    if unreachable.size == 0:
        return floors
    worst_aim = int(unreachable[np.argmax(floors.ratios[unreachable])])
    if worst_aim >= floors.deviations.size:
        jet_index, other_index = suspicion.pairs[worst_aim - floors.deviations.size]
        jet = vehicle.designations[jet_index]
        if other_index < 0:
            raise InputError(
                f"design: no firing shows that {jet} fails by so little: it is within what thrusts may be off, or what "
                "the sensors resolve"
            )
        raise InputError(
            f"design: no firing tells {jet} from {vehicle.designations[other_index]}: what one of them does by failing "
            "the other does as well"
        )
    why = _hidden_direction_text(information, task, worst_aim, vehicle)
    if worst_aim >= len(targets):
        raise InputError(f"design: suspects: {_UNKNOWN}, and no firing mends that. {why}")
    target, sigma = targets[worst_aim], float(floors.deviations[worst_aim])
    asked_with_margin = _with_unit(float(task.aims.deviations[worst_aim]), target)
    raise InputError(
        f"design: target {target.name}: no firing makes it known better than to {_with_unit(sigma, target)}; asked is "
        f"{_with_unit(target.asked, target)}, with a margin {asked_with_margin}. {why}"
    )


def _hidden_direction_text(information: Sequence[Array], task: Task, aim_index: int, vehicle: Vehicle) -> str:
    """Describes the unobservable combination of parameters that keeps a target from being reached."""
    places, sigma = task.craft.params.places, thrust_sigmas(task.craft.params)
    direction = unobservable_direction(information, task, aim_index)
    thrusts = direction[N_PROPERTIES : N_PROPERTIES + places.n_thrust]
    size = float(np.linalg.norm(thrusts))
    fires = np.flatnonzero(sigma)
    if size > 0.0 and fires.size and abs(float(thrusts[fires].sum())) > 0.9 * size * math.sqrt(fires.size):
        return (
            "What is left is the common scale of all thrusts: if each jet gives more by the same share, and inertia "
            "and mass are larger by as much, every reading is the same. Better known thrusts would help, or wheels"
        )
    prior = np.sqrt(np.diagonal(np.linalg.inv(task.known.information)))
    sigmas = np.zeros(N_PROPERTIES)
    known = task.known.of
    sigmas[known[known < N_PROPERTIES]] = prior[known < N_PROPERTIES]
    share = np.abs(direction[:N_PROPERTIES]) * np.where(sigmas > 0.0, 1.0 / np.maximum(sigmas, 1e-300), 0.0)
    names = [SYMBOLS[place] for place in np.argsort(-share)[:2] if share[place] > 0.3 * share.max()]
    return f"No firing of these jets shows {' with '.join(names)}, by the sensors that vehicle '{vehicle.name}' has"


def _with_unit(sigma: float, target: Target) -> str:
    """Formats a target's sigma with its unit, and in percent of its value where it has one."""
    percent = f" ({100.0 * sigma / target.share:.3g} %)" if target.share else ""
    return f"{sigma:.3g} {target.unit}{percent}"


def require_allowed_firing(jet_sets: Sequence[tuple[int, ...]], task: Task, limits: Mapping[str, str]) -> None:
    """Checks that the limits allow at least the shortest firing, else InputError.

    Args:
        jet_sets: of jets that fire together.
        task: see `Task`.
        limits: as they were given, for the message.
    """
    if not characterize_actions(candidate_actions(jet_sets, task.craft, lengths=(1,)), task)[0]:
        raise InputError(f"design: limits: {_limits_text(limits)}: forbids every firing; the shortest takes more")


def _limits_text(limits: Mapping[str, str]) -> str:
    """Formats limits as text."""
    return " and ".join(f"{name} {value}" for name, value in limits.items())


def require_reached(
    plan: Plan, task: Task, request: tuple[Sequence[Target], Suspicion], vehicle: Vehicle, limits: Mapping[str, str]
) -> None:
    """Checks that a plan reaches all aims, else InputError with how close it comes and the limits."""
    (targets, suspicion), last = request, plan.reached[-1]
    if last.shortfall == 0.0:
        return
    worst = int(np.argmax(last.ratios))
    used = f"{plan.propellant:.3g} {vehicle.unit_names['mass']} and {plan.samples * task.craft.period_s:.3g} s"
    if worst < len(targets):
        result = f"{targets[worst].name} is known to {_with_unit(float(last.deviations[worst]), targets[worst])}"
    elif worst < last.deviations.size:
        result = _UNKNOWN
    else:
        jet_index, other_index = suspicion.pairs[worst - last.deviations.size]
        other_jet = vehicle.designations[other_index] if other_index >= 0 else "nothing"
        result = f"{vehicle.designations[jet_index]} is not told from {other_jet}"
    within = f" within {_limits_text(limits)}" if limits else ""
    raise InputError(
        f"design: no maneuver was found that reaches what is asked{within}: after {used} {result}; raise a "
        "limit or a target"
    )

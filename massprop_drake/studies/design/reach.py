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
    sets: Sequence[tuple[int, ...]], task: Task, asks: tuple[Sequence[Target], Suspicion], vehicle: Vehicle
) -> Reached:
    """Checks that firings can reach all aims, else InputError; returns the least sigmas that firings reach.

    Raises:
        InputError: when that is more than an aim leaves, with the direction that nothing shows.
    """
    (wanted, suspected), free = asks, task._replace(limits=ManeuverLimits())
    shown = characterize_actions(candidate_actions(sets, task.craft, lengths=(4,)), free)[1]
    floors = aims_floor(shown, task)
    beyond = np.flatnonzero(floors.ratios > 1.0)
    if beyond.size == 0:
        return floors
    worst = int(beyond[np.argmax(floors.ratios[beyond])])
    if worst >= floors.deviations.size:
        one, other = suspected.pairs[worst - floors.deviations.size]
        jet = vehicle.designations[one]
        if other < 0:
            raise InputError(
                f"design: no firing shows that {jet} fails by so little: it is within what thrusts may be off, or what "
                "the sensors resolve"
            )
        raise InputError(
            f"design: no firing tells {jet} from {vehicle.designations[other]}: what one of them does by failing the "
            "other does as well"
        )
    why = _hidden_direction_text(shown, task, worst, vehicle)
    if worst >= len(wanted):
        raise InputError(f"design: suspects: {_UNKNOWN}, and no firing mends that. {why}")
    target, left = wanted[worst], float(floors.deviations[worst])
    narrower = _with_unit(float(task.aims.deviations[worst]), target)
    raise InputError(
        f"design: target {target.name}: no firing makes it known better than to {_with_unit(left, target)}; asked is "
        f"{_with_unit(target.asked, target)}, with a margin {narrower}. {why}"
    )


def _hidden_direction_text(shown: Sequence[Array], task: Task, worst: int, vehicle: Vehicle) -> str:
    """Describes the unobservable combination that keeps a target from being reached, as text."""
    places, sigma = task.craft.params.places, thrust_sigmas(task.craft.params)
    direction = unobservable_direction(shown, task, worst)
    thrusts = direction[N_PROPERTIES : N_PROPERTIES + places.n_thrust]
    size = float(np.linalg.norm(thrusts))
    fires = np.flatnonzero(sigma)
    if size > 0.0 and fires.size and abs(float(thrusts[fires].sum())) > 0.9 * size * math.sqrt(fires.size):
        return (
            "What is left is the common scale of all thrusts: if each jet gives more by the same share, and inertia "
            "and mass are larger by as much, every reading is the same. Better known thrusts would help, or wheels"
        )
    prior = np.sqrt(np.diagonal(np.linalg.inv(task.known.information)))
    ten = np.zeros(N_PROPERTIES)
    of = task.known.of
    ten[of[of < N_PROPERTIES]] = prior[of < N_PROPERTIES]
    share = np.abs(direction[:N_PROPERTIES]) * np.where(ten > 0.0, 1.0 / np.maximum(ten, 1e-300), 0.0)
    names = [SYMBOLS[place] for place in np.argsort(-share)[:2] if share[place] > 0.3 * share.max()]
    return f"No firing of these jets shows {' with '.join(names)}, by the sensors that vehicle '{vehicle.name}' has"


def _with_unit(value: float, target: Target) -> str:
    """Formats a target's sigma with its unit, and in percent of its value where it has one."""
    percent = f" ({100.0 * value / target.share:.3g} %)" if target.share else ""
    return f"{value:.3g} {target.unit}{percent}"


def require_room(sets: Sequence[tuple[int, ...]], task: Task, limits: Mapping[str, str]) -> None:
    """Checks that limits leave any firing allowed, else InputError.

    Args:
        sets: of jets that fire together.
        task: see `Task`.
        limits: as they were given, for the message.

    Raises:
        InputError: when they forbid even the shortest firing.
    """
    if not characterize_actions(candidate_actions(sets, task.craft, lengths=(1,)), task)[0]:
        raise InputError(f"design: limits: {_in_words(limits)}: forbids every firing; the shortest takes more")


def _in_words(limits: Mapping[str, str]) -> str:
    return " and ".join(f"{name} {value}" for name, value in limits.items())


def require_reached(
    plan: Plan, task: Task, asks: tuple[Sequence[Target], Suspicion], vehicle: Vehicle, limits: Mapping[str, str]
) -> None:
    """Checks that a plan reaches all aims, else InputError with how close it comes and the limits.

    Raises:
        InputError: when it does not, with how far it comes and the limits that are set.
    """
    (wanted, suspected), last = asks, plan.reached[-1]
    if last.shortfall == 0.0:
        return
    worst = int(np.argmax(last.ratios))
    used = f"{plan.propellant:.3g} {vehicle.unit_names['mass']} and {plan.samples * task.craft.period_s:.3g} s"
    if worst < len(wanted):
        comes = f"{wanted[worst].name} is known to {_with_unit(float(last.deviations[worst]), wanted[worst])}"
    elif worst < last.deviations.size:
        comes = _UNKNOWN
    else:
        one, other = suspected.pairs[worst - last.deviations.size]
        other_one = vehicle.designations[other] if other >= 0 else "nothing"
        comes = f"{vehicle.designations[one]} is not told from {other_one}"
    within = f" within {_in_words(limits)}" if limits else ""
    raise InputError(
        f"design: no maneuver was found that reaches what is asked{within}: after {used} {comes}; raise a "
        "limit or a target"
    )

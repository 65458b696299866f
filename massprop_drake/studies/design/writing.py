"""Output of a plan as a scenario that flies it, and as a design with its forecast."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.display.run import Run
from massprop_drake.inputs.asked import Suspicion, Target
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.inputs.scheduled import JetPulse, WheelPulse
from massprop_drake.maths.maneuver.actions import FlownAction, coast_action, fly_action_sample
from massprop_drake.maths.maneuver.aims import FOLLOWED, Aims, Reached, compare_with_aims
from massprop_drake.maths.maneuver.planning import Plan, SearchResult, Task, begin_plan
from massprop_drake.studies.design.found import LISTENING_S, Design, PairFound, TargetFound, Trace

Array = NDArray[np.float64]


class DesignRequest(NamedTuple):
    """Request for a design, as it has been read.

    Attributes:
        wanted: targets.
        suspected: see `Suspicion`.
        floors: of all aims.
        hold: whether the autopilot holds attitude meanwhile.
    """

    wanted: Sequence[Target]
    suspected: Suspicion
    floors: Reached
    hold: bool


def make_design(found: SearchResult, task: Task, asks: DesignRequest, base: Scenario, run: Run | None) -> Design:
    """Makes the design of a found plan: its scenario, predicted sigmas, separable pairs and commands."""
    (plan, trace), (wanted, suspected, floors, hold) = found, asks
    craft, vehicle = task.craft, base.vehicle_data
    begins_s = 0.0 if run is None else base.duration_s
    before, last = plan.reached[0], plan.reached[-1]
    n = len(wanted)
    rows, spent = _unroll_plan(plan, task)
    deviations, apart_s = _sigmas_and_separation(rows, task, task.aims, n)
    course = Trace(np.array(spent), np.array([each.row for each in rows]) * craft.period_s, deviations[:, :n])
    targets = tuple(
        TargetFound(
            one.name, one.unit, one.value, one.asked, float(before.deviations[place]), float(last.deviations[place]),
            float(floors.deviations[place]), (), (),
        )
        for place, one in enumerate(wanted)
    )  # fmt: skip
    sign = -1.0 if suspected.loss else 1.0
    pairs = tuple(
        PairFound(
            vehicle.designations[one],
            vehicle.designations[other] if other >= 0 else None,
            sign * float(force),
            after_s,
        )
        for (one, other), force, after_s in zip(suspected.pairs.tolist(), suspected.forces, apart_s, strict=True)
    )
    used = np.cumsum([action.propellant for action in trace.actions])
    front = Trace(
        used,
        np.array([flown.row for flown in trace.flown]) * craft.period_s,
        np.array([each.deviations[:n] for each in trace.reached]).reshape(used.size, n),
    )
    return Design(
        _scenario(plan, task, base, begins_s, hold=hold),
        begins_s,
        plan.samples * craft.period_s,
        craft.period_s * sum(action.samples for action in plan.actions),
        plan.propellant,
        max(flown.rate for flown in plan.flown),
        max(flown.angle for flown in plan.flown),
        max(flown.displacement for flown in plan.flown),
        targets,
        pairs,
        course,
        front,
        {vehicle.designations[jet]: time_s for jet, time_s in _naming_times_s(rows, task, n).items()},
        {},
    )


def _unroll_plan(plan: Plan, task: Task) -> tuple[list[FlownAction], list[float]]:
    """Returns the predicted filter courses sample by sample after the lead, and propellant used by then."""
    (flown,), used = begin_plan(task).flown, [0.0]
    rows = [flown]
    for action in plan.actions[1:]:
        for sample in range(action.length):
            fires = sample < action.samples
            rows.append(fly_action_sample(rows[-1], action, task.craft, task.doubt, fires=fires))
            used.append(used[-1] + (action.propellant / action.samples if fires else 0.0))
    return rows, used


def _sigmas_and_separation(
    rows: Sequence[FlownAction], task: Task, aims: Aims, n: int
) -> tuple[Array, list[float | None]]:
    """Computes 1-sigmas by sample, and times at which pairs become separable, s after the lead, or None.

    Args:
        rows: see `_unroll_plan`.
        task: see `Task`.
        aims: whose pairs they are.
        n: number of targets; other combinations must be known before suspects are looked for.
    """
    done = [compare_with_aims(flown.course.shown, task.known, aims) for flown in rows]
    deviations, wide = np.array([each.deviations for each in done]), 1.0 + task.margin
    looked_for = np.all(deviations[:, n:] <= aims.deviations[n:] * wide, axis=1)
    told = (np.array([each.deltas for each in done]) >= aims.odds / wide**2) & looked_for.reshape(-1, 1)
    after = [max(int(np.argmax(one)), FOLLOWED) * task.craft.period_s if one.any() else None for one in told.T]
    return deviations, after


def _naming_times_s(rows: list[FlownAction], task: Task, n: int) -> dict[int, float | None]:
    """Maps each suspect jet to when it is separable from all other jets, s after the lead, or None.

    Nothing fires after the maneuver, for as long as flights are listened to.
    """
    aims, period_s, jets = task.aims, task.craft.period_s, task.craft.params.places.jets
    if aims.pairs.size == 0:
        return {}
    rest = coast_action(round(LISTENING_S / period_s), task.craft)
    after = list(rows)
    for _ in range(rest.coast):
        after.append(fly_action_sample(after[-1], rest, task.craft, fires=False))
    apart, nothing = aims.odds[aims.pairs[:, 1] >= 0].min(), np.flatnonzero(aims.pairs[:, 1] < 0)
    whom = aims.pairs[nothing, 0]
    others = [np.append(np.delete(np.arange(2 * jets), (own % jets, jets + own % jets)), -1) for own in whom]
    rivals, size = np.concatenate(others), others[0].size
    of = np.repeat(nothing, size)
    every = aims._replace(
        pairs=np.column_stack((np.repeat(whom, size), rivals)),
        forces=aims.forces[of],
        most=aims.most[of],
        odds=np.where(rivals < 0, aims.odds[of], apart),
    )
    told = np.array([math.inf if one is None else one for one in _sigmas_and_separation(after, task, every, n)[1]])
    last = told.reshape(-1, size).max(axis=1).tolist()
    return {
        own % jets: time_s if math.isfinite(time_s) else None for own, time_s in zip(whom.tolist(), last, strict=True)
    }


def _scenario(plan: Plan, task: Task, base: Scenario, begins_s: float, *, hold: bool) -> Scenario:
    """Makes a scenario that flies a plan, from the start or from the end of the base scenario."""
    period_s, vehicle = task.craft.period_s, base.vehicle_data
    pulses, turns, row = list[JetPulse](), list[WheelPulse](), 0
    for action, flown in zip(plan.actions, plan.flown, strict=True):
        start_s = begins_s + row * period_s
        end_s = start_s + action.samples * period_s
        times = {"start_s": round(start_s, 9), "end_s": round(end_s, 9)}
        pulses += [JetPulse(jet=vehicle.designations[jet], **times) for jet in action.jets]
        turns += [
            WheelPulse(wheel=vehicle.wheels[wheel].name, torque=torque, **times)
            for wheel, torque in enumerate(action.torques)
            if torque
        ]
        row = flown.row
    changed = {
        "name": f"{vehicle.name}_design",
        "description": "A maneuver that was designed: " + ", ".join(_in_words(plan, task)),
        "maneuver": base.maneuver if begins_s else (),
        "autopilot": base.autopilot.model_copy(update={"engaged": hold or bool(begins_s and not base.open_loop)}),
        "jet_schedule": (*(base.jet_schedule if begins_s else ()), *pulses),
        "wheel_schedule": (*(base.wheel_schedule if begins_s else ()), *turns),
        "engine_schedule": base.engine_schedule if begins_s else (),
        "duration_s": round(begins_s + row * period_s, 9),
    }
    return base.model_copy(update=changed)


def _in_words(plan: Plan, task: Task) -> list[str]:
    return [f"{len(plan.actions) - 1} firings", f"{plan.samples * task.craft.period_s:.3g} s"]

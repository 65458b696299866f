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
        targets: with the 1-sigma asked for.
        suspicion: suspect jets and their forces, see `Suspicion`.
        floors: of all aims.
        hold: whether the autopilot holds attitude meanwhile.
    """

    targets: Sequence[Target]
    suspicion: Suspicion
    floors: Reached
    hold: bool


def make_design(result: SearchResult, task: Task, request: DesignRequest, base: Scenario, run: Run | None) -> Design:
    """Makes the design of a found plan: its scenario, predicted sigmas, separable pairs and commands."""
    (plan, trace), (requested, suspicion, floors, hold) = result, request
    craft, vehicle = task.craft, base.vehicle_data
    begins_s = 0.0 if run is None else base.duration_s
    before, last = plan.reached[0], plan.reached[-1]
    n = len(requested)
    samples, spent = _unroll_plan(plan, task)
    deviations, separable_s = _sigmas_and_separation(samples, task, task.aims, n)
    course = Trace(np.array(spent), np.array([each.row for each in samples]) * craft.period_s, deviations[:, :n])
    targets = tuple(
        TargetFound(
            one.name, one.unit, one.value, one.asked, float(before.deviations[place]), float(last.deviations[place]),
            float(floors.deviations[place]), (), (),
        )
        for place, one in enumerate(requested)
    )  # fmt: skip
    sign = -1.0 if suspicion.loss else 1.0
    pairs = tuple(
        PairFound(
            vehicle.designations[one],
            vehicle.designations[other] if other >= 0 else None,
            sign * float(force),
            after_s,
        )
        for (one, other), force, after_s in zip(suspicion.pairs.tolist(), suspicion.forces, separable_s, strict=True)
    )
    used = np.cumsum([action.propellant for action in trace.actions])
    front = Trace(
        used,
        np.array([flown.row for flown in trace.flown]) * craft.period_s,
        np.array([each.deviations[:n] for each in trace.reached]).reshape(used.size, n),
    )
    return Design(
        _flying_scenario(plan, task, base, begins_s, hold=hold),
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
        {vehicle.designations[jet]: time_s for jet, time_s in _naming_times_s(samples, task, n).items()},
        {},
    )


def _unroll_plan(plan: Plan, task: Task) -> tuple[list[FlownAction], list[float]]:
    """Predicts a plan sample by sample from its first firing on: filter states, and propellant used by then."""
    (flown,), propellant = begin_plan(task).flown, [0.0]
    samples = [flown]
    for action in plan.actions[1:]:
        for sample in range(action.length):
            fires = sample < action.samples
            samples.append(fly_action_sample(samples[-1], action, task.craft, task.doubt, fires=fires))
            propellant.append(propellant[-1] + (action.propellant / action.samples if fires else 0.0))
    return samples, propellant


def _sigmas_and_separation(
    samples: Sequence[FlownAction], task: Task, aims: Aims, n_targets: int
) -> tuple[Array, list[float | None]]:
    """Computes 1-sigmas by sample, and times at which pairs become separable, s after the first firing, or None.

    Args:
        samples: see `_unroll_plan`.
        task: see `Task`.
        aims: whose pairs they are.
        n_targets: number of targets; other combinations must be known before suspects are looked for.
    """
    reached = [compare_with_aims(flown.course.shown, task.known, aims) for flown in samples]
    deviations, tolerance = np.array([each.deviations for each in reached]), 1.0 + task.margin
    looked_for = np.all(deviations[:, n_targets:] <= aims.deviations[n_targets:] * tolerance, axis=1)
    separable = (np.array([each.deltas for each in reached]) >= aims.odds / tolerance**2) & looked_for.reshape(-1, 1)
    times_s = [max(int(np.argmax(row)), FOLLOWED) * task.craft.period_s if row.any() else None for row in separable.T]
    return deviations, times_s


def _naming_times_s(samples: list[FlownAction], task: Task, n_targets: int) -> dict[int, float | None]:
    """Maps each suspect jet to the time after the first firing at which it is separable from all others, s, or None.

    Nothing fires after the maneuver, for as long as flights are listened to.
    """
    aims, period_s, jets = task.aims, task.craft.period_s, task.craft.params.places.jets
    if aims.pairs.size == 0:
        return {}
    rest = coast_action(round(LISTENING_S / period_s), task.craft)
    rows = list(samples)
    for _ in range(rest.coast):
        rows.append(fly_action_sample(rows[-1], rest, task.craft, fires=False))
    least_odds, nothing = aims.odds[aims.pairs[:, 1] >= 0].min(), np.flatnonzero(aims.pairs[:, 1] < 0)
    suspects = aims.pairs[nothing, 0]
    others = [np.append(np.delete(np.arange(2 * jets), (jet % jets, jets + jet % jets)), -1) for jet in suspects]
    rivals, size = np.concatenate(others), others[0].size
    suspect_rows = np.repeat(nothing, size)
    pairs = aims._replace(
        pairs=np.column_stack((np.repeat(suspects, size), rivals)),
        forces=aims.forces[suspect_rows],
        most=aims.most[suspect_rows],
        odds=np.where(rivals < 0, aims.odds[suspect_rows], least_odds),
    )
    times_s = np.array(
        [math.inf if one is None else one for one in _sigmas_and_separation(rows, task, pairs, n_targets)[1]]
    )
    last = times_s.reshape(-1, size).max(axis=1).tolist()
    return {
        jet % jets: time_s if math.isfinite(time_s) else None
        for jet, time_s in zip(suspects.tolist(), last, strict=True)
    }


def _flying_scenario(plan: Plan, task: Task, base: Scenario, begins_s: float, *, hold: bool) -> Scenario:
    """Makes a scenario that flies a plan, from the start or from the end of the base scenario."""
    period_s, vehicle = task.craft.period_s, base.vehicle_data
    pulses, wheel_pulses, sample = list[JetPulse](), list[WheelPulse](), 0
    for action, flown in zip(plan.actions, plan.flown, strict=True):
        start_s = begins_s + sample * period_s
        end_s = start_s + action.samples * period_s
        times = {"start_s": round(start_s, 9), "end_s": round(end_s, 9)}
        pulses += [JetPulse(jet=vehicle.designations[jet], **times) for jet in action.jets]
        wheel_pulses += [
            WheelPulse(wheel=vehicle.wheels[wheel].name, torque=torque, **times)
            for wheel, torque in enumerate(action.torques)
            if torque
        ]
        sample = flown.row
    changed = {
        "name": f"{vehicle.name}_design",
        "description": "A maneuver that was designed: " + ", ".join(_plan_texts(plan, task)),
        "maneuver": base.maneuver if begins_s else (),
        "autopilot": base.autopilot.model_copy(update={"engaged": hold or bool(begins_s and not base.open_loop)}),
        "jet_schedule": (*(base.jet_schedule if begins_s else ()), *pulses),
        "wheel_schedule": (*(base.wheel_schedule if begins_s else ()), *wheel_pulses),
        "engine_schedule": base.engine_schedule if begins_s else (),
        "duration_s": round(begins_s + sample * period_s, 9),
    }
    return base.model_copy(update=changed)


def _plan_texts(plan: Plan, task: Task) -> list[str]:
    """Returns number of firings and duration of a plan as text."""
    return [f"{len(plan.actions) - 1} firings", f"{plan.samples * task.craft.period_s:.3g} s"]

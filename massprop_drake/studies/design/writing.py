"""The scenario that flies a plan, and the design that says what it shows."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from massprop_drake.inputs.asked import Suspicion, Target
from massprop_drake.inputs.scenario import JetPulse, Scenario, WheelPulse
from massprop_drake.maths.maneuver.actions import stepped
from massprop_drake.maths.maneuver.aims import FOLLOWED, Reached, reached
from massprop_drake.maths.maneuver.planning import Plan, SearchResult, Task, begun
from massprop_drake.results.run import Run
from massprop_drake.studies.design.found import Design, PairFound, TargetFound, Trace


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


def made(found: SearchResult, task: Task, asks: DesignRequest, base: Scenario, run: Run | None) -> Design:
    """The design of a plan."""
    (plan, trace), (wanted, suspected, floors, hold) = found, asks
    craft, vehicle = task.craft, base.vehicle_data
    begins_s = 0.0 if run is None else base.duration_s
    course, apart_s = _by_sample(plan, task, len(wanted))
    before, last = plan.reached[0], plan.reached[-1]
    n = len(wanted)
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
        {},
    )


def _by_sample(plan: Plan, task: Task, n: int) -> tuple[Trace, list[float | None]]:
    """The course of a plan sample by sample, and when each pair is told apart, s after the lead.

    Args:
        plan: see `Plan`.
        task: see `Task`.
        n: number of targets; other combinations must be known before suspects are looked for.
    """
    first = begun(task)
    (flown,), done, used = first.flown, [first.reached[-1]], [0.0]
    rows = [flown.row]
    for action in plan.actions[1:]:
        for sample in range(action.length):
            fires = sample < action.samples
            flown = stepped(flown, action, task.craft, task.doubt, fires=fires)
            done.append(reached(flown.course.shown, task.known, task.aims))
            used.append(used[-1] + (action.propellant / action.samples if fires else 0.0))
            rows.append(flown.row)
    time_s = np.array(rows) * task.craft.period_s
    deviations = np.array([each.deviations for each in done])
    wide = 1.0 + task.margin
    looked_for = np.all(deviations[:, n:] <= task.aims.deviations[n:] * wide, axis=1)
    looked_for[:FOLLOWED] = False
    told = (np.array([each.deltas for each in done]) >= task.aims.odds / wide**2) & looked_for.reshape(-1, 1)
    after = [float(time_s[np.argmax(one)] - time_s[0]) if one.any() else None for one in told.T]
    return Trace(np.array(used), time_s, deviations[:, :n]), after


def _scenario(plan: Plan, task: Task, base: Scenario, begins_s: float, *, hold: bool) -> Scenario:
    """A scenario that flies a plan; after another one's end, if it goes on from there."""
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

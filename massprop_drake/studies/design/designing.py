"""Design of a maneuver: the request, the search, the scenario that flies it, and the results of its flights."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from massprop_drake.display.run import Run
from massprop_drake.errors import InputError, suggestion
from massprop_drake.inputs import asked, crafts
from massprop_drake.inputs import params as inputs
from massprop_drake.inputs.estimation_blocks import HypothesesBlock
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.inputs.true_blocks import PlantBlock
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.maths.estimation.filters.joint import JointFilterState, initial_state
from massprop_drake.maths.estimation.joint.layout import RATE
from massprop_drake.maths.maneuver.actions import Craft, candidate_actions
from massprop_drake.maths.maneuver.aims import Aims, Known, compare_with_aims
from massprop_drake.maths.maneuver.information import prior_information
from massprop_drake.maths.maneuver.planning import (
    Choice,
    Cost,
    SearchResult,
    Task,
    characterize_actions,
    rebuild_plan,
    search_best_plan,
)
from massprop_drake.results.stored import STATE_FILE
from massprop_drake.runners.logs import state_from_json
from massprop_drake.studies.design import reach, writing
from massprop_drake.studies.design.found import Design
from massprop_drake.studies.design.verification import fly_design
from massprop_drake.systems.autopilot.jet_sets import jet_sets

Array = NDArray[np.float64]

_EARLY = 0.5  # of the 1-sigmas at which estimates converge: then they have converged before the end; probability


def design(
    case: Scenario | Vehicle,
    targets: Mapping[str, str] | None = None,
    *,
    suspects: Sequence[str] = (),
    force: str = "5%",
    limits: Mapping[str, str] | None = None,
    without: Sequence[str] = (),
    spare: str = "propellant",
    margin: float = crafts.MARGIN,
    hold: bool = False,
    known: Run | str | Path | None = None,
    flights: int = 0,
) -> Design:
    """Designs the firings of least cost that determine mass properties, or tell which jet fails.

        design(load_vehicle("servicer"), {"mass": "1%", "inertia": "0.5%"}, limits={"rate": "1 deg/s"}, flights=5)

    The vehicle is taken as its file has it, or as it is known at the end of a run. Each firing is followed by the joint
    filter's own recursion, see `maths.maneuver.information`.

    Args:
        case: a vehicle, whose settings are the usual ones; or a scenario, for vehicle, plant and settings.
        targets: 1-sigma by name: a share of the value, or with a unit. See `asked.TARGETS`.
        suspects: jets of which one may fail: one is to be told from every other jet, several from each other.
        force: that a suspect leaks, a share of its thrust or with a unit; below zero: misses while it fires.
        limits: of rate, angle, displacement, propellant and time, see `asked.LIMITS`.
        without: jets that are not to be fired, as plumes or rules forbid.
        spare: what is to be spared, `propellant` or `time`.
        margin: by which share each 1-sigma is to be smaller than asked, as the truth is not nominal.
        hold: whether the autopilot holds attitude while nothing is prescribed, by firings that come on top.
        known: a run, or its folder, from whose end the maneuver goes on; None: nothing is known but what is stated.
        flights: how often the maneuver is flown, with seeds 0, 1, ...; with a suspect that fails as often for each.

    Raises:
        InputError: when something asked for is none, or cannot be reached: then it says what is in the way.
    """
    run = Run.load(known) if isinstance(known, (str, Path)) else known
    base = _joint_filter_scenario(
        run.scenario if run is not None else case if isinstance(case, Scenario) else _default_scenario(case)
    )
    vehicle = base.vehicle_data
    if run is not None and isinstance(case, Vehicle) and case.name != vehicle.name:
        raise InputError(f"design: the run is of vehicle '{vehicle.name}', not of '{case.name}'")
    if spare not in ("propellant", "time"):
        raise InputError(f"design: spare: either propellant or time, not '{spare}'")
    if not 0.0 <= margin <= 10.0:
        raise InputError(f"design: margin: must be from 0 to 10, not {margin:g}")
    craft, state = _craft_and_filter(base, run, without)
    requested = asked.parse_targets(targets or {}, craft.properties, vehicle)
    suspicion = asked.parse_suspects(suspects, force, vehicle, craft.jets)
    if not requested and not suspects:
        raise InputError("design: nothing is asked for; give a target, such as mass=1%, or a suspect")
    aims = asked.make_aims(requested, suspicion, craft.params, asked.AimSettings(base.faults, margin, False))
    flow = float(np.median(craft.flows[craft.jets]))
    cost = Cost(1.0 / flow, crafts.SECOND) if spare == "propellant" else Cost(crafts.SECOND / flow, 1.0)
    task = Task(
        craft,
        Known(*prior_information(state.joint, craft.params)),
        aims,
        asked.parse_limits(limits or {}, vehicle),
        cost,
        margin,
    )
    firing_sets = jet_sets(craft)
    floors = reach.require_within_reach(firing_sets, task, (requested, suspicion), vehicle)
    reach.require_allowed_firing(firing_sets, task, limits or {})
    choice = characterize_actions(candidate_actions(firing_sets, craft), task)
    converging_aims = asked.make_aims(requested, suspicion, craft.params, asked.AimSettings(base.faults, margin, True))
    result, task = _search_plan(choice, task, converging_aims, len(requested))
    reach.require_reached(result.plan, task, (requested, suspicion), vehicle, limits or {})
    maneuver = writing.make_design(result, task, writing.DesignRequest(requested, suspicion, floors, hold), base, run)
    return fly_design(maneuver, requested, vehicle, flights) if flights else maneuver


def _search_plan(candidates: Choice, task: Task, converging_aims: Aims, n_targets: int) -> tuple[SearchResult, Task]:
    """Returns the plan of least cost and its task; searches anew, products of errors as noise, if convergence is late.

    Where estimates converge, a start is gone over until products of errors do not matter. Where they would not, by a
    filter to which these are noise, the plan is that of such a filter.

    Args:
        candidates: of actions.
        task: see `Task`.
        converging_aims: its aims, and then convergence.
        n_targets: number of targets among them.
    """
    result = search_best_plan(candidates, task)
    if result.plan.reached[-1].shortfall > 0.0:
        return result, task
    doubting_task = task._replace(doubting=True)
    rebuilt = rebuild_plan(result.plan.actions, 1, result.plan, doubting_task)
    assert rebuilt is not None  # what is noise moves nothing
    ratios = compare_with_aims(rebuilt.flown[-1].course.shown, task.known, converging_aims).ratios[
        n_targets : converging_aims.deviations.size
    ]
    if (ratios < _EARLY).all():
        return result, task
    return search_best_plan(candidates, doubting_task), doubting_task


def _default_scenario(vehicle: Vehicle) -> Scenario:
    """Makes a scenario of a vehicle with default settings, and thrusts dispersed by the file's uncertainty."""
    return Scenario(vehicle=vehicle, plant=PlantBlock(thrust_dispersion=float(vehicle.thrust_uncertainties.max())))


def _joint_filter_scenario(scenario: Scenario) -> Scenario:
    """Returns the scenario with the joint filter, its failures and jumps removed."""
    if scenario.vehicle_data.needs_pose_filter:
        raise InputError(
            f"design: vehicle '{scenario.vehicle_data.name}' is estimated in a fixed frame, by estimation.filter: "
            "pose; maneuvers are designed for vehicles that have gyros and no position sensor"
        )
    changed: dict[str, Any] = {"failures": (), "engine_failures": (), "jumps": ()}
    if scenario.estimation.filter != "joint":
        changed["estimation"] = scenario.estimation.model_copy(update={"filter": "joint"})
        changed["detector"] = HypothesesBlock()
    return scenario.model_copy(update=changed)


def _craft_and_filter(scenario: Scenario, run: Run | None, excluded: Sequence[str]) -> tuple[Craft, JointFilterState]:
    """Returns the vehicle model for planning, and the joint filter's state before the maneuver."""
    vehicle = scenario.vehicle_data
    for name in excluded:
        if name not in vehicle.designations:
            raise InputError(f"design: without '{name}': no such jet{suggestion(name, vehicle.designations)}")
    craft, params = crafts.make_craft(scenario, frozenset(excluded)), inputs.estimation_params(scenario)
    if craft.jets.size == 0 and not craft.torques.any():
        raise InputError("design: without: leaves no jet to fire")
    if run is None:
        return craft, initial_state(params.filter_params)
    state = state_from_json(run.state["states"], params, STATE_FILE).filter
    speeds = np.where(np.isnan(state.speeds), craft.speeds, state.speeds)
    properties = np.where(np.isnan(state.estimate), craft.properties, state.estimate)  # mass that no sensor shows
    return craft._replace(rate=state.joint.mean[RATE], properties=properties, speeds=speeds), state

"""Checks of a scenario against its vehicle."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Literal

import numpy as np

from massprop_drake.errors import moment, suggestion
from massprop_drake.inputs import plausible
from massprop_drake.inputs.estimation_blocks import FaultsBlock
from massprop_drake.inputs.moving import moving_parts_problem
from massprop_drake.inputs.scheduled import jump_terms
from massprop_drake.inputs.true_blocks import PlantBlock
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.inputs.yaml import FieldPath
from massprop_drake.maths.mass_properties import attach_body, is_possible_inertia
from massprop_drake.maths.vehicle.on_times import pulse_samples

if TYPE_CHECKING:
    from massprop_drake.inputs.scenario import Scenario


def check_against_vehicle(scenario: Scenario, vehicle: Vehicle) -> list[tuple[FieldPath, str]]:
    """Finds the problems of a scenario that only show against its vehicle, each with the path of its field."""
    outside = plausible.out_of_span(scenario, vehicle.units, skipped=("vehicle",))
    problems = [(finding.path, finding.problem) for finding in outside]
    if problems:  # nothing can be reckoned with such numbers
        return problems

    def require(what: str, name: str, valid: Iterable[str], *path: str | int) -> None:
        names = list(valid)
        if name not in names:
            problem = f"{name!r} is no {what} of vehicle '{vehicle.name}'{suggestion(name, names)}"
            problems.append((path, problem))

    problems.extend(_filter_problems(scenario, vehicle))
    problems.extend(_moving_part_problems(scenario, vehicle))
    known = {
        "jet": vehicle.designations,
        "wheel": tuple(wheel.name for wheel in vehicle.wheels),
        "engine": tuple(engine.name for engine in vehicle.engines),
        "tank": tuple(tank.name for tank in vehicle.tanks),
    }
    for what, name, path in _named_components(scenario):
        require(what, name, known[what], *path)
    problems.extend(_double_opening_problems(scenario, vehicle))
    problems.extend(_gimbal_problems(scenario, vehicle))
    problems.extend(_payload_problems(scenario, vehicle))
    faulty: list[str] = []
    for index, errors in enumerate(scenario.sensors.errors):
        require("sensor", errors.sensor, vehicle.sensor_names(), "sensors", "errors", index, "sensor")
        if errors.sensor in faulty:
            problem = f"'{errors.sensor}' has errors already; give one entry"
            problems.append((("sensors", "errors", index, "sensor"), problem))
        faulty.append(errors.sensor)
    if scenario.sensors.gyro is not None:
        require("gyro", scenario.sensors.gyro, (gyro.name for gyro in vehicle.gyros), "sensors", "gyro")
    if scenario.sensors.accelerometer is not None:
        packages = (package.name for package in vehicle.accelerometers)
        require("accelerometer", scenario.sensors.accelerometer, packages, "sensors", "accelerometer")
    for index, kind in enumerate((scenario.autopilot.jet_kinds or ()) if not scenario.open_loop else ()):
        require("jet kind", kind, vehicle.jet_kinds, "autopilot", "jet_kinds", index)
    for name in scenario.faults.jets:
        require("jet", name, vehicle.designations, "faults", "jets", name)
    problems.extend(_on_time_problems(scenario, vehicle))
    problems.extend(_wheel_problems(scenario, vehicle))
    problems.extend(_test_firing_problems(scenario))
    problems.extend(_fault_rate_problems(scenario.faults, vehicle))
    period = vehicle.sample_period_s
    problems.extend(_plant_problems(scenario, vehicle))
    if vehicle.motion == "planar" and isinstance(scenario.plant, PlantBlock) and scenario.plant.dispersion.axes_deg:
        problem = f"vehicle '{vehicle.name}' moves in a plane, in which its axes do not tilt; leave it out"
        problems.append((("plant", "dispersion", "axes_deg"), problem))
    if scenario.duration_s < period:
        problems.append((("duration_s",), f"must be at least one sample period, {period:g} s"))
    if not problems:
        found = plausible.scenario_findings(scenario, vehicle)
        problems.extend((finding.path, finding.problem) for finding in found if finding.impossible)
    return problems


def _fault_rate_problems(faults: FaultsBlock, vehicle: Vehicle) -> Iterator[tuple[FieldPath, str]]:
    """Finds rates by which more than one event is expected in a sample period."""
    period, components = vehicle.sample_period_s, 3 * (len(vehicle.gyros) + len(vehicle.accelerometers))
    own = [jet.per_hour for jet in faults.jets.values() if jet.per_hour is not None]
    of_jets = sum(own) + (len(vehicle.jets) - len(own)) * faults.jet_per_hour
    total = of_jets + faults.payload_per_hour + components * faults.reading_per_hour + faults.unknown_per_hour
    most = 3600.0 / period
    if total > most:
        parts = f"{len(vehicle.jets)} jets, payloads, {components} components and what is unknown"
        problem = (
            f"rates of {parts} sum to {total:.3g} per hour, {total / most:.3g} events in a sample period of {period:g} "
            f"s; at most one, {most:.3g} per hour"
        )
        yield ("faults",), problem
    if faults.change_per_hour > most:
        problem = (
            f"{faults.change_per_hour:.3g} is {faults.change_per_hour / most:.3g} changes in a sample period of "
            f"{period:g} s; at most one, {most:.3g} per hour"
        )
        yield ("faults", "change_per_hour"), problem


def _on_time_problems(scenario: Scenario, vehicle: Vehicle) -> Iterator[tuple[FieldPath, str]]:
    """Finds on-times to be flown with jets that do not take them, or whose clock is too coarse."""
    if scenario.open_loop or scenario.autopilot.jet_selection.output != "on_time":
        return
    path: FieldPath = ("autopilot", "jet_selection", "output")
    if not vehicle.has_on_times:
        problem = (
            f"on_time does not go with vehicle '{vehicle.name}', whose commands of jets are levels; use cycles, or "
            "give the vehicle jet_commands: {as: on_time}"
        )
        yield path, problem
    for name, kind in vehicle.jet_kinds.items():
        if kind.on_time_quantum_s > vehicle.sample_period_s:
            problem = (
                f"on_time does not go with jets of kind '{name}', whose on_time_quantum_s of "
                f"{kind.on_time_quantum_s:g} s is longer than a sample, {vehicle.sample_period_s:g} s"
            )
            yield path, problem


def _test_firing_problems(scenario: Scenario) -> Iterator[tuple[FieldPath, str]]:
    """Finds reasons for which an autopilot cannot fly test firings."""
    path: FieldPath = ("autopilot", "test_firing")
    if scenario.autopilot.test_firing is None:
        return
    if scenario.jet_schedule:
        yield path, "does not go with jet_schedule, which prescribes jets as well; leave out one of the two"
    elif scenario.open_loop:
        yield path, "needs an autopilot; leave out autopilot.engaged: false"


def _wheel_problems(scenario: Scenario, vehicle: Vehicle) -> Iterator[tuple[FieldPath, str]]:
    """Finds reasons for which wheels cannot turn the vehicle, and wheels that start faster than they can turn."""
    speeds = scenario.plant.wheel_speeds
    for wheel in vehicle.wheels:
        if abs(speeds.get(wheel.name, 0.0)) > wheel.fastest:
            problem = f"{speeds[wheel.name]:g} is beyond the wheel's speed_limit, {wheel.fastest:g} rad/s"
            yield ("plant", "wheel_speeds", wheel.name), problem
    block, path = scenario.autopilot.wheels, ("autopilot", "wheels")
    if block is None:
        return
    if scenario.open_loop:
        yield path, "does not go with jet_schedule without an autopilot; leave it out, or set autopilot.engaged: true"
    if scenario.wheel_schedule:
        yield ("wheel_schedule",), "does not go with autopilot.wheels, which turns the wheels; leave out one of the two"
    axes = np.array([wheel.axis for wheel in vehicle.wheels]).reshape(-1, 3)
    if np.linalg.matrix_rank(axes, tol=0.01) < 3:
        problem = f"needs wheels about three axes, of which vehicle '{vehicle.name}' has {len(axes) or 'none'}"
        yield path, problem
    endless = [wheel.name for wheel in vehicle.wheels if wheel.speed_limit is None]
    if block.unload_above is not None and endless:
        problem = f"is a share of a wheel's speed_limit, which the vehicle does not give for '{endless[0]}'"
        yield (*path, "unload_above"), problem


def _plant_problems(scenario: Scenario, vehicle: Vehicle) -> Iterator[tuple[FieldPath, str]]:
    """Finds entries that do not go with the kind of the plant, or with its time step."""
    period, loop = vehicle.sample_period_s, scenario.execution.engine == "loop"
    covers = "loop does not cover a continuous plant, whose steps are Drake's; use diagram"
    if isinstance(scenario.plant, PlantBlock):
        step = scenario.plant.time_step
        if step not in (None, 0.0) and not math.isclose(step, period, rel_tol=1e-12):
            problem = f"must be 0 (continuous) or the vehicle's sample period, {period:g} s; got {step:g}"
            yield ("plant", "time_step"), problem
        if step == 0.0 and loop:
            yield ("execution", "engine"), f"{covers}, or leave out plant.time_step"
        yield from _true_tank_problems(scenario.plant, vehicle)
        return
    if loop:
        yield ("execution", "engine"), covers
    if scenario.jumps:
        problem = "a multibody plant knows no payload that leaves or comes; leave them out, or use plant.kind: rigid"
        yield ("jumps",), problem
    if vehicle.motion == "planar":
        problem = f"multibody does not go with vehicle '{vehicle.name}', which moves in a plane; use rigid"
        yield ("plant", "kind"), problem
    if vehicle.engines:
        problem = (
            f"multibody does not go with vehicle '{vehicle.name}', whose engines are no part of a model; use rigid"
        )
        yield ("plant", "kind"), problem
    if vehicle.tanks:
        problem = f"multibody does not go with vehicle '{vehicle.name}', whose tanks no firing empties; use rigid"
        yield ("plant", "kind"), problem


def _true_tank_problems(plant: PlantBlock, vehicle: Vehicle) -> Iterator[tuple[FieldPath, str]]:
    """Finds more propellant in a true tank than it holds, or less than none."""
    for tank in vehicle.tanks:
        held = plant.propellant.get(tank.name, tank.propellant)
        if not 0.0 <= held <= tank.capacity:
            problem = f"must be between 0 and the tank's capacity, {tank.capacity:g}, got {held:g}"
            yield ("plant", "propellant", tank.name), problem


def _filter_problems(scenario: Scenario, vehicle: Vehicle) -> Iterator[tuple[FieldPath, str]]:
    """Finds a filter that does not go with the vehicle's moving parts, wheels, engines, tanks or pose sensors."""
    named = scenario.estimation.filter
    if scenario.moving and named != "joint":
        yield ("moving",), f"plays no part in estimation.filter: {named}; use joint, or leave it out"
    if vehicle.wheels and named != "joint":
        yield ("estimation", "filter"), f"{named} knows no wheels, which vehicle '{vehicle.name}' has; use joint"
    elif scenario.engine_schedule and named != "joint":
        yield ("estimation", "filter"), f"{named} knows no engines, which engine_schedule burns; use joint"
    elif vehicle.tanks and named != "joint":
        yield ("estimation", "filter"), f"{named} knows no tanks, which vehicle '{vehicle.name}' has; use joint"
    elif vehicle.needs_pose_filter != (named == "pose") and not (vehicle.tracked and named == "pose"):
        needs = "which needs pose" if vehicle.needs_pose_filter else "which has no pose or velocity sensor; use joint"
        yield ("estimation", "filter"), f"{named} does not go with vehicle '{vehicle.name}', {needs}"


def _named_components(scenario: Scenario) -> Iterator[tuple[Literal["jet", "wheel", "engine", "tank"], str, FieldPath]]:
    """Yields the jets, wheels, engines and tanks that a scenario names, and where."""
    for index, pulse in enumerate(scenario.jet_schedule):
        yield "jet", pulse.jet, ("jet_schedule", index, "jet")
    for index, failure in enumerate(scenario.failures):
        yield "jet", failure.jet, ("failures", index, "jet")
    for index, turn in enumerate(scenario.wheel_schedule):
        yield "wheel", turn.wheel, ("wheel_schedule", index, "wheel")
    for name in scenario.plant.wheel_speeds:
        yield "wheel", name, ("plant", "wheel_speeds", name)
    for index, burn in enumerate(scenario.engine_schedule):
        yield "engine", burn.engine, ("engine_schedule", index, "engine")
    for index, lost in enumerate(scenario.engine_failures):
        yield "engine", lost.engine, ("engine_failures", index, "engine")
    if isinstance(scenario.plant, PlantBlock):
        for name in scenario.plant.engine_errors:
            yield "engine", name, ("plant", "engine_errors", name)
        for name in scenario.plant.propellant:
            yield "tank", name, ("plant", "propellant", name)


def _gimbal_problems(scenario: Scenario, vehicle: Vehicle) -> Iterator[tuple[FieldPath, str]]:
    """Finds angles that the gimbal of an engine does not reach."""
    stops = {engine.name: 0.0 if engine.gimbal is None else engine.gimbal.stop for engine in vehicle.engines}
    for index, burn in enumerate(scenario.engine_schedule):
        most = stops.get(burn.engine, math.inf)
        if max(map(abs, burn.gimbal)) > most:
            at = f"its gimbal's stop is at {most:g} rad" if most else "it has no gimbal"
            yield ("engine_schedule", index, "gimbal"), f"{max(map(abs, burn.gimbal)):g} rad for {burn.engine}: {at}"


def _double_opening_problems(scenario: Scenario, vehicle: Vehicle) -> Iterator[tuple[FieldPath, str]]:
    """Finds pulses that open a jet a second time in a sample: a command holds one opening."""
    if not vehicle.has_on_times:
        return
    period_s, before = vehicle.sample_period_s, dict[tuple[str, int], int]()
    for index, pulse in enumerate(scenario.jet_schedule):
        first, end = pulse_samples(pulse.start_s, pulse.end_s, period_s)
        for sample in {first, end - 1} if end > first else ():
            if (pulse.jet, sample) in before:
                other = f"jet_schedule[{before[pulse.jet, sample]}]"
                yield (
                    ("jet_schedule", index),
                    f"opens {pulse.jet} a second time in the sample from {moment(sample * period_s)} s on, beside "
                    f"{other}; a jet opens once in a sample of {period_s:g} s",
                )
                break
            before[pulse.jet, sample] = index


def _moving_part_problems(scenario: Scenario, vehicle: Vehicle) -> Iterator[tuple[FieldPath, str]]:
    """Yields problems of parts that move inside, with those of the vehicle."""
    nominal, every = vehicle.nominal, (*vehicle.moving, *scenario.moving)
    known = nominal.mass, nominal.center_of_mass, nominal.inertia
    if scenario.moving and (problem := moving_parts_problem(every, known, vehicle.sample_period_s)):
        yield ("moving",), problem


def _payload_problems(scenario: Scenario, vehicle: Vehicle) -> list[tuple[FieldPath, str]]:
    """Finds a payload whose arrival or departure would leave an impossible body."""
    if not isinstance(scenario.plant, PlantBlock):
        return []
    properties = scenario.plant.mass_properties
    body = vehicle.nominal if properties is None else properties.properties()
    order = sorted(range(len(scenario.jumps)), key=lambda index: scenario.jumps[index].time_s)
    for index in order:
        jump = scenario.jumps[index]
        mass, position, inertia = jump_terms(jump)
        if body.mass + mass <= 0.0:
            return [(("jumps", index, "mass"), f"releases {-mass:g} of a vehicle that has {body.mass:g} left")]
        body = attach_body(body, mass, position, inertia)
        if not is_possible_inertia(body.inertia):
            problem = "leaves an inertia that no rigid body has; check mass, position and inertia"
            return [(("jumps", index), problem)]
        for finding in plausible.body_findings(body, vehicle, ("jumps", index)):
            if finding.impossible:
                return [(finding.path, f"leaves a body of which this {finding.problem}")]
    return []

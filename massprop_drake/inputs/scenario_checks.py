"""Checks of a scenario: what overlaps, what does not go with its vehicle, and probable slips."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from massprop_drake.errors import moment, suggestion
from massprop_drake.inputs.model import span_of
from massprop_drake.inputs.moving import join_parts, moving_parts_problem
from massprop_drake.inputs.plausible import Finding, compare_with_span, finding_above, out_of_span
from massprop_drake.inputs.scenario_fields import ScenarioFields
from massprop_drake.inputs.scheduled import find_overlaps, jump_terms
from massprop_drake.inputs.true_blocks import PlantBlock
from massprop_drake.inputs.vehicle_checks import Problem, body_findings, sharpness_findings
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.inputs.yaml import FieldPath
from massprop_drake.maths.mass_properties import attach_body, initial_standard_deviation, is_possible_inertia
from massprop_drake.maths.vehicle.on_times import pulse_samples

_HALF_TURN = math.pi  # rad, in a sample
_LEAKIEST, _LEAKY = 10.0, 1.0  # force of a leak over the jet's thrust
_MOST_SAMPLES = 1e8


def schedule_problems(scenario: ScenarioFields) -> Iterator[Problem]:
    """Yields problems of commands and failures that overlap, and of a maneuver without an autopilot."""
    if scenario.maneuver and scenario.open_loop:
        problem = (
            "a maneuver is flown by the autopilot, which does not fly: leave out either maneuver or jet_schedule, "
            "or set autopilot.engaged: true, for both"
        )
        yield (), problem
    windows = {
        "maneuver": [(f"{w.controller} {w.axis[1]}", w.start_s, w.end_s) for w in scenario.maneuver],
        "failures": [(f.jet, f.start_s, f.end_s or math.inf) for f in scenario.failures],
        "jet_schedule": [(p.jet, p.start_s, p.end_s) for p in scenario.jet_schedule],
        "wheel_schedule": [(p.wheel, p.start_s, p.end_s) for p in scenario.wheel_schedule],
        "engine_schedule": [(p.engine, p.start_s, p.end_s) for p in scenario.engine_schedule],
        "engine_failures": [(f"{f.engine} {f.kind}", f.start_s, f.end_s or math.inf) for f in scenario.engine_failures],
    }
    for field, entries in windows.items():
        yield from find_overlaps(field, entries)


def check_against_vehicle(scenario: ScenarioFields, vehicle: Vehicle) -> list[Problem]:
    """Lists the problems of a scenario that only show against its vehicle, pairs of field path and sentence."""
    findings = out_of_span(scenario, vehicle.units, skipped=("vehicle",))
    if problems := [(finding.path, finding.problem) for finding in findings]:
        return problems  # nothing can be reckoned with such numbers
    checks = (
        *(_filter_problems, _unknown_names, _moving_part_problems, _double_opening_problems, _gimbal_problems),
        *(_payload_problems, _on_time_problems, _wheel_problems, _test_firing_problems, _fault_rate_problems),
        *(_plant_problems, _impossible_runs),
    )
    for find in checks:
        if find is not _impossible_runs or not problems:
            problems += find(scenario, vehicle)
    return problems


def _impossible_runs(scenario: ScenarioFields, vehicle: Vehicle) -> Iterator[Problem]:
    """Yields the impossible findings of a scenario as problems, pairs of field path and sentence."""
    return ((finding.path, finding.problem) for finding in scenario_findings(scenario, vehicle) if finding.impossible)


def _unknown_names(scenario: ScenarioFields, vehicle: Vehicle) -> Iterator[Problem]:
    """Yields problems of named components that the vehicle lacks, and of a sensor with two entries of errors."""
    known = {
        "jet": vehicle.designations,
        "jet kind": vehicle.jet_kinds,
        "sensor": vehicle.sensor_names(),
        **{
            kind: [component.name for component in getattr(vehicle, f"{kind}s")]
            for kind in ("wheel", "engine", "tank", "gyro", "accelerometer")
        },
    }
    for kind, name, path in _named_components(scenario):
        if name not in known[kind]:
            yield path, f"{name!r} is no {kind} of vehicle '{vehicle.name}'{suggestion(name, known[kind])}"
    faulty = [errors.sensor for errors in scenario.sensors.errors]
    for index, name in enumerate(faulty):
        if name in faulty[:index]:
            yield ("sensors", "errors", index, "sensor"), f"'{name}' has errors already; give one entry"


def _named_components(scenario: ScenarioFields) -> Iterator[tuple[str, str, FieldPath]]:
    """Yields kind, name and field path of each component that a scenario names."""
    for field, kind in (
        ("jet_schedule", "jet"),
        ("failures", "jet"),
        ("wheel_schedule", "wheel"),
        ("engine_schedule", "engine"),
        ("engine_failures", "engine"),
    ):
        for index, entry in enumerate(getattr(scenario, field)):
            yield kind, getattr(entry, kind), (field, index, kind)
    for index, errors in enumerate(scenario.sensors.errors):
        yield "sensor", errors.sensor, ("sensors", "errors", index, "sensor")
    for kind in ("gyro", "accelerometer"):
        if (name := getattr(scenario.sensors, kind)) is not None:
            yield kind, name, ("sensors", kind)
    if not scenario.open_loop:
        for index, name in enumerate(scenario.autopilot.jet_kinds or ()):
            yield "jet kind", name, ("autopilot", "jet_kinds", index)
    for path, kind in (
        (("faults", "jets"), "jet"),
        (("plant", "wheel_speeds"), "wheel"),
        (("plant", "engine_errors"), "engine"),  # of a rigid plant alone, as the next
        (("plant", "propellant"), "tank"),
    ):
        for name in getattr(getattr(scenario, path[0]), path[1], ()):
            yield kind, name, (*path, name)


def _fault_rate_problems(scenario: ScenarioFields, vehicle: Vehicle) -> Iterator[Problem]:
    """Yields problems of fault rates by which more than one event is expected in a sample period."""
    faults = scenario.faults
    period, components = vehicle.sample_period_s, 3 * (len(vehicle.gyros) + len(vehicle.accelerometers))
    stated_rates = [jet.per_hour for jet in faults.jets.values() if jet.per_hour is not None]
    of_jets = sum(stated_rates) + (len(vehicle.jets) - len(stated_rates)) * faults.jet_per_hour
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
        rate, limit = f"{faults.change_per_hour:.3g}", f"at most one, {most:.3g} per hour"
        problem = f"{rate} is {faults.change_per_hour / most:.3g} changes in a sample period of {period:g} s; {limit}"
        yield ("faults", "change_per_hour"), problem


def _on_time_problems(scenario: ScenarioFields, vehicle: Vehicle) -> Iterator[Problem]:
    """Yields problems of on-times for jets commanded by levels, or whose on-time quantum exceeds a sample."""
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


def _test_firing_problems(scenario: ScenarioFields, _vehicle: Vehicle) -> Iterator[Problem]:
    """Yields a problem where the autopilot cannot fly test firings."""
    path: FieldPath = ("autopilot", "test_firing")
    if scenario.autopilot.test_firing is None:
        return
    if scenario.jet_schedule:
        yield path, "does not go with jet_schedule, which prescribes jets as well; leave out one of the two"
    elif scenario.open_loop:
        yield path, "needs an autopilot; leave out autopilot.engaged: false"


def _wheel_problems(scenario: ScenarioFields, vehicle: Vehicle) -> Iterator[Problem]:
    """Yields problems of wheels that cannot turn the vehicle, or start faster than their speed limit."""
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
        yield path, f"needs wheels about three axes, of which vehicle '{vehicle.name}' has {len(axes) or 'none'}"
    endless = [wheel.name for wheel in vehicle.wheels if wheel.speed_limit is None]
    if block.unload_above is not None and endless:
        problem = f"is a share of a wheel's speed_limit, which the vehicle does not give for '{endless[0]}'"
        yield (*path, "unload_above"), problem


def _plant_problems(scenario: ScenarioFields, vehicle: Vehicle) -> Iterator[Problem]:
    """Yields problems of a run shorter than a sample, and of entries that misfit the plant's kind or step."""
    period, loop = vehicle.sample_period_s, scenario.execution.engine == "loop"
    if scenario.duration_s < period:
        yield ("duration_s",), f"must be at least one sample period, {period:g} s"
    covers = "loop does not cover a continuous plant, whose steps are Drake's; use diagram"
    if isinstance(scenario.plant, PlantBlock):
        step = scenario.plant.time_step
        if step not in (None, 0.0) and not math.isclose(step, period, rel_tol=1e-12):
            problem = f"must be 0 (continuous) or the vehicle's sample period, {period:g} s; got {step:g}"
            yield ("plant", "time_step"), problem
        if step == 0.0 and loop:
            yield ("execution", "engine"), f"{covers}, or leave out plant.time_step"
        for tank in vehicle.tanks:
            propellant = scenario.plant.propellant.get(tank.name, tank.propellant)
            if not 0.0 <= propellant <= tank.capacity:
                problem = f"must be between 0 and the tank's capacity, {tank.capacity:g}, got {propellant:g}"
                yield ("plant", "propellant", tank.name), problem
        if vehicle.motion == "planar" and scenario.plant.dispersion.axes_deg:
            problem = f"vehicle '{vehicle.name}' moves in a plane, in which its axes do not tilt; leave it out"
            yield ("plant", "dispersion", "axes_deg"), problem
        return
    if loop:
        yield ("execution", "engine"), covers
    if scenario.jumps:
        problem = "a multibody plant knows no payload that leaves or comes; leave them out, or use plant.kind: rigid"
        yield ("jumps",), problem
    for applies, reason in (
        (vehicle.motion == "planar", "which moves in a plane"),
        (vehicle.engines, "whose engines are no part of a model"),
        (vehicle.tanks, "whose tanks no firing empties"),
    ):
        if applies:
            yield ("plant", "kind"), f"multibody does not go with vehicle '{vehicle.name}', {reason}; use rigid"


def _filter_problems(scenario: ScenarioFields, vehicle: Vehicle) -> Iterator[Problem]:
    """Yields problems of a filter that cannot handle the vehicle's wheels, engines, tanks or pose sensors."""
    filter_name = scenario.estimation.filter
    if scenario.moving and filter_name != "joint":
        yield ("moving",), f"plays no part in estimation.filter: {filter_name}; use joint, or leave it out"
    if vehicle.wheels and filter_name != "joint":
        yield ("estimation", "filter"), f"{filter_name} knows no wheels, which vehicle '{vehicle.name}' has; use joint"
    elif scenario.engine_schedule and filter_name != "joint":
        yield ("estimation", "filter"), f"{filter_name} knows no engines, which engine_schedule burns; use joint"
    elif vehicle.tanks and filter_name != "joint":
        yield ("estimation", "filter"), f"{filter_name} knows no tanks, which vehicle '{vehicle.name}' has; use joint"
    elif vehicle.needs_pose_filter != (filter_name == "pose") and not (vehicle.tracked and filter_name == "pose"):
        needs = "which needs pose" if vehicle.needs_pose_filter else "which has no pose or velocity sensor; use joint"
        yield ("estimation", "filter"), f"{filter_name} does not go with vehicle '{vehicle.name}', {needs}"


def _gimbal_problems(scenario: ScenarioFields, vehicle: Vehicle) -> Iterator[Problem]:
    """Yields a problem for each burn whose gimbal angles are beyond the engine's stop."""
    stops = {engine.name: 0.0 if engine.gimbal is None else engine.gimbal.stop for engine in vehicle.engines}
    for index, burn in enumerate(scenario.engine_schedule):
        stop = stops.get(burn.engine, math.inf)
        if max(map(abs, burn.gimbal)) > stop:
            why = f"its gimbal's stop is at {stop:g} rad" if stop else "it has no gimbal"
            yield ("engine_schedule", index, "gimbal"), f"{max(map(abs, burn.gimbal)):g} rad for {burn.engine}: {why}"


def _double_opening_problems(scenario: ScenarioFields, vehicle: Vehicle) -> Iterator[Problem]:
    """Yields a problem for each pulse that opens a jet a second time in a sample: a command holds one opening."""
    if not vehicle.has_on_times:
        return
    period_s, opened_by = vehicle.sample_period_s, dict[tuple[str, int], int]()
    for index, pulse in enumerate(scenario.jet_schedule):
        first, end = pulse_samples(pulse.start_s, pulse.end_s, period_s)
        for sample in {first, end - 1} if end > first else ():
            if (pulse.jet, sample) in opened_by:
                earlier_pulse = f"jet_schedule[{opened_by[pulse.jet, sample]}]"
                yield (
                    ("jet_schedule", index),
                    f"opens {pulse.jet} a second time in the sample from {moment(sample * period_s)} s on, beside "
                    f"{earlier_pulse}; a jet opens once in a sample of {period_s:g} s",
                )
                break
            opened_by[pulse.jet, sample] = index


def _moving_part_problems(scenario: ScenarioFields, vehicle: Vehicle) -> Iterator[Problem]:
    """Yields the problem of sloshing masses and panels that a filter cannot estimate with the vehicle's own."""
    nominal, parts = vehicle.nominal, join_parts(vehicle.moving, scenario.moving)
    known = nominal.mass, nominal.center_of_mass, nominal.inertia
    if scenario.moving and (problem := moving_parts_problem(parts, known, vehicle.sample_period_s)):
        yield ("moving",), problem


def _payload_problems(scenario: ScenarioFields, vehicle: Vehicle) -> Iterator[Problem]:
    """Yields the problem of the first payload whose arrival or departure leaves an impossible body."""
    if not isinstance(scenario.plant, PlantBlock):
        return
    properties = scenario.plant.mass_properties
    body = vehicle.nominal if properties is None else properties.properties()
    for index, jump in sorted(enumerate(scenario.jumps), key=lambda entry: entry[1].time_s):
        mass, position, inertia = jump_terms(jump)
        if body.mass + mass <= 0.0:
            yield ("jumps", index, "mass"), f"releases {-mass:g} of a vehicle that has {body.mass:g} left"
            return
        body = attach_body(body, mass, position, inertia)
        if not is_possible_inertia(body.inertia):
            yield ("jumps", index), "leaves an inertia that no rigid body has; check mass, position and inertia"
            return
        for finding in body_findings(body, vehicle, ("jumps", index)):
            if finding.impossible:
                yield finding.path, f"leaves a body of which this {finding.problem}"
                return


def scenario_findings(scenario: ScenarioFields, vehicle: Vehicle) -> Iterator[Finding]:
    """Yields findings of impossible or doubtful entries of a scenario, whose keys are each within their span."""
    sensor_findings = list(_errors_out_of_bounds(scenario, vehicle))
    yield from sensor_findings
    if not sensor_findings:
        yield from _fast_rates(scenario, vehicle)
        properties = getattr(scenario.plant, "mass_properties", None)  # a multibody plant's stand in its model
        if properties is not None:
            yield from body_findings(properties.properties(), vehicle, ("plant", "mass_properties"))
        yield from _strong_disturbances(scenario, vehicle)
        yield from _strong_leaks(scenario, vehicle)
        yield from _late_events(scenario)
        yield from _short_pulses(scenario, vehicle)
        yield from _large_process_noise(scenario, vehicle)
        samples = scenario.duration_s / vehicle.sample_period_s
        problem = f"is {samples:.3g} samples of {vehicle.sample_period_s:g} s; expected {_MOST_SAMPLES:g} at the most"
        yield from finding_above(samples, _MOST_SAMPLES, _MOST_SAMPLES, ("duration_s",), problem)
        disturbances = (scenario.rotation.disturbance_std, scenario.mass.disturbance_std)
        with np.errstate(over="ignore", invalid="ignore"):  # what a file gives may be beyond all numbers
            covariance = scenario.estimation.initial_covariance(vehicle) + np.diag(
                np.square(scenario.process_noise_std)
            )
            findings = list(sharpness_findings(vehicle, covariance, disturbances, ("estimation",)))
        yield from findings


def _errors_out_of_bounds(scenario: ScenarioFields, vehicle: Vehicle) -> Iterator[Finding]:
    """Yields findings of true sensor errors outside the spans that hold for the vehicle file's."""
    sensors = {sensor.name: sensor for sensor in vehicle.sensors}
    for index, errors in enumerate(scenario.sensors.errors):
        span, unit = span_of(type(sensors[errors.sensor]).model_fields["noise_std"])
        assert span is not None
        for field in ("noise_std", "quantum", "bias", "bias_random_walk"):
            bounds = span if field in ("noise_std", "quantum") else span._replace(least=0.0)
            path = ("sensors", "errors", index, field)
            yield from compare_with_span(getattr(errors, field), bounds, unit, vehicle.units, path)
        for number, tone in enumerate(errors.vibration):
            tone_path = ("sensors", "errors", index, "vibration", number, "amplitude")
            yield from compare_with_span(tone.amplitude, span._replace(least=0.0), unit, vehicle.units, tone_path)


def _fast_rates(scenario: ScenarioFields, vehicle: Vehicle) -> Iterator[Finding]:
    """Yields findings of rates that turn the vehicle further in a sample than a filter can use."""
    usable, period = scenario.rotation.largest_turn, vehicle.sample_period_s
    for path, rate in (
        (("plant", "initial_rate"), float(np.linalg.norm(scenario.plant.initial_rate))),
        (("autopilot", "discrete_rate"), scenario.autopilot.discrete_rate),
    ):
        turn = rate * period
        problem = (
            f"turns the vehicle by {turn:.3g} rad in a sample of {period:g} s; up to {usable:g} "
            "a sample is used, and beyond half a turn none could be"
        )
        yield from finding_above(turn, min(usable, _HALF_TURN), _HALF_TURN, path, problem)


def _strong_disturbances(scenario: ScenarioFields, vehicle: Vehicle) -> Iterator[Finding]:
    """Yields findings of disturbance torques and forces above those of the vehicle's strongest jet."""
    disturbance = scenario.plant.disturbance
    torques = np.cross(vehicle.positions - vehicle.nominal.center_of_mass, vehicle.thrusts)
    of_torque = "ft-lbf" if vehicle.units == "us" else "N-m"
    for field, gives, unit in (("torque", torques, of_torque), ("force", vehicle.thrusts, vehicle.unit_names["force"])):
        largest = float(np.linalg.norm(gives, axis=1).max())
        mean, std = (np.array(getattr(disturbance, name)) for name in (field, f"{field}_std"))
        size = float(np.hypot(np.linalg.norm(mean), np.linalg.norm(std)))
        problem = f"with what changes in it is {size:.3g} {unit}, and the strongest jet gives {largest:.3g}"
        yield from finding_above(size, largest, math.inf, ("plant", "disturbance", field), problem)


def _strong_leaks(scenario: ScenarioFields, vehicle: Vehicle) -> Iterator[Finding]:
    """Yields findings of leak forces above the jet's thrust: a leak is flow past a closed valve."""
    for index, failure in enumerate(scenario.failures):
        force = getattr(failure, "force", 0.0)
        thrust = vehicle.jets[vehicle.jet_index(failure.jet)].thrust
        problem = (
            f"is {force / thrust:.3g} times the thrust of jet {failure.jet!r}, {thrust:g}; a leak gives a part of it"
        )
        yield from finding_above(force / thrust, _LEAKY, _LEAKIEST, ("failures", index, "force"), problem)


def _late_events(scenario: ScenarioFields) -> Iterator[Finding]:
    """Yields doubts of commands and events that start after the end of the run, which do nothing."""
    end = scenario.duration_s
    for field, key in (
        ("maneuver", "start_s"),
        ("jet_schedule", "start_s"),
        ("failures", "start_s"),
        ("jumps", "time_s"),
    ):
        starts = [getattr(entry, key) for entry in getattr(scenario, field)]
        late = [index for index, start in enumerate(starts) if start >= end]
        if late:
            subject = f"{len(late)} of {len(starts)} entries come" if len(starts) > 1 else "comes"
            problem = f"{subject} at or after the end of the run, {moment(end)} s, and do nothing"
            yield Finding(
                (field, late[0], key), problem if len(starts) > 1 else problem.replace(" do ", " does "), False
            )


def _short_pulses(scenario: ScenarioFields, vehicle: Vehicle) -> Iterator[Finding]:
    """Yields a doubt of pulses below a sample where jets switch with samples: they last for a whole one or none."""
    period_s = vehicle.sample_period_s
    short = [
        index
        for index, pulse in enumerate(scenario.jet_schedule)
        if pulse.end_s - pulse.start_s < period_s * (1.0 - 1e-9)
    ]
    if short and not vehicle.has_on_times:
        subject = f"{len(short)} of {len(scenario.jet_schedule)} pulses are" if len(short) > 1 else "is"
        problem = (
            f"{subject} shorter than a sample, {period_s:g} s, and its jets switch with samples: a pulse lasts "
            "for a whole one or for none; jet_commands: {as: on_time} in the vehicle's file lets it last as it says"
        )
        yield Finding(("jet_schedule", short[0]), problem, False)


def _large_process_noise(scenario: ScenarioFields, vehicle: Vehicle) -> Iterator[Finding]:
    """Yields findings of process noise per sample that exceeds the parameter that it is added to."""
    sizes = initial_standard_deviation(vehicle.nominal.vector(), 1.0, vehicle.center_of_mass_floor)
    for index, (std, size) in enumerate(zip(scenario.process_noise_std, sizes, strict=True)):
        path: FieldPath = ("rotation", "process_noise_std", index) if index < 9 else ("mass", "process_noise_std")
        problem = f"is {std:g} in each sample, more than the parameter itself: nothing learned would last"
        yield from finding_above(std, float(size), math.inf, path, problem)

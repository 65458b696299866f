"""Checks of a vehicle: keys that do not go together, impossible figures, and probable slips, each with its reason."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from massprop_drake.errors import suggestion
from massprop_drake.inputs.moving import moving_parts_problem
from massprop_drake.inputs.plausible import (
    GRAVITY,
    SPECIFIC_IMPULSE,
    Finding,
    compare_with_span,
    finding_above,
    out_of_span,
    unit_in_si,
)
from massprop_drake.inputs.vehicle_fields import WITHOUT_RATES, VehicleFields
from massprop_drake.inputs.vehicle_sensors import SensorPackage
from massprop_drake.inputs.yaml import FieldPath
from massprop_drake.maths.linear_algebra import Array, skew
from massprop_drake.maths.mass_properties import (
    MassProperties,
    initial_standard_deviation,
    is_possible_inertia,
    six_elements,
    symmetric_matrix,
)
from massprop_drake.maths.signals import SIGNALS
from massprop_drake.maths.vehicle.depletion import structure_after_draining

Problem = tuple[FieldPath, str]  # of a field, and what is wrong with it

# names that a sensor may not have: of signals and telemetry columns, and of ports and systems beside it
_RESERVED = {
    *SIGNALS,
    *("time_s", "file", "jet", "known_force", "known_torque"),
    *("reaction_jets", "rigid_body", "disturbance", "noise_source", "noise_seed"),
    *("reaction_wheels", "wheels", "wheel_speeds", "wheel_torque", "engines", "engine_command", "engine_state"),
    *("propellant", "drained"),
    *("body_state", "structure", "mass_properties"),
    *("telemetry_source", "record_time"),
    *("closed", "held_closed", "command", "held_command", "held_command_onset", "jet_commands"),
    *("impulses", "turning", "evidence"),
    *("outside_wrench", "mean_level", "predicted", "published", "replacement"),
    *("estimate", "covariance", "innovation", "innovation_covariance", "status", "adaptation", "reconfiguration"),
}
_RESERVED_BEGINNINGS = ("rotation_", "mass_", "joint_", "predicted_", "detector_")
_STRONGEST, _STRONG = 100.0 * GRAVITY, 10.0 * GRAVITY  # acceleration by one jet, m/s^2
_WEAKEST = 1e-12  # the same, m/s^2: the light of a star does more
_IMPINGED = 1.5  # thrust over nominal thrust
_FAR, _SEVERAL = 1000.0, 30.0  # radius of gyration and reach of jets and sensors, one over the other
# RMS arm of the jets over the largest radius of gyration: 3/sqrt(2) = 2.1 for a uniform cube with jets at its corners,
# 1.1 to 1.8 for the vehicles of the package; a mass in kg for slug makes it 3.8 times as large, positions in ft 3.3
_CONCENTRATED = 3.0
_LONGEST_LAG, _LONG_LAG = 100.0, 10.0  # of a valve, in sample periods
_LARGEST_STEP, _LARGE_STEP = 1.0, 0.1  # quantum or noise of a sensor, over its range
_SHARPEST, _SHARP = 1e13, 1e11  # see `sharpness_findings`
_FAINT = 1e-4  # what one sample of the strongest jet shows, over the sensor's 1-sigma
_QUICKEST, _QUICK = 1.0, 0.2  # rad that one sample of a jet adds to what the vehicle turns in a sample


def frame_problems(vehicle: VehicleFields) -> Iterator[Problem]:
    """Yields problems of keys that do not go with planar motion, or with estimation in a fixed frame."""
    attitude = any(pose.attitude_std is not None for pose in vehicle.poses)
    if not vehicle.gyros and not attitude:
        problem = f"is empty; this field is required: {WITHOUT_RATES}; or by a pose sensor with attitude_std"
        yield ("gyros",), problem
    if (vehicle.velocities or any(pose.position_std is not None for pose in vehicle.poses)) and not attitude:
        key = "poses" if vehicle.poses else "velocities"
        yield (key,), "positions and velocities in a fixed frame need a pose sensor with attitude_std"
    if vehicle.disturbance is not None and vehicle.needs_pose_filter:
        instead = "state surroundings.slope_std and surroundings.turn_std"
        yield ("disturbance",), f"is not estimated in a fixed frame; {instead}"
    for key in ("wheels", "engines", "tanks", "moving") if vehicle.needs_pose_filter else ():
        if getattr(vehicle, key):
            yield (key,), "play no part in a fixed frame; leave them out"
    if vehicle.motion == "planar":
        inertia = np.array(vehicle.mass_properties.inertia)
        if inertia[0, 2] or inertia[1, 2]:
            yield ("mass_properties", "inertia"), "with motion: planar products xz and yz play no part; give 0"
        for index, jet in enumerate(vehicle.jets):
            if jet.direction[0] == jet.direction[1] == 0.0:
                yield ("jets", index, "direction"), "with motion: planar a jet along z moves nothing"
    elif vehicle.surroundings.heading_turn_std:
        path = ("surroundings", "heading_turn_std")
        yield path, "goes with motion: planar, which has a heading; here it must be 0"


def component_problems(vehicle: VehicleFields) -> Iterator[Problem]:
    """Yields problems of names, repeated, reserved or unknown, and of moving parts that no filter can estimate."""
    jets = [(("jets", index), jet) for index, jet in enumerate(vehicle.jets)]
    kinds = ("gyros", "accelerometers", "poses", "velocities", "wheels", "engines")
    sensors = [((kind, index, "name"), one.name) for kind in kinds for index, one in enumerate(getattr(vehicle, kind))]
    yield from _find_repeated(((*path, "designation"), jet.designation) for path, jet in jets)
    yield from _find_repeated(((*path, "number"), jet.number) for path, jet in jets)
    yield from _find_repeated(sensors)
    for path, name in sensors:
        if name in _RESERVED or name.startswith(_RESERVED_BEGINNINGS):
            yield path, f"{name!r} is a signal of every run; give the sensor another"
    for jet_path, jet in jets:
        if jet.kind not in vehicle.jet_kinds:
            yield (*jet_path, "kind"), f"{jet.kind!r} is not one of jet_kinds{suggestion(jet.kind, vehicle.jet_kinds)}"
    accelerometers, preferred = [one.name for one in vehicle.accelerometers], vehicle.preferred_accelerometer
    if preferred is not None and preferred not in accelerometers:
        hint = suggestion(preferred, accelerometers)
        yield ("preferred_accelerometer",), f"{preferred!r} is not an accelerometer{hint}"
    nominal = vehicle.nominal
    known = nominal.mass, nominal.center_of_mass, nominal.inertia
    if problem := moving_parts_problem(vehicle.moving, known, vehicle.sample_period_s):
        yield ("moving",), problem


def _find_repeated(values: Iterable[tuple[FieldPath, Any]]) -> Iterator[Problem]:
    """Yields a problem for each value that an earlier one of the pairs of path and value has."""
    seen = set()
    for path, value in values:
        if value in seen:
            yield path, f"{value!r} appears twice; it must be unique"
        seen.add(value)


def tank_problems(vehicle: VehicleFields) -> Iterator[Problem]:
    """Yields problems of tanks that feed unknown jets, or one jet together, or hold more than the vehicle has."""
    yield from _find_repeated((("tanks", index, "name"), tank.name) for index, tank in enumerate(vehicle.tanks))
    known, fed = [*vehicle.designations, *vehicle.jet_kinds], dict[str, str]()
    for index, tank in enumerate(vehicle.tanks):
        for position, name in enumerate(tank.feeds):
            if name not in known:
                problem = f"{name!r} is neither a jet nor one of jet_kinds{suggestion(name, known)}"
                yield ("tanks", index, "feeds", position), problem
        for jet in np.array(vehicle.designations)[vehicle.jets_of(tank)].tolist():
            if jet in fed:
                problem = f"jet {jet} draws from tank '{fed[jet]}' already; a jet draws from one tank"
                yield ("tanks", index, "feeds"), problem
                break
            fed[jet] = tank.name
    propellant = sum(tank.propellant for tank in vehicle.tanks)
    if propellant >= vehicle.mass_properties.mass:
        last, unit = len(vehicle.tanks) - 1, vehicle.unit_names["mass"]
        problem = (
            f"tanks hold {propellant:g} {unit} of propellant, and the vehicle's mass with it is "
            f"{vehicle.mass_properties.mass:g} {unit}"
        )
        yield ("tanks", last, "propellant"), problem
    elif propellant > 0.0:
        fill = np.array([tank.propellant for tank in vehicle.tanks])
        body = np.concatenate((six_elements(vehicle.nominal.inertia), vehicle.nominal.center_of_mass))
        dry = symmetric_matrix(
            structure_after_draining(body, vehicle.nominal.mass, fill, fill, vehicle.tank_geometry)[:6]
        )
        if not is_possible_inertia(dry):
            moments = ", ".join(f"{moment:.6g}" for moment in np.linalg.eigvalsh(dry))
            problem = (
                "propellant so far out has a larger inertia than mass_properties leave for it: without it no rigid "
                f"body has the principal moments {moments}"
            )
            yield ("tanks",), problem


def impossible_entries(vehicle: VehicleFields) -> Iterator[Problem]:
    """Yields the impossible findings of a vehicle as problems, pairs of field path and sentence."""
    return ((finding.path, finding.problem) for finding in vehicle_findings(vehicle) if finding.impossible)


def vehicle_findings(vehicle: VehicleFields) -> Iterator[Finding]:
    """Yields impossible or doubtful entries of a vehicle; relations between keys only where each is in its span."""
    single_findings = [*out_of_span(vehicle, vehicle.units), *_column_name_clashes(vehicle)]
    yield from single_findings
    if not single_findings:
        yield from _narrow_sensor_ranges(vehicle)
        yield from _slow_valves(vehicle)
        yield from _mismatched_jets(vehicle)
        yield from body_findings(vehicle.nominal, vehicle)
        deviation = initial_standard_deviation(
            vehicle.nominal.vector(), vehicle.uncertainty, vehicle.center_of_mass_floor
        )
        yield from sharpness_findings(vehicle, np.diag(deviation**2))


def _packages(vehicle: VehicleFields) -> Iterator[tuple[FieldPath, SensorPackage]]:
    """Yields path and sensor package of each gyro and accelerometer."""
    for kind in ("gyros", "accelerometers"):
        for index, sensor in enumerate(getattr(vehicle, kind)):
            yield (kind, index), sensor


def _column_name_clashes(vehicle: VehicleFields) -> Iterator[Finding]:
    """Yields findings of sensors and jets whose telemetry columns have the name of another but for case."""
    columns: list[tuple[FieldPath, str, list[str]]] = []
    for path, sensor in _packages(vehicle):
        stems = [sensor.name] if path[0] == "gyros" else [sensor.name, f"{sensor.name}_accel"]
        columns.append(((*path, "name"), sensor.name, [f"{stem}_{axis}" for stem in stems for axis in "xyz"]))
    for index, jet in enumerate(vehicle.jets):
        columns.append((("jets", index, "designation"), jet.designation, [f"jet_{jet.designation}"]))
    owners: dict[str, str] = {}
    for path, name, names in columns:
        clash = next((other for other in map(owners.get, map(str.casefold, names)) if other is not None), None)
        if clash is not None:
            problem = f"{name!r} has a column in telemetry that is like one of {clash!r}, but for the case of letters"
            yield Finding(path, f"{problem} perhaps; rename one", True)
        owners.update(dict.fromkeys(map(str.casefold, names), name))


def _narrow_sensor_ranges(vehicle: VehicleFields) -> Iterator[Finding]:
    """Yields findings of sensors whose range is below ten times their quantum or noise 1-sigma."""
    for path, sensor in _packages(vehicle):
        what = "quantum" if sensor.quantum >= sensor.noise_std else "noise_std"
        step = max(sensor.quantum, sensor.noise_std)
        problem = (
            f"is {sensor.limit:g}, for a {what} of {step:g}: hardly a reading lies within it; expected a hundred times"
        )
        yield from finding_above(step / sensor.limit, _LARGE_STEP, _LARGEST_STEP, (*path, "range"), problem)


def _slow_valves(vehicle: VehicleFields) -> Iterator[Finding]:
    """Yields findings of jet kinds whose time constant or minimum on-time exceeds ten sample periods."""
    period = vehicle.sample_period_s
    for name, kind in vehicle.jet_kinds.items():
        for field in ("time_constant_s", "minimum_on_time_s"):
            periods = getattr(kind, field) / period
            problem = f"is {periods:.4g} sample periods: no command of a period would be followed"
            yield from finding_above(periods, _LONG_LAG, _LONGEST_LAG, ("jet_kinds", name, field), problem)


def _mismatched_jets(vehicle: VehicleFields) -> Iterator[Finding]:
    """Yields findings of jets whose thrust exceeds their kind's by half, or whose flow does not match it."""
    speed = unit_in_si("m/s", vehicle.units)
    for index, jet in enumerate(vehicle.jets):
        nominal = vehicle.jet_kinds[jet.kind].nominal_thrust
        problem = (
            f"is {jet.thrust / nominal:.3g} times the nominal thrust of its kind; impingement takes away, adds nothing"
        )
        yield from finding_above(jet.thrust / nominal, _IMPINGED, math.inf, ("jets", index, "thrust"), problem)
        if jet.mass_flow is not None:
            impulse = nominal / jet.mass_flow * speed / GRAVITY
            for finding in compare_with_span(
                impulse, SPECIFIC_IMPULSE, "s", vehicle.units, ("jets", index, "mass_flow")
            ):
                problem = (
                    f"with the nominal thrust of its kind gives a specific impulse that cannot be: {finding.problem}"
                )
                yield finding._replace(problem=problem)


def body_findings(body: MassProperties, vehicle: VehicleFields, path: FieldPath = ()) -> Iterator[Finding]:
    """Yields findings of a body that jets accelerate or turn implausibly, or whose inertia misfits its mass."""
    units, inertia = vehicle.units, path or ("mass_properties", "inertia")
    # a jet's acceleration; that of the kinds counts for the flow
    per_force = unit_in_si("N", units) / (body.mass * unit_in_si("kg", units))
    forces: dict[FieldPath, float] = {("jets", index, "thrust"): jet.thrust for index, jet in enumerate(vehicle.jets)}
    for name, kind in vehicle.jet_kinds.items():
        forces["jet_kinds", name, "nominal_thrust"] = kind.nominal_thrust
    for field_path, force in forces.items():
        acceleration = force * per_force
        problem = f"accelerates {body.mass:g} {vehicle.unit_names['mass']} at {acceleration:.4g} m/s^2, "
        more = f"{acceleration / GRAVITY:.4g} times the weight on Earth"
        yield from finding_above(acceleration, _STRONG, _STRONGEST, path or field_path, problem + more)
        if acceleration < _WEAKEST:
            yield Finding(path or field_path, f"{problem}less than the light of a star would", True)
    # a jet's turn
    torques = np.cross(vehicle.positions - body.center_of_mass, vehicle.thrusts)
    turns = np.linalg.norm(np.linalg.solve(body.inertia, torques.T), axis=0) * vehicle.sample_period_s**2
    jet = int(np.argmax(turns))
    problem = (
        f"is so small that jet {vehicle.designations[jet]!r} turns it by {turns[jet]:.3g} rad more in the sample after "
        "one sample of firing; rates are taken as steady within a sample"
    )
    yield from finding_above(float(turns[jet]), _QUICK, _QUICKEST, inertia, problem)
    # its radius of gyration
    positions = [*vehicle.positions, *(sensor.position for sensor in vehicle.accelerometers)]
    reach = float(np.linalg.norm(np.array(positions) - body.center_of_mass, axis=1).max())
    radii = np.sqrt(np.linalg.eigvalsh(body.inertia) / body.mass)
    length = vehicle.unit_names["length"]
    for radius, ratio, size in (
        (radii[2], radii[2] / (reach or radii[2]), "large"),
        (radii[0], reach / radii[0], "small"),
    ):
        problem = (
            f"is too {size} for this mass: the radius of gyration is {radius:.4g} {length}, the farthest jet or sensor "
            f"{reach:.4g} {length} from the center of mass; check the units of mass, inertia and positions"
        )
        yield from finding_above(float(ratio), _SEVERAL, _FAR, inertia, problem)
    if vehicle.rms_arm > _CONCENTRATED * radii[2] and reach <= _SEVERAL * radii[0]:
        slip = "the mass in slug, not in kg or lb" if units == "us" else "every position in m, not in ft or cm"
        problem = (
            f"is small for this mass: the largest radius of gyration is {radii[2]:.4g} {length}, the RMS distance of "
            f"the jets from the center of mass {vehicle.rms_arm:.4g} {length}, about twice the radius where a body "
            f"fills the hull of its jets; is {slip}?"
        )
        yield Finding(inertia, problem, False)


def sharpness_findings(
    vehicle: VehicleFields, covariance: Array, disturbances: tuple[float, float] = (0.0, 0.0), path: FieldPath = ()
) -> Iterator[Finding]:
    """Yields findings of sensors too accurate for double precision, or too coarse to show a jet firing.

    An update takes S Hᵀ (H S Hᵀ + R)⁻¹ H S from S. In double precision 1e-16 of H S Hᵀ is lost by that, and nothing
    is left of a smaller R: the covariance loses its definiteness.

    Args:
        vehicle: whose jets push, at its nominal mass properties.
        covariance: at the start, shape (10, 10).
        disturbances: 1-sigma added to that of rate and velocity increments.
        path: of what sets the covariance, if it is not the vehicle.
    """
    period, nominal = vehicle.sample_period_s, vehicle.nominal.vector()
    torques = np.cross(vehicle.positions - nominal[6:9], vehicle.thrusts) * period
    forces = vehicle.thrusts * period
    inverse = symmetric_matrix(nominal[:6])
    shown = {
        "gyros": (
            _rate_variances(torques, forces, inverse, covariance[:9, :9]),
            np.linalg.norm(torques @ inverse, axis=1),
        ),
        "accelerometers": ((forces**2).sum(axis=1) * covariance[9, 9], np.linalg.norm(forces, axis=1) * nominal[9]),
    }
    for place, sensor in _packages(vehicle):
        variances, sizes = shown[str(place[0])]
        error = 2.0 * sensor.variance + disturbances[place[0] == "accelerometers"] ** 2
        jet = int(np.argmax(variances))
        ratio = float(variances[jet]) / error
        problem = (
            f"what one sample of jet {vehicle.designations[jet]!r} would show is so uncertain, and {sensor.name!r} so "
            f"sharp, that the variances are as {ratio:.1g} to 1; beyond {_SHARPEST:g} the covariance could lose its "
            "definiteness in rounding. Give the sensor its noise_std, or the mass properties less uncertainty or noise"
        )
        yield from finding_above(ratio, _SHARP, _SHARPEST, path or place, problem)
        if not path and sizes.max() < _FAINT * math.sqrt(error):
            problem = f"a sample of the strongest jet shows as {sizes.max():.2g}, its error is {math.sqrt(error):.2g}"
            yield Finding(place, f"{problem}: nothing can be learned from it in a reasonable time", False)


def _rate_variances(torques: Array, forces: Array, inverse: Array, covariance: Array) -> Array:
    """Computes the trace of H S Hᵀ for rate increments of impulses about the center of mass, (rad/s)^2, shape (n,)."""
    x, y, z = torques.T
    none = np.zeros_like(x)
    by_inertia = np.array([[x, none, none, none, z, y], [none, y, none, z, none, x], [none, none, z, y, x, none]])
    by_center = inverse @ np.array([skew(force) for force in forces])
    by_matrix = np.concatenate([by_inertia.transpose(2, 0, 1), by_center], axis=2)
    variances: Array = ((by_matrix @ covariance) * by_matrix).sum(axis=(1, 2))
    return variances

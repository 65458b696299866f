"""Plausibility rules, each with its reason: impossible vehicles and runs, and probable slips.

Bounds of single keys stand beside the keys, as `Span`, in SI units whatever the units of the file. Rules between keys
stand here. What is impossible is refused when a file is loaded; the rest are doubts, which `massprop check` shows and
a run notes.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.errors import dotted, moment
from massprop_drake.inputs.model import Model, Span, span_of
from massprop_drake.inputs.yaml import FieldPath
from massprop_drake.maths.linear_algebra import skew
from massprop_drake.maths.mass_properties import MassProperties, initial_standard_deviation, symmetric_matrix

if TYPE_CHECKING:
    from massprop_drake.inputs.scenario import Scenario
    from massprop_drake.inputs.vehicle_file import Vehicle
    from massprop_drake.inputs.vehicle_sensors import SensorPackage

Array = NDArray[np.float64]

GRAVITY = 9.80665  # m/s^2
FOOT, SLUG = 0.3048, 0.45359237 * GRAVITY / 0.3048  # m, kg
# SI value of one US unit, by the SI unit
_US = {
    **{"m": FOOT, "m/s": FOOT, "m/s^2": FOOT, "kg": SLUG, "kg/s": SLUG, "N": SLUG * FOOT, "kg-m^2": SLUG * FOOT**2},
    "N-m": SLUG * FOOT**2,
}

MASS = Span(1e-3, 1e9, "from a satellite on a chip to a thousand space stations")
INERTIA = Span(0.0, 1e15, "that of the heaviest mass, a kilometer wide")
POSITION = Span(0.0, 1e3, "no structure is longer than a kilometer")
SIZE = Span(1e-6, 1e4, "it is to be drawn")
FORCE = Span(1e-9, 1e9, "from a colloid thruster to a heavy launcher")
FLOW = Span(1e-15, 1e6, "that of such thrusters")
SPECIFIC_IMPULSE = Span(1.0, 3e4, "cold gas gives tens of seconds, chemical jets hundreds, ion thrusters up to 20 000")
PERIOD = Span(
    1e-4, 100.0, "no valve acts within less, and in more a vehicle turns too far for rates to count as steady"
)
FREQUENCY = Span(1e-4, 1e4, "from a fix every few hours to the fastest inertial sensors")
VALVE = Span(1e-6, 1e4, "no valve is faster; 0: instantaneous")
WHEEL = Span(1e-10, 1e9, "from the wheel of a satellite on a chip to that of a space station")
SPIN = Span(1e-3, 1e5, "from a wheel that hardly turns to one that bursts")
SPEED_STEP = Span(1e-9, 1e3, "a revolution is counted in finer steps than that")
FREQUENCY = Span(1e-6, 1e4, "from propellant that drifts in orbit to the ringing of a plate")
RATE_STEP = Span(1e-13, 1e3, "from the largest ring lasers to the speed of a turbine")
RATE = Span(0.0, 1e4, "a vehicle or gyro that turns faster bursts")
VELOCITY_STEP = Span(1e-16, 1e3, "from drag-free test masses to all that jets give a vehicle")
VELOCITY = Span(0.0, 3e8, "the speed of light")
ACCELERATION = Span(0.0, 100.0 * GRAVITY, "a hundred times the weight on Earth")
UNCERTAINTY = Span(1e-9, 10.0, "less is beyond any scale, more says nothing")
LEAK = Span(0.0, 1e9, FORCE.why)
PAYLOAD = Span(0.0, MASS.most, MASS.why)
DRIFT = Span(0.0, 100.0, "faster is a failure at once")
GAIN = Span(0.0, 1e3, "a loop of jets is slower")
SCALE = Span(0.0, 2.0, "-2 turns a reading round")
BANDWIDTH = Span(1e-6, 1e9, "from a week to what is no limit")
TONE = Span(1e-6, 1e6, "no structure carries a faster vibration")
OUTSIDE_FORCE = Span(0.0, FORCE.most, FORCE.why)
OUTSIDE_TORQUE = Span(0.0, FORCE.most * POSITION.most, "the largest force at the longest arm")
CORRELATION = Span(1e-6, 1e9, "thirty years; shorter than a sample it is white")
ACCURACY = Span(1e-13, 1e-2, "an integrator gets no closer with numbers of 16 digits, and less close shows")
TIME = Span(0.0, 1e9, "thirty years")

_STRONGEST, _STRONG = 100.0 * GRAVITY, 10.0 * GRAVITY  # acceleration by one jet, m/s^2
_WEAKEST = 1e-12  # the same, m/s^2: the light of a star does more
_IMPINGED = 1.5  # thrust over nominal thrust
_FAR, _SEVERAL = 1000.0, 30.0  # radius of gyration and reach of jets and sensors, one over the other
_LONGEST_LAG, _LONG_LAG = 100.0, 10.0  # of a valve, in sample periods
_LARGEST_STEP, _LARGE_STEP = 1.0, 0.1  # quantum or noise of a sensor, over its range
_SHARPEST, _SHARP = 1e13, 1e11  # see `_sharpness`
_FAINT = 1e-4  # what one sample of the strongest jet shows, over the sensor's 1-sigma
_QUICKEST, _QUICK = 1.0, 0.2  # rad that one sample of a jet adds to what the vehicle turns in a sample
_HALF_TURN = math.pi  # rad, in a sample
_LEAKIEST, _LEAKY = 10.0, 1.0  # force of a leak over the jet's thrust
_MOST_SAMPLES = 1e8


class Finding(NamedTuple):
    """Input that is impossible, or doubtful.

    Attributes:
        path: of the field.
        problem: what is wrong, and why.
        impossible: refused; otherwise a doubt.
    """

    path: FieldPath
    problem: str
    impossible: bool

    def __str__(self) -> str:
        return f"{dotted(self.path)}: {self.problem}"


def _finding_above(value: float, doubt: float, limit: float, path: FieldPath, problem: str) -> Iterator[Finding]:
    """Yields a finding where a value is above the usual limit, impossible where above the possible one."""
    if not value <= doubt:  # nor a number
        yield Finding(path, problem, not value <= limit)


# ------------------------------------------------------------------------------------- single keys


def out_of_span(model: Model, units: str, path: FieldPath = (), skipped: tuple[str, ...] = ()) -> Iterator[Finding]:
    """Finds the numbers of a model, and of all models in it, that lie outside their `Span`.

    Args:
        model: a vehicle, a scenario, or a part of one.
        units: the unit system, "us" or "si".
        path: of the model.
        skipped: fields to leave out.
    """
    for name, span, unit in _spans(type(model)):
        if name in skipped:
            continue
        place, value = (*path, name), getattr(model, name)
        if span is not None:
            yield from _compare_with_span(value, span, unit, units, place)
        else:
            for inside, part in _nested_models(value, place):
                yield from out_of_span(part, units, inside)


@cache
def _spans(model: type[Model]) -> list[tuple[str, Span | None, str]]:
    """Returns the fields of a model with their spans and units."""
    return [(name, *span_of(field)) for name, field in model.model_fields.items()]


def _compare_with_span(value: Any, span: Span, unit: str, units: str, path: FieldPath) -> Iterator[Finding]:
    """Finds the numbers in a value that lie outside a span."""
    if isinstance(value, tuple):
        for index, part in enumerate(value):
            yield from _compare_with_span(part, span, unit, units, (*path, index))
    elif value:
        in_si = value * _si_factor(unit, units)
        name = "" if unit == "-" else f" {unit}"
        side, bound = ("below", span.least) if abs(in_si) < span.least else ("above", span.most)
        if not span.least <= abs(in_si) <= span.most:
            shown = f"{value:g}" if in_si == value else f"{value:g}, in SI units {in_si:.4g}"
            size = "of a size " if value < 0.0 else ""
            yield Finding(path, f"{shown}{name}, is {size}{side} {bound:g}{name}: {span.why}", True)


def _si_factor(unit: str, units: str) -> float:
    """Returns the SI value of one unit of a unit system, given the SI unit's name."""
    return _US.get(unit, 1.0) if units == "us" else 1.0


def _nested_models(value: Any, path: FieldPath) -> Iterator[tuple[FieldPath, Model]]:
    if isinstance(value, Model):
        yield path, value
    elif isinstance(value, (dict, tuple)):
        for key, part in value.items() if isinstance(value, dict) else enumerate(value):
            yield from _nested_models(part, (*path, key))


# --------------------------------------------------------------------------------------- a vehicle


def vehicle_findings(vehicle: Vehicle) -> Iterator[Finding]:
    """Finds what is impossible or doubtful in a vehicle; relations between keys only where each is within its span."""
    alone = [*out_of_span(vehicle, vehicle.units), *_column_name_clashes(vehicle)]
    yield from alone
    if not alone:
        yield from _narrow_sensor_ranges(vehicle)
        yield from _slow_valves(vehicle)
        yield from _mismatched_jets(vehicle)
        yield from body_findings(vehicle.nominal, vehicle)
        deviation = initial_standard_deviation(
            vehicle.nominal.vector(), vehicle.uncertainty, vehicle.center_of_mass_floor
        )
        yield from sharpness_findings(vehicle, np.diag(deviation**2))


def _packages(vehicle: Vehicle) -> Iterator[tuple[FieldPath, SensorPackage]]:
    for kind in ("gyros", "accelerometers"):
        for index, sensor in enumerate(getattr(vehicle, kind)):
            yield (kind, index), sensor


def _column_name_clashes(vehicle: Vehicle) -> Iterator[Finding]:
    """Finds columns of telemetry with the same name, or names that differ in the case of letters alone."""
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


def _narrow_sensor_ranges(vehicle: Vehicle) -> Iterator[Finding]:
    """Finds sensors whose range holds few steps of their reading."""
    for path, sensor in _packages(vehicle):
        what = "quantum" if sensor.quantum >= sensor.noise_std else "noise_std"
        step = max(sensor.quantum, sensor.noise_std)
        problem = (
            f"is {sensor.limit:g}, for a {what} of {step:g}: hardly a reading lies within it; expected a hundred times"
        )
        yield from _finding_above(step / sensor.limit, _LARGE_STEP, _LARGEST_STEP, (*path, "range"), problem)


def _slow_valves(vehicle: Vehicle) -> Iterator[Finding]:
    """Finds valves that do not follow their commands well enough for control by jets."""
    period = vehicle.sample_period_s
    for name, kind in vehicle.jet_kinds.items():
        for field in ("time_constant_s", "minimum_on_time_s"):
            periods = getattr(kind, field) / period
            problem = f"is {periods:.4g} sample periods: no command of a period would be followed"
            yield from _finding_above(periods, _LONG_LAG, _LONGEST_LAG, ("jet_kinds", name, field), problem)


def _mismatched_jets(vehicle: Vehicle) -> Iterator[Finding]:
    """Finds jets whose thrust, their kind's nominal thrust and flow do not match."""
    speed = _si_factor("m/s", vehicle.units)
    for index, jet in enumerate(vehicle.jets):
        nominal = vehicle.jet_kinds[jet.kind].nominal_thrust
        problem = (
            f"is {jet.thrust / nominal:.3g} times the nominal thrust of its kind; impingement takes away, adds nothing"
        )
        yield from _finding_above(jet.thrust / nominal, _IMPINGED, math.inf, ("jets", index, "thrust"), problem)
        if jet.mass_flow is not None:
            impulse = nominal / jet.mass_flow * speed / GRAVITY
            for finding in _compare_with_span(
                impulse, SPECIFIC_IMPULSE, "s", vehicle.units, ("jets", index, "mass_flow")
            ):
                problem = (
                    f"with the nominal thrust of its kind gives a specific impulse that cannot be: {finding.problem}"
                )
                yield finding._replace(problem=problem)


def body_findings(body: MassProperties, vehicle: Vehicle, path: FieldPath = ()) -> Iterator[Finding]:
    """Finds what is impossible or doubtful in how a vehicle's jets push a body, and in its inertia.

    Args:
        body: nominal or true.
        vehicle: whose jets and sensors it has.
        path: of the body, if it is not the vehicle's nominal one.
    """
    units, inertia = vehicle.units, path or ("mass_properties", "inertia")
    # a jet's acceleration; that of the kinds counts for the flow
    per_force = _si_factor("N", units) / (body.mass * _si_factor("kg", units))
    forces: dict[FieldPath, float] = {("jets", index, "thrust"): jet.thrust for index, jet in enumerate(vehicle.jets)}
    for name, kind in vehicle.jet_kinds.items():
        forces["jet_kinds", name, "nominal_thrust"] = kind.nominal_thrust
    for place, force in forces.items():
        acceleration = force * per_force
        problem = f"accelerates {body.mass:g} {vehicle.unit_names['mass']} at {acceleration:.4g} m/s^2, "
        more = f"{acceleration / GRAVITY:.4g} times the weight on Earth"
        yield from _finding_above(acceleration, _STRONG, _STRONGEST, path or place, problem + more)
        if acceleration < _WEAKEST:
            yield Finding(path or place, f"{problem}less than the light of a star would", True)
    # a jet's turn
    torques = np.cross(vehicle.positions - body.center_of_mass, vehicle.thrusts)
    turns = np.linalg.norm(np.linalg.solve(body.inertia, torques.T), axis=0) * vehicle.sample_period_s**2
    jet = int(np.argmax(turns))
    problem = (
        f"is so small that jet {vehicle.designations[jet]!r} turns it by {turns[jet]:.3g} rad more in the sample after "
        "one sample of firing; rates are taken as steady within a sample"
    )
    yield from _finding_above(float(turns[jet]), _QUICK, _QUICKEST, inertia, problem)
    # its radius of gyration
    places = [*vehicle.positions, *(sensor.position for sensor in vehicle.accelerometers)]
    reach = float(np.linalg.norm(np.array(places) - body.center_of_mass, axis=1).max())
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
        yield from _finding_above(float(ratio), _SEVERAL, _FAR, inertia, problem)


def sharpness_findings(
    vehicle: Vehicle, covariance: Array, disturbances: tuple[float, float] = (0.0, 0.0), path: FieldPath = ()
) -> Iterator[Finding]:
    """Finds sensors too sharp for the arithmetic, or too dull to show anything.

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
        yield from _finding_above(ratio, _SHARP, _SHARPEST, path or place, problem)
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


# -------------------------------------------------------------------------------------- a scenario


def scenario_findings(scenario: Scenario, vehicle: Vehicle) -> Iterator[Finding]:
    """Finds what is impossible or doubtful in a scenario; its vehicle is plausible, and each key within its span."""
    alone = list(_errors_out_of_bounds(scenario, vehicle))
    yield from alone
    if not alone:
        yield from _fast_rates(scenario, vehicle)
        true = getattr(scenario.plant, "mass_properties", None)  # a multibody plant's stand in its model
        if true is not None:
            yield from body_findings(true.properties(), vehicle, ("plant", "mass_properties"))
        yield from _strong_disturbances(scenario, vehicle)
        yield from _strong_leaks(scenario, vehicle)
        yield from _late_events(scenario)
        yield from _short_pulses(scenario, vehicle)
        yield from _large_process_noise(scenario, vehicle)
        samples = scenario.duration_s / vehicle.sample_period_s
        problem = f"is {samples:.3g} samples of {vehicle.sample_period_s:g} s; expected {_MOST_SAMPLES:g} at the most"
        yield from _finding_above(samples, _MOST_SAMPLES, _MOST_SAMPLES, ("duration_s",), problem)
        disturbances = (scenario.rotation.disturbance_std, scenario.mass.disturbance_std)
        with np.errstate(over="ignore", invalid="ignore"):  # what a file gives may be beyond all numbers
            covariance = scenario.estimation.initial_covariance(vehicle) + np.diag(
                np.square(scenario.process_noise_std)
            )
            found = list(sharpness_findings(vehicle, covariance, disturbances, ("estimation",)))
        yield from found


def _errors_out_of_bounds(scenario: Scenario, vehicle: Vehicle) -> Iterator[Finding]:
    """Finds true errors of a sensor outside the bounds that hold for those of the vehicle's file."""
    sensors = {sensor.name: sensor for sensor in vehicle.sensors}
    for index, errors in enumerate(scenario.sensors.errors):
        span, unit = span_of(type(sensors[errors.sensor]).model_fields["noise_std"])
        assert span is not None
        for field in ("noise_std", "quantum", "bias", "bias_random_walk"):
            bounds = span if field in ("noise_std", "quantum") else span._replace(least=0.0)
            here = ("sensors", "errors", index, field)
            yield from _compare_with_span(getattr(errors, field), bounds, unit, vehicle.units, here)
        for number, tone in enumerate(errors.vibration):
            there = ("sensors", "errors", index, "vibration", number, "amplitude")
            yield from _compare_with_span(tone.amplitude, span._replace(least=0.0), unit, vehicle.units, there)


def _fast_rates(scenario: Scenario, vehicle: Vehicle) -> Iterator[Finding]:
    """Finds rates that turn the vehicle too far in a sample: beyond half a turn it seems to turn the other way."""
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
        yield from _finding_above(turn, min(usable, _HALF_TURN), _HALF_TURN, path, problem)


def _strong_disturbances(scenario: Scenario, vehicle: Vehicle) -> Iterator[Finding]:
    """Finds disturbances that are stronger than the vehicle's strongest jet."""
    disturbance = scenario.plant.disturbance
    torques = np.cross(vehicle.positions - vehicle.nominal.center_of_mass, vehicle.thrusts)
    of_torque = "ft-lbf" if vehicle.units == "us" else "N-m"
    for field, gives, unit in (("torque", torques, of_torque), ("force", vehicle.thrusts, vehicle.unit_names["force"])):
        largest = float(np.linalg.norm(gives, axis=1).max())
        mean, std = (np.array(getattr(disturbance, name)) for name in (field, f"{field}_std"))
        size = float(np.hypot(np.linalg.norm(mean), np.linalg.norm(std)))
        problem = f"with what changes in it is {size:.3g} {unit}, and the strongest jet gives {largest:.3g}"
        yield from _finding_above(size, largest, math.inf, ("plant", "disturbance", field), problem)


def _strong_leaks(scenario: Scenario, vehicle: Vehicle) -> Iterator[Finding]:
    """Finds leaks above the jet's thrust: a leak is flow past a closed valve."""
    for index, failure in enumerate(scenario.failures):
        force = getattr(failure, "force", 0.0)
        thrust = vehicle.jets[vehicle.jet_index(failure.jet)].thrust
        problem = (
            f"is {force / thrust:.3g} times the thrust of jet {failure.jet!r}, {thrust:g}; a leak gives a part of it"
        )
        yield from _finding_above(force / thrust, _LEAKY, _LEAKIEST, ("failures", index, "force"), problem)


def _late_events(scenario: Scenario) -> Iterator[Finding]:
    """Finds commands and events after the end of the run, which do nothing."""
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
            which = f"{len(late)} of {len(starts)} entries come" if len(starts) > 1 else "comes"
            problem = f"{which} at or after the end of the run, {moment(end)} s, and do nothing"
            yield Finding(
                (field, late[0], key), problem if len(starts) > 1 else problem.replace(" do ", " does "), False
            )


def _short_pulses(scenario: Scenario, vehicle: Vehicle) -> Iterator[Finding]:
    """Finds pulses below a sample where jets switch with samples: they last for a whole one, or for none."""
    period_s = vehicle.sample_period_s
    short = [
        index
        for index, pulse in enumerate(scenario.jet_schedule)
        if pulse.end_s - pulse.start_s < period_s * (1.0 - 1e-9)
    ]
    if short and not vehicle.has_on_times:
        whose = f"{len(short)} of {len(scenario.jet_schedule)} pulses are" if len(short) > 1 else "is"
        problem = (
            f"{whose} shorter than a sample, {period_s:g} s, and its jets switch with samples: a pulse lasts "
            "for a whole one or for none; jet_commands: {as: on_time} in the vehicle's file lets it last as it says"
        )
        yield Finding(("jet_schedule", short[0]), problem, False)


def _large_process_noise(scenario: Scenario, vehicle: Vehicle) -> Iterator[Finding]:
    """Finds process noise that is not small beside the quantity that it is added to."""
    sizes = initial_standard_deviation(vehicle.nominal.vector(), 1.0, vehicle.center_of_mass_floor)
    for index, (std, size) in enumerate(zip(scenario.process_noise_std, sizes, strict=True)):
        path: FieldPath = ("rotation", "process_noise_std", index) if index < 9 else ("mass", "process_noise_std")
        problem = f"is {std:g} in each sample, more than the parameter itself: nothing learned would last"
        yield from _finding_above(std, float(size), math.inf, path, problem)

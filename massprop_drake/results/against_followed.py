"""Comparison of a record in a fixed frame with a simulation: the differences, and their possible causes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from massprop_drake.inputs import params
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.inputs.vehicle_sensors import PoseSensor, VelocitySensor
from massprop_drake.maths import attitude
from massprop_drake.maths.estimation.pose import pose_hindsight, setting
from massprop_drake.maths.estimation.pose.pose_hindsight import Assumed, PoseRecord
from massprop_drake.maths.estimation.pose.pose_layout import PoseParams
from massprop_drake.maths.signals import AGAINST, AXES, SYMBOLS, mass_property_units
from massprop_drake.results import against
from massprop_drake.results.against import Explanation, Residual, UnknownLabel, name_mass_property
from massprop_drake.results.spool import Spool

Array = NDArray[np.float64]


def residuals(scenario: Scenario, signals: Spool) -> tuple[Residual, ...]:
    """Computes the RMS and the largest residual of each sensor component, attitudes as rotation vectors.

    Args: as `against.residuals`.
    """
    vehicle, results = scenario.vehicle_data, list[Residual]()
    translation_axes, rotation_axes = ((0, 1), (2,)) if vehicle.motion == "planar" else ((0, 1, 2), (0, 1, 2))
    length = vehicle.unit_names["length"]

    def add(
        prefix: str, axes: Sequence[int], unit: str, noise_std: float, residual_blocks: Iterable[tuple[Array, Array]]
    ) -> None:
        """Appends the residual statistics of some axes of a sensor, whose columns begin with a prefix."""
        selected = ((time_s, values[:, list(axes)]) for time_s, values in residual_blocks)
        results.extend(against.summarize_residuals([prefix + AXES[axis] for axis in axes], unit, noise_std, selected))

    sensors: tuple[PoseSensor | VelocitySensor, ...] = (*vehicle.poses, *vehicle.velocities)
    for sensor in sensors:
        residual_blocks, prefix = against.differences(signals, sensor.name), f"{sensor.name}_"
        if not isinstance(sensor, PoseSensor):
            add(prefix, translation_axes, f"{length}/s", sensor.noise_std, residual_blocks)
            continue
        if sensor.position_std is not None:
            add(prefix, translation_axes, length, sensor.position_std, residual_blocks)
        if sensor.attitude_std is not None:
            rotations = _attitude_differences(signals, sensor.name)
            add(f"{sensor.name} turned, ", rotation_axes, "rad", sensor.attitude_std, rotations)
    for package in (*params.gyros(scenario), *params.accelerometers(scenario)):
        axes, unit = (rotation_axes, "rad/s") if package in vehicle.gyros else (translation_axes, f"{length}/s")
        add(f"{package.name}_", axes, unit, package.variance**0.5, against.differences(signals, package.name))
    return tuple(results)


def _attitude_differences(signals: Spool, name: str) -> Iterator[tuple[Array, Array]]:
    """Yields times, s, and rotation vectors from simulated to measured attitude, body axes, rad, shape (n, 3)."""
    for block in signals.blocks("time_s", name, AGAINST + name):
        yield block["time_s"], rotation_differences(block[name][:, 3:], block[AGAINST + name][:, 3:])


def rotation_differences(measured: Array, simulated: Array) -> Array:
    """Computes rotation vectors from simulated to measured attitudes, body axes, rad, NaN unread, shape (n, 3).

    Args:
        measured, simulated: quaternions from body to fixed frame, the latter of unit length, NaN unread, shape (n, 4).
    """
    found = np.full((len(measured), 3), np.nan)
    for row in np.flatnonzero(np.isfinite(measured).all(axis=1) & np.isfinite(simulated).all(axis=1)):
        one = measured[row] / np.sqrt(measured[row] @ measured[row])
        found[row] = attitude.to_rotation_vector(attitude.multiply(attitude.conjugate(simulated[row]), one))
    return found


def explain_differences(
    scenario: Scenario, record: PoseRecord, vehicle: Assumed, pose_params: PoseParams
) -> tuple[float | None, tuple[Explanation, ...]]:
    """Finds the unknowns of the pose filter that explain how a record's readings differ from a simulation.

    Args:
        scenario: of the record.
        record: readings and commands up to the first failure.
        vehicle: as simulated.
        pose_params: parameters of the estimator.

    Returns:
        See `Against.misfit` and `Against.causes`.
    """
    movable = setting.movable_indices(params.filter_setup(scenario), pose_params.parts)
    with np.errstate(all="ignore"):
        return against.find_causes(
            lambda at: pose_hindsight.record_equations(record, vehicle._replace(at=at), movable, pose_params),
            (vehicle.at, _name_unknowns(scenario, pose_params, vehicle.at)),
            lambda at: pose_hindsight.is_physical(at, pose_params.parts),
        )


def _name_unknowns(scenario: Scenario, pose_params: PoseParams, state: Array) -> list[UnknownLabel | None]:
    """Returns the label of each element of the pose filter's state, in its order; None where it is not fitted."""
    vehicle, parts = scenario.vehicle_data, pose_params.parts
    length = vehicle.unit_names["length"]
    found: list[UnknownLabel | None] = [None] * parts.size
    values = np.concatenate((state[parts.spin], state[parts.center], state[parts.common]))
    units = mass_property_units(vehicle.unit_names)
    places = [*range(*parts.spin.indices(parts.size)), *range(*parts.center.indices(parts.size)), parts.common.start]
    known = params.known_parameters(scenario)
    for place, fixed, *one in zip(places, known, SYMBOLS, units, values.tolist(), strict=True):
        found[place] = None if fixed else name_mass_property(*one)
    kinds, poses = list(vehicle.jet_kinds), [pose.name for pose in vehicle.poses]
    gyros, accelerometers = ([one.name for one in few(scenario)] for few in (params.gyros, params.accelerometers))
    push, nobody, turn = parts.push.start, "that nobody commands", "angular acceleration"
    named: list[tuple[slice, list[str], str, float]] = [
        (parts.thrust, [f"thrust of {jet}" for jet in vehicle.designations], "%", 100.0),
        (parts.delay, [f"delay of {kind} jets" for kind in kinds], "ms", 1e3),
        (parts.lag, [f"lag of {kind} jets" for kind in kinds], "ms", 1e3),
        (parts.opening, [f"later opening of {kind} jets" for kind in kinds], "ms", 1e3),
        (parts.drag, ["drag over mass", "drag over moment of inertia"], "1/s", 1.0),
        (slice(push, push + 3), [f"acceleration {axis} {nobody}" for axis in AXES], f"{length}/s^2", 1.0),
        (slice(push + 3, push + 6), [f"{turn} {axis} {nobody}" for axis in AXES], "rad/s^2", 1.0),
        (parts.tilt, [f"{turn} by the {way} of the heading" for way in ("cosine", "sine")], "rad/s^2", 1.0),
        (parts.point, [f"point of {name}, {axis}" for name in poses for axis in AXES], length, 1.0),
        (parts.gyro_bias, [f"{name}: bias {axis}" for name in gyros for axis in AXES], "rad/s", 1.0),
        (
            parts.acceleration_bias,
            [f"{name}: bias {axis}" for name in accelerometers for axis in AXES],
            f"{length}/s^2",
            1.0,
        ),
    ]
    for part, of_part, unit, scale in named:
        found[part] = [UnknownLabel(what, unit, scale) for what in of_part]
    return found

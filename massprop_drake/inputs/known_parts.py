"""Wheels, engines, tanks and thrust as a vehicle's file states them, in arrays of the mathematics."""

from __future__ import annotations

import numpy as np

from massprop_drake.inputs.vehicle_fields import STANDARD_GRAVITY
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.inputs.vehicle_sensors import RocketEngine
from massprop_drake.maths.estimation.joint.tanks import TankParams
from massprop_drake.maths.estimation.joint.wheels import WheelParams
from massprop_drake.maths.linear_algebra import Array, normals
from massprop_drake.maths.vehicle.engine_thrust import NO_ENGINES, EngineParams


def wheels(vehicle: Vehicle) -> WheelParams:
    """Makes the parameters of the reaction wheels, of exact inertia."""
    axes = np.array([wheel.axis for wheel in vehicle.wheels]).reshape(-1, 3)
    return WheelParams(
        axes=axes / np.linalg.norm(axes, axis=1, keepdims=True),
        inertias=np.array([wheel.inertia for wheel in vehicle.wheels]),
        sigma=0.0,
        speed_std=np.array([wheel.speed_std for wheel in vehicle.wheels]),
        most=np.array([wheel.most_acceleration for wheel in vehicle.wheels]),
    )


def engines(vehicle: Vehicle) -> EngineParams:
    """Makes the parameters of the engines, without errors."""
    stated = vehicle.engines
    if not stated:
        return NO_ENGINES
    directions = np.array([engine.direction for engine in stated])
    directions = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    across = normals(directions)
    axes = across.copy()
    for place, engine in enumerate(stated):
        if engine.gimbal is not None:
            axes[place] = np.array(engine.gimbal.axes)
            across[place] = normals(directions[[place]], axes[[place], 0])[0]
    axes = axes / np.linalg.norm(axes, axis=2, keepdims=True)
    levels = np.unique([0.0, 1.0, *(level for engine in stated for level, _ in engine.impulses)])
    own = np.array([(one.level_rate, one.level_time_constant_s, 1.0, one.level_noise_std) for one in stated])
    fixed = (1.0, 0.0, 0.0, 0.0)
    of_gimbals = np.array(
        [fixed if g is None else (g.rate, g.time_constant_s, g.stop, g.noise_std) for g in (e.gimbal for e in stated)]
    )
    rates, constants_s, stops, read_std = np.stack((own, of_gimbals, of_gimbals), axis=2).transpose(1, 0, 2)
    return EngineParams(
        positions=np.array([engine.position for engine in stated]),
        directions=directions,
        axes=axes,
        normals=across,
        thrusts=np.array([engine.thrust for engine in stated]),
        levels=levels,
        flows=np.stack([_flows(engine, levels, STANDARD_GRAVITY[vehicle.units]) for engine in stated]),
        rates=rates.copy(),
        constants_s=constants_s.copy(),
        stops=stops.copy(),
        read_std=read_std.copy(),
        least=np.array([engine.least_level for engine in stated]),
        measured=np.array([float(engine.telemetry == "measured") for engine in stated]),
    )


def _flows(engine: RocketEngine, levels: Array, gravity: float) -> Array:
    """Computes an engine's propellant flow at some throttle levels, shape (k,)."""
    given, impulses = np.array(engine.impulses).T
    return np.asarray(engine.thrust * levels / (gravity * np.interp(levels, given, impulses)))


def engine_sigmas(vehicle: Vehicle) -> Array:
    """Returns 1-sigma of each engine's errors: two each of thrust, direction and position, shape (6 n,)."""
    return np.array(
        [
            sigma
            for engine in vehicle.engines
            for sigma in (engine.thrust_uncertainty, engine.direction_std, engine.position_std)
            for _ in range(2)
        ]
    )


def tanks(vehicle: Vehicle) -> TankParams:
    """Makes the parameters of the tanks that jets empty, as they are stated."""
    stated, geometry = vehicle.tanks, vehicle.tank_geometry

    def each(key: str) -> Array:
        return np.array([getattr(tank, key) for tank in stated], dtype=float)

    sigmas = each("propellant_std"), each("flow_uncertainty")
    return TankParams(*geometry, each("capacity"), each("propellant"), *sigmas)

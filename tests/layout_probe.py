"""Logs of one flight as many programs would have written it: random units, names, layouts, clocks and scales."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from record_probe import Flight

from massprop_drake.inputs.vehicle_file import Vehicle

Array = NDArray[np.float64]

GRID_S = 1_455_210_114  # of clocks that count from 1970
RATES = (
    "gyro_{x}_dps",
    "omega_{x}_deg_s",
    "angularVelocity.{x}",
    "w_RS_S_{x} [rad s^-1]",
    "omega_BN_B_{1}",
    "gyro_rad[{0}]",
)
VELOCITIES = ("dv_{x}_mmps", "DV_{X} [mm/s]", "deltaV{X}_m_s", "dv[{0}]", "imu_dv_{1}")
ACCELERATIONS = ("a{x} [m/s^2]", "acc_{x}_mg", "linear_acceleration.{x}", "accelerometer_m_s2[{0}]")
JETS = ("cmd_{jet}", "{jet}", "thruster{number}", "THR{number:02d}", "valve[{index}]", "rcs.{number}.cmd")
TIMES = ("time", "t", "MET", "header.stamp", "TimeUS", "# timestamp", "elapsedSecs")


def flown(vehicle: Vehicle, seed: int, rows: int = 400, longest: int = 6) -> Flight:
    """A flight that follows its commands, pulses of random lengths of samples, with a little noise."""
    random = np.random.default_rng(seed)
    commands = np.zeros((rows, len(vehicle.jets)))
    for jet in range(len(vehicle.jets)):
        row = int(random.integers(3, 30))
        while row < rows:
            length = int(random.integers(1, longest + 1))
            commands[row : row + length, jet] = 1.0
            row += length + int(random.integers(5, 40))
    nominal, wrenches = vehicle.nominal, vehicle.wrenches
    torques = wrenches[:, :3] - np.cross(nominal.center_of_mass, wrenches[:, 3:])
    turning = torques @ np.linalg.inv(1.1 * nominal.inertia).T
    arm = np.subtract(vehicle.accelerometers[0].position, nominal.center_of_mass)
    pushing = wrenches[:, 3:] / (0.9 * nominal.mass) + np.cross(turning, arm)
    steps = vehicle.sample_period_s * np.vstack([np.zeros((1, len(vehicle.jets))), commands[:-1]])
    rates = np.cumsum(steps @ turning, axis=0)
    velocities = np.cumsum(steps @ pushing, axis=0)
    rates += random.normal(0.0, 0.02 * np.abs(np.diff(rates, axis=0)).max(), rates.shape)
    velocities += random.normal(0.0, 0.02 * np.abs(np.diff(velocities, axis=0)).max(), velocities.shape)
    return Flight(vehicle, vehicle.sample_period_s * np.arange(rows), rates, velocities, commands)


def _named(pattern: str, values: Array) -> dict[str, Array]:
    """Three columns by a pattern of their names."""
    named = {}
    for index, axis in enumerate("xyz"):
        name = pattern.replace("{x}", axis).replace("{X}", axis.upper())
        named[name.replace("{0}", str(index)).replace("{1}", str(index + 1))] = values[:, index]
    return named


def _choice(random: np.random.Generator, several: Sequence[Any]) -> Any:
    return several[int(random.integers(len(several)))]


def _times(one: Flight, random: np.random.Generator) -> dict[str, Any]:
    name = _choice(random, TIMES)
    kind = int(random.integers(5))
    if kind == 0:
        nanoseconds = np.round(1e9 * one.time_s).astype(np.int64)
        return {"header.stamp.sec": GRID_S + nanoseconds // 10**9, "header.stamp.nanosec": nanoseconds % 10**9}
    if kind == 1:
        start = np.datetime64("2024-05-01T23:59:50", "ms")
        stamps = start + np.round(1e3 * one.time_s).astype("timedelta64[ms]")
        return {"utc": [f"{stamp}{'Z' if random.integers(2) else ''}" for stamp in stamps]}
    if name == "TimeUS":
        return {name: np.round(1e6 * one.time_s).astype(np.int64)}
    if name == "elapsedSecs":
        return {name: one.time_s + 100.0}
    if kind == 2:
        return {name: np.round(1e9 * (GRID_S + one.time_s)).astype(np.int64)}
    return {name: 1e3 * one.time_s} if kind == 3 else {f"{name} [s]": one.time_s}


def _rates(one: Flight, random: np.random.Generator) -> dict[str, Array]:
    pattern = _choice(random, RATES)
    degrees = any(word in pattern for word in ("dps", "deg"))
    # where no name says the unit, the jets do
    silent = not degrees and "rad" not in pattern.lower()
    return _named(pattern, np.degrees(one.rates) if degrees or (silent and random.integers(2)) else one.rates)


def _velocities(one: Flight, random: np.random.Generator) -> dict[str, Array]:
    changes = np.diff(one.velocities, axis=0, prepend=one.velocities[:1])
    if random.integers(2):
        pattern = _choice(random, ACCELERATIONS)
        scale = 1e3 / 9.80665 if "mg" in pattern else 1.0
        return _named(pattern, scale * changes / one.vehicle.sample_period_s)
    pattern = _choice(random, VELOCITIES)
    return _named(pattern, (1e3 if "mm" in pattern else 1.0) * (changes if random.integers(2) else one.velocities))


def _commands(one: Flight, random: np.random.Generator) -> dict[str, Array]:
    pattern, period_s = _choice(random, JETS), one.vehicle.sample_period_s
    off, full = _choice(
        random, ((0.0, 1.0), (0.0, 100.0), (0.0, 1e3 * period_s), (0.0, period_s), (1e3, 2e3), (0.0, 255.0))
    )
    values = off + (full - off) * one.commands
    if random.integers(3) == 0:  # logged once they have acted
        values = np.vstack([values[:1], values[:-1]])
    order = range(len(one.jets)) if "index" in pattern else random.permutation(len(one.jets))
    return {pattern.format(jet=one.jets[jet], number=jet + 1, index=jet): values[:, jet] for jet in order}


def write_any(path: Path, one: Flight, seed: int) -> Path:
    """Writes the flight in one of many layouts; other columns stand in between."""
    random = np.random.default_rng(seed)
    others = {
        "RW1_RPM": random.normal(1000.0, 1.0, len(one.time_s)),
        "mag_x": one.rates[:, 0],
        "temp1": random.normal(20.0, 1.0, len(one.time_s)),
        "gyro_bias_x": 0.0 * one.time_s,
    }
    parts = [_rates(one, random), _velocities(one, random), _commands(one, random), others]
    columns: dict[str, Any] = _times(one, random)
    for place in random.permutation(len(parts)):
        columns |= parts[place]
    texts = any(isinstance(values[0], str) for values in columns.values())
    separator = _choice(random, (",", ";", "\t") if texts else (",", ";", "\t", " ", "   "))
    comma = separator == ";" and bool(random.integers(2))
    lines = [separator.join(columns)]
    for row in zip(*columns.values(), strict=True):
        line = separator.join(one if isinstance(one, str) else repr(one.item()) for one in row)
        lines.append(line.replace(".", ",") if comma else line)
    above = _choice(random, ([], [], ["made by a program", "for one flight"], ["# flight 7", ""]))
    path.write_text("\n".join([*above, *lines]) + "\n", encoding="utf-8")
    return path

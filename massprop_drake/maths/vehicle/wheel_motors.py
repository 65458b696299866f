"""True reaction wheels of a vehicle: torques of their motors by speed, and the readings of the speeds.

A motor's torque u turns its wheel about its axis, J dW/dt = u, and the vehicle the other way. W is the speed relative
to the vehicle; what the vehicle's own turning takes of u is left out, as a loop that controls the speed would have it.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.noise import Seed, normal_sample


class WheelsModel(NamedTuple):
    """True wheels of a vehicle.

    Attributes:
        axes: about which they turn, unit vectors, body axes, shape (n, 3).
        inertias: about these, as stated, slug-ft^2 or kg-m^2, shape (n,).
        most: largest torque of each motor, ft-lbf or N-m, shape (n,).
        quanta, noise_std: of a reading of each speed, rad/s, zero: none, shape (n,).
        dispersion: 1-sigma by which true inertias are off those for good, relative.
        start: speeds at the start, rad/s, shape (n,).
        fastest: largest speed either way, rad/s, infinity: any, shape (n,).
    """

    axes: Array
    inertias: Array
    most: Array
    quanta: Array
    noise_std: Array
    dispersion: float
    start: Array
    fastest: Array


def draw_inertias(model: WheelsModel, seed: Seed) -> Array:
    """Draws the true inertias of the wheels about their axes by a seed, shape (n,)."""
    if model.dispersion == 0.0:
        return model.inertias
    drawn = normal_sample(seed, "reaction wheels", 0, model.inertias.size)
    return np.asarray(model.inertias * (1.0 + model.dispersion * drawn))


def acceleration(torque: Any, inertias: Array, speeds: Any, model: WheelsModel, period_s: float) -> Any:
    """Computes angular accelerations of the wheels under motor torques over a sample, rad/s^2, shape (n,).

    Motors are limited by their torques, and leave a wheel at its largest speed.

    Args:
        torque: that is asked of each, ft-lbf or N-m, shape (n,).
        inertias: of the wheels, shape (n,).
        speeds: as the sample begins, rad/s, shape (n,).
    """
    most = np.clip(torque, -model.most, model.most) / inertias
    return np.clip(most, (-model.fastest - speeds) / period_s, (model.fastest - speeds) / period_s)


def momentum(speeds: Any, accelerations: Any, inertias: Array, model: WheelsModel) -> Any:
    """Computes the wheels' angular momentum in body axes and its time derivative, shape (6,)."""
    arms = inertias[:, None] * model.axes
    return np.concatenate((speeds @ arms, accelerations @ arms))


def read_speed(speed: Any, noise: Any, wheel: int, model: WheelsModel) -> Any:
    """Measures the speed of one wheel as its tachometer does, with noise and quantum.

    Args:
        speed: rad/s.
        noise: standard normal.
        wheel: of the wheel.
    """
    shown, step = speed + model.noise_std[wheel] * noise, model.quanta[wheel]
    return shown if step == 0.0 else step * np.floor(shown / step + 0.5)

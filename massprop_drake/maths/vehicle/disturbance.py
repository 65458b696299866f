"""Uncommanded torque and force that change slowly: drag, gravity gradient, venting.

A mean, and a first-order Gauss-Markov process about it, as a shaping filter gives it in a Kalman filter's model: its
autocorrelation is std^2 exp(-|lag| / correlation time). It is held over each sample, so that a stepped and a
continuous body are pushed alike.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from massprop_drake.maths.kernels import kernel
from massprop_drake.maths.linear_algebra import Array, cross
from massprop_drake.maths.noise import Seed, normal_sample


class DisturbanceModel(NamedTuple):
    """Model of a disturbance: torque about the center of mass (3), force (3), body axes.

    Attributes:
        mean: ft-lbf and lbf, or N-m and N, shape (6,).
        std: 1-sigma of the deviation from it, shape (6,).
        kept: share of a deviation that is left after a sample.
        before: deviation in the sample before the first, shape (6,).
    """

    mean: Array
    std: Array
    kept: float
    before: Array


def decay_factor(correlation_time_s: float, period_s: float) -> float:
    """Computes the factor exp(-T/tau) by which a Gauss-Markov deviation decays in a period."""
    return math.exp(-period_s / correlation_time_s)


def draw_initial_deviation(seed: Seed, std: Array) -> Array:
    """Draws the disturbance's deviation from its mean at the sample before the first, shape (6,)."""
    return std * normal_sample(seed, "disturbance before the start", 0, 6)


@kernel
def next_deviation(deviation: Array, noise: Array, model: DisturbanceModel) -> Array:
    """Computes the disturbance's deviation in the next sample, as Gauss-Markov process, shape (6,).

    Args:
        deviation: in this sample, shape (6,).
        noise: independent standard normal numbers, shape (6,).
    """
    return model.kept * deviation + math.sqrt(1.0 - model.kept**2) * model.std * noise


@kernel
def move_to_origin(disturbance: Array, center_of_mass: Array) -> Array:
    """Converts a wrench about the center of mass to one about the vehicle origin, shape (6,).

    Args:
        disturbance: torque about the center of mass, force, shape (6,).
        center_of_mass: in the vehicle frame, ft or m, shape (3,).
    """
    torque, force = disturbance[:3], disturbance[3:]
    return np.concatenate((torque + cross(center_of_mass, force), force))


def move_to_center(wrench: Array, center_of_mass: Array) -> Array:
    """Converts a wrench about the vehicle origin to one about the center of mass; arguments as `move_to_origin`."""
    return move_to_origin(wrench, -center_of_mass)


def add_wrench(wrench: Array, added: Array, pieces: int = 1) -> Array:
    """Adds a wrench that is constant over a sample to another, or to each piece of a wrench profile of ``pieces``.

    Args:
        wrench: torque about the vehicle origin, force, and what follows, shape (6 + any,); or the profile of a sample
            of several pieces, see `reaction_jets.profile_by_pieces`.
        added: torque about the vehicle origin, force, and what else follows these, shape (k,).
        pieces: of the profile.
    """
    total = wrench.copy()
    first = 0 if pieces == 1 else 1  # a piece begins with its length
    total.reshape(pieces, -1)[:, first : first + added.shape[0]] += added
    return total

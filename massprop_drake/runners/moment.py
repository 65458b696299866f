"""State of a simulation at one sample, for display."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Moment(NamedTuple):
    """State of a simulation at one sample, for those who watch it.

    Attributes:
        time_s: of the sample, s.
        attitude: q_NB, shape (4,).
        center_of_mass: the true one, vehicle frame, ft or m, shape (3,).
        thrust: mean force of each jet over the coming sample, lbf or N, shape (n_jets,).
        estimate, standard_deviation: of the ten parameters, shape (10,) each.
        removed: jets taken out of use, boolean, shape (n_jets,).
        command: fraction of the coming sample that each jet is told to fire, shape (n_jets,).
        rate: true, rad/s, shape (3,).
        nis: of the rotation filter's innovation; NaN where the sample was not used.
        readings: of each sensor package, in the vehicle's order, shape (3,) each.
        joint_positions: of a multibody plant, rad, ft or m; empty where there are none.
    """

    time_s: float
    attitude: Array
    center_of_mass: Array
    thrust: Array
    estimate: Array
    standard_deviation: Array
    removed: NDArray[np.bool_]
    command: Array
    rate: Array
    nis: float
    readings: tuple[Array, ...]
    joint_positions: Array = np.empty(0)

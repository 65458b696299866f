r"""Angular and linear impulse (a, lambda) of the commanded jets over a sample, and whether it is usable.

    lambda = sum_i T_i l_i dt                  (2-45)
    a      = sum_i r'_i x T_i l_i dt           (2-46), about the origin of the vehicle frame

with l_i the mean thrust level over the sample: the command itself, or the level of the thrust lag. Known
outside forces add to both.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from massprop_drake.maths.arrays import FLAG, Layout
from massprop_drake.maths.kernels import idiom, kernel, select_where
from massprop_drake.maths.linear_algebra import Array, has_nonzero
from massprop_drake.maths.vehicle.thrust import LagFactors, level_after, mean_level

_OFF, _ON_OFF = {0.0}, {0.0, 1.0}


class Impulses(NamedTuple):
    """Impulses of one sample interval.

    Attributes:
        angular_impulse: a, about the vehicle origin, body axes, lbf-ft-s or N-m-s, shape (3,).
        linear_impulse: lambda, body axes, lbf-s or N-s, shape (3,).
        usable: whether the combination of jets was steady, so that the impulses can be believed.
        firing: whether a known impulse acted: any jet was commanded, or an outside force is known.
        level: thrust level of each jet at the end of the interval, shape (n_jets,).
        mean_level: on average over the interval, shape (n_jets,).
    """

    angular_impulse: Array
    linear_impulse: Array
    usable: bool
    firing: bool
    level: Array
    mean_level: Array


# what is told of them
LAYOUT = Layout("impulses", angular_impulse=3, linear_impulse=3, usable=FLAG, firing=FLAG)


def _classify_command(command, previous_command):  # type: ignore[no-untyped-def] # compiled alone
    """Tests whether commands are steady, all known, and firing; see `classify_command`."""
    steady, known, firing = True, True, False
    for jet in range(command.size):
        fraction = command[jet]
        steady = steady and fraction == previous_command[jet] and fraction * (1.0 - fraction) == 0.0
        known = known and not math.isnan(fraction)
        firing = firing or fraction != 0.0
    return steady, known, firing


@idiom(_classify_command)
def classify_command(command: Array, previous_command: Array) -> tuple[bool, bool, bool]:
    """Tests whether jet commands are steady over two intervals, all known, and firing: three booleans."""
    fractions = set(command.tolist())
    # equal bytes are equal numbers, but for NaN, which the set does not let pass
    same = command.tobytes() == previous_command.tobytes() or bool((command == previous_command).all())
    steady = same and fractions <= _ON_OFF
    return steady, steady or not math.isnan(sum(fractions)), fractions != _OFF


@kernel
def interval_impulses(
    command: Array,
    previous_command: Array,
    level: Array,
    impulse_per_level: Array,
    lag: LagFactors,
    outside_impulse: Array | None = None,
) -> Impulses:
    r"""Computes the impulse of jets and outside forces over the interval that ended now, and new thrust levels.

    The steady-combination gate: a sample is usable when the commands of this interval and of the one
    before are equal and each is 0 or 1, so that build-up and tail-off have passed (section 5.4 of
    the thesis). An empty combination counts as steady. Where a command is not known, nothing is taken to
    have fired, and the sample is not usable.

    Args:
        command: fraction commanded over the interval, 0 to 1, NaN where not known, shape (n_jets,).
        previous_command: fraction commanded over the interval before, likewise.
        level: thrust level at the start of the interval, shape (n_jets,).
        impulse_per_level: torque and force of each jet times the sample period, shape (n_jets, 6).
        lag: factors of the thrust lag; with zero time constants the level is the command.
        outside_impulse: of known outside forces, about the vehicle origin, shape (6,); None: none.
    """
    steady, known, firing = classify_command(command, previous_command)
    if not known:
        command = select_where(np.isnan(command), 0.0, command)
        firing = has_nonzero(command)
    mean = after = command
    if not lag.instantaneous:
        mean, after = mean_level(level, command, lag.mean), level_after(level, command, lag.remaining)
    impulse = np.dot(mean, impulse_per_level)
    if _is_acting(outside_impulse):
        impulse, firing = _add_outside_impulse(impulse, outside_impulse), True
    return Impulses(
        angular_impulse=impulse[:3],
        linear_impulse=impulse[3:],
        usable=steady,
        firing=firing,
        level=after,
        mean_level=mean,
    )


@kernel
def _is_acting(outside_impulse: Array | None) -> bool:
    """Tests whether an outside impulse is stated and not zero."""
    if outside_impulse is None:
        return False
    return has_nonzero(outside_impulse)


@kernel
def _add_outside_impulse(impulse: Array, outside_impulse: Array | None) -> Array:
    """Returns the impulse with the outside impulse added, shape (6,); None: there is none."""
    if outside_impulse is None:
        return impulse
    return impulse + outside_impulse


@kernel
def add_wrench(impulses: Impulses, wrench: Array, period_s: float) -> Impulses:
    """Adds the impulse of a constant wrench about the vehicle origin, shape (6,), over a sample period."""
    impulse = wrench * period_s
    return Impulses(
        impulses.angular_impulse + impulse[:3],
        impulses.linear_impulse + impulse[3:],
        impulses.usable,
        impulses.firing,
        impulses.level,
        impulses.mean_level,
    )

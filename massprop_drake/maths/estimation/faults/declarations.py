"""Declarations that the hypothesis filter makes about a run."""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

from massprop_drake.maths.estimation.joint.separation import Separation
from massprop_drake.maths.linear_algebra import Array


class Mode(IntEnum):
    """Fault mode of a jet."""

    NONE = 0
    STUCK_ON = 1
    LEAK = 2
    STUCK_OFF = 3
    LOSS = 4
    DRIFTING = 5
    INTERMITTENT = 6


class Word(IntEnum):
    """Kind of declaration about a jet; the first two also serve for a group of indistinguishable jets."""

    FAILED = 1
    GROUP = 2  # one of these has failed
    CHANGED = 3
    WITHDRAWN = 4  # nothing is left of an earlier failure
    ERRATIC = 5  # it gives something else every time


class JetsDeclared(NamedTuple):
    """Declaration about jets.

    Attributes:
        jets: indices; of a group its members, likeliest first.
        signs: 1: it gives more than it is told to, -1: less.
        forces, sigmas: of each, lbf or N; NaN but for the first where a group is spoken of again.
        onset_s: when it began.
        apart: what would tell the members of a group apart.
    """

    word: Word
    jets: tuple[int, ...]
    signs: tuple[int, ...]
    forces: tuple[float, ...]
    sigmas: tuple[float, ...]
    onset_s: float
    apart: Separation = Separation()


class JumpDeclared(NamedTuple):
    """Declaration of a jump of the mass properties.

    It is made when the jump is found, with its size if that is known by then, and again when the filter has settled
    after it and knows the mass to a tenth.

    Attributes:
        measured: whether this is the second time.
        onset_s: when it had not happened yet.
        mass, mass_sigma: gained (released: negative), NaN when it is first said while the jump's filter does
            not fit or the mass is not known to a tenth, slug or kg.
        position, position_sigma: where, vehicle frame, NaN while the mass is not significant, ft or m, shape (3,).
    """

    measured: bool
    onset_s: float
    mass: float
    mass_sigma: float
    position: Array
    position_sigma: Array


class ReadingDeclared(NamedTuple):
    """Declaration of a false reading.

    Attributes:
        component: index among all, gyros first, see `joint.hypotheses.Cause`.
        onset_s: before its first wrong sample.
    """

    component: int
    onset_s: float


class Unexplained(NamedTuple):
    """Declaration that no hypothesis explains the readings.

    Attributes:
        onset_s: when it began.
    """

    onset_s: float


class DisturbanceDeclared(NamedTuple):
    """Declaration of a disturbance that is not stated, and changes slowly.

    Attributes:
        onset_s: since when.
        torque, force: its 1-sigma, to an order of magnitude, ft-lbf and lbf, or N-m and N; NaN without accelerometer.
    """

    onset_s: float
    torque: float
    force: float


Declaration = JetsDeclared | JumpDeclared | ReadingDeclared | Unexplained | DisturbanceDeclared

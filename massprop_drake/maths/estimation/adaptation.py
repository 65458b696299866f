r"""Adaptation of the filters to a sample in which a jet is seen to fail (section 4.5 of the thesis).

With f c the estimated signature and C its covariance, all three keep the signature out of the estimates:

- CORRECT: subtract f c and keep the gains; the covariance gets back what f cost, S += K C K^T. The best
  linear update with an unknown force, since the corrected innovation has covariance Y - C.
- CORRECT_THESIS: subtract f c with gains made smaller by Y + C (4-34), (4-35).
- REJECT: do not use the sample.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np

from massprop_drake.maths.arrays import FLAG, NUMBER, Layout
from massprop_drake.maths.kernels import idiom
from massprop_drake.maths.linear_algebra import Array


class Action(IntEnum):
    """Action of the filters on a sample."""

    NONE = 0
    CORRECT = 1
    CORRECT_THESIS = 2
    REJECT = 3


class Adaptation(NamedTuple):
    """Adaptation that the filters apply to a sample.

    Attributes:
        action: NONE, CORRECT, CORRECT_THESIS or REJECT.
        translation, rotation: signature f c to take out of the innovations, shape (3,) each.
        translation_spread, rotation_spread: C_11 and C_22 (4-32), shape (3, 3) each.
        mass_jumped: whether the mass filter is to start anew.
    """

    action: Action
    translation: Array
    rotation: Array
    translation_spread: Array
    rotation_spread: Array
    mass_jumped: bool


_NONE = np.zeros(3)
_NO_SPREAD = np.zeros((3, 3))
NO_ADAPTATION = Adaptation(Action.NONE, _NONE, _NONE, _NO_SPREAD, _NO_SPREAD, mass_jumped=False)


def _passive_adaptation(action, mass_jumped):  # type: ignore[no-untyped-def] # compiled alone
    """Makes the adaptation of `passive_adaptation` in compiled code."""
    return Adaptation(action, np.zeros(3), np.zeros(3), np.zeros((3, 3)), np.zeros((3, 3)), mass_jumped)


@idiom(_passive_adaptation)
def passive_adaptation(action: int, mass_jumped: bool) -> Adaptation:
    """Makes a filter adaptation with an action and a jump flag, its corrections of the innovations zero."""
    if action == Action.NONE and not mass_jumped:
        return NO_ADAPTATION
    return NO_ADAPTATION._replace(action=Action(action), mass_jumped=mass_jumped)


LAYOUT = Layout(
    "adaptation",
    action=NUMBER,
    translation=3,
    rotation=3,
    translation_spread=(3, 3),
    rotation_spread=(3, 3),
    mass_jumped=FLAG,
)
_ACTION, _JUMPED = LAYOUT.slice("action").start, LAYOUT.slice("mass_jumped").start


def pack_adaptation(adaptation: Adaptation) -> Array:
    """Packs an adaptation of the filters' update into a vector, shape (26,)."""
    return LAYOUT.pack(adaptation)


def unpack_adaptation(vector: Array) -> Adaptation:
    """Unpacks an adaptation from a vector of shape (26,): the inverse of `pack_adaptation`."""
    if vector.item(_ACTION) == 0.0 and vector.item(_JUMPED) == 0.0:  # Action.NONE
        return NO_ADAPTATION
    action, *parts = LAYOUT.read(vector)
    return Adaptation(Action(int(action)), *parts)

r"""What the filters do with a sample in which a jet is seen to fail (section 4.5 of the thesis).

With f c the estimated signature and C its covariance, all three keep the signature out of the estimates:

- CORRECT: subtract f c and keep the gains; the covariance gets back what f cost, S += K C K^T. The best
  linear update with an unknown force, since the corrected innovation has covariance Y - C.
- CORRECT_THESIS: subtract f c with gains made smaller by Y + C (4-34), (4-35).
- REJECT: do not use the sample.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from massprop_drake.maths.linear_algebra import Array

NO_ACTION, CORRECT, CORRECT_THESIS, REJECT = 0, 1, 2, 3

N_ADAPTATION = 26


class Adaptation(NamedTuple):
    """What the filters are to do with a sample.

    Attributes:
        action: NO_ACTION, CORRECT, CORRECT_THESIS or REJECT.
        translation, rotation: signature f c to take out of the innovations, shape (3,) each.
        translation_spread, rotation_spread: C_11 and C_22 (4-32), shape (3, 3) each.
        mass_jumped: whether the mass filter is to start anew.
    """

    action: int
    translation: Array
    rotation: Array
    translation_spread: Array
    rotation_spread: Array
    mass_jumped: bool


_NONE = np.zeros(3)
_NO_SPREAD = np.zeros((3, 3))
NO_ADAPTATION = Adaptation(NO_ACTION, _NONE, _NONE, _NO_SPREAD, _NO_SPREAD, mass_jumped=False)


def packed(adaptation: Adaptation) -> Array:
    """An adaptation as a vector, shape (26,)."""
    vector = np.empty(N_ADAPTATION)
    vector[0] = adaptation.action
    vector[1:4] = adaptation.translation
    vector[4:7] = adaptation.rotation
    vector[7:16] = adaptation.translation_spread.ravel()
    vector[16:25] = adaptation.rotation_spread.ravel()
    vector[25] = adaptation.mass_jumped
    return vector


def unpacked(vector: Array) -> Adaptation:
    """The inverse of `packed`."""
    if vector[0] == NO_ACTION and vector[25] == 0.0:
        return NO_ADAPTATION
    return Adaptation(
        int(vector[0]),
        vector[1:4],
        vector[4:7],
        vector[7:16].reshape(3, 3),
        vector[16:25].reshape(3, 3),
        mass_jumped=bool(vector[25]),
    )

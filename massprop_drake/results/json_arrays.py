"""Arrays as JSON has them, and back: NaN is null, and the ten parameters stand by name."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from massprop_drake.maths import mass_properties
from massprop_drake.maths.mass_properties import CENTER_OF_MASS, MASS_RECIPROCAL, six_elements

Array = NDArray[np.float64]


def null_for_nan(values: Array) -> Any:
    """Converts an array to nested lists of floats, NaN to None."""
    if values.ndim > 1:
        return [null_for_nan(row) for row in values]
    return [None if math.isnan(value) else value for value in values.tolist()]


def onsets_as_json(onset_s: Array) -> dict[str, Any]:
    """Returns {"command_onset": opening times of jets, s; null: constant level} for saved states; {} without pulses."""
    return {"command_onset": null_for_nan(onset_s)} if np.isfinite(onset_s).any() else {}


def parameters_by_name(parameters: Array) -> dict[str, Any]:
    """Maps "inverse_inertia" (3 x 3), "center_of_mass" and "mass_reciprocal" to values; NaN as None."""
    values = null_for_nan(parameters)
    matrix = [[values[index] for index in row] for row in mass_properties.ELEMENT.tolist()]
    return {
        "inverse_inertia": matrix,
        "center_of_mass": values[CENTER_OF_MASS],
        "mass_reciprocal": values[MASS_RECIPROCAL],
    }


def parameters_from_names(values: Mapping[str, Any]) -> Array:
    """Converts what `parameters_by_name` returns to the ten parameters, None as NaN, shape (10,)."""
    inverse = np.array(values["inverse_inertia"], dtype=float)
    center = np.array(values["center_of_mass"], dtype=float)
    reciprocal = np.array([values["mass_reciprocal"]], dtype=float)
    return np.concatenate([six_elements(inverse), center, reciprocal])

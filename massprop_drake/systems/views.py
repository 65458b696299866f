"""Names for the elements of port vectors, as pydrake's `namedview` gives them.

    View = port_view("estimate")
    View(estimation.GetOutputPort("estimate").Eval(context)).Ixx_inv
    View = port_view("detector_report", vehicle.designations)
    View(detector_report).likelihood_R4R

Elements are called as the components of logged signals are: `<field>_<component>`, or `<field>` where there is one.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from itertools import product
from typing import Any

from pydrake.common.containers import namedview

from massprop_drake.maths.mass_properties import N_ROTATION, NAMES
from massprop_drake.systems.layouts import (
    ADAPTATION,
    DETECTOR_REPORT,
    EVIDENCE,
    HYPOTHESIS_REPORT,
    IMPULSES,
    JOINT_REPORT,
    KNOWN_FORCE,
    MASS_ESTIMATE,
    MASS_REPORT,
    POSE_REPORT,
    RECONFIGURATION,
    ROTATION_REPORT,
    SELECTION_COUNTS,
    TURNING,
)

Names = tuple[str, ...]

JETS = "jets"  # stands for the vehicle's jets among the dimensions of a port
AXES, QUATERNION = ("x", "y", "z"), ("w", "x", "y", "z")
MOTIONS = ("translation", "rotation")
_WRENCH = tuple(f"{part}_{axis}" for part in ("torque", "force") for axis in AXES)
_INCREMENTS = tuple(f"{part}_{axis}" for part in MOTIONS for axis in AXES)
_ROTATIONAL = NAMES[:N_ROTATION]

# components along a dimension of a field, by its size; those below where another field is of the same size
_BY_SIZE: dict[int | str, Names] = {
    **{1: ("",), 2: MOTIONS, 3: AXES, 4: QUATERNION, 6: _INCREMENTS, N_ROTATION: _ROTATIONAL, 10: NAMES},
    JETS: (JETS,),
}
_OF_FIELDS: dict[str, Names] = {
    **dict.fromkeys(("wrench", "known_wrench"), _WRENCH),
    **dict.fromkeys(("heading_turn", "heading_turn_std"), ("cosine", "sine")),
}

# ports of packed fields, by the name that a diagram exports them or a system takes them by
_PACKED = {
    layout.name: layout
    for layout in (
        ADAPTATION,
        DETECTOR_REPORT,
        EVIDENCE,
        HYPOTHESIS_REPORT,
        IMPULSES,
        JOINT_REPORT,
        KNOWN_FORCE,
        MASS_ESTIMATE,
        MASS_REPORT,
        POSE_REPORT,
        RECONFIGURATION,
        ROTATION_REPORT,
        SELECTION_COUNTS,
        TURNING,
    )
}
# ports of one quantity: the components along each of its dimensions, row by row
_PLAIN: dict[str, tuple[Names, ...]] = {
    **dict.fromkeys(("estimate", "standard_deviation", "predicted"), (NAMES,)),
    "covariance": (NAMES, NAMES),
    **dict.fromkeys(("rotation_estimate", "predicted_estimate"), (_ROTATIONAL,)),
    "rotation_covariance": (_ROTATIONAL, _ROTATIONAL),
    **dict.fromkeys(("rotation_innovation", "mass_innovation", "attitude_error", "delivered"), (AXES,)),
    **dict.fromkeys(("rotation_innovation_covariance", "mass_innovation_covariance"), (AXES, AXES)),
    "outside_wrench": (_WRENCH,),
    "hand_controllers": (tuple(f"{hand}_{axis}" for hand in ("rhc", "thc") for axis in AXES),),
    "request": ((*(f"{change}_{axis}" for change in ("dw", "dv") for axis in AXES), "time_limit", "urgency"),),
    **dict.fromkeys(
        (
            *("command", "held_command", "command_onset", "held_command_onset", "jet_commands"),
            *("mean_level", "closed", "held_closed", "out_of_use", "failed_jets"),
        ),
        ((JETS,),),
    ),
    "fault_probability": ((JETS, "none", "unknown"),),
}
PORTS = tuple(sorted((*_PACKED, *_PLAIN)))


def port_view(port: str, jets: Sequence[str] | None = None) -> Any:
    """Makes a class of vectors whose elements have names, for the vector of a port.

    Args:
        port: one of `PORTS`; a report of a system alone has the name that the diagram exports it by.
        jets: designations of the jets, in the vehicle's order, where elements are of jets; what is no letter or digit
            in them becomes an underscore. None: no elements are of jets.

    Raises:
        ValueError: when there is no such port, or jets are needed and not given.
    """
    parts = [part for of_field in elements(port).values() for part in of_field]
    if jets is None and any(JETS in part for part in parts):
        raise ValueError(f"the port '{port}' has elements of jets: give their designations, vehicle.designations")
    names = [name for part in parts for name in _expand_names(part, _identifiers(jets or ()))]
    return namedview("".join(word.capitalize() for word in port.split("_")) + "View", names)


def elements(port: str) -> dict[str, list[Names]]:
    """Maps fields of a port to their elements in order, each a tuple of words; `JETS` stands for any jet.

    A port of one quantity has one field, which is not among the words.

    Raises:
        ValueError: when there is no such port.
    """
    if port in _PLAIN:
        return {port: list(product(*_PLAIN[port]))}
    if port not in _PACKED:
        raise ValueError(f"there is no port '{port}' with named elements; there are {', '.join(PORTS)}")
    return {field: list(product((field,), *_components(field, shape))) for field, shape in _PACKED[port].shapes()}


def _components(field: str, shape: Iterable[int | str]) -> list[Names]:
    """Returns the names of a field's components along each of its dimensions."""
    return [_OF_FIELDS.get(field, _BY_SIZE[size]) for size in shape]


def _expand_names(element_words: Names, jets: Names) -> list[str]:
    """Joins the words of an element to its name, or to one name per jet where it is of jets."""
    choices = (jets if word == JETS else (word,) for word in element_words)
    return ["_".join(filter(None, words)) for words in product(*choices)]


def _identifiers(jets: Sequence[str]) -> Names:
    """Converts jet designations to parts of Python names, with the index where two would be the same."""
    plain = tuple(re.sub(r"[\W_]+", "_", jet) for jet in jets)
    return plain if len(set(plain)) == len(plain) else tuple(f"{jet}_{index}" for index, jet in enumerate(plain))

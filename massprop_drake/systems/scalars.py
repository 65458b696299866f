"""Systems for every scalar type of Drake: float, AutoDiffXd and Expression.

A system is a template: `RigidBodyPlant_[T]` beside `RigidBodyPlant`, the class for floats. Drake converts it with the
diagram that it stands in: `ToAutoDiffXd`, `ToSymbolic`, `Linearize`. A part without derivatives refuses by `refuse`.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import numpy as np
from pydrake.autodiffutils import AutoDiffXd
from pydrake.symbolic import Expression
from pydrake.systems.scalar_conversion import TemplateSystem

from massprop_drake.errors import InputError

_CALLBACKS = ("_calc", "_compute", "_update", "_apply", "DoCalc")
_RESULT = {AutoDiffXd: "AutoDiffXd", Expression: "Expression"}


def float_class(template: Any, name: str) -> Any:
    """Returns the class of a system's template for floats, renamed to the name that users import."""
    system = template[float]
    system.__name__ = system.__qualname__ = name
    return system


def template(make: Callable[[Any], type]) -> Any:
    """Makes a Drake `TemplateSystem` from a function that makes a system's class for a scalar type."""

    def make_class(scalar: Any) -> type:
        """Makes the class for a scalar type; without NaN warnings in callbacks for Expression."""
        system = make(scalar)
        for name, member in list(vars(system).items()) if scalar is Expression else []:
            if name.startswith(_CALLBACKS):  # numpy takes the bits of an Expression for NaN, and would warn
                setattr(system, name, np.errstate(invalid="ignore")(member))
        return system

    return TemplateSystem.define(make.__name__, scope=sys.modules[make.__module__])(make_class)


def refuse(scalar: Any, system: str, reasons: list[str], remedy: str) -> None:
    """Raises InputError where a system has no form for a scalar type T, for stated reasons.

    Args:
        scalar: T.
        system: name of the system in the message.
        reasons: why there are no derivatives; none: the type is accepted.
        remedy: how to do without.

    Raises:
        InputError: when T is not float and there is a reason.
    """
    if reasons and scalar is not float:
        raise InputError(f"{system} {' and '.join(reasons)}, so it has no form for {_RESULT[scalar]}: {remedy}")

"""Sensor packages of one kind that a filter reads."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from pydrake.systems.framework import LeafSystem

from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.vehicle.sensing import mask_saturated


class KnownPackage(NamedTuple):
    """Sensor package as a filter knows it.

    Attributes:
        name: of its input port.
        limit: largest reading either way, where the sensor saturates; infinity: unlimited.
    """

    name: str
    limit: float


class Readings:
    """Input ports of some packages, and their readings side by side.

    Args:
        system: that gets the ports, one per package.
        packages: the preferred one first.
    """

    def __init__(self, system: LeafSystem, packages: tuple[KnownPackage, ...]):
        self._packages = packages
        self.ports = [system.DeclareVectorInputPort(package.name, 3) for package in packages]

    def eval(self, context: Any) -> Array:
        """Stacks readings of all packages from the input ports, NaN where missing or saturated, shape (s, 3).

        The first package's port must be connected; another that is not counts as missing.
        """
        readings = np.empty((len(self.ports), 3))
        for index, (port, package) in enumerate(zip(self.ports, self._packages, strict=True)):
            if index == 0 or port.HasValue(context):
                reading = port.Eval(context)
                readings[index] = reading if package.limit == math.inf else mask_saturated(reading, package.limit)
            else:
                readings[index] = math.nan
        return readings

"""Sets of jets that are worth firing together."""

from __future__ import annotations

import numpy as np

from massprop_drake.maths.autopilot.jet_selection import activity_vectors
from massprop_drake.maths.maneuver.actions import Craft
from massprop_drake.systems.autopilot.jet_selection_program import JetSelectionProgram

_ASKED = 0.2  # of what the strongest jet gives in a second; jets then fire together, compute budget
_SHARE = 0.3  # of the longest on-time of a selection: jets with less stay shut, compute budget


def jet_sets(craft: Craft) -> list[tuple[int, ...]]:
    """Lists sets of jets, by index: single jets, then the set of least propellant for each axis and sign.

    Args:
        craft: see `Craft`.
    """
    sets: list[tuple[int, ...]] = [(jet,) for jet in craft.jets.tolist()]
    if not sets:
        return []
    activity = activity_vectors(craft.params.wrenches, craft.properties)
    limits = np.zeros(craft.params.places.jets)
    limits[craft.jets] = 1.0
    program = JetSelectionProgram(craft.flows)
    for axis in range(6):
        reach = float(np.abs(activity[axis, craft.jets]).max())
        for sign in (1.0, -1.0):
            request = np.zeros(6)
            request[axis] = _ASKED * sign * reach
            on_times = program.solve(activity, request, limits).on_times_s
            if on_times.any():
                sets.append(tuple(np.flatnonzero(on_times > _SHARE * on_times.max()).tolist()))
    return list(dict.fromkeys(sets))

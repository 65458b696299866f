"""Validity rules for a saved state of the joint filter, checked when it is restored."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from massprop_drake.maths.estimation.joint.covariance import order_root_rows
from massprop_drake.maths.estimation.joint.layout import JointState, Places
from massprop_drake.maths.estimation.joint.ticks import Clock
from massprop_drake.maths.linear_algebra import Array, triangular_rows

_ROUNDING = 1e-9  # of a level
_UNIT = 1e-6  # of the square of a quaternion's length


def check_state_rules(state: JointState, clock: Clock, frame: Array, layout: Places) -> Iterator[tuple[bool, str]]:
    """Yields for each rule on a saved joint-filter state whether it is broken, and its error message."""
    told = state._replace(read=state.read[~np.isnan(state.read)], assumed=state.assumed[~np.isnan(state.assumed)])
    yield abs(float(frame @ frame) - 1.0) > _UNIT, "the shared attitude must be a unit quaternion"
    finite = all(np.isfinite(part).all() for part in (*told, *clock[:-2]))
    yield not finite, "only commands and readings may be missing"
    unread = (np.isnan(state.read) & (state.fresh > 0.0)).any()
    yield (
        not _are_all_one_of(state.fresh, 0.0, 1.0) or bool(unread),
        "fresh must be 0 or 1, and 0 where no reading is kept",
    )
    rows = triangular_rows(order_root_rows(state.root, layout.thrust))
    yield rows < state.root.shape[0], "the covariance's root must be lower triangular, parameters first"
    yield not _are_all_within(state.level_std, 0.0, 1.0), "level_std must be between 0 and 1"
    levels = state.level[:0] if clock.off else state.level  # off its tick, beyond for an interval
    fractions = _are_all_within(levels, 0.0, 1.0) and _are_all_within(clock.earlier[~np.isnan(clock.earlier)], 0.0, 1.0)
    yield not fractions, "commands and levels must be fractions of 0 to 1"
    yield state.firing_count < 0.0, "counts must be zero or positive"
    yield not _are_all_one_of(state.lag_open, 0.0, 1.0), "lag_open must be 0 or 1"
    yield not _are_all_one_of(state.slot_on_top, 0.0, 1.0), "slot_on_top must be 0 or 1"
    jets = state.slot_jet
    known = (jets == np.round(jets)).all() and _are_all_within(jets, -1.0, layout.jets - 1.0)
    signed = _are_all_one_of(state.slot_sign, -1.0, 1.0) and bool(known)
    yield not signed, "a slot of a failed jet must have a jet's index and a sign"
    whole = clock.number >= 0.0 and clock.number == round(clock.number)
    yield not whole, "the number of the clock's tick must be a whole one"


def _are_all_one_of(values: Array, first: float, second: float) -> bool:
    """Tests whether all values equal one or the other of two numbers."""
    return bool(np.isin(values, (first, second)).all())


def _are_all_within(values: Array, low: float, high: float) -> bool:
    """Tests whether all values lie within two bounds."""
    return bool(((values >= low - _ROUNDING) & (values <= high + _ROUNDING)).all())

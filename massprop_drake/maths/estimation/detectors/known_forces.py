"""Wrench and covariance of the known forces of failed jets, which a detector gives to the filters."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from massprop_drake.maths.estimation.detector import NO_KNOWN_FORCE, ROTATION, TRANSLATION, KnownForce
from massprop_drake.maths.estimation.detectors.jet_tests import signatures
from massprop_drake.maths.kernels import kernel, select_where
from massprop_drake.maths.linear_algebra import Array, has_nonzero


def known_force(state: Any, mass_properties: Array, command: Array, params: Any) -> KnownForce:
    """Computes the wrench of failed jets' known forces, and the covariance they add to the measurements.

    Args:
        state: of the detector, with `force` and `variance`; see `detector.Detector`.
        mass_properties: the ten predicted parameters, shape (10,).
        command: fraction commanded over the interval that ended, NaN where not known, shape (n_jets,).
        params: of the detector, with `period_s`, `unit_wrenches` and `thrusts` as in `detector.KnownJets`.
    """
    if not has_nonzero(state.variance):
        return NO_KNOWN_FORCE
    return acting_force(state, mass_properties, command, params)


@kernel
def acting_force(state: Any, mass_properties: Array, command: Array, params: Any) -> KnownForce:
    """Computes the wrench and covariances of failed jets' known forces, of which there is at least one."""
    jets = np.flatnonzero(state.variance)
    wrenches = params.unit_wrenches[jets]
    c = signatures(wrenches, mass_properties, params.period_s)
    excess = excess_share(state, jets, command, params)
    variance = state.variance[jets] * excess**2
    return KnownForce(
        (state.force[jets] * excess) @ wrenches,
        (c[:, TRANSLATION].T * variance) @ c[:, TRANSLATION],
        (c[:, ROTATION].T * variance) @ c[:, ROTATION],
    )


@kernel
def excess_share(state: Any, jet_indices: NDArray[np.int_], command: Array, params: Any) -> Array:
    """Computes the fraction of each known force that is not commanded, shape (k,).

    A jet that is stuck on gives no more when it is told to fire; a leak does.
    """
    stuck = state.force[jet_indices] > 0.5 * params.thrusts[jet_indices]
    fractions = command[jet_indices]
    return select_where(stuck, 1.0 - select_where(np.isnan(fractions), 0.0, fractions), 1.0)

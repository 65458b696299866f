"""Interface of every detector of failed jets, whatever its method.

A detector is a record of functions, as `Detector` says, in a file of its own under `detectors/`; its `DETECTOR`
stands in the registry there, and a block of the scenario makes its parameters.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.maths.arrays import Field, Layout
from massprop_drake.maths.estimation.adaptation import Adaptation
from massprop_drake.maths.linear_algebra import Array, has_nonzero

TRANSLATION, ROTATION = slice(0, 3), slice(3, 6)  # parts of the innovation that a detector sees


class Verdict(IntEnum):
    """Event that a detector declares in a cycle."""

    NOTHING = 0
    DECLARED = 1  # a failed jet
    JUMP = 2  # of the mass properties
    WITHDRAWN = 3  # of an earlier declaration nothing is left
    OTHER = 4  # something else, which the method's own report says


class KnownJets(NamedTuple):
    """The jets as a detector knows them.

    Attributes:
        period_s: sample period, s.
        clusters: index of each jet's cluster, shape (n_jets,).
        unit_wrenches: torque about the vehicle origin and force of a unit force along each jet, shape
            (n_jets, 6).
        thrusts: full force of each jet, lbf or N, shape (n_jets,).
        manifolds: index of each jet's propellant manifold, -1: it has none, shape (n_jets,).
        limits: of convergence, see `mass_properties.is_converged`, shape (3,).
    """

    period_s: float
    clusters: NDArray[np.int_]
    unit_wrenches: Array
    thrusts: Array
    manifolds: NDArray[np.int_]
    limits: Array


class Evidence(NamedTuple):
    """Evidence of one sample for a detector.

    Attributes:
        time_s: of the sample, s.
        command: fraction commanded over the interval that ended, NaN where not known, shape (n_jets,).
        usable: whether the combination of jets was steady.
        firing: whether any jet was commanded.
        innovation: of translation, ft/s or m/s, and of rotation, rad/s, NaN where not measured, shape (6,).
        covariance: Y, shape (6, 6).
        coupled: whether translation and rotation share a part of it, by considered thrust errors that bear on
            the sample; else its blocks off the diagonal are zero.
        estimate: the ten parameters, predicted, shape (10,).
        estimate_covariance: Sigma, of their errors, shape (10, 10).
        cross_covariance: Gamma, of the innovation with these errors (true minus predicted), shape (6, 10).
    """

    time_s: float
    command: Array
    usable: bool
    firing: bool
    innovation: Array
    covariance: Array
    coupled: bool
    estimate: Array
    estimate_covariance: Array
    cross_covariance: Array


class KnownForce(NamedTuple):
    """Effect of the known forces of failed jets on one sample.

    Attributes:
        wrench: torque about the vehicle origin and force, shape (6,).
        translation_spread, rotation_spread: what their uncertainty adds to the covariances of the
            velocity and rate increments, shape (3, 3) each.
    """

    wrench: Array
    translation_spread: Array
    rotation_spread: Array

    @property
    def acts(self) -> bool:
        """Tests whether the known force has any effect on the sample; a stuck jet that is commanded has none."""
        return self is not NO_KNOWN_FORCE and bool(self.wrench.any() or self.translation_spread.any())


KNOWN_FORCE = Layout("known_force", wrench=6, translation_spread=(3, 3), rotation_spread=(3, 3))

_NO_SPREAD = np.zeros((3, 3))
NO_KNOWN_FORCE = KnownForce(np.zeros(6), _NO_SPREAD, _NO_SPREAD)


def unpack_known_force(vector: Array) -> KnownForce:
    """Unpacks wrench and covariances of a known force from a vector; `NO_KNOWN_FORCE` where all is zero."""
    return KnownForce(*KNOWN_FORCE.read(vector)) if has_nonzero(vector) else NO_KNOWN_FORCE


# what is logged of every cycle; what does not apply to a method is NaN
STATUS = Layout(
    "status",
    tested=Field("sample tested for failed jets"),
    alarm=Field("alarm of a failed jet"),
    detector_event=Field("0 none, 1 failure declared, 2 jump, 3 withdrawn, 4 other", component="event"),
    suspected_cluster=Field("likeliest cluster", component="cluster"),
    suspected_jet=Field("index of the likeliest jet", component="jet"),
    jet_isolated=Field("alarm names the jet", component="isolated"),
    suspected_magnitude=Field("magnitude of the likeliest jet's failure", "{force}", "magnitude"),
    suspected_magnitude_std=Field("1-sigma of it", "{force}", "std"),
    suspected_likelihood=Field("its likelihood argument", component="likelihood"),
    cluster_margin=Field("margin of the likeliest cluster", component="margin"),
    jet_margin=Field("margin of the likeliest jet in its cluster", component="margin"),
    unexplained=Field("part of the innovations it leaves unexplained"),
    onset=Field("onset of the alarms in a row", "s"),
    alarms=Field("alarms in a row"),
)


class Judgment(NamedTuple):
    """Judgment of one sample by a detector.

    Attributes:
        state: to remember, see `Detector`.
        adaptation: what the filter is to do with the sample.
        status: of the fields of `STATUS`.
        likelihood: statistic of every jet, NaN where the sample was not tested, shape (n_jets,).
        magnitude: estimated force of every jet's failure, lbf or N, likewise.
        replacement: a state that the filter is to go on from in place of its own; None: it keeps its own.
        own: what the method logs besides, the fields of `Detector.report`; None: nothing.
        published: a state whose estimates are published, though the filter does not go on from it; None: those of the
            state that it goes on from.
    """

    state: Any
    adaptation: Adaptation
    status: Any
    likelihood: Array
    magnitude: Array
    replacement: Any = None
    own: Any = None
    published: Any = None


class Detector(NamedTuple):
    """A method of finding failed jets.

    Its state is a named tuple, of floats and arrays alone where it has a layout. Among its fields are `force` and
    `variance`, the known force of each failed jet, lbf or N, and its variance, zero where none is known; `removed`, 1
    for each jet to be taken out of use; and `closed`, 1 for each jet whose manifold has been closed; shape (n_jets,)
    each.

    Attributes:
        params: (jets, options) -> parameters; options are the scenario's block, word for word. With `made_for` it
            takes the filter's parameters besides.
        initial: params -> state at the start.
        known_force: (state, ten predicted parameters, command, params) -> `KnownForce`; `NO_KNOWN_FORCE` itself
            where none acts.
        judge: (state, evidence, params) -> `Judgment`; the evidence is an `Evidence`, or what the filter that it is
            made for gives.
        layout: params -> fields of the state, packed; None: it is kept by `saved` and `restored`, in as many numbers
            as it takes, at least as many as at the start.
        saved: (state, params) -> a vector to keep it by.
        restored: (vector, params) -> state; raises ValueError when the detector cannot have left it.
        made_for: name of the one filter that it goes with; empty: any whose evidence is a `Joint`.
        group: name of its part of a saved state.
        report: fields of `Judgment.own`, a signal each; a size "jets" is the number of jets; None: none.
    """

    params: Callable[..., Any]
    initial: Callable[[Any], Any]
    known_force: Callable[[Any, Array, Array, Any], KnownForce]
    judge: Callable[[Any, Any, Any], Judgment]
    layout: Callable[[Any], Layout] | None = None
    saved: Callable[[Any, Any], Array] | None = None
    restored: Callable[[Array, Any], Any] | None = None
    made_for: str = ""
    group: str = "failure_detector"
    report: Layout | None = None

    def pack_state(self, state: Any, params: Any) -> Array:
        """Packs the detector's state into a vector."""
        if self.layout is not None:
            return self.layout(params).pack(state)
        assert self.saved is not None, "a detector has a layout, or keeps its state itself"
        return self.saved(state, params)

    def unpack_state(self, vector: Array, params: Any) -> Any:
        """Unpacks the detector's state from a vector: the inverse of `pack_state`.

        Raises:
            ValueError: when the detector cannot have left such a state.
        """
        if self.layout is None:
            assert self.restored is not None, "a detector has a layout, or keeps its state itself"
            return self.restored(vector, params)
        state = type(self.initial(params))(*self.layout(params).read(vector))
        if not np.isfinite(vector).all():
            raise ValueError(f"{self.group}: must be finite")
        if (state.variance < 0.0).any():
            raise ValueError(f"{self.group}: variances of known forces must be zero or positive")
        if not all(np.isin(flags, (0.0, 1.0)).all() for flags in (state.removed, state.closed)):
            raise ValueError(f"{self.group}: removed and closed must be 0 or 1 for each jet")
        return state

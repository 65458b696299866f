"""Torque and force on the vehicle besides those of its jets."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydrake.common import RandomDistribution
from pydrake.systems.framework import LeafSystem_

from massprop_drake.maths.kernels import value_of
from massprop_drake.maths.vehicle.disturbance import (
    DisturbanceModel,
    add_wrench,
    draw_initial_deviation,
    move_to_origin,
    next_deviation,
)
from massprop_drake.maths.vehicle.reaction_jets import profile_size
from massprop_drake.systems.caching import declare_output, state_of
from massprop_drake.systems.layouts import STRUCTURE
from massprop_drake.systems.parameters import Named, Parameters
from massprop_drake.systems.scalars import float_class, template
from massprop_drake.systems.vehicle.noise_source import run_seed

_DEVIATION, _BEGUN = slice(0, 6), 6  # of the state
_AXES = ("torque_x", "torque_y", "torque_z", "force_x", "force_y", "force_z")


@template
def Disturbance_(T: Any) -> Any:  # noqa: N802 (Drake's name of a template)
    """Makes the class of disturbing torques and forces for a scalar type T, see `Disturbance`."""

    class Push(LeafSystem_[T]):
        """Adds a slowly changing torque and force to the wrench of the jets on its way to the body.

        Ports:
            jets (in, 7 (1 + n_lags)): `wrench` or `wrench_profile` of `ReactionJets`.
            structure (in, 9): see `RigidBodyPlant`; the torque is about the center of mass as it is.
            noise (in, 6): independent standard normal numbers, new at each sample.
            seed (in, 1): varies the seed of the deviation before the start, see `noise_seed`. Optional.
            wrench (out, 7 (1 + n_lags)): the sum, for the body.

        Parameters: see `parameters`: mean (torque_x to force_z) and std, 1-sigma of the deviation from it,
        ft-lbf and lbf or N-m and N.

        State: deviation (6) from the mean, torque and force, over the sample now running; at t_k before the update,
        over the one that ended. Then 1 since the first update, 0 before it, when the deviation is the seed's.

        Timing: held over each sample. A stepped body's wrench is that of the coming sample, a continuous one's of the
        running one.

        Scalars: float, AutoDiffXd and Expression.

        Args:
            model: mean, size and correlation; its deviation before the start counts where no seed is given.
            period_s: sample period, s.
            stepped: whether the body is stepped, and so asks for the coming sample.
            n_lags, pieces: of the jets' profile.
            seed: of the run, which draws the deviation before the start; None: that of the model.

        Attributes:
            parameters: those in a context, by name.
        """

        def _construct(
            self,
            model: DisturbanceModel,
            *,
            period_s: float,
            stepped: bool,
            n_lags: int = 0,
            pieces: int = 1,
            seed: int | None = None,
            converter: Any = None,
        ) -> None:
            """Declares ports, parameters and state; arguments as the class."""
            LeafSystem_[T].__init__(self, converter)
            self.set_name("disturbance")
            self._made = {"period_s": period_s, "stepped": stepped, "n_lags": n_lags, "pieces": pieces, "seed": seed}
            self._model, self._stepped, self._pieces, self._seed = model, stepped, pieces, seed
            self.parameters = Parameters(self, T, {"mean": Named(model.mean, _AXES), "std": Named(model.std, _AXES)})
            size = profile_size(n_lags, pieces)
            self._jets = self.DeclareVectorInputPort("jets", size)
            self._structure = self.DeclareVectorInputPort("structure", STRUCTURE.size)
            self._noise = self.DeclareVectorInputPort("noise", 6, RandomDistribution.kGaussian)
            self._varied = self.DeclareVectorInputPort("seed", 1)
            self.DeclareDiscreteState(_BEGUN + 1)
            needed = [self._jets, self._structure, self._varied, *([self._noise] if stepped else [])]
            tickets = {*(port.ticket() for port in needed), self.xd_ticket(), self.parameters.ticket}
            declare_output(self, "wrench", size, self._calc_wrench, tickets)
            self.DeclarePeriodicDiscreteUpdateEvent(period_sec=period_s, offset_sec=0.0, update=self._update)

        def _construct_copy(self, other: Any, converter: Any = None) -> None:
            """Constructs the disturbance from one of another scalar type."""
            Push._construct(self, other._model, converter=converter, **other._made)

        def _running_deviation(self, context: Any) -> Any:
            """Returns the random deviation over the running sample, torque and force, shape (6,)."""
            state = state_of(context)
            if value_of(state[_BEGUN]):
                return state[_DEVIATION]
            if self._seed is None:
                return self._model.before
            return draw_initial_deviation(run_seed(context, self._varied, self._seed), self.parameters.get(context).std)

        def _next_deviation(self, context: Any) -> Any:
            """Computes the random deviation over the coming sample, torque and force, shape (6,)."""
            model = self._model._replace(std=self.parameters.get(context).std)
            return next_deviation(self._running_deviation(context), self._noise.Eval(context), model)

        def _calc_wrench(self, context: Any) -> Any:
            """Computes the sum of the jets' wrench and the disturbance, packed as the jets' wrench."""
            deviation = self._next_deviation(context) if self._stepped else self._running_deviation(context)
            center = STRUCTURE.read(self._structure.Eval(context)).center_of_mass
            total = self.parameters.get(context).mean + deviation
            return add_wrench(self._jets.Eval(context), move_to_origin(total, center), self._pieces)

        def _update(self, context: Any, state: Any) -> None:
            """Stores the deviation over the sample that begins."""
            state.set_value(np.append(self._next_deviation(context), T(1.0)))

    return Push


Disturbance: Any = float_class(Disturbance_, "Disturbance")

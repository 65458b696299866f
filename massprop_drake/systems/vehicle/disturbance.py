"""Adds what disturbs the vehicle to what its jets give."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.common import RandomDistribution
from pydrake.systems.framework import LeafSystem

from massprop_drake.maths.vehicle.disturbance import DisturbanceModel, disturbed, next_deviation
from massprop_drake.maths.vehicle.rigid_body import N_WRENCH
from massprop_drake.systems.layouts import STRUCTURE

Array = NDArray[np.float64]


class Disturbance(LeafSystem):
    """A slowly changing torque and force, added to the wrench of the jets on its way to the body.

    Ports:
        jets (in, 7 (1 + n_lags)): `wrench` or `wrench_profile` of `ReactionJets`.
        structure (in, 9): see `RigidBodyPlant`; the torque is about the center of mass as it is.
        noise (in, 6): independent standard normal numbers, new at each sample.
        wrench (out, 7 (1 + n_lags)): the sum, for the body.

    State: deviation (6) from the mean, torque and force, over the sample now running; at t_k before the update, over
    the one that ended.

    Timing: held over each sample. A stepped body's wrench is that of the coming sample, a continuous one's of the
    running one.

    Args:
        model: mean, size and correlation.
        period_s: sample period, s.
        stepped: whether the body is stepped, and so asks for the coming sample.
        n_lags: of the jets' profile.
    """

    def __init__(self, model: DisturbanceModel, *, period_s: float, stepped: bool, n_lags: int = 0):
        super().__init__()
        self.set_name("disturbance")
        self._model, self._stepped = model, stepped
        size = N_WRENCH * (1 + n_lags)
        self._jets = self.DeclareVectorInputPort("jets", size)
        self._structure = self.DeclareVectorInputPort("structure", STRUCTURE.size)
        self._noise = self.DeclareVectorInputPort("noise", 6, RandomDistribution.kGaussian)
        self._deviation = self.DeclareDiscreteState(model.before)
        needed = [self._jets, self._structure, *([self._noise] if stepped else [])]
        tickets = {self.input_port_ticket(port.get_index()) for port in needed} | {self.xd_ticket()}
        self.DeclareVectorOutputPort("wrench", size, self._calc_wrench, prerequisites_of_calc=tickets)
        self.DeclarePeriodicDiscreteUpdateEvent(period_sec=period_s, offset_sec=0.0, update=self._update)

    def _coming(self, context: Any) -> Array:
        deviation = context.get_discrete_state(self._deviation).CopyToVector()
        return next_deviation(deviation, self._noise.Eval(context), self._model)

    def _calc_wrench(self, context: Any, output: Any) -> None:
        held = context.get_discrete_state(self._deviation).CopyToVector()
        deviation = self._coming(context) if self._stepped else held
        center = STRUCTURE.read(self._structure.Eval(context)).center_of_mass
        output.SetFromVector(disturbed(self._jets.Eval(context), self._model.mean + deviation, center))

    def _update(self, context: Any, state: Any) -> None:
        state.set_value(self._deviation, self._coming(context))

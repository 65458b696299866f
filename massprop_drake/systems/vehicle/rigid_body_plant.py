"""The true rigid body."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import BasicVector, LeafSystem

from massprop_drake.maths.kernels import chosen, held
from massprop_drake.maths.mass_properties import MassProperties
from massprop_drake.maths.vehicle import ports, rigid_body
from massprop_drake.maths.vehicle.ports import Motion
from massprop_drake.maths.vehicle.rigid_body import MASS, N_WRENCH, RATE, Jump, OutOfMassError, SpunUpError

Array = NDArray[np.float64]

_LEAST_TIME_S = 1e-9  # that the mass must last in a continuous plant, whose steps shrink with what is left


class RigidBodyPlant(LeafSystem):
    """A free rigid body under the wrench of its jets, without gravity.

    Equations, frames and the order of the state: `massprop_drake.maths.vehicle.rigid_body`.

    Ports:
        wrench (in, 7, continuous plant only): torque about the vehicle origin (3), force (3), body
            axes, and mass flow, at this instant. Required.
        wrench_profile (in, 7 (1 + n_lags), stepped plant only): see `ReactionJets`. Required.
        body_state (out, 23): the state. No feedthrough.
        structure (out, 9): the state of that name. No feedthrough.
        mass_properties (out, 10): the true ten parameters, see `maths.mass_properties`.

    State: body_state (23), continuous or discrete; structure (9), discrete: inertia about the center
    of mass (11, 22, 33, 23, 13, 12) and center of mass. They are state, not parameters, because a
    payload may leave.

    Timing: a stepped plant's update at t_k carries the body from t_k to t_k+1 under the command
    decided at t_k; a continuous one is integrated by the simulator.

    Args:
        properties: mass properties at the start.
        time_step: 0 for a continuous plant; positive, s: steps of this length.
        lag_time_constants_s: of the profile's dying parts, s.
        initial_rate: rad/s, body axes, shape (3,).
        jumps: of the mass properties.
        period_s: sample period, s; needed with jumps.
        compiled: whether the step's kernel is.
    """

    def __init__(
        self,
        properties: MassProperties,
        *,
        time_step: float,
        lag_time_constants_s: tuple[float, ...] = (),
        initial_rate: Array | None = None,
        jumps: tuple[Jump, ...] = (),
        period_s: float = 0.0,
        compiled: bool = False,
    ):
        super().__init__()
        self.set_name("rigid_body")
        self._time_step = time_step
        self._compiled = compiled
        motion = Motion(np.array(lag_time_constants_s, dtype=float), time_step)
        self._kernel, self._held = chosen(ports.stepped, compiled), held(motion, compiled)
        start = rigid_body.initial_state(properties.mass)
        if initial_rate is not None:
            start[RATE] = initial_rate
        self._structure = self.DeclareDiscreteState(rigid_body.packed_structure(properties))
        if time_step == 0.0:
            self._wrench = self.DeclareVectorInputPort("wrench", N_WRENCH)
            self._state = self.DeclareContinuousState(BasicVector(start))
            self.DeclareStateOutputPort("body_state", self._state)
        else:
            self._wrench = self.DeclareVectorInputPort("wrench_profile", N_WRENCH * (1 + len(lag_time_constants_s)))
            self._state = self.DeclareDiscreteState(start)
            self.DeclareStateOutputPort("body_state", self._state)
            self.DeclarePeriodicDiscreteUpdateEvent(period_sec=time_step, offset_sec=0.0, update=self._update)
        self._jumps = rigid_body.jumps_by_sample(jumps, period_s) if jumps else {}
        self._period_s = period_s
        if jumps:
            self.DeclarePeriodicUnrestrictedUpdateEvent(period_sec=period_s, offset_sec=0.0, update=self._jump)
        self.DeclareStateOutputPort("structure", self._structure)
        self.DeclareVectorOutputPort(
            "mass_properties",
            10,
            self._calc_mass_properties,
            prerequisites_of_calc={self.xd_ticket(), self.xc_ticket()},
        )

    def _body(self, context: Any) -> rigid_body.Body:
        return rigid_body.body_of_structure(context.get_discrete_state(self._structure).get_value())

    def _body_state(self, context: Any) -> Array:
        if self._time_step == 0.0:
            return context.get_continuous_state_vector().CopyToVector()
        return context.get_discrete_state(self._state).CopyToVector()

    def _calc_mass_properties(self, context: Any, output: Any) -> None:
        body = self._body(context)
        mass = float(self._body_state(context)[MASS])
        output.SetFromVector(np.array([*body.inverse, *body.center, 1.0 / mass]))

    def DoCalcTimeDerivatives(self, context: Any, derivatives: Any) -> None:  # noqa: N802 (overrides Drake's)
        """The continuous plant's equations of motion."""
        if self._time_step == 0.0:
            wrench = self._wrench.Eval(context)
            body, state = self._body(context), self._body_state(context)
            try:
                rigid_body.require_mass(float(state[MASS]), _LEAST_TIME_S * float(wrench[-1]))
            except OutOfMassError as error:
                raise error.at(context.get_time()) from None
            derivatives.get_mutable_vector().SetFromVector(rigid_body.derivative(state, wrench, body))

    def _jump(self, context: Any, state: Any) -> None:
        structure = context.get_discrete_state(self._structure).CopyToVector()
        jumps = self._jumps.get(round(context.get_time() / self._period_s), ())
        body_state, structure = rigid_body.jumped(self._body_state(context), structure, jumps)
        state.get_mutable_discrete_state(self._structure).SetFromVector(structure)
        if self._time_step == 0.0:
            state.get_mutable_continuous_state().SetFromVector(body_state)
        else:
            state.get_mutable_discrete_state(self._state).SetFromVector(body_state)

    def _update(self, context: Any, state: Any) -> None:
        profile, before = self._wrench.Eval(context), self._body_state(context)
        structure = context.get_discrete_state(self._structure).CopyToVector()
        constants = _constants(structure.tobytes(), self._compiled)
        try:
            after = self._kernel(before, profile, constants, self._held)
        except (OutOfMassError, SpunUpError) as error:
            raise error.at(context.get_time()) from None
        state.set_value(self._state, after)


@lru_cache(maxsize=256)
def _constants(structure: bytes, compiled: bool) -> Any:
    """A holder of the constants of motion for a structure."""
    return held(rigid_body.body_of_structure(np.frombuffer(structure)), compiled)

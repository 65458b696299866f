"""The true reaction-control jets: from commands to forces, torques and propellant flow."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import LeafSystem

from massprop_drake.maths.kernels import chosen, held
from massprop_drake.maths.vehicle import ports
from massprop_drake.maths.vehicle.ports import Jets
from massprop_drake.maths.vehicle.reaction_jets import jets_params, level_now, thrusters
from massprop_drake.maths.vehicle.rigid_body import N_WRENCH
from massprop_drake.maths.vehicle.thrust import level_at
from massprop_drake.maths.vehicle.true_failures import Failure, failure_table, struck
from massprop_drake.systems.caching import Cached
from massprop_drake.systems.vehicle.noise_source import seed_in

Array = NDArray[np.float64]

_NONE = np.zeros(0)


class ReactionJets(LeafSystem):
    r"""Thrust of all jets, with an optional first-order build-up and tail-off.

    Within a sample each jet's level goes from where it was toward its command with its time constant,
    in closed form; see `massprop_drake.maths.vehicle.thrust`. A time constant of zero is instantaneous thrust.

    Ports:
        command (in, n_jets): fraction commanded over the coming sample, 0 to 1. Required for
            `thrust` and `wrench_profile`.
        held_command (in, n_jets): the command of the sample now running; at t_k before the update,
            of the one that ended. Required.
        closed (in, n_jets), held_closed (in, n_jets): 1 for each jet whose manifold is closed over the
            coming and over the running sample. Optional.
        seed (in, 1): varies the seed of intermittent failures, see `noise_seed`. Optional.
        thrust (out, n_jets): mean force over the coming sample, lbf or N, along each jet's direction.
        wrench (out, 7): torque about the vehicle origin (3), force (3), body axes, and mass flow, at this
            instant; for a continuous plant.
        wrench_profile (out, 7 (1 + n_classes)): for a stepped plant: the wrench that the coming sample
            tends to, then for each time constant the part that dies away with it; see
            `maths.rigid_body.step`.

    State: level (n_jets) at the last update's sample; time of that update, s. Neither changes when all
    thrust is instantaneous and nothing fails.

    Timing: after the update at t_k the state holds the level at t_k, reached under the command of
    [t_k-1, t_k).

    Args:
        wrenches: torque about the vehicle origin, force, mass flow at full thrust, shape (n_jets, 7).
        time_constants_s: of each jet, s, shape (n_jets,).
        period_s: sample period, s.
        failures: what jets deliver in place of what they are told; see `maths.vehicle.true_failures`.
        seed: of intermittent failures.
        compiled: whether its kernels are.
    """

    def __init__(
        self,
        *,
        wrenches: Array,
        time_constants_s: Array,
        period_s: float,
        failures: tuple[Failure, ...] = (),
        seed: int = 0,
        compiled: bool = False,
    ):
        super().__init__()
        self.set_name("reaction_jets")
        n_jets = wrenches.shape[0]
        self._params = jets_params(wrenches, time_constants_s, period_s, failures, seed)
        self._jets = thrusters(self._params)
        self._kernel, self._failed = chosen(ports.thrust, compiled), chosen(ports.failed_target, compiled)
        self._given = held(Jets(self._jets, failure_table(failures), period_s), compiled)
        self._n_jets = n_jets
        self._time_constants_s = time_constants_s
        self._instantaneous = self._params.lag.instantaneous
        self._period_s = period_s

        command = self._command = self.DeclareVectorInputPort("command", n_jets)
        before = self._held = self.DeclareVectorInputPort("held_command", n_jets)
        closed = self._closed = self.DeclareVectorInputPort("closed", n_jets)
        held_closed = self._held_closed = self.DeclareVectorInputPort("held_closed", n_jets)
        self._level = self.DeclareDiscreteState(n_jets)
        self._updated_s = self.DeclareDiscreteState([-period_s])
        # `wrench` must not depend on `command`: with a continuous plant that would close an algebraic
        # loop through the sensors and the autopilot
        varied = self._varied = self.DeclareVectorInputPort("seed", 1)
        running = {self.input_port_ticket(port.get_index()) for port in (before, held_closed, varied)}
        running |= {self.xd_ticket(), self.time_ticket()}
        coming = running | {self.input_port_ticket(port.get_index()) for port in (command, closed)}
        self._coming = Cached(self, "thrust", self._compute, coming)
        coming = {self._coming.ticket}
        self.DeclareVectorOutputPort("thrust", n_jets, self._calc_thrust, prerequisites_of_calc=coming)
        self.DeclareVectorOutputPort("wrench", N_WRENCH, self._calc_wrench, prerequisites_of_calc=running)
        self.DeclareVectorOutputPort(
            "wrench_profile",
            N_WRENCH * (1 + len(self.lag_time_constants_s)),
            self._calc_profile,
            prerequisites_of_calc=coming,
        )
        if failures or not self._instantaneous:
            self.DeclarePeriodicDiscreteUpdateEvent(period_sec=period_s, offset_sec=0.0, update=self._update)

    @property
    def lag_time_constants_s(self) -> tuple[float, ...]:
        """The distinct positive time constants, s, in the order of `wrench_profile`."""
        return self._params.classes.time_constants_s

    def _shown(self, command: Any, closed: Any, sample: int, context: Any) -> Array:
        """What each jet's level tends to over a sample, by the ports of what it is told and of what is closed."""
        told, shut = command.Eval(context), closed.Eval(context) if closed.HasValue(context) else None
        failures = self._params.failures
        if not failures:
            return told if shut is None else told * (1.0 - shut)
        strikes = struck(failures, sample, self._period_s, seed_in(context, self._varied, self._params.seed))
        shut = _NONE if shut is None else shut
        shown: Array = self._failed(told, shut, sample * self._period_s, strikes, self._given)
        return shown

    def _held_target(self, context: Any) -> Array:
        """What it tends to over the sample that the last update began."""
        sample = round(context.get_discrete_state(self._updated_s).GetAtIndex(0) / self._period_s)
        return self._shown(self._held, self._held_closed, sample, context)

    def _level_now(self, context: Any) -> Array:
        """Level at this sample, before the update: a period after the level in the state."""
        level = context.get_discrete_state(self._level).CopyToVector()
        return level_now(level, self._held_target(context), self._jets)

    def _level_that_matters(self, context: Any) -> Array:
        """The same; anything where no jet lags."""
        return self._params.forces if self._instantaneous else self._level_now(context)

    def _compute(self, context: Any) -> Array:
        """Mean forces, then the wrench profile, over the coming sample."""
        sample = round(context.get_time() / self._period_s)
        coming = self._shown(self._command, self._closed, sample, context)
        row: Array = self._kernel(self._level_that_matters(context), coming, self._given)
        return row

    def _calc_thrust(self, context: Any, output: Any) -> None:
        output.SetFromVector(self._coming.get(context)[: self._n_jets])

    def _calc_wrench(self, context: Any, output: Any) -> None:
        elapsed = context.get_time() - context.get_discrete_state(self._updated_s).GetAtIndex(0)
        level = context.get_discrete_state(self._level).CopyToVector()
        reached = level_at(level, self._held_target(context), self._time_constants_s, elapsed)
        output.SetFromVector(reached @ self._params.wrenches)

    def _calc_profile(self, context: Any, output: Any) -> None:
        output.SetFromVector(self._coming.get(context)[self._n_jets :])

    def _update(self, context: Any, state: Any) -> None:
        state.set_value(self._level, self._level_now(context))
        state.set_value(self._updated_s, [context.get_time()])

"""The true reaction-control jets: from commands to forces, torques and propellant flow."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import LeafSystem

from massprop_drake.maths.vehicle.rigid_body import N_WRENCH
from massprop_drake.maths.vehicle.thrust import lag_factors, level_after, level_at, mean_level
from massprop_drake.maths.vehicle.true_failures import Failure, delivered
from massprop_drake.systems.layouts import WRENCH

Array = NDArray[np.float64]


class LagClasses(NamedTuple):
    """Jets grouped by time constant, so that a few exponentials carry all transients.

    Attributes:
        time_constants_s: the distinct positive time constants, s.
        wrenches: for each, the wrench of its jets, zero for others, shape (n_classes, n_jets, 7).
    """

    time_constants_s: tuple[float, ...]
    wrenches: Array


def lag_classes(wrenches: Array, time_constants_s: Array) -> LagClasses:
    """The classes of a set of jets.

    Args:
        wrenches: torque about the vehicle origin, force, mass flow of each jet, shape (n_jets, 7).
        time_constants_s: of each jet, s, shape (n_jets,).
    """
    distinct = tuple(sorted({constant for constant in time_constants_s.tolist() if constant > 0.0}))
    members = [(time_constants_s == constant)[:, None] * wrenches for constant in distinct]
    return LagClasses(distinct, np.array(members).reshape(len(distinct), *wrenches.shape))


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
    """

    def __init__(
        self,
        *,
        wrenches: Array,
        time_constants_s: Array,
        period_s: float,
        failures: tuple[Failure, ...] = (),
        seed: int = 0,
    ):
        super().__init__()
        self.set_name("reaction_jets")
        n_jets = wrenches.shape[0]
        self._wrenches = wrenches
        self._forces = np.linalg.norm(WRENCH.columns(wrenches)["force"], axis=1)
        self._time_constants_s = time_constants_s
        self._lag = lag_factors(time_constants_s, period_s)
        self._classes = lag_classes(wrenches, time_constants_s)
        self._instantaneous = not time_constants_s.any()
        self._period_s = period_s
        self._failures = failures
        self._seed = seed

        command = self._command = self.DeclareVectorInputPort("command", n_jets)
        held = self._held = self.DeclareVectorInputPort("held_command", n_jets)
        closed = self._closed = self.DeclareVectorInputPort("closed", n_jets)
        held_closed = self._held_closed = self.DeclareVectorInputPort("held_closed", n_jets)
        self._level = self.DeclareDiscreteState(n_jets)
        self._updated_s = self.DeclareDiscreteState([-period_s])
        # `wrench` must not depend on `command`: with a continuous plant that would close an algebraic
        # loop through the sensors and the autopilot
        running = {self.input_port_ticket(port.get_index()) for port in (held, held_closed)}
        running |= {self.xd_ticket(), self.time_ticket()}
        coming = running | {self.input_port_ticket(port.get_index()) for port in (command, closed)}
        self.DeclareVectorOutputPort("thrust", n_jets, self._calc_thrust, prerequisites_of_calc=coming)
        self.DeclareVectorOutputPort("wrench", N_WRENCH, self._calc_wrench, prerequisites_of_calc=running)
        self.DeclareVectorOutputPort(
            "wrench_profile",
            N_WRENCH * (1 + len(self._classes.time_constants_s)),
            self._calc_profile,
            prerequisites_of_calc=coming,
        )
        if failures or not self._instantaneous:
            self.DeclarePeriodicDiscreteUpdateEvent(period_sec=period_s, offset_sec=0.0, update=self._update)

    @property
    def lag_time_constants_s(self) -> tuple[float, ...]:
        """The distinct positive time constants, s, in the order of `wrench_profile`."""
        return self._classes.time_constants_s

    def _target(self, context: Any) -> Array:
        """What each jet's level tends to over the coming sample."""
        target = self._command.Eval(context)
        if self._failures:
            sample = round(context.get_time() / self._period_s)
            target = delivered(target, sample, self._period_s, self._failures, self._seed)
        return self._unless_closed(context, target, self._closed)

    def _held_target(self, context: Any) -> Array:
        """What it tends to over the sample that the last update began."""
        sample = round(context.get_discrete_state(self._updated_s).GetAtIndex(0) / self._period_s)
        target = delivered(self._held.Eval(context), sample, self._period_s, self._failures, self._seed)
        return self._unless_closed(context, target, self._held_closed)

    def _unless_closed(self, context: Any, target: Array, closed: Any) -> Array:
        if closed.HasValue(context):
            return target * (1.0 - closed.Eval(context))
        return target

    def _level_now(self, context: Any) -> Array:
        """Level at this sample, before the update: a period after the level in the state."""
        level = context.get_discrete_state(self._level).CopyToVector()
        return level_after(level, self._held_target(context), self._lag.remaining)

    def _mean_level(self, context: Any) -> Array:
        command = self._target(context)
        if self._instantaneous:
            return command
        return mean_level(self._level_now(context), command, self._lag.mean)

    def _calc_thrust(self, context: Any, output: Any) -> None:
        output.SetFromVector(self._forces * self._mean_level(context))

    def _calc_wrench(self, context: Any, output: Any) -> None:
        elapsed = context.get_time() - context.get_discrete_state(self._updated_s).GetAtIndex(0)
        level = context.get_discrete_state(self._level).CopyToVector()
        target = self._held_target(context)
        output.SetFromVector(level_at(level, target, self._time_constants_s, elapsed) @ self._wrenches)

    def _calc_profile(self, context: Any, output: Any) -> None:
        target = self._target(context)
        profile = target @ self._wrenches
        if not self._instantaneous:
            difference = self._level_now(context) - target
            profile = np.concatenate([profile, *(difference @ wrenches for wrenches in self._classes.wrenches)])
        output.SetFromVector(profile)

    def _update(self, context: Any, state: Any) -> None:
        state.set_value(self._level, self._level_now(context))
        state.set_value(self._updated_s, [context.get_time()])

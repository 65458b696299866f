"""The true reaction wheels."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydrake.common import RandomDistribution
from pydrake.systems.framework import LeafSystem

from massprop_drake.maths.vehicle.wheel_motors import WheelsModel, acceleration, draw_inertias, momentum, read_speed
from massprop_drake.systems.caching import Cached, declare_output
from massprop_drake.systems.vehicle.noise_source import run_seed


class ReactionWheels(LeafSystem):
    """Spins reaction wheels up and down by the torques of their motors.

    Ports:
        wheel_torque (in, n): torque of each motor on its wheel over the coming sample, ft-lbf or N-m. Unconnected:
            none.
        noise (in, n): independent standard normal numbers, new at each sample. Required.
        seed (in, 1): varies the seed, see `noise_seed`. Optional.
        wheels (out, 6): angular momentum relative to the vehicle and its time derivative, body axes, see
            `RigidBodyPlant`: for a stepped plant as the coming sample begins, for a continuous one at this instant.
        wheel_speeds (out, n): rad/s. No feedthrough.
        <wheel> (out, 1): what is read of the speed of each wheel, rad/s.

    State: speeds at the last sample, rad/s (n), the accelerations that followed, rad/s^2 (n), and its time, s (1).

    Timing: a torque at t_k acts on [t_k, t_k+1).

    Args:
        model: see `WheelsModel`.
        names: of the wheels.
        period_s: sample period, s.
        stepped: whether the body is carried by steps of a sample.
        seed: of the run.
    """

    def __init__(self, model: WheelsModel, names: tuple[str, ...], *, period_s: float, stepped: bool, seed: int):
        super().__init__()
        self.set_name("reaction_wheels")
        self._model, self._seed, self._stepped = model, seed, stepped
        n = self._n = len(names)
        self._torque = self.DeclareVectorInputPort("wheel_torque", n)
        self._noise = self.DeclareVectorInputPort("noise", n, RandomDistribution.kGaussian)
        self._varied = self.DeclareVectorInputPort("seed", 1)
        start = np.concatenate((model.start, np.zeros(n), [-period_s]))
        self._state = self.DeclareDiscreteState(start)
        self._period_s = period_s
        self.DeclarePeriodicDiscreteUpdateEvent(period_sec=period_s, offset_sec=0.0, update=self._update)
        self._inertias = Cached(self, "inertias", self._compute_inertias, {self._varied.ticket()})
        running = {self._inertias.ticket, self.time_ticket(), self.xd_ticket()}
        acting = running | {self._torque.ticket()} if stepped else running
        declare_output(self, "wheels", 6, self._calc_momentum, acting)
        declare_output(self, "wheel_speeds", n, self._present_speeds, running)
        for place, name in enumerate(names):

            def read(context: Any, place: int = place) -> Any:
                """Reads the speed of a wheel with noise, rad/s."""
                speed, noise = self._present_speeds(context)[place], self._noise.Eval(context)[place]
                return [read_speed(speed, noise, place, model)]

            declare_output(self, name, 1, read, running | {self._noise.ticket()})

    @property
    def n_noise(self) -> int:
        """Number of random numbers that it takes at each sample."""
        return self._n

    def _compute_inertias(self, context: Any) -> Any:
        """Draws the true inertias of all wheels by the seed."""
        return draw_inertias(self._model, run_seed(context, self._varied, self._seed))

    def _present_speeds(self, context: Any) -> Any:
        """Computes wheel speeds at this instant, rad/s, shape (n,); at the first sample those of the start."""
        state, n = context.get_discrete_state(self._state).CopyToVector(), self._n
        return state[:n] + (context.get_time() - state[-1]) * state[n : 2 * n]

    def _next_accelerations(self, context: Any) -> Any:
        """Computes the wheels' accelerations over the coming sample by the motors' torques, rad/s^2, shape (n,)."""
        inertias = self._inertias.get(context)
        torque = self._torque.Eval(context) if self._torque.HasValue(context) else np.zeros(self._n)
        return acceleration(torque, inertias, self._present_speeds(context), self._model, self._period_s)

    def _calc_momentum(self, context: Any) -> Any:
        """Computes the wheels' total angular momentum and its time derivative, body axes, shape (6,)."""
        if self._stepped:
            accelerations = self._next_accelerations(context)
        else:
            accelerations = context.get_discrete_state(self._state).CopyToVector()[self._n : 2 * self._n]
        inertias = self._inertias.get(context)
        return momentum(self._present_speeds(context), accelerations, inertias, self._model)

    def _update(self, context: Any, state: Any) -> None:
        """Stores speeds and accelerations of the wheels, and the sample's time."""
        after = np.concatenate((self._present_speeds(context), self._next_accelerations(context), [context.get_time()]))
        state.set_value(self._state, after)

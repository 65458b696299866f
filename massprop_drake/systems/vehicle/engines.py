"""The true engines."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydrake.common import RandomDistribution
from pydrake.systems.framework import LeafSystem

from massprop_drake.maths.vehicle.disturbance import add_wrench
from massprop_drake.maths.vehicle.engine_thrust import N_CHANNELS, channel_mask, follow_command
from massprop_drake.maths.vehicle.reaction_jets import profile_size
from massprop_drake.maths.vehicle.true_engines import (
    EnginesModel,
    draw_engine_errors,
    effective_command,
    engines_wrench,
    mean_wrench,
    read_engines,
    reshape_by_engine,
)
from massprop_drake.systems.caching import Cached, declare_output
from massprop_drake.systems.vehicle.noise_source import run_seed


class Engines(LeafSystem):
    """Burns engines at their commanded levels and turns their gimbals, and adds that to the wrench of the jets.

    Ports:
        jets (in, 7 (1 + n_lags)): `wrench` or `wrench_profile` of `ReactionJets`. Required.
        engine_command (in, 3 n): level and two angles of each, rad, over the coming sample. Required.
        noise (in, 3 n): independent standard normal numbers, new at each sample. Required.
        seed (in, 1): varies the seed, see `noise_seed`. Optional.
        wrench (out, 7 (1 + n_lags)): the sum, for the body: of a stepped body with the mean over the coming sample, of
            a continuous one at this instant.
        engine_state (out, 3 n): levels and angles as they are. No feedthrough.
        <engine> (out, 1 or 3): what telemetry has of each, rad: with a gimbal level and angles, else the level.

    State: levels and angles at the last sample (3 n), what they follow since (3 n), and its time, s (1).

    Timing: a command at t_k holds over [t_k, t_k+1).

    Args:
        model: see `EnginesModel`.
        names: of the engines.
        period_s: sample period, s.
        stepped: whether the body is carried by steps of a sample.
        n_lags, pieces: of the jets' profile.
        seed: of the run.
    """

    def __init__(
        self,
        model: EnginesModel,
        names: tuple[str, ...],
        *,
        period_s: float,
        stepped: bool,
        n_lags: int = 0,
        pieces: int = 1,
        seed: int,
    ):
        super().__init__()
        self.set_name("engines")
        self._model, self._seed, self._stepped, self._pieces = model, seed, stepped, pieces
        size, profile = N_CHANNELS * len(names), profile_size(n_lags, pieces)
        self._size, self._period_s = size, period_s
        self._jets = self.DeclareVectorInputPort("jets", profile)
        self._command = self.DeclareVectorInputPort("engine_command", size)
        self._noise = self.DeclareVectorInputPort("noise", size, RandomDistribution.kGaussian)
        self._varied = self.DeclareVectorInputPort("seed", 1)
        self._state = self.DeclareDiscreteState(np.append(np.zeros(2 * size), -period_s))
        self.DeclarePeriodicDiscreteUpdateEvent(period_sec=period_s, offset_sec=0.0, update=self._update)
        command, noise, jets = (port.ticket() for port in (self._command, self._noise, self._jets))
        self._errors = Cached(self, "errors", self._compute_errors, {self._varied.ticket()})
        running = {self.time_ticket(), self.xd_ticket()}
        acting = {*running, self._errors.ticket, jets, *((command,) if stepped else ())}
        declare_output(self, "wrench", profile, self._calc_wrench, acting)
        declare_output(self, "engine_state", size, lambda context: self._channels(context).ravel(), running)
        has = channel_mask(model.engines)
        for place, name in enumerate(names):

            def read(context: Any, place: int = place) -> Any:
                """Reads an engine's level, and its gimbal angles, rad, where it has a gimbal, with noise."""
                told, noise = (reshape_by_engine(port.Eval(context)) for port in (self._command, self._noise))
                return read_engines(self._channels(context), told, noise, model.engines)[place][has[place]]

            declare_output(self, name, int(has[place].sum()), read, {*running, command, noise})

    @property
    def n_noise(self) -> int:
        """Number of random numbers that it takes at each sample."""
        return self._size

    def _compute_errors(self, context: Any) -> Any:
        """Draws the errors of thrust and alignment of all engines by the seed."""
        return draw_engine_errors(self._model, run_seed(context, self._varied, self._seed))

    def _channels(self, context: Any) -> Any:
        """Computes the engines' levels and gimbal angles at this instant, shape (n, 3)."""
        state, n = context.get_discrete_state(self._state).CopyToVector(), self._size
        now, told = reshape_by_engine(state[:n]), reshape_by_engine(state[n : 2 * n])
        return follow_command(now, told, context.get_time() - state[-1], self._model.engines)[0]

    def _target(self, context: Any) -> Any:
        """Computes levels and angles commanded to the engines over the coming sample, shape (n, 3)."""
        return effective_command(
            self._channels(context), reshape_by_engine(self._command.Eval(context)), context.get_time(), self._model
        )

    def _calc_wrench(self, context: Any) -> Any:
        """Computes the sum of the jets' and engines' wrench, packed as the jets' wrench."""
        errors, present, time_s = self._errors.get(context), self._channels(context), context.get_time()
        if self._stepped:
            added = mean_wrench(present, self._target(context), errors, (time_s, self._period_s), self._model)
        else:
            since_s = context.get_discrete_state(self._state).value()[-1]
            added = engines_wrench(present[None], errors, since_s, self._model)
        return add_wrench(self._jets.Eval(context), added, self._pieces)

    def _update(self, context: Any, state: Any) -> None:
        """Stores levels and angles of this sample, the coming ones, and its time."""
        after = np.concatenate((self._channels(context).ravel(), self._target(context).ravel(), [context.get_time()]))
        state.set_value(self._state, after)

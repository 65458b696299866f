"""What rate gyros and integrating accelerometers have in common."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.common import RandomDistribution
from pydrake.systems.framework import LeafSystem

from massprop_drake.maths.vehicle.rigid_body import N_STATE
from massprop_drake.maths.vehicle.sensing import SensorModel, sense, sense_now
from massprop_drake.systems.caching import Cached
from massprop_drake.systems.layouts import NOISE

Array = NDArray[np.float64]


class Sensor(LeafSystem):
    """A package of three sensors along the body axes, with the errors of `maths.sensing.SensorModel`.

    Ports:
        body_state (in, 23): see `RigidBodyPlant`. Required.
        noise (in, 6): independent standard normal numbers, new at each sample. Required when the
            model is noisy.
        reading (out, 3): body axes.

    State: memory (10 + 3 delay), see `maths.sensing.sense`; none for a model that remembers nothing.

    Timing: the reading at t_k is of the body at t_k, or `delay` samples before; vibration is taken at t_k too.

    Args:
        name: of the system, the package's name.
        model: its errors.
    """

    def __init__(self, name: str, model: SensorModel):
        super().__init__()
        self.set_name(name)
        self._model = model
        self._exact = model.exact
        self._body_state = self.DeclareVectorInputPort("body_state", N_STATE)
        self._noise = self.DeclareVectorInputPort("noise", NOISE.size, RandomDistribution.kGaussian)
        inputs = {self.input_port_ticket(self._body_state.get_index())}
        if model.noisy:
            inputs.add(self.input_port_ticket(self._noise.get_index()))
        if model.vibration is not None:
            inputs.add(self.time_ticket())
        if model.remembers:
            self._memory = self.DeclareDiscreteState(model.memory_size)
            self._step = Cached(self, "step", self._compute, {self.xd_ticket(), *inputs})
            self.DeclareVectorOutputPort(
                "reading", 3, self._calc_remembering, prerequisites_of_calc={self._step.ticket}
            )
            self.DeclarePeriodicDiscreteUpdateEvent(period_sec=model.period_s, offset_sec=0.0, update=self._update)
        else:
            self.DeclareVectorOutputPort("reading", 3, self._calc_direct, prerequisites_of_calc=inputs)

    def _signal(self, body_state: Array) -> Array:
        """The true quantity, shape (3,)."""
        raise NotImplementedError

    def _calc_direct(self, context: Any, output: Any) -> None:
        model = self._model
        signal = self._signal(self._body_state.Eval(context))
        if self._exact:
            output.SetFromVector(model.read(signal))
            return
        noise = self._noise.Eval(context) if model.noisy else None
        output.SetFromVector(sense_now(signal, noise, model, context.get_time()))

    def _compute(self, context: Any) -> tuple[Array, Array]:
        noise = self._noise.Eval(context) if self._model.noisy else np.zeros(6)
        memory = context.get_discrete_state(self._memory).CopyToVector()
        return sense(self._signal(self._body_state.Eval(context)), memory, noise, self._model, context.get_time())

    def _calc_remembering(self, context: Any, output: Any) -> None:
        reading, _ = self._step.get(self, context)
        output.SetFromVector(reading)

    def _update(self, context: Any, state: Any) -> None:
        _, memory = self._step.get(self, context)
        state.set_value(self._memory, memory)

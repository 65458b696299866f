"""What rate gyros and integrating accelerometers have in common."""

from __future__ import annotations

import math
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from pydrake.common import RandomDistribution
from pydrake.systems.framework import LeafSystem

from massprop_drake.maths.kernels import chosen, held
from massprop_drake.maths.vehicle import ports
from massprop_drake.maths.vehicle.ports import Sensing
from massprop_drake.maths.vehicle.rigid_body import N_STATE
from massprop_drake.maths.vehicle.sensing import SensorModel, vibrating
from massprop_drake.systems.arguments import vector
from massprop_drake.systems.caching import Cached, state_of
from massprop_drake.systems.layouts import NOISE

Array = NDArray[np.float64]


_QUIET = np.zeros(NOISE.size)
_READING, _AFTER = slice(0, 3), slice(3, None)  # of what the kernel gives of a package that remembers


class StatedPackage(Protocol):
    """A package of three sensors as a vehicle has it, see `inputs.vehicle.SensorPackage`."""

    @property
    def name(self) -> str:
        """Of the package."""

    @property
    def quantum(self) -> float:
        """Step of a reading."""

    @property
    def noise_std(self) -> float:
        """White noise of a reading, 1-sigma."""

    @property
    def range(self) -> float | None:
        """Largest reading either way; None: unlimited."""


def stated(package: StatedPackage) -> SensorModel:
    """The errors of a package that its vehicle states, and no others."""
    nothing, limit = np.zeros(3), math.inf if package.range is None else package.range
    return SensorModel(
        period_s=1.0,  # of no effect without memory
        scale_factor=nothing,
        smoothing=0.0,
        bias=nothing,
        walk_std=0.0,
        integrates=False,
        noise_std=package.noise_std,
        quantum=package.quantum,
        phase=nothing,
        delay=0,
        limit=limit,
    )


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
        package: its name, which is that of the system; or a package of a vehicle, such as `vehicle.gyro("gyro")`.
        model: its errors; default those that the package states, which then must be one: quantum, noise and range.
        position: of integrating accelerometers, vehicle frame, ft or m, shape (3,); None: they are rate gyros.
        compiled: whether its kernel is.

    Raises:
        ValueError: when a vector of the model has not three elements.
    """

    def __init__(
        self,
        package: str | StatedPackage,
        model: SensorModel | None = None,
        position: Array | None = None,
        *,
        compiled: bool = False,
    ):
        super().__init__()
        self.set_name(package if isinstance(package, str) else package.name)
        if model is None:
            if isinstance(package, str):
                raise ValueError(f"sensor '{package}': a name alone has no errors; give its model, or a package")
            model = stated(package)
        for name in ("scale_factor", "bias", "phase"):
            vector(f"sensor '{self.get_name()}': {name}", getattr(model, name), 3)
        self._model = model
        self._exact = model.exact
        read: Any = ports.exact_reading if self._exact else ports.reading
        read = ports.remembered_reading if model.remembers else read
        self._kernel = chosen(read, compiled)
        place = np.zeros(3) if position is None else position
        self._held = held(Sensing(model.errors, position is not None, place), compiled)
        self._body_state = self.DeclareVectorInputPort("body_state", N_STATE)
        self._noise = self.DeclareVectorInputPort("noise", NOISE.size, RandomDistribution.kGaussian)
        inputs = {self.input_port_ticket(self._body_state.get_index())}
        if model.noisy:
            inputs.add(self.input_port_ticket(self._noise.get_index()))
        if model.vibration is not None:
            inputs.add(self.time_ticket())
        if model.remembers:
            self.DeclareDiscreteState(model.memory_size)
            self._step = Cached(self, "step", self._compute, {self.xd_ticket(), *inputs})
            self.DeclareVectorOutputPort(
                "reading", 3, self._calc_remembering, prerequisites_of_calc={self._step.ticket}
            )
            self.DeclarePeriodicDiscreteUpdateEvent(period_sec=model.period_s, offset_sec=0.0, update=self._update)
        else:
            self.DeclareVectorOutputPort("reading", 3, self._calc_direct, prerequisites_of_calc=inputs)

    def _chance(self, context: Any) -> tuple[Array, Array]:
        """Noise and vibration at a sample."""
        noise = self._noise.Eval(context) if self._model.noisy else _QUIET
        return noise, vibrating(self._model, context.get_time())

    def _calc_direct(self, context: Any, output: Any) -> None:
        body = self._body_state.Eval(context)
        if self._exact:
            output.SetFromVector(self._kernel(body, self._held))
        else:
            output.SetFromVector(self._kernel(body, *self._chance(context), self._held))

    def _compute(self, context: Any) -> Array:
        body = self._body_state.Eval(context)
        row: Array = self._kernel(body, state_of(context), *self._chance(context), self._held)
        return row

    def _calc_remembering(self, context: Any, output: Any) -> None:
        output.SetFromVector(self._step.get(context)[_READING])

    def _update(self, context: Any, state: Any) -> None:
        state.set_value(self._step.get(context)[_AFTER])

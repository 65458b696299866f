"""Package of three sensors, common to rate gyros and integrating accelerometers."""

from __future__ import annotations

import math
from typing import Any, Protocol

import numpy as np
from pydrake.autodiffutils import AutoDiffXd
from pydrake.common import RandomDistribution
from pydrake.symbolic import Expression
from pydrake.systems.framework import LeafSystem_

from massprop_drake.errors import InputError
from massprop_drake.maths.kernels import compile_kernel_if, make_holder, value_of
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.vehicle import vehicle_ports
from massprop_drake.maths.vehicle.rigid_body import N_STATE
from massprop_drake.maths.vehicle.sensing import Draws, SensorModel, add_drawn_phases, vibration_at
from massprop_drake.maths.vehicle.vehicle_ports import Sensing
from massprop_drake.systems.arguments import require_vector
from massprop_drake.systems.caching import Cached, declare_output, declare_outputs, declare_update, state_of
from massprop_drake.systems.layouts import NOISE
from massprop_drake.systems.parameters import Named, Parameters
from massprop_drake.systems.scalars import float_class, refuse, template
from massprop_drake.systems.vehicle.noise_source import run_seed

_QUIET = np.zeros(NOISE.size)
_READING, _AFTER = slice(0, 3), slice(3, None)  # of what the kernel gives of a package that remembers


class StatedPackage(Protocol):
    """Package of three sensors as a vehicle states it, see `inputs.vehicle_file.SensorPackage`."""

    @property
    def name(self) -> str:
        """Name of the package."""

    @property
    def quantum(self) -> float:
        """Quantum of a reading."""

    @property
    def noise_std(self) -> float:
        """White noise of a reading, 1-sigma."""

    @property
    def range(self) -> float | None:
        """Largest reading either way; None: unlimited."""


def stated_errors(package: StatedPackage) -> SensorModel:
    """Makes the error model of a package from the noise, quantum and range that its vehicle states."""
    zeros, limit = np.zeros(3), math.inf if package.range is None else package.range
    return SensorModel(
        period_s=1.0,  # of no effect without memory
        scale_factor=zeros,
        smoothing=0.0,
        bias=zeros,
        walk_std=0.0,
        integrates=False,
        noise_std=package.noise_std,
        quantum=package.quantum,
        phase=zeros,
        delay=0,
        limit=limit,
    )


@template
def Sensor_(T: Any) -> Any:  # noqa: N802 (Drake's name of a template)
    """Makes the class of three-axis sensor packages for a scalar type T, see `Sensor`."""

    class Triad(LeafSystem_[T]):
        """Reads three sensors along the body axes, with the errors of `maths.vehicle.sensing.SensorModel`.

        Ports:
            body_state (in, 23): see `RigidBodyPlant`. Required.
            noise (in, 6): independent standard normal numbers, new at each sample. Required when the
                model is noisy.
            seed (in, 1, with draws alone): varies the seed of the phases, see `noise_seed`. Optional.
            reading (out, 3): body axes.

        Parameters: see `parameters`. scale_factor (x, y, z), relative; bias (x, y, z), of a reading or, of an
        accelerometer, of its time derivative; walk_std and noise_std, 1-sigma of a sample; quantum, 0: none; phase
        (x, y, z) of the quantizer's marks, quanta, to which a drawn one is added; limit, largest reading either way.

        State: memory (10 + 3 delay), see `maths.vehicle.sensing.sense`; none for a model that remembers nothing.

        Timing: the reading at t_k is of the body at t_k, or `delay` samples before; vibration is taken at t_k too.

        Scalars: float; AutoDiffXd without quantum and limit; Expression also without memory, and
        with noise_std and time as numbers.

        Args:
            package: its name, or a package of a vehicle, such as `vehicle.gyro("gyro")`.
            model: its errors, the parameters' defaults; default those that the package states: quantum, noise and
                range.
            position: in the vehicle frame, ft or m, shape (3,); None: a rate gyro.
            draws: phases that a seed draws.
            seed: of the run.
            compiled: whether its kernel is.

        Attributes:
            parameters: those in a context, by name.

        Raises:
            ValueError: when there is a name without a model, or a vector of it has not three elements.
            InputError: in a conversion of readings without derivatives; in a simulation, when parameters ask for noise
                or memory that the model has not.
        """

        def _construct(
            self,
            package: str | StatedPackage,
            model: SensorModel | None = None,
            position: Array | None = None,
            *,
            draws: Draws | None = None,
            seed: int = 0,
            compiled: bool = False,
            converter: Any = None,
        ) -> None:
            """Declares ports, parameters and state; arguments as the class."""
            LeafSystem_[T].__init__(self, converter)
            self.set_name(package if isinstance(package, str) else package.name)
            if model is None:
                if isinstance(package, str):
                    raise ValueError(f"sensor '{package}': a name alone has no errors; give its model, or a package")
                model = stated_errors(package)
            for name in ("scale_factor", "bias", "phase"):
                require_vector(f"sensor '{self.get_name()}': {name}", getattr(model, name), 3)
            self._made = {"model": model, "position": position, "draws": draws, "seed": seed, "compiled": compiled}
            self._model, self._draws, self._seed = model, draws, seed
            self._compiled = compiled and T is float
            self._integrates, self._place = position is not None, np.zeros(3) if position is None else position
            self.parameters = Parameters(
                self,
                T,
                {
                    "scale_factor": Named(model.scale_factor, "xyz"),
                    "bias": Named(model.bias, "xyz"),
                    "walk_std": Named(model.walk_std),
                    "noise_std": Named(model.noise_std),
                    "quantum": Named(model.quantum),
                    "phase": Named(model.phase, "xyz"),
                    "limit": Named(model.limit),
                },
            )
            self._body_state = self.DeclareVectorInputPort("body_state", N_STATE)
            self._noise = self.DeclareVectorInputPort("noise", NOISE.size, RandomDistribution.kGaussian)
            of_model = {self.parameters.ticket}
            if draws is not None:
                self._varied = self.DeclareVectorInputPort("seed", 1)
                of_model.add(self._varied.ticket())
            self._sensing = Cached(self, "errors", self._compute_sensing, of_model)
            inputs = {self._sensing.ticket, self._body_state.ticket()}
            if model.noisy:
                inputs.add(self._noise.ticket())
            if model.vibration is not None:
                inputs.add(self.time_ticket())
            if model.remembers:
                self.DeclareDiscreteState(model.memory_size)
                step = Cached(self, "step", self._compute, {self.xd_ticket(), *inputs})
                declare_outputs(self, step, [("reading", 3, _READING)])
                declare_update(self, step, model.period_s, _AFTER)
            else:
                declare_output(self, "reading", 3, self._calc_direct, inputs)

        def _construct_copy(self, other: Any, converter: Any = None) -> None:
            """Constructs the sensor from one of another scalar type."""
            _require_smooth_readings(T, other.get_name(), other._model)
            Triad._construct(self, other.get_name(), converter=converter, **other._made)

        def _error_model(self, context: Any) -> SensorModel:
            """Returns the sensor's error model by the parameters in a context, before random draws."""
            values = self.parameters.get(context)
            scalars = ("quantum", "limit", "noise_std", "walk_std")
            numbers: dict[str, Any] = {name: value_of(getattr(values, name)) for name in scalars}
            numbers["phase"] = np.array([value_of(number) for number in values.phase])
            # the bias of a gyro may be symbolic, since it decides nothing
            bias = np.array([value_of(number) for number in values.bias]) if self._integrates else np.zeros(3)
            model, label = self._model._replace(bias=bias, **numbers), f"sensor '{self.get_name()}'"
            _require_smooth_readings(T, self.get_name(), model)
            if model.noisy and not self._model.noisy:
                raise InputError(f"{label} has no noise: build it with a noise_std above zero to vary that")
            if model.remembers and not self._model.remembers:
                raise InputError(f"{label} has no memory: build it with a bias or a walk_std to vary these")
            if T is AutoDiffXd:
                model = model._replace(noise_std=values.noise_std, walk_std=values.walk_std)
            return model._replace(scale_factor=values.scale_factor, bias=values.bias)

        def _compute_sensing(self, context: Any) -> tuple[Any, Any, SensorModel | None]:
            """Makes a reading's kernel, its holder, and the errors, None where neither noise nor time matters."""
            model = self._error_model(context)
            if self._draws is not None:
                model = add_drawn_phases(model, self._draws, run_seed(context, self._varied, self._seed))
            exact = T is float and model.exact and not self._model.remembers
            read: Any = vehicle_ports.remembered_reading if self._model.remembers else vehicle_ports.reading
            kernel = compile_kernel_if(vehicle_ports.exact_reading if exact else read, self._compiled)
            holder = make_holder(Sensing(model.errors, self._integrates, self._place), self._compiled)
            return kernel, holder, None if exact else model

        def _noise_and_vibration(self, context: Any, model: SensorModel) -> tuple[Array, Array]:
            """Returns the random numbers of a sample, and the vibration at its time, shape (3,) or empty."""
            noise = self._noise.Eval(context) if self._model.noisy else _QUIET
            return noise, vibration_at(model, context.get_time())

        def _calc_direct(self, context: Any) -> Any:
            """Computes the reading of a sensor without memory from the body's state now, shape (3,)."""
            (kernel, holder, model), body = self._sensing.get(context), self._body_state.Eval(context)
            random_inputs = () if model is None else self._noise_and_vibration(context, model)
            return kernel(body, *random_inputs, holder)

        def _compute(self, context: Any) -> Any:
            """Computes the reading (3) of a sensor with memory, then its next state, as one vector."""
            (kernel, holder, model), body = self._sensing.get(context), self._body_state.Eval(context)
            return kernel(body, state_of(context), *self._noise_and_vibration(context, model), holder)

    return Triad


Sensor: Any = float_class(Sensor_, "Sensor")


def _require_smooth_readings(scalar: Any, name: str, model: SensorModel) -> None:
    """Raises InputError where readings have no derivatives and the scalar type needs them."""
    reasons = []
    if model.quantum > 0.0:
        reasons.append("quantizes its readings")
    if model.limit < math.inf:
        reasons.append("saturates at its range")
    remedy = f"give it sensors.errors: [{{sensor: {name}, quantum: 0}}] and no range, or leave the sensor out"
    refuse(scalar, f"sensor '{name}'", reasons, remedy)
    reasons = ["remembers (bandwidth_hz, drift of its bias, or delay_samples)"] if model.remembers else []
    refuse(scalar if scalar is Expression else float, f"sensor '{name}'", reasons, "leave these errors out")

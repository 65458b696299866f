"""The true rigid body."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydrake.symbolic import Expression
from pydrake.systems.framework import BasicVector_, DiscreteStateIndex, LeafSystem_

from massprop_drake.errors import InputError
from massprop_drake.maths.kernels import compile_kernel_if, make_holder, value_of
from massprop_drake.maths.linear_algebra import Array, is_positive_definite
from massprop_drake.maths.mass_properties import MassProperties, Spread, six_elements, symmetric_matrix
from massprop_drake.maths.vehicle import rigid_body, vehicle_ports
from massprop_drake.maths.vehicle.depletion import OutOfPropellantError, Tanks, drain_tanks, structure_after_draining
from massprop_drake.maths.vehicle.reaction_jets import profile_size
from massprop_drake.maths.vehicle.rigid_body import (
    MASS,
    N_STATE,
    N_WRENCH,
    RATE,
    STRUCTURE,
    Jump,
    OutOfMassError,
    SpunUpError,
)
from massprop_drake.maths.vehicle.vehicle_ports import Motion
from massprop_drake.systems.caching import Cached, declare_output
from massprop_drake.systems.parameters import Named, Parameters
from massprop_drake.systems.scalars import float_class, refuse, template
from massprop_drake.systems.vehicle.noise_source import run_seed

_NO_WHEELS = np.zeros(0)
_CENTER = STRUCTURE.slice("center_of_mass")
_LEAST_TIME_S = 1e-9  # that the mass must last in a continuous plant, whose steps shrink with what is left


@template
def RigidBodyPlant_(T: Any) -> Any:  # noqa: N802 (Drake's name of a template)
    """Makes the class of rigid-body plants for a scalar type T, see `RigidBodyPlant`."""

    class Plant(LeafSystem_[T]):
        """Moves a free rigid body under the wrench of its jets, without gravity.

        Equations, frames and the order of the state: `massprop_drake.maths.vehicle.rigid_body`.

        Ports:
            wrench (in, 7, continuous plant only): torque about the vehicle origin (3), force (3), body
                axes, and mass flow, at this instant. Required.
            wrench_profile (in, 7 (1 + n_lags), stepped plant only): see `ReactionJets`. Required.
            wheels (in, 6, with wheels only): angular momentum of reaction wheels relative to the body, ft-lbf-s or
                N-m-s, and its time derivative, see `ReactionWheels`. Required.
            drained (in, n_tanks, with tanks only): propellant drawn from each tank over the coming sample, see
                `ReactionJets`. Required.
            seed (in, 1, with a spread only): varies the seed, see `noise_seed`. Optional.
            body_state (out, 23): see `rigid_body`. No feedthrough.
            structure (out, 9): inertia about the center of mass (11, 22, 33, 23, 13, 12) and center of mass. No
                feedthrough.
            mass_properties (out, 10): the true ten parameters, see `maths.mass_properties`.
            propellant (out, n_tanks, with tanks only): in each tank at the last sample, slug or kg. No feedthrough.

        Parameters: mass properties at the start, or, with a spread, those about which they are drawn, see `parameters`:
        mass, slug or kg; center_of_mass (x, y, z), vehicle frame, ft or m; inertia (xx, yy, zz, yz, xz, xy) about the
        center of mass, body axes, slug-ft^2 or kg-m^2.

        State: body (23), continuous or discrete: as `body_state`, but of the mass the change since the start. With
        jumps or tanks structure_change (9), discrete: of the structure since the start. Drake's events cannot change
        parameters, so what a payload or propellant changes is state. With tanks running (9 + n_tanks + 1), discrete:
        change of the structure over the sample that is running, propellant left at its end, and its begin, s.

        Timing: a stepped plant's update at t_k carries the body from t_k to t_k+1 under the command
        decided at t_k; a continuous one is integrated by the simulator.

        Scalars: float and AutoDiffXd; Expression for a continuous plant.

        Args:
            properties: mass properties at the start, the parameters' defaults.
            time_step: 0 for a continuous plant; positive, s: steps of this length.
            lag_time_constants_s: of the profile's dying parts, s.
            pieces: of the profile, see `ReactionJets`.
            initial_rate: rad/s, body axes, shape (3,).
            jumps: of the mass properties.
            period_s: sample period, s; needed with jumps.
            spread: of the true mass properties about the parameters, drawn by the seed; None: they are the parameters.
            seed: of the run.
            wheels: whether the vehicle has reaction wheels.
            tanks: that the jets empty, and propellant in each at the start, slug or kg, shape (n_tanks,); None: none.
            compiled: whether the step's kernel is.

        Attributes:
            parameters: the mass properties in a context, by name.

        Raises:
            InputError: in a conversion of a stepped plant to Expression, or of drawn mass properties; in a
                simulation, when the inertia in the context is not positive definite.
        """

        def _construct(
            self,
            properties: MassProperties,
            *,
            time_step: float,
            lag_time_constants_s: tuple[float, ...] = (),
            pieces: int = 1,
            initial_rate: Array | None = None,
            jumps: tuple[Jump, ...] = (),
            period_s: float = 0.0,
            spread: Spread | None = None,
            seed: int = 0,
            wheels: bool = False,
            tanks: tuple[Tanks, Array] | None = None,
            compiled: bool = False,
            converter: Any = None,
        ) -> None:
            """Declares ports, parameters and state; arguments as the class."""
            LeafSystem_[T].__init__(self, converter)
            self.set_name("rigid_body")
            arguments = lag_time_constants_s, pieces, initial_rate, jumps, period_s, wheels, tanks, compiled
            self._made = (properties, time_step, *arguments)
            self._spread, self._seed = spread, seed
            self._time_step = time_step
            self._compiled = compiled and T is float and time_step != 0.0
            motion = Motion(np.array(lag_time_constants_s, dtype=float), time_step, pieces)
            self._kernel = compile_kernel_if(vehicle_ports.step_body, self._compiled)
            self._held = make_holder(motion, self._compiled)
            self.parameters = Parameters(
                self,
                T,
                {
                    "mass": Named(properties.mass),
                    "center_of_mass": Named(properties.center_of_mass, "xyz"),
                    "inertia": Named(six_elements(properties.inertia), ("xx", "yy", "zz", "yz", "xz", "xy")),
                },
            )
            start = rigid_body.initial_state(0.0)  # no change of the mass yet
            if initial_rate is not None:
                start[RATE] = initial_rate
            vector = BasicVector_[T](N_STATE)
            vector.SetFromVector(np.array([T(value) for value in start.tolist()]))
            drawn = {self.parameters.ticket}
            if spread is not None:
                self._varied = self.DeclareVectorInputPort("seed", 1)
                drawn.add(self._varied.ticket())
            self._start = Cached(self, "mass properties at the start", self._compute_start, drawn)
            changed = {self._start.ticket}
            if time_step == 0.0:
                self._wrench = self.DeclareVectorInputPort("wrench", N_WRENCH)
                self._state = self.DeclareContinuousState(vector)
            else:
                size = profile_size(len(lag_time_constants_s), pieces)
                self._wrench = self.DeclareVectorInputPort("wrench_profile", size)
                self._state = self.DeclareDiscreteState(vector)
                self.DeclarePeriodicDiscreteUpdateEvent(period_sec=time_step, offset_sec=0.0, update=self._update)
            self._wheels = self.DeclareVectorInputPort("wheels", 6) if wheels else None
            self._jumps = rigid_body.jumps_by_sample(jumps, period_s) if jumps else {}
            self._period_s, self._tanks = period_s, tanks
            self._structure_change = None
            if jumps or tanks is not None:
                self._structure_change = self.DeclareDiscreteState(STRUCTURE.size)
                changed.add(self.discrete_state_ticket(DiscreteStateIndex(self._structure_change)))
            if jumps:
                self.DeclarePeriodicUnrestrictedUpdateEvent(
                    period_sec=period_s, offset_sec=0.0, update=self._apply_jumps
                )
            changed |= set() if tanks is None else self._declare_tanks(tanks[-1])
            self._constants = Cached(self, "constants of motion", self._compute_constants, changed)
            moving = {self._constants.ticket, self.xd_ticket(), self.xc_ticket()}
            declare_output(self, "body_state", N_STATE, self._calc_body_state, moving)
            declare_output(self, "structure", STRUCTURE.size, self._calc_structure, changed)
            declare_output(self, "mass_properties", 10, self._calc_mass_properties, moving)

        def _declare_tanks(self, propellant: Array) -> set[Any]:
            """Declares state and events for tanks with initial propellant; returns the structure's dependencies."""
            self._drained = self.DeclareVectorInputPort("drained", propellant.size)
            begun = np.concatenate((np.zeros(STRUCTURE.size), propellant, [0.0]))
            self._running = self.DeclareDiscreteState(begun)
            running = {self.discrete_state_ticket(DiscreteStateIndex(self._running))}
            declare_output(self, "propellant", propellant.size, self._calc_propellant, running)
            if self._time_step != 0.0:
                return set()
            self.DeclarePeriodicDiscreteUpdateEvent(period_sec=self._period_s, offset_sec=0.0, update=self._drain)
            return {*running, self.time_ticket()}

        def _construct_copy(self, other: Any, converter: Any = None) -> None:
            """Constructs the plant from one of another scalar type; raises InputError where T has no derivatives."""
            properties, time_step, *_ = other._made
            steps = ["moves by steps whose number depends on the state"] if time_step and T is Expression else []
            refuse(T, f"plant '{other.get_name()}'", steps, "set plant.time_step: 0")
            random = ["has mass properties that are drawn"] if other._spread is not None else []
            refuse(T, f"plant '{other.get_name()}'", random, "leave out plant.dispersion, and set its parameters")
            emptying = ["has tanks that jets empty"] if other._tanks is not None else []
            refuse(T, f"plant '{other.get_name()}'", emptying, "leave out the vehicle's tanks")
            own = ("time_step", "lag_time_constants_s", "pieces", "initial_rate", "jumps", "period_s")
            names = (*own, "wheels", "tanks", "compiled")
            arguments = dict(zip(names, other._made[1:], strict=True))
            Plant._construct(self, properties, converter=converter, **arguments)

        def _compute_start(self, context: Any) -> Any:
            """Computes mass properties at the start, with the random spread, as a named tuple."""
            values = self.parameters.get(context)
            if self._spread is None:
                return values
            body = MassProperties(values.mass, values.center_of_mass, symmetric_matrix(values.inertia))
            seed = run_seed(context, self._varied, self._seed)
            mass, center, inertia = rigid_body.draw_true_body(seed, body, self._spread)
            return values._replace(mass=mass, center_of_mass=center, inertia=six_elements(inertia))

        def _structure(self, context: Any) -> Any:
            """Computes inertia and center of mass at this instant, packed as `STRUCTURE`."""
            values = self._start.get(context)
            structure = np.concatenate((values.inertia, values.center_of_mass))
            if self._structure_change is None:
                return structure
            structure = structure + context.get_discrete_state(self._structure_change).CopyToVector()
            if self._tanks is None or self._time_step != 0.0:
                return structure
            change, _, since_s = self._read_draining(context)
            return structure + (context.get_time() - since_s) / self._period_s * change

        def _read_draining(self, context: Any) -> tuple[Any, Any, float]:
            """Returns the structure's change over the running sample (9), propellant at its end, and its time, s."""
            running = context.get_discrete_state(self._running).CopyToVector()
            return running[: STRUCTURE.size], running[STRUCTURE.size : -1], running[-1]

        def _compute_constants(self, context: Any) -> Any:
            """Computes the constants of motion from inertia and center, a holder of them, and the initial mass."""
            structure = self._structure(context)
            if T is float and not is_positive_definite(symmetric_matrix(STRUCTURE.read(structure).inertia)):
                raise InputError(
                    f"plant '{self.get_name()}': inertia (xx, yy, zz, yz, xz, xy) must be positive definite, got "
                    f"{STRUCTURE.read(structure).inertia.tolist()}"
                )
            constants = rigid_body.constants_from_structure(structure)
            return constants, make_holder(constants, self._compiled), self._start.get(context).mass

        def _body_state(self, context: Any) -> Any:
            """Returns the body's state, shape (23,), its stored change of mass added to the initial mass."""
            if self._time_step == 0.0:
                body = context.get_continuous_state_vector().CopyToVector()
            else:
                body = context.get_discrete_state(self._state).CopyToVector()
            body[MASS] += self._constants.get(context)[-1]
            return body

        def _calc_body_state(self, context: Any) -> Any:
            """Returns the body's state at this instant, see `rigid_body`, shape (23,)."""
            return self._body_state(context)

        def _calc_structure(self, context: Any) -> Any:
            """Computes inertia and center of mass at this instant, packed as `STRUCTURE`, shape (9,)."""
            return self._structure(context)

        def _calc_mass_properties(self, context: Any) -> Any:
            """Computes the true ten parameters at this instant, shape (10,)."""
            constants, *_ = self._constants.get(context)
            return np.array([*constants.inverse, *constants.center, 1.0 / self._body_state(context)[MASS]])

        def DoCalcTimeDerivatives(self, context: Any, derivatives: Any) -> None:  # noqa: N802 (overrides Drake's)
            """Computes the time derivative of a continuous plant's state by the equations of motion."""
            if self._time_step == 0.0:
                wrench = self._wrench.Eval(context)
                (constants, *_), body = self._constants.get(context), self._body_state(context)
                if self._wheels is not None:
                    constants = rigid_body.add_wheel_momentum(constants, self._wheels.Eval(context))
                if T is not Expression:
                    self._require_mass(context, body, wrench)
                changing = rigid_body.derivative(body, wrench, constants)
                if self._tanks is not None:
                    shift = self._read_draining(context)[0][_CENTER] / self._period_s
                    changing = changing + rigid_body.center_shift_increment(body, body[RATE], shift)
                derivatives.get_mutable_vector().SetFromVector(changing)

        def _draw_from_tanks(self, context: Any, mass: float, structure: Array) -> tuple[Array, Array]:
            """Computes the structure (9) after the coming sample, and the propellant left in the tanks."""
            assert self._tanks is not None, "the plant has tanks"
            (tanks, _), used = self._tanks, self._drained.Eval(context)
            _, propellant, _ = self._read_draining(context)
            try:
                left = drain_tanks(propellant, used)
            except OutOfPropellantError as error:
                raise error.at(value_of(context.get_time())) from None
            return structure_after_draining(structure, mass, propellant, used, tanks), left

        def _drain(self, context: Any, state: Any) -> None:
            """Stores the structure's changes up to and over the coming sample, propellant left after it, and time."""
            structure, body = self._structure(context), self._body_state(context)
            after, left = self._draw_from_tanks(context, body[MASS], structure)
            start = self._start.get(context)
            change = structure - np.concatenate((start.inertia, start.center_of_mass))
            state.set_value(self._structure_change, change)
            state.set_value(self._running, np.concatenate((after - structure, left, [context.get_time()])))

        def _calc_propellant(self, context: Any) -> Any:
            """Returns the propellant in each tank at the last sample, slug or kg, shape (n_tanks,)."""
            _, left, _ = self._read_draining(context)
            return left

        def _require_mass(self, context: Any, body: Any, wrench: Any) -> None:
            """Raises OutOfMassError when the jets are about to use up the whole mass."""
            try:
                rigid_body.require_mass(value_of(body[MASS]), _LEAST_TIME_S * value_of(wrench[-1]))
            except OutOfMassError as error:
                raise error.at(value_of(context.get_time())) from None

        def _apply_jumps(self, context: Any, state: Any) -> None:
            """Applies the mass-property jumps of this sample, such as payloads, to the plant's state."""
            jumps = self._jumps.get(round(value_of(context.get_time()) / self._period_s), ())
            if not jumps:
                return
            start = self._start.get(context)
            body, structure = rigid_body.apply_jumps(self._body_state(context), self._structure(context), jumps)
            body[MASS] -= start.mass
            change = structure - np.concatenate((start.inertia, start.center_of_mass))
            state.get_mutable_discrete_state(self._structure_change).SetFromVector(change)
            if self._time_step == 0.0:
                state.get_mutable_continuous_state().SetFromVector(body)
            else:
                state.get_mutable_discrete_state(self._state).SetFromVector(body)

        def _update(self, context: Any, state: Any) -> None:
            """Advances a plant with time steps to the next sample, and drains its tanks."""
            body, profile = context.get_discrete_state(self._state).CopyToVector(), self._wrench.Eval(context)
            _, constants, mass = self._constants.get(context)
            body[MASS] += mass
            wheels = _NO_WHEELS if self._wheels is None else self._wheels.Eval(context)
            drawn: Any = None
            if self._tanks is not None:
                structure = self._structure(context)
                drawn = self._draw_from_tanks(context, body[MASS], structure)
                middle = rigid_body.constants_kernel(0.5 * (structure + drawn[0]))
                constants = make_holder(middle, self._compiled)
            try:
                after = self._kernel(body, profile, wheels, constants, self._held)
            except (OutOfMassError, SpunUpError) as error:
                raise error.at(value_of(context.get_time())) from None
            if drawn is not None:
                rate, shift = 0.5 * (body[RATE] + after[RATE]), drawn[0][_CENTER] - structure[_CENTER]
                after = after + rigid_body.center_shift_increment(after, rate, shift)
                start = self._start.get(context)
                change = drawn[0] - np.concatenate((start.inertia, start.center_of_mass))
                state.set_value(self._structure_change, change)
                running = np.concatenate((np.zeros(STRUCTURE.size), drawn[-1], [context.get_time()]))
                state.set_value(self._running, running)
            after[MASS] -= mass
            state.set_value(self._state, after)

    return Plant


RigidBodyPlant: Any = float_class(RigidBodyPlant_, "RigidBodyPlant")

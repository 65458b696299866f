"""True reaction-control jets: forces, torques and propellant flow from commands."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydrake.systems.framework import LeafSystem_

from massprop_drake.maths.kernels import compile_kernel_if, make_holder, read_holder, value_of
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.vehicle import vehicle_ports
from massprop_drake.maths.vehicle.reaction_jets import (
    JetThrusts,
    LevelCourse,
    draw_thrust_factors,
    level_course,
    make_jets,
    next_level,
    profile_by_pieces,
    profile_size,
    propellant_used,
    true_wrenches,
)
from massprop_drake.maths.vehicle.rigid_body import N_WRENCH, STRUCTURE
from massprop_drake.maths.vehicle.thrust import level_at
from massprop_drake.maths.vehicle.true_failures import (
    Failure,
    FailureKind,
    draw_strikes,
    failure_table,
    leaks_as_levels,
)
from massprop_drake.maths.vehicle.vehicle_ports import Jets
from massprop_drake.systems.caching import Cached, declare_output, state_of
from massprop_drake.systems.parameters import Named, Parameters
from massprop_drake.systems.scalars import float_class, refuse, template
from massprop_drake.systems.vehicle.noise_source import run_seed

_NONE = np.zeros(0)


@template
def ReactionJets_(T: Any) -> Any:  # noqa: N802 (Drake's name of a template)
    """Makes the class of a vehicle's jets for a scalar type T, see `ReactionJets`."""

    class Nozzles(LeafSystem_[T]):
        r"""Computes thrust of all jets, with an optional first-order build-up and tail-off.

        Within a sample each jet's level goes from where it was toward its command with its time constant,
        in closed form; see `massprop_drake.maths.vehicle.thrust`. A time constant of zero is instantaneous thrust.

        Ports:
            command (in, n_jets): fraction commanded over the coming sample, 0 to 1. Required for
                `thrust` and `wrench_profile`.
            held_command (in, n_jets): the command of the sample now running; at t_k before the update,
                of the one that ended. Required.
            closed (in, n_jets), held_closed (in, n_jets): 1 for each jet whose manifold is closed over the
                coming and over the running sample. Optional.
            command_onset (in, n_jets), held_command_onset (in, n_jets), where samples have pieces: how long after the
                beginning of the coming and of the running sample each jet opens, s, see `maths.vehicle.on_times`.
                Required as the commands are.
            seed (in, 1): varies the seed of thrust dispersion and intermittent failures, see `noise_seed`. Optional.
            structure (in, 9, planar alone): see `RigidBodyPlant`. Required.
            thrust (out, n_jets): mean force over the coming sample, lbf or N, along each jet's direction.
            wrench (out, 7): torque about the vehicle origin (3), force (3), body axes, and mass flow, at this
                instant; for a continuous plant.
            wrench_profile (out, 7 (1 + n_classes)): for a stepped plant: the wrench that the coming sample
                tends to, then for each time constant the part that dies away with it; see
                `maths.vehicle.rigid_body.step`. Where samples have pieces, this for each, after its length, s.
            drained (out, n_tanks, with tanks only): propellant drawn from each tank over the coming sample, slug or kg.

        Parameters: thrust_factor (0 to n_jets - 1), of the nominal thrust of each jet; thrust_dispersion, the relative
        1-sigma of a further factor, which the seed draws for each jet. A jet's thrust is the product of the three.

        State: level (n_jets) at the last update's sample, where thrust lags; time of that update, s. None when all
        thrust is instantaneous, nothing fails, and jets open and close with samples.

        Timing: after the update at t_k the state holds the level at t_k, reached under the command of
        [t_k-1, t_k).

        Scalars: float, AutoDiffXd and Expression, but for intermittent failures and samples of pieces. Time constants
        are no parameters: they shape the profile.

        Args:
            wrenches: torque about the vehicle origin, force, mass flow at nominal thrust, shape (n_jets, 7).
            time_constants_s: of each jet, s, shape (n_jets,).
            period_s: sample period, s.
            dispersion: default of thrust_dispersion.
            failures: as `maths.vehicle.true_failures` has them, with the force of a leak as its amount, lbf or N.
            thrusts: nominal thrust of each jet, lbf or N, shape (n_jets,); default the size of its force.
            planar: whether a floor carries the vehicle, see `maths.vehicle.reaction_jets.true_wrenches`.
            pieces: the most that a sample has, as jets open and close within it; 1: they do not.
            feeds: 1 for each jet that draws from a tank, shape (n_tanks, n_jets); None: there are no tanks.
            seed: of the run.
            compiled: whether its kernels are.

        Attributes:
            parameters: those in a context, by name.

        Raises:
            InputError: in a conversion of jets that fail intermittently, or that open within a sample.
        """

        def _construct(
            self,
            *,
            wrenches: Array,
            time_constants_s: Array,
            period_s: float,
            dispersion: float = 0.0,
            failures: tuple[Failure, ...] = (),
            thrusts: Array | None = None,
            planar: bool = False,
            pieces: int = 1,
            feeds: Array | None = None,
            seed: int = 0,
            compiled: bool = False,
            converter: Any = None,
        ) -> None:
            """Declares ports, parameters and state; arguments as the class."""
            LeafSystem_[T].__init__(self, converter)
            self.set_name("reaction_jets")
            self._made: dict[str, Any] = {
                "wrenches": wrenches,
                "time_constants_s": time_constants_s,
                "period_s": period_s,
                "dispersion": dispersion,
                "failures": failures,
                "thrusts": thrusts,
                "planar": planar,
                "pieces": pieces,
                "feeds": feeds,
                "seed": seed,
                "compiled": compiled,
            }
            n_jets = wrenches.shape[0]
            self._nominal = make_jets(wrenches, time_constants_s, period_s)
            self._thrusts = self._nominal.forces if thrusts is None else thrusts
            self._compiled = compiled and T is float
            self._kernel = compile_kernel_if(vehicle_ports.forces_and_profile, self._compiled)
            self._failed = compile_kernel_if(vehicle_ports.failed_target, self._compiled)
            self._n_jets, self._seed, self._failures = n_jets, seed, failures
            self._time_constants_s = time_constants_s
            self._instantaneous = self._nominal.lag.instantaneous
            self._period_s, self._pieces = period_s, pieces
            self.parameters = Parameters(
                self,
                T,
                {
                    "thrust_factor": Named(np.ones(n_jets), [str(jet) for jet in range(n_jets)]),
                    "thrust_dispersion": Named(dispersion),
                },
            )

            command = self._command = self.DeclareVectorInputPort("command", n_jets)
            held = self._held = self.DeclareVectorInputPort("held_command", n_jets)
            closed = self._closed = self.DeclareVectorInputPort("closed", n_jets)
            held_closed = self._held_closed = self.DeclareVectorInputPort("held_closed", n_jets)
            varied = self._varied = self.DeclareVectorInputPort("seed", 1)
            switching = [held, held_closed]
            if pieces > 1:
                self._onset = self.DeclareVectorInputPort("command_onset", n_jets)
                self._held_onset = self.DeclareVectorInputPort("held_command_onset", n_jets)
                switching.append(self._held_onset)
            of_jets = {self.parameters.ticket, varied.ticket()}
            if planar:
                self._structure = self.DeclareVectorInputPort("structure", STRUCTURE.size)
                of_jets.add(self._structure.ticket())
            self._jets = Cached(self, "jets", self._compute_jets, of_jets)
            self._remembers = bool(failures) or pieces > 1 or not self._instantaneous
            running = {port.ticket() for port in (*switching, varied)}
            running |= {self._jets.ticket, self.time_ticket()}
            if self._remembers:
                state = np.append(np.zeros(0 if self._instantaneous else n_jets), -period_s)
                self.DeclareDiscreteState(np.array([T(value) for value in state.tolist()]))
                self.DeclarePeriodicDiscreteUpdateEvent(period_sec=period_s, offset_sec=0.0, update=self._update)
                running.add(self.xd_ticket())
            # `wrench` must not depend on `command`: with a continuous plant that would close an algebraic
            # loop through the sensors and the autopilot
            ahead = [command, closed, *([self._onset] if pieces > 1 else [])]
            coming = running | {port.ticket() for port in ahead}
            self._coming = Cached(self, "thrust", self._compute, coming)
            coming = {self._coming.ticket}
            declare_output(self, "thrust", n_jets, self._calc_thrust, coming)
            declare_output(self, "wrench", N_WRENCH, self._calc_wrench, running)
            size = profile_size(len(self.lag_time_constants_s), pieces)
            declare_output(self, "wrench_profile", size, self._calc_profile, coming)
            if feeds is not None:
                declare_output(self, "drained", feeds.shape[0], self._calc_drained, coming)

        def _construct_copy(self, other: Any, converter: Any = None) -> None:
            """Constructs the jets from those of another scalar type; raises InputError where T has no derivatives."""
            intermittent = [failure.jet for failure in other._failures if failure.kind == FailureKind.INTERMITTENT]
            refuse(
                T,
                f"'{other.get_name()}'",
                [f"has a jet that fails intermittently (index {intermittent[0]})"] if intermittent else [],
                "leave the intermittent failures out",
            )
            within = ["has jets that open within a sample"] if other._pieces > 1 else []
            refuse(T, f"'{other.get_name()}'", within, "let them open and close with samples")
            Nozzles._construct(self, converter=converter, **other._made)

        @property
        def lag_time_constants_s(self) -> tuple[float, ...]:
            """Distinct positive time constants, s, in the order of `wrench_profile`."""
            return tuple(self._nominal.class_constants_s.tolist())

        def _compute_jets(self, context: Any) -> tuple[JetThrusts, Any]:
            """Returns the jets' model at their true thrusts, and a bundle of it with the failures for compiled code."""
            factor, dispersion = self.parameters.get(context)
            factors = factor * draw_thrust_factors(self._run_seed(context), dispersion, self._n_jets)
            floor = None
            if self._made["planar"]:
                floor = STRUCTURE.read(self._structure.Eval(context)).center_of_mass
            wrenches = true_wrenches(self._made["wrenches"], factors, floor)
            jets = make_jets(wrenches, self._time_constants_s, self._period_s)
            table = failure_table(leaks_as_levels(self._failures, factors * self._thrusts))
            return jets, make_holder(Jets(jets, table, self._period_s), self._compiled)

        def _run_seed(self, context: Any) -> Any:
            """Returns the run's seed in a context, varied by the seed port."""
            return run_seed(context, self._varied, self._seed)

        def _level_target(self, command: Any, closed: Any, start_s: Any, context: Any) -> Any:
            """Computes thrust levels that jets tend to over a sample, with failures; takes command and closed ports."""
            inputs, shut = command.Eval(context), closed.Eval(context) if closed.HasValue(context) else None
            if not self._failures:
                return inputs if shut is None else inputs * (1.0 - shut)
            sample = round(value_of(start_s) / self._period_s)
            strikes = draw_strikes(self._failures, sample, self._period_s, self._run_seed(context))
            shut = _NONE if shut is None else shut
            _, jets = self._jets.get(context)
            return self._failed(inputs, shut, sample * self._period_s, strikes, jets)

        def _held_target(self, context: Any) -> Any:
            """Computes the thrust levels that jets tend to over the running sample, shape (n_jets,)."""
            start_s = state_of(context)[-1] if self._failures else 0.0
            return self._level_target(self._held, self._held_closed, start_s, context)

        def _sample_levels(self, inputs: tuple[Any, Any, Any], since_s: float, level: Any, context: Any) -> LevelCourse:
            """Computes levels piece by piece over a sample from a time, s; `inputs`: command, onset, closed ports."""
            command_port, onset_port, closed = inputs
            command, onset = command_port.Eval(context), onset_port.Eval(context)
            shut = closed.Eval(context) if closed.HasValue(context) else np.zeros(self._n_jets)
            sample = round(since_s / self._period_s)
            strikes = draw_strikes(self._failures, sample, self._period_s, self._run_seed(context))
            _, jets = self._jets.get(context)
            faults = read_holder(jets).failures, strikes
            return level_course(
                level, (command, onset, shut), (since_s, self._period_s), faults, self._time_constants_s
            )

        def _running_levels(self, context: Any) -> LevelCourse:
            """Computes thrust levels piece by piece over the running sample."""
            state = state_of(context)
            level = np.zeros(self._n_jets) if self._instantaneous else state[:-1]
            inputs = (self._held, self._held_onset, self._held_closed)
            return self._sample_levels(inputs, float(state[-1]), level, context)

        def _level_now(self, context: Any) -> Any:
            """Computes the jets' thrust levels at this sample, before the update: a period after those in the state."""
            if self._pieces > 1:
                return self._running_levels(context).end
            jets, _ = self._jets.get(context)
            return next_level(state_of(context)[:-1], self._held_target(context), jets)

        def _compute(self, context: Any) -> Any:
            """Computes the jets' mean forces, then the wrench profile, over the coming sample, as one vector."""
            if self._pieces > 1:
                inputs, thrusters = (self._command, self._onset, self._closed), self._jets.get(context)[0]
                course = self._sample_levels(inputs, context.get_time(), self._level_now(context), context)
                profile = profile_by_pieces(course, thrusters, self._pieces)
                return np.append(thrusters.forces * course.mean, profile)
            coming = self._level_target(self._command, self._closed, context.get_time(), context)
            _, jets = self._jets.get(context)
            level = coming if self._instantaneous else self._level_now(context)  # of no effect where no jet lags
            return self._kernel(level, coming, jets)

        def _calc_thrust(self, context: Any) -> Any:
            """Returns mean forces of all jets over the coming sample, lbf or N, shape (n_jets,)."""
            return self._coming.get(context)[: self._n_jets]

        def _calc_drained(self, context: Any) -> Any:
            """Computes the propellant that the jets use from each tank over the coming sample, shape (n_tanks,)."""
            jets, _ = self._jets.get(context)
            force = self._coming.get(context)[: self._n_jets]
            return propellant_used(force, self._period_s, self._made["feeds"], jets)

        def _calc_wrench(self, context: Any) -> Any:
            """Computes the wrench of all jets at this instant, shape (7,)."""
            jets, _ = self._jets.get(context)
            if self._pieces > 1:
                levels = self._level_within(context)
            else:
                levels = self._held_target(context)
                if not self._instantaneous:
                    state = state_of(context)
                    elapsed_s = context.get_time() - state[-1]
                    levels = level_at(state[:-1], levels, self._time_constants_s, elapsed_s)
            return levels @ jets.wrenches

        def _level_within(self, context: Any) -> Any:
            """Computes thrust levels at this instant of a sample of pieces; at an edge, of the piece before."""
            course, elapsed_s = self._running_levels(context), context.get_time() - state_of(context)[-1]
            ends_s = np.cumsum(course.lengths_s)
            piece = min(int(np.searchsorted(ends_s, elapsed_s)), ends_s.size - 1)
            since_s = elapsed_s - (ends_s[piece] - course.lengths_s[piece])
            return level_at(course.begins[piece], course.targets[piece], self._time_constants_s, since_s)

        def _calc_profile(self, context: Any) -> Any:
            """Returns the wrench profile of the coming sample, see the class."""
            return self._coming.get(context)[self._n_jets :]

        def _update(self, context: Any, state: Any) -> None:
            """Stores the jets' levels at this sample, where they lag, and its time."""
            level = [] if self._instantaneous else self._level_now(context)
            state.set_value(np.append(level, context.get_time()))

    return Nozzles


ReactionJets: Any = float_class(ReactionJets_, "ReactionJets")

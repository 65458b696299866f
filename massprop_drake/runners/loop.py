"""Plain loop: a scenario sample by sample, by the same functions as the diagram's systems call, without Drake.

Only the linear program of jet selection is Drake's. What the loop does not cover, `check_against_vehicle` refuses.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.inputs import params, pilot_params, true_params
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.maths import flight
from massprop_drake.maths.autopilot.phase_space import hand_controller_rows
from massprop_drake.maths.estimation import cycle as estimation
from massprop_drake.maths.estimation.filter import Groups
from massprop_drake.maths.estimation.whole import Samples
from massprop_drake.maths.flight import (
    JUMP,
    PHASE,
    ROW,
    SAMPLE,
    SELECT,
    SENSING,
    UNTIL,
    Desk,
    FlightBlock,
    FlightRows,
    Together,
)
from massprop_drake.maths.kernels import compile_kernel_if, make_holder, make_shared_holder, read_holder
from massprop_drake.maths.linear_algebra import NotPositiveDefiniteError
from massprop_drake.maths.mass_properties import is_converged
from massprop_drake.maths.signals import PROPELLANT
from massprop_drake.maths.vehicle import vehicle_cycle
from massprop_drake.maths.vehicle.depletion import OutOfPropellantError
from massprop_drake.maths.vehicle.on_times import level_onsets
from massprop_drake.maths.vehicle.rigid_body import QUATERNION, RATE, STRUCTURE, OutOfMassError, SpunUpError
from massprop_drake.runners.cycles import ESTIMATOR, Cycles, RecordRows, ThesisKernelCycles, make_cycles
from massprop_drake.runners.logs import EstimationLog
from massprop_drake.runners.moment import Moment
from massprop_drake.runners.tracker_readings import Trackers
from massprop_drake.systems.autopilot.selector import Reconfiguration, SelectionState, Selector
from massprop_drake.systems.layouts import REQUEST
from massprop_drake.systems.stopwatch import JET_SELECTION, Stopwatch

Array = NDArray[np.float64]

_ROWS = 256, 1024  # that logs grow by: as many as are still to come, but no fewer, and no more
_PILOTED = ("hand_controllers", "attitude_error", "request", "selection_counts", "out_of_use")


class _Selection:
    """Jet selection by the requests and estimates in a `flight.Desk`.

    Args:
        scenario: with hand-controller windows.
        exchange: where requests, and what else counts, are found, and bursts are put.
    """

    def __init__(self, scenario: Scenario, exchange: Desk):
        self.selector = Selector(**pilot_params.jet_selection_arguments(scenario))
        self._exchange = exchange
        self._adapts = scenario.autopilot.mass_properties == "estimated"
        self._limits = params.convergence_limits(scenario)
        exchange.counts[:] = self.selector.initial.counts

    def select(self, request: Array) -> None:
        """Selects the burst of jets for a request, packed as `REQUEST`, and stores it for the kernel."""
        exchange = self._exchange
        _, command, delivered, *_ = self.selector.initial  # which it does not ask for
        counters = (exchange.counts, exchange.refused, exchange.out_of_use, exchange.owed)
        state = SelectionState(exchange.remaining, command, delivered, *counters)
        properties = None
        if self._adapts and is_converged(exchange.deviation, exchange.estimate, self._limits):
            properties = exchange.estimate.copy()
        reconfiguration = Reconfiguration(bool(exchange.asked.declared[0]), exchange.wrench, exchange.asked.removed)
        burst = self.selector.decide(state, REQUEST.read(request), properties, reconfiguration)
        exchange.remaining[:], exchange.counts[:], exchange.refused[:], exchange.out_of_use[:], exchange.owed[:] = burst


class _Block(NamedTuple):
    """Rows of the logs that are filled in together."""

    rows: FlightRows
    tracked: Array  # readings in a fixed frame, see `Trackers`
    log: EstimationLog
    shared: Any  # what the kernel has of it


class Loop:
    """Engine that runs a scenario by the plain loop, see `simulate.Engine`.

    Args:
        scenario: to run.
        cycles: its estimation; None: that which it asks for.
    """

    def __init__(self, scenario: Scenario, cycles: Cycles | None = None):
        vehicle, self._compiled = scenario.vehicle_data, scenario.execution.compiled
        self._scenario, self._period_s = scenario, vehicle.sample_period_s
        self._true = true_params.vehicle_params(scenario)
        self._schedule: Array | None = None
        self._onsets_s: Array | None = None  # of the schedule, where jets open within samples
        if scenario.open_loop:
            self._schedule, self._onsets_s = params.scheduled_jet_commands(scenario)
        self._windows = pilot_params.controller_windows(scenario)
        self._flight_params = pilot_params.flight_params(scenario, self._true)
        self._fly = compile_kernel_if(flight.fly, self._compiled)
        start = vehicle_cycle.initial_state(self._true)
        self._holder = make_holder(flight.initial_state(start), self._compiled)
        self._reached = np.array([0, SENSING, 0, 0])
        self._params = params.estimation_params(scenario)
        self._cycles: Cycles = make_cycles(scenario, self._params) if cycles is None else cycles
        self._exchange = flight.empty_desk(len(vehicle.jets), self._cycles.asked)
        self._selection = None if scenario.open_loop else _Selection(scenario, self._exchange)
        self._names, self._trackers = vehicle.sensor_names(), Trackers(scenario)
        self._shared_kernel = self._find_shared_kernel()
        if self._shared_kernel is None:
            self._kernel_params = make_holder(self._flight_params, self._compiled)
        else:
            self._kernel_params = make_holder(Together(self._flight_params, self._shared_kernel.given), self._compiled)
        self._blocks: list[_Block] = []
        self._size = self._row = 0  # rows of the last block; those of it that are filled in
        self._sample = self._taken = 0  # the next one; rows taken from the blocks
        self._ending = params.sample_count(scenario) + 1
        self._stopwatch = Stopwatch()

    def _find_shared_kernel(self) -> ThesisKernelCycles | None:
        """Returns the estimation if one kernel runs it together with vehicle and autopilot; None: they run apart."""
        apart = not self._compiled or self._flight_params.pilot.adapts or self._trackers.size > 0
        return None if apart or not isinstance(self._cycles, ThesisKernelCycles) else self._cycles

    @property
    def logged(self) -> int:
        """Number of samples logged since the logs were emptied."""
        return sum(block.rows.told.shape[0] for block in self._blocks[:-1]) + self._row - self._taken

    def advance(self, until_s: float) -> None:
        """Simulates up to a time, s, and logs every sample up to it, that at the time itself included."""
        with self._stopwatch:
            while self._sample * self._period_s <= until_s:
                try:
                    self._advance_block(until_s)
                except (OutOfMassError, OutOfPropellantError, SpunUpError) as error:
                    raise error.at(self._sample * self._period_s) from None

    def _advance_block(self, until_s: float) -> None:
        """Simulates samples up to a time, s, or to the end of the block of log rows, by the shared kernel if any."""
        if self._row == self._size:
            self._begin_block()
        if self._shared_kernel is not None:
            self._advance_block_by_shared_kernel(self._shared_kernel, until_s)
            return
        rows, tracked, log, shared_rows = self._blocks[-1]
        fly, cycles, adapts, tracks = self._fly, self._cycles, self._flight_params.pilot.adapts, self._trackers.size > 0
        while self._row < self._size and self._sample * self._period_s <= until_s:
            row = self._row
            if tracks:
                tracked[row] = self._trackers.read(rows.body_state[row], rows.structure[row], self._sample)
            cycles.advance(row + 1)
            if adapts:
                self._exchange.estimate[:], self._exchange.deviation[:] = log.estimate_and_deviation(row)
            while stop := fly(self._holder, shared_rows, self._reached, self._kernel_params):
                self._handle_stop(stop, rows.request[row])
            self._row += 1
            self._sample += 1

    def _advance_block_by_shared_kernel(self, cycles: ThesisKernelCycles, until_s: float) -> None:
        """Simulates samples up to a time, s, or to the end of the block, in one kernel with the estimation."""
        fly, block, reached = (
            compile_kernel_if(flight.fly_and_estimate, self._compiled),
            self._blocks[-1],
            self._reached,
        )
        times_s = np.arange(self._sample, self._sample + self._size - self._row) * self._period_s
        reached[UNTIL] = self._row + np.count_nonzero(times_s <= until_s)
        try:
            while stop := fly(self._holder, cycles.holder, block.shared, reached, self._kernel_params):
                self._sample = int(reached[SAMPLE])
                self._handle_stop(stop, block.rows.request[reached[ROW]])
        except NotPositiveDefiniteError as error:
            raise error.at(float(reached[SAMPLE] * self._period_s), ESTIMATOR) from None
        finally:
            self._sample, self._row = int(reached[SAMPLE]), int(reached[ROW])
        cycles.mark_done(int(reached[ROW]))

    def _handle_stop(self, stop: int, request: Array) -> None:
        """Serves a stop of the flight kernel: selects jets for a request, or applies a jump of mass properties."""
        if stop == SELECT:
            assert self._selection is not None
            self._selection.select(request)
        elif stop == JUMP:
            state = read_holder(self._holder)
            after = vehicle_cycle.apply_sample_jumps(state.vehicle, self._sample, self._true)
            self._holder = make_holder(state._replace(vehicle=after), self._compiled)
            if self._true.planar:
                truth = vehicle_cycle.update_floor_wrenches(self._flight_params.truth, after.structure, self._true)
                self._kernel_params = make_holder(self._flight_params._replace(truth=truth), self._compiled)

    def _begin_block(self) -> None:
        """Allocates a block of log rows, with its commands and noise, and reads the sensors at its first sample."""
        first, (min_rows, max_rows) = self._sample, _ROWS
        self._size, self._row = min(max(self._ending - first, min_rows), max_rows), 0
        size = self._size
        rows = flight.empty_rows(size, (len(self._scenario.vehicle_data.jets), len(self._names)), self._flight_params)
        times_s = np.arange(first, first + size, dtype=np.float64) * self._period_s
        if self._schedule is not None:
            commands = self._schedule[first : first + size]
            rows.command[: len(commands)] = commands
            if self._onsets_s is not None:
                rows.onset[: len(commands)] = self._onsets_s[first : first + size]
        else:
            rows.hand_controllers[:] = hand_controller_rows(self._windows, times_s)
        ahead = vehicle_cycle.draw_ahead(first, size, self._true)
        log, tracked = EstimationLog(self._scenario, self._params, size), np.empty((size, self._trackers.size))
        flown: Any = FlightBlock(rows, ahead, self._exchange)
        samples = Samples(times_s, rows.rates, rows.velocities, rows.told, np.zeros((size, 6)))
        next_commands = None if self._schedule is None else rows.command
        onsets_s = None
        if self._onsets_s is not None:
            last_onset_s = None if not self._blocks else self._blocks[-1].rows.onset[-1]
            onset_before_s = level_onsets(rows.onset.shape[1]) if last_onset_s is None else last_onset_s
            onsets_s = np.vstack((onset_before_s, rows.onset))
        self._cycles.begin(RecordRows(samples, None, next_commands, tracked if tracked.size else None, onsets_s), log)
        self._reached[[ROW, PHASE, SAMPLE]] = 0, SENSING, first
        if self._shared_kernel is not None:
            flown = Together(flown, self._shared_kernel.block)
        self._blocks.append(_Block(rows, tracked, log, make_shared_holder(flown, self._compiled)))
        if self._shared_kernel is None:
            self._fly(self._holder, self._blocks[-1].shared, self._reached, self._kernel_params)

    def take_logs(self) -> dict[str, Array]:
        """Returns logged rows by port, shape (n, size), with their times as time_s, and empties the logs."""
        taken, count = self._taken, self.logged
        blocks = [{**self._logged_ports(block), **block.log.rows} for block in self._blocks]
        logs = {name: _join_blocks([block[name] for block in blocks])[taken : taken + count] for name in blocks[0]}
        times_s = np.arange(self._sample - count, self._sample) * self._period_s
        self._taken = self._row
        self._blocks = self._blocks[-1:]  # whose other rows are still to be filled in
        return {"time_s": times_s, **logs}

    def _logged_ports(self, block: _Block) -> dict[str, Array]:
        """Maps ports of vehicle, autopilot and sensors to their logged rows in a block."""
        rows = block.rows
        logged = ("body_state", "structure", "command", "thrust", *(() if self._selection is None else _PILOTED))
        within = self._onsets_s is not None or self._flight_params.pilot.pulses.within
        readings = {"command_onset": rows.onset} if within else {}
        if rows.propellant.shape[1]:
            readings[PROPELLANT] = rows.propellant
        readings |= {name: rows.readings[:, place] for place, name in enumerate(self._names)}
        return {**{name: getattr(rows, name) for name in logged}, **readings, **self._trackers.ports(block.tracked)}

    def snapshot(self) -> Moment:
        """Returns true motion, thrusts, estimates, commands and readings of the last sample, for viewers."""
        (rows, _, log, _), row = self._blocks[-1], self._row - 1
        rotation, *_ = log.reports(row)
        estimate, deviation = log.estimate_and_deviation(row)
        return Moment(
            (self._sample - 1) * self._period_s,
            rows.body_state[row][QUATERNION],
            STRUCTURE.read(rows.structure[row]).center_of_mass,
            rows.thrust[row],
            estimate,
            deviation,
            self._cycles.asked.removed != 0.0,
            rows.command[row],
            rows.body_state[row][RATE],
            float(rotation.rotation_nis) if rotation.rotation_used else math.nan,
            tuple(rows.readings[row]),
        )

    def finish(self, *, interrupted: bool = False) -> tuple[Array, Groups]:
        """Returns covariance of the ten estimates, shape (10, 10), and the estimators' state, after the last sample."""
        _, covariance = self._cycles.estimate_and_covariance()
        return covariance, estimation.save_state(self._cycles.state(), self._params)

    def cycle_times(self, cycles: int) -> dict[str, float | None]:
        """Computes mean times per cycle of estimators, detector and jet selection, microseconds; None: no such part."""
        mean: dict[str, float | None] = {name: 1e6 * spent / cycles for name, spent in self._cycles.spent_s.items()}
        if self._shared_kernel is not None:  # not apart from the vehicle
            mean["estimators"] = None
        spent_s = self._stopwatch.spent_s.get(JET_SELECTION, 0.0)
        selection = None if self._selection is None else 1e6 * spent_s / cycles
        detector = mean.get("detector") if self._params.detector is not None else None
        return {"estimators": mean["estimators"], "detector": detector, "jet_selection": selection}


def _join_blocks(parts: list[Any]) -> Any:
    """Concatenates the rows of blocks in time; those of a single block are not copied."""
    return np.concatenate(parts) if len(parts) > 1 else parts[0]

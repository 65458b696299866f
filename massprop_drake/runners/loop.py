"""The plain loop: a scenario sample by sample, by the same functions as the diagram's systems call, without Drake.

Only the linear program of jet selection is Drake's. What the loop does not cover, `check_against_vehicle` refuses.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from massprop_drake.inputs import params
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.maths.autopilot.phase_space import hand_controllers, initial_memory, piloted
from massprop_drake.maths.estimation import cycle as estimation
from massprop_drake.maths.estimation.filter import Groups
from massprop_drake.maths.estimation.whole import Asked
from massprop_drake.maths.kernels import chosen, held
from massprop_drake.maths.linear_algebra import nonzero
from massprop_drake.maths.mass_properties import converged
from massprop_drake.maths.vehicle import cycle as vehicle_cycle
from massprop_drake.maths.vehicle.rigid_body import N_STATE, QUATERNION, RATE, STRUCTURE, OutOfMassError, SpunUpError
from massprop_drake.maths.vehicle.sensing import unsaturated
from massprop_drake.runners.cycles import Cycles, cycles
from massprop_drake.runners.logs import EstimationLog
from massprop_drake.runners.moment import Moment
from massprop_drake.runners.trackers import Trackers
from massprop_drake.systems.autopilot.selector import Selector
from massprop_drake.systems.layouts import HAND_CONTROLLERS, RECONFIGURATION, REQUEST, SELECTION_COUNTS

Array = NDArray[np.float64]

_ROWS = 256  # that logs grow by
_NO_WRENCH = np.zeros(6)


class _Pilot:
    """The autopilot, as its diagram wires it.

    Args:
        scenario: with hand-controller windows.
    """

    LOGGED = ("hand_controllers", "attitude_error", "request", "selection_counts", "out_of_use")

    def __init__(self, scenario: Scenario):
        vehicle = scenario.vehicle_data
        self._windows = params.windows(scenario)
        compiled = scenario.execution.compiled
        self._piloted = chosen(piloted, compiled)
        self._settings = held(params.phase_space_params(scenario), compiled)
        self._memory = held(initial_memory(), compiled)
        self.selector = Selector(**params.selection(scenario))
        self._reconfiguration = RECONFIGURATION.sized(jets=len(vehicle.jets))
        self._unit_wrenches = params.unit_wrenches(vehicle)
        self._adapts = scenario.autopilot.mass_properties == "estimated"
        self._limits = params.convergence_limits(scenario)
        self._state = self.selector.initial

    def decide(self, time_s: float, gyro: Array, known: Cycles, asked: Asked | None) -> tuple[Array, tuple[Array, ...]]:
        """The command of the coming sample, and the rows of `LOGGED`."""
        state = self._state
        controllers = hand_controllers(self._windows, time_s)
        request, error = self._piloted(self._memory, gyro, controllers, state.delivered, self._settings)
        properties = self._properties(known) if self._adapts else None
        burst = self.selector.decide(state, request, properties, self._asked_for(asked))
        rows = (controllers, error, REQUEST.pack(request), state.counts, state.out_of_use)
        self._state = self.selector.after(state, burst, properties)
        return burst.command, rows

    def _properties(self, known: Cycles) -> Array | None:
        """The estimate where it may be acted on."""
        estimate, deviation = known.reported()
        return estimate if converged(deviation, estimate, self._limits) else None

    def _asked_for(self, asked: Asked | None) -> Any:
        if asked is None:
            return None
        wrench = asked.force @ self._unit_wrenches if nonzero(asked.force) else _NO_WRENCH
        return self._reconfiguration.make(declared=asked.declared, known_wrench=wrench, removed=asked.removed)


class Loop:
    """A run by the plain loop, see `simulate.Engine`.

    Args:
        scenario: to run.
    """

    def __init__(self, scenario: Scenario):
        vehicle = scenario.vehicle_data
        self._scenario, self._period_s = scenario, vehicle.sample_period_s
        self._true = params.vehicle_params(scenario)
        self._closes = params.closes_manifolds(scenario) and not scenario.jet_schedule
        self._vehicle = vehicle_cycle.initial_state(self._true, closes=self._closes)
        self._schedule = params.commands(scenario) if scenario.jet_schedule else None
        self._pilot = None if scenario.jet_schedule else _Pilot(scenario)
        self._params = params.estimation_params(scenario)
        self._known = cycles(scenario, self._params)
        self._asked: Asked | None = None
        names = vehicle.sensor_names()
        self._trackers = Trackers(scenario)
        self._gyros = [names.index(package.name) for package in params.gyros(scenario)]
        self._accelerometers = [names.index(package.name) for package in params.accelerometers(scenario)]
        self._limits = [package.limit for package in vehicle.sensors]
        self._sample = 0  # the next one
        self._columns = {
            "body_state": N_STATE,
            "structure": STRUCTURE.size,
            "command": len(vehicle.jets),
            "thrust": len(vehicle.jets),
            **dict.fromkeys(names, 3),
            **self._trackers.sizes,
        }
        if self._pilot is not None:
            sizes = (HAND_CONTROLLERS.size, 3, REQUEST.size, SELECTION_COUNTS.size, len(vehicle.jets))
            self._columns |= dict(zip(_Pilot.LOGGED, sizes, strict=True))
        self._names = names
        self._moment: tuple[Array, Array, Array] | None = None
        self._shown: tuple[Array, tuple[Array, ...]] | None = None  # command and readings of that sample
        self._logs: list[tuple[dict[str, Array], EstimationLog]] = []
        self._logged = 0

    @property
    def logged(self) -> int:
        """Number of rows since the logs were emptied."""
        return self._logged

    def advance(self, reached_s: float) -> None:
        """Runs up to a time and logs every sample up to it, that at the time itself included."""
        while self._sample * self._period_s <= reached_s:
            time_s = self._sample * self._period_s
            try:
                self._step(time_s)
            except (OutOfMassError, SpunUpError) as error:
                raise error.at(time_s) from None
            self._sample += 1

    def _step(self, time_s: float) -> None:
        state, sample = self._vehicle, self._sample
        readings, memories = vehicle_cycle.sense(state, sample, self._true)
        index, columns, log = self._row()
        tracked = self._trackers.read(state.body, state.structure, sample)
        coming = None if self._pilot is not None else self._scheduled(sample)
        seen = estimation.Sample(
            time_s,
            self._stacked(readings, self._gyros),
            self._stacked(readings, self._accelerometers),
            state.command,
            coming=coming,
            tracked=np.concatenate(list(tracked.values())) if tracked else None,
        )
        asked = self._known.one(seen, log, index)
        rows: tuple[Array, ...] = ()
        if coming is None:
            assert self._pilot is not None
            command, rows = self._pilot.decide(time_s, readings[self._gyros[0]], self._known, asked)
        else:
            command = coming
        closed = asked.closed if self._closes and asked is not None else None
        stepped = vehicle_cycle.step(state, command, closed, sample, self._true)
        self._vehicle = stepped.state._replace(memories=memories)
        row = (state.body, state.structure, command, stepped.thrust, *readings, *tracked.values(), *rows)
        for column, values in zip(columns.values(), row, strict=True):
            column[index] = values
        self._logged += 1
        self._moment, self._asked = (state.body, state.structure, stepped.thrust), asked
        self._shown = command, tuple(readings)

    def _stacked(self, readings: list[Array], packages: list[int]) -> Array:
        """Readings of some packages side by side, NaN where saturated, shape (s, 3)."""
        stacked = np.empty((len(packages), 3))
        for row, index in enumerate(packages):
            stacked[row] = unsaturated(readings[index], self._limits[index])
        return stacked

    def _scheduled(self, sample: int) -> Array:
        assert self._schedule is not None
        command: Array = self._schedule[sample] if sample < len(self._schedule) else np.zeros(self._schedule.shape[1])
        return command

    def _row(self) -> tuple[int, dict[str, Array], EstimationLog]:
        """The next row of the logs: its number and the logs that it is in."""
        index = self._logged % _ROWS
        if index == 0:
            columns = {name: np.empty((_ROWS, size)) for name, size in self._columns.items()}
            self._logs.append((columns, EstimationLog(self._scenario, self._params, _ROWS)))
        return index, *self._logs[-1]

    def emptied(self) -> dict[str, Array]:
        """What has been logged, by port, and the times; the logs are empty then."""
        count = self._logged
        first = self._sample - count
        blocks = [{**columns, **log.rows} for columns, log in self._logs]
        logs = {name: np.concatenate([block[name] for block in blocks])[:count] for name in blocks[0]}
        self._logs, self._logged = [], 0
        return {"time_s": np.arange(first, self._sample) * self._period_s, **logs}

    def moment(self) -> Moment:
        """What there is to see at the last sample."""
        assert self._moment is not None
        body, structure, thrust = self._moment
        removed = np.zeros(thrust.size, dtype=bool)
        if self._asked is not None:
            removed = self._asked.removed != 0.0
        assert self._shown is not None
        estimate, deviation = self._known.reported()
        command, readings = self._shown
        return Moment(
            (self._sample - 1) * self._period_s,
            body[QUATERNION],
            STRUCTURE.read(structure).center_of_mass,
            thrust,
            estimate,
            deviation,
            removed,
            command,
            body[RATE],
            self._known.rotation_nis(),
            readings,
        )

    def finish(self) -> tuple[Array, Groups]:
        """Covariance of the ten estimates, shape (10, 10), and the estimators' state, after the last sample."""
        _, covariance = self._known.known()
        return covariance, estimation.saved(self._known.state(), self._params)

    def cycle_times(self, cycles: int) -> dict[str, float | None]:
        """Mean time per cycle spent in each part, microseconds."""
        mean = {name: 1e6 * spent / cycles for name, spent in self._known.spent_s.items()}
        selection = None if self._pilot is None else 1e6 * self._pilot.selector.stopwatch.spent_s / cycles
        detector = mean.get("detector") if self._params.detector is not None else None
        return {"estimators": mean["estimators"], "detector": detector, "jet_selection": selection}

"""One diagram and two contexts that run by turns: neither knows of the other."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from pydrake.common import RandomGenerator
from pydrake.systems.analysis import Simulator

from massprop_drake import Run, load_scenario, simulate
from massprop_drake.diagrams import closed_loop, replay

Array = NDArray[np.float64]

THESIS = load_scenario("stuck_on_29", ["duration_s=52"])
JOINT = load_scenario(
    "leak_named",
    [
        "duration_s=8",
        "estimation={filter: joint, start: nominal, std_fraction: 0.001}",
        "joint={settled_after: 10, tank_fraction: 0, thrust_uncertainty: 0}",
        "failures=[{kind: leak, jet: L4D, start_s: 5, force: 10}]",
    ],
)
SEEN = ("estimate", "covariance", "reconfiguration", "detector_report")
BEYOND = 0.25  # of a sample period: the last row is used up, and the next not asked for
FLOWN = ("body_state", "command", "selection_counts", *SEEN)


class Flight:
    """A context of a diagram on its way, and what some ports have said after each step."""

    def __init__(self, diagram: Any, ports: tuple[str, ...], draw: int | None = None):
        self.diagram, self.ports = diagram, ports
        context = diagram.CreateDefaultContext()
        if draw is not None:
            diagram.SetRandomContext(context, RandomGenerator(draw))
        self.simulator = Simulator(diagram, context)
        self.root = self.simulator.get_mutable_context()
        self.said: list[Array] = []

    def advance(self, reached_s: float) -> None:
        self.simulator.AdvanceTo(reached_s)
        self.said.append(np.concatenate([self.diagram.GetOutputPort(name).Eval(self.root) for name in self.ports]))


@pytest.mark.parametrize("scenario", [THESIS, JOINT], ids=["thesis", "joint"])
def test_two_flights_by_turns_are_those_flown_alone(scenario: Any) -> None:
    draws, steps_s = (None, 3), (0.8, 0.56)
    alone = [Flight(closed_loop.build(scenario), FLOWN, draw) for draw in draws]
    diagram = closed_loop.build(scenario)
    together = [Flight(diagram, FLOWN, draw) for draw in draws]

    def turn(number: int, flight: Flight, step_s: float) -> None:
        if number * step_s <= scenario.duration_s:
            flight.advance(number * step_s)

    turns = range(1, int(scenario.duration_s / min(steps_s)) + 1)
    for flight, step_s in zip(alone, steps_s, strict=True):
        for number in turns:
            turn(number, flight, step_s)
    for number in turns:
        for flight, step_s in zip(together, steps_s, strict=True):
            turn(number, flight, step_s)
    for one, other in zip(alone, together, strict=True):
        np.testing.assert_array_equal(one.said, other.said)
    assert not np.array_equal(alone[0].said[-1], alone[1].said[-1])
    jets = len(scenario.vehicle_data.jets)
    out_of_use = [flight.diagram.GetOutputPort("reconfiguration").Eval(flight.root)[-jets:] for flight in together]
    assert np.sum(out_of_use) > 0.0  # a failure was found on the way


def test_two_records_by_turns_are_those_played_alone() -> None:
    cases = [load_scenario("stuck_on_29", ["duration_s=24", f"seed={seed}"]) for seed in (0, 5)]
    runs = [simulate(case, look_back=False) for case in cases]
    alone = [Flight(replay.build(THESIS), SEEN) for _ in runs]
    diagram = replay.build(THESIS)
    together = [Flight(diagram, SEEN) for _ in runs]
    blocks = np.array_split(np.arange(len(runs[0].time_s)), 7)
    for run, flight in zip(runs, alone, strict=True):
        for rows in blocks:
            _play(flight, run, rows)
    for rows in blocks:
        for run, flight in zip(runs, together, strict=True):
            _play(flight, run, rows)
    for one, other, run in zip(alone, together, runs, strict=True):
        np.testing.assert_array_equal(one.said, other.said)
        np.testing.assert_array_equal(one.said[-1][:10], run["estimate"][-1])
    assert not np.array_equal(alone[0].said[-1], alone[1].said[-1])


def _play(flight: Flight, run: Run, rows: NDArray[np.int_]) -> None:
    """Gives a flight some rows of a run and goes on to the last of them."""
    source = flight.diagram.GetSubsystemByName("telemetry_source")
    readings = {name: run[name][rows] for name in THESIS.vehicle_data.sensor_names()}
    commands = np.nan_to_num(run["command"][rows])
    last = source.extend(source.GetMyContextFromRoot(flight.root), run.time_s[rows], readings, commands, None)
    flight.advance((last + BEYOND) * THESIS.vehicle_data.sample_period_s)

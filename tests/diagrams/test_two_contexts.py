"""One diagram and two contexts that run by turns: neither knows of the other."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.common import RandomGenerator
from pydrake.systems.analysis import Simulator
from systems_probe import LEAKS, leaked

from massprop_drake import Run, load_scenario, simulate
from massprop_drake.diagrams import closed_loop, replay

NEAR = "estimation={filter: thesis, start: nominal, std_fraction: 0.001}"
THESIS = load_scenario("stuck_on_29", ["duration_s=8", NEAR, "failures=[{kind: stuck_on, jet: R4R, start_s: 4}]"])
SEEN = ("estimate", "covariance", "reconfiguration", "detector_report")
FLOWN = ("estimate", "standard_deviation", "command", "thrust", "gyro", "selection_counts", "out_of_use")
BEYOND = 0.25  # of a sample period: the last row is used up, and the next not asked for


class Flight:
    """A context of a diagram on its way, and what some ports have said after each step."""

    def __init__(self, diagram: Any, ports: tuple[str, ...], draw: int | None = None):
        self.diagram, self.ports, context = diagram, ports, diagram.CreateDefaultContext()
        if draw is not None:
            diagram.SetRandomContext(context, RandomGenerator(draw))
        self.simulator = Simulator(diagram, context)
        self.root = self.simulator.get_mutable_context()
        self.said: list[NDArray[np.float64]] = []

    def advance(self, reached_s: float) -> None:
        self.simulator.AdvanceTo(reached_s)
        self.said.append(np.concatenate([self.diagram.GetOutputPort(name).Eval(self.root) for name in self.ports]))

    def play(self, run: Run, rows: NDArray[np.int_]) -> None:
        """Takes some rows of a run and goes on to the last of them."""
        source = self.diagram.GetSubsystemByName("telemetry_source")
        readings = {name: run[name][rows] for name in THESIS.vehicle_data.sensor_names()}
        given = readings, np.nan_to_num(run["command"][rows]), None
        last = source.extend(source.GetMyContextFromRoot(self.root), run.time_s[rows], *given)
        self.advance((last + BEYOND) * THESIS.vehicle_data.sample_period_s)


def test_two_flights_by_turns_do_not_disturb_each_other() -> None:
    run, diagram = leaked(), closed_loop.build(LEAKS)
    one, other = (Flight(diagram, FLOWN, draw) for draw in (None, 3))
    for row in range(0, len(run.time_s), 5):
        one.advance(run.time_s[row])
        other.advance(0.7 * run.time_s[row])
        np.testing.assert_array_equal(one.said[-1], np.concatenate([run[name][row] for name in FLOWN]))
    assert run["out_of_use"].any()  # a failure was found on the way
    assert (other.said[-1] != one.said[-1]).any()


def test_two_records_by_turns_are_those_played_alone() -> None:
    runs = [simulate(THESIS.model_copy(update={"seed": seed}), look_back=False) for seed in (0, 5)]
    diagram, blocks = replay.build(THESIS), np.array_split(np.arange(len(runs[0].time_s)), 7)
    alone = [Flight(replay.build(THESIS), SEEN) for _ in runs]
    together = [Flight(diagram, SEEN) for _ in runs]
    for run, flight in zip(runs, alone, strict=True):
        for rows in blocks:
            flight.play(run, rows)
    for rows in blocks:
        for run, flight in zip(runs, together, strict=True):
            flight.play(run, rows)
    for one, other, run in zip(alone, together, runs, strict=True):
        np.testing.assert_array_equal(one.said, other.said)
        np.testing.assert_array_equal(one.said[-1][:10], run["estimate"][-1])

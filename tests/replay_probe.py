"""Recorded telemetry through the replay diagram, in Drake's simulator: a second opinion on `estimate`."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput

from massprop_drake import Scenario
from massprop_drake.diagrams import replay
from massprop_drake.inputs import params
from massprop_drake.records.reader import Reader
from massprop_drake.runners.logs import ESTIMATION, SavedState, estimation_signals, groups_to_json, state_groups
from massprop_drake.runners.recorded import split_by_sensor

Array = NDArray[np.float64]

_AHEAD = 0.25  # of a sample period beyond the last row: its update is done, and the next row not asked for


class Opinion(NamedTuple):
    """What the diagram makes of a record.

    Attributes:
        signals: of the estimators, a row per sample; onsets in the diagram's time, which counts rows from zero.
        states: of the diagram after the last row, as a file keeps it.
        covariance: of the ten estimates after the last row, shape (10, 10).
    """

    signals: dict[str, Array]
    states: SavedState
    covariance: Array


def replayed(telemetry: Path, scenario: Scenario) -> Opinion:
    """Plays a record back through the replay diagram of a scenario."""
    period_s = scenario.vehicle_data.sample_period_s
    diagram = replay.build(scenario)
    builder = DiagramBuilder()
    builder.AddNamedSystem("replay", diagram)
    sinks = {
        name: LogVectorOutput(diagram.GetOutputPort(name), builder, period_s)
        for name in (*ESTIMATION, "covariance")
        if diagram.HasOutputPort(name)
    }
    simulator = Simulator(builder.Build())
    source: Any = diagram.GetSubsystemByName("telemetry_source")
    vehicle = scenario.vehicle_data
    gyro = params.gyro(scenario).name if vehicle.gyros else None
    reader = Reader(telemetry, vehicle, gyro=gyro, previous=None, stream=None)
    for number, rows in enumerate(reader):
        readings = {**rows.readings, **split_by_sensor(rows, vehicle)}
        own = source.GetMyMutableContextFromRoot(simulator.get_mutable_context())
        last = source.extend(own, rows.time_s, readings, rows.commands, rows.outside_wrench, rows.onsets_s)
        if number == 0:
            simulator.Initialize()
        simulator.AdvanceTo((last + _AHEAD) * period_s)
    reader.close()
    context = simulator.get_context()
    logs = {name: np.array(sink.FindLog(context).data().T) for name, sink in sinks.items()}
    states = groups_to_json(state_groups(diagram.GetSubsystemByName("estimation"), context))
    return Opinion(estimation_signals(scenario, logs), states, logs["covariance"][-1].reshape(10, 10))

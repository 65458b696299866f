"""Guaranteed intervals of the ten parameters by quantized readings, added to a run."""

from __future__ import annotations

from dataclasses import replace

from massprop_drake.display.run import Run
from massprop_drake.results.allowed import allowed_intervals
from massprop_drake.results.spool import Spool, blocks
from massprop_drake.systems.estimation.interval_program import solve_linear_program


def add_guaranteed_intervals(run: Run) -> Run:
    """Adds the intervals of the ten parameters that all readings of a run allow, by linear programs.

    A reading of a quantum q says that the signal lies within q/2 of it. Of sensors that are quantized, with noise of at
    most a tenth of the quantum, these cells confine the truth; see `offline.intervals` for the programs. What
    is stated with a 1-sigma is taken to be within 4 of it, noise within 5: the intervals are guaranteed given that.
    Readings count up to the first failure or jump that was declared and stands; of a long run those of four stretches
    of at most 1024 samples, evenly spread.

    Args:
        run: simulated, or estimated from telemetry.

    Returns:
        The same run with `results.intervals`, in the vehicle's units and frame; where there are none, these say why.
    """
    signals = run.signals
    if not isinstance(signals, Spool):
        signals = Spool(index="time_s")
        for block in blocks({"time_s": run.time_s, **run.signals}, "time_s", *run.signals):
            signals.append(block)
    results = run.results
    intervals = allowed_intervals(
        run.scenario, signals, results.estimates, results.detections, results.events, solve_linear_program
    )
    time_s = None if isinstance(run.signals, Spool) else run.time_s
    return Run(run.scenario, replace(results, intervals=intervals), time_s, run.signals, run.state)

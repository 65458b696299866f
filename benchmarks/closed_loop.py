"""Speed of the closed loop with every log: ratios that hold on any machine, best of several runs.

    python benchmarks/closed_loop.py

Prints how many times faster than real time the sample maneuver runs, what Drake adds to a plain loop
of the same functions, the time of the estimators, of a linear program, and of each module.
"""

from __future__ import annotations

import cProfile
import pstats
import statistics
import time
from pathlib import Path

import numpy as np

import massprop_drake
from massprop_drake import Estimator, load_scenario, simulate
from massprop_drake.display.run import Run
from massprop_drake.inputs.scenario import Scenario

_PACKAGE = Path(massprop_drake.__file__).parent

REPEATS = 7


def main() -> None:
    """Prints the figures."""
    scenario = load_scenario("sample_maneuver")
    duration = scenario.duration_s
    plain = load_scenario("sample_maneuver", ["execution.engine=loop"])
    quiet = load_scenario("sample_maneuver", ["detector.kind=off"])
    simulate(scenario)
    simulated, undetected, bare = [], [], []
    for _ in range(REPEATS):  # in turns, so that a busy moment strikes both
        run = simulate(scenario)
        simulated.append(run.summary["timing"]["wall_s"])
        undetected.append(simulate(quiet).summary["timing"]["wall_s"])
        loop = simulate(plain)
        bare.append(loop.summary["timing"]["wall_s"])
    fastest, typical = duration / min(simulated), duration / statistics.median(simulated)
    print(f"closed loop with logging   {fastest:6.0f} times real time (median {typical:.0f})")
    fastest, typical = duration / min(undetected), duration / statistics.median(undetected)
    print(f"  without failure detector {fastest:6.0f} times real time (median {typical:.0f})")
    same = all(np.array_equal(run[name], loop[name], equal_nan=True) for name in run.signals)
    print(f"plain loop without Drake   {duration / min(bare):6.0f} times real time")
    print(f"the same numbers           {'yes' if same else 'NO':>6}")
    print(f"Drake adds                 {100.0 * (min(simulated) / min(bare) - 1.0):6.0f} %")

    cycles = len(run.time_s)
    spent = run.summary["timing"]["cycle_us"]
    solves = run.summary["autopilot"]["lp_solves"]
    each = spent["jet_selection"] * cycles / solves
    print(f"linear program             {each:6.0f} us, {solves} programs in {cycles} cycles")
    print(f"failure detector           {spent['detector']:6.0f} us a cycle")
    _estimator(run)
    _modules(scenario)


def _estimator(run: Run) -> None:
    """Measures the time of one call of the real-time estimator, all cycles and those with a jet on."""
    scenario = run.scenario
    vehicle = scenario.vehicle_data
    gyros, accelerometers = ([package.name for package in kind] for kind in (vehicle.gyros, vehicle.accelerometers))
    spent = np.empty((REPEATS, len(run.time_s)))
    for repeat in range(REPEATS):
        estimator = Estimator(vehicle, scenario)
        for k, now in enumerate(run.time_s):
            rates = {name: run[name][k] for name in gyros}
            velocities = {name: run[name][k] for name in accelerometers}
            began = time.perf_counter()
            estimator.step(now, rates, velocities, run["command"][k])
            spent[repeat, k] = time.perf_counter() - began
    cycle_us = 1e6 * spent.min(axis=0)
    firing = run["firing"][:, 0] > 0.0
    median, median_firing = np.median(cycle_us), np.median(cycle_us[firing])
    print(f"one cycle of estimators    {median:6.0f} us median, {median_firing:.0f} us with a jet on")


def _modules(scenario: Scenario) -> None:
    """Measures each package module's own time, by a profile (which slows everything by half)."""
    profile = cProfile.Profile()
    profile.enable()
    run = simulate(scenario)
    profile.disable()
    own: dict[str, float] = {}
    for (file, _, _), (_, _, total, _, _) in pstats.Stats(profile).stats.items():  # type: ignore[attr-defined]
        path = Path(file)
        inside = path.relative_to(_PACKAGE) if path.is_relative_to(_PACKAGE) else None
        ours = inside is not None and inside.parts[0] in ("maths", "systems")
        name = str(inside) if ours else "numpy, Drake and the rest"
        own[name] = own.get(name, 0.0) + total
    cycles = len(run.time_s)
    print("own time per cycle under the profiler, us:")
    for name, total in sorted(own.items(), key=lambda item: -item[1]):
        if 1e6 * total / cycles >= 1.0:
            print(f"  {name:45} {1e6 * total / cycles:6.1f}")


if __name__ == "__main__":
    main()

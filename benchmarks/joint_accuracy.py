"""Accuracy of the joint estimator over seeds, beside the Cramér-Rao bound: RMS errors, coverage, z and NIS.

    python benchmarks/joint_accuracy.py [--seeds 20] [--first 0] [--case NAME ...] [--compiled]

Each case is flown once a seed, by Drake or, compiled, by the plain loop, and the joint estimator is run over its
telemetry together with the recursion of the bound at the truth, which counts the components that the estimator used.
Jets lag by the vehicle file's time constants, of which the estimator is told 5 % too much.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake import Run, load_scenario, simulate
from massprop_drake.inputs import params
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.maths.estimation.filter import Told
from massprop_drake.maths.estimation.filters import joint as filters
from massprop_drake.maths.estimation.joint import bound, cycle
from massprop_drake.maths.estimation.joint.thrust_scale import reported
from massprop_drake.maths.estimation.joint.ticks import on_ticks
from massprop_drake.signals import SYMBOLS

Array = NDArray[np.float64]

LAG = ("plant.thrust_transient=vehicle", "plant.lag_factor=0.9523809523809523", "detector.kind=off")
EXACT = ("estimation.filter=joint", "joint.thrust_uncertainty=0", "joint.tank_fraction=0")
_BIAS = 5e-4  # rad/s
CASES = {
    "orbiter": ("orbiter_maneuver", (*LAG,)),
    "free_flyer": ("free_flyer_maneuver", ("mass={}", *LAG, *EXACT)),
    "small_satellite": ("small_satellite_maneuver", (*LAG, *EXACT)),
    "lander": ("lander_maneuver", (*LAG, *EXACT)),
    "orbiter, thrusts dispersed by 1 %": (
        "orbiter_maneuver",
        (*LAG, "plant.thrust_dispersion=0.01", "joint.thrust_uncertainty=0.01"),
    ),
    "orbiter, gyro bias": ("orbiter_maneuver", (*LAG, f"vehicle.gyros[0].bias_std={_BIAS}")),
}


class Result(NamedTuple):
    """What one run leaves for the table.

    Attributes:
        percent: errors, %, NaN where the truth is as good as zero, shape (10,).
        sigmas: errors over their 1-sigma, shape (10,).
        bounds: errors over the bound, shape (10,).
        nis: sums of NIS and of components, of gyros and of accelerometers, shape (2, 2).
    """

    percent: Array
    sigmas: Array
    bounds: Array
    nis: Array


def measure(case: str, seed: int, how: Sequence[str] = ()) -> Result:
    """Flies one case with one seed; `how` are settings of the execution."""
    name, settings = CASES[case]
    drawn = ()
    if "bias" in case:
        bias = _BIAS * np.random.default_rng(seed).standard_normal(3)
        drawn = (f"sensors.errors=[{{sensor: gyro, bias: {bias.tolist()}}}]",)
    scenario = load_scenario(name, [*settings, *drawn, *how, f"seed={seed}"])
    return compared(scenario, simulate(scenario))


def compared(scenario: Scenario, run: Run) -> Result:
    """The joint estimator and its bound over the telemetry of a run."""
    of_filter = params.joint_params(scenario)
    joint, period = of_filter.joint, np.array([of_filter.period_s])
    velocities = np.stack([run[package.name] for package in params.accelerometers(scenario)], axis=1)
    rates = np.stack([run[package.name] for package in params.gyros(scenario)], axis=1)
    lag_error = (scenario.plant.lag_factor - 1.0) / joint.lag_sigma if joint.lag_sigma > 0.0 else 0.0
    errors = np.zeros(joint.places.size - joint.places.thrust)
    first = joint.places.thrust
    errors[joint.places.lag - first : joint.places.lag - first + joint.places.n_lag] = lag_error
    nis = np.zeros((2, 2))
    n_gyros = 3 * joint.places.gyros
    state = filters.initial(of_filter)
    for row, time_s in enumerate(run.time_s.tolist()):
        command = run["command"][max(row - 1, 0)]
        told = Told(time_s, time_s, command, None, np.zeros(6))
        truth = bound.true_mean(run["truth"][row], run["rate"][row], errors, joint)
        made = filters.step(state, rates[row], velocities[row], told, of_filter)
        state, report = made.state, made.evidence.report
        sample = cycle.Sample(
            time_s, period, command.reshape(1, -1), np.zeros(6), rates[row], velocities[row], on_ticks()
        )
        if row == 0:
            least = bound.start(sample, truth, joint)
            continue
        least = bound.step(least, sample, truth, report.used, joint)
        counts = report.used[:n_gyros].sum(), report.used[n_gyros:].sum()
        for kind, (one, count) in enumerate(zip((report.gyro_nis, report.accelerometer_nis), counts, strict=True)):
            if count:
                nis[kind] += one, count
    estimate, rows = reported(state.joint, joint)
    truth = run["truth"][-1]
    error = estimate - truth
    scale = np.where(np.abs(truth) > 1e-9 * np.abs(truth[[0, 0, 0, 0, 0, 0, 6, 6, 6, 9]]), np.abs(truth), np.nan)
    deviation = np.sqrt(np.sum(rows * rows, axis=1))
    return Result(100.0 * error / scale, error / deviation, error / bound.deviation(least), nis)


def report(case: str, results: list[Result], spent_s: float) -> None:
    """Prints one case's table."""
    percent, sigmas, bounds = (
        np.array([getattr(one, name) for one in results]) for name in ("percent", "sigmas", "bounds")
    )
    print(f"\n{case}: {len(results)} seeds, {spent_s / len(results):.1f} s each")
    print(f"  {'':8} {'RMS %':>9} {'RMS/bound':>10} {'z RMS':>7} {'|z| max':>8} {'3 sigma %':>10}")
    for i, symbol in enumerate(SYMBOLS):
        rms, of_bound, of_sigma = (np.sqrt(np.mean(part[:, i] ** 2)) for part in (percent, bounds, sigmas))
        inside = 100.0 * (np.abs(sigmas[:, i]) <= 3.0).mean()
        print(
            f"  {symbol:8} {rms:9.5f} {of_bound:10.2f} {of_sigma:7.2f} {np.abs(sigmas[:, i]).max():8.2f} {inside:10.1f}"
        )
    total = np.sum([one.nis for one in results], axis=0)
    print(f"  coverage of 3 sigma {100.0 * (np.abs(sigmas) <= 3.0).mean():.2f} %, ", end="")
    print(f"NIS/dof gyro {total[0, 0] / total[0, 1]:.3f}, accelerometers {total[1, 0] / total[1, 1]:.3f}", flush=True)


def main() -> None:
    """Prints a table a case."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--case", nargs="*", default=list(CASES), choices=list(CASES))
    parser.add_argument("--compiled", action="store_true", help="compiled kernels: the extra `fast`")
    arguments = parser.parse_args()
    how = ["execution.engine=loop", "execution.compiled=true"] if arguments.compiled else []
    for case in arguments.case:
        began = time.perf_counter()
        seeds = range(arguments.first, arguments.first + arguments.seeds)
        report(case, [measure(case, seed, how) for seed in seeds], time.perf_counter() - began)


if __name__ == "__main__":
    main()

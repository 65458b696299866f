"""Accuracy of the sample maneuver over sensor phases, beside the thesis and the targets.

    python benchmarks/accuracy.py [--seeds 20] [--many 100]

Runs every case on all seeds in two processes and prints one table a case. Takes a few minutes.
"""

from __future__ import annotations

import argparse
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake import load_scenario, simulate
from massprop_drake.maths.signals import SYMBOLS
from massprop_drake.results.json_arrays import parameters_from_names

Array = NDArray[np.float64]

# median of abs % error over seeds, in the order of SYMBOLS
TARGETS = (0.03, 0.03, 0.03, 25.0, 0.1, 1.5, 0.02, 1.0, 0.1, 4.0)
THESIS = (0.015, 0.007, 0.022, 20.733, 0.049, 0.415, 0.005, 0.074, 0.001, 1.586)  # table 5-3

LAG = ("plant.thrust_transient=vehicle",)
CASES = {
    "thrust instantaneous": (),
    "15 ms lag, estimator gate_lag": (*LAG, "estimation.thrust_transient=gate_lag"),
    "15 ms lag, plain gate": (*LAG, "estimation.thrust_transient=gate"),
    "extended Kalman filter, incrementation off": ("rotation.filter=extended", "rotation.jump=none"),
    "coupling ignored, incrementation off": ("rotation.coupling=ignore", "rotation.jump=none"),
    "adaptive jet selection": ("autopilot.mass_properties=estimated",),
}


class Result(NamedTuple):
    """Results of one run for the table."""

    percent: Array  # errors, %, shape (10,)
    sigmas: Array  # errors over their 1-sigma, shape (10,)
    nis_mean: float
    nis_late: float  # mean after 25 s
    nis_fast: float  # mean from 37 to 46 s
    translation_nis: float
    jumps: int
    window_means: Array  # mean rate in the second half of each RHC window, deg/s, toward the command
    window_range: tuple[float, float]
    gained: Array  # velocity gained per THC window, toward the command
    firings: int
    propellant: float
    unusable: int


def measure(case: tuple[str, ...], seed: int) -> Result:
    """Runs one case with one seed."""
    scenario = load_scenario("sample_maneuver", [*case, f"seed={seed}"])
    run = simulate(scenario)
    summary, time = run.summary, run.time_s
    estimate, truth = parameters_from_names(summary["estimates"]), parameters_from_names(summary["truth"])
    used = run["rotation_used"][:, 0] > 0.0
    nis = run["rotation_nis"][:, 0]
    means, spread, gained = [], [], []
    for window in scenario.maneuver:
        axis, sign = "xyz".index(window.axis[1]), 1.0 if window.axis[0] == "+" else -1.0
        if window.controller == "rhc":
            half = (time >= 0.5 * (window.start_s + window.end_s)) & (time < window.end_s)
            rates = sign * np.degrees(run["rate"][half, axis])
            means.append(rates.mean())
            spread.extend([rates.min(), rates.max()])
        else:
            start, end = np.searchsorted(time, [window.start_s, window.end_s])
            gained.append(sign * (run["velocity"][end, axis] - run["velocity"][start, axis]))
    return Result(
        percent=parameters_from_names(summary["percent_error"]),
        sigmas=(estimate - truth) / parameters_from_names(summary["standard_deviations"]),
        nis_mean=nis[used].mean(),
        nis_late=nis[used & (time > 25.0)].mean(),
        nis_fast=nis[used & (time >= 37.0) & (time <= 46.0)].mean(),
        translation_nis=summary["consistency"]["translation_nis_mean"],
        jumps=int(run["rotation_jump"].sum()),
        window_means=np.array(means),
        window_range=(min(spread), max(spread)),
        gained=np.array(gained),
        firings=summary["autopilot"]["firings"],
        propellant=summary["autopilot"]["propellant_mass"],
        unusable=int((~used & (run["firing"][:, 0] > 0.0)).sum()),
    )


def report(title: str, results: list[Result]) -> None:
    """Prints one case's table."""
    percent = np.abs([result.percent for result in results])
    sigmas = np.abs([result.sigmas for result in results])
    print(f"\n{title}, {len(results)} seeds")
    print(f"  {'':8} {'median %':>10} {'target':>8} {'thesis':>8} {'worst %':>10} {'worst/sigma':>12}")
    for i, symbol in enumerate(SYMBOLS):
        print(
            f"  {symbol:8} {np.median(percent[:, i]):10.4f} {TARGETS[i]:8g} {THESIS[i]:8g} "
            f"{percent[:, i].max():10.4f} {sigmas[:, i].max():12.2f}"
        )

    def span(values: list[float] | Array) -> str:
        return f"{np.median(values):.4g} ({np.min(values):.4g} to {np.max(values):.4g})"

    print(f"  rotation NIS, mean of all samples   {span([r.nis_mean for r in results])}")
    print(f"  rotation NIS, mean after 25 s       {span([r.nis_late for r in results])}")
    print(f"  rotation NIS, mean 37 to 46 s       {span([r.nis_fast for r in results])}")
    print(f"  translation NIS, mean               {span([r.translation_nis for r in results])}")
    print(f"  covariance increments               {span([float(r.jumps) for r in results])}")
    print(f"  mean rate, second half of windows   {span(np.concatenate([r.window_means for r in results]))} deg/s")
    ranges = np.array([r.window_range for r in results])
    print(f"  single readings there               {ranges[:, 0].min():.3f} to {ranges[:, 1].max():.3f} deg/s")
    print(f"  velocity gained per translation     {span(np.concatenate([r.gained for r in results]))} ft/s")
    print(f"  firings                             {span([float(r.firings) for r in results])}")
    print(f"  propellant                          {span([r.propellant for r in results])} slug")


def main() -> None:
    """Prints a table for each case, then the count of inconsistent runs over many seeds."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--many", type=int, default=100)
    arguments = parser.parse_args()
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        for title, case in CASES.items():
            results = list(pool.map(measure, [case] * arguments.seeds, range(arguments.seeds), chunksize=2))
            report(title, results)
        base: tuple[str, ...] = ()
        results = list(pool.map(measure, [base] * arguments.many, range(arguments.many), chunksize=4))
    bad = sum(result.nis_late > 100.0 for result in results)
    worst = max(np.abs(result.percent[:3]).max() for result in results)
    print(f"\n{arguments.many} seeds: {bad} end with a mean NIS above 100; worst diagonal error {worst:.4f} %")


if __name__ == "__main__":
    main()

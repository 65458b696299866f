"""Measures of a run's signals that several claims share."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from massprop_drake.inputs.scenario import load_scenario
from massprop_drake.inputs.scheduled import HandControllerWindow
from massprop_drake.inputs.vehicle_file import Vehicle, load_vehicle
from reproduction.claims import Array, Measure, Phase, Pooled, Signals

DIAGONAL, CENTER, MASS = slice(0, 3), slice(6, 9), 9
XX, YY, ZZ, YZ, XZ, XY = range(6)
DEGREES = 180.0 / np.pi
END_S = 50.0  # of the sample maneuver
_END = 1e-6  # s, against rounding of sample times


@lru_cache(maxsize=1)
def orbiter() -> Vehicle:
    """Returns the thesis's vehicle."""
    return load_vehicle("orbiter")


@lru_cache(maxsize=1)
def maneuver_windows() -> tuple[HandControllerWindow, ...]:
    """Returns the hand-controller windows of the sample maneuver."""
    return load_scenario("sample_maneuver").maneuver


def during(run: Signals, start_s: float, end_s: float) -> NDArray[np.bool_]:
    """Selects the samples from one time to another, both included."""
    return (run["time_s"] >= start_s - _END) & (run["time_s"] <= end_s + _END)


def at(run: Signals, time_s: float) -> int:
    """Returns the index of the last sample that is not after a time."""
    return int(np.searchsorted(run["time_s"], time_s + _END)) - 1


def percent_error(run: Signals) -> Array:
    """Computes the true minus the estimated parameters (2-85), % of the truth at the start, shape (n, 10)."""
    return 100.0 * (run["truth"] - run["estimate"]) / np.abs(run["truth"][0])


def percent_at(run: Signals, time_s: float = np.inf) -> Array:
    """Computes the size of the errors at a time, %, shape (10,); at the end without one."""
    result: Array = np.abs(percent_error(run)[at(run, time_s)])
    return result


def used(run: Signals, filter_name: str) -> NDArray[np.bool_]:
    """Selects the samples that a filter used; `filter_name`: rotation or mass."""
    result: NDArray[np.bool_] = run[f"{filter_name}_used"][:, 0] != 0.0
    return result


def nis(run: Signals, filter_name: str, start_s: float = 0.0, end_s: float = np.inf) -> Array:
    """Returns a filter's consistency function at the samples it used, shape (m,)."""
    result: Array = run[f"{filter_name}_nis"][used(run, filter_name) & during(run, start_s, end_s), 0]
    return result


def mean_nis(case: str, filter_name: str, start_s: float = 0.0, end_s: float = np.inf) -> Measure:
    """Makes a measure: the mean consistency function (NIS) of a case over a time."""
    return lambda phase: float(nis(phase[case], filter_name, start_s, end_s).mean())


def share_above(case: str, limit: float, start_s: float, end_s: float = np.inf) -> Measure:
    """Makes a measure: share of the rotation filter's consistency function above a limit, over a time."""
    return lambda phase: float(np.mean(nis(phase[case], "rotation", start_s, end_s) > limit))


def value(case: str, name: str, index: int | tuple[int, int] = 0) -> Measure:
    """Makes a measure: an element of a result of a calculation."""
    return lambda phase: float(phase[case][name][index])


def mean(measure: Measure) -> Pooled:
    """Makes a pooled measure: the mean over the phases."""
    return lambda phases: float(np.mean([measure(phase) for phase in phases]))


def ratio(numerator: Callable[[Any], float], denominator: Callable[[Any], float]) -> Callable[[Any], float]:
    """Makes a measure: the ratio of two measures, of a phase or pooled as they are."""
    return lambda phases: numerator(phases) / denominator(phases)


def worst(case: str, elements: int | slice | list[int] = DIAGONAL, time_s: float = np.inf) -> Measure:
    """Makes a measure: the largest error of some elements at a time, %; at the end without one."""
    return lambda phase: float(np.max(percent_at(phase[case], time_s)[elements]))


def sigma_percent(case: str, element: int, time_s: float = np.inf) -> Measure:
    """Makes a measure: the filter's 1-sigma of an element at a time, %; at the end without one."""

    def measure(phase: Phase) -> float:
        """Computes the 1-sigma in one phase, %."""
        run = phase[case]
        sigma = run["standard_deviation"][at(run, time_s), element]
        return float(100.0 * sigma / abs(run["truth"][0, element]))

    return measure


def difference_in_sigma(first: str, second: str, time_s: float) -> Measure:
    """Makes a measure: largest difference of two cases in an estimate of the diagonal, in 1-sigmas of the first."""

    def measure(phase: Phase) -> float:
        """Computes the difference in one phase."""
        run, row = phase[first], at(phase[first], time_s)
        difference = np.abs(run["estimate"][row] - phase[second]["estimate"][row]) / run["standard_deviation"][row]
        return float(difference[DIAGONAL].max())

    return measure


def mass_error(run: Signals, start_s: float = 0.0, end_s: float = np.inf) -> Array:
    """Computes the error of 1/m over a time, %, shape (m,)."""
    return percent_error(run)[during(run, start_s, end_s), MASS]


def mass_rms(case: str, start_s: float = END_S, end_s: float = np.inf) -> Pooled:
    """Makes a pooled measure: RMS error of 1/m over a time, %; at the end without one."""
    return lambda phases: rms(np.concatenate([mass_error(phase[case], start_s, end_s) for phase in phases]))


def rms(values: Array) -> float:
    """Computes the root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def firings(run: Signals, start_s: float = 0.0, end_s: float = np.inf) -> tuple[Array, Array]:
    """Finds when each firing that begins within a time begins, and how long it lasts, s, shape (m,) each."""
    command = run["command"] > 0.0
    starts, times = [], []
    for jet in np.flatnonzero(command.any(axis=0)):
        edges = np.flatnonzero(np.diff(np.concatenate([[False], command[:, jet], [False]]).astype(int)))
        for first, last in zip(edges[::2], edges[1::2], strict=True):
            if start_s <= run["time_s"][first] <= end_s:
                starts.append(run["time_s"][first])
                times.append((last - first) * orbiter().sample_period_s)
    return np.array(starts), np.array(times)


def longest_row(flags: NDArray[np.bool_]) -> int:
    """Finds the length of the longest unbroken row of true values."""
    edges = np.flatnonzero(~np.concatenate([[False], flags, [False]]))
    return max(int(later - earlier) - 1 for earlier, later in pairwise(edges))

"""Calibration of the joint filter's likelihood: how often a wrong constant force of one jet is ahead of the truth.

    python benchmarks/likelihood_ratio.py [--flights 1000] [--kind nominal_exact] [--set KEY=VALUE ...]
        [--after 36] [--jets 6]

Flies each flight of a kind of `card.yaml` once. From a time on, when the filter has converged, hypotheses go on from
its state over the same readings: the filter itself, and others with a force of one jet that does not act. That force is
of a fixed size, or a force to be estimated with the prior N(0, T^2), T the jet's thrust. All take the readings in that
count for the filter itself. With LLR the log likelihood of the truth less that of the wrong force, a calibrated filter
has E[exp(-LLR)] = 1, and the wrong force is ahead by a with a probability of at most exp(-a), by Markov's inequality.

Sizes are those whose expected LLR is `_EXPECTED`, by the 1-sigma of the estimated force, median over flights that do
not count. A line a size: mean and standard deviation of LLR, variance over twice the mean (1 where LLR is Gaussian),
E[exp(-LLR)] with its standard error over flights, and the share of wrong forces ahead by 1 to 6 nats with bounds of
95 %, a flight taken for one trial. A thousand flights of the orbiter take half an hour on two processors.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml
from fly import drawn, loaded
from numpy.typing import NDArray
from scipy.stats import beta

from massprop_drake import simulate
from massprop_drake.inputs.params import accelerometers, estimation_params, gyros
from massprop_drake.maths.estimation.filter import Told
from massprop_drake.maths.estimation.filters import joint
from massprop_drake.maths.estimation.joint.hypotheses import Cause, Kind, apply_cause, without_increments
from massprop_drake.maths.estimation.joint.joint_cycle import JointEvidence, step
from massprop_drake.maths.estimation.joint.layout import JointParams, JointState
from massprop_drake.maths.kernels import has_compiler

Array = NDArray[np.float64]

_EXPECTED = (0.5, 1.0, 2.5, 5.0)  # nats
_AHEAD = np.arange(1.0, 7.0)  # nats
_PILOTS = 6  # flights that give the sizes; they are numbered from _FIRST_PILOT on
_FIRST_PILOT = 900_000
_BOUND = 0.95


class Replayed(NamedTuple):
    """Readings of a flight over which hypotheses are compared.

    Attributes:
        entry: the filter's state before the first.
        cycles: of the filter, which are the truth's.
        params: see `JointParams`.
    """

    entry: JointState
    cycles: list[JointEvidence]
    params: JointParams


def flown(spec: dict[str, Any], settings: Sequence[str], number: int, after_s: float) -> Replayed:
    """Flies a flight of a kind, and runs the filter over its readings.

    Raises:
        ValueError: when the filter has not converged by then.
    """
    flight = drawn(spec, np.random.default_rng([number, *spec["stream"].encode()]), number)
    flight = flight._replace(settings=(*flight.settings, *settings))
    scenario = loaded(flight, number, has_compiler())
    run, params = simulate(scenario), estimation_params(scenario).filter_params
    rates, velocities = _stacked(run, gyros(scenario)), _stacked(run, accelerometers(scenario))
    commands = np.vstack((np.zeros_like(run["command"][:1]), run["command"]))
    state, entry, cycles = joint.initial_state(params), None, []
    for row, time_s in enumerate(run.time_s.tolist()):
        told = Told(time_s, time_s, commands[row], commands[row + 1], np.zeros(6))
        done = joint.step(state, rates[row], velocities[row], told, params)
        if time_s > after_s:
            entry = state.joint if entry is None else entry
            cycles.append(done.evidence)
        elif time_s + 1e-9 > after_s and (done.state.start.under_way or not done.state.joint.guarded):
            raise ValueError(f"flight {number}: not converged after {after_s:g} s")
        state = done.state
    assert entry is not None, "the flight is longer"
    return Replayed(entry, cycles, without_increments(params.joint))


def _stacked(run: Any, packages: Sequence[Any]) -> Array:
    """Stacks readings of packages, shape (n, packages, 3)."""
    return np.stack([np.array(run[each.name]) for each in packages], axis=1)


def ratio(replayed: Replayed, jet: int, mean: float, sigma: float) -> tuple[float, float]:
    """Computes log likelihood of the truth less that of a force of one jet, nats, and the force's 1-sigma at the end.

    Args:
        replayed: see `Replayed`.
        jet: its index.
        mean, sigma: of the force beforehand, lbf or N.
    """
    params, cause = replayed.params, Cause(Kind.JETS, (jet,), (1,), (1,))
    state, found = apply_cause(replayed.entry, cause, params, force_priors=((mean, sigma),)), 0.0
    for cycle in replayed.cycles:
        state, report = step(state, cycle.sample, params, cycle.report.used)
        found += cycle.report.log_likelihood - report.log_likelihood
    return found, float(np.linalg.norm(state.root[params.places.force]))


def chosen_jets(params: JointParams, count: int) -> list[int]:
    """Returns indices of so many jets, spread over the vehicle's."""
    return np.unique(np.linspace(0, params.places.jets - 1, count).astype(int)).tolist()


def sigmas(number: int, spec: dict[str, Any], settings: Sequence[str], after_s: float, jets: int) -> Array:
    """Returns the 1-sigma of each jet's force when it is estimated, lbf or N, shape (jets,)."""
    replayed = flown(spec, settings, number, after_s)
    thrusts = replayed.params.thrusts
    return np.array([ratio(replayed, jet, 0.0, thrusts[jet])[1] for jet in chosen_jets(replayed.params, jets)])


def ratios(number: int, spec: dict[str, Any], settings: Sequence[str], after_s: float, unit: Array) -> Array | None:
    """Computes LLR of each size and of the estimated force, shape (sizes + 1, jets); None if not converged.

    Args:
        number: of the flight.
        spec: of its kind.
        settings: overrides of its scenario.
        after_s: time from which on hypotheses are compared.
        unit: 1-sigma of each jet's estimated force, lbf or N, shape (jets,).
    """
    try:
        replayed = flown(spec, settings, number, after_s)
    except ValueError:
        return None
    jets, thrusts = chosen_jets(replayed.params, len(unit)), replayed.params.thrusts
    way = 1.0 if number % 2 else -1.0
    sizes = [
        [ratio(replayed, jet, way * np.sqrt(2.0 * nats) * size, 0.0)[0] for jet, size in zip(jets, unit, strict=True)]
        for nats in _EXPECTED
    ]
    return np.array([*sizes, [ratio(replayed, jet, 0.0, thrusts[jet])[0] for jet in jets]])


def line(title: str, found: Array) -> str:
    """Formats a line of the table.

    Args:
        title: of it.
        found: LLR, shape (flights, jets).
    """
    flights, odds = len(found), np.exp(-found).mean(axis=1)
    cells = []
    for ahead in _AHEAD:
        wrong = float((found < -ahead).mean()) * flights  # in flights
        low = beta.ppf(0.5 - 0.5 * _BOUND, wrong, flights - wrong + 1.0) if wrong > 0.0 else 0.0
        high = beta.ppf(0.5 + 0.5 * _BOUND, wrong + 1.0, flights - wrong)
        cells.append(f"{1e3 * wrong / flights:6.1f} ({1e3 * low:.1f}-{1e3 * high:.1f})")
    error = odds.std(ddof=1) / np.sqrt(flights)
    return (
        f"{title:12}  {found.mean():5.2f}  {found.std():5.2f}  {found.var() / (2.0 * found.mean()):13.2f}  "
        f"{odds.mean():8.3g} +- {error:<7.2g}  {found.min():6.1f}  {'  '.join(f'{cell:>18}' for cell in cells)}"
    )


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--flights", type=int, default=1000)
    parser.add_argument("--first", type=int, default=0, help="number of the first flight")
    parser.add_argument("--kind", default="nominal_exact", help="of card.yaml, without a failure")
    parser.add_argument("--set", dest="settings", nargs="*", default=[], metavar="KEY=VALUE")
    parser.add_argument("--after", type=float, default=36.0, help="time from which on hypotheses are compared, s")
    parser.add_argument("--jets", type=int, default=6, help="whose forces are tried")
    given = parser.parse_args()
    groups = yaml.safe_load((Path(__file__).parent / "card.yaml").read_text())["groups"]
    spec = next((kinds[given.kind] for kinds in groups.values() if given.kind in kinds), None)
    if spec is None:
        parser.error(f"card.yaml has no kind '{given.kind}'")
    options = {"spec": {"stream": given.kind, **spec}, "settings": given.settings, "after_s": given.after}
    os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        pilots = range(_FIRST_PILOT, _FIRST_PILOT + _PILOTS)
        unit = np.median(list(pool.map(partial(sigmas, jets=given.jets, **options), pilots)), axis=0)
        numbers = range(given.first, given.first + given.flights)
        each = list(pool.map(partial(ratios, unit=unit, **options), numbers, chunksize=4))
    found = np.array([one for one in each if one is not None])
    print(f"{given.kind}: {len(found)} flights, {len(each) - len(found)} not converged by {given.after:g} s")
    heading = "  ".join(f"{f'by {ahead:g}: {1e3 * np.exp(-ahead):.1f}':>18}" for ahead in _AHEAD)
    print("LLR in nats; wrong force ahead in thousandths, beside exp(-a) of them")
    print(f"{'force':12}  {'mean':>5}  {'sd':>5}  var/(2 mean)  E[exp(-LLR)]          lowest  {heading}")
    for index, nats in enumerate(_EXPECTED):
        print(line(f"of {nats:g} nats", found[:, index]))
    print(line("estimated", found[:, -1]))


if __name__ == "__main__":
    main()

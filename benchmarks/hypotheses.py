"""Hypothesis filter over flights of the card, flown once and read by it in open loop.

    python benchmarks/hypotheses.py KIND [--first N] [--count N] [--verbose]

Prints what truly failed, what is declared and when, the largest error in its own sigma, the time a sample takes (mean
and longest, ms) and the mean number of hypotheses. With `--verbose` the likeliest events and hypotheses of every sample
about the first failure. What was flown is kept in `runs/hypotheses`.
"""

from __future__ import annotations

import argparse
import pickle
import time
from pathlib import Path
from typing import Any

import card
import numpy as np
from fly import drawn, loaded

from massprop_drake import simulate
from massprop_drake.inputs.params import accelerometers, estimation_params, gyros
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.maths.estimation import cycle
from massprop_drake.maths.estimation.faults.declarations import Word
from massprop_drake.maths.estimation.faults.verdicts import jet_fault_probabilities, other_event_probabilities

_KEPT = Path("runs") / "hypotheses"


def flown(kind: str, number: int) -> tuple[Scenario, dict[str, Any]]:
    """Returns scenario and readings of a flight."""
    spec = card.load_card().kinds[kind]
    flight = drawn(spec, np.random.default_rng([number, *spec.get("stream", kind).encode()]), number)
    scenario, kept = loaded(flight, number, False), _KEPT / f"{kind}_{number}.pkl"
    if not kept.exists():
        run = simulate(scenario)
        names = [[one.name for one in of(scenario)] for of in (gyros, accelerometers)]
        read = [np.stack([run[name] for name in each], axis=1) for each in names]
        facts = [np.array(run[name]) for name in ("time_s", "command", "truth")]
        kept.parent.mkdir(parents=True, exist_ok=True)
        kept.write_bytes(pickle.dumps((*read, *facts, run.summary["injected"])))
    rates, velocities, time_s, commands, truth, injected = pickle.loads(kept.read_bytes())
    read = {"rates": rates, "velocities": velocities, "time_s": time_s}
    return scenario, read | {"commands": commands, "truth": truth, "injected": injected}


def said(own: Any, time_s: float, names: tuple[str, ...]) -> list[str]:
    """Lists the declarations at a sample."""
    found = [
        f"{time_s:.2f} {names[jet]} {Word(int(own.verdict[jet])).name.lower()} {own.verdict_magnitude[jet]:.4g}"
        for jet in np.flatnonzero(own.verdict)
    ]
    if np.isfinite(own.jump_measured):
        found.append(f"{time_s:.2f} mass properties")
    if np.isfinite(own.unexplained_since):
        found.append(f"{time_s:.2f} unexplained")
    if np.isfinite(own.lying_component):
        found.append(f"{time_s:.2f} reading {int(own.lying_component)}")
    return found


def main() -> None:
    """Reads flights of a kind."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kind", choices=list(card.load_card().kinds), metavar="KIND")
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--count", type=int, default=1)
    parser.add_argument("--verbose", action="store_true")
    given = parser.parse_args()
    for number in range(given.first, given.first + given.count):
        scenario, read = flown(given.kind, number)
        names, params = scenario.vehicle_data.designations, estimation_params(scenario)
        joint = params.filter_params.joint
        state, before = cycle.initial_state(params), np.zeros(len(names))
        first_s = min((one["first_acted_s"] or np.inf for one in read["injected"]), default=np.inf)
        words, spent, count = [], [], []
        for row, time_s in enumerate(read["time_s"].tolist()):
            now = read["commands"][row]
            sample = cycle.Sample(time_s, read["rates"][row], read["velocities"][row], before, None, None, now)
            began = time.process_time()
            done = cycle.step(state, sample, params)
            spent.append(time.process_time() - began)
            state, before = done.state, now
            tree = state.detector.tree
            count.append(len(tree.hypotheses))
            words += said(done.judgment.own, time_s, names)
            if given.verbose and first_s - 0.2 < time_s < first_s + 4.0:
                found = {
                    f"{names[jet]}{'+-'[sign < 0]}": share
                    for (jet, sign), share in jet_fault_probabilities(tree, joint).items()
                }
                found |= {f"{part[0].name} {part[1]}": share for part, share in other_event_probabilities(tree).items()}
                likely = sorted(found.items(), key=lambda item: -item[1])[:5]
                events = [f"{name} {share:.4f}" for name, share in likely]
                print(f"{time_s - first_s:6.2f} s {count[-1]:3d} hypotheses {len(tree.births):3d} wait:", *events)
        error = state.filter.estimate - read["truth"][-1]
        sigmas = error / np.sqrt(np.diag(state.filter.covariance))
        failed = [f"{one['kind']} {one['jet'] or ''} {one['first_acted_s'] or 0.0:.2f}" for one in read["injected"]]
        took = f"{1e3 * np.mean(spent):.1f} ms, {1e3 * np.max(spent):.0f} ms; {np.mean(count):.1f} hypotheses"
        print(number, failed, "->", words, f"largest {np.nanmax(np.abs(sigmas)):.1f} sigma; {took}", flush=True)


if __name__ == "__main__":
    main()

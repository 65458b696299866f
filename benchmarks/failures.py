"""Failure scenarios over sensor phases, beside the targets.

    python benchmarks/failures.py [--seeds 10] [--lag]

Runs every case on all seeds in two processes; `--lag` with 15 ms of thrust build-up and tail-off.
"""

from __future__ import annotations

import argparse
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake import load_scenario, simulate
from massprop_drake.results.summary import from_names

Array = NDArray[np.float64]

LAG = ("plant.thrust_transient=vehicle", "estimation.thrust_transient=gate_lag")


class Outcome(NamedTuple):
    """What one run leaves for the tables."""

    detections: list[dict[str, Any]]
    time_s: Array
    alarm: Array
    tested: Array
    isolated: Array
    jet: Array  # index of the likeliest
    cluster: Array
    magnitude: Array
    likelihood: Array
    rate: Array
    commanded: Array  # whether each axis's hand controller is out of detent
    held: Array  # attitude error, deg
    propellant: Array  # used up to each sample
    errors: Array  # estimate - truth over truth, at the end, %
    percent: Array  # at each sample, %
    out_of_use: int
    jumps: int
    wall: float


def fly(case: tuple[str, ...], seed: int) -> Outcome:
    """Runs one case with one seed."""
    name, *overrides = case
    scenario = load_scenario(name, [*overrides, f"seed={seed}"])
    run = simulate(scenario)
    truth = run["truth"]
    mass = 1.0 / truth[:, 9]
    return Outcome(
        detections=run.summary["detections"],
        time_s=run.time_s,
        alarm=run["alarm"][:, 0] > 0.0,
        tested=run["tested"][:, 0] > 0.0,
        isolated=run["jet_isolated"][:, 0] > 0.0,
        jet=run["suspected_jet"][:, 0].astype(int),
        cluster=run["suspected_cluster"][:, 0].astype(int),
        magnitude=run["suspected_magnitude"][:, 0],
        likelihood=run["suspected_likelihood"][:, 0],
        rate=np.degrees(run["rate"]),
        commanded=run["hand_controllers"][:, :3],
        held=np.degrees(run["attitude_error"]),
        propellant=mass[0] - mass,
        errors=from_names(run.summary["percent_error"]),
        percent=100.0 * (run["estimate"] - truth) / np.abs(truth),
        out_of_use=int((run["out_of_use"][-1] > 0.0).sum()),
        jumps=int(run["rotation_jump"].sum()),
        wall=run.summary["timing"]["real_time_factor"],
    )


def say(label: str, value: object) -> None:
    """Prints a row."""
    print(f"  {label:50} {value}")


def span(values: Any) -> str:
    """Median and range."""
    array = np.asarray(list(values), dtype=float)
    return "none" if array.size == 0 else f"{np.median(array):.4g} ({array.min():.4g} to {array.max():.4g})"


def first(outcome: Outcome, mask: Array, after: float = 50.0) -> float:
    """Samples from a time to the first where the mask holds: 1 is the first sample after it."""
    hits = np.flatnonzero(mask & (outcome.time_s > after + 1e-9))
    return np.inf if hits.size == 0 else round((outcome.time_s[hits[0]] - after) / 0.08)


def stuck(results: list[Outcome], healthy: list[Outcome], jet: int, cluster: int, magnitude: float) -> None:
    """A hard failure with reconfiguration."""
    wrong = sum(int((r.alarm & r.isolated & (r.jet != jet) & (r.time_s < 56.0)).sum()) for r in results)
    say(
        "first alarm of its cluster, samples after 50 s",
        span(first(r, r.alarm & (r.cluster == cluster)) for r in results),
    )
    say("first alarm that names the jet", span(first(r, r.alarm & r.isolated & (r.jet == jet)) for r in results))
    say("alarms that name a wrong jet (to 56 s)", wrong)
    say("declared, s after 50 s", span(d["time_s"] - 50.0 for r in results for d in r.detections[:1]))
    say("kinds and jets declared", sorted({(d["kind"], d["jet"]) for r in results for d in r.detections}))
    errors = [d["magnitude"] - magnitude for r in results for d in r.detections[:1]]
    say(f"magnitude declared - {magnitude:g}", span(errors))
    say("likelihood argument of the first alarm", span(r.likelihood[np.flatnonzero(r.alarm)[0]] for r in results))
    late = [r.time_s > 52.0 for r in results]
    say(
        "rates after 52 s, largest in hold, deg/s",
        span(np.abs(np.where(r.commanded == 0, r.rate, 0.0))[m].max() for r, m in zip(results, late, strict=True)),
    )
    say(
        "attitude error in hold after 52 s, deg",
        span(np.abs(r.held[m]).max() for r, m in zip(results, late, strict=True)),
    )
    say(
        "propellant per 10 s after 51 s",
        span(10.0 * (r.propellant[-1] - r.propellant[r.time_s > 51.0][0]) / (r.time_s[-1] - 51.0) for r in results),
    )
    ours = np.sqrt(np.mean(np.square([r.errors for r in results]), axis=0))
    theirs = np.sqrt(np.mean(np.square([r.errors for r in healthy]), axis=0))
    say("RMS of errors over healthy runs' RMS", np.round(ours / theirs, 2))


def soft(results: list[Outcome], jet: int, cluster: int, magnitude: float) -> None:
    """A soft failure without reconfiguration."""
    after = [r.tested & (r.time_s > 50.0) for r in results]
    right = [r.alarm & (r.cluster == cluster) for r in results]
    named = sum(int((m & r.alarm & r.isolated).sum()) for r, m in zip(results, after, strict=True))
    wrong = sum(int((m & r.alarm & r.isolated & (r.jet != jet)).sum()) for r, m in zip(results, after, strict=True))
    other = sum(int((m & r.alarm & (r.cluster != cluster)).sum()) for r, m in zip(results, after, strict=True))
    count = sum(int(m.sum()) for m in after)
    say(
        "first alarm of its cluster, samples after 50 s", span(first(r, a) for r, a in zip(results, right, strict=True))
    )
    say("tested samples after 50 s", count)
    share = 100.0 * named / count
    say("alarms naming the jet / a wrong jet / another cluster", f"{named} ({share:.1f} %) / {wrong} / {other}")
    force = np.concatenate([r.magnitude[m & r.alarm & (r.jet == jet)] for r, m in zip(results, after, strict=True)])
    any_jet = np.concatenate([r.magnitude[m & a] for r, m, a in zip(results, after, right, strict=True)])
    say(f"magnitude - {magnitude:g}, of the jet", span(force - magnitude))
    say(f"magnitude - {magnitude:g}, of the likeliest jet", span(any_jet - magnitude))
    say(
        "likelihood argument",
        span(np.concatenate([r.likelihood[m & a] for r, m, a in zip(results, after, right, strict=True)])),
    )


def health(results: list[Outcome], sensors: str) -> None:
    """Alarms while nothing fails."""
    alarms, tested = sum(int(r.alarm.sum()) for r in results), sum(int(r.tested.sum()) for r in results)
    say(f"{sensors}: declarations", sum(len(r.detections) for r in results))
    say(f"{sensors}: alarms per tested sample", f"{alarms} of {tested}: {alarms / tested:.5f}")


def recovery(outcome: Outcome, jump_s: float, elements: slice | int, percent: float) -> float:
    """Seconds after a jump until errors stay within a limit."""
    wrong = np.abs(outcome.percent[:, elements]) > percent
    bad = wrong.any(axis=1) if wrong.ndim > 1 else wrong
    bad &= outcome.time_s > jump_s
    hits = np.flatnonzero(bad)
    return 0.0 if hits.size == 0 else float(outcome.time_s[hits[-1]] - jump_s)


def main() -> None:
    """Prints a table a case."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--lag", action="store_true")
    arguments = parser.parse_args()
    extra = LAG if arguments.lag else ()
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:

        def runs(*case: str, seeds: int = arguments.seeds) -> list[Outcome]:
            return list(pool.map(fly, [(*case, *extra)] * seeds, range(seeds)))

        print("\njet 29 stuck on")
        stuck(runs("stuck_on_29"), runs("stuck_on_29", "failures=[]"), 28, 12, 868.819)
        print("\njet 11 stuck off")
        results = runs("stuck_off_11")
        stuck(results, runs("stuck_off_11", "failures=[]"), 10, 5, -874.185)
        reached = [r.time_s[np.flatnonzero((r.rate[:, 2] < -0.44) & (r.time_s > 50.0))[0]] - 50.0 for r in results]
        say("commanded rate reached, s after 50 s", span(reached))
        print("\nvernier 39 stuck on")
        soft(runs("vernier_stuck_on_39"), 38, 4, 24.483)
        print("\njet 24 leaking 10.4 lbf")
        soft(runs("leak_24"), 23, 10, 10.4)
        gaussian = (
            "sensors.errors=[{sensor: gyro, quantum: 0, noise_std: 4.3878e-7}, "
            "{sensor: acc2, quantum: 0, noise_std: 0.0099304}]"
        )
        print("\njet 24 leaking 10.4 lbf, Gaussian sensors of equal variance")
        soft(runs("leak_24", gaussian), 23, 10, 10.4)
        print("\njet 27 leaking 10 lbf")
        soft(runs("leak_27"), 26, 11, 10.0)
        print("\ntwo failures")
        results = runs("two_failures")
        both = [tuple((d["jet"], d["kind"]) for d in r.detections) for r in results]
        wanted = (("R4R", "jet_on"), ("F2R", "jet_off"))
        say(f"both isolated, of {len(both)}", both.count(wanted))
        print("\nhealthy, ten minutes")
        results = runs("healthy_long", seeds=12)
        health(results, "quantized sensors")
        results = runs("healthy_long", gaussian, seeds=12)
        health(results, "Gaussian sensors")
        for mass in (1000, 300, 2000):
            print(f"\npayload of {mass} slug released at 45 s")
            results = runs("payload_release", f"jumps[0].mass={mass}", seeds=20)
            kinds = [tuple(d["kind"] for d in r.detections) for r in results]
            say("declared", {kind: kinds.count(kind) for kind in set(kinds)})
            say("jets out of use", sum(r.out_of_use for r in results))
            say("single alarms of a jet", sum(int(r.alarm.sum()) for r in results))
            say("diagonal within 1 %, s after the release", span(recovery(r, 45.0, slice(0, 3), 1.0) for r in results))
            say("mass within 10 %, s after the release", span(recovery(r, 45.0, 9, 10.0) for r in results))


if __name__ == "__main__":
    main()

"""Worker that flies the flights of the card, one after the other, for the campaign engine."""

from __future__ import annotations

import csv
import json
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import yaml
from flights import bundled, moving, orbiter, poses, real, vehicles
from flights.flight import Array, Flight, Random, write_record

from massprop_drake import Estimator, Run, estimate, load_scenario, simulate
from massprop_drake.inputs.scenario import Scenario, resolve_scenario
from massprop_drake.records.rows import telemetry_columns
from massprop_drake.results.json_arrays import parameters_from_names

_SETTLED_S = 60.0  # of flights of hours, whose errors are looked at from then on
_TIMED = 20  # each so many flights the steps of the estimator are timed
_DECLARED = ("kind", "isolated_to", "jets", "time_s", "onset_s", "magnitude", "magnitude_std", "withdrawn_s")
_DECLARED_PAYLOAD = ("mass", "mass_std", "position", "position_std")


class Flights:
    """Flights that the card asks for, see `card.yaml`.

    Args:
        setup: `kinds`, the content of `card.yaml` under that key, and `compiled`.
    """

    def __init__(self, setup: Mapping[str, Any]):
        self._kinds = setup["kinds"]
        self.compiled: bool = setup["compiled"]

    def fly(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Flies one; returns its `facts` as a text of JSON, and `timed`, which differs from time to time.

        Args:
            request: `kind` and `number`.
        """
        kind, number = request["kind"], request["number"]
        spec = self._kinds[kind]
        random = np.random.default_rng([number, *spec.get("stream", kind).encode()])
        facts, timed = _FLOWN[spec["draw"].partition(".")[0]](spec, random, number, self.compiled)
        return {"facts": json.dumps(facts), "timed": json.dumps(timed)}


# --- simulated by the package


def _simulated(spec: Mapping[str, Any], random: Random, number: int, compiled: bool) -> tuple[Any, Any]:
    flight = drawn(spec, random, number)
    scenario = loaded(flight, number, compiled)
    run = simulate(scenario)
    flown, truth = run, parameters_from_names(run.summary["truth"])
    if flight.recorded is not None:
        record = flight.recorded(run, random)
        with TemporaryDirectory() as folder:
            path = Path(folder) / "telemetry.csv"
            gyro = scenario.vehicle_data.gyros[0].name
            write_record(record, scenario.vehicle_data.designations, gyro, path)
            run = estimate(path, loaded(flight._replace(settings=(*flight.settings, *flight.told)), number, compiled))
    failed = [_injected(one) for one in flown.summary["injected"]]
    facts = _facts(run, truth, failed, scenario)
    if spec.get("hours"):
        facts["sigmas"] = _largest(run, _SETTLED_S)
    return facts, _timed(run, flown, number)


def drawn(spec: Mapping[str, Any], random: Random, number: int) -> Flight:
    """Draws a flight of a kind that the package simulates."""
    module, _, name = spec["draw"].partition(".")
    draw = getattr({"bundled": bundled, "moving": moving, "orbiter": orbiter, "vehicles": vehicles}[module], name)
    flight: Flight = draw(random, number, **spec.get("with", {}))
    return flight


def loaded(flight: Flight, number: int, compiled: bool) -> Scenario:
    """Loads the scenario of a flight."""
    settings = [*flight.settings, f"seed={number}", f"execution.compiled={str(compiled).lower()}"]
    if isinstance(flight.scenario, str):
        return load_scenario(flight.scenario, settings)
    with TemporaryDirectory() as folder:
        (Path(folder) / "vehicle.yaml").write_text(yaml.safe_dump(flight.vehicle))
        path = Path(folder) / "scenario.yaml"
        path.write_text(yaml.safe_dump({**flight.scenario, "vehicle": "vehicle.yaml"}))
        return load_scenario(path, settings)


def _injected(one: Mapping[str, Any]) -> dict[str, Any]:
    return {name: one[name] for name in ("kind", "jet", "start_s", "first_acted_s", "force")}


def _largest(run: Run, since_s: float) -> list[float]:
    """Returns the error of each parameter in its 1-sigma where that is largest from a time on, shape (10,)."""
    rows = run.time_s > since_s
    every = (run["estimate"] - run["truth"])[rows] / run["standard_deviation"][rows]
    found: list[float] = every[np.argmax(np.abs(every), axis=0), np.arange(10)].tolist()
    return found


def _timed(run: Run, flown: Run, number: int) -> dict[str, Any]:
    """Measures processor time of the estimator's steps over some runs, ms: mean and longest."""
    if number % _TIMED or run is not flown:
        return {"mean_ms": None, "longest_ms": None}
    spent_ms = 1e3 * np.array(_step_times(run)[1:])
    return {"mean_ms": float(spent_ms.mean()), "longest_ms": float(spent_ms.max())}


def _step_times(run: Run) -> list[float]:
    """Measures processor time of each step of the real-time estimator over the readings of a run, s."""
    vehicle, spent = run.scenario.vehicle_data, []
    estimator = Estimator(vehicle, run.scenario)
    gyros = {one.name: np.array(run[one.name]) for one in vehicle.gyros}
    packages = {one.name: np.array(run[one.name]) for one in vehicle.accelerometers}
    commands = np.array(run["command"])
    onsets_s = run["command_onset"] if "command_onset" in run.signals else None
    for row, time_s in enumerate(run.time_s.tolist()):
        rates, velocities = ({name: values[row] for name, values in of.items()} for of in (gyros, packages))
        began = time.thread_time()
        estimator.step(time_s, rates, velocities, commands[row], onsets_s=None if onsets_s is None else onsets_s[row])
        spent.append(time.thread_time() - began)
    return spent


# --- tracked in a fixed frame


def _tracked(spec: Mapping[str, Any], _random: Random, number: int, _compiled: bool) -> tuple[Any, Any]:
    given = {"vehicle": "", "departures": {}, "told": {}, "walk": 0.0, "seconds": 60.0} | spec.get("with", {})
    vehicle, flight = poses.drawn_flight(number, **given)
    rows, _ = flight.rows()
    began = time.thread_time()
    with TemporaryDirectory() as folder:
        path = Path(folder) / "record.csv"
        with path.open("w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(telemetry_columns(vehicle))
            writer.writerows([["" if np.isnan(cell) else repr(float(cell)) for cell in row] for row in rows])
        run = estimate(path, resolve_scenario({"name": "flight", "vehicle": vehicle}))
    spent_s = time.thread_time() - began
    true = flight.truth
    failed = []
    if true.dead >= 0:
        jet, tenth_s = vehicle.designations[true.dead], poses.tenth_pulse(rows, true, vehicle)
        force = -(1.0 - true.left) * float(np.linalg.norm(true.thrusts[true.dead]))
        acted_s = None if tenth_s is None else true.since_s
        failed = [{"kind": "degraded", "jet": jet, "start_s": true.since_s, "first_acted_s": acted_s, "force": force}]
    facts = _facts(run, poses.true_parameters(true, vehicle), failed, run.scenario)
    return facts, {"mean_ms": 1e3 * spent_s / len(run.time_s), "longest_ms": None}


# --- recorded by somebody else


def _recorded(spec: Mapping[str, Any], random: Random, _number: int, _compiled: bool) -> tuple[Any, Any]:
    name = spec["draw"].partition(".")[2]
    known = real.KNOWN[name]
    with TemporaryDirectory() as folder:
        path, by = real.cut(random, name, Path(folder))
        run = estimate(path, load_scenario("air_bearing_pulses"), record_map=by)
    truth = np.full(10, np.nan)
    truth[9] = 1.0 / known.mass
    failed = [
        {"kind": "degraded", "jet": jet, "start_s": 0.0, "first_acted_s": 0.0, "force": None} for jet in known.failed
    ]
    return _facts(run, truth, failed, run.scenario), {"mean_ms": None, "longest_ms": None}


_FLOWN = {
    **dict.fromkeys(("bundled", "moving", "orbiter", "vehicles"), _simulated),
    "poses": _tracked,
    "real": _recorded,
}


# --- what is kept of a flight


def _facts(run: Run, truth: Array, failed: Sequence[Mapping[str, Any]], scenario: Scenario) -> dict[str, Any]:
    """Returns the facts of a flight from which the table is made.

    Args:
        run: estimated in flight or from the record.
        truth: the ten parameters at the end, NaN where unknown, shape (10,).
        failed: `kind`, `jet`, `start_s`, `first_acted_s` and `force` of each failure and payload.
        scenario: as flown.
    """
    summary = run.summary
    error = parameters_from_names(summary["estimates"]) - truth
    deviation = parameters_from_names(summary["standard_deviations"])
    known = np.isfinite(error) & (deviation > 0.0)
    sigmas = np.where(known, error / np.where(known, deviation, 1.0), np.nan)
    covariance = np.array(summary["covariance"], dtype=float)[np.ix_(known, known)]
    shape = covariance / np.outer(deviation[known], deviation[known])
    faulty = {jet for one in failed if (jet := one["jet"])}
    consistency = summary["consistency"]
    out = np.flatnonzero(run["out_of_use"][-1]).tolist() if "out_of_use" in run.signals else []
    names = [scenario.vehicle_data.designations[jet] for jet in out]
    return {
        "duration_s": summary["duration_s"],
        "errors": _listed(error),
        "deviations": _listed(deviation),
        "sigmas": _listed(sigmas),
        "nees": float(sigmas[known] @ np.linalg.solve(shape, sigmas[known])) if known.any() else None,
        "failed": list(failed),
        "payloads": [
            {"mass": one.mass if one.kind == "dock" else -one.mass, "position": list(one.position)}
            for one in scenario.jumps
        ],
        "declared": [{name: one[name] for name in (*_DECLARED, *_DECLARED_PAYLOAD)} for one in summary["detections"]],
        "other": [
            {name: one[name] for name in ("kind", "time_s", "sensor", "axis")}
            for one in summary["events"]
            if one["kind"] in ("false_reading", "unexplained")
        ],
        "healthy_jets_out": [name for name in names if name not in faulty],
        "verdict": consistency["verdict"],
        "reasons": [one["kind"] for one in consistency["diagnoses"]],
    }


def _listed(values: Array) -> list[float | None]:
    """Converts numbers for JSON, None where unknown."""
    return [float(value) if np.isfinite(value) else None for value in values]

"""Comparison of the numbers of two versions, bit for bit.

    python benchmarks/same_numbers.py record FOLDER [NAME ...]
    python benchmarks/same_numbers.py compare EARLIER LATER
    python benchmarks/same_numbers.py compiled [NAME ...]

`record` runs every bundled scenario with three seeds, and variants that turn on what no bundled scenario uses,
by whichever version is installed; estimates from each run's own telemetry besides; and keeps signals, summaries,
telemetry and saved states. `compare` looks at two such folders. `compiled` flies each case twice with five seeds, in
numpy and compiled, and says what is decided otherwise, and how far apart the rest is. Names that have changed are in
`tests/data/renamed.csv`. Not compared: the version, timing, and digests of files.
"""

from __future__ import annotations

import csv
import json
import sys
import warnings
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

SEEDS = (0, 1, 2)
COMPILED_SEEDS = (0, 1, 2, 3, 4)
# what is decided is the same; sums of squares and differences of such, and all else, by the largest of a signal
DECIDED = ("command", "rotation_used", "mass_used", "alarm", "tested", "detector_event", "suspected_jet", "out_of_use")
OF_LIKELIHOOD = ("likelihood", "nis", "margin", "unexplained")
STATES, LIKELIHOODS = 5e-12, 1e-10
RENAMED = Path(__file__).parent.parent / "tests" / "data" / "renamed.csv"
ERRORS = (
    "sensors.errors=[{sensor: gyro, scale_factor: [1.0e-4, 0, -1.0e-4], bias: [1.0e-6, 0, -2.0e-6], "
    "bias_random_walk: 1.0e-7, noise_std: 2.0e-6}, "
    "{sensor: acc2, bandwidth_hz: 20.0, bias: [1.0e-3, 0, 0], noise_std: 0.01, delay_samples: 1}]"
)
# what no bundled scenario turns on, flown on one that shows it
VARIANTS = {
    "extended": ("sample_maneuver", "rotation.filter=extended", "rotation.coupling=ignore"),
    "modelled": (  # codespell:ignore
        "sample_maneuver",
        "rotation.coupling=model",
        "mass.compensation=transverse_centripetal",
    ),
    "without_bias": ("sample_maneuver", "rotation.filter=second_order_without_bias", "mass.jump=none"),
    "thrust_errors": ("stuck_on_29", "plant.thrust_dispersion=0.01", "estimation.thrust_uncertainty=0.01"),
    "serial": ("sample_maneuver", "sensors.combine={gyros: serial, accelerometers: serial}"),
    "correlated": ("leak_24", "sensors.combine={accelerometers: weighted_average, correlated: true}"),
    "mid_value": ("sample_maneuver", "sensors.combine={accelerometers: mid_value}", "mass.jump=glr"),
    "average": ("stuck_off_11", "sensors.combine={accelerometers: average}", "detector.on_detection=reject"),
    "thesis_correction": ("stuck_on_29", "detector.on_detection=correct_thesis", "mass.jump=single_sample_thesis"),
    "manifold": ("stuck_on_29", "detector.close_manifold=true", "autopilot.mass_properties=estimated"),
    "noisy": ("sample_maneuver", ERRORS, "plant.thrust_transient=vehicle"),
    "continuous": ("stuck_on_29", "plant.time_step=0", "duration_s=60"),
    "instantaneous": ("two_failures", "plant.thrust_transient=none", "estimation.thrust_transient=gate"),
    "walk": ("payload_release", "rotation.process_noise_std=[1e-12,1e-12,1e-12,0,0,0,1e-4,0,0]"),
    "unexplained": ("vernier_stuck_on_39", "detector.signature_uncertainty=false", "detector.unexplained_limit=null"),
}
_NOT_COMPARED = {"version", "timing", "provenance"}


def cases() -> dict[str, tuple[str, ...]]:
    """Lists every case by name: a bundled scenario and its settings."""
    from massprop_drake import load_scenario  # noqa: PLC0415 (either version)

    bundled = import_module(load_scenario.__module__).bundled_scenarios()
    return {**{name: (name,) for name in bundled}, **VARIANTS}


def record(folder: Path, wanted: list[str]) -> None:
    """Runs the cases with the version that is installed; existing results are kept."""
    from massprop_drake import estimate, load_scenario, simulate  # noqa: PLC0415 (either version)

    warnings.simplefilter("ignore")
    for name, (scenario, *overrides) in cases().items():
        if wanted and name not in wanted:
            continue
        for seed in SEEDS:
            place = folder / f"{name}-{seed}"
            if (place / "estimated" / "summary.json").exists():
                continue
            case = load_scenario(scenario, [*overrides, f"seed={seed}"])
            simulate(case).save(place / "run", pictures=False, report=False)
            replayed = estimate(place / "run" / "telemetry.csv", case)
            replayed.save(place / "estimated", pictures=False, report=False)
            print(place.name, flush=True)


def renamed() -> dict[str, dict[str, str]]:
    """Reads new names of old ones, by kind; an empty new name: it is gone."""
    found: dict[str, dict[str, str]] = {}
    with RENAMED.open(encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            found.setdefault(row["kind"], {})[row["old"]] = row["new"]
    return found


def differences(earlier: Path, later: Path, names: dict[str, dict[str, str]]) -> Iterator[str]:
    """Yields the differences between two folders of a run, a line each."""
    with np.load(earlier / "history.npz") as old, np.load(later / "history.npz") as new:
        signals = names.get("signal", {})
        for name in old.files:
            if name.startswith("_") or signals.get(name) == "":
                continue
            other = signals.get(name, name)
            if other not in new.files:
                yield f"signal {name}: is gone"
            elif not np.array_equal(old[name], new[other], equal_nan=True):
                worst = np.nanmax(np.abs(old[name] - new[other])) if old[name].shape == new[other].shape else np.nan
                yield f"signal {name}: differs by up to {worst:.3g}"
    if (earlier / "telemetry.csv").read_bytes() != (later / "telemetry.csv").read_bytes():
        yield "telemetry.csv differs"
    before, after = (json.loads((place / "summary.json").read_text()) for place in (earlier, later))
    yield from _unequal(before, after, names.get("summary", {}), "")


def _unequal(before: Any, after: Any, names: dict[str, str], path: str) -> Iterator[str]:
    if isinstance(before, dict) and isinstance(after, dict):
        for key, value in before.items():
            if key in _NOT_COMPARED or names.get(key) == "":
                continue
            other = names.get(key, key)
            if other not in after:
                yield f"summary {path}{key}: is gone"
            else:
                yield from _unequal(value, after[other], names, f"{path}{key}.")
    elif isinstance(before, list) and isinstance(after, list) and len(before) == len(after):
        for index, (old, new) in enumerate(zip(before, after, strict=True)):
            yield from _unequal(old, new, names, f"{path}{index}.")
    elif before != after:
        yield f"summary {path.rstrip('.')}: {before!r} became {after!r}"


def compare(earlier: Path, later: Path) -> int:
    """Prints the differences; returns how many cases differ."""
    names, wrong, compared = renamed(), 0, 0
    for place in sorted(path for path in earlier.iterdir() if path.is_dir()):
        if not (later / place.name / "estimated" / "summary.json").exists():
            print(f"{place.name}: not run")
            wrong += 1
            continue
        compared += 1
        found = [
            f"  {part}: {line}"
            for part in ("run", "estimated")
            for line in differences(place / part, later / place.name / part, names)
        ]
        if found:
            wrong += 1
            print(place.name, *found[:8], sep="\n")
    print(f"{compared} cases compared, {wrong} differ")
    return wrong


def apart(plain: Any, compiled: Any) -> tuple[list[str], float, float]:
    """Compares two runs: signals that decide otherwise, and relative differences of states and likelihoods."""
    otherwise, states, likelihoods = [], 0.0, 0.0
    for name in plain.signals:
        one, other = np.asarray(plain[name], dtype=float), np.asarray(compiled[name], dtype=float)
        if name in DECIDED:
            if not np.array_equal(one, other, equal_nan=True):
                otherwise.append(name)
            continue
        if not np.array_equal(np.isfinite(one), np.isfinite(other)):
            otherwise.append(f"{name}, where it is a number")
            continue
        known = np.isfinite(one)
        size = np.abs(one[known]).max(initial=0.0)
        far = float(np.abs(one - other)[known].max(initial=0.0) / size) if size > 0.0 else 0.0
        if any(word in name for word in OF_LIKELIHOOD):
            likelihoods = max(likelihoods, far)
        else:
            states = max(states, far)
    told = [[(event["kind"], event["jets"]) for event in run.summary["events"]] for run in (plain, compiled)]
    return otherwise + (["events"] if told[0] != told[1] else []), states, likelihoods


def compiled(wanted: list[str]) -> int:
    """Prints how far compiled runs are from those in numpy; returns how many are too far."""
    from massprop_drake import InputError, load_scenario, simulate  # noqa: PLC0415 (either version)

    warnings.simplefilter("ignore")
    wrong = 0
    for name, (scenario, *overrides) in cases().items():
        if wanted and name not in wanted:
            continue
        engine = "diagram" if name == "continuous" else "loop"
        for seed in COMPILED_SEEDS:
            ways = [f"execution={{engine: {engine}, compiled: {each}}}" for each in ("false", "true")]
            try:
                runs = [simulate(load_scenario(scenario, [*overrides, f"seed={seed}", way])) for way in ways]
            except InputError as error:
                print(f"{name}: {error}", flush=True)
                break
            otherwise, states, likelihoods = apart(*runs)
            far = bool(otherwise) or states > STATES or likelihoods > LIKELIHOODS
            wrong += far
            said = f", otherwise: {', '.join(otherwise)}" if otherwise else ""
            print(f"{name}-{seed}: states {states:.1e}, likelihoods {likelihoods:.1e}{said}{' *' * far}", flush=True)
    return wrong


def main() -> None:
    """Records or compares."""
    match sys.argv[1:]:
        case ["record", folder, *wanted]:
            record(Path(folder), wanted)
        case ["compare", earlier, later]:
            sys.exit(1 if compare(Path(earlier), Path(later)) else 0)
        case ["compiled", *wanted]:
            sys.exit(1 if compiled(wanted) else 0)
        case _:
            sys.exit(__doc__)


if __name__ == "__main__":
    main()

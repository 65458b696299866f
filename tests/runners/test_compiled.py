"""Compiled kernels: asked for, the same but for rounding, and never there by themselves."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import REPOSITORY
from script_probe import script
from vehicle_flights import step

from massprop_drake import Estimator, estimate, load_scenario, simulate

pytest.importorskip("numba")

# the compiler takes no notice of it where it is made ready, which is in whatever test comes first
pytestmark = pytest.mark.filterwarnings("ignore:.*is faster on contiguous arrays")
_BENCHMARK = script(REPOSITORY / "benchmarks" / "same_numbers.py")
# what is decided, not reckoned: the same to the last bit; and bounds relative to the largest of a signal
DECIDED, OF_LIKELIHOOD = _BENCHMARK.DECIDED, _BENCHMARK.OF_LIKELIHOOD
STATES, LIKELIHOODS = _BENCHMARK.STATES, _BENCHMARK.LIKELIHOODS


def require_close(compiled: Any, plain: Any) -> None:
    """What is decided is the same, and the rest but for rounding."""
    for name in plain.signals:
        one, other = compiled[name], plain[name]
        if name in DECIDED:
            np.testing.assert_array_equal(one, other, err_msg=name)
            continue
        size = np.abs(other[np.isfinite(other)]).max(initial=0.0)
        limit = LIKELIHOODS if any(word in name for word in OF_LIKELIHOOD) else STATES
        np.testing.assert_allclose(one, other, rtol=0.0, atol=limit * size, err_msg=name)
    assert [entry["jets"] for entry in compiled.summary["detections"]] == [
        entry["jets"] for entry in plain.summary["detections"]
    ]
    bounds, expected = ([entry["bound"] for entry in run.summary["identifiability"]] for run in (compiled, plain))
    # by regression upon all readings: changed in their last bit they change those of six seconds by 3e-8
    assert bounds == pytest.approx(expected, rel=1e-7)


FAILING = (  # so that a jet is suspected, declared and reckoned with
    "stuck_on_29",
    "duration_s=20",
    "estimation.start=nominal",
    "estimation.std_fraction=0.05",
    "failures=[{kind: stuck_on, jet: R4R, start_s: 12}]",
)
# one each of what the kernel from sample to sample does besides
FLOWN = {
    "a filter of the thesis": ("sample_maneuver", "duration_s=20"),
    "the joint filter": ("orbiter_maneuver", "duration_s=10"),
    "a jet that sticks on": FAILING,
    "sensors that are noisy, late and shaken, thrust that lags, a disturbance": (
        "sample_maneuver",
        "duration_s=8",
        "plant.thrust_transient=vehicle",
        "plant.disturbance={torque_std: [1, 1, 1], force: [1, 0, 0]}",
        "sensors.errors=[{sensor: gyro, bias_random_walk: 1.0e-7, noise_std: 2.0e-6}, {sensor: acc1, bandwidth_hz: 5}, "
        "{sensor: acc2, noise_std: 0.01, bias: [1.0e-3, 0, 0], delay_samples: 1, "
        "vibration: [{frequency_hz: 9, amplitude: [1, 0, 0]}]}]",
    ),
    "on-times that the autopilot flies about the middle of a cycle": (
        "sample_maneuver",
        "duration_s=6",
        "vehicle.jet_kinds.primary.minimum_on_time_s=0.02",
        "vehicle.jet_kinds.primary.on_time_quantum_s=0.004",
        "vehicle.jet_commands={as: on_time, at: center}",
        "autopilot.jet_selection.output=on_time",
    ),
    "jets that fail each in its way": (
        "sample_maneuver",
        "duration_s=8",
        "failures=[{kind: leak, jet: R4R, start_s: 1, force: 20}, "
        "{kind: intermittent, jet: L3L, start_s: 1, level: 0.5, probability: 0.3}, "
        "{kind: drift, jet: F3F, start_s: 2, rate_per_s: -0.1}, {kind: degraded, jet: F1F, "
        "start_s: 0.5, fraction: 0.4}, {kind: stuck_off, jet: F2F, start_s: 2, end_s: 5}]",
    ),
    "estimates that are acted upon, manifolds that are closed": (
        *FAILING[:2],
        *FAILING[2:],
        "detector.close_manifold=true",
        "autopilot.mass_properties=estimated",
    ),
}


@pytest.mark.parametrize("what", FLOWN)
def test_flights_are_compiled_alike(what: str, tmp_path: Path) -> None:
    name, *overrides = FLOWN[what]
    plain, compiled = (
        simulate(load_scenario(name, [*overrides, f"execution={{engine: loop, compiled: {asked}}}"]))
        for asked in ("false", "true")
    )
    require_close(compiled, plain)
    assert compiled.summary["provenance"]["engine"].startswith("loop, compiled by numba ")
    if what == "a jet that sticks on":  # its record, read by the same kernels: the same bits
        assert plain["rotation_used"].any()
        assert plain.summary["detections"]
        compiled.save(tmp_path / "run", pictures=False, report=False)
        again = estimate(tmp_path / "run" / "telemetry.csv", load_scenario(tmp_path / "run"))
        np.testing.assert_array_equal(again["estimate"], compiled["estimate"])
        assert load_scenario(tmp_path / "run").execution.compiled


@pytest.mark.parametrize(
    "case",
    [("orbiter_maneuver", "duration_s=6"), ("stuck_on_29", "plant.time_step=0", "duration_s=6")],
    ids=["the joint filter", "a continuous plant"],
)
def test_what_the_loop_has_otherwise_is_compiled_in_the_diagram(case: tuple[str, ...]) -> None:
    name, *overrides = case
    plain, compiled = (simulate(load_scenario(name, [*overrides, f"execution.compiled={it}"])) for it in (False, True))
    require_close(compiled, plain)


def test_the_estimator_compiles_its_cycle_too() -> None:
    asked = load_scenario(FAILING[0], [*FAILING[1:], "execution={engine: loop, compiled: true}"])
    run = simulate(asked)
    steps = []
    dut = Estimator(asked.vehicle_data, asked)
    for row in range(run.time_s.size):
        if row == 200:  # from its state as JSON has it
            state, dut = dut.state, Estimator(asked.vehicle_data, asked)
            dut.restore(state)
        steps.append(step(dut, run, row))
    np.testing.assert_array_equal([one.estimate for one in steps], run["estimate"])
    np.testing.assert_array_equal([one.standard_deviation for one in steps], run["standard_deviation"])
    np.testing.assert_array_equal([one.rotation_nis for one in steps], run["rotation_nis"][:, 0])
    np.testing.assert_array_equal([one.alarm for one in steps], run["alarm"][:, 0])
    np.testing.assert_array_equal(dut.covariance, run.covariance)
    (found,) = [one.detection for one in steps if one.detection is not None]
    assert (found.kind, found.jet) == ("jet", "R4R")
    assert steps[-1].removed.any()


def test_damaged_compiled_code_is_compiled_anew(tmp_path: Path) -> None:
    """Cut off, emptied, overwritten, with a hole, or without the right to read: one line, and the same result."""
    code = (
        "import numpy as np; from massprop_drake.maths import attitude, kernels; "
        "print(kernels.compile_kernel(attitude.multiply)(np.eye(4)[0], np.eye(4)[1]))"
    )
    environ = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}

    def run() -> tuple[str, list[str]]:
        done = subprocess.run([sys.executable, "-c", code], env=environ, check=True, capture_output=True, text=True)
        return done.stdout, done.stderr.splitlines()

    expected, _ = run()
    (index,), (data,) = list(tmp_path.rglob("*.nbi")), list(tmp_path.rglob("*.nbc"))
    for path in (index, data):
        content = path.read_bytes()
        middle = len(content) // 2
        hole = content[:middle] + bytes(16) + content[middle + 16 :]
        for damaged in (content[:-1], hole):
            path.write_bytes(damaged)
            got, said = run()
            assert got == expected
            assert [line for line in said if "is damaged (" in line] == [said[0]]
            assert str(path.parent) in said[0]
            assert run() == (expected, [])
    index.unlink()
    index.mkdir()
    got, said = run()
    assert got == expected
    assert sum("cannot be kept" in line for line in said) == 1


def test_another_process_reads_compiled_code() -> None:
    asked = [*FAILING[1:], "execution={engine: loop, compiled: true}"]
    simulate(load_scenario(FAILING[0], asked))
    code = (
        "from massprop_drake import load_scenario, simulate; from massprop_drake.maths import kernels; "
        f"run = simulate(load_scenario({FAILING[0]!r}, {asked!r})); "
        "assert run.summary['detections']; assert kernels.compiler().spent_s == 0.0, kernels.compiler().spent_s"
    )
    subprocess.run([sys.executable, "-W", "ignore", "-c", code], check=True)

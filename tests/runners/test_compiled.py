"""Compiled kernels: asked for, the same but for rounding, and never there by themselves."""

from __future__ import annotations

import gc
import importlib.util
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import REPOSITORY
from pydrake.systems.analysis import Simulator
from script_probe import script

from massprop_drake import Estimator, InputError, estimate, load_scenario, simulate
from massprop_drake.diagrams import closed_loop
from massprop_drake.inputs.params import thesis_params
from massprop_drake.maths import kernels
from massprop_drake.maths.autopilot.phase_space import Sensed
from massprop_drake.maths.estimation.offline import record_kernels
from massprop_drake.maths.linear_algebra import cross
from massprop_drake.maths.vehicle.rigid_body import step

# the compiler takes no notice of it where it is made ready, which is in whatever test comes first
pytestmark = pytest.mark.filterwarnings("ignore:.*is faster on contiguous arrays")
_BENCHMARK = script(REPOSITORY / "benchmarks" / "same_numbers.py")
# what is decided, not reckoned: the same to the last bit; and bounds relative to the largest of a signal
DECIDED, OF_LIKELIHOOD = _BENCHMARK.DECIDED, _BENCHMARK.OF_LIKELIHOOD
STATES, LIKELIHOODS = _BENCHMARK.STATES, _BENCHMARK.LIKELIHOODS


def test_a_kernel_is_the_function_itself() -> None:
    assert step in kernels._KERNELS
    assert kernels.chosen(step, compile_it=False) is step
    assert type(cross(np.eye(3)[0], np.eye(3)[1])) is np.ndarray


def test_bundles_for_compiled_code_hold_no_enumeration_members() -> None:
    params = thesis_params(load_scenario("sample_maneuver")).rotation
    plain = kernels.plain(params)
    assert (type(plain), type(plain.rule), type(plain.coupling)) == (type(params), int, int)
    assert plain.process_noise is params.process_noise


def test_without_numba_it_is_said_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    kernels.compiler.cache_clear()
    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name, *of: None if name == "numba" else find(name, *of))
    case = load_scenario("sample_maneuver", ["duration_s=1", "execution={engine: loop, compiled: true}"])
    with pytest.raises(InputError, match=r"execution\.compiled: needs numba: pip install 'massprop-drake\[fast\]'"):
        simulate(case)


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


def test_a_bundle_is_a_reference_in_compiled_code_and_the_same_named_tuple_in_python() -> None:
    pytest.importorskip("numba")
    compiler = kernels.compiler()

    def turned(given: Sensed, rate: Any) -> Sensed:
        other = Sensed(
            given.rotation_command, given.translation_command, rate=rate, delivered=rate, attitude_error=rate
        )
        return other if rate[0] > given.rate[0] else given

    import numba  # noqa: PLC0415 (optional)

    first = Sensed(*(np.full(3, float(number)) for number in range(5)))
    compiled = numba.njit(turned)
    for rate in (np.full(3, 2.0), np.full(3, 4.0)):
        made, expected = compiled(first, rate), turned(first, rate)
        assert type(made) is Sensed
        np.testing.assert_array_equal(made, expected)
    (signature,) = compiled.signatures
    assert signature[0].bundle is Sensed
    assert len(numba.core.registry.cpu_target.target_context.get_value_type(signature[0]).elements) == 1
    assert compiler.spent_s > 0.0


@pytest.mark.parametrize(("one", "other"), [(1.0, 0.0), (1.0, "vector"), ("vector", 0.0), ("vector", "other")])
def test_either_of_two_is_taken_element_by_element(one: Any, other: Any) -> None:
    pytest.importorskip("numba")
    vectors = {"vector": np.array([1.5, np.nan, -2.0]), "other": np.array([np.inf, 4.0, 0.25])}
    given = [vectors.get(value, value) for value in (one, other)]
    condition = np.array([True, False, True])
    kernels.compiler()
    import numba  # noqa: PLC0415 (optional)

    compiled = numba.njit(lambda *parts: kernels.either(parts[0], parts[1], parts[2]))
    np.testing.assert_array_equal(compiled(condition, *given), np.where(condition, *given))
    np.testing.assert_array_equal(kernels.either(condition, *given), np.where(condition, *given))


def test_machine_code_is_made_of_what_python_calls_alone() -> None:
    numba = pytest.importorskip("numba")
    kernels.compiler()
    inner = numba.njit(no_cpython_wrapper=True)(lambda x: 2.0 * x)
    outer = numba.njit(lambda x: inner(x) + 1.0)
    assert outer(3.0) == 7.0
    assert gc.isenabled()  # again
    made = {function: [one.library._waits for one in function.overloads.values()] for function in (inner, outer)}
    assert made == {inner: [True], outer: [False]}


def test_levels_lag_the_same_compiled() -> None:
    pytest.importorskip("numba")
    random = np.random.default_rng(3)
    told, remaining = random.integers(0, 2, (40, 3)).astype(float), np.array([0.0, 0.02, 0.6])
    lagged = []
    for compiled in (False, True):
        level, slope = told.copy(), np.zeros((40, 3))
        record_kernels.compute(compiled=compiled).lag(level, slope, remaining, 0.5 * remaining)
        lagged.append(np.hstack((level, slope)))
    np.testing.assert_allclose(*lagged, atol=1e-15)


def test_references_are_counted_as_they_come_and_go() -> None:
    pytest.importorskip("numba")
    runtime = pytest.importorskip("numba.core.runtime")
    call = kernels.compiled(cross)
    call(np.eye(3)[0], np.eye(3)[1])
    (library,) = [one.library for one in call.overloads.values()]  # type: ignore[attr-defined]
    assert library.__class__.__module__ == "massprop_drake.maths._linking"
    runtime._nrt_python.memsys_enable_stats()
    try:
        before = runtime.rtsys.get_allocation_stats()
        kept = [call(np.eye(3)[0], np.full(3, float(number))) for number in range(100)]
        between = runtime.rtsys.get_allocation_stats()
        np.testing.assert_array_equal(kept[7], np.cross(np.eye(3)[0], np.full(3, 7.0)))
        del kept
        after = runtime.rtsys.get_allocation_stats()
    finally:
        runtime._nrt_python.memsys_disable_stats()
    assert between.mi_alloc - before.mi_alloc >= 100
    assert (between.mi_alloc - before.mi_alloc) - (between.mi_free - before.mi_free) == 100
    assert after.mi_alloc - before.mi_alloc == after.mi_free - before.mi_free


FAILING = (  # so that a jet is suspected, declared and reckoned with
    "stuck_on_29",
    "duration_s=20",
    "estimation.start=nominal",
    "estimation.std_fraction=0.05",
    "failures=[{kind: stuck_on, jet: R4R, start_s: 12}]",
)
CASES = (("sample_maneuver", "duration_s=50"), FAILING, ("orbiter_maneuver", "duration_s=10"))
# one each of what the kernel from sample to sample does besides
FLOWN = {
    "sensors that are noisy, late and shaken, thrust that lags, a disturbance": (
        "sample_maneuver",
        "duration_s=8",
        "plant.thrust_transient=vehicle",
        "plant.disturbance={torque_std: [1, 1, 1], force: [1, 0, 0]}",
        "sensors.errors=[{sensor: gyro, bias_random_walk: 1.0e-7, noise_std: 2.0e-6}, {sensor: acc1, bandwidth_hz: 5}, "
        "{sensor: acc2, noise_std: 0.01, bias: [1.0e-3, 0, 0], delay_samples: 1, "
        "vibration: [{frequency_hz: 9, amplitude: [1, 0, 0]}]}]",
    ),
    "a jump of mass properties": ("payload_release", "duration_s=6", "jumps[0].time_s=3"),
    "a schedule of jets": ("jet_pulses", "duration_s=6"),
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


@pytest.mark.parametrize("case", CASES)
def test_compiled_kernels_give_the_same_but_for_rounding(case: tuple[str, ...], tmp_path: Path) -> None:
    pytest.importorskip("numba")
    kernels.compiler.cache_clear()
    plain = simulate(load_scenario(case[0], [*case[1:], "execution={engine: loop}"]))
    asked = load_scenario(case[0], [*case[1:], "execution={engine: loop, compiled: true}"])
    compiled = simulate(asked)
    require_close(compiled, plain)
    assert plain["rotation_used"].any()
    assert case is not FAILING or plain.summary["detections"]
    provenance = compiled.summary["provenance"]
    assert provenance["engine"].startswith("loop, compiled by numba ")
    if case[0] == "orbiter_maneuver":
        return  # the joint filter reads records row by row, as it flies
    # the record of it, read by the same kernels: the same bits
    compiled.save(tmp_path / "run", pictures=False, report=False)
    again = estimate(tmp_path / "run" / "telemetry.csv", load_scenario(tmp_path / "run"))
    np.testing.assert_array_equal(again["estimate"], compiled["estimate"])
    assert load_scenario(tmp_path / "run").execution.compiled


def test_stamps_off_their_ticks_are_compiled_alike(tmp_path: Path) -> None:
    pytest.importorskip("numba")
    scenario = load_scenario("orbiter_maneuver", ["duration_s=12", "execution={engine: loop}"])
    simulate(scenario).save(tmp_path / "run", pictures=False, report=False)
    heading, *rows = (tmp_path / "run" / "telemetry.csv").read_text(encoding="utf-8").splitlines()
    late = np.random.default_rng(4).uniform(-1e-3, 1e-3, len(rows)).tolist()
    written = [
        ",".join([repr(float(row.split(",")[0]) + off), *row.split(",")[1:]])
        for row, off in zip(rows, late, strict=True)
    ]
    (tmp_path / "off.csv").write_text("\n".join([heading, *written]), encoding="utf-8")
    plain = estimate(tmp_path / "off.csv", scenario)
    compiled = estimate(tmp_path / "off.csv", load_scenario(tmp_path / "run", ["execution.compiled=true"]))
    require_close(compiled, plain)
    assert plain.summary["data_quality"]["jitter"]["count"] > 100


@pytest.mark.parametrize("what", FLOWN)
def test_all_that_a_vehicle_may_meet_is_compiled_alike(what: str) -> None:
    pytest.importorskip("numba")
    name, *overrides = FLOWN[what]
    plain, compiled = (
        simulate(load_scenario(name, [*overrides, f"execution={{engine: loop, compiled: {asked}}}"]))
        for asked in ("false", "true")
    )
    require_close(compiled, plain)


@pytest.mark.parametrize("case", [CASES[0], *FLOWN.values()], ids=["sample_maneuver", *FLOWN])
def test_the_systems_of_the_diagram_are_compiled_alike(case: tuple[str, ...]) -> None:
    pytest.importorskip("numba")
    name, *overrides = case
    plain = simulate(load_scenario(name, [*overrides, "execution={engine: loop}"]))
    compiled = simulate(load_scenario(name, [*overrides, "execution={engine: diagram, compiled: true}"]))
    require_close(compiled, plain)
    assert compiled.summary["provenance"]["engine"].startswith("diagram, compiled by numba ")


@pytest.mark.parametrize(
    "case",
    [("orbiter_maneuver", "duration_s=6"), ("stuck_on_29", "plant.time_step=0", "duration_s=6")],
    ids=["the joint filter", "a continuous plant"],
)
def test_what_the_loop_has_otherwise_is_compiled_in_the_diagram(case: tuple[str, ...]) -> None:
    pytest.importorskip("numba")
    name, *overrides = case
    plain, compiled = (simulate(load_scenario(name, [*overrides, f"execution.compiled={it}"])) for it in (False, True))
    require_close(compiled, plain)


def test_a_copy_of_a_context_repeats_a_compiled_run() -> None:
    pytest.importorskip("numba")
    diagram = closed_loop.build(load_scenario(FAILING[0], [*FAILING[1:], "execution.compiled=true"]))
    simulator = Simulator(diagram)
    simulator.AdvanceTo(14.0)
    again = Simulator(diagram, simulator.get_context().Clone())
    ends = []
    for one in (simulator, again):
        one.AdvanceTo(16.0)
        ends.append([diagram.GetOutputPort(name).Eval(one.get_context()) for name in ("covariance", "body_state")])
    for first, second in zip(*ends, strict=True):
        np.testing.assert_array_equal(first, second)


def test_the_estimator_compiles_its_cycle_too() -> None:
    pytest.importorskip("numba")
    asked = load_scenario(FAILING[0], [*FAILING[1:], "execution={engine: loop, compiled: true}"])
    run = simulate(asked)
    steps = []
    dut = Estimator(asked.vehicle_data, asked)
    for row, time_s in enumerate(run.time_s):
        readings = {name: run[name][row] for name in ("acc1", "acc2", "acc3")}
        if row == 200:  # from its state as JSON has it
            state, dut = dut.state, Estimator(asked.vehicle_data, asked)
            dut.restore(state)
        steps.append(dut.step(time_s, run["gyro"][row], readings, run["command"][row]))
    np.testing.assert_array_equal([step.estimate for step in steps], run["estimate"])
    np.testing.assert_array_equal([step.standard_deviation for step in steps], run["standard_deviation"])
    np.testing.assert_array_equal([step.rotation_nis for step in steps], run["rotation_nis"][:, 0])
    np.testing.assert_array_equal([step.alarm for step in steps], run["alarm"][:, 0])
    np.testing.assert_array_equal(dut.covariance, run.covariance)
    (found,) = [step.detection for step in steps if step.detection is not None]
    assert (found.kind, found.jet) == ("jet", "R4R")
    assert steps[-1].removed.any()


def test_where_nothing_can_be_kept_it_is_said_and_nothing_is_left_beside_the_sources(tmp_path: Path) -> None:
    pytest.importorskip("numba")
    (tmp_path / "file").touch()
    code = (
        "from massprop_drake.maths import kernels; compiler = kernels.compiler(); assert compiler.folder is None; "
        "from massprop_drake.maths._holding import hold, _compiled; "
        "from numba.core.caching import NullCache; assert isinstance(hold._cache, NullCache); "
        "from massprop_drake.maths.estimation.joint.lagged_impulses import fire; "
        "assert isinstance(kernels.compiled(fire)._cache, NullCache)"
    )
    environ = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "file")}
    done = subprocess.run([sys.executable, "-c", code], env=environ, check=True, capture_output=True, text=True)
    (line,) = done.stderr.splitlines()
    assert line.startswith(f"compiled kernels cannot be kept in {tmp_path}")
    assert "(Not a directory)" in line
    assert "NUMBA_CACHE_DIR" in line


def test_the_first_compilation_is_said_once_and_kept_where_it_is_asked_for(tmp_path: Path) -> None:
    pytest.importorskip("numba")
    code = (
        "import numba, numpy as np; from massprop_drake.maths import attitude, kernels; kernels.compiler(); "
        "numba.njit(lambda x: x)(1.0); "  # of somebody else; numba then looks at its environment anew
        f"assert numba.config.CACHE_DIR in ('', {str(tmp_path)!r}); "
        "print(kernels.have_been_compiled()); turned = kernels.compiled(attitude.multiply); "
        "turned(np.eye(4)[0], np.eye(4)[1]); print(kernels.have_been_compiled())"
    )
    environ = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    for expected, lines in ((["False", "True"], 1), (["True", "True"], 0)):
        done = subprocess.run([sys.executable, "-c", code], env=environ, check=True, capture_output=True, text=True)
        assert done.stdout.split() == expected
        assert [str(tmp_path) in line for line in done.stderr.splitlines()] == [True] * lines


def test_damaged_compiled_code_is_compiled_anew(tmp_path: Path) -> None:
    """Cut off, emptied, overwritten, with a hole, or without the right to read: one line, and the same result."""
    pytest.importorskip("numba")
    code = (
        "import numpy as np; from massprop_drake.maths import attitude, kernels; "
        "print(kernels.compiled(attitude.multiply)(np.eye(4)[0], np.eye(4)[1]))"
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
        for damaged in (b"", content[:20], content[:-1], bytes(range(256)) * 8, hole):
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
    pytest.importorskip("numba")
    asked = [*FAILING[1:], "execution={engine: loop, compiled: true}"]
    simulate(load_scenario(FAILING[0], asked))
    code = (
        "from massprop_drake import load_scenario, simulate; from massprop_drake.maths import kernels; "
        f"run = simulate(load_scenario({FAILING[0]!r}, {asked!r})); "
        "assert run.summary['detections']; assert kernels.compiler().spent_s == 0.0, kernels.compiler().spent_s"
    )
    subprocess.run([sys.executable, "-W", "ignore", "-c", code], check=True)

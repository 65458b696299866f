"""What a run's readings contradict, in words, and the bound of each parameter."""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lsim

from massprop_drake import Run, load_scenario
from massprop_drake.results.batch_analysis import BatchAnalysis, analyze_run
from massprop_drake.results.consistency import Diagnosis, Tally, judge_consistency
from massprop_drake.results.detections import DetectionRecord
from massprop_drake.results.events import EventRecord
from massprop_drake.results.record_stretches import stretches
from massprop_drake.results.spool import Spool
from massprop_drake.results.summary import Summary

Array = NDArray[np.float64]
TOLD = ("estimation={filter: joint, start: zero}", "mass={}", "joint={thrust_uncertainty: 0, tank_fraction: 0}")
ROWS = 250  # of the sample maneuver where its first 20 s are enough
READ = ("command", "gyro", "acc1", "acc2", "acc3")


def looked(
    run: Run,
    *settings: str,
    rows: int | None = ROWS,
    found: tuple[DetectionRecord, ...] = (),
    events: tuple[EventRecord, ...] = (),
    **changed: Callable[[Array], Array],
) -> BatchAnalysis:
    """Looks back on the first rows of a run as the joint filter is told, with some signals changed."""
    signals = {name: np.array(run[name])[:rows] for name in READ}
    signals["gap"] = np.zeros((len(signals["gyro"]), 1))
    signals |= {name: change(signals[name]) for name, change in changed.items()}
    spool = Spool(index="time_s")
    spool.append({"time_s": np.array(run.time_s)[:rows], **signals})
    scenario = load_scenario("sample_maneuver", [*TOLD, *settings])
    return analyze_run(scenario, spool, run["estimate"][-1], found, events)


@pytest.fixture(scope="module")
def whole(sample_run: Run) -> BatchAnalysis:
    """The sample maneuver as it was read."""
    return looked(sample_run)


def test_a_gap_costs_what_is_lost_in_it(sample_run: Run, whole: BatchAnalysis) -> None:
    """And not the stretch that it is in; jets that were on in it are felt for a while, and that is no misfit."""
    firing = np.flatnonzero((sample_run["command"] != 0.0).any(axis=1))
    lost = np.isin(np.arange(ROWS), [firing[firing > 100][0], 200, 201])[:, None]
    exact = looked(sample_run, "joint.tank_fraction=0.01").bound
    gaps = {
        "gap": lambda rows: 1.0 * lost,
        "gyro": lambda readings: np.where(lost, np.nan, readings),
        "command": lambda commands: np.where(lost, np.nan, commands),
    }
    for bound, told in ((whole.bound, ()), (exact, ("joint.tank_fraction=0.01",))):
        found = looked(sample_run, *told, **gaps)
        assert found.diagnoses == ()
        assert (bound < 1.03 * found.bound).all()
        assert (found.bound < 1.5 * bound).all()


@pytest.mark.parametrize(("sensor", "last"), [("gyro", 101), ("acc1", 112)])
def test_readings_that_were_said_to_be_false_are_left_out(
    sample_run: Run, whole: BatchAnalysis, sensor: str, last: int
) -> None:
    """One of a gyro, whose rate coupling is taken with, too, and an axis of an accelerometer for a second."""
    wrong = np.zeros((ROWS, 3))
    wrong[100:last, 1] = 0.5
    lies = {sensor: lambda readings: readings + wrong}
    said = EventRecord(8.4, "false_reading", 7.92, sensor=sensor, axis="y")
    assert looked(sample_run, **lies).diagnoses
    found = looked(sample_run, events=(said,), **lies)
    assert found.diagnoses == ()
    assert (found.bound < 1.5 * whole.bound).all()


def test_what_jets_gave_in_a_gap_is_waited_for(sample_run: Run) -> None:
    """Thrust of 15 ms lingers for two intervals; of a record it is not known before it, of a simulation it is none."""
    scenario, size = load_scenario("orbiter_maneuver"), sample_run.time_s.size
    rows = {name: np.array(sample_run[name]) for name in READ}
    rows["command"][200] = np.nan
    gap = np.zeros((size, 1))
    gap[300] = 1.0

    def spans(**more: Array) -> list[tuple[int, int]]:
        spool = Spool(index="time_s")
        spool.append({"time_s": np.array(sample_run.time_s), **rows, **more})
        found = [(part.time_s[0], part.time_s[-1]) for part in stretches(scenario, spool)]
        return [(round(first / 0.08), round(last / 0.08)) for first, last in found]

    assert spans(gap=gap) == [(2, 200), (203, 299), (303, size - 1)]
    assert spans() == [(0, 200), (203, size - 1)]


REVERSED = "vehicle.jets[14].direction=[-0.985, 0, -0.174]"
DELAYED = "delay wrong: commands act 80 ms earlier than they are logged, one sample period"


def _noise(read: Array) -> Array:
    return np.random.default_rng(1).standard_normal(read.shape)


def _late(run: Run) -> Array:
    """Errors of readings whose stamps are some milliseconds off."""
    change = np.diff(run["rate"], axis=0, append=run["rate"][-1:]) / 0.08
    return np.abs(1e-3 * np.random.default_rng(2).standard_normal((change.shape[0], 1))) * change


@pytest.mark.parametrize(
    ("settings", "sensor", "change", "expected"),
    [
        ((), "gyro", lambda read, _: read * np.array([1.0, -1.0, 1.0]), "axis gyro y has the wrong sign"),
        ((), "acc2", lambda read, _: read * np.array([1.0, 1.0, -1.0]), "axis acc2 z has the wrong sign"),
        ((REVERSED,), "gyro", lambda read, _: read, "jet L1A pushes the other way: its direction is reversed"),
        ((), "gyro", lambda read, _: read + 3e-6 * _noise(read), "noise"),
        ((), "gyro", lambda read, _: read + 1e-6 * np.cumsum(_noise(read), axis=0), "drift"),
        ((), "gyro", lambda read, run: read + _late(run), "jitter"),
        ((), "command", lambda told, _: np.roll(told, 1, axis=0), DELAYED),
    ],
)
def test_what_is_wrong_with_readings_or_jets_is_named_alone(
    sample_run: Run, settings: tuple[str, ...], sensor: str, change: Callable[[Array, Run], Array], expected: str
) -> None:
    (found,) = looked(sample_run, *settings, rows=None, **{sensor: lambda read: change(read, sample_run)}).diagnoses
    assert expected in (found.kind, found.reason)


@pytest.mark.parametrize(("sensor", "axis", "drift", "rows"), [("gyro", 1, 2e-5, ROWS), ("acc2", 2, 0.0, None)])
def test_a_wrong_sign_is_named_first_whatever_drifts_or_was_declared(
    sample_run: Run, sensor: str, axis: int, drift: float, rows: int | None
) -> None:
    walk = np.cumsum(np.random.default_rng(1).normal(0.0, drift, (sample_run.time_s.size, 3))[:rows], axis=0)
    signs = np.where(np.arange(3) == axis, -1.0, 1.0)
    said = DetectionRecord(5.0, 5.0, "jet_on", 7, "L1A", "jet", 870.0, 1.0, 100.0, 2, jets=("L1A",))
    for found in ((), (said,)):
        first = looked(sample_run, rows=rows, found=found, **{sensor: lambda read: signs * (read + walk)}).diagnoses[0]
        assert first.reason == f"axis {sensor} {'xyz'[axis]} has the wrong sign"


def test_after_a_declared_failure_nothing_more_is_blamed(sample_run: Run) -> None:
    def lies_later(readings: Array) -> Array:
        return readings * np.where(np.arange(readings.shape[0]) < 150, 1.0, -1.0)[:, None]

    assert looked(sample_run, gyro=lies_later).diagnoses
    said = DetectionRecord(11.0, 11.2, "jet_on", 7, "L1A", "jet", 870.0, 1.0, 100.0, 2, jets=("L1A",))
    assert looked(sample_run, gyro=lies_later, found=(said,)).diagnoses == ()
    jump = said._replace(kind="mass_property_jump", cluster=None, jet=None, isolated_to=None)
    assert np.isnan(looked(sample_run, found=(jump,)).bound).all()


def test_a_diagnosis_makes_a_run_inconsistent_and_is_kept(sample_run: Run) -> None:
    said = Diagnosis("lag", "lag wrong", 100.0, 13.8)
    found = judge_consistency(Tally(), Tally(), np.full(10, np.nan), [""] * 10, [said])
    assert (found.verdict, found.reasons) == ("inconsistent", ["lag wrong"])
    content = sample_run.results.as_json()
    content["consistency"]["diagnoses"] = [said._asdict()]
    again = Summary.from_json(content)
    assert again.consistency.diagnoses == (said,)
    assert again.identifiability == sample_run.results.identifiability
    del content["consistency"]["diagnoses"]
    assert Summary.from_json(content).consistency.diagnoses == ()


def sloshing(run: Run, frequency_hz: float, share: float) -> Array:
    """Rates that a pendulum of a share of the mass adds, by its spring, driven by the force of the jets, rad/s."""
    vehicle, period_s = run.scenario.vehicle_data, run.scenario.vehicle_data.sample_period_s
    omega, damping, time_s = 2.0 * np.pi * frequency_hz, 0.02, period_s * np.arange(ROWS)
    swing = [[0.0, 1.0], [-(omega**2), -2.0 * damping * omega]], [[0.0], [-1.0]], [[0.0, 1.0]], [[0.0]]
    pulls = np.array(run["force"])[:ROWS].T / vehicle.nominal.mass
    speeds = np.column_stack([lsim(swing, pull, time_s, interp=False)[1] for pull in pulls])
    arm = np.array([20.0, 3.0, -4.0])  # ft, from the center of mass
    momentum = share * vehicle.nominal.mass * speeds
    return -np.cross(arm, momentum) @ np.linalg.inv(vehicle.nominal.inertia)


@pytest.mark.parametrize("frequency_hz", [0.15, 0.5])
def test_slosh_is_told_with_its_frequency(sample_run: Run, frequency_hz: float) -> None:
    added = sloshing(sample_run, frequency_hz, 0.02)
    (found,) = looked(sample_run, gyro=lambda rates: rates + added).diagnoses
    assert found.kind == "oscillation"
    words = re.fullmatch(
        r"something inside moves at ([\d.]+) Hz, such as slosh or a panel; "
        r"joint.rate_walk=(\S+) and joint.velocity_walk=(\S+) would cover it",
        found.reason,
    )
    assert words is not None
    assert float(words[1]) == pytest.approx(frequency_hz, rel=0.05)
    # the walk is at least what the readings are moved by in a second, per root of a second
    assert float(words[2]) > 0.5 * np.abs(added[12:] - added[:-12]).std()
    walks = (f"joint.rate_walk={words[2]}", f"joint.velocity_walk={words[3]}")
    assert looked(sample_run, *walks, gyro=lambda rates: rates + added).diagnoses == ()
    assert looked(sample_run, *walks, gyro=lambda rates: rates + 5.0 * added).diagnoses


def test_a_walk_has_no_frequency(sample_run: Run) -> None:
    walk = np.cumsum(np.random.default_rng(1).normal(0.0, 2e-5, (ROWS, 3)), axis=0)
    assert "oscillation" not in {one.kind for one in looked(sample_run, gyro=lambda rates: rates + walk).diagnoses}

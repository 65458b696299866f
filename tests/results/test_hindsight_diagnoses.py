"""What a run's readings contradict, in words, and the bound of each parameter."""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from massprop_drake import Run, load_scenario, simulate
from massprop_drake.maths.estimation import hindsight
from massprop_drake.results.consistency import Diagnosis, Tally, judged
from massprop_drake.results.detections import DetectionRecord
from massprop_drake.results.events import EventRecord
from massprop_drake.results.shown_in_hindsight import Hindsight, looked_back, model, stretches
from massprop_drake.results.spool import Spool
from massprop_drake.results.summary import Summary

Array = NDArray[np.float64]
TOLD = ("estimation={filter: joint, start: zero}", "mass={}", "joint={thrust_uncertainty: 0, tank_fraction: 0}")


def looked(
    run: Run,
    *settings: str,
    found: tuple[DetectionRecord, ...] = (),
    events: tuple[EventRecord, ...] = (),
    **changed: Callable[[Array], Array],
) -> Hindsight:
    """Looks back on a run as the joint filter is told, with some signals changed."""
    rows = {name: np.array(run[name]) for name in ("command", "gyro", "acc1", "acc2", "acc3")}
    rows["gap"] = np.zeros((run.time_s.size, 1))
    rows |= {name: change(rows[name]) for name, change in changed.items()}
    spool = Spool(index="time_s")
    spool.append({"time_s": np.array(run.time_s), **rows})
    scenario = load_scenario("sample_maneuver", [*TOLD, *settings])
    return looked_back(scenario, spool, run["estimate"][-1], found, events)


def test_a_healthy_flight_has_none_and_the_bound_is_below_the_sigma(sample_run: Run) -> None:
    assert sample_run.results.consistency.diagnoses == ()
    for one, entry in zip(sample_run.results.parameters, sample_run.results.identifiability, strict=True):
        assert entry.bound is not None
        assert 0.01 < entry.bound / one.standard_deviation < 0.2  # the thesis's filters leave out most samples


def test_a_gap_costs_what_is_lost_in_it(sample_run: Run) -> None:
    """And not the stretch that it is in; jets that were on in it are felt for a while, and that is no misfit."""
    firing = np.flatnonzero((sample_run["command"] != 0.0).any(axis=1))
    lost = np.isin(np.arange(sample_run.time_s.size), [firing[firing > 100][0], 300, 301])[:, None]
    whole, exact = looked(sample_run), looked(sample_run, "joint.tank_fraction=0.01").bound
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


def test_readings_that_were_said_to_be_false_are_left_out(sample_run: Run) -> None:
    """One of a gyro, whose rate coupling is taken with, too, and an axis of an accelerometer for a second."""

    def lying(first: int, last: int, axis: int) -> Callable[[Array], Array]:
        def changed(readings: Array) -> Array:
            wrong = readings.copy()
            wrong[first:last, axis] += 0.5
            return wrong

        return changed

    for sensor, last in (("gyro", 401), ("acc1", 412)):
        lies = {sensor: lying(400, last, 1)}
        said = EventRecord(32.4, "false_reading", 31.92, sensor=sensor, axis="y")
        assert looked(sample_run, **lies).diagnoses
        found = looked(sample_run, events=(said,), **lies)
        assert found.diagnoses == ()
        assert (found.bound < 1.5 * looked(sample_run).bound).all()


def test_what_jets_gave_in_a_gap_is_waited_for(sample_run: Run) -> None:
    """Thrust of 15 ms lingers for two intervals; of a record it is not known before it, of a simulation it is none."""
    scenario, size = load_scenario("orbiter_maneuver"), sample_run.time_s.size
    rows = {name: np.array(sample_run[name]) for name in ("command", "gyro", "acc1", "acc2", "acc3")}
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


def test_what_a_jet_has_just_given_is_known_where_a_stretch_is_cut() -> None:
    """A vehicle that turns fast is looked at in short pieces, and some begin before thrust has built up or died out."""
    together = (
        ("M1", "M3"),
        ("M2", "M4"),
        ("M2", "M4"),
        ("M1", "M3"),
        ("M1", "M2"),
        ("M3", "M4"),
        ("M3", "M4"),
        ("M1", "M2"),
    )
    schedule = [
        f"{{jet: {jet}, start_s: {begin_s:.1f}, end_s: {begin_s + 0.3:.1f}}}"
        for number, jets in enumerate(2 * together)
        for jet in jets
        for begin_s in (0.5 + 0.7 * number,)
    ]
    settings = ("vehicle=servicer", "duration_s=12", "plant.initial_rate=[0.5, 0.1, -0.1]", "detector.kind=off")
    told = ("estimation={filter: joint, start: nominal}", f"jet_schedule=[{', '.join(schedule)}]")
    run = simulate(load_scenario("jet_pulses", [*settings, *told]))
    assert run.results.consistency.diagnoses == ()


def test_a_wrong_sign_is_named(sample_run: Run) -> None:
    back = looked(sample_run, gyro=lambda readings: readings * np.array([1.0, -1.0, 1.0]))
    assert [one.reason for one in back.diagnoses] == ["axis gyro y has the wrong sign"]
    back = looked(sample_run, acc2=lambda readings: readings * np.array([1.0, 1.0, -1.0]))
    assert [one.reason for one in back.diagnoses] == ["axis acc2 z has the wrong sign"]
    back = looked(sample_run, "vehicle.jets[14].direction=[-0.985, 0, -0.174]")
    assert [one.reason for one in back.diagnoses] == ["jet L1A pushes the other way: its direction is reversed"]


@pytest.mark.parametrize(
    ("kind", "noise"),
    [
        ("noise", lambda rng, rows: 3e-6 * rng.standard_normal((rows, 3))),
        ("drift", lambda rng, rows: 1e-6 * np.cumsum(rng.standard_normal((rows, 3)), axis=0)),
    ],
)
def test_readings_that_are_worse_than_stated(sample_run: Run, kind: str, noise: Callable[..., Array]) -> None:
    back = looked(sample_run, gyro=lambda readings: readings + noise(np.random.default_rng(1), readings.shape[0]))
    assert [one.kind for one in back.diagnoses] == [kind]


def test_jitter_is_told_from_noise(sample_run: Run) -> None:
    rng = np.random.default_rng(2)
    change = np.diff(sample_run["rate"], axis=0, append=sample_run["rate"][-1:]) / 0.08
    late = np.abs(1e-3 * rng.standard_normal((change.shape[0], 1)))
    back = looked(sample_run, gyro=lambda readings: readings + late * change)
    assert [one.kind for one in back.diagnoses] == ["jitter"]


def test_after_a_declared_failure_nothing_more_is_blamed(sample_run: Run) -> None:
    def lies_later(readings: Array) -> Array:
        return readings * np.where(np.arange(readings.shape[0]) < 400, 1.0, -1.0)[:, None]

    assert looked(sample_run, gyro=lies_later).diagnoses
    said = DetectionRecord(31.0, 31.2, "jet_on", 7, "L1A", "jet", 870.0, 1.0, 100.0, 2, jets=("L1A",))
    assert looked(sample_run, gyro=lies_later, found=(said,)).diagnoses == ()
    jump = said._replace(kind="mass_property_jump", cluster=None, jet=None, isolated_to=None)
    assert np.isnan(looked(sample_run, found=(jump,)).bound).all()


def test_a_diagnosis_makes_a_run_inconsistent_and_is_kept(sample_run: Run) -> None:
    said = Diagnosis("lag", "lag wrong", 100.0, 13.8)
    found = judged(Tally(), Tally(), np.full(10, np.nan), [""] * 10, [said])
    assert (found.verdict, found.reasons) == ("inconsistent", ["lag wrong"])
    content = sample_run.results.as_json()
    content["consistency"]["diagnoses"] = [said._asdict()]
    again = Summary.from_json(content)
    assert again.consistency.diagnoses == (said,)
    assert again.identifiability == sample_run.results.identifiability
    del content["consistency"]["diagnoses"]
    assert Summary.from_json(content).consistency.diagnoses == ()


# ------------------------------------------------------------------------------- what moves inside


def sloshing(run: Run, frequency_hz: float, share: float) -> Array:
    """Rates that a pendulum of a share of the mass adds, by its spring, driven by the force of the jets, rad/s."""
    vehicle, period_s = run.scenario.vehicle_data, run.scenario.vehicle_data.sample_period_s
    omega, damping, finer = 2.0 * np.pi * frequency_hz, 0.02, 40
    moved, speed, speeds = np.zeros(3), np.zeros(3), []
    for force in np.array(run["force"]):
        speeds.append(speed)
        for _ in range(finer):
            pull = force / vehicle.nominal.mass + 2.0 * damping * omega * speed + omega**2 * moved
            speed = speed - pull * period_s / finer
            moved = moved + speed * period_s / finer
    arm = np.array([20.0, 3.0, -4.0])  # ft, from the center of mass
    momentum = share * vehicle.nominal.mass * np.array(speeds)
    return -np.cross(arm, momentum) @ np.linalg.inv(vehicle.nominal.inertia)


@pytest.mark.parametrize("frequency_hz", [0.06, 0.5])
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
    walk = np.cumsum(np.random.default_rng(1).normal(0.0, 2e-5, sample_run["gyro"].shape), axis=0)
    found = looked(sample_run, gyro=lambda rates: rates + walk).diagnoses
    assert found
    assert "oscillation" not in {one.kind for one in found}


def test_passes_settle_though_each_would_choose_other_readings() -> None:
    """A reading counts once it has moved by a quantum: of 161, four lie at that, and each pass saw it otherwise."""
    run = simulate(load_scenario("jet_pulses", ["duration_s=6", "execution.engine=loop"]), look_back=False)
    made = model(run.scenario)
    assert hindsight.fitted(list(stretches(run.scenario, run.signals)), made.prior, made).settled

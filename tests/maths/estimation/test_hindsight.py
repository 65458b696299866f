"""A flight in hindsight, against the recursions of the joint estimator: they share only the impulses with it."""

from __future__ import annotations

import re
from functools import cache
from itertools import pairwise
from typing import Any

import bound_probe as bound
import numpy as np
import pytest
from joint_probe import INVERSE, PERIOD, POSITIONS, TRUTH, read_as, small_params
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.stats import chi2

from massprop_drake.maths.estimation.joint.disturbance_states import DisturbanceParams
from massprop_drake.maths.estimation.joint.forcing import compute_forces
from massprop_drake.maths.estimation.joint.joint_sample import JointSample
from massprop_drake.maths.estimation.joint.layout import make_places
from massprop_drake.maths.estimation.joint.measurement import predict_outputs
from massprop_drake.maths.estimation.joint.prediction import predict
from massprop_drake.maths.estimation.joint.process_noise import propellant_drift
from massprop_drake.maths.estimation.joint.ticks import timing_on_ticks
from massprop_drake.maths.estimation.joint.wheels import NO_WHEELS, WheelParams
from massprop_drake.maths.estimation.offline.flight_bound import cramer_rao_deviation
from massprop_drake.maths.estimation.offline.flight_model import Columns, FlightModel, Stretch, columns
from massprop_drake.maths.estimation.offline.normal_equations import accumulating_noise, stretch_equations
from massprop_drake.maths.estimation.offline.record_kernels import select_informative as informative
from massprop_drake.maths.estimation.offline.regression import FlightFit, fit_flight
from massprop_drake.maths.estimation.offline.regression import score_test as score_of
from massprop_drake.maths.estimation.offline.thrust_course import is_off_ticks
from massprop_drake.maths.vehicle.mounting import mounting_errors
from massprop_drake.results.diagnoses import diagnose_readings
from massprop_drake.results.regression_model import Names

Array = NDArray[np.float64]
ROWS = 100
FLOW = 1e-9  # of a jet, kg/s
Y = np.array([0.0, 1.0, 0.0])
PARAMS = small_params(
    places=make_places((6, 1, 1), 2, (False, False), True, 0),
    flows=np.zeros(6),
    second_order=False,
    accelerometer_positions=np.array([[0.3, 0.1, -0.2]]),
    variances=np.array([1e-14] * 3 + [1e-12] * 3),
    quanta=np.zeros(6),
    prior_sigma=np.append(np.ones(6 + 2), 0.0),
)
PARAMS = PARAMS._replace(wrenches=0.01 * PARAMS.wrenches)  # it turns slowly
NUMBER = r"(?<![a-z\d])(\d[\d.e-]*)"
NAMES = Names(("1", "2", "3", "4", "5", "6"), ("1", "2"), ("gyro",), ("acc1",), "torque", "acceleration")


@cache
def flight(seed: int) -> Stretch:
    """A flight of the small vehicle as it is stated."""
    return flown(seed)[0]


@cache
def bounded(tank_fraction: float) -> tuple[Stretch, Array]:
    """The flight of one seed, and the least 1-sigma of the recursion."""
    return flown(1, tank_fraction=tank_fraction, is_bounded=True)


def flown(
    seed: int,  # of commands and noise
    factors: Array | float = 1.0,  # true thrusts over those stated
    torque: Array | float = 0.0,  # that nobody commands
    momentum: Array | float = 0.0,  # of wheels that turn steadily
    lag: float = 0.0,  # error of the time constants, in units of their sigma
    late: Array | float = 0.0,  # of each row, at which commands switch then, s
    tank_fraction: float = 0.0,  # by which what is used moves inertia and center of mass
    shift: Array | float = 0.0,  # of elements 0 to 8 from the beginning to the end; gyros alone are then right
    rate: Array | float = 0.0,  # at the beginning
    strength: float = 1.0,  # of all jets as stated, over nominal
    is_bounded: bool = False,  # whether the recursion follows it
) -> tuple[Stretch, Array]:
    """A flight of the small vehicle, and the least 1-sigma of the recursion; jets at random, next to no mass used."""
    time_s = PERIOD * np.arange(ROWS + 1) + late
    rng = np.random.default_rng(seed)
    pulled = strength * np.asarray(factors) * np.ones(6)
    using = PARAMS._replace(flows=np.full(6, FLOW), tank_fraction=tank_fraction)
    actual, places = PARAMS._replace(wrenches=PARAMS.wrenches * pulled[:, None]), PARAMS.places
    errors = np.zeros(places.size - places.thrust)
    errors[places.lag - places.thrust : places.lag - places.thrust + 2] = lag
    outside = np.append(np.asarray(torque) * PERIOD * np.ones(3), np.zeros(3))
    commands = np.repeat(rng.uniform(size=(ROWS // 4, 6)) < 0.3, 4, axis=0).astype(float)
    noise = rng.standard_normal((ROWS + 1, 2, 3)) * np.sqrt(PARAMS.variances).reshape(2, 3)
    unread = np.zeros((1, 3))
    sample = JointSample(0.0, np.array([PERIOD]), commands[:1], np.zeros(6), unread, unread, timing_on_ticks())
    state = bound.start(sample, bound.true_mean(TRUTH, rate * np.ones(3), errors, PARAMS), PARAMS)
    least, readings = state, np.zeros((ROWS + 1, 2, 3))
    readings[0, 0] = rate
    used = np.concatenate(([0.0], np.cumsum(commands.sum(axis=1) * FLOW * PERIOD)))
    for k in range(ROWS):
        still = 1.0 - 0.5 * (used[k] + used[k + 1]) / used[-1]
        moved = np.append(TRUTH[:9] - still * np.asarray(shift), state.mean[9:])
        state = state._replace(mean=moved if np.any(shift) else state.mean)
        sample = sample._replace(durations_s=np.diff(time_s[k : k + 2]))
        ahead, before = state.mean[10:13], np.full(3, np.inf)
        while np.abs(ahead - before).max() > 1e-12:  # the coupling takes the rate at the end
            before, given = ahead, outside.copy()
            given[:3] += np.cross(momentum * np.ones(3), 0.5 * (state.mean[10:13] + ahead)) * PERIOD
            acting = compute_forces(state, sample._replace(commands=commands[k : k + 1], outside=given), actual)
            prediction = predict(state, acting, read_as(ahead, actual), actual)
            ahead = prediction.mean[10:13]
        spin = state.spin + prediction.spin
        shown, _ = predict_outputs(prediction.mean, state.reference, spin, actual)
        state = state._replace(mean=prediction.mean, level=acting.firing.level, slope=acting.firing.slope, spin=spin)
        readings[k + 1] = shown.reshape(2, 3)
        if is_bounded:
            told = sample._replace(commands=commands[k : k + 1], rates=ahead.reshape(1, 3))
            truth = bound.true_mean(TRUTH, ahead, errors, PARAMS)
            least = bound.step(least, told, truth, np.ones(6, dtype=np.bool_), using)
    commands = np.vstack((commands, np.zeros(6)))
    stretch = Stretch(time_s, readings + noise, commands, np.zeros((1, 6)), np.zeros((ROWS + 1, 6)), -used)
    stretch.readings.flags.writeable = False  # a flight serves several tests
    return stretch, bound.deviation(least)


def read_again(stretch: Stretch, place: Any, readings: Any) -> Stretch:
    """The stretch with other readings at some places."""
    changed = stretch.readings.copy()
    changed[place] = readings
    return stretch._replace(readings=changed)


WHEELS = WheelParams(
    np.array([[0.6, 0.0, 0.8], [0.0, 1.0, 0.0]]), np.array([0.01, 0.02]), 0.0, np.full(2, 1e-3), np.full(2, 1e3)
)


def known(thrust: float = 0.01, wheels: WheelParams = NO_WHEELS, strength: float = 1.0) -> tuple[FlightModel, Columns]:
    """What is stated of the small vehicle."""
    prior = np.append(TRUTH, np.zeros(6 + 2 + 7 * 3 + wheels.inertias.size + 9))
    model = FlightModel(
        PERIOD,
        strength * PARAMS.wrenches,
        PARAMS.flows,
        PARAMS.time_constants_s,
        PARAMS.kinds,
        PARAMS.accelerometer_positions,
        variances=PARAMS.variances[[0, 3]],
        quanta=np.zeros(2),
        gyros=1,
        prior=prior,
        sigma=np.zeros_like(prior),
        wheels=wheels,
    )
    places = columns(model)
    model.sigma[places.properties] = np.diag(PARAMS.start_root)
    model.sigma[places.thrust] = thrust
    model.sigma[places.lag] = [0.003, 0.006]
    model.sigma[places.wheel] = 0.01
    return model, places


def test_a_torque_from_outside_is_as_good_as_unknown_to_accelerometers() -> None:
    """They feel ten times what is stated, by their arm, and the whole of a force; gyros what is stated."""
    model, _ = known()
    model = model._replace(positions=TRUTH[6:9] + np.array([[0.0, 0.0, 2.0]]))  # above the center of mass
    torque, force = DisturbanceParams(np.eye(6)[:, 1:2], 5.0), DisturbanceParams(np.eye(6)[:, 3:4], 5.0)
    for disturbance, arm in ((torque, 20.0), (force, 1.0)):
        noise = accumulating_noise(1, 0, model.prior, model._replace(disturbance=disturbance))
        assert noise.acting * model.variances[1] == pytest.approx(arm**2)
    assert accumulating_noise(0, 1, model.prior, model._replace(disturbance=torque)).acting == 1.0 / model.variances[0]


def fit_of(stretch: Stretch, model: FlightModel) -> FlightFit:
    """From the start that is stated."""
    fit = fit_flight([stretch], model.prior, model)
    assert fit.settled
    return fit


def least_of(stretches: tuple[Stretch, ...], tank_fraction: float = 0.0) -> Array:
    """The least 1-sigma in hindsight, at the truth."""
    model, _ = known()
    drift = propellant_drift(TRUTH, 1.0, tank_fraction, PARAMS.arm)
    return cramer_rao_deviation(stretches, model.prior, np.diag(model.sigma[:10] ** 2), drift, model)


@pytest.mark.parametrize(("tank_fraction", "times"), [(0.0, 1.0), (3.0, 1.15), (100.0, 5.0)])
def test_the_bound_of_what_drifts_is_that_of_the_recursion(tank_fraction: float, times: float) -> None:
    """What is used meanwhile is forgotten as it comes: neither before all that the flight shows, nor after it."""
    (_, exact), (stretch, least) = bounded(0.0), bounded(tank_fraction)
    np.testing.assert_allclose(least_of((stretch,), tank_fraction), least, rtol=0.03)
    assert (least[6:9] >= times * exact[6:9]).all()


def cut(stretch: Stretch, first: int, last: int = ROWS) -> Stretch:
    """Rows of a stretch, both ends included, after the first."""
    own = ("time_s", "readings", "commands", "outside", "used_after")
    rows = {name: getattr(stretch, name)[first : last + 1] for name in own}
    return Stretch(before=stretch.commands[first - 1 : first], **rows)


def test_what_is_used_between_pieces_drifts_as_well() -> None:
    stretch, drift = flight(1), propellant_drift(TRUTH, 1.0, 10.0, PARAMS.arm)
    one, last = cut(stretch, 1, 40), cut(stretch, 97)
    idle = last._replace(commands=np.zeros_like(last.commands), before=np.zeros((1, 6)))
    alone, both = least_of((one,), 10.0), least_of((one, idle), 10.0)
    used = one.used_after[-1] - last.used_after[-1]
    known = used * drift > 0.01 * alone**2  # of others the last rows say as much
    assert known[6:9].all()
    np.testing.assert_allclose(both[known] ** 2, (alone**2 + used * drift)[known], rtol=0.02)


def test_what_is_used_before_a_sensor_reads_does_not_move_what_it_reads_first() -> None:
    stretch = flight(1)
    used_after = np.maximum(stretch.used_after, stretch.used_after[40])  # nothing from then on
    blind = read_again(stretch._replace(used_after=used_after), np.r_[:40, 60 : ROWS + 1], np.nan)
    drift = propellant_drift(TRUTH, 1.0, 300.0, PARAMS.arm)
    (model, _), later = known(), cut(blind, 40)
    start = np.diag(model.sigma[:10] ** 2 - drift * used_after[40])
    expected = cramer_rao_deviation([later], model.prior, start, drift, model)
    np.testing.assert_allclose(least_of((blind,), 300.0), expected, rtol=5e-3)


def jittered(stretch: Stretch, seed: int) -> Stretch:
    """The flight with readings a few thousandths of a period off their ticks, and stamped as they were taken."""
    late = 3e-4 * np.random.default_rng(seed).standard_normal(ROWS + 1)
    levels = np.zeros((ROWS + 1, 6))
    for k, told in enumerate(stretch.commands[:-1]):
        levels[k + 1] = told + (levels[k] - told) * np.exp(-PERIOD / PARAMS.time_constants_s)
    wrench = levels @ PARAMS.wrenches
    center, arm = TRUTH[6:9], PARAMS.accelerometer_positions[0] - TRUTH[6:9]
    turns = (wrench[:, :3] - np.cross(center, wrench[:, 3:])) @ INVERSE
    pushes = TRUTH[9] * wrench[:, 3:] + np.cross(turns, arm)
    moved = stretch.readings + late[:, None, None] * np.stack((turns, pushes), axis=1)
    return stretch._replace(time_s=stretch.time_s + late, readings=moved)


def test_ticks_that_a_line_through_the_stamps_does_not_know_are_no_misfit() -> None:
    """Its errors, a tenth of a stamp's own, are those of all rows of a stretch at once."""
    for seed in (2, 6):
        assert fit_of(jittered(flight(seed), seed), known()[0]).normal.per_reading < 1.1


def test_commands_that_switch_at_the_stamps_are_told_from_regular_ticks() -> None:
    late = 3e-4 * np.random.default_rng(5).standard_normal(ROWS + 1)
    (model, _), (stretch, _) = known(), flown(1, late=late)
    stamps = model._replace(at_stamps=True)
    shifted = jittered(flight(1), 5)
    assert fit_of(stretch, stamps).normal.per_reading < 1.1
    assert fit_of(stretch, model).normal.per_reading > 2.0
    assert is_off_ticks(shifted, model)
    assert not is_off_ticks(flight(1), model)
    assert fit_flight([shifted], model.prior, stamps).normal.per_reading > 2.0


def test_a_flight_that_is_as_stated_passes_every_test() -> None:
    model, places = known()
    ratios, statistics = [], []
    for seed in range(4):
        rng = np.random.default_rng(100 + seed)
        fit = fit_of(flown(seed, 1.0 + 0.01 * rng.standard_normal(6), lag=rng.standard_normal())[0], model)
        ratios.append(fit.normal.per_reading)
        for part, stated in ((places.torque, 0.0), (places.drag, 0.0), (places.thrust, 0.01)):
            score = score_of(fit, np.arange(fit.at.size)[part], model, stated, 0.01)
            statistics.append(chi2.sf(score.statistic, score.degrees) if score.degrees else 0.5)
    assert np.mean(ratios) == pytest.approx(0.95, abs=0.04)  # of 600 readings some 20 go into the fit
    assert min(statistics) > 1e-3
    assert 0.3 < np.mean(statistics) < 0.7


@pytest.mark.parametrize(
    ("faulty", "words"),
    [
        ({"lag": -5.0}, "lag wrong: 1 jets build up with 0 ms, told 15 ms; 2 jets build up with 0 ms, told 30 ms"),
        ({"lag": 10.0}, "lag wrong: 1 jets build up with 45 ms, told 15 ms; 2 jets build up with 90 ms, told 30 ms"),
        ({"momentum": 1e-2 * Y}, "wheels that turn: an angular momentum of 0.01 torque-s, untold"),
        ({"torque": 2e-5 * Y}, "a torque that nobody commands: 2e-05 torque"),
    ],
)
def test_what_is_wrong_is_named(faulty: dict[str, Any], words: str) -> None:
    """Tests lags of nothing or three times the stated one, and wheels: no drag is named, and no jets."""
    model, _ = known(thrust=0.0)
    found, _ = diagnose_readings([flown(3, **faulty)[0]], model.prior[:10], model, NAMES)
    told, said = re.split(NUMBER, words), re.split(NUMBER, found[0].reason)
    assert said[::2][: len(told[::2])] == told[::2]
    for one, other in zip(map(float, told[1::2]), map(float, said[1::2]), strict=False):
        assert other == pytest.approx(one, rel=0.1, abs=0.5)


def test_commands_a_row_off_are_named_and_one_row_that_is_off_is_no_delay() -> None:
    model, _ = known(thrust=0.0)
    stretch = flight(3)
    for rows, words in ((-1, "later"), (1, "earlier")):
        moved = stretch._replace(commands=np.roll(stretch.commands, rows, axis=0))
        (first, *_), _ = diagnose_readings([moved], model.prior[:10], model, NAMES)
        assert first.reason.startswith(f"delay wrong: commands act 100 ms {words} than they are logged")
    found, _ = diagnose_readings([read_again(stretch, (-1, 0), 0.01)], model.prior[:10], model, NAMES)
    assert found
    assert "delay" not in {one.kind for one in found}


def test_the_score_is_the_slope_of_the_misfit() -> None:
    """Of gyros; of accelerometers what turning shows is taken as it is."""
    stretch, (model, places) = read_again(flight(3), np.s_[:, 1], np.nan), known()
    at = model.prior + 0.01 * model.sigma
    at[places.thrust], at[places.gyro_gain], at[places.gyro_bias] = 0.01 * np.arange(6), 1e-3, 1e-4
    at[places.torque], at[places.drag], at[places.momentum], at[places.acceleration_bias] = 1e-6, 1e-3, 2e-3, 1e-3
    steps = np.full(at.size, 1e-5)
    steps[:10] = 1e-4 * model.sigma[:10]
    found = stretch_equations(stretch, at, model)
    for place in range(at.size):
        scale = np.sqrt(found.information[place, place] * found.misfit)
        slope = misfit_slope(stretch, at, model, place, steps[place])
        assert slope == pytest.approx(found.score[place], abs=2e-6 * scale)


def test_what_propellant_shifts_steadily_is_no_fault_where_it_may_do_so() -> None:
    """The last values are found, and nothing is left; without such a shift a thousand times the noise is."""
    (stretch, _), (model, places) = flown(7, shift=0.02 * TRUTH[:9]), known()
    used = -stretch.used_after[-1]
    stretch = read_again(stretch._replace(used_after=stretch.used_after + used), np.s_[:, 1], np.nan)
    assert fit_flight([stretch], model.prior, model).normal.per_reading > 10.0
    model.sigma[places.shift] = 0.03 * np.abs(TRUTH[:9]) / used
    fit = fit_flight([stretch], model.prior, model)
    assert fit.settled
    assert fit.normal.per_reading < 1.2
    np.testing.assert_allclose(fit.at[places.shift][:3] * used, -0.02 * TRUTH[:3], rtol=0.1)


def test_a_shift_by_what_will_be_used_only_after_all_rows_is_another_vehicle() -> None:
    stretch, (model, places) = flight(1), known()
    model.sigma[places.shift] = 1.0
    later = 0.7
    found = stretch_equations(stretch._replace(used_after=np.full(ROWS + 1, later)), model.prior, model)
    scale = found.information[:9]
    np.testing.assert_allclose(found.information[places.shift], later * scale, atol=1e-9 * np.abs(scale).max())
    np.testing.assert_allclose(found.score[places.shift], later * found.score[:9], rtol=1e-9)


def test_rates_that_are_missing_while_jets_fire_lie_on_no_straight_line() -> None:
    """One cell in ten, of gyros that read far finer than a firing changes the rate: coupling is no torque then."""
    (stretch, _), (model, _) = flown(7, strength=10.0), known(strength=10.0)
    missing = np.random.default_rng(7).random((ROWS + 1, 3)) < 0.1
    stretch = read_again(stretch, np.s_[:, 0], np.where(missing, np.nan, stretch.readings[:, 0]))
    fit = fit_flight([stretch], model.prior, model)
    assert fit.normal.per_reading < 1.2
    once = stretch_equations(stretch, model.prior, model)  # at the truth, before any rate is followed
    assert once.misfit < 1.2 * once.readings
    assert (fit.normal.by_package[:, 0] < 1.2 * fit.normal.by_package[:, 1]).all()


def test_a_reading_counts_once_it_has_moved() -> None:
    expected = np.array([0.0, 0.3, 0.6, 1.0, 1.4, 2.1, 2.1])
    read = np.array([0.0, 0.0, 1.0, 1.0, np.nan, 2.0, 5.0])
    assert informative(expected, read, 1.0).tolist() == [0, 3, 5, 6]
    assert informative(expected, read, 0.0).tolist() == [0, 1, 2, 3, 5, 6]
    assert informative(expected, np.full(7, np.nan), 1.0).size == 0


def test_passes_that_go_astray_are_not_followed() -> None:
    """An axis that says for a while what no body does, from where passes go farther and farther."""
    model, _ = known()
    told = flight(1)
    told = read_again(told, np.s_[40:60, 0, 0], told.readings[40:60, 0, 0] + 30.0)
    with np.errstate(all="ignore"):
        found, fit = diagnose_readings([told], model.prior[:10], model, NAMES)
    assert not fit.settled
    assert fit.normal.misfit <= stretch_equations(told, model.prior, model).misfit
    assert fit.normal.misfit == stretch_equations(told, fit.at, model).misfit
    assert [one.kind for one in found] == ["drift"]


def test_nobody_is_blamed_by_what_is_no_number() -> None:
    model, told = known()[0], flight(3)
    with np.errstate(all="ignore"):
        found, fit = diagnose_readings([told._replace(readings=told.readings * 1e200)], model.prior[:10], model, NAMES)
    assert not fit.normal.is_finite
    assert found == []


@pytest.mark.parametrize("followed", [False, True])
def test_slopes_are_right_however_fast_the_vehicle_turns(followed: bool) -> None:
    """Where coupling is followed the rate that a body begins with is found besides; else any motion will do."""
    model, places = known()
    stretch, at, turn = flight(1), model.prior.copy(), np.array([0.3, -0.2, 0.4])
    at[places.lag] = 2e-4, -3e-4
    if followed:
        at[places.gyro_bias], at[places.torque], at[places.drag] = (1e-5, -2e-5, 5e-6), 1e-6, 1e-5
        stretch, model = flown(2, rate=turn)[0], model._replace(followed=True)
    else:
        at[places.gyro_bias], at[places.torque], at[places.drag] = (1e-3, -2e-3, 5e-4), 1e-4, 1e-3
        stretch = read_again(stretch, np.s_[:, 0], stretch.readings[:, 0] + turn)
    require_slopes(stretch, at, model, 2e-4 if followed else 1e-6)


def turned_by_wheels(speeds: Array, errors: Array) -> Array:
    """Rates at the rows of a vehicle that wheels alone turn, whose inertias are so much off, shape (m, 3)."""
    inertia, axes = np.linalg.inv(INVERSE), (WHEELS.inertias * (1.0 + errors))[:, None] * WHEELS.axes
    rates = np.zeros((speeds.shape[0], 3))
    rates[0] = 0.05, -0.03, 0.04
    for row, (before, after) in enumerate(pairwise(speeds)):
        change = (after - before) / PERIOD

        def flow(time_s: float, rate: Array, before: Array = before, change: Array = change) -> Array:
            momentum = inertia @ rate + (before + change * time_s) @ axes
            return np.asarray(-INVERSE @ (change @ axes + np.cross(rate, momentum)))

        rates[row + 1] = solve_ivp(flow, (0.0, PERIOD), rates[row], rtol=1e-10, atol=1e-14).y[:, -1]
    return rates


def test_wheels_turn_the_vehicle_as_they_are_read() -> None:
    """Errors of their inertias are found, and slopes of the misfit are those of differences."""
    (model, places), steps = known(wheels=WHEELS), np.arange(ROWS + 1)
    speeds = np.column_stack((40.0 + 0.1 * steps, 30.0 * np.sin(0.1 * steps)))
    errors, still, readings = np.array([0.01, -0.02]), np.zeros((ROWS + 1, 6)), np.full((ROWS + 1, 2, 3), np.nan)
    noise = 1e-7 * np.random.default_rng(1).standard_normal((ROWS + 1, 3))
    readings[:, 0] = turned_by_wheels(speeds, errors) + noise
    stretch = flight(1)._replace(readings=readings, commands=still, speeds=speeds, used_after=still[:, 0])
    at = model.prior.copy()
    at[places.gyro_bias], at[places.wheel] = (1e-5, -2e-5, 5e-6), (0.011, -0.018)
    for followed in (False, True):
        require_slopes(stretch, at, model._replace(followed=followed), 5e-3)
    model.sigma[places.properties] *= 1e-3  # else both scales are one
    fit = fit_flight([stretch], model.prior, model)
    np.testing.assert_allclose(fit.at[places.wheel], errors, atol=1e-3)
    assert fit.normal.misfit < 1.5 * fit.normal.readings
    model.sigma[places.wheel] = 0.0
    assert fit_flight([stretch], model.prior, model).normal.misfit > 100.0 * fit.normal.misfit


def test_jets_are_mounted_as_they_push() -> None:
    """Slopes of the misfit by errors of the mounting are those of differences, and the errors are found."""
    model, _ = known()
    each = mounting_errors(PARAMS.wrenches, POSITIONS, np.full((6, 2), (0.02, 0.01)))
    prior = np.insert(model.prior, columns(model).fill.start, np.zeros(each.jets.size))
    model = model._replace(prior=prior, sigma=np.zeros_like(prior), mounting=each)
    places = columns(model)
    model.sigma[places.properties], model.sigma[places.mount] = 1e-3 * np.diag(PARAMS.start_root), 1.0
    at = model.prior.copy()
    at[places.mount] = np.random.default_rng(2).standard_normal(each.jets.size)
    stretch = flight(1)
    require_slopes(stretch, at, model, 5e-3)
    fit = fit_flight([stretch], at, model)
    assert np.abs(fit.at[places.mount]).max() < 0.3  # as they were flown
    assert fit.normal.misfit < 1.2 * fit.normal.readings


def require_slopes(stretch: Stretch, at: Array, model: FlightModel, tolerance: float) -> None:
    """Compares the score with slopes of the misfit by differences, to a share of the largest."""
    places, score = columns(model), stretch_equations(stretch, at, model).score
    sizes = np.concatenate((1e-4 * np.abs(TRUTH), np.full(at.size - 10, 1e-6)))
    sizes[places.mount] = 1e-3
    tested = [*range(10), places.thrust.start + 2, places.torque.start, places.drag.start + 1]
    tested += [places.momentum.start + 2, places.accelerometer_gain.start]
    for group in (places.gyro_bias, places.wheel, places.mount):
        tested += range(at.size)[group]
    for unknown in tested:
        slope = misfit_slope(stretch, at, model, unknown, sizes[unknown])
        assert score[unknown] == pytest.approx(slope, rel=2e-3, abs=tolerance * abs(score).max()), unknown


def misfit_slope(stretch: Stretch, at: Array, model: FlightModel, unknown: int, size: float) -> float:
    """Slope of minus half the misfit by an unknown, by differences."""
    move = size * np.eye(at.size)[unknown]
    ahead, back = (stretch_equations(stretch, at + way * move, model).misfit for way in (1.0, -1.0))
    return (back - ahead) / (4.0 * size)


def of_all(model: FlightModel, at: Array, stretch: Stretch) -> tuple[Array, Array]:
    """Information about everything that may be wrong, scaled, and the score."""
    wide = model._replace(sigma=np.where(model.sigma > 0.0, model.sigma, 1.0))
    found = stretch_equations(stretch, at, wide)
    scale = 1.0 / np.sqrt(np.maximum(found.information.diagonal(), 1e-300))
    return scale[:, None] * found.information * scale, found.score * scale


@pytest.mark.parametrize("opens", [False, True])
def test_intervals_of_one_length_say_the_same_one_by_one(opens: bool) -> None:
    model, _ = known()
    own = model._replace(at_stamps=True, own_times=True)
    stretch, at = flight(3), model.prior.copy()
    at[columns(model).torque] = 1e-5, 0.0, 0.0
    if opens:
        halves = 0.5 * stretch.commands
        at_s = np.where(halves > 0.0, 0.3 * PERIOD, np.nan)
        stretch = stretch._replace(commands=halves, onsets_s=at_s, before_onsets_s=np.full((1, 6), np.nan))
    for one, other in zip(of_all(model, at, stretch), of_all(own, at, stretch), strict=True):
        np.testing.assert_allclose(other, one, rtol=0.0, atol=1e-8 * np.abs(one).max())

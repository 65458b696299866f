"""The mass filter: compensation of rotation by sampling, and the scalar update against batch least squares."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pytest
from params_probe import mass_params

from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.maths.estimation.adaptation import NO_ADAPTATION
from massprop_drake.maths.estimation.filters.mass_filter import (
    Compensation,
    MassInnovation,
    MassInterval,
    MassMeasurement,
    MassParams,
    MassState,
    Rotation,
    compensated,
    finish,
    measure,
    update,
)
from massprop_drake.maths.estimation.filters.mass_jump import empty_window
from massprop_drake.maths.linear_algebra import Array, NotPositiveDefiniteError, skew, symmetrized
from massprop_drake.maths.vehicle.rigid_body import ORIGIN_VELOCITY, RATE, SPIN_INTEGRAL, body_of, initial_state, step
from massprop_drake.maths.vehicle.sensing import point_velocity

PERIOD = 0.08  # s
SETTINGS = mass_params(period_s=PERIOD, compensation=Compensation.TRANSVERSE_CENTRIPETAL, compensation_covariance=True)
WINDOW = empty_window(1)
ARM = np.array([2.0, -1.0, 0.5])
CENTER = np.array([1.0, 0.5, -2.0])  # exact in binary, as ARM is: so is their sum
CENTER_COVARIANCE = np.array([[0.30, 0.05, -0.02], [0.05, 0.20, 0.04], [-0.02, 0.04, 0.10]])
NOISE = np.array([[4e-3, 1e-3, 0.0], [1e-3, 3e-3, 5e-4], [0.0, 5e-4, 2e-3]])
RATE_INCREMENT = np.array([0.2, -0.3, 0.1])
RATE_NOW = np.array([0.5, 0.4, -0.8])
IMPULSE = np.array([3.0, -1.0, 2.0])
VELOCITY_INCREMENT = np.array([1.2, -0.4, 0.9])

VARIANTS = [
    (Compensation.NONE, False),
    (Compensation.TRANSVERSE, False),
    (Compensation.TRANSVERSE, True),
    (Compensation.TRANSVERSE_CENTRIPETAL, True),
]


def freed(
    compensation: int, grow: bool = True, rate_variance: float = 0.04, period: float = PERIOD, **changes: Any
) -> tuple[Array, Array]:
    given: dict[str, Any] = {
        "velocity_increment": VELOCITY_INCREMENT,
        "velocity_noise": NOISE,
        "rate_increment": RATE_INCREMENT,
        "rate": RATE_NOW,
        "arm": ARM,
        "center_covariance": CENTER_COVARIANCE,
    } | changes
    rotation = Rotation(given["rate_increment"], given["rate"], rate_variance, CENTER, given["center_covariance"])
    params = mass_params(period_s=period, compensation=compensation, compensation_covariance=grow)
    return compensated(given["velocity_increment"], given["velocity_noise"], given["arm"], rotation, params)


class Cycled(NamedTuple):
    """Both halves of a cycle."""

    innovation: MassInnovation
    mass_reciprocal: float
    variance: float
    used: bool


def measured(params: MassParams = SETTINGS, **changes: Any) -> MassMeasurement:
    """First half of a cycle with one accelerometer, its noise given in full."""
    arguments: dict[str, Any] = {
        "mass_reciprocal": 0.3,
        "variance": 0.02,
        "velocity_before": np.zeros(3),
        "velocity": VELOCITY_INCREMENT,
        "noise": NOISE,
        "arm": ARM,
        "center_covariance": CENTER_COVARIANCE,
        "rate_increment": RATE_INCREMENT,
        "rate": RATE_NOW,
        "rate_variance": 0.04,
        "linear_impulse": IMPULSE,
    }
    given = arguments | changes
    rotation = Rotation(
        given["rate_increment"], given["rate"], given["rate_variance"], CENTER, given["center_covariance"]
    )
    return measure(
        MassState(given["mass_reciprocal"], given["variance"], WINDOW),
        given["velocity_before"][None],
        given["velocity"][None],
        MassInterval(given["linear_impulse"], given["noise"]),
        rotation,
        params._replace(positions=(CENTER + given["arm"])[None]),
    )


def cycled(params: MassParams = SETTINGS, **changes: Any) -> Cycled:
    arguments: dict[str, Any] = {
        "mass_reciprocal": 0.3,
        "variance": 0.02,
        "velocity_before": np.array([5.0, -3.0, 1.0]),
        "velocity": np.array([6.2, -3.4, 1.9]),
        "usable": True,
        "firing": True,
    }
    arguments |= changes
    usable, firing = arguments.pop("usable"), arguments.pop("firing")
    state = MassState(arguments["mass_reciprocal"], arguments["variance"], WINDOW)
    measurement = measured(params, **arguments)
    done = finish(state, measurement, usable, firing, NO_ADAPTATION, params)
    return Cycled(measurement.innovation, done.state.mass_reciprocal, done.state.variance, done.used)


def spread_of_rates(arm: Array, center_covariance: Array, rate_variance: float) -> Array:
    """W element by element from (3-50) with (3-55)."""
    moment = np.outer(arm, arm) + center_covariance
    spread = np.empty((3, 3))
    for p in range(3):
        for q in range(3):
            # E of (row q)^T (row p) of the error matrix
            rows = rate_variance * ((p == q) * np.eye(3) - np.outer(np.eye(3)[p], np.eye(3)[q]))
            spread[p, q] = np.trace(rows @ moment)
    return spread


# ---------------------------------------------------------------- compensation


def test_no_compensation_returns_what_was_measured() -> None:
    increment, covariance = freed(Compensation.NONE)
    np.testing.assert_array_equal(increment, VELOCITY_INCREMENT)
    np.testing.assert_array_equal(covariance, NOISE)


def test_transverse_compensation_of_hand_value() -> None:
    # (0, 0, 1) x (1, 2, 3) = (-2, 1, 0)
    increment, _ = freed(
        Compensation.TRANSVERSE,
        velocity_increment=np.array([10.0, 10.0, 10.0]),
        rate_increment=np.array([0.0, 0.0, 1.0]),
        arm=np.array([1.0, 2.0, 3.0]),
    )
    np.testing.assert_array_equal(increment, [12, 9, 10])


def test_centripetal_compensation_of_hand_value() -> None:
    # w = (0, 0, 2): w x (w x (1, 2, 3)) = (-4, -8, 0), over 0.5 s (-2, -4, 0); the noise of the increment, 0.1,
    # makes the measured square too large by 2 (0.1 / 4) 0.5 = 0.025 of the arm, in its negative
    increment, _ = freed(
        Compensation.TRANSVERSE_CENTRIPETAL,
        rate_variance=0.1,
        period=0.5,
        velocity_increment=np.array([10.0, 10.0, 10.0]),
        rate_increment=np.zeros(3),
        rate=np.array([0.0, 0.0, 2.0]),
        arm=np.array([1.0, 2.0, 3.0]),
    )
    np.testing.assert_allclose(increment, [12.025, 14.05, 10.075], rtol=1e-15)


@pytest.mark.parametrize("compensation", [Compensation.TRANSVERSE, Compensation.TRANSVERSE_CENTRIPETAL])
def test_covariance_grows_by_the_spread_of_rates_and_of_the_center_of_mass(compensation: int) -> None:
    # (3-61b) and (3-80b); one error of the center of mass drives both compensations, so they add up inside
    mixing = skew(RATE_INCREMENT)
    if compensation == Compensation.TRANSVERSE_CENTRIPETAL:
        mixing = mixing + PERIOD * skew(RATE_NOW) @ skew(RATE_NOW)
    expected = NOISE + spread_of_rates(ARM, CENTER_COVARIANCE, 0.04) + mixing @ CENTER_COVARIANCE @ mixing.T
    _, covariance = freed(compensation)
    np.testing.assert_allclose(covariance, expected, rtol=1e-13, atol=1e-16)


@pytest.mark.parametrize("compensation", [Compensation.TRANSVERSE, Compensation.TRANSVERSE_CENTRIPETAL])
def test_covariance_is_the_sensors_where_it_is_not_to_grow(compensation: int) -> None:
    increment, covariance = freed(compensation, grow=False)
    np.testing.assert_array_equal(covariance, NOISE)
    np.testing.assert_array_equal(increment, freed(compensation, grow=True)[0])


def test_spread_of_the_transverse_compensation_is_that_of_samples() -> None:
    # (3-46) with (3-56): what dw x r is beside dw^ x r^, when dw = dw^ - v and r = r^ - dr
    rng = np.random.default_rng(1)
    count, rate_variance = 400_000, 0.04
    rates = RATE_INCREMENT - np.sqrt(rate_variance) * rng.standard_normal((count, 3))
    arms = ARM - rng.standard_normal((count, 3)) @ np.linalg.cholesky(CENTER_COVARIANCE).T
    errors = np.cross(rates, arms) - np.cross(RATE_INCREMENT, ARM)
    _, covariance = freed(Compensation.TRANSVERSE, rate_variance=rate_variance, velocity_noise=np.zeros((3, 3)))
    # 5 standard errors, from the sampled spread itself
    assert (np.abs(errors.mean(axis=0)) < 5.0 * errors.std(axis=0) / np.sqrt(count)).all()
    products = errors[:, :, None] * errors[:, None]
    bounds = 5.0 * products.std(axis=0) / np.sqrt(count)
    assert (np.abs(products.mean(axis=0) - covariance) < bounds).all()
    # the test can tell: the part of the spread that comes from both errors at once matters
    without = covariance - spread_of_rates(np.zeros(3), CENTER_COVARIANCE, rate_variance)
    assert (np.abs(products.mean(axis=0) - without).diagonal() > bounds.diagonal()).all()


def test_centripetal_compensation_is_the_mean_over_the_rates_that_two_readings_leave_possible() -> None:
    # (3-67) to (3-69) in the source's sense: the readings are given, the true rates lie about them by their errors.
    # 0.5 rad/s per reading, 0.5 / sqrt(2) for the mean of two, over 10 s: 2 * 0.125 * 10 = 2.5 times the arm
    rng = np.random.default_rng(2)
    period, reading_std, count = 10.0, 0.5, 200_000
    first, second = np.array([0.02, -0.03, 0.01]), np.array([0.03, -0.01, -0.01])
    true = np.array([0.3, -0.1, 0.2])
    before = first - reading_std * rng.standard_normal((count, 3))
    after = second - reading_std * rng.standard_normal((count, 3))
    mean = 0.5 * (before + after)
    measured = true + np.cross(after - before, ARM) + period * np.cross(mean, np.cross(mean, ARM))
    increment, _ = freed(
        Compensation.TRANSVERSE_CENTRIPETAL,
        rate_variance=2.0 * reading_std**2,
        period=period,
        velocity_increment=measured.mean(axis=0),
        rate_increment=second - first,
        rate=0.5 * (first + second),
    )
    standard_error = measured.std(axis=0) / np.sqrt(count)
    assert (np.abs(increment - true) < 5.0 * standard_error).all()
    # the test can tell whether the correction is there, and whether it is for one reading or for the mean of two
    assert (2.5 * np.abs(ARM) > 20.0 * standard_error).all()


def test_compensation_frees_a_true_motion_of_its_rotation(orbiter: Vehicle) -> None:
    # ideal sensors on the orbiter while it turns and thrusts: what is left is lambda / m. With a constant angular
    # acceleration the square of the mean rate misses [dw x]^2 / 12; its change, 3e-4 rad/s^3 by the coupling, misses
    # 2 |w| 3e-4 T^2 / 12, a fifth of that
    nominal = orbiter.nominal
    wrench = np.concatenate([orbiter.wrenches[orbiter.jet_index("L1A")] + orbiter.wrenches[3], [0.0]])
    position = np.array([90.068, -1.146, 1.833])
    arm = position - nominal.center_of_mass
    start = initial_state(nominal.mass)
    start[RATE] = [0.03, -0.02, 0.025]
    end = step(start, wrench, np.zeros((0, 7)), (), PERIOD, body_of(nominal))
    increment = point_velocity(end[ORIGIN_VELOCITY], end[RATE], end[SPIN_INTEGRAL], position)
    increment = increment - point_velocity(start[ORIGIN_VELOCITY], start[RATE], start[SPIN_INTEGRAL], position)
    expected = wrench[3:6] * PERIOD / nominal.mass

    def left(compensation: int) -> float:
        increments, _ = freed(
            compensation,
            rate_variance=0.0,
            velocity_increment=increment,
            rate_increment=end[RATE] - start[RATE],
            rate=0.5 * (start[RATE] + end[RATE]),
            arm=arm,
        )
        return float(np.abs(increments - expected).max())

    change = end[RATE] - start[RATE]
    assert left(Compensation.TRANSVERSE_CENTRIPETAL) < 1.2 * PERIOD / 12.0 * float(change @ change) * np.linalg.norm(
        arm
    )
    assert left(Compensation.TRANSVERSE) > 1e-3  # w^2 r T = 0.03^2 * 58 * 0.08
    assert left(Compensation.NONE) > 1e-2


# ---------------------------------------------------------------- innovation and update


def test_innovation_is_put_together_from_its_terms() -> None:
    disturbance = np.diag([1e-3, 2e-3, 3e-3])
    dut = measured(SETTINGS._replace(disturbance_covariance=disturbance)).innovation
    increment, noise = freed(Compensation.TRANSVERSE_CENTRIPETAL, velocity_noise=NOISE + disturbance)
    expected = increment - 0.3 * IMPULSE
    total = 0.02 * np.outer(IMPULSE, IMPULSE) + noise
    np.testing.assert_allclose(dut.noise, noise, rtol=1e-14)
    np.testing.assert_allclose(dut.innovation, expected, rtol=1e-14)
    np.testing.assert_allclose(dut.covariance, total, rtol=1e-14)
    np.testing.assert_allclose(dut.information @ total, np.eye(3), rtol=0.0, atol=1e-13)
    assert dut.nis == pytest.approx(expected @ np.linalg.solve(total, expected), rel=1e-12)


@pytest.mark.parametrize(("compensation", "grow"), VARIANTS)
def test_variants_differ_in_what_they_subtract_and_in_their_covariance(compensation: int, grow: bool) -> None:
    params = SETTINGS._replace(compensation=compensation, compensation_covariance=grow)
    dut = measured(params).innovation
    rotation = np.zeros(3)
    mixing = np.zeros((3, 3))
    if compensation != Compensation.NONE:
        mixing = skew(RATE_INCREMENT)
        rotation = np.cross(RATE_INCREMENT, ARM)
    if compensation == Compensation.TRANSVERSE_CENTRIPETAL:
        mixing = mixing + PERIOD * skew(RATE_NOW) @ skew(RATE_NOW)
        # of the noise 0.04 of an increment, a reading has half, and the mean of two a quarter: 2 * 0.01
        rotation += PERIOD * (np.cross(RATE_NOW, np.cross(RATE_NOW, ARM)) - 2.0 * 0.01 * ARM)
    noise = NOISE
    if grow:
        noise = NOISE + spread_of_rates(ARM, CENTER_COVARIANCE, 0.04) + mixing @ CENTER_COVARIANCE @ mixing.T
    np.testing.assert_allclose(dut.innovation, VELOCITY_INCREMENT - rotation - 0.3 * IMPULSE, rtol=1e-13)
    np.testing.assert_allclose(dut.noise, noise, rtol=1e-13, atol=1e-16)


def test_update_of_hand_value() -> None:
    # lambda = (0, 0, 2), variance 3, noise 1: Y_zz = 13, gain 6/13; innovation 1.3 adds 0.6, and the variance
    # becomes 3 / 13 (3-84); process noise 0.25
    params = SETTINGS._replace(compensation=Compensation.NONE, process_noise=0.25)
    push, velocity = np.array([0.0, 0.0, 2.0]), np.array([0.0, 0.0, 1.9])
    measurement = measured(params, variance=3.0, velocity=velocity, noise=np.eye(3), linear_impulse=push)
    dut = update(MassState(0.3, 3.0, WINDOW), measurement.sample, measurement.innovation, NO_ADAPTATION, params)
    assert dut.state.mass_reciprocal == pytest.approx(0.9, rel=1e-14)
    assert dut.state.variance == pytest.approx(3.0 / 13.0 + 0.25, rel=1e-14)


def test_variance_is_that_of_the_short_form() -> None:
    # (1 - kappa^T lambda) sigma^2 (3-84) with kappa = sigma^2 Y^-1 lambda (3-86)
    rng = np.random.default_rng(3)
    for _ in range(20):
        impulse, variance = rng.standard_normal(3), rng.uniform(0.01, 10.0)
        sample, innovation, _ = measured(variance=variance, linear_impulse=impulse)
        gain = variance * np.linalg.solve(innovation.covariance, impulse)
        dut = update(MassState(0.3, variance, WINDOW), sample, innovation, NO_ADAPTATION, SETTINGS).state
        # Y has a condition up to 1e4
        assert dut.mass_reciprocal == pytest.approx(0.3 + gain @ innovation.innovation, rel=1e-11)
        assert dut.variance == pytest.approx((1.0 - gain @ impulse) * variance, rel=1e-11)
        assert 0.0 < dut.variance < variance


def test_used_sample_is_the_update_of_its_increment() -> None:
    dut = cycled()
    sample, innovation, _ = measured(velocity=np.array([6.2, -3.4, 1.9]) - [5.0, -3.0, 1.0])
    expected = update(MassState(0.3, 0.02, WINDOW), sample, innovation, NO_ADAPTATION, SETTINGS)
    assert dut.used
    assert (dut.mass_reciprocal, dut.variance) == expected.state[:2]
    assert dut.innovation.nis == innovation.nis


def test_innovation_covariance_that_is_not_positive_definite_is_an_error() -> None:
    with pytest.raises(NotPositiveDefiniteError, match="innovation covariance is not positive definite"):
        cycled(SETTINGS._replace(compensation=Compensation.NONE), noise=np.diag([1.0, -1.0, 1.0]))


def test_cycle_leaves_its_inputs_alone() -> None:
    inputs = {
        "velocity_before": np.array([5.0, -3.0, 1.0]),
        "velocity": np.array([6.2, -3.4, 1.9]),
        "noise": NOISE.copy(),
        "arm": ARM.copy(),
        "center_covariance": CENTER_COVARIANCE.copy(),
        "rate_increment": RATE_INCREMENT.copy(),
        "rate": RATE_NOW.copy(),
        "linear_impulse": IMPULSE.copy(),
    }
    before = {name: value.copy() for name, value in inputs.items()}
    for compensation, grow in VARIANTS:
        cycled(SETTINGS._replace(compensation=compensation, compensation_covariance=grow), **inputs)
    for name, value in inputs.items():
        np.testing.assert_array_equal(value, before[name], err_msg=name)


# ---------------------------------------------------------------- samples that are not used


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("missing", ["velocity", "velocity_before", "rate_increment"])
def test_missing_reading_keeps_the_state(missing: str, axis: int) -> None:
    reading = np.array([0.1, 0.2, 0.3])
    reading[axis] = np.nan
    dut = cycled(SETTINGS._replace(process_noise=1e-3), **{missing: reading})
    assert not dut.used
    assert np.isnan(dut.innovation.nis)
    assert np.isnan(dut.innovation.innovation).all()
    assert dut.mass_reciprocal == 0.3
    assert dut.variance == 0.02 + 1e-3


@pytest.mark.parametrize(("usable", "firing"), [(False, True), (True, False), (False, False)])
def test_sample_that_is_not_steady_or_not_firing_is_shown_but_not_used(usable: bool, firing: bool) -> None:
    dut = cycled(SETTINGS._replace(process_noise=1e-3), usable=usable, firing=firing)
    assert not dut.used
    assert dut.innovation.nis == cycled().innovation.nis
    assert dut.mass_reciprocal == 0.3
    assert dut.variance == 0.02 + 1e-3


# ---------------------------------------------------------------- whole runs


def random_run(rng: np.random.Generator, samples: int) -> list[dict[str, Any]]:
    run: list[dict[str, Any]] = []
    for _ in range(samples):
        factor = rng.standard_normal((2, 3, 5)) * [[[0.05]], [[0.2]]]
        run.append(
            {
                "velocity_before": rng.standard_normal(3),
                "velocity": rng.standard_normal(3),
                "noise": factor[0] @ factor[0].T,
                "arm": rng.standard_normal(3),
                "center_covariance": factor[1] @ factor[1].T,
                "rate_increment": 0.2 * rng.standard_normal(3),
                "rate": 2.0 * rng.standard_normal(3),
                "rate_variance": 1e-3,
                "linear_impulse": rng.standard_normal(3),
            }
        )
    return run


def run_through(
    run: list[dict[str, Any]], mass_reciprocal: float, variance: float, params: MassParams = SETTINGS
) -> tuple[float, float, list[float]]:
    nis = []
    for sample in run:
        done = cycled(params, mass_reciprocal=mass_reciprocal, variance=variance, **sample)
        mass_reciprocal, variance = done.mass_reciprocal, done.variance
        nis.append(done.innovation.nis)
    return mass_reciprocal, variance, nis


@pytest.mark.parametrize(("compensation", "grow"), VARIANTS)
def test_recursive_estimate_equals_batch_least_squares(compensation: int, grow: bool) -> None:
    # zeta' = lambda / m + v, covariance R': information 1 / s_0^2 + sum lambda^T R'^-1 lambda
    params = SETTINGS._replace(compensation=compensation, compensation_covariance=grow)
    run = random_run(np.random.default_rng(4), 40)
    information, right_side = 1.0 / 4.0, 0.5 / 4.0
    for sample in run:
        rotation = Rotation(
            sample["rate_increment"], sample["rate"], sample["rate_variance"], CENTER, sample["center_covariance"]
        )
        measured_increment = sample["velocity"] - sample["velocity_before"]
        increment, total = compensated(measured_increment, sample["noise"], sample["arm"], rotation, params)
        weighted = np.linalg.solve(symmetrized(total), sample["linear_impulse"])
        information += weighted @ sample["linear_impulse"]
        right_side += weighted @ increment
    mass_reciprocal, variance, _ = run_through(run, 0.5, 4.0, params)
    # forty updates whose Y has a condition up to 1e5, as the noise's smallest axis is far below lambda's
    assert mass_reciprocal == pytest.approx(right_side / information, rel=1e-9)
    assert variance == pytest.approx(1.0 / information, rel=1e-9)


def transformed(
    run: list[dict[str, Any]], turn: Array, length: float = 1.0, force: float = 1.0
) -> list[dict[str, Any]]:
    """The same samples in turned axes and other units of length and force."""
    return [
        {
            "velocity_before": length * turn @ sample["velocity_before"],
            "velocity": length * turn @ sample["velocity"],
            "noise": length**2 * turn @ sample["noise"] @ turn.T,
            "arm": length * turn @ sample["arm"],
            "center_covariance": length**2 * turn @ sample["center_covariance"] @ turn.T,
            "rate_increment": turn @ sample["rate_increment"],
            "rate": turn @ sample["rate"],
            "rate_variance": sample["rate_variance"],
            "linear_impulse": force * turn @ sample["linear_impulse"],
        }
        for sample in run
    ]


def compare_through(turn: Array, length: float, force: float) -> None:
    rng = np.random.default_rng(5)
    run = random_run(rng, 20)
    factor = 0.05 * rng.standard_normal((3, 4))
    disturbance = factor @ factor.T
    mass = force / length  # the time's unit does not change
    here = SETTINGS._replace(process_noise=1e-3, disturbance_covariance=disturbance)
    there = SETTINGS._replace(
        process_noise=1e-3 / mass**2, disturbance_covariance=length**2 * turn @ disturbance @ turn.T
    )
    ours = run_through(run, 0.5, 4.0, here)
    theirs = run_through(transformed(run, turn, length, force), 0.5 / mass, 4.0 / mass**2, there)
    # rounding of twenty updates with a condition up to 1e5
    assert theirs[0] == pytest.approx(ours[0] / mass, rel=1e-10)
    assert theirs[1] == pytest.approx(ours[1] / mass**2, rel=1e-10)
    np.testing.assert_allclose(theirs[2], ours[2], rtol=1e-9)


def test_estimate_follows_a_change_of_units() -> None:
    # ft, slug, lbf to m, kg, N; the slug is 1 lbf s^2 / ft = 14.59390 kg, so the units stay consistent
    compare_through(np.eye(3), 0.3048, 4.4482216152605)


def test_estimate_does_not_depend_on_a_cyclic_permutation_of_the_axes() -> None:
    compare_through(np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]), 1.0, 1.0)


def test_estimate_does_not_depend_on_a_rotation_of_the_axes() -> None:
    rotation = np.linalg.qr(np.random.default_rng(6).standard_normal((3, 3)))[0]
    compare_through(rotation * np.linalg.det(rotation), 1.0, 1.0)


def test_estimates_errors_are_those_the_variance_claims() -> None:
    # 400 runs of five samples with sampled priors and noise, nothing left to compensate: mean NEES 1 and mean
    # NIS 3, with standard errors sqrt(2 / 400) and sqrt(6 / 2000)
    rng = np.random.default_rng(7)
    nees, nis = [], []
    params = SETTINGS._replace(compensation=Compensation.NONE)
    root = np.linalg.cholesky(NOISE)
    for _ in range(400):
        truth = 0.3 + np.sqrt(0.02) * rng.standard_normal()
        estimate, variance = 0.3, 0.02
        for _ in range(5):
            impulse = 0.3 * rng.standard_normal(3)
            increment = impulse * truth + root @ rng.standard_normal(3)
            done = cycled(
                params,
                mass_reciprocal=estimate,
                variance=variance,
                velocity_before=np.zeros(3),
                velocity=increment,
                linear_impulse=impulse,
            )
            estimate, variance = done.mass_reciprocal, done.variance
            nis.append(done.innovation.nis)
        nees.append((estimate - truth) ** 2 / variance)
    assert abs(np.mean(nees) - 1.0) < 5.0 * np.sqrt(2.0 / 400)
    assert abs(np.mean(nis) - 3.0) < 5.0 * np.sqrt(6.0 / 2000)


def test_a_couple_of_jets_shows_no_jump() -> None:
    # opposed thrusts leave an impulse of rounding errors; whatever the innovation, it says nothing of 1/m
    params = SETTINGS._replace(compensation=Compensation.NONE, jump_threshold=6.63, jump_variance=0.09)
    state = MassState(0.3, 0.01, WINDOW)
    for push, jumps in ((1e-17, False), (1.0, True)):
        impulse, velocity = np.array([push, 0.0, 0.0]), np.array([5.0, 0.0, 0.0])
        measurement = measured(params, variance=0.01, velocity=velocity, noise=1e-3 * np.eye(3), linear_impulse=impulse)
        dut = update(state, measurement.sample, measurement.innovation, NO_ADAPTATION, params)
        assert dut.jumped == jumps
        assert abs(dut.state.mass_reciprocal) < 10.0

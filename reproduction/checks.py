"""Calculations that check single equations of the thesis by drawing many samples through our own functions."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from massprop_drake.inputs import params
from massprop_drake.inputs.scenario import load_scenario
from massprop_drake.maths.estimation.adaptation import NO_ADAPTATION, Action, Adaptation
from massprop_drake.maths.estimation.detectors.jet_tests import jet_tests
from massprop_drake.maths.estimation.filters import rate_increments, rotation_filter
from massprop_drake.maths.estimation.filters.mass_filter import (
    MassInterval,
    MassParams,
    MassSample,
    MassState,
    Rotation,
    innovate,
    measure,
    update,
)
from massprop_drake.maths.estimation.filters.mass_jump import empty_window, jump_test
from massprop_drake.maths.estimation.filters.rate_increments import rate_increment
from massprop_drake.maths.linear_algebra import skew
from massprop_drake.maths.vehicle import rigid_body
from reproduction.analytic import setting
from reproduction.measures import orbiter
from reproduction.pure_rotations import initial_state, update_filter

Array = NDArray[np.float64]

_PUSH = np.array([0.0, 0.0, 871.0 * 0.08])  # lbf-s: one primary jet for a sample


def _mass_params(*overrides: str) -> MassParams:
    """Returns the mass filter's parameters in the sample maneuver, with overrides."""
    return params.mass_params(load_scenario("sample_maneuver", list(overrides)))


def _noise() -> Array:
    """Covariance R^zeta of a velocity increment's noise (section 5.1), ft^2/s^2, shape (3, 3)."""
    result: Array = 2.0 * orbiter().accelerometers[0].variance * np.eye(3)
    return result


def updates_per_sample(_: int) -> dict[str, Array]:
    """Counts the mass filter's updates per used sample, by the rule for its three accelerometers."""
    truth = orbiter().nominal
    rotation = Rotation(np.zeros(3), np.zeros(3), 1e-12, truth.center_of_mass, np.zeros((3, 3)))
    counts = {}
    for rule in ("single", "weighted_average", "serial"):
        params = _mass_params(f"sensors.combine.accelerometers={rule}")
        state = MassState(truth.vector()[9], 1e-9, empty_window(1))
        measurement = measure(state, np.zeros((3, 3)), np.zeros((3, 3)), MassInterval(_PUSH), rotation, params)
        counts[rule] = np.array([float(len(measurement.each) or 1)])
    return counts


def mass_jump_variance(seed: int) -> dict[str, Array]:
    """Computes the variance of 1/m after a jump found in one sample (3-116): true, and as the filter claims it.

    For a gain of 0.8 and one of 0.004; exact: our default, thesis: its form for small gains (3-118). Each over the
    variance of that sample alone.
    """
    random = np.random.default_rng([seed, 10])
    # a threshold of zero: every sample counts as a jump
    always = {
        name: _mass_params(f"mass.jump={jump}")._replace(jump_threshold=0.0, jump_variance=1.0)
        for name, jump in (("exact", "single_sample"), ("thesis", "single_sample_thesis"))
    }
    truth = orbiter().nominal.vector()[9]
    noise = _noise()
    alone = 1.0 / float(_PUSH @ np.linalg.solve(noise, _PUSH))
    result: dict[str, list[float]] = {"true": [], "exact": [], "thesis": []}
    for gain in (0.8, 0.004):
        variance = alone * gain / (1.0 - gain)
        errors = []
        for _ in range(1000):
            before = MassState(truth + math.sqrt(variance) * random.standard_normal(), variance, empty_window(1))
            jumped = truth + 3e-5 * random.standard_normal()
            velocity = _PUSH * jumped + np.sqrt(noise.diagonal()) * random.standard_normal(3)
            sample = MassSample(velocity, noise, _PUSH)
            after = update(before, sample, innovate(before, sample), NO_ADAPTATION, always["exact"])
            errors.append(after.state.mass_reciprocal - jumped)
        result["true"].append(float(np.mean(np.square(errors))) / alone)
        for name, settings in always.items():
            claimed = update(before, sample, innovate(before, sample), NO_ADAPTATION, settings).state.variance
            result[name].append(claimed / alone)
    return {name: np.array(values) for name, values in result.items()}


def window_false_alarms(seed: int) -> dict[str, Array]:
    """Computes the share of healthy samples above thresholds on the largest argument of five, shape (2, 2).

    Rows: a prior that one sample hardly changes, and one as uncertain as a sample. Columns: 6.63, the 1 % value of
    chi-square with one degree of freedom, and its value at 1 % / 5.
    """
    random = np.random.default_rng([seed, 11])
    limits = np.array([6.635, 9.550])
    noise, count = _noise(), 1500
    alone = 1.0 / float(_PUSH @ np.linalg.solve(noise, _PUSH))
    params = _mass_params()
    shares = []
    for prior in (1e-3, 1.0):
        above = np.zeros(2)
        for _ in range(count):
            variance = prior * alone
            state = MassState(math.sqrt(variance) * random.standard_normal(), variance, empty_window(5))
            window = empty_window(5)
            for velocity in np.sqrt(noise.diagonal()) * random.standard_normal((5, 3)):
                sample = MassSample(
                    velocity, noise, _PUSH
                )  # of a vehicle with 1/m of zero: it is the errors that count
                innovation = innovate(state, sample)
                share = state.variance * float(_PUSH @ innovation.information @ _PUSH)
                test = jump_test(window, _PUSH, innovation.information, innovation.innovation, share)
                window = test.window
                state = update(state, sample, innovation, NO_ADAPTATION, params).state
            above += test.likelihood > limits
        shares.append(above / count)
    return {"share": np.array(shares)}


def corrections(seed: int) -> dict[str, Array]:
    """Computes the variance of 1/m after a sample corrected for a leak, true over claimed: ours, and by (4-34).

    With so coarse a gyro that the two differ: the orbiter's alone says how large the leak is, and next to nothing
    of the translation is spent on it.
    """
    random = np.random.default_rng([seed, 12])
    constants = setting()
    params = _mass_params()
    truth = orbiter().nominal.vector()[9]
    noise = _noise()
    signature = constants.coefficients[23]  # jet 24, its force much along _PUSH
    variance = 0.5 / float(_PUSH @ np.linalg.solve(noise, _PUSH))
    # so coarse a gyro that it is the translation alone that shows the leak, and is corrected for it
    weights = constants.information * np.repeat([1.0, 1e-9], 3)
    spread = 1.0 / np.sqrt(weights.diagonal())
    nothing = np.zeros(len(constants.clusters), dtype=bool)
    errors: dict[Action, list[float]] = {Action.CORRECT: [], Action.CORRECT_THESIS: []}
    claimed = {}
    for _ in range(500):
        before = MassState(truth + math.sqrt(variance) * random.standard_normal(), variance, empty_window(1))
        measured = spread * random.standard_normal(6) + 20.0 * signature
        measured[:3] += _PUSH * truth
        sample = MassSample(measured[:3], noise, _PUSH)
        innovation = innovate(before, sample)
        information = weights.copy()
        information[:3, :3] = innovation.information
        residual = np.concatenate([innovation.innovation, measured[3:]])
        tests = jet_tests(constants.coefficients, residual, information, nothing, nothing)
        effect = tests.magnitude[23] * signature
        scatter = tests.variance[23] * np.outer(signature, signature)
        for action, action_errors in errors.items():
            correction = Adaptation(action, effect[:3], effect[3:], scatter[:3, :3], scatter[3:, 3:], mass_jumped=False)
            after = update(before, sample, innovation, correction, params).state
            action_errors.append(after.mass_reciprocal - truth)
            claimed[action] = after.variance
    return {
        name: np.array([np.mean(np.square(errors[action])) / claimed[action]])
        for name, action in (("ours", Action.CORRECT), ("thesis", Action.CORRECT_THESIS))
    }


def whiteness(seed: int) -> dict[str, Array]:
    """Computes the correlation of the noises of two increments in a row, of a quantized reading over many quanta."""
    random = np.random.default_rng([seed, 13])
    truth = np.cumsum(random.uniform(10.0, 30.0, 4000))
    noise = np.diff(np.round(truth) - truth)
    return {"correlation": np.array([float(np.corrcoef(noise[1:], noise[:-1])[0, 1])])}


def first_updates(_: int) -> dict[str, Array]:
    """Computes the error of Ixx^-1 after one exact rate increment, %, for groups of primary jets that roll the orbiter.

    Those whose rate increment about x is at least twice that about y and z.
    """
    vehicle = orbiter()
    truth = vehicle.nominal.vector()[:9]
    impulses = vehicle.wrenches * vehicle.sample_period_s
    primary = [index for index, jet in enumerate(vehicle.jets) if jet.kind == "primary"]
    errors = []
    for count in (2, 3):
        for jets in itertools.combinations(primary, count):
            angular, linear = np.split(impulses[list(jets)].sum(axis=0), 2)
            increment = np.abs(rate_increment(truth, angular, linear))
            if increment[0] >= 2.0 * increment[1:].max():
                errors.append(first_update(jets))
    return {"percent": np.array(errors)}


def first_update(jet_indices: Sequence[int]) -> float:
    """Computes the error of Ixx^-1, %, after one exact rate increment by some jets, from zero at 100 % uncertainty."""
    vehicle = orbiter()
    truth = vehicle.nominal.vector()[:9]
    impulse = vehicle.wrenches[list(jet_indices)].sum(axis=0) * vehicle.sample_period_s
    after = update_filter(
        initial_state(), rate_increment(truth, *np.split(impulse, 2)), impulse, _rotation_params()
    ).estimate
    return float(100.0 * abs(after[0] - truth[0]) / truth[0])


@lru_cache(maxsize=1)
def _rotation_params() -> rotation_filter.RotationParams:
    """Returns the rotation filter's parameters in the sample maneuver, without covariance increments."""
    return params.thesis_params(load_scenario("sample_maneuver", ["rotation.jump=none"])).rotation


def momentum(_: int) -> dict[str, Array]:
    """Computes the relative change of the angular momentum in inertial axes over 50 s of tumbling without jets."""
    properties = orbiter().nominal
    body = rigid_body.motion_constants(properties)
    state = rigid_body.initial_state(properties.mass)
    state[rigid_body.RATE] = np.radians([0.5, -0.4, 0.3])
    before = rigid_body.angular_momentum(state, properties)
    for _step in range(625):
        state = rigid_body.step(state, np.zeros(7), np.zeros((0, 7)), (), 0.08, body)
    change = rigid_body.angular_momentum(state, properties) - before
    return {"change": np.array([np.linalg.norm(change) / np.linalg.norm(before)])}


def arms(_: int) -> dict[str, Array]:
    """Computes the largest difference of torques about the center of mass by (1-4) from shifted wrenches, ft-lbf."""
    vehicle = orbiter()
    center = vehicle.nominal.center_of_mass
    direct = np.cross(vehicle.positions - center, vehicle.thrusts)
    shifted = vehicle.wrenches[:, :3] - np.cross(center, vehicle.wrenches[:, 3:])
    return {"difference": np.array([np.abs(direct - shifted).max()])}


def second_order_parts(seed: int) -> dict[str, Array]:
    """Compares the filter's bias (2-118), D (2-121) and H (2-102) with the 9 by 9 matrices (2-53), (2-54), relative."""
    random = np.random.default_rng([seed, 14])
    root, estimate = random.standard_normal((9, 9)), random.standard_normal(9)
    covariance = root @ root.T
    angular, linear = random.standard_normal((2, 3))
    blocks = _curvatures(linear)
    bias = np.array([0.5 * np.trace(block @ covariance) for block in blocks])
    spread = [[0.5 * np.trace(one @ covariance @ two @ covariance) for two in blocks] for one in blocks]
    jacobian = np.hstack([rate_increments.angular_block(angular), np.zeros((3, 3))]) + blocks @ estimate
    terms = rate_increments.second_order_terms(covariance, linear)
    filter_jacobian = rate_increments.rate_increment_jacobian(estimate, angular, linear)
    pairs = ((terms[0], bias), (terms[1], np.array(spread)), (filter_jacobian, jacobian))
    return {"difference": np.array([np.abs(one - two).max() / np.abs(two).max() for one, two in pairs])}


def _curvatures(linear_impulse: Array) -> Array:
    """Second derivatives Lambda^i (2-54) of the rate increment at a linear impulse, shape (3, 9, 9)."""
    b = skew(linear_impulse)
    blocks = np.zeros((3, 9, 9))
    # rows of B^i in the order 11, 22, 33, 23, 13, 12: element (i, j) of the inverse inertia multiplies b_j
    for row, (i, j) in enumerate(((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))):
        blocks[i, row, 6:] = b[j]
        blocks[j, row, 6:] = b[i]
    result: Array = blocks + blocks.transpose(0, 2, 1)
    return result


def wiring(_: int) -> dict[str, Array]:
    """Counts connections, true inputs and parameters of the diagrams, to compare with figures 1-1 to 1-4."""
    from massprop_drake.display import graphs  # noqa: PLC0415 (loads Drake)

    loop = graphs.build("closed_loop")
    found = {(there[0].get_name(), here[0].get_name()) for here, there in loop.connection_map().items()}
    wanted = {
        ("autopilot", "vehicle"),
        ("vehicle", "autopilot"),
        ("vehicle", "estimation"),
        ("autopilot", "estimation"),
        ("estimation", "autopilot"),
    }
    estimation = graphs.build("estimation")
    inputs = {estimation.get_input_port(index).get_name() for index in range(estimation.num_input_ports())}
    true = {"body_state", "structure", "mass_properties", "thrust"}
    return {
        "missing": np.array([float(len(wanted - found))]),
        "true_inputs": np.array([float(len(inputs & true))]),
        "parameters": np.array([float(estimation.GetOutputPort("estimate").size())]),
    }


def matched_filters(_: int) -> dict[str, Array]:
    """Compares force (4-25) and argument (4-28) of every jet with a weighted least-squares fit of each, relative."""
    constants = setting()
    random = np.random.default_rng(15)
    off = np.zeros(len(constants.clusters), dtype=bool)
    root = np.sqrt(constants.information)
    largest = 0.0
    for _sample in range(20):
        residual = random.standard_normal(6) / root.diagonal()
        tests = jet_tests(constants.coefficients, residual, constants.information, off, off)
        for jet, signature in enumerate(constants.coefficients):
            force = float(np.linalg.lstsq((root @ signature)[:, None], root @ residual, rcond=None)[0][0])
            rest = root @ (residual - force * signature)
            gained = float(residual @ constants.information @ residual - rest @ rest)
            largest = max(largest, abs(tests.magnitude[jet] - force) / (abs(force) + 1.0))
            largest = max(largest, abs(tests.likelihood[jet] - gained) / (gained + 1.0))
    return {"difference": np.array([largest])}

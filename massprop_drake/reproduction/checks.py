"""Calculations that check single equations of the thesis by drawing many samples through our own functions."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from massprop_drake import settings as make
from massprop_drake.maths.adaptation import CORRECT, CORRECT_THESIS, NO_ADAPTATION, Adaptation
from massprop_drake.maths.jet_failures import jet_tests
from massprop_drake.maths.mass_filter import MassSample, MassSettings, MassState, Rotation, innovate, measure, update
from massprop_drake.maths.mass_jump import empty_window, jump_test
from massprop_drake.reproduction.analytic import setting
from massprop_drake.reproduction.measures import orbiter
from massprop_drake.scenario import load_scenario

Array = NDArray[np.float64]

_PUSH = np.array([0.0, 0.0, 871.0 * 0.08])  # lbf-s: one primary jet for a sample


def _settings(*overrides: str) -> MassSettings:
    return make.mass_settings(load_scenario("sample_maneuver", list(overrides)))


def _noise() -> Array:
    """R^zeta of section 5.1, ft^2/s^2, shape (3, 3)."""
    result: Array = 2.0 * orbiter().accelerometers[0].variance * np.eye(3)
    return result


def updates_per_sample(_: int) -> dict[str, Array]:
    """Updates of the mass filter that one used sample takes, by the rule for its three accelerometers."""
    truth = orbiter().nominal
    rotation = Rotation(np.zeros(3), np.zeros(3), 1e-12, truth.center_of_mass, np.zeros((3, 3)))
    counts = {}
    for rule in ("single", "weighted_average", "serial"):
        own = _settings(f"sensors.combine.accelerometers={rule}")
        state = MassState(truth.vector()[9], 1e-9, empty_window(1))
        made = measure(state, np.zeros((3, 3)), np.zeros((3, 3)), None, rotation, _PUSH, own)
        counts[rule] = np.array([float(len(made.each) or 1)])
    return counts


def mass_jump_variance(seed: int) -> dict[str, Array]:
    """Variance of 1/m after a jump found in one sample (3-116), over what formulas say of it.

    For a gain of 0.8 and one of 0.004: true variance, the filter's (exact), the thesis's small-gain form
    3 sigma_old^2 + 1/(lambda^T Y^-1 lambda) (3-118); each over the variance of that sample alone.
    """
    random = np.random.default_rng([seed, 10])
    # a threshold of zero: every sample counts as a jump
    always = _settings("mass.jump=single_sample")._replace(jump_threshold=0.0)
    truth = orbiter().nominal.vector()[9]
    noise = _noise()
    alone = 1.0 / float(_PUSH @ np.linalg.solve(noise, _PUSH))
    result: dict[str, list[float]] = {"true": [], "exact": [], "thesis": []}
    for gain in (0.8, 0.004):
        variance = alone * gain / (1.0 - gain)
        errors = []
        for _ in range(500):
            before = MassState(truth + math.sqrt(variance) * random.standard_normal(), variance, empty_window(1))
            jumped = truth + 3e-5 * random.standard_normal()
            velocity = _PUSH * jumped + np.sqrt(noise.diagonal()) * random.standard_normal(3)
            sample = MassSample(velocity, noise, _PUSH)
            after = update(before, sample, innovate(before, sample), NO_ADAPTATION, always)
            errors.append(after.state.mass_reciprocal - jumped)
        information = innovate(before, sample).information
        ordinary = (1.0 - gain) * variance
        result["true"].append(float(np.mean(np.square(errors))) / alone)
        result["exact"].append(after.state.variance / alone)
        result["thesis"].append((3.0 * ordinary + 1.0 / float(_PUSH @ information @ _PUSH)) / alone)
    return {name: np.array(values) for name, values in result.items()}


def window_false_alarms(seed: int) -> dict[str, Array]:
    """Share of healthy samples above thresholds on the largest argument over a window of five samples.

    Thresholds: 6.63, the 1 % value of chi-square with one degree of freedom; its value at 1 % / 5; and the
    1 % value with five degrees, which the thesis names.
    """
    random = np.random.default_rng([seed, 11])
    limits = np.array([6.635, 9.550, 15.086])
    above = np.zeros(3)
    count = 1500
    variance, noise = 1e-12, _noise()
    information = np.linalg.inv(noise + np.outer(_PUSH, _PUSH) * variance)
    share = variance * float(_PUSH @ information @ _PUSH)
    for _ in range(count):
        window = empty_window(5)
        for innovation in np.sqrt(noise.diagonal()) * random.standard_normal((5, 3)):
            test = jump_test(window, _PUSH, information, innovation, share)
            window = test.window
        above += test.likelihood > limits
    return {"share": above / count}


def corrections(seed: int) -> dict[str, Array]:
    """Variance of 1/m after a sample corrected for a leak, true over claimed: ours, and the thesis's (4-34).

    With a gyro a thousand times coarser than the orbiter's, where the two differ: else rotation alone says how
    large the leak is, and next to nothing is lost.
    """
    random = np.random.default_rng([seed, 12])
    here = setting()
    own = _settings()
    truth = orbiter().nominal.vector()[9]
    noise = _noise()
    signature = here.coefficients[23]  # jet 24, its force much along _PUSH
    variance = 0.5 / float(_PUSH @ np.linalg.solve(noise, _PUSH))
    # a coarse gyro, so that it is the same translation that shows the leak and is corrected for it
    weights = here.information * np.repeat([1.0, 1e-6], 3)
    spread = 1.0 / np.sqrt(weights.diagonal())
    nothing = np.zeros(len(here.clusters), dtype=bool)
    errors: dict[int, list[float]] = {CORRECT: [], CORRECT_THESIS: []}
    claimed = {}
    for _ in range(500):
        before = MassState(truth + math.sqrt(variance) * random.standard_normal(), variance, empty_window(1))
        both = spread * random.standard_normal(6) + 20.0 * signature
        both[:3] += _PUSH * truth
        sample = MassSample(both[:3], noise, _PUSH)
        innovation = innovate(before, sample)
        information = weights.copy()
        information[:3, :3] = innovation.information
        residual = np.concatenate([innovation.innovation, both[3:]])
        tests = jet_tests(here.coefficients, residual, information, nothing, nothing)
        effect = tests.magnitude[23] * signature
        scatter = tests.variance[23] * np.outer(signature, signature)
        for action in errors:
            correction = Adaptation(
                action, effect[:3], effect[3:], scatter[:3, :3], scatter[3:, 3:], mass_jumped=False
            )
            after = update(before, sample, innovation, correction, own).state
            errors[action].append(after.mass_reciprocal - truth)
            claimed[action] = after.variance
    return {
        name: np.array([np.mean(np.square(errors[action])) / claimed[action]])
        for name, action in (("ours", CORRECT), ("thesis", CORRECT_THESIS))
    }


def whiteness(seed: int) -> dict[str, Array]:
    """Correlation of the noises of two increments in a row, of a quantised reading that moves by many quanta."""
    random = np.random.default_rng([seed, 13])
    truth = np.cumsum(random.uniform(10.0, 30.0, 4000))
    noise = np.diff(np.round(truth) - truth)
    return {"correlation": np.array([float(np.corrcoef(noise[1:], noise[:-1])[0, 1])])}

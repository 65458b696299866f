"""Noise as a pure function of seed, stream and sample number."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.noise import normal_sample, stream_seed, uniform_phase, vary_seed


def samples(seed: int, stream: str, count: int, size: int = 3) -> Array:
    return np.array([normal_sample(seed, stream, number, size) for number in range(count)])


def test_sample_is_the_same_whenever_it_is_asked_for_and_cannot_be_changed() -> None:
    expected = samples(7, "gyro", 192)
    assert len(np.unique(expected)) == expected.size  # a block holds 64 samples, and none repeats another
    for number in np.random.default_rng(1).permutation(192).tolist():
        normal_sample(7, "acc1", number, 3)  # streams do not depend on each other
        assert_array_equal(normal_sample(7, "gyro", number, 3), expected[number])
    for number in range(0, 20_000, 64):  # hundreds of blocks push the first out of any memory
        normal_sample(8, "another", number, 3)
    assert_array_equal(normal_sample(7, "gyro", 5, 3), expected[5])
    with pytest.raises(ValueError, match="read-only"):
        normal_sample(7, "gyro", 3, 3)[0] = 0.0


@pytest.mark.parametrize(("seed", "stream"), [(8, "gyro"), (7, "gyro2"), (7, "oryg")])
def test_another_seed_or_stream_has_unrelated_numbers(seed: int, stream: str) -> None:
    ours, theirs = samples(7, "gyro", 2000), samples(seed, stream, 2000)
    # correlation of 6000 independent pairs: zero with a standard error of 1 / sqrt(6000)
    assert abs(np.corrcoef(ours.ravel(), theirs.ravel())[0, 1]) < 5.0 / np.sqrt(6000)
    assert not np.array_equal(uniform_phase(seed, stream, 3), uniform_phase(7, "gyro", 3))
    assert stream_seed(seed, stream).generate_state(2).tolist() != stream_seed(7, "gyro").generate_state(2).tolist()


def test_what_is_drawn_varies_a_seed_by_every_bit_of_it() -> None:
    assert vary_seed(3, 0.0) == 3
    assert len({vary_seed(3, draw) for draw in (0.5, np.nextafter(0.5, 1.0), -0.5)} | {vary_seed(4, 0.5)}) == 4


def test_samples_are_standard_normal_and_white() -> None:
    count = 20_000
    noise, root = samples(11, "gyro", count), np.sqrt(count)
    # standard errors: mean 1 / sqrt(n), variance sqrt(2 / n), fourth moment sqrt(96 / n), products 1 / sqrt(n)
    assert np.abs(noise.mean(axis=0)).max() < 5.0 / root
    assert np.abs((noise**2).mean(axis=0) - 1.0).max() < 5.0 * np.sqrt(2.0) / root
    assert np.abs((noise**4).mean(axis=0) - 3.0).max() < 5.0 * np.sqrt(96.0) / root
    for lag in (1, 64):
        assert np.abs((noise[lag:] * noise[:-lag]).mean(axis=0)).max() < 5.0 / np.sqrt(count - lag)
    assert np.abs((noise.T @ noise / count)[np.triu_indices(3, 1)]).max() < 5.0 / root


def test_phases_are_uniform_within_half_a_quantum() -> None:
    phases = np.concatenate([uniform_phase(seed, "gyro", 3) for seed in range(1000)])
    assert -0.5 <= phases.min() <= phases.max() < 0.5
    # mean 0, variance 1/12; their standard errors: sqrt(1 / 12 n), and sqrt((1/80 - 1/144) / n)
    assert abs(phases.mean()) < 5.0 * np.sqrt(1.0 / 12.0 / phases.size)
    assert abs((phases**2).mean() - 1.0 / 12.0) < 5.0 * np.sqrt((1.0 / 80.0 - 1.0 / 144.0) / phases.size)

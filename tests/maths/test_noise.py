"""Noise as a pure function of seed, stream and sample number."""

from __future__ import annotations

import numpy as np
import pytest

from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.noise import normal_sample, stream_seed, uniform_phase


def samples(seed: int, stream: str, count: int, size: int = 3) -> Array:
    return np.array([normal_sample(seed, stream, number, size) for number in range(count)])


def test_sample_is_the_same_in_whatever_order_it_is_asked_for() -> None:
    numbers = np.arange(200)
    expected = samples(7, "gyro", 200)
    for order in (numbers[::-1], np.random.default_rng(1).permutation(numbers)):
        for number in order:
            np.testing.assert_array_equal(normal_sample(7, "gyro", int(number), 3), expected[number])


def test_sample_is_the_same_long_after_it_was_last_asked_for() -> None:
    # hundreds of blocks asked for in between push the first out of any memory
    before = normal_sample(7, "gyro", 5, 3).copy()
    for number in range(0, 40_000, 64):
        normal_sample(8, "another", number, 3)
    np.testing.assert_array_equal(normal_sample(7, "gyro", 5, 3), before)


def test_streams_do_not_depend_on_each_other() -> None:
    alone = samples(7, "gyro", 100)
    interleaved = []
    for number in range(100):
        normal_sample(7, "acc1", number, 3)
        interleaved.append(normal_sample(7, "gyro", number, 3))
    np.testing.assert_array_equal(interleaved, alone)


@pytest.mark.parametrize(("seed", "stream"), [(8, "gyro"), (7, "gyro2"), (7, "acc1"), (7, "oryg")])
def test_another_seed_or_stream_has_unrelated_numbers(seed: int, stream: str) -> None:
    ours, theirs = samples(7, "gyro", 2000), samples(seed, stream, 2000)
    # correlation of 6000 independent pairs: zero with a standard error of 1 / sqrt(6000)
    assert abs(np.corrcoef(ours.ravel(), theirs.ravel())[0, 1]) < 5.0 / np.sqrt(6000)


def test_samples_around_a_block_boundary_differ() -> None:
    # a block holds 64 samples; a counter that did not move on would repeat a row of the one before
    around = samples(7, "gyro", 192)
    assert len(np.unique(around)) == around.size
    for number in (63, 64, 127, 128):
        np.testing.assert_array_equal(normal_sample(7, "gyro", number, 3), around[number])


def test_samples_are_standard_normal_and_white() -> None:
    count = 20_000
    noise = samples(11, "gyro", count)
    # standard errors: mean 1 / sqrt(n), variance sqrt(2 / n), fourth moment sqrt(96 / n), products 1 / sqrt(n)
    root = np.sqrt(count)
    assert np.abs(noise.mean(axis=0)).max() < 5.0 / root
    assert np.abs((noise**2).mean(axis=0) - 1.0).max() < 5.0 * np.sqrt(2.0) / root
    assert np.abs((noise**4).mean(axis=0) - 3.0).max() < 5.0 * np.sqrt(96.0) / root
    for lag in (1, 64):
        assert np.abs((noise[lag:] * noise[:-lag]).mean(axis=0)).max() < 5.0 / np.sqrt(count - lag)
    across = noise.T @ noise / count
    assert np.abs(across[np.triu_indices(3, 1)]).max() < 5.0 / root


def test_sample_cannot_be_written_to() -> None:
    sample = normal_sample(7, "gyro", 3, 3)
    with pytest.raises(ValueError, match="read-only"):
        sample[0] = 0.0


def test_sample_has_the_size_asked_for() -> None:
    assert normal_sample(7, "gyro", 70, 6).shape == (6,)


def test_stream_seed_follows_seed_and_name() -> None:
    states = [stream_seed(*key).generate_state(2).tolist() for key in ((1, "a"), (1, "a"), (2, "a"), (1, "b"))]
    assert states[0] == states[1]
    assert states[0] != states[2]
    assert states[0] != states[3]


def test_phase_is_drawn_once_per_run_and_stream() -> None:
    first = uniform_phase(7, "gyro", 3)
    np.testing.assert_array_equal(uniform_phase(7, "gyro", 3), first)
    assert not np.array_equal(uniform_phase(8, "gyro", 3), first)
    assert not np.array_equal(uniform_phase(7, "acc1", 3), first)


def test_phases_are_uniform_within_half_a_quantum() -> None:
    phases = np.concatenate([uniform_phase(seed, "gyro", 3) for seed in range(1000)])
    assert phases.min() >= -0.5
    assert phases.max() < 0.5
    # mean 0, variance 1/12; their standard errors: sqrt(1 / 12 n), and sqrt((1/80 - 1/144) / n)
    assert abs(phases.mean()) < 5.0 * np.sqrt(1.0 / 12.0 / phases.size)
    assert abs((phases**2).mean() - 1.0 / 12.0) < 5.0 * np.sqrt((1.0 / 80.0 - 1.0 / 144.0) / phases.size)

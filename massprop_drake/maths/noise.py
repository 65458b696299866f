"""Reproducible sensor noise: sample k of a stream of a given size is a pure function of (seed, stream, k).

A simulator may evaluate a sensor's reading at t_k any number of times and in any order, for the log
and for the filter; the noise in it must be the same every time. numpy's counter-based Philox
generator gives that without any memory: a stream's key comes from the seed and the stream's name, the
counter from the sample's number. Adding a stream changes no other.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from massprop_drake.maths.linear_algebra import Array

_BLOCK = 64  # samples drawn at a time; a matter of speed alone

Seed = int | tuple[int, int]  # of a run; and what was drawn to vary it


def vary_seed(seed: int, draw: float) -> Seed:
    """Makes a seed from a run's seed and a random draw; a draw of zero leaves the seed as it is."""
    return seed if draw == 0.0 else (seed, int(np.float64(draw).view(np.uint64)))


def stream_seed(seed: Seed, stream: str) -> np.random.SeedSequence:
    """Makes numpy's seed sequence for a named stream of random numbers of a run."""
    return np.random.SeedSequence(seed, spawn_key=tuple(stream.encode()))


@lru_cache(maxsize=256)
def _draw_block(seed: Seed, stream: str, number: int, size: int) -> Array:
    """Draws block ``number`` of a stream of standard normal numbers, shape (_BLOCK, size), read-only and cached."""
    key = stream_seed(seed, stream).generate_state(2, np.uint64)
    generator = np.random.Generator(np.random.Philox(key=key, counter=[0, number, 0, 0]))
    block = generator.standard_normal((_BLOCK, size))
    block.flags.writeable = False
    return block


def normal_sample(seed: Seed, stream: str, number: int, size: int) -> Array:
    """Draws the standard normal numbers of sample ``number`` (0, 1, ...) of a stream, shape (size,)."""
    block, row = divmod(number, _BLOCK)
    return _draw_block(seed, stream, block, size)[row]


def uniform_phase(seed: Seed, stream: str, size: int) -> Array:
    """Draws a run's quantizer phases, uniform in [-1/2, 1/2), shape (size,)."""
    return np.random.default_rng(stream_seed(seed, f"phase of {stream}")).uniform(-0.5, 0.5, size)


def uniform_sample(seed: Seed, stream: str, number: int) -> float:
    """Draws the uniform number in [0, 1) of sample ``number`` (0, 1, ...) of a stream."""
    key = stream_seed(seed, stream).generate_state(2, np.uint64)
    return float(np.random.Generator(np.random.Philox(key=key, counter=[0, number, 0, 0])).random())

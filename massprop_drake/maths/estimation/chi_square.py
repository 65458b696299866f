"""Thresholds of chi-square at a false-alarm rate, for whole degrees of freedom."""

from __future__ import annotations

import math
from functools import cache


@cache
def chi_square_limit(probability: float, degrees: int) -> float:
    """Computes the value that chi-square of some degrees of freedom exceeds with a given probability, by bisection.

    Args:
        probability: of the tail, above 1e-300 and below 1.
        degrees: of freedom, at least 1.
    """
    low, high = 0.0, 2.0 * degrees - 4.0 * math.log(probability)
    while True:
        middle = 0.5 * (low + high)
        if not low < middle < high:
            return middle
        low, high = (middle, high) if _tail_probability(middle, degrees) > probability else (low, middle)


def _tail_probability(value: float, degrees: int) -> float:
    """Computes the probability that chi-square of some degrees of freedom exceeds a value, 0 to 1."""
    half = 0.5 * value
    odd = degrees % 2
    tail = math.erfc(math.sqrt(half)) if odd else 0.0
    term = math.exp(-half) * (math.sqrt(half) * 2.0 / math.sqrt(math.pi) if odd else 1.0)
    for k in range(degrees // 2):
        tail += term
        term *= half / (k + 1.5 if odd else k + 1.0)
    return tail

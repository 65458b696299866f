"""What claims measure of signals, on signals of which the answer is known."""

from __future__ import annotations

import numpy as np
import pytest

from reproduction import measures

TIME_S = 0.08 * np.arange(6)
COMMAND = np.zeros((6, 44))
COMMAND[1:3, 0] = COMMAND[5, 0] = COMMAND[0:4, 7] = 1.0
RUN = {
    "time_s": TIME_S,
    "command": COMMAND,
    "truth": np.linspace(-2.0, -1.0, 6)[:, None] * np.ones(10),
    "estimate": np.linspace(-3.0, -1.5, 6)[:, None] * np.ones(10),
    "rotation_nis": np.array([[9.0], [1.0], [2.0], [3.0], [4.0], [9.0]]),
    "rotation_used": np.array([[0.0], [1.0], [1.0], [1.0], [1.0], [0.0]]),
}


def test_both_ends_of_a_time_count() -> None:
    np.testing.assert_array_equal(np.flatnonzero(measures.during(RUN, 0.16, 0.24)), [2, 3])
    assert measures.at(RUN, 0.24) == 3
    assert measures.at(RUN, 0.31) == 3


def test_errors_are_true_minus_estimate_of_the_first_truth() -> None:
    np.testing.assert_allclose(measures.percent_error(RUN)[0], np.full(10, 50.0))
    np.testing.assert_allclose(measures.final_percent(RUN), np.full(10, 25.0))
    np.testing.assert_allclose(measures.percent_at(RUN, 0.16), np.full(10, 40.0))


def test_only_samples_that_were_used_are_consistent_or_not() -> None:
    np.testing.assert_array_equal(measures.nis(RUN, "rotation"), [1.0, 2.0, 3.0, 4.0])
    np.testing.assert_array_equal(measures.nis(RUN, "rotation", 0.16, 0.24), [2.0, 3.0])
    assert measures.mean_nis("case", "rotation")({"case": RUN}) == 2.5


def test_firings_have_a_beginning_and_a_length() -> None:
    np.testing.assert_allclose(measures.on_starts_s(RUN), [0.08, 0.40, 0.0])
    np.testing.assert_allclose(measures.on_times_s(RUN), [0.16, 0.08, 0.32])
    np.testing.assert_allclose(measures.on_times_s(RUN, 0.05, 0.3), [0.16])


@pytest.mark.parametrize(("flags", "length"), [([], 0), ([0, 0], 0), ([1, 1, 0, 1, 1, 1], 3), ([1], 1)])
def test_the_longest_row(flags: list[int], length: int) -> None:
    assert measures.longest_row(np.array(flags, dtype=bool)) == length


def test_rms() -> None:
    assert measures.rms(np.array([3.0, -4.0, 0.0, 0.0])) == 2.5

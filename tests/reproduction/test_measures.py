"""What claims measure of signals, on signals of which the answer is known."""

from __future__ import annotations

import numpy as np

from reproduction import measures

COMMAND = np.zeros((6, 44))
COMMAND[1:3, 0] = COMMAND[5, 0] = COMMAND[0:4, 7] = 1.0
RUN = {
    "time_s": 0.08 * np.arange(6),
    "command": COMMAND,
    "truth": np.linspace(-2.0, -1.0, 6)[:, None] * np.ones(10),
    "estimate": np.linspace(-3.0, -1.5, 6)[:, None] * np.ones(10),
    "rotation_nis": np.array([[9.0], [1.0], [2.0], [3.0], [4.0], [9.0]]),
    "rotation_used": np.array([[0.0], [1.0], [1.0], [1.0], [1.0], [0.0]]),
}


def test_measures_of_signals() -> None:
    np.testing.assert_array_equal(np.flatnonzero(measures.during(RUN, 0.16, 0.24)), [2, 3])  # both ends count
    assert [measures.at(RUN, time_s) for time_s in (0.24, 0.31)] == [3, 3]
    # true minus estimate, of the first truth
    np.testing.assert_allclose(measures.percent_error(RUN)[0], np.full(10, 50.0))
    np.testing.assert_allclose(measures.percent_at(RUN), np.full(10, 25.0))
    np.testing.assert_allclose(measures.percent_at(RUN, 0.16), np.full(10, 40.0))
    np.testing.assert_array_equal(measures.nis(RUN, "rotation"), [1.0, 2.0, 3.0, 4.0])  # of samples that were used
    np.testing.assert_array_equal(measures.nis(RUN, "rotation", 0.16, 0.24), [2.0, 3.0])
    assert measures.mean_nis("case", "rotation")({"case": RUN}) == 2.5
    np.testing.assert_allclose(measures.firings(RUN), [[0.08, 0.40, 0.0], [0.16, 0.08, 0.32]])
    np.testing.assert_allclose(measures.firings(RUN, 0.05, 0.3), [[0.08], [0.16]])
    for flags, length in (([], 0), ([0, 0], 0), ([1, 1, 0, 1, 1, 1], 3), ([1], 1)):
        assert measures.longest_row(np.array(flags, dtype=bool)) == length
    assert measures.rms(np.array([3.0, -4.0, 0.0, 0.0])) == 2.5

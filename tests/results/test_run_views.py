"""A run as a notebook, pandas and xarray see it."""

from __future__ import annotations

import numpy as np
import pytest

from massprop_drake.display.page import summary_html
from massprop_drake.display.run import Run


def test_a_run_is_seen_in_notebooks_and_tables(short_run: Run) -> None:
    assert "orbiter: sample_maneuver" in summary_html(short_run)
    with pytest.raises(KeyError, match=r"no signal 'rates'; did you mean 'rate'\?"):
        short_run["rates"]
    frame, data = short_run.to_pandas(), short_run.to_xarray()
    np.testing.assert_array_equal(frame.index, short_run.time_s)
    np.testing.assert_array_equal(frame["rate"]["y"], short_run["rate"][:, 1])
    np.testing.assert_array_equal(frame["command"]["R4R"], short_run["command"][:, 28])
    assert data["force"].attrs["units"] == "lbf"
    np.testing.assert_array_equal(data["rate"].sel(rate_component="z"), short_run["rate"][:, 2])
    np.testing.assert_array_equal(data["time_s"], short_run.time_s)

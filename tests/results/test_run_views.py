"""A run as a notebook, pandas and xarray see it."""

from __future__ import annotations

import numpy as np
import pytest

from massprop_drake.results import table
from massprop_drake.results.run import Run


def test_a_notebook_shows_the_verdict_and_the_parameters(short_run: Run) -> None:
    html = short_run._repr_html_()
    assert "orbiter: sample_maneuver" in html
    row = table.parameters(short_run.results, short_run.scenario.vehicle_data.unit_names)[0]
    assert f"<td>{row.unit}</td><td>{row.estimate}</td><td>{row.sigma}</td>" in html
    assert "within 3 sigma of the truth" in html


def test_a_signal_that_is_none_is_told_by_its_name(short_run: Run) -> None:
    with pytest.raises(KeyError, match=r"no signal 'rates'; did you mean 'rate'\?"):
        short_run["rates"]
    np.testing.assert_array_equal(short_run["time_s"], short_run.time_s)


def test_signals_as_a_table_of_pandas(short_run: Run) -> None:
    frame = short_run.to_pandas()
    np.testing.assert_array_equal(frame.index, short_run.time_s)
    np.testing.assert_array_equal(frame["rate"]["y"], short_run["rate"][:, 1])
    np.testing.assert_array_equal(frame["command"]["R4R"], short_run["command"][:, 28])


def test_signals_as_a_dataset_of_xarray(short_run: Run) -> None:
    data = short_run.to_xarray()
    assert data["force"].attrs["units"] == "lbf"
    np.testing.assert_array_equal(data["rate"].sel(rate_component="z"), short_run["rate"][:, 2])
    np.testing.assert_array_equal(data["time_s"], short_run.time_s)


def test_a_long_run_is_thinned_to_rows_as_recorded(short_run: Run) -> None:
    assert short_run.shown() is short_run
    copies = 70
    time_s = np.arange(copies * short_run.time_s.size) * 0.08
    signals = {name: np.tile(values, (copies, 1)) for name, values in short_run.signals.items()}
    signals["rate"][4321, 1] = 0.5
    signals["gyro"][4321, 1] = 0.5
    long = Run(short_run.scenario, short_run.results, time_s, signals)
    shown = long.shown()
    assert shown.time_s.size < time_s.size
    assert shown.shown() is shown
    rows = np.searchsorted(time_s, shown.time_s)
    assert 4321 in rows
    for name in ("gyro", "estimate", "command"):
        np.testing.assert_array_equal(shown[name], signals[name][rows])

"""The description of each plot, against the signals that it is made from."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.special import chdtri

from massprop_drake import estimate, load_scenario, simulate
from massprop_drake.display import detector_plots as faults
from massprop_drake.display import filter_plots as filters
from massprop_drake.display import instruments, plots
from massprop_drake.display import motion_plots as motion
from massprop_drake.display.figures import Plots
from massprop_drake.display.flight3d import replay_html
from massprop_drake.display.page import report_html
from massprop_drake.display.plot_source import Source
from massprop_drake.display.run import Run
from massprop_drake.display.spec import Band, Bars, Level, Line, Panel, Plot, Points, SymmetricLog, Whiskers, Zone
from massprop_drake.results.table import derived_rows

MOTION = ["rates", "attitude_error", "velocities", "clusters", "jets", "torques", "forces", "phase_plane"]
FILTER = ["consistency", "innovations", "mass_innovations", "propellant"]
ESTIMATES = ["inverse_inertia_diagonal", "inverse_inertia_products", "center_of_mass", "mass_reciprocal"]
DETECTOR = ["likelihoods", "margins", "failure_magnitude", "detection_timeline"]
TRUE = ("truth", "thrust", "rate", "velocity", "torque", "force", "attitude", "position")
AUTOPILOT = ("hand_controllers", "attitude_error", "request", "selection_counts", "out_of_use")


@pytest.fixture(scope="module")
def stuck(stuck_run: Run) -> Source:
    return plots.source(stuck_run)


@pytest.fixture(scope="module")
def recorded(stuck: Source) -> Source:
    """The signals that a record of the run would give."""
    signals = {name: values for name, values in stuck.signals.items() if name not in {*TRUE, *AUTOPILOT}}
    scenario = stuck.scenario.model_copy(update={"failures": (), "maneuver": ()})
    return Source(stuck.time_s, signals, scenario)


def changed(source: Source, **signals: Any) -> Source:
    """The source with other signals; None: without."""
    there = {name: values for name, values in {**source.signals, **signals}.items() if values is not None}
    return source._replace(signals=there)


def marks(panel: Panel, kind: type) -> list:
    return [mark for mark in panel.marks if isinstance(mark, kind)]


def named(panel: Panel) -> list[str]:
    return [points.label for points in marks(panel, Points) if points.drawn]


def test_a_source_has_the_plots_of_its_signals_in_the_order_to_read_them(stuck: Source, recorded: Source) -> None:
    read = ["accelerometer_velocities", "gyro_readings", "clusters", "jets"]
    left = changed(stuck, mass_nis=None, likelihood=None)
    some = [*MOTION, *ESTIMATES[:-1], *FILTER]
    expected = [*MOTION, *ESTIMATES, *FILTER, *DETECTOR], [*read, *ESTIMATES, *FILTER, *DETECTOR], some
    for source, names in zip((stuck, recorded, left), expected, strict=True):
        found = plots.available_plots(source)
        assert list(found) == names
        assert [plot(source).name for plot in found.values()] == names


@pytest.mark.parametrize(
    ("name", "signal", "label", "scale", "steps"),
    [
        ("rates", "rate", "y, deg/s", 180.0 / np.pi, False),
        ("attitude_error", "attitude_error", "y, deg", 180.0 / np.pi, False),
        ("velocities", "velocity", "y, ft/s", 1.0, False),
        ("torques", "torque", "y, ft-lbf", 1.0, True),
        ("forces", "force", "y, lbf", 1.0, True),
    ],
)
def test_vectors_have_a_panel_per_axis_in_their_units(
    stuck: Source, name: str, signal: str, label: str, scale: float, steps: bool
) -> None:
    plot = plots.available_plots(stuck)[name](stuck)
    assert plot.panels[1].axis_label == label
    for axis, panel in enumerate(plot.panels):
        (line,) = panel.marks
        assert line.x is plot.time_s
        assert line.steps == steps
        np.testing.assert_allclose(line.y, scale * stuck.signals[signal][:, axis], rtol=1e-14)


def test_a_firing_is_a_bar_in_the_row_of_its_jet(stuck: Source, recorded: Source) -> None:
    (panel,), vehicle = motion.jets(stuck).panels, stuck.vehicle
    command = stuck.signals["command"][:-1] > 0.0
    bars = {label: [one for one in marks(panel, Bars) if one.label == label] for label in ("commanded", "thrust")}
    length = sum((one.end - one.begin).sum() for one in bars["commanded"])
    assert length == pytest.approx(command.sum() * 0.08, rel=1e-9)
    begins = command & ~np.vstack([np.zeros_like(command[:1]), command[:-1]])
    assert sum(one.begin.size for one in bars["commanded"]) == begins.sum() < command.sum()  # one a firing
    assert sorted(panel.rows) == sorted(f"{jet.designation} ({jet.cluster})" for jet in vehicle.jets)
    for label, signal in (("commanded", "command"), ("thrust", "thrust")):
        on = (stuck.signals[signal][:-1] > 0.0).any(axis=0)
        rows = {panel.rows[round(row)].split()[0] for one in bars[label] for row in one.row}
        assert rows | {"R4R"} == {jet for jet, fires in zip(vehicle.designations, on, strict=True) if fires} | {"R4R"}
    # the jet that is stuck, which nobody commands, has a row beside its cluster's; a hundredth of it is a bar, too
    jet = vehicle.jet_index("R4R")
    for share in (1.0, 0.01):
        thrust = stuck.signals["thrust"] * np.where(np.arange(44) == jet, share, 1.0)
        (panel,) = motion.clusters(changed(stuck, thrust=thrust)).panels
        assert panel.rows == ("jet R4R", *(f"cluster {number}" for number in range(1, 15)))
        (untold,) = (bars for bars in marks(panel, Bars) if bars.label == "thrust untold")
        assert np.round(untold.row).astype(int).tolist() == [0, 12]
        np.testing.assert_allclose(untold.begin, 1.0, atol=0.081)  # the first whole sample
        np.testing.assert_allclose(untold.end, stuck.time_s[-1])
    verdict = np.zeros_like(stuck.signals["command"])
    verdict[50, vehicle.jet_index("F2R")] = 1.0
    assert "jet F2R" in motion.clusters(changed(recorded, verdict=verdict)).panels[0].rows


def test_what_a_row_commands_lasts_until_the_next_row_that_is_there(stuck: Source) -> None:
    command = np.zeros((6, 44))
    command[[1, 2, 4, 5], 0] = 1.0
    time_s = np.array([0.0, 1.0, 2.0, 7.0, 8.0, 9.0])
    few = {name: values[:6] for name, values in stuck.signals.items()}
    source = changed(stuck._replace(time_s=time_s, signals=few), command=command, thrust=None)
    (bars,) = (one for one in marks(motion.jets(source).panels[0], Bars) if one.begin.size)
    np.testing.assert_array_equal(bars.begin, [1.0, 8.0])
    np.testing.assert_array_equal(bars.end, [7.0, 9.0])  # the last row commands nothing


def test_propellant_is_what_the_summary_says(stuck: Source, stuck_run: Run) -> None:
    (line,) = motion.propellant(stuck).panels[0].marks
    assert line.y[-1] == pytest.approx(stuck_run.results.autopilot.propellant_mass, rel=1e-9)
    assert (np.diff(line.y) >= 0.0).all()


def test_the_autopilot_acts_where_the_phase_plane_says(stuck: Source) -> None:
    """No translation is asked for: an axis in hold beyond the dashed lines asks for a correction, and only such do."""
    held = np.ones(stuck.time_s.size, dtype=bool)
    beyond = np.zeros_like(held)
    for axis, panel in enumerate(motion.phase_plane(stuck).panels):
        path, wanted, low, high = marks(panel, Line)
        rate = np.degrees(stuck.signals["gyro"][:, axis])
        np.testing.assert_allclose(path.y, np.where(np.isnan(path.x), np.nan, rate))
        held &= np.isfinite(path.x)
        beyond |= (path.y > np.interp(path.x, high.x, high.y)) | (path.y < np.interp(path.x, low.x, low.y))
        np.testing.assert_allclose(0.5 * (low.y + high.y), wanted.y, atol=1e-15)
    asks = stuck.signals["request"][:, 7] > 0.0
    assert 0 < beyond[held].sum() < held.sum()
    np.testing.assert_array_equal(asks[held], beyond[held])
    moving = stuck.scenario.maneuver[0].model_copy(update={"controller": "thc"})
    moved = stuck._replace(scenario=stuck.scenario.model_copy(update={"maneuver": (moving,)}))
    *_, low, high = marks(motion.phase_plane(moved).panels[0], Line)  # a translation has switching lines of its own
    np.testing.assert_allclose(high.y - low.y, 2.0 * np.degrees(stuck.scenario.autopilot.resolve_rate))


@pytest.mark.parametrize(("name", "scale"), [("rotation", 180.0 / np.pi), ("mass", 1.0)])
def test_innovations_show_the_usual_band_whatever_some_of_them_are(stuck: Source, name: str, scale: float) -> None:
    plot = {"rotation": filters.innovations, "mass": filters.mass_innovations}[name]
    rows = np.flatnonzero(stuck.signals[f"{name}_used"][:, 0])
    innovation, sigma = (stuck.signals[f"{name}_innovation{what}"] for what in ("", "_std"))
    panel = plot(stuck).panels[1]
    (points, *_), (band,) = marks(panel, Points), marks(panel, Whiskers)
    np.testing.assert_allclose(points.y, scale * innovation[rows, 1], rtol=1e-14)
    np.testing.assert_allclose(band.high, 3.0 * scale * sigma[rows, 1], rtol=1e-14)
    np.testing.assert_array_equal(band.low, -band.high)
    far = innovation.copy()
    far[rows[::3], 1] = 1e3 * np.where(np.arange(rows[::3].size) % 2, 1.0, -1.0)  # a third is far off
    panel = plot(changed(stuck, **{f"{name}_innovation": far})).panels[1]
    points, up, down = marks(panel, Points)
    assert panel.most
    assert panel.limits is not None
    assert np.median(band.high) < panel.limits[1] < 10.0 * np.median(band.high)
    beyond = np.abs(points.y) > panel.limits[1]
    assert sorted([*up.x, *down.x]) == sorted(points.x[beyond])
    assert (up.label, up.symbol, down.symbol) == (f"{beyond.sum()} beyond the axis", "up", "down")
    assert (points.y[np.isin(points.x, up.x)] > 0.0).all()
    assert 0.9 * panel.limits[1] < up.y[0] < panel.limits[1]
    bare = plot(changed(stuck, **{f"{name}_innovation_std": None})).panels[0]
    assert {type(mark) for mark in bare.marks} == {Points}


def test_errors_are_in_percent_of_the_truth_within_three_sigma(stuck: Source, recorded: Source) -> None:
    panel, truth = filters.center_of_mass(stuck).panels[0], stuck.signals["truth"]
    (band,), (line,) = marks(panel, Band), marks(panel, Line)
    estimate, sigma = stuck.signals["estimate"], stuck.signals["standard_deviation"]
    assert panel.axis_label == "x_cm, %"
    np.testing.assert_allclose(line.y, 100.0 * (estimate[:, 6] / truth[:, 6] - 1.0), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(band.high, 300.0 * sigma[:, 6] / truth[:, 6], rtol=1e-12)
    np.testing.assert_array_equal(band.low, -band.high)
    assert line.label == f"error, at the end {line.y[-1]:.3g} %"
    assert panel.scale == SymmetricLog(band.high[-1], max(np.abs(line.y).max(), band.high.max()))
    zero = truth * (np.arange(10) != 7)  # in its unit
    panel = filters.center_of_mass(changed(stuck, truth=zero)).panels[1]
    assert panel.unit == "ft"
    np.testing.assert_array_equal(marks(panel, Line)[0].y, estimate[:, 7])
    plot = filters.mass_reciprocal(recorded)  # without the truth: the estimate
    (panel,) = plot.panels
    (band,), (line,) = marks(panel, Band), marks(panel, Line)
    assert (plot.title, panel.axis_label, panel.scale) == ("Mass reciprocal: estimate", "1/m, 1/slug", "linear")
    np.testing.assert_array_equal(line.y, estimate[:, 9])
    np.testing.assert_allclose(band.high - line.y, 3.0 * sigma[:, 9], rtol=1e-9)
    assert panel.limits is not None
    assert panel.limits[0] < line.y.min() < band.high[-1] < panel.limits[1]


def test_nis_is_shown_where_it_was_used_beside_its_limits(stuck: Source) -> None:
    panel = filters.consistency(stuck).panels[0]
    (zone,), (points,) = marks(panel, Zone), marks(panel, Points)
    used = stuck.signals["rotation_used"][:, 0] != 0.0
    np.testing.assert_array_equal(points.x, stuck.time_s[used])
    np.testing.assert_array_equal(points.y, stuck.signals["rotation_nis"][used, 0])
    within = points.y[points.y < chdtri(3, 0.01)].mean()  # without those of the jet until it is declared
    assert points.label == f"NIS, mean {within:.2f} ({points.y.mean():.4g} with those beyond 99 %)"
    assert panel.scale == "log"
    np.testing.assert_allclose((zone.low, zone.high), chdtri(3, [0.975, 0.025]), rtol=1e-14)
    quiet = changed(stuck, rotation_nis=np.full((stuck.time_s.size, 1), 2.5))
    means = {"rotation_nis_mean": 2.5, "rotation_nis_within": 2.4, "rotation_nis_beyond": 0.01}
    thinned = stuck._replace(consistency=means)
    labels = [marks(panel, Points)[0].label for one in (quiet, thinned) for panel in filters.consistency(one).panels]
    assert labels[0] == f"NIS, mean 2.50 of {used.sum()} samples"
    assert labels[2:] == ["NIS, mean 2.50 of all samples used", "NIS, no sample used"]


def test_the_likeliest_jets_have_colors_and_the_others_their_range(stuck: Source) -> None:
    panel, of_clusters = faults.likelihoods(stuck).panels
    tested = stuck.signals["tested"][:, 0] != 0.0
    likelihood, jets = stuck.signals["likelihood"], stuck.vehicle.designations
    values = np.maximum(likelihood[tested], 0.1)
    every, (others,) = marks(panel, Points), marks(panel, Whiskers)
    assert len(every) == 44  # all are there to be read
    top = [points for points in every if points.drawn]
    columns = [jets.index(points.label) for points in top]
    assert (len(top), top[-1].label) == (5, "R4R")  # on top
    for column, points in zip(columns, top, strict=True):
        np.testing.assert_array_equal(points.y, values[:, column])
    rest = np.delete(values, columns, axis=1)
    np.testing.assert_array_equal(others.low, rest.min(axis=1))
    np.testing.assert_array_equal(others.high, rest.max(axis=1))
    assert values[:, columns].max(axis=0).min() >= rest.max()
    assert panel.limits == (0.1, pytest.approx(2.0 * values.max()))
    last, members = marks(of_clusters, Points)[-1], [jet.cluster == 12 for jet in stuck.vehicle.jets]
    assert last.label == "cluster 12"
    np.testing.assert_array_equal(last.y, values[:, members].max(axis=1))
    unknown = likelihood.copy()
    unknown[np.flatnonzero(tested)[0]] = np.nan  # what the detector does not judge hides nobody
    assert "R4R" in named(faults.likelihoods(changed(stuck, likelihood=unknown)).panels[0])
    # a jet that was declared off has no known force, and others may come ahead of it at another time
    jet = stuck.vehicle.jet_index("F2R")
    behind = np.where(np.arange(44) == jet, 1.0, likelihood)
    suspect = np.where(stuck.signals["detector_event"] == 1.0, jet, stuck.signals["suspected_jet"])
    nothing = {"known_force_variance": 0.0 * likelihood}
    off = changed(stuck, likelihood=behind, suspected_jet=suspect, **nothing)
    assert named(faults.likelihoods(off).panels[0])[-1] == "F2R"
    none = changed(stuck, tested=np.zeros_like(stuck.signals["tested"]))
    assert [panel.marks for panel in faults.likelihoods(none).panels] == [(), ()]
    assert marks(faults.margins(none).panels[0], Points)[0].x.size == 0


def probable(source: Source, **jets: float) -> Source:
    """A run whose detector gives probabilities: of each jet from the tenth row to the twentieth."""
    of_jets = np.zeros((len(source.time_s), 44))
    for jet, probability in jets.items():
        of_jets[10:20, source.vehicle.jet_index(jet)] = probability
    unknown = np.full((len(source.time_s), 1), 0.002)
    none = 1.0 - of_jets.max(axis=1, keepdims=True)
    return changed(source, fault_probability=of_jets, none_probability=none, unknown_probability=unknown)


def test_probabilities_stand_in_place_of_likelihoods(stuck: Source) -> None:
    source = probable(stuck, R4R=0.9, F1U=0.02, L2D=0.009)
    assert list(plots.available_plots(source))[-len(DETECTOR) :] == ["fault_probabilities", *DETECTOR[1:]]
    of_poses = changed(stuck, none_probability=np.full((len(stuck.time_s), 1), np.nan))
    assert list(plots.available_plots(of_poses))[-len(DETECTOR) :] == DETECTOR
    of_jets, others = faults.fault_probabilities(source).panels
    lines = marks(of_jets, Line)
    assert [line.label for line in lines] == ["R4R, at the end 0", "F1U, at the end 0"]  # that were ever probable
    np.testing.assert_array_equal(lines[0].y, source.signals["fault_probability"][:, 28])
    labels = [line.label for line in marks(others, Line)]
    assert labels == ["none, at the end above 0.9999", "unknown, at the end 0.002"]
    names = ("R4R", "F1U", "L2D", "L4D", "R1U", "F3U", "F2U")
    many = probable(stuck, **{jet: 0.5 - 0.05 * number for number, jet in enumerate(names)})
    panel = faults.fault_probabilities(many).panels[0]
    assert [line.label.partition(",")[0] for line in marks(panel, Line)] == list(names[:5])
    (rest,) = marks(panel, Whiskers)
    assert (rest.low[15], rest.high[15]) == (pytest.approx(0.2), pytest.approx(0.25))
    assert [points.label for points in marks(panel, Points)] == list(names[5:])
    assert len(faults.fault_probabilities(probable(stuck, R4R=0.005)).panels) == 1  # nothing and unknown are left


def test_margins_and_magnitude_are_shown_beside_what_isolates_and_what_is_true(stuck: Source) -> None:
    panel = faults.margins(stuck).panels[1]
    (level,), (points,) = marks(panel, Level), marks(panel, Points)
    tested = stuck.signals["tested"][:, 0] != 0.0
    assert level.y == stuck.scenario.detector.margin
    np.testing.assert_array_equal(points.y, np.maximum(stuck.signals["cluster_margin"][tested, 0], 0.1))
    (panel,) = faults.failure_magnitude(stuck).panels
    (points,), (spread,) = marks(panel, Points), marks(panel, Whiskers)
    alarm = stuck.signals["alarm"][:, 0] != 0.0
    np.testing.assert_array_equal(points.y, stuck.signals["suspected_magnitude"][alarm, 0])
    np.testing.assert_allclose(spread.high - points.y, stuck.signals["suspected_magnitude_std"][alarm, 0], rtol=1e-6)
    truth, known = marks(panel, Line)
    assert (truth.label, known.label, panel.unit) == ("truth of R4R", "known force of R4R", "lbf")
    jet = stuck.vehicle.jet_index("R4R")
    given = stuck.signals["thrust"][:, jet] - 868.8 * stuck.signals["command"][:, jet]
    np.testing.assert_allclose(truth.y, given, atol=1e-6)
    assert truth.y[-2] == pytest.approx(known.y[-1], rel=1e-3)
    assert np.isnan(known.y[0])
    (panel,) = faults.failure_magnitude(changed(stuck, alarm=np.zeros_like(stuck.signals["alarm"]))).panels
    assert "truth of R4R" in [mark.label for mark in panel.marks]  # without an alarm, too
    assert not marks(panel, Points)


def test_the_timeline_has_tests_alarms_and_the_jets_commanded(stuck: Source) -> None:
    unsaid = np.where(np.arange(stuck.time_s.size) == 9, 1.0, np.nan)[:, None]
    for source in (stuck, changed(stuck, jet_isolated=unsaid)):
        rate, commanded, events = faults.detection_timeline(source).panels
        assert [line.label for line in rate.marks] == ["x", "y", "z"]
        count = (stuck.signals["command"] > 0.0).sum(axis=1)
        np.testing.assert_array_equal(marks(commanded, Band)[0].high, count)
        assert events.rows == ("tested", "alarm", "names the jet")
        for row, name in enumerate(("tested", "alarm", "jet_isolated")):
            there = np.nan_to_num(source.signals[name][:, 0]) != 0.0
            np.testing.assert_array_equal(events.marks[row].x, stuck.time_s[there])
            assert set(events.marks[row].y.tolist()) == {row}


def test_every_plot_says_whose_it_is_and_what_happened_when(stuck: Source, recorded: Source, stuck_run: Run) -> None:
    plot = motion.rates(stuck)
    assert plot.caption == "orbiter, stuck_on_29, seed 0"
    assert [tuple(window) for window in plot.windows] == [(0.2, 0.8, "RHC +x", True)]
    happens, *declared = plot.moments
    assert happens == (1.0, False)
    times = [entry.time_s for entry in stuck_run.results.detections]
    assert [tuple(moment) for moment in declared] == [(time_s, True) for time_s in times]
    assert plot.note == "shaded: hand controller out of detent, dotted: it happens, red line: it is declared"
    plot = motion.gyro_readings(recorded)
    assert (plot.caption, plot.windows, plot.note) == ("orbiter, stuck_on_29", (), "red line: it is declared")
    until = stuck.time_s <= 0.16
    signals = {name: values[until] for name, values in stuck.signals.items()}
    plot = motion.rates(stuck._replace(time_s=stuck.time_s[until], signals=signals))
    assert (plot.windows, plot.moments, plot.note) == ((), (), "")
    late = np.where(stuck.time_s[:, None] >= 2.0, stuck.signals["tested"], 0.0)
    unarmed, _ = motion.rates(changed(stuck, tested=late)).windows
    first_s = stuck.time_s[np.flatnonzero(late[:, 0])[0]]
    assert (unarmed.start_s, unarmed.end_s, unarmed.armed) == (0.0, first_s, False)


@pytest.fixture(scope="module")
def tracked() -> Run:
    """A vehicle in a plane that is followed by motion capture: no gyro, and most parameters fixed."""
    return simulate(load_scenario("air_bearing_pulses", ["duration_s=1"]))


def test_what_a_vehicle_in_a_plane_cannot_do_has_no_panel(tracked: Run) -> None:
    source = plots.source(tracked)
    found = plots.available_plots(source)
    assert not {"inverse_inertia_products", "innovations", "phase_plane", "gyro_readings", "clusters"} & set(found)
    shown: dict[str, Plot] = {name: plot(source) for name, plot in found.items()}
    axes = {"rates": "z", "torques": "z", "velocities": "xy", "forces": "xy", "positions": "xy"}
    for name, letters in axes.items():
        assert "".join(panel.label for panel in shown[name].panels) == letters
    assert [panel.label for panel in shown["inverse_inertia_diagonal"].panels] == ["Izz⁻¹"]
    assert shown["jets"].panels[0].rows == tracked.scenario.vehicle_data.designations
    assert not shown["jets"].folded
    assert (len(shown["likelihoods"].panels), len(shown["center_of_mass"].panels)) == (1, 2)
    panels = shown["surroundings"].panels
    assert [panel.label for panel in panels][:3] == ["delay of commands", "drag", "angular drag"]
    (line,), (band,) = marks(panels[0], Line), marks(panels[0], Band)
    np.testing.assert_array_equal(line.y, tracked["command_delay"][:, 0])
    np.testing.assert_allclose(band.high - line.y, 3.0 * tracked["command_delay_std"][:, 0], atol=1e-15)
    assert np.isnan(instruments.columns(tracked)["apart"]).all()


def test_a_record_without_gyro_has_pictures_pages_and_a_table(tracked: Run, tmp_path: Path) -> None:
    folder = tracked.save(tmp_path / "run", pictures=False, report=False)
    record = estimate(folder / "telemetry.csv", tracked.scenario)
    source = plots.source(record)
    drawn = {name for name, figure in Plots(source).all().items() if figure.axes}
    assert {"detection_timeline", "thrust_factors", "positions"} <= drawn
    (turning,) = faults.detection_timeline(source).panels[0].marks  # about the only axis there is
    np.testing.assert_allclose(turning.y, np.degrees(record["rate_estimate"][:, 2]))  # type: ignore[union-attr]
    assert "Izz" in report_html(record)
    assert "</html>" in replay_html(record)
    rows = {row.symbol: row for row in derived_rows(record.results, record.scenario.vehicle_data.unit_names)}
    assert (rows["Ixx"].sigma, rows["Ixx"].percent) == ("-", "-")  # is fixed
    assert rows["Izz"].sigma != "-"
    again = Run.load(record.save(tmp_path / "record", pictures=False, report=False))
    np.testing.assert_array_equal(again["mocap"], record["mocap"])


def test_signals_of_ones_own_are_shown(stuck: Source, recorded: Source) -> None:
    mine = 1.01 * stuck.signals["truth"]
    mine[:, 9] = np.nan
    for source, shown in ((stuck, 1.0), (recorded, mine[:, 0])):
        more = changed(source, **{"mine.estimate": mine})
        own = [line for line in marks(filters.inverse_inertia_diagonal(more).panels[0], Line) if "mine" in line.label]
        np.testing.assert_allclose(own[0].y, shown)  # the error in percent, or the estimate
        assert "own_signals" not in plots.available_plots(more)
        assert len(marks(filters.mass_reciprocal(more).panels[0], Line)) == 1  # which it does not estimate
    rate = stuck.signals["rate"]
    others = {"mine.pair": rate[:, :2], "mine.long": np.ones((len(rate), 40)), "against.gyro": rate}
    source = changed(stuck, **others)
    (panel,) = plots.available_plots(source)["own_signals"](source).panels
    assert (panel.label, [line.label for line in marks(panel, Line)]) == ("mine.pair", ["0", "1"])

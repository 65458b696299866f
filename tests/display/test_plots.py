"""The description of each plot, against the signals that it is made from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.special import chdtri

from massprop_drake import load_scenario, simulate
from massprop_drake.display import instruments, plots
from massprop_drake.display.figures import drawn
from massprop_drake.display.page import report_html
from massprop_drake.display.plots import Source
from massprop_drake.display.spec import Band, Bars, Level, Line, Panel, Points, SymmetricLog, Whiskers, Zone
from massprop_drake.results.run import Run

MOTION = ["rates", "attitude_error", "velocities", "clusters", "jets", "torques", "forces", "phase_plane"]
FILTER = ["consistency", "innovations", "mass_innovations", "propellant"]
ESTIMATES = ["inverse_inertia_diagonal", "inverse_inertia_products", "center_of_mass", "mass_reciprocal"]
DETECTOR = ["likelihoods", "margins", "failure_magnitude", "detection_timeline"]
TRUE = ("truth", "thrust", "rate", "velocity", "torque", "force", "attitude", "position")
AUTOPILOT = ("hand_controllers", "attitude_error", "request", "selection_counts", "out_of_use")


@dataclass(frozen=True)
class Case:
    """A run and its source."""

    run: Run
    source: Source


@pytest.fixture(scope="module")
def stuck(stuck_run: Run) -> Case:
    return Case(stuck_run, plots.source(stuck_run))


@pytest.fixture(scope="module")
def recorded(stuck_run: Run) -> Source:
    """The signals that a record of the run would give."""
    unread = {*TRUE, *AUTOPILOT}
    signals = {name: values for name, values in stuck_run.signals.items() if name not in unread}
    scenario = stuck_run.scenario.model_copy(update={"failures": (), "maneuver": ()})
    return Source(stuck_run.time_s, signals, scenario)


def marks(panel: Panel, kind: type) -> list:
    return [mark for mark in panel.marks if isinstance(mark, kind)]


def test_a_simulation_has_every_plot_in_the_order_to_read_them(stuck: Case) -> None:
    assert list(plots.available(stuck.source)) == [*MOTION, *ESTIMATES, *FILTER, *DETECTOR]


def test_a_record_shows_what_was_read_in_place_of_the_truth(recorded: Source) -> None:
    read = ["accelerometer_velocities", "gyro_readings", "clusters", "jets"]
    assert list(plots.available(recorded)) == [*read, *ESTIMATES, *FILTER, *DETECTOR]


def test_plots_without_their_signals_are_left_out(stuck: Case) -> None:
    signals = {name: v for name, v in stuck.run.signals.items() if name not in ("mass_nis", "likelihood")}
    left = plots.available(stuck.source._replace(signals=signals))
    assert "mass_reciprocal" not in left
    assert not set(DETECTOR) & set(left)


@pytest.mark.parametrize("which", ["stuck", "recorded"])
def test_a_plot_carries_the_name_it_is_asked_for_by(which: str, request: pytest.FixtureRequest) -> None:
    case = request.getfixturevalue(which)
    source = case if isinstance(case, Source) else case.source
    for name, plot in plots.available(source).items():
        assert plot(source).name == name


# ------------------------------------------------------------------------------------------ motion


def test_rates_are_in_degrees_a_panel_per_axis(stuck: Case) -> None:
    plot = plots.rates(stuck.source)
    assert [panel.axis_label for panel in plot.panels] == ["x, deg/s", "y, deg/s", "z, deg/s"]
    for axis, panel in enumerate(plot.panels):
        (line,) = panel.marks
        assert line.x is plot.time_s
        np.testing.assert_allclose(line.y, np.degrees(stuck.run["rate"][:, axis]), rtol=1e-14)


@pytest.mark.parametrize(
    ("name", "signal", "label", "steps"),
    [
        ("velocities", "velocity", "y, ft/s", False),
        ("torques", "torque", "y, ft-lbf", True),
        ("forces", "force", "y, lbf", True),
    ],
)
def test_vectors_are_in_the_vehicles_units(stuck: Case, name: str, signal: str, label: str, steps: bool) -> None:
    panel = plots.available(stuck.source)[name](stuck.source).panels[1]
    assert panel.axis_label == label
    np.testing.assert_array_equal(panel.marks[0].y, stuck.run[signal][:, 1])
    assert panel.marks[0].steps == steps


def test_every_package_has_its_readings(recorded: Source) -> None:
    plot = plots.accelerometer_velocities(recorded)
    assert [mark.label for mark in plot.panels[0].marks] == ["acc1", "acc2", "acc3"]
    np.testing.assert_array_equal(plot.panels[2].marks[1].y, recorded.signals["acc2"][:, 2])
    assert plot.panels[0].axis_label == "x, ft/s"
    (gyro,) = plots.gyro_readings(recorded).panels[2].marks
    np.testing.assert_allclose(gyro.y, np.degrees(recorded.signals["gyro"][:, 2]), rtol=1e-14)


def test_a_firing_is_one_bar_from_its_beginning_to_its_end(stuck: Case) -> None:
    (panel,) = plots.jets(stuck.source).panels
    command = stuck.run["command"][:-1] > 0.0
    told = [bars for bars in marks(panel, Bars) if bars.label == "commanded"]
    length = sum((bars.end - bars.begin).sum() for bars in told)
    assert length == pytest.approx(command.sum() * 0.08, rel=1e-9)
    # a bar per firing, not per sample
    begins = command & ~np.vstack([np.zeros_like(command[:1]), command[:-1]])
    assert sum(bars.begin.size for bars in told) == begins.sum() < command.sum()


def test_a_bar_lies_in_the_row_of_its_jet(stuck: Case) -> None:
    (panel,) = plots.jets(stuck.source).panels
    jets = stuck.run.scenario.vehicle_data.jets
    assert sorted(panel.rows) == sorted(f"{jet.designation} ({jet.cluster})" for jet in jets)

    def in_rows(label: str) -> set[str]:
        shown = [bars for bars in marks(panel, Bars) if bars.label == label]
        return {panel.rows[round(row)].split()[0] for bars in shown for row in bars.row}

    for label, signal in (("commanded", "command"), ("thrust", "thrust")):
        on = (stuck.run[signal][:-1] > 0.0).any(axis=0)
        expected = {jet.designation for jet, fires in zip(jets, on, strict=True) if fires}
        assert in_rows(label) == (expected if label == "commanded" else expected - {"R4R"})
    assert in_rows("thrust untold") == {"R4R"}  # which nobody commands


def test_a_jet_that_is_stuck_has_a_row_of_its_own_beside_the_clusters(stuck: Case) -> None:
    (panel,) = plots.clusters(stuck.source).panels
    assert panel.rows == ("jet R4R", *(f"cluster {number}" for number in range(1, 15)))
    (untold,) = (bars for bars in marks(panel, Bars) if bars.label == "thrust untold")
    assert np.round(untold.row).astype(int).tolist() == [0, 12]
    np.testing.assert_allclose(untold.begin, 1.04, atol=0.08)  # the first whole sample
    np.testing.assert_allclose(untold.end, stuck.run.time_s[-1])


def test_propellant_is_what_the_summary_says(stuck: Case) -> None:
    (line,) = plots.propellant(stuck.source).panels[0].marks
    assert line.y[-1] == pytest.approx(stuck.run.results.autopilot.propellant_mass, rel=1e-9)
    assert (np.diff(line.y) >= 0.0).all()


def test_innovations_are_those_of_the_samples_used_with_their_own_three_sigma(stuck: Case) -> None:
    for name, plot, scale in (("rotation", plots.innovations, 180.0 / np.pi), ("mass", plots.mass_innovations, 1.0)):
        used = stuck.run[f"{name}_used"][:, 0] != 0.0
        panel = plot(stuck.source).panels[1]
        (points, *_), (band,) = marks(panel, Points), marks(panel, Whiskers)
        np.testing.assert_allclose(points.y, scale * stuck.run[f"{name}_innovation"][used, 1], rtol=1e-14)
        np.testing.assert_allclose(band.high, 3.0 * scale * stuck.run[f"{name}_innovation_std"][used, 1], rtol=1e-14)
        np.testing.assert_array_equal(band.low, -band.high)
        # by the whole covariance, each component is at most as far off as all of them together
        share = stuck.run[f"{name}_innovation"] / stuck.run[f"{name}_innovation_std"]
        assert (share[used] ** 2 <= stuck.run[f"{name}_nis"][used] * (1.0 + 1e-9)).all()


def test_innovations_show_the_usual_band_whatever_some_of_them_are(stuck: Case) -> None:
    used = np.flatnonzero(stuck.run["rotation_used"][:, 0])
    value = stuck.run["rotation_innovation"].copy()
    value[used[::3], 1] = 1e3 * np.where(np.arange(used[::3].size) % 2, 1.0, -1.0)  # a third is far off
    panel = plots.innovations(
        stuck.source._replace(signals={**stuck.run.signals, "rotation_innovation": value})
    ).panels[1]
    (points, up, down), (band,) = marks(panel, Points), marks(panel, Whiskers)
    usual = np.median(band.high)
    assert panel.most
    assert panel.limits is not None
    assert usual < panel.limits[1] < 10.0 * usual
    beyond = np.abs(points.y) > panel.limits[1]
    assert sorted([*up.x, *down.x]) == sorted(points.x[beyond])
    assert up.label == f"{beyond.sum()} beyond the axis"
    assert (up.symbol, down.symbol) == ("up", "down")
    assert (points.y[np.isin(points.x, up.x)] > 0.0).all()
    assert 0.9 * panel.limits[1] < up.y[0] < panel.limits[1]


def test_innovations_of_a_run_without_their_sigma_have_no_band(stuck: Case) -> None:
    signals = {name: value for name, value in stuck.run.signals.items() if not name.endswith("innovation_std")}
    panel = plots.innovations(stuck.source._replace(signals=signals)).panels[0]
    assert {type(mark) for mark in panel.marks} == {Points}


def test_the_autopilot_acts_where_the_phase_plane_says(stuck: Case) -> None:
    """No translation is asked for: an axis in hold beyond the dashed lines asks for a correction, and only such do."""
    panels = plots.phase_plane(stuck.source).panels
    held = np.ones(stuck.run.time_s.size, dtype=bool)
    beyond = np.zeros_like(held)
    for axis, panel in enumerate(panels):
        path, wanted, low, high = marks(panel, Line)
        np.testing.assert_allclose(path.y, np.where(np.isnan(path.x), np.nan, np.degrees(stuck.run["gyro"][:, axis])))
        assert path.y[np.isfinite(path.y)].size
        held &= np.isfinite(path.x)
        beyond |= (path.y > np.interp(path.x, high.x, high.y)) | (path.y < np.interp(path.x, low.x, low.y))
        np.testing.assert_allclose(0.5 * (low.y + high.y), wanted.y, atol=1e-15)
    asks = stuck.run["request"][:, 7] > 0.0
    assert beyond[held].any()
    assert not beyond[held].all()
    np.testing.assert_array_equal(asks[held], beyond[held])


def test_a_translation_has_switching_lines_of_its_own(stuck: Case) -> None:
    moving = stuck.run.scenario.maneuver[0].model_copy(update={"controller": "thc"})
    source = stuck.source._replace(scenario=stuck.run.scenario.model_copy(update={"maneuver": (moving,)}))
    *_, low, high = marks(plots.phase_plane(source).panels[0], Line)
    resolve_rate = np.degrees(stuck.run.scenario.autopilot.resolve_rate)
    np.testing.assert_allclose(high.y - low.y, 2.0 * resolve_rate)


def test_when_the_detector_is_not_armed_is_a_window(stuck: Case) -> None:
    late = np.where(stuck.run.time_s[:, None] >= 2.0, stuck.run["tested"], 0.0)
    unarmed, _ = plots.rates(stuck.source._replace(signals={**stuck.run.signals, "tested": late})).windows
    assert (unarmed.start_s, unarmed.armed) == (0.0, False)
    assert unarmed.end_s == stuck.run.time_s[np.flatnonzero(late[:, 0])[0]]


def test_what_a_row_commands_lasts_until_the_next_row_that_is_there() -> None:
    on = np.array([False, True, True, False, True, True])
    begin, end = plots._intervals(np.array([0.0, 1.0, 2.0, 7.0, 8.0, 9.0]), on)
    np.testing.assert_array_equal(begin, [1.0, 8.0])
    np.testing.assert_array_equal(end, [7.0, 9.0])  # the last row commands nothing


# --------------------------------------------------------------------------------------- estimates


def test_errors_are_in_percent_of_the_truth_within_three_sigma(stuck: Case) -> None:
    run, panel = stuck.run, plots.center_of_mass(stuck.source).panels[0]
    truth = run["truth"][:, 6]
    (band,), (line,) = marks(panel, Band), marks(panel, Line)
    assert panel.axis_label == "x_cm, %"
    np.testing.assert_allclose(line.y, 100.0 * (run["estimate"][:, 6] / truth - 1.0), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(band.high, 300.0 * run["standard_deviation"][:, 6] / truth, rtol=1e-12)
    np.testing.assert_array_equal(band.low, -band.high)
    assert line.label == f"error, at the end {line.y[-1]:.3g} %"
    assert panel.scale == SymmetricLog(band.high[-1], max(np.abs(line.y).max(), band.high.max()))


def test_the_error_of_a_parameter_that_is_zero_has_its_own_unit(stuck: Case) -> None:
    signals = dict(stuck.run.signals)
    signals["truth"] = signals["truth"].copy()
    signals["truth"][:, 7] = 0.0
    panel = plots.center_of_mass(stuck.source._replace(signals=signals)).panels[1]
    assert panel.unit == "ft"
    np.testing.assert_array_equal(marks(panel, Line)[0].y, stuck.run["estimate"][:, 7])


def test_without_the_truth_the_estimate_is_shown_in_its_unit(recorded: Source) -> None:
    plot = plots.mass_reciprocal(recorded)
    (panel,) = plot.panels
    (band,), (line,) = marks(panel, Band), marks(panel, Line)
    assert plot.title == "Mass reciprocal: estimate"
    assert (panel.axis_label, panel.scale) == ("1/m, 1/slug", "linear")
    np.testing.assert_array_equal(line.y, recorded.signals["estimate"][:, 9])
    np.testing.assert_allclose(band.high - line.y, 3.0 * recorded.signals["standard_deviation"][:, 9], rtol=1e-9)
    assert panel.limits is not None
    assert panel.limits[0] < line.y.min()
    assert panel.limits[1] > band.high[-1]


def test_nis_is_shown_where_it_was_used_beside_its_limits(stuck: Case) -> None:
    panel = plots.consistency(stuck.source).panels[0]
    (zone,), (points,) = marks(panel, Zone), marks(panel, Points)
    used = stuck.run["rotation_used"][:, 0] != 0.0
    np.testing.assert_array_equal(points.x, stuck.run.time_s[used])
    np.testing.assert_array_equal(points.y, stuck.run["rotation_nis"][used, 0])
    within = points.y[points.y < chdtri(3, 0.01)].mean()  # without those of the jet until it is declared
    assert points.label == f"NIS, mean {within:.2f} ({points.y.mean():.4g} with those beyond 99 %)"
    quiet = stuck.source._replace(
        signals={**stuck.run.signals, "rotation_nis": np.full((stuck.run.time_s.size, 1), 2.5)}
    )
    (points,) = marks(plots.consistency(quiet).panels[0], Points)
    assert points.label == f"NIS, mean 2.50 of {used.sum()} samples"
    assert panel.scale == "log"
    np.testing.assert_allclose((zone.low, zone.high), chdtri(3, [0.975, 0.025]), rtol=1e-14)


def test_means_of_a_thinned_run_are_those_of_all_samples(stuck: Case) -> None:
    means = {"rotation_nis_mean": 2.5, "rotation_nis_within": 2.4, "rotation_nis_beyond": 0.01}
    panels = plots.consistency(stuck.source._replace(consistency=means)).panels
    labels = [marks(panel, Points)[0].label for panel in panels]
    assert labels == ["NIS, mean 2.50 of all samples used", "NIS, no sample used"]


# ---------------------------------------------------------------------------------------- detector


def test_the_likeliest_jets_have_colors_and_the_others_their_range(stuck: Case) -> None:
    panel = plots.likelihoods(stuck.source).panels[0]
    tested = stuck.run["tested"][:, 0] != 0.0
    values = np.maximum(stuck.run["likelihood"][tested], 0.1)
    every, (others,) = marks(panel, Points), marks(panel, Whiskers)
    assert len(every) == 44  # all are there to be read
    named = [points for points in every if points.drawn]
    jets = stuck.run.scenario.vehicle_data.designations
    columns = [jets.index(points.label) for points in named]
    assert named[-1].label == "R4R"  # on top
    assert len(named) == 5
    for column, points in zip(columns, named, strict=True):
        np.testing.assert_array_equal(points.y, values[:, column])
    rest = np.delete(values, columns, axis=1)
    np.testing.assert_array_equal(others.low, rest.min(axis=1))
    np.testing.assert_array_equal(others.high, rest.max(axis=1))
    assert values[:, columns].max(axis=0).min() >= rest.max()
    assert panel.limits == (0.1, pytest.approx(2.0 * values.max()))


def test_a_cluster_is_as_likely_as_its_likeliest_jet(stuck: Case) -> None:
    points = marks(plots.likelihoods(stuck.source).panels[1], Points)[-1]
    tested = stuck.run["tested"][:, 0] != 0.0
    in_cluster = [jet.cluster == 12 for jet in stuck.run.scenario.vehicle_data.jets]
    assert points.label == "cluster 12"
    expected = np.maximum(stuck.run["likelihood"][tested][:, in_cluster].max(axis=1), 0.1)
    np.testing.assert_array_equal(points.y, expected)


def _probable(case: Case, **jets: float) -> Source:
    """A run whose detector gives probabilities: of each jet from the tenth row to the twentieth."""
    rows, names = len(case.source.time_s), case.source.vehicle.designations
    of_jets = np.zeros((rows, len(names)))
    for jet, probability in jets.items():
        of_jets[10:20, names.index(jet)] = probability
    none = 1.0 - of_jets.max(axis=1, keepdims=True)
    more = {"fault_probability": of_jets, "none_probability": none, "unknown_probability": np.full((rows, 1), 0.002)}
    return case.source._replace(signals={**case.source.signals, **more})


def test_probabilities_stand_in_place_of_likelihoods(stuck: Case) -> None:
    found = list(plots.available(_probable(stuck)))
    assert found[-len(DETECTOR) :] == ["fault_probabilities", *DETECTOR[1:]]
    unknown = {name: np.full((len(stuck.source.time_s), 1), np.nan) for name in ("none_probability",)}
    of_poses = stuck.source._replace(signals={**stuck.source.signals, **unknown})
    assert list(plots.available(of_poses))[-len(DETECTOR) :] == DETECTOR


def test_every_jet_that_was_ever_probable_is_drawn(stuck: Case) -> None:
    source = _probable(stuck, R4R=0.9, F1U=0.02, L2D=0.009)
    of_jets, others = plots.fault_probabilities(source).panels
    lines = marks(of_jets, Line)
    assert [line.label for line in lines] == ["R4R, at the end 0", "F1U, at the end 0"]
    np.testing.assert_array_equal(lines[0].y, source.signals["fault_probability"][:, 28])
    none, unknown = marks(others, Line)
    assert (none.label, unknown.label) == ("none, at the end above 0.9999", "unknown, at the end 0.002")
    drawn(plots.fault_probabilities(source))


def test_the_least_of_many_probable_jets_are_a_range_and_can_be_read(stuck: Case) -> None:
    names = ("R4R", "F1U", "L2D", "L4D", "R1U", "F3U", "F2U")
    source = _probable(stuck, **{jet: 0.5 - 0.05 * number for number, jet in enumerate(names)})
    panel = plots.fault_probabilities(source).panels[0]
    assert [line.label.partition(",")[0] for line in marks(panel, Line)] == list(names[:5])
    (rest,) = marks(panel, Whiskers)
    assert (rest.low[15], rest.high[15]) == (pytest.approx(0.2), pytest.approx(0.25))
    assert [points.label for points in marks(panel, Points)] == list(names[5:])


def test_where_no_jet_is_probable_nothing_and_unknown_are_left(stuck: Case) -> None:
    (panel,) = plots.fault_probabilities(_probable(stuck, R4R=0.005)).panels
    assert len(marks(panel, Line)) == 2


def test_nothing_tested_gives_empty_panels(stuck: Case) -> None:
    signals = {**stuck.run.signals, "tested": np.zeros_like(stuck.run["tested"])}
    source = stuck.source._replace(signals=signals)
    assert [panel.marks for panel in plots.likelihoods(source).panels] == [(), ()]
    assert marks(plots.margins(source).panels[0], Points)[0].x.size == 0


def test_margins_stand_beside_the_one_that_isolates(stuck: Case) -> None:
    panel = plots.margins(stuck.source).panels[1]
    (level,), (points,) = marks(panel, Level), marks(panel, Points)
    tested = stuck.run["tested"][:, 0] != 0.0
    assert level.y == stuck.run.scenario.detector.margin
    np.testing.assert_array_equal(points.y, np.maximum(stuck.run["cluster_margin"][tested, 0], 0.1))


def test_the_magnitude_is_shown_at_alarms_beside_the_truth_and_the_known_force(stuck: Case) -> None:
    run = stuck.run
    (panel,) = plots.failure_magnitude(stuck.source).panels
    (points,), (spread,) = marks(panel, Points), marks(panel, Whiskers)
    alarm = run["alarm"][:, 0] != 0.0
    np.testing.assert_array_equal(points.y, run["suspected_magnitude"][alarm, 0])
    np.testing.assert_allclose(spread.high - points.y, run["suspected_magnitude_std"][alarm, 0], rtol=1e-6)
    truth, known = marks(panel, Line)
    assert (truth.label, known.label, panel.unit) == ("truth of R4R", "known force of R4R", "lbf")
    jet = run.scenario.vehicle_data.jet_index("R4R")
    np.testing.assert_allclose(truth.y, run["thrust"][:, jet] - 868.8 * run["command"][:, jet], atol=1e-6)
    assert truth.y[-2] == pytest.approx(known.y[-1], rel=1e-3)
    assert np.isnan(known.y[0])


def test_the_truth_of_a_failure_without_an_alarm_is_shown_too(stuck: Case) -> None:
    signals = {**stuck.run.signals, "alarm": np.zeros_like(stuck.run["alarm"])}
    (panel,) = plots.failure_magnitude(stuck.source._replace(signals=signals)).panels
    assert "truth of R4R" in [mark.label for mark in panel.marks]
    assert not marks(panel, Points)


def test_the_timeline_has_tests_alarms_and_the_jets_commanded(stuck: Case) -> None:
    rate, commanded, events = plots.detection_timeline(stuck.source).panels
    assert [line.label for line in rate.marks] == ["x", "y", "z"]
    np.testing.assert_array_equal(marks(commanded, Band)[0].high, (stuck.run["command"] > 0.0).sum(axis=1))
    assert events.rows == ("tested", "alarm", "names the jet")
    for row, name in enumerate(("tested", "alarm", "jet_isolated")):
        np.testing.assert_array_equal(events.marks[row].x, stuck.run.time_s[stuck.run[name][:, 0] != 0.0])
        assert set(events.marks[row].y.tolist()) == {row}


# ------------------------------------------------------------------------------------ what all show


def test_every_plot_says_whose_it_is_and_what_happened_when(stuck: Case) -> None:
    plot = plots.rates(stuck.source)
    assert plot.caption == "orbiter, stuck_on_29, seed 0"
    assert [tuple(window) for window in plot.windows] == [(0.2, 0.8, "RHC +x", True)]
    happens, *declared = plot.moments
    assert happens == (1.0, False)
    assert [moment.time_s for moment in declared] == [entry["time_s"] for entry in stuck.run.summary["detections"]]
    assert all(moment.declared for moment in declared)
    assert plot.note == "shaded: hand controller out of detent, dotted: it happens, red line: it is declared"


def test_a_record_knows_only_what_was_declared(recorded: Source) -> None:
    plot = plots.gyro_readings(recorded)
    assert plot.caption == "orbiter, stuck_on_29"
    assert not plot.windows
    assert plot.note == "red line: it is declared"


def test_what_lies_beyond_the_end_is_left_out(stuck: Case) -> None:
    until = stuck.run.time_s <= 0.16
    signals = {name: values[until] for name, values in stuck.run.signals.items()}
    plot = plots.rates(stuck.source._replace(time_s=stuck.run.time_s[until], signals=signals))
    assert (plot.windows, plot.moments, plot.note) == ((), (), "")


# --------------------------------------------------------------------- followed in a fixed frame


@pytest.fixture(scope="module")
def tracked() -> Run:
    """A vehicle in a plane that is followed by motion capture: no gyro, and most parameters fixed."""
    return simulate(load_scenario("air_bearing_pulses", ["duration_s=3"]))


def test_parameters_that_are_fixed_have_no_panel(tracked: Run) -> None:
    found = plots.available(plots.source(tracked))
    assert not {"inverse_inertia_products", "innovations", "phase_plane", "gyro_readings"} & set(found)
    (panel,) = found["inverse_inertia_diagonal"](plots.source(tracked)).panels
    assert panel.label == "Izz⁻¹"


def test_a_vehicle_without_gyro_has_pictures_and_pages(tracked: Run) -> None:
    true = {*TRUE, "position"}
    signals = {name: values for name, values in tracked.signals.items() if name not in true}
    source = plots.source(tracked)
    for each in (source, source._replace(signals=signals)):
        for name, plot in plots.available(each).items():
            assert plot(each).name == name
            drawn(plot(each))
    (rate, *_) = plots.detection_timeline(source._replace(signals=signals)).panels
    (turning,) = rate.marks  # about the only axis there is
    np.testing.assert_allclose(turning.y, np.degrees(tracked["rate_estimate"][:, 2]))  # type: ignore[union-attr]
    assert "Izz" in report_html(tracked)
    assert np.isnan(instruments.columns(tracked)["apart"]).all()


def test_what_cannot_move_in_a_plane_has_no_panel(tracked: Run) -> None:
    source = plots.source(tracked)
    for name, axes in {"rates": "z", "torques": "z", "velocities": "xy", "forces": "xy", "positions": "xy"}.items():
        assert "".join(panel.label for panel in plots.available(source)[name](source).panels) == axes


def test_clusters_of_one_jet_are_jets(tracked: Run) -> None:
    source = plots.source(tracked)
    found = plots.available(source)
    assert "clusters" not in found
    (panel,) = found["jets"](source).panels
    assert panel.rows == tracked.scenario.vehicle_data.designations
    assert not found["jets"](source).folded
    assert len(found["likelihoods"](source).panels) == 1


def test_delay_and_surroundings_are_shown_with_their_sigma(tracked: Run) -> None:
    panels = plots.surroundings(plots.source(tracked)).panels
    assert [panel.label for panel in panels][:3] == ["delay of commands", "drag", "angular drag"]
    (line,), (band,) = marks(panels[0], Line), marks(panels[0], Band)
    np.testing.assert_array_equal(line.y, tracked["command_delay"][:, 0])
    np.testing.assert_allclose(band.high - line.y, 3.0 * tracked["command_delay_std"][:, 0], atol=1e-15)


def test_what_is_not_said_is_no_event(stuck: Case) -> None:
    names = np.where(np.arange(stuck.run.time_s.size) == 9, 1.0, np.nan)[:, None]
    source = stuck.source._replace(signals={**stuck.run.signals, "jet_isolated": names})
    ticks = marks(plots.detection_timeline(source).panels[-1], Points)
    np.testing.assert_array_equal(ticks[2].x, stuck.run.time_s[9:10])


# ------------------------------------------------------------------------------------ of the user's own


def test_an_estimate_of_ones_own_is_beside_ours(stuck: Case, recorded: Source) -> None:
    mine = 1.01 * stuck.run["truth"]
    mine[:, 9] = np.nan
    for source, shown in ((stuck.source, 1.0), (recorded, mine[:, 0])):
        more = source._replace(signals={**source.signals, "mine.estimate": mine})
        own = [line for line in marks(plots.inverse_inertia_diagonal(more).panels[0], Line) if "mine" in line.label]
        np.testing.assert_allclose(own[0].y, shown)  # the error in percent, or the estimate
        assert "own_signals" not in plots.available(more)
        assert len(marks(plots.mass_reciprocal(more).panels[0], Line)) == 1  # which it does not estimate


def test_other_signals_of_ones_own_have_a_panel_each(stuck: Case) -> None:
    mine = {"mine.pair": stuck.run["rate"][:, :2], "mine.long": np.ones((stuck.run.time_s.size, 40))}
    source = stuck.source._replace(signals={**stuck.run.signals, **mine, "against.gyro": stuck.run["rate"]})
    (panel,) = plots.available(source)["own_signals"](source).panels
    assert (panel.label, [line.label for line in marks(panel, Line)]) == ("mine.pair", ["0", "1"])


def test_a_leak_of_a_hundredth_is_a_bar(stuck: Case) -> None:
    jet = stuck.run.scenario.vehicle_data.jet_index("R4R")
    thrust = stuck.run["thrust"].copy()
    thrust[:, jet] *= 0.01
    panel = plots.clusters(stuck.source._replace(signals={**stuck.run.signals, "thrust": thrust})).panels[0]
    (untold,) = (bars for bars in marks(panel, Bars) if bars.label == "thrust untold")
    np.testing.assert_allclose(untold.begin, [1.0, 1.0], atol=0.081)  # its own row, and that of its cluster


def test_what_the_detector_does_not_judge_hides_nobody(stuck: Case) -> None:
    likelihood = stuck.run["likelihood"].copy()
    tested = stuck.source.where("tested")
    likelihood[tested[0]] = np.nan
    panel = plots.likelihoods(stuck.source._replace(signals={**stuck.run.signals, "likelihood": likelihood})).panels[0]
    assert "R4R" in [points.label for points in marks(panel, Points) if points.drawn]


def test_a_jet_that_was_declared_off_is_named_however_far_behind(stuck: Case) -> None:
    """It has no known force, and others may come ahead of it at another time."""
    signals = {name: values.copy() for name, values in stuck.run.signals.items()}
    jet = stuck.run.scenario.vehicle_data.jet_index("F2R")
    signals["likelihood"][:, jet] = 1.0
    signals["suspected_jet"][signals["detector_event"] == 1.0] = jet
    signals["known_force_variance"][:] = 0.0
    panel = plots.likelihoods(stuck.source._replace(signals=signals)).panels[0]
    assert [points.label for points in marks(panel, Points) if points.drawn][-1] == "F2R"


def test_a_jet_that_is_named_has_a_row_of_its_own_in_a_record(recorded: Source, stuck: Case) -> None:
    verdict = np.zeros_like(stuck.run["command"])
    verdict[50, stuck.run.scenario.vehicle_data.jet_index("F2R")] = 1.0
    panel = plots.clusters(recorded._replace(signals={**recorded.signals, "verdict": verdict})).panels[0]
    assert "jet F2R" in panel.rows

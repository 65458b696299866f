"""Plots of a campaign's report, section by section."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from massprop_drake.maths.mass_properties import N_ROTATION, NAMES
from massprop_drake.studies.campaign import charts, merit, statistics
from massprop_drake.studies.campaign.counts import Row, select_flown
from massprop_drake.studies.campaign.merit import InjectedEvent
from massprop_drake.studies.campaign.reading import Cell, Study
from massprop_drake.studies.campaign.statistics import Figure


def delay_plots(study: Study, failures: Sequence[InjectedEvent]) -> list[charts.Json]:
    """Makes plots of detection delays, by kind and by cell of a sweep, and of the operating curve."""
    cell = study.cells[study.reference]
    plots = []
    if failures:
        curves = {
            kind.replace("_", " "): merit.detection_curve(group)
            for kind, group in merit.group_events(failures, "kind").items()
        }
        if len(curves) > 1:
            curves["all"] = merit.detection_curve(failures)
        plots.append(charts.delays(curves))
        swept = len(study.cells) > 1
        if swept:
            cells = {one.label: merit.detection_curve(merit.events(one.rows)) for one in study.cells}
            plots.append(charts.delays(cells, "delays-cells", "by setting of the sweep"))
        points = [
            merit.operating_point(one.rows, ", ".join(map(str, one.settings.values())))
            for one in (study.cells if swept else ())
        ]
        flown_point = merit.operating_point(cell.rows, cell.label)
        names = ", ".join(key.rpartition(".")[2] for key in study.spec.file.sweep)
        plots.append(charts.operating_curve(merit.operating_curve(cell.rows), points, flown_point, names))
    return plots


def confusion_plots(
    study: Study, failures: Sequence[InjectedEvent], payload_events: Sequence[InjectedEvent]
) -> list[charts.Json]:
    """Makes heat maps of declared against true failures, by jet and by cluster."""
    if not failures and not payload_events:
        return []
    vehicle = study.spec.base.vehicle_data
    clusters = {jet.designation: jet.cluster for jet in vehicle.jets}
    counts = merit.confusion([*failures, *payload_events])
    special = [merit.OWN_CLUSTER, merit.JUMP_COLUMN, merit.NOT_FOUND, merit.NOT_TESTED]
    numbers = sorted(set(clusters.values()))
    by_jet = [*clusters, *(f"cluster {number}" for number in numbers), *special]
    return [
        charts.confusion(counts, by_jet, "confusion", "What failed, and what was declared: jets"),
        charts.confusion(
            merit.sum_by_cluster(counts, clusters),
            [*(f"cluster {number}" for number in numbers), *special],
            "confusion-clusters",
            "The same by cluster",
        ),
    ]


def size_plots(failures_by_kind: Mapping[str, Sequence[InjectedEvent]], force_unit: str) -> list[charts.Json]:
    """Makes plots of the probability of detection over failure size, one per kind."""
    plots = []
    for kind, group in failures_by_kind.items():
        sizes, detected = [merit.failure_size(event) for event in group], [event.right for event in group]
        curve, bins = statistics.size_curve(sizes, detected), statistics.shares_by_size(sizes, detected)
        plots.append(charts.sizes(kind, group, curve, bins, force_unit))
    return plots


def magnitude_plots(failures: Sequence[InjectedEvent], force_unit: str) -> list[charts.Json]:
    """Makes plots of declared over true force of failures, and of its errors over the claimed sigma."""
    errors = [z for _, z in merit.magnitude_errors(failures)]
    if not errors:
        return []
    groups = {kind.replace("_", " "): group for kind, group in merit.group_events(failures, "kind").items()}
    title = "Magnitude, error over claimed sigma"
    return [
        charts.magnitudes(groups, force_unit),
        charts.normal_histogram(errors, "magnitude-errors", title, "error / claimed 1-sigma"),
    ]


def consistency_plots(cell: Cell, times_s: Sequence[float]) -> list[charts.Json]:
    """Makes plots of NEES, NIS, coverage and errors over claimed sigma, of a cell."""
    rows, good = cell.rows, select_flown(cell.rows)
    plots: list[charts.Json] = []
    nees, mass = merit.known_values(good, "nees.rotation"), merit.known_values(good, "nees.mass")
    if nees:
        texts = ("nees", "NEES of the nine rotational parameters", "NEES at the end")
        plots.append(charts.chi_square(nees, N_ROTATION, texts))
    if mass:
        plots.append(charts.chi_square(mass, 1, ("nees-mass", "NEES of 1/m", "NEES at the end")))
    samples = sorted(row["samples"] for row in good if row["samples"])
    for kind, filter_name in (("rotation", "rotation"), ("translation", "mass")):
        nis = merit.known_values(good, f"nis.{kind}")
        if nis and samples:
            label = f"mean NIS over a flight (median {samples[len(samples) // 2]} samples)"
            texts = (f"nis-{kind}", f"NIS of the {filter_name} filter", label)
            plots.append(charts.chi_square(nis, 3, texts, samples[len(samples) // 2]))
    sigmas = {name: merit.normalized_errors(rows, name) for name in NAMES}
    if any(sigmas.values()):
        plots.append(charts.coverage({name: coverage_by_sigma(rows, name) for name in NAMES}))
        plots.append(charts.parameter_histograms(sigmas))
    if times_s and any(sigmas.values()):
        shares_by_time = {
            time: {
                label: merit.coverage(rows, names, suffix=suffix)
                for label, names in (("rotational parameters", NAMES[:N_ROTATION]), ("1/m", NAMES[N_ROTATION:]))
            }
            for time, suffix in [*((time, f"@{time:g}") for time in sorted(times_s)), (rows[0]["duration_s"], "")]
        }
        plots.append(charts.coverage_over_time(shares_by_time))
    return plots


def coverage_by_sigma(rows: Sequence[Row], name: str) -> dict[float, Figure]:
    """Maps 1, 2 and 3 sigma to the share of a parameter's estimates within it."""
    return {sigma: merit.coverage(rows, (name,), sigma) for sigma in (1.0, 2.0, 3.0)}


def sensitivity_plots(study: Study, cell: Cell) -> list[charts.Json]:
    """Makes plots of rank correlations of errors with draws, and of Sobol indices if the plan allows."""
    plots = []
    for size, name, title in (
        (False, "sensitivity", "Rank correlation of each error with each draw"),
        (True, "sensitivity-size", "Rank correlation of each error's size with each draw"),
    ):
        coefficients = merit.sensitivity(cell.rows, study.labels, absolute=size)
        if coefficients:
            plots.append(charts.correlations(coefficients, name, title))
    if study.spec.file.method == "saltelli" and len(cell.rows) == cell.planned:
        indices = merit.sobol(cell.rows, len(study.labels))
        if indices is not None:
            names, (first, total) = indices
            plots.append(charts.sobol(first, names, study.labels, "alone"))
            plots.append(charts.sobol(total, names, study.labels, "alone and together with others"))
    return plots

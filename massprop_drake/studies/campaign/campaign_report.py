"""Report of a campaign: as data for `summary.json`, and as one self-contained HTML page with the verdict first."""

from __future__ import annotations

import math
import shlex
from collections import Counter
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from massprop_drake.display import plotted, templates
from massprop_drake.inputs.model import yaml_text
from massprop_drake.maths.mass_properties import N_ROTATION, NAMES
from massprop_drake.results.detections import JUMP
from massprop_drake.studies.campaign import charts, merit, statistics
from massprop_drake.studies.campaign.counts import Row, endings, flown, judgeable, not_run, progress
from massprop_drake.studies.campaign.merit import CAUSES, DELAYS_S, MEANINGS, OUTCOMES, InjectedEvent, Passed
from massprop_drake.studies.campaign.plan import case_name
from massprop_drake.studies.campaign.reading import Cell, Study, read
from massprop_drake.studies.campaign.statistics import Figure, SizeCurve

FORMAT = 1  # of a campaign's `summary.json`
SIZED = ("leak", "degraded")  # kinds of failures that have a size

_HERE = Path(__file__).parent
_DISPLAY = Path(templates.__file__).parent
_MAIN = (  # of a cell, side by side
    "false_declarations_per_hour", "false_declarations_in_case", "healthy_jets_out", "ended_wrong", "failing",
    "isolated", "named", *(f"found_within_{delay:g}_s" for delay in DELAYS_S), "delay_50_percent_s", "coverage_3_sigma",
    "nees_in_band",
)  # fmt: skip


# ------------------------------------------------------------------------------------------- as data


def summary(folder: str | Path) -> dict[str, Any]:
    """Returns the content of a campaign's `summary.json`.

    Raises:
        InputError: when the folder holds no campaign that has been run.
    """
    return summarized(read(folder))


def summarized(study: Study) -> dict[str, Any]:
    """Returns the summary of a campaign that has been read: counts, figures by cell, and gates with their verdicts.

    Gates hold for every cell. The figures at the top are those of the reference: the cell with the base scenario's own
    settings, or the first.
    """
    file = study.spec.file
    cells: list[dict[str, Any]] = []
    for number, cell in enumerate(study.cells):
        found = merit.figures(cell.rows)
        cells.append(
            {
                "cell": number,
                "settings": dict(cell.settings),
                "cases": cell.numbers._asdict(),
                "hours": merit.hours(cell.rows),
                "figures": {name: figure_data(figure) for name, figure in found.items()},
                "gates": [_gate_data(passed) for passed in merit.judged(file.gates, found)],
            }
        )
    gates = [{"cell": cell["cell"], **gate} for cell in cells for gate in cell["gates"]]
    return {
        "format": FORMAT,
        "version": version("massprop-drake"),
        "campaign": file.name,
        "description": file.description,
        "base": study.spec.base.name,
        "vehicle": study.spec.base.vehicle_data.name,
        "method": file.method,
        "seed": file.seed,
        "cases": study.status.counts._asdict(),
        "hours": merit.hours(study.rows),
        "passed": all(gate["passes"] for gate in gates),
        "gates": gates,
        "reference": study.reference,
        "figures": cells[study.reference]["figures"],
        "cells": cells,
        "injected": {kind: dict(counts) for kind, counts in merit.outcomes(study.rows).items()},
        "failed_to_run": _reasons(study.rows),
    }


def figure_data(figure: Figure) -> dict[str, float | None]:
    """Returns a figure as JSON has it: null for what is not known or not bounded."""
    return {name: value if math.isfinite(value) else None for name, value in figure._asdict().items()}


def _gate_data(passed: Passed) -> dict[str, Any]:
    value = passed.value if math.isfinite(passed.value) else None
    return {"figure": passed.name, **passed.gate.model_dump(mode="json"), "value": value, "passes": passed.passes}


def _reasons(rows: Sequence[Row]) -> dict[str, int]:
    """Counts reasons for which cases failed to run, the most frequent first."""
    return dict(Counter(str(row["reason"]) for row in rows if row["status"] != "flown").most_common())


# ------------------------------------------------------------------------------------------- as words


def shown(figure: Figure, unit: str, *, interval: bool = True) -> str:
    """Formats a figure, such as '12.5 % (8.1 to 18.4)'."""
    if math.isnan(figure.value):
        bounded = figure.n and math.isfinite(figure.low)
        return f"at least {_number(figure.low, unit)}{_unit(unit)}" if bounded else "-"
    text = f"{_number(figure.value, unit)}{_unit(unit)}"
    return f"{text} ({between(figure, unit)})" if interval and not math.isnan(figure.low) else text


def between(figure: Figure, unit: str) -> str:
    """Formats the interval of a figure."""
    if math.isnan(figure.low) or math.isnan(figure.high):
        return ""
    if math.isinf(figure.high):
        return f"from {_number(figure.low, unit)}" if math.isfinite(figure.low) else "unknown"
    return f"{_number(figure.low, unit)} to {_number(figure.high, unit)}"


def _number(value: float, unit: str) -> str:
    if unit != "%":
        return f"{value:.3g}" if abs(value) < 1e4 else f"{value:.3e}"
    return f"{100.0 * value:.1f}" if 0.0 < value < 1.0 else f"{100.0 * value:.0f}"


def _unit(unit: str) -> str:
    return f" {unit}" if unit else ""


def row_of(name: str, figure: Figure) -> dict[str, str]:
    """Formats a figure as a row of a table."""
    words, unit, measured_on = MEANINGS[name]
    text = shown(figure, unit, interval=False)
    return {
        "name": name, "words": words, "value": text, "interval": between(figure, unit) if text[0] != "a" else "",
        "n": f"{figure.n:.3g} {measured_on}" if "hours" in measured_on else f"{figure.n:g} {measured_on}",
    }  # fmt: skip


def verdict(study: Study) -> list[dict[str, Any]]:
    """Returns the sentences of the verdict, each a `text` and whether it is `good`: None where nothing was asked."""
    sentences: list[dict[str, Any]] = []

    def say(good: bool | None, text: str) -> None:
        sentences.append({"good": good, "text": text})

    cell = study.cells[study.reference]
    all_figures = [merit.figures(one.rows) for one in study.cells]
    found = all_figures[study.reference]
    judged = [merit.judged(study.spec.file.gates, figures) for figures in all_figures]
    for of_gate in zip(*judged, strict=True):
        say(all(passed.passes for passed in of_gate), _gate_words(of_gate, study.cells))
    for sentence in endings(study.status):
        say(None, sentence)
    if len(study.cells) > 1:
        say(None, f"Figures below, unless they say otherwise, are with {cell.label}{_why_reference(study)}.")
    judged_rows = judgeable(cell.rows)
    if judged_rows:
        rate, hours = found["false_declarations_per_hour"], merit.hours(judged_rows)
        count = len(merit.false_declarations(judged_rows))
        say(
            None,
            f"{count} false declarations in {hours:.3g} hours flown: {shown(rate, 'per hour')}; "
            f"{shown(found['false_declarations_in_case'], '%')} of the cases have one.",
        )
        wrong, out = (shown(found[name], "%") for name in ("ended_wrong", "healthy_jets_out"))
        say(None, f"{wrong} of the cases end wrong; {out} end with a healthy jet out of use.")
    else:
        count, hours = sum(len(row["declared"]) for row in flown(cell.rows)), merit.hours(cell.rows)
        say(None, f"{count} declarations in {hours:.3g} hours of telemetry; which of them are right nobody says.")
    acted = merit.events(cell.rows)
    if acted:
        within = ", ".join(f"{shown(found[f'found_within_{d:g}_s'], '%')} within {d:g} s" for d in DELAYS_S)
        say(None, f"Of {len(acted)} failures that acted, {shown(found['isolated'], '%')} were found: {within}.")
    never = sum(counts["never_acted"] for counts in merit.outcomes(cell.rows).values())
    if never:
        say(None, f"{never} failure{'s' if never > 1 else ''} never acted, and no figure counts them.")
    counts = study.status.counts
    if counts.failed_to_run:
        say(False, not_run(counts))
    if counts.tried < counts.planned:
        say(False, progress(counts))
    return sentences


def _why_reference(study: Study) -> str:
    return ", the first cell" if study.reference == 0 else ", the base scenario's own settings"


def _gate_words(of_gate: Sequence[Passed], cells: Sequence[Cell]) -> str:
    """Formats a gate, with the value of each cell."""
    gate, (words, unit, _) = of_gate[0].gate, MEANINGS[of_gate[0].name]
    asked = " and ".join(
        f"{word} {_number(bound, unit)}{_unit(unit)}"
        for word, bound in (("at least", gate.min), ("at most", gate.max))
        if bound is not None
    )
    values = [
        "not measured" if math.isnan(passed.value) else f"{_number(passed.value, unit)}{_unit(unit)}"
        for passed in of_gate
    ]
    if len(cells) > 1:
        values = [f"{value} with {cell.label}" for value, cell in zip(values, cells, strict=True)]
    verdict = "passed" if all(passed.passes for passed in of_gate) else "failed"
    on = "" if gate.on == "estimate" else f", {gate.on.replace('_', ' ')}"
    return f"Gate {verdict}: {words}{on}: {'; '.join(values)}; asked {asked}."


# -------------------------------------------------------------------------------------------- as page


def page(folder: str | Path) -> str:
    """Returns the report of a campaign as the text of one HTML file that needs no network.

    Raises:
        InputError: when the folder holds no campaign that has been run.
    """
    return page_of(read(folder))


def page_of(study: Study) -> str:
    """Returns the report of a campaign that has been read."""
    return plotted.page(_HERE / "campaign.html", contents(study))


def notebook(study: Study) -> str:
    """Returns the HTML that a notebook shows of a campaign."""
    title = f"{study.spec.file.name}: {study.spec.base.name}"
    return templates.fragment(_DISPLAY / "summary.html", {"title": title, "verdict": verdict(study)})


def contents(study: Study) -> dict[str, Any]:
    """Returns all that the page shows, as plain values: texts, tables and plots."""
    spec = study.spec
    cell = study.cells[study.reference]
    rows = cell.rows
    found = merit.figures(rows)
    acted = merit.events(rows)
    force = spec.base.vehicle_data.unit_names["force"]
    sized = {kind: group for kind, group in merit.by_kind(acted).items() if kind in SIZED}
    places = {
        "detection": _delay_plots(study, acted),
        "isolation": _confusion_plots(study, acted, merit.events(rows, payloads=True)),
        "sizes": _size_plots(sized, force),
        "magnitudes": _magnitude_plots(acted, force),
        "consistency": _consistency_plots(cell, spec.file.times_s),
        "sensitivity": _sensitivity_plots(study, cell),
    }
    return {
        "title": spec.file.name,
        "description": spec.file.description,
        "about": _about(study),
        "verdict": verdict(study),
        "figures": [row_of(name, figure) for name, figure in found.items() if figure.n],
        "sweep": _sweep(study),
        "falsely": _false(rows),
        "false_of": _false_of(rows),
        "outcomes": _outcomes(rows),
        "delays": _delays(acted),
        "jumps": _jumps(rows),
        "healthy_out": _healthy_out(rows, {jet.designation: jet.cluster for jet in spec.base.vehicle_data.jets}),
        "leaks": {kind: _smallest(group, force) for kind, group in sized.items()},
        "magnitudes": _magnitudes(acted, force),
        "groups": _groups(rows),
        "coverage": _coverage(rows),
        "sobol": spec.file.method == "saltelli",
        "worst": _worst(study),
        "failed": list(_reasons(study.rows).items()),
        "execution": _execution(study),
        "file": yaml_text(spec.file),
        "base": yaml_text(spec.base),
        "places_of": places,
        "plots": [plot for plots in places.values() for plot in plots],
    }


def _about(study: Study) -> str:
    file, base = study.spec.file, study.spec.base
    cells = f" in {len(study.cells)} cells of a sweep" if len(study.cells) > 1 else ""
    return (
        f"{base.name} on {base.vehicle_data.name}: {study.status.counts.flown} cases{cells}, "
        f"{merit.hours(study.rows):.3g} hours flown, {file.method}, seed {file.seed}"
    )


# ---------------------------------------------------------------------------------------------- plots


def _delay_plots(study: Study, acted: Sequence[InjectedEvent]) -> list[charts.Json]:
    cell = study.cells[study.reference]
    plots = []
    if acted:
        curves = {kind.replace("_", " "): merit.detection_curve(group) for kind, group in merit.by_kind(acted).items()}
        if len(curves) > 1:
            curves["all"] = merit.detection_curve(acted)
        plots.append(charts.delays(curves))
        swept = len(study.cells) > 1
        if swept:
            cells = {one.label: merit.detection_curve(merit.events(one.rows)) for one in study.cells}
            plots.append(charts.delays(cells, "delays-cells", "by setting of the sweep"))
        points = [merit.operating_point(one.rows, _values(one)) for one in study.cells] if swept else []
        own = merit.operating_point(cell.rows, cell.label)
        plots.append(charts.operating(merit.operating_curve(cell.rows), points, own, ", ".join(_names(study))))
    return plots


def _names(study: Study) -> list[str]:
    """Returns the names of swept keys, in short."""
    return [key.rpartition(".")[2] for key in study.spec.file.sweep]


def _values(cell: Cell) -> str:
    return ", ".join(str(value) for value in cell.settings.values())


def _confusion_plots(study: Study, acted: Sequence[InjectedEvent], moved: Sequence[InjectedEvent]) -> list[charts.Json]:
    if not acted and not moved:
        return []
    vehicle = study.spec.base.vehicle_data
    clusters = {jet.designation: jet.cluster for jet in vehicle.jets}
    counts = merit.confusion([*acted, *moved])
    special = [merit.OWN_CLUSTER, merit.JUMP_COLUMN, merit.NOT_FOUND, merit.NOT_TESTED]
    numbers = sorted(set(clusters.values()))
    by_jet = [*clusters, *(f"cluster {number}" for number in numbers), *special]
    return [
        charts.confusion(counts, by_jet, "confusion", "What failed, and what was declared: jets"),
        charts.confusion(
            merit.by_cluster(counts, clusters),
            [*(f"cluster {number}" for number in numbers), *special],
            "confusion-clusters",
            "The same by cluster",
        ),
    ]


def _size_plots(sized: Mapping[str, Sequence[InjectedEvent]], force: str) -> list[charts.Json]:
    plots = []
    for kind, group in sized.items():
        sizes, right = [merit.size_of(event) for event in group], [event.right for event in group]
        curve, bins = statistics.size_curve(sizes, right), statistics.binned(sizes, right)
        plots.append(charts.sizes(kind, group, curve, bins, force))
    return plots


def _magnitude_plots(acted: Sequence[InjectedEvent], force: str) -> list[charts.Json]:
    errors = [z for _, z in merit.magnitude_errors(acted)]
    if not errors:
        return []
    groups = {kind.replace("_", " "): group for kind, group in merit.by_kind(acted).items()}
    title = "Magnitude, error over claimed sigma"
    return [
        charts.magnitudes(groups, force),
        charts.normal_histogram(errors, "magnitude-errors", title, "error / claimed 1-sigma"),
    ]


def _consistency_plots(cell: Cell, times_s: Sequence[float]) -> list[charts.Json]:
    rows, good = cell.rows, flown(cell.rows)
    plots: list[charts.Json] = []
    nees, mass = merit.known(good, "nees.rotation"), merit.known(good, "nees.mass")
    if nees:
        what = ("nees", "NEES of the nine rotational parameters", "NEES at the end")
        plots.append(charts.chi_square(nees, N_ROTATION, what))
    if mass:
        plots.append(charts.chi_square(mass, 1, ("nees-mass", "NEES of 1/m", "NEES at the end")))
    samples = sorted(row["samples"] for row in good if row["samples"])
    for which, filter_name in (("rotation", "rotation"), ("translation", "mass")):
        nis = merit.known(good, f"nis.{which}")
        if nis and samples:
            label = f"mean NIS over a flight (median {samples[len(samples) // 2]} samples)"
            what = (f"nis-{which}", f"NIS of the {filter_name} filter", label)
            plots.append(charts.chi_square(nis, 3, what, samples[len(samples) // 2]))
    sigmas = {name: merit.sigmas(rows, name) for name in NAMES}
    if any(sigmas.values()):
        plots.append(charts.coverage({name: _covered(rows, name) for name in NAMES}))
        plots.append(charts.parameter_histograms(sigmas))
    if times_s and any(sigmas.values()):
        over = {
            time: {
                label: merit.coverage(rows, names, suffix=suffix)
                for label, names in (("rotational parameters", NAMES[:N_ROTATION]), ("1/m", NAMES[N_ROTATION:]))
            }
            for time, suffix in [*((time, f"@{time:g}") for time in sorted(times_s)), (rows[0]["duration_s"], "")]
        }
        plots.append(charts.coverage_over_time(over))
    return plots


def _covered(rows: Sequence[Row], name: str) -> dict[float, Figure]:
    return {sigma: merit.coverage(rows, (name,), sigma) for sigma in (1.0, 2.0, 3.0)}


def _sensitivity_plots(study: Study, cell: Cell) -> list[charts.Json]:
    plots = []
    for size, name, title in (
        (False, "sensitivity", "Rank correlation of each error with each draw"),
        (True, "sensitivity-size", "Rank correlation of each error's size with each draw"),
    ):
        found = merit.sensitivity(cell.rows, study.labels, size=size)
        if found:
            plots.append(charts.correlations(found, name, title))
    if study.spec.file.method == "saltelli" and len(cell.rows) == cell.planned:
        indices = merit.sobol(cell.rows, len(study.labels))
        if indices is not None:
            names, (first, total) = indices
            plots.append(charts.sobol(first, names, study.labels, "alone"))
            plots.append(charts.sobol(total, names, study.labels, "alone and together with others"))
    return plots


# --------------------------------------------------------------------------------------------- tables


def _sweep(study: Study) -> dict[str, Any] | None:
    """Returns the main figures of each cell, side by side."""
    if len(study.cells) < 2:
        return None
    found = [merit.figures(cell.rows) for cell in study.cells]
    names = [name for name in _MAIN if any(figures[name].n for figures in found)]
    return {
        "cells": [cell.label for cell in study.cells],
        "reference": study.reference,
        "cases": [len(flown(cell.rows)) for cell in study.cells],
        "rows": [
            {
                "words": MEANINGS[name].words,
                "values": [shown(figures[name], MEANINGS[name].unit, interval=False) for figures in found],
                "intervals": [row_of(name, figures[name])["interval"] for figures in found],
            }
            for name in names
        ],
    }


def _false(rows: Sequence[Row]) -> list[dict[str, str]]:
    table = []
    for cause in (*CAUSES, None):
        found = merit.false_declarations(rows, cause)
        hours = merit.hours(judgeable(rows), cause)
        if not hours:
            continue
        figure = merit.false_rate(rows, cause)
        table.append(
            {
                "cause": "all" if cause is None else MEANINGS[f"false_declarations_per_hour_{cause}"].words,
                "count": str(len(found)),
                "withdrawn": str(sum(entry["withdrawn_s"] is not None for entry in found)),
                "hours": f"{hours:.3g}",
                "rate": shown(figure, "", interval=False),
                "interval": between(figure, ""),
            }
        )
    return table


def _false_of(rows: Sequence[Row]) -> list[tuple[str, int]]:
    """Counts false declarations by jet, the most frequent first."""
    names = (
        entry["jet"] or ("a jump of the mass properties" if entry["cluster"] is None else f"cluster {entry['cluster']}")
        for entry in merit.false_declarations(rows)
    )
    return Counter(names).most_common(15)


def _healthy_out(rows: Sequence[Row], clusters: Mapping[str, int]) -> dict[str, Any]:
    """Counts healthy jets out of use at the end: beside a jet that failed, in its cluster, or elsewhere.

    Args:
        rows: of a cell.
        clusters: number of each jet's cluster, by designation.
    """
    beside: Counter[str] = Counter()
    elsewhere: Counter[str] = Counter()
    cases = 0
    good = judgeable(rows)
    for row in good:
        failed = {clusters.get(one["jet"]) for one in row["injected"] if one["first_acted_s"] is not None}
        alone = [jet for jet in row["healthy_jets_out"] if clusters.get(jet) not in failed]
        elsewhere.update(alone)
        beside.update(jet for jet in row["healthy_jets_out"] if jet not in alone)
        cases += bool(alone)
    return {
        "share": shown(statistics.share(cases, len(good)), "%"),
        "jets": [(jet, elsewhere[jet], beside[jet]) for jet, _ in (elsewhere + beside).most_common(15)],
    }


def _outcomes(rows: Sequence[Row]) -> list[dict[str, Any]]:
    table: list[dict[str, Any]] = []
    for kind, counts in merit.outcomes(rows).items():
        acted = sum(counts.values()) - counts["never_acted"]
        table.append({"kind": kind.replace("_", " "), "acted": acted, **{name: counts[name] for name in OUTCOMES}})
    if len(table) > 1:
        table.append({"kind": "all", **{name: sum(row[name] for row in table) for name in ("acted", *OUTCOMES)}})
    return table


def _delays(acted: Sequence[InjectedEvent]) -> list[dict[str, Any]]:
    table = []
    groups = merit.by_kind(acted)
    for kind, group in [*groups.items(), *([("all", list(acted))] if len(groups) > 1 else [])]:
        curve = merit.detection_curve(group)
        tested = [event for event in group if event.injected["outcome"] != "not_tested"]
        table.append(
            {
                "kind": kind.replace("_", " "),
                "n": len(group),
                "found": shown(merit.found_share(group, lambda event: event.right), "%"),
                "of_tested": shown(merit.found_share(tested, lambda event: event.right), "%"),
                "within": [shown(curve.at(delay), "%") for delay in DELAYS_S],
                "median": shown(curve.quantile(0.5), "s"),
            }
        )
    return table


def _jumps(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Counts failed jets and payloads that moved, by the declaration of each."""
    table = []
    for payloads, what in ((False, "a failed jet"), (True, "a payload that moved")):
        found = merit.events(rows, payloads=payloads)
        if not found:
            continue
        taken = Counter(_declared_as(event) for event in found)
        table.append({"what": what, "n": len(found), "counts": [taken[column] for column in _DECLARED_AS]})
    return table


_DECLARED_AS = ("the jet or its cluster", "another jet", "a jump", "nothing")


def _declared_as(event: InjectedEvent) -> str:
    jet, a_jump = event.injected["jet"], event.injected["taken_for"] == JUMP
    if event.right:
        return "a jump" if jet is None else "the jet or its cluster"
    if event.injected["outcome"] != "wrong":
        return "nothing"
    return "a jump" if a_jump else "another jet"


def _smallest(found: Sequence[InjectedEvent], force: str) -> list[dict[str, str]]:
    """Returns, by jet, failures found and missed, and the size found with a probability of 0.9."""
    table = []
    for jet, group in merit.by_jet(found).items():
        right = [merit.size_of(event) for event in group if event.right]
        left = [merit.size_of(event) for event in group if not event.right]
        curve = statistics.size_curve([merit.size_of(event) for event in group], [event.right for event in group])
        table.append(
            {
                "jet": jet,
                "found": f"{len(right)} of {len(group)}",
                "smallest": f"{min(right):.3g} {force}" if right else "-",
                "largest_left": f"{max(left):.3g} {force}" if left else "-",
                "size_90": _size_90(curve, force),
            }
        )
    return sorted(table, key=lambda row: row["jet"])


def _size_90(curve: SizeCurve | None, force: str) -> str:
    if curve is None:
        return "-"
    return f"below {curve.smallest:.3g} {force}" if curve.finds_all else shown(curve.size_90, force)


def _magnitudes(acted: Sequence[InjectedEvent], force: str) -> list[dict[str, Any]]:
    table = []
    for kind, group in merit.by_kind(acted).items():
        pairs = merit.magnitude_errors(group)
        if not pairs:
            continue
        sigmas = [abs(z) for _, z in pairs]
        table.append(
            {
                "kind": kind.replace("_", " "),
                "n": str(len(pairs)),
                "bias": shown(statistics.mean([error for error, _ in pairs]), force),
                "rms": f"{math.sqrt(sum(error**2 for error, _ in pairs) / len(pairs)):.3g} {force}",
                "within": [
                    shown(statistics.share(sum(z <= bound for z in sigmas), len(sigmas)), "%") for bound in (1, 2, 3)
                ],
            }
        )
    return table


def _groups(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Returns consistency by the kind of events in a case."""
    groups: dict[str, list[Row]] = {"nothing failed": [], "all failures found": [], "a failure not found": []}
    for row in flown(rows):
        happened = [one["outcome"] for one in row["injected"] if one["outcome"] != "never_acted"]
        right = all(outcome in ("named", "group") for outcome in happened)
        groups["nothing failed" if not happened else "all failures found" if right else "a failure not found"].append(
            row
        )
    return [
        {
            "group": name,
            "n": str(len(group)),
            "wrong": shown(merit.ended_wrong(group), "%"),
            "covered": shown(merit.coverage(group), "%"),
            "nees": shown(statistics.in_band(merit.known(group, "nees.rotation"), N_ROTATION), "%"),
            "nees_mass": shown(statistics.in_band(merit.known(group, "nees.mass"), 1), "%"),
        }
        for name, group in groups.items()
        if group
    ]


def _coverage(rows: Sequence[Row]) -> list[dict[str, Any]]:
    table = []
    for name in NAMES:
        sigmas = merit.sigmas(rows, name)
        if sigmas:
            table.append(
                {
                    "parameter": charts.PARAMETERS[name],
                    "within": [shown(figure, "%") for figure in _covered(rows, name).values()],
                    "mean": shown(statistics.mean(sigmas), ""),
                    "n": str(len(sigmas)),
                }
            )
    return table


def _worst(study: Study) -> list[dict[str, str]]:
    """Returns the worst cases of all cells, with commands to fly them again."""
    cell_of = {row["case_id"]: f", {cell.label}" for cell in study.cells for row in cell.rows if len(study.cells) > 1}
    folder = shlex.quote(str(study.folder))
    table = []
    for row in merit.worst(study.rows):
        number = row["case_id"]
        place = shlex.quote(str(study.folder / "cases" / case_name(number)))
        table.append(
            {
                "case": case_name(number),
                "cell": cell_of.get(number, ""),
                "link": study.kept.get(number, ""),
                "why": "; ".join(row["failing"]),
                "rerun": f"massprop campaign run {folder} --only {number}",
                "view": f"massprop run {place} --view",
            }
        )
    return table


def _execution(study: Study) -> list[tuple[str, str]]:
    rows = study.rows
    spent = sorted(merit.known(rows, "cpu_s"))
    lines = list(study.execution.items())
    if spent:
        lines.append(("processor time", f"{sum(spent) / 3600.0:.3g} h, median {spent[len(spent) // 2]:.3g} s a case"))
    return lines

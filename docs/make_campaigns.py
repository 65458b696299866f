"""Writes the results of finished campaigns into docs/campaigns, a page for each, below its mark; and the index.

    massprop campaign run gyro_quantum --out runs/gyro_quantum
    python docs/make_campaigns.py runs/gyro_quantum ...

What stands above the mark, question and finding, is written by hand and kept.
"""

from __future__ import annotations

import itertools
import math
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy import stats

from massprop_drake.inputs.campaign import bundled_campaigns, load_campaign
from massprop_drake.inputs.distributions import LogUniform
from massprop_drake.inputs.model import digest
from massprop_drake.results.injected import InjectedRecord
from massprop_drake.studies.campaign import merit, statistics, store
from massprop_drake.studies.campaign.campaign import Campaign
from massprop_drake.studies.campaign.counts import Row, flown
from massprop_drake.studies.campaign.plan import PlannedCase, design
from massprop_drake.studies.campaign.reading import told_apart
from massprop_drake.studies.campaign.statistics import Figure

PAGES = Path(__file__).parent / "campaigns"
MARK = "<!-- below: written by docs/make_campaigns.py -->\n"
NEW = "# {title}\n\n{description}.\n\n{mark}"

Measure = Callable[[Sequence[Row]], Figure]

_SIZES = [digit * 10.0**power for power in range(-2, 5) for digit in (1.0, 2.0, 5.0)]  # edges of bins of sizes
_FEW = 6  # sizes that need no bins
_BINS = 4  # of a drawn number
_OUTCOMES = ("named", "group", "wrong", "missed", "not_tested", "never_acted")


class Group(NamedTuple):
    """Rows of cases in one line of a table.

    Attributes:
        labels: of the line, one for each heading.
        rows: cases.
    """

    labels: tuple[str, ...]
    rows: Sequence[Row]


# ------------------------------------------------------------------------------------------ figures


def median(values: Sequence[float]) -> Figure:
    """Computes a median with its distribution-free interval, by order statistics."""
    x = np.sort(np.asarray(values, dtype=float))
    if not x.size:
        return Figure(math.nan, math.nan, math.nan, 0)
    tail = int(stats.binom.ppf(0.5 * (1.0 - statistics.CONFIDENCE), x.size, 0.5))
    low, high = (float(x[tail - 1]), float(x[-tail])) if tail else (math.nan, math.nan)
    return Figure(float(np.median(x)), low, high, x.size)


def _error(row: Row, names: Sequence[str], suffix: str, *, relative: bool) -> float:
    """Computes the largest relative error of some parameters, %, or their error's length; NaN where unknown."""
    errors = [row[f"error{suffix}.{name}"] for name in names]
    if any(error is None for error in errors):
        return math.nan
    if not relative:
        return float(np.linalg.norm(errors))
    return max(100.0 * abs(error / row[f"truth.{name}"]) for error, name in zip(errors, names, strict=True))


def error_median(names: Sequence[str], suffix: str, *, relative: bool = True) -> Measure:
    """Makes the measure of `_error` over cases."""

    def measured(rows: Sequence[Row]) -> Figure:
        errors = [_error(row, names, suffix, relative=relative) for row in flown(rows)]
        return median([error for error in errors if math.isfinite(error)])

    return measured


def named(name: str) -> Measure:
    """Makes the measure of a figure of `merit.figures`."""
    return lambda rows: merit.figures(rows)[name]


def shown(figure: Figure, unit: str) -> str:
    """Formats a figure with its interval and n."""
    if not math.isfinite(figure.value):
        return "-"
    factor = 100.0 if unit == "share" else 1.0
    n = f"{figure.n:.3g} h" if unit == "1/h" else f"{figure.n:g}"
    value, low, high = (f"{factor * part:.3g}" for part in figure[:3])
    interval = f"{low} to {high}, " if math.isfinite(figure.low) else ""
    return f"{value}{' %' if unit == 'share' else ''} ({interval}n {n})"


def estimates(suffix: str, length: str) -> dict[str, tuple[str, Measure]]:
    """Returns columns about estimates: unit and measure by heading."""
    return {
        "inverse inertia, %": ("", error_median(("Ixx_inv", "Iyy_inv", "Izz_inv"), suffix)),
        f"center of mass, {length}": ("", error_median(("x_cm", "y_cm", "z_cm"), suffix, relative=False)),
        "1/m, %": ("", error_median(("m_inv",), suffix)),
    }


CONSISTENCY = {
    "ended wrong": ("share", named("ended_wrong")),
    "within 3 sigma": ("share", named("coverage_3_sigma")),
    "NEES in band": ("share", named("nees_in_band")),
}
INNOVATIONS = {  # of healthy flights alone: a failure shows in them
    "NIS, rotation": ("", named("nis_rotation")),
    "NIS, translation": ("", named("nis_translation")),
}
HEALTHY = {
    "false declarations, 1/h": ("1/h", named("false_declarations_per_hour")),
    "of them before any failure, 1/h": ("1/h", named("false_declarations_per_hour_healthy")),
    "cases with healthy jets out": ("share", named("healthy_jets_out")),
}
FAILURES = {
    "isolated": ("share", named("isolated")),
    "taken for another": ("share", named("wrong")),
    "missed": ("share", named("missed")),
    "not tested": ("share", named("not_tested")),
    "found within 1 s": ("share", named("found_within_1_s")),
    "within 5 s": ("share", named("found_within_5_s")),
    "median delay, s": ("", named("delay_50_percent_s")),
}


# ------------------------------------------------------------------------------------------- tables


def table(headings: Sequence[str], lines: Iterable[Sequence[str]]) -> str:
    """Formats a table in Markdown."""
    rows = [headings, ["---"] * len(headings), *lines]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in rows)


def figures_table(headings: Sequence[str], groups: Sequence[Group], columns: Mapping[str, tuple[str, Measure]]) -> str:
    """Makes a line for each group, a column for each measure; columns without any number are left out."""
    cells = {name: [shown(measure(group.rows), unit) for group in groups] for name, (unit, measure) in columns.items()}
    cells = {name: column for name, column in cells.items() if set(column) != {"-"}}
    if not cells:
        return ""
    lines = [(*group.labels, *(cells[name][place] for name in cells)) for place, group in enumerate(groups)]
    return table((*headings, *cells), lines)


def outcomes_table(headings: Sequence[str], groups: Sequence[Group]) -> str:
    """Makes a table of the outcomes of each group's failures, and how soon they were found."""
    lines = []
    for group in groups:
        found = [one["outcome"] for row in flown(group.rows) for one in row["injected"]]
        curve = merit.detection_curve(merit.events(group.rows))
        rest = [merit.figures(group.rows)["isolated"], curve.at(1.0), curve.at(5.0)]
        counts = [str(found.count(outcome)) for outcome in _OUTCOMES]
        lines.append((*group.labels, str(len(found)), *counts, *(shown(figure, "share") for figure in rest)))
    heads = [outcome.replace("_", " ") for outcome in _OUTCOMES]
    return table((*headings, "n", *heads, "isolated, of those that acted", "within 1 s", "within 5 s"), lines)


def sized(rows: Sequence[Row], campaign: Campaign, cases: Sequence[PlannedCase]) -> list[dict[str, Any]]:
    """Returns cases with the planned size of each failure: the force of a leak, or a degraded jet's loss, lbf or N."""
    base = campaign.spec.base
    thrusts = {jet.designation: jet.thrust for jet in base.vehicle_data.jets}
    usual = base.model_dump(mode="json", include={"failures"})["failures"]
    given = {case.case_id: case.settings.get("failures", usual) for case in cases}

    def size(failure: Mapping[str, Any]) -> float | None:
        if failure["kind"] == "degraded":
            return (1.0 - failure["fraction"]) * thrusts[failure["jet"]]
        return failure.get("force")

    found = []
    for row in flown(rows):
        sizes = [*map(size, given[row["case_id"]]), *[None] * len(row["injected"])]  # payloads come last
        injected = [{**one, "size": each} for one, each in zip(row["injected"], sizes, strict=False)]
        found.append({**row, "injected": injected})
    return found


def by_failure(group: Group, force: str) -> list[Group]:
    """Groups failures by kind and size; in each row that is returned, those of one kind and size are left."""
    ones = [one for row in flown(group.rows) for one in row["injected"]]
    binned = len({one["size"] for one in ones} - {None}) > _FEW

    def label(one: Mapping[str, Any]) -> tuple[float, str, str]:
        size, kind = one["size"], one["kind"].replace("_", " ")
        if size is None:
            return 0.0, kind, "-"
        if not binned:
            return size, kind, f"{size:.3g} {force}"
        low, high = next((a, b) for a, b in itertools.pairwise([0.0, *_SIZES, math.inf]) if a <= size < b)
        return low, kind, f"{low:g} to {high:g} {force}"

    labels = sorted({label(one) for one in ones}, key=lambda item: (item[1], item[0]))
    return [
        Group((*group.labels, *which[1:]), _only(group.rows, lambda _, one, which=which: label(one) == which))  # type: ignore[misc]
        for which in labels
    ]


def by_order(group: Group) -> list[Group]:
    """Groups failures by their order in the flight."""
    most = max((len(row["injected"]) for row in flown(group.rows)), default=0)
    return [
        Group((*group.labels, str(place + 1)), _only(group.rows, lambda index, _, place=place: index == place))  # type: ignore[misc]
        for place in range(most)
    ]


def _only(rows: Sequence[Row], wanted: Callable[[int, Mapping[str, Any]], bool]) -> list[Row]:
    """Returns cases with some of their failures alone; those that have none left are left out."""
    kept = [
        {**row, "injected": [one for index, one in enumerate(row["injected"]) if wanted(index, one)]}
        for row in flown(rows)
    ]
    return [row for row in kept if row["injected"]]


def outcome_matrix(rows: Sequence[Row], force: str) -> str:
    """Makes a table of outcomes by jet and failure, where each case is one of its own; else nothing."""
    cells: dict[tuple[str, str], str] = {}
    for row in flown(rows):
        if len(row["injected"]) != 1:
            return ""
        (given,) = row["injected"]
        one, size = InjectedRecord(*(given[name] for name in InjectedRecord._fields)), given["size"]
        kind = one.kind.replace("_", " ") + ("" if size is None else f" {size:.3g} {force}")
        if (str(one.jet), kind) in cells:
            return ""
        delay = math.nan if one.declared_s is None else one.declared_s - (one.first_acted_s or math.nan)
        text = one.outcome.replace("_", " ")
        text += f" for {one.taken_for}" if one.taken_for else ""
        cells[str(one.jet), kind] = text if math.isnan(delay) else f"{text}, {delay:.3g} s"
    kinds = list(dict.fromkeys(kind for _, kind in cells))
    jets = list(dict.fromkeys(jet for jet, _ in cells))
    return table(("jet", *kinds), [(jet, *(cells.get((jet, kind), "-") for kind in kinds)) for jet in jets])


def by_draw(rows: Sequence[Row], values: Mapping[int, float]) -> list[Group]:
    """Groups cells by a drawn number, as many in each bin."""
    inner = np.quantile(list(values.values()), np.linspace(0.0, 1.0, _BINS + 1)[1:-1])
    edges = [min(values.values()), *inner.tolist(), max(values.values())]
    place = {case: int(np.searchsorted(inner, value, side="right")) for case, value in values.items()}
    return [
        Group((f"{low:.3g} to {high:.3g}",), [row for row in rows if place[row["case_id"]] == number])
        for number, (low, high) in enumerate(itertools.pairwise(edges))
    ]


# -------------------------------------------------------------------------------------------- pages


def results(folder: Path) -> tuple[Campaign, str]:
    """Makes the generated part of a campaign's page.

    Raises:
        InputError: when the folder holds no campaign, or nothing has been flown.
    """
    campaign = Campaign.load(folder)
    cases, _ = store.read_plan(folder)
    found = store.read_rows(folder)
    rows = [] if found is None else found.to_pylist()
    good, spec = sized(rows, campaign, cases), campaign.spec
    units = spec.base.vehicle_data.unit_names
    swept = {case.cell: case.swept for case in cases}
    keys, values = told_apart(list(swept.values()))
    headings, labels = [f"`{key}`" for key in keys], dict(zip(swept, values, strict=True))
    cell = {case.case_id: case.cell for case in cases}
    groups = [Group(label, [row for row in good if cell[row["case_id"]] == number]) for number, label in labels.items()]
    groups = [group for group in groups if group.rows]

    parts = [
        f"{len(rows)} of {len(cases)} flights, {merit.hours(rows):.3g} h; {len(rows) - len(good)} failed to run. "
        "In parentheses the 95 % interval and what a figure was measured on. "
        f"Base scenario {digest(spec.base)[:12]}, seed {spec.file.seed}."
    ]

    def section(title: str, text: str) -> None:
        if text:
            parts.append(f"## {title}\n\n{text}")

    at = spec.file.times_s[0] if spec.file.times_s else None
    suffix, when = ("", "at the end") if at is None else (f"@{at:g}", f"at {at:g} s")
    heads = headings or ["all"]
    lines = groups if headings else [Group(("all",), good)]
    section(f"Error, median, {when}", figures_table(heads, lines, estimates(suffix, units["length"])))
    failed = any(row["injected"] for row in good)
    section("Consistency at the end", figures_table(heads, lines, CONSISTENCY | ({} if failed else INNOVATIONS)))
    section("Healthy jets", figures_table(heads, lines, HEALTHY))
    section("Failures", figures_table(heads, lines, FAILURES))
    if failed:
        kinds = [one for group in groups for one in by_failure(group, units["force"])]
        section("Failures by kind and size", outcomes_table([*headings, "kind", "size"], kinds))
        if max(len(row["injected"]) for row in good) > 1:
            order = [one for group in groups for one in by_order(group)]
            section("Failures by their order in the flight", outcomes_table([*headings, "number"], order))
        section("Every case", outcome_matrix(good, units["force"]))
    for quantity in spec.quantities:
        if isinstance(quantity.distribution, LogUniform) and not quantity.label.startswith("failures"):
            drawn = {case.case_id: float(case.drawn[quantity.label]) for case in cases}
            columns = CONSISTENCY | HEALTHY | FAILURES
            text = figures_table([f"`{quantity.label}`"], by_draw(good, drawn), columns)
            section(f"By `{quantity.label}`", text)
    return campaign, "\n\n".join(parts) + "\n"


def updated(page: str, text: str) -> str:
    """Returns a page with its generated part replaced.

    Raises:
        ValueError: when the page has no mark.
    """
    above, mark, _ = page.partition(MARK)
    if not mark:
        raise ValueError(f"the page has no line {MARK.strip()!r}")
    return f"{above}{mark}\n{text}"


def write_page(folder: Path, pages: Path = PAGES) -> Path:
    """Writes the page of the campaign in a folder; what is above the mark stays."""
    campaign, text = results(folder)
    file = campaign.spec.file
    path = pages / f"{file.name}.md"
    if path.exists():
        page = path.read_text(encoding="utf-8")
    else:
        title = file.name.replace("_", " ").capitalize()
        page = NEW.format(title=title, description=file.description, mark=MARK)
    path.write_text(updated(page, text), encoding="utf-8")
    return path


def write_index(pages: Path = PAGES) -> None:
    """Writes the table of all bundled campaigns into the index."""
    lines = []
    for name in bundled_campaigns():
        spec = load_campaign(name)
        flights = len(design(spec)) * math.prod(len(values) for values in spec.file.sweep.values())
        link = f"[{name}]({name}.md)" if (pages / f"{name}.md").exists() else name
        lines.append((link, spec.file.description, str(flights)))
    path = pages / "index.md"
    text = table(("campaign", "what it flies", "flights"), lines) + "\n"
    path.write_text(updated(path.read_text(encoding="utf-8"), text), encoding="utf-8")


if __name__ == "__main__":
    for folder in sys.argv[1:]:
        write_page(Path(folder))
    write_index()

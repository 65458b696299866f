"""Writes the results of finished campaigns into docs/campaigns, a page for each, below its mark.

    massprop campaign run gyro_quantum --out runs/gyro_quantum
    python docs/make_campaigns.py runs/gyro_quantum ...

What stands above the mark, question and finding, is written by hand and kept. The repository keeps few of the pages;
the headline of every campaign stands in docs/campaigns.md, by hand.
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

from massprop_drake.inputs.distributions import LogUniform
from massprop_drake.inputs.model import digest
from massprop_drake.results.injected import InjectedRecord
from massprop_drake.studies.campaign import merit, statistics, store
from massprop_drake.studies.campaign.campaign import Campaign
from massprop_drake.studies.campaign.counts import Row, select_flown
from massprop_drake.studies.campaign.plan import PlannedCase
from massprop_drake.studies.campaign.reading import find_varying_keys
from massprop_drake.studies.campaign.statistics import Figure

PAGES = Path(__file__).parent / "campaigns"
MARK = "<!-- below: written by docs/make_campaigns.py -->\n"
NEW = "# {title}\n\n{description}.\n\n{mark}"
NOTES = (
    "Errors are medians {when}. In parentheses stands the 95 % interval. `n` is what a line's first figure was "
    "measured on; where another's differs, it stands beside it. "
    "[Campaigns](../campaigns.md#what-the-figures-mean) has the words."
)

MATRIX = "The delay in s of what was named; else what became of it."

Measure = Callable[[Sequence[Row]], Figure]
Columns = Mapping[str, tuple[str, Measure]]  # unit and measure by heading

_SIZES = [digit * 10.0**power for power in range(-2, 5) for digit in (1.0, 2.0, 5.0)]  # edges of bins of sizes
_FEW = 6  # sizes that need no bins
_BINS = 4  # of a drawn number
_OUTCOMES = ("named", "group", "wrong", "missed", "not_tested", "never_acted")


class Group(NamedTuple):
    """Rows of a table's line.

    Attributes:
        labels: of the line, one for each heading.
        rows: cases.
    """

    labels: tuple[str, ...]
    rows: Sequence[Row]


# ------------------------------------------------------------------------------------------ figures


def median(values: Sequence[float]) -> Figure:
    """A median with its distribution-free interval, by order statistics."""
    x = np.sort(np.asarray(values, dtype=float))
    if not x.size:
        return Figure(math.nan, math.nan, math.nan, 0)
    tail = int(stats.binom.ppf(0.5 * (1.0 - statistics.CONFIDENCE), x.size, 0.5))
    low, high = (float(x[tail - 1]), float(x[-tail])) if tail else (math.nan, math.nan)
    return Figure(float(np.median(x)), low, high, x.size)


def _error(row: Row, names: Sequence[str], suffix: str, *, relative: bool) -> float:
    """Largest relative error of some parameters, %, or the length of their error's vector; NaN where unknown."""
    errors = [row[f"error{suffix}.{name}"] for name in names]
    if any(error is None for error in errors):
        return math.nan
    if not relative:
        return float(np.linalg.norm(errors))
    return max(100.0 * abs(error / row[f"truth.{name}"]) for error, name in zip(errors, names, strict=True))


def error_median(names: Sequence[str], suffix: str, *, relative: bool = True) -> Measure:
    """The measure of `_error` over cases."""

    def measured(rows: Sequence[Row]) -> Figure:
        errors = [_error(row, names, suffix, relative=relative) for row in select_flown(rows)]
        return median([error for error in errors if math.isfinite(error)])

    return measured


def named(name: str) -> Measure:
    """A figure of `merit.figures`."""
    return lambda rows: merit.figures(rows)[name]


def number(figure: Figure, unit: str) -> str:
    """Formats the number that a figure was measured on: hours of a rate, else a count."""
    return f"{figure.n:.3g} h" if unit == "1/h" else f"{figure.n:g}"


def shown(figure: Figure, unit: str, usual: str = "") -> str:
    """Formats a figure with its interval, and its n where that is not the usual one."""
    if not math.isfinite(figure.value):
        return "-"
    factor = 100.0 if unit == "share" else 1.0
    n = number(figure, unit)
    value, low, high = (f"{factor * part:.3g}" for part in figure[:3])
    inside = [f"{low} to {high}"] if math.isfinite(figure.low) else []
    inside += [f"n {n}"] if n != usual else []
    return f"{value} ({', '.join(inside)})" if inside else value


def estimates(suffix: str, length: str) -> Columns:
    """Returns columns about estimates: unit and measure by heading."""
    return {
        "inverse inertia, %": ("", error_median(("Ixx_inv", "Iyy_inv", "Izz_inv"), suffix)),
        f"center of mass, {length}": ("", error_median(("x_cm", "y_cm", "z_cm"), suffix, relative=False)),
        "1/m, %": ("", error_median(("m_inv",), suffix)),
    }


CONSISTENCY: Columns = {
    "ended wrong, %": ("share", named("ended_wrong")),
    "within 3 sigma, %": ("share", named("coverage_3_sigma")),
    "NEES in band, %": ("share", named("nees_in_band")),
}
INNOVATIONS: Columns = {  # of healthy flights alone: a failure shows in them
    "NIS, rotation": ("", named("nis_rotation")),
    "NIS, translation": ("", named("nis_translation")),
}
FAILURES: Columns = {
    "isolated, %": ("share", named("isolated")),
    "taken for another, %": ("share", named("wrong")),
    "missed, %": ("share", named("missed")),
    "not tested, %": ("share", named("not_tested")),
    "found within 5 s, %": ("share", named("found_within_5_s")),
    "median delay, s": ("", named("delay_50_percent_s")),
}
HEALTHY: Columns = {
    "healthy jets out, %": ("share", named("healthy_jets_out")),
    "false, 1/h": ("1/h", named("false_declarations_per_hour")),
    "false before any failure, 1/h": ("1/h", named("false_declarations_per_hour_healthy")),
}


# ------------------------------------------------------------------------------------------- tables


def table(headings: Sequence[str], lines: Iterable[Sequence[str]]) -> str:
    """Makes a table in Markdown."""
    rows = [headings, ["---"] * len(headings), *lines]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in rows)


def figures_table(headings: Sequence[str], groups: Sequence[Group], columns: Columns) -> str:
    """Makes a line for each group, a column for each measure."""
    figures = {name: (unit, [measure(group.rows) for group in groups]) for name, (unit, measure) in columns.items()}
    return formatted(headings, [group.labels for group in groups], figures)


def formatted(
    headings: Sequence[str], labels: Sequence[tuple[str, ...]], figures: Mapping[str, tuple[str, Sequence[Figure]]]
) -> str:
    """Makes a table of figures with the n of each line's first; columns without any number are left out.

    Args:
        headings: of the labels.
        labels: of each line.
        figures: unit, and the figure of each line, by heading.
    """
    kept = {
        name: column for name, column in figures.items() if any(math.isfinite(figure.value) for figure in column[1])
    }
    if not kept:
        return ""
    unit, first = next(iter(kept.values()))
    usual = [number(figure, unit) for figure in first]
    lines = [
        (*label, usual[place], *(shown(column[place], unit, usual[place]) for unit, column in kept.values()))
        for place, label in enumerate(labels)
    ]
    return table((*headings, "n", *kept), lines)


def outcomes_table(headings: Sequence[str], groups: Sequence[Group]) -> str:
    """Makes a table of how the failures of each group ended."""
    found = [[one["outcome"] for row in select_flown(group.rows) for one in row["injected"]] for group in groups]
    counts = [[each.count(outcome) for outcome in _OUTCOMES] for each in found]
    return counts_table(headings, [group.labels for group in groups], counts)


def counts_table(headings: Sequence[str], labels: Sequence[tuple[str, ...]], counts: Sequence[Sequence[int]]) -> str:
    """Counts how many failures of each line ended in each of `_OUTCOMES`, but for outcomes that none has."""
    kept = [place for place in range(len(_OUTCOMES)) if any(line[place] for line in counts)]
    lines = [
        (*label, str(sum(line)), *(str(line[place]) for place in kept))
        for label, line in zip(labels, counts, strict=True)
    ]
    return table((*headings, "n", *(_OUTCOMES[place].replace("_", " ") for place in kept)), lines)


def sized(rows: Sequence[Row], campaign: Campaign, cases: Sequence[PlannedCase]) -> list[dict[str, Any]]:
    """Adds the planned size of each failure to cases: the force of a leak, what a degraded jet lacks, lbf or N."""
    base = campaign.spec.base
    thrusts = {jet.designation: jet.thrust for jet in base.vehicle_data.jets}
    usual = base.model_dump(mode="json", include={"failures"})["failures"]
    given = {case.case_id: case.settings.get("failures", usual) for case in cases}

    def size(failure: Mapping[str, Any]) -> float | None:
        if failure["kind"] == "degraded":
            return (1.0 - failure["fraction"]) * thrusts[failure["jet"]]
        return failure.get("force")

    found = []
    for row in select_flown(rows):
        sizes = [*map(size, given[row["case_id"]]), *[None] * len(row["injected"])]  # payloads come last
        injected = [{**one, "size": each} for one, each in zip(row["injected"], sizes, strict=False)]
        found.append({**row, "injected": injected})
    return found


def by_failure(group: Group, force: str) -> list[Group]:
    """Failures by kind and size; in each row that is returned, those of one kind and size are left."""
    ones = [one for row in select_flown(group.rows) for one in row["injected"]]
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
    """Failures by their order in the flight."""
    most = max((len(row["injected"]) for row in select_flown(group.rows)), default=0)
    return [
        Group((*group.labels, str(place + 1)), _only(group.rows, lambda index, _, place=place: index == place))  # type: ignore[misc]
        for place in range(most)
    ]


def _only(rows: Sequence[Row], wanted: Callable[[int, Mapping[str, Any]], bool]) -> list[Row]:
    """Cases with some of their failures alone; those that have none left are left out."""
    kept = [
        {**row, "injected": [one for index, one in enumerate(row["injected"]) if wanted(index, one)]}
        for row in select_flown(rows)
    ]
    return [row for row in kept if row["injected"]]


def outcome_matrix(rows: Sequence[Row], force: str) -> str:
    """Makes a table of every jet's failures, where each case is a jet and a failure of its own; else nothing."""
    cells: dict[tuple[str, str], str] = {}
    for row in select_flown(rows):
        if len(row["injected"]) != 1:
            return ""
        (given,) = row["injected"]
        one, size = InjectedRecord(*(given[name] for name in InjectedRecord._fields)), given["size"]
        kind = one.kind.replace("_", " ") + ("" if size is None else f" {size:.3g} {force}")
        if (str(one.jet), kind) in cells:
            return ""
        delay = math.nan if one.declared_s is None else one.declared_s - (one.first_acted_s or math.nan)
        words = "" if one.outcome == "named" else one.outcome.replace("_", " ")
        words += f" for {one.taken_for}" if one.taken_for else ""
        cells[str(one.jet), kind] = words if math.isnan(delay) else f"{words} {delay:.3g}".strip()
    kinds = list(dict.fromkeys(kind for _, kind in cells))
    jets = list(dict.fromkeys(jet for jet, _ in cells))
    rows = [(jet, *(cells.get((jet, kind), "-") for kind in kinds)) for jet in jets]
    return f"{MATRIX}\n\n{table(('jet', *kinds), rows)}"


def by_draw(rows: Sequence[Row], values: Mapping[int, float]) -> list[Group]:
    """Cells by a drawn number, as many in each bin."""
    inner = np.quantile(list(values.values()), np.linspace(0.0, 1.0, _BINS + 1)[1:-1])
    edges = [min(values.values()), *inner.tolist(), max(values.values())]
    place = {case: int(np.searchsorted(inner, value, side="right")) for case, value in values.items()}
    return [
        Group((f"{low:.3g} to {high:.3g}",), [row for row in rows if place[row["case_id"]] == number])
        for number, (low, high) in enumerate(itertools.pairwise(edges))
    ]


# -------------------------------------------------------------------------------------------- pages


def results(folder: Path) -> tuple[Campaign, str]:
    """The generated part of a campaign's page.

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
    keys, values = find_varying_keys(list(swept.values()))
    headings, labels = [f"`{key}`" for key in keys], dict(zip(swept, values, strict=True))
    cell = {case.case_id: case.cell for case in cases}
    groups = [Group(label, [row for row in good if cell[row["case_id"]] == number]) for number, label in labels.items()]
    groups = [group for group in groups if group.rows]

    at = spec.file.times_s[0] if spec.file.times_s else None
    suffix, when = ("", "at the end") if at is None else (f"@{at:g}", f"at {at:g} s")
    parts = [
        f"{len(rows)} of {len(cases)} flights, {merit.hours(rows):.3g} h; {len(rows) - len(good)} failed to run. "
        f"{NOTES.format(when=when)} Base scenario {digest(spec.base)[:12]}, seed {spec.file.seed}."
    ]

    def section(title: str, text: str) -> None:
        if text:
            parts.append(f"## {title}\n\n{text}")

    lines = groups if headings else [Group((), good)]
    failed = any(row["injected"] for row in good)
    about = estimates(suffix, units["length"]) | CONSISTENCY | ({} if failed else INNOVATIONS)
    section("Estimates", figures_table(headings, lines, about))
    section("Declarations", figures_table(headings, lines, FAILURES | HEALTHY))
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
            text = figures_table([f"`{quantity.label}`"], by_draw(good, drawn), CONSISTENCY | FAILURES | HEALTHY)
            section(f"By `{quantity.label}`", text)
    return campaign, "\n\n".join(parts) + "\n"


def updated(page: str, text: str) -> str:
    """A page with its generated part replaced.

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


if __name__ == "__main__":
    for folder in sys.argv[1:]:
        write_page(Path(folder))

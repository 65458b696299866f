"""Figures of merit of a campaign, for gates and the report."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from massprop_drake.errors import InputError, suggestion
from massprop_drake.inputs.campaign_file import Gate
from massprop_drake.maths.mass_properties import N_ROTATION, NAMES
from massprop_drake.results.detections import JUMP
from massprop_drake.studies.campaign import statistics
from massprop_drake.studies.campaign.counts import FAILING, WRONG, Row, count_cases, select_flown, select_judgeable
from massprop_drake.studies.campaign.statistics import Detections, Figure

CAUSES = ("healthy", "failure", "jump")  # what had acted last before a false declaration
DELAYS_S = (1.0, 5.0, 30.0)  # within which a failure is found or not
OUTCOMES = ("named", "group", "wrong", "missed", "not_tested", "never_acted")
PAYLOADS = ("release", "dock")
_HOUR_S = 3600.0


class InjectedEvent(NamedTuple):
    """Injected failure in one case.

    Attributes:
        row: of the case.
        injected: what became of it.
        delay_s: from its first effect to its declaration as what it is; NaN where it was not.
        present_s: from its first effect to the end of the run.
    """

    row: Row
    injected: Mapping[str, Any]
    delay_s: float
    present_s: float

    @property
    def right(self) -> bool:
        """True if the declaration is right: of the jet, a group with it, or the payload's jump."""
        return self.injected["outcome"] in ("named", "group")

    @property
    def statistic(self) -> float:
        """Likelihood argument of the right declaration; NaN where there is none."""
        if not self.right:
            return math.nan
        at_s = self.injected["declared_s"]
        declarations = [entry for entry in self.row["declared"] if entry["time_s"] == at_s and not entry["false"]]
        return max((entry["statistic"] for entry in declarations), default=math.nan)


def events(rows: Iterable[Row], *, payloads: bool = False) -> list[InjectedEvent]:
    """Returns the injected jet failures that acted, or the payloads that docked or were released, of flown cases."""
    acted = []
    for row in select_flown(rows):
        for record in row["injected"]:
            if (record["kind"] in PAYLOADS) != payloads or record["first_acted_s"] is None:
                continue
            right = record["outcome"] in ("named", "group")
            delay = record["declared_s"] - record["first_acted_s"] if right else math.nan
            acted.append(InjectedEvent(row, record, delay, row["duration_s"] - record["first_acted_s"]))
    return acted


def count_outcomes(rows: Iterable[Row]) -> dict[str, Counter[str]]:
    """Maps each kind of injected failure or payload event to the numbers of its outcomes."""
    outcomes: dict[str, Counter[str]] = {}
    for row in select_flown(rows):
        for record in row["injected"]:
            outcomes.setdefault(record["kind"], Counter())[record["outcome"]] += 1
    return outcomes


def detection_curve(failures: Sequence[InjectedEvent]) -> Detections:
    """Computes the Kaplan-Meier curve of the delay from failure to right declaration."""
    return statistics.detection_curve(
        [max(0.0, event.delay_s) for event in failures if event.right],
        [max(0.0, event.present_s) for event in failures if not event.right],
    )


def share_of_events(events: Sequence[InjectedEvent], condition: Callable[[InjectedEvent], bool]) -> Figure:
    """Computes the share of injected events that fulfill a condition, with an interval clustered by case."""
    by_case: dict[int, list[bool]] = {}
    for event in events:
        by_case.setdefault(event.row["case_id"], []).append(condition(event))
    return statistics.clustered_share(
        [sum(case) for case in by_case.values()], [len(case) for case in by_case.values()]
    )


# --------------------------------------------------------------------------------------- false ones


def hours(rows: Iterable[Row], cause: str | None = None) -> float:
    """Computes the time flown in all cases, h, or the part in which a kind of event had acted last."""
    return sum(_exposure_s(row)[cause] if cause else row["duration_s"] for row in select_flown(rows)) / _HOUR_S


def _exposure_s(row: Row) -> dict[str, float]:
    """Splits a case's duration by the kind of event that had acted last: healthy, failure or jump, s each."""
    acted = sorted(
        (record["first_acted_s"], "jump" if record["kind"] in PAYLOADS else "failure")
        for record in row["injected"]
        if record["first_acted_s"] is not None
    )
    times = [0.0, *(time for time, _ in acted), row["duration_s"]]
    spent = dict.fromkeys(CAUSES, 0.0)
    for cause, begin, end in zip(("healthy", *(cause_then for _, cause_then in acted)), times, times[1:], strict=False):
        spent[cause] += max(0.0, end - begin)
    return spent


def false_declarations(rows: Iterable[Row], cause: str | None = None) -> list[Mapping[str, Any]]:
    """Returns false declarations of all cases, of one cause or all."""
    return [
        entry
        for row in select_flown(rows)
        for entry in row["declared"]
        if entry["false"] and (cause is None or entry["cause"] == cause)
    ]


def false_rate(rows: Sequence[Row], cause: str | None = None) -> Figure:
    """Computes false declarations per hour, of all time, or of a cause per hour in which it had acted last."""
    return statistics.rate(len(false_declarations(rows, cause)), hours(select_judgeable(rows), cause))


# --------------------------------------------------------------------------------------- estimates


def normalized_errors(rows: Iterable[Row], name: str, suffix: str = "") -> list[float]:
    """Returns a parameter's error over claimed 1-sigma of every flown case where both are known."""
    ratios = []
    for row in select_flown(rows):
        error, sigma = row[f"error{suffix}.{name}"], row[f"sigma{suffix}.{name}"]
        if error is not None and sigma:
            ratios.append(error / sigma)
    return ratios


def coverage(rows: Sequence[Row], names: Sequence[str] = NAMES, sigma: float = 3.0, suffix: str = "") -> Figure:
    """Computes the share of estimates within some sigma of the truth, over some parameters, clustered by case."""
    inside, sizes = [], []
    for row in select_flown(rows):
        ratios = [abs(z) for name in names for z in normalized_errors([row], name, suffix)]
        inside.append(sum(z <= sigma for z in ratios))
        sizes.append(len(ratios))
    return statistics.clustered_share(inside, sizes)


def known_values(rows: Iterable[Row], column: str) -> list[float]:
    """Returns the values of a column of all rows except None."""
    return [row[column] for row in rows if row[column] is not None]


def ended_wrong_share(rows: Sequence[Row]) -> Figure:
    """Computes the share of cases whose final error exceeds the claimed sigma several times in any parameter."""
    counts = count_cases(rows, len(rows))
    return statistics.share(counts.ended_wrong, counts.measured)


# ----------------------------------------------------------------------------------------- figures


class Meaning(NamedTuple):
    """Meaning of a figure.

    Attributes:
        words: that name it.
        unit: of it; "%" for a share.
        measured_on: what its n counts.
    """

    words: str
    unit: str
    measured_on: str


_CAUSED = {"healthy": "before anything failed", "failure": "after a failure", "jump": "after a payload moved"}
MEANINGS: dict[str, Meaning] = {
    "false_declarations_per_hour": Meaning("False declarations", "1/h", "hours flown"),
    **{
        f"false_declarations_per_hour_{cause}": Meaning(f"False declarations {words}", "1/h", "hours of that")
        for cause, words in _CAUSED.items()
    },
    "false_declarations_in_case": Meaning("Cases with a false declaration", "%", "cases"),
    "healthy_jets_out": Meaning("Cases that end with a healthy jet out of use", "%", "cases"),
    "ended_wrong": Meaning(f"Cases that end wrong ({WRONG})", "%", "cases"),
    "failing": Meaning(f"Cases that are failing ({FAILING})", "%", "cases"),
    "failed_to_run": Meaning("Cases that failed to run", "%", "cases"),
    "isolated": Meaning("Failures found: the jet, or its cluster", "%", "failures"),
    "named": Meaning("Failures found: the jet itself", "%", "failures"),
    **{
        f"found_within_{delay:g}_s": Meaning(f"Failures found within {delay:g} s", "%", "failures")
        for delay in DELAYS_S
    },
    "delay_50_percent_s": Meaning("Delay within which 50 % are found", "s", "failures"),
    "delay_90_percent_s": Meaning("Delay within which 90 % are found", "s", "failures"),
    "wrong": Meaning("Failures taken for something else", "%", "failures"),
    "missed": Meaning("Failures missed", "%", "failures"),
    "not_tested": Meaning("Failures after which no sample could be tested", "%", "failures"),
    "jumps_found": Meaning("Jumps of the mass properties found", "%", "payloads"),
    "coverage_3_sigma": Meaning("Estimates within 3 sigma of the truth (99.7 % expected)", "%", "estimates"),
    "nees_in_band": Meaning("NEES of the nine rotational parameters in its 95 % band", "%", "cases"),
    "nees_mass_in_band": Meaning("NEES of 1/m in its 95 % band", "%", "cases"),
    "nees_mean": Meaning("Mean NEES of the rotational parameters, each (1 expected)", "", "cases"),
    "nis_rotation": Meaning("Mean NIS of the rotation filter, median case (3 expected)", "", "cases"),
    "nis_translation": Meaning("Mean NIS of the mass filter, median case (3 expected)", "", "cases"),
    "converged": Meaning("Cases that converge", "%", "cases"),
}  # fmt: skip


def figures(rows: Sequence[Row]) -> dict[str, Figure]:
    """Computes all figures of merit that a gate can ask for, by name, in the order of `MEANINGS`."""
    good, acted, jumps = select_flown(rows), events(rows), events(rows, payloads=True)
    judged = select_judgeable(rows)
    curve = detection_curve(acted)

    def share_of_cases(column: str) -> Figure:
        """Computes the share of judged cases in which a column is true or above zero."""
        return statistics.share(sum(bool(row[column]) for row in judged), len(judged))

    computed = {
        "false_declarations_per_hour": false_rate(rows),
        **{f"false_declarations_per_hour_{cause}": false_rate(rows, cause) for cause in CAUSES},
        "false_declarations_in_case": share_of_cases("n_false"),
        "healthy_jets_out": share_of_cases("healthy_jets_out"),
        "ended_wrong": ended_wrong_share(rows),
        "failing": share_of_cases("failing"),
        "failed_to_run": statistics.share(len(rows) - len(good), len(rows)),
        "isolated": share_of_events(acted, lambda event: event.right),
        **{
            name: share_of_events(acted, lambda event, name=name: event.injected["outcome"] == name)  # type: ignore[misc]
            for name in ("named", "wrong", "missed", "not_tested")
        },
        **{f"found_within_{delay:g}_s": curve.at(delay) for delay in DELAYS_S},
        **{f"delay_{percent}_percent_s": curve.quantile(0.01 * percent) for percent in (50, 90)},
        "jumps_found": share_of_events(jumps, lambda event: event.right),
        "coverage_3_sigma": coverage(rows),
        "nees_in_band": statistics.share_in_band(known_values(good, "nees.rotation"), N_ROTATION),
        "nees_mass_in_band": statistics.share_in_band(known_values(good, "nees.mass"), 1),
        "nees_mean": statistics.mean([value / N_ROTATION for value in known_values(good, "nees.rotation")]),
        "nis_rotation": statistics.median(known_values(good, "nis.rotation")),
        "nis_translation": statistics.median(known_values(good, "nis.translation")),
        "converged": statistics.share(len(known_values(good, "converged_s")), len(good)),
    }
    return {name: computed[name] for name in MEANINGS}


# -------------------------------------------------------------------------------------------- gates


class GateResult(NamedTuple):
    """Gate, and whether it holds.

    Attributes:
        name: of the figure.
        gate: what was asked.
        figure: what was found.
        value: the figure or the bound of it that counts.
        passes: whether it satisfies the gate; a figure that could not be measured does not.
    """

    name: str
    gate: Gate
    figure: Figure
    value: float
    passes: bool


def require_known_figures(gates: Mapping[str, Gate], source: str) -> None:
    """Checks that every gate names an existing figure of merit, else InputError."""
    for name in gates:
        if name not in MEANINGS:
            raise InputError(f"{source}: gates.{name}: there is no such figure{suggestion(name, list(MEANINGS))}")


def judge_gates(gates: Mapping[str, Gate], figures: Mapping[str, Figure]) -> list[GateResult]:
    """Compares figures of merit with gates; returns the value compared and whether it passes, for each gate."""
    results = []
    for name, gate in gates.items():
        figure = figures[name]
        value = {"estimate": figure.value, "lower_bound": figure.low, "upper_bound": figure.high}[gate.on]
        low = -math.inf if gate.min is None else gate.min
        high = math.inf if gate.max is None else gate.max
        results.append(GateResult(name, gate, figure, value, low <= value <= high))
    return results


# ---------------------------------------------------------------------------------------- isolation

NOT_FOUND, NOT_TESTED, OWN_CLUSTER, JUMP_COLUMN = "not found", "not tested", "its cluster", "jump"


def confusion(events: Sequence[InjectedEvent]) -> Counter[tuple[str, str]]:
    """Counts events by true and declared label: jet, own cluster, jump, not found or not tested."""
    counts: Counter[tuple[str, str]] = Counter()
    for event in events:
        record = event.injected
        counts[record["jet"] or JUMP_COLUMN, _declared_label(record)] += 1
    return counts


def _declared_label(failure: Mapping[str, Any]) -> str:
    """Returns the confusion table's label of what an injected failure was declared as."""
    match failure["outcome"]:
        case "named":
            return failure["jet"] or JUMP_COLUMN
        case "group":
            return OWN_CLUSTER
        case "wrong":
            return JUMP_COLUMN if failure["taken_for"] == JUMP else str(failure["taken_for"])
        case "not_tested":
            return NOT_TESTED
        case _:
            return NOT_FOUND


def sum_by_cluster(counts: Mapping[tuple[str, str], int], clusters: Mapping[str, int]) -> Counter[tuple[str, str]]:
    """Sums the counts of a confusion table over the jets of each cluster, true and declared.

    Args:
        counts: of a confusion.
        clusters: number of each jet's cluster, by designation.
    """
    merged: Counter[tuple[str, str]] = Counter()
    for (true, named), count in counts.items():
        row = f"cluster {clusters[true]}" if true in clusters else true
        column = row if named == OWN_CLUSTER else f"cluster {clusters[named]}" if named in clusters else named
        merged[row, column] += count
    return merged


def group_events(events: Sequence[InjectedEvent], key: str) -> dict[str, list[InjectedEvent]]:
    """Groups failures by `kind` or `jet`, in the order in which these first appear."""
    groups: dict[str, list[InjectedEvent]] = {}
    for event in events:
        groups.setdefault(event.injected[key], []).append(event)
    return groups


def failure_size(event: InjectedEvent) -> float:
    """Returns the true size of a failure: the median of missing or excess force of its jet, lbf or N."""
    return abs(event.injected["force"])


def magnitude_errors(failures: Sequence[InjectedEvent]) -> list[tuple[float, float]]:
    """Returns declared minus true force, lbf or N, and the same over claimed sigma, of all right declarations."""
    pairs = []
    for event in failures:
        record = event.injected
        if event.right and None not in (record["magnitude"], record["force"]) and record["magnitude_std"]:
            error = record["magnitude"] - record["force"]
            pairs.append((error, error / record["magnitude_std"]))
    return pairs


class OperatingPoint(NamedTuple):
    """Operating point of a detector: its detections and false declarations.

    Attributes:
        setting: the threshold, or what else makes the point.
        false_per_hour: false declarations of jets per hour.
        found: share of failures declared as what they are.
        delay_s: within which half of all failures are found.
    """

    setting: Any
    false_per_hour: Figure
    found: Figure
    delay_s: Figure


def operating_point(rows: Sequence[Row], setting: Any, threshold: float = -math.inf) -> OperatingPoint:
    """Computes false rate, share found and median delay of declarations whose likelihood argument reaches a threshold.

    A declaration below the threshold is struck out; the flight itself is not flown again, so that what would have been
    declared later, with more evidence, is not counted: the share found is a lower bound of the detector's.
    """
    acted = events(rows)
    kept = [event if not event.right or event.statistic >= threshold else _as_missed(event) for event in acted]
    false = [entry for entry in false_declarations(rows) if entry["kind"] != JUMP and entry["statistic"] >= threshold]
    curve = detection_curve(kept)
    return OperatingPoint(
        setting,
        statistics.rate(len(false), hours(select_judgeable(rows))),
        share_of_events(kept, lambda event: event.right),
        curve.quantile(0.5),
    )


def _as_missed(failure: InjectedEvent) -> InjectedEvent:
    """Returns an injected failure with the outcome of one that was missed."""
    return failure._replace(injected={**failure.injected, "outcome": "missed"}, delay_s=math.nan)


def operating_curve(rows: Sequence[Row], max_points: int = 40) -> list[OperatingPoint]:
    """Computes operating points at thresholds from the least declared likelihood argument to the largest."""
    declared = [entry["statistic"] for entry in false_declarations(rows) if entry["kind"] != JUMP]
    declared += [event.statistic for event in events(rows) if event.right and not math.isnan(event.statistic)]
    levels = np.unique([level for level in declared if level > 0.0])
    if levels.size > max_points:
        levels = np.unique(np.quantile(levels, np.linspace(0.0, 1.0, max_points)))
    return [operating_point(rows, level, level) for level in levels.tolist()]


# -------------------------------------------------------------------------------------- sensitivity


def sensitivity(rows: Sequence[Row], labels: Sequence[str], *, absolute: bool) -> dict[str, dict[str, Figure]]:
    """Computes rank correlations of each parameter's error with each draw, by parameter, then by draw label.

    Args:
        rows: with the draws in columns `draw.<label>`.
        labels: of the draws; those that are no numbers are left out.
        absolute: whether errors are taken without their sign.
    """
    good = select_flown(rows)
    columns = {}
    for label in labels:
        values = [row[f"draw.{label}"] for row in good]
        if all(isinstance(value, (int, float)) and not isinstance(value, bool) for value in values):
            columns[label] = values
    by_parameter = {}
    for name in NAMES:
        errors = [math.nan if row[f"error.{name}"] is None else row[f"error.{name}"] for row in good]
        sizes = [abs(error) if absolute else error for error in errors]
        correlations = {label: statistics.rank_correlation(values, sizes) for label, values in columns.items()}
        varying = {label: figure for label, figure in correlations.items() if not math.isnan(figure.value)}
        if varying:
            by_parameter[name] = varying
    return by_parameter


def sobol(rows: Sequence[Row], n_draws: int) -> tuple[tuple[str, ...], statistics.SobolIndices] | None:
    """Computes names of parameters and Sobol indices of their errors, for `method: saltelli`; None if incomplete.

    Args:
        rows: of one cell, every sample in its order.
        n_draws: how many quantities are drawn.
    """
    if not rows or len(rows) != len(select_flown(rows)):
        return None
    errors = np.array(
        [[np.nan if row[f"error.{name}"] is None else row[f"error.{name}"] for row in rows] for name in NAMES]
    )
    complete = np.isfinite(errors).all(axis=1)
    if not complete.any():
        return None
    names = tuple(name for name, whole in zip(NAMES, complete.tolist(), strict=True) if whole)
    scale = np.abs(errors[complete]).max(axis=1, keepdims=True)
    return names, statistics.sobol_indices(errors[complete] / np.where(scale > 0.0, scale, 1.0), n_draws)


def worst_cases(rows: Sequence[Row], count: int = 10) -> list[Row]:
    """Returns up to `count` failing cases by number of reasons, then by largest error in sigma, the worst first."""

    def badness(row: Row) -> tuple[int, float]:
        """Returns the number of reasons and the largest error in sigma, to sort by."""
        size = row["largest_sigmas"]
        return len(row["failing"] or ()), 0.0 if size is None else float(np.nan_to_num(size))

    return sorted((row for row in select_flown(rows) if row["failing"]), key=badness, reverse=True)[:count]

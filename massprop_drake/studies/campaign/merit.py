"""Figures of merit of a campaign: what a gate can ask for, and what the report shows."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from massprop_drake.errors import InputError, suggestion
from massprop_drake.inputs.campaign import Gate
from massprop_drake.maths.mass_properties import NAMES, N_ROTATION
from massprop_drake.studies.campaign import statistics
from massprop_drake.studies.campaign.measure import WRONG_SIGMAS
from massprop_drake.studies.campaign.statistics import Detections, Figure

Row = Mapping[str, Any]

CAUSES = ("healthy", "failure", "jump")  # what had acted last before a false declaration
DELAYS_S = (1.0, 5.0, 30.0)  # within which a failure is found or not
PAYLOADS = ("release", "dock")


class Event(NamedTuple):
    """One injected failure in one case.

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
        """Whether it was declared as what it is."""
        return self.injected["outcome"] in ("named", "group")


def flown(rows: Sequence[Row]) -> list[Row]:
    """Cases that could be run."""
    return [row for row in rows if row["status"] == "flown"]


def events(rows: Sequence[Row], *, payloads: bool = False) -> list[Event]:
    """Injected failures of jets that acted, or payloads that came or left."""
    found = []
    for row in flown(rows):
        for one in row["injected"]:
            if (one["kind"] in PAYLOADS) != payloads or one["first_acted_s"] is None:
                continue
            right = one["outcome"] in ("named", "group")
            delay = one["declared_s"] - one["first_acted_s"] if right else math.nan
            found.append(Event(row, one, delay, row["duration_s"] - one["first_acted_s"]))
    return found


def detection_curve(found: Sequence[Event]) -> Detections:
    """Kaplan-Meier curve of the delay to the right declaration."""
    return statistics.detection_curve(
        [max(0.0, event.delay_s) for event in found if event.right],
        [max(0.0, event.present_s) for event in found if not event.right],
    )


def hours(rows: Sequence[Row]) -> float:
    """Time flown by all cases together, h."""
    return sum(row["duration_s"] for row in flown(rows)) / 3600.0


def false_rate(rows: Sequence[Row], cause: str | None = None) -> Figure:
    """False declarations per hour; of one cause, or of all."""
    count = sum(
        1
        for row in flown(rows)
        for entry in row["declared"]
        if entry["false"] and (cause is None or entry["cause"] == cause)
    )
    return statistics.rate(count, hours(rows))


def sigmas(rows: Sequence[Row], name: str, suffix: str = "") -> list[float]:
    """Error over claimed 1-sigma of one parameter in every case where both are known."""
    found = []
    for row in flown(rows):
        error, sigma = row[f"error{suffix}.{name}"], row[f"sigma{suffix}.{name}"]
        if error is not None and sigma:
            found.append(error / sigma)
    return found


def coverage(rows: Sequence[Row], name: str | None = None, sigma: float = 3.0) -> Figure:
    """Share of estimates within some sigma of the truth; of one parameter, or of all."""
    ratios = [abs(z) for one in (NAMES if name is None else (name,)) for z in sigmas(rows, one)]
    return statistics.share(sum(z <= sigma for z in ratios), len(ratios))


def figures(rows: Sequence[Row]) -> dict[str, Figure]:
    """Everything that a gate can ask for, by name."""
    good, acted, jumps = flown(rows), events(rows), events(rows, payloads=True)
    outcomes = Counter(event.injected["outcome"] for event in acted)
    curve = detection_curve(acted)
    found = {
        "false_declarations_per_hour": false_rate(rows),
        **{f"false_declarations_per_hour_{cause}": false_rate(rows, cause) for cause in CAUSES},
        "ended_wrong": statistics.share(
            sum((row["largest_sigmas"] or 0.0) > WRONG_SIGMAS for row in good),
            sum(row["largest_sigmas"] is not None for row in good),
        ),
        "failing": statistics.share(sum(bool(row["failing"]) for row in good), len(good)),
        "healthy_jets_out": statistics.share(sum(bool(row["healthy_jets_out"]) for row in good), len(good)),
        "failed_to_run": statistics.share(len(rows) - len(good), len(rows)),
        "coverage_3_sigma": coverage(rows),
        "nees_in_band": statistics.in_band(_known(good, "nees.rotation"), N_ROTATION),
        "nees_mass_in_band": statistics.in_band(_known(good, "nees.mass"), 1),
        "nees_mean": statistics.mean([value / N_ROTATION for value in _known(good, "nees.rotation")]),
        "nis_rotation": statistics.mean(_known(good, "nis.rotation")),
        "nis_translation": statistics.mean(_known(good, "nis.translation")),
        **{name: statistics.share(outcomes[name], len(acted)) for name in ("named", "wrong", "missed", "not_tested")},
        "isolated": statistics.share(outcomes["named"] + outcomes["group"], len(acted)),
        **{f"found_within_{delay:g}_s": curve.at(delay) for delay in DELAYS_S},
        "jumps_found": statistics.share(sum(event.right for event in jumps), len(jumps)),
    }
    for quantile in (0.5, 0.9):
        delay = curve.quantile(quantile)
        found[f"delay_{round(100 * quantile)}_percent_s"] = Figure(delay, math.nan, math.nan, curve.n)
    return found


def _known(rows: Sequence[Row], column: str) -> list[float]:
    return [row[column] for row in rows if row[column] is not None]


class Passed(NamedTuple):
    """A gate, and whether it holds.

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


def require_known(gates: Mapping[str, Gate], source: str) -> None:
    """Makes sure that each gate asks for a figure that there is.

    Raises:
        InputError: when one does not.
    """
    known = list(figures([]))
    for name in gates:
        if name not in known:
            raise InputError(f"{source}: gates.{name}: there is no such figure{suggestion(name, known)}")


def judged(gates: Mapping[str, Gate], found: Mapping[str, Figure]) -> list[Passed]:
    """Holds figures against gates."""
    results = []
    for name, gate in gates.items():
        figure = found[name]
        value = {"estimate": figure.value, "lower_bound": figure.low, "upper_bound": figure.high}[gate.on]
        low = -math.inf if gate.min is None else gate.min
        high = math.inf if gate.max is None else gate.max
        results.append(Passed(name, gate, figure, value, low <= value <= high))
    return results


def confusion(found: Sequence[Event]) -> dict[tuple[str, str], int]:
    """How often each jet was taken for each; what was not found is "-", a jump "jump"."""
    counts: Counter[tuple[str, str]] = Counter()
    for event in found:
        one = event.injected
        named = {
            "named": one["jet"],
            "group": f"cluster of {one['jet']}",
            "wrong": "jump" if one["taken_for"] == "mass_property_jump" else one["taken_for"],
        }.get(one["outcome"], "-")
        counts[one["jet"], named] += 1
    return dict(counts)


def by_kind(found: Sequence[Event]) -> dict[str, list[Event]]:
    """Failures by their kind, in the order in which kinds appear."""
    groups: dict[str, list[Event]] = {}
    for event in found:
        groups.setdefault(event.injected["kind"], []).append(event)
    return groups


def smallest_leaks(found: Sequence[Event]) -> dict[str, float | None]:
    """The size from which a jet's leak is found with a probability of 0.9, by jet; lbf or N."""
    leaks: dict[str, list[Event]] = {}
    for event in found:
        if event.injected["kind"] == "leak":
            leaks.setdefault(event.injected["jet"], []).append(event)
    return {
        jet: statistics.smallest_found(
            [abs(event.injected["force"]) for event in group], [event.right for event in group]
        )
        for jet, group in leaks.items()
    }


def magnitude_errors(found: Sequence[Event]) -> list[tuple[float, float]]:
    """Declared less true force, lbf or N, and the same over the claimed 1-sigma, of all that was found right."""
    pairs = []
    for event in found:
        one = event.injected
        if event.right and one["magnitude"] is not None and one["magnitude_std"]:
            error = one["magnitude"] - one["force"]
            pairs.append((error, error / one["magnitude_std"]))
    return pairs


def sensitivity(rows: Sequence[Row], labels: Sequence[str]) -> dict[str, dict[str, float]]:
    """Rank correlation of the size of each parameter's error with each draw, by parameter and draw."""
    good = flown(rows)
    columns = {}
    for label in labels:
        values = [row[label] for row in good]
        if all(isinstance(value, (int, float)) for value in values):
            columns[label] = values
    return {
        name: statistics.rank_correlations(
            columns, [math.nan if row[f"error.{name}"] is None else abs(row[f"error.{name}"]) for row in good]
        )
        for name in NAMES
    }


def worst(rows: Sequence[Row], count: int = 10) -> list[Row]:
    """The cases that ended worst: those that failed to run, then failing ones, by the largest error in sigma."""

    def badness(row: Row) -> tuple[bool, int, float]:
        size = row["largest_sigmas"]
        return row["status"] != "flown", len(row["failing"] or ()), 0.0 if size is None else float(np.nan_to_num(size))

    return sorted((row for row in rows if row["failing"] or row["status"] != "flown"), key=badness, reverse=True)[:count]

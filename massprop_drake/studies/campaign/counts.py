"""Counts of cases by outcome: the one place that counts, for status, report and summary alike."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from massprop_drake.studies.campaign.plan import FLOWN

Row = Mapping[str, Any]

WRONG_SIGMAS = 6.0  # sigmas from the truth, beyond which a parameter counts as wrong
COLUMNS = ("case_id", "status", "failing", "n_false", "largest_sigmas")  # of a row that are counted


class Counts(NamedTuple):
    """Numbers of cases.

    Attributes:
        planned: in the plan.
        tried: of them have a row.
        flown: of those could be run.
        judged: of those have known failures: simulated, not read from a telemetry record.
        failing: of those have a wrong estimate, a false or missing declaration, or a healthy jet out of use.
        measured: of those flown have a known error at the end.
        ended_wrong: of those have a parameter more than `WRONG_SIGMAS` off.
        failed_to_run: of those that were tried.
    """

    planned: int
    tried: int
    flown: int
    judged: int
    failing: int
    measured: int
    ended_wrong: int
    failed_to_run: int


class Status(NamedTuple):
    """Progress of a campaign, and outcomes of its cases.

    Attributes:
        counts: of all cases.
        cells: label, settings and counts of each cell of the sweep; one cell without a sweep.
    """

    counts: Counts
    cells: Sequence[tuple[str, Mapping[str, Any], Counts]]


def select_flown(rows: Iterable[Row]) -> list[Row]:
    """Returns the rows of the cases that could be run."""
    return [row for row in rows if row["status"] == FLOWN]


def select_judgeable(rows: Iterable[Row]) -> list[Row]:
    """Returns the rows of simulated cases, whose true failures are known, without telemetry records."""
    return [row for row in select_flown(rows) if row["n_false"] is not None]


def ends_wrong(row: Row) -> bool:
    """Tests whether a case's final error exceeds `WRONG_SIGMAS` claimed sigmas in any parameter."""
    return row["largest_sigmas"] is not None and bool(row["largest_sigmas"] > WRONG_SIGMAS)


def count_cases(rows: Sequence[Row], planned: int) -> Counts:
    """Counts cases by outcome: planned, tried, flown, judged, failing, wrong at the end, failed to run.

    Args:
        rows: those that were tried, with the columns `COLUMNS`.
        planned: number of cases in the plan.
    """
    good, judged = select_flown(rows), select_judgeable(rows)
    return Counts(
        planned=planned,
        tried=len(rows),
        flown=len(good),
        judged=len(judged),
        failing=sum(bool(row["failing"]) for row in judged),
        measured=sum(row["largest_sigmas"] is not None for row in good),
        ended_wrong=sum(map(ends_wrong, good)),
        failed_to_run=len(rows) - len(good),
    )


def sum_counts(parts: Iterable[Counts]) -> Counts:
    """Adds the counts of cases by outcome over the cells of a sweep."""
    return Counts(*map(sum, zip(*parts, strict=True)))


# -------------------------------------------------------------------------------------------- in words

FAILING = "a wrong estimate, a false or missing declaration, or a healthy jet out of use"
WRONG = f"a parameter more than {WRONG_SIGMAS:g} sigma off"


def progress_text(counts: Counts) -> str:
    """Returns a sentence on how many planned cases have been flown."""
    if counts.tried < counts.planned:
        return f"{counts.tried} of {counts.planned} planned cases have been flown so far."
    return f"All {counts.planned} planned cases have been flown."


def failed_to_run_text(counts: Counts) -> str:
    """Returns a sentence on how many cases failed to run; empty for none."""
    return f"{counts.failed_to_run} of {counts.tried} cases failed to run." if counts.failed_to_run else ""


def outcome_sentences(status: Status) -> list[str]:
    """Returns sentences on how many cases fail, and end wrong, in all and by cell; none if nothing is known."""
    kinds = (("failing", "judged", f"are failing ({FAILING})"), ("ended_wrong", "measured", f"end wrong ({WRONG})"))
    sentences = []
    for name, base, words in kinds:
        number, *by_cell = (
            f"{getattr(one, name)} of {getattr(one, base)}"
            for one in (status.counts, *(one for *_, one in status.cells))
        )
        texts = [f"{text} with {label}" for text, (label, *_) in zip(by_cell, status.cells, strict=True)]
        if getattr(status.counts, base):
            sentences.append(f"{number} cases {words}{': ' + '; '.join(texts) if len(texts) > 1 else ''}.")
    return sentences

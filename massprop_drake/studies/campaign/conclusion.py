"""Conclusion of a campaign, made in another process without loading its modules here."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple


class Concluded(NamedTuple):
    """Summary, verdict and page of a campaign.

    Attributes:
        summary: see `report.summarized`.
        verdict: see `report.verdict`.
        page: see `report.page_of`; None where none is asked for.
    """

    summary: dict[str, Any]
    verdict: list[dict[str, Any]]
    page: str | None


def concluded(folder: str | Path, *, with_page: bool) -> Concluded:
    """Makes the conclusion of the campaign in a folder, which is read once for all of it.

    Raises:
        InputError: when the folder holds no campaign that has been run.
    """
    from massprop_drake.studies.campaign import reading, report  # noqa: PLC0415 (called in a process of its own)

    study = reading.read(folder)
    return Concluded(report.summarized(study), report.verdict(study), report.page_of(study) if with_page else None)

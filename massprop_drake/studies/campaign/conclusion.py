"""Conclusion of a campaign, made in another process without loading its modules here."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple


class Conclusion(NamedTuple):
    """Summary, verdict and page of a campaign.

    Attributes:
        summary: see `campaign_report.summary_data`.
        verdict: see `report_words.verdict`.
        page: see `campaign_report.report_page`; None where none is asked for.
    """

    summary: dict[str, Any]
    verdict: list[dict[str, Any]]
    page: str | None


def make_conclusion(folder: str | Path, *, with_page: bool) -> Conclusion:
    """Returns summary, verdict and report page of the campaign in a folder, whose results are read once.

    Raises:
        InputError: when the folder holds no campaign that has been run.
    """
    from massprop_drake.studies.campaign import (  # noqa: PLC0415 (called in a process of its own)
        campaign_report,
        reading,
        report_words,
    )

    study = reading.read(folder)
    return Conclusion(
        campaign_report.summary_data(study),
        report_words.verdict(study),
        campaign_report.report_page(study) if with_page else None,
    )

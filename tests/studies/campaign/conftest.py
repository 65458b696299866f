"""A campaign that is flown once for all tests, some of its cases bad."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from campaign_probe import BAD, CASES, environment, once, study

from massprop_drake.studies.campaign.campaign import Campaign


@pytest.fixture(scope="session")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a short campaign of which four cases fail to run, flown by two workers; change nothing in it."""
    shared = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        shared = shared.parent

    def fly(folder: Path) -> None:
        marked = {**environment(shared / "faulty", bad=BAD), "PROBE_MARK": "flown"}
        with pytest.MonkeyPatch.context() as patch:
            for name, value in marked.items():
                patch.setenv(name, value)
            Campaign.load(study(shared, CASES)).run(folder)

    return once(shared / "flown", fly)

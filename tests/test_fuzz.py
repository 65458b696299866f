"""Spoilt files of every kind: whatever is in them, a result or one message, and nothing half-written.

`MASSPROP_FUZZ=20` makes twenty times as many cases.
"""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import pytest
from malformed_probe import KINDS, QUIET, Case, Sound, judged

CASES = 5 * int(os.environ.get("MASSPROP_FUZZ", "1"))  # of each kind


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Sound:
    """Sound files of every kind that the command line reads."""
    return Sound(tmp_path_factory.mktemp("sound"))


def test_what_is_spoilt_below_is_sound(sound: Sound, tmp_path: Path) -> None:
    for place, command in enumerate(
        (
            "check vehicle.yaml sound.yaml scheduled.yaml campaign.yaml log.csv",
            "run scheduled.yaml --out out",
            "estimate log.csv --resume-from estimated --out out",
            "view run --out page.html",
        )
    ):
        arguments = [*command.split(), *(QUIET if "--out out" in command else ())]
        verdict = judged(lambda *_, given=arguments: Case(given), 0, sound, tmp_path / str(place))  # type: ignore[misc]
        assert (verdict.status, verdict.fault) == (0, ""), verdict.said


@pytest.mark.parametrize("kind", KINDS)
def test_malformed_input_ends_in_a_result_or_a_message(sound: Sound, tmp_path: Path, kind: str) -> None:
    """Status 0 with a whole result or 2 with a message; no traceback, nothing half-written, within five seconds."""
    statuses, faults = set(), []
    for number in range(CASES):
        with tempfile.TemporaryDirectory(dir=tmp_path) as here:
            verdict = judged(KINDS[kind], number, sound, Path(here))
        statuses.add(verdict.status)
        if verdict.fault:
            faults.append(f"{kind} {number}: {verdict.arguments}: {verdict.fault}: {verdict.said}")
    assert not faults, "\n".join([f"{len(faults)} faults", *faults])
    assert 2 in statuses  # there was something to refuse

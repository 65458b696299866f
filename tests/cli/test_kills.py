"""Commands are killed at random moments: what is there is whole, nothing is lost, and the next start tidies.

MASSPROP_KILLS says how often, of the trials of `kill_probe` the first ones.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import kill_probe
import pytest
from conftest import REPOSITORY

COUNT = int(os.environ.get("MASSPROP_KILLS", "6"))


@pytest.mark.parametrize("seed", [20261122])
def test_a_kill_at_any_moment_loses_nothing(tmp_path: Path, seed: int) -> None:
    command = [sys.executable, kill_probe.__file__, str(tmp_path), str(seed), str(COUNT)]
    environment = {**os.environ, "PYTHONPATH": str(REPOSITORY)}  # where the reproduction is
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    found = json.loads(done.stdout)
    assert found["faults"] == []
    assert found["killed"] > COUNT / 2  # the others had ended before

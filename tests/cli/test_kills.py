"""Commands are killed at random moments: what is there is whole, nothing is lost, and the next start tidies.

MASSPROP_KILLS says how often; `kill_probe` does it.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import kill_probe
import pytest

COUNT = int(os.environ.get("MASSPROP_KILLS", str(len(kill_probe.TRIALS))))


@pytest.mark.parametrize("seed", [20261122])
def test_a_kill_at_any_moment_loses_nothing(tmp_path: Path, seed: int) -> None:
    command = [sys.executable, kill_probe.__file__, str(tmp_path), str(seed), str(COUNT)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")

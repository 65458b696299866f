"""How many threads BLAS gets, and who says so."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from massprop_drake.studies.threads import ONE_THREAD

COUNT = (
    "import sys\n"
    "from massprop_drake.cli import main\n"
    "assert 'numpy' not in sys.modules\n"
    "main.run = lambda *_: 0\n"
    "try: main.main()\n"
    "except SystemExit: pass\n"
    "import numpy, threadpoolctl\n"
    "print(*{library['num_threads'] for library in threadpoolctl.threadpool_info()})"
)


@pytest.mark.parametrize(("chosen", "found"), [({}, "1"), ({"OPENBLAS_NUM_THREADS": "2"}, "2")])
def test_the_command_starts_with_one_thread_unless_told_otherwise(chosen: dict[str, str], found: str) -> None:
    if found == "2" and (os.cpu_count() or 1) < 2:
        pytest.skip("there is one core")
    environ = {name: value for name, value in os.environ.items() if name not in ONE_THREAD}
    done = subprocess.run(
        [sys.executable, "-c", COUNT], env={**environ, **chosen}, capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == [found]

"""Functions called in a process of their own."""

from __future__ import annotations

import os
import signal
from concurrent.futures.process import BrokenProcessPool

import pytest

from massprop_drake.errors import InputError, require_text
from massprop_drake.studies.processes import call_in_process


def test_a_process_of_its_own_gives_the_result_and_is_gone() -> None:
    pid = call_in_process(os.getpid)
    assert pid != os.getpid()
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


def test_what_it_raises_is_raised_here() -> None:
    with pytest.raises(InputError, match="has the character NUL"):
        call_in_process(require_text, name="\0")


def test_one_that_is_killed_is_no_result() -> None:
    with pytest.raises(BrokenProcessPool):
        call_in_process(signal.raise_signal, signal.SIGKILL)

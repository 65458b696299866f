"""What flies cases: a child that is replaced, ends by itself, and a worker that knows no Drake."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import psutil
import pytest
from campaign_probe import CHILD, environment, study

from massprop_drake import InputError
from massprop_drake.studies.campaign import worker
from massprop_drake.studies.campaign.campaign import Campaign
from massprop_drake.studies.campaign.worker import CannotFlyError, Child
from massprop_drake.studies.threads import ONE_THREAD


def setup_of(campaign: Campaign, **others: Any) -> dict[str, Any]:
    base = campaign.spec.base.model_dump(mode="json")
    setup = {"base": base, "campaign": "short", "times_s": [], "keep": "none", "folder": "nowhere", "token": None}
    return {**setup, **others}


def only_child() -> psutil.Process:
    """The process that flies cases for this one."""
    (found,) = (one for one in psutil.Process().children() if one.cmdline()[-1:] == [CHILD])
    return found


def test_a_child_has_one_thread_of_blas_and_is_replaced_after_some_cases_or_one_that_hangs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(worker, "LIFE", 2)
    for name, value in environment(tmp_path / "faulty", bad={1: "hang"}).items():
        monkeypatch.setenv(name, value)
    for name in ONE_THREAD:
        monkeypatch.setenv(name, "01")  # as many, so that this process stays as it is, and yet not what is asked for
    campaign = Campaign.load(study(tmp_path, 5))
    child, pids = Child(setup_of(campaign)), []
    try:
        for case in campaign.planned():
            request = {**case._asdict(), "keep": False}
            if case.case_id == 1:
                assert child.fly(request, 1.0, 2000.0)["failed"] == "took longer than 1 s"  # whatever the machine does
                assert not psutil.pid_exists(pids[0])
                continue
            assert "row" in child.fly(request, 600.0, 2000.0)
            pids.append(only_child().pid)
            environ = only_child().environ()
            assert {name: environ[name] for name in ONE_THREAD} == ONE_THREAD
        assert pids[0] != pids[1] == pids[2] != pids[3]
        assert not psutil.pid_exists(pids[1])
        child.end()
        with pytest.raises(CannotFlyError, match="the campaign has ended"):
            child.fly({}, 60.0, 2000.0)
    finally:
        child.close()
    assert not psutil.pid_exists(pids[3])


def test_a_child_that_does_not_start_says_why(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    setup = setup_of(Campaign.load(study(tmp_path, 1)), folder=str(tmp_path), token="not-there")
    with pytest.raises(
        InputError, match=f"does not see {tmp_path}, in which run folders are to be kept; give a folder"
    ):
        worker.require_shared(setup)
    monkeypatch.setattr(worker, "STARTS", 1)
    with pytest.raises(
        CannotFlyError, match=f"can be started: its process ended with status 1: .*does not see {tmp_path}"
    ):
        Child(setup).fly({}, 60.0, 2000.0)


def test_a_child_that_nobody_asks_ends() -> None:
    program = f"from {CHILD.rpartition('.')[0]} import child; child.IDLE_S = 1; child.main()"
    with subprocess.Popen([sys.executable, "-c", program], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.wait() == -14  # SIGALRM
    done = subprocess.run([sys.executable, "-m", CHILD], input=b"", capture_output=True, check=False)
    assert (done.stdout, done.stderr) == (b"", b"")  # nor one whose parent has gone

"""What flies cases: a child that is replaced, ends by itself, and a worker that knows no Drake."""

from __future__ import annotations

import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import psutil
import pytest
from campaign_probe import CHILD, environment, study
from distributed.comm import CommClosedError

from massprop_drake import InputError
from massprop_drake.studies.campaign import engine, worker
from massprop_drake.studies.campaign.campaign import Campaign
from massprop_drake.studies.campaign.execution import differences, execution
from massprop_drake.studies.campaign.worker import CannotFlyError, Child
from massprop_drake.studies.threads import ONE_THREAD


def setup_of(campaign: Campaign, **others: Any) -> dict[str, Any]:
    base = campaign.spec.base.model_dump(mode="json")
    setup = {"base": base, "campaign": "short", "times_s": [], "keep": "none", "folder": "nowhere", "token": None}
    return {**setup, **others}


def test_a_child_is_replaced_after_some_cases_and_has_one_thread_of_blas(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(worker, "_LIFE", 3)
    for name in ONE_THREAD:
        monkeypatch.setenv(name, "01")  # as many, so that this process stays as it is, and yet not what is asked for
    campaign = Campaign.load(study(tmp_path, 4))
    child, pids = Child(setup_of(campaign)), []
    try:
        for case in campaign.planned():
            assert "row" in child.fly({**case._asdict(), "keep": False}, 600.0, 2000.0)
            assert child._process is not None
            pids.append(child._process.pid)
            environ = psutil.Process(pids[-1]).environ()
            assert {name: environ[name] for name in ONE_THREAD} == ONE_THREAD
        assert pids[0] == pids[1] == pids[2] != pids[3]
        assert not psutil.pid_exists(pids[0])
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
    monkeypatch.setattr(worker, "_STARTS", 1)
    with pytest.raises(
        CannotFlyError, match=f"can be started: its process ended with status 1: .*does not see {tmp_path}"
    ):
        Child(setup).fly({}, 60.0, 2000.0)


def test_a_child_that_nobody_asks_ends() -> None:
    program = f"from {CHILD.rpartition('.')[0]} import child; child._IDLE_S = 1; child.main()"
    with subprocess.Popen([sys.executable, "-c", program], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.wait() == -14  # SIGALRM
    done = subprocess.run([sys.executable, "-m", CHILD], input=b"", capture_output=True, check=False)
    assert (done.stdout, done.stderr) == (b"", b"")  # nor one whose parent has gone


def test_each_thread_of_a_worker_has_a_child_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    made = []

    class Told:
        execution: dict[str, str] = {}  # noqa: RUF012

        def __init__(self, setup: Any):
            self.done = ""
            self.key = setup["key"]
            made.append(self)

        def fly(self, case: Any, *_: Any) -> dict[str, Any]:
            return {"row": case}

        def close(self) -> None:
            self.done = "closed"

        def end(self) -> None:
            self.done = "ended"

    monkeypatch.setattr(worker, "Child", Told)

    def work() -> None:
        for key in ("a", "a", "b"):
            assert worker.fly_chunk({"key": key}, [{"n": 1}, {"n": 2}], 1.0, 1.0)["answers"][1] == {"row": {"n": 2}}

    threads = [threading.Thread(target=work) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(child.key for child in made) == ["a", "a", "b", "b"]
    assert {child.done for child in made if child.key == "a"} == {"closed"}
    worker.end("b")
    assert {child.done for child in made if child.key == "b"} == {"ended"}


def test_a_worker_loads_no_drake() -> None:
    program = (
        "import sys, distributed, massprop_drake.studies.campaign.worker\n"
        "print(sorted({name.partition('.')[0] for name in sys.modules} & {'pydrake', 'matplotlib', 'scipy'}))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_without_the_extra_everything_else_works_and_campaigns_say_what_they_need() -> None:
    program = (
        "import sys\n"
        "sys.modules.update(dict.fromkeys(('pyarrow', 'pyarrow.parquet', 'distributed')))\n"
        "from massprop_drake import InputError, load_scenario\n"
        "from massprop_drake.inputs.campaign_file import bundled_campaigns\n"
        "load_scenario('sample_maneuver'), bundled_campaigns()\n"
        "try:\n"
        "    from massprop_drake.studies.campaign.campaign import Campaign\n"
        "except InputError as error:\n"
        "    print(error)\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "campaigns need pyarrow: pip install 'massprop-drake[campaign]'"


def test_how_a_process_executes_is_told_and_compared() -> None:
    here = execution()
    assert here == execution()
    assert differences(here, here) == []
    assert differences({**here, "numpy": "0.1"}, here) == [f"numpy 0.1 instead of {here['numpy']}"]
    assert differences(here, {**here, "compiler": "x"}) == ["compiler unknown instead of x"]
    assert here["blas"]


def test_a_case_that_hangs_ends_at_its_limit_and_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in environment(tmp_path / "faulty", bad={1: "hang"}).items():
        monkeypatch.setenv(name, value)
    campaign = Campaign.load(study(tmp_path, 3))
    child = Child(setup_of(campaign))
    try:
        first, hung, last = ({**case._asdict(), "keep": False} for case in campaign.planned())
        assert "row" in child.fly(first, 600.0, 2000.0)
        assert child._process is not None
        pid = child._process.pid
        assert child.fly(hung, 1.0, 2000.0)["failed"] == "took longer than 1 s"  # whatever else the machine does
        assert not psutil.pid_exists(pid)
        assert "row" in child.fly(last, 600.0, 2000.0)
    finally:
        child.close()


class Gone:
    """A client whose scheduler has just gone, before it has noticed."""

    status = "running"

    def wait_for_workers(self, *_: Any, **__: Any) -> None:
        """There are some, as far as it knows."""

    def run(self, *_: Any, **__: Any) -> Any:
        raise CommClosedError("closed")

    cancel = run


def test_a_scheduler_that_goes_unnoticed_is_told_all_the_same(tmp_path: Path) -> None:
    work = engine.CampaignWork({"keep": "none", "folder": str(tmp_path)}, [], frozenset(), 1.0, 1.0)
    with pytest.raises(InputError, match="connection to the Dask scheduler is lost; --resume goes on"):
        list(engine.flown(Gone(), work, None, tmp_path))  # type: ignore[arg-type]


def test_a_case_that_kills_its_process_is_flown_twice(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in environment(tmp_path / "faulty", bad={0: "abort"}).items():
        monkeypatch.setenv(name, value)
    campaign = Campaign.load(study(tmp_path, 2))
    child = Child(setup_of(campaign))
    starts: list[int] = []
    start = child._start
    monkeypatch.setattr(child, "_start", lambda: (starts.append(1), start())[1])
    try:
        first, second = ({**case._asdict(), "keep": False} for case in campaign.planned())
        assert child.fly(first, 600.0, 2000.0)["failed"] == "its process was ended by SIGABRT: terminate called"
        assert len(starts) == 2
        assert "row" in child.fly(second, 600.0, 2000.0)
        assert len(starts) == 3
    finally:
        child.close()

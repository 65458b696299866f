"""A scheduler and workers that are processes of their own, as on the machines of a cluster."""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from campaign_probe import GOOD, Driver, are_gone, environment, fliers, outcome, study
from dask_probe import client_here
from distributed import Client

from massprop_drake import InputError
from massprop_drake.studies.campaign import engine
from massprop_drake.studies.campaign.campaign import Campaign


class Cluster:
    """A scheduler and workers."""

    def __init__(self, folder: Path, environ: dict[str, str]):
        self._file = folder / "scheduler.json"
        self._environ = {**os.environ, **environ}
        self._log = (folder / "cluster.log").open("a")
        self._processes: list[subprocess.Popen[bytes]] = []

    def scheduler(self) -> subprocess.Popen[bytes]:
        self._file.unlink(missing_ok=True)
        quiet = ["--host", "127.0.0.1", "--port", "0", "--dashboard-address", "127.0.0.1:0"]
        return self._start("scheduler", *quiet)

    def worker(self) -> subprocess.Popen[bytes]:
        return self._start("worker", "--nthreads", "1", "--nworkers", "1", "--no-dashboard")

    def _start(self, what: str, *options: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", "dask", what, "--scheduler-file", str(self._file), *options]
        started = subprocess.Popen(
            command, env=self._environ, stdout=self._log, stderr=self._log, cwd=self._file.parent
        )
        self._processes.append(started)
        return started

    @property
    def address(self) -> str:
        with Client(scheduler_file=str(self._file), timeout=600) as client:  # which waits for the file
            return str(client.scheduler.address)

    def close(self) -> None:
        for process in self._processes:
            with contextlib.suppress(ProcessLookupError):
                process.terminate()
        for process in self._processes:
            process.wait()
        self._log.close()


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[Cluster]:
    made = Cluster(tmp_path, {**environment(tmp_path / "slow", slow_s=0.3), "PROBE_MARK": f"cluster-{tmp_path}"})
    yield made
    made.close()


def test_workers_and_scheduler_may_be_lost(flown: Path, tmp_path: Path, cluster: Cluster) -> None:
    mark = f"cluster-{tmp_path}"
    file, out = study(tmp_path, GOOD), tmp_path / "out"
    scheduler = cluster.scheduler()
    cluster.worker()
    cluster.worker()
    address = cluster.address

    driver = Driver(file, out, {}, scheduler=address)
    assert driver.line().startswith("at")
    worker = fliers(mark)[0].parent()
    assert worker is not None
    for process in (worker.parent(), worker):  # first the one that would start another
        assert process is not None
        process.kill()
    driver.go_on()
    assert driver.line().startswith("at")
    before = Campaign.load(out).status().counts.tried
    scheduler.kill()
    driver.go_on()
    said = driver.to_the_end()
    assert said, driver.ended()
    assert said.startswith("refused the connection to the Dask scheduler is lost; --resume goes on")
    assert driver.ended() == (0, "")
    assert before <= Campaign.load(out).status().counts.tried < GOOD

    cluster.scheduler()
    cluster.worker()
    driver = Driver(file, out, {}, scheduler=cluster.address, resume=True)
    assert driver.to_the_end() == "ended"
    assert driver.ended() == (0, "")
    assert outcome(out).equals(outcome(flown, GOOD))
    assert not fliers(mark)  # the workers wait for another campaign, without children
    cluster.close()
    assert are_gone(mark)


def test_a_worker_that_executes_otherwise_is_refused(
    flown: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    here = shutil.copytree(flown, tmp_path / "out")
    for name, value in {**environment(tmp_path / "site"), "PROBE_PYTHON": "2.7"}.items():
        monkeypatch.setenv(name, value)
    words = r"executes cases differently.*: python 2\.7 instead of 3.*; give all workers"
    with client_here() as client, pytest.raises(InputError, match=words):
        Campaign.load(here).run(client=client, only=[0])
    assert outcome(here).equals(outcome(flown))


def test_a_scheduler_that_is_not_there_is_told_before_anything_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(engine, "_CONNECT_S", 0.5)
    file = study(tmp_path, 2)
    for address in ("nonsense", "tcp://127.0.0.1:x"):
        with pytest.raises(InputError, match=f"--scheduler {address}: no Dask scheduler answers there"):
            Campaign.load(file).run(tmp_path / "out", scheduler=address)
    assert not (tmp_path / "out").exists()

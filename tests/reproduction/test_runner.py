"""Work goes on where it was, whatever ended it, and nothing broken is taken for a result."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import reproduction_fakes as fakes
from conftest import REPOSITORY
from reproduction_fakes import FAILING, SLOW

from reproduction.cases import Calculation, Flight
from reproduction.runner import WORKERS, Store, needed, run_missing, write_result

QUICK = Calculation("quick", fakes.quick, seeds=3)


def _wait_for(condition: Callable[[], bool]) -> None:
    """Waits however long it takes; what never comes is for the limit that every test has."""
    while not condition():
        time.sleep(0.01)


def _results(cache: Path) -> set[str]:
    return {path.name for path in cache.glob("*.npz")}


def _is_alive(process: int) -> bool:
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"  # a zombie is not
    except FileNotFoundError:
        return False


def _interrupted(cache: Path, log: Path, end: signal.Signals) -> set[int]:
    """Seeds that are finished when work in another process is ended after some of it."""
    log.mkdir()
    finished = len(_results(cache)) + fakes.FREE
    environment = {**os.environ, fakes.LOG: str(log), "PYTHONPATH": str(REPOSITORY)}
    command = [sys.executable, str(Path(fakes.__file__)), str(cache)]
    process = subprocess.Popen(command, env=environment, stderr=subprocess.DEVNULL, start_new_session=True)
    _wait_for(lambda: len(_results(cache)) >= finished or process.poll() is not None)
    _wait_for(lambda: len(list(log.iterdir())) >= fakes.FREE + WORKERS or process.poll() is not None)
    os.killpg(process.pid, end) if end is signal.SIGINT else process.kill()
    if end is signal.SIGINT:  # what is under way is waited for
        (log / fakes.GO).touch()
    process.wait()
    workers = {int(path.name.split("-")[1]) for path in log.iterdir() if path.name != fakes.GO}
    _wait_for(lambda: not any(map(_is_alive, workers)))
    return {int(name.split("-")[1]) for name in _results(cache)}


def test_interrupted_work_goes_on(tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    killed = _interrupted(cache, tmp_path / "killed", signal.SIGKILL)
    assert killed == set(range(fakes.FREE))
    finished = _interrupted(cache, tmp_path / "interrupted", signal.SIGINT)
    assert len(killed) + fakes.FREE <= len(finished) < SLOW.seeds
    store = Store(cache)
    assert run_missing(store, [SLOW]) == SLOW.seeds - len(finished)
    for seed in range(SLOW.seeds):
        np.testing.assert_array_equal((store.get(SLOW, seed) or {})["values"], fakes.quick(seed)["values"])
    assert not list(cache.glob(".*")), "left over"


def test_finished_runs_are_not_repeated_and_superseded_ones_go(tmp_path: Path) -> None:
    store = Store(tmp_path)
    for seed in range(QUICK.seeds):
        write_result(store.path(QUICK, seed), fakes.quick(seed))
    current, other = _results(tmp_path), "quick_too-00-0123456789abcdef0123.npz"
    for name in ("quick-00-0123456789abcdef0123.npz", other):
        (tmp_path / name).touch()
    said: list[tuple[int, int]] = []
    assert run_missing(store, [QUICK], lambda *step: said.append(step)) == 0
    assert said == [(3, 3)]
    assert _results(tmp_path) == current | {other}


def test_a_broken_file_is_no_result(tmp_path: Path) -> None:
    store = Store(tmp_path)
    path = store.path(QUICK, 0)
    write_result(path, fakes.quick(0))
    assert store.get(QUICK, 0) is not None
    content = path.read_bytes()
    middle = len(content) // 2
    wrong = content[:middle] + bytes([content[middle] ^ 0xFF]) + content[middle + 1 :]
    for broken in (b"", content[: len(content) // 3], content[:-1], wrong):
        path.write_bytes(broken)
        assert store.get(QUICK, 0) is None
    assert (QUICK, 0, path) in store.missing([QUICK])

    class Unwritable:
        def __array__(self, *_: object, **__: object) -> np.ndarray:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_result(tmp_path / "result.npz", {"values": Unwritable()})  # type: ignore[dict-item]
    assert list(tmp_path.iterdir()) == [path]


def test_a_run_that_fails_is_named(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match="case 'failing', seed 1: lost definiteness"):
        run_missing(Store(tmp_path), [FAILING])


def test_another_setting_is_another_result() -> None:
    flight = Flight("short", "sample_maneuver", ("duration_s=1",))
    changes = {"overrides": ("duration_s=2",), "signals": ("rate",), "from_s": 0.5, "scenario": "stuck_on_29"}
    others = [replace(flight, **{name: value}) for name, value in changes.items()]
    assert len({case.key() for case in (flight, QUICK, Calculation("slow", fakes.held_up), *others)}) == 7
    assert flight.key() == replace(flight, name="renamed").key() == replace(flight, seeds=3).key()


def test_a_case_of_one_seed_is_part_of_every_phase(tmp_path: Path) -> None:
    store = Store(tmp_path)
    once = replace(QUICK, name="once", seeds=1)
    write_result(store.path(once, 0), fakes.quick(7))
    for seed in range(QUICK.seeds):
        write_result(store.path(QUICK, seed), fakes.quick(seed))
    phases = store.phases({"a": QUICK, "b": once})
    assert len(phases) == QUICK.seeds
    for seed, phase in enumerate(phases):
        np.testing.assert_array_equal(phase["a"]["values"], fakes.quick(seed)["values"])
        np.testing.assert_array_equal(phase["b"]["values"], fakes.quick(7)["values"])
    with pytest.raises(LookupError, match="'failing', seed 0"):
        store.phases({"a": FAILING})
    many, some, one = (replace(QUICK, name=name, seeds=seeds) for name, seeds in (("m", 60), ("s", 20), ("o", 1)))
    groups = [{"a": many, "b": some, "c": one}], [{"a": many, "b": some}, {"a": many, "c": one}], [{"c": one}]
    found = [{case.name: case.seeds for case in needed(group)} for group in groups]
    assert found == [{"m": 20, "s": 20, "o": 1}, {"m": 60, "s": 20, "o": 1}, {"o": 1}]  # those that are run


def test_a_flight_keeps_what_it_is_asked_to() -> None:
    kept = Flight("short", "sample_maneuver", ("duration_s=2",), ("rate", "truth"), from_s=1.2).run(3)
    assert set(kept) == {"time_s", "rate", "truth"}
    assert kept["time_s"].tolist() == pytest.approx(np.arange(1.2, 2.04, 0.08).tolist())
    assert len(kept["rate"]) == len(kept["time_s"])

"""The example of docs/live.md, fed over a local socket."""

from __future__ import annotations

import json
import socket
import threading
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from script_probe import script

from massprop_drake import Estimator, load_scenario, simulate
from massprop_drake.display.run import Run

LIVE = Path(__file__).parent.parent / "docs" / "live.py"


@pytest.fixture(scope="module")
def live() -> ModuleType:
    return script(LIVE)


@pytest.fixture(scope="module")
def flown() -> Run:
    return simulate(load_scenario("free_flyer_maneuver", ["duration_s=3", "execution={engine: loop}"]))


def messages(flown: Run) -> list[dict[str, Any]]:
    jets = flown.scenario.vehicle_data.designations
    return [
        {
            "time_s": float(time),
            "gyro": flown["gyro"][row].tolist(),
            "accelerometer": flown["acc"][row].tolist(),
            "jets": {
                jet: share for jet, share in zip(jets, np.nan_to_num(flown["command"][row]), strict=True) if share
            },
        }
        for row, time in enumerate(flown.time_s)
    ]


@pytest.fixture
def sent() -> Iterator[Any]:
    """Sends messages to whoever connects to a local port, a line each, and in pieces, as a network does."""
    threads = []

    def send(content: list[dict[str, Any]]) -> int:
        server = socket.create_server(("127.0.0.1", 0))

        def serve() -> None:
            with server, server.accept()[0] as connection:
                lines = b"".join(json.dumps(one).encode() + b"\n" for one in content)
                for start in range(0, len(lines), 700):
                    connection.sendall(lines[start : start + 700])

        threads.append(threading.Thread(target=serve, daemon=True))
        threads[-1].start()
        return server.getsockname()[1]

    yield send
    for thread in threads:
        thread.join(timeout=10)


def test_the_stream_gives_the_runs_own_estimates(live: ModuleType, flown: Run, sent: Any) -> None:
    vehicle = flown.scenario.vehicle_data
    stream = live.samples("127.0.0.1", sent(messages(flown)))
    steps = list(live.follow(stream, vehicle, Estimator(vehicle, flown.scenario)))
    np.testing.assert_array_equal([step.estimate for step in steps], flown["estimate"])
    np.testing.assert_array_equal([step.standard_deviation for step in steps], flown["standard_deviation"])


def test_the_program_goes_on_from_its_state(
    live: ModuleType, flown: Run, sent: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole, state = messages(flown), tmp_path / "state.json"
    live.main("free_flyer", "127.0.0.1", str(sent(whole[:25])), str(state))
    live.main("free_flyer", "127.0.0.1", str(sent(whole[25:])), str(state))
    in_parts = capsys.readouterr().out.splitlines()[-1]
    live.main("free_flyer", "127.0.0.1", str(sent(whole)))
    assert capsys.readouterr().out.splitlines()[-1] == in_parts
    assert in_parts.startswith("mass ")

"""Live view of a simulation in three dimensions, served on this machine only, in the page of the replay."""

from __future__ import annotations

import json
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from massprop_drake.display import event_marks, flight3d, instruments, interactive, motion
from massprop_drake.display.plot_source import failing_jets as truly_failing
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.maths.mass_properties import CENTER_OF_MASS

if TYPE_CHECKING:
    from massprop_drake.runners.moment import Moment

Array = NDArray[np.float64]

_WAIT_S = 1.0  # between two looks at whether a reader is still there


class Live:
    """Shows a simulation while it runs; pass it to `simulate` as `watch`.

    The page goes on when the simulation has ended: all that it has seen can be played again.

    Args:
        scenario: the one to be simulated.
        speed: how many times faster than real time; infinity: as fast as it is computed.
    """

    def __init__(self, scenario: Scenario, speed: float = 1.0):
        self._scenario, self._speed = scenario, speed
        self._full = np.linalg.norm(scenario.vehicle_data.thrusts, axis=1)
        self._began: float | None = None
        self._before: Moment | None = None
        self._lines: list[str] = []
        self._news = threading.Condition()
        failed = event_marks.failure_marks(scenario, scenario.duration_s)
        page, stage = flight3d.build_scene(scenario, truth=True)
        self._links = stage.links
        data = {
            **flight3d.scenario_page_data(scenario, stage, truth=True),
            "live": True,
            "rows": [],
            "lists": {name: [] for name in (*flight3d.LISTS, "sizes")},
            "gaps": [],
            "moments": flight3d.list_moments(scenario, 0.0, failed, ()),
            "events": [],
        }
        html = flight3d.flight_page(scenario, page, data, live=True).encode()
        self._server = ThreadingHTTPServer(("localhost", 0), _make_handler(html, self))
        self._server.daemon_threads = True
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    @property
    def address(self) -> str:
        """URL of the view, for a browser on this machine."""
        return f"http://localhost:{self._server.server_address[1]}"

    def __call__(self, moment: Moment) -> None:
        """Waits until a sample is due at the playback speed, then publishes it to the page."""
        if self._began is None:
            self._began = time.monotonic()
        ahead_s = moment.time_s / self._speed - (time.monotonic() - self._began)
        if ahead_s > 0.0:
            time.sleep(ahead_s)
        line = json.dumps(self._make_row(moment), allow_nan=False, separators=(",", ":"))
        self._before = moment
        with self._news:
            self._lines.append(line)
            self._news.notify_all()

    def wait_for_rows(self, first_row: int) -> list[str]:
        """Returns the samples from a row on as JSON texts; waits up to a second where there are none."""
        with self._news:
            if len(self._lines) <= first_row:
                self._news.wait(_WAIT_S)
            return self._lines[first_row:]

    def _make_row(self, moment: Moment) -> dict[str, Any]:
        """Makes the page's data of a sample: its values, and lists of the jets by plume kind and failure."""
        time_s = np.array([moment.time_s])
        failing = truly_failing(time_s, self._scenario)[0]
        commanded = np.nan_to_num(moment.command) > 0.0
        level = moment.thrust / self._full
        lists = {
            **motion.classify_plumes(level, commanded, failing),
            "failed": failing,
            "found": moment.removed,
        }
        values = (
            time_s,
            moment.attitude,
            moment.center_of_mass,
            moment.estimate[CENTER_OF_MASS],
            moment.standard_deviation[CENTER_OF_MASS],
            np.degrees(moment.rate),
            np.array([moment.nis]),
            np.array([self._package_deviation(moment)]),
            *([self._links.poses(moment.joint_positions)] if self._links else []),
        )
        listed = (interactive.rounded_numbers(value, digits=flight3d.DIGITS) for value in values)
        row = [numbers[0] if len(numbers) == 1 else numbers for numbers in listed]
        jet_lists: dict[str, Any] = {name: np.flatnonzero(lists[name]).tolist() for name in flight3d.LISTS}
        jet_lists["sizes"] = flight3d.plume_sizes(self._scenario, level, lists["given"], lists["untold"])
        return {"row": row, "lists": jet_lists}

    def _package_deviation(self, moment: Moment) -> float:
        """Computes the largest deviation of packages from their median in the last interval, 1-sigma; NaN at first."""
        if self._before is None:
            return float("nan")
        both = (self._before, moment)
        names = self._scenario.vehicle_data.sensor_names()
        signals = {name: np.stack([one.readings[index] for one in both]) for index, name in enumerate(names)}
        return float(instruments.package_deviation(self._scenario, np.array([one.time_s for one in both]), signals)[-1])


def _make_handler(page: bytes, live: Live) -> type[BaseHTTPRequestHandler]:
    """Makes an HTTP handler class that serves the page, and streams the samples as server-sent events."""

    class Handler(BaseHTTPRequestHandler):
        """Handler of the page and of its samples."""

        def do_GET(self) -> None:
            """Sends the page for "/", or streams the samples for "/rows"."""
            if self.path == "/":
                self._send_headers("text/html; charset=utf-8", len(page))
                self.wfile.write(page)
            elif self.path == "/rows":
                self._send_headers("text/event-stream", None)
                n_sent = 0
                try:
                    while True:
                        rows = live.wait_for_rows(n_sent)
                        n_sent += len(rows)
                        self.wfile.write(("".join(f"data: {line}\n\n" for line in rows) or ": waiting\n\n").encode())
                        self.wfile.flush()
                except OSError:  # the reader has left
                    return
            else:
                self.send_error(404)

        def _send_headers(self, kind: str, length: int | None) -> None:
            """Sends status 200 with the content type, and the length in bytes if it is known."""
            self.send_response(200)
            self.send_header("Content-Type", kind)
            if length is not None:
                self.send_header("Content-Length", str(length))
            self.end_headers()

        def log_message(self, *_: Any) -> None:
            """Suppresses messages on the terminal."""

    return Handler

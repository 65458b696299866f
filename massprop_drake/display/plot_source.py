"""Source of plots: the signals of a run with their scenario, and what every plot of it shows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.display.spec import (
    MomentLine,
    Panel,
    Plot,
    ShadedWindow,
)
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.inputs.vehicle_file import Vehicle

if TYPE_CHECKING:
    from massprop_drake.results.run_content import RunContent

DEGREES = 180.0 / np.pi
Array = NDArray[np.float64]

PROMPT_S = 1.0  # a detector that tests as soon is armed from the start


class Source(NamedTuple):
    """Source of plots: signals of a run and their scenario.

    Attributes:
        time_s: sample times, s, shape (n,).
        signals: by name, shape (n, components).
        scenario: for units, maneuver windows, failures and jets.
        consistency: mean NIS and number of samples used, as in the summary; None: the signals are complete,
            and the means are taken from them.
    """

    time_s: Array
    signals: Mapping[str, Array]
    scenario: Scenario
    consistency: Mapping[str, float | None] | None = None

    @property
    def vehicle(self) -> Vehicle:
        """Vehicle of the scenario."""
        return self.scenario.vehicle_data

    @property
    def simulated(self) -> bool:
        """True if the true mass properties are known."""
        return "truth" in self.signals

    @property
    def rotation_axes(self) -> tuple[int, ...]:
        """Indices of the axes about which the vehicle turns."""
        return (2,) if self.vehicle.motion == "planar" else (0, 1, 2)

    @property
    def translation_axes(self) -> tuple[int, ...]:
        """Indices of the axes along which the vehicle moves."""
        return (0, 1) if self.vehicle.motion == "planar" else (0, 1, 2)

    @property
    def clustered(self) -> bool:
        """True if any cluster has more than one jet."""
        return len({jet.cluster for jet in self.vehicle.jets}) < len(self.vehicle.jets)

    def nonzero_rows(self, name: str) -> NDArray[np.int_]:
        """Returns indices of the rows at which a one-column signal is known and not zero, shape (k,)."""
        return np.flatnonzero(np.nan_to_num(self.signals[name][:, 0]) != 0.0)


def source(run: RunContent) -> Source:
    """Makes the plots' source of a run, or of a thinned run."""
    return Source(run.time_s, run.signals, run.scenario, run.summary["consistency"] if run.thinned else None)


def failing_jets(time_s: Array, scenario: Scenario) -> NDArray[np.bool_]:
    """Flags the jets that truly fail during each sample, from its row to the next, shape (n, n_jets)."""
    vehicle = scenario.vehicle_data
    found = np.zeros((time_s.size, len(vehicle.jets)), dtype=bool)
    for failure in scenario.failures:
        end_s = np.inf if failure.end_s is None else failure.end_s
        within = (time_s > failure.start_s - vehicle.sample_period_s + 1e-9) & (time_s < end_s - 1e-9)
        found[within, vehicle.jet_index(failure.jet)] = True
    return found


def first_tested_s(run: Source) -> float | None:
    """Returns the first time at which the detector tested a sample, s; None: it never did."""
    tested = run.nonzero_rows("tested")
    return float(run.time_s[tested[0]]) if tested.size else None


def plot(run: Source, name: str, title: str, panels: Sequence[Panel], *, meaning: str = "") -> Plot:
    """Makes a plot of panels, with the run's caption, time windows and event times."""
    drawn = f", seed {run.scenario.seed}" if run.simulated else ""
    caption = f"{run.vehicle.name}, {run.scenario.name}{drawn}"
    windows, moments = _windows(run), _moments(run)
    meanings = {
        "shaded: hand controller out of detent": any(window.armed for window in windows),
        "gray: detector not armed": any(not window.armed for window in windows),
        "dotted: it happens": any(not moment.declared for moment in moments),
        "red line: it is declared": any(moment.declared for moment in moments),
    }
    note = ", ".join(meaning for meaning, there in meanings.items() if there)
    return Plot(name, title, caption, run.time_s, tuple(panels), windows, moments, note, meaning)


def _windows(run: Source) -> tuple[ShadedWindow, ...]:
    """Returns time windows in which a hand controller is out of detent, or the detector is not armed yet."""
    commanded = tuple(
        ShadedWindow(window.start_s, window.end_s, f"{window.controller.upper()} {window.axis}")
        for window in run.scenario.maneuver
        if window.start_s < run.time_s[-1]
    )
    if "tested" not in run.signals:
        return commanded
    start_s, until_s = float(run.time_s[0]), first_tested_s(run)
    end_s = float(run.time_s[-1]) if until_s is None else until_s
    return (ShadedWindow(start_s, end_s, "", armed=False), *commanded) if end_s - start_s > PROMPT_S else commanded


def _moments(run: Source) -> tuple[MomentLine, ...]:
    """Returns times at which jets fail or mass properties jump, and times of the detector's declarations."""
    happens = [failure.start_s for failure in run.scenario.failures] + [jump.time_s for jump in run.scenario.jumps]
    declared = run.time_s[run.nonzero_rows("detector_event")].tolist() if "detector_event" in run.signals else []
    return (
        *(MomentLine(time_s, declared=False) for time_s in happens if time_s <= run.time_s[-1]),
        *(MomentLine(time_s, declared=True) for time_s in declared),
    )

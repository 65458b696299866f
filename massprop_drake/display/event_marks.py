"""Events of a run with their times: commands, failures, and detections."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

from massprop_drake.inputs.scenario import Scenario
from massprop_drake.results.detections import in_words

if TYPE_CHECKING:
    from massprop_drake.results.run_content import RunContent


class Mark(NamedTuple):
    """An interval in which some jets are to be marked.

    Attributes:
        jets: their indices.
        start_s, end_s: the interval, s; infinity: it does not end.
        text: the reason, for the reader.
    """

    jets: tuple[int, ...]
    start_s: float
    end_s: float
    text: str


def failure_marks(scenario: Scenario, end_s: float) -> list[Mark]:
    """Makes a mark for each injected jet failure that begins by a time, s: its jet, interval and text."""
    vehicle = scenario.vehicle_data
    return [
        Mark(
            (vehicle.jet_index(failure.jet),),
            failure.start_s,
            math.inf if failure.end_s is None else failure.end_s,
            f"jet {failure.jet}: {failure.kind.replace('_', ' ')}",
        )
        for failure in scenario.failures
        if failure.start_s <= end_s
    ]


def detection_marks(run: RunContent) -> list[Mark]:
    """Makes a mark for each declaration: its jets (none for a mass-property jump), interval and text."""
    vehicle, marks = run.scenario.vehicle_data, []
    for entry in run.results.detections:
        named = (entry.jet,) if entry.jet else entry.jets
        jets = tuple(
            index
            for index, jet in enumerate(vehicle.jets)
            if entry.cluster is not None and (jet.designation in named if named else jet.cluster == entry.cluster)
        )
        until = math.inf if entry.withdrawn_s is None else entry.withdrawn_s
        marks.append(Mark(jets, entry.time_s, until, in_words(entry, vehicle.unit_names)))
    return marks


def describe_command(scenario: Scenario, time_s: float) -> str:
    """Describes the hand controllers' command at a time, such as 'RHC +x'; 'hold' while both are in detent."""
    windows = [window for window in scenario.maneuver if window.start_s <= time_s < window.end_s]
    if not windows:
        return "hold" if scenario.maneuver else ""
    return ", ".join(f"{window.controller.upper()} {window.axis}" for window in windows)

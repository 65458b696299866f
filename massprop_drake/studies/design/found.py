"""Data classes of a design: targets, separable pairs, predicted sigmas and commands."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.inputs.scenario import Scenario

Array = NDArray[np.float64]

LISTENING_S = 10.0  # s, after a maneuver, for which a suspect may still be named


class TargetFound(NamedTuple):
    """Target quantity with its 1-sigma: asked for, before, predicted and flown.

    Attributes:
        name: of the quantity.
        unit: of all numbers.
        value: as the vehicle is taken to be.
        asked: 1-sigma that was asked for.
        before: 1-sigma before the maneuver.
        predicted: after it.
        floor: what no firing takes away.
        flown: 1-sigma of the filter at the end of each flight.
        errors: error of its estimate there.
    """

    name: str
    unit: str
    value: float
    asked: float
    before: float
    predicted: float
    floor: float
    flown: tuple[float, ...]
    errors: tuple[float, ...]


class PairFound(NamedTuple):
    """Pair of suspects, and the time after which they are separable.

    Attributes:
        jet: that fails.
        other: that would explain it; None: nothing fails.
        force: lbf or N; below zero: missing while it fires.
        after_s: seconds after the first firing; None: not by its end.
    """

    jet: str
    other: str | None
    force: float
    after_s: float | None


class Trace(NamedTuple):
    """Predicted 1-sigma of each target over propellant and time.

    Attributes:
        propellant: that is used, slug or kg, shape (n,).
        time_s: since the beginning, shape (n,).
        deviations: 1-sigma of each target by then, shape (n, n_targets).
    """

    propellant: Array
    time_s: Array
    deviations: Array


class ManeuverCommand(NamedTuple):
    """A command of a maneuver.

    Attributes:
        name: of the jet or wheel.
        torque: of a wheel's motor; zero of a jet.
        start_s, end_s: in the scenario's time.
    """

    name: str
    torque: float
    start_s: float
    end_s: float


class Design(NamedTuple):
    """Maneuver that reaches the requested targets, with its forecast and its flights.

    Attributes:
        scenario: that flies it.
        begins_s: when in that scenario it begins, s.
        duration_s: of the maneuver.
        firing_s: for which jets fire or wheels turn in it.
        propellant: that it uses, slug or kg.
        rate, angle, displacement: largest on the way, rad/s, rad, ft or m.
        targets: see `TargetFound`.
        pairs: see `PairFound`.
        course: along the maneuver.
        front: of the plans for looser aims that the search went through.
        expected_s: by suspect, when it is to be named if it fails, told from every other jet, s; None: it is not.
        named_s: of each flight with a suspect that fails, by suspect: when it was named, s after it failed; None: not.
    """

    scenario: Scenario
    begins_s: float
    duration_s: float
    firing_s: float
    propellant: float
    rate: float
    angle: float
    displacement: float
    targets: tuple[TargetFound, ...]
    pairs: tuple[PairFound, ...]
    course: Trace
    front: Trace
    expected_s: Mapping[str, float | None]
    named_s: Mapping[str, tuple[float | None, ...]]

    @property
    def commanded(self) -> list[ManeuverCommand]:
        """The maneuver's commands of jets and wheels, in order of time."""
        scenario = self.scenario
        commands = [ManeuverCommand(one.jet, 0.0, one.start_s, one.end_s) for one in scenario.jet_schedule]
        commands += [ManeuverCommand(one.wheel, one.torque, one.start_s, one.end_s) for one in scenario.wheel_schedule]
        return sorted((one for one in commands if one.start_s >= self.begins_s), key=lambda one: one.start_s)

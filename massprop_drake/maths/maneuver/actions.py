"""Short firings of which a maneuver is made: candidates for a vehicle, and their information."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.maths.estimation.joint.layout import RATE, JointParams
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.maneuver.aims import Known
from massprop_drake.maths.maneuver.information import FollowedCourse, Step, advance_course

_LENGTHS = (1, 2, 4, 8, 16)  # samples that an action lasts, a compute budget
_COASTS = (1, 5)  # samples after it; compute budget


class Craft(NamedTuple):
    """Vehicle as a maneuver commands it.

    Attributes:
        params: of the joint filter.
        properties: the ten parameters as the vehicle is taken to be, shape (10,).
        period_s: control period.
        flows: propellant of each jet at full thrust, slug/s or kg/s, shape (n_jets,).
        least: fewest samples that each jet may be on, shape (n_jets,).
        jets: those that may be used, integers, shape (n,).
        torques: that the motor of each wheel may give, N-m or ft-lbf, shape (n_wheels,).
        rate: of the vehicle at the start, rad/s, shape (3,).
        speeds: of the wheels at the start, rad/s, shape (n_wheels,).
        every: samples between two readings of each component, shape (n_outputs,).
    """

    params: JointParams
    properties: Array
    period_s: float
    flows: Array
    least: NDArray[np.int_]
    jets: NDArray[np.int_]
    torques: Array
    rate: Array
    speeds: Array
    every: NDArray[np.int_]


class FiringAction(NamedTuple):
    """Short firing of jets and wheel motors, then a coast.

    Attributes:
        jets: that fire, integers.
        torques: of the wheels' motors, shape (n_wheels,).
        samples: for which both last.
        coast: samples after that.
        propellant: slug or kg.
    """

    jets: tuple[int, ...]
    torques: tuple[float, ...]
    samples: int
    coast: int
    propellant: float

    @property
    def length(self) -> int:
        """Number of samples that the action lasts, firing and coast together."""
        return self.samples + self.coast


def coast_action(samples: int, craft: Craft) -> FiringAction:
    """Makes an action of so many samples in which no jet fires and no wheel turns."""
    return FiringAction((), (0.0,) * craft.torques.size, 0, samples, 0.0)


def candidate_actions(
    sets: Sequence[tuple[int, ...]], craft: Craft, lengths: Sequence[int] = _LENGTHS
) -> list[FiringAction]:
    """Lists the actions that a search may choose: each set of jets, and each wheel, for several lengths.

    Args:
        sets: of jets that fire together, integers.
        lengths: in samples.
    """
    found = []
    still = (0.0,) * craft.torques.size
    for jets in sets:
        flow = float(craft.flows[list(jets)].sum())
        least = int(craft.least[list(jets)].max())
        for samples in sorted({max(length, least) for length in lengths}):
            for coast in _COASTS:
                found.append(FiringAction(jets, still, samples, coast, flow * samples * craft.period_s))
    for wheel, torque in enumerate(craft.torques.tolist()):
        for way in (torque, -torque) if torque else ():
            turned = tuple(way if each == wheel else 0.0 for each in range(craft.torques.size))
            for samples in lengths:
                found.append(FiringAction((), turned, samples, _COASTS[0], 0.0))
    return found


class FlownAction(NamedTuple):
    """Course after an action, and the motion on its way.

    Attributes:
        course: after it.
        row: number of samples from the start of the maneuver.
        rate: largest in it, rad/s.
        angle: largest that the vehicle is turned from its first attitude, rad.
        displacement: largest from its first position, ft or m.
    """

    course: FollowedCourse
    row: int
    rate: float
    angle: float
    displacement: float


def fly_action(
    start: tuple[FollowedCourse, int], action: FiringAction, craft: Craft, prior: Known | None = None
) -> FlownAction:
    """Propagates vehicle motion and parameter information through an action; returns them and largest excursions.

    Args:
        start: the course, and the number of its samples.
        action: that follows.
        prior: before the course, see `information.advance_course`.
    """
    flown = FlownAction(*start, 0.0, 0.0, 0.0)
    for sample in range(action.length):
        flown = fly_action_sample(flown, action, craft, prior, fires=sample < action.samples)
    return flown


def fly_action_sample(
    previous: FlownAction, action: FiringAction, craft: Craft, prior: Known | None = None, *, fires: bool
) -> FlownAction:
    """Propagates motion and information by one sample of an action, firing or coasting; see `fly_action`."""
    places, row = craft.params.places, previous.row + 1
    command, torques = np.zeros(places.jets), np.zeros(places.wheels)
    if fires:
        command[list(action.jets)], torques[:] = 1.0, action.torques
    step = Step(command, torques, craft.period_s, row % craft.every != 0)
    course = advance_course(previous.course, step, craft.params, prior)
    return FlownAction(
        course,
        row,
        max(previous.rate, float(np.linalg.norm(course.joint.mean[RATE]))),
        max(previous.angle, 2.0 * math.acos(min(abs(float(course.attitude[0])), 1.0))),
        max(previous.displacement, float(np.linalg.norm(course.position))),
    )

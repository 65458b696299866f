"""Layouts of every packed port, state and log, in one place.

Those that a kernel packs itself stand beside it and are named here; the vectors of fewer than four numbers, and
those with one element per jet, need none.
"""

from __future__ import annotations

from typing import Any

from massprop_drake.maths.arrays import NUMBER, Array, Layout
from massprop_drake.maths.autopilot.autopilot_ports import (
    ATTITUDE_MEMORY,
    HAND_CONTROLLERS,
    RECONFIGURATION,
    REQUEST,
    TRANSLATION_MEMORY,
)
from massprop_drake.maths.estimation.adaptation import LAYOUT as ADAPTATION
from massprop_drake.maths.estimation.cycle import MEMORY as IMPULSE_MEMORY
from massprop_drake.maths.estimation.detector import KNOWN_FORCE, STATUS, Judgment
from massprop_drake.maths.estimation.faults.fault_report import HYPOTHESIS_REPORT
from massprop_drake.maths.estimation.filter import JOINT as EVIDENCE
from massprop_drake.maths.estimation.filter import MASS_REPORT, ROTATION_REPORT
from massprop_drake.maths.estimation.filters.joint import JOINT_REPORT
from massprop_drake.maths.estimation.filters.pose import POSE_REPORT
from massprop_drake.maths.estimation.filters.thesis import TURNING
from massprop_drake.maths.estimation.impulses import LAYOUT as IMPULSES
from massprop_drake.maths.estimation.impulses import Impulses
from massprop_drake.maths.vehicle.rigid_body import STRUCTURE

__all__ = [
    "ADAPTATION",
    "ATTITUDE_MEMORY",
    "DETECTOR_REPORT",
    "EVIDENCE",
    "HAND_CONTROLLERS",
    "HYPOTHESIS_REPORT",
    "IMPULSES",
    "IMPULSE_MEMORY",
    "JOINT_REPORT",
    "KNOWN_FORCE",
    "MASS_ESTIMATE",
    "MASS_REPORT",
    "NOISE",
    "POSE_REPORT",
    "RECONFIGURATION",
    "REFUSED",
    "REQUEST",
    "ROTATION_REPORT",
    "SELECTION_COUNTS",
    "STATUS",
    "STRUCTURE",
    "TRANSLATION_MEMORY",
    "TURNING",
    "WRENCH",
    "detector_row",
    "impulse_row",
]

# the vehicle
WRENCH = Layout("wrench", torque=3, force=3, mass_flow=NUMBER)
NOISE = Layout("noise", white=3, walk=3)

# the autopilot
SELECTION_COUNTS = Layout("selection_counts", solved=NUMBER, reduced=NUMBER, closest=NUMBER, granted=NUMBER)
REFUSED = Layout("refused", rate_change=3, least_change=NUMBER)

# the estimators
MASS_ESTIMATE = Layout("mass_estimate", mass_reciprocal=NUMBER, variance=NUMBER)
DETECTOR_REPORT = Layout(
    "detector_report",
    **STATUS.logged,
    likelihood="jets",
    failure_magnitude="jets",
    known_force="jets",
    known_force_variance="jets",
)


def impulse_row(impulses: Impulses) -> Array:
    """Packs an interval's impulses into a vector, as `IMPULSES`."""
    return IMPULSES.pack((impulses.angular_impulse, impulses.linear_impulse, impulses.usable, impulses.firing))


def detector_row(judgment: Judgment, state_before: Any, layout: Layout) -> Array:
    """Makes the log row of a detector's cycle, packed as `DETECTOR_REPORT` for the detector's number of jets.

    Args:
        judgment: of the sample.
        state_before: state of the detector before it, whose known forces are reported.
        layout: `DETECTOR_REPORT`, sized.
    """
    return layout.pack(
        (*judgment.status, judgment.likelihood, judgment.magnitude, state_before.force, state_before.variance)
    )

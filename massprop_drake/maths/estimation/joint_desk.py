"""Buffers of the kernel that runs the joint filter's cycles: rows, memory and past states, written in place."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.maths.arrays import Layout
from massprop_drake.maths.estimation.joint.bank import ONSETS, Since, empty_bank
from massprop_drake.maths.estimation.joint.burns import shut_engine_burn
from massprop_drake.maths.estimation.joint.joint_sample import JointSample
from massprop_drake.maths.estimation.joint.layout import JointState, Places, state_layout
from massprop_drake.maths.estimation.joint.orientation import STILL
from massprop_drake.maths.estimation.joint.sensitivity import LINK
from massprop_drake.maths.estimation.joint.ticks import Clock, start_clock, timing_on_ticks
from massprop_drake.maths.estimation.joint.wheels import Spun
from massprop_drake.maths.estimation.whole import Samples, allocate_sample
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.vehicle.thrust import LagFactors, lag_factors


class JointMemory(NamedTuple):
    """Memory between two cycles.

    Attributes:
        joint: see `JointState`.
        clock: see `Clock`.
        estimate, covariance: see `JointFilterState`.
        since: see `bank.Since`.
        command, level: see `cycle.EstimationState`.
        cycle: number of the newest sample.
        frame, speeds: see `JointFilterState`.
    """

    joint: JointState
    clock: Clock
    estimate: Array
    covariance: Array
    since: Since
    command: Array
    level: Array
    cycle: float
    frame: Array
    speeds: Array


class Past(NamedTuple):
    """States and cycles of the past, written in place.

    Attributes:
        states: of the onsets, packed, in any order, shape (ONSETS, size of a state).
        roots: of the same, shape (ONSETS, size, size).
        places: of each onset's among them, oldest first, shape (ONSETS,).
        links: of the last cycles, packed as `LINK`, each in the row of its number, shape (n, size of a link).
        excess: by how much less likely the readings of each of these were than expected, nats, shape (n,).
    """

    states: Array
    roots: Array
    places: NDArray[np.int_]
    links: Array
    excess: Array


class JointRows(NamedTuple):
    """Log rows, one per cycle, as the layouts of the same names have them; one row of no cycle is empty."""

    impulses: Array
    rotation_report: Array
    mass_report: Array
    joint_report: Array
    detector_report: Array
    hypothesis_report: Array


class Besides(NamedTuple):
    """Readings and commands beside those of the samples, a row per cycle, and values that cycles derive, in place.

    Attributes:
        quaternions: that trackers read, NaN where missing, shape (n, n_trackers, 4).
        speeds: of the wheels as they are read, NaN where missing, rad/s, shape (n, n_wheels).
        onsets_s: of the commands, NaN where these are levels, shape (n, n_jets).
        durations_s: of the intervals that end, shape (n,).
        frames, attitudes: see `JointSample`, shapes (n, 2, 4) and (n, n_trackers, 3).
        before: speeds that were read last before each, NaN where none has been, rad/s, shape (n, n_wheels).
    """

    quaternions: Array
    speeds: Array
    onsets_s: Array
    durations_s: Array
    frames: Array
    attitudes: Array
    before: Array


def make_extra_readings(
    n_rows: int, layout: Places, tracked: Array | None = None, onsets_s: Array | None = None
) -> Besides:
    """Makes rows of tracked readings and command onsets, with zeros for the values that cycles fill in.

    Args:
        tracked: see `filter.Told`, shape (n, columns); None: nothing.
        onsets_s: of the commands, shape (n, n_jets) at least; None: these are levels.
    """
    poses = 7 * layout.trackers
    read = np.full((n_rows, poses + layout.wheels), np.nan) if tracked is None else tracked
    return Besides(
        np.ascontiguousarray(read[:, :poses].reshape(n_rows, -1, 7)[:, :, 3:]) if poses else np.zeros((n_rows, 0, 4)),
        np.ascontiguousarray(read[:, read.shape[1] - layout.wheels :]),
        np.full((n_rows, layout.jets), np.nan) if onsets_s is None else np.ascontiguousarray(onsets_s[:n_rows]),
        np.zeros(n_rows),
        np.zeros((n_rows, 2, 4)),
        np.zeros((n_rows, layout.trackers, 3)),
        np.zeros((n_rows, layout.wheels)),
    )


class Rules(NamedTuple):
    """Parameters of a cycle besides the filter's.

    Attributes:
        period_s, impulse_per_level, lag: see `cycle.EstimationParams`.
        detector_row, hypothesis_row: what is logged of the detector where nothing is found.
    """

    period_s: float
    impulse_per_level: Array
    lag: LagFactors
    detector_row: Array
    hypothesis_row: Array


class JointDesk(NamedTuple):
    """Inputs of cycles, and the rows that they write.

    Attributes:
        samples: one a row.
        stamps_s: see `cycle.Sample`, shape (n,).
        besides: see `Besides`.
        rows: to be filled in.
        reached: the row that is being made, and that before which to stop, shape (2,).
        past: see `Past`.
        rules: see `Rules`.
    """

    samples: Samples
    stamps_s: Array
    besides: Besides
    rows: JointRows
    reached: NDArray[np.int_]
    past: Past
    rules: Rules


def empty_sample(layout: Places) -> JointSample:
    """Returns a joint filter's sample of zeros, a template of its types."""
    rates, velocities = np.zeros((layout.gyros, 3)), np.zeros((layout.accelerometers, 3))
    attitudes, command = np.zeros((layout.trackers, 3)), np.zeros((1, layout.jets))
    none = np.zeros(layout.wheels)
    around = STILL.copy(), Spun(none, none, none, none), shut_engine_burn(layout.engines)
    return JointSample(0.0, np.ones(1), command, np.zeros(6), rates, velocities, timing_on_ticks(), attitudes, *around)


def initial_memory(state: JointState, layout: Places) -> JointMemory:
    """Returns the compiled cycles' memory before the first cycle, from the filter's initial state."""
    none, since = np.zeros(layout.jets), empty_bank(layout).since
    clock = start_clock(0.0, state.level, none)
    frame, speeds = np.zeros(4), np.zeros(layout.wheels)
    return JointMemory(state, clock, np.zeros(10), np.zeros((10, 10)), since, none, none, 0.0, frame, speeds)


def empty_past(layout: Places, n_cycles: int) -> Past:
    """Allocates zeros for filter states at possible fault onsets, and for linearizations of `n_cycles` past cycles."""
    states = np.zeros((ONSETS, state_layout(layout).size))
    kept = np.zeros((n_cycles, link_layout(layout).size))
    roots, order = np.zeros((ONSETS, layout.size, layout.size)), np.zeros(ONSETS, dtype=np.int_)
    return Past(states, roots, order, kept, np.zeros(n_cycles))


def empty_buffers(layout: Places) -> JointDesk:
    """Makes buffers of compiled cycles, inputs and log rows, with one row of zeros as a template of their types."""
    samples, nothing = allocate_sample(layout.gyros, layout.accelerometers, layout.jets), np.zeros(1)
    rules = Rules(1.0, np.zeros((layout.jets, 6)), lag_factors(np.zeros(layout.jets), 1.0), nothing, nothing)
    rows, reached = JointRows(*[np.zeros((1, 1))] * len(JointRows._fields)), np.zeros(2, dtype=np.int_)
    return JointDesk(samples, np.zeros(1), make_extra_readings(1, layout), rows, reached, empty_past(layout, 2), rules)


def link_layout(layout: Places) -> Layout:
    """Returns the layout of a cycle's linearization as a vector, sized for a vehicle."""
    counts = {"jets": layout.jets, "outputs": layout.outputs, "attitude": layout.n_attitude}
    return LINK.sized(size=layout.size, slow=layout.n_slow, swing=layout.n_swing, disturbed=6 + layout.n_slow, **counts)

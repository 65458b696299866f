r"""Information that a course of commands gives about the vehicle, and motion along it, by the joint filter's equations.

Parameters theta are the ten mass properties, what the joint state has from thrust errors on, and forces by which jets
fail: constant ones on top of what a jet is told to give, or what is missing while it fires; and jumps of the mass
properties, since what a payload does may look like a leak. Were they known, only the
motion would have a covariance. With B what a unit error of each has brought to the state, F and H the derivatives of
prediction and outputs, K the gain and S the covariance of innovations of that filter,

    B <- (1 - K H)(F B + g),    G <- G + (H (F B + g))^T S^-1 (H (F B + g)),

g is what a unit of each force does in the interval. G is the Fisher information about theta, whatever is known of it
before. With a prior of the information M the covariance is (M + G)^-1, and parameters that do not matter are in it by
the Schur complement. So a course is followed once for all priors, all targets and all suspects.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from massprop_drake.maths.attitude import propagate_attitude as turned_on
from massprop_drake.maths.attitude import rotation_matrix
from massprop_drake.maths.estimation.joint import bound
from massprop_drake.maths.estimation.joint.beginning import begin_from_readings, initial_joint_state
from massprop_drake.maths.estimation.joint.burns import shut_engine_burn
from massprop_drake.maths.estimation.joint.forcing import effective_seconds, wrenches_of
from massprop_drake.maths.estimation.joint.hypotheses import JUMP_SHARES, jump_sigma
from massprop_drake.maths.estimation.joint.joint_sample import JointSample
from massprop_drake.maths.estimation.joint.layout import MASS, N_PROPERTIES, RATE, VELOCITY, JointParams, JointState
from massprop_drake.maths.estimation.joint.measurement import predict_outputs
from massprop_drake.maths.estimation.joint.orientation import UNTURNED
from massprop_drake.maths.estimation.joint.thrust_scale import parameters_with_scale
from massprop_drake.maths.estimation.joint.ticks import timing_on_ticks
from massprop_drake.maths.estimation.joint.wheels import Spun
from massprop_drake.maths.linear_algebra import Array, scaled_inverse, scaled_root
from massprop_drake.maths.maneuver.aims import Known

_TINY = float(np.finfo(np.float64).tiny)
_SELDOM = 1e-6  # share of the samples: a reading that never changes says nothing


class Step(NamedTuple):
    """Sample interval of a course.

    Attributes:
        command: fraction commanded of each jet, shape (n_jets,).
        torques: of the wheels' motors on the wheels, N-m or ft-lbf, shape (n_wheels,).
        period_s: its length.
        missing: which readings there will be none of at its end, see `measurement.readings`, boolean, shape (m,).
    """

    command: Array
    torques: Array
    period_s: float
    missing: np.ndarray


class FollowedCourse(NamedTuple):
    """Course of commands up to a sample. Never changed; a step makes a new one.

    Attributes:
        joint: state with the covariance of the motion alone, its mean as the vehicle is taken to be.
        carried: B, shape (size, k).
        shown: G, shape (k, k).
        attitude: body to fixed frame, quaternion, shape (4,).
        velocity, position: of the center of mass since the start, fixed frame, shape (3,) each.
        speeds: of the wheels, rad/s, shape (n_wheels,).
    """

    joint: JointState
    carried: Array
    shown: Array
    attitude: Array
    velocity: Array
    position: Array
    speeds: Array


def n_known(params: JointParams) -> int:
    """Returns the number of parameters other than jet forces: 10, and the state's from thrust errors on."""
    return N_PROPERTIES + params.places.force - params.places.thrust


def initial_course(properties: Array, rate: Array, speeds: Array, params: JointParams) -> FollowedCourse:
    """Makes the course at the start of a maneuver: the vehicle's state, and no information on its motion.

    Args:
        properties: the ten parameters, shape (10,).
        rate: rad/s, shape (3,).
        speeds: of the wheels, rad/s, shape (n_wheels,).
    """
    places, known = params.places, n_known(params)
    before = initial_joint_state(params)
    root = before.root.copy()
    root[:N_PROPERTIES], root[places.thrust :] = 0.0, 0.0
    mean = np.zeros(places.size)
    mean[:N_PROPERTIES], mean[RATE] = properties, rate
    mean[places.fill : places.fill + places.tanks] = params.tanks.fill
    step = Step(np.zeros(places.jets), np.zeros(places.wheels), 0.0, np.ones(places.outputs, dtype=bool))
    sample = _zero_sample(before, step, (UNTURNED, UNTURNED), (speeds, speeds), params)
    joint = begin_from_readings(before._replace(root=root, mean=mean), sample, params)._replace(
        mean=mean, reference=mean[RATE].copy()
    )
    size = known + 2 * places.jets + N_PROPERTIES
    carried = np.zeros((places.size, size))
    carried[:N_PROPERTIES, :N_PROPERTIES] = np.eye(N_PROPERTIES)
    carried[places.thrust : places.force, N_PROPERTIES:known] = np.eye(known - N_PROPERTIES)
    return FollowedCourse(joint, carried, np.zeros((size, size)), UNTURNED, np.zeros(3), np.zeros(3), speeds)


def begin_failures(course: FollowedCourse, params: JointParams) -> FollowedCourse:
    """Sets the onset of failures and mass-property jumps to a course's end, without information on them."""
    first = n_known(params)
    carried, shown = course.carried.copy(), course.shown.copy()
    carried[:, first:], shown[first:], shown[:, first:] = 0.0, 0.0, 0.0
    carried[:N_PROPERTIES, -N_PROPERTIES:] = np.diag(jump_sigma(params, JUMP_SHARES[0]))
    return course._replace(carried=carried, shown=shown)


def advance_course(
    course: FollowedCourse, step: Step, params: JointParams, prior: Known | None = None
) -> FollowedCourse:
    """Advances motion, information and covariance of a course by one interval of commands.

    Args:
        course: up to then.
        prior: knowledge before the course. With it, products of errors that are left by then are noise: a filter
            that knows neither inverse inertia nor center of mass learns less from a firing than information says.
    """
    places, before = params.places, course.joint
    speeds = course.speeds + step.torques * step.period_s / params.wheels.inertias
    frame = turned_on(course.attitude, before.mean[RATE], step.period_s)
    sample = _zero_sample(before, step, (course.attitude, frame), (course.speeds, speeds), params)
    doubt = None
    if prior is not None and (step.command.any() or step.torques.any()):
        doubt = _covariance_root(course, prior, params)
    end = bound.predict_interval_end(before, sample, None, params, doubt)
    weighed = ~step.missing, _reading_variances(before, end, params)
    after, done = bound.update_bound(before, end, sample.time_s, weighed, params)
    carried, shown = bound.advance_force_effects((course.carried, course.shown), before, done, n_known(params), params)
    force = effective_seconds(before, end.acting.firing, params) @ wrenches_of(before.mean, params)[:, 3:]
    middle = 0.5 * (before.mean[RATE] + after.mean[RATE])
    turn = rotation_matrix(turned_on(course.attitude, middle, 0.5 * step.period_s))
    velocity = course.velocity + before.mean[MASS] * (turn @ force)
    mean = after.mean.copy()
    mean[VELOCITY : places.slow] = 0.0
    return FollowedCourse(
        after._replace(mean=mean),
        carried,
        shown,
        turned_on(course.attitude, middle, step.period_s),
        velocity,
        course.position + 0.5 * step.period_s * (course.velocity + velocity),
        speeds,
    )


def _covariance_root(course: FollowedCourse, prior: Known, params: JointParams) -> Array:
    """Computes a root of the state's covariance, motion and parameters independent, shape (size, size)."""
    of, root = prior.of, np.zeros_like(course.joint.root)
    lower, size = scaled_root(prior.information + course.shown[np.ix_(of, of)])
    half = np.linalg.inv(lower).T * size.reshape(-1, 1)
    rows = np.where(of < N_PROPERTIES, of, of + params.places.thrust - N_PROPERTIES)
    others = np.setdiff1d(np.arange(len(root)), rows)
    root[np.ix_(rows, rows)] = half
    # columns of their own: those of the filter's root are shared by parameters and motion
    root[np.ix_(others, others)] = np.linalg.qr(course.joint.root[others].T)[1].T
    return root


def _reading_variances(previous: JointState, end: bound.IntervalEnd, params: JointParams) -> Array:
    """Computes readings' variances, shape (m,); a rounded one without noise informs only when it changes."""
    moved = predict_outputs(end.mean, previous.reference, end.spin, params)[0]
    moved -= predict_outputs(previous.mean, previous.reference, previous.spin, params)[0]
    changes = np.where(params.dithered > 0.0, 1.0, np.abs(moved) / np.maximum(params.cells, _TINY))
    return params.variances / np.clip(changes, _SELDOM, 1.0)


def _zero_sample(
    state: JointState, step: Step, frames: tuple[Array, Array], speeds: tuple[Array, Array], params: JointParams
) -> JointSample:
    """Makes a sample of readings that are zero or missing, for a covariance that no value matters to."""
    places = params.places
    read = np.where(step.missing, np.nan, 0.0)
    counts = 3 * np.cumsum([places.gyros, places.accelerometers])
    rates, velocities, attitudes = (part.reshape(-1, 3) for part in np.split(read, counts))
    n_wheels = places.wheels
    return JointSample(
        state.time_s + step.period_s,
        np.array([step.period_s]),
        step.command.reshape(1, -1),
        np.zeros(6),
        rates,
        velocities,
        timing_on_ticks(),
        attitudes,
        np.stack(frames),
        Spun(*speeds, np.zeros(n_wheels), np.ones(n_wheels)),
        shut_engine_burn(places.engines),
    )


def prior_information(state: JointState, params: JointParams) -> tuple[Array, np.ndarray]:
    """Computes a filter state's information on the parameters, (n, n), and these parameters' indices, (n,).

    The common scale is back in inertia, mass and thrusts (`thrust_scale`); what the state knows exactly is left out.

    Args:
        state: of the joint filter; one before its first sample, too.
    """
    places, errors = params.places, state.root[params.places.thrust : params.places.force].copy()
    if places.n_scale > 0:
        errors[: places.n_thrust] += state.root[places.scale]
        errors[places.scale - places.thrust] = 0.0
    rows = np.vstack((parameters_with_scale(state, params)[1], errors))
    open_ones = np.flatnonzero(rows.any(axis=1))
    return scaled_inverse(rows[open_ones] @ rows[open_ones].T), open_ones

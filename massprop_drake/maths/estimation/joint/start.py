"""Iterated smoothing of the start: the filter runs again, linearized at the mass properties found at its end.

Equations and conditions: theory page of the joint filter, "The start". Passes by the method of Gauss and Newton are
made when what jets do to the rates is first known (`guard.knows_rotation`), and when the guard first holds. An
increment on the way says that the start was stated too well: the passes then begin with what it adds. A cycle makes
`STEPS` of their steps; until they have arrived the estimates have not converged. If they do not explain the readings,
or the start is longer than `LONGEST` control periods, the filter's own state stands.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from massprop_drake.maths.estimation.joint.covariance import compress_root
from massprop_drake.maths.estimation.joint.guard import knows_rotation, reset_guard, update_guard
from massprop_drake.maths.estimation.joint.joint_cycle import Report, incremented_root, restart
from massprop_drake.maths.estimation.joint.joint_sample import JointSample, has_impulse
from massprop_drake.maths.estimation.joint.lag_prior import choose_lag_priors
from massprop_drake.maths.estimation.joint.layout import N_PROPERTIES, JointParams, JointState, Places
from massprop_drake.maths.estimation.joint.relinearization import repeat_start_cycle
from massprop_drake.maths.linear_algebra import Array

STEPS = 16  # in a cycle: 1 to 1.5 ms each
LONGEST = 400  # a compute budget: control periods of which samples are kept, 32 s of the orbiter
_NEAR = 0.3  # sigmas from where a pass began to where it ends: what remains is of second order in that
_PASSES = 5  # at most; two or three as a rule
_MISFIT = 10.0  # standard deviations of chi-square by which readings may be off what passes expect


class Kept(NamedTuple):
    """Sample of the start, and a flag of whether rate and velocity were reset at it."""

    sample: JointSample
    anew: bool


class Pass(NamedTuple):
    """Pass over the start.

    Attributes:
        about: the estimate at whose mass properties and biases it is linearized, shape (size,).
        state: after what it has gone over.
        done: number of samples of these.
        nis, components: sums of the NIS and of the components that counted.
        number: of the pass, from 1 on.
    """

    about: Array
    state: JointState
    done: int
    nis: float
    components: float
    number: int


class Start(NamedTuple):
    """Samples and passes of a start. Never changed; a cycle makes a new one.

    Attributes:
        under_way: whether it is; nothing is kept once it is over.
        entry: state before the first sample that is kept; None: nothing has acted yet.
        kept: samples since.
        incremented: whether the covariance has been, since then.
        under_pass: None: the guard has not held.
        contradicted: whether passes have just arrived that do not explain the readings.
        tried: whether passes have arrived since rotation was known first.
        rotation: whether what jets do to the rates is known, and passes have explained the readings.
    """

    under_way: bool = False
    entry: JointState | None = None
    kept: tuple[Kept, ...] = ()
    incremented: bool = False
    under_pass: Pass | None = None
    contradicted: bool = False
    tried: bool = False
    rotation: bool = False


BEGUN, OVER, CONTRADICTED = Start(under_way=True), Start(), Start(contradicted=True)
BEGUN_KNOWN = Start(under_way=True, tried=True, rotation=True)


def advance_start(
    start: Start, before: JointState, after_and_report: tuple[JointState, Report], latest: Kept, params: JointParams
) -> tuple[Start, JointState]:
    """Stores a sample of the initialization, advances its smoothing passes; returns the start and the filter's state.

    Args:
        before: the filter's state before the cycle.
        after_and_report: the filter's state after it, and its report.
    """
    after, report = after_and_report
    if not start.under_way:
        return OVER, after
    acting = has_impulse(latest.sample, params)
    if not before.started or not (acting or start.kept):
        return start, after
    if len(start.kept) >= LONGEST * params.rates.steps:
        acted = np.any([(each.sample.commands != 0.0).any(axis=0) for each in start.kept], axis=0)
        return BEGUN_KNOWN if start.rotation or (acted.any() and knows_rotation(after, params, acted)) else OVER, after
    start = start._replace(
        entry=before if start.entry is None else start.entry,
        kept=(*start.kept, latest),
        incremented=start.incremented or report.incremented,
        contradicted=False,
    )
    smoothing = start.under_pass
    if smoothing is None:
        if not (after.guarded or (not start.tried and knows_rotation(after, params))):
            return start, after
        smoothing = _begin_pass(start, after, 1, params)
    smoothing, arrived = _advance_pass(start, smoothing, params)
    if not arrived:
        return start._replace(under_pass=smoothing), reset_guard(after)
    if not _is_consistent(smoothing):
        if after.guarded or start.tried:
            return CONTRADICTED, after
        return start._replace(under_pass=None, contradicted=True, tried=True), after
    smoothed = update_guard(smoothing.state, acting, params)
    if smoothed.guarded:
        return OVER, smoothed
    rotation = knows_rotation(smoothed, params)
    return start._replace(under_pass=None, tried=start.tried or rotation, rotation=rotation), smoothed


def _begin_pass(start: Start, end: JointState, number: int, params: JointParams) -> Pass:
    """Begins a smoothing pass over the start's samples, linearized at the last pass's final mean."""
    entry = start.entry
    assert entry is not None, "something is kept"
    root = (
        compress_root(incremented_root(entry.root, params), params.places.thrust) if start.incremented else entry.root
    )
    begins = choose_lag_priors(entry._replace(root=root), end, params)
    return Pass(end.mean.copy(), begins, 0, 0.0, 0.0, number)


def _advance_pass(start: Start, smoothing: Pass, params: JointParams) -> tuple[Pass, bool]:
    """Advances a smoothing pass by some cycles; returns the pass, and whether smoothing has finished."""
    compiled = params.compiled
    for _ in range(STEPS):
        sample, anew = start.kept[smoothing.done]
        if anew:
            state, _report = restart(smoothing.state, sample, params)
            smoothing = smoothing._replace(state=state, done=smoothing.done + 1)
        else:
            with np.errstate(over="ignore", invalid="ignore"):
                if compiled is None:
                    state, nis, components = repeat_start_cycle(smoothing.state, sample, smoothing.about, params)
                else:
                    state, nis, components = compiled.repeat_start_cycle(smoothing.state, sample, smoothing.about)
            smoothing = smoothing._replace(
                state=state,
                done=smoothing.done + 1,
                nis=smoothing.nis + nis,
                components=smoothing.components + components,
            )
        if smoothing.done == len(start.kept):
            if is_pass_converged(smoothing.state, smoothing.about, params.places) or smoothing.number == _PASSES:
                return smoothing, True
            smoothing = _begin_pass(start, smoothing.state, smoothing.number + 1, params)
    return smoothing, False


def is_pass_converged(state: JointState, origin: Array, places: Places, sigmas: float = _NEAR) -> bool:
    """Tests whether a smoothing pass ends within some sigmas of the mass properties and lags of its origin."""
    which = np.concatenate((np.arange(N_PROPERTIES), np.arange(places.lag, places.lag + places.n_lag)))
    rows = state.root[which]
    return bool((np.abs(state.mean[which] - origin[which]) <= sigmas * np.sqrt(np.sum(rows * rows, axis=1))).all())


def _is_consistent(smoothing: Pass) -> bool:
    """Tests whether a smoothing pass's NIS exceeds its expectation by less than a threshold of sigmas."""
    return smoothing.nis - smoothing.components < _MISFIT * np.sqrt(2.0 * smoothing.components)

"""One cycle of the joint estimator: from a state and a sample to the next state.

Order: what the readings before tell that have just changed; what the jets did, with the lag estimated before
(`prediction.drive`); prediction; which components count; while the start lasts and the gyros contradict the prediction,
lags are no longer taken as stated if that explains it, else the covariance is incremented, and the prediction made
again; update; the prior of lags; the guard. A hypothesis is the same
with another state: one with a force in a slot, or rebased and with a larger covariance.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from massprop_drake.maths.estimation.joint.burns import UNLIT, Burn
from massprop_drake.maths.estimation.joint.covariance import (
    Update,
    compressed,
    nothing_learned,
    updated,
    widely_updated,
)
from massprop_drake.maths.estimation.joint.guard import guarded
from massprop_drake.maths.estimation.joint.lag_prior import reconsidered, with_wide_priors
from massprop_drake.maths.estimation.joint.layout import (
    CENTER,
    MASS,
    N_PROPERTIES,
    RATE,
    VELOCITY,
    JointParams,
    JointState,
    n_assumed,
    relearned,
    releveled,
    taken_in,
)
from massprop_drake.maths.estimation.joint.measurement import (
    POOR,
    changed,
    counted,
    outputs,
    rate_read,
    readings,
    told_by_trackers,
)
from massprop_drake.maths.estimation.joint.modes import spread_of
from massprop_drake.maths.estimation.joint.orientation import STILL
from massprop_drake.maths.estimation.joint.prediction import (
    Drive,
    Prediction,
    burning,
    drive,
    gathered_rows,
    lag_of,
    predict,
    propagated,
    turned_by,
)
from massprop_drake.maths.estimation.joint.quantized import Sites, sites
from massprop_drake.maths.estimation.joint.tanks import drawn
from massprop_drake.maths.estimation.joint.thrust_scale import partitioned, reported
from massprop_drake.maths.estimation.joint.ticks import Stamped, Timing, stamped
from massprop_drake.maths.estimation.joint.unknown import EXPECTED, shown_by
from massprop_drake.maths.estimation.joint.wheels import UNSPUN, Spun, first_spread, turn_by
from massprop_drake.maths.kernels import kernel
from massprop_drake.maths.linear_algebra import Array, NotPositiveDefiniteError, skew, sparse_product
from massprop_drake.maths.vehicle.disturbance import kept_share

_WHAT = "the joint estimator's covariance"
_UNREAD = 1e6  # sigmas of a reading that what was not read at the start may be off
_DIGITS = 1e3  # arithmetic: 1-sigmas of readings, of whose square a NIS across so wide directions has ten digits left
UNTRACKED = np.zeros((0, 3))  # readings of no tracker
OWN_CHOICE = np.zeros(0, dtype=np.bool_)  # of the readings that count


class JointSample(NamedTuple):
    """Sample as a cycle takes it.

    Attributes:
        time_s: of the readings.
        durations_s: of the pieces of the interval that ends then, each with a constant command, shape (n_pieces,).
        commands: fraction commanded in each piece, NaN where not known, shape (n_pieces, n_jets).
        outside: impulse of known outside forces over the interval, angular about the vehicle origin and linear,
            shape (6,).
        rates: readings of the gyro packages, NaN where missing, rad/s, shape (n_gyros, 3).
        velocities: readings of the accelerometer packages, NaN where missing, ft/s or m/s, shape
            (n_accelerometers, 3).
        timing: see `ticks.Timing`.
        attitudes: readings of the trackers relative to the shared attitude, NaN where missing, see `orientation`, rad,
            shape (n_trackers, 3).
        frames: shared attitude before and after the interval, quaternions, shape (2, 4).
        speeds: see `wheels.Spun`.
        burn: see `burns.Burn`.
    """

    time_s: float
    durations_s: Array
    commands: Array
    outside: Array
    rates: Array
    velocities: Array
    timing: Timing
    attitudes: Array = UNTRACKED
    frames: Array = STILL
    speeds: Spun = UNSPUN
    burn: Burn = UNLIT


@kernel
def turned_from_outside(sample: JointSample, params: JointParams) -> bool:
    """Tests whether known outside forces, engines or wheels act on the vehicle."""
    known = bool(np.any(sample.outside != 0.0)) or bool(np.any(sample.burn.points[:, :, 0] != 0.0))
    return known or turn_by(sample.speeds, params.wheels)


def acts(sample: JointSample, params: JointParams) -> bool:
    """Tests whether anything pushes or turns the vehicle in a sample."""
    return bool((sample.commands > 0.0).any() or turned_from_outside(sample, params))


class Expected(NamedTuple):
    """Expected readings of a cycle, before it updates.

    Attributes:
        prediction: see `Prediction`.
        root: predicted, with noise, not square, shape (size, k).
        spin: integral of w w^T dt, with the interval's, shape (6,).
        jacobian: H, shape (m, size).
        projected: H times root, shape (m, k).
        innovation: e of all components, NaN where missing, shape (m,).
        used: which components count, shape (m,).
        floors: variance of each prediction beyond the state's, shape (m,).
        variances: of one reading of each component, shape (m,).
    """

    prediction: Prediction
    root: Array
    spin: Array
    jacobian: Array
    projected: Array
    innovation: Array
    used: np.ndarray
    floors: Array
    variances: Array


class Crossing(NamedTuple):
    """Update of the state before an interval by readings that change in it, each the last one in its cell.

    Attributes:
        rows: U^-T H, zero for readings that did not count, shape (m, size).
        half_gain: G, likewise, shape (size, m); K H = G rows.
        correction: of the mean, shape (size,).
        log_likelihood: of these readings, nats.
    """

    rows: Array
    half_gain: Array
    correction: Array
    log_likelihood: float


class Course(NamedTuple):
    """Course of a cycle: what a detector needs to propagate errors through it.

    Attributes:
        crossing: see `Crossing`.
        stamp: see `ticks.Stamped`.
        acting: see `Drive`.
        expected: see `Expected`; after an increment, if there was one.
        update: `nothing_learned` where no component counted.
        nis, degrees, log_likelihood: see `Report`.
    """

    crossing: Crossing
    stamp: Stamped
    acting: Drive
    expected: Expected
    update: Update
    nis: float
    degrees: float
    log_likelihood: float


class Report(NamedTuple):
    """Report of a cycle.

    Attributes:
        estimate: of the ten parameters, shape (10,).
        covariance: of their errors, shape (10, 10).
        innovation: of all components, before any increment, NaN where missing, shape (m,).
        innovation_std: 1-sigma of each, by the covariance before any increment, shape (m,).
        used: which components counted, shape (m,).
        nis, degrees: sum over those that counted, and its expectation, see `quantized.Sites`.
        log_likelihood: of all readings that the cycle has taken in, with what another prior of a lag makes of those
            before, nats.
        gyro_nis, accelerometer_nis: of the components of either kind that counted, of accelerometers given the gyros,
            before any increment; NaN where none did.
        gyro_degrees, accelerometer_degrees: their expectations; zero where none did.
        incremented: whether the covariance was incremented.
        coupled: whether dynamic coupling counted.
        course: see `Course`; None at the first sample.
        starting, contradicted: whether a start is kept to be gone over again, and whether it has just ended since that
            does not explain the readings, see `start`.
        rotation_known: whether hypotheses may be judged by the rates before all has converged, see `start`.
    """

    estimate: Array
    covariance: Array
    innovation: Array
    innovation_std: Array
    used: np.ndarray
    nis: float
    degrees: float
    log_likelihood: float
    gyro_nis: float
    accelerometer_nis: float
    gyro_degrees: float
    accelerometer_degrees: float
    incremented: bool
    coupled: bool
    course: Course | None
    starting: bool = False
    contradicted: bool = False
    rotation_known: bool = False


class JointEvidence(NamedTuple):
    """Evidence of a cycle of the joint filter for a detector.

    Attributes:
        before, after: states before and after it.
        report: see `Report`.
        sample: what the cycle got.
        anew: whether rate and velocity began anew, so that nothing was tested.
    """

    before: JointState
    after: JointState
    report: Report
    sample: JointSample
    anew: bool


def initial(params: JointParams) -> JointState:
    """Returns the state before the first sample."""
    places = params.places
    mean, root = np.zeros(places.size), np.zeros((places.size, places.size))
    mean[:N_PROPERTIES] = params.start
    root[:N_PROPERTIES, :N_PROPERTIES] = params.start_root
    for element in range(places.slow, places.slow + places.n_slow):
        root[element, element] = 0.0 if 0 <= element - places.unstated < places.n_unstated else 1.0
    swing = slice(places.swing, places.swing + places.n_swing)
    root[swing, swing] = np.diag(spread_of(params.modes.start, params.modes))
    for element in range(places.thrust, places.size):
        root[element, element] = params.prior_sigma[element - places.thrust]
    for tank in range(places.tanks):
        element = places.fill + tank
        mean[element], root[element, element] = params.tanks.fill[tank], params.tanks.fill_sigma[tank]
    jets = places.jets
    return JointState(
        mean=mean,
        root=compressed(root, places.thrust),
        level=np.zeros(jets),
        slope=np.zeros(jets),
        tick_slope=np.zeros((2, jets)),
        level_std=np.zeros(jets),
        spin=np.zeros(6),
        reference=np.zeros(3),
        read=np.full(places.outputs, np.nan),
        fresh=np.zeros(places.outputs),
        slot_jet=np.full(places.n_force, -1.0),
        slot_sign=np.ones(places.n_force),
        slot_on_top=np.zeros(places.n_force),
        time_s=0.0,
        started=False,
        guarded=False,
        firing_count=0.0,
        lag_open=np.zeros(places.n_lag),
        assumed=np.full(n_assumed(places), np.nan),
        stir=0.0,
        stir_s=1.0,
    )


def begun(state: JointState, sample: JointSample, params: JointParams) -> JointState:
    """Returns the state after the first sample, or after a gap: rate, gathered velocity and attitude as read.

    They are uncorrelated with the rest, but that with a gyro bias the rate's error is that of the reading less the
    bias, and that the rate from which the turning of accelerometers is counted has the error of that rate: what they
    read then says nothing of it. What is not read starts at zero and as good as unknown. Of a disturbance is known what
    is left of it.
    """
    places = params.places
    mean = state.mean.copy()
    first, last = RATE.start, places.slow
    root = np.zeros((places.size, places.size + last - first))
    root[:first, : places.size], root[last:, : places.size] = state.root[:first], state.root[last:]
    own = places.size - first  # a column for the reading of each of these rows
    for axis in range(3):
        row = RATE.start + axis
        weights = np.zeros(places.gyros)
        for package in range(places.gyros):
            if not np.isnan(sample.rates[package, axis]):
                weights[package] = 1.0 / params.variances[3 * package + axis]
        total = float(weights.sum())
        if total == 0.0:
            root[row, own + row] = _UNREAD * np.sqrt(params.variances[axis])
            continue
        root[row, own + row] = np.sqrt(1.0 / total)
        mean[row] = 0.0
        for package in range(places.gyros):
            if weights[package] > 0.0:
                share = weights[package] / total
                mean[row] += share * sample.rates[package, axis]
                if places.n_gyro_bias > 0:
                    bias, shift = places.gyro_bias + 3 * package + axis, share * params.gyro_bias_sigma
                    mean[row] -= shift * mean[bias]
                    root[row] -= shift * root[bias]
    for package in range(places.accelerometers):
        for axis in range(3):
            row, value = VELOCITY + 3 * package + axis, sample.velocities[package, axis]
            deviation = np.sqrt(params.variances[3 * (places.gyros + package) + axis])
            missing = np.isnan(value)
            mean[row] = 0.0 if missing else value
            root[row, own + row] = _UNREAD * deviation if missing else deviation
        part = slice(VELOCITY + 3 * package, VELOCITY + 3 * package + 3)
        arm = params.accelerometer_positions[package] - mean[CENTER]
        root[part] += skew(arm) @ root[RATE]
    for axis in range(places.n_attitude):
        row = places.attitude + axis
        own_variances = params.trackers.variances * np.where(params.trackers.outliers > 0.0, POOR**2, 1.0)
        there = ~np.isnan(sample.attitudes[:, axis])
        mean[row], root[row, own + row] = 0.0, _UNREAD * np.sqrt(own_variances[0])
        if there.any():
            weights = 1.0 / own_variances[there]
            mean[row] = weights @ sample.attitudes[there, axis] / weights.sum()
            root[row, own + row] = np.sqrt(1.0 / weights.sum())
    if places.n_slow > 0:
        kept, spread = _kept_of_slow(state, sample, params)
        come = np.zeros((places.size, places.n_slow))
        slow = slice(places.slow, places.slow + places.n_slow)
        come[slow] = np.diag(spread * np.sqrt(1.0 - kept**2))
        mean[slow] *= kept
        root[slow] *= kept.reshape(-1, 1)
        root = np.hstack((root, come))
    mean, root = _with_shaken(state, mean, root, params)
    read = readings(sample.rates, sample.velocities, sample.attitudes)
    return state._replace(
        mean=mean,
        root=compressed(root, places.thrust),
        spin=np.zeros(6),
        reference=mean[RATE].copy(),
        read=read,
        fresh=np.zeros(read.shape[0]),
        time_s=sample.time_s,
        started=True,
    )


def _with_shaken(state: JointState, mean: Array, root: Array, params: JointParams) -> tuple[Array, Array]:
    """Returns mean and root with modes that may have been shaken by anything, if they have been followed before."""
    places = params.places
    if places.n_swing == 0 or not state.started:
        return mean, root
    swing = slice(places.swing, places.swing + places.n_swing)
    shaken = np.zeros((places.size, places.n_swing))
    shaken[swing] = np.diag(spread_of(params.modes.shaken, params.modes))
    mean[swing], root[swing] = 0.0, 0.0
    return mean, np.hstack((root, shaken))


def _kept_of_slow(state: JointState, sample: JointSample, params: JointParams) -> tuple[Array, Array]:
    """Computes the share of each z left after a time of which nothing is known, and its 1-sigma then."""
    places = params.places
    filled = places.n_slow - places.tanks
    others, unstated = filled - places.wheels, places.unstated - places.slow
    kept, spread, since_s = np.zeros(places.n_slow), np.ones(places.n_slow), max(sample.time_s - state.time_s, 0.0)
    kept[:unstated] = kept_share(params.disturbance.time_constant_s, since_s)
    kept[unstated:others], spread[unstated:others] = kept_share(state.stir_s, since_s), state.stir
    spread[others:filled] = first_spread(sample.speeds.kept, params.wheels)
    kept[filled:] = 1.0
    return kept, spread


@kernel
def expect(state: JointState, acting: Drive, sample: JointSample, params: JointParams) -> Expected:
    """Predicts the state and its outputs, and selects the components that count."""
    read = rate_read(sample.rates, state.mean, params)
    prediction = predict(state, acting, read, params, (sample.frames, sample.speeds))
    root = propagated(state.root, prediction, params)
    about = (prediction.mean[:N_PROPERTIES], floors(state, params))
    return _expected(state, prediction, root, about, sample, params)


@kernel
def _expected(
    state: JointState,
    prediction: Prediction,
    root: Array,
    about: tuple[Array, Array],
    sample: JointSample,
    params: JointParams,
) -> Expected:
    """Predicts the readings of a sample; linearized at some mass properties and at the rate that gyros correct.

    At the rate that was predicted, its error times that of the center of mass would be taken for an error of this.
    """
    spin = state.spin + prediction.spin
    there = prediction.mean.copy()
    properties, least = about
    there[:N_PROPERTIES], there[RATE] = properties, prediction.end
    values, jacobian = outputs(there, state.reference, spin, params)
    values = values + jacobian @ (prediction.mean - there)
    projected = sparse_product(jacobian, root)
    read = readings(sample.rates, sample.velocities, sample.attitudes)
    variances = params.variances
    if params.places.n_attitude > 0:
        variances, least = told_by_trackers(read - values, projected, prediction.end, least, params)
    counts, least = counted(read, state.read, values, (projected**2).sum(axis=1), least, params)
    return Expected(prediction, root, spin, jacobian, projected, read - values, counts, least, variances)


@kernel
def _by_kind(values: Array, used: np.ndarray, nothing: float, params: JointParams) -> tuple[float, float]:
    """Sums over the gyros' components that count, and over the accelerometers'.

    Args:
        values: of each that counts, shape (number,).
        used: which components count, shape (m,).
        nothing: in place of a sum of none.
        params: see `JointParams`.
    """
    places = params.places
    gyros = int(used[: 3 * places.gyros].sum())
    both = int(used[: 3 * (places.gyros + places.accelerometers)].sum())
    of_gyros = values[:gyros].sum() if gyros > 0 else nothing
    return of_gyros, values[gyros:both].sum() if both > gyros else nothing


@kernel
def floors(state: JointState, params: JointParams) -> Array:
    """Computes each prediction's variance beyond the state's, shape (m,): before the guard holds, that of rounding.

    Until then the second order counts, and no cell is told to a hundredth of a quantum. Passes over the start are
    linearized where its end knows the mass properties to be, and need no such floor.
    """
    return params.floors if state.guarded else params.variances


@kernel
def _sites(used: np.ndarray, projected: Array, innovation: Array, given: tuple[Array, Array]) -> Sites:
    """Makes measurements that stand for the readings that count, see `quantized.sites`.

    Args:
        used: which components count, shape (m,).
        projected: their rows of H times the root, shape (number, k).
        innovation: of all components, shape (m,).
        given: quanta, and floors, of all components, shape (m,).
    """
    counts, (cells, least) = np.flatnonzero(used), given
    return sites(innovation[counts], projected @ projected.T, cells[counts], least[counts])


@kernel
def _told(expected: Expected, params: JointParams) -> Sites:
    """Makes measurements that stand for a sample's readings that count, as they are expected."""
    projected = expected.projected[np.flatnonzero(expected.used)]
    return _sites(expected.used, projected, expected.innovation, (params.cells, expected.floors))


@kernel
def _update(expected: Expected, root: Array, params: JointParams) -> tuple[Update, Sites]:
    projected = sparse_product(expected.jacobian[np.flatnonzero(expected.used)], root)
    told = _sites(expected.used, projected, expected.innovation, (params.cells, expected.floors))
    return updated(root, projected, told.variance, told.innovation, params.places.thrust), told


@kernel
def crossed(
    state: JointState, about: Array, sample: JointSample, least: Array, params: JointParams
) -> tuple[JointState, Crossing]:
    """Updates the state by readings that were the last in their cells, and have not been taken in.

    Args:
        state: after the last sample.
        about: the ten parameters at which outputs are linearized, shape (10,).
        sample: the next one, whose readings show which have changed.
        least: see `floors`.
        params: see `JointParams`.
    """
    places, m = params.places, state.read.shape[0]
    rows, half_gain = np.zeros((m, places.size)), np.zeros((places.size, m))
    chosen = (state.fresh > 0.0) & changed(
        readings(sample.rates, sample.velocities, sample.attitudes), state.read, params
    )
    if not chosen.any():
        return taken_in(state), Crossing(rows, half_gain, np.zeros(places.size), 0.0)
    there = state.mean.copy()
    there[:N_PROPERTIES] = about
    values, jacobian = outputs(there, state.reference, state.spin, params)
    values = values + jacobian @ (state.mean - there)
    counts = np.flatnonzero(chosen)
    projected = sparse_product(jacobian[counts], state.root)
    told = _sites(chosen, projected, state.read - values, (params.cells, least))
    change = widely_updated(state.root, projected, told.variance, told.innovation)
    whitened = np.linalg.solve(change.upper.T, jacobian[counts])
    for place in range(counts.shape[0]):
        rows[counts[place]], half_gain[:, counts[place]] = whitened[place], change.half_gain[:, place]
    mean = state.mean + change.correction
    level = _releveled((state.level, state.slope, state.tick_slope), state.mean, mean, params)
    after = taken_in(releveled(state, mean, change.root, level, state.tick_slope))
    return after, Crossing(rows, half_gain, change.correction, told.log_likelihood.sum())


def step(
    state: JointState, sample: JointSample, params: JointParams, counts: np.ndarray = OWN_CHOICE
) -> tuple[JointState, Report]:
    """Runs a whole cycle.

    Args:
        state: after the last sample.
        sample: see `JointSample`.
        params: see `JointParams`.
        counts: see `cycled`.

    Raises:
        NotPositiveDefiniteError: when the covariance or the estimate overflow, or the readings are too precise for
            what is known of them to be told from them, with the time.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        try:
            after, report = _step(state, sample, params, counts) if state.started else _first(state, sample, params)
        except NotPositiveDefiniteError as error:
            raise error.at(sample.time_s, "the joint estimator") from None
        except np.linalg.LinAlgError:
            raise NotPositiveDefiniteError(state.root @ state.root.T, _WHAT, sample.time_s) from None
        if not (np.all(np.isfinite(after.mean)) and np.all(np.isfinite(after.root))):
            raise NotPositiveDefiniteError(after.root @ after.root.T, _WHAT, sample.time_s)
    return after, report


def _step(state: JointState, sample: JointSample, params: JointParams, counts: np.ndarray) -> tuple[JointState, Report]:
    made = params.compiled
    done: Cycled = (
        cycled(state, sample, params.thresholds, counts, params)
        if made is None
        else made.cycled(Cycling(state, sample, params.thresholds, counts))
    )
    expected = done.expected
    return done.state, Report(
        estimate=done.estimate,
        covariance=done.covariance,
        innovation=done.innovation,
        innovation_std=done.innovation_std,
        used=expected.used,
        nis=done.nis,
        degrees=done.degrees,
        log_likelihood=done.log_likelihood,
        gyro_nis=done.gyro_nis,
        accelerometer_nis=done.accelerometer_nis,
        gyro_degrees=done.gyro_degrees,
        accelerometer_degrees=done.accelerometer_degrees,
        incremented=done.incremented,
        coupled=expected.prediction.coupled,
        course=course_of(done),
    )


def _first(state: JointState, sample: JointSample, params: JointParams) -> tuple[JointState, Report]:
    after = begun(state, sample, params)
    n_outputs = after.read.shape[0]
    estimate, rows = reported(after, params)
    nothing, unused = np.full(n_outputs, np.nan), np.zeros(n_outputs, dtype=np.bool_)
    return after, Report(
        estimate, rows @ rows.T, nothing, nothing, unused, 0.0, 0.0, 0.0, np.nan, np.nan, 0.0, 0.0, False, False, None
    )


def restart(state: JointState, sample: JointSample, params: JointParams) -> tuple[JointState, Report]:
    """Runs a cycle over an interval of which nothing is known: rate and gathered velocity begin again, see `begun`.

    What else is known stays; thrust follows the commands as far as they are known.

    Args:
        state: after the last sample, `started`.
        sample: see `JointSample`.
        params: see `JointParams`.
    """
    state, _ = stamped(state, sample.timing, params)
    acting = driven(state, sample, params)
    firing = acting.firing
    begun_by = state._replace(
        level=firing.level, slope=firing.slope, tick_slope=acting.tick_slope, level_std=firing.level_std
    )
    return _first(begun_by, sample, params)


@kernel
def driven(state: JointState, sample: JointSample, params: JointParams) -> Drive:
    """Computes the drive of a sample's interval; jets of unknown command give in it what its readings show."""
    acting = drive(state, sample.durations_s, sample.commands, sample.outside, sample.timing, params)
    acting = burning(acting, sample.burn, state, params)
    if acting.anything.number == 0.0:
        return acting
    read = rate_read(sample.rates, state.mean, params)
    prediction = predict(state, acting, read, params, (sample.frames, sample.speeds))
    there = prediction.mean.copy()
    there[RATE] = prediction.end
    values, _ = outputs(there, state.reference, state.spin + prediction.spin, params)
    shown, begin = np.zeros(6), 3 * params.places.gyros
    shown[:3] = read.rate - prediction.mean[RATE]
    for axis in range(3):
        present = 0
        for package in range(params.places.accelerometers):
            if not np.isnan(sample.velocities[package, axis]):
                present += 1
                shown[3 + axis] += sample.velocities[package, axis] - values[begin + 3 * package + axis]
        shown[3 + axis] = shown[3 + axis] / present if present > 0 else np.nan
    return Drive(
        shown_by(shown, state.mean, acting.firing, acting.anything, params),
        acting.lag_slope,
        acting.outside,
        acting.spreads,
        acting.by_ticks,
        acting.tick_slope,
        acting.anything,
        acting.engines,
    )


class Cycled(NamedTuple):
    """Result of the kernel of a cycle.

    Attributes:
        state: after it.
        estimate: see `Report`, as all up to `log_likelihood`.
        covariance: see there.
        innovation, innovation_std: see there.
        gyro_nis, accelerometer_nis, gyro_degrees, accelerometer_degrees, incremented: see there.
        nis, degrees, log_likelihood: see there.
        crossing, stamp, acting, expected: see `Course`.
        update: see there.
    """

    state: JointState
    estimate: Array
    covariance: Array
    innovation: Array
    innovation_std: Array
    gyro_nis: float
    accelerometer_nis: float
    gyro_degrees: float
    accelerometer_degrees: float
    incremented: bool
    nis: float
    degrees: float
    log_likelihood: float
    crossing: Crossing
    stamp: Stamped
    acting: Drive
    expected: Expected
    update: Update


@kernel
def course_of(done: Cycled) -> Course:
    """Collects the course of a cycle, see `Course`."""
    return Course(
        done.crossing,
        done.stamp,
        done.acting,
        done.expected,
        done.update,
        done.nis,
        done.degrees,
        done.log_likelihood,
    )


class Cycling(NamedTuple):
    """Inputs of compiled code for a cycle besides the parameters.

    Attributes:
        state: see `cycled`.
        sample: see `cycled`.
        thresholds: see `JointParams`; of all parameters these alone may be others than those that it was compiled for.
        counts: see `cycled`.
    """

    state: JointState
    sample: JointSample
    thresholds: Array
    counts: np.ndarray


@kernel
def cycled(
    state: JointState, sample: JointSample, thresholds: Array, counts: np.ndarray, params: JointParams
) -> Cycled:
    """Runs a cycle after the first.

    Args:
        state: after the last sample.
        sample: see `JointSample`.
        thresholds: in place of those of the parameters.
        counts: which readings count unless they are missing, so that hypotheses are compared on the same ones, shape
            (m,); or `OWN_CHOICE`, shape (0,).
        params: see `JointParams`.
    """
    least = floors(state, params)
    state, crossing = crossed(state, state.mean[:N_PROPERTIES], sample, least, params)
    state, stamp = stamped(state, sample.timing, params)
    acting = driven(state, sample, params)
    state, firing = partitioned(state, acting.firing.amount, params), acting.firing
    commanded = firing.commanded or turned_from_outside(sample, params)
    expected = expect(state, acting, sample, params)
    if counts.size > 0:
        expected = _counting(expected, counts & ~np.isnan(expected.innovation))
    innovation, incremented, likelier = expected.innovation, False, 0.0
    deviation = np.sqrt((expected.projected**2).sum(axis=1) + expected.variances)
    told = _told(expected, params)
    gyro_nis, accelerometer_nis = _by_kind(told.nis, expected.used, np.nan, params)
    gyro_degrees, accelerometer_degrees = _by_kind(told.degrees, expected.used, 0.0, params)
    anything = _anything(expected, acting, state.mean, params)
    if acting.anything.number > 0.0:
        spread = acting.anything.spread
        gyro_nis, gyro_degrees = _tested(gyro_nis, gyro_degrees - anything[0], spread)
        accelerometer_degrees -= anything[1]
        accelerometer_nis, accelerometer_degrees = _tested(accelerometer_nis, accelerometer_degrees, spread)
    if commanded and not state.guarded:
        count = int(expected.used[: 3 * params.places.gyros].sum())
        if count > 0 and gyro_nis > thresholds[count - 1]:
            opened, more = with_wide_priors(state, params)
            given = driven(opened, sample, params)
            wider = _counting(expect(opened, given, sample, params), expected.used)
            nis, _ = _by_kind(_told(wider, params).nis, wider.used, np.nan, params)
            if nis <= thresholds[count - 1]:  # a lag that is not as stated explains it
                state, acting, expected, likelier = opened, given, wider, more
            else:
                incremented = True
                state = relearned(state, state.mean, incremented_root(state.root, params))
                expected = _counting(expect(state, acting, sample, params), expected.used)

    change = nothing_learned(expected.root)
    if expected.used.any():
        change, told = _update(expected, expected.root, params)
    after = _learned(state, sample, acting, expected, change, params)
    if state.guarded:  # before, second orders may be taken for what a lag does
        after, likelier = reconsidered(after, params)
    after = guarded(after, commanded, params)
    estimate, rows = reported(after, params)
    return Cycled(
        after,
        estimate,
        rows @ rows.T,
        innovation,
        deviation,
        gyro_nis,
        accelerometer_nis,
        gyro_degrees,
        accelerometer_degrees,
        incremented,
        float(told.nis.sum()),
        max(float(told.degrees.sum()) - anything[0] - anything[1], 0.0),
        crossing.log_likelihood + float(told.log_likelihood.sum()) + anything[2] + likelier,
        crossing,
        stamp,
        acting,
        expected,
        change,
    )


@kernel
def _anything(expected: Expected, acting: Drive, mean: Array, params: JointParams) -> tuple[float, float, float]:
    """Counts components whose readings only show how long jets of unknown command were open, see `unknown`.

    Args:
        expected: see `Expected`.
        acting: see `Drive`.
        mean: before the interval, where it is linearized, shape (size,).
        params: see `JointParams`.

    Returns:
        Degrees of freedom of the gyros, of the accelerometers given these, and what the log likelihood lacks, nats.
    """
    counts = np.flatnonzero(expected.used)
    if acting.anything.number == 0.0 or counts.shape[0] == 0:
        return 0.0, 0.0, 0.0
    jacobian, places = expected.jacobian[counts], params.places
    opened = acting.anything.spread * acting.anything.basis
    arms = params.accelerometer_positions - mean[CENTER]
    turned = turned_by(mean[RATE], expected.prediction.end, arms, expected.prediction.duration_s)[1]
    wide = jacobian[:, RATE] @ opened[:3]
    for package in range(places.accelerometers):
        part = jacobian[:, VELOCITY + 3 * package : VELOCITY + 3 * package + 3]
        wide += part @ (opened[3:] + turned[package] @ opened[:3])
    wide = wide / np.sqrt(expected.variances[counts]).reshape(-1, 1)
    every = _opened_degrees(wide)
    number = int(expected.used[: 3 * places.gyros].sum())
    gyros = _opened_degrees(np.ascontiguousarray(wide[:number])) if number > 0 else 0.0
    return gyros, max(every - gyros, 0.0), every * (np.log(acting.anything.spread) + EXPECTED)


@kernel
def _opened_degrees(wide: Array) -> float:
    """Computes the degrees of freedom that directions take from readings, by their effects in readings' 1-sigmas."""
    squares = np.linalg.svd(wide)[1] ** 2
    return float((squares / (1.0 + squares)).sum())


@kernel
def _tested(nis: float, degrees: float, spread: float) -> tuple[float, float]:
    """Returns a NIS and its expectation; none where less than half a component, or too few digits, are left.

    Readings are compared across directions in which they may be off by `spread` of their own 1-sigmas.
    """
    return (nis, degrees) if (degrees > 0.5 and spread < _DIGITS) or np.isnan(nis) else (np.nan, 0.0)


@kernel
def _learned(
    state: JointState, sample: JointSample, acting: Drive, expected: Expected, change: Update, params: JointParams
) -> JointState:
    """Computes the state after a cycle, before the guard.

    Args:
        state: before it.
        sample: of it.
        acting: see `Drive`.
        expected: see `Expected`.
        change: of no meaning where no component counted.
        params: see `JointParams`.
    """
    mean, root, firing = expected.prediction.mean, change.root, acting.firing
    if expected.used.any():
        mean = mean + change.correction
    elif root.shape[1] > root.shape[0]:
        root = compressed(root, params.places.thrust)
    read = readings(sample.rates, sample.velocities, sample.attitudes)
    there = ~np.isnan(read)
    return JointState(
        mean,
        root,
        _releveled((firing.level, firing.slope, acting.tick_slope), state.mean, mean, params),
        firing.slope,
        acting.tick_slope,
        firing.level_std,
        expected.spin,
        state.reference,
        np.where(there, read, state.read),
        np.where(there & ~expected.used, 1.0, 0.0),
        state.slot_jet,
        state.slot_sign,
        state.slot_on_top,
        sample.time_s,
        state.started,
        state.guarded,
        state.firing_count,
        state.lag_open,
        state.assumed,
        state.stir,
        state.stir_s,
    )


@kernel
def gone_over(
    state: JointState, sample: JointSample, about: Array, params: JointParams
) -> tuple[JointState, float, float]:
    """Runs a cycle of a start that is gone over again, see `relinearized`.

    Args:
        state: after the last sample, not guarded.
        sample: see `JointSample`.
        about: a state's estimate at which it is linearized, shape (size,).
        params: see `JointParams`.

    Returns:
        The state after it, the NIS of the components that counted, and its expectation.
    """
    after, course, _ = relinearized(state, sample, about, params)
    after, _ = reconsidered(after, params)
    return after, course.nis, course.degrees


@kernel
def relinearized(
    state: JointState, sample: JointSample, about: Array, params: JointParams
) -> tuple[JointState, Course, tuple[float, float]]:
    """Runs a cycle linearized at other mass properties, lags, biases and forces than the state's.

    Args:
        state: after the last sample, not guarded.
        sample: see `JointSample`.
        about: a state's estimate with these, shape (size,).
        params: see `JointParams`.

    Returns:
        The state after it, how it went, and NIS of the gyros with its expectation.
    """
    state, crossing = crossed(state, standing(about, state.mean, params), sample, params.floors, params)
    state, stamp = stamped(state, sample.timing, params)
    mean = _about(state.mean, about, params)
    acting = driven(relearned(state, mean, state.root), sample, params)
    state = partitioned(state, acting.firing.amount, params)
    there = relearned(state, mean, state.root.copy())
    there.root[:N_PROPERTIES] = 0.0  # nothing of second order is left
    at = predict(there, acting, rate_read(sample.rates, mean, params), params, (sample.frames, sample.speeds))
    away = state.mean - mean
    mean = at.mean + away
    swing = slice(params.places.swing, params.places.swing + params.places.n_swing)
    mean[swing] = at.mean[swing] + at.swung.rows @ away
    mean[RATE] += at.rate_rows @ away
    for package in range(params.places.accelerometers):
        part = slice(VELOCITY + 3 * package, VELOCITY + 3 * package + 3)
        mean[part] += gathered_rows(at, package) @ away
    if params.places.n_attitude > 0:
        part = slice(params.places.attitude, params.places.attitude + 3)
        mean[part] += at.attitude[0] @ away[RATE] + at.attitude[1] @ (away[RATE] + at.rate_rows @ away)
    if params.places.tanks > 0:
        more = at.tank_rows @ away
        mean[:N_PROPERTIES] += more[:N_PROPERTIES]
        mean[params.places.fill : params.places.fill + params.places.tanks] += more[N_PROPERTIES:]
    prediction = Prediction(
        mean,
        at.rate_rows,
        at.velocity_rows,
        at.apart,
        at.attitude,
        at.mass_factor,
        at.noise,
        at.wander,
        at.swung,
        at.drift,
        at.tank_rows,
        at.turned,
        at.spin,
        at.end,
        at.duration_s,
        at.coupled,
    )
    root = propagated(state.root, prediction, params)
    there_properties = standing(about, prediction.mean, params)
    expected = _expected(state, prediction, root, (there_properties, params.floors), sample, params)
    change, told = (
        nothing_learned(root),
        _sites(np.zeros_like(expected.used), root[:0], expected.innovation, (params.cells, params.floors)),
    )
    if expected.used.any():
        change, told = _update(expected, root, params)
    after = _learned(state, sample, acting, expected, change, params)
    after = releveled(after, after.mean, after.root, _level_about(state, after, acting, params), acting.tick_slope)
    anything = _anything(expected, acting, there.mean, params)
    nis, degrees = float(told.nis.sum()), max(float(told.degrees.sum()) - anything[0] - anything[1], 0.0)
    log_likelihood = crossing.log_likelihood + float(told.log_likelihood.sum()) + anything[2]
    gyro_nis, gyro_degrees = (
        _by_kind(told.nis, expected.used, 0.0, params)[0],
        _by_kind(told.degrees, expected.used, 0.0, params)[0],
    )
    course = Course(crossing, stamp, acting, expected, change, nis, degrees, log_likelihood)
    return after, course, (gyro_nis, max(gyro_degrees - anything[0], 0.0))


@kernel
def _level_about(before: JointState, after: JointState, acting: Drive, params: JointParams) -> Array:
    """Computes levels after a cycle, lags where it is linearized and ticks at their new estimates, shape (n_jets,)."""
    places, mean = params.places, before.mean.copy()
    lags = slice(places.lag, places.lag + places.n_lag)
    mean[lags] = after.mean[lags]
    return _releveled((acting.firing.level, acting.firing.slope, acting.tick_slope), mean, after.mean, params)


@kernel
def standing(about: Array, mean: Array, params: JointParams) -> Array:
    """Returns the ten parameters of an estimate, with as much propellant in the tanks as another one has, shape (10,).

    Args:
        about: the estimate, shape (size,).
        mean: the other, shape (size,).
        params: see `JointParams`.
    """
    places, result = params.places, about[:N_PROPERTIES].copy()
    if places.tanks > 0:
        fill = slice(places.fill, places.fill + places.tanks)
        used = about[fill] - mean[fill]
        result[:MASS] += drawn(result, about[fill], used, 1.0, params.tanks).change[:MASS]
        result[MASS] /= 1.0 - result[MASS] * used.sum()
    return result


@kernel
def _about(mean: Array, about: Array, params: JointParams) -> Array:
    """Returns an estimate with mass properties, lags, forces and gyros' biases of another, and the rate to match.

    Args:
        mean: the estimate, shape (size,).
        about: the other, shape (size,).
        params: see `JointParams`.
    """
    places = params.places
    result = mean.copy()
    result[:N_PROPERTIES] = standing(about, mean, params)
    forces = slice(places.force, places.force + places.n_force)
    result[forces] = about[forces]
    lags = slice(places.lag, places.lag + places.n_lag)
    result[lags] = about[lags]
    moving = slice(places.moving, places.moving + places.n_moving)
    result[moving] = about[moving]
    if places.n_gyro_bias > 0:
        biases = slice(places.gyro_bias, places.gyro_bias + places.n_gyro_bias)
        result[biases] = about[biases]
        for package in range(places.gyros):
            begin = places.gyro_bias + 3 * package
            own = slice(begin, begin + 3)
            result[RATE] += params.gyro_bias_sigma / places.gyros * (mean[own] - about[own])
    return result


@kernel
def _counting(expected: Expected, used: np.ndarray) -> Expected:
    """Returns the expectation with other components that count."""
    return Expected(
        expected.prediction,
        expected.root,
        expected.spin,
        expected.jacobian,
        expected.projected,
        expected.innovation,
        used,
        expected.floors,
        expected.variances,
    )


@kernel
def incremented_root(root: Array, params: JointParams) -> Array:
    """Computes the root with the uncertainty of the start added to the ten parameters, not square."""
    columns = np.zeros((root.shape[0], N_PROPERTIES))
    for element in range(N_PROPERTIES):
        columns[element, element] = params.increment_sigma[element]
    return np.hstack((root, columns))


@kernel
def _releveled(levels: tuple[Array, Array, Array], before: Array, after: Array, params: JointParams) -> Array:
    """Computes the levels at the new estimates of lag and ticks, to first order.

    Args:
        levels: `level`, `slope` and `tick_slope` of a state.
        before, after: estimates, shape (size,).
        params: see `JointParams`.
    """
    places, (level, slope, tick_slope) = params.places, levels
    if places.n_lag > 0:
        old, _ = lag_of(before, params)
        new, _ = lag_of(after, params)
        ratio = np.where(old > 0.0, new / np.where(old > 0.0, old, 1.0), 1.0)
        at_least, at_most = np.minimum(level, 0.0), np.maximum(level, 1.0)  # off its tick, beyond for an interval
        step = np.maximum(np.log(ratio), -1.0)  # a lag that goes takes along no more than the level was off
        level = np.minimum(np.maximum(level + slope * step, at_least), at_most)
    if places.n_ticks > 0 and tick_slope.any():
        ticks = slice(places.ticks, places.ticks + 2)
        moved_s = params.tick_sigma * (after[ticks] - before[ticks])
        level = level + moved_s @ tick_slope
    return level

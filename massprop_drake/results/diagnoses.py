"""Diagnoses of a run: the assumptions that its readings contradict, one after the other, in words."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.maths.estimation.chi_square import chi_square_limit
from massprop_drake.maths.estimation.offline import flight_model, oscillation, regression, unexplained_motion
from massprop_drake.maths.estimation.offline.flight_model import FlightModel, Stretch
from massprop_drake.maths.estimation.offline.regression import FlightFit, Reckoned, ScoreTest
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.vehicle.engine_thrust import N_ERRORS
from massprop_drake.results.consistency import Diagnosis
from massprop_drake.results.record_stretches import is_off_ticks, prepend_rows, take_rows
from massprop_drake.results.regression_model import Names

_OFF = 3.0  # 1-sigma from the widest start, beyond which the vehicle's file is not held against the readings
RATE = 2e-4  # at which a test is failed by chance
_MOST = 3  # causes that are looked for one after the other
_OUTSIDE = 5.0  # times the reach of the jets, at which no force of the vehicle acts
_TRIED = 5  # suspects with which all is fitted anew: compute budget
_CLEAR = 0.01  # 1-sigma of a combination of thrust errors that is tested
EXPLAINED = 0.9  # of the misfit beyond what is stated, that a cause must explain
_HOPELESS = 1e4  # times the stated variance: a sign may be wrong
_SMOOTH = 0.5  # serial correlation, from which on residuals drift rather than scatter
_SHARE = 0.9  # of what a group explains: one of it that explains as much is named alone
_REVERSED = (-2.6, -1.4)  # error of a gain that reverses a sign
_DEAD = (-1.2, -0.8)
_WIDE = 0.99  # 1-sigma from which on something is no longer tested: it has been found
FEWEST = 100  # readings, below which nothing is tested
SCATTER = 1.3  # times the stated variance: less may be rounding that is not white
_CONFIDENT = 5.0  # sigma of a ratio of variances


class _TestedGroup(NamedTuple):
    """Group of unknowns with the score test of their stated values."""

    kind: str
    group: NDArray[np.int_]
    score: ScoreTest
    statistic: float
    threshold: float


def diagnose_readings(
    parts: Sequence[Stretch], begin: Array, made: FlightModel, names: Names
) -> tuple[list[Diagnosis], FlightFit]:
    """Finds model errors that explain the readings' misfit, clearest first; also returns the first fit.

    Args:
        parts: of the record.
        begin: the ten parameters to begin with, shape (10,).
        made: see `model`.
        names: of jets, kinds and sensors.
    """
    found: list[Diagnosis] = []
    fit = first = regression.fit_flight(parts, fit_start(begin, made), made)
    if fit.normal.is_finite and (wider := _widen_prior(fit.at[:10], made)) is not made:
        made = wider
        fit = first = regression.fit_flight(parts, fit.at, made)
    if fit.normal.readings < FEWEST or not fit.normal.is_finite:
        return found, first
    fit, reckoned, found = try_switching(parts, fit, made)
    while len(found) < _MOST:
        best = min(_explanations(parts, fit, reckoned, names), key=lambda one: one.cost, default=None)
        if best is None:
            break
        found.append(best.diagnosis)
        parts, fit, reckoned = best.parts, best.fit, best.made
    if not found and fit.normal.per_reading > _HOPELESS:
        fit, found = _try_gyro_signs(parts, fit, made, names)
    if not any(one.kind == "jet" for one in found):  # what a failed jet leaves is no fault of sensors
        found += find_oscillation(parts, fit, reckoned, names) or _find_scatter(parts, fit, reckoned, names)
    return found, first


class _Explanation(NamedTuple):
    """Cause that explains the readings.

    Attributes:
        diagnosis: the cause in words.
        cost: objective of the fit, with the Bayesian information criterion's cost of what is free.
        parts: of the record, as the cause has them.
        fit: of the parts.
        made: model with what may be wrong by the cause.
    """

    diagnosis: Diagnosis
    cost: float
    parts: Sequence[Stretch]
    fit: FlightFit
    made: FlightModel


def _explanations(parts: Sequence[Stretch], fit: FlightFit, made: FlightModel, names: Names) -> Iterator[_Explanation]:
    """Yields model errors, such as wrong thrust or a delay, with which a new fit removes most of the misfit."""
    suspects = [one for one in _test_assumptions(fit, made) if one.statistic > one.threshold]
    per_unknown = math.log(max(fit.normal.readings, 1.0))
    for one in sorted(suspects, key=lambda one: -one.statistic / one.threshold)[:_TRIED]:
        cause = _describe_cause(one, fit, made, names)
        wider = made._replace(sigma=made.sigma.copy())
        wider.sigma[cause.group] = cause.sigma
        after = regression.fit_flight(parts, fit.at, wider)
        if _explains(after, fit):
            reason = _describe_lags(cause, after, made, names) if cause.kind == "lag" else cause.reason
            found = Diagnosis(cause.kind, reason, one.statistic, one.threshold)
            yield _Explanation(found, fit_cost(after, wider) + per_unknown * one.score.degrees, parts, after, wider)
    for rows in (1, -1) if excess_misfit(fit) > 0.0 and not made.own_times else ():
        moved = [_shift_commands(part, rows) for part in parts]
        after = regression.fit_flight(moved, made.prior, made)
        if not _explains(after, fit):
            continue
        same = regression.fit_flight([take_rows(part, _kept_rows(part, rows)) for part in parts], fit.at, made)
        if excess_misfit(same) > 0.0 and _explains(
            after, same
        ):  # else the row that is left out is all that contradicts
            words = f"delay wrong: commands act {1e3 * made.period_s:.3g} ms {'later' if rows > 0 else 'earlier'}"
            reason = f"{words} than they are logged, one sample period"
            found = Diagnosis("delay", reason, fit.normal.per_reading, after.normal.per_reading)
            yield _Explanation(found, fit_cost(after, made) + per_unknown, moved, after, made)


def _explains(after: FlightFit, before: FlightFit) -> bool:
    """Tests whether a fit removes nearly all of an earlier fit's misfit beyond rounding."""
    return after.normal.is_finite and excess_misfit(after) <= (1.0 - EXPLAINED) * excess_misfit(before)


def _shift_commands(part: Stretch, rows: int) -> Stretch:
    """Returns a stretch whose commands act one row later (1) or earlier (-1) than logged, one row shorter."""
    cut, told = take_rows(part, _kept_rows(part, rows)), slice(0, -1) if rows > 0 else slice(1, None)
    opening = None if part.onsets_s is None else part.onsets_s[told]
    return prepend_rows(cut._replace(commands=part.commands[told], onsets_s=opening), part, slice(0 if rows > 0 else 1))


def _kept_rows(part: Stretch, rows: int) -> slice:
    """Returns the slice of a stretch's rows that remain if commands move one row later (1) or earlier (-1)."""
    return slice(1, part.time_s.size) if rows > 0 else slice(0, part.time_s.size - 1)


def _describe_lags(cause: _Cause, after: FlightFit, made: FlightModel, names: Names) -> str:
    """Describes, per kind of jet, the time constant or delay that a fit with free thrust lags has found, ms."""
    places, words = flight_model.columns(made), []
    for place in cause.group.tolist():
        index, off = place - places.lag.start, 1e3 * float(after.at[place])
        told = 1e3 * float(made.time_constants_s[made.kinds == index].max(initial=0.0))
        if told > 0.0:
            words.append(f"{names.kinds[index]} jets build up with {max(told + off, 0.0):.3g} ms, told {told:.3g} ms")
        elif off != 0.0:
            when = "late" if off > 0.0 else "early"
            words.append(f"{names.kinds[index]} jets act {abs(off):.3g} ms {when}, told none")
    return f"lag wrong: {'; '.join(words)}"


def find_oscillation(parts: Sequence[Stretch], fit: FlightFit, made: FlightModel, names: Names) -> list[Diagnosis]:
    """Returns a diagnosis of slosh or a panel, or of random drift, as readings show it; [] where they do not.

    Where walks or a disturbance are stated, whatever exceeds them is told, a mode or not.
    """
    stated = flight_model.has_accumulating_noise(made)
    if not flight_model.is_physical(fit.at):
        return []
    if oscillation.is_covered(parts, fit, made) if stated else excess_misfit(fit) == 0.0:
        return []
    misfit, readings = oscillation.misfit_of(parts, fit, made) if stated else (fit.normal.misfit, fit.normal.readings)
    mode = oscillation.strongest_mode(parts, fit, made)
    left = (1.0 - EXPLAINED) * max(misfit - SCATTER * readings, 0.0)
    if mode is None or mode.misfit - SCATTER * mode.readings > left:
        if not stated:
            return []
        rate, velocity = oscillation.covering_walk(parts, fit, made, np.zeros_like(fit.at))
        words = f"readings wander more than is stated; {_walks_in_words(rate, velocity)}"
        return [Diagnosis("drift", words, misfit / max(readings, 1.0), 1.0)]
    rate, velocity = oscillation.covering_walk(parts, fit, made, mode.change)
    walks = _walks_in_words(rate, velocity)
    words = f"something inside moves at {mode.frequency_hz:.2g} Hz, such as slosh or a panel; {walks}"
    return [Diagnosis("oscillation", words, fit.normal.per_reading, mode.misfit / mode.readings)]


def _walks_in_words(rate: float, velocity: float) -> str:
    """Formats the `joint.rate_walk` and `joint.velocity_walk` that would cover the residuals' drift."""
    return f"joint.rate_walk={rate:.2g} and joint.velocity_walk={velocity:.2g} would cover it"


def fit_start(begin: Array, made: FlightModel) -> Array:
    """Returns the start of a fit: the prior, with the ten parameters of the estimate if physically possible."""
    start = made.prior.copy()
    if flight_model.is_physical(begin):  # NaN is not
        start[:10] = begin
    return start


def _widen_prior(found: Array, made: FlightModel) -> FlightModel:
    """Widens the prior 1-sigma of those of the ten parameters that a fit puts many sigmas from it."""
    off = np.abs(found - made.prior[:10])
    far = off > _OFF * made.sigma[:10]
    if not far.any():
        return made
    sigma = made.sigma.copy()
    sigma[:10] = np.where(far, off, sigma[:10])
    return made._replace(sigma=sigma)


def try_switching(
    parts: Sequence[Stretch], fit: FlightFit, made: FlightModel
) -> tuple[FlightFit, FlightModel, list[Diagnosis]]:
    """Refits with commands that switch at time stamps instead of ticks, or the reverse, if stamps are off ticks.

    Args:
        parts: of the record.
        fit: of them as it is stated.
        made: see `model`.

    Returns:
        The fit, the model that it was made with, and the diagnoses, at most one.
    """
    if made.at_stamps is None or excess_misfit(fit) == 0.0 or not is_off_ticks(parts, made):
        return fit, made, []
    other = made._replace(at_stamps=not made.at_stamps)
    after = regression.fit_flight(parts, fit.at if flight_model.is_physical(fit.at) else made.prior, other)
    if not _explains(after, fit):
        return fit, made, []
    where = "the stamps of their rows" if other.at_stamps else "regular ticks"
    words = f"clock jitter: commands switch at {where}: joint.switching={'stamps' if other.at_stamps else 'ticks'}"
    return after, other, [Diagnosis("jitter", words, fit.normal.misfit, after.normal.misfit)]


def excess_misfit(fit: FlightFit) -> float:
    """Computes a fit's misfit beyond 1.3 per reading, which rounding may explain; 0 if below."""
    return max(fit.normal.misfit - SCATTER * fit.normal.readings, 0.0)


def _try_gyro_signs(
    parts: Sequence[Stretch], fit: FlightFit, made: FlightModel, names: Names
) -> tuple[FlightFit, list[Diagnosis]]:
    """Refits with a gyro axis reversed; returns the first fit that explains readings, else the old one and []."""
    for package in range(made.gyros):
        for axis in range(3):
            signs = np.ones((made.variances.shape[0], 3))
            signs[package, axis] = -1.0
            turned = [part._replace(readings=part.readings * signs) for part in parts]
            after = regression.fit_flight(turned, made.prior, made)
            if after.normal.per_reading < _HOPELESS and excess_misfit(after) < (1.0 - EXPLAINED) * excess_misfit(fit):
                reason = f"axis {names.gyros[package]} {'xyz'[axis]} has the wrong sign"
                return after, [Diagnosis("gyro_sign", reason, fit.normal.per_reading, _HOPELESS)]
    return fit, []


def fit_cost(fit: FlightFit, made: FlightModel) -> float:
    """Computes a fit's objective: the readings' misfit plus squared sigmas of unknowns from their prior."""
    free = made.sigma > 0.0
    return fit.normal.misfit + float(np.sum(((fit.at - made.prior)[free] / made.sigma[free]) ** 2))


def _unknown_groups(made: FlightModel) -> dict[str, NDArray[np.int_]]:
    """Maps each assumption, such as "thrust" or "drag", to the indices of its unknowns in the flight model."""
    places = flight_model.columns(made)
    every = {
        "thrust": places.thrust,
        "torque": places.torque,
        "drag": places.drag,
        "momentum": places.momentum,
        "gyro_bias": places.gyro_bias,
        "acceleration_bias": places.acceleration_bias,
        "gyro_scale": places.gyro_gain,
        "accelerometer_scale": places.accelerometer_gain,
        "wheel": places.wheel,
        "engine": places.engine,
        "mounting": places.mount,
    }
    return {kind: np.arange(part.start, part.stop) for kind, part in every.items()}


def _test_group(
    kind: str,
    group: NDArray[np.int_],
    fit: FlightFit,
    made: FlightModel,
    clear: float = np.inf,
    common: Reckoned | None = None,
) -> _TestedGroup:
    """Tests by a score statistic, against chi-square, whether a group of unknowns is off its stated values."""
    stated = float(made.sigma[group].max())
    score = regression.score_test(fit, group, made, stated, clear, common)
    threshold = chi_square_limit(RATE, score.degrees) if score.degrees else np.inf
    alike = 1.0  # packages of a kind, side by side, may round alike: then they say no more than one
    if kind.startswith("gyro"):
        alike = float(made.gyros)
    elif kind.startswith("accel"):
        alike = float(made.positions.shape[0])
    left = fit.normal.misfit if stated > 0.0 else score.least
    scaled = score.statistic / max(1.0, left / max(fit.normal.readings, 1.0))  # where readings vary more than stated
    return _TestedGroup(kind, group, score, scaled / alike, threshold)


def _test_assumptions(fit: FlightFit, made: FlightModel) -> Iterator[_TestedGroup]:
    """Yields the score test of each assumption; thrust lags by kind of jet, then all together."""
    places, common = flight_model.columns(made), regression.estimated_unknowns(fit, made)
    for kind, group in _unknown_groups(made).items():
        if group.size and made.sigma[group].max() < _WIDE:
            yield _test_group(kind, group, fit, made, _CLEAR if kind == "thrust" else np.inf, common)
    lags = [
        place
        for place in range(places.lag.start, places.lag.stop)
        if made.sigma[place] < _WIDE and fit.normal.information[place, place] > 0.0
    ]
    for place in lags:
        yield _test_group("lag", np.array([place]), fit, made, common=common)
    if len(lags) > 1:
        yield _test_group("lag", np.array(lags), fit, made, common=common)


class _Cause(NamedTuple):
    """Possible cause of residuals, in words, and the unknowns of the model that it would change."""

    kind: str
    reason: str
    group: NDArray[np.int_]
    sigma: float


def _describe_cause(worst: _TestedGroup, fit: FlightFit, made: FlightModel, names: Names) -> _Cause:
    """Converts a failed score test to a cause in words, its unknowns and the 1-sigma to free them with."""
    kind, group, size = worst.kind, worst.group, worst.score.size
    if kind in ("thrust", "gyro_scale", "accelerometer_scale", "wheel", "engine"):
        return _find_single_cause(worst, fit, made, names)
    if kind == "lag":
        return _Cause(kind, "lag wrong", group, 1.0)  # by how much, the fit with it says
    largest = float(np.abs(size).max())
    words = {
        "torque": f"a torque that nobody commands: {largest:.3g} {names.torque}",
        "drag": "a torque that opposes or follows the rate, such as drag",
        "momentum": f"wheels that turn: an angular momentum of {largest:.3g} {names.torque}-s, untold",
        "mounting": "jets are mounted, or point, farther off than is stated",
        "gyro_bias": f"gyro bias of {largest:.3g} rad/s, beyond what is stated",
        "acceleration_bias": f"a steady force or an accelerometer bias of {largest:.3g} {names.acceleration}",
    }[kind]
    return _Cause(kind, words, group, 1.0 if kind in ("gyro_bias", "mounting") else 1e6)


def _find_single_cause(worst: _TestedGroup, fit: FlightFit, made: FlightModel, names: Names) -> _Cause:
    """Names the one jet, wheel, engine or axis that explains a failed score test, else all of its group."""
    kind, group, size = worst.kind, worst.group, worst.score.size
    common = regression.estimated_unknowns(fit, made)
    each = [_test_group(kind, np.array([place]), fit, made, common=common) for place in group.tolist()]
    best = max(range(len(each)), key=lambda index: each[index].score.statistic)
    gain, alone = float(each[best].score.size[0]), each[best].score.statistic >= _SHARE * worst.score.statistic
    turned = alone and _REVERSED[0] < gain < _REVERSED[1]
    if kind == "thrust":
        if not alone:
            spread = 100.0 * math.sqrt(float(np.sum(size**2)) / worst.score.degrees)
            stated = 100.0 * float(made.sigma[group].max())
            words = f"thrust mismatch: jets are off by {spread:.2g} %, {stated:.2g} % is stated"
            return _Cause(kind, words, group, 1.0)
        given = "nothing" if _DEAD[0] < gain < _DEAD[1] else f"{100.0 * (1.0 + gain):.3g} % of its thrust"
        words = "pushes the other way: its direction is reversed" if turned else f"gives {given} when told to fire"
        return _Cause("jet", f"jet {names.jets[best]} {words}", each[best].group, 3.0)
    if kind == "wheel":
        if not alone:
            return _Cause(kind, "inertias of wheels are off by more than is stated", group, 1.0)
        gain_of = f"its inertia is {1.0 + gain:.3g} times the stated one"
        words = "turns the other way: its axis, or its speed, is reversed" if turned else gain_of
        return _Cause(kind, f"wheel {names.wheels[best]}: {words}", each[best].group, 3.0)
    if kind == "engine":
        return _describe_engine_cause(gain, each[best], names, best, alone=alone)
    sensors = names.gyros if kind == "gyro_scale" else names.accelerometers
    axis = f"axis {sensors[best // 3]} {'xyz'[best % 3]}"
    if turned:
        return _Cause(kind.replace("scale", "sign"), f"{axis} has the wrong sign", each[best].group, 3.0)
    what = axis if alone else sensors[best // 3]
    return _Cause(kind, f"{what}: scale factor off by {100.0 * gain:.3g} %", group, 3.0)


def _describe_engine_cause(gain: float, suspect: _TestedGroup, names: Names, place: int, *, alone: bool) -> _Cause:
    """Returns the cause by an error of one engine's thrust, direction or place, or by several engines."""
    if not alone:
        return _Cause("engine", "engines are off by more than is stated", suspect.group, 1.0)
    engine, error = divmod(place, N_ERRORS)
    what = (
        f"its thrust is {1.0 + gain:.3g} times the stated one",
        f"its force points {gain:.2g} rad beside the stated direction",
        f"its force acts {gain:.2g} {names.length} beside the stated place",
    )[error // 2]
    return _Cause("engine", f"engine {names.engines[engine]}: {what}", suspect.group, 1.0)


def _find_scatter(parts: Sequence[Stretch], fit: FlightFit, made: FlightModel, names: Names) -> list[Diagnosis]:
    """Diagnoses packages with larger residuals than stated, as drift, clock jitter or noise; [] if none."""
    quick, quiet = fit.normal.quick, fit.normal.quiet
    sensors = (*names.gyros, *names.accelerometers)
    found: list[Diagnosis] = []
    for package, (misfit, count, serial) in enumerate(fit.normal.by_package.tolist()):
        gyro = package < len(names.gyros)
        if count < FEWEST / 4 or (found and not gyro):  # accelerometers turn with what gyros show
            continue
        ratio, allowed = misfit / count, SCATTER * (1.0 + _CONFIDENT * math.sqrt(2.0 / count))
        if ratio <= allowed:
            continue
        times = f"{math.sqrt(ratio):.3g} times what is stated"
        if serial > _SMOOTH * misfit:
            cause = _describe_torques(parts, made, names) if gyro else "unmodeled forces"
            found.append(Diagnosis("drift", f"{sensors[package]}: readings drift {times}: {cause}", ratio, allowed))
        elif gyro and quick[1] >= FEWEST / 4 and quick[0] / quick[1] > SCATTER * _misfit_per_reading(quiet) * 2.0:
            words = f"clock jitter: {sensors[package]} readings scatter {times} while the rate changes"
            found.append(Diagnosis("jitter", words, ratio, allowed))
        else:
            found.append(Diagnosis("noise", f"{sensors[package]}: readings scatter {times}", ratio, allowed))
    return found


def _describe_torques(parts: Sequence[Stretch], made: FlightModel, names: Names) -> str:
    """Describes unmodeled torques in words: as of wheels, if the equivalent force would act far outside."""
    momentum, impulse = unexplained_motion.unexplained_impulses(parts, made)
    torques, forces = made.wrenches[:, :3], made.wrenches[:, 3:]
    reach = float((np.linalg.norm(torques, axis=1) / np.linalg.norm(forces, axis=1)).max())
    if not made.positions.size or momentum < _OUTSIDE * reach * impulse:
        return "unmodeled torques"
    size = f"angular momentum of up to {momentum:.2g} {names.torque}-s"
    return f"unmodeled torques without a force, such as wheels whose speed changes: {size}"


def _misfit_per_reading(part: Array) -> float:
    """Computes misfit per reading from (misfit, count), at least 1; 1 where readings are too few."""
    return max(float(part[0] / part[1]), 1.0) if part[1] >= FEWEST / 4 else 1.0

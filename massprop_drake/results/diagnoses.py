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
from massprop_drake.maths.estimation.offline.normal_equations import stretch_equations, sum_equations
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
GAINED = 30.0  # log likelihood, twice, that another factor or sign must gain: 5 sigma, of some ten that are tried
_SMOOTH = 0.5  # serial correlation, from which on residuals drift rather than scatter
_SHARE = 0.9  # of what a group explains: one of it that explains as much is named alone
_REVERSED = (-2.6, -1.4)  # error of a gain that reverses a jet or wheel
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
    stretches: Sequence[Stretch], estimate: Array, model: FlightModel, names: Names
) -> tuple[list[Diagnosis], FlightFit]:
    """Finds model errors that explain the readings' misfit, clearest first; also returns the first fit.

    Args:
        stretches: of the record.
        estimate: the ten parameters to begin with, shape (10,).
        model: see `make_model`.
        names: of jets, kinds and sensors.
    """
    found: list[Diagnosis] = []
    fit = first = regression.fit_flight(stretches, fit_start(estimate, model), model)
    if fit.normal.is_finite and (wider := _widen_prior(fit.at[:10], model)) is not model:
        model = wider
        fit = first = regression.fit_flight(stretches, fit.at, model)
    if fit.normal.readings < FEWEST or not fit.normal.is_finite:
        return found, first
    fit, fit_model, found = try_switching(stretches, fit, model)
    while len(found) < _MOST:
        best = min(_find_explanations(stretches, fit, fit_model, names), key=lambda one: one.cost, default=None)
        if best is None:
            break
        found.append(best.diagnosis)
        stretches, fit, fit_model = best.parts, best.fit, best.made
    if not any(one.kind == "jet" for one in found):  # what a failed jet leaves is no fault of sensors
        found += find_oscillation(stretches, fit, fit_model, names) or _find_scatter(stretches, fit, fit_model, names)
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


def _find_explanations(
    stretches: Sequence[Stretch], fit: FlightFit, model: FlightModel, names: Names
) -> Iterator[_Explanation]:
    """Yields model errors, such as wrong thrust or a delay, with which a new fit removes most of the misfit."""
    if excess_misfit(fit) > 0.0:
        yield from _find_signs(stretches, model, names)
    suspects = [one for one in _test_assumptions(fit, model) if one.statistic > one.threshold]
    per_unknown = math.log(max(fit.normal.readings, 1.0))
    for one in sorted(suspects, key=lambda one: -one.statistic / one.threshold)[:_TRIED]:
        cause = _describe_cause(one, fit, model, names)
        wider = model._replace(sigma=model.sigma.copy())
        wider.sigma[cause.group] = cause.sigma
        after = regression.fit_flight(stretches, fit.at, wider)
        if _explains(after, fit):
            reason = _describe_lags(cause, after, model, names) if cause.kind == "lag" else cause.reason
            found = Diagnosis(cause.kind, reason, one.statistic, one.threshold)
            yield _Explanation(found, fit_cost(after, wider) + per_unknown * one.score.degrees, stretches, after, wider)
    for shift in (1, -1) if excess_misfit(fit) > 0.0 and not model.own_times else ():
        moved = [_shift_commands(part, shift) for part in stretches]
        after = regression.fit_flight(moved, model.prior, model)
        if not _explains(after, fit):
            continue
        same = regression.fit_flight([take_rows(part, _kept_rows(part, shift)) for part in stretches], fit.at, model)
        if excess_misfit(same) > 0.0 and _explains(
            after, same
        ):  # else the row that is left out is all that contradicts
            words = f"delay wrong: commands act {1e3 * model.period_s:.3g} ms {'later' if shift > 0 else 'earlier'}"
            reason = f"{words} than they are logged, one sample period"
            found = Diagnosis("delay", reason, fit.normal.per_reading, after.normal.per_reading)
            yield _Explanation(found, fit_cost(after, model) + per_unknown, moved, after, model)


def _find_signs(stretches: Sequence[Stretch], model: FlightModel, names: Names) -> Iterator[_Explanation]:
    """Yields each sensor axis whose readings are likelier with reversed sign, even if disturbances act too.

    Both signs are fitted from the prior, since a fit to wrong signs leads anywhere, and with the walks that cover what
    the turned axis leaves.
    """
    sensors = (*names.gyros, *names.accelerometers)
    for package, axis in find_negative_gains(stretches, model):
        signs = np.ones((model.variances.size, 3))
        signs[package, axis] = -1.0
        turned = [part._replace(readings=part.readings * signs) for part in stretches]
        after = turned_fit = regression.fit_flight(turned, model.prior, model)
        if not after.normal.is_finite:
            continue
        drifting = model
        if excess_misfit(after) > 0.0:
            walks = oscillation.covering_walk(turned, after, model, np.zeros_like(after.at))
            drifting = model._replace(walks=tuple(np.hypot(model.walks, walks).tolist()))
            turned_fit = regression.fit_flight(turned, model.prior, drifting)
        gained = fit_cost(regression.fit_flight(stretches, model.prior, drifting), drifting)
        gained -= fit_cost(turned_fit, drifting)
        if gained > GAINED:
            kind = "gyro_sign" if package < model.gyros else "accelerometer_sign"
            reason = f"axis {sensors[package]} {'xyz'[axis]} has the wrong sign"
            yield _Explanation(Diagnosis(kind, reason, gained, GAINED), fit_cost(after, model), turned, after, model)


def find_negative_gains(stretches: Sequence[Stretch], model: FlightModel) -> list[tuple[int, int]]:
    """Finds package and axis of readings whose gain is negative by its score about the prior, most so first."""
    places = flight_model.columns(model)
    equations = [stretch_equations(part, model.prior, model) for part in stretches]
    start = FlightFit(model.prior, sum_equations(equations, model), False)
    estimated = regression.estimated_unknowns(start, model)
    gains = [
        1.0 + float(regression.score_test(start, np.array([place]), model, estimated=estimated).size[0])
        for place in range(places.gyro_gain.start, places.accelerometer_gain.stop)
    ]
    return [divmod(place, 3) for place in np.argsort(gains).tolist() if gains[place] < 0.0][:_TRIED]


def _explains(fit: FlightFit, earlier_fit: FlightFit) -> bool:
    """Tests whether a fit removes nearly all of an earlier fit's misfit beyond rounding."""
    return fit.normal.is_finite and excess_misfit(fit) <= (1.0 - EXPLAINED) * excess_misfit(earlier_fit)


def _shift_commands(stretch: Stretch, shift: int) -> Stretch:
    """Returns a stretch whose commands act one row later (1) or earlier (-1) than logged, one row shorter."""
    cut, told = take_rows(stretch, _kept_rows(stretch, shift)), slice(0, -1) if shift > 0 else slice(1, None)
    opening = None if stretch.onsets_s is None else stretch.onsets_s[told]
    return prepend_rows(
        cut._replace(commands=stretch.commands[told], onsets_s=opening), stretch, slice(0 if shift > 0 else 1)
    )


def _kept_rows(stretch: Stretch, shift: int) -> slice:
    """Returns the slice of a stretch's rows that remain if commands shift one row later (1) or earlier (-1)."""
    return slice(1, stretch.time_s.size) if shift > 0 else slice(0, stretch.time_s.size - 1)


def _describe_lags(cause: _Cause, fit: FlightFit, model: FlightModel, names: Names) -> str:
    """Describes the thrust time constant or delay of each kind of jet in a cause, as fitted, ms."""
    places, words = flight_model.columns(model), []
    for place in cause.group.tolist():
        index, off = place - places.lag.start, 1e3 * float(fit.at[place])
        told = 1e3 * float(model.time_constants_s[model.kinds == index].max(initial=0.0))
        if told > 0.0:
            words.append(f"{names.kinds[index]} jets build up with {max(told + off, 0.0):.3g} ms, told {told:.3g} ms")
        elif off != 0.0:
            when = "late" if off > 0.0 else "early"
            words.append(f"{names.kinds[index]} jets act {abs(off):.3g} ms {when}, told none")
    return f"lag wrong: {'; '.join(words)}"


def find_oscillation(stretches: Sequence[Stretch], fit: FlightFit, model: FlightModel, names: Names) -> list[Diagnosis]:
    """Diagnoses an oscillation, such as slosh or a panel, or random drift that readings show; [] if none.

    Where walks or a disturbance are stated, anything beyond them is diagnosed.
    """
    stated = flight_model.has_accumulating_noise(model)
    if not flight_model.is_physical(fit.at):
        return []
    if oscillation.is_covered(stretches, fit, model) if stated else excess_misfit(fit) == 0.0:
        return []
    misfit, readings = (
        oscillation.misfit_of(stretches, fit, model) if stated else (fit.normal.misfit, fit.normal.readings)
    )
    mode = oscillation.strongest_mode(stretches, fit, model)
    left = (1.0 - EXPLAINED) * max(misfit - SCATTER * readings, 0.0)
    if mode is None or mode.misfit - SCATTER * mode.readings > left:
        if not stated:
            return []
        rate, velocity = oscillation.covering_walk(stretches, fit, model, np.zeros_like(fit.at))
        words = f"readings wander more than is stated; {_walks_in_words(rate, velocity)}"
        return [Diagnosis("drift", words, misfit / max(readings, 1.0), 1.0)]
    rate, velocity = oscillation.covering_walk(stretches, fit, model, mode.change)
    walks = _walks_in_words(rate, velocity)
    words = f"something inside moves at {mode.frequency_hz:.2g} Hz, such as slosh or a panel; {walks}"
    return [Diagnosis("oscillation", words, fit.normal.per_reading, mode.misfit / mode.readings)]


def _walks_in_words(rate_walk: float, velocity_walk: float) -> str:
    """Formats the `joint.rate_walk` and `joint.velocity_walk` that would cover the residuals' drift."""
    return f"joint.rate_walk={rate_walk:.2g} and joint.velocity_walk={velocity_walk:.2g} would cover it"


def fit_start(estimate: Array, model: FlightModel) -> Array:
    """Returns the start of a fit: the prior, with the ten parameters of the estimate if physically possible."""
    start = model.prior.copy()
    if flight_model.is_physical(estimate):  # NaN is not
        start[:10] = estimate
    return start


def _widen_prior(fitted: Array, model: FlightModel) -> FlightModel:
    """Returns the model with wider prior 1-sigma for parameters that a fit puts over 3 sigma from the prior."""
    change = np.abs(fitted - model.prior[:10])
    far = change > _OFF * model.sigma[:10]
    if not far.any():
        return model
    sigma = model.sigma.copy()
    sigma[:10] = np.where(far, change, sigma[:10])
    return model._replace(sigma=sigma)


def try_switching(
    stretches: Sequence[Stretch], fit: FlightFit, model: FlightModel
) -> tuple[FlightFit, FlightModel, list[Diagnosis]]:
    """Refits with jets switching at time stamps instead of regular times, or the reverse, if the stamps are irregular.

    Returns:
        The fit, its model, and the diagnoses, at most one.
    """
    if model.at_stamps is None or excess_misfit(fit) == 0.0 or not is_off_ticks(stretches, model):
        return fit, model, []
    switched = model._replace(at_stamps=not model.at_stamps)
    new_fit = regression.fit_flight(stretches, fit.at if flight_model.is_physical(fit.at) else model.prior, switched)
    if not _explains(new_fit, fit):
        return fit, model, []
    moments = "the stamps of their rows" if switched.at_stamps else "regular ticks"
    words = f"clock jitter: commands switch at {moments}: joint.switching={'stamps' if switched.at_stamps else 'ticks'}"
    return new_fit, switched, [Diagnosis("jitter", words, fit.normal.misfit, new_fit.normal.misfit)]


def excess_misfit(fit: FlightFit) -> float:
    """Computes a fit's misfit beyond 1.3 per reading, which rounding may explain; 0 if below."""
    return max(fit.normal.misfit - SCATTER * fit.normal.readings, 0.0)


def fit_cost(fit: FlightFit, model: FlightModel) -> float:
    """Computes a fit's objective: the readings' misfit plus squared sigmas of unknowns from their prior."""
    free = model.sigma > 0.0
    return fit.normal.misfit + float(np.sum(((fit.at - model.prior)[free] / model.sigma[free]) ** 2))


def _unknown_groups(model: FlightModel) -> dict[str, NDArray[np.int_]]:
    """Maps each assumption, such as "thrust" or "drag", to the indices of its unknowns in the flight model."""
    slices = flight_model.columns(model)
    groups = {
        "thrust": slices.thrust,
        "torque": slices.torque,
        "drag": slices.drag,
        "momentum": slices.momentum,
        "gyro_bias": slices.gyro_bias,
        "acceleration_bias": slices.acceleration_bias,
        "gyro_scale": slices.gyro_gain,
        "accelerometer_scale": slices.accelerometer_gain,
        "wheel": slices.wheel,
        "engine": slices.engine,
        "mounting": slices.mount,
    }
    return {kind: np.arange(part.start, part.stop) for kind, part in groups.items()}


def _test_group(
    kind: str,
    indices: NDArray[np.int_],
    fit: FlightFit,
    model: FlightModel,
    largest_sigma: float = np.inf,
    estimated: Reckoned | None = None,
) -> _TestedGroup:
    """Computes score statistic and chi-square limit to test whether unknowns at some indices have stated values."""
    stated = float(model.sigma[indices].max())
    score = regression.score_test(fit, indices, model, stated, largest_sigma, estimated)
    threshold = chi_square_limit(RATE, score.degrees) if score.degrees else np.inf
    alike = 1.0  # packages of a kind, side by side, may round alike: then they say no more than one
    if kind.startswith("gyro"):
        alike = float(model.gyros)
    elif kind.startswith("accel"):
        alike = float(model.positions.shape[0])
    left = fit.normal.misfit if stated > 0.0 else score.least
    scaled = score.statistic / max(1.0, left / max(fit.normal.readings, 1.0))  # where readings vary more than stated
    return _TestedGroup(kind, indices, score, scaled / alike, threshold)


def _test_assumptions(fit: FlightFit, model: FlightModel) -> Iterator[_TestedGroup]:
    """Yields the score test of each assumption; thrust lags by kind of jet, then all together."""
    slices, estimated = flight_model.columns(model), regression.estimated_unknowns(fit, model)
    for kind, indices in _unknown_groups(model).items():
        if indices.size and model.sigma[indices].max() < _WIDE:
            yield _test_group(kind, indices, fit, model, _CLEAR if kind == "thrust" else np.inf, estimated)
    lags = [
        index
        for index in range(slices.lag.start, slices.lag.stop)
        if model.sigma[index] < _WIDE and fit.normal.information[index, index] > 0.0
    ]
    for index in lags:
        yield _test_group("lag", np.array([index]), fit, model, estimated=estimated)
    if len(lags) > 1:
        yield _test_group("lag", np.array(lags), fit, model, estimated=estimated)


class _Cause(NamedTuple):
    """Possible cause of residuals, in words, and the unknowns of the model that it would change."""

    kind: str
    reason: str
    group: NDArray[np.int_]
    sigma: float


def _describe_cause(test: _TestedGroup, fit: FlightFit, model: FlightModel, names: Names) -> _Cause:
    """Converts a failed score test to a cause in words, with its unknowns and the 1-sigma to free them with."""
    kind, indices, size = test.kind, test.group, test.score.size
    if kind in ("thrust", "gyro_scale", "accelerometer_scale", "wheel", "engine"):
        return _find_single_cause(test, fit, model, names)
    if kind == "lag":
        return _Cause(kind, "lag wrong", indices, 1.0)  # by how much, the fit with it says
    largest = float(np.abs(size).max())
    words = {
        "torque": f"a torque that nobody commands: {largest:.3g} {names.torque}",
        "drag": "a torque that opposes or follows the rate, such as drag",
        "momentum": f"wheels that turn: an angular momentum of {largest:.3g} {names.torque}-s, untold",
        "mounting": "jets are mounted, or point, farther off than is stated",
        "gyro_bias": f"gyro bias of {largest:.3g} rad/s, beyond what is stated",
        "acceleration_bias": f"a steady force or an accelerometer bias of {largest:.3g} {names.acceleration}",
    }[kind]
    return _Cause(kind, words, indices, 1.0 if kind in ("gyro_bias", "mounting") else 1e6)


def _find_single_cause(test: _TestedGroup, fit: FlightFit, model: FlightModel, names: Names) -> _Cause:
    """Names the one jet, wheel, engine or axis that explains a failed score test, else all of its group."""
    kind, indices, size = test.kind, test.group, test.score.size
    estimated = regression.estimated_unknowns(fit, model)
    tests = [_test_group(kind, np.array([place]), fit, model, estimated=estimated) for place in indices.tolist()]
    best = max(range(len(tests)), key=lambda index: tests[index].score.statistic)
    gain, alone = float(tests[best].score.size[0]), tests[best].score.statistic >= _SHARE * test.score.statistic
    turned = alone and _REVERSED[0] < gain < _REVERSED[1]
    if kind == "thrust":
        if not alone:
            spread = 100.0 * math.sqrt(float(np.sum(size**2)) / test.score.degrees)
            stated = 100.0 * float(model.sigma[indices].max())
            words = f"thrust mismatch: jets are off by {spread:.2g} %, {stated:.2g} % is stated"
            return _Cause(kind, words, indices, 1.0)
        given = "nothing" if _DEAD[0] < gain < _DEAD[1] else f"{100.0 * (1.0 + gain):.3g} % of its thrust"
        words = "pushes the other way: its direction is reversed" if turned else f"gives {given} when told to fire"
        return _Cause("jet", f"jet {names.jets[best]} {words}", tests[best].group, 3.0)
    if kind == "wheel":
        if not alone:
            return _Cause(kind, "inertias of wheels are off by more than is stated", indices, 1.0)
        gain_of = f"its inertia is {1.0 + gain:.3g} times the stated one"
        words = "turns the other way: its axis, or its speed, is reversed" if turned else gain_of
        return _Cause(kind, f"wheel {names.wheels[best]}: {words}", tests[best].group, 3.0)
    if kind == "engine":
        return _describe_engine_cause(gain, tests[best], names, best, alone=alone)
    sensors = names.gyros if kind == "gyro_scale" else names.accelerometers
    axis = f"axis {sensors[best // 3]} {'xyz'[best % 3]}"
    what = axis if alone else sensors[best // 3]
    return _Cause(kind, f"{what}: scale factor off by {100.0 * gain:.3g} %", indices, 3.0)


def _describe_engine_cause(gain: float, test: _TestedGroup, names: Names, error_index: int, *, alone: bool) -> _Cause:
    """Describes an error of one engine's thrust, direction or place as a cause, or of several engines (not alone)."""
    if not alone:
        return _Cause("engine", "engines are off by more than is stated", test.group, 1.0)
    engine, error = divmod(error_index, N_ERRORS)
    what = (
        f"its thrust is {1.0 + gain:.3g} times the stated one",
        f"its force points {gain:.2g} rad beside the stated direction",
        f"its force acts {gain:.2g} {names.length} beside the stated place",
    )[error // 2]
    return _Cause("engine", f"engine {names.engines[engine]}: {what}", test.group, 1.0)


def _find_scatter(stretches: Sequence[Stretch], fit: FlightFit, model: FlightModel, names: Names) -> list[Diagnosis]:
    """Diagnoses packages with larger residuals than stated, as drift, clock jitter or noise; [] if none."""
    quick, quiet = fit.normal.quick, fit.normal.quiet
    sensors = (*names.gyros, *names.accelerometers)
    diagnoses: list[Diagnosis] = []
    for package, (misfit, count, serial) in enumerate(fit.normal.by_package.tolist()):
        gyro = package < len(names.gyros)
        if count < FEWEST / 4 or (diagnoses and not gyro):  # accelerometers turn with what gyros show
            continue
        ratio, allowed = misfit / count, SCATTER * (1.0 + _CONFIDENT * math.sqrt(2.0 / count))
        if ratio <= allowed:
            continue
        times = f"{math.sqrt(ratio):.3g} times what is stated"
        if serial > _SMOOTH * misfit:
            cause = _describe_torques(stretches, model, names) if gyro else "unmodeled forces"
            diagnoses.append(Diagnosis("drift", f"{sensors[package]}: readings drift {times}: {cause}", ratio, allowed))
        elif gyro and quick[1] >= FEWEST / 4 and quick[0] / quick[1] > SCATTER * _misfit_per_reading(quiet) * 2.0:
            words = f"clock jitter: {sensors[package]} readings scatter {times} while the rate changes"
            diagnoses.append(Diagnosis("jitter", words, ratio, allowed))
        else:
            diagnoses.append(Diagnosis("noise", f"{sensors[package]}: readings scatter {times}", ratio, allowed))
    return diagnoses


def _describe_torques(stretches: Sequence[Stretch], model: FlightModel, names: Names) -> str:
    """Describes unmodeled torques in words: as of wheels, if the equivalent force would act far outside."""
    momentum, impulse = unexplained_motion.unexplained_impulses(stretches, model)
    torques, forces = model.wrenches[:, :3], model.wrenches[:, 3:]
    reach = float((np.linalg.norm(torques, axis=1) / np.linalg.norm(forces, axis=1)).max())
    if not model.positions.size or momentum < _OUTSIDE * reach * impulse:
        return "unmodeled torques"
    size = f"angular momentum of up to {momentum:.2g} {names.torque}-s"
    return f"unmodeled torques without a force, such as wheels whose speed changes: {size}"


def _misfit_per_reading(misfit_and_count: Array) -> float:
    """Computes misfit per reading from (misfit, count), at least 1; 1 where readings are too few."""
    return max(float(misfit_and_count[0] / misfit_and_count[1]), 1.0) if misfit_and_count[1] >= FEWEST / 4 else 1.0

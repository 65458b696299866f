"""Batch analysis of a run: how well it could have shown each parameter, and what its readings contradict."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.inputs import factors, params
from massprop_drake.inputs.factors import Factor
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.maths.estimation import hindsight, oscillation
from massprop_drake.maths.estimation.filter import Instruments, Setup
from massprop_drake.maths.estimation.filters.joint import chi_square_limit
from massprop_drake.maths.estimation.hindsight import FlightFit, FlightModel, Reckoned, ScoreTest, Stretch
from massprop_drake.maths.estimation.joint.burns import Burn, EngineSettings, at_rest, burnt, push
from massprop_drake.maths.estimation.joint.disturbance_states import NO_DISTURBANCE
from massprop_drake.maths.estimation.joint.process_noise import propellant_drift
from massprop_drake.maths.mass_properties import MassProperties
from massprop_drake.maths.vehicle.engine_thrust import N_CHANNELS, N_ERRORS, channels
from massprop_drake.maths.vehicle.mounting import EXACT
from massprop_drake.maths.vehicle.on_times import levels_alone
from massprop_drake.results import prior
from massprop_drake.results.consistency import Diagnosis
from massprop_drake.results.detections import JUMP, DetectionRecord
from massprop_drake.results.events import EventRecord, acting
from massprop_drake.results.spool import Spool

Array = NDArray[np.float64]

_ROWS = 1024  # of a stretch
_ADDED = 0.3  # of a reading's noise: what coupling may add to it over a stretch
_BEFORE = ("before", "before_onsets_s")  # of a stretch, what is of rows before it
_SHORTEST = 16  # rows of a stretch
_STRETCHES = 32  # of so many rows, at the most, evenly spread
_LINGERS = 1e-4  # of full thrust: less is not felt
_HOLE = 2  # rows without a gyro's axis over which the rate is taken to be what jets make of it
_DRIFTED = 0.01  # of the mass, used: inertia and center of mass then have a walk's 1-sigma, of one that is stated by it
_GATHERS_S = 60.0  # seconds: noise that gathers to less than a reading's 1-sigma by then is left out
_LIES_ON_S = 2.0  # after a reading was said to be false it is not believed again
_OF_DISTURBANCES = ("oscillation", "drift", "torque", "drag", "momentum")  # diagnoses of what acts besides the jets
_PRIOR = 0.3  # of the widest start: nothing known of a vehicle is more wrong
_OFF = 3.0  # 1-sigma from the widest start, beyond which the vehicle's file is not held against the readings
_OPEN_LAG_S = 0.05  # 1-sigma of a lag that the filters do not reckon with

# The C library keeps what is freed up to twice the largest block that it has been given back: without this the system
# would be given the memory of each look back, and would clear it anew for the next, which takes a fifth of its time.
np.empty(1 << 21)


class Names(NamedTuple):
    """Names of jets, sensors and units in words."""

    jets: Sequence[str]
    kinds: Sequence[str]
    gyros: Sequence[str]
    accelerometers: Sequence[str]
    torque: str
    acceleration: str
    wheels: Sequence[str] = ()
    engines: Sequence[str] = ()
    length: str = ""


def names_of(scenario: Scenario) -> Names:
    """Returns the names of a scenario's vehicle."""
    vehicle = scenario.vehicle_data
    units = vehicle.unit_names
    return Names(
        vehicle.designations,
        list(vehicle.jet_kinds),
        [package.name for package in params.gyros(scenario)],
        [package.name for package in params.accelerometers(scenario)],
        f"{units['length']}-{units['force']}",
        f"{units['length']}/s^2",
        [wheel.name for wheel in vehicle.wheels],
        [engine.name for engine in vehicle.engines],
        units["length"],
    )


def model(scenario: Scenario) -> FlightModel:
    """Makes the model of the vehicle that a scenario's filter has."""
    setup, vehicle = params.setup(scenario), scenario.vehicle_data
    thrust, gyros, accelerometers = setup.thrust, setup.gyros, setup.accelerometers
    joint = scenario.estimation.filter == "joint"
    n_jets, n_kinds, n_accelerometers = len(vehicle.jets), thrust.lag_uncertainty.shape[0], accelerometers.quanta.size
    mounting = thrust.mounting if joint else EXACT
    of_others = setup.engine_sigmas.size, mounting.jets.size, setup.modes.sigmas.size, 2 * len(vehicle.tanks), 9
    n_others = 12 + 3 * gyros.quanta.size + 6 * n_accelerometers + len(vehicle.wheels) + sum(of_others)
    of_kinds = np.array([thrust.time_constants_s[thrust.kinds == kind].max(initial=0.0) for kind in range(n_kinds)])
    if joint:
        block = scenario.joint
        of_thrust = thrust.uncertainty if block.thrust_uncertainty is None else block.thrust_uncertainty
        of_lag = of_kinds * (thrust.lag_uncertainty if block.lag_uncertainty is None else block.lag_uncertainty)
    else:
        of_thrust = scenario.estimation.thrust_uncertainty
        gated = scenario.estimation.thrust_transient == "gate"
        of_lag = np.full(n_kinds, _OPEN_LAG_S) if gated else of_kinds * thrust.lag_uncertainty
    prior = np.concatenate((setup.nominal, np.zeros(n_jets + n_kinds + n_others)))
    sigma = np.zeros_like(prior)
    misread = setup.wheels.inertias * setup.wheels.speed_std  # moves the rate that is compared with a gyro's
    turned = (misread * (np.linalg.inv(vehicle.nominal.inertia) @ setup.wheels.axes.T)) ** 2
    of_wheels = float(turned.sum(axis=1).max())
    variances = np.concatenate((setup.gyro_variances + of_wheels, setup.accelerometer_variances))
    made = FlightModel(
        period_s=setup.period_s,
        wrenches=thrust.wrenches,
        flows=thrust.flows,
        time_constants_s=thrust.time_constants_s,
        kinds=thrust.kinds,
        positions=setup.accelerometer_positions,
        variances=variances,
        quanta=np.concatenate((_steps(gyros), _steps(accelerometers))),
        gyros=gyros.quanta.size,
        prior=prior,
        sigma=sigma,
        compute=hindsight.compute(compiled=scenario.execution.compiled),
        at_stamps=(scenario.joint.switching == "stamps" or params.steps_by_readings(scenario)) if joint else None,
        walks=_walks(scenario, setup) if joint else (0.0, 0.0),
        disturbance=setup.disturbance if joint else NO_DISTURBANCE,
        wheels=setup.wheels,
        engines=setup.engines,
        own_times=params.steps_by_readings(scenario),
        tanks=setup.tanks,
        mounting=mounting,
        modes=setup.modes,
    )
    places = hindsight.columns(made)
    sigma[places.properties] = _PRIOR * setup.widest
    sigma[places.thrust] = of_thrust
    sigma[places.lag] = of_lag
    sigma[places.gyro_bias] = gyros.bias_std.max(initial=0.0)
    sigma[places.acceleration_bias] = np.repeat(accelerometers.bias_std, 3)
    sigma[places.wheel] = setup.wheel_uncertainty
    sigma[places.engine] = setup.engine_sigmas
    sigma[places.mount] = 1.0
    sigma[places.moving] = (setup.modes.sigmas > 0.0).astype(np.float64).ravel()
    sigma[places.fill], sigma[places.flow] = setup.tanks.fill_sigma, setup.tanks.flow_sigma
    fed = setup.tanks.feeds.sum(axis=0)  # of each jet 1 or 0
    if (thrust.flows * (1.0 - fed)).any():  # one way, by as much as what drifts has become once so much has been used
        share = setup.nominal[9] / _DRIFTED
        sigma[places.shift] = np.sqrt(_drift(scenario, setup.nominal)[:9] * share)
    return made


def _walks(scenario: Scenario, setup: Setup) -> tuple[float, float]:
    """Computes walks of rate and velocity: those stated, and those by reading errors of engines at full thrust.

    By so much a flight with engines may drift all through, though it does so as long as they burn alone.
    """
    at = np.zeros((setup.engines.thrusts.size, 3, N_CHANNELS))
    at[:, :, 0] = 1.0
    full = push(Burn(at, setup.engines.read_std), np.zeros(setup.engine_sigmas.size), setup.period_s, setup.engines)
    gathered = _by_noise(full.noise, scenario.vehicle_data.nominal) / math.sqrt(setup.period_s)
    least = (setup.gyro_variances, setup.accelerometer_variances)
    for place, variances in enumerate(least):
        if gathered[place] * math.sqrt(_GATHERS_S) < math.sqrt(variances.min(initial=math.inf)):
            gathered[place] = 0.0
    rate, velocity = np.hypot((scenario.joint.rate_walk, scenario.joint.velocity_walk), gathered).tolist()
    return rate, velocity


def _by_noise(noise: Array, body: MassProperties) -> Array:
    """Computes 1-sigma of a body's rate and velocity by independent impulses, shape (2,).

    Args:
        noise: impulses about the vehicle origin, angular and linear, 1-sigma, shape (k, 6).
        body: its mass properties.
    """
    moments = noise[:, :3] + np.cross(noise[:, 3:], body.center_of_mass)
    rates = np.linalg.solve(np.asarray(body.inertia), moments.T).T
    return np.array([math.sqrt((each**2).sum(axis=0).max()) for each in (rates, noise[:, 3:] / body.mass)])


def steady(made: FlightModel) -> FlightModel:
    """Returns the model without shifts of inertia and center of mass in one direction by used propellant."""
    sigma = made.sigma.copy()
    sigma[hindsight.columns(made).shift] = 0.0
    return made._replace(sigma=sigma)


def _steps(packages: Instruments) -> Array:
    """Returns quanta, zero where noise dithers a reading."""
    return np.where(packages.noise_std >= 0.25 * packages.quanta, 0.0, packages.quanta)


def stretches(scenario: Scenario, signals: Spool) -> Iterator[Stretch]:
    """Returns the parts of a run's record for regression, in order; propellant is counted from the beginning.

    Args:
        scenario: as run.
        signals: with `time_s`, commands and readings.
    """
    packages = (*params.gyros(scenario), *params.accelerometers(scenario))
    optional = ("gap", "outside_wrench", "command_onset")
    wanted = ["time_s", "command", *(name for name in optional if name in signals)]
    flows, lengths_s = scenario.vehicle_data.mass_flows, _lengths(scenario)
    felt = _felt(scenario)
    before, used, since = np.zeros((felt, flows.size)), 0.0, -1 if "gap" in signals else -1 - felt
    fired_s, has_tanks = np.zeros(flows.size), bool(scenario.vehicle_data.tanks)
    opened = levels_alone((felt, flows.size))  # onsets of these
    wheels = [wheel.name for wheel in scenario.vehicle_data.wheels]
    engines = [engine.name for engine in scenario.vehicle_data.engines if engine.name in signals]
    setting: EngineSettings | None = None
    for block in _windows(signals, *wanted, *(package.name for package in packages), *wheels, *engines):
        time_s, commands = block["time_s"], block["command"]
        known = np.nan_to_num(commands)
        burns = _burns(scenario, block, setting)
        setting = burns.setting
        spent = used + np.concatenate(([0.0], np.cumsum(known[:-1] @ flows * lengths_s(time_s) + burns.used)))
        used = float(spent[-1])
        readings = np.stack([block[package.name] for package in packages], axis=1)
        for number, package in enumerate(packages):
            saturated = ~(np.abs(readings[:, number]) < package.limit).all(axis=1)
            readings[saturated, number] = np.nan
        outside = block["outside_wrench"] if "outside_wrench" in block else np.zeros((time_s.size, 6))
        onsets_s = block.get("command_onset")
        opening: tuple[Array | None, Array | None] = (None, None) if onsets_s is None else (onsets_s, opened)
        speeds = np.hstack([block[name] for name in wheels]) if wheels else None
        if speeds is not None:  # without them a gyro does not show what has acted on the vehicle
            readings[np.isnan(speeds).any(axis=1), : len(params.gyros(scenario))] = np.nan
        whole = Stretch(time_s, readings, known, before, outside, -spent, *opening, speeds, burns.points)
        if has_tanks:
            lasted_s = np.reshape(lengths_s(time_s), (-1, 1))
            gone_s = fired_s + np.vstack((np.zeros(flows.size), np.cumsum(known[:-1] * lasted_s, axis=0)))
            whole, fired_s = whole._replace(seconds=np.stack((gone_s, -gone_s), axis=1)), gone_s[-1]
        unknown = np.asarray(np.isnan(commands[:-1]).any(axis=1)) | burns.loose
        if "gap" in block:
            gap = block["gap"][:, 0] != 0.0
            unknown |= gap[:-1] | gap[1:]
        counts = np.arange(unknown.size)
        last_unknown = np.maximum.accumulate(np.where(unknown, counts, since))
        since = int(last_unknown[-1]) - unknown.size
        for first, last in _runs(counts - last_unknown > felt):
            if last - first > 1:
                yield _rows_of(whole, slice(first, last + 1))
        before = _with_rows(before, known[:-1])
        opened = opened if onsets_s is None else _with_rows(opened, onsets_s[:-1])


class _Burns(NamedTuple):
    """Engines in rows of a record, of which the first was the last of those before."""

    points: Array | None  # see `Stretch.burns`; None: there are no engines
    used: Array  # propellant of each interval, (m - 1,)
    loose: NDArray[np.bool_]  # intervals whose impulse is known less well than a reading shows it, (m - 1,)
    setting: EngineSettings | None  # after the last row


def _burns(scenario: Scenario, block: dict[str, Array], before: EngineSettings | None) -> _Burns:
    """Computes the state of the engines in some rows.

    Args:
        scenario: as run.
        block: the rows.
        before: setting of the engines at the first row; None: it is that of the record.
    """
    vehicle, rows = scenario.vehicle_data, block["time_s"].size
    used, loose = np.zeros(rows - 1), np.zeros(rows - 1, dtype=np.bool_)
    if not any(engine.name in block for engine in vehicle.engines):
        return _Burns(None, used, loose, before)
    setup = params.setup(scenario)
    made, has, period_s = setup.engines, channels(setup.engines), setup.period_s
    least = np.sqrt([each.min(initial=np.inf) for each in (setup.gyro_variances, setup.accelerometer_variances)])
    read, nothing = np.zeros((rows, *has.shape)), np.zeros(setup.engine_sigmas.size)
    each = (block.get(one.name, np.full((rows, len(one.columns)), np.nan)) for one in vehicle.engines)
    read[:, has] = np.hstack(list(each))
    points = np.zeros((rows, len(has), 3, N_CHANNELS))
    if before is None:
        _, before = burnt(at_rest(len(has)), read[0], period_s, made)
    lengths_s = np.broadcast_to(_lengths(scenario)(block["time_s"]), rows - 1)
    for row in range(1, rows):
        length_s = float(lengths_s[row - 1])
        burn, before = burnt(before, read[row], length_s, made)
        if burn.points.any():
            given = push(burn, nothing, length_s, made)
            points[row - 1], used[row - 1] = burn.points, given.used
            loose[row - 1] = (_by_noise(given.noise, vehicle.nominal) > least).any()
    return _Burns(points, used, loose, before)


def _felt(scenario: Scenario) -> int:
    """Returns for how many intervals unknown impulses act on: after a gap, and before a record."""
    vehicle = scenario.vehicle_data
    longest = float(vehicle.time_constants_s.max(initial=0.0)) / vehicle.sample_period_s
    return max(1, math.ceil(longest * params.rates(scenario).steps * math.log(1.0 / _LINGERS)))


def _lengths(scenario: Scenario) -> Callable[[Array], Array | float]:
    """Returns lengths of the intervals between rows, s: the sample period, or by their times."""
    if params.steps_by_readings(scenario):
        return np.diff
    return lambda _: scenario.vehicle_data.sample_period_s


def _runs(there: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Returns where runs begin, and one past their ends."""
    edges = np.flatnonzero(np.diff(there, prepend=False, append=False))
    return [(int(first), int(last)) for first, last in edges.reshape(-1, 2)]


def _windows(signals: Spool, *names: str) -> Iterator[dict[str, Array]]:
    """Yields the signals by so many intervals, independent of the spool's pieces: a last row is the next's first."""
    waiting = {name: np.empty((0,)) for name in names}
    for block in signals.blocks(*names):
        for name, rows in block.items():
            waiting[name] = np.concatenate((waiting[name], rows)) if waiting[name].size else rows
        while waiting["time_s"].shape[0] > _ROWS:
            yield {name: rows[: _ROWS + 1] for name, rows in waiting.items()}
            waiting = {name: rows[_ROWS:] for name, rows in waiting.items()}
    if waiting["time_s"].shape[0] > 1:
        yield waiting


def _whole(scenario: Scenario, signals: Spool) -> list[Stretch]:
    """Returns all stretches, with the propellant counted to the end of the last."""
    parts = list(stretches(scenario, signals))
    used = max((-float(part.used_after[-1]) for part in parts), default=0.0)
    return _ended(parts, used)


def _ended(parts: Sequence[Stretch], used: float) -> list[Stretch]:
    """Returns stretches with all used propellant counted to another end.

    Args:
        parts: in order.
        used: propellant from the end up to which it was counted to that one, slug or kg; negative: it is earlier.
    """
    found = [part._replace(used_after=part.used_after + used) for part in parts]
    if not parts or parts[-1].seconds is None:
        return found
    later = np.stack((np.zeros_like(parts[-1].seconds[-1, 1]), parts[-1].seconds[-1, 1]))
    return [one._replace(seconds=one.seconds - later) for one in found if one.seconds is not None]


def _without_lies(parts: Sequence[Stretch], events: Sequence[EventRecord], names: Names) -> list[Stretch]:
    """Removes readings that were declared false, from their onset on until a while after the declaration."""
    sensors = [*names.gyros, *names.accelerometers]
    false = [each for each in events if each.kind == "false_reading"]
    lies, found = [each for each in false if each.sensor in sensors], list(parts)
    ends = [each.onset_s for each in false if each.sensor in names.wheels]
    unheard_s = min([*ends, *(each.onset_s for each in events if each.kind == "engine_failed")], default=math.inf)
    if unheard_s < math.inf:  # then gyros do not show what has acted on the vehicle, and it may be so from there on
        found = [cut for part in parts if (cut := _until(part, unheard_s)).time_s.size > 2]
    for number, part in enumerate(found if lies else ()):
        readings = part.readings.copy()
        for lie in lies:
            rows = (part.time_s > lie.onset_s) & (part.time_s <= lie.time_s + _LIES_ON_S)
            readings[rows, sensors.index(str(lie.sensor)), "xyz".index(str(lie.axis))] = np.nan
        found[number] = part._replace(readings=readings)
    return found


def _some(parts: Sequence[Stretch], until_s: float, made: FlightModel) -> list[Stretch]:
    """Selects pieces of stretches up to a time that are short enough to be regressed, evenly spread if many."""
    seen = (piece for part in parts for piece in _seen(_until(part, until_s), made))
    every = [piece for part in seen for piece in _slow_enough(part, made)]
    rows = sum(piece.time_s.size for piece in every)
    return every[:: max(-(-rows // (_STRETCHES * (_ROWS + 1))), 1)]


def pieces(scenario: Scenario, signals: Spool, until_s: float, made: FlightModel) -> list[Stretch]:
    """Returns the parts of a record up to a time for regression.

    Args:
        scenario: as run.
        signals: with `time_s`, commands and readings.
        until_s: up to when, s; infinity: all of it.
        made: see `model`.
    """
    return _some(_whole(scenario, signals), until_s, made)


def believed(
    scenario: Scenario, signals: Spool, until_s: float, events: Iterable[EventRecord], made: FlightModel
) -> tuple[list[Stretch], bool]:
    """Returns stretches of a record up to a time, without readings declared false; 1/m is that of then.

    Args:
        scenario: as run.
        signals: with `time_s`, commands and readings.
        until_s: up to when, s; infinity: all of it.
        events: what was said of the run.
        made: see `model`.

    Returns:
        Stretches, and whether their stamps lie on the ticks at which commands switch.
    """
    parts = _without_lies(_whole(scenario, signals), list(events), names_of(scenario))
    found = [cut for part in parts if (cut := _until(part, until_s)).time_s.size > 2]
    found = _ended(found, -found[-1].used_after[-1] if found else 0.0)
    return found, bool(made.at_stamps) or not _off_ticks(found, made)


def _until(part: Stretch, time_s: float) -> Stretch:
    return _rows_of(part, slice(0, int(np.searchsorted(part.time_s, time_s))))


def _rows_of(part: Stretch, rows: slice) -> Stretch:
    own = {name: value for name, value in part._asdict().items() if name not in _BEFORE and value is not None}
    return _preceded(part._replace(**{name: value[rows] for name, value in own.items()}), part, slice(rows.start))


def _preceded(cut: Stretch, part: Stretch, rows: slice) -> Stretch:
    """Returns a cut stretch with further rows of its original before it."""
    cut = cut._replace(before=_with_rows(part.before, part.commands[rows]))
    if part.onsets_s is None or part.before_onsets_s is None:
        return cut
    return cut._replace(before_onsets_s=_with_rows(part.before_onsets_s, part.onsets_s[rows]))


def _with_rows(before: Array, later: Array) -> Array:
    """Appends rows to the commands before a stretch; the oldest go, and as many stay."""
    rows = before.shape[0]
    return np.concatenate((before, later[-rows:]))[-rows:]


def _seen(part: Stretch, made: FlightModel) -> Iterator[Stretch]:
    """Yields a stretch in pieces over which the rate is known, which coupling takes as it is read."""
    unread = np.asarray(np.isnan(part.readings[:, : made.gyros]).all(axis=1))
    lost, hole = np.asarray(unread.any(axis=1)), _HOLE
    if made.own_times:  # rows of other sensors have no rate
        hole = max(
            _HOLE, math.ceil(_HOLE * made.period_s / float(np.median(np.diff(part.time_s)))) if lost.size > 1 else 0
        )
    for first, last in _runs(lost):
        if last - first <= hole:
            lost[first:last] = False
    for first, last in _runs(~lost):
        yield _rows_of(part, slice(first, last))


def _slow_enough(part: Stretch, made: FlightModel) -> Iterator[Stretch]:
    """Yields a stretch in pieces over which noise of the rates that enters by coupling does not add up."""
    n = part.time_s.size
    if n <= 2:
        return
    rates = part.readings[:, : made.gyros]
    length_s = float(part.time_s[-1] - part.time_s[0]) / (n - 1) if made.own_times else made.period_s
    fastest = float(np.nanmax(np.abs(rates), initial=0.0)) * length_s
    rows = n if fastest * math.sqrt(n) <= _ADDED else int((_ADDED / fastest) ** 2)
    if rows >= _SHORTEST:
        for first in range(0, n - 2, rows):
            yield _rows_of(part, slice(first, min(first + rows + 1, n)))


class Hindsight(NamedTuple):
    """Result of the batch analysis of a run.

    Attributes:
        bound: least 1-sigma of the ten parameters that the run allows for rounding taken as noise, NaN where not known,
            shape (10,).
        diagnoses: what the readings contradict, the clearest first.
    """

    bound: Array
    diagnoses: tuple[Diagnosis, ...]


def looked_back(
    scenario: Scenario,
    signals: Spool,
    estimate: Array,
    found: Sequence[DetectionRecord],
    events: Sequence[EventRecord] = (),
    *,
    resumed: bool = False,
) -> Hindsight:
    """Analyzes a run after its end.

    What comes after the first failure or jump that was declared, and still stands, is not put to the test: what is
    wrong then has been said.

    Args:
        scenario: as run.
        signals: with `time_s`, commands and readings.
        estimate: of the ten parameters at the end, NaN where not observed, shape (10,).
        found: failures and jumps that were declared.
        events: what was said besides; readings that were said to be false are left out.
        resumed: whether it goes on from another run, of which the signals tell nothing.
    """
    back = _looked_back(scenario, signals, estimate, (found, events), resumed=resumed)
    return back._replace(diagnoses=(*back.diagnoses, *_disturbed(scenario, events, back.diagnoses)))


def _disturbed(scenario: Scenario, events: Sequence[EventRecord], told: Sequence[Diagnosis]) -> list[Diagnosis]:
    """Diagnoses a disturbance that is not stated, where no other diagnosis names it."""
    found = [one for one in events if one.kind == "disturbance" and one.torque_std is not None]
    if not found or any(one.kind in _OF_DISTURBANCES for one in told):
        return []
    largest = max(found, key=lambda one: one.torque_std or 0.0)
    words = f"{acting(largest, scenario.vehicle_data.unit_names)} acts besides the jets; nothing states it"
    return [Diagnosis("disturbance", words, largest.torque_std or 0.0, 0.0)]


def _looked_back(
    scenario: Scenario,
    signals: Spool,
    estimate: Array,
    said: tuple[Sequence[DetectionRecord], Sequence[EventRecord]],
    *,
    resumed: bool,
) -> Hindsight:
    """Analyzes what readings contradict by themselves; `said` are the failures and jumps, and the events."""
    found, events = said
    standing = [one for one in found if one.withdrawn_s is None]
    jumped = any(one.kind == JUMP for one in standing)
    apart = None if resumed or jumped else prior.contradiction(scenario, signals, estimate)
    if scenario.estimation.filter == "pose":  # what it looks back on are rates at regular intervals
        return Hindsight(np.full(10, np.nan), () if apart is None else (apart,))
    made = model(scenario)
    unseen_s = made.period_s if scenario.estimation.filter == "joint" else _UNSEEN_S
    until_s = min((one.onset_s - unseen_s for one in standing), default=math.inf)
    with np.errstate(all="ignore"):
        parts = _without_lies(_whole(scenario, signals), list(events), names_of(scenario))
        begin = np.where(np.isnan(estimate) | jumped, made.prior[:10], estimate)  # that at the end is of after a jump
        if until_s < math.inf and _off_ticks(parts, made):  # what was declared may be the clock's doing
            every = _some(parts, math.inf, made)
            if _switched(every, hindsight.fitted(every, _from(begin, made), made), made)[-1]:
                until_s = math.inf
        names = names_of(scenario)
        chosen = _some(parts, until_s, made)
        diagnoses, fit = diagnosed(chosen, begin, made, names)
        if until_s < math.inf and _excess(fit) > 0.0:  # what was declared may be the doing of what moves inside
            every = _some(parts, math.inf, made)
            whole = hindsight.fitted(every, _from(begin, made), made)
            diagnoses = _oscillating(every, whole, made, names) or diagnoses
        if until_s < math.inf and names.wheels:  # or of a wheel that is not as stated
            whole_of_it, _ = diagnosed(_some(parts, math.inf, made), begin, made, names)
            diagnoses = whole_of_it if any(one.kind == "wheel" for one in whole_of_it) else diagnoses
        if diagnoses or apart is not None or _excess(fit) > 0.0 or fit.normal.readings < _FEWEST:
            scaled = _rescaled(parts, begin, made, scenario)
            if scaled is not None:
                parts, apart = scaled.parts, None
                others, fit = diagnosed(_some(parts, until_s, made), scaled.begin, made, names)
                diagnoses = [*scaled.found, *others]
        if apart is not None:
            diagnoses = [apart, *diagnoses] if apart.kind == "factor" else [*diagnoses, apart]
        tracked = bool(params.trackers(scenario))  # whose readings it does not go over: they allow less
        if resumed or jumped or tracked or not hindsight.possible(fit.at):
            return Hindsight(np.full(10, np.nan), tuple(diagnoses))
        start, drift = params.initial_covariance(scenario), _drift(scenario, fit.at)
        all_of_it = sum(one.time_s.size for one in chosen) == sum(one.time_s.size for one in parts)
        known = fit.normal.information if all_of_it and not hindsight.gathers(made) else None
        bound = hindsight.least_deviation(parts, fit.at, start, drift, steady(made), known)
    return Hindsight(bound, tuple(diagnoses))


def _drift(scenario: Scenario, at: Array) -> Array:
    """Computes variances that each unit of propellant adds, as in the joint filter, shape (10,)."""
    joint, vehicle = scenario.joint, scenario.vehicle_data
    fed = any(vehicle.jets_of(tank).any() for tank in vehicle.tanks)
    if scenario.estimation.filter != "joint" or (fed and vehicle.tank_geometry.feeds.sum(axis=0).all()):
        return np.zeros(10)
    fraction = vehicle.tank_fraction if joint.tank_fraction is None else joint.tank_fraction
    return propellant_drift(at, 1.0, fraction, vehicle.rms_arm)


# --------------------------------------------------------------------------------------- diagnoses

RATE = 2e-4  # at which a test is failed by chance
_UNSEEN_S = 2.0  # for which a failure or a jump may have been there before detectors of the thesis see it
_MOST = 3  # causes that are looked for one after the other
_OUTSIDE = 5.0  # times the reach of the jets, at which no force of the vehicle acts
_TRIED = 5  # suspects with which all is fitted anew: compute budget
_CLEAR = 0.01  # 1-sigma of a combination of thrust errors that is tested
_EXPLAINED = 0.9  # of the misfit beyond what is stated, that a cause must explain
_HOPELESS = 1e4  # times the stated variance: a sign may be wrong
_SMOOTH = 0.5  # serial correlation, from which on residuals drift rather than scatter
_SHARE = 0.9  # of what a group explains: one of it that explains as much is named alone
_REVERSED = (-2.6, -1.4)  # error of a gain that reverses a sign
_DEAD = (-1.2, -0.8)
_WIDE = 0.99  # 1-sigma from which on something is no longer tested: it has been found
_FEWEST = 100  # readings, below which nothing is tested
_SCATTER = 1.3  # times the stated variance: less may be rounding that is not white
_CONFIDENT = 5.0  # sigma of a ratio of variances
_GAINED = 30.0  # log likelihood, twice, that a factor must gain: 5 sigma, of some ten that are tried
_UNLIKELY = 2.5  # ratio of what readings gain to what jets give by the vehicle's file, beyond which a unit is tried


class _Suspect(NamedTuple):
    kind: str
    group: NDArray[np.int_]
    score: ScoreTest
    statistic: float
    threshold: float


def diagnosed(
    parts: Sequence[Stretch], begin: Array, made: FlightModel, names: Names
) -> tuple[list[Diagnosis], FlightFit]:
    """Diagnoses what the readings contradict, the clearest first.

    Args:
        parts: of the record.
        begin: the ten parameters to begin with, shape (10,).
        made: see `model`.
        names: of jets, kinds and sensors.
    """
    found: list[Diagnosis] = []
    fit = first = hindsight.fitted(parts, _from(begin, made), made)
    if fit.normal.is_finite and (wider := _reaching(fit.at[:10], made)) is not made:
        made = wider
        fit = first = hindsight.fitted(parts, fit.at, made)
    if fit.normal.readings < _FEWEST or not fit.normal.is_finite:
        return found, first
    fit, reckoned, found = _switched(parts, fit, made)
    while len(found) < _MOST:
        best = min(_explanations(parts, fit, reckoned, names), key=lambda one: one.cost, default=None)
        if best is None:
            break
        found.append(best.diagnosis)
        parts, fit, reckoned = best.parts, best.fit, best.made
    if not found and fit.normal.per_reading > _HOPELESS:
        fit, found = _turned_right(parts, fit, made, names)
    if not any(one.kind == "jet" for one in found):  # what a failed jet leaves is no fault of sensors
        found += _oscillating(parts, fit, reckoned, names) or _scattered(parts, fit, reckoned, names)
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
    """Yields causes that explain the readings once all is fitted again with them."""
    suspects = [one for one in _suspects(fit, made) if one.statistic > one.threshold]
    per_unknown = math.log(max(fit.normal.readings, 1.0))
    for one in sorted(suspects, key=lambda one: -one.statistic / one.threshold)[:_TRIED]:
        cause = _named(one, fit, made, names)
        wider = made._replace(sigma=made.sigma.copy())
        wider.sigma[cause.group] = cause.sigma
        after = hindsight.fitted(parts, fit.at, wider)
        if _explains(after, fit):
            reason = _late_thrust(cause, after, made, names) if cause.kind == "lag" else cause.reason
            found = Diagnosis(cause.kind, reason, one.statistic, one.threshold)
            yield _Explanation(found, _cost(after, wider) + per_unknown * one.score.degrees, parts, after, wider)
    for rows in (1, -1) if _excess(fit) > 0.0 and not made.own_times else ():
        moved = [_commanded_later(part, rows) for part in parts]
        after = hindsight.fitted(moved, made.prior, made)
        if not _explains(after, fit):
            continue
        same = hindsight.fitted([_rows_of(part, _kept_of(part, rows)) for part in parts], fit.at, made)
        if _excess(same) > 0.0 and _explains(after, same):  # else the row that is left out is all that contradicts
            words = f"delay wrong: commands act {1e3 * made.period_s:.3g} ms {'later' if rows > 0 else 'earlier'}"
            reason = f"{words} than they are logged, one sample period"
            found = Diagnosis("delay", reason, fit.normal.per_reading, after.normal.per_reading)
            yield _Explanation(found, _cost(after, made) + per_unknown, moved, after, made)


def _explains(after: FlightFit, before: FlightFit) -> bool:
    """Tests whether a fit leaves next to nothing of another fit's misfit beyond rounding."""
    return after.normal.is_finite and _excess(after) <= (1.0 - _EXPLAINED) * _excess(before)


def _commanded_later(part: Stretch, rows: int) -> Stretch:
    """Returns a stretch whose commands act one row later (1), or earlier (-1), than its record says."""
    cut, told = _rows_of(part, _kept_of(part, rows)), slice(0, -1) if rows > 0 else slice(1, None)
    opening = None if part.onsets_s is None else part.onsets_s[told]
    return _preceded(cut._replace(commands=part.commands[told], onsets_s=opening), part, slice(0 if rows > 0 else 1))


def _kept_of(part: Stretch, rows: int) -> slice:
    """Returns rows of a stretch that are left when its commands act one row later (1), or earlier (-1)."""
    return slice(1, part.time_s.size) if rows > 0 else slice(0, part.time_s.size - 1)


def _late_thrust(cause: _Cause, after: FlightFit, made: FlightModel, names: Names) -> str:
    """Describes the lags with which the thrust of each kind of jet builds up, by a fit in which they are free."""
    places, words = hindsight.columns(made), []
    for place in cause.group.tolist():
        index, off = place - places.lag.start, 1e3 * float(after.at[place])
        told = 1e3 * float(made.time_constants_s[made.kinds == index].max(initial=0.0))
        if told > 0.0:
            words.append(f"{names.kinds[index]} jets build up with {max(told + off, 0.0):.3g} ms, told {told:.3g} ms")
        elif off != 0.0:
            when = "late" if off > 0.0 else "early"
            words.append(f"{names.kinds[index]} jets act {abs(off):.3g} ms {when}, told none")
    return f"lag wrong: {'; '.join(words)}"


def _oscillating(parts: Sequence[Stretch], fit: FlightFit, made: FlightModel, names: Names) -> list[Diagnosis]:
    """Looks for a mode inside the vehicle, such as slosh or a panel, that explains drifting residuals.

    Where walks or a disturbance are stated, whatever exceeds them is told, a mode or not.
    """
    stated = hindsight.gathers(made)
    if not hindsight.possible(fit.at):
        return []
    if oscillation.is_covered(parts, fit, made) if stated else _excess(fit) == 0.0:
        return []
    misfit, readings = oscillation.misfit_of(parts, fit, made) if stated else (fit.normal.misfit, fit.normal.readings)
    mode = oscillation.strongest_mode(parts, fit, made)
    left = (1.0 - _EXPLAINED) * max(misfit - _SCATTER * readings, 0.0)
    if mode is None or mode.misfit - _SCATTER * mode.readings > left:
        if not stated:
            return []
        rate, velocity = oscillation.covering_walk(parts, fit, made, np.zeros_like(fit.at))
        words = f"readings wander more than is stated; {_covering(rate, velocity)}"
        return [Diagnosis("drift", words, misfit / max(readings, 1.0), 1.0)]
    rate, velocity = oscillation.covering_walk(parts, fit, made, mode.change)
    words = (
        f"something inside moves at {mode.frequency_hz:.2g} Hz, such as slosh or a panel; {_covering(rate, velocity)}"
    )
    return [Diagnosis("oscillation", words, fit.normal.per_reading, mode.misfit / mode.readings)]


def _covering(rate: float, velocity: float) -> str:
    return f"joint.rate_walk={rate:.2g} and joint.velocity_walk={velocity:.2g} would cover it"


def _from(begin: Array, made: FlightModel) -> Array:
    """Returns the start of a fit: these ten parameters, if they are a body's."""
    start = made.prior.copy()
    if hindsight.possible(begin):  # NaN is not
        start[:10] = begin
    return start


def _reaching(found: Array, made: FlightModel) -> FlightModel:
    """Returns the model with a prior of the ten parameters as wide as their deviation from it turned out to be."""
    off = np.abs(found - made.prior[:10])
    far = off > _OFF * made.sigma[:10]
    if not far.any():
        return made
    sigma = made.sigma.copy()
    sigma[:10] = np.where(far, off, sigma[:10])
    return made._replace(sigma=sigma)


def _off_ticks(parts: Sequence[Stretch], made: FlightModel) -> bool:
    """Tests whether stamps are off their ticks."""
    return any(hindsight.off_ticks(part, made) for part in parts)


def _switched(
    parts: Sequence[Stretch], fit: FlightFit, made: FlightModel
) -> tuple[FlightFit, FlightModel, list[Diagnosis]]:
    """Tries commands that switch at stamps instead of regular ticks, or the reverse; takes what explains the readings.

    Args:
        parts: of the record.
        fit: of them as it is stated.
        made: see `model`.

    Returns:
        The fit, what it was made with, and what there is to say.
    """
    if made.at_stamps is None or _excess(fit) == 0.0 or not _off_ticks(parts, made):
        return fit, made, []
    other = made._replace(at_stamps=not made.at_stamps)
    after = hindsight.fitted(parts, fit.at if hindsight.possible(fit.at) else made.prior, other)
    if not after.normal.is_finite or _excess(after) > (1.0 - _EXPLAINED) * _excess(fit):
        return fit, made, []
    where = "the stamps of their rows" if other.at_stamps else "regular ticks"
    words = f"clock jitter: commands switch at {where}: joint.switching={'stamps' if other.at_stamps else 'ticks'}"
    return after, other, [Diagnosis("jitter", words, fit.normal.misfit, after.normal.misfit)]


def _excess(fit: FlightFit) -> float:
    """Computes the misfit beyond the possible effect of rounding."""
    return max(fit.normal.misfit - _SCATTER * fit.normal.readings, 0.0)


def _turned_right(
    parts: Sequence[Stretch], fit: FlightFit, made: FlightModel, names: Names
) -> tuple[FlightFit, list[Diagnosis]]:
    """Tries each axis of the gyros with the other sign; takes one that explains the readings."""
    for package in range(made.gyros):
        for axis in range(3):
            signs = np.ones((made.variances.shape[0], 3))
            signs[package, axis] = -1.0
            turned = [part._replace(readings=part.readings * signs) for part in parts]
            after = hindsight.fitted(turned, made.prior, made)
            if after.normal.per_reading < _HOPELESS and _excess(after) < (1.0 - _EXPLAINED) * _excess(fit):
                reason = f"axis {names.gyros[package]} {'xyz'[axis]} has the wrong sign"
                return after, [Diagnosis("gyro_sign", reason, fit.normal.per_reading, _HOPELESS)]
    return fit, []


class _Rescaled(NamedTuple):
    """Record whose readings were all off by common factors.

    Attributes:
        parts: the stretches without them.
        begin: the ten parameters by these, shape (10,).
        found: the factors.
    """

    parts: list[Stretch]
    begin: Array
    found: list[Diagnosis]


def _rescaled(parts: Sequence[Stretch], begin: Array, made: FlightModel, scenario: Scenario) -> _Rescaled | None:
    """Tries readings of gyros, of accelerometers and of both without a common factor; takes the best if it explains.

    Args:
        parts: of the whole record, since a failure that was declared may be the factor's doing.
        begin: the ten parameters as estimated, shape (10,).
        made: see `model`.
        scenario: as run.
    """
    ratios = hindsight.gain_ratios(parts, made.prior, made)
    vehicle, gyro = scenario.vehicle_data, np.arange(ratios.size) < made.gyros
    rates = factors.of_rates(vehicle.sample_period_s)
    velocities = factors.of_velocities(vehicle.units, vehicle.sample_period_s)
    of_gyros, of_others = _candidates(ratios, gyro, rates), _candidates(ratios, ~gyro, velocities)
    known = (None, *rates, *velocities)
    names = names_of(scenario)
    tried: list[tuple[float, _Rescaled]] = []
    for pair in product((None, *of_gyros), (None, *of_others)):
        sizes, words = np.ones(ratios.size), []
        for kind, factor, among in zip((gyro, ~gyro), pair, (names.gyros, names.accelerometers), strict=True):
            if factor is not None:
                off = kind & ~_is_plausible(ratios)
                sizes[off] = factor.size
                sensors = [name for name, is_off in zip(among, off[kind], strict=True) if is_off]
                words.append(f"{', '.join(sensors)}: readings are {factor}")
        if not words:
            continue
        other = [_times(part, 1.0 / sizes) for part in parts]
        chosen = _some(other, math.inf, made)
        after = hindsight.fitted(chosen, made.prior, made)
        if after.normal.readings < _FEWEST or not after.normal.is_finite:
            continue
        before = hindsight.fitted([_times(part, sizes) for part in chosen], _from(begin, made), made)
        gained = _cost(before, made) - _cost(after, made)
        settled = _excess(after) <= (1.0 - _EXPLAINED) * _excess(before)
        if before.normal.is_finite and not (settled and gained > _GAINED * max(after.normal.per_reading, 1.0)):
            continue
        found = [Diagnosis("factor", one, before.normal.per_reading, after.normal.per_reading) for one in words]
        exact = 1.0 if all(one in known for one in pair) else _SCATTER  # what was measured is not
        tried.append((exact * after.normal.per_reading, _Rescaled(other, after.at[:10], found)))
    return min(tried, key=lambda one: one[0], default=(0.0, None))[1]


def _times(part: Stretch, sizes: Array) -> Stretch:
    """Multiplies the readings of each package in a stretch by a factor, shape (n_packages,)."""
    return part._replace(readings=part.readings * sizes[:, None])


def _candidates(ratios: Array, kind: NDArray[np.bool_], known: Sequence[Factor]) -> list[Factor]:
    """Returns the common factors that packages of a kind may be off by, or else the measured one."""
    off = ratios[kind & ~_is_plausible(ratios)]
    if not off.size:
        return []
    size = float(np.median(off))
    return [*factors.near(size, known), Factor(size, "")] if size > 0.0 else []


def _is_plausible(ratios: Array) -> NDArray[np.bool_]:
    """Tests whether mass properties may be so far from nominal that readings change by so much more or less."""
    return np.isnan(ratios) | ((ratios >= 1.0 / _UNLIKELY) & (ratios <= _UNLIKELY))


def _cost(fit: FlightFit, made: FlightModel) -> float:
    """Computes the objective of a fit: the misfit, and the distance of the unknowns from their prior."""
    free = made.sigma > 0.0
    return fit.normal.misfit + float(np.sum(((fit.at - made.prior)[free] / made.sigma[free]) ** 2))


def _groups(made: FlightModel) -> dict[str, NDArray[np.int_]]:
    places = hindsight.columns(made)
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


def _scaled(score: ScoreTest, fit: FlightFit, stated: float) -> float:
    """Scales a statistic to the variance of the readings as it is, where that is larger than stated."""
    left = fit.normal.misfit if stated > 0.0 else score.least
    return score.statistic / max(1.0, left / max(fit.normal.readings, 1.0))


def _tested(
    kind: str,
    group: NDArray[np.int_],
    fit: FlightFit,
    made: FlightModel,
    clear: float = np.inf,
    common: Reckoned | None = None,
) -> _Suspect:
    stated = float(made.sigma[group].max())
    score = hindsight.score(fit, group, made, stated, clear, common)
    threshold = chi_square_limit(RATE, score.degrees) if score.degrees else np.inf
    alike = 1.0  # packages of a kind, side by side, may round alike: then they say no more than one
    if kind.startswith("gyro"):
        alike = float(made.gyros)
    elif kind.startswith("accel"):
        alike = float(made.positions.shape[0])
    return _Suspect(kind, group, score, _scaled(score, fit, stated) / alike, threshold)


def _suspects(fit: FlightFit, made: FlightModel) -> Iterator[_Suspect]:
    places, common = hindsight.columns(made), hindsight.reckoned_in(fit, made)
    for kind, group in _groups(made).items():
        if group.size and made.sigma[group].max() < _WIDE:
            yield _tested(kind, group, fit, made, _CLEAR if kind == "thrust" else np.inf, common)
    lags = [
        place
        for place in range(places.lag.start, places.lag.stop)
        if made.sigma[place] < _WIDE and fit.normal.information[place, place] > 0.0
    ]
    for place in lags:
        yield _tested("lag", np.array([place]), fit, made, common=common)
    if len(lags) > 1:
        yield _tested("lag", np.array(lags), fit, made, common=common)


class _Cause(NamedTuple):
    """Cause, and the unknowns of the model that it makes wrong."""

    kind: str
    reason: str
    group: NDArray[np.int_]
    sigma: float


def _named(worst: _Suspect, fit: FlightFit, made: FlightModel, names: Names) -> _Cause:
    """Describes a failed test as a cause."""
    kind, group, size = worst.kind, worst.group, worst.score.size
    if kind in ("thrust", "gyro_scale", "accelerometer_scale", "wheel", "engine"):
        return _of_many(worst, fit, made, names)
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


def _of_many(worst: _Suspect, fit: FlightFit, made: FlightModel, names: Names) -> _Cause:
    """Finds the cause among jets or axes: the one that explains all of it, else all of them."""
    kind, group, size = worst.kind, worst.group, worst.score.size
    common = hindsight.reckoned_in(fit, made)
    each = [_tested(kind, np.array([place]), fit, made, common=common) for place in group.tolist()]
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
        return _of_engines(gain, each[best], names, best, alone=alone)
    sensors = names.gyros if kind == "gyro_scale" else names.accelerometers
    axis = f"axis {sensors[best // 3]} {'xyz'[best % 3]}"
    if turned:
        return _Cause(kind.replace("scale", "sign"), f"{axis} has the wrong sign", each[best].group, 3.0)
    what = axis if alone else sensors[best // 3]
    return _Cause(kind, f"{what}: scale factor off by {100.0 * gain:.3g} %", group, 3.0)


def _of_engines(gain: float, suspect: _Suspect, names: Names, place: int, *, alone: bool) -> _Cause:
    """Describes a cause by an error of an engine: by how much, or that there are several."""
    if not alone:
        return _Cause("engine", "engines are off by more than is stated", suspect.group, 1.0)
    engine, error = divmod(place, N_ERRORS)
    what = (
        f"its thrust is {1.0 + gain:.3g} times the stated one",
        f"its force points {gain:.2g} rad beside the stated direction",
        f"its force acts {gain:.2g} {names.length} beside the stated place",
    )[error // 2]
    return _Cause("engine", f"engine {names.engines[engine]}: {what}", suspect.group, 1.0)


def _scattered(parts: Sequence[Stretch], fit: FlightFit, made: FlightModel, names: Names) -> list[Diagnosis]:
    """Finds readings with larger residuals than stated: drifting, while the rate changes fast, or all of a package.

    Args:
        parts: of the record.
        fit: of them.
        made: see `model`.
        names: of sensors, and units.
    """
    quick, quiet = fit.normal.quick, fit.normal.quiet
    sensors = (*names.gyros, *names.accelerometers)
    found: list[Diagnosis] = []
    for package, (misfit, count, serial) in enumerate(fit.normal.by_package.tolist()):
        gyro = package < len(names.gyros)
        if count < _FEWEST / 4 or (found and not gyro):  # accelerometers turn with what gyros show
            continue
        ratio, allowed = misfit / count, _allowed(count)
        if ratio <= allowed:
            continue
        times = f"{math.sqrt(ratio):.3g} times what is stated"
        if serial > _SMOOTH * misfit:
            cause = _of_torques(parts, made, names) if gyro else "unmodeled forces"
            found.append(Diagnosis("drift", f"{sensors[package]}: readings drift {times}: {cause}", ratio, allowed))
        elif gyro and quick[1] >= _FEWEST / 4 and quick[0] / quick[1] > _SCATTER * _per_reading(quiet) * 2.0:
            words = f"clock jitter: {sensors[package]} readings scatter {times} while the rate changes"
            found.append(Diagnosis("jitter", words, ratio, allowed))
        else:
            found.append(Diagnosis("noise", f"{sensors[package]}: readings scatter {times}", ratio, allowed))
    return found


def _of_torques(parts: Sequence[Stretch], made: FlightModel, names: Names) -> str:
    """Describes what turns the vehicle beyond the fit: wheels, where the equivalent force would act far outside."""
    momentum, impulse = hindsight.unexplained(parts, made)
    torques, forces = made.wrenches[:, :3], made.wrenches[:, 3:]
    reach = float((np.linalg.norm(torques, axis=1) / np.linalg.norm(forces, axis=1)).max())
    if not made.positions.size or momentum < _OUTSIDE * reach * impulse:
        return "unmodeled torques"
    size = f"angular momentum of up to {momentum:.2g} {names.torque}-s"
    return f"unmodeled torques without a force, such as wheels whose speed changes: {size}"


def _allowed(count: float) -> float:
    """Computes the largest ratio of variances that may be chance."""
    return _SCATTER * (1.0 + _CONFIDENT * math.sqrt(2.0 / count))


def _per_reading(part: Array) -> float:
    """Computes the misfit for each reading, at least the stated one."""
    return max(float(part[0] / part[1]), 1.0) if part[1] >= _FEWEST / 4 else 1.0

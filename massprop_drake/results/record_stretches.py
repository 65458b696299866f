"""Parts of a run's record without gaps, as the batch regression takes them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.inputs import params
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.maths.estimation.joint.burns import EngineSettings, engine_impulse, make_burn, shut_engine_settings
from massprop_drake.maths.estimation.offline import thrust_course
from massprop_drake.maths.estimation.offline.flight_model import FlightModel, Stretch
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.vehicle.engine_thrust import N_CHANNELS, channel_mask
from massprop_drake.maths.vehicle.on_times import level_onsets
from massprop_drake.results.events import EventRecord
from massprop_drake.results.regression_model import Names, motion_sigma, vehicle_names
from massprop_drake.results.spool import Spool

_ROWS = 1024  # of a stretch
_ADDED = 0.3  # of a reading's noise: what coupling may add to it over a stretch
_BEFORE = ("before", "before_onsets_s")  # of a stretch, what is of rows before it
_SHORTEST = 16  # rows of a stretch
_STRETCHES = 32  # of so many rows, at the most, evenly spread
_LINGERS = 1e-4  # of full thrust: less is not felt
_HOLE = 2  # rows without a gyro's axis over which the rate is taken to be what jets make of it
_LIES_ON_S = 2.0  # after a reading was said to be false it is not believed again


# The C library keeps what is freed up to twice the largest block that it has been given back: without this the system
# would be given the memory of each look back, and would clear it anew for the next, which takes a fifth of its time.
np.empty(1 << 21)


def stretches(scenario: Scenario, signals: Spool) -> Iterator[Stretch]:
    """Yields a record's stretches without gaps, at most 1024 intervals each; propellant counts from the beginning."""
    packages = (*params.gyros(scenario), *params.accelerometers(scenario))
    optional = ("gap", "outside_wrench", "command_onset")
    wanted = ["time_s", "command", *(name for name in optional if name in signals)]
    flows, lengths_s = scenario.vehicle_data.mass_flows, _interval_lengths(scenario)
    felt = _lag_intervals(scenario)
    before, used, since = np.zeros((felt, flows.size)), 0.0, -1 if "gap" in signals else -1 - felt
    fired_s, has_tanks = np.zeros(flows.size), bool(scenario.vehicle_data.tanks)
    opened = level_onsets((felt, flows.size))  # onsets of these
    wheels = [wheel.name for wheel in scenario.vehicle_data.wheels]
    engines = [engine.name for engine in scenario.vehicle_data.engines if engine.name in signals]
    setting: EngineSettings | None = None
    for block in _windows(signals, *wanted, *(package.name for package in packages), *wheels, *engines):
        time_s, commands = block["time_s"], block["command"]
        known = np.nan_to_num(commands)
        burns = _engine_burns(scenario, block, setting)
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
        for first, last in _find_runs(counts - last_unknown > felt):
            if last - first > 1:
                yield take_rows(whole, slice(first, last + 1))
        before = _append_rows(before, known[:-1])
        opened = opened if onsets_s is None else _append_rows(opened, onsets_s[:-1])


class _EngineBurns(NamedTuple):
    """Engine burns between the rows of a block, whose first row is the last of the block before."""

    points: Array | None  # see `Stretch.burns`; None: there are no engines
    used: Array  # propellant of each interval, (m - 1,)
    loose: NDArray[np.bool_]  # intervals whose impulse is known less well than a reading shows it, (m - 1,)
    setting: EngineSettings | None  # after the last row


def _engine_burns(scenario: Scenario, block: dict[str, Array], setting: EngineSettings | None) -> _EngineBurns:
    """Computes the engines' burns and propellant used per interval of a block, and their final setting."""
    vehicle, rows = scenario.vehicle_data, block["time_s"].size
    used, loose = np.zeros(rows - 1), np.zeros(rows - 1, dtype=np.bool_)
    if not any(engine.name in block for engine in vehicle.engines):
        return _EngineBurns(None, used, loose, setting)
    setup = params.filter_setup(scenario)
    engines, has_channel, period_s = setup.engines, channel_mask(setup.engines), setup.period_s
    least = np.sqrt([item.min(initial=np.inf) for item in (setup.gyro_variances, setup.accelerometer_variances)])
    read, nothing = np.zeros((rows, *has_channel.shape)), np.zeros(setup.engine_sigmas.size)
    item = (block.get(one.name, np.full((rows, len(one.columns)), np.nan)) for one in vehicle.engines)
    read[:, has_channel] = np.hstack(list(item))
    points = np.zeros((rows, len(has_channel), 3, N_CHANNELS))
    if setting is None:
        _, setting = make_burn(shut_engine_settings(len(has_channel)), read[0], period_s, engines)
    lengths_s = np.broadcast_to(_interval_lengths(scenario)(block["time_s"]), rows - 1)
    for row in range(1, rows):
        length_s = float(lengths_s[row - 1])
        burn, setting = make_burn(setting, read[row], length_s, engines)
        if burn.points.any():
            impulse = engine_impulse(burn, nothing, length_s, engines)
            points[row - 1], used[row - 1] = burn.points, impulse.used
            loose[row - 1] = (motion_sigma(impulse.noise, vehicle.nominal) > least).any()
    return _EngineBurns(points, used, loose, setting)


def _lag_intervals(scenario: Scenario) -> int:
    """Computes the number of intervals over which thrust lags after unknown commands, at least 1."""
    vehicle = scenario.vehicle_data
    longest = float(vehicle.time_constants_s.max(initial=0.0)) / vehicle.sample_period_s
    return max(1, math.ceil(longest * params.filter_step_rates(scenario).steps * math.log(1.0 / _LINGERS)))


def _interval_lengths(scenario: Scenario) -> Callable[[Array], Array | float]:
    """Makes the function that converts row times to interval lengths, s: their differences, or the sample period."""
    if params.steps_by_readings(scenario):
        return np.diff
    return lambda _: scenario.vehicle_data.sample_period_s


def used_propellant(scenario: Scenario, signals: Spool, flows: Array, *, by_thrust: bool = False) -> float:
    """Computes the propellant used from the first row to the last, slug or kg, by commands or thrusts.

    Args:
        scenario: as run.
        signals: with `time_s`, and commands or thrusts.
        flows: of each jet at full thrust, slug/s or kg/s, shape (n_jets,).
        by_thrust: whether to integrate thrusts in place of commands.
    """
    vehicle = scenario.vehicle_data
    name, full = ("thrust", np.linalg.norm(vehicle.thrusts, axis=1)) if by_thrust else ("command", np.ones(flows.size))
    flow = np.concatenate([np.nansum(block[name] / full * flows, axis=1) for block in signals.blocks(name)])[:-1]
    if params.steps_by_readings(scenario) and not by_thrust:  # of a simulation every row is a sample
        return float(flow @ np.diff(signals["time_s"]))
    return float(flow.sum() * vehicle.sample_period_s)


def _find_runs(mask: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Returns (first index, one past the last) of each run of True in a mask."""
    edges = np.flatnonzero(np.diff(mask, prepend=False, append=False))
    return [(int(first), int(last)) for first, last in edges.reshape(-1, 2)]


def _windows(signals: Spool, *names: str) -> Iterator[dict[str, Array]]:
    """Yields signals by name in windows of 1024 intervals; the last row of each is the first of the next."""
    waiting = {name: np.empty((0,)) for name in names}
    for block in signals.blocks(*names):
        for name, rows in block.items():
            waiting[name] = np.concatenate((waiting[name], rows)) if waiting[name].size else rows
        while waiting["time_s"].shape[0] > _ROWS:
            yield {name: rows[: _ROWS + 1] for name, rows in waiting.items()}
            waiting = {name: rows[_ROWS:] for name, rows in waiting.items()}
    if waiting["time_s"].shape[0] > 1:
        yield waiting


def whole_record(scenario: Scenario, signals: Spool) -> list[Stretch]:
    """Returns a record's stretches without gaps; propellant after each row is that used until the record's end."""
    pieces = list(stretches(scenario, signals))
    used = max((-float(part.used_after[-1]) for part in pieces), default=0.0)
    return _recount_propellant(pieces, used)


def _recount_propellant(pieces: Sequence[Stretch], propellant_mass: float) -> list[Stretch]:
    """Adds propellant, slug or kg, to that used after each row; recounts jet seconds to the end of the last row."""
    found = [part._replace(used_after=part.used_after + propellant_mass) for part in pieces]
    if not pieces or pieces[-1].seconds is None:
        return found
    later = np.stack((np.zeros_like(pieces[-1].seconds[-1, 1]), pieces[-1].seconds[-1, 1]))
    return [piece._replace(seconds=piece.seconds - later) for piece in found if piece.seconds is not None]


def remove_false_readings(pieces: Sequence[Stretch], events: Sequence[EventRecord], names: Names) -> list[Stretch]:
    """Sets readings declared false to NaN, from onset to 2 s after; cuts stretches at wheel or engine faults."""
    sensors = [*names.gyros, *names.accelerometers]
    false = [event for event in events if event.kind == "false_reading"]
    lies, result = [event for event in false if event.sensor in sensors], list(pieces)
    ends = [event.onset_s for event in false if event.sensor in names.wheels]
    unheard_s = min([*ends, *(event.onset_s for event in events if event.kind == "engine_failed")], default=math.inf)
    if unheard_s < math.inf:  # then gyros do not show what has acted on the vehicle, and it may be so from there on
        result = [cut for piece in pieces if (cut := cut_at(piece, unheard_s)).time_s.size > 2]
    for number, piece in enumerate(result if lies else ()):
        readings = piece.readings.copy()
        for lie in lies:
            rows = (piece.time_s > lie.onset_s) & (piece.time_s <= lie.time_s + _LIES_ON_S)
            readings[rows, sensors.index(str(lie.sensor)), "xyz".index(str(lie.axis))] = np.nan
        result[number] = piece._replace(readings=readings)
    return result


def select_short_pieces(pieces: Sequence[Stretch], until_s: float, model: FlightModel) -> list[Stretch]:
    """Cuts stretches at a time, s, and into pieces short enough for regression; every k-th if too many."""
    read_pieces = (piece for long_piece in pieces for piece in _split_at_lost_rates(cut_at(long_piece, until_s), model))
    short = [piece for long_piece in read_pieces for piece in _split_by_coupling(long_piece, model)]
    rows = sum(piece.time_s.size for piece in short)
    return short[:: max(-(-rows // (_STRETCHES * (_ROWS + 1))), 1)]


def regression_pieces(scenario: Scenario, signals: Spool, until_s: float, model: FlightModel) -> list[Stretch]:
    """Returns a record's stretches up to a time, s, cut into pieces short enough for regression."""
    return select_short_pieces(whole_record(scenario, signals), until_s, model)


def trusted_stretches(
    scenario: Scenario, signals: Spool, until_s: float, events: Iterable[EventRecord], model: FlightModel
) -> tuple[list[Stretch], bool]:
    """Returns stretches up to a time or a wheel or engine fault, false readings NaN; and if switching times are known.

    Args:
        scenario: as run.
        signals: with `time_s`, commands and readings.
        until_s: up to when, s; infinity: all of it.
        events: declared in the run.
        model: see `make_model`.

    Returns:
        Stretches, their propellant counted from the end of the last; True if stamps are the ticks of commands.
    """
    pieces = remove_false_readings(whole_record(scenario, signals), list(events), vehicle_names(scenario))
    trusted = [cut for piece in pieces if (cut := cut_at(piece, until_s)).time_s.size > 2]
    trusted = _recount_propellant(trusted, -trusted[-1].used_after[-1] if trusted else 0.0)
    return trusted, bool(model.at_stamps) or not is_off_ticks(trusted, model)


def cut_at(stretch: Stretch, time_s: float) -> Stretch:
    """Returns the rows of a stretch before a time, s."""
    return take_rows(stretch, slice(0, int(np.searchsorted(stretch.time_s, time_s))))


def take_rows(stretch: Stretch, rows: slice) -> Stretch:
    """Returns some rows of a stretch, with the commands before them, whose thrust still lags."""
    own = {name: value for name, value in stretch._asdict().items() if name not in _BEFORE and value is not None}
    return prepend_rows(
        stretch._replace(**{name: value[rows] for name, value in own.items()}), stretch, slice(rows.start)
    )


def prepend_rows(shorter: Stretch, stretch: Stretch, rows: slice) -> Stretch:
    """Returns the cut stretch with earlier commands (thrust lags): those before the original, then some of its rows."""
    shorter = shorter._replace(before=_append_rows(stretch.before, stretch.commands[rows]))
    if stretch.onsets_s is None or stretch.before_onsets_s is None:
        return shorter
    return shorter._replace(before_onsets_s=_append_rows(stretch.before_onsets_s, stretch.onsets_s[rows]))


def _append_rows(before: Array, new_rows: Array) -> Array:
    """Appends rows to the commands before a stretch, and drops as many of the oldest."""
    rows = before.shape[0]
    return np.concatenate((before, new_rows[-rows:]))[-rows:]


def _split_at_lost_rates(stretch: Stretch, model: FlightModel) -> Iterator[Stretch]:
    """Yields the pieces of a stretch between holes in which an axis of the rate is not read for long."""
    unread = np.asarray(np.isnan(stretch.readings[:, : model.gyros]).all(axis=1))
    lost, hole = np.asarray(unread.any(axis=1)), _HOLE
    if model.own_times:  # rows of other sensors have no rate
        hole = max(
            _HOLE, math.ceil(_HOLE * model.period_s / float(np.median(np.diff(stretch.time_s)))) if lost.size > 1 else 0
        )
    for first, last in _find_runs(lost):
        if last - first <= hole:
            lost[first:last] = False
    for first, last in _find_runs(~lost):
        yield take_rows(stretch, slice(first, last))


def _split_by_coupling(stretch: Stretch, model: FlightModel) -> Iterator[Stretch]:
    """Yields pieces so short that dynamic coupling does not accumulate rate noise; none if they would be too short."""
    n = stretch.time_s.size
    if n <= 2:
        return
    rates = stretch.readings[:, : model.gyros]
    length_s = float(stretch.time_s[-1] - stretch.time_s[0]) / (n - 1) if model.own_times else model.period_s
    fastest = float(np.nanmax(np.abs(rates), initial=0.0)) * length_s
    rows = n if fastest * math.sqrt(n) <= _ADDED else int((_ADDED / fastest) ** 2)
    if rows >= _SHORTEST:
        for first in range(0, n - 2, rows):
            yield take_rows(stretch, slice(first, min(first + rows + 1, n)))


def is_off_ticks(pieces: Sequence[Stretch], model: FlightModel) -> bool:
    """Tests whether time stamps of any stretch deviate from regular multiples of the sample period."""
    return any(thrust_course.is_off_ticks(piece, model) for piece in pieces)

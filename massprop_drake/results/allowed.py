"""Intervals of the ten parameters that quantized readings allow, and the assumptions that guarantee them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.inputs import params
from massprop_drake.inputs.model import Flag, Real, Text
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.maths import mass_properties
from massprop_drake.maths.estimation.offline import flight_model, intervals, regression
from massprop_drake.maths.estimation.offline.flight_model import FlightModel, Stretch
from massprop_drake.maths.estimation.offline.intervals import Cells, Confined, Solve
from massprop_drake.maths.mass_properties import CENTER_OF_MASS, ELEMENT, MASS_RECIPROCAL
from massprop_drake.maths.vehicle.on_times import has_pulse
from massprop_drake.results.detections import DetectionRecord
from massprop_drake.results.events import EventRecord
from massprop_drake.results.record_stretches import trusted_stretches
from massprop_drake.results.regression_model import make_model
from massprop_drake.results.spool import Spool

Array = NDArray[np.float64]

_QUIET = 0.1  # of a quantum: the largest 1-sigma of noise
_WIDEST = 3.0  # times the widest start: how far from the estimate parameters are sought
_STRETCHES = 4  # evenly spread, that are taken of a long record

_Bound = tuple[Real, Real] | None
_Three = tuple[_Bound, _Bound, _Bound]


class Intervals(NamedTuple):
    """Intervals of the ten parameters that readings allow.

    Attributes:
        inverse_inertia: [low, high] of each element, 3 x 3, 1/(slug-ft^2) or 1/(kg-m^2); None where there is none.
        center_of_mass: likewise, vehicle frame, ft or m.
        mass_reciprocal: likewise, 1/slug or 1/kg.
        best: middle of each, by the same names, which is off by half of the width at most.
        guaranteed: whether there are intervals, and the truth is in them if `given` holds.
        given: what must hold beyond what the scenario takes for exact.
        reason: why there are none; None where there are.
        contradicted: whether no vehicle explains all readings.
        until_s: time of the first failure or jump, up to which readings count, and of which the intervals are; None:
            the end of the run.
    """

    inverse_inertia: tuple[_Three, _Three, _Three]
    center_of_mass: _Three
    mass_reciprocal: _Bound
    best: dict[str, Any]
    guaranteed: Flag
    given: tuple[Text, ...] = ()
    reason: Text | None = None
    contradicted: Flag = False
    until_s: Real | None = None

    @property
    def pairs(self) -> list[_Bound]:
        """Pairs (low, high) of the ten parameters in their order; None where there is no interval."""
        elements = {int(ELEMENT[i, j]): self.inverse_inertia[i][j] for i in range(3) for j in range(3)}
        return [*(elements[index] for index in range(6)), *self.center_of_mass, self.mass_reciprocal]

    def in_words(self) -> str:
        """Describes up to when and on what assumptions the intervals are guaranteed, or why there are none."""
        if self.reason is not None:
            return f"none: {self.reason}"
        before = "" if self.until_s is None else f" before {self.until_s:.2f} s"
        given = f", given {' and '.join(self.given)}" if self.given else ""
        return f"guaranteed by the readings{before}{given}"


def allowed_intervals(
    scenario: Scenario,
    signals: Spool,
    estimate: Array,
    detections: Sequence[DetectionRecord],
    events: Sequence[EventRecord],
    solve: Solve,
) -> Intervals:
    """Finds guaranteed intervals of the ten parameters from quantized readings before the first failure or jump.

    Args:
        scenario: as run.
        signals: with `time_s`, commands and readings.
        estimate: of the ten parameters at the end, NaN where not observed, shape (10,).
        detections: failures and jumps that were declared.
        events: declared besides; readings declared false are left out.
        solve: solves a linear program, see `maths.estimation.offline.intervals`.
    """
    onsets = [
        one.onset_s if one.earliest_s is None else one.earliest_s for one in detections if one.withdrawn_s is None
    ]
    until_s = min(onsets, default=None)
    reason = _reason_unbounded(scenario)
    if reason is not None:
        return _no_intervals(reason, until_s)
    model = make_model(scenario)
    last_s = math.inf if until_s is None else until_s - model.period_s
    pieces, on_ticks = trusted_stretches(scenario, signals, last_s, events, model)
    chosen = [piece for piece in pieces if not np.isnan(piece.readings[:, : model.gyros]).all(axis=(0, 1)).any()]
    chosen = chosen[:: max(-(-len(chosen) // _STRETCHES), 1)]
    if not chosen:
        return _no_intervals("there are too few readings", until_s)
    if not on_ticks:
        return _no_intervals("time stamps scatter about the ticks at which commands switch", until_s)
    if any(piece.onsets_s is not None and has_pulse(piece.commands[:-1], piece.onsets_s[:-1]) for piece in chosen):
        return _no_intervals("jets open and close within samples", until_s)
    cells = _reading_cells(scenario, model)
    begin = model.prior.copy()
    if flight_model.is_physical(estimate):  # NaN is not
        begin[:10] = estimate
    with np.errstate(all="ignore"):
        fit = regression.fit_flight(chosen, begin, model)
        about = fit.at if flight_model.is_physical(fit.at) else model.prior
        try:
            limits = intervals.find_intervals(chosen, about, model, cells, solve)
        except ArithmeticError as error:
            return _no_intervals(str(error), until_s)
    return _make_intervals(limits, _list_assumptions(model, cells, chosen), until_s)


def _reason_unbounded(scenario: Scenario) -> str | None:
    """Returns in words why the readings cannot bound the motion, such as unbounded noise; None: they can."""
    vehicle, joint = scenario.vehicle_data, scenario.estimation.filter == "joint"
    if scenario.estimation.filter == "pose":
        return "sensors in a fixed frame confine nothing"
    if not any(_is_mostly_rounding(package.quantum, package.noise_std) for package in params.gyros(scenario)):
        return "no gyro is quantized with noise of a tenth of its quantum at most"
    if joint and (scenario.joint.rate_walk > 0.0 or scenario.joint.velocity_walk > 0.0):
        return "joint.rate_walk and joint.velocity_walk state torques or forces that no reading confines"
    if vehicle.wheels:
        return "speeds of wheels are read with noise that no reading of a gyro confines"
    if vehicle.engines:
        return "levels and gimbals of engines are read with noise that no reading of a gyro confines"
    if vehicle.tanks:
        return "flows out of tanks are stated with a 1-sigma, and no reading confines them"
    if joint and vehicle.disturbance is not None:
        return "the vehicle's disturbance states torques or forces that no reading confines"
    if any(kind.repeatability > 0.0 for kind in vehicle.jet_kinds.values()):
        return "pulses scatter by the vehicle's repeatability, which no reading confines"
    model = make_model(scenario)
    if model.sigma[flight_model.columns(model).shift].any():
        return "propellant that is used may shift the center of mass; joint.tank_fraction=0 takes it for fixed"
    return None


def _is_mostly_rounding(quantum: float, noise_std: float) -> bool:
    """Tests whether a reading's noise is at most a tenth of its quantum, so that its cell bounds the truth."""
    return quantum > 0.0 and noise_std <= _QUIET * quantum


def _reading_cells(scenario: Scenario, model: FlightModel) -> Cells:
    """Returns the cells of quantized readings: quantum (0: too noisy) and noise by package, biases, search range."""
    setup = params.filter_setup(scenario)
    packages = [*params.gyros(scenario), *params.accelerometers(scenario)]
    quanta, noise = np.array([[package.quantum, package.noise_std] for package in packages]).T
    used = np.array([_is_mostly_rounding(package.quantum, package.noise_std) for package in packages])
    return Cells(np.where(used, quanta, 0.0), noise, setup.gyros.bias_std, _WIDEST * setup.widest)


def _list_assumptions(model: FlightModel, cells: Cells, stretches: Sequence[Stretch]) -> tuple[str, ...]:
    """Lists in words the uncertainties taken as bounds though stated as 1-sigma: thrusts, lags, biases, noise."""
    slices = flight_model.columns(model)
    used = cells.quanta[model.gyros :] > 0.0
    biased = bool(cells.gyro_biases.any()) or bool(model.sigma[slices.acceleration_bias].reshape(-1, 3)[used].any())
    fired = np.any([stretch.commands.any(axis=0) for stretch in stretches], axis=0)
    is_open_by_name = {
        "thrusts": model.sigma[slices.thrust][fired].any(),
        "time constants": model.sigma[slices.lag][model.kinds][fired].any(),
        "biases": biased,
    }
    stated = [what for what, is_open in is_open_by_name.items() if is_open]
    given = [f"{' and '.join(stated)} within {intervals.SIGMAS:g} sigma of what is stated"] if stated else []
    if cells.noise[cells.quanta > 0.0].any():
        given.append(f"noise within {intervals.NOISE_SIGMAS:g} sigma")
    return tuple(given)


def _make_intervals(limits: Confined, assumptions: tuple[str, ...], until_s: float | None) -> Intervals:
    """Converts limits of the ten parameters to named intervals, or to none with the reason."""
    if limits.is_contradicted:
        words = f"no vehicle explains all readings: some are at least {-limits.depth:.2g} quanta beyond their cells"
        return _no_intervals(words, until_s)._replace(contradicted=True, given=assumptions)
    if np.isnan(limits.low).all():
        return _no_intervals("readings leave so much open that the motion is not linear in it", until_s)
    return _intervals_by_name(limits)._replace(given=assumptions, until_s=until_s)


def _intervals_by_name(limits: Confined) -> Intervals:
    """Arranges (low, high) of the ten as matrix, vector and number, with the middle of each interval."""
    pairs = [
        None if math.isnan(low) else (low, high)
        for low, high in zip(limits.low.tolist(), limits.high.tolist(), strict=True)
    ]
    best = [None if pair is None else 0.5 * (pair[0] + pair[1]) for pair in pairs]
    rows = ELEMENT.tolist()
    return Intervals(
        tuple(tuple(pairs[index] for index in row) for row in rows),  # type: ignore[arg-type] # of three by three
        tuple(pairs[CENTER_OF_MASS]),  # type: ignore[arg-type] # of three
        pairs[MASS_RECIPROCAL],
        {
            "inverse_inertia": [[best[index] for index in row] for row in rows],
            "center_of_mass": best[CENTER_OF_MASS],
            "mass_reciprocal": best[MASS_RECIPROCAL],
        },
        guaranteed=any(pair is not None for pair in pairs),
    )


def _no_intervals(reason: str, until_s: float | None) -> Intervals:
    """Returns the result without any interval, with the reason and the time up to which readings counted, s."""
    unknown = np.full(len(mass_properties.NAMES), np.nan)
    return _intervals_by_name(Confined(unknown, unknown, 0.0, 0.0))._replace(reason=reason, until_s=until_s)

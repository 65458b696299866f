"""Sizes that quantities of a vehicle and a run can have, each with its reason, and findings of others.

The fields have them as `Span`, in SI units whatever the units of the file. Rules between fields stand in
`vehicle_checks` and `scenario_checks`. Impossible input is refused when a file is loaded; the rest are doubts, which
`massprop check` shows and a run notes.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import Any, NamedTuple

from massprop_drake.errors import dotted
from massprop_drake.inputs.model import Model, Span, span_of
from massprop_drake.inputs.yaml import FieldPath

GRAVITY = 9.80665  # m/s^2
FOOT, SLUG = 0.3048, 0.45359237 * GRAVITY / 0.3048  # m, kg
# SI value of one US unit, by the SI unit
_US = {
    **{"m": FOOT, "m/s": FOOT, "m/s^2": FOOT, "kg": SLUG, "kg/s": SLUG, "N": SLUG * FOOT, "kg-m^2": SLUG * FOOT**2},
    "N-m": SLUG * FOOT**2,
}

MASS = Span(1e-3, 1e9, "from a satellite on a chip to a thousand space stations")
INERTIA = Span(0.0, 1e15, "that of the heaviest mass, a kilometer wide")
POSITION = Span(0.0, 1e3, "no structure is longer than a kilometer")
SIZE = Span(1e-6, 1e4, "it is to be drawn")
FORCE = Span(1e-9, 1e9, "from a colloid thruster to a heavy launcher")
FLOW = Span(1e-15, 1e6, "that of such thrusters")
SPECIFIC_IMPULSE = Span(1.0, 3e4, "cold gas gives tens of seconds, chemical jets hundreds, ion thrusters up to 20 000")
PERIOD = Span(
    1e-4, 100.0, "no valve acts within less, and in more a vehicle turns too far for rates to count as steady"
)
FREQUENCY = Span(1e-4, 1e4, "from a fix every few hours to the fastest inertial sensors")
VALVE = Span(1e-6, 1e4, "no valve is faster; 0: instantaneous")
WHEEL = Span(1e-10, 1e9, "from the wheel of a satellite on a chip to that of a space station")
SPIN = Span(1e-3, 1e5, "from a wheel that hardly turns to one that bursts")
SPEED_STEP = Span(1e-9, 1e3, "a revolution is counted in finer steps than that")
SWING = Span(1e-6, 1e4, "from propellant that drifts in orbit to the ringing of a plate")
RATE_STEP = Span(1e-13, 1e3, "from the largest ring lasers to the speed of a turbine")
RATE = Span(0.0, 1e4, "a vehicle or gyro that turns faster bursts")
VELOCITY_STEP = Span(1e-16, 1e3, "from drag-free test masses to all that jets give a vehicle")
VELOCITY = Span(0.0, 3e8, "the speed of light")
ACCELERATION = Span(0.0, 100.0 * GRAVITY, "a hundred times the weight on Earth")
UNCERTAINTY = Span(1e-9, 10.0, "less is beyond any scale, more says nothing")
LEAK = Span(0.0, 1e9, FORCE.why)
PAYLOAD = Span(0.0, MASS.most, MASS.why)
DRIFT = Span(0.0, 100.0, "faster is a failure at once")
GAIN = Span(0.0, 1e3, "a loop of jets is slower")
SCALE = Span(0.0, 2.0, "-2 turns a reading round")
BANDWIDTH = Span(1e-6, 1e9, "from a week to what is no limit")
TONE = Span(1e-6, 1e6, "no structure carries a faster vibration")
OUTSIDE_FORCE = Span(0.0, FORCE.most, FORCE.why)
OUTSIDE_TORQUE = Span(0.0, FORCE.most * POSITION.most, "the largest force at the longest arm")
CORRELATION = Span(1e-6, 1e9, "thirty years; shorter than a sample it is white")
ACCURACY = Span(1e-13, 1e-2, "an integrator gets no closer with numbers of 16 digits, and less close shows")
TIME = Span(0.0, 1e9, "thirty years")


class Finding(NamedTuple):
    """Input that is impossible, or doubtful.

    Attributes:
        path: of the field.
        problem: what is wrong, and why.
        impossible: refused; otherwise a doubt.
    """

    path: FieldPath
    problem: str
    impossible: bool

    def __str__(self) -> str:
        return f"{dotted(self.path)}: {self.problem}"


def finding_above(value: float, doubt: float, limit: float, path: FieldPath, problem: str) -> Iterator[Finding]:
    """Yields a doubt where a value is above `doubt`; an impossible finding where it is also above `limit`."""
    if not value <= doubt:  # nor a number
        yield Finding(path, problem, not value <= limit)


# ------------------------------------------------------------------------------------- single keys


def out_of_span(model: Model, units: str, path: FieldPath = (), skipped: tuple[str, ...] = ()) -> Iterator[Finding]:
    """Yields a finding for each number of a model, and of all models in it, that lies outside its `Span`.

    Args:
        model: a vehicle, a scenario, or a part of one.
        units: the unit system, "us" or "si".
        path: of the model.
        skipped: fields to leave out.
    """
    for name, span, unit in _spans(type(model)):
        if name in skipped:
            continue
        field_path, value = (*path, name), getattr(model, name)
        if span is not None:
            yield from compare_with_span(value, span, unit, units, field_path)
        else:
            for inside, part in _nested_models(value, field_path):
                yield from out_of_span(part, units, inside)


@cache
def _spans(model: type[Model]) -> list[tuple[str, Span | None, str]]:
    """Lists name, span (None: none) and SI unit of each field of a model class."""
    return [(name, *span_of(field)) for name, field in model.model_fields.items()]


def compare_with_span(value: Any, span: Span, unit: str, units: str, path: FieldPath) -> Iterator[Finding]:
    """Yields an impossible finding for each number of a value, or of a nested tuple, outside a span."""
    if isinstance(value, tuple):
        for index, part in enumerate(value):
            yield from compare_with_span(part, span, unit, units, (*path, index))
    elif value:
        in_si = value * unit_in_si(unit, units)
        name = "" if unit == "-" else f" {unit}"
        side, bound = ("below", span.least) if abs(in_si) < span.least else ("above", span.most)
        if not span.least <= abs(in_si) <= span.most:
            text = f"{value:g}" if in_si == value else f"{value:g}, in SI units {in_si:.4g}"
            size = "of a size " if value < 0.0 else ""
            yield Finding(path, f"{text}{name}, is {size}{side} {bound:g}{name}: {span.why}", True)


def unit_in_si(unit: str, units: str) -> float:
    """Returns the SI value of one unit in the unit system "us" or "si", by the name of the SI unit."""
    return _US.get(unit, 1.0) if units == "us" else 1.0


def _nested_models(value: Any, path: FieldPath) -> Iterator[tuple[FieldPath, Model]]:
    """Yields path and model for a value that is a model, or for each model in its mappings and tuples."""
    if isinstance(value, Model):
        yield path, value
    elif isinstance(value, (dict, tuple)):
        for key, part in value.items() if isinstance(value, dict) else enumerate(value):
            yield from _nested_models(part, (*path, key))

"""Tables of a run: the ten parameters and derived ones, intervals, a comparison of a record with a simulation.

Terminal and page render the same sheets.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from massprop_drake.maths import mass_properties
from massprop_drake.maths.estimation.offline.identifiability import Flag
from massprop_drake.maths.mass_properties import (
    CENTER_OF_MASS,
    INVERSE_INERTIA,
    MASS_RECIPROCAL,
    product_floors,
    six_elements,
)
from massprop_drake.maths.signals import SYMBOLS, mass_property_units
from massprop_drake.results.against import Against
from massprop_drake.results.summary import NearZeroParameter, Parameter, Summary

_INERTIA = ("Ixx", "Iyy", "Izz", "Iyz", "Ixz", "Ixy")
_NOTHING = 1e-3  # of a 1-sigma, below which it gives the power of ten
IN_THREE_SIGMA, KNOWN, LEAST_SIGMA = "in 3 sigma", "known", "least 1-sigma"  # headings
_PLAIN = 1e-3, 1e5  # magnitudes that are written without a power of ten


class Row(NamedTuple):
    """Row of a quantity in words; "-" for what is not known.

    Attributes:
        symbol: of it.
        unit: with the power of ten of the numbers of the row, such as 1e-9/(slug-ft^2).
        estimate, truth, sigma: to two digits of the 1-sigma and to six of their own at the most.
        error: of the estimate, percent of the truth, with its sign.
        percent: the 1-sigma in percent of the estimate.
        inside: "yes" or "no": whether the estimate lies within 3 sigma of the truth; "not excited" where it does
            because the flight has hardly touched it.
        flag: what the flight has told of it, in words; empty for what follows.
        bound: least 1-sigma that the flight allows for rounding taken as noise; "-" where it is not known.
    """

    symbol: str
    unit: str
    estimate: str
    truth: str
    error: str
    sigma: str
    percent: str
    inside: str = "-"
    flag: str = ""
    bound: str = "-"


class Sheet(NamedTuple):
    """Table of results, which terminal and page render.

    Attributes:
        headings: of the columns, with a line break where a narrow column needs one.
        rows: a cell for each column.
        words: headings of the columns that are no numbers.
    """

    headings: tuple[str, ...]
    rows: list[tuple[str, ...]]
    words: tuple[str, ...] = ("parameter", "unit")


def parameter_sheets(results: Summary, units: Mapping[str, str], *, with_truth: bool = True) -> tuple[Sheet, Sheet]:
    """Makes two tables: of mass, center of mass and inertia; of inverse inertia and 1/m, with known bounds."""
    first, rest = property_rows(results, units, with_truth=with_truth)
    bounded = any(row.bound != "-" for row in rest)
    return _make_sheet(first, with_truth, with_bound=False), _make_sheet(rest, with_truth, with_bound=bounded)


def _make_sheet(rows: list[Row], with_truth: bool, *, with_bound: bool) -> Sheet:
    """Arranges rows as a table, with or without columns of true value and error, and of the least 1-sigma."""
    columns = {
        "symbol": "parameter",
        "unit": "unit",
        "estimate": "estimate",
        **({"truth": "truth", "error": "error %"} if with_truth else {}),
        "sigma": "1-sigma",
        "percent": "1-sigma %",
        **({"inside": IN_THREE_SIGMA} if with_truth else {}),
        "flag": KNOWN,
        **({"bound": LEAST_SIGMA} if with_bound else {}),
    }
    cells = [tuple(getattr(row, name) for name in columns) for row in rows]
    return Sheet(tuple(columns.values()), cells, ("parameter", "unit", IN_THREE_SIGMA, KNOWN))


def parameter_rows(results: Summary, units: Mapping[str, str], *, with_truth: bool = True) -> list[Row]:
    """Formats the ten parameters as table rows: estimate, truth, error, 1-sigma and identifiability flag.

    Args:
        results: of a run.
        units: of the vehicle, as `Vehicle.unit_names`.
        with_truth: whether any true value is known.
    """
    entries = {entry.parameter: entry for entry in results.identifiability}
    rows = []
    for symbol, unit, parameter in zip(SYMBOLS, mass_property_units(dict(units)), results.parameters, strict=True):
        entry = entries.get(parameter.name)
        flag, bound = ("", None) if entry is None else (entry.flag, entry.bound)
        if math.isnan(parameter.estimate):
            power = _power_of_ten(parameter.truth if with_truth else math.nan)
            true = _format_scaled(parameter.truth, math.nan, power)
            row = Row(symbol, _unit_with_power(unit, power), "not observable", true, "-", "-", "-")
        else:
            row = _parameter_row(symbol, unit, parameter)
            inside = "yes" if parameter.within_three_sigma else "no"
            if flag == Flag.FIXED:
                inside, row = "fixed", row._replace(error="-")
            row = row._replace(inside="not excited" if flag == "not_excited" and inside == "yes" else inside)
            if bound is not None:
                power = _power_of_ten(_larger_magnitude(parameter), parameter.truth)
                row = row._replace(bound=_format_scaled(bound, bound, power))
        rows.append(row._replace(flag=flag.replace("_", " ")))
    return rows


def derived_rows(results: Summary, units: Mapping[str, str]) -> list[Row]:
    """Formats mass and the elements of inertia, derived from the estimates, as table rows."""
    derived, true = results.derived, mass_properties.derive_mass_and_inertia(results.truth, np.zeros((10, 10)))
    rows = [_derived_row("m", units["mass"], (derived.mass, derived.mass_std, true.mass))]
    if derived.inertia is not None and derived.inertia_std is not None:
        unit = f"{units['mass']}-{units['length']}^2"
        unknown = np.full((3, 3), np.nan) if true.inertia is None else true.inertia
        columns = [six_elements(matrix) for matrix in (derived.inertia, derived.inertia_std, unknown)]
        floors = [np.append(np.zeros(3), product_floors(columns[number][:3])) for number in (0, 2)]
        for name, values, least in zip(_INERTIA, np.transpose(columns), np.transpose(floors), strict=True):
            rows.append(_derived_row(name, unit, tuple(values.tolist()), tuple(least.tolist())))
    return rows


def property_rows(
    results: Summary, units: Mapping[str, str], *, with_truth: bool = True
) -> tuple[list[Row], list[Row]]:
    """Returns the rows of mass, center of mass and inertia, and those of inverse inertia and 1/m."""
    ten, (mass, *inertia) = parameter_rows(results, units, with_truth=with_truth), derived_rows(results, units)
    elements, reciprocal = ten[INVERSE_INERTIA], ten[MASS_RECIPROCAL]
    unsure = [row.flag for row in elements if row.flag != Flag.IDENTIFIED] or [row.flag for row in elements]
    first = [mass._replace(inside=reciprocal.inside, flag=reciprocal.flag), *ten[CENTER_OF_MASS]]
    return [*first, *(row._replace(flag=unsure[0]) for row in inertia)], [*elements, reciprocal]


def interval_sheet(results: Summary, units: Mapping[str, str]) -> Sheet:
    """Makes the table of guaranteed intervals: low, middle, high, and whether the estimate is inside.

    Low is rounded down and high is rounded up, to two digits of half of the width.

    Args:
        results: of a run, with intervals.
        units: of the vehicle, as `Vehicle.unit_names`.
    """
    rows: list[tuple[str, ...]] = []
    assert results.intervals is not None
    columns = zip(SYMBOLS, mass_property_units(dict(units)), results.intervals.pairs, results.parameters, strict=True)
    for symbol, unit, pair, parameter in columns:
        if pair is None:
            rows.append((symbol, unit, "-", "-", "-", "-"))
            continue
        low, high = pair
        power = _power_of_ten(max(abs(low), abs(high)))
        digits = max(0, 1 - math.floor(math.log10(0.5 * (high - low) / 10.0**power)))
        step = 10.0 ** (power - digits)
        ends = (math.floor(low / step), round(0.5 * (low + high) / step), math.ceil(high / step))
        texts = [f"{end / 10.0**digits:.{digits}f}" for end in ends]
        inside = "-" if math.isnan(parameter.estimate) else "yes" if low <= parameter.estimate <= high else "no"
        rows.append((symbol, _unit_with_power(unit, power), *texts, inside))
    inside = "estimate\ninside"
    return Sheet(("parameter", "unit", "low", "middle", "high", inside), rows, ("parameter", "unit", inside))


def residual_sheet(comparison: Against) -> Sheet:
    """Makes the table of readings minus simulated ones, by signal: RMS, largest value, its time, and noise."""
    rows: list[tuple[str, ...]] = []
    for one in comparison.residuals:
        power = _power_of_ten(one.rms if one.rms and one.rms > _NOTHING * one.noise else one.noise)
        size, largest, noise = (
            "-" if value is None else f"{value / 10.0**power:.4g}" for value in (one.rms, one.largest, one.noise)
        )
        when = "-" if one.largest_s is None else f"{one.largest_s:.2f} s"
        rows.append((one.signal, _unit_with_power(one.unit, power), size, largest, when, noise))
    headings = ("signal", "unit", "RMS\ndifference", "largest", "at", "1-sigma of\na reading")
    return Sheet(headings, rows, ("signal", "unit"))


def cause_sheet(comparison: Against) -> Sheet:
    """Makes the table of unknowns that explain differences: size, 1-sigma, share alone and with those above."""
    rows: list[tuple[str, ...]] = []
    for cause in comparison.causes:
        power = _power_of_ten(cause.size)
        size, deviation = (_format_scaled(value, cause.size_std, power) for value in (cause.size, cause.size_std))
        sign = "+" if cause.size >= 0.0 else ""
        shares = (f"{100.0 * share:.1f} %" for share in (cause.alone, cause.together))
        rows.append((cause.what, f"{sign}{size} ± {deviation}", _unit_with_power(cause.unit, power), *shares))
    headings = ("cause", "off by", "unit", "explains\nalone", "with those\nabove")
    return Sheet(headings, rows, ("cause", "unit"))


def _derived_row(
    name: str, unit: str, numbers: tuple[float | None, ...], floors: tuple[float, ...] = (0.0, 0.0)
) -> Row:
    """Formats a derived (value, 1-sigma, truth) as a row; value and truth below their floors count as zero."""
    value, deviation, true = (math.nan if parameter is None else parameter for parameter in numbers)
    fixed = deviation == 0.0
    error = 100.0 * (value - true) / abs(true) if abs(true) > floors[1] and not fixed else math.nan
    kind = NearZeroParameter if abs(value) <= floors[0] else Parameter
    parameter = kind(name, value, math.nan if fixed else deviation, true, error)
    row = _parameter_row(name, unit, parameter)
    if fixed:
        return row._replace(inside="fixed")
    return row if math.isnan(true - value) else row._replace(inside="yes" if parameter.within_three_sigma else "no")


def _parameter_row(symbol: str, unit: str, parameter: Parameter) -> Row:
    """Formats estimate, truth, error and 1-sigma of a parameter as a row, with one power of ten."""
    power = _power_of_ten(_larger_magnitude(parameter), parameter.truth)
    numbers = (parameter.estimate, parameter.truth, parameter.standard_deviation)
    estimate, truth, sigma = (_format_scaled(number, parameter.standard_deviation, power) for number in numbers)
    error, percent = _format_percent(parameter.percent_error, "+"), _format_percent(parameter.percent_deviation)
    return Row(symbol, _unit_with_power(unit, power), estimate, truth, error, sigma, percent)


def _larger_magnitude(parameter: Parameter) -> float:
    """Returns the larger of |estimate| and 1-sigma, ignoring NaN; NaN if both are."""
    return float(np.fmax(abs(parameter.estimate), parameter.standard_deviation))


def _power_of_ten(*values: float) -> int:
    """Returns the exponent, a multiple of three, to write values with, by the first nonzero one; 0 for plain."""
    size = next((abs(value) for value in values if value and math.isfinite(value)), 1.0)
    return 0 if _PLAIN[0] <= size < _PLAIN[1] else 3 * math.floor(math.log10(size) / 3.0)


def _unit_with_power(unit: str, power: int) -> str:
    """Prefixes a unit with a power of ten: '1e-6/(slug-ft^2)', '1e3 slug-ft^2'."""
    return unit if not power else f"1e{power}{unit.removeprefix('1')}" if unit.startswith("1/") else f"1e{power} {unit}"


def _format_scaled(value: float, deviation: float, power: int) -> str:
    """Formats a value over 10^power to two digits of its 1-sigma, at most six significant; "-" for NaN."""
    if math.isnan(value):
        return "-"
    scaled, digits = value / 10.0**power, 6
    if deviation > 0.0 and math.isfinite(deviation):
        digits = 1 - math.floor(math.log10(deviation / 10.0**power))
    if value:
        digits = min(digits, 5 - math.floor(math.log10(abs(scaled))))
    return f"{scaled:.{max(0, digits)}f}"


def _format_percent(value: float, sign: str = "") -> str:
    """Formats a percentage; '-' for NaN."""
    if math.isnan(value):
        return "-"
    return f"{value:{sign}.4f}" if abs(value) < 1e4 else f"{value:{sign}.2e}"

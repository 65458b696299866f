"""Warnings of a record's quality, in words."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from massprop_drake.errors import counted, moment
from massprop_drake.inputs import factors
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.inputs.vehicle_sensors import Accelerometer
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.signals import SYMBOLS, fill_unit_template
from massprop_drake.records.quality_measures import Package, could_be_off_nominal, format_stretch, likely_cause

LISTED = 5  # of each kind, in warnings
_PERIOD_DIFFERS = 0.005  # of the sample period


class KnownOfRecord(NamedTuple):
    """Knowledge of a record and its estimation beside the summary's `data_quality`.

    Attributes:
        vehicle, filter: of the scenario.
        packages: sensors in their order.
        accelerometers: their names, the one in use first.
        at_stamps, own_times: how commands switch, and whether sensors are read at times of their own.
        weighs, detects: whether the filter estimates the mass, and whether a detector is on.
        tested: samples that were tested for failed jets.
        n_stuck: stretches in which a sensor stands still.
        limits: of convergence, shape (3,).
        estimate, deviation: of the ten parameters at the end, shape (10,) each.
        about_commands: warnings of unknown commands.
    """

    vehicle: Vehicle
    filter: str
    packages: Sequence[Package]
    accelerometers: Sequence[str]
    at_stamps: bool
    own_times: bool
    weighs: bool
    detects: bool
    tested: int
    n_stuck: int
    limits: Array
    estimate: Array
    deviation: Array
    about_commands: Sequence[str]


def warnings_of(quality: dict[str, Any], known: KnownOfRecord) -> list[str]:
    """Returns the warnings on a record's quality, a sentence each, from its measures."""
    return [
        *_unit_warnings(quality, known),
        *_row_warnings(quality, known),
        *_sensor_warnings(quality, known),
        *_sample_warnings(quality, known),
        *known.about_commands,
        *_test_warnings(known),
    ]


def _test_warnings(known: KnownOfRecord) -> list[str]:
    """Returns a sentence on why no sample was tested for failed jets; empty if any was, or no detector is on."""
    if known.tested or not known.detects:
        return []
    diagonal, center, reciprocal = known.limits.tolist()
    relative = np.append(np.full(3, diagonal), reciprocal)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = known.deviation / np.abs(known.estimate)
    texts = [
        f"{SYMBOLS[element]} is known to {100.0 * share[element]:.2g} % ({100.0 * limit:.2g} % is asked)"
        for element, limit in zip((0, 1, 2, 9), relative, strict=True)
        if not share[element] < limit
    ]
    length = known.vehicle.unit_names["length"]
    texts += [
        f"{SYMBOLS[element]} to {known.deviation[element]:.2g} {length} ({center:.2g} {length})"
        for element in (6, 7, 8)
        if not known.deviation[element] < center
    ]
    why = f": {'; '.join(texts)}" if texts else ""
    return [
        f"no sample was tested for failed jets, since the estimates did not converge{why}; it takes a "
        "record that excites them, or wider limits in estimation.convergence"
    ]


def _unit_warnings(quality: dict[str, Any], known: KnownOfRecord) -> list[str]:
    """Returns warnings of readings out of proportion to the prediction: a wrong unit, or jets that fail."""
    warnings = []
    blamed: dict[tuple[str, ...], list[str]] = {}
    for entry in known.packages:
        name = entry.package.name
        if name not in quality["units"]:
            continue
        slope, jets = quality["units"][name]["slope"], quality["units"][name].get("jets")
        if could_be_off_nominal(slope) or "slope_before_failure" in quality["units"][name]:
            continue
        if jets:
            blamed.setdefault(tuple(jets), []).append(name)
            continue
        unit, known_factors = "rad/s", factors.rate_factors(known.vehicle.sample_period_s)
        if isinstance(entry.package, Accelerometer):
            unit = fill_unit_template("{length}/s", known.vehicle.unit_names)
            known_factors = factors.velocity_factors(known.vehicle.units, known.vehicle.sample_period_s)
        warnings.append(
            f"{name} changes by {slope:.3g} times what the nominal mass properties predict; it must be in {unit}, "
            f"body axes{likely_cause(slope, known_factors)}"
        )
    warnings += [
        f"{', '.join(names)} {'follow' if len(names) > 1 else 'follows'} what is predicted but while "
        f"{' or '.join(jets)} {'is' if len(jets) == 1 else 'are'} told to fire: look there for a failure"
        for jets, names in blamed.items()
    ]
    return warnings


def _row_warnings(quality: dict[str, Any], known: KnownOfRecord) -> list[str]:
    """Returns warnings of gaps, jitter, a wrong sample period, rows left out, and unused columns."""
    warnings = []
    gaps = quality["gaps"]
    if gaps["count"]:
        first = gaps["first"][0]
        warnings.append(
            f"{counted(gaps['count'], 'gap')} in time, {gaps['longest_s']:.6g} s the longest, the first after "
            f"{moment(first['time_s'])} s; estimates are kept over it"
        )
    period, nominal = quality["sample_period_s"], known.vehicle.sample_period_s
    if known.filter == "joint" and quality["jitter"]["count"] and not known.own_times:
        regular = "at regular ticks, found from the stamps; where they do at these, set joint.switching=stamps"
        text = f"commands are taken to switch {'at the stamps' if known.at_stamps else regular}"
        warnings.append(
            f"{counted(quality['jitter']['count'], 'interval')} between rows off the sample period, by "
            f"{quality['jitter']['largest_s']:.2g} s at the most: {text}"
        )
    if known.filter == "thesis" and period is not None and abs(period - nominal) > _PERIOD_DIFFERS * nominal:
        warnings.append(f"rows are {period:.6g} s apart on average, not {nominal:g} s: forces seem off by as much")
    late = quality["duplicates"] + quality["backward"]
    if late:
        warnings.append(f"{counted(late, 'row')} left out whose time does not go on")
    if quality["without_time"]:
        warnings.append(f"{counted(quality['without_time'], 'row')} left out that have no time")
    for name, similar in quality["unknown_columns"].items():
        if similar is not None:
            warnings.append(f"column '{name}' is not used; is '{similar}' meant?")
    return warnings


def _actuator_warnings(quality: dict[str, Any], known: KnownOfRecord) -> list[str]:
    """Returns warnings of engines and wheels of the vehicle that the record has no columns for."""
    warnings, absent = list[str](), quality["absent_sensors"]
    for engine in known.vehicle.engines:
        if engine.name in absent:
            warnings.append(f"the record has no {engine.columns[0]}: engine {engine.name} counts as shut")
    unread = [column for wheel in known.vehicle.wheels if wheel.name in absent for column in wheel.columns]
    if unread:
        warnings.append(
            f"the record has no {', '.join(unread)}: what these wheels do turns the vehicle untold, and hides the rest"
        )
    return warnings


def _sensor_warnings(quality: dict[str, Any], known: KnownOfRecord) -> list[str]:
    """Returns warnings of readings that are missing, stuck, repeated, saturated or jump."""
    warnings = []
    for name, count in quality["missing"].items():
        if count:
            warnings.append(f"{name} is missing in {counted(count, 'row')}")
    if not known.weighs:
        warnings.append("the vehicle has no accelerometer: its mass is not observable")
    elif known.accelerometers and set(known.accelerometers) <= set(quality["absent_sensors"]):
        warnings.append("the record has no accelerometer: the mass is not observable in it")
    warnings += _actuator_warnings(quality, known)
    for entry in quality["unanswered"][:LISTED]:
        warnings.append(
            f"{', '.join(entry['jets'])} told to fire {format_stretch(entry)}, but no "
            f"sensor shows it: jets that did not fire, not sensors that stood still"
        )
    for entry in quality["stuck"][:LISTED]:
        warnings.append(
            f"{entry['sensor']}_{entry['axis']} stands still {format_stretch(entry)} "
            f"while the jets commanded should change it by {entry['predicted_change']:.3g}"
        )
    if known.n_stuck > LISTED:
        warnings.append(f"and {known.n_stuck - LISTED} more times a sensor stands still")
    for name, repeated in quality["repeated"].items():
        warnings.append(
            f"{name} repeats its reading in {repeated['count']} of {repeated['of']} samples in which the jets "
            "commanded should have changed it: what has not been read anew tells nothing new, but counts as if it "
            "did; leave such cells empty, or say `every` of it in a map"
        )
    for name, count in quality["saturated"].items():
        if count:
            warnings.append(f"{name} is at the end of its range in {counted(count, 'row')}")
    for name, jump in quality["jumps"].items():
        warnings.append(
            f"{name} jumps {counted(jump['count'], 'time')} by more than all jets could cause in a sample, first at "
            f"{moment(jump['first_s'])} s, the most {jump['largest']:.3g}"
        )
    return warnings


def _sample_warnings(quality: dict[str, Any], known: KnownOfRecord) -> list[str]:
    """Returns a warning for each filter that could use no sample, with the commonest reason."""
    names = {"rotation": "inverse inertia and center of mass", "mass": "mass"}
    warnings = []
    for name, counts in quality["samples"].items():
        if counts["used"]:
            continue
        worst = max(list(counts)[1:], key=lambda reason: counts[reason])
        warnings.append(
            f"no sample could be used for {names[name]}: they are as they were at the start; most often "
            f"({counts[worst]} times) the reason was: {worst.replace('_', ' ')}"
        )
    return warnings

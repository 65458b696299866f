"""Remarks on the command delay of a vehicle that is tracked in a fixed frame."""

from __future__ import annotations

from massprop_drake.inputs.scenario import Scenario
from massprop_drake.results.spool import Spool

_SIGMAS = 3.0
_SAMPLES = 0.5  # by which a delay is off that is worth a word


def remarks(scenario: Scenario, signals: Spool) -> list[str]:
    """Returns a sentence if the command delay is off the vehicle's by over 3 sigma and half a sample, else []."""
    if "command_delay" not in signals:
        return []
    vehicle = scenario.vehicle_data
    name, kind = next(iter(vehicle.jet_kinds.items()))
    delay, deviation = (float(signals.last(signal)[0]) for signal in ("command_delay", "command_delay_std"))
    difference_s = abs(delay - kind.command_delay_s)
    if difference_s <= max(_SIGMAS * deviation, _SAMPLES * vehicle.sample_period_s):
        return []
    return [
        f"jets of kind '{name}' act {delay:.3f} ± {deviation:.3f} s after their commands, and the vehicle's file says "
        f"{kind.command_delay_s:g} ± {kind.command_delay_std_s:g} s"
    ]

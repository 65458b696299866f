"""Disturbances and vibrations in a scenario's file: what is refused, what is doubted, in both systems of units."""

from __future__ import annotations

import pytest

from massprop_drake.errors import InputError
from massprop_drake.inputs.scenario import load_scenario

TONE = "sensors.errors=[{sensor: gyro, vibration: [{frequency_hz: %s, amplitude: %s}]}]"


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("plant.disturbance.torque_std=[-1, 0, 0]", "plant.disturbance.torque_std: must be zero or positive"),
        ("plant.disturbance.force_std=[0, -1, 0]", "plant.disturbance.force_std: must be zero or positive"),
        ("plant.disturbance.torque=[1.0e14, 0, 0]", "in SI units 1.356e+14 N-m, is above 1e+12 N-m"),
        ("plant.disturbance.correlation_time_s=0", "correlation_time_s: input should be greater than 0"),
        ("plant.disturbance.torqe=[0, 0, 0]", "plant.disturbance.torqe: unknown key; did you mean 'torque'?"),
        (TONE % (0, [1, 1, 1]), "sensors.errors[0].vibration[0].frequency_hz: input should be greater than 0"),
        (TONE % (3, [1.0e9, 1, 1]), "sensors.errors[0].vibration[0].amplitude[0]: 1e+09 rad/s, is above"),
    ],
)
def test_what_cannot_be_is_refused(override: str, message: str) -> None:
    with pytest.raises(InputError) as error:
        load_scenario("jet_pulses", [override])
    assert message in str(error.value)


@pytest.mark.parametrize(
    ("name", "units"), [("jet_pulses", ("ft-lbf", "lbf")), ("small_satellite_maneuver", ("N-m", "N"))]
)
def test_a_disturbance_that_no_jet_can_hold_is_doubted(name: str, units: tuple[str, str]) -> None:
    for field, unit in zip(("torque", "force"), units, strict=True):
        (doubt,) = load_scenario(name, [f"plant.disturbance.{field}_std=[1.0e6, 0, 0]"]).doubts
        assert doubt.path == ("plant", "disturbance", field)
        assert f"1e+06 {unit}, and the strongest jet gives" in doubt.problem
    assert load_scenario(name).doubts == []

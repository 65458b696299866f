"""The mass of a vehicle whose thrusts are known, by the estimator in a fixed frame."""

from __future__ import annotations

import numpy as np
import pytest

from massprop_drake.inputs.params import estimation_params
from massprop_drake.inputs.scenario import resolve_scenario
from massprop_drake.inputs.vehicle_file import Vehicle, load_vehicle
from massprop_drake.maths.estimation.pose.outcome import estimated_properties


@pytest.mark.parametrize("known", [1, 8])
def test_known_thrusts_tell_the_mass(known: int) -> None:
    data = load_vehicle("air_bearing").model_dump(mode="json") | {"common_scale_uncertainty": 0.0}
    for jet in data["jets"][:known]:
        jet["thrust_uncertainty"] = 0.0
    scenario = resolve_scenario({"name": "known", "vehicle": Vehicle.model_validate(data)})
    params = estimation_params(scenario).filter_params.pose
    mean = params.start.copy()
    mean[:known] = 1.1  # what each of them accelerates over nominal; of the others nothing is read
    values, _ = estimated_properties(mean, params.covariance, np.ones(8, dtype=bool), params)
    assert 23.09 * values[9] == pytest.approx(1.1, rel=1e-9)

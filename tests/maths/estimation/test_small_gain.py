"""The thesis's variance after a jump of the mass reciprocal, as a choice."""

from __future__ import annotations

import numpy as np
import pytest

from massprop_drake import load_scenario
from massprop_drake.inputs import params
from massprop_drake.maths.estimation.adaptation import NO_ADAPTATION
from massprop_drake.maths.estimation.filters.mass_filter import MassParams, MassSample, MassState, innovate, update
from massprop_drake.maths.estimation.filters.mass_jump import empty_window


def always(jump: str) -> MassParams:
    chosen = params.mass_params(load_scenario("sample_maneuver", [f"mass.jump={jump}"]))
    return chosen._replace(jump_threshold=0.0, jump_variance=1.0)


@pytest.mark.parametrize(("gain", "ratio"), [(0.8, 7.4), (0.004, 1.016)])
def test_variance_over_that_of_the_sample_alone(gain: float, ratio: float) -> None:
    # lambda = (0, 0, 2), R' = 4: the sample alone has variance 1, gain g means a prior variance of g / (1 - g);
    # the thesis: 3 (1 - g) g / (1 - g) + Y / 4 with Y = 4 / (1 - g)
    variance = gain / (1.0 - gain)
    state = MassState(0.3, variance, empty_window(1))
    sample = MassSample(np.array([0.0, 0.0, 1.0]), 4.0 * np.eye(3), np.array([0.0, 0.0, 2.0]))
    exact, thesis = (
        update(state, sample, innovate(state, sample), NO_ADAPTATION, always(jump)).state
        for jump in ("single_sample", "single_sample_thesis")
    )
    assert exact.variance == pytest.approx(1.0, rel=1e-12)
    assert thesis.variance == pytest.approx(3.0 * gain + 1.0 / (1.0 - gain), rel=1e-12)
    assert thesis.variance == pytest.approx(ratio, rel=1e-3)
    assert thesis.mass_reciprocal == exact.mass_reciprocal


def test_only_the_choice_changes() -> None:
    changed, default = (
        params.mass_params(load_scenario("sample_maneuver", [f"mass.jump={jump}"]))
        for jump in ("single_sample_thesis", "single_sample")
    )
    assert changed.small_gain
    assert not default.small_gain
    assert changed.jump_threshold == default.jump_threshold
    assert changed.jump_window == default.jump_window

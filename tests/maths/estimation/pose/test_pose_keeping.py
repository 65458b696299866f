"""Hypotheses and commands as a vector: all of it comes back, and what no run leaves is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pose_probe import JETS, small_params, some_bank

from massprop_drake.maths.estimation.pose import keeping, pose_hypotheses
from massprop_drake.maths.estimation.pose.pose_cycle import Doubt
from massprop_drake.maths.estimation.pose.pose_hypotheses import Tried
from massprop_drake.maths.estimation.pose.pose_layout import Commands, PoseParams


def _some() -> tuple[Tried, Commands, PoseParams]:
    params = small_params()
    bank = some_bank(params, opens=(-1,))
    bank = bank._replace(covariance=0.5 * (bank.covariance + np.swapaxes(bank.covariance, 1, 2)))
    first = pose_hypotheses.begun(bank, 1.0, params)
    likelihood = first.likelihood.copy()
    likelihood[3] = -np.inf
    count = likelihood.size
    first = first._replace(likelihood=likelihood, led_s=2.5, leader=4, steady=3, total=-12.5)
    first = first._replace(apart=np.arange(float(count**2)).reshape(count, count))
    second = first._replace(doubt=Doubt(first.bank, np.linspace(0.0, 1.0, count)), apart=None, total=-20.0)
    third = pose_hypotheses.alone(bank, np.zeros(1 + 2 * JETS), 1.0)
    levels = np.array([[0.0, 1.0, np.nan, 0.5], [1.0, 0.0, 0.0, 0.0]])
    return first._replace(elsewhere=(second, third)), Commands(np.array([0.7, 0.9]), levels), params


def _same(one: Any, other: Any) -> None:
    if isinstance(one, tuple):
        assert len(one) == len(other)
        for own, its in zip(one, other, strict=True):
            _same(own, its)
    elif one is None:
        assert other is None
    else:
        np.testing.assert_array_equal(one, other)


def test_all_of_it_comes_back_to_the_bit() -> None:
    tried, commands, params = _some()
    _same((tried, commands), keeping.unpacked(keeping.packed(tried, commands), params))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda vector: vector[:-1], "hypotheses are cut short"),
        (lambda vector: np.append(-1.0, vector[1:]), "hypotheses must be counted by whole numbers"),
        (lambda vector: np.concatenate((vector[:1], [0.0], vector[2:12])), "hypotheses are of another number"),
        (lambda vector: np.concatenate((vector[:2], [0.9, 0.7], vector[4:])), "commands must be in order of time"),
        (lambda vector: np.concatenate((vector[:4], [1.5], vector[5:])), "commands must be fractions of 0 to 1"),
        (lambda vector: np.concatenate((vector[:12], [7.0], vector[13:])), "hypotheses are of another number of jets"),
        (lambda vector: np.concatenate((vector[:13], [np.nan], vector[14:])), "hypotheses must be numbers"),
    ],
)
def test_what_no_run_leaves_is_refused(change: Any, message: str) -> None:
    tried, commands, params = _some()
    with pytest.raises(ValueError, match=message):
        keeping.unpacked(change(keeping.packed(tried, commands)), params)

"""The mass estimator as a system: ports, and one sample by hand; its mathematics have their own."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
from params_probe import mass_params
from systems_probe import advance, feedthrough, give, inputs, output, outputs

from massprop_drake.systems import MassEstimator
from massprop_drake.systems.estimation.mass_estimator import KnownPackage
from massprop_drake.systems.layouts import EVIDENCE, MASS_REPORT, TURNING

PUSH = [0.0, 0.0, 0.0, 5.0, 0.0, 0.0, 1.0, 1.0]  # a linear impulse of 5 along x, usable, firing
ROTATION = np.array([*[0.0] * 6, 1.0, 0.0, 0.0])  # center of mass at (1, 0, 0), packages at (3, 0, 0)


def made(*packages: str) -> tuple[Any, Any]:
    """1/m = 0.1, of a variance of 4e-4; increments with one of 0.01; the vehicle does not turn."""
    n = len(packages)
    params = mass_params(positions=np.tile([3.0, 0.0, 0.0], (n, 1)), variances=np.full(n, 5e-3))
    dut = MassEstimator(
        mass_reciprocal=0.1, variance=4e-4, params=params,
        accelerometers=tuple(KnownPackage(name, np.inf) for name in packages),
    )  # fmt: skip
    context = dut.CreateDefaultContext()
    give(dut, context, predicted_estimate=ROTATION, impulses=PUSH)
    turn(dut, context)
    return dut, context


def turn(dut: Any, context: Any, **changes: Any) -> None:
    """What the rotation filter says of the sample."""
    layout, zeros = TURNING.sized(jets=0), np.zeros(3)
    turning = {
        "innovation": zeros, "innovation_covariance": np.eye(3), "increment": zeros, "rate": zeros,
        "rate_variance": 0.0, "estimate": ROTATION, "covariance": np.zeros((9, 9)),
        "cross_covariance": np.zeros((3, 9)), "effects": np.zeros((3, 0)), "sensitivity": np.zeros((9, 0)),
    }  # fmt: skip
    give(dut, context, turning=layout.pack(layout.make(**(turning | changes))))


def reported(dut: Any, context: Any, acc: Any) -> Any:
    return MASS_REPORT.read(output(dut, context, "report", acc=acc))


def evidence(dut: Any, context: Any) -> Any:
    return EVIDENCE.read(output(dut, context, "evidence"))


def test_topology() -> None:
    dut, context = made("acc", "spare")
    told = {"impulses": 8, "turning": 136, "predicted_estimate": 9, "known_force": 24, "adaptation": 26}
    assert inputs(dut) == {"acc": 3, "spare": 3} | told
    measured, cycled = {"evidence": 213, "innovation": 3, "innovation_covariance": 9}, {"estimate": 2, "report": 11}
    assert outputs(dut) == {"predicted": 10, **measured, **cycled}
    # the prediction alone goes to `predicted` and nowhere else; the detector makes the adaptation from the innovation,
    # which therefore must not wait for it
    used = set(inputs(dut)) - {"predicted_estimate"}
    depends = {name: used - ({"adaptation"} if name in measured else set()) for name in measured | cycled}
    assert feedthrough(dut) == {"predicted": {"predicted_estimate"}, **depends}
    assert context.get_discrete_state(0).size() == 11


def test_one_sample_by_hand() -> None:
    dut, context = made("acc", "spare")  # only the one in use need be connected
    first = reported(dut, context, [1.0, 1.0, 1.0])
    assert_array_equal([*first.mass_innovation, first.mass_nis, first.mass_used], [np.nan] * 4 + [False])
    advance(dut, context)
    about = {"innovation": np.array([1.0, 2.0, 3.0]), "innovation_covariance": np.diag([4.0, 5.0, 6.0])}
    turn(dut, context, covariance=np.diag(np.arange(1.0, 10.0)), **about)
    report, joint = reported(dut, context, [1.6, 1.2, 1.0]), evidence(dut, context)
    # e = (0.6, 0.2, 0) - 5 x 0.1; Y = diag(25 x 4e-4 + 0.01, 0.01, 0.01)
    for innovation in (output(dut, context, "innovation"), report.mass_innovation, joint.innovation[:3]):
        assert_allclose(innovation, [0.1, 0.2, 0.0], rtol=1e-14, atol=1e-16)
    assert_allclose(output(dut, context, "innovation_covariance"), np.diag([0.02, 0.01, 0.01]).ravel(), rtol=1e-14)
    assert_allclose(report.mass_nis, 0.01 / 0.02 + 0.04 / 0.01, rtol=1e-13)
    assert (report.mass_used, report.mass_jump) == (True, False)
    # gain 4e-4 x 5 / 0.02 = 0.1, so 0.1 + 0.1 x 0.1; the variance halves
    assert_allclose(output(dut, context, "estimate"), [0.11, 2e-4], rtol=1e-13)
    assert_array_equal([report.mass_reciprocal, report.variance], output(dut, context, "estimate"))
    # both innovations and predictions side by side, those before the sample
    assert_array_equal(joint.innovation[3:], [1.0, 2.0, 3.0])
    assert_allclose(joint.covariance, np.diag([0.02, 0.01, 0.01, 4.0, 5.0, 6.0]), rtol=1e-14)
    assert_array_equal(joint.estimate, [*ROTATION, 0.1])
    assert_array_equal(joint.estimate_covariance, np.diag([*np.arange(1.0, 10.0), 4e-4]))
    estimate = output(dut, context, "estimate")
    assert_array_equal(output(dut, context, "predicted"), joint.estimate)
    advance(dut, context)
    assert_array_equal(output(dut, context, "predicted"), [*ROTATION, estimate[0]])
    assert not reported(dut, context, [np.nan] * 3).mass_used

"""The mass estimator as a system: ports, timing and missing readings."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from params_probe import mass_params
from systems_probe import advance, feedthrough, give, inputs, output, outputs

from massprop_drake.maths.estimation.filter import Joint, MassReport
from massprop_drake.maths.estimation.filters.mass_filter import Compensation
from massprop_drake.maths.estimation.filters.thesis import MASS_STATE
from massprop_drake.maths.estimation.redundancy import Rule
from massprop_drake.systems import MassEstimator
from massprop_drake.systems.estimation._readings import KnownPackage
from massprop_drake.systems.layouts import EVIDENCE, MASS_REPORT, TURNING

RECIPROCAL, VARIANCE = 0.1, 4e-4
READING_VARIANCE = 5e-3  # so that of an increment is 0.01
PUSH = [0.0, 0.0, 0.0, 5.0, 0.0, 0.0, 1.0, 1.0]  # a linear impulse of 5 along x, usable, firing
ROTATION = np.array([*[0.0] * 6, 1.0, 0.0, 0.0])  # center of mass at (1, 0, 0), packages at (3, 0, 0)
NONE = np.full(3, np.nan)


class Rig:
    """The estimator with its inputs in hand; the vehicle does not turn."""

    def __init__(self, packages: tuple[str, ...] = ("acc",), limit: float = np.inf, **given: Any):
        errors, n = given.pop("thrust_errors", None), len(packages)
        places = {"positions": np.tile([3.0, 0.0, 0.0], (n, 1)), "variances": np.full(n, READING_VARIANCE)}
        self.jets = 0 if errors is None else len(errors)
        self.dut = MassEstimator(
            mass_reciprocal=RECIPROCAL, variance=VARIANCE, thrust_errors=errors, params=mass_params(**places, **given),
            accelerometers=tuple(KnownPackage(name, limit) for name in packages),
        )  # fmt: skip
        self.context = self.dut.CreateDefaultContext()
        give(self.dut, self.context, predicted_estimate=ROTATION)
        self.turn()

    def turn(self, increment: Any = (0, 0, 0), rate: Any = (0, 0, 0), variance: float = 0.0, **changes: Any) -> None:
        """What the rotation filter says of the sample."""
        layout, j = TURNING.sized(jets=self.jets), self.jets
        turning = {
            "innovation": np.zeros(3), "innovation_covariance": np.eye(3), "increment": np.array(increment, dtype=float),
            "rate": np.array(rate, dtype=float), "rate_variance": variance, "estimate": ROTATION,
            "covariance": np.zeros((9, 9)), "cross_covariance": np.zeros((3, 9)), "effects": np.zeros((3, j)),
            "sensitivity": np.zeros((9, j)),
        }  # fmt: skip
        give(self.dut, self.context, turning=layout.pack(layout.make(**(turning | changes))))

    def see(self, *readings: Any, impulses: Any = PUSH) -> MassReport:
        """The report of a sample, before its update; a number is a velocity along x."""
        given = [[reading, 0.0, 0.0] if np.ndim(reading) == 0 else reading for reading in readings]
        give(self.dut, self.context, impulses=impulses, **dict(zip(("acc", "spare"), given, strict=False)))
        return MassReport._make(MASS_REPORT.read(self.out("report")))

    def sample(self, *readings: Any, impulses: Any = PUSH) -> MassReport:
        """The same; the sample is then over."""
        report = self.see(*readings, impulses=impulses)
        advance(self.dut, self.context)
        return report

    def out(self, name: str) -> Any:
        return output(self.dut, self.context, name)

    def evidence(self) -> Joint:
        return Joint._make(EVIDENCE.read(self.out("evidence")))

    def state(self) -> Any:
        layout = MASS_STATE.sized(accelerometers=1, window=1, errors=self.jets)
        return layout.read(self.context.get_discrete_state(0).CopyToVector())


def test_topology() -> None:
    rig = Rig(("acc", "spare"))
    packages = {"acc": 3, "spare": 3}
    told = {"impulses": 8, "turning": 136, "predicted_estimate": 9, "known_force": 24, "adaptation": 26}
    assert inputs(rig.dut) == packages | told
    measured, cycled = {"evidence": 213, "innovation": 3, "innovation_covariance": 9}, {"estimate": 2, "report": 11}
    assert outputs(rig.dut) == {"predicted": 10, **measured, **cycled}
    # the prediction alone goes to `predicted` and nowhere else; the detector makes the adaptation from the innovation,
    # which therefore must not wait for it
    used = set(inputs(rig.dut)) - {"predicted_estimate"}
    assert feedthrough(rig.dut) == {
        "predicted": {"predicted_estimate"},
        **dict.fromkeys(measured, used - {"adaptation"}),
        **dict.fromkeys(cycled, used),
    }
    assert rig.context.get_discrete_state(0).size() == 11
    errors = Rig(thrust_errors=np.ones((2, 6)))
    assert (inputs(errors.dut)["mean_level"], inputs(errors.dut)["turning"]) == (2, 136 + 24)
    assert feedthrough(errors.dut)["evidence"] == feedthrough(errors.dut)["innovation"] >= {"mean_level"}
    assert errors.context.get_discrete_state(0).size() == 2 + 3 + 3 + 2


def test_one_sample_by_hand() -> None:
    rig = Rig()
    first = rig.sample([1.0, 1.0, 1.0])
    assert_array_equal([*first.mass_innovation, first.mass_nis, first.mass_used], [np.nan] * 4 + [False])
    about = {"innovation": np.array([1.0, 2.0, 3.0]), "innovation_covariance": np.diag([4.0, 5.0, 6.0])}
    rig.turn(covariance=np.diag(np.arange(1.0, 10.0)), **about)
    report = rig.see([1.6, 1.2, 1.0])
    # e = (0.6, 0.2, 0) - 5 x 0.1; Y = diag(25 x 4e-4 + 0.01, 0.01, 0.01)
    assert_allclose(rig.out("innovation"), [0.1, 0.2, 0.0], rtol=1e-14, atol=1e-16)
    assert_allclose(rig.out("innovation_covariance"), np.diag([0.02, 0.01, 0.01]).ravel(), rtol=1e-14)
    assert_array_equal(report.mass_innovation, rig.out("innovation"))
    assert_allclose(report.mass_innovation_std, np.sqrt([0.02, 0.01, 0.01]), rtol=1e-14)
    assert_allclose(report.mass_nis, 0.01 / 0.02 + 0.04 / 0.01, rtol=1e-13)
    assert (report.mass_used, report.mass_jump) == (True, False)
    # gain 4e-4 x 5 / 0.02 = 0.1, so 0.1 + 0.1 x 0.1; the variance halves
    assert_allclose(rig.out("estimate"), [0.11, 2e-4], rtol=1e-13)
    assert_array_equal([report.mass_reciprocal, report.variance], rig.out("estimate"))
    # both innovations and predictions side by side, those before the sample
    evidence = rig.evidence()
    assert_allclose(evidence.innovation, [0.1, 0.2, 0.0, 1.0, 2.0, 3.0], rtol=1e-14, atol=1e-16)
    assert_allclose(evidence.covariance, np.diag([0.02, 0.01, 0.01, 4.0, 5.0, 6.0]), rtol=1e-14)
    assert not evidence.coupled
    for estimate in (evidence.estimate, rig.out("predicted")):
        assert_array_equal(estimate, [*ROTATION, RECIPROCAL])
    assert_array_equal(evidence.estimate_covariance, np.diag([*np.arange(1.0, 10.0), VARIANCE]))
    estimate = rig.out("estimate")
    advance(rig.dut, rig.context)
    assert_array_equal([rig.state().mass_reciprocal, rig.state().variance], estimate)
    assert_array_equal(rig.out("predicted"), [*ROTATION, estimate[0]])


@pytest.mark.parametrize(
    ("limit", "impulses", "velocities", "used"),
    [
        *((np.inf, [*PUSH[:6], *flags], [0.0, 0.6], [0, 0]) for flags in ((0, 1), (1, 0), (0, 0))),  # measured only
        # neither the increment to a missing reading nor the one from it is known
        (np.inf, PUSH, [0.0, 0.6, NONE, 1.8, 2.4], [0, 1, 0, 0, 1]),
        (1.0, PUSH, [0.0, 0.6, 1.0, 0.3, 0.9], [0, 1, 0, 0, 1]),
    ],
)
def test_samples_are_used_where_they_tell_something(limit: float, impulses: Any, velocities: Any, used: list[int]) -> None:
    rig, found = Rig(limit=limit), []
    for velocity in velocities:
        before = rig.state().variance
        report = rig.sample(velocity, impulses=impulses)
        found.append(report.mass_used)
        assert (rig.state().variance < before) == report.mass_used
        assert report.mass_used <= np.isfinite(report.mass_nis)
        assert np.isfinite(rig.evidence().innovation).all() <= bool(impulses[6])
    assert found == used


def test_several_packages_take_over_from_each_other_or_are_averaged() -> None:
    rig = Rig(("acc", "spare"))
    rig.sample(0.0)  # only the one in use need be connected
    assert rig.sample(0.6).mass_used
    # velocities of the two differ by their offset, 100 along y, which cancels in each package's own increments:
    # 0.6 of acc, 0.7 of spare; 2 to 4 have no increment of acc, 7 and 8 none of either
    rig, seen = Rig(("acc", "spare")), []
    for number in range(9):
        acc, spare = 0.6 * number, [0.7 * number, 100.0, 0.0]
        seen.append(rig.sample(NONE if number in (2, 3, 7) else acc, NONE if number == 7 else spare).mass_innovation[0])
    expected, estimate, variance = [], RECIPROCAL, VARIANCE
    for increment in (0.6, 0.7, 0.7, 0.7, 0.6, 0.6):
        expected.append(increment - 5.0 * estimate)
        gain = 5.0 * variance / (25.0 * variance + 0.01)
        estimate, variance = estimate + gain * expected[-1], variance * (1.0 - 5.0 * gain)
    assert_allclose(seen, [np.nan, *expected, np.nan, np.nan], rtol=1e-10)
    for spare, innovation in (([], 0.1), ([0.8], 0.2)):
        rig = Rig(("acc", "spare"), rule=Rule.AVERAGE)
        rig.sample(0.0, *[0.0 for _ in spare])
        assert rig.sample(0.6, *spare).mass_innovation[0] == pytest.approx(innovation)


@pytest.mark.parametrize(
    ("compensation", "turning", "reading", "innovation"),
    [
        # dw = (0, 0, 0.1) at 2 ahead of the center of mass: dw x r = (0, 0.2, 0); with that 1 further aft 0.3
        (Compensation.TRANSVERSE, {"increment": (0, 0, 0.1), "rate": (0, 0, 0.05)}, [0.5, 0.2, 0], [0, 0, 0]),
        (Compensation.TRANSVERSE, {"increment": (0, 0, 0.1), "estimate": np.zeros(9)}, [0.5, 0.2, 0], [0, -0.1, 0]),
        # turning about z at 0.5: w x (w x r) T = -0.25 x 2 x 0.08 along x
        (Compensation.TRANSVERSE_CENTRIPETAL, {"rate": (0, 0, 0.5)}, [0.46, 0, 0], [0, 0, 0]),
        (Compensation.TRANSVERSE, {"increment": NONE, "rate": NONE, "variance": np.nan}, [0.6, 0, 0], NONE),
    ],
)
def test_turning_is_taken_out_about_the_predicted_center_of_mass(
    compensation: Compensation, turning: dict[str, Any], reading: list[float], innovation: Any
) -> None:
    rig = Rig(compensation=compensation)
    rig.sample(0.0)
    rig.turn(**turning)
    assert_allclose(rig.sample(reading).mass_innovation, innovation, rtol=1e-13, atol=1e-15)


def test_unknown_rotation_and_center_of_mass_widen_the_innovation() -> None:
    # dw = (0, 0, 0.1), S_cm = 0.09 in y: [dw x] S [dw x]^T has 0.01 x 0.09 in x;
    # W = var (tr M 1 - M), var = 0.001, M = diag(4, 0.09, 0)
    rig = Rig(compensation=Compensation.TRANSVERSE, compensation_covariance=True)
    rig.sample(0.0)
    rig.turn((0.0, 0.0, 0.1), (0.0, 0.0, 0.05), 1e-3, covariance=np.diag([0, 0, 0, 0, 0, 0, 0, 0.09, 0]))
    rig.see([0.5, 0.2, 0.0])
    expected = np.diag([0.02 + 0.0009 + 1e-3 * 0.09, 0.01 + 1e-3 * 4.0, 0.01 + 1e-3 * 4.09])
    assert_allclose(rig.out("innovation_covariance"), expected.ravel(), rtol=1e-13, atol=1e-18)


def test_thrust_errors_count_by_the_level_of_their_jet() -> None:
    # two jets push along x with one sigma of 0.2 and 0.4 at full level; the first is on, the second at a half:
    # effects 0.1 x 0.2 and 0.1 x 0.2 along x, and the products 4e-4 (0.04 + 0.04)
    errors = np.zeros((2, 6))
    errors[:, 3] = 0.2, 0.4
    rig = Rig(thrust_errors=errors)
    give(rig.dut, rig.context, mean_level=[1.0, 0.5])
    rig.sample(0.0)
    rig.see(0.6)
    # what each shows as in the rate is shared: 0.02 times that
    for effects in (np.array([[0.0, 0.0], [0.0, 0.0], [1.0, 2.0]]), np.eye(3, 2), np.eye(3, 2, 1), np.zeros((3, 2))):
        rig.turn(effects=effects)
        shared, evidence = np.zeros((3, 3)), rig.evidence()
        shared[0] = 0.02 * effects.sum(axis=1)
        assert evidence.coupled == effects.any()
        assert_allclose(evidence.covariance[:3, 3:], shared, rtol=1e-13)
        assert_array_equal(evidence.covariance[3:, :3], evidence.covariance[:3, 3:].T)
    expected = np.diag([0.02 + 2 * 4e-4 + 4e-4 * 0.08, 0.01, 0.01])
    assert_allclose(rig.out("innovation_covariance"), expected.ravel(), rtol=1e-13, atol=1e-18)
    advance(rig.dut, rig.context)
    sensitivity = rig.state().sensitivity
    assert (sensitivity < 0.0).all()  # more thrust than thought looks like a larger 1/m: truth minus estimate falls
    give(rig.dut, rig.context, mean_level=[0.0, 0.0])  # where nothing fired, none bears on the sample
    rig.sample(0.6, impulses=[0.0] * 6 + [1.0, 0.0])
    assert_array_equal(rig.state().sensitivity, sensitivity)

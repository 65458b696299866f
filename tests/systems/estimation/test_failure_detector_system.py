"""The failure detector as a system: ports, loops, and the same answers as its mathematics."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from params_probe import PERIOD_S
from params_probe import detector_settings_of as settings_of
from systems_probe import advance, feedthrough, inputs, outputs

from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.maths.estimation.adaptation import Adaptation, unpacked
from massprop_drake.maths.estimation.detector import Evidence, KnownForce, KnownJets, Verdict
from massprop_drake.maths.estimation.detectors import cglr as detection
from massprop_drake.maths.estimation.detectors.cglr import LAYOUT, DetectorCycle, DetectorState, initial_state
from massprop_drake.maths.estimation.detectors.jet_tests import signatures
from massprop_drake.maths.estimation.filter import Joint
from massprop_drake.maths.estimation.filters.thesis import joint_covariance, shared_covariance
from massprop_drake.maths.linear_algebra import Array, NotPositiveDefiniteError
from massprop_drake.systems.estimation.failure_detector import FailureDetector
from massprop_drake.systems.layouts import (
    DETECTOR_REPORT,
    EVIDENCE,
    IMPULSES,
    KNOWN_FORCE,
    RECONFIGURATION,
    STATUS,
)

N = 44
STUCK = 28  # index of jet 29
VELOCITY_VARIANCE, RATE_VARIANCE = 0.0344**2 / 6.0, 1.52e-6**2 / 6.0  # section 5.5 of the thesis
STEADY, CHANGED = True, False
REPORT, MEMORY, TOLD = (layout.sized(jets=N) for layout in (DETECTOR_REPORT, LAYOUT, RECONFIGURATION))


def impulses(*, usable: bool, firing: bool) -> Array:
    """The impulse model's port; the detector reads the two flags alone."""
    return IMPULSES.pack((np.eye(3)[0] * firing, np.zeros(3), usable, firing))


class Rig:
    """The detector with its inputs in hand."""

    def __init__(self, vehicle: Vehicle, *overrides: str):
        self.params = settings_of(*overrides)
        params = self.params
        jets = KnownJets(
            PERIOD_S, params.clusters, params.unit_wrenches, params.thrusts, params.manifolds, params.limits
        )
        self.dut = FailureDetector(detection.DETECTOR, params, jets=jets)
        self.context = self.dut.CreateDefaultContext()
        self.properties = vehicle.nominal.vector()
        self.signatures = signatures(self.params.unit_wrenches, self.properties, PERIOD_S)
        deviation = np.concatenate([1e-5 * self.properties[:3], np.full(3, 1e-13), np.full(3, 1e-4)])
        self.given: dict[str, Any] = {
            "jet_commands": np.zeros(N),
            "impulses": impulses(usable=STEADY, firing=False),
            "rotation_innovation_covariance": RATE_VARIANCE * np.eye(3),
            "mass_innovation_covariance": VELOCITY_VARIANCE * np.eye(3),
            "shared_covariance": None,
            "predicted": self.properties,
            "predicted_covariance": joint_covariance(np.diag(deviation**2), (1e-3 * self.properties[9]) ** 2),
            "cross_covariance": np.zeros((6, 10)),
        }
        self.see(np.zeros(6))

    def seen(self) -> Joint:
        """What both filters say of the sample."""
        given, covariance = self.given, np.zeros((6, 6))
        covariance[:3, :3], covariance[3:, 3:] = (
            given["mass_innovation_covariance"],
            given["rotation_innovation_covariance"],
        )
        shared = given["shared_covariance"]
        if shared is not None:
            covariance[:3, 3:], covariance[3:, :3] = shared, shared.T
        innovation = np.concatenate([given["mass_innovation"], given["rotation_innovation"]])
        return Joint(
            innovation,
            covariance,
            shared is not None,
            given["predicted"],
            given["predicted_covariance"],
            given["cross_covariance"],
        )

    def see(self, innovation: Array, **changes: Any) -> None:
        """Sets the inputs of the sample."""
        self.given |= {"mass_innovation": innovation[:3], "rotation_innovation": innovation[3:], **changes}
        ports = {name: self.given[name] for name in ("jet_commands", "impulses", "predicted")}
        for name, value in {**ports, "evidence": EVIDENCE.pack(self.seen())}.items():
            self.dut.GetInputPort(name).FixValue(self.context, value)

    def fail(self, force: float = 868.8, jet: int = STUCK) -> None:
        self.see(force * self.signatures[jet])

    def out(self, name: str) -> Array:
        return self.dut.GetOutputPort(name).Eval(self.context)

    def report(self) -> Any:
        return REPORT.read(self.out("report"))

    def told(self) -> Any:
        """What the autopilot hears."""
        return TOLD.read(self.out("reconfiguration"))

    def known_force(self) -> KnownForce:
        return KnownForce._make(KNOWN_FORCE.read(self.out("known_force")))

    def adaptation(self) -> Adaptation:
        return unpacked(self.out("adaptation"))

    def memory(self, context: Any = None) -> Array:
        """The state, packed."""
        return (context or self.context).get_discrete_state(0).CopyToVector()

    def state(self) -> DetectorState:
        return DetectorState._make(MEMORY.read(self.memory()))

    def next(self) -> None:
        advance(self.dut, self.context)

    def judged(self) -> DetectorCycle:
        """What the mathematics makes of the inputs and the state."""
        flags = IMPULSES.read(self.given["impulses"])
        command = self.given["jet_commands"]
        evidence = Evidence(self.context.get_time(), command, flags.usable, flags.firing, *self.seen())
        return detection.judged(self.state(), evidence, self.params)

    def declare(self) -> None:
        """Two samples that declare jet 29 stuck on; the second is over."""
        for _ in range(2):
            self.fail()
            event = self.report().detector_event
            self.next()
        assert event == Verdict.DECLARED


def assert_reported(rig: Rig, expected: DetectorCycle) -> None:
    """The report is that of the mathematics."""
    report = rig.report()
    np.testing.assert_array_equal(report[: len(list(STATUS))], detection.status(expected))
    np.testing.assert_array_equal(report.likelihood, expected.tests.likelihood)
    np.testing.assert_array_equal(report.failure_magnitude, expected.tests.magnitude)


@pytest.fixture
def rig(orbiter: Vehicle) -> Rig:
    return Rig(orbiter)


def test_topology(rig: Rig) -> None:
    assert inputs(rig.dut) == {"jet_commands": N, "impulses": 8, "evidence": 213, "predicted": 10}
    assert outputs(rig.dut) == {
        "known_force": 24,
        "adaptation": 26,
        "reconfiguration": 7 + N,
        "closed": N,
        "report": 14 + 4 * N,
        "held_closed": N,
    }
    assert rig.memory().size == 10 + 4 * N


def test_known_forces_depend_on_predictions_and_commands_alone(rig: Rig) -> None:
    # they enter the impulses, which make the innovations: anything more would close a loop
    depends = feedthrough(rig.dut)
    assert depends["known_force"] == {"predicted", "jet_commands"}
    assert depends["held_closed"] == set()
    for name in ("adaptation", "reconfiguration", "closed", "report"):
        assert depends[name] == {"evidence", "predicted", "jet_commands", "impulses"}


def test_it_starts_with_no_suspicion(rig: Rig) -> None:
    np.testing.assert_array_equal(rig.memory(), MEMORY.pack(initial_state(N)))
    for name in ("known_force", "reconfiguration", "closed", "held_closed", "adaptation"):
        assert not rig.out(name).any()


@pytest.mark.parametrize("uncertainty", ["true", "false"])
def test_outputs_are_those_of_the_mathematics(orbiter: Vehicle, uncertainty: str) -> None:
    rig = Rig(orbiter, f"detector.signature_uncertainty={uncertainty}")
    noise = np.sqrt(np.repeat([VELOCITY_VARIANCE, RATE_VARIANCE], 3))
    rng = np.random.default_rng(1)
    for force in (0.0, 868.8, 868.8, 0.0):
        rig.see(force * rig.signatures[STUCK] + noise * rng.normal(size=6))
        expected = rig.judged()
        assert_reported(rig, expected)
        report, before = rig.report(), rig.state()
        np.testing.assert_array_equal(report.known_force, before.force)  # before the sample
        np.testing.assert_array_equal(report.known_force_variance, before.variance)
        for found, part in zip(rig.adaptation(), expected.adaptation, strict=True):
            np.testing.assert_array_equal(found, part)
        rig.next()
        np.testing.assert_array_equal(rig.memory(), MEMORY.pack(expected.state))
    assert rig.state().variance.any()


def test_the_update_remembers_and_declares(rig: Rig) -> None:
    rig.fail()
    report = rig.report()
    assert (report.alarm, report.detector_event, report.alarms) == (1.0, Verdict.NOTHING, 1.0)
    assert not rig.out("reconfiguration").any()
    rig.next()
    assert (rig.state().cluster, rig.state().alarms) == (12.0, 1.0)
    rig.fail()
    report = rig.report()
    assert (report.alarm, report.detector_event, report.alarms) == (1.0, Verdict.DECLARED, 2.0)
    # the time of the sample dates the onset: the first alarm came at 0, of the interval before it
    np.testing.assert_allclose(report.onset, -PERIOD_S, rtol=1e-12)


def test_the_autopilot_hears_at_once_and_the_impulse_model_one_sample_later(rig: Rig) -> None:
    rig.fail()
    rig.next()
    rig.fail()
    told = rig.told()
    assert told.declared
    # what pushes from now on, and the jet out of use from now on
    np.testing.assert_allclose(told.known_wrench, 868.8 * rig.params.unit_wrenches[STUCK], rtol=1e-4)
    np.testing.assert_array_equal(np.flatnonzero(told.removed), [STUCK])
    # the interval that ended is still taken as it was
    assert not rig.out("known_force").any()
    rig.next()
    np.testing.assert_allclose(rig.known_force().wrench, 868.8 * rig.params.unit_wrenches[STUCK], rtol=1e-4)


def test_a_declaration_is_told_once_and_its_consequences_stay(rig: Rig) -> None:
    rig.declare()
    rig.see(np.zeros(6))  # the known force now accounts for what is measured
    told = rig.told()
    assert not told.declared
    assert told.known_wrench.any()
    np.testing.assert_array_equal(np.flatnonzero(told.removed), [STUCK])


def test_the_known_forces_effect_follows_the_predictions(rig: Rig) -> None:
    rig.declare()
    state = rig.state()
    moved = rig.properties.copy()
    moved[[0, 6, 9]] *= 1.1
    rig.see(np.zeros(6), predicted=moved)
    known = rig.known_force()
    expected = detection.known_force(state, moved, np.zeros(N), rig.params)
    np.testing.assert_array_equal(known.wrench, expected.wrench)
    np.testing.assert_array_equal(known.translation_spread, expected.translation_spread)
    np.testing.assert_array_equal(known.rotation_spread, expected.rotation_spread)
    before = detection.known_force(state, rig.properties, np.zeros(N), rig.params)
    assert (np.abs(known.rotation_spread - before.rotation_spread) > 0.0).any()


@pytest.mark.parametrize(
    "change",
    [
        {"impulses": impulses(usable=CHANGED, firing=False)},
        {"mass_innovation": np.full(3, np.nan)},
        {"rotation_innovation": np.full(3, np.nan)},
        {"predicted_covariance": np.eye(10)},
    ],
    ids=["unsteady", "no velocity", "no rate", "not converged"],
)
def test_a_sample_that_is_not_tested(rig: Rig, change: dict[str, Any]) -> None:
    rig.see(868.8 * rig.signatures[STUCK], **change)
    report = rig.report()
    assert (report.tested, report.alarm, report.detector_event) == (0.0, 0.0, Verdict.NOTHING)
    assert np.isnan(report.likelihood).all()
    assert np.isnan(report.failure_magnitude).all()
    assert not rig.out("adaptation").any()


def test_a_jump_needs_a_commanded_jet(rig: Rig) -> None:
    # turning as no jet does: the detector leaves it to the filters, but only where an impulse could show it
    odd = np.array([0.0, 0.0, 0.0, 1e-4, 1e-4, -1e-4])
    rig.see(odd)
    quiet = rig.report()
    command = np.zeros(N)
    command[0] = 1.0
    rig.see(odd, jet_commands=command, impulses=impulses(usable=STEADY, firing=True))
    assert (quiet.alarm, quiet.detector_event) == (0.0, Verdict.NOTHING)
    assert (rig.report().alarm, rig.report().detector_event) == (0.0, Verdict.JUMP)
    assert rig.adaptation().mass_jumped


def test_closed_manifolds_act_at_once_and_are_held(orbiter: Vehicle) -> None:
    rig = Rig(orbiter, "detector.close_manifold=true")
    sharing = [jet for jet, name in enumerate(orbiter.designations) if name.startswith("R4")]
    rig.fail()
    rig.next()
    rig.fail()
    np.testing.assert_array_equal(np.flatnonzero(rig.out("closed")), sharing)
    assert not rig.out("held_closed").any()
    np.testing.assert_array_equal(np.flatnonzero(rig.told().removed), sharing)
    assert not rig.told().known_wrench.any()  # closed, it pushes no more
    rig.next()
    rig.see(np.zeros(6))
    np.testing.assert_array_equal(np.flatnonzero(rig.out("held_closed")), sharing)
    np.testing.assert_array_equal(np.flatnonzero(rig.out("closed")), sharing)


def test_a_covariance_that_lost_definiteness_is_reported_with_time_and_system(rig: Rig) -> None:
    rig.next()
    rig.see(np.zeros(6), rotation_innovation_covariance=-np.eye(3))
    with pytest.raises(NotPositiveDefiniteError, match=r"failure_detector.*t = 0\.08 s"):
        rig.out("report")


def test_two_contexts_do_not_share_memory(orbiter: Vehicle) -> None:
    rig = Rig(orbiter)
    other: Any = rig.dut.CreateDefaultContext()
    rig.declare()
    np.testing.assert_array_equal(rig.memory(other), MEMORY.pack(initial_state(N)))
    assert rig.state().variance.any()


def test_what_thrust_errors_share_is_counted(rig: Rig) -> None:
    # jet 1 fires, and is off by 2.5 of its usual errors of 8.7 lbf
    effects = np.zeros((2, 3, N))
    effects[:, :, 0] = 8.7 * rig.signatures[0].reshape(2, 3)
    about = {
        "jet_commands": np.eye(N)[0],
        "impulses": impulses(usable=STEADY, firing=True),
        "mass_innovation_covariance": VELOCITY_VARIANCE * np.eye(3) + effects[0] @ effects[0].T,
        "rotation_innovation_covariance": RATE_VARIANCE * np.eye(3) + effects[1] @ effects[1].T,
    }
    rig.see(2.5 * 8.7 * rig.signatures[0], **about)
    apart = rig.report().likelihood
    assert_reported(rig, rig.judged())
    rig.see(2.5 * 8.7 * rig.signatures[0], shared_covariance=shared_covariance(effects[0], effects[1]))
    assert_reported(rig, rig.judged())
    assert not np.array_equal(rig.report().likelihood, apart)
    # where none bears on the sample nothing is shared
    rig.see(2.5 * 8.7 * rig.signatures[0], shared_covariance=shared_covariance(effects[0], np.zeros((3, N))))
    np.testing.assert_array_equal(rig.report().likelihood, apart)

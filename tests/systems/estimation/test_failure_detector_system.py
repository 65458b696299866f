"""The failure detector as a system: ports, loops, and what it tells whom when."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from params_probe import PERIOD_S
from params_probe import detector_settings_of as settings_of
from systems_probe import advance, feedthrough, give, inputs, output, outputs

from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.maths.estimation.detector import KnownForce, KnownJets, Verdict
from massprop_drake.maths.estimation.detectors import cglr
from massprop_drake.maths.estimation.detectors.cglr import LAYOUT, initial_state
from massprop_drake.maths.estimation.detectors.jet_tests import signatures
from massprop_drake.maths.estimation.filter import Joint
from massprop_drake.maths.estimation.filters.thesis import joint_covariance
from massprop_drake.maths.linear_algebra import Array, NotPositiveDefiniteError
from massprop_drake.systems import FailureDetector
from massprop_drake.systems.layouts import DETECTOR_REPORT, EVIDENCE, IMPULSES, KNOWN_FORCE, RECONFIGURATION

N = 44
STUCK, FORCE = 28, 868.8  # index of jet 29, lbf
VELOCITY_VARIANCE, RATE_VARIANCE = 0.0344**2 / 6.0, 1.52e-6**2 / 6.0  # section 5.5 of the thesis
REPORT, MEMORY, TOLD = (layout.sized(jets=N) for layout in (DETECTOR_REPORT, LAYOUT, RECONFIGURATION))


class Rig:
    """The detector with its inputs in hand."""

    def __init__(self, vehicle: Vehicle):
        params = self.params = settings_of()
        known = params.clusters, params.unit_wrenches, params.thrusts, params.manifolds, params.limits
        self.dut = FailureDetector(cglr.DETECTOR, params, jets=KnownJets(PERIOD_S, *known))
        self.context = self.dut.CreateDefaultContext()
        self.properties = vehicle.nominal.vector()
        self.signatures = signatures(params.unit_wrenches, self.properties, PERIOD_S)
        deviation = np.concatenate([1e-5 * self.properties[:3], np.full(3, 1e-13), np.full(3, 1e-4)])
        self.predicted_covariance = joint_covariance(np.diag(deviation**2), (1e-3 * self.properties[9]) ** 2)
        self.see(np.zeros(6))

    def see(self, innovation: Array, **changes: Any) -> None:
        """Sets the inputs of a sample in which nothing fires."""
        noise = np.diag(np.repeat([VELOCITY_VARIANCE, RATE_VARIANCE], 3))
        joint = Joint(innovation, noise, False, self.properties, self.predicted_covariance, np.zeros((6, 10)))
        told = IMPULSES.pack((np.zeros(3), np.zeros(3), True, False))
        given = {"jet_commands": np.zeros(N), "impulses": told, "predicted": self.properties}
        give(self.dut, self.context, evidence=EVIDENCE.pack(joint._replace(**changes)), **given)

    def fail(self, force: float = FORCE) -> None:
        self.see(force * self.signatures[STUCK])

    def out(self, name: str) -> Array:
        return output(self.dut, self.context, name)

    def report(self) -> Any:
        return REPORT.read(self.out("report"))

    def told(self) -> Any:
        """What the autopilot hears."""
        return TOLD.read(self.out("reconfiguration"))

    def known_force(self) -> KnownForce:
        return KnownForce._make(KNOWN_FORCE.read(self.out("known_force")))

    def memory(self) -> Array:
        return self.context.get_discrete_state(0).CopyToVector()

    def next(self) -> None:
        advance(self.dut, self.context)


@pytest.fixture
def rig(orbiter: Vehicle) -> Rig:
    return Rig(orbiter)


def test_topology_and_start(rig: Rig) -> None:
    assert inputs(rig.dut) == {"jet_commands": N, "impulses": 8, "evidence": 213, "predicted": 10}
    judged = {"adaptation": 26, "reconfiguration": 7 + N, "closed": N, "report": 14 + 4 * N}
    assert outputs(rig.dut) == {"known_force": 24, **judged, "held_closed": N}
    # known forces enter the impulses, which make the innovations: anything more would close a loop
    depends = {name: set(inputs(rig.dut)) for name in judged}
    assert feedthrough(rig.dut) == depends | {"known_force": {"predicted", "jet_commands"}, "held_closed": set()}
    assert_array_equal(rig.memory(), MEMORY.pack(initial_state(N)))
    for name in ("known_force", "reconfiguration", "closed", "held_closed", "adaptation"):
        assert not rig.out(name).any()


def test_a_declaration_is_told_to_the_autopilot_at_once_and_to_the_impulse_model_a_sample_later(rig: Rig) -> None:
    pushes, events = FORCE * rig.params.unit_wrenches[STUCK], []
    for number in range(2):
        rig.fail()
        report, told = rig.report(), rig.told()
        events.append((report.alarm, report.detector_event, report.alarms))
        assert told.declared == bool(number)
        assert not rig.out("known_force").any()  # the interval that ended is still taken as it was
        if number == 0:
            rig.next()
    assert events == [(1.0, Verdict.NOTHING, 1.0), (1.0, Verdict.DECLARED, 2.0)]
    # the time of the sample dates the onset: the first alarm came at 0, of the interval before it
    assert_allclose(report.onset, -PERIOD_S, rtol=1e-12)
    assert_allclose(told.known_wrench, pushes, rtol=1e-4)
    assert np.flatnonzero(told.removed).tolist() == [STUCK]
    rig.next()
    assert_allclose(rig.known_force().wrench, pushes, rtol=1e-4)
    rig.see(np.zeros(6))  # the known force now accounts for what is measured; it is told once, consequences stay
    assert (rig.told().declared, rig.told().known_wrench.any()) == (False, True)
    assert np.flatnonzero(rig.told().removed).tolist() == [STUCK]


def test_a_covariance_that_lost_definiteness_is_reported_with_time_and_system(rig: Rig) -> None:
    rig.next()
    rig.see(np.zeros(6), covariance=-np.eye(6))
    with pytest.raises(NotPositiveDefiniteError, match=r"failure_detector.*t = 0\.08 s"):
        rig.out("report")

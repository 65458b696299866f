"""The failure detector as a system: ports, loops, and the same answers as its mathematics."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from params_probe import detector_settings_of as settings_of
from systems_probe import PERIOD_S, advance, feedthrough, inputs, outputs

from massprop_drake.inputs.vehicle import Vehicle
from massprop_drake.maths.estimation import adaptation
from massprop_drake.maths.estimation.detectors import cglr as detection
from massprop_drake.maths.estimation.detectors.cglr import Event, initial_state, packed
from massprop_drake.maths.estimation.detectors.jet_tests import signatures
from massprop_drake.maths.linear_algebra import Array, NotPositiveDefiniteError
from massprop_drake.systems.estimation.failure_detector import FailureDetector

N = 44
STUCK = 28  # index of jet 29
LIMITS = np.array([0.02, 1.0, 0.2])
VELOCITY_VARIANCE, RATE_VARIANCE = 0.0344**2 / 6.0, 1.52e-6**2 / 6.0  # section 5.5 of the thesis
STEADY, CHANGED = 1.0, 0.0
INNOVATIONS = {"rotation_judged", "mass_judged"}
EFFECTS = {"rotation_effects", "mass_effects"}
PREDICTIONS = {"predicted_estimate", "predicted_covariance", "mass_predicted"}


class Rig:
    """The detector with its inputs in hand."""

    def __init__(self, vehicle: Vehicle, *overrides: str, mass_size: int = 8):
        self.params = settings_of(*overrides)
        self.dut = FailureDetector(self.params, limits=LIMITS, mass_size=mass_size)
        self.context = self.dut.CreateDefaultContext()
        self.properties = vehicle.nominal.vector()
        self.signatures = signatures(self.params.unit_wrenches, self.properties, PERIOD_S)
        deviation = np.concatenate([1e-5 * self.properties[:3], np.full(3, 1e-13), np.full(3, 1e-4)])
        self.given: dict[str, Array] = {
            "jet_commands": np.zeros(N),
            "impulses": np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, STEADY, 0.0]),
            "rotation_innovation_covariance": (RATE_VARIANCE * np.eye(3)).ravel(),
            "mass_innovation_covariance": (VELOCITY_VARIANCE * np.eye(3)).ravel(),
            "predicted_estimate": self.properties[:9],
            "predicted_covariance": np.diag(deviation**2).ravel(),
            "mass_predicted": np.concatenate(
                [[self.properties[9], (1e-3 * self.properties[9]) ** 2], np.full(mass_size - 2, 9.0)]
            ),
        }
        self.see(np.zeros(6))

    def see(self, innovation: Array, **changes: Array) -> None:
        """Sets the inputs of the sample."""
        self.given |= {"mass_innovation": innovation[:3], "rotation_innovation": innovation[3:], **changes}
        given = {name: value for name, value in self.given.items() if "innovation" not in name}
        for filtered in ("rotation", "mass"):
            parts = self.given[f"{filtered}_innovation"], self.given[f"{filtered}_innovation_covariance"]
            given[f"{filtered}_judged"] = np.concatenate(parts)
        for name, value in given.items():
            self.dut.GetInputPort(name).FixValue(self.context, value)

    def fail(self, force: float = 868.8, jet: int = STUCK) -> None:
        self.see(force * self.signatures[jet])

    def out(self, name: str) -> Array:
        return self.dut.GetOutputPort(name).Eval(self.context)

    def next(self) -> None:
        advance(self.dut, self.context)

    def judged(self, shared: Array | None = None) -> detection.DetectorCycle:
        """What the mathematics makes of the inputs and the state."""
        given = self.given
        return detection.judged(
            detection.unpacked(self.out("memory"), N),
            self.context.get_time(),
            given["jet_commands"],
            given["impulses"][6] != 0.0,
            given["impulses"][7] != 0.0,
            given["mass_innovation"],
            given["rotation_innovation"],
            given["mass_innovation_covariance"].reshape(3, 3),
            given["rotation_innovation_covariance"].reshape(3, 3),
            given["predicted_estimate"],
            given["predicted_covariance"].reshape(9, 9),
            given["mass_predicted"],
            LIMITS,
            self.params,
            shared,
        )

    def declare(self) -> None:
        """Two samples that declare jet 29 stuck on; the second is over."""
        for _ in range(2):
            self.fail()
            event = self.out("status")[2]
            self.next()
        assert event == Event.DECLARED


@pytest.fixture
def rig(orbiter: Vehicle) -> Rig:
    return Rig(orbiter)


@pytest.mark.parametrize("mass_size", [8, 20])
def test_topology(orbiter: Vehicle, mass_size: int) -> None:
    dut = Rig(orbiter, mass_size=mass_size).dut
    assert inputs(dut) == {
        "jet_commands": N,
        "impulses": 8,
        "rotation_judged": 12,
        "predicted_estimate": 9,
        "predicted_covariance": 81,
        "mass_judged": 12,
        "mass_predicted": mass_size,
        "mass_effects": 3 * N,
        "rotation_effects": 3 * N,
    }
    assert outputs(dut) == {
        "known_force": 24,
        "adaptation": 26,
        "reconfiguration": 7 + N,
        "closed": N,
        "held_closed": N,
        "status": 14,
        "likelihood": N,
        "magnitude": N,
        "report": 14 + 2 * N,
        "memory": 10 + 4 * N,
    }


def test_known_forces_depend_on_predictions_and_commands_alone(rig: Rig) -> None:
    # they enter the impulses, which make the innovations: anything more would close a loop
    depends = feedthrough(rig.dut)
    assert depends["known_force"] <= {*PREDICTIONS, "jet_commands"}
    assert depends["memory"] == depends["held_closed"] == set()
    for name in ("adaptation", "reconfiguration", "closed", "status", "likelihood", "magnitude"):
        assert depends[name] == {*INNOVATIONS, *PREDICTIONS, *EFFECTS, "jet_commands", "impulses"}


def test_it_starts_with_no_suspicion(rig: Rig) -> None:
    np.testing.assert_array_equal(rig.out("memory"), packed(initial_state(N)))
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
        np.testing.assert_array_equal(rig.out("status"), detection.status(expected))
        np.testing.assert_array_equal(rig.out("likelihood"), expected.tests.likelihood)
        np.testing.assert_array_equal(rig.out("magnitude"), expected.tests.magnitude)
        np.testing.assert_array_equal(rig.out("adaptation"), adaptation.packed(expected.adaptation))
        rig.next()
        np.testing.assert_array_equal(rig.out("memory"), packed(expected.state))


def test_the_update_remembers_and_declares(rig: Rig) -> None:
    rig.fail()
    assert rig.out("status")[[1, 2, 13]].tolist() == [1.0, Event.NOTHING, 1.0]
    assert not rig.out("reconfiguration").any()
    rig.next()
    assert rig.out("memory")[:2].tolist() == [12.0, 1.0]
    rig.fail()
    assert rig.out("status")[[1, 2, 13]].tolist() == [1.0, Event.DECLARED, 2.0]
    # the time of the sample dates the onset: the first alarm came at 0, of the interval before it
    np.testing.assert_allclose(rig.out("status")[12], -PERIOD_S, rtol=1e-12)


def test_the_autopilot_hears_at_once_and_the_impulse_model_one_sample_later(rig: Rig) -> None:
    rig.fail()
    rig.next()
    rig.fail()
    told = rig.out("reconfiguration")
    assert told[0] == 1.0
    # what pushes from now on, and the jet out of use from now on
    np.testing.assert_allclose(told[1:7], 868.8 * rig.params.unit_wrenches[STUCK], rtol=1e-4)
    np.testing.assert_array_equal(np.flatnonzero(told[7:]), [STUCK])
    # the interval that ended is still taken as it was
    assert not rig.out("known_force").any()
    rig.next()
    np.testing.assert_allclose(rig.out("known_force")[:6], 868.8 * rig.params.unit_wrenches[STUCK], rtol=1e-4)


def test_a_declaration_is_told_once_and_its_consequences_stay(rig: Rig) -> None:
    rig.declare()
    rig.see(np.zeros(6))  # the known force now accounts for what is measured
    told = rig.out("reconfiguration")
    assert told[0] == 0.0
    assert told[1:7].any()
    np.testing.assert_array_equal(np.flatnonzero(told[7:]), [STUCK])


def test_the_known_forces_effect_follows_the_predictions(rig: Rig) -> None:
    rig.declare()
    state = detection.unpacked(rig.out("memory"), N)
    moved = rig.properties.copy()
    moved[[0, 6, 9]] *= 1.1
    rig.see(
        np.zeros(6),
        predicted_estimate=moved[:9],
        mass_predicted=np.array([moved[9], 1e-12, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]),
    )
    known = rig.out("known_force")
    expected = detection.known_force(state, moved, np.zeros(N), rig.params)
    np.testing.assert_array_equal(known[6:15], expected.translation_spread.ravel())
    np.testing.assert_array_equal(known[15:], expected.rotation_spread.ravel())
    before = detection.known_force(state, rig.properties, np.zeros(N), rig.params)
    assert (np.abs(known[15:] - before.rotation_spread.ravel()) > 0.0).any()


@pytest.mark.parametrize(
    "change",
    [
        {"impulses": np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, CHANGED, 0.0])},
        {"mass_innovation": np.full(3, np.nan)},
        {"rotation_innovation": np.full(3, np.nan)},
        {"predicted_covariance": np.eye(9).ravel()},
    ],
    ids=["unsteady", "no velocity", "no rate", "not converged"],
)
def test_a_sample_that_is_not_tested(rig: Rig, change: dict[str, Array]) -> None:
    rig.see(868.8 * rig.signatures[STUCK], **change)
    assert not rig.out("status")[:3].any()
    assert np.isnan(rig.out("likelihood")).all()
    assert np.isnan(rig.out("magnitude")).all()
    assert not rig.out("adaptation").any()


def test_a_jump_needs_a_commanded_jet(rig: Rig) -> None:
    # turning as no jet does: the detector leaves it to the filters, but only where an impulse could show it
    odd = np.array([0.0, 0.0, 0.0, 1e-4, 1e-4, -1e-4])
    rig.see(odd)
    quiet = rig.out("status")[1:3].tolist()
    command = np.zeros(N)
    command[0] = 1.0
    rig.see(odd, jet_commands=command, impulses=np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0, STEADY, 1.0]))
    assert quiet == [0.0, Event.NOTHING]
    assert rig.out("status")[1:3].tolist() == [0.0, detection.Event.JUMP]
    assert rig.out("adaptation")[25] == 1.0


def test_closed_manifolds_act_at_once_and_are_held(orbiter: Vehicle) -> None:
    rig = Rig(orbiter, "detector.close_manifold=true")
    sharing = [jet for jet, name in enumerate(orbiter.designations) if name.startswith("R4")]
    rig.fail()
    rig.next()
    rig.fail()
    np.testing.assert_array_equal(np.flatnonzero(rig.out("closed")), sharing)
    assert not rig.out("held_closed").any()
    np.testing.assert_array_equal(np.flatnonzero(rig.out("reconfiguration")[7:]), sharing)
    assert not rig.out("reconfiguration")[1:7].any()  # closed, it pushes no more
    rig.next()
    rig.see(np.zeros(6))
    np.testing.assert_array_equal(np.flatnonzero(rig.out("held_closed")), sharing)
    np.testing.assert_array_equal(np.flatnonzero(rig.out("closed")), sharing)


def test_a_covariance_that_lost_definiteness_is_reported_with_time_and_system(rig: Rig) -> None:
    rig.next()
    rig.see(np.zeros(6), rotation_innovation_covariance=-np.eye(3).ravel())
    with pytest.raises(NotPositiveDefiniteError, match=r"failure_detector.*t = 0\.08 s"):
        rig.out("status")


def test_two_contexts_do_not_share_memory(orbiter: Vehicle) -> None:
    rig = Rig(orbiter)
    other: Any = rig.dut.CreateDefaultContext()
    rig.declare()
    np.testing.assert_array_equal(rig.dut.GetOutputPort("memory").Eval(other), packed(initial_state(N)))


def test_thrust_errors_are_counted_once_both_effects_are_connected(rig: Rig) -> None:
    # jet 1 fires, and is off by 2.5 of its usual errors of 8.7 lbf
    effects = np.zeros((2, 3, N))
    effects[:, :, 0] = 8.7 * rig.signatures[0].reshape(2, 3)
    command = np.eye(N)[0]
    about = {
        "jet_commands": command,
        "impulses": np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0, STEADY, 1.0]),
        "mass_innovation_covariance": (VELOCITY_VARIANCE * np.eye(3) + effects[0] @ effects[0].T).ravel(),
        "rotation_innovation_covariance": (RATE_VARIANCE * np.eye(3) + effects[1] @ effects[1].T).ravel(),
    }
    rig.see(2.5 * 8.7 * rig.signatures[0], **about)
    apart = rig.out("likelihood")
    rig.see(2.5 * 8.7 * rig.signatures[0], mass_effects=effects[0].ravel())
    np.testing.assert_array_equal(rig.out("likelihood"), apart)  # one alone says nothing of what they share
    rig.see(2.5 * 8.7 * rig.signatures[0], rotation_effects=effects[1].ravel())
    shared = detection.shared_covariance(effects[0], effects[1])
    expected = rig.judged(shared)
    np.testing.assert_array_equal(rig.out("likelihood"), expected.tests.likelihood)
    np.testing.assert_array_equal(rig.out("status"), detection.status(expected))
    assert not np.array_equal(rig.out("likelihood"), apart)
    # where none bears on the sample the effects are zero
    rig.see(2.5 * 8.7 * rig.signatures[0], rotation_effects=np.zeros(3 * N), mass_effects=np.zeros(3 * N))
    np.testing.assert_array_equal(rig.out("likelihood"), apart)

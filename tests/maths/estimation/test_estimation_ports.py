"""The kernels of the estimators' systems give the bits of a cycle: packed, and one after the other."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from numpy.typing import NDArray

from massprop_drake import Run, Scenario, load_scenario, simulate
from massprop_drake.inputs import params
from massprop_drake.maths.estimation import cycle, estimation_ports
from massprop_drake.maths.estimation.adaptation import NO_ADAPTATION, pack_adaptation
from massprop_drake.maths.estimation.cycle import EstimationParams, Sample
from massprop_drake.maths.estimation.detector import KNOWN_FORCE, NO_KNOWN_FORCE, unpack_known_force
from massprop_drake.maths.estimation.filters import thesis
from massprop_drake.maths.estimation.impulses import LAYOUT as IMPULSES
from massprop_drake.maths.kernels import Holder, read_bundle
from massprop_drake.systems.layouts import MASS_REPORT, ROTATION_REPORT

Array = NDArray[np.float64]
FAILING = (
    "duration_s=20",
    "estimation.start=nominal",
    "estimation.std_fraction=0.05",
    "failures=[{kind: stuck_on, jet: R4R, start_s: 12}]",
)


@pytest.fixture(scope="module", params=[(), ("detector={kind: off}",)], ids=["with the detector", "without"])
def flown(request: pytest.FixtureRequest) -> tuple[Scenario, Run]:
    scenario = load_scenario("stuck_on_29", [*FAILING, *request.param, "execution.engine=loop"])
    return scenario, simulate(scenario)


def samples(scenario: Scenario, run: Run) -> list[Sample]:
    """What the estimators got."""
    accelerometers = [package.name for package in params.accelerometers(scenario)]
    before = np.vstack([np.zeros(run["command"].shape[1]), run["command"][:-1]])
    return [
        Sample(time_s, run["gyro"][row : row + 1], np.array([run[name][row] for name in accelerometers]), before[row])
        for row, time_s in enumerate(run.time_s.tolist())
    ]


class Systems:
    """The kernels, called as the systems of a diagram call them."""

    def __init__(self, made: EstimationParams):
        groups = cycle.save_state(cycle.initial_state(made), made)
        rotation, mass = made.filter_params.rotation, made.filter_params.mass
        turned = thesis.rotation_layout(rotation, 0).read(groups["rotation_estimator"])[:-1]
        moved = thesis.mass_layout(mass, 0).read(groups["mass_estimator"])[:-1]
        self.groups, self._made = groups, made
        self._lagging = Holder(estimation_ports.Lagging(made.impulse_per_level, made.lag, made.period_s))
        self._rotating = Holder(
            estimation_ports.make_rotation_filter(rotation, estimation_ports.RotationVector(*turned))
        )
        self._weighing = Holder(estimation_ports.make_mass_filter(mass, estimation_ports.MassVector(*moved)))
        self._judging = None if made.detector is None else Holder(estimation_ports.make_detector(made.detector_params))

    def step(self, sample: Sample) -> Array:
        """One cycle; the reports of both filters."""
        groups, command = self.groups, sample.command
        row = estimation_ports.impulses(groups["impulse_model"], command, np.zeros(6), self._lagging)
        told, force = row[: IMPULSES.size].copy(), KNOWN_FORCE.pack(NO_KNOWN_FORCE)
        if self._judging is not None:
            detector = groups["failure_detector"]
            state = read_bundle(detector, self._judging.value.state)
            if state.variance.any():
                predicted = np.append(groups["rotation_estimator"][:9], groups["mass_estimator"][0])
                force = estimation_ports.known_force(detector, predicted, command, self._judging)
        if unpack_known_force(force).acts:
            told[:6] += force[:6] * self._made.period_s
        turned = estimation_ports.measure_rotation(
            groups["rotation_estimator"], sample.rates, told, force, self._rotating
        )
        said = turned[: thesis.TURNING.sized(jets=0).size]
        moved = estimation_ports.measure_mass(
            groups["mass_estimator"], sample.velocities, said, told, force, self._weighing
        )
        asked = pack_adaptation(NO_ADAPTATION)
        if self._judging is not None:
            judged = estimation_ports.run_detector(detector, sample.time_s, command, told, moved[:213], self._judging)
            asked, groups["failure_detector"] = judged[:26], judged[33 : 33 + detector.size]
        rotation, mass = (
            estimation_ports.finish_rotation(turned, asked, self._rotating),
            estimation_ports.finish_mass(moved, asked, self._weighing),
        )
        groups["impulse_model"] = np.append(command, row[IMPULSES.size + command.size :])
        groups["rotation_estimator"] = rotation[ROTATION_REPORT.size :]
        groups["mass_estimator"] = mass[MASS_REPORT.size :]
        return np.append(rotation[: ROTATION_REPORT.size], mass[: MASS_REPORT.size])


def test_systems_one_after_the_other_are_a_cycle_bit_by_bit(flown: tuple[Scenario, Run]) -> None:
    scenario, run = flown
    made = params.estimation_params(scenario)
    dut, state = Systems(made), cycle.initial_state(made)
    for sample in samples(scenario, run):
        step = cycle.step(state, sample, made)
        report, filtered = dut.step(sample), step.filtered
        assert filtered.mass is not None
        expected = np.append(ROTATION_REPORT.pack(filtered.rotation), MASS_REPORT.pack(filtered.mass))
        assert_array_equal(report, expected)
        state = step.state
        for name, vector in cycle.save_state(state, made).items():
            assert_array_equal(dut.groups[name], vector, err_msg=f"{name} at {sample.time_s}")
    assert made.detector is None or state.detector.variance.any()

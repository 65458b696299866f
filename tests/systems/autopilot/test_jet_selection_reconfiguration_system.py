"""Jet selection after a declared failure: what stops, what is no longer used, and what is made up for."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import linprog
from systems_probe import PERIOD_S, advance

from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.maths.autopilot.jet_selection import activity_vectors
from massprop_drake.maths.autopilot.phase_space import Urgency
from massprop_drake.systems.autopilot.jet_selection_program import JetSelectionProgram
from massprop_drake.systems.autopilot.jet_selection_system import JetSelection

Array = NDArray[np.float64]

# Make-believe jets: jet 2 i gives +1 and jet 2 i + 1 gives -1 of the i-th component of torque about the
# origin and force; with mass 1, unit inertia and the center of mass at the origin, on-times equal a request's
# elements. Jets 12 and 13 do what jets 0 and 8 do, for twice the propellant.
AXES = np.zeros((12, 6))
for _axis in range(6):
    AXES[2 * _axis, _axis] = 1.0
    AXES[2 * _axis + 1, _axis] = -1.0
WRENCHES = np.vstack([AXES, AXES[0], AXES[8]])
N = 14
ROLL, ROLL_SPARE, NO_SPARE = 0, 12, 2  # +x torque twice, +y torque once
PUSH, PUSH_SPARE = 8, 13  # +y force
UNIT_BODY = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
NOTHING = [0.0] * 6


class Pilot:
    """Jet selection with its inputs in hand."""

    def __init__(self, mass_properties: Array = UNIT_BODY):
        self.dut = JetSelection(
            wrenches=WRENCHES,
            mass_flows=np.array([1.0] * 12 + [2.0] * 2),
            minimum_on_times_s=np.full(N, PERIOD_S),
            selectable=np.ones(N, dtype=bool),
            mass_properties=mass_properties,
            period_s=PERIOD_S,
        )
        self.context: Any = self.dut.CreateDefaultContext()
        self.ask(NOTHING, Urgency.NONE)

    def ask(self, change: list[float], urgency: float, limit_s: float = np.inf) -> None:
        self.dut.GetInputPort("request").FixValue(self.context, [*change, limit_s, urgency])

    def hear(self, *removed: int, declared: bool = False, wrench: Any = NOTHING) -> None:
        """What the detector says at this sample and until it says otherwise."""
        out_of_use = np.zeros(N)
        out_of_use[list(removed)] = 1.0
        told = np.concatenate([[float(declared)], wrench, out_of_use])
        self.dut.GetInputPort("reconfiguration").FixValue(self.context, told)

    def declare(self, *removed: int) -> None:
        """A sample at which jets are declared failed; afterwards they stay so."""
        self.hear(*removed, declared=True)
        self.fire()
        self.hear(*removed)

    def fire(self) -> list[int]:
        """The jets that fire over the coming sample, which is then over."""
        command = self.out("command")
        advance(self.dut, self.context)
        return np.flatnonzero(command).tolist()

    def out(self, name: str) -> Array:
        return self.dut.GetOutputPort(name).Eval(self.context)

    def out_of_use(self) -> list[int]:
        return np.flatnonzero(self.out("out_of_use") > 0.0).tolist()


@pytest.fixture
def pilot() -> Pilot:
    return Pilot()


# ---------------------------------------------------------------------------------------------- the reset


def test_without_news_nothing_changes(pilot: Pilot) -> None:
    pilot.hear()
    pilot.ask([0.16, 0.0, 0.0, 0.0, 0.0, 0.0], Urgency.WHEN_IDLE)
    assert pilot.fire() == [ROLL]
    pilot.ask(NOTHING, Urgency.NONE)
    assert pilot.fire() == [ROLL]
    assert pilot.fire() == []
    assert pilot.out_of_use() == []


def test_a_declared_failure_stops_the_running_burst(pilot: Pilot) -> None:
    pilot.ask([0.0, 0.4, 0.0, 0.0, 0.0, 0.0], Urgency.WHEN_IDLE)
    assert pilot.fire() == [NO_SPARE]
    pilot.ask(NOTHING, Urgency.NONE)
    pilot.hear(PUSH, declared=True)
    assert pilot.fire() == []
    pilot.hear(PUSH)
    assert pilot.fire() == []
    assert not pilot.out("held_command").any()


def test_a_request_is_served_at_once_after_the_reset(pilot: Pilot) -> None:
    pilot.ask([0.0, 0.4, 0.0, 0.0, 0.0, 0.0], Urgency.WHEN_IDLE)
    pilot.fire()
    # the burst of five cycles would have kept this one waiting
    pilot.ask([0.0, 0.0, 0.08, 0.0, 0.0, 0.0], Urgency.WHEN_IDLE)
    pilot.hear(PUSH, declared=True)
    assert pilot.fire() == [4]


def test_only_the_declaration_resets(pilot: Pilot) -> None:
    pilot.declare(PUSH)
    pilot.ask([0.0, 0.24, 0.0, 0.0, 0.0, 0.0], Urgency.WHEN_IDLE)
    assert pilot.fire() == [NO_SPARE]
    pilot.ask(NOTHING, Urgency.NONE)
    assert pilot.fire() == [NO_SPARE]
    assert pilot.fire() == [NO_SPARE]


# -------------------------------------------------------------------------------------------- out of use


def test_a_jet_out_of_use_is_replaced_from_the_same_sample_on(pilot: Pilot) -> None:
    pilot.ask([0.08, 0.0, 0.0, 0.0, 0.0, 0.0], Urgency.WHEN_IDLE)
    assert pilot.fire() == [ROLL]
    pilot.hear(ROLL, declared=True)
    assert pilot.fire() == [ROLL_SPARE]
    assert pilot.out_of_use() == [ROLL]
    pilot.hear(ROLL)
    assert pilot.fire() == [ROLL_SPARE]


def test_what_it_alone_could_push_is_met_in_part(pilot: Pilot) -> None:
    pilot.declare(PUSH, PUSH_SPARE)
    pilot.ask([0.0, 0.08, 0.0, 0.0, 0.16, 0.0], Urgency.AT_ONCE, limit_s=2.0)
    assert pilot.fire() == [NO_SPARE]
    assert pilot.out("counts")[1] == 1.0
    assert pilot.out("counts")[3] == pytest.approx(0.0, abs=1e-8)


def test_jets_without_which_control_is_lost_stay_in_use(pilot: Pilot) -> None:
    pilot.declare(NO_SPARE)
    assert pilot.out_of_use() == []
    assert np.flatnonzero(pilot.out("out_of_use") < 0.0).tolist() == [NO_SPARE]  # reported all the same
    pilot.ask([0.0, 0.08, 0.0, 0.0, 0.0, 0.0], Urgency.WHEN_IDLE)
    assert pilot.fire() == [NO_SPARE]


@pytest.mark.parametrize("jet", range(6))
def test_control_counts_about_every_axis_in_both_senses(jet: int) -> None:
    pilot = Pilot()
    pilot.declare(jet)
    assert pilot.out_of_use() == ([jet] if jet == ROLL else [])


def test_a_pair_of_which_one_is_needed_stays_in_use(pilot: Pilot) -> None:
    pilot.declare(ROLL, ROLL_SPARE)
    assert pilot.out_of_use() == []


def test_a_jet_that_can_be_spared_goes_though_another_had_to_stay(pilot: Pilot) -> None:
    # the detector goes on naming the first, which control cannot do without
    pilot.declare(NO_SPARE)
    pilot.declare(NO_SPARE, ROLL)
    assert ROLL in pilot.out_of_use()
    assert NO_SPARE not in pilot.out_of_use()


def test_a_second_failure_adds_to_the_first(pilot: Pilot) -> None:
    pilot.declare(PUSH)
    pilot.declare(PUSH, ROLL)
    assert pilot.out_of_use() == [ROLL, PUSH]


# ------------------------------------------------------------------------------------------ known forces


def test_a_known_force_is_made_up_for_in_every_idle_cycle(pilot: Pilot) -> None:
    # 0.9 of torque about z over a period of 0.08 s takes 0.072 s of jet 5: one cycle
    pilot.hear(wrench=[0.0, 0.0, 0.9, 0.0, 0.0, 0.0])
    assert [pilot.fire() for _ in range(4)] == [[5]] * 4
    pilot.hear()
    assert pilot.fire() == []


def test_a_known_push_off_the_center_of_mass_is_made_up_for_in_turning_and_pushing() -> None:
    # the center of mass at (0, 0, -1): a push of 0.9 along x at the origin turns by 0.9 about y; the jets' own
    # torques are about the origin too, so a push along -x undoes both
    moved = UNIT_BODY.copy()
    moved[8] = -1.0
    pilot = Pilot(moved)
    pilot.hear(wrench=[0.0, 0.0, 0.0, 0.9, 0.0, 0.0])
    assert pilot.fire() == [7]


def test_a_known_force_is_undone_together_with_the_request(pilot: Pilot) -> None:
    # +y turn of 0.16, two cycles by itself, less what the known torque gives in them, 0.08: one cycle
    pilot.hear(wrench=[0.0, 0.5, 0.0, 0.0, 0.0, 0.0])
    pilot.ask([0.0, 0.16, 0.0, 0.0, 0.0, 0.0], Urgency.WHEN_IDLE)
    assert pilot.fire() == [NO_SPARE]
    pilot.hear()
    pilot.ask(NOTHING, Urgency.NONE)
    assert pilot.fire() == []


def test_a_translation_allows_for_the_force_over_all_its_time(pilot: Pilot) -> None:
    # 0.32 along +z within 0.8 s against -0.5 all the while: 0.72, nine cycles of jet 10
    pilot.hear(wrench=[0.0, 0.0, 0.0, 0.0, 0.0, -0.5])
    pilot.ask([0.0, 0.0, 0.0, 0.0, 0.0, 0.32], Urgency.AT_ONCE, limit_s=0.8)
    fired = [pilot.fire()]
    pilot.ask(NOTHING, Urgency.NONE)
    pilot.hear()
    fired += [pilot.fire() for _ in range(10)]
    assert fired == [[10]] * 9 + [[]] * 2


def test_a_known_force_too_small_for_a_cycle_leaves_the_jets_alone(pilot: Pilot) -> None:
    pilot.hear(wrench=[0.0, 0.0, 0.4, 0.0, 0.0, 0.0])
    assert [pilot.fire() for _ in range(3)] == [[]] * 3


def test_the_failed_jet_is_not_used_against_itself(pilot: Pilot) -> None:
    # jet 9 (-y force) sticks on; what undoes it is jet 8, and jet 9 is out of use
    pilot.hear(9, declared=True, wrench=0.9 * WRENCHES[9])
    assert pilot.fire() == [PUSH]
    pilot.hear(9, wrench=0.9 * WRENCHES[9])
    assert pilot.fire() == [PUSH]
    assert pilot.out_of_use() == [9]


@pytest.mark.parametrize("stuck", ["R4R", "F1L", "R2U", "L4U", "L4D", "F1F"])
def test_rates_stay_small_with_a_jet_stuck_on(orbiter: Vehicle, stuck: str) -> None:
    # the orbiter turning by the sum of its jets' activity vectors, for 16 s; the stuck jet alone would give
    # 0.1 to 0.5 deg/s every second, and the other jets can undo any one
    primary = np.array([jet.kind == "primary" for jet in orbiter.jets])
    properties = orbiter.nominal.vector()
    dut = JetSelection(
        wrenches=orbiter.wrenches,
        mass_flows=orbiter.mass_flows,
        minimum_on_times_s=orbiter.minimum_on_times_s,
        selectable=primary,
        mass_properties=properties,
        period_s=PERIOD_S,
    )
    context: Any = dut.CreateDefaultContext()
    activity = activity_vectors(orbiter.wrenches, properties)[:3]
    failed = orbiter.jet_index(stuck)
    deadband = np.deg2rad(0.02)
    rate, largest = np.zeros(3), 0.0
    for number in range(200):
        told = np.concatenate([[float(number == 0)], orbiter.wrenches[failed], np.eye(44)[failed]])
        dut.GetInputPort("reconfiguration").FixValue(context, told)
        urgency = Urgency.WHEN_IDLE if np.abs(rate).max() > deadband else Urgency.NONE
        dut.GetInputPort("request").FixValue(context, [*-rate, 0.0, 0.0, 0.0, np.inf, urgency])
        command = dut.GetOutputPort("command").Eval(context)
        assert command[failed] == 0.0
        advance(dut, context)
        rate = rate + (activity[:, failed] + activity @ command) * PERIOD_S
        largest = max(largest, float(np.abs(rate).max()))
    assert largest < np.deg2rad(0.2)


# ---------------------------------------------------------------------------------------- control authority

# tighter than HiGHS's own 1e-7, so that what is compared is not its tolerance
HIGHS = {"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10}


def furthest(activity: Array, row: int, sign: float, limits_s: Array) -> float:
    """The reach by HiGHS: on-times as variables, rotations other than the row's held at zero."""
    rows = activity / np.abs(activity).max(axis=1)[:, None]
    held = [axis for axis in range(3) if axis != row]
    found = linprog(
        -sign * rows[row],
        A_eq=rows[held],
        b_eq=np.zeros(len(held)),
        bounds=np.column_stack([np.zeros_like(limits_s), limits_s]),
        method="highs",
        options=HIGHS,
    )
    assert found.status == 0, found.message
    return float(-found.fun * np.abs(activity[row]).max())


@pytest.fixture(scope="module")
def authority(orbiter: Vehicle) -> tuple[JetSelectionProgram, Array, NDArray[np.bool_]]:
    activity = activity_vectors(orbiter.wrenches, orbiter.nominal.vector())
    primary = np.array([jet.kind == "primary" for jet in orbiter.jets])
    return JetSelectionProgram(orbiter.mass_flows), activity, primary


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("row", range(6))
@pytest.mark.parametrize("time_s", [1.0, PERIOD_S])
def test_reach_against_highs(
    authority: tuple[JetSelectionProgram, Array, NDArray[np.bool_]], row: int, sign: float, time_s: float
) -> None:
    program, activity, primary = authority
    rng = np.random.default_rng(1)
    for share in (1.0, 0.6, 0.4):
        available = primary & (rng.random(primary.size) < share)
        limits = np.where(available, time_s, 0.0)
        expected = furthest(activity, row, sign, limits)
        # Clp's absolute tolerance of 1e-7, on numbers of the order of 0.01 to 1 here
        np.testing.assert_allclose(program.reach(activity, row, sign, limits), expected, rtol=1e-5)


def test_reach_of_make_believe_jets_is_their_time() -> None:
    program = JetSelectionProgram(np.ones(N))
    activity = activity_vectors(WRENCHES, UNIT_BODY)
    limits = np.full(N, 0.5)
    reached = [[program.reach(activity, row, sign, limits) for sign in (1.0, -1.0)] for row in range(6)]
    # two jets for +x turning and +y pushing
    expected = [[1.0, 0.5], [0.5, 0.5], [0.5, 0.5], [0.5, 0.5], [1.0, 0.5], [0.5, 0.5]]
    np.testing.assert_allclose(reached, expected, rtol=1e-6)


def test_reach_scales_with_the_body(authority: tuple[JetSelectionProgram, Array, NDArray[np.bool_]]) -> None:
    # a hundred thousand times the inertia and mass: a hundred thousandth of the reach, as exact as before
    program, activity, primary = authority
    limits = np.where(primary, 1.0, 0.0)
    for row in range(6):
        heavy = program.reach(1e-5 * activity, row, 1.0, limits)
        np.testing.assert_allclose(heavy, 1e-5 * program.reach(activity, row, 1.0, limits), rtol=1e-5)


def test_reach_is_nothing_where_no_combination_gets(
    authority: tuple[JetSelectionProgram, Array, NDArray[np.bool_]], orbiter: Vehicle
) -> None:
    # these five cannot pitch up without rolling or yawing; a reach above zero would keep up the appearance of
    # control and let a needed jet be taken out of use
    program, activity, _ = authority
    few = [orbiter.jet_index(name) for name in ("F1U", "F2D", "L1L", "R1R", "R5R")]
    limits = np.zeros(44)
    limits[few] = 1.0
    assert furthest(activity, 1, 1.0, limits) < 1e-12
    most = program.reach(activity, 1, -1.0, np.ones(44))
    assert program.reach(activity, 1, 1.0, limits) < 1e-6 * most


def test_no_jets_reach_nothing(authority: tuple[JetSelectionProgram, Array, NDArray[np.bool_]]) -> None:
    program, activity, _ = authority
    assert [program.reach(activity, row, 1.0, np.zeros(44)) for row in range(6)] == [0.0] * 6

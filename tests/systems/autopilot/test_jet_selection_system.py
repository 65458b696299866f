"""Jet selection as a system: bursts of whole cycles, when a request is taken, and what a declared failure changes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from systems_probe import PERIOD_S, advance, feedthrough, give, inputs, output, outputs

from massprop_drake.maths.autopilot.phase_space import Urgency
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.systems import JetSelection

# Make-believe jets: jet 2 i gives +1 and jet 2 i + 1 gives -1 of the i-th component of torque about the
# origin and force; with mass 1, unit inertia and the center of mass at the origin, on-times equal a request's
# elements. Jets 12 and 13 do what jets 0 and 8 do, for twice the propellant.
WRENCHES = np.kron(np.eye(6), [[1.0], [-1.0]])
WRENCHES = np.vstack([WRENCHES, WRENCHES[0], WRENCHES[8]])
N = 14
ROLL, SPARE_ROLL, PITCH, PUSH = 0, 12, 2, 8  # +x torque twice, +y torque once, +y force twice
UNIT_BODY = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
IDLE, ONCE = Urgency.WHEN_IDLE, Urgency.AT_ONCE


def change(**by: float) -> Array:
    """A request or a wrench by components: turning (x, y, z) and pushing (u, v, w)."""
    return np.array([by.get(name, 0.0) for name in "xyzuvw"])


class Pilot:
    """Jet selection with its inputs in hand."""

    def __init__(self, **given: Any):
        made = {
            "wrenches": WRENCHES,
            "mass_flows": np.array([1.0] * 12 + [2.0] * 2),
            "minimum_on_times_s": np.full(N, PERIOD_S),
            "selectable": np.ones(N, dtype=bool),
            "mass_properties": UNIT_BODY,
            "period_s": PERIOD_S,
        }
        self.dut = JetSelection(**(made | given))
        self.context: Any = self.dut.CreateDefaultContext()
        self.ask(np.zeros(6), Urgency.NONE)

    def ask(self, wanted: Array, urgency: float = IDLE, limit_s: float = np.inf) -> None:
        give(self.dut, self.context, request=[*wanted, limit_s, urgency])

    def hear(self, *removed: int, declared: bool = False, wrench: Any = (0.0,) * 6) -> None:
        """State that the detector declares at this sample and until it says otherwise."""
        give(self.dut, self.context, reconfiguration=[float(declared), *wrench, *np.isin(np.arange(N), removed)])

    def declare(self, *removed: int) -> None:
        """A sample at which jets are declared failed; afterwards they stay so."""
        self.hear(*removed, declared=True)
        self.fire()
        self.hear(*removed)

    def fire(self, count: int = 1) -> list[list[int]]:
        """The jets that fire in the coming samples."""
        found = []
        for _ in range(count):
            command = self.out("command")
            advance(self.dut, self.context)
            assert_array_equal(self.out("held_command"), command)
            given = WRENCHES[:, 3:].T @ command * PERIOD_S
            assert_allclose(self.out("delivered"), given, rtol=1e-14)
            found.append(np.flatnonzero(command).tolist())
        return found

    def burst(self, wanted: Array, urgency: float = IDLE, limit_s: float = np.inf) -> dict[int, int]:
        """The jets that fire for a request that is asked for once, and for how many cycles."""
        self.ask(wanted, urgency, limit_s)
        first = self.fire()
        self.ask(np.zeros(6), Urgency.NONE)
        fired = [jet for jets in first + self.fire(12) for jet in jets]
        return {jet: fired.count(jet) for jet in set(fired)}

    def out(self, name: str) -> Array:
        return output(self.dut, self.context, name)

    def counts(self) -> list[float]:
        return self.out("counts").tolist()


def test_topology() -> None:
    pilot = Pilot()
    told = {"estimate": 10, "converged": 1, "reconfiguration": 7 + N, "prescribed": N}
    assert inputs(pilot.dut) == {"request": 8, **told}
    assert outputs(pilot.dut) == {"command": N, "held_command": N, "delivered": 3, "counts": 4, "out_of_use": N}
    # held_command feeds the continuous plant and the estimators, delivered the controller: loops that
    # only their being state breaks
    assert feedthrough(pilot.dut) == {
        name: set(inputs(pilot.dut)) if name == "command" else set() for name in outputs(pilot.dut)
    }
    assert pilot.fire() == [[]]
    assert pilot.counts() == [0.0, 0.0, 0.0, 1.0]


@pytest.mark.parametrize(
    ("wanted", "given", "expected"),
    [
        (change(x=0.25, w=-0.13), {}, {0: 3, 11: 2}),  # 3.1 and 1.6 cycles
        *((change(y=-on_s), {}, {3: n} if n else {}) for on_s, n in ((0.039, 0), (0.041, 1), (0.119, 1), (0.121, 2))),
        (change(x=0.08), {"minimum_on_times_s": np.full(N, 0.2)}, {0: 3}),  # 2.5 cycles
        (
            change(x=0.16, y=0.08),
            {"selectable": ~np.isin(np.arange(N), (0, 12))},
            {2: 1},
        ),  # nothing else turns about +x
    ],
)
def test_on_times_are_fired_as_whole_cycles(wanted: Array, given: dict[str, Any], expected: dict[int, int]) -> None:
    pilot = Pilot(**given)
    assert pilot.burst(wanted) == expected
    assert pilot.counts()[2] == ("selectable" in given)  # met by the closest reachable


def test_a_request_waits_for_the_running_burst_unless_it_is_urgent() -> None:
    pilot = Pilot()
    pilot.ask(change(x=0.16))
    fired = pilot.fire()
    pilot.ask(change(y=0.16))
    fired += pilot.fire(2)
    assert pilot.counts()[0] == 2.0
    pilot.ask(change(z=0.4), ONCE, 2.0)
    fired += pilot.fire()
    pilot.ask(np.zeros(6), ONCE)  # of nothing: it ends the burst
    assert fired + pilot.fire() == [[ROLL], [ROLL], [PITCH], [4], []]
    give(pilot.dut, pilot.context, prescribed=np.eye(N)[7])  # fires instead, and no request is served
    pilot.ask(change(x=0.16))
    assert pilot.fire(2) == [[7], [7]]
    give(pilot.dut, pilot.context, prescribed=np.zeros(N))
    assert pilot.fire() == [[ROLL]]


def test_a_request_too_small_for_a_cycle_is_solved_once_and_again_only_when_it_has_grown() -> None:
    pilot, solved = Pilot(), []
    for asked in (0.03, 0.03, 0.0399, 0.0401):  # half a cycle is 0.04 s: a change of 0.01 rad/s is needed
        pilot.ask(change(x=asked))
        fired = pilot.fire()
        solved.append(pilot.counts()[0])
    assert (fired, solved) == ([[ROLL]], [1.0, 1.0, 1.0, 2.0])


def test_a_translation_beyond_its_time_is_met_in_part_and_counted() -> None:
    # 0.8 ft/s in at most 0.2 s with two jets of 1 ft/s^2: half of it
    pilot = Pilot()
    assert pilot.burst(change(v=0.8), ONCE, 0.24) == {8: 3, 13: 3}
    assert pilot.counts()[1:3] == [1.0, 0.0]
    assert pilot.counts()[3] == pytest.approx(0.6, rel=1e-8)  # the program gives up 1e-9 on purpose


def test_estimates_are_used_once_they_have_converged() -> None:
    # by the estimate the body is twice as hard to turn about x, and has half the mass
    pilot, estimate = Pilot(), UNIT_BODY * [0.5, *[1.0] * 8, 2.0]
    for converged, numbers, cycles, delivered in (
        (0.0, estimate, 1, 0.08),
        (0.0, np.full(10, np.nan), 1, 0.08),
        (1.0, estimate, 2, 0.16),
    ):
        give(pilot.dut, pilot.context, estimate=numbers, converged=[converged])
        pilot.ask(change(x=0.08, u=0.8), ONCE, 2.0)
        advance(pilot.dut, pilot.context)
        assert_allclose(pilot.out("delivered"), [delivered, 0.0, 0.0], rtol=1e-14)
        pilot.ask(np.zeros(6), ONCE)
        advance(pilot.dut, pilot.context)
        pilot.ask(change(x=0.08))
        turned = 0.0
        for _ in range(4):
            turned += pilot.out("command")[ROLL]
            advance(pilot.dut, pilot.context)
            pilot.ask(np.zeros(6), Urgency.NONE)
        assert turned == cycles


# ------------------------------------------------------------------------------------- a declared failure


def test_a_declared_failure_stops_the_burst_once_and_a_spare_jet_takes_over() -> None:
    pilot = Pilot()
    pilot.hear()
    pilot.ask(change(y=0.4))
    fired = pilot.fire()
    pilot.ask(change(x=0.08))  # which the burst of five cycles would have kept waiting
    pilot.hear(ROLL, declared=True)
    fired += pilot.fire()
    assert np.flatnonzero(pilot.out("out_of_use")).tolist() == [ROLL]
    pilot.hear(ROLL)
    pilot.ask(change(y=0.16))
    fired += pilot.fire()
    pilot.ask(np.zeros(6), Urgency.NONE)
    assert fired + pilot.fire(2) == [[PITCH], [SPARE_ROLL], [PITCH], [PITCH], []]
    assert pilot.burst(change(y=0.08, v=0.16), ONCE, 2.0) == {PITCH: 1, PUSH: 2}
    pilot.declare(ROLL, PUSH, 13)
    assert pilot.burst(change(y=0.08, v=0.16), ONCE, 2.0) == {PITCH: 1}  # the rest nothing can give
    assert pilot.counts()[3] == pytest.approx(0.0, abs=1e-8)


@pytest.mark.parametrize(
    ("declared", "out", "kept"),
    [
        *(([(jet,)], [jet] if jet == ROLL else [], [] if jet == ROLL else [jet]) for jet in range(6)),
        ([(ROLL, SPARE_ROLL)], [], [ROLL, SPARE_ROLL]),  # of which one is needed
        ([(PITCH,), (PITCH, ROLL)], [ROLL], [PITCH]),  # the detector goes on naming the first
        ([(PUSH,), (PUSH, ROLL)], [ROLL, PUSH], []),
    ],
)
def test_jets_without_which_control_is_lost_stay_in_use(
    declared: list[Sequence[int]], out: list[int], kept: list[int]
) -> None:
    pilot = Pilot()
    for jets in declared:
        pilot.declare(*jets)
    marks = pilot.out("out_of_use")
    assert (np.flatnonzero(marks > 0.0).tolist(), np.flatnonzero(marks < 0.0).tolist()) == (out, kept)
    assert pilot.burst(change(y=0.08)) == {PITCH: 1}


LOW = np.append(UNIT_BODY[:8], [-1.0, 1.0])  # the center of mass at (0, 0, -1)


@pytest.mark.parametrize(
    ("wrench", "body", "asked", "fired"),
    [
        # 0.9 of torque about z over a period of 0.08 s takes 0.072 s of jet 5: one cycle, in every idle one
        (change(z=0.9), UNIT_BODY, None, [[5]] * 3),
        # a push of 0.9 along x at the origin turns by 0.9 about y; the jets' own torques are about the origin too, so
        # a push along -x undoes both
        (change(u=0.9), LOW, None, [[7]] * 3),
        # +y turn of 0.16, two cycles by itself, less what the known torque gives in them, 0.08: one cycle
        (change(y=0.5), UNIT_BODY, (change(y=0.16), IDLE, np.inf), [[PITCH], [], []]),
        # 0.32 along +z within 0.8 s against -0.5 all the while: 0.72, nine cycles of jet 10
        (change(w=-0.5), UNIT_BODY, (change(w=0.32), ONCE, 0.8), [[10]] * 9 + [[]]),
    ],
)
def test_a_known_force_is_made_up_for(
    wrench: Array, body: Array, asked: tuple[Array, float, float] | None, fired: list[list[int]]
) -> None:
    pilot = Pilot(mass_properties=body)
    pilot.hear(wrench=wrench)
    if asked is not None:
        pilot.ask(*asked)
    found = pilot.fire()
    if asked is not None:
        pilot.ask(np.zeros(6), Urgency.NONE)
        pilot.hear()
    assert found + pilot.fire(len(fired) - 1) == fired

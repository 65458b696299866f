"""What valves let through: against integration of the level in small steps, and derivatives against differences."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from massprop_drake.maths.estimation.pose.openings import Openings, OpeningTimes, average_openings, openings_between
from massprop_drake.maths.estimation.pose.pose_layout import Commands

BEGIN_S, END_S = 1.0, 1.1
SPAN_S = END_S - BEGIN_S


def timing(delay_s: float = 0.0, lag_s: float = 0.02, opening_s: float = 0.0) -> OpeningTimes:
    return OpeningTimes(*(np.array([[value]]) for value in (delay_s, lag_s, opening_s)))


def one_jet(*switches: tuple[float, float]) -> Commands:
    times, levels = zip(*switches, strict=True)
    return Commands(np.array(times), np.array(levels)[:, None])


def integrated(commands: Commands, valve: OpeningTimes) -> tuple[float, float]:
    """J and JJ by an integrator that stops at every edge; the level begins closed long before."""
    delay, lag, late = (float(part[0, 0]) for part in valve)
    edges: list[tuple[float, float]] = []
    before = 0.0
    ends = [*commands.time_s[1:], np.inf]
    for time_s, end_s, level in zip(commands.time_s, ends, commands.levels[:, 0], strict=True):
        opens = level > 0.0 and before == 0.0
        edges.append((min(time_s + delay + (late if opens else 0.0), end_s + delay), level))
        before = level
    marks = sorted({BEGIN_S, END_S, *(at for at, _ in edges if at < END_S)})
    now, level, once, twice = min(marks) - 1.0, 0.0, 0.0, 0.0
    for mark in marks:
        wanted = 0.0
        for at, target in edges:
            if at <= now + 1e-12:
                wanted = target
        inside = now >= BEGIN_S - 1e-12

        def slope(t: float, y: np.ndarray, wanted: float = wanted, inside: bool = inside) -> list[float]:
            gain = y[0] if inside else 0.0
            return [(wanted - y[0]) / lag, gain, (END_S - t) * gain]

        done = solve_ivp(slope, (now, mark), [level, once, twice], rtol=1e-10, atol=1e-13)
        now, (level, once, twice) = mark, done.y[:, -1]
    return once, twice


CASES = {
    "a pulse before the interval, which still acts": one_jet((0.9, 1.0), (0.99, 0.0)),
    "a pulse across its beginning": one_jet((0.95, 1.0), (1.03, 0.0)),
    "a pulse inside": one_jet((1.01, 1.0), (1.04, 0.0)),
    "two pulses": one_jet((0.95, 1.0), (0.99, 0.0), (1.02, 1.0)),
    "fractions one after the other": one_jet((0.9, 0.3), (1.02, 0.7), (1.06, 0.2)),
    "on for ever": one_jet((0.0, 1.0)),
    "after the interval": one_jet((1.2, 1.0)),
}


@pytest.mark.parametrize("commands", CASES.values(), ids=CASES)
@pytest.mark.parametrize("valve", [timing(), timing(0.03, 0.02, 0.01), timing(-0.013, 0.05, -0.004)])
def test_impulses_are_the_integrals_of_the_level(commands: Commands, valve: OpeningTimes) -> None:
    found = openings_between(commands, BEGIN_S, END_S, valve)
    once, twice = integrated(commands, valve)
    assert float(found.once[0, 0]) == pytest.approx(once, abs=1e-9)
    assert float(found.twice[0, 0]) == pytest.approx(twice, abs=1e-10)
    assert float(found.variance[0, 0]) == 0.0


@pytest.mark.parametrize("commands", CASES.values(), ids=CASES)
@pytest.mark.parametrize("place", range(3), ids=["delay", "ln lag", "opening"])
def test_derivatives_are_central_differences(commands: Commands, place: int) -> None:
    at, step = np.array([0.021, np.log(0.02), 0.007]), 1e-6

    def value(by: float) -> Openings:
        point = at.copy()
        point[place] += by
        return openings_between(commands, BEGIN_S, END_S, timing(point[0], np.exp(point[1]), point[2]))

    found, ahead, behind = value(0.0), value(step), value(-step)
    once = (ahead.once - behind.once) / (2.0 * step)
    twice = (ahead.twice - behind.twice) / (2.0 * step)
    np.testing.assert_allclose(found.once_by[place], once, atol=1e-8)
    np.testing.assert_allclose(found.twice_by[place], twice, atol=1e-9)


def test_an_opening_later_than_the_pulse_is_long_leaves_it_out_and_moves_nothing() -> None:
    found = openings_between(one_jet((1.02, 1.0), (1.04, 0.0)), BEGIN_S, END_S, timing(0.01, 0.02, 0.03))
    assert float(found.once[0, 0]) == pytest.approx(0.0, abs=1e-15)
    assert float(found.twice[0, 0]) == pytest.approx(0.0, abs=1e-15)
    np.testing.assert_array_equal(found.once_by[2], 0.0)
    np.testing.assert_allclose(found.once_by[0], 0.0, atol=1e-15)


def test_an_unknown_command_is_half_open_with_the_variance_of_anything_between() -> None:
    known = one_jet((0.9, 0.0), (1.03, 1.0), (1.07, 0.0))
    unknown = one_jet((0.9, 0.0), (1.03, np.nan), (1.07, 0.0))
    whole, found = (openings_between(commands, BEGIN_S, END_S, timing(0.0, 0.01)) for commands in (known, unknown))
    np.testing.assert_allclose(found.once, 0.5 * whole.once, rtol=1e-12)
    np.testing.assert_allclose(found.twice, 0.5 * whole.twice, rtol=1e-12)
    drawn = np.random.default_rng(2).uniform(size=20_000) * float(whole.once[0, 0])
    assert float(found.variance[0, 0]) == pytest.approx(drawn.var(), rel=0.03)


# ------------------------------------------------------------------------- a delay that is not known


@pytest.mark.parametrize("std_s", [0.02, 0.05])
def test_a_delay_that_is_not_known_is_taken_on_average(std_s: float) -> None:
    """Mean, slope and what is left, against many draws of a smooth enough level."""
    commands, valve = one_jet((0.93, 1.0), (1.02, 0.0)), timing(0.04, lag_s=0.05)
    found = average_openings(commands, (BEGIN_S, END_S), valve, np.array([[std_s]]))
    drawn = np.random.default_rng(2).standard_normal(20_000)
    many = OpeningTimes(*(np.repeat(part, drawn.size, 0) for part in valve))
    many = many._replace(delay_s=many.delay_s + std_s * drawn[:, None])
    every = openings_between(commands, BEGIN_S, END_S, many)
    for own, part in (("once", every.once), ("twice", every.twice)):
        size = part.max()
        assert getattr(found, own)[0, 0] == pytest.approx(part.mean(), abs=0.05 * size)
        slope = (drawn @ part[:, 0]) / drawn.size / std_s
        assert getattr(found, f"{own}_by")[0, 0, 0] == pytest.approx(slope, abs=0.1 * size / std_s)
    left = every.once[:, 0].var() - (std_s * found.once_by[0, 0, 0]) ** 2
    assert 0.5 * left - 1e-7 < np.sum(found.unsure**2) < 2.0 * left + 1e-7


@pytest.mark.parametrize(("opens_s", "begins"), [(0.97, False), (0.99, True), (1.05, True), (1.08, False)])
def test_a_pulse_begins_in_the_interval_in_which_it_opens(opens_s: float, begins: bool) -> None:
    valve = timing(0.01, opening_s=0.015)
    found = openings_between(one_jet((0.5, 0.0), (opens_s, 1.0), (1.3, 0.0)), BEGIN_S, END_S, valve)
    assert found.begins.tolist() == [[begins]]

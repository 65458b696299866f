"""The hypothesis filter on the orbiter, flown open loop through the sample maneuver with lag, told 5 % wrong."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pytest
from detector_probe import (
    Body,
    Failure,
    Release,
    Watch,
    body_of,
    detector_params,
    fly,
    quantized,
    verdict,
    watch,
    watched,
)

from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.maths.estimation.faults.declarations import Declaration, JetsDeclared, JumpDeclared, Word
from massprop_drake.maths.estimation.faults.priors import Params
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.results.run import Run

START = 480  # cycles before anything happens: the filter has settled


class Flight(NamedTuple):
    """The healthy part of a flight, and what continues it."""

    vehicle: Vehicle
    params: Params
    commands: Array
    body: Body
    watch: Watch


def readings(flown: Any, vehicle: Vehicle) -> tuple[Array, Array]:
    """Of one gyro and the accelerometers, quantized at one phase."""
    phase = np.random.default_rng(4).uniform(size=(2, 3))
    rates = quantized(flown.rates[:, None], vehicle.gyros[0].quantum, phase[:1])
    return rates, quantized(flown.velocities, vehicle.accelerometers[0].quantum, phase[1:])


@pytest.fixture(scope="module")
def healthy(sample_run: Run, orbiter: Vehicle) -> Flight:
    params = detector_params(orbiter, dispersed=False)
    commands = sample_run["command"]
    flown = fly(orbiter, body_of(orbiter), commands[:START], 0.0, np.ones(44), [])
    now, said = watched(watch(params), commands[:START], *readings(flown, orbiter), params)
    assert not said
    return Flight(orbiter, params, commands, flown.body, now)


def continued(healthy: Flight, *events: Failure | Release, cycles: int) -> list[tuple[float, Declaration]]:
    """What is said after events, with the time since the first."""
    vehicle, params, commands, body, now = healthy
    rows = commands[START : START + cycles]
    flown = fly(vehicle, body, rows, START * vehicle.sample_period_s, np.ones(44), list(events))
    _, said = watched(now, rows, *readings(flown, vehicle), params)
    first = events[0]
    begin = first.start_s if isinstance(first, Failure) else first.time_s
    return [(time_s - begin, declaration) for time_s, declaration in said]


@pytest.mark.parametrize(("kind", "jet", "size", "limit_s"), [("on", 28, 0.0, 0.3), ("leak", 38, 10.0, 1.5)])
def test_a_failed_jet_is_named_soon(healthy: Flight, kind: str, jet: int, size: float, limit_s: float) -> None:
    found = continued(healthy, Failure(kind, jet, 38.43, size), cycles=25)
    assert verdict(found, {(jet, 1)}) == "right"
    ((after_s, said),) = found
    assert isinstance(said, JetsDeclared)
    assert after_s < limit_s
    force = size or np.linalg.norm(healthy.vehicle.thrusts[jet])
    assert abs(said.forces[0] - force) < 4.5 * said.sigmas[0]


def test_a_release_is_a_jump_and_no_jet(healthy: Flight) -> None:
    said = continued(healthy, Release(38.43, 1000.0, np.array([60.0, 0.0, -3.0])), cycles=60)
    assert [type(declaration) for _, declaration in said] == [JumpDeclared]


@pytest.mark.parametrize(("kind", "size"), [("leak", 40.0), ("on", 0.0)])
def test_a_jet_that_is_told_to_fire_meanwhile_is_named(healthy: Flight, kind: str, size: float) -> None:
    """A leak comes on top of what is told; a jet that is stuck on gives no more when it is told to fire."""
    commands = healthy.commands.copy()
    commands[START + 1 : START + 6, 28] = 1.0
    found = continued(healthy._replace(commands=commands), Failure(kind, 28, 38.43, size), cycles=25)
    assert verdict(found, {(28, 1)}) == "right"
    ((_, said),) = found
    assert isinstance(said, JetsDeclared)
    assert said.forces[0] == pytest.approx(size or 872.0, rel=0.3)


def test_a_force_that_is_known_better_has_not_changed(healthy: Flight) -> None:
    """In the midst of a sample the force is known to a tenth at first, and to a part in a thousand at the next."""
    found = continued(healthy, Failure("on", 28, 38.47), cycles=25)
    assert [said.word for _, said in found if isinstance(said, JetsDeclared)] == [Word.FAILED]


def test_a_jet_that_comes_and_goes_is_erratic(healthy: Flight) -> None:
    """It is withdrawn when it is well, and named anew; from the third change on anything is expected of it."""
    bursts = [Failure("on", 28, 38.43 + k, 0.0, 38.43 + k + 0.5) for k in range(3)]
    found = continued(healthy, *bursts, cycles=40)
    said = [one for _, one in found if isinstance(one, JetsDeclared)]
    assert len(said) == len(found)
    assert {one.jets for one in said} == {(28,)}
    assert [one.word for one in said] == [Word.FAILED, Word.WITHDRAWN, Word.FAILED, Word.ERRATIC]

"""Open-loop flights with failures, for filter and detector on arrays: truth by fine steps, lag told 5 % wrong."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from joint_probe import vehicle_params

from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.maths.estimation.faults.declarations import Declaration, JetsDeclared, Word
from massprop_drake.maths.estimation.faults.priors import Params, Priors
from massprop_drake.maths.estimation.faults.tree import Tree, advance
from massprop_drake.maths.estimation.faults.verdicts import Verdicts, judged
from massprop_drake.maths.estimation.joint.beginning import initial as initial_filter
from massprop_drake.maths.estimation.joint.hypotheses import without_increments
from massprop_drake.maths.estimation.joint.joint_cycle import JointEvidence, step
from massprop_drake.maths.estimation.joint.joint_sample import JointSample
from massprop_drake.maths.estimation.joint.layout import JointState, make_places
from massprop_drake.maths.estimation.joint.ticks import on_ticks
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.linear_algebra import cross as _cross

_STEPS = 4  # of the truth in a sample
TOLD_WRONG = 1.05  # what the filter is told of the lag, over the truth


class Body(NamedTuple):
    """The true vehicle: what it is and how it moves."""

    mass: float
    center: Array
    inertia: Array
    rate: Array
    gathered: Array  # integral of F/m, shape (3,)
    offset: Array  # per accelerometer, what jumps of the center of mass must not change, shape (n, 3)
    level: Array


class Failure(NamedTuple):
    """What is wrong with a jet, and when."""

    kind: str  # on, off, degraded; leak: on top of what is told, seep: only while less is told
    jet: int
    start_s: float
    size: float = 0.0
    end_s: float = np.inf


class Release(NamedTuple):
    """A payload that leaves."""

    time_s: float
    mass: float
    position: Array


def body_of(vehicle: Vehicle, **changed: Any) -> Body:
    """A nominal vehicle at rest."""
    nominal = vehicle.nominal
    n = len(vehicle.accelerometers)
    jets = len(vehicle.jets)
    at_rest = Body(
        nominal.mass,
        np.array(nominal.center_of_mass),
        np.array(nominal.inertia),
        np.zeros(3),
        np.zeros(3),
        np.zeros((n, 3)),
        np.zeros(jets),
    )
    return at_rest._replace(**changed)


def released(body: Body, release: Release) -> Body:
    """The vehicle without its payload, a point mass."""
    mass = body.mass - release.mass
    center = (body.mass * body.center - release.mass * release.position) / mass

    def about(point: Array, of: Array, m: float) -> Array:
        d = of - point
        return m * (d @ d * np.eye(3) - np.outer(d, d))

    inertia = body.inertia + about(center, body.center, body.mass) - about(center, release.position, release.mass)
    return body._replace(mass=mass, center=center, inertia=inertia)


class Flown(NamedTuple):
    """Readings at the end of each interval, before quantizing, and the body then."""

    rates: Array
    velocities: Array
    body: Body


def fly(
    vehicle: Vehicle, body: Body, commands: Array, start_s: float, scale: Array, events: list[Failure | Release]
) -> Flown:
    """Flies a vehicle open loop.

    Args:
        vehicle: jets and sensors.
        body: at the start.
        commands: of each interval, shape (n, n_jets).
        start_s: time of the start.
        scale: true thrust of each jet over nominal, shape (n_jets,).
        events: what happens.
    """
    period = vehicle.sample_period_s
    h = period / _STEPS
    positions = np.array([sensor.position for sensor in vehicle.accelerometers])
    wrenches, thrusts = vehicle.wrenches, np.linalg.norm(vehicle.thrusts, axis=1)
    constants = np.maximum(vehicle.time_constants_s, 1e-9)
    remaining = np.exp(-h / constants)
    part = constants / h * (1.0 - remaining)
    failures = [event for event in events if isinstance(event, Failure)]
    releases = [event for event in events if isinstance(event, Release)]
    done: set[int] = set()
    rates, velocities = [], []
    inverse = np.linalg.inv(body.inertia)
    shift, turned, spin, reference = body.offset, body.gathered, np.zeros((3, 3)), body.rate
    # since the start of this call: y = offset + c + (w - w0) x rho + C rho
    offset = shift
    gathered = turned
    rate, level, mass = body.rate.copy(), body.level.copy(), body.mass
    for k in range(commands.shape[0]):
        for sub in range(_STEPS):
            time = start_s + k * period + sub * h
            for index, release in enumerate(releases):
                if index not in done and time >= release.time_s - 1e-9:
                    done.add(index)
                    before = body._replace(mass=mass)
                    after = released(before, release)
                    rho_before, rho_after = positions - body.center, positions - after.center
                    turn = _skew(rate - reference) + spin
                    offset = offset + (rho_before - rho_after) @ turn.T
                    body, mass, inverse = after, after.mass, np.linalg.inv(after.inertia)
            told = commands[k].copy()
            on_top, least = np.zeros(told.shape[0]), np.zeros(told.shape[0])
            for failure in failures:
                if failure.start_s - 1e-9 <= time < failure.end_s:
                    if failure.kind == "on":
                        told[failure.jet] = 1.0
                    elif failure.kind == "off":
                        told[failure.jet] = 0.0
                    elif failure.kind == "degraded":
                        told[failure.jet] *= failure.size
                    elif failure.kind == "leak":
                        on_top[failure.jet] = failure.size / thrusts[failure.jet]
                    elif failure.kind == "seep":
                        least[failure.jet] = failure.size / thrusts[failure.jet]
            mean = told + (level - told) * part
            level = told + (level - told) * remaining
            given = np.maximum(mean * scale, least) + on_top
            wrench = given @ wrenches
            mass -= float(given @ vehicle.mass_flows) * h
            torque = wrench[:3] - _cross(body.center, wrench[3:])
            middle = rate + 0.5 * h * (inverse @ (torque - _cross(rate, body.inertia @ rate)))
            rate = rate + h * (inverse @ (torque - _cross(middle, body.inertia @ middle)))
            gathered = gathered + wrench[3:] / mass * h
            spin = spin + h * (np.outer(middle, middle) - middle @ middle * np.eye(3))
        turn = _skew(rate - reference) + spin
        rates.append(rate)
        velocities.append(offset + gathered + (positions - body.center) @ turn.T)
    turn = _skew(rate - reference) + spin
    end = body._replace(
        mass=mass,
        rate=rate,
        level=level,
        gathered=gathered,
        offset=offset + (positions - body.center) @ turn.T,
    )
    return Flown(np.array(rates), np.array(velocities), end)


def _skew(w: Array) -> Array:
    return np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])


def quantized(values: Array, quantum: float, phase: Array) -> Array:
    """Readings of a rounding sensor."""
    result: Array = np.round(values / quantum + phase) * quantum - phase * quantum
    return result


def detector_params(vehicle: Vehicle, dispersed: bool, **changed: Any) -> Params:
    """Of a vehicle file, lag told wrong, four slots."""
    plain = vehicle_params(vehicle, lag=True)
    counts = (plain.places.jets, plain.places.gyros, plain.places.accelerometers)
    places = make_places(counts, plain.places.n_lag, (False, False), dispersed, 4, ticks=2)
    joint = plain._replace(
        places=places,
        prior_sigma=np.append(np.ones(places.scale - places.thrust), np.zeros(places.n_scale + 2 + places.n_force)),
        thrust_sigma=0.01 if dispersed else 0.0,
        tick_sigma=0.08 * np.array([0.01, 1e-3]),
        time_constants_s=plain.time_constants_s * TOLD_WRONG,
        **changed,
    )
    return Params(joint, Priors(), np.ones(2 * places.jets), np.ones(places.jets))


class Watch(NamedTuple):
    """Filter and hypotheses on their way."""

    filter: JointState
    tree: Tree
    verdicts: Verdicts
    time_s: float


def watch(params: Params) -> Watch:
    """Before the first sample."""
    return Watch(initial_filter(params.joint), Tree(), Verdicts(), 0.0)


def watched(
    watching: Watch, commands: Array, rates: Array, velocities: Array, params: Params
) -> tuple[Watch, list[tuple[float, Declaration]]]:
    """Filter and hypotheses over some samples, and what was declared when.

    Args:
        watching: before.
        commands: of each interval, shape (n, n_jets).
        rates: readings at its end, shape (n, n_gyros, 3).
        velocities: shape (n, n_accelerometers, 3).
        params: see `Params`.
    """
    own = params._replace(joint=without_increments(params.joint))
    period = 0.08
    said: list[tuple[float, Declaration]] = []
    state, tree, verdicts, time_s = watching
    for command, rate, velocity in zip(commands, rates, velocities, strict=True):
        time_s += period
        sample = JointSample(time_s, np.array([period]), command[None], np.zeros(6), rate, velocity, on_ticks())
        after, report = step(state, sample, params.joint)
        tree = advance(tree, JointEvidence(state, after, report, sample, False), own)
        verdicts, more = judged(verdicts, tree, own)
        state = tree.next_state(own)
        said += [(time_s, declaration) for declaration in more]
    return Watch(state, tree, verdicts, time_s), said


def verdict(said: list[tuple[float, Declaration]], truth: set[tuple[int, int]]) -> str:
    """What the first declaration is worth: right, group (of at most three, with all that failed), wrong or silent.

    Args:
        said: what was declared, and when.
        truth: jets that have failed, with their signs; none: anything that is said is wrong.
    """
    if not said:
        return "silent"
    first = said[0][1]
    if not isinstance(first, JetsDeclared):
        return "wrong"
    named = set(zip(first.jets, first.signs, strict=True))
    if first.word == Word.FAILED and named == truth:
        return "right"
    return "group" if first.word == Word.GROUP and truth <= named and len(named) <= 3 else "wrong"

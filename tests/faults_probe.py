"""Open-loop flights of a small vehicle with faults, for the hypothesis filter: truth by the filter's own prediction."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from joint_probe import PERIOD, TRUTH, small_params, some_sample, unread

from massprop_drake.maths.estimation.faults.declarations import Declaration
from massprop_drake.maths.estimation.faults.priors import Params, Priors
from massprop_drake.maths.estimation.faults.tree import Tree, advance
from massprop_drake.maths.estimation.faults.verdicts import Verdicts, fault_probabilities, update_verdicts
from massprop_drake.maths.estimation.joint import disturbance_states
from massprop_drake.maths.estimation.joint.beginning import initial_joint_state
from massprop_drake.maths.estimation.joint.hypotheses import without_increments
from massprop_drake.maths.estimation.joint.joint_cycle import JointEvidence, estimate_forces, step
from massprop_drake.maths.estimation.joint.joint_sample import JointSample
from massprop_drake.maths.estimation.joint.lagged_impulses import effects_of
from massprop_drake.maths.estimation.joint.layout import CENTER, MASS, JointParams, JointState, make_places
from massprop_drake.maths.estimation.joint.measurement import fix_velocity_reference, predict_outputs
from massprop_drake.maths.estimation.joint.prediction import predict
from massprop_drake.maths.estimation.joint.quantized import FLOOR
from massprop_drake.maths.linear_algebra import Array

JETS = 6
SLOTS = 4
NOISE = (1e-3, 5e-3)  # 1 sigma of a gyro, rad/s, and of an accelerometer, ft/s
Change = Callable[[JointState], JointState]


def make_params(*, quantum: float = 0.0, unstated: int = 0, **priors: float) -> Params:
    """Parameters of a vehicle with six jets, all faults possible.

    The quantum is that of the gyros, rad/s, ten times as large for accelerometers; 0: noise alone. `unstated` are
    components of a disturbance that nobody states: six, or none.
    """
    cells, noise = np.repeat([quantum, 10.0 * quantum], 6), np.repeat(NOISE, 6) if quantum == 0.0 else np.full(12, 1e-5)
    joint = small_params(
        places=make_places((JETS, 2, 2, 0, 0, 0, 0, 0, unstated), 0, (False, False), False, SLOTS),
        prior_sigma=np.zeros(SLOTS),
        time_constants_s=np.zeros(JETS),
        flows=np.zeros(JETS),
        second_order=False,
        variances=noise**2 + cells**2 / 12.0,
        quanta=cells,
        cells=cells,
        floors=noise**2 + (FLOOR * cells) ** 2,
        dithered=np.full(12, float(quantum == 0.0)),
    )
    if unstated:
        joint = joint._replace(unstated=disturbance_states.unstated_unit_effects(effects_of(joint.wrenches, TRUTH), 2))
    return Params(without_increments(joint), Priors(**priors), np.ones(2 * JETS), np.ones(JETS))


def known_vehicle(params: JointParams) -> JointState:
    """The filter's state before the first sample: converged, the ten parameters known to a thousandth."""
    state = initial_joint_state(params)
    root = np.zeros_like(state.root)
    root[range(10), range(10)] = 1e-3 * np.abs(TRUTH)
    root[range(10, params.places.force), range(10, params.places.force)] = 1e-4
    root[params.places.slow : params.places.thrust] = 0.0
    return state._replace(root=root, started=True, guarded=True, firing_count=100.0)


def fail(jet: int, force: float, sign: int = 1, on_top: int = 0) -> Change:
    """A failure of a jet: its force, lbf or N, more (1) or less (-1), on top of its commands (1) or in their place."""

    def change(truth: JointState) -> JointState:
        slot = int(np.flatnonzero((truth.slot_jet < 0) | (truth.slot_jet == jet))[0])
        mean, at = truth.mean.copy(), np.eye(SLOTS)[slot]
        mean[-SLOTS + slot] = force
        return truth._replace(
            mean=mean,
            slot_jet=np.where(at > 0.0, float(jet), truth.slot_jet),
            slot_sign=np.where(at > 0.0, float(sign), truth.slot_sign),
            slot_on_top=np.where(at > 0.0, float(on_top), truth.slot_on_top),
        )

    return change


def push(params: JointParams, accelerations: Array) -> Change:
    """Something besides the jets that pushes from now on: change of w and c by it in a second, shape (6,)."""

    def change(truth: JointState) -> JointState:
        mean = truth.mean.copy()
        begin = params.places.unstated
        mean[begin : begin + 6] = accelerations / params.unstated.diagonal()
        return truth._replace(mean=mean, stir_s=1e9)

    return change


def dock(params: JointParams, share: float) -> Change:
    """A payload of some share of the vehicle's mass, which moves the center of mass and adds inertia."""

    def change(truth: JointState) -> JointState:
        truth = fix_velocity_reference(truth, params)
        mean = truth.mean.copy()
        mean[:3] /= 1.0 + share
        mean[CENTER] += share * np.array([0.4, -0.2, 0.3])
        mean[MASS] /= 1.0 + share
        return truth._replace(mean=mean)

    return change


@dataclass(frozen=True, repr=False)
class Flown:
    """A flight: trees, verdicts, declarations and true states after each sample."""

    params: Params
    samples: list[JointSample]
    trees: list[Tree]
    verdicts: list[Verdicts]
    said: list[tuple[float, Declaration]]
    filters: list[JointState]
    truths: list[JointState]

    @property
    def tree(self) -> Tree:
        """The last tree."""
        return self.trees[-1]

    def probability(self, jet: int, after: int = -1) -> float:
        """Posterior probability that a jet has failed, after a sample."""
        return float(fault_probabilities(self.trees[after], self.params.joint).jets[jet])


def commands_of(count: int, seed: int = 2, idle: tuple[int, ...] = ()) -> Array:
    """Commands at random, jets named never, shape (count, JETS)."""
    commands = (np.random.default_rng(seed).uniform(size=(count, JETS)) < 0.3).astype(float)
    commands[:, list(idle)] = 0.0
    return commands


def samples_of(
    params: JointParams,
    commands: Array,
    changes: dict[int, Change] | None = None,
    false: dict[int, Array] | None = None,
) -> tuple[list[JointSample], list[JointState]]:
    """Samples of a flight, and the truth after each.

    By index: changes of the truth before an interval, and what is added to the readings, shape (12,).
    """
    rng, truth = np.random.default_rng(7), known_vehicle(params)
    offset = np.where(params.cells > 0.0, rng.uniform(size=12) * params.cells, 0.0)
    noise = np.sqrt(params.variances - params.cells**2 / 12.0)
    samples, truths = [], []
    for k, command in enumerate(commands):
        truth = (changes or {}).get(k, lambda same: same)(truth)
        sample = some_sample(params, time_s=(k + 1) * PERIOD, commands=command[None])
        acting = estimate_forces(truth, sample, params)
        prediction = predict(truth, acting, unread(params), params)
        truth = truth._replace(
            mean=prediction.mean,
            spin=truth.spin + prediction.spin,
            level=acting.firing.level,
            slope=acting.firing.slope,
            tick_slope=acting.tick_slope,
            time_s=sample.time_s,
        )
        read, _ = predict_outputs(truth.mean, truth.reference, truth.spin, params)
        read = read + rng.standard_normal(12) * noise
        cells = np.where(params.cells > 0.0, params.cells, 1.0)
        read = np.where(params.cells > 0.0, np.round((read - offset) / cells) * cells + offset, read)
        read = read + (false or {}).get(k, np.zeros(12))
        samples.append(sample._replace(rates=read[:6].reshape(2, 3), velocities=read[6:].reshape(2, 3)))
        truths.append(truth)
    return samples, truths


def flight(params: Params, commands: Array, **events: Any) -> Flown:
    """A flight with its hypotheses; `events` as of `samples_of`."""
    samples, truths = samples_of(params.joint, commands, **events)
    flown = Flown(params, samples, [], [], [], [], truths)
    return follow(flown, Tree(), Verdicts(), known_vehicle(params.joint), 0)


@cache
def leaking(quantum: float) -> Flown:
    """A flight in which a jet that is never told to fire leaks by 2 % of its thrust, from interval 30 on."""
    params = make_params(quantum=quantum)
    return flight(params, commands_of(45, idle=(3,)), changes={30: fail(3, 0.02 * params.joint.thrusts[3], 1, 1)})


def follow(flown: Flown, tree: Tree, verdicts: Verdicts, state: JointState, first: int) -> Flown:
    """The hypotheses over the samples of a flight from an index on."""
    params = flown.params
    trees, past, said, filters = [], [], [], []
    for sample in flown.samples[first:]:
        after, report = step(state, sample, params.joint)
        tree = advance(tree, JointEvidence(state, after, report, sample, False), params)
        verdicts, more = update_verdicts(verdicts, tree, params)
        said += [(sample.time_s, one) for one in more]
        state = tree.next_state(params)
        trees.append(tree)
        past.append(verdicts)
        filters.append(state)
    return Flown(params, flown.samples, trees, past, said, filters, flown.truths)

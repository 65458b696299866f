"""Hypotheses, their events and priors: what is the same, twins of a jet, gaps, and forces by quadrature."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
from faults_probe import commands_of, known_vehicle, make_params, samples_of
from joint_probe import some_sample
from scipy.integrate import quad
from scipy.stats import norm

from massprop_drake.maths.estimation.faults.fault_events import (
    ANEW,
    Event,
    Hypothesis,
    no_fault_hypothesis,
    restart_hypothesis,
    slot_force,
    split_on_command,
    update_weight,
)
from massprop_drake.maths.estimation.faults.priors import (
    Priors,
    force_correction,
    log_event_probability,
    log_feasible_force,
)
from massprop_drake.maths.estimation.joint.hypotheses import NO_SCORE, Cause, Kind, apply_cause

PARAMS = make_params()
JOINT = PARAMS.joint


def hypothesis(*causes: Cause) -> Hypothesis:
    """A hypothesis with these events, the forces of its jets in slots, half of full thrust each."""
    state = known_vehicle(JOINT)
    for cause in causes:
        state = apply_cause(state, cause, JOINT) if cause.kind == Kind.JETS else state
    mean = state.mean.copy()
    mean[JOINT.places.force :] = np.where(state.slot_jet >= 0, 0.5 * JOINT.thrusts[state.slot_jet.astype(int)], 0.0)
    one = no_fault_hypothesis(state._replace(mean=mean), 5, JOINT)
    events = tuple(Event(cause, float(number), NO_SCORE) for number, cause in enumerate(causes))
    run = one.run._replace(cause=causes[-1] if causes else one.run.cause, onset=3)
    return one._replace(run=run, events=events)


def of_jet(jet: int, sign: int = 1, on_top: int = 0) -> Cause:
    return Cause(Kind.JETS, (jet,), (sign,), (on_top,))


@pytest.mark.parametrize("kind", [Kind.JUMP, Kind.LIES, Kind.UNKNOWN])
def test_a_jet_is_nothing_else_that_has_its_number(kind: Kind) -> None:
    """The loss of jet 4 is no unknown push, that of jet 2 no jump; a leak of jet 3 no false reading of component 1."""
    sign = 1 if kind == Kind.LIES else -1
    other = Cause(kind, component=sign)
    one = hypothesis(of_jet(int(kind), sign), other)
    assert set(hypothesis(of_jet(int(kind), sign)).parts).isdisjoint(hypothesis(other).parts)
    assert one.parts[-1] == (kind, sign, 0)


def test_histories_are_the_same_by_what_happened_in_any_order_and_what_is() -> None:
    one = hypothesis(of_jet(2), of_jet(4, -1))
    assert one.key == hypothesis(of_jet(4, -1), of_jet(2))._replace(weight=7.0, prior=-3.0).key
    others = [
        hypothesis(of_jet(2)),
        hypothesis(of_jet(2), of_jet(4, -1), of_jet(4, -1)),
        hypothesis(of_jet(2, on_top=1), of_jet(4, -1)),
        hypothesis(of_jet(2), of_jet(4, 1)),
        one._replace(push=0.1),
        one._replace(walks=np.array([ANEW, 0.0, 0.0, 0.0])),
    ]
    assert len({each.key for each in (one, *others)}) == 7


def test_a_jet_that_gives_too_much_is_on_top_or_in_place_once_it_is_commanded() -> None:
    """Twins, each with half of the prior; later commands ask no more."""
    one = hypothesis(of_jet(0), of_jet(4, -1))
    idle = some_sample(JOINT, commands=np.array([[0.0, 1, 1, 1, 1, 1]]))
    assert split_on_command(one, idle) == (one,)
    fires = some_sample(JOINT, commands=np.array([[1.0, 0, 0, 0, 0, 0]]))
    twins = split_on_command(one, fires)
    assert [each.run.state.slot_on_top[0] for each in twins] == [0.0, 1.0]
    for each in twins:
        assert each.prior == pytest.approx(one.prior - math.log(2.0))
        assert each.decided == {0}
        assert each.run.state.slot_on_top[1] == one.run.state.slot_on_top[1]
        assert split_on_command(each, fires) == (each,)
    assert twins[0].key != twins[1].key


def test_a_gap_takes_what_is_known_of_the_motion_and_keeps_events_and_forces() -> None:
    samples, _ = samples_of(JOINT, commands_of(3))
    one = hypothesis(of_jet(2))._replace(root_until_s=9.0)
    after = restart_hypothesis(one, samples[2], 9, JOINT)
    assert (after.events, after.prior, after.run.cycle) == (one.events, one.prior, 9)
    assert after.run.score == one.run.score
    assert slot_force(after.run.state, 0, JOINT) == pytest.approx(slot_force(one.run.state, 0, JOINT))
    assert after.run.state.time_s == samples[2].time_s
    rate = np.mean(samples[2].rates, axis=0)
    np.testing.assert_allclose(after.run.state.mean[10:13], rate, atol=5e-3)
    assert np.linalg.norm(one.run.state.mean[10:13] - rate) > 0.01


def test_a_weight_is_likelihood_prior_and_what_forces_are_worth() -> None:
    one = hypothesis(of_jet(2), of_jet(4, -1))
    one = one._replace(prior=-20.0, run=one.run._replace(score=NO_SCORE._replace(likelihood=7.0)))
    worth = [
        force_correction(
            *slot_force(one.run.state, slot, JOINT), float(JOINT.thrusts[jet]), PARAMS.priors, is_loss=less
        )
        for slot, jet, less in ((0, 2, False), (1, 4, True))
    ]
    assert update_weight(one, PARAMS).weight == pytest.approx(7.0 - 20.0 + sum(worth))
    erratic = one._replace(walks=np.array([ANEW, 0.0, 0.0, 0.0]))
    assert update_weight(erratic, PARAMS).weight == pytest.approx(7.0 - 20.0 + worth[1])
    drifting = one._replace(walks=np.array([0.03, 0.0, 0.0, 0.0]))
    possible = log_feasible_force(*slot_force(one.run.state, 0, JOINT), float(JOINT.thrusts[2]))
    assert update_weight(drifting, PARAMS).weight == pytest.approx(7.0 - 20.0 + possible + worth[1])
    changed = one._replace(opened_at=np.array([0.3, np.nan, np.nan, np.nan]))
    assert update_weight(changed, PARAMS).weight != pytest.approx(update_weight(one, PARAMS).weight)
    unopened = one._replace(run=one.run._replace(onset=one.run.cycle))
    assert update_weight(unopened, PARAMS).weight == pytest.approx(-13.0)


THRUST = 40.0
PRIORS = Priors(full_thrust=0.4)
FORCES = [(1.0, 0.01), (0.95, 0.03), (0.5, 0.02), (0.1, 0.01), (0.02, 0.003), (0.8, 0.1)]  # and 1 sigma, of full thrust


def mean_of(ratio: Callable[[float], float], force: float, sigma: float, *edges: float) -> float:
    """Mean over N(force, sigma^2) by adaptive quadrature, split where the density has an edge or a peak."""
    low, high = force - 9.0 * sigma, force + 9.0 * sigma
    marks = sorted({low, high, *(edge for edge in edges if low < edge < high)})
    total = 0.0
    for a, b in pairwise(marks):
        total += quad(lambda x: ratio(x) * norm.pdf(x, force, sigma), a, b, epsabs=0.0, epsrel=1e-9, limit=400)[0]
    return total


@pytest.mark.parametrize(("share", "width"), FORCES)
@pytest.mark.parametrize("missing", [False, True])
def test_a_new_force_is_worth_its_prior_over_the_one_it_was_opened_with(
    share: float, width: float, missing: bool
) -> None:
    """Half full thrust within 3 %; of the rest a leak log-uniform from a thousandth on, a loss uniform."""

    def ratio(x: float) -> float:
        rest = 0.0
        if 1e-3 < x < 1.05:
            rest = 1.0 / 1.049 if missing else 1.0 / (x * math.log(1050.0))
        density = 0.4 * norm.pdf(x, 1.0, 0.03) + 0.6 * rest
        return float(density / norm.pdf(x))

    expected = mean_of(ratio, share, width, 1e-3, 1.0, 1.05)
    found = force_correction(share * THRUST, width * THRUST, THRUST, PRIORS, is_loss=missing)
    assert found == pytest.approx(math.log(expected), abs=0.06)  # the nodes see an edge within their spacing


@pytest.mark.parametrize(("share", "width"), [*FORCES, (0.0, 0.01)])
def test_a_changed_force_is_gone_or_full_or_anything(share: float, width: float) -> None:
    """A third each; opened about the force that it was."""
    about = 0.6

    def ratio(x: float) -> float:
        density = norm.pdf(x, 0.0, 0.03) + norm.pdf(x, 1.0, 0.03) + (1.0 / 1.05 if 0.0 < x < 1.05 else 0.0)
        return float(density / 3.0 / norm.pdf(x, about))

    expected = mean_of(ratio, share, width, 0.0, 1.0, 1.05)
    found = force_correction(share * THRUST, width * THRUST, THRUST, PRIORS, is_loss=False, old_force=about * THRUST)
    assert found == pytest.approx(math.log(expected), abs=0.06)


def test_rates_are_probabilities_by_the_hour() -> None:
    assert log_event_probability(2.0, 3600.0) == pytest.approx(math.log(2.0))
    assert log_event_probability(1e-3, 0.08) - log_event_probability(1e-3, 0.16) == pytest.approx(-math.log(2.0))


def test_the_doubt_of_a_declaration_is_what_a_user_accepts_over_what_fails() -> None:
    assert Priors(false_per_hour=1e-6).doubt(1e-3) == pytest.approx(1e-3)
    assert Priors(false_per_hour=1.0).doubt(1e-6) == 0.5


@pytest.mark.parametrize(
    ("force", "sigma"), [(20.0, 1.0), (0.5, 1.0), (-3.0, 1.0), (41.0, 2.0), (44.0, 0.5), (-29.99, 1.0), (-1e5, 1.0)]
)
def test_a_force_is_possible_between_nothing_and_a_little_more_than_full_thrust(force: float, sigma: float) -> None:
    """However far off: of a filter that has gone astray, beyond what a float's exponential has."""
    expected = norm.logcdf(force / sigma) + norm.logcdf((1.05 * THRUST - force) / sigma)
    assert log_feasible_force(force, sigma, THRUST) == pytest.approx(expected, rel=1e-6, abs=1e-9)
    if force < -20.0:
        assert force_correction(force, 1e-3 * THRUST, THRUST, PRIORS, is_loss=False) < -100.0

"""Saved state of the hypothesis filter: it goes on the same, and what no run can have left is refused."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from faults_probe import SLOTS, Flown, follow, known_vehicle, leaking, make_params
from numpy.testing import assert_allclose, assert_array_equal, assert_equal

from massprop_drake.maths.estimation.faults import hypothesis_filter
from massprop_drake.maths.estimation.faults.fault_events import Event
from massprop_drake.maths.estimation.faults.saved import pack_tree, unpack_tree
from massprop_drake.maths.estimation.faults.tree import Tree
from massprop_drake.maths.estimation.faults.verdicts import Declared, Verdicts
from massprop_drake.maths.estimation.joint.hypotheses import Cause, Kind, Score
from massprop_drake.maths.linear_algebra import Array

PARAMS = make_params(quantum=3e-3)
PLACES = PARAMS.joint.places
KEPT = ("run", "events", "prior", "opened_at", "walks", "decided", "push", "earlier", "jumped", "weight")
DECLARED = Verdicts(
    (Declared((3, 1), 0.3, 0.01, 2), Declared((1, -1), 1.0, 0.02)),
    frozenset({(Kind.JUMP, -1, 0), (Kind.LIES, 7, 1)}),
    groups=frozenset({frozenset({(0, 1), (4, -1)}), frozenset({(2, 1), (0, 1), (5, 1)})}),
    earlier=known_vehicle(PARAMS.joint),
)


@pytest.fixture(scope="module")
def flown() -> Flown:
    """A flight in which a jet leaks."""
    return leaking(3e-3)


def with_everything(flown: Flown) -> Tree:
    """A tree whose likeliest hypothesis has everything that one may have."""
    leader = flown.tree.leader
    jump = Event(Cause(Kind.JUMP, component=5), 0.5, Score(1.0, 2.0, 3.0, 4.0, 5.0))
    run = leader.run._replace(kicks=((1.0,), (2.0,)), lying=True, share=0.2, lie=0.3, expected=((0.1, 0.4),))
    leader = leader._replace(
        run=run,
        events=(jump, *leader.events),
        opened_at=np.array([0.1, np.nan, 0.2, 0.3]),
        walks=np.array([0.0, 1e6, 0.1, 0.2]),
        decided=frozenset({3, 5}),
        push=0.1,
        earlier=known_vehicle(PARAMS.joint),
        jumped=0.4,
    )
    return flown.tree._replace(hypotheses=(leader, *flown.tree.hypotheses[1:]))


@pytest.mark.parametrize("tree_of", [lambda _: Tree(), lambda flown: flown.trees[33], with_everything])
@pytest.mark.parametrize("verdicts", [Verdicts(), DECLARED], ids=["nothing", "declared"])
def test_what_is_restored_is_what_was_saved(flown: Flown, tree_of: Callable[[Flown], Tree], verdicts: Verdicts) -> None:
    tree = tree_of(flown)
    vector = pack_tree(tree, verdicts, PLACES)
    again, told = unpack_tree(vector, PLACES)
    assert again.cycle == tree.cycle
    assert_equal(told, verdicts)
    possible = [each for each in tree.hypotheses if np.isfinite(each.weight)]
    for one, other in zip(again.hypotheses, possible, strict=True):
        for name in KEPT:
            assert_equal(getattr(one, name), getattr(other, name))
    assert_array_equal(pack_tree(again, told, PLACES), vector)


@pytest.mark.parametrize("row", [33, 39])
def test_a_run_goes_on_the_same_after_a_restart(flown: Flown, row: int) -> None:
    """In the midst of a doubt: each hypothesis stays as likely as it was, and what is declared and estimated the same.

    Proposals that waited are gone. So hypotheses that would still have been born are missing, none is another.
    """
    assert len(flown.trees[33].hypotheses) > 2
    tree, verdicts = unpack_tree(pack_tree(flown.trees[row], flown.verdicts[row], PLACES), PLACES)
    again = follow(flown, tree, verdicts, flown.filters[row], row + 1)
    for one, other in zip(again.trees, flown.trees[row + 1 :], strict=True):
        assert one.leader.key == other.leader.key
        assert one.leader.run.score.likelihood == pytest.approx(other.leader.run.score.likelihood, rel=1e-9)
    assert_allclose(again.filters[-1].mean, flown.filters[-1].mean, atol=1e-9)
    assert_allclose(again.filters[-1].root, flown.filters[-1].root, atol=1e-9)
    assert [one.jets for _, one in again.said] == [one.jets for time_s, one in flown.said if time_s > 0.1 * row + 0.15]


def changed(flown: Flown, change: Callable[[Any], Any]) -> Array:
    """A saved state of which the likeliest hypothesis is another."""
    tree = flown.tree
    return pack_tree(tree._replace(hypotheses=(change(tree.leader), *tree.hypotheses[1:])), Verdicts(), PLACES)


def with_state(**changes: Any) -> Callable[[Any], Any]:
    """A hypothesis whose filter's state is another."""
    return lambda each: each._replace(run=each.run._replace(state=each.run.state._replace(**changes)))


def with_cause(**changes: Any) -> Callable[[Any], Any]:
    """A hypothesis whose newest event is another."""

    def change(each: Any) -> Any:
        event = each.events[-1]
        return each._replace(events=(*each.events[:-1], event._replace(cause=event.cause._replace(**changes))))

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda each: each._replace(prior=np.nan), "must be finite"),
        (lambda each: each._replace(push=-1.0), "pushes and walks zero or positive"),
        (lambda each: each._replace(walks=np.full(SLOTS, np.nan)), "pushes and walks zero or positive"),
        (lambda each: each._replace(run=each.run._replace(cycle=4)), "an index is out of its range"),
        (lambda each: each._replace(run=each.run._replace(kicks=((1.0, 2.0, 3.0),))), "those of the newest failure"),
        (lambda each: each._replace(run=each.run._replace(expected=((1.0,),))), "those of the newest failure"),
        (lambda each: each._replace(run=each.run._replace(state=None)), "a hypothesis must have a state"),
        (with_state(mean=np.full(PLACES.size, np.inf)), "only readings of a hypothesis, and what it assumes, may"),
        (with_state(slot_jet=np.full(SLOTS, 6.0)), "a force must be of a jet"),
        (with_state(slot_sign=np.zeros(SLOTS)), "a force must be of a jet"),
        (with_cause(jets=(0, 2)), "a failure must be of a jet"),
        (with_cause(signs=(0,)), "a failure must be of a jet"),
        (with_cause(kind=9), "an index is out of its range"),
    ],
)
def test_a_hypothesis_that_no_run_has_is_refused(flown: Flown, change: Callable[[Any], Any], message: str) -> None:
    with pytest.raises(ValueError, match=f"hypothesis_detector: .*{message}"):
        unpack_tree(changed(flown, change), PLACES)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda vector: vector[:-1], "ends too soon"),
        (lambda vector: np.append(vector, 0.0), "goes on where it should end"),
        (lambda vector: np.append(0.5, vector[1:]), "an index is out of its range"),
        (lambda vector: np.concatenate((vector[:1], [-1.0], vector[2:])), "counts must be whole numbers"),
        (lambda _: np.array([0.0, 0, 0, 0, 1, 3, 0, 1, 2, 0]), "a group must be of jets and signs"),
        (lambda _: np.array([0.0, 0, 0, 0, 1, 2, 6, 1, 0]), "an index is out of its range"),
    ],
)
def test_a_vector_that_no_run_can_have_left_is_refused(
    flown: Flown, change: Callable[[Array], Array], message: str
) -> None:
    vector = pack_tree(flown.tree, flown.verdicts[-1], PLACES)
    with pytest.raises(ValueError, match=f"hypothesis_detector: .*{message}"):
        unpack_tree(change(vector), PLACES)


@pytest.mark.parametrize(
    ("place", "value", "message"),
    [(0, np.nan, "must be finite"), (6, -1.0, "zero or positive"), (12, 0.5, "removed must be 0 or 1")],
)
def test_what_the_detector_keeps_of_each_jet_is_looked_at(place: int, value: float, message: str) -> None:
    own = {"force": np.arange(6.0), "variance": np.arange(6.0) ** 2, "removed": np.eye(6)[4]}
    vector = hypothesis_filter.pack_state(hypothesis_filter.initial(PARAMS)._replace(**own), PARAMS)
    again = hypothesis_filter.unpack_state(vector, PARAMS)
    assert again.tree == Tree()
    assert_equal({name: getattr(again, name) for name in own}, own)
    vector[place] = value
    with pytest.raises(ValueError, match=f"hypothesis_detector: .*{message}"):
        hypothesis_filter.unpack_state(vector, PARAMS)

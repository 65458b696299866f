"""Saved state of the hypothesis filter: all hypotheses and what has been declared, as one vector.

Banks of onsets begin anew after a restart, and proposals that wait are made again when readings ask for them.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from massprop_drake.maths.estimation.faults.fault_events import NOTHING, Event, Hypothesis
from massprop_drake.maths.estimation.faults.tree import Tree
from massprop_drake.maths.estimation.faults.verdicts import Declared, Verdicts
from massprop_drake.maths.estimation.joint.hypotheses import Cause, Kind, Runner, Score
from massprop_drake.maths.estimation.joint.layout import JointState, Places, pack, state_layout, unpack
from massprop_drake.maths.linear_algebra import Array

_MOST = 10_000  # entries of a list in a saved state
_LATEST = 2**53  # number of a sample
_NAME = "hypothesis_detector"


class _Writer:
    """Numbers written one after the other."""

    def __init__(self, layout: Places):
        self._places, self.numbers = layout, list[Array]()

    def put(self, *values: float) -> None:
        """Appends numbers to the vector."""
        self.numbers.append(np.array(values, dtype=float))

    def put_all(self, values: Iterable[float]) -> None:
        """Appends a list of numbers to the vector, after its count."""
        values = list(values)
        self.put(len(values), *values)

    def put_state(self, state: JointState | None) -> None:
        """Appends a flag, 1: there is a state, and then a filter's state if there is one."""
        self.put(float(state is not None))
        if state is not None:
            self.numbers.append(pack(state, self._places))

    def put_cause(self, cause: Cause) -> None:
        """Appends a fault's cause: kind, component, jets, signs, and whether forces come on top."""
        self.put(float(cause.kind), float(cause.component))
        for values in (cause.jets, cause.signs, cause.on_top):
            self.put_all(values)


class _Reader:
    """Reader of what `_Writer` has written.

    Raises:
        ValueError: where numbers are missing, or no count is where one must be.
    """

    def __init__(self, vector: Array, layout: Places):
        self._vector, self._places, self._at = vector, layout, 0

    def take(self, count: int) -> Array:
        """Reads so many numbers, shape (count,); raises ValueError where the vector ends too soon."""
        if self._at + count > self._vector.size:
            raise ValueError(f"{_NAME}: ends too soon")
        self._at += count
        return self._vector[self._at - count : self._at]

    def number(self) -> float:
        """Reads the next number of the vector."""
        return float(self.take(1)[0])

    def count(self) -> int:
        """Reads the next number as a count; raises ValueError where it is none."""
        value = self.number()
        if not (0.0 <= value <= _MOST and value == round(value)):
            raise ValueError(f"{_NAME}: counts must be whole numbers, zero or positive")
        return int(value)

    def index(self, minimum: int, maximum: int) -> int:
        """Reads the next number as an integer within bounds; raises ValueError where it is none."""
        value = self.number()
        if not (minimum <= value <= maximum and value == round(value)):
            raise ValueError(f"{_NAME}: an index is out of its range")
        return int(value)

    def all(self) -> tuple[float, ...]:
        """Reads the next list of numbers, stored after its count."""
        return tuple(self.take(self.count()).tolist())

    def integers(self, minimum: int, maximum: int) -> tuple[int, ...]:
        """Reads the next list of integers within bounds, stored after its count."""
        return tuple(self.index(minimum, maximum) for _ in range(self.count()))

    def state(self) -> JointState | None:
        """Reads the next filter state, or None where none was stored; raises ValueError for an impossible one."""
        if self.number() == 0.0:
            return None
        state = unpack(self.take(state_layout(self._places).size), self._places)
        told = state._replace(read=state.read[~np.isnan(state.read)], assumed=state.assumed[~np.isnan(state.assumed)])
        if not all(np.isfinite(part).all() for part in told):
            raise ValueError(f"{_NAME}: only readings of a hypothesis, and what it assumes, may be missing")
        known = np.isin(state.slot_jet, np.arange(-1, self._places.jets)) & np.isin(state.slot_on_top, (0.0, 1.0))
        if not (known & (np.abs(state.slot_sign) == 1.0)).all():
            raise ValueError(f"{_NAME}: a force must be of a jet, too much or too little")
        return state

    def cause(self) -> Cause:
        """Reads the next cause of a fault; raises ValueError for an impossible one."""
        kind, component = Kind(self.index(0, len(Kind) - 1)), self.index(-1, _MOST)
        jets, signs, on_top = self.integers(0, self._places.jets - 1), self.integers(-1, 1), self.integers(0, 1)
        if not len(jets) == len(signs) == len(on_top) or 0 in signs:
            raise ValueError(f"{_NAME}: a failure must be of a jet, too much or too little")
        return Cause(kind, jets, signs, on_top, component)

    def score(self) -> Score:
        """Reads the next score: log likelihood, NIS and degrees of freedom."""
        return Score(*self.take(len(Score._fields)).tolist())

    def ended(self) -> bool:
        """Tests whether all numbers of the vector have been read."""
        return self._at == self._vector.size


def pack_tree(tree: Tree, verdicts: Verdicts, layout: Places) -> Array:
    """Packs fault hypotheses and declarations into one vector, see `unpack_tree`."""
    writer = _Writer(layout)
    possible = [each for each in tree.hypotheses if math.isfinite(each.weight)]  # others are kept for their banks alone
    writer.put(tree.cycle, len(possible))
    for each in possible:
        run = each.run
        writer.put(each.prior, each.push, each.weight, run.onset, run.cycle, float(run.lying), run.share, run.lie)
        writer.put(each.jumped, *run.score)
        writer.put_all(sorted(each.decided))
        writer.put(*each.opened_at, *each.walks)
        writer.put_state(run.state)
        writer.put_state(each.earlier)
        for pairs in (run.kicks, run.expected):
            writer.put(len(pairs))
            for pair in pairs:
                writer.put_all(pair)
        writer.put(len(each.events))
        for event in each.events:
            writer.put_cause(event.cause)
            writer.put(event.onset_s, *event.score)
    writer.put(len(verdicts.jets))
    for one in verdicts.jets:
        writer.put(*one.way, one.force, one.sigma, one.changes)
    writer.put(len(verdicts.others))
    for part in sorted(verdicts.others):
        writer.put(*part)
    writer.put(len(verdicts.groups))
    for group in sorted(verdicts.groups, key=sorted):
        writer.put_all(number for way in sorted(group) for number in way)
    writer.put_state(verdicts.earlier)
    return np.concatenate(writer.numbers)


def unpack_tree(vector: Array, layout: Places) -> tuple[Tree, Verdicts]:
    """Unpacks fault hypotheses and declarations from a vector: the inverse of `pack_tree`.

    Raises:
        ValueError: when no run can have left such a vector.
    """
    reader = _Reader(vector, layout)
    cycle = reader.index(0, _LATEST)
    hypotheses = tuple(_read_hypothesis(reader, cycle, layout) for _ in range(reader.count()))
    jets = tuple(
        Declared(
            (reader.index(0, layout.jets - 1), reader.index(-1, 1)), reader.number(), reader.number(), reader.count()
        )
        for _ in range(reader.count())
    )
    others = frozenset(
        (Kind(reader.index(0, len(Kind) - 1)), reader.index(-1, _MOST), reader.count()) for _ in range(reader.count())
    )
    groups = []
    for _ in range(reader.count()):
        flat = reader.integers(-1, layout.jets - 1)
        if len(flat) % 2:
            raise ValueError(f"{_NAME}: a group must be of jets and signs")
        groups.append(frozenset(zip(flat[::2], flat[1::2], strict=True)))
    verdicts = Verdicts(jets, others, groups=frozenset(groups), earlier=reader.state())
    if not reader.ended():
        raise ValueError(f"{_NAME}: goes on where it should end")
    return Tree(cycle, hypotheses), verdicts


def _read_hypothesis(reader: _Reader, cycle: int, layout: Places) -> Hypothesis:
    """Reads one fault hypothesis; raises ValueError for values that no run leaves."""
    prior, push, weight = reader.take(3).tolist()
    onset, now, lying = reader.index(0, cycle), reader.index(cycle, cycle), reader.index(0, 1)
    share, lie = reader.take(2).tolist()
    jumped, score, decided = reader.number(), reader.score(), frozenset(reader.integers(0, layout.jets - 1))
    opened_at, walks = reader.take(layout.n_force), reader.take(layout.n_force)
    state, earlier = reader.state(), reader.state()
    if state is None:
        raise ValueError(f"{_NAME}: a hypothesis must have a state")
    kicks, expected = (tuple(reader.all() for _ in range(reader.count())) for _ in range(2))
    events = tuple(Event(reader.cause(), reader.number(), reader.score()) for _ in range(reader.count()))
    if not (np.isfinite([prior, push, weight, share, jumped, *score]).all() and (walks >= 0.0).all() and push >= 0.0):
        raise ValueError(f"{_NAME}: must be finite, and pushes and walks zero or positive")
    cause = events[-1].cause if events else NOTHING
    if not all(len(pair) == 2 for pair in expected) or not all(len(each) == len(cause.jets) for each in kicks):
        raise ValueError(f"{_NAME}: impulses and changes must be those of the newest failure")
    pairs = tuple((mean, sigma) for mean, sigma in expected)
    run = Runner(cause, onset, kicks, now, state, score, bool(lying), share, lie, pairs)
    return Hypothesis(run, events, prior, opened_at, walks, decided, push, earlier, jumped, weight=weight)

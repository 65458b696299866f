r"""The race of hypotheses: from a snapshot of the past on, who explains the recorded readings best.

All hypotheses are compared to first order (`screen`); the jump and whoever comes near the best also run as filters of
their own (`hypotheses`), and nothing is decided for one that does not. What a cycle may cost is bounded: links of the
screen and steps of filters that are left over are made up for in the next cycles, the likeliest first.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from massprop_drake.maths.estimation.joint import screen as screens
from massprop_drake.maths.estimation.joint.bank import Bank
from massprop_drake.maths.estimation.joint.cycle import Sample
from massprop_drake.maths.estimation.joint.hypotheses import Cause, Kind, Runner, slot_of, stepped
from massprop_drake.maths.estimation.joint.layout import JointParams, JointState
from massprop_drake.maths.estimation.joint.screen import Contender, Screen
from massprop_drake.maths.estimation.joint.sensitivity import Link
from massprop_drake.maths.linear_algebra import Array

STEPS = 8  # of filters in a cycle: 1.5 to 2.5 ms each
LINKS_PER_STEP = 2  # of the screen, in the time of a filter's step
_BEFORE = 2  # snapshots before the onset where the race begins: the onset is not known to one
_NEAR = 12.0  # nats behind the best within which a hypothesis runs as a filter: twice the lead that decides
_RUNS = 6  # filters at once, with the jump
_LIE_RUNS = 12  # cycles in which the likeliest liar runs, however the first order takes so large an error
_BETTER = 1.0  # nats at another onset, that a filter begins anew there
_TOO_WIDE = 2.0  # times the uncertainty of the onset: then a filter begins anew
OUT = 60.0  # nats behind the best: out of the race


class Record(NamedTuple):
    """A cycle to be replayed.

    Attributes:
        sample: its sample.
        link: see `Link`.
    """

    sample: Sample
    link: Link


class History(NamedTuple):
    """Cycles of the past.

    Attributes:
        last: number of the newest.
        records: oldest first.
    """

    last: int
    records: tuple[Record, ...]

    def at(self, cycle: int) -> Record:
        """The record of a cycle."""
        return self.records[cycle - self.last - 1]


class Race(NamedTuple):
    """A race under way.

    Attributes:
        triggered: cycle of the alarm.
        states: after the beginning and after each onset of the screen.
        screen: see `Screen`.
        runs: see `Runner`.
        out: causes whose own filters have fallen too far behind, whatever the first order says of them.
    """

    triggered: int
    states: tuple[JointState, ...]
    screen: Screen
    runs: tuple[Runner, ...]
    out: frozenset[Cause] = frozenset()


class Standing(NamedTuple):
    """A hypothesis in the race.

    Attributes:
        contender: see `Contender`; lead and forces are those of its filter where that has arrived.
        run: its filter where it has arrived at the present, else None.
        first_order: what the screen says of it, maybe at another onset.
    """

    contender: Contender
    run: Runner | None
    first_order: Contender


def begin(bank: Bank, index: int, triggered: int, history: History, params: JointParams) -> Race:
    """The race about an onset.

    Args:
        bank: before it takes the newest cycle.
        index: of the onset in it.
        triggered: cycle of the alarm.
        history: back to the bank's oldest onset.
        params: see `JointParams`.
    """
    first = max(index - _BEFORE, 0)
    chosen = range(max(index - 1, 0), min(index + 2, len(bank.states)))
    cycles = bank.cycles.astype(np.intp)
    onsets = tuple(int(cycles[k]) for k in chosen)
    began = int(cycles[first])
    gaps = tuple(int(cycles[k] - cycles[k - 1]) if k > 0 else 1 for k in chosen)
    read = history.at(began).link.read
    started = screens.begin((bank.states[first], began), onsets, gaps, read, params)
    return Race(triggered, (bank.states[first], *(bank.states[k] for k in chosen)), started, ())


def moved(race: Race, standing: list[Standing], bank: Bank, history: History, params: JointParams) -> Race:
    """The race anew about its likeliest onset, where that is the first or the last that it looks at and not the only.

    Args:
        race: see `Race`.
        standing: see `standings`.
        bank: see `begin`.
        history: see `History`.
        params: see `JointParams`.
    """
    onsets = race.screen.onsets
    best = next((each.contender.onset for each in standing if each.contender.cause.kind == Kind.JETS), None)
    if best not in (onsets[0], onsets[-1]) or best not in bank.cycles:
        return race
    drawn = begin(bank, int(np.flatnonzero(bank.cycles == best)[0]), race.triggered, history, params)
    return race if drawn.screen.onsets == onsets else drawn


def advanced(race: Race, history: History, params: JointParams) -> Race:
    """The race with the screen as far as the bound on links lets it go."""
    screen = race.screen
    for _ in range(min(STEPS * LINKS_PER_STEP, history.last - screen.cycle)):
        screen = screens.screened(screen, history.at(screen.cycle + 1).link, params)
    return race._replace(screen=screen)


def arrived(race: Race, history: History) -> bool:
    """Whether the screen is at the present."""
    return race.screen.cycle == history.last


def standings(race: Race, contenders: list[Contender], params: JointParams) -> list[Standing]:
    """All hypotheses by how likely they are, each by its filter where that has arrived.

    Args:
        race: see `Race`.
        contenders: to first order.
        params: see `JointParams`.
    """
    result = []
    by_cause = {run.cause: run for run in race.runs if run.cycle == race.screen.cycle}
    nothing = race.screen.scores[-1].likelihood
    for contender in contenders:
        if contender.cause in race.out:
            continue
        run = by_cause.pop(contender.cause, None)
        measured = _measured(contender, run, nothing, params) if run else contender
        result.append(Standing(measured, run, contender))
    for cause, run in by_cause.items():  # what is not possible to first order may be so by its filter
        contender = Contender(cause, run.onset, 0.0, kicks=run.kicks)
        result.append(Standing(_measured(contender, run, nothing, params), run, contender))
    return sorted(result, key=lambda standing: -standing.contender.lead)


def _measured(contender: Contender, run: Runner, nothing: float, params: JointParams) -> Contender:
    lead = run.score.likelihood - nothing + screens.prior(run.cause, params)
    force, sigma = [], []
    for jet, sign in zip(run.cause.jets, run.cause.signs, strict=True):
        row = params.places.force + slot_of(run.state, jet, sign)
        force.append(float(run.state.mean[row]))
        sigma.append(float(np.sqrt(np.sum(run.state.root[row] ** 2))))
    return contender._replace(onset=run.onset, lead=lead, force=tuple(force), sigma=tuple(sigma))


def running(race: Race, standing: list[Standing], free_slots: int) -> Race:
    """The race with the filters that it needs: of the jump, and of those near the best.

    Args:
        race: see `Race`.
        standing: see `standings`.
        free_slots: for forces of further failures.
    """
    best = standing[0].contender.lead
    present = {run.cause: run for run in race.runs}
    wanted: list[Runner] = []
    liar = next((each.contender.cause for each in standing if each.contender.cause.kind == Kind.LIES), None)
    young = race.screen.cycle - race.triggered < _LIE_RUNS
    lost = {each.contender.cause for each in standing if each.run is not None and each.contender.lead < best - OUT}
    for each in standing:
        contender, cause = each.contender, each.contender.cause
        near = contender.lead > best - (OUT if cause.kind == Kind.JUMP or cause in present else _NEAR)
        near = near or (young and cause == liar)
        if near and contender.lead > 0.0 and len(wanted) < _RUNS and _fits(race, cause, free_slots):
            run = present.get(cause)
            anew = run is None or _too_wide(run, contender) or _elsewhere(each)
            wanted.append(_opened(race, each.first_order) if run is None or anew else run)
    return race._replace(runs=tuple(wanted), out=race.out | (lost - {Cause(Kind.JUMP)}))


def _fits(race: Race, cause: Cause, free_slots: int) -> bool:
    """Whether the state has a slot for each of its jets."""
    base = race.states[0]
    taken = set(zip(base.slot_jet.astype(np.intp).tolist(), base.slot_sign.tolist(), strict=True))
    needed = sum((jet, float(sign)) not in taken for jet, sign in zip(cause.jets, cause.signs, strict=True))
    return needed <= free_slots


def _too_wide(run: Runner, contender: Contender) -> bool:
    """Whether a filter began with far more uncertainty of its onset than there now is."""
    return any(
        had > _TOO_WIDE * has
        for of_run, now in zip(run.kicks, contender.kicks, strict=True)
        for had, has in zip(of_run, now, strict=True)
    )


def _elsewhere(standing: Standing) -> bool:
    """Whether another onset than its filter's explains clearly more."""
    contender, run, first = standing
    return run is not None and first.onset != run.onset and first.lead > contender.lead + _BETTER


def _opened(race: Race, contender: Contender) -> Runner:
    screen, cause = race.screen, contender.cause
    place = 0 if cause.kind == Kind.JUMP else 1 + screen.onsets.index(contender.onset)
    onset = screen.began if cause.kind == Kind.JUMP else contender.onset
    score = screen.scores[onset - screen.began]
    return Runner(cause, onset, contender.kicks, onset, race.states[place], score, cause.kind == Kind.LIES)


def stepped_on(race: Race, left: int, history: History, erratic: np.ndarray, params: JointParams) -> tuple[Race, int]:
    """The race with its filters as far as the steps that are left let them go, in their order, and what then is left.

    Args:
        race: see `Race`.
        left: steps.
        history: see `History`.
        erratic: see `hypotheses.restless`.
        params: without increments.
    """
    runs, screen = [], race.screen
    for run in race.runs:
        now = run
        while left > 0 and now.cycle < screen.cycle:
            record = history.at(now.cycle + 1)
            counts = screen.masks[now.cycle - screen.began]
            now = stepped(now, record.sample, record.link, counts, erratic, params)
            left -= 1
        runs.append(now)
    return race._replace(runs=tuple(runs)), left


def known_forces(state: JointState, params: JointParams) -> Array:
    """Force of each known failure, more and then less, shape (2 n_jets,)."""
    result = np.zeros(2 * params.places.jets)
    for slot in np.flatnonzero(state.slot_jet >= 0):
        column = int(state.slot_jet[slot]) + (params.places.jets if state.slot_sign[slot] < 0 else 0)
        result[column] = max(state.mean[params.places.force + slot], np.finfo(np.float64).tiny)
    return result

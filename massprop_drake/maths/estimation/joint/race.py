r"""The race of hypotheses: from a snapshot of the past on, who explains the recorded readings best.

All hypotheses are compared to first order (`screen`); the jump and whoever comes near the best also run as filters of
their own (`hypotheses`), and nothing is decided for one that does not. The jump does so whatever the first order says
where jets fire as it happens: that has it happen between two samples, and may be thousands of nats off. What a
cycle may cost is bounded: links of the screen and steps of filters that are left over are made up for in the next
cycles, the likeliest first.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from massprop_drake.maths.estimation.joint import screen as screens
from massprop_drake.maths.estimation.joint.bank import Bank
from massprop_drake.maths.estimation.joint.cycle import Sample
from massprop_drake.maths.estimation.joint.hypotheses import (
    FIT,
    KICK,
    Cause,
    Kind,
    Named,
    Runner,
    jumping,
    slot_of,
    stepped,
)
from massprop_drake.maths.estimation.joint.layout import JointParams, JointState
from massprop_drake.maths.estimation.joint.screen import Contender, Screen
from massprop_drake.maths.estimation.joint.sensitivity import Link
from massprop_drake.maths.linear_algebra import Array, NotPositiveDefiniteError

STEPS = 12  # of filters in a cycle: 1.5 to 2.5 ms each
LINKS_PER_STEP = 2  # of the screen, in the time of a filter's step
_CHANCE = 48.0  # nats by which a filter and the first order are apart by chance; of pairs that oppose each other 30
_WIDER = 5.0  # times the 1-sigma of a force to first order: what a filter opens with says little
_EARLIER = 2  # onsets before the chosen one that it looks at
_BEFORE = 3  # snapshots before the onset where the race begins: the onset is not known to one
NEAR = 12.0  # nats behind the best within which a hypothesis runs as a filter: twice the lead that decides
_FIRST_ORDER = 1e-3  # of the lead of a filter that does not fit, by which the first order may be off
_RUNS = 6  # filters at once, with the jump
A_SECOND = 12  # cycles in which two failures at once are not held to be rare
_LIE_RUNS = 12  # cycles in which the likeliest liar runs, however the first order takes so large an error
_BETTER = 1.0  # nats at another onset, that a filter begins anew there
_AGAIN = 30.0  # times likelier that a jet known to be wrong changes than that any other fails, in whichever of two ways
_TOO_WIDE = 3.0  # nats that the uncertainty of an onset may cost at most: half of what decides; a filter begins anew
SURPRISED = 2.3  # normal deviate of a sample that one in a hundred exceeds
SHAKEN = 4.2  # of one that one in a hundred thousand exceeds
HALF_A_SECOND = 6  # cycles: so long one jet may explain what two do, and a neighbor what a known jet would
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
        leading: jets that explain everything so far and are not behind, the likeliest first; empty: none does.
        led: those of them that had a filter when last there were any, as they stood; empty: none has led, or something
            explains everything by now.
        clear: the hypothesis that led all others by enough after the last sample.
        out: causes whose own filters have fallen too far behind, whatever the first order says of them.
        quiet: samples up to the last one through which it could be of chance, see `is_quiet`.
        until: cycle at which one of those that led explained nearly all, the last so far; -1: none yet.
        ceased: single jets that explained everything until a sample in the last second, as they stood after it.
    """

    triggered: int
    states: tuple[JointState, ...]
    screen: Screen
    runs: tuple[Runner, ...]
    leading: tuple[Contender, ...] = ()
    led: tuple[Standing, ...] = ()
    clear: Cause | None = None
    out: frozenset[Cause] = frozenset()
    quiet: int = 0
    until: int = -1
    ceased: tuple[Standing, ...] = ()

    @property
    def cycles(self) -> int:
        """From the alarm to the last one done, both counted."""
        return self.screen.cycle - self.triggered + 1


class Standing(NamedTuple):
    """A hypothesis in the race.

    Attributes:
        contender: see `Contender`; lead and forces are those of its filter where that has arrived.
        run: its filter where it has arrived at the present, else None.
        first_order: what the screen says of it, maybe at another onset; what its filter says where to first order it is
            not possible.
        linear: lead to first order of whichever way of the same failures explains most.
        beforehand: nats by which it is likelier than new failures before any reading: a force that is known to be wrong
            changes sooner than a further jet fails, and it is one where these are many.
    """

    contender: Contender
    run: Runner | None
    first_order: Contender
    linear: float
    beforehand: float

    @property
    def odds(self) -> float:
        """By which hypotheses are compared with each other, nats."""
        return self.contender.lead + self.beforehand


def begin(bank: Bank, index: int, triggered: int, history: History, params: JointParams) -> Race:
    """The race about an onset: from two before it on, since the youngest of those that come near the best is taken.

    What has begun before the first that it looks at is taken for an impulse there, and of two neighbors the wrong one
    may have less to take.

    Args:
        bank: before it takes the newest cycle.
        index: of the onset in it.
        triggered: cycle of the alarm.
        history: back to the bank's oldest onset.
        params: see `JointParams`.
    """
    first = max(index - _BEFORE, 0)
    chosen = range(max(index - _EARLIER, 0), min(index + 2, len(bank.states)))
    cycles = bank.cycles.astype(np.intp)
    onsets = tuple(int(cycles[k]) for k in chosen)
    began = int(cycles[first])
    gaps = tuple(int(cycles[k] - cycles[k - 1]) if k > 0 else 1 for k in chosen)
    read = history.at(began).link.read
    started = screens.begin((bank.states[first], began), onsets, gaps, read, params)
    return Race(triggered, (bank.states[first], *(bank.states[k] for k in chosen)), started, ())


def moved(race: Race, standing: list[Standing], bank: Bank, history: History, tested: int, params: JointParams) -> Race:
    """The race anew about its likeliest onset, where that is the first or the last that it looks at and not the only.

    Where it is the last and jets lead that do not fit, nor anybody else, what has begun may have done so long after:
    then about the onset that the test has by now, if that is later still. The first alarm may have been of chance, and
    tells nothing of what came as it was raised. Where somebody fits, or a jump explains most, it did not: the test's
    onset is then of a filter that has learned wrongly since, as would be all that begins there.

    A race whose leader fits stays, or in which jets that fit are no more behind than their onset may cost: it is known
    well enough. But a small jump also fits jets that have failed at another onset.

    Args:
        race: see `Race`.
        standing: see `standings`.
        bank: see `begin`.
        history: see `History`.
        tested: index in it of the onset that the test has, -1 for none.
        params: see `JointParams`.
    """
    onsets = race.screen.onsets
    if not standing:  # it has not arrived at the present
        return race
    near = standing[0].odds - _TOO_WIDE
    fitting = [each for each in standing if each.run is not None and each.run.fits]
    jets = any(each.contender.cause.kind == Kind.JETS and each.odds > near for each in fitting)
    if jets or (standing[0] in fitting and not (standing[0].run is not None and standing[0].run.is_small)):
        return race
    best = next((each.contender.onset for each in standing if each.contender.cause.kind == Kind.JETS), None)
    if best not in (onsets[0], onsets[-1]) or best not in bank.cycles:
        return race
    index = int(np.flatnonzero(bank.cycles == best)[0])
    if best == onsets[-1] and not fitting and standing[0].contender.cause.kind != Kind.JUMP:
        index = max(index, tested)
    drawn = begin(bank, index, race.triggered, history, params)
    return race if drawn.screen.onsets == onsets else drawn


def is_quiet(race: Race, standing: list[Standing], lead_nothing: float) -> bool:
    """Whether a race may be of chance: that nothing has happened explains all, and nobody leads that by enough.

    Args:
        race: see `Race`.
        standing: see `standings`, not empty.
        lead_nothing: see `Rules`.
    """
    return race.screen.scores[-1].misfit < FIT and all(each.contender.lead <= lead_nothing for each in standing)


def overtaken(race: Race, onset: int) -> bool:
    """Whether what has just begun needs a race of its own, since this one is of chance.

    It has been quiet for half a second and more, and neither that nothing has happened nor a hypothesis that fits
    explains the newest sample. To hypotheses that begin at its onsets, what begins now is what happened there, and none
    of them is what happens; but it goes on for twenty seconds.

    Args:
        race: with its screen at the present.
        onset: that the test has by now.
    """
    if race.quiet <= HALF_A_SECOND or onset <= race.screen.onsets[-1]:
        return False
    before, now = race.screen.scores[-2:]
    if now.without(before).surprise < SHAKEN:
        return False
    at_present = (run for run in race.runs if run.cycle == race.screen.cycle)
    return not any(run.fits and run.newest.surprise < SURPRISED for run in at_present)


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
    judged = {cause: _judged(run, params) for cause, run in by_cause.items()}
    nothing = race.screen.scores[-1].likelihood
    ways: dict[Named, float] = {}
    for contender in contenders:
        ways[contender.cause.named] = max(ways.get(contender.cause.named, contender.lead), contender.lead)
    for contender in contenders:
        if contender.cause in race.out:
            continue
        run = by_cause.pop(contender.cause, None)
        measured = _measured(contender, run, nothing, judged[run.cause]) if run else contender
        linear = ways[contender.cause.named]
        beforehand = _beforehand(race, contender.cause)
        result.append(Standing(measured, run, contender, linear, beforehand))
    for cause, run in by_cause.items():  # what is not possible to first order may be so by its filter
        contender = Contender(cause, run.onset, 0.0, kicks=run.kicks, share=run.share)
        measured = _measured(contender, run, nothing, judged[cause])
        linear = measured.lead if cause.drifts else ways.get(cause.named, measured.lead)
        result.append(Standing(measured, run, measured, linear, _beforehand(race, cause)))
    result.sort(key=lambda standing: -standing.odds)
    explains = next((each for each in result if each.run is not None and each.run.fits), None)
    if explains is not None:
        result = [each for each in result if not _adds(explains, each)]
    singles = {each.contender.cause.failures: each for each in result if len(each.contender.cause.jets) == 1}
    return [each for each in result if not _adds_nothing(each, singles)]


def rivals(standing: list[Standing]) -> list[Standing]:
    """The best, and those that name something else.

    A jet that is told to fire all the while is stuck and leaks alike, and filters of both ways run: it is stuck unless
    a leak, which might be of any size, explains more. Of others a way whose filter has arrived stands for both.
    """
    least = standing[0].odds - _BETTER
    named = standing[0].contender.cause.named
    ways = [each for each in standing if each.contender.cause.named == named and each.run is not None]
    likely = [each for each in ways if each.odds > least] or standing[:1]
    found: dict[Named, Standing] = {}
    for each in (min(likely, key=lambda each: sum(each.contender.cause.on_top)), *standing):
        has = found.setdefault(each.contender.cause.named, each)
        if has.run is None and each.run is not None:
            found[each.contender.cause.named] = each
    return list(found.values())


def _adds(explains: Standing, other: Standing) -> bool:
    """Whether a hypothesis names more besides what by itself explains the readings, and is no likelier for it.

    What little a further failure then explains is told from chance by a race of its own. To first order it must be far
    likelier to count: of a large effect the first order leaves enough for whatever is added to explain.
    """
    named = explains.contender.cause.failures
    if not named or not named < other.contender.cause.failures:
        return False
    if other.run is not None:
        return other.odds <= explains.odds
    gained = other.linear + other.beforehand - explains.linear - explains.beforehand
    return gained < NEAR


def _adds_nothing(other: Standing, singles: dict[frozenset[tuple[int, int]], Standing]) -> bool:
    """Whether to first order one of two failures explains by itself no less than both."""
    failures = other.contender.cause.failures
    if len(failures) < 2 or other.run is not None:
        return False
    alone = [singles[frozenset({each})] for each in failures if frozenset({each}) in singles]
    return any(each.linear + each.beforehand > other.linear + other.beforehand for each in alone)


def _beforehand(race: Race, cause: Cause) -> float:
    jets = race.states[0].level.shape[0]
    return float(np.log(2.0 * jets * _AGAIN)) * len(_known(race) & cause.failures)


def ahead(best: Standing, other: Standing) -> float:
    """Lead over another hypothesis as each is measured, nats.

    The first order compares all by the innovations of one filter; where it is about right, what decides must show
    there, too.
    """
    measured = best.odds - other.odds
    if best.run is None or other.run is None or not (_is_about_linear(best) and _is_about_linear(other)):
        return measured
    return min(measured, best.linear + best.beforehand - other.linear - other.beforehand)


def _is_about_linear(standing: Standing) -> bool:
    """Whether the first order of jets or a jump is no farther from what their filter has measured than chance takes it.

    Of a large jump it is far off.
    """
    compared = standing.contender.cause.kind in (Kind.JETS, Kind.JUMP)
    return compared and abs(standing.linear - standing.contender.lead) <= _CHANCE


def margin(best: Standing, other: Standing) -> float:
    """Lead over another hypothesis, nats: of filters, or of the first order where one has no filter that has arrived.

    A filter counts as one that has not if it is to begin anew at an onset that explains more. Where the first order is
    far from what the best has measured, nothing is made of it; but of two failures many neighbors explain as much.

    Of an effect that is not small the first order is off by far more than hypotheses differ: what it puts near the best
    or before it must run as a filter before it is believed to be behind.
    """
    measured = ahead(best, other)
    alone = len(best.contender.cause.jets) == 1 or best.contender.cause.kind == Kind.LIES
    if best.run is None or _arrived(other) or (alone and _strays(best)):
        return measured
    return min(measured, best.linear + best.beforehand - other.linear - other.beforehand)


def by_readings(best: Standing, other: Standing) -> float:
    """Lead over another hypothesis, nats, where two other failures at once are not held against it.

    One small force may explain for a while what two do: then all that it leads them by is that two at once are rare.
    """
    one = len(best.contender.cause.jets) == 1 and len(other.contender.cause.jets) > 1
    instead = one and not best.contender.cause.failures & other.contender.cause.failures
    return margin(best, other) - (screens.PAIR_PRIOR if instead else 0.0)


def _arrived(standing: Standing) -> bool:
    """Whether it stands by a filter of its own that is to go on."""
    return standing.run is not None and not _begins_anew(standing.run, standing)


def _strays(standing: Standing) -> bool:
    """Whether a filter fits and the first order is far from what it measured: then the first order is wrong."""
    off = abs(standing.linear - standing.contender.lead) > NEAR
    return standing.run is not None and standing.run.fits and off


def leads(best: Standing, other: Standing, lead: float, *, read: bool = False) -> bool:
    """Whether one is ahead by enough: whoever is near to first order must run as a filter before it is behind.

    Args:
        best, other: hypotheses.
        lead: that is enough, nats.
        read: whether `by_readings`.
    """
    enough = lead if best.run is not None and _arrived(other) else max(lead, NEAR)
    return (by_readings if read else margin)(best, other) > enough


def apart(one: Standing, other: Standing, params: JointParams, *, shaken: bool) -> float:
    """By how much one is ahead of another, nats.

    Args:
        one, other: with filters that are as far.
        params: see `JointParams`.
        shaken: whether something new has begun: what surprises the other in the newest sample then says nothing.
    """
    assert one.run is not None, "only filters are compared so"
    assert other.run is not None, "only filters are compared so"
    before = shaken and other.run.newest.surprise >= SURPRISED
    scores = [each.run.before_newest if before else each.run.score for each in (one, other) if each.run is not None]
    believed = [_judged(each.run, params).believed for each in (one, other) if each.run is not None]
    beforehand = one.beforehand + believed[0] - other.beforehand - believed[1]
    return scores[0].likelihood - scores[1].likelihood + beforehand


class _Judged(NamedTuple):
    """What a filter says of its cause.

    Attributes:
        believed: logarithm of how likely it is but for the readings, nats: beforehand, and as its forces go.
        force, sigma: of the failed jets.
    """

    believed: float
    force: tuple[float, ...] = ()
    sigma: tuple[float, ...] = ()


def _judged(run: Runner, params: JointParams) -> _Judged:
    if run.cause.kind != Kind.JETS:
        return _Judged(screens.prior(run.cause, params))
    force, covariance = _forces(run, params)
    believed = screens.believed(run.cause, force, covariance, params) + _regained(run, force, covariance, params)
    return _Judged(believed, tuple(force.tolist()), tuple(np.sqrt(np.diagonal(covariance)).tolist()))


def _measured(contender: Contender, run: Runner, nothing: float, judged: _Judged) -> Contender:
    lead = run.score.likelihood - nothing + judged.believed
    return contender._replace(onset=run.onset, lead=lead, force=judged.force, sigma=judged.sigma)


def _regained(run: Runner, force: Array, covariance: Array, params: JointParams) -> float:
    """Nats by which the readings are likelier, or less likely, with forces of N(0, T^2) beforehand than with what its
    filter opened with, N(f_0, S): ln of the integral of N(f; f^, P) N(f; 0, T^2) / N(f; f_0, S).
    """
    if not run.expected or run.cycle == run.onset:
        return 0.0
    mean, sigma = np.array(run.expected).T
    wide, narrow = params.thrusts[list(run.cause.jets)] ** -2.0, sigma**-2.0
    less, pull = wide - narrow, narrow * mean
    mixed = np.eye(force.shape[0]) + covariance * less
    if np.linalg.eigvals(mixed).real.min() > 0.0:
        volume, force = float(np.linalg.slogdet(mixed)[1]), np.linalg.solve(mixed, force - covariance @ pull)
        away = less * force + pull
        volume += float(away @ covariance @ away)
    else:  # its force changes, and is known no better than at first
        volume = 0.0
    density = np.sum(np.log(wide / narrow)) - force @ (less * force) - 2.0 * pull @ force + pull @ mean
    return 0.5 * float(density - volume)


def _most(run: Runner, params: JointParams) -> Array:
    most: Array = screens.most_forces(params)[list(run.cause.jets)]
    return most


def _forces(run: Runner, params: JointParams) -> tuple[Array, Array]:
    """Forces of the failed jets and their covariance, as a filter of its own has them."""
    places = zip(run.cause.jets, run.cause.signs, strict=True)
    rows = [params.places.force + slot_of(run.state, jet, sign) for jet, sign in places]
    return run.state.mean[rows], run.state.root[rows] @ run.state.root[rows].T


def _impossible(run: Runner, params: JointParams) -> bool:
    """Whether a filter knows by now that a jet would have to give more than it can, or less than nothing."""
    if run.cause.kind != Kind.JETS or run.age < len(run.kicks):
        return False
    force, covariance = _forces(run, params)
    within = screens.BOUND * np.sqrt(np.diagonal(covariance))
    return bool(((force - within > _most(run, params)) | (force + within < 0.0)).any())


def running(race: Race, standing: list[Standing], free_slots: int, params: JointParams) -> Race:
    """The race with the filters that it needs: of the jump, and of those near the best.

    Args:
        race: see `Race`.
        standing: see `standings`.
        free_slots: for forces of further failures.
        params: see `JointParams`.
    """
    if not standing:
        return race._replace(runs=(), out=race.out - {Cause(Kind.JUMP)})
    leader = standing[0]
    best = leader.contender.lead
    present = {run.cause: run for run in race.runs}
    led = {each.cause for each in race.leading} & present.keys()  # kept: that none explains what is new is said of them
    wanted: list[Runner] = []
    liar = next((each.contender.cause for each in standing if each.contender.cause.kind == Kind.LIES), None)
    young = race.cycles <= _LIE_RUNS
    behind = {
        each.contender.cause
        for each in standing
        if each.run is not None and each.contender.lead < best - OUT and not _at_a_wrong_onset(each)
    }
    fits = leader.run is None or leader.run.fits
    reach = NEAR if fits else max(NEAR, _FIRST_ORDER * best)  # what it leads by to first order may be none
    others = [each for each in standing[1:] if each.contender.cause.kind != Kind.JUMP]
    ahead_by = by_readings if race.cycles <= A_SECOND else margin
    close = {each.contender.cause for each in others if ahead_by(leader, each) < reach}

    lie = next((each.run for each in others if each.run is not None and each.run.cause.kind == Kind.LIES), None)
    lies_so_far = lie.cause if lie is not None and lie.fits else None

    def place(each: Standing) -> tuple[bool, ...]:
        """The jump first, forces that drift, and the reading that lies while that explains all so far: jets that to
        first order come near a jump, of which that says little, are many. Then those that are close, of them those
        that run: where dozens explain as much, they would take each other's place before any has arrived; then the
        rest; each as likely as they are.
        """
        cause = each.contender.cause
        first = cause.kind == Kind.JUMP or cause.drifts or cause == lies_so_far
        return not first, cause not in close, cause in close and cause not in present

    for each in (leader, *sorted(standing[1:], key=place)):
        contender, cause = each.contender, each.contender.cause
        stays = (cause.kind == Kind.JUMP or cause in present) and contender.lead > best - OUT
        stays = stays or is_unheard(race, each)
        near = stays or each is leader or cause in close or (young and cause == liar)
        if cause in led and not _may_begin_anew(present[cause], each):
            wanted.append(present[cause])
        elif near and contender.lead > 0.0 and len(wanted) < _RUNS and _fits(race, cause, free_slots):
            run, excess = present.get(cause), overrated(race, each, params)
            if run is None or _begins_anew(run, each):
                run = _opened(race, each.first_order, params)
            elif excess is not None:
                narrower = screens.as_rows(np.array(run.kicks) / excess)
                run = _opened(race, contender._replace(kicks=narrower), params)
            wanted.append(run)
    known = {each.contender.cause for each in standing} | race.out
    if young:  # its first order says nothing of a reading that lies for long, so it is heard once it has arrived
        wanted[1:1] = [run for run in race.runs if run.cause.kind == Kind.LIES and run.cause not in known][:1]
    drifting = [run for run in race.runs if run.cause.drifts and run.cause not in known]  # there is no first order
    race = race._replace(ceased=_ceased(race, standing))
    wanted[:0] = drifting + _drifting(race, standing, {run.cause for run in (*wanted, *drifting)}, params)
    out = race.out | (behind - led)
    if leader.run is None or not leader.run.fits:  # a jump may yet be what is left
        out -= {Cause(Kind.JUMP)}
    return race._replace(runs=tuple(wanted), out=out)


def _ceased(race: Race, standing: list[Standing]) -> tuple[Standing, ...]:
    """`Race.ceased` with those that the newest sample is no longer explained by."""
    now = [
        each
        for each in standing
        if len(each.contender.cause.jets) == 1 and not each.contender.cause.drifts and each.run is not None
        if not each.run.fits and each.run.explained_before
    ]
    causes, since = {each.contender.cause for each in now}, race.screen.cycle - A_SECOND
    before = [each for each in race.ceased if each.contender.cause not in causes]
    return *(each for each in before if each.run is not None and each.run.cycle > since), *now


def _drifting(race: Race, standing: list[Standing], present: set[Cause], params: JointParams) -> list[Runner]:
    """Filters for forces that drift, where no jets explain all any more: of single ones that did, or led, until then.

    A jet that weakens slowly may be told to fire only long after it has begun to, and one opposite that gives as much
    keeps it from being named; by then its force has changed too much for a constant one, and what would explain that
    is a jump.
    """
    of_jets = (each.run for each in standing if each.contender.cause.kind == Kind.JETS)
    if any(run is not None and run.fits for run in of_jets):
        return []
    found: list[Runner] = []
    for each in (*race.led, *race.ceased):
        run, contender = each.run, each.contender
        cause = contender.cause._replace(drifts=True)
        alone = cause.kind == Kind.JETS and len(cause.jets) == 1
        new = cause not in present and cause not in race.out and all(cause != other.cause for other in found)
        if alone and new and run is not None and run.onset in race.screen.onsets:
            found.append(_opened(race, contender._replace(cause=cause, onset=run.onset, kicks=run.kicks), params))
    return found


def is_unheard(race: Race, standing: Standing) -> bool:
    """Whether it is a jump of which only the first order speaks, while jets fired when it may have happened."""
    return standing.contender.cause.kind == Kind.JUMP and standing.run is None and race.screen.fired


def _fits(race: Race, cause: Cause, free_slots: int) -> bool:
    """Whether the state has a slot for each of its jets."""
    taken = _known(race)
    return len(cause.failures - taken) <= free_slots


def _known(race: Race) -> set[tuple[int, int]]:
    """Jets and signs of the failures that are known."""
    base = race.states[0]
    return set(zip(base.slot_jet.astype(np.intp).tolist(), base.slot_sign.astype(np.intp).tolist(), strict=True))


def _may_begin_anew(led: Runner, standing: Standing) -> bool:
    """Whether a filter that led begins anew: not where something new may have begun in the newest sample."""
    return led.newest.surprise < SURPRISED and _begins_anew(led, standing)


def _begins_anew(run: Runner, standing: Standing) -> bool:
    """Whether a filter began with far more uncertainty of its onset than there now is, or another explains more.

    Where a filter fits, and the first order is far from what it has measured, the first order is wrong, unless it has
    more and both have the same forces: then it is what the filter took for its onset that costs so much.
    """
    contender, arrived_run, first = standing.contender, standing.run, standing.first_order
    if first.share > run.share:  # a jump turns out larger than its filter expects: it would hold on to what it knows
        return True
    there = first.lead_at(run.onset)
    strays = run.fits and arrived_run is not None and abs(there - contender.lead) > NEAR
    if strays and not (there > contender.lead and _of_one_size(first, contender)):
        return False
    if run.kicks and first.onset == run.onset:  # elsewhere a jet may have been told otherwise, and kick otherwise
        wider = np.log(np.array(run.kicks) / np.array(first.kicks))
        if float(np.sum(np.maximum(wider, 0.0))) > _TOO_WIDE:
            return True
    return not strays and _is_better_elsewhere(standing)


def overrated(race: Race, standing: Standing, params: JointParams) -> Array | None:
    """By which factors a filter's impulses at its onset are more than its forces can have given; None: none is.

    Impulses that the first readings allowed, and forces that then turn out to be far less, are no failure: two jets
    against each other with a kick of any size explain whatever happened in the midst of a sample. A jet that has failed
    before may have ceased to push: what its force has changed by may have given them, too.
    """
    run, contender = standing.run, standing.contender
    if run is None or not run.kicks or run.onset not in race.screen.onsets:
        return None
    gap = race.screen.gaps[race.screen.onsets.index(run.onset)]
    known = known_forces(race.states[0], params)
    places = zip(contender.cause.jets, contender.cause.signs, strict=True)
    had = [known[column_of(jet, sign, params)] for jet, sign in places]
    given = np.maximum(np.abs(contender.force), np.abs(np.array(contender.force) - had))
    most = KICK * gap * (given + screens.BOUND * np.array(contender.sigma))
    factors = np.maximum(np.array(run.kicks[0]) / most, 1.0)
    return factors if float(np.sum(np.log(factors))) > _TOO_WIDE else None


def _at_a_wrong_onset(standing: Standing) -> bool:
    """Whether a filter does not fit, while the first order explains more at another onset."""
    run = standing.run
    elsewhere = run is not None and not run.fits and standing.first_order.onset != run.onset
    return elsewhere and _is_better_elsewhere(standing)


def _is_better_elsewhere(standing: Standing) -> bool:
    """Whether the first order explains more at another onset, or of another share, than a filter that has arrived."""
    run, first = standing.run, standing.first_order
    if run is None or (first.onset == run.onset and first.share == run.share):
        return False
    return first.lead > max(first.lead_at(run.onset), standing.contender.lead) + _BETTER


def _of_one_size(first: Contender, other: Contender) -> bool:
    """Whether two have the same forces, to a half."""
    return bool(first.force) and all(abs(f - g) <= 0.5 * abs(g) for f, g in zip(first.force, other.force, strict=True))


def _opened(race: Race, contender: Contender, params: JointParams) -> Runner:
    screen, cause = race.screen, contender.cause
    place = 0 if cause.kind == Kind.JUMP else 1 + screen.onsets.index(contender.onset)
    onset = screen.began if cause.kind == Kind.JUMP else contender.onset
    score = screen.scores[onset - screen.began]
    return Runner(
        cause,
        onset,
        contender.kicks,
        onset,
        race.states[place],
        score,
        cause.kind == Kind.LIES,
        entry=score,
        share=contender.share,
        expected=_expected(race, contender, params),
    )


def _expected(race: Race, contender: Contender, params: JointParams) -> tuple[tuple[float, float], ...]:
    """Mean and 1-sigma of each force as a filter opens with it: as found to first order, five times as wide.

    The force of a full jet, not known at all, times what is not known of inertia and balance is noise in the first
    intervals, and a filter that takes it for that loses nats that the first order does not: two jets that push against
    each other, of which the sum stays open for seconds, lose twenty. What the narrower prior gives is taken back
    (`_regained`).
    """
    if contender.cause.kind != Kind.JETS or contender.cause.drifts:  # of one that drifts it says what it is by now
        return ()
    known = _known(race)
    found: list[tuple[float, float]] = []
    for each in contender.failures:
        thrust, sigma = float(params.thrusts[each.jet]), _WIDER * each.sigma
        fresh = (each.jet, each.sign) not in known and sigma < thrust
        found.append((each.force, sigma) if fresh else (0.0, thrust))
    return tuple(found)


def stepped_on(race: Race, left: int, history: History, erratic: np.ndarray, params: JointParams) -> tuple[Race, int]:
    """The race with its filters as far as the steps that are left let them go, and what then is left.

    Those that were at the present stay there; then those that are behind catch up, in their order. Those that turn out
    to be impossible leave the race, and those whose filter comes to nothing.

    Args:
        race: see `Race`.
        left: steps.
        history: see `History`.
        erratic: see `hypotheses.restless`.
        params: without increments.
    """
    runs, out, screen = list(race.runs), set(race.out), race.screen
    for place in sorted(range(len(runs)), key=lambda place: runs[place].cycle < screen.cycle - 1):
        now = runs[place]
        while left > 0 and now.cycle < screen.cycle:
            record = history.at(now.cycle + 1)
            done = now.cycle - screen.began
            left -= 1
            try:
                if now.cause.kind == Kind.JUMP and now.cycle <= screen.onsets[-1]:
                    now = jumping(now, record.sample, screen.scores[done + 1], params)
                else:
                    now = stepped(now, record.sample, record.link, erratic, params)
            except NotPositiveDefiniteError:  # of what it says no filter is left
                out.add(now.cause)
                break
        runs[place] = now
        if _impossible(now, params):
            out.add(now.cause)
    return race._replace(runs=tuple(run for run in runs if run.cause not in out), out=frozenset(out)), left


def column_of(jet: int, sign: int, params: JointParams) -> int:
    """Place of a jet's failure among those that give more and then those that give less."""
    return jet + (params.places.jets if sign < 0 else 0)


def known_forces(state: JointState, params: JointParams) -> Array:
    """Force of each known failure, more and then less, shape (2 n_jets,)."""
    result = np.zeros(2 * params.places.jets)
    for slot in np.flatnonzero(state.slot_jet >= 0):
        column = column_of(int(state.slot_jet[slot]), int(state.slot_sign[slot]), params)
        result[column] = max(state.mean[params.places.force + slot], np.finfo(np.float64).tiny)
    return result

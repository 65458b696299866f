r"""The detector of the joint estimator: a bank of onsets raises the alarm, a race of hypotheses decides it.

    every cycle     the bank is carried on, and its telescoped test looks for anything that nothing explains
    at an alarm     a race begins from a snapshot before the likeliest onset (`joint.race`)
    at a decision   the winner's state becomes the filter's: what it learned since the onset is undone by that alone

Known failures stay in their slots of the state, their forces estimated on. A jet whose force has been found changed
for the third time is *erratic*: from then on the filter expects anything of it.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np

from massprop_drake.maths.estimation.joint import bank as banks
from massprop_drake.maths.estimation.joint import early as at_start
from massprop_drake.maths.estimation.joint import race as races
from massprop_drake.maths.estimation.joint import screen as screens
from massprop_drake.maths.estimation.joint.apart import Apart, told_apart
from massprop_drake.maths.estimation.joint.bank import Bank
from massprop_drake.maths.estimation.joint.covariance import compressed
from massprop_drake.maths.estimation.joint.cycle import Report, Sample, step
from massprop_drake.maths.estimation.joint.decision import (
    ALIKE,
    SIGNIFICANT,
    UNSETTLED_FLOOR,
    Decision,
    Outcome,
    Rules,
    as_they_stood,
    decided,
    explaining,
    is_one,
    nearly_fits,
    runners_up,
)
from massprop_drake.maths.estimation.joint.early import Early, Found
from massprop_drake.maths.estimation.joint.guard import unguarded
from massprop_drake.maths.estimation.joint.hypotheses import (
    DRIFT,
    JUMP_SHARES,
    jump_sigma,
    masked,
    misfits,
    restless,
    slot_of,
    without_increments,
)
from massprop_drake.maths.estimation.joint.layout import N_PROPERTIES, JointParams, JointState, Places, settled
from massprop_drake.maths.estimation.joint.payload import UNKNOWN, Payload, brought
from massprop_drake.maths.estimation.joint.race import History, Race, Record
from massprop_drake.maths.estimation.joint.screen import Contender, FailedJet
from massprop_drake.maths.estimation.joint.sensitivity import Link, Traces, linked, traces
from massprop_drake.maths.kernels import kernel
from massprop_drake.maths.linear_algebra import Array

_REDRAWN = (6, 12, 24, 48, 96)  # cycles of a race after which it moves to its likeliest onset, if that is at its edge
_LEAK_FLOOR, _LOSS_FLOOR = 0.002, 0.1  # of full thrust: below, thrusts that are not as stated explain as much
_LEAST_FLOOR = 0.00115  # of the largest jet's thrust: 1 lbf of 870
_CHANGE = 0.1  # of full thrust, by which a known force must differ to be said to have changed
_BETTER = 0.5  # of the 1-sigma of a force as announced
_SAID = float(np.finfo(np.float64).tiny)  # of a force that has been announced, at the least: zero is not yet
_ERRATIC_AFTER = 3  # changes
_REMEMBERED = 25  # cycles for which who led alone is remembered while only two at once explain what has come since
_SOON = 12  # cycles after jets have been named because something new had begun in which an alarm is of that
_OTHERWISE = 3  # others that are followed beside who is named, the likeliest
_MEASURED = 0.1  # of a payload's mass, to which it is known when its size is told
_ONSET_SHARE = 0.7  # of the largest statistic: older onsets explain the end point as well

Way = tuple[int, int]  # a jet and a sign
Ways = frozenset[Way]


class Word(IntEnum):
    """What is said of jets; but for the first two of one jet, or of a group that is not told apart."""

    FAILED = 1
    GROUP = 2  # one of these has failed
    CHANGED = 3
    WITHDRAWN = 4  # nothing is left of an earlier failure
    ERRATIC = 5  # it gives something else every time


class JetsDeclared(NamedTuple):
    """Something said of jets.

    Attributes:
        word: see `Word`.
        jets: indices; of a group its members, likeliest first.
        signs: 1: it gives more than it is told to, -1: less.
        forces, sigmas: of each, lbf or N; NaN but for the first where a group is spoken of again.
        onset_s: when it began.
        apart: what would tell the members of a group apart.
    """

    word: Word
    jets: tuple[int, ...]
    signs: tuple[int, ...]
    forces: tuple[float, ...]
    sigmas: tuple[float, ...]
    onset_s: float
    apart: Apart = Apart()


class JumpDeclared(NamedTuple):
    """A jump of the mass properties; first when it is found, with its size if that is known by then, and again when
    the filter has settled after it and knows the mass to a tenth.

    Attributes:
        measured: whether this is the second time.
        onset_s: when it had not happened yet.
        mass, mass_sigma: gained (released: negative), NaN when it is first said while the jump's filter does
            not fit or the mass is not known to a tenth, slug or kg.
        position, position_sigma: where, vehicle frame, NaN while the mass is not significant, ft or m, shape (3,).
    """

    measured: bool
    onset_s: float
    mass: float
    mass_sigma: float
    position: Array
    position_sigma: Array


class ReadingDeclared(NamedTuple):
    """A reading that lies.

    Attributes:
        component: index among all, gyros first.
        onset_s: before its first wrong sample.
    """

    component: int
    onset_s: float


class Unexplained(NamedTuple):
    """Something that no hypothesis explains.

    Attributes:
        onset_s: when it began.
    """

    onset_s: float


Declaration = JetsDeclared | JumpDeclared | ReadingDeclared | Unexplained


class HypothesisParams(NamedTuple):
    """What shapes the detector.

    Attributes:
        joint: of the filter.
        trigger_jet: l above which a race begins.
        trigger: T above which a race begins.
        rules: see `Rules`.
    """

    joint: JointParams
    trigger_jet: float = 28.0
    trigger: float = 45.0
    rules: Rules = Rules()


class State(NamedTuple):
    """All that the detector remembers. Never changed; a cycle makes a new one.

    Attributes:
        cycle: number of samples taken.
        bank: see `Bank`.
        history: see `History`.
        race: the one under way.
        commanded: samples in which each jet was commanded; zero: untested, shape (n_jets,).
        members: of each slot's failure, by jet, those that give more and then those that give less: its place among
            those that look alike, 1: the likeliest; 0: it is none. Without any, nobody may be blamed for the slot's
            force. Shape (n_force, 2 n_jets).
        apart: of each slot's group, see `Apart`, shape (n_force, 2).
        onsets: when what a race has put into each slot began, NaN once that has been said, s, shape (n_force,).
        announced, sigmas: force of each slot as announced, or as known better since, and its 1-sigma; zero: not yet,
            lbf or N, shape (n_force,).
        changes: times that each slot's force was announced as changed, shape (n_force,).
        erratic: see `hypotheses.restless`, shape (n_force,).
        lying: 1 for each component that is left out until it fits, shape (m,).
        earlier: of the filter before a jump that is not measured yet.
        explained: cycle up to which what was named last explains all; whatever began there has not been found.
        early: what is kept of a start in case a jet fails in it.
    """

    cycle: int
    bank: Bank
    history: History
    race: Race | None
    commanded: Array
    members: Array
    apart: Array
    onsets: Array
    announced: Array
    sigmas: Array
    changes: Array
    erratic: Array
    lying: Array
    earlier: JointState | None
    explained: int = -1
    early: Early = at_start.BEGUN


class Status(NamedTuple):
    """What is logged of a cycle.

    Attributes:
        tested: whether all axes had readings to be tested, and none of them is held as lying.
        likelihood, total: largest l and T; zero where nothing was tested.
        racing: whether a race is under way.
        likeliest: hypothesis in it; None: nothing has happened, or not known yet.
        lead: of the likeliest over the next, nats.
        leads: of the likeliest hypothesis about each jet over the one that nothing has happened, in the order of
            likelihood: jet and nats.
    """

    tested: bool = False
    likelihood: float = 0.0
    total: float = 0.0
    racing: bool = False
    likeliest: Contender | None = None
    lead: float = 0.0
    leads: tuple[tuple[int, float], ...] = ()


class Otherwise(NamedTuple):
    """What a decision that names jets rests on, for `had_others_won`.

    Attributes:
        state: before it.
        joint: the filter's state before it.
        named: the decision.
        others: the same with another winner each.
    """

    state: State
    joint: JointState
    named: Decision
    others: tuple[Decision, ...]


class Other(NamedTuple):
    """What would be where jets are named, had others won that are not far behind.

    Attributes:
        state: to remember.
        joint: the filter's state.
        declarations: what would be declared.
        odds: by which it is behind the winner, negative, nats.
    """

    state: State
    joint: JointState
    declarations: tuple[Declaration, ...]
    odds: float


class Judged(NamedTuple):
    """What the detector makes of a cycle.

    Attributes:
        state: to remember.
        replacement: that the filter goes on from; None: its own.
        published: of a race that is open, the state of the likeliest hypothesis once it leads that nothing has happened
            by `Rules.lead_nothing`; None: that from which the filter goes on.
        declarations: what is declared.
        status: see `Status`.
        otherwise: of jets that are named, where others that have a filter are not far behind; else None.
    """

    state: State
    replacement: JointState | None
    published: JointState | None
    declarations: tuple[Declaration, ...]
    status: Status
    otherwise: Otherwise | None = None

    def goes_on_from(self, own: JointState) -> JointState:
        """The filter's state after the cycle, given its own."""
        return own if self.replacement is None else self.replacement


def initial(params: JointParams) -> State:
    """The state before the first sample."""
    places: Places = params.places
    slots = np.zeros(places.n_force)
    return State(
        cycle=0,
        bank=banks.empty(places),
        history=History(0, ()),
        race=None,
        commanded=np.zeros(places.jets),
        members=np.zeros((places.n_force, 2 * places.jets)),
        apart=np.tile(Apart(), (places.n_force, 1)),
        onsets=np.full(places.n_force, np.nan),
        announced=slots,
        sigmas=slots,
        changes=slots,
        erratic=slots,
        lying=np.zeros(3 * (places.gyros + places.accelerometers)),
        earlier=None,
    )


def untested(state: State) -> tuple[int, ...]:
    """Indices of the jets that have never been commanded: that they would not fire, nothing could have shown."""
    return tuple(np.flatnonzero(state.commanded == 0.0).tolist())


def judge(
    state: State, before: JointState, after: JointState, report: Report, sample: Sample, params: HypothesisParams
) -> Judged:
    """What becomes of one cycle of the filter.

    Args:
        state: of the detector, after the last cycle.
        before, after: of the filter, before and after this cycle.
        report: of the filter's cycle.
        sample: of it.
        params: see `HypothesisParams`.

    Raises:
        NotPositiveDefiniteError: see `joint.cycle.step`.
    """
    joint = params.joint
    told = (sample.commands > 0.0).any(axis=0)
    state = state._replace(cycle=state.cycle + 1, commanded=state.commanded + told)
    if report.course is None:  # the first sample, or the first after a gap: nothing before it can be compared
        quiet = _quiet(state, joint)._replace(early=at_start.BEGUN if report.starting else at_start.OVER)
        return Judged(quiet, _restless(quiet, after, after, joint), None, (), Status())
    state, found = _searched(state, before, report, sample, params)
    if found is not None:
        state, of_start = _found(_quiet(state, joint), found, joint)
        return Judged(state, found.state, None, of_start, Status(racing=True))
    state, again, report, sample = _probation(state, before, (after, report), sample, joint)
    if not again.guarded or report.incremented:  # an increment forgets what a race would compare
        quiet = _quiet(state, joint)
        return Judged(
            quiet, _restless(quiet, again, after, joint), None, (), Status(racing=state.early.search is not None)
        )
    state, decision, standing, status = _raced(state, before, again, report, sample, params)
    status = status._replace(racing=status.racing or state.early.search is not None)
    if decision.outcome == Outcome.OPEN:
        published = None
        if standing and standing[0].run is not None and standing[0].contender.lead > params.rules.lead_nothing:
            published = standing[0].run.state
        declared: tuple[Declaration, ...] = ()
        if state.race is None:  # while one is under way, nothing is known of forces that it may change
            state, declared = _known_now(state, again, joint)
        return Judged(state, _restless(state, again, after, joint), published, declared, status)
    others = tuple(_otherwise(state, decision, standing))
    otherwise = Otherwise(state, again, decision, others) if others or decision.shaken else None
    state, now, said = _concluded(state, again, decision, joint)
    state, declared = _known_now(state, now, joint)
    said = [*said, *declared]
    if decision.outcome in (Outcome.JETS, Outcome.GROUP, Outcome.LIES):
        state = state._replace(early=at_start.OVER)
    return Judged(state, _restless(state, now, after, joint), None, tuple(said), status, otherwise)


def _quiet(state: State, params: JointParams) -> State:
    """What is remembered while nothing can be compared."""
    return state._replace(bank=banks.empty(params.places), history=History(state.cycle, ()), race=None)


def _searched(
    state: State, before: JointState, report: Report, sample: Sample, params: HypothesisParams
) -> tuple[State, Found | None]:
    """A cycle of the search for a jet that fails before the start has converged, see `early`."""
    early = state.early
    contradicted = report.contradicted or (report.incremented and report.starting)
    if not early.under_way:
        return state, None
    if not (report.starting or contradicted or early.contradicted) or params.joint.places.n_force == 0:
        return state._replace(early=at_start.OVER), None
    early, found = at_start.followed(early, before, sample, contradicted, (params.rules, params.joint))
    return state._replace(early=early), found


def _found(state: State, found: Found, params: JointParams) -> tuple[State, tuple[Declaration, ...]]:
    """What is said of a jet that has failed before the start had converged, if its force is large enough."""
    (jet,), (sign,) = found.cause.jets, found.cause.signs
    slot = slot_of(found.state, jet, sign)
    force, sigma = _force(found.state, slot, params)
    jets = (jet, *(each.jets[0] for each, _, _ in found.group))
    signs = (sign, *(each.signs[0] for each, _, _ in found.group))
    forces = (force, *(each for _, each, _ in found.group))
    sigmas = (sigma, *(each for _, _, each in found.group))
    floors = (_floor(*way, False, True, params) for way in zip(jets, signs, strict=True))
    is_said = any(each > floor for each, floor in zip(forces, floors, strict=True))
    state = state._replace(
        members=_with(state.members, slot, _listed(jets, signs, params)),
        onsets=_with(state.onsets, slot, np.nan if is_said else found.onset_s),
        announced=_with(state.announced, slot, max(force, _SAID) if is_said else 0.0),
        sigmas=_with(state.sigmas, slot, sigma if is_said else 0.0),
    )
    word = Word.GROUP if found.group else Word.FAILED
    return state, (JetsDeclared(word, jets, signs, forces, sigmas, found.onset_s),) if is_said else ()


def had_others_won(otherwise: Otherwise, params: JointParams) -> tuple[Other, ...]:
    """What would be, of each of those that are not far behind.

    Args:
        otherwise: see `Judged.otherwise`.
        params: see `JointParams`.
    """
    winner, found = otherwise.named.winner, []
    assert winner is not None, "one has won"
    for decision in otherwise.others:
        its = decision.winner
        assert its is not None, "it would have won"
        state, joint, declared = _concluded(otherwise.state, otherwise.joint, decision, params)
        behind = races.apart(its, winner, params, shaken=otherwise.named.shaken)
        found.append(Other(state, joint, tuple(declared), behind))
    return tuple(found)


def goes_on(otherwise: Otherwise) -> State:
    """What would be remembered, had nothing been decided of those that lead, and nobody led."""
    race = otherwise.state.race
    assert race is not None, "only a race is decided"
    return otherwise.state._replace(race=race._replace(leading=(), led=(), clear=None))


def _otherwise(state: State, decision: Decision, standing: list[races.Standing]) -> list[Decision]:
    """The decision with others as the winner, of those with a filter as far: the other members of a group, or whoever
    explains all, too, and is not far behind.
    """
    winner, race = decision.winner, state.race
    if decision.outcome not in (Outcome.JETS, Outcome.GROUP) or winner is None or race is None:
        return []
    assert winner.run is not None, "only a filter of its own decides"
    as_far = {
        each.contender.cause: each
        for each in (*race.led, *standing)
        if each.run is not None and each.run.cycle == winner.run.cycle
    }
    if decision.outcome == Outcome.JETS:
        return [decision._replace(winner=each) for each in runners_up(winner, list(as_far.values()))][:_OTHERWISE]
    found: list[Decision] = []
    everyone = (winner.contender, *decision.group)
    for contender in everyone[1:]:
        alternatives = _seen_from(contender, decision.alternatives)
        if contender.cause in as_far and alternatives:
            first = as_far[contender.cause]._replace(contender=contender)
            rest = tuple(each for each in everyone if each is not contender)
            found.append(decision._replace(winner=first, group=rest, alternatives=alternatives))
    return found[:_OTHERWISE]


def _seen_from(
    contender: Contender, alternatives: tuple[tuple[FailedJet, ...], ...]
) -> tuple[tuple[FailedJet, ...], ...]:
    """Alternatives with this one's failures first; none where it has not one of each."""
    own = {(each.jet, each.sign): each for each in contender.failures}
    found: list[tuple[FailedJet, ...]] = []
    for group in alternatives:
        firsts = [own[each.jet, each.sign] for each in group if (each.jet, each.sign) in own]
        if len(firsts) != 1:
            return ()
        others = (each for each in group if (each.jet, each.sign) not in own)
        found.append((firsts[0], *others))
    return tuple(found)


def _probation(
    state: State, before: JointState, own: tuple[JointState, Report], sample: Sample, params: JointParams
) -> tuple[State, JointState, Report, Sample]:
    """The filter's cycle without readings that still lie; the first that fits is free again."""
    if not state.lying.any():
        return state, *own, sample
    lying = state.lying.copy()
    for component in np.flatnonzero(lying):
        if misfits(own[1], int(component), params):
            sample = masked(sample, int(component))
        else:
            lying[component] = 0.0
    after, report = step(before, sample, without_increments(params)) if lying.any() else own
    return state._replace(lying=lying), after, report, sample


def _raced(
    state: State, before: JointState, after: JointState, report: Report, sample: Sample, params: HypothesisParams
) -> tuple[State, Decision, list[races.Standing], Status]:
    """Bank, alarm, race and decision."""
    joint = params.joint
    seen = _uncertain(traces(before, report, sample), before, state.erratic, joint)
    bank, least = state.bank, min(params.trigger_jet, params.trigger)
    over, found, tested, after_it = banks.followed_on(bank, seen, after, state.cycle, least, joint)
    if state.lying.any():
        found, tested = None, False
    history = History(state.cycle, (*state.history.records, Record(sample, over)))
    likelihood = float(found.likelihood.max()) if found is not None else 0.0
    total = float(found.total.max()) if found is not None else 0.0
    index = -1
    triggers = (params.trigger_jet, params.trigger)
    if found is not None and alarming(likelihood, total, settled(after, joint), triggers):
        index = _onset(state, found.total)
    race, decision = state.race, Decision(Outcome.OPEN)
    standing: list[races.Standing] = []
    if race is None and index >= 0:
        race = races.begin(bank, index, state.cycle, history, joint)
    status = Status(tested, likelihood, total, race is not None)
    if race is not None:
        race, standing = _run(race, history, state, before, joint)
        if standing:
            was_settled = settled(race.states[0], joint)
            decision = decided(race, standing, was_settled, params.rules, joint)
            if decision.outcome == Outcome.OPEN:
                race = _led(race, standing, decision, params.rules)
            second = max(standing[1].contender.lead, 0.0) if len(standing) > 1 else 0.0
            best = standing[0].contender
            status = status._replace(
                likeliest=best if best.lead > 0.0 else None,
                lead=best.lead - second if best.lead > 0.0 else -best.lead,
                leads=_leads(standing),
            )
    if race is not None and decision.outcome == Outcome.OPEN:
        if standing and index >= 0 and races.overtaken(race, int(bank.cycles[index])):
            race, standing = races.begin(bank, index, state.cycle, history, joint), []
            status = Status(tested, likelihood, total, True)
        else:
            quiet = bool(standing) and races.is_quiet(race, standing, params.rules.lead_nothing)
            race = race._replace(quiet=race.quiet + 1 if quiet else 0)
            if not race.led and state.cycle - race.triggered in _REDRAWN:
                race = races.moved(race, standing, bank, history, index, joint)
    bank = after_it
    oldest = int(bank.cycles[0]) if race is None else min(int(bank.cycles[0]), race.screen.began)
    history = History(state.cycle, history.records[-(state.cycle - oldest + 1) :])
    return state._replace(bank=bank, history=history, race=race), decision, standing, status


def _onset(state: State, total: Array) -> int:
    """Index of the onset about which a race begins.

    Where jets have just been named because something else had begun, that began before they ceased to explain all; what
    their filter has learned since is wrong, and makes later onsets look likely.

    Args:
        state: with the bank that has been tested.
        total: T of each onset, shape (k,).
    """
    until = state.bank.cycles <= state.explained
    soon = until.any() and state.cycle - state.explained <= _SOON
    return banks.onset_of(total[until] if soon else total, _ONSET_SHARE)


def _led(race: Race, standing: list[races.Standing], decision: Decision, rules: Rules) -> Race:
    """The race with who leads it now, and who did last: as they stood before a sample that surprises one of them."""
    winner = decision.winner
    leading = () if winner is None else (winner.contender, *decision.group)
    causes = {each.cause for each in leading}
    led = tuple(each for each in standing if each.run is not None and each.contender.cause in causes)
    if any(each.run is not None and each.run.newest.surprise >= races.SURPRISED for each in led):
        led = as_they_stood(race, causes) or led
    if not leading:
        fits = any(each.run is not None and each.run.fits for each in standing)
        led = explaining(standing, race.led, rules) if fits else race.led
    if led and not any(is_one(race, each) for each in led):  # two at once may stand for a second that has just begun
        since = race.screen.cycle - _REMEMBERED
        led = tuple(one for one in race.led if is_one(race, one) and one.run and one.run.cycle >= since) or led
    clear = winner.contender.cause if winner is not None and decision.clear else None
    who = {each.contender.cause for each in led}
    explains = any(each.run and nearly_fits(each.run) for each in standing if each.contender.cause in who)
    until = race.screen.cycle if explains else race.until if led else -1
    return race._replace(leading=leading, led=led, clear=clear, until=until)


@kernel
def alarming(likelihood: float, total: float, is_settled: bool, triggers: tuple[float, float]) -> bool:
    """Whether a race begins.

    Args:
        likelihood, total: largest l and T.
        is_settled: whether the start is over.
        triggers: `HypothesisParams.trigger_jet` and `trigger`.
    """
    factor = 1.0 if is_settled else at_start.BEFORE_SETTLED
    return likelihood > triggers[0] * factor or total > triggers[1] * factor


def _leads(standing: list[races.Standing]) -> tuple[tuple[int, float], ...]:
    """Lead of the likeliest hypothesis about each jet, see `Status`."""
    best: dict[int, float] = {}
    for each in standing:
        for jet in each.contender.cause.jets:
            best.setdefault(jet, each.contender.lead)
    return tuple(best.items())


def _uncertain(seen: Traces, before: JointState, erratic: Array, params: JointParams) -> Traces:
    """What a link is made of, with what erratic jets, and those that drift, add to the noise of its interval."""
    noise = seen.noise
    for slot in np.flatnonzero(erratic):
        column = params.places.force + int(slot)
        effect = np.concatenate((seen.rate_rows[:, column], seen.velocity_rows[:, column]))
        may_change = erratic[slot] * params.thrusts[int(before.slot_jet[slot])]
        noise = noise + may_change**2 * np.outer(effect, effect)
    return seen._replace(noise=noise)


def _run(
    race: Race, history: History, state: State, before: JointState, params: JointParams
) -> tuple[Race, list[races.Standing]]:
    """The race after one cycle's work, and its standing; none while it has not arrived at the present."""
    links = race.screen.cycle
    race = races.advanced(race, history, params)
    if not races.arrived(race, history):
        return race, []
    left = max(races.STEPS - (race.screen.cycle - links) // races.LINKS_PER_STEP, 1)
    known = races.known_forces(race.states[0], params)
    free = int((before.slot_jet < 0).sum())
    allowed = (np.ones(2 * params.places.jets) if free > 0 else known) > 0.0
    contenders = screens.contenders(race.screen, allowed, known, params)
    quiet = without_increments(params)
    race, left = races.stepped_on(race, left, history, state.erratic, quiet)
    race = races.running(race, races.standings(race, contenders, params), free, params)
    race, _ = races.stepped_on(race, left, history, state.erratic, quiet)
    return race, races.standings(race, contenders, params)


def _restless(state: State, now: JointState, own: JointState, params: JointParams) -> JointState | None:
    """What the filter is to go on from: None where it is its own state."""
    now = restless(now, state.erratic, params)
    return None if now is own else now


def _concluded(
    state: State, now: JointState, decision: Decision, joint: JointParams
) -> tuple[State, JointState, list[Declaration]]:
    """What the detector remembers after a decision, the filter's state, and what is declared."""
    declared: list[Declaration] = []
    race = state.race
    assert race is not None, "only a race is decided"
    began = race.states[0].time_s
    winner = decision.winner
    if winner is not None and winner.run is not None:
        now = winner.run.state
    if decision.outcome in (Outcome.JETS, Outcome.GROUP):
        assert winner is not None
        state, said = _jets(state, now, race, decision, joint)
        declared += said
    elif decision.outcome == Outcome.JUMP:
        assert winner is not None
        assert winner.run is not None
        size = brought(race.states[0], now, joint) if winner.run.fits else UNKNOWN
        if not _is_measured(size):  # nothing has pushed it enough
            size = UNKNOWN
        declared.append(JumpDeclared(False, began, *size))
        state = state._replace(earlier=race.states[0])
    elif decision.outcome == Outcome.LIES:
        assert winner is not None
        assert winner.run is not None
        lying = state.lying.copy()
        lying[winner.contender.cause.component] = float(winner.run.lying)
        state = state._replace(lying=lying)
        declared.append(ReadingDeclared(winner.contender.cause.component, _onset_s(race, winner.contender)))
    elif decision.outcome == Outcome.UNEXPLAINED:
        columns = np.zeros((joint.places.size, N_PROPERTIES))
        np.fill_diagonal(columns, jump_sigma(joint, JUMP_SHARES[0]))
        now = unguarded(now._replace(root=compressed(np.hstack((now.root, columns)), joint.places.thrust)))
        declared.append(Unexplained(began))
    bank, history, now = _anew(state, now, decision, joint)
    return state._replace(bank=bank, history=history, race=None, explained=_explained(decision, race)), now, declared


def _explained(decision: Decision, race: Race) -> int:
    """Cycle up to which jets explain all that are named because something new has begun, see `State.explained`."""
    run = decision.winner.run if decision.winner is not None else None
    if not decision.shaken or run is None:
        return -1
    return max(run.cycle - int(run.newest.surprise >= races.SURPRISED), race.until)


def _is_measured(size: Payload) -> bool:
    """Whether a mass is known well enough to be told."""
    return size.mass_sigma < _MEASURED * abs(size.mass)


def _anew(state: State, now: JointState, decision: Decision, joint: JointParams) -> tuple[Bank, History, JointState]:
    """Bank, history and the filter's state after a decision: what was learned before is of another filter.

    Of jets that have won, the last cycles of their filter are in it, from when it is known what they give: something
    else may have begun there that has not shown yet. Where the newest sample has shown it, that is in it in any case,
    and so are all samples since they led last.
    """
    bank, records = banks.empty(joint.places), state.history.records
    run = decision.winner.run if decision.winner is not None else None
    if decision.outcome not in (Outcome.JETS, Outcome.GROUP) or run is None:
        return banks.taken(bank, records[-1].link, now, state.cycle), History(state.cycle, (records[-1],)), now
    ago = state.cycle - run.cycle
    known_for = max(run.age - len(run.kicks), int(decision.shaken and ago == 0))
    count = min(len(run.earlier), known_for, len(records) - 1 - ago)
    past = run.earlier[len(run.earlier) - count] if count > 0 else now
    count += ago
    kept, cycle = [records[-1 - count]], state.cycle - count
    bank = banks.taken(bank, kept[0].link, past, cycle)
    quiet = without_increments(joint)
    for place, record in enumerate(records[len(records) - count :], start=1):
        after, report = step(restless(past, state.erratic, joint), record.sample, quiet)
        over = linked(_uncertain(traces(past, report, record.sample), past, state.erratic, joint), joint)
        kept.append(Record(record.sample, over))
        bank = banks.taken(banks.advanced(bank, over, joint.places), over, after, cycle + place)
        past = after
    return bank, History(state.cycle, tuple(kept)), past if ago > 0 else now


def _onset_s(race: Race, contender: Contender) -> float:
    """Time of an onset."""
    return race.states[1 + race.screen.onsets.index(contender.onset)].time_s


def _told(jet: int, over: Link) -> bool:
    """Whether a jet was told to fire over most of an interval."""
    return bool(over.amount[jet] > 0.5 * over.duration_s)


def _floor(jet: int, sign: float, told: bool, is_settled: bool, params: JointParams) -> float:
    """The least force to be declared: what a jet gives too much while it is told to fire may be its thrust's error."""
    thrust = float(params.thrusts[jet])
    if not is_settled:
        return UNSETTLED_FLOOR * thrust
    if sign < 0 or told:
        return _LOSS_FLOOR * thrust
    return max(_LEAK_FLOOR * thrust, _LEAST_FLOOR * float(params.thrusts.max()))


def _force(now: JointState, slot: int, params: JointParams) -> tuple[float, float]:
    row = params.places.force + slot
    return float(now.mean[row]), float(np.sqrt(np.sum(now.root[row] ** 2)))


def _jets(
    state: State, now: JointState, race: Race, decision: Decision, params: JointParams
) -> tuple[State, list[Declaration]]:
    """What is said of winning jets that nothing has been said of, if they are large enough; and whom it may be.

    Where the force of a jet that is known has changed, or else another has failed that pushes against it, that is said.
    Of what has been said of a group before, it stays a group; but where another of its members is now named alone,
    that settles which it was.
    """
    winner = decision.winner
    assert winner is not None, "somebody has won"
    contender = winner.contender
    announced, known = state.announced.copy(), state.sigmas.copy()
    members, aparts, onsets = state.members.copy(), state.apart.copy(), state.onsets.copy()
    erratic, was_settled = state.erratic.copy(), settled(race.states[0], params)
    doubtful = {(each[0].jet, each[0].sign): each for each in decision.alternatives}
    onset_s, over = _onset_s(race, contender), state.history.records[-1].link
    said: list[Declaration] = []
    for jet, sign in zip(contender.cause.jets, contender.cause.signs, strict=True):
        slot = slot_of(now, jet, sign)
        force, sigma = _force(now, slot, params)
        _, *others = doubtful.get((jet, sign), (None,))
        if not others:
            own = members[:, races.column_of(jet, sign, params)] > 1.0
            members[own] = members[own] == 1.0
        onsets[slot] = onset_s
        if contender.cause.drifts and erratic[slot] == 0.0:
            erratic[slot] = DRIFT * over.duration_s
        if announced[slot] > 0.0 and not others:
            continue
        jets, signs = (jet, *(each.jet for each in others)), (sign, *(each.sign for each in others))
        forces, sigmas = (force, *(each.force for each in others)), (sigma, *(each.sigma for each in others))
        apart = Apart()
        if others:
            likely = list(zip(jets, signs, forces, strict=True))
            apart = told_apart(race.screen, over, contender.onset, likely, ALIKE, params)
        members[slot], aparts[slot] = _listed(jets, signs, params), apart
        ways = zip(jets, signs, strict=True)
        floors = (_floor(each, way, _told(each, over), was_settled, params) for each, way in ways)
        if all(each <= floor for each, floor in zip(forces, floors, strict=True)):
            continue
        announced[slot], known[slot], onsets[slot] = max(force, _SAID), sigma, np.nan
        word = Word.GROUP if others else Word.FAILED
        said.append(JetsDeclared(word, jets, signs, forces, sigmas, onset_s, apart))
    state = state._replace(members=members, apart=aparts, onsets=onsets, erratic=erratic)
    return state._replace(announced=announced, sigmas=known), said


def _listed(jets: tuple[int, ...], signs: tuple[int, ...], params: JointParams) -> Array:
    """The row of a group in `State.members`."""
    row = np.zeros(2 * params.places.jets)
    columns = [races.column_of(jet, sign, params) for jet, sign in zip(jets, signs, strict=True)]
    row[columns] = 1.0 + np.arange(len(jets))
    return row


def _group(row: Array, params: JointParams) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Jets and signs of a row of `State.members`."""
    ways = sorted(np.flatnonzero(row).tolist(), key=row.__getitem__)
    jets = params.places.jets
    return tuple(way % jets for way in ways), tuple(1 if way < jets else -1 for way in ways)


def _known_now(state: State, now: JointState, params: JointParams) -> tuple[State, tuple[Declaration, ...]]:
    """What is known only now: failures too small before, forces that have changed, and the size of a jump."""
    said: list[Declaration] = []
    if state.earlier is not None and settled(now, params):
        size = brought(state.earlier, now, params)
        if _is_measured(size):
            said.append(JumpDeclared(True, state.earlier.time_s, *size))
            state = state._replace(earlier=None)
    if not state.members.any():
        return state, tuple(said)
    for slot in np.flatnonzero(state.members.any(axis=1) & (state.erratic < 1.0)).tolist():
        jet, sign = int(now.slot_jet[slot]), int(now.slot_sign[slot])
        force, sigma = _force(now, slot, params)
        had, had_sigma = state.announced[slot], state.sigmas[slot]
        told = had == 0.0 and _told(jet, state.history.records[-1].link)
        floor = max(_floor(jet, sign, told, settled(now, params), params), SIGNIFICANT * sigma)
        changes = state.changes[slot]
        if had == 0.0:
            if force < floor:
                continue
            word = Word.FAILED if np.count_nonzero(state.members[slot]) == 1 else Word.GROUP
        elif abs(force - had) > max(SIGNIFICANT * np.hypot(sigma, had_sigma), _CHANGE * params.thrusts[jet]):
            changes += 1.0
            word = Word.WITHDRAWN if force < floor else Word.CHANGED
        else:
            if sigma < _BETTER * had_sigma:  # the same force, known better: it is what a change is told from
                announced = _with(state.announced, slot, max(force, _SAID))
                state = state._replace(announced=announced, sigmas=_with(state.sigmas, slot, sigma))
            continue
        if changes >= _ERRATIC_AFTER:
            word = Word.ERRATIC
        jets, signs = _group(state.members[slot], params)
        unknown = (np.nan,) * (len(jets) - 1)
        by, after_s = state.apart[slot].tolist()
        apart = Apart(int(by), after_s) if word == Word.GROUP else Apart()
        began_s = float(state.onsets[slot])
        onset_s = now.time_s if np.isnan(began_s) else began_s  # no race has put it there: it drifts
        said.append(JetsDeclared(word, jets, signs, (force, *unknown), (sigma, *unknown), onset_s, apart))
        state = state._replace(
            onsets=_with(state.onsets, slot, np.nan),
            announced=_with(state.announced, slot, max(force, _SAID)),
            sigmas=_with(state.sigmas, slot, sigma),
            changes=_with(state.changes, slot, changes),
            erratic=_with(state.erratic, slot, state.erratic[slot] or float(word == Word.ERRATIC)),
        )
    return state, tuple(said)


def announced_jets(state: State, now: JointState) -> dict[tuple[int, int], float]:
    """1-sigma of the force of each jet, with its sign, that is declared alone, lbf or N."""
    alone = np.flatnonzero((state.announced > 0.0) & (np.count_nonzero(state.members, axis=1) == 1))
    return {(int(now.slot_jet[slot]), int(now.slot_sign[slot])): float(state.sigmas[slot]) for slot in alone.tolist()}


def narrowed(
    state: State, now: JointState, group: JetsDeclared, left: Ways, params: JointParams
) -> tuple[State, tuple[JetsDeclared, ...]]:
    """What is remembered and said of a group of which some have turned out not to be it.

    Args:
        state: before.
        now: the filter's state.
        group: as it was found.
        left: jets and signs of those that may be it still, of which the likeliest is one.
        params: see `JointParams`.
    """
    slot = slot_of(now, group.jets[0], group.signs[0])
    if frozenset(zip(*_group(state.members[slot], params), strict=True)) != ways_of(group):
        return state, ()  # it has been settled already
    ways = [way for way in zip(group.jets, group.signs, strict=True) if way in left]
    jets, signs = zip(*ways, strict=True)
    force, sigma = _force(now, slot, params)
    unknown = (np.nan,) * (len(jets) - 1)
    state = state._replace(
        members=_with(state.members, slot, _listed(jets, signs, params)),
        announced=_with(state.announced, slot, max(force, _SAID)),
        sigmas=_with(state.sigmas, slot, sigma),
    )
    word, apart = (Word.FAILED, Apart()) if len(jets) == 1 else (Word.GROUP, group.apart)
    return state, (JetsDeclared(word, jets, signs, (force, *unknown), (sigma, *unknown), group.onset_s, apart),)


def ways_of(said: JetsDeclared) -> Ways:
    """Jets and signs that something is said of."""
    return frozenset(zip(said.jets, said.signs, strict=True))


def unannounced(state: State, now: JointState, said: JetsDeclared) -> State:
    """What is remembered where a failure has not been announced after all: it is as soon as it is large enough.

    Args:
        state: of the detector.
        now: the filter's state.
        said: what would have been.
    """
    slot = slot_of(now, said.jets[0], said.signs[0])
    return state._replace(
        announced=_with(state.announced, slot, 0.0),
        sigmas=_with(state.sigmas, slot, 0.0),
        onsets=_with(state.onsets, slot, said.onset_s),
    )


def _with(values: Array, index: int, value: Array | float) -> Array:
    """The values with one replaced."""
    result = values.copy()
    result[index] = value
    return result

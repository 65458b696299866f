r"""Who has won a race, and what is said of it.

With L_0, L_J, L_S of nothing, jump and a reading that lies, L_1 of the likeliest jets, L_2 of the likeliest *other*
set of jets, in nats, and cycles counted from the alarm:

    jets     L_1 - L_2 > 6, L_1 - L_J > 6, L_1 - L_S > 6, L_1 - L_0 > 12, f > 3 sigma of each, and they fit; a pair
             after three samples; before settled only forces of a tenth of full thrust
    group    the same against all but at most two single jets that what has fired cannot tell apart
    lie      L_S leads all by 6 and nothing by 12, after 6 cycles
    jump     L_J leads all by 6, two samples at least and twelve where it does not fit; announced if settled and
             L_J - L_0 > 100, else taken as an increment
    nothing  L_0 leads after 12 cycles, or is within 8 after 75; and fits

and what is still open after 250 cycles is a group of however many, or unexplained.

A hypothesis *fits* whose NIS is at most 6 standard deviations above its expectation.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

from massprop_drake.maths.estimation.joint import screen as screens
from massprop_drake.maths.estimation.joint.hypotheses import Kind, Runner
from massprop_drake.maths.estimation.joint.layout import JointParams
from massprop_drake.maths.estimation.joint.race import OUT, Race, Standing
from massprop_drake.maths.estimation.joint.screen import Contender

FIT = 6.0  # standard deviations of chi-square: rounding is not white, and six are never chance
SIGNIFICANT = 3.0  # sigmas of a force
UNSETTLED_FLOOR = 0.1  # of full thrust: before settled a start that still learns explains less than that by jets
_LIE_AFTER = 6  # cycles: a lie that ends is told from a rate that has changed by what follows it
_JUMP_AFTER = 2  # samples: in one of them a pair of jets explains as much
_JUMP_THAT_MISFITS_AFTER = 12  # samples
_PAIR_AFTER = 3  # samples: two jets and their onsets explain nearly all of the six increments of one or two
_JUMP_AT_LEAST = 1000.0  # nats before settled: less is a start that still learns
_INCREMENT_AFTER = 25  # cycles: a filter that was a little off, no payload
_NOTHING_AFTER, _NOTHING_NEAR, _NOTHING_LATE = 12, 8.0, 75
_GROUP_AFTER = 100  # cycles: a leak that is not told apart in 8 s will not be soon
_GROUP_OF_LOSSES_AFTER = 4  # cycles: jets that fire together stay alike however long they do
_GROUP = 3  # jets at most
ALIKE = 12.0  # separation below which jets look alike: twice the lead
LAST = 250  # cycles of a race


class Outcome(IntEnum):
    """How a race ends."""

    OPEN = 0
    NOTHING = 1
    JETS = 2
    GROUP = 3
    JUMP = 4
    INCREMENT = 5
    LIES = 6
    UNEXPLAINED = 7


class Levels(NamedTuple):
    """Leads that decide, nats; see the module.

    Attributes:
        lead: over every other hypothesis.
        lead_nothing: over no failure.
        jump: over no failure, of a jump that is announced.
    """

    lead: float = 6.0
    lead_nothing: float = 12.0
    jump: float = 100.0


class Decision(NamedTuple):
    """A decision and whom it is about.

    Attributes:
        outcome: see `Outcome`.
        winner: see `Standing`; None where nothing has happened.
        group: further jets that what has fired cannot tell from the winner's.
    """

    outcome: Outcome
    winner: Standing | None = None
    group: tuple[Contender, ...] = ()


def decided(race: Race, standing: list[Standing], settled: bool, levels: Levels, params: JointParams) -> Decision:
    """The decision after a cycle.

    Args:
        race: its screen has arrived at the present.
        standing: see `race.standings`.
        settled: whether the filter's start is over.
        levels: see `Levels`.
        params: see `JointParams`.
    """
    cycles = race.screen.cycle - race.triggered + 1
    jump = next(each for each in standing if each.contender.cause.kind == Kind.JUMP)
    best = standing[0]
    lead = best.contender.lead
    kind = best.contender.cause.kind
    clear = lead > levels.lead_nothing and all(_margin(best, other) > levels.lead for other in standing[1:])
    if kind == Kind.JETS and best.run is not None and (jump.run is not None or jump.contender.lead < lead - OUT):
        large = settled or _large(best.contender, params)
        found = _of_jets(race, standing, cycles, clear, levels, params) if large else None
        if found is not None:
            return found
    if kind == Kind.JUMP and jump.run is not None and clear and cycles >= _jump_after(jump.run):
        if settled and lead > levels.jump:
            return Decision(Outcome.JUMP, jump)
        if cycles >= _INCREMENT_AFTER or (not settled and lead > _JUMP_AT_LEAST):
            return Decision(Outcome.INCREMENT, jump)
    if kind == Kind.LIES and best.run is not None and clear and cycles >= _LIE_AFTER:
        return Decision(Outcome.LIES, best)
    nothing_fits = race.screen.scores[-1].misfit < FIT
    if nothing_fits and cycles >= _NOTHING_AFTER and lead <= 0.0:
        return Decision(Outcome.NOTHING)
    if nothing_fits and cycles >= _NOTHING_LATE and lead <= _NOTHING_NEAR:
        return Decision(Outcome.NOTHING)
    if cycles >= LAST:
        return _at_last(standing, levels, nothing_fits)
    return Decision(Outcome.OPEN)


def _margin(best: Standing, other: Standing) -> float:
    """Lead over another hypothesis, like compared with like: filters, or where one has not arrived the first order."""
    measured = best.contender.lead - other.contender.lead
    if other.run is not None or best.run is None:
        return measured
    return min(measured, best.first_order.lead - other.first_order.lead)


def _jump_after(run: Runner) -> int:
    """Cycles after which a jump may win: large ones fit only when the filter has learned them."""
    return _JUMP_AFTER if run.score.misfit < FIT else _JUMP_THAT_MISFITS_AFTER


def _of_jets(
    race: Race, standing: list[Standing], cycles: int, clear: bool, levels: Levels, params: JointParams
) -> Decision | None:
    best, run = standing[0].contender, standing[0].run
    assert run is not None, "only a filter of its own decides"
    significant = all(abs(force) > SIGNIFICANT * sigma for force, sigma in zip(best.force, best.sigma, strict=True))
    known = any(jet in race.states[0].slot_jet for jet in best.cause.jets)
    if run.cycle - run.onset < len(run.kicks):  # what is not known of its first intervals is not all in its state
        return None
    if run.score.misfit >= FIT or best.lead <= levels.lead_nothing or not (significant or known):
        return None
    if len(best.cause.jets) > 1 and cycles < _PAIR_AFTER:
        return None
    if clear:
        return Decision(Outcome.JETS, standing[0])
    near = _near(standing, levels)
    single = all(c.cause.kind == Kind.JETS and len(c.cause.jets) == 1 for c in (best, *near))
    patience = _GROUP_OF_LOSSES_AFTER if best.cause.signs[0] < 0 else _GROUP_AFTER
    small = single and len(near) < _GROUP and cycles >= patience
    if small and all(screens.alike(race.screen, best, other, ALIKE, params) for other in near):
        return Decision(Outcome.GROUP, standing[0], near)
    return None


def _large(contender: Contender, params: JointParams) -> bool:
    """Whether each force is one that may be believed before settled."""
    jets = contender.cause.jets
    return all(f > UNSETTLED_FLOOR * params.thrusts[jet] for f, jet in zip(contender.force, jets, strict=True))


def _near(standing: list[Standing], levels: Levels) -> tuple[Contender, ...]:
    """Those that the best does not lead by enough."""
    best = standing[0].contender.lead
    return tuple(each.contender for each in standing[1:] if each.contender.lead > best - levels.lead)


def _at_last(standing: list[Standing], levels: Levels, nothing_fits: bool) -> Decision:
    best = next((each for each in standing if each.run is not None), None)
    if best is None or best.contender.lead <= levels.lead_nothing:
        return Decision(Outcome.NOTHING if nothing_fits else Outcome.UNEXPLAINED)
    if best.run is not None and best.run.score.misfit >= FIT:
        return Decision(Outcome.UNEXPLAINED, best)
    if best.contender.cause.kind == Kind.JUMP:
        return Decision(Outcome.INCREMENT, best)
    near = _near(standing, levels)
    if best is standing[0] and all(c.cause.kind == Kind.JETS for c in (best.contender, *near)):
        return Decision(Outcome.GROUP, best, near)
    return Decision(Outcome.UNEXPLAINED, best)

"""The detector by hypotheses as one of the registry: what it remembers, what logs keep, which jets are put out of use.

The mathematics is in `multi_hypothesis`. Its evidence is a `JointEvidence`. Forces of failed jets are states of the
filter, so that none acts through the impulse model; those that have been declared stand in `force` and `variance` for
the autopilot and the logs. A jet that is named alone is put out of use until its declaration is withdrawn; of a group
none is, whatever is said of it later: the slot is that of its likeliest member, which may be healthy.

Bank and race are snapshots of the filter by the dozen. A saved state has what has been said, and not these: after a
restart the bank begins anew, so that a race that was under way begins anew with the next alarm; jets that were to be
named and waited for others (`members`) are named then.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from massprop_drake.maths.arrays import FLAG, NUMBER, Field, Layout
from massprop_drake.maths.estimation.adaptation import NO_ADAPTATION
from massprop_drake.maths.estimation.detector import NO_KNOWN_FORCE, STATUS, Detector, Event, Jets, Judgment
from massprop_drake.maths.estimation.detectors import multi_hypothesis
from massprop_drake.maths.estimation.detectors.members import Members, as_said, follow
from massprop_drake.maths.estimation.detectors.multi_hypothesis import (
    Declaration,
    HypothesisParams,
    JetsDeclared,
    JumpDeclared,
    ReadingDeclared,
    Status,
    Unexplained,
    Word,
)
from massprop_drake.maths.estimation.filters.joint import JointFilterParams
from massprop_drake.maths.estimation.joint.cycle import JointEvidence
from massprop_drake.maths.estimation.joint.decision import Rules
from massprop_drake.maths.estimation.joint.hypotheses import Kind
from massprop_drake.maths.estimation.joint.layout import JointState, pack, state_layout, unpack
from massprop_drake.maths.estimation.joint.race import History
from massprop_drake.maths.linear_algebra import Array, NotPositiveDefiniteError

_WHAT = "a covariance by which the detector compares hypotheses"

GROUP = "hypothesis_detector"  # the system that holds the state in a diagram

# what is logged of every cycle besides what all detectors log; NaN where nothing is said
HYPOTHESIS_REPORT = Layout(
    "hypothesis_report",
    racing=Field("hypotheses are compared"),
    lead=Field("lead of the likeliest hypothesis, nats"),
    jump_mass=Field("mass gained in a jump, where it is known", "{mass}", "mass"),
    jump_mass_std=Field("1-sigma of it", "{mass}", "std"),
    jump_measured=Field("0: a jump is found; 1: an earlier one has been measured", component="measured"),
    lying_component=Field("index of a component that reads falsely", component="component"),
    unexplained_since=Field("onset of what nothing explains", "s", "onset"),
    jump_position=3,
    jump_position_std=3,
    verdict="jets",
    verdict_magnitude="jets",
    verdict_std="jets",
    verdict_onset="jets",
    verdict_group="jets",
    verdict_place="jets",
    verdict_apart_by="jets",
    verdict_apart_after="jets",
)


class State(NamedTuple):
    """All that is remembered. Never changed; a cycle makes a new one.

    Attributes:
        method: see `multi_hypothesis.State`.
        force, variance: of the declared jets that push untold, as the filter has them, lbf or N, shape (n_jets,).
        removed: 1 for each jet that is named alone, shape (n_jets,).
        closed: 1 for each jet whose manifold is closed: none, shape (n_jets,).
        members: of a group that are followed side by side, see `members`.
    """

    method: multi_hypothesis.State
    force: Array
    variance: Array
    removed: Array
    closed: Array
    members: Members = Members()


def make_params(jets: Jets, options: Any, filter_params: JointFilterParams) -> HypothesisParams:
    """Parameters from those of the filter and the scenario's block."""
    rules = Rules(options.lead, options.lead_nothing, options.jump, jets.clusters)
    return HypothesisParams(filter_params.joint, options.trigger_jet, options.trigger, rules)


def initial(params: HypothesisParams) -> State:
    """Before the first sample."""
    none = np.zeros(params.joint.places.jets)
    return State(multi_hypothesis.initial(params.joint), none, none, none, none)


def judge(state: State, evidence: JointEvidence, params: HypothesisParams) -> Judgment:
    """What is made of a cycle of the filter.

    Args:
        state: of the cycle before.
        evidence: see `JointEvidence`.
        params: see `HypothesisParams`.

    Raises:
        NotPositiveDefiniteError: see `joint.cycle.step`; and when a covariance that hypotheses are compared by has no
            root.
    """
    after = evidence.after
    try:
        found, members = follow(state.members, state.method, evidence, params)
    except np.linalg.LinAlgError:
        raise NotPositiveDefiniteError(after.root @ after.root.T, _WHAT, evidence.sample.time_s) from None
    now = found.goes_on_from(after)
    said = found.declarations
    force, variance = _declared(found.state, now, params)
    kept = State(found.state, force, variance, _removed(state.removed, said), state.closed, members)
    race = found.state.race or state.method.race
    alarms = 0 if race is None else found.state.cycle - race.triggered + 1
    likelihood = np.full(params.joint.places.jets, np.nan)
    for jet, lead in found.status.leads:
        likelihood[jet] = lead
    own = _own(said, found.status, likelihood.size)
    return Judgment(
        state=kept,
        adaptation=NO_ADAPTATION,
        status=_status(said, found.status, alarms),
        likelihood=likelihood,
        magnitude=own.verdict_magnitude,
        replacement=found.replacement,
        own=own,
        published=found.published,
    )


def _declared(method: multi_hypothesis.State, now: JointState, params: HypothesisParams) -> tuple[Array, Array]:
    """Force and variance of each declared jet that pushes untold, shape (n_jets,) each; what is off pushes nobody."""
    places = params.joint.places
    force, variance = np.zeros(places.jets), np.zeros(places.jets)
    if not method.announced.any():
        return force, variance
    for slot in np.flatnonzero((now.slot_jet >= 0) & (now.slot_sign > 0.0) & (method.announced > 0.0)).tolist():
        jet, row = int(now.slot_jet[slot]), now.root[places.force + slot]
        force[jet] = max(float(now.mean[places.force + slot]), 0.0)
        variance[jet] = row @ row
    return force, variance


def _removed(removed: Array, said: tuple[Declaration, ...]) -> Array:
    """1 for each jet that is to be out of use."""
    for one in said:
        if isinstance(one, JetsDeclared) and len(one.jets) == 1:
            removed = removed.copy()
            removed[list(one.jets)] = float(one.word != Word.WITHDRAWN)
    return removed


def _status(said: tuple[Declaration, ...], status: Status, alarms: int) -> Any:
    """What all detectors log: of several declarations the first."""
    likeliest = status.likeliest
    row: dict[str, float] = {"suspected_likelihood": status.likelihood}
    if likeliest is not None and likeliest.cause.kind == Kind.JETS:
        row["suspected_jet"] = float(likeliest.cause.jets[0])
        if likeliest.force:
            row["suspected_magnitude"] = likeliest.cause.signs[0] * likeliest.force[0]
            row["suspected_magnitude_std"] = likeliest.sigma[0]
    alarm = "suspected_jet" in row
    event = Event.NOTHING
    if said:
        first = said[0]
        event = _event(first)
        row = {key: value for key, value in row.items() if key == "suspected_likelihood"}
        row |= {"onset": first.onset_s, "alarms": float(alarms)}
        if isinstance(first, JetsDeclared):
            row["suspected_jet"] = float(first.jets[0])
            row["suspected_magnitude"] = first.signs[0] * first.forces[0]
            row["suspected_magnitude_std"] = first.sigmas[0]
            row["jet_isolated"] = float(len(first.jets) == 1)
    return STATUS.make(tested=float(status.tested), alarm=float(alarm), detector_event=float(event), **row)


def _event(one: Declaration) -> Event:
    if isinstance(one, JetsDeclared):
        return _EVENTS.get(one.word, Event.OTHER)
    return Event.JUMP if isinstance(one, JumpDeclared) and not one.measured else Event.OTHER


_EVENTS = {Word.FAILED: Event.DECLARED, Word.GROUP: Event.DECLARED, Word.WITHDRAWN: Event.WITHDRAWN}


def _own(said: tuple[Declaration, ...], status: Status, n_jets: int) -> Any:
    """What this detector logs, as `HYPOTHESIS_REPORT`."""
    told = _told(said, n_jets) if said else _nothing_told(n_jets)
    return told._replace(racing=float(status.racing), lead=status.lead if status.racing else math.nan)


@cache
def _nothing_told(n_jets: int) -> Any:
    """`_told` of most cycles; nobody changes its arrays."""
    return _told((), n_jets)


def nothing_said(n_jets: int) -> Any:
    """What this detector logs of a cycle in which nothing happens, as `HYPOTHESIS_REPORT`."""
    return _own((), Status(), n_jets)


def unremarkable(state: State) -> tuple[Any, ...]:
    """What all detectors log of such a cycle: of `STATUS`, and of each jet."""
    nothing = np.full(state.force.size, np.nan)
    return (*_status((), Status(), 0), nothing, nothing, state.force, state.variance)


def _told(said: tuple[Declaration, ...], n_jets: int) -> Any:
    """What is logged of what is said."""
    verdict, group, place = (np.zeros(n_jets) for _ in range(3))
    magnitude, std, onset, by, after = (np.full(n_jets, np.nan) for _ in range(5))
    position, position_std = np.full(3, np.nan), np.full(3, np.nan)
    row: dict[str, float] = {}
    bit = 1.0  # of the next thing that is said of jets
    for one in said:
        match one:
            case JetsDeclared():
                jets = list(one.jets)
                verdict[jets], place[jets] = float(one.word), 1.0 + np.arange(len(jets))
                magnitude[jets] = np.array(one.signs) * np.array(one.forces)
                std[jets], onset[jets] = one.sigmas, one.onset_s
                by[jets] = one.apart.jet if one.apart.jet >= 0 else math.nan
                after[jets] = one.apart.coasting_s
                group[jets] += bit
                bit *= 2.0
            case JumpDeclared():
                row |= {"jump_mass": one.mass, "jump_mass_std": one.mass_sigma, "jump_measured": float(one.measured)}
                position, position_std = one.position, one.position_sigma
            case ReadingDeclared():
                row["lying_component"] = float(one.component)
            case Unexplained():
                row["unexplained_since"] = one.onset_s
    of_jets = {"verdict": verdict, "verdict_magnitude": magnitude, "verdict_std": std, "verdict_onset": onset}
    of_jets |= {"verdict_group": group, "verdict_place": place, "verdict_apart_by": by, "verdict_apart_after": after}
    of_jets |= {"jump_position": position, "jump_position_std": position_std}
    return HYPOTHESIS_REPORT.make(**row, **of_jets)


def named(group: Array, place: Array) -> list[list[int]]:
    """Indices of the jets that each thing said at a sample is about, the likeliest first.

    Args:
        group, place: as logged at the sample, shape (n_jets,) each.
    """
    bits = group.astype(np.int64)
    order = np.argsort(place, kind="stable")
    return [order[bits[order] >> number & 1 > 0].tolist() for number in range(int(bits.max()).bit_length())]


# --------------------------------------------------------------------------------------- kept states

_SAVED = Layout(
    "hypotheses",
    cycle=NUMBER,
    commanded="jets",
    members=("forces", "ways"),
    apart=("forces", 2),
    onsets="forces",
    announced="forces",
    sigmas="forces",
    changes="forces",
    erratic="forces",
    lying="outputs",
    force="jets",
    variance="jets",
    removed="jets",
    jumped=FLAG,
    earlier="state",
)


def _layout(params: HypothesisParams) -> Layout:
    places = params.joint.places
    return _SAVED.sized(
        jets=places.jets,
        ways=2 * places.jets,
        forces=places.n_force,
        outputs=3 * (places.gyros + places.accelerometers),
        state=state_layout(places).size,
    )


def saved(state: State, params: HypothesisParams) -> Array:
    """What has been said and what it rests on, without bank and race, and without those that are followed beside."""
    method, places = as_said(state.members, state.method), params.joint.places
    jumped = method.earlier is not None
    earlier = np.zeros(state_layout(places).size) if method.earlier is None else pack(method.earlier, places)
    whom = (method.members, method.apart, method.onsets)
    said = (*whom, method.announced, method.sigmas, method.changes, method.erratic, method.lying)
    of_jets = (state.force, state.variance, state.removed)
    return _layout(params).pack((method.cycle, method.commanded, *said, *of_jets, jumped, earlier))


def restored(vector: Array, params: HypothesisParams) -> State:
    """The inverse of `saved`; the bank begins anew.

    Raises:
        ValueError: when the state holds what the detector cannot leave.
    """
    read = _layout(params).read(vector)
    told = read._replace(
        apart=read.apart[:, 0],
        onsets=np.nan_to_num(read.onsets, posinf=np.inf, neginf=np.inf),
        earlier=np.nan_to_num(read.earlier, posinf=np.inf, neginf=np.inf),  # a reading that is missing
    )
    if not all(np.isfinite(part).all() for part in told):
        raise ValueError(f"{GROUP}: must be finite")
    if (read.variance < 0.0).any():
        raise ValueError(f"{GROUP}: variances of known forces must be zero or positive")
    if not all(np.isin(flags, (0.0, 1.0)).all() for flags in (read.removed, read.lying)):
        raise ValueError(f"{GROUP}: removed and lying must be 0 or 1")
    if not ((read.erratic >= 0.0) & (read.erratic <= 1.0)).all():
        raise ValueError(f"{GROUP}: erratic must be from 0 to 1")
    counts = (np.array([read.cycle]), read.commanded, read.changes, read.members)
    if not all(((one >= 0.0) & (one == np.round(one))).all() for one in counts):
        raise ValueError(f"{GROUP}: counts must be whole numbers, zero or positive")
    if not np.isin(read.apart[:, 0], np.arange(-1.0, params.joint.places.jets)).all():
        raise ValueError(f"{GROUP}: what tells a group apart must be a jet's index, or -1")
    fresh = initial(params)
    method = fresh.method._replace(
        cycle=int(read.cycle),
        history=History(int(read.cycle), ()),
        commanded=read.commanded,
        members=read.members,
        apart=read.apart,
        onsets=read.onsets,
        announced=read.announced,
        sigmas=read.sigmas,
        changes=read.changes,
        erratic=read.erratic,
        lying=read.lying,
        earlier=unpack(read.earlier, params.joint.places) if read.jumped else None,
    )
    return fresh._replace(method=method, force=read.force, variance=read.variance, removed=read.removed)


DETECTOR = Detector(
    made_for="joint",
    params=make_params,
    initial=initial,
    known_force=lambda *_: NO_KNOWN_FORCE,
    judge=judge,
    saved=saved,
    restored=restored,
    group=GROUP,
    report=HYPOTHESIS_REPORT,
)

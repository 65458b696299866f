r"""First-order test of many faults at once: columns beside a filter that assumes none.

Per onset there is a column for each jet that gives something on top of what it is told to, for each that gives less,
for the impulse of each jet in the first interval (nobody knows when in it a failure began) and in the second (it builds
up with a lag), for each that gives more only while it is not told to, and for each reading that lies in the first
sample; besides, the ten parameters jump at the screen's beginning. With s the innovation that a column's unit adds,

    A = sum S^T Y^-1 S,    b = sum S^T Y^-1 e,

and for columns with the prior variances Pi, against no failure,

    L = 1/2 b^T (A + Pi^-1)^-1 b - 1/2 ln |I + Pi A|,    f = (A + Pi^-1)^-1 b.

So all jets, and all pairs of them, at three onsets cost a few matrix products a cycle. What is likeliest is then run
as a filter of its own (`hypotheses`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from massprop_drake.maths.estimation.joint.hypotheses import (
    JUMP_SHARES,
    KICK,
    NO_SCORE,
    SHARES,
    Cause,
    Kind,
    Score,
    false_reading_cost,
    jump_sigma,
    jump_variances,
)
from massprop_drake.maths.estimation.joint.layout import (
    CENTER,
    N_PROPERTIES,
    VELOCITY,
    JointParams,
    JointState,
    thrust_sigmas,
)
from massprop_drake.maths.estimation.joint.possible import impossible_force_cost
from massprop_drake.maths.estimation.joint.rate_coupling import turning_matrix
from massprop_drake.maths.estimation.joint.sensitivity import (
    Link,
    propagate_crossings,
    propagate_to_update,
    propagate_update,
)
from massprop_drake.maths.linear_algebra import Array

_MOST_FORCE = 1.05  # of full thrust: a jet gives no more, unless its thrust is stated to be that uncertain
PAIR_PRIOR = 12.0  # nats against two failures at once: 1e-5 of one
_KINDS = 5  # of columns of a jet
_BLOCKS = 4  # dimensions of A where only its blocks are kept
_FIRES = 0.01  # of an interval: less is the rest of a tail-off
LEAK = 0.5  # of full thrust: below, a jet leaks; above, it is stuck on and gives no more when it is told to fire
_LEAST_KICK = 1e-6  # of the largest, so that a variance has an inverse
BOUND = 3.0  # sigmas within which a force lies
_NEARLY = 1.5  # of full thrust: so much may be found of a jet while its onset is taken as known
_PAIRS = 30  # likeliest that are looked at with their onsets uncertain
_HAD_NOTHING = 1.0  # nats at a later onset that one is kept for at which no jet had anything to lose yet
_ALIKE = 4  # jets of which pairs are looked at since together they push as one: a cluster has as many


class Screen(NamedTuple):
    """Columns of a screen, and the log likelihood that they explain.

    Attributes:
        onsets: cycles after which failures may have begun, ascending.
        gaps: intervals between neighboring onsets, of each.
        cycle: the last one done.
        columns: errors of the filter per unit, shape (size, 10 + n_onsets * h), h = 5 n_jets + m.
        acting: share of the first intervals after each onset in which each failure can have acted, on top, less, and
            where not told to, shape (n_onsets, len(SHARES), 3 n_jets).
        information: A of each onset, shape (n_onsets, h, h); of single jets, its blocks of the columns of a jet, shape
            (n_onsets, n_jets, 5, 5).
        projection: b of each onset, shape (n_onsets, h).
        jump_information, jump_projection: of the jump, shape (10, 10) and (10,).
        scores: of no failure, after each cycle from the beginning on.
        fired: whether a jet fired in an interval in which what the screen is about may have happened: the first order,
            which has a jump happen between two samples, may then be far off.
        misfit: NIS of no failure, rounding taken as noise, above its expectation.
    """

    onsets: tuple[int, ...]
    gaps: tuple[int, ...]
    cycle: int
    columns: Array
    acting: Array
    information: Array
    projection: Array
    jump_information: Array
    jump_projection: Array
    scores: tuple[Score, ...]
    fired: bool = False
    misfit: float = 0.0

    @property
    def began(self) -> int:
        """Number of the cycle after which the first-order fault test begins."""
        return self.cycle - len(self.scores) + 1

    @property
    def single(self) -> bool:
        """True if only single-jet faults are tested, no pairs or false readings."""
        return self.information.ndim == _BLOCKS

    def information_of(self, index: int, sets: np.ndarray) -> Array:
        """Returns information matrices A of sets of fault-effect columns at an onset, shape (number, k, k)."""
        if self.single:
            jets = self.information.shape[1]
            jet, kind = sets % jets, sets // jets
            return self.information[index][jet[:, :, None], kind[:, :, None], kind[:, None, :]]
        return self.information[index][sets[:, :, None], sets[:, None, :]]


class Contender(NamedTuple):
    """Fault hypothesis with its log likelihood to first order.

    Attributes:
        cause: see `Cause`.
        onset: cycle after which it holds.
        lead: L above that of no failure, nats.
        force, sigma: of each failed jet, lbf or N.
        kicks: 1-sigma of the impulse of each in the first and in the second interval, in intervals of force, lbf or N.
        at_onsets: onsets at which it is possible to first order, and its lead at each.
    """

    cause: Cause
    onset: int
    lead: float
    force: tuple[float, ...] = ()
    sigma: tuple[float, ...] = ()
    kicks: tuple[tuple[float, ...], ...] = ()
    at_onsets: tuple[tuple[int, float], ...] = ()


def begin_screen(
    state_and_cycle: tuple[JointState, int],
    onsets: tuple[int, ...],
    gaps: tuple[int, ...],
    reading: Array,
    params: JointParams,
    *,
    single: bool = False,
) -> Screen:
    """Returns the first-order test of faults at given onsets, before its first cycle: all sums zero.

    Args:
        state_and_cycle: where it begins.
        onsets, gaps: see `Screen`.
        reading: readings then, shape (m,).
        single: whether to test single jets alone, which takes far less.
    """
    places = params.places
    state, cycle = state_and_cycle
    h = _KINDS * places.jets + reading.shape[0]
    columns = np.zeros((places.size, N_PROPERTIES + len(onsets) * h))
    jump = np.zeros((places.size, N_PROPERTIES))
    jump[:N_PROPERTIES] = np.diag(jump_sigma(params, JUMP_SHARES[0]))
    turn = turning_matrix(state.mean[slice(10, 13)], state.reference, state.spin)
    for package in range(places.accelerometers):
        part = slice(VELOCITY + 3 * package, VELOCITY + 3 * package + 3)
        jump[part] = turn @ jump[CENTER]
    columns[:, :N_PROPERTIES] = jump
    return Screen(
        onsets=onsets,
        gaps=gaps,
        cycle=cycle,
        columns=columns,
        acting=np.ones((len(onsets), len(SHARES), 3 * places.jets)),
        information=np.zeros((len(onsets), places.jets, _KINDS, _KINDS) if single else (len(onsets), h, h)),
        projection=np.zeros((len(onsets), h)),
        jump_information=np.zeros((N_PROPERTIES, N_PROPERTIES)),
        jump_projection=np.zeros(N_PROPERTIES),
        scores=(NO_SCORE,),
    )


def advance_screen(screen: Screen, interval: Link, params: JointParams) -> Screen:
    """Advances the first-order fault test by one cycle: fault effects, information, projections and scores."""
    places = params.places
    jets, m = places.jets, interval.read.shape[0]
    h, begun = _KINDS * jets + m, sum(onset <= screen.cycle for onset in screen.onsets)
    live = N_PROPERTIES + begun * h  # columns that are not zero
    forcing = np.zeros((6, live))
    of_onsets = forcing[:, N_PROPERTIES:].reshape(6, begun, h)
    untold = interval.effects.T * (interval.duration_s - interval.amount)
    less = interval.effects.T * -interval.amount
    impulse = interval.effects.T * interval.duration_s
    of_onsets[:, :, :jets] = impulse[:, None]
    of_onsets[:, :, jets : 2 * jets] = less[:, None]
    of_onsets[:, :, 4 * jets : 5 * jets] = untold[:, None]
    for index, onset in enumerate(screen.onsets[:begun]):
        if screen.cycle - onset < len(SHARES):
            begin = (2 + screen.cycle - onset) * jets
            of_onsets[:, index, begin : begin + jets] = impulse
    known = np.ascontiguousarray(screen.columns[:, :live])
    after = propagate_to_update(propagate_crossings(known, interval, places), forcing, interval, places)
    acting_shares = _update_acting(screen, interval)
    shown = interval.jacobian @ after
    for index, onset in enumerate(screen.onsets[:begun]):
        if onset == screen.cycle:
            shown[:, live - (begun - index) * h + _KINDS * jets : live - (begun - index - 1) * h] += np.eye(m)
    columns = screen.columns.copy()
    columns[:, :live] = propagate_update(after, shown, interval)
    score = screen.scores[-1].plus(Score(interval.log_likelihood, interval.nis, interval.degrees))
    information, projection = screen.information, screen.projection
    jump_information, jump_projection = screen.jump_information, screen.jump_projection
    chosen, misfit = np.flatnonzero(interval.used), screen.misfit
    if chosen.shape[0] > 0:
        half = np.linalg.cholesky(interval.covariance[np.ix_(chosen, chosen)])
        whitened = np.linalg.solve(half, np.column_stack((interval.innovation[chosen], shown[chosen])))
        innovation, whitened = whitened[:, 0], whitened[:, 1:]
        misfit += float(innovation @ innovation) - chosen.shape[0]
        of_jump = whitened[:, :N_PROPERTIES]
        of_onsets = whitened[:, N_PROPERTIES:].reshape(chosen.shape[0], begun, h).transpose(1, 0, 2)
        information, projection = information.copy(), projection.copy()
        information[:begun] += (
            _jet_information(of_onsets, jets) if screen.single else of_onsets.transpose(0, 2, 1) @ of_onsets
        )
        projection[:begun] += innovation @ of_onsets
        jump_information = jump_information + of_jump.T @ of_jump
        jump_projection = jump_projection + innovation @ of_jump
    fires = screen.cycle <= screen.onsets[-1] and bool((interval.amount > _FIRES * interval.duration_s).any())
    return screen._replace(
        cycle=screen.cycle + 1,
        fired=screen.fired or fires,
        misfit=misfit,
        columns=columns,
        acting=acting_shares,
        information=information,
        projection=projection,
        jump_information=jump_information,
        jump_projection=jump_projection,
        scores=(*screen.scores, score),
    )


def condition_screen(screen: Screen, rows: np.ndarray, offset: Array, covariance: Array) -> Screen:
    """Returns the first-order fault test conditioned on independent estimates of some parameters of its filter.

    Args:
        rows: of these parameters in its state, shape (k,).
        offset: independent estimates less its own, shape (k,).
        covariance: of the independent estimates, shape (k, k).
    """
    weights = np.linalg.inv(covariance)
    columns = screen.columns[rows]
    n, h = screen.projection.shape
    of_jump = columns[:, :N_PROPERTIES]
    of_onsets = columns[:, N_PROPERTIES:].reshape(rows.size, n, h).transpose(1, 0, 2)
    weighted_offset = weights @ offset
    return screen._replace(
        information=screen.information + of_onsets.transpose(0, 2, 1) @ weights @ of_onsets,
        projection=screen.projection + weighted_offset @ of_onsets,
        jump_information=screen.jump_information + of_jump.T @ weights @ of_jump,
        jump_projection=screen.jump_projection + weighted_offset @ of_jump,
    )


def _jet_information(whitened: Array, jets: int) -> Array:
    """Computes information of each jet's five fault effects, by whitened innovations, (n_onsets, n_jets, 5, 5)."""
    of_jets = whitened[:, :, : _KINDS * jets].reshape(*whitened.shape[:2], _KINDS, jets).transpose(0, 3, 2, 1)
    result: Array = of_jets @ of_jets.transpose(0, 1, 3, 2)
    return result


def _update_acting(screen: Screen, interval: Link) -> Array:
    """Returns the fractions of the intervals after each onset in which each fault can have acted, one cycle further.

    A loss shows only while its jet is told to fire, a jet that is stuck on only while it is not, a leak always; but
    where an onset stands for several intervals, what may have acted in those before it is not known.
    """
    idle = 1.0 - interval.amount / interval.duration_s
    acting_shares = screen.acting.copy()
    for index, (onset, gap) in enumerate(zip(screen.onsets, screen.gaps, strict=True)):
        place = screen.cycle - onset
        if 0 <= place < len(SHARES):
            shares = np.concatenate((np.ones_like(idle), 1.0 - idle, idle))
            acting_shares[index, place] = 1.0 if place == 0 and gap > 1 else shares
    return acting_shares


def maximize_likelihood(information: Array, projection: Array, variances: Array) -> tuple[Array, Array, Array]:
    """Computes log likelihood ratios, amplitudes, covariances of sets of fault effects with Gaussian priors.

    Args:
        information: A of each set, shape (..., k, k).
        projection: b, shape (..., k).
        variances: of the priors, shape (..., k).
    """
    precision = information + np.eye(variances.shape[-1]) / variances[..., None, :]
    covariance = np.asarray(np.linalg.inv(precision), dtype=np.float64)
    amplitude = (covariance @ projection[..., None])[..., 0]
    _, volume = np.linalg.slogdet(precision)
    lead = 0.5 * np.sum(amplitude * projection, axis=-1) - 0.5 * (volume + np.sum(np.log(variances), axis=-1))
    return lead, amplitude, covariance


def largest_jet_forces(params: JointParams) -> Array:
    """Returns the largest force that each jet can give, lbf or N, shape (n_jets,)."""
    largest: Array = np.maximum(_MOST_FORCE, 1.0 + BOUND * thrust_sigmas(params)) * params.thrusts
    return largest


def excess_force_cost(force: Array, covariance: Array, jets: np.ndarray, params: JointParams) -> Array:
    """Computes log likelihood lost by forces below zero, or above full thrust plus 3 sigma, nats, shape (number,).

    Jets can give full thrust and three of its stated 1-sigma. More is as rare as a second failure, and costs no more up
    to what jets give at most.

    Args:
        force, covariance: see `impossible_force_cost`.
        jets: whose they are, shape (number, jets).
    """
    stated = (1.0 + BOUND * thrust_sigmas(params)) * params.thrusts
    at_most = impossible_force_cost(force, covariance, largest_jet_forces(params)[jets])
    cost: Array = np.minimum(impossible_force_cost(force, covariance, stated[jets]), at_most + PAIR_PRIOR)
    return cost


def _log_force_prior(params: JointParams) -> Array:
    """Returns each jet's log prior that cancels the preference of a force prior N(0, T^2) for weak jets, nats."""
    result: Array = np.log(params.thrusts / params.thrusts.max())
    return result


def propose_faults(
    screen: Screen, candidates: np.ndarray, known_forces: Array, params: JointParams, threshold: float = 0.0
) -> list[Contender]:
    """Returns fault hypotheses, jumps excepted, at their likeliest onsets, sorted by log likelihood.

    Of a screen about single jets alone neither pairs nor false readings.

    Args:
        candidates: mask of jets that may have failed, gains and then losses, shape (2 n_jets,).
        known_forces: of each such failure that is known already, shape (2 n_jets,).
        threshold: log likelihood ratio of a single jet above which it is among them, nats.
    """
    found: dict[Cause, Contender] = {}
    for index in range(len(screen.onsets)):
        single = _single_columns(screen, index, candidates, params.places.jets)
        here = _make_contenders(screen, index, single, known_forces, params, threshold)
        if not screen.single:
            pairs = _pair_columns(screen, index, candidates, known_forces, params)
            here += _make_contenders(screen, index, pairs, known_forces, params)
            here += _false_reading_contenders(screen, index, params)
        for contender in here:
            best = found.get(contender.cause)
            leads = (*(best.at_onsets if best is not None else ()), (contender.onset, contender.lead))
            if best is None or contender.lead > best.lead + _later_onset_penalty(screen, best, params):
                best = contender
            found[contender.cause] = best._replace(at_onsets=leads)
    return sorted(found.values(), key=lambda contender: -contender.lead)


def jump_log_likelihoods(screen: Screen, params: JointParams) -> Array:
    """Returns log likelihood ratios of mass-property jumps at the test's start, by size, nats, (len(JUMP_SHARES),)."""
    lead, _, _ = maximize_likelihood(screen.jump_information, screen.jump_projection, jump_variances(params))
    return lead


def _later_onset_penalty(screen: Screen, contender: Contender, params: JointParams) -> float:
    """Returns the log likelihood by which a later onset must exceed this one, nats: 1 if lost jets idle here, else 0.

    A jet that is not told to fire has nothing to lose: such an onset stands for all since it last fired, and needs no
    impulse in the first interval in which it is told to. Were that taken for the onset, nobody could tell the force
    from the impulse of a jet that is told to fire in no other. Of onsets that stand for several intervals it is not
    known what a jet was told in each.
    """
    cause, index = contender.cause, screen.onsets.index(contender.onset)
    lost = [screen.acting[index, 0, params.places.jets + jet] for jet in cause.jets]
    return _HAD_NOTHING if max(cause.signs, default=1) < 0 and max(lost) < _FIRES else 0.0


def _cause_of_columns(columns: list[int], jets: int) -> Cause:
    """Converts indices of fault effects to a fault cause: failed jets, signs and leak flags."""
    signs = tuple(-1 if jets <= column < 2 * jets else 1 for column in columns)
    return Cause(Kind.JETS, tuple(column % jets for column in columns), signs, tuple(int(c < jets) for c in columns))


def _failure_indices(columns: np.ndarray, jets: int) -> np.ndarray:
    """Converts indices of fault effects to indices of failures: jets with excess thrust, then losses."""
    return np.where(columns < 2 * jets, columns, columns % jets)


def columns_matching_forces(columns: np.ndarray, force: Array, params: JointParams) -> np.ndarray:
    """Returns excess-thrust columns set to leak below half thrust, else stuck on, by force; loss columns unchanged."""
    jets = params.places.jets
    jet = columns % jets
    more = np.where(force < LEAK * params.thrusts[jet], jet, jet + 4 * jets)
    return np.where((columns >= jets) & (columns < 2 * jets), columns, more)


class _Fitted(NamedTuple):
    """Fitted sets of failures with the impulses at their onsets: log likelihoods, forces, covariances, kicks."""

    lead: Array
    force: Array
    covariance: Array
    kicks: Array  # by interval, row and failure

    @property
    def sigma(self) -> Array:
        """1-sigma of each estimated force, lbf or N, shape (number, n)."""
        result: Array = np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2))
        return result


def _fit_failures(screen: Screen, index: int, columns: np.ndarray, params: JointParams) -> _Fitted:
    """Fits forces of sets of failures, rows of `columns`, at the onset at `index`; then with bounded onset impulses."""
    jets, failures = params.places.jets, columns.shape[1]
    thrusts = params.thrusts[columns % jets]
    sets = np.hstack([columns, *((2 + place) * jets + columns % jets for place in range(len(SHARES)))])
    information = screen.information_of(index, sets)
    projection = screen.projection[index][sets]
    acting = screen.acting[index][:, np.where(columns < 2 * jets, columns, columns - 2 * jets)]
    places = np.maximum(acting, _LEAST_KICK) * np.reshape(SHARES, (-1, 1, 1))
    most = thrusts
    for _ in range(2):
        kicks = KICK * screen.gaps[index] * most * places
        variances = np.hstack([thrusts, *kicks]) ** 2
        lead, amplitude, covariance = maximize_likelihood(information, projection, variances)
        fitted = _Fitted(lead, amplitude[:, :failures], covariance[:, :failures, :failures], kicks)
        most = np.minimum(np.abs(fitted.force) + BOUND * fitted.sigma, thrusts)
    return fitted


def _make_contenders(
    screen: Screen, index: int, columns: np.ndarray, known_forces: Array, params: JointParams, threshold: float = 0.0
) -> list[Contender]:
    """Fits sets of failures at one onset, and returns the hypotheses whose forces are possible.

    Args:
        columns: columns of each set, one or two, shape (number, n).
        known_forces: see `propose_faults`.
        threshold: log likelihood ratio that one failure alone must exceed, nats.
    """
    jets, single = params.places.jets, columns.shape[1] == 1
    fitted, previous = _fit_failures(screen, index, columns, params), known_forces[_failure_indices(columns, jets)]
    total, sigma, jet = fitted.force + previous, fitted.sigma, columns % jets
    lead = fitted.lead + _log_force_prior(params)[jet].sum(axis=1) - (0.0 if single else PAIR_PRIOR)
    lead -= excess_force_cost(total, fitted.covariance, jet, params)
    possible = (total + BOUND * sigma > 0.0) & (total - BOUND * sigma < largest_jet_forces(params)[jet])
    possible &= (columns_matching_forces(columns, total, params) == columns) | (previous > 0.0)
    if single:
        possible &= ((fitted.force > 0.0) | (previous > 0.0)) & (lead > threshold).reshape(-1, 1)
    result = []
    for row in np.flatnonzero(possible.all(axis=1)):
        kicks = tuple(map(tuple, fitted.kicks[:, row].tolist()))
        forces = (tuple(total[row].tolist()), tuple(sigma[row].tolist()), kicks)
        cause = _cause_of_columns(columns[row].tolist(), jets)
        result.append(Contender(cause, screen.onsets[index], float(lead[row]), *forces))
    return result


def _single_columns(screen: Screen, index: int, candidates: np.ndarray, jets: int) -> np.ndarray:
    """Returns the columns of allowed single failures with information in the readings, shape (number, 1)."""
    steps = np.concatenate((np.arange(2 * jets), np.arange(4 * jets, 5 * jets))).reshape(-1, 1)
    return steps[candidates[_failure_indices(steps, jets)[:, 0]] & (screen.information_of(index, steps)[:, 0, 0] > 0.0)]


def _pair_columns(
    screen: Screen, index: int, candidates: np.ndarray, known_forces: Array, params: JointParams
) -> np.ndarray:
    """Returns the columns of likely pairs of failures, leak or stuck on by force found, shape (number, 2)."""
    jets = params.places.jets
    chosen = [
        _likely_pairs(
            screen, index, np.concatenate((more, np.arange(jets, 2 * jets))), (candidates, known_forces), params
        )
        for more in (np.arange(jets), np.arange(4 * jets, 5 * jets))
    ]
    columns = np.unique(np.concatenate(chosen), axis=0)
    if columns.shape[0] == 0:
        return columns
    previous = known_forces[_failure_indices(columns, jets)]
    at_first = _fit_failures(screen, index, columns, params).force + previous
    return np.unique(np.where(previous > 0.0, columns, columns_matching_forces(columns, at_first, params)), axis=0)


def _likely_pairs(
    screen: Screen, index: int, columns: np.ndarray, candidates_forces: tuple[np.ndarray, Array], params: JointParams
) -> np.ndarray:
    """Returns the likeliest pairs of failures at a known onset, and pairs that look alike, as columns, (number, 2).

    One of two that explains no less alone is no pair: with whatever else, it would take the places of all others.
    """
    jets, (allowed, known) = params.places.jets, candidates_forces
    information, projection = screen.information[index], screen.projection[index]
    usable = columns[allowed[_failure_indices(columns, jets)] & (np.diag(information)[columns] > 0.0)]
    first, second = np.triu_indices(usable.shape[0], 1)
    one, other = usable[first], usable[second]
    different = one % jets != other % jets
    one, other = one[different], other[different]
    of_one, of_other = params.thrusts[one % jets], params.thrusts[other % jets]
    a, b = information[one, one] + of_one**-2.0, information[other, other] + of_other**-2.0
    c = information[one, other]
    determinant = a * b - c * c
    x = (b * projection[one] - c * projection[other]) / determinant
    y = (a * projection[other] - c * projection[one]) / determinant
    gain = 0.5 * (x * projection[one] + y * projection[other])
    gain -= 0.5 * np.log(determinant * of_one**2 * of_other**2)
    scarce = _log_force_prior(params)
    gain += scarce[one % jets] + scarce[other % jets] - PAIR_PRIOR
    had, other_had = known[_failure_indices(one, jets)], known[_failure_indices(other, jets)]
    alone = _single_likelihoods(screen, index, columns, known, params)
    least = np.maximum(alone[one], alone[other])
    order = np.flatnonzero(~((had > 0.0) & (other_had > 0.0)) & (gain > least))  # of most that is enough
    a, b, c, had, other_had = a[order], b[order], c[order], had[order], other_had[order]
    covariance = np.stack((b, -c, -c, a), axis=1).reshape(-1, 2, 2) / determinant[order, None, None]
    most = _NEARLY * np.stack((of_one[order], of_other[order]), axis=1)
    gain[order] -= impossible_force_cost(np.stack((x[order] + had, y[order] + other_had), axis=1), covariance, most)
    order = order[gain[order] > least[order]]
    order = order[np.argsort(-gain[order])][:_PAIRS]
    alike = _similar_column_pairs(information, projection, usable)
    first, second = alike.T
    kept = (first % jets != second % jets) & ~((known[_failure_indices(alike, jets)] > 0.0).all(axis=1))
    return np.vstack((np.stack((one[order], other[order]), axis=1), alike[kept]))


def _single_likelihoods(screen: Screen, index: int, columns: np.ndarray, forces: Array, params: JointParams) -> Array:
    """Computes log likelihood ratios of single failures at a known onset, zero if negative, nats, shape (h,)."""
    jets = params.places.jets
    thrusts, had = params.thrusts[columns % jets], forces[_failure_indices(columns, jets)]
    projection = screen.projection[index][columns]
    precision = screen.information[index, columns, columns] + thrusts**-2.0
    force = projection / precision
    gain = 0.5 * (force * projection - np.log(precision * thrusts**2)) + _log_force_prior(params)[columns % jets]
    gain -= impossible_force_cost((force + had)[:, None], 1.0 / precision[:, None, None], _NEARLY * thrusts[:, None])
    result = np.zeros(screen.projection.shape[1])
    result[columns] = np.maximum(gain, 0.0)
    return result


def _similar_column_pairs(information: Array, projection: Array, columns: np.ndarray) -> np.ndarray:
    """Returns all pairs among the likeliest single failure and the three most like it, as columns, (number, 2)."""
    if columns.shape[0] == 0:
        return np.zeros((0, 2), dtype=np.intp)
    energy = np.diagonal(information)[columns]
    best = int(np.argmax(np.maximum(projection[columns], 0.0) ** 2 / energy))
    likeness = information[columns[best], columns] / np.sqrt(energy)
    group = np.sort(columns[np.argsort(-likeness)][:_ALIKE])
    first, second = np.triu_indices(group.shape[0], 1)
    return np.stack((group[first], group[second]), axis=1)


def _false_reading_contenders(screen: Screen, index: int, params: JointParams) -> list[Contender]:
    """Returns false-reading hypotheses at one onset, those likelier than no fault, one per component."""
    jets = params.places.jets
    m = screen.projection.shape[1] - 5 * jets
    result = []
    for component in range(m):
        column = 5 * jets + component
        energy, projection = screen.information[index, column, column], screen.projection[index, column]
        if energy > 0.0:
            width = params.cells[component] or 1.0
            lead = 0.5 * projection**2 / energy - 0.5 * np.log(energy / (2.0 * np.pi))
            lead -= false_reading_cost(component, params) + np.log(width)
            if lead > 0.0:
                cause = Cause(Kind.LIES, component=component)
                result.append(Contender(cause, screen.onsets[index], float(lead)))
    return result

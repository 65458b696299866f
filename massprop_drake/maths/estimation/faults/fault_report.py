"""Log rows of the hypothesis filter's cycles, field by field."""

from __future__ import annotations

import math
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from massprop_drake.maths.arrays import Field, Layout
from massprop_drake.maths.estimation.detector import STATUS, Verdict
from massprop_drake.maths.estimation.faults.declarations import (
    Declaration,
    DisturbanceDeclared,
    JetsDeclared,
    JumpDeclared,
    ReadingDeclared,
    Unexplained,
    Word,
)
from massprop_drake.maths.estimation.joint.hypotheses import Score
from massprop_drake.maths.linear_algebra import Array

# logged of every cycle besides what all detectors log; NaN where nothing is said. Of the detector by thrust factors are
# `racing` and `lead`; it has neither probabilities nor histories
HYPOTHESIS_REPORT = Layout(
    "hypothesis_report",
    racing=Field("hypotheses are compared"),
    lead=Field("lead of the likeliest hypothesis, nats"),
    hypotheses=Field("hypotheses that are followed", component="number"),
    none_probability=Field("probability that nothing has failed or changed", component="none"),
    unknown_probability=Field("probability that something unknown pushes", component="unknown"),
    history_since=Field("time since which the likeliest history is another than was reported", "s", "since"),
    history_rotation_nis=Field("NIS of the gyros since then by that history", component="rotation_nis"),
    history_rotation_components=Field("its expectation", component="rotation_components"),
    history_mass_nis=Field("NIS of the accelerometers since then by that history", component="mass_nis"),
    history_mass_components=Field("its expectation", component="mass_components"),
    jump_mass=Field("mass gained in a jump, where it is known", "{mass}", "mass"),
    jump_mass_std=Field("1-sigma of it", "{mass}", "std"),
    jump_measured=Field("0: a jump is found; 1: an earlier one has been measured", component="measured"),
    lying_component=Field("index of a component that reads falsely", component="component"),
    unexplained_since=Field("onset of what nothing explains", "s", "onset"),
    disturbed_since=Field("onset of a disturbance that nobody stated", "s", "onset"),
    disturbance_torque=Field("1-sigma of it about an axis, to an order of magnitude", "{length}-{force}", "torque"),
    disturbance_force=Field("1-sigma of it along an axis, to an order of magnitude", "{force}", "force"),
    jump_position=3,
    jump_position_std=3,
    fault_probability="jets",
    fault_mode="jets",
    fault_force="jets",
    fault_force_std="jets",
    verdict="jets",
    verdict_magnitude="jets",
    verdict_std="jets",
    verdict_onset="jets",
    verdict_group="jets",
    verdict_place="jets",
    verdict_apart_by="jets",
    verdict_apart_after="jets",
)

_EVENTS = {Word.FAILED: Verdict.DECLARED, Word.GROUP: Verdict.DECLARED, Word.WITHDRAWN: Verdict.WITHDRAWN}


class History(NamedTuple):
    """Samples since a fork, explained by the history that has just become the likeliest.

    Attributes:
        since_s: time of the fork, s.
    """

    since_s: float
    score: Score


class Odds(NamedTuple):
    """Posterior probabilities after a sample.

    Attributes:
        hypotheses: number of them.
        none: that nothing has failed or changed.
        unknown: that something unknown pushes.
        jets: that each jet has failed, shape (n_jets,).
        modes: likeliest mode of each, see `declarations.Mode`, shape (n_jets,).
        forces, sigmas: of each in its likeliest hypothesis, positive: it gives too much, lbf or N; NaN without one;
            shape (n_jets,).
    """

    hypotheses: int
    none: float
    unknown: float
    jets: Array
    modes: Array
    forces: Array
    sigmas: Array


@cache
def no_fault_odds(n_jets: int) -> Odds:
    """Returns posterior probabilities where no fault is considered: no fault 1, jets 0; shared, do not modify."""
    nothing, unknown = np.zeros(n_jets), np.full(n_jets, np.nan)
    return Odds(1, 1.0, 0.0, nothing, nothing, unknown, unknown)


def hypothesis_report_row(declarations: tuple[Declaration, ...], odds: Odds, history: History | None = None) -> Any:
    """Makes the log row `HYPOTHESIS_REPORT` of a sample from its declarations and fault probabilities."""
    row: dict[str, Any] = {"fault_probability": odds.jets, "fault_mode": odds.modes}
    row |= {"fault_force": odds.forces, "fault_force_std": odds.sigmas}
    row |= {"hypotheses": odds.hypotheses, "none_probability": odds.none, "unknown_probability": odds.unknown}
    if history is not None:
        score = history.score
        row |= {"history_since": history.since_s, "history_rotation_nis": score.gyro_nis}
        row |= {"history_rotation_components": score.gyro_degrees, "history_mass_nis": score.nis - score.gyro_nis}
        row |= {"history_mass_components": score.degrees - score.gyro_degrees}
    return declaration_row(declarations, odds.jets.size)._replace(**row)


def status_row(declarations: tuple[Declaration, ...], odds: Odds, tested: bool, statistic: float) -> Any:
    """Makes the log row `STATUS` of a sample: of its first declaration, else of a jet with fault probability over 0.5.

    Args:
        tested: whether the readings were tested against the likeliest hypothesis.
        statistic: largest GLR of a jet in that test.
    """
    row: dict[str, float] = {"suspected_likelihood": statistic}
    event = Verdict.NOTHING
    suspected = int(np.argmax(odds.jets))
    alarm = odds.jets[suspected] > 0.5
    if declarations:
        first = declarations[0]
        jumped = isinstance(first, JumpDeclared) and not first.measured
        event = Verdict.JUMP if jumped else Verdict.OTHER
        row |= {"onset": first.onset_s, "alarms": 1.0}
        if isinstance(first, JetsDeclared):
            event = _EVENTS.get(first.word, Verdict.OTHER)
            row["suspected_jet"] = float(first.jets[0])
            row["suspected_magnitude"] = first.signs[0] * first.forces[0]
            row["suspected_magnitude_std"] = first.sigmas[0]
            row["jet_isolated"] = float(len(first.jets) == 1)
    elif alarm:
        row["suspected_jet"] = float(suspected)
        row["suspected_magnitude"] = odds.forces[suspected]
        row["suspected_magnitude_std"] = odds.sigmas[suspected]
    return STATUS.make(tested=float(tested), alarm=float(alarm), detector_event=float(event), **row)


def declaration_row(declarations: tuple[Declaration, ...], n_jets: int) -> Any:
    """Makes a `HYPOTHESIS_REPORT` row with the fields of a sample's declarations filled in, the others empty."""
    verdict, group, place = (np.zeros(n_jets) for _ in range(3))
    magnitude, std, onset, by, after = (np.full(n_jets, np.nan) for _ in range(5))
    position, position_std = np.full(3, np.nan), np.full(3, np.nan)
    row: dict[str, float] = {}
    bit = 1.0  # of the next thing that is said of jets
    for one in declarations:
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
            case DisturbanceDeclared():
                row |= {"disturbed_since": one.onset_s}
                row |= {"disturbance_torque": one.torque, "disturbance_force": one.force}
    of_jets = {"verdict": verdict, "verdict_magnitude": magnitude, "verdict_std": std, "verdict_onset": onset}
    of_jets |= {"verdict_group": group, "verdict_place": place, "verdict_apart_by": by, "verdict_apart_after": after}
    of_jets |= {"jump_position": position, "jump_position_std": position_std}
    return HYPOTHESIS_REPORT.make(**row, **of_jets)


def jets_by_declaration(group_bits: Array, ranks: Array) -> list[list[int]]:
    """Decodes jets' group bits and ranks: for each declaration the list of its jets' indices, likeliest first."""
    bits = group_bits.astype(np.int64)
    order = np.argsort(ranks, kind="stable")
    return [order[bits[order] >> number & 1 > 0].tolist() for number in range(int(bits.max()).bit_length())]

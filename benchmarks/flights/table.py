"""Table of the card: outcome of each kind of flight, with 95 % intervals."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binomtest, chi2

Array = NDArray[np.float64]
Facts = Mapping[str, Any]

IN_A_GROUP = 3  # jets of a group that a user can still act on
LARGE_SIGMAS = 6.0  # an error beyond is as good as impossible in an honest estimate
_JUMP = "mass_property_jump"
OUTCOMES = ("right", "grouped", "silent", "wrong")

HEADER = (
    "flights",
    "n",
    *OUTCOMES,
    "time to name, s",
    "largest error, sigma",
    "NEES / n",
    "in 1, 2, 3 sigma, %",
    "force, sigma",
    "payload mass; place, sigma",
    "misjudged",
    "step, ms",
)
LEGEND = """
- **right**: every failure that acted was named, payloads were announced once, wrong readings were said to be wrong, and
  nothing else was declared. Of healthy flights: nothing was declared.
- **grouped**: each was named, or is in a declared group of three jets at most.
- **silent**: something that acted was not declared, or only as unexplained or in a group of more jets.
- **wrong**: a jet was named that had not failed, a group without one that had, a payload or a false reading that there
  was not, or a payload twice.
- Shares are in percent, with their 95 % interval (Clopper and Pearson).
- **time to name**: median; 90 %; longest, from when a failure first acted.
- **largest error**: of all parameters and flights, in their own 1-sigma at the end; in brackets flights beyond 6 sigma,
  and how many of these were called consistent.
- **NEES / n**: normalized estimation error squared over the number of parameters, mean over flights: 1 where the
  covariance is honest. In brackets the 95 % band of that mean by chance.
- **in 1, 2, 3 sigma**: share of errors; 68.3, 95.4 and 99.7 of Gaussian ones.
- **force**: errors of the forces of rightly named jets in their own 1-sigma: RMS, largest. Drifting jets are left out.
- **payload**: errors of measured mass and of place in their 1-sigma: RMS, largest of each.
- **misjudged**: share of runs called inconsistent where what the files state holds, and of those not called
  inconsistent, or for another first reason, where it does not.
- **step**: processor time of a step of the estimator over every twentieth flight: mean; longest.
"""

BRIEF = ("flights", "right", "wrong", "named after, s", "largest error, sigma", "misjudged")
BRIEF_LEGEND = """
Numbers of flights. **Right**, of all: every failure that acted was named, payloads were announced once, wrong readings
were said to be wrong, and nothing else was declared. **Wrong**: a jet was named that had not failed, a group without
one that had, a payload or a false reading that there was not. In the rest something that acted was not declared, or in
a group. **Named after**: median, from when a failure first acted. **Largest error** of all parameters and flights, in
their own 1-sigma at the end. **Misjudged**: called inconsistent where what the files state holds, or not called so, or
for another first reason, where it does not. By its 95 % interval, a share is at least {least}.
"""


class Judged(NamedTuple):
    """Outcome of one flight.

    Attributes:
        outcome: one of `OUTCOMES`.
        delays_s: from when each failure or payload acted to its first name or group, s.
        forces: errors of forces of rightly named jets in their 1-sigma.
        payloads: errors of mass, and the largest of place, in their 1-sigma; a pair for each payload measured.
    """

    outcome: str
    delays_s: list[float]
    forces: list[float]
    payloads: list[tuple[float, float]]


def judge(facts: Facts, spec: Mapping[str, Any]) -> Judged:
    """Judges what was declared in a flight against what happened in it.

    Args:
        facts: of the flight, see `fly.py`.
        spec: of its kind, see `card.yaml`.
    """
    failed, begun = _first(facts["failed"], "first_acted_s"), _first(facts["failed"], "start_s")
    payloads = [one for one in facts["failed"] if one["jet"] is None]
    told: dict[str, float] = {}
    alone: set[str] = set()
    wrong, announced = False, 0
    for entry in facts["declared"]:
        if entry["kind"] == _JUMP:
            announced += 1
            wrong |= announced > sum(one["first_acted_s"] <= entry["time_s"] for one in payloads)
            continue
        right = [jet for jet in entry["jets"] if begun.get(jet, math.inf) <= entry["time_s"]]
        wrong |= not right
        if entry["isolated_to"] == "jet":
            alone.update(right)
        if len(entry["jets"]) <= IN_A_GROUP:
            told |= {jet: min(told.get(jet, math.inf), entry["time_s"]) for jet in right}
    readings = sum(one["kind"] == "false_reading" for one in facts["other"])
    nothing = not failed and not payloads and not spec.get("sensor")
    wrong |= bool(readings) and not spec.get("sensor")
    stated = "verdict" not in spec and "reason" not in spec
    wrong |= nothing and stated and bool(facts["other"])
    met = announced == len(payloads) and (bool(readings) or not spec.get("sensor"))
    if wrong:
        outcome = "wrong"
    elif not met or failed.keys() - told.keys():
        outcome = "silent"
    else:
        outcome = "grouped" if failed.keys() - alone else "right"
    delays = [max(told[jet] - since, 0.0) for jet, since in failed.items() if jet in told]
    jumps = (entry["time_s"] for entry in facts["declared"] if entry["kind"] == _JUMP)
    delays += [time_s - one["first_acted_s"] for one, time_s in zip(payloads, jumps, strict=False)]
    return Judged(outcome, delays, _forces(facts, failed), _payloads(facts))


def _first(failures: Iterable[Mapping[str, Any]], time: str) -> dict[str, float]:
    """Returns the first of some times of each failed jet, s, by designation."""
    found: dict[str, float] = {}
    for one in failures:
        if one["jet"] is not None and one[time] is not None:
            found[one["jet"]] = min(found.get(one["jet"], math.inf), one[time])
    return found


def _forces(facts: Facts, failed: Mapping[str, float]) -> list[float]:
    """Computes errors of the forces of named jets in their 1-sigma, where the force is constant and known."""
    true = {one["jet"]: one["force"] for one in facts["failed"] if one["kind"] != "drift"}
    newest = {
        entry["jets"][0]: entry
        for entry in facts["declared"]
        if entry["isolated_to"] == "jet" and entry["withdrawn_s"] is None and entry["magnitude_std"]
    }
    return [
        (entry["magnitude"] - true[jet]) / entry["magnitude_std"]
        for jet, entry in newest.items()
        if jet in failed and true.get(jet) is not None
    ]


def _payloads(facts: Facts) -> list[tuple[float, float]]:
    """Computes errors of mass and place of payloads in their 1-sigma, where they were measured."""
    entries = [one for one in facts["declared"] if one["kind"] == _JUMP and one["mass"] is not None]
    found = []
    for entry, true in zip(entries, facts["payloads"], strict=False):
        place = math.nan
        if entry["position"] is not None:
            off = (np.array(entry["position"]) - true["position"]) / np.array(entry["position_std"])
            place = float(np.abs(off).max())
        found.append(((entry["mass"] - true["mass"]) / entry["mass_std"], place))
    return found


class Row(NamedTuple):
    """Statistics of a kind of flight.

    Attributes:
        n: number of flights that could be flown.
        crashed: number of those that could not.
        counts: of each outcome, in the order of `OUTCOMES`.
        delays_s: of all failures, s.
        sigmas: errors in their 1-sigma, NaN where unknown, shape (n, 10).
        nees: sum over flights, and the number of parameters in it.
        far: flights beyond `LARGE_SIGMAS`, and those of them called consistent.
        forces: errors of forces in their 1-sigma.
        payloads: errors of mass and place in their 1-sigma, shape (m, 2).
        misjudged: number of flights with the wrong verdict.
        errors: of the parameters, NaN where unknown, shape (n, 10).
        deviations: 1-sigma of the parameters, shape (n, 10).
        step_ms: mean and longest processor time of a step, ms, NaN where not measured.
        eventful: whether anything happened in any flight, so that it could be silent.
    """

    n: int
    crashed: int
    counts: tuple[int, ...]
    delays_s: Array
    sigmas: Array
    nees: tuple[float, int]
    far: tuple[int, int]
    forces: Array
    payloads: Array
    misjudged: int
    errors: Array
    deviations: Array
    step_ms: tuple[float, float]
    eventful: bool


def counted(flights: Sequence[Mapping[str, Any]], spec: Mapping[str, Any]) -> Row:
    """Computes statistics of the flights of one kind.

    Args:
        flights: rows of results, with `facts` and `timed` as JSON, None where the flight failed to run.
        spec: of the kind.
    """
    flown = [json.loads(one["facts"]) for one in flights if one["facts"]]
    timed = [json.loads(one["timed"]) for one in flights if one["timed"]]
    judged = [judge(facts, spec) for facts in flown]
    sigmas = _stacked(flown, "sigmas")
    largest = np.nanmax(np.abs(sigmas), axis=1, initial=0.0)
    consistent = np.array([facts["verdict"] == "consistent" for facts in flown], dtype=bool)
    far = largest > LARGE_SIGMAS
    known = [facts for facts in flown if facts["nees"] is not None]
    nees = sum(facts["nees"] for facts in known), sum(sum(x is not None for x in facts["sigmas"]) for facts in known)
    return Row(
        len(flown),
        len(flights) - len(flown),
        tuple(sum(one.outcome == outcome for one in judged) for outcome in OUTCOMES),
        np.array([delay for one in judged for delay in one.delays_s]),
        sigmas,
        nees,
        (int(far.sum()), int((far & consistent).sum())),
        np.array([force for one in judged for force in one.forces]),
        np.array([payload for one in judged for payload in one.payloads]).reshape(-1, 2),
        sum(_misjudged(facts, spec) for facts in flown),
        _stacked(flown, "errors"),
        _stacked(flown, "deviations"),
        (_over(np.mean, timed, "mean_ms"), _over(np.max, timed, "longest_ms")),
        bool(spec.get("sensor")) or any(facts["failed"] for facts in flown),
    )


def _misjudged(facts: Facts, spec: Mapping[str, Any]) -> bool:
    """Tests whether the verdict on a run, or the first reason of it, is wrong."""
    if spec.get("verdict") == "either":
        return False
    if "reason" in spec:
        return facts["verdict"] != "inconsistent" or facts["reasons"][:1] != [spec["reason"]]
    inconsistent: bool = facts["verdict"] == "inconsistent"
    return inconsistent != (spec.get("verdict") == "inconsistent")


def _stacked(flown: Sequence[Facts], name: str) -> Array:
    """Stacks values of all flights, NaN where unknown, shape (n, 10)."""
    return np.array([[np.nan if x is None else x for x in facts[name]] for facts in flown]).reshape(-1, 10)


def _over(function: Callable[[list[float]], Any], timed: Iterable[Mapping[str, Any]], name: str) -> float:
    """Computes a statistic of measured values; NaN without any."""
    found = [one[name] for one in timed if one[name] is not None]
    return float(function(found)) if found else math.nan


def share(count: int, n: int) -> str:
    """Formats a share in percent with its 95 % interval."""
    if not n:
        return "-"
    low, high = binomtest(count, n).proportion_ci(0.95, "exact")
    return f"{_short(100.0 * count / n)} ({_short(100.0 * low)} to {_short(100.0 * high)})"


def _short(value: float) -> str:
    return f"{value:.0f}" if value >= 10.0 and value == round(value) else f"{value:.3g}"


def cells(spec: Mapping[str, Any], row: Row) -> list[str]:
    """Formats the cells of a row, in the order of `HEADER`.

    Args:
        spec: of the kind, for its title.
        row: its statistics.
    """
    title = spec["title"]
    if not row.n:
        return [title, "0", *["-"] * (len(HEADER) - 2)]
    outcomes = [share(count, row.n) for count in row.counts]
    if not row.eventful:
        outcomes[1] = outcomes[2] = "-"
    largest = float(np.nanmax(np.abs(row.sigmas), initial=0.0))
    beyond = f" [{row.far[0]}; {row.far[1]}]" if row.far[0] else ""
    crashed = f" and {row.crashed} that failed to run" if row.crashed else ""
    total, degrees = row.nees
    band = chi2.ppf((0.025, 0.975), degrees) / degrees if degrees else (math.nan, math.nan)
    known = np.abs(row.sigmas[np.isfinite(row.sigmas)])
    within = ", ".join(f"{100.0 * (known <= limit).mean():.1f}" for limit in (1.0, 2.0, 3.0)) if known.size else "-"
    payloads = "; ".join(_rms_and_largest(column[np.isfinite(column)]) for column in row.payloads.T)
    mean_ms, longest_ms = row.step_ms
    return [
        title,
        f"{row.n}{crashed}",
        *outcomes,
        "; ".join(f"{x:.2f}" for x in _spread(row.delays_s)) or "-",
        f"{largest:.1f}{beyond}",
        f"{total / degrees:.2f} [{band[0]:.2f} to {band[1]:.2f}]" if degrees else "-",
        within,
        _rms_and_largest(row.forces),
        payloads if row.payloads.size else "-",
        "-" if spec.get("verdict") == "either" else share(row.misjudged, row.n),
        "; ".join("-" if math.isnan(x) else f"{x:.2f}" for x in (mean_ms, longest_ms)),
    ]


def brief_cells(spec: Mapping[str, Any], row: Row) -> list[str]:
    """Formats the cells of a row, in the order of `BRIEF`."""
    if not row.n:
        return [spec["title"], "0/0", *["-"] * (len(BRIEF) - 2)]
    right, wrong = (row.counts[OUTCOMES.index(outcome)] for outcome in ("right", "wrong"))
    return [
        spec["title"],
        f"{right}/{row.n}",
        str(wrong),
        f"{np.median(row.delays_s):.2f}" if row.delays_s.size else "-",
        f"{np.nanmax(np.abs(row.sigmas), initial=0.0):.1f}",
        "-" if spec.get("verdict") == "either" else str(row.misjudged),
    ]


def brief_legend(rows: Iterable[Row]) -> str:
    """Explains the columns of `BRIEF`, and what the usual numbers of flights can show."""
    usual = Counter(row.n for row in rows if row.n).most_common(3)
    lows = {n: float(binomtest(n, n).proportion_ci(0.95, "exact").low) for n, _ in usual}
    least = ", ".join(f"{_short(100.0 * low)} % where {n}/{n} are right" for n, low in sorted(lows.items()))
    return BRIEF_LEGEND.strip().replace("\n", " ").format(least=least)


def headline(sentence: str, rows: Sequence[Row]) -> str:
    """Fills the statistics of some kinds together into a sentence.

    Args:
        sentence: with any of `{n}`, `{right}`, `{wrong}` (shares with intervals), `{wrongs}` (their number),
            `{median}`, `{most}` (90 %) and `{longest}` (time to name, s), `{largest}` (error, sigma) and `{within}`
            (share of errors in 3 sigma, %).
        rows: of the kinds.
    """
    n = sum(row.n for row in rows)
    right, wrong = (sum(row.counts[OUTCOMES.index(outcome)] for row in rows) for outcome in ("right", "wrong"))
    median, most, longest = _spread(np.concatenate([row.delays_s for row in rows])) or (math.nan,) * 3
    sigmas = np.abs(np.concatenate([row.sigmas[np.isfinite(row.sigmas)] for row in rows]))
    return sentence.format(
        n=n,
        right=share(right, n),
        wrong=share(wrong, n),
        wrongs=wrong or "none",
        median=f"{median:.2g}",
        most=f"{most:.2g}",
        longest=f"{longest:.2g}",
        largest=f"{sigmas.max(initial=0.0):.1f}",
        within=f"{100.0 * (sigmas <= 3.0).mean():.1f}" if sigmas.size else "-",
    )


def _spread(values: Array) -> tuple[float, ...]:
    """Computes median, 90 % and largest; none where there are no values."""
    return (float(np.median(values)), float(np.quantile(values, 0.9)), float(values.max())) if values.size else ()


def _rms_and_largest(values: Array) -> str:
    return f"{np.sqrt(np.mean(values**2)):.2g}, {np.abs(values).max():.2g}" if values.size else "-"


def versus(spec: Mapping[str, Any], now: Row, before: Row) -> list[str]:
    """Formats a row of the comparison of two versions over the same flights, in the order of `VERSUS`."""
    title = spec["title"]
    if not (now.n and before.n):
        return [title, *["-"] * (len(VERSUS) - 1)]
    ratios = [_rms(now.errors), _rms(before.errors)]
    known = np.isfinite(ratios).all(axis=0) & (ratios[1] > 0.0)
    ratio = ratios[0][known] / ratios[1][known]
    geometric = float(np.exp(np.mean(np.log(ratio)))) if ratio.size and (ratio > 0.0).all() else math.nan
    mass = float(ratios[0][9] / ratios[1][9]) if known[9] else math.nan
    return [
        title,
        *(f"{share(a, before.n)} -> {share(b, now.n)}" for a, b in zip(before.counts, now.counts, strict=True)),
        " -> ".join("; ".join(f"{x:.2f}" for x in _spread(row.delays_s)) or "-" for row in (before, now)),
        " -> ".join(f"{np.nanmax(np.abs(row.sigmas), initial=0.0):.1f}" for row in (before, now)),
        " -> ".join(f"{row.nees[0] / row.nees[1]:.2f}" if row.nees[1] else "-" for row in (before, now)),
        f"{geometric:.3g}; {mass:.3g}",
        " -> ".join(_rms_and_largest(row.forces) for row in (before, now)),
        " -> ".join(share(row.misjudged, row.n) for row in (before, now)),
        " -> ".join("-" if math.isnan(row.step_ms[0]) else f"{row.step_ms[0]:.2f}" for row in (before, now)),
    ]


VERSUS = (
    "flights",
    *OUTCOMES,
    "time to name, s",
    "largest error, sigma",
    "NEES / n",
    "RMS error over the other's: mean of ten; 1/m",
    "force, sigma",
    "misjudged",
    "step, ms",
)


def _rms(errors: Array) -> Array:
    """Computes the RMS of each parameter's error, NaN where unknown, shape (10,)."""
    return np.sqrt(np.mean(errors**2, axis=0))


def markdown(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Formats a table."""
    lines = ["| " + " | ".join(row) + " |" for row in (header, ["---"] * len(header), *rows)]
    return "\n".join(lines)

"""Posterior probabilities of faults at the end of a run, of a detector that follows hypotheses."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from massprop_drake.inputs.model import NotNegative, Real
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.maths.estimation.faults.declarations import Mode as Code
from massprop_drake.maths.signals import format_with_deviation
from massprop_drake.results.detections import Mode
from massprop_drake.results.spool import Spool

Array = NDArray[np.float64]
Probability = Annotated[Real, Field(ge=0.0, le=1.0)]

LEAST_TOLD = 1e-4  # probability of a jet's failure that is listed
LEAST_SHOWN = 0.01  # probability that is put into words or drawn
_MOST_SHOWN = 5  # jets that are put into words
_ROUNDED = 0.9999  # probability above which digits say nothing more
_OF_NO_JET = ("none", "unknown")
_MODES: dict[int, Mode] = {
    Code.STUCK_ON: "stuck_on",
    Code.LEAK: "leak",
    Code.STUCK_OFF: "stuck_off",
    Code.LOSS: "loss",
    Code.DRIFTING: "drift",
    Code.INTERMITTENT: "intermittent",
}


class JetProbability(NamedTuple):
    """Posterior probability that a jet has failed.

    Attributes:
        probability: of its failure, in whatever mode.
        mode: likeliest fault mode; None where there is none.
        force, force_std: too much (positive) or missing (negative) in the likeliest hypothesis with that failure, and
            its 1-sigma, lbf or N; None where no hypothesis has one.
    """

    probability: Probability
    mode: Mode | None = None
    force: Real | None = None
    force_std: NotNegative | None = None


class FaultProbabilities(NamedTuple):
    """Posterior probabilities of faults.

    Attributes:
        jets: by designation, likeliest first, of those above `LEAST_TOLD`.
        none: probability that nothing has failed or changed.
        unknown: probability that something unknown pushes.
    """

    jets: Mapping[str, JetProbability]
    none: Probability
    unknown: Probability

    def as_json(self) -> dict[str, Any]:
        """Returns the entry `fault_probability` of `summary.json`: by jet, and "none" and "unknown"."""
        return {**{jet: one._asdict() for jet, one in self.jets.items()}, "none": self.none, "unknown": self.unknown}

    def in_words(self, units: Mapping[str, str]) -> str:
        """Describes jets whose probability of failure is above 1 %, at most five; "" where there is none."""
        shown = [(jet, entry) for jet, entry in self.jets.items() if entry.probability > LEAST_SHOWN]
        parts = [
            f"{jet} {format_probability(entry.probability)}{_failure_in_words(entry, units)}"
            for jet, entry in shown[:_MOST_SHOWN]
        ]
        if len(shown) > _MOST_SHOWN:
            parts.append(f"{len(shown) - _MOST_SHOWN} more jets less")
        words = f"failed with probability: {', '.join(parts)}" if parts else ""
        if self.unknown > LEAST_SHOWN:
            words += (
                f"{'; ' if words else ''}something unknown pushes with probability {format_probability(self.unknown)}"
            )
        return words


def gives_probabilities(signals: Spool) -> bool:
    """Tests whether a run's signals have posterior fault probabilities."""
    return "none_probability" in signals and math.isfinite(signals.last("none_probability")[0])


def final_probabilities(vehicle: Vehicle, signals: Spool) -> FaultProbabilities | None:
    """Returns fault probabilities at the end, with modes and forces; None where the detector gives none."""
    if not gives_probabilities(signals):
        return None
    names = ("fault_probability", "fault_mode", "fault_force", "fault_force_std")
    probability, *_ = columns = [signals.last(name) for name in names]
    order = np.argsort(-probability, kind="stable")
    listed = order[probability[order] > LEAST_TOLD].tolist()
    jets = {vehicle.designations[jet]: _jet_probability(*(float(column[jet]) for column in columns)) for jet in listed}
    none, unknown = (_limit_probability(signals.last(name)[0]) for name in ("none_probability", "unknown_probability"))
    return FaultProbabilities(jets, none, unknown)


def read_fault_probability(content: Any) -> Any:
    """Converts the stored `fault_probability` to fields of FaultProbabilities; drops unknown keys."""
    if not isinstance(content, dict):
        return content
    jets = {
        name: {key: entry[key] for key in JetProbability._fields if key in entry} if isinstance(entry, dict) else entry
        for name, entry in content.items()
        if name not in _OF_NO_JET
    }
    return {"jets": jets, **{name: content[name] for name in _OF_NO_JET if name in content}}


def format_probability(probability: float) -> str:
    """Formats a probability to two digits, from 0.99 on to four decimals; "above 0.9999" beyond."""
    if probability > _ROUNDED:
        return f"above {_ROUNDED}"
    return f"{probability:.4f}" if probability >= 1.0 - LEAST_SHOWN else f"{probability:.2g}"


def _failure_in_words(entry: JetProbability, units: Mapping[str, str]) -> str:
    """Formats fault mode and force of a jet as " (stuck on, 3.9 ± 0.1 N)"; "" where neither is known."""
    parts = [] if entry.mode is None else [entry.mode.replace("_", " ")]
    if entry.force is not None and entry.force_std is not None:
        parts.append(f"{format_with_deviation(entry.force, entry.force_std)} {units['force']}")
    return f" ({', '.join(parts)})" if parts else ""


def _jet_probability(probability: float, mode: float, force: float, force_std: float) -> JetProbability:
    """Makes a jet's entry from logged numbers; mode and force become None where NaN or unknown."""
    known = math.isfinite(force) and math.isfinite(force_std)
    size = (force, force_std) if known else (None, None)
    return JetProbability(_limit_probability(probability), _MODES.get(int(mode)), *size)


def _limit_probability(probability: float) -> float:
    """Clips a probability to 0 to 1, beyond which rounding may carry it."""
    return min(max(float(probability), 0.0), 1.0)

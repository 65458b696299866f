"""Summary of a run: estimates, failures, consistency, and provenance; as `summary.json` on disk."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from importlib import metadata
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, ConfigDict, Field, field_validator

from massprop_drake.inputs import params, true_params
from massprop_drake.inputs.model import Count, Flag, Model, NotNegative, Real, Text, Whole, digest, validated
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.inputs.true_blocks import MultibodyBlock
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.maths import mass_properties, possible_inertia
from massprop_drake.maths.mass_properties import CENTER_OF_MASS, MASS_RECIPROCAL, N_ROTATION, Derived, six_elements
from massprop_drake.records.completeness import Completeness, Loss, completeness
from massprop_drake.results.against import Against
from massprop_drake.results.allowed import Intervals
from massprop_drake.results.consistency import (
    COMPONENTS,
    TOO_LITTLE,
    Consistency,
    Diagnosis,
    Tally,
    fork_signals,
    forks,
    innovations,
    judged,
    of_likeliest_history,
    used_nis,
)
from massprop_drake.results.detections import JUMP, DetectionRecord
from massprop_drake.results.events import EventRecord
from massprop_drake.results.fault_probabilities import FaultProbabilities, by_jet, gives_probabilities
from massprop_drake.results.identified import Identifiability, bound_in_words, identified
from massprop_drake.results.injected import InjectedRecord, what_became
from massprop_drake.results.parts import Ended, PartsMade
from massprop_drake.results.shown_in_hindsight import looked_back
from massprop_drake.results.spool import Spool, blocks
from massprop_drake.results.unconfirmed import UnconfirmedRecord, UntestedRecord
from massprop_drake.signals import SYMBOLS

Array = NDArray[np.float64]

FORMAT = 1  # of `summary.json`

# ------------------------------------------------------------------------------------ what it holds


class Parameter(NamedTuple):
    """One of the ten mass properties at the end of a run, in the vehicle's units.

    Attributes:
        name: as in `maths.mass_properties.NAMES`.
        estimate: NaN where it cannot be observed.
        standard_deviation: 1-sigma that the filter claims; NaN likewise.
        truth: NaN where it is unknown.
        percent_error: 100 (estimate - truth) / |truth|; NaN where the truth is unknown or as good as zero.
    """

    name: str
    estimate: float
    standard_deviation: float
    truth: float
    percent_error: float

    @property
    def percent_deviation(self) -> float:
        """The 1-sigma in percent of the estimate; NaN where that, or a known truth, is as good as zero."""
        if not self.estimate or (not math.isnan(self.truth) and math.isnan(self.percent_error)):
            return math.nan
        return 100.0 * self.standard_deviation / abs(self.estimate)

    @property
    def within_three_sigma(self) -> bool:
        """True if the estimate lies within 3 sigma of the truth; False where either is NaN."""
        return abs(self.estimate - self.truth) <= 3.0 * self.standard_deviation


class Findings(NamedTuple):
    """Findings of a detector in a run.

    Attributes:
        detections: failures and jumps in the order they were declared.
        events: all that it said, in the order it was said.
        unconfirmed: what it suspected and never declared.
        untested: jets of which nothing could have shown that they do not fire.
        fault_probability: of each jet at the end; None of a detector that gives none.
    """

    detections: tuple[DetectionRecord, ...] = ()
    events: tuple[EventRecord, ...] = ()
    unconfirmed: tuple[UnconfirmedRecord, ...] = ()
    untested: tuple[UntestedRecord, ...] = ()
    fault_probability: FaultProbabilities | None = None


class AutopilotSummary(NamedTuple):
    """Activity of the jets, and the autopilot's remaining control.

    Attributes:
        firings: number of off-to-on transitions over all jets.
        propellant_mass: used, slug or kg.
        lp_solves: requests that the jet selection solved; like all below None without an autopilot.
        lp_infeasible: those of them beyond the jets' reach.
        jets_out_of_use: designations of the jets taken out of use at the end.
        jets_left_in: designations of those left in, though in question, since control needs them.
        control_authority: largest change of rate and velocity in one second of firing, "before" and "after"
            failures, each by axis and direction.
    """

    firings: Count
    propellant_mass: Real
    lp_solves: Count | None = None
    lp_infeasible: Count | None = None
    jets_out_of_use: Sequence[Text] | None = None
    jets_left_in: Sequence[Text] | None = None
    control_authority: Mapping[str, Mapping[str, Real]] | None = None


class Provenance(NamedTuple):
    """Versions and input that made a run.

    Attributes:
        drake, numpy: versions.
        vehicle_sha256, scenario_sha256: digests of both in full.
        telemetry: name of the record that was read; None for a simulated run.
        telemetry_sha256: digest of its content.
        engine: what ran it, see `inputs.scenario.ExecutionBlock`; None for a record read without compiled kernels.
    """

    drake: Text
    numpy: Text
    vehicle_sha256: Text
    scenario_sha256: Text
    telemetry: Text | None = None
    telemetry_sha256: Text | None = None
    engine: Text | None = None


class RunTiming(NamedTuple):
    """Duration of a run.

    Attributes:
        wall_s: from the first sample to the last, s.
        real_time_factor: time covered by the run per time taken.
        cycle_us: mean time per cycle by part, microseconds; None for a part that the run has not, or that is not apart.
    """

    wall_s: Real
    real_time_factor: Real
    cycle_us: Mapping[str, Real | None]


@dataclass(frozen=True, eq=False)
class Summary:
    """Summary of a run.

    Attributes:
        version: of this package, that wrote it.
        scenario, vehicle: names.
        units: of the vehicle, "us" or "si".
        seed: of the scenario.
        duration_s: from the first sample to the last, s.
        estimates: the ten parameters at the end in the order of `maths.mass_properties`, NaN where one cannot
            be observed, shape (10,).
        standard_deviations: 1-sigma of each, shape (10,).
        covariance: of their errors, shape (10, 10).
        derived: mass and inertia that follow from them.
        truth: at the end, NaN where unknown, shape (10,).
        percent_error: of each estimate, NaN where unknown, shape (10,).
        detections: failures and jumps in the order they were declared.
        consistency: of the filters.
        autopilot: what the jets did.
        provenance: versions and digests.
        timing: how long it took.
        data_quality: what `telemetry.quality` found about a record; None for a simulated run.
        injected: failures and jumps of a simulated run, and what was made of them, in the scenario's order; None for a
            record, of which nobody knows.
        identifiability: what the run has told of each parameter; empty in what an earlier version wrote.
        events, unconfirmed, untested, fault_probability: see `Findings`; likewise.
        against: a record beside a simulation of its commands; None: there is none.
        intervals: of the ten parameters, which quantized readings guarantee; None: they were not asked for.
        ended: where and why the run ended before its scenario or record does; None: it did not.
        missing: parts that could not be made, each with the reason.
        completeness: of a record; a simulated run is complete.
        completeness_detail: what could not be read of it, and how much, a sentence each.
    """

    version: str
    scenario: str
    vehicle: str
    units: str
    seed: int
    duration_s: float
    estimates: Array
    standard_deviations: Array
    covariance: Array
    derived: Derived
    truth: Array
    percent_error: Array
    detections: tuple[DetectionRecord, ...]
    consistency: Consistency
    autopilot: AutopilotSummary
    provenance: Provenance
    timing: RunTiming
    data_quality: Mapping[str, Any] | None = None
    injected: tuple[InjectedRecord, ...] | None = None
    identifiability: tuple[Identifiability, ...] = ()
    events: tuple[EventRecord, ...] = ()
    unconfirmed: tuple[UnconfirmedRecord, ...] = ()
    untested: tuple[UntestedRecord, ...] = ()
    fault_probability: FaultProbabilities | None = None
    against: Against | None = None
    intervals: Intervals | None = None
    ended: Ended | None = None
    missing: tuple[str, ...] = ()
    completeness: Completeness = "complete"
    completeness_detail: tuple[str, ...] = ()

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The ten mass properties by name, one by one."""
        columns = (self.estimates, self.standard_deviations, self.truth, self.percent_error)
        return tuple(map(Parameter, mass_properties.NAMES, *(column.tolist() for column in columns)))

    @cached_property
    def nearest_possible(self) -> Array | None:
        """Nearest estimates that a rigid body can have, shape (10,); None where the estimates are possible.

        None where the estimates are possible, or there is none; see `maths.possible_inertia.nearest_possible`.
        """
        known = np.isfinite(self.estimates[:N_ROTATION]).all() and np.isfinite(self.covariance[:6, :6]).all()
        if self.derived.physically_possible or not known:
            return None
        return possible_inertia.nearest_possible(self.estimates, self.covariance)

    @property
    def has_failed(self) -> bool:
        """True if a failure of jets was declared that still stands."""
        return any(one.kind != JUMP and one.withdrawn_s is None for one in self.detections)

    @property
    def above_bound(self) -> str:
        """Comparison of the 1-sigma with the least for rounding taken as noise; empty where that is not known."""
        deviations = self.standard_deviations.tolist()
        return bound_in_words(deviations, self.identifiability, SYMBOLS, failed=self.has_failed)

    @property
    def impossible(self) -> str:
        """Statement that no rigid body can have the estimates; empty where one can."""
        if self.derived.physically_possible or self.derived.inertia is None:
            return ""
        near = "; the nearest that one can have is in summary.json" if self.nearest_possible is not None else ""
        return f"no rigid body can have the inertia that was estimated{near}"

    def as_json(self) -> dict[str, Any]:
        """Returns the content of `summary.json`; NaN becomes null."""
        derived, nearest = self.derived, self.nearest_possible
        content: dict[str, Any] = {
            "format": FORMAT,
            "version": self.version,
            "scenario": self.scenario,
            "vehicle": self.vehicle,
            "units": self.units,
            "seed": self.seed,
            "duration_s": self.duration_s,
            "completeness": self.completeness,
            "completeness_detail": list(self.completeness_detail),
            "estimates": by_name(self.estimates),
            "standard_deviations": by_name(self.standard_deviations),
            "covariance": null_for_nan(self.covariance),
            "derived": {
                **derived._asdict(),
                "mass_std": None if derived.mass_std is None or math.isnan(derived.mass_std) else derived.mass_std,
                "inertia": None if derived.inertia is None else null_for_nan(derived.inertia),
                "inertia_std": None if derived.inertia_std is None else null_for_nan(derived.inertia_std),
                "nearest_possible": None if nearest is None else by_name(nearest),
            },
            "truth": by_name(self.truth),
            "percent_error": by_name(self.percent_error),
            "detections": [_without(record, "jet_index", "before") for record in self.detections],
            "events": [_without(record, "jet_index") for record in self.events],
            "unconfirmed": [_without(record) for record in self.unconfirmed],
            "untested": [_without(record) for record in self.untested],
            "fault_probability": None if self.fault_probability is None else self.fault_probability.as_json(),
            "consistency": {
                **self.consistency._asdict(),
                "diagnoses": [one._asdict() for one in self.consistency.diagnoses],
            },
            "identifiability": [entry._asdict() for entry in self.identifiability],
            "injected": None if self.injected is None else [record._asdict() for record in self.injected],
            "autopilot": self.autopilot._asdict(),
            "provenance": {key: value for key, value in self.provenance._asdict().items() if value is not None},
            "timing": self.timing._asdict(),
        }
        if self.data_quality is not None:
            content["data_quality"] = self.data_quality
        if self.against is not None:
            content["against"] = self.against.as_json()
        if self.intervals is not None:
            content["intervals"] = self.intervals.as_json()
        if self.ended is not None:
            content["ended"] = self.ended._asdict()
        if self.missing:
            content["missing"] = list(self.missing)
        return content

    @staticmethod
    def from_json(content: Any, source: str = "the summary") -> Summary:
        """Makes a summary from the content of `summary.json`, of this version or an earlier one.

        What an earlier version did not write yet has its default; keys that are not known are left out.

        Args:
            content: as JSON has it.
            source: what to call it in messages.

        Raises:
            InputError: when it is no summary; the message names each field that is wrong.
        """
        read = validated(SummaryFile, content, source=source)
        derived = read.derived
        return Summary(
            read.version,
            read.scenario,
            read.vehicle,
            read.units,
            read.seed,
            read.duration_s,
            estimates=from_names(read.estimates.model_dump()),
            standard_deviations=from_names(read.standard_deviations.model_dump()),
            covariance=np.array(read.covariance, dtype=float),
            derived=Derived(
                derived.mass,
                derived.mass_std,
                _array(derived.inertia),
                _array(derived.inertia_std),
                derived.physically_possible,
            ),
            truth=from_names(read.truth.model_dump()),
            percent_error=from_names(read.percent_error.model_dump()),
            detections=read.detections,
            consistency=read.consistency,
            autopilot=read.autopilot,
            provenance=read.provenance,
            timing=read.timing,
            data_quality=read.data_quality,
            injected=read.injected,
            identifiability=read.identifiability,
            events=read.events,
            unconfirmed=read.unconfirmed,
            untested=read.untested,
            fault_probability=read.fault_probability,
            against=read.against,
            intervals=read.intervals,
            ended=read.ended,
            missing=read.missing,
            completeness=read.completeness,
            completeness_detail=read.completeness_detail,
        )


# --------------------------------------------------------------------------------- how it is stored

_Maybe = Real | None
_Maybe3 = tuple[_Maybe, _Maybe, _Maybe]
_Maybe10 = tuple[_Maybe, _Maybe, _Maybe, _Maybe, _Maybe, _Maybe, _Maybe, _Maybe, _Maybe, _Maybe]


def _known_to(kind: Any) -> BeforeValidator:
    """Passes over keys that a later version of a named tuple wrote."""

    def known(content: Any) -> Any:
        return {key: content[key] for key in kind._fields if key in content} if isinstance(content, dict) else content

    return BeforeValidator(known)


class _Stored(Model):
    """Part of `summary.json`; further entries of a later version are passed over."""

    model_config = ConfigDict(extra="ignore")


class _ByName(_Stored):
    """Ten parameters as `by_name` writes them."""

    inverse_inertia: tuple[_Maybe3, _Maybe3, _Maybe3]
    center_of_mass: _Maybe3
    mass_reciprocal: _Maybe


class _Derived(_Stored):
    """Mass and inertia, see `mass_properties.Derived`."""

    mass: _Maybe
    mass_std: _Maybe
    inertia: tuple[_Maybe3, _Maybe3, _Maybe3] | None
    inertia_std: tuple[_Maybe3, _Maybe3, _Maybe3] | None
    physically_possible: Flag


class SummaryFile(_Stored):
    """Schema of `summary.json`; see `Summary`."""

    format: Annotated[Whole, Field(ge=1, le=FORMAT)]
    version: Text
    scenario: Text
    vehicle: Text
    units: Literal["us", "si"]
    seed: Count
    duration_s: NotNegative
    estimates: _ByName
    standard_deviations: _ByName
    covariance: tuple[
        _Maybe10, _Maybe10, _Maybe10, _Maybe10, _Maybe10, _Maybe10, _Maybe10, _Maybe10, _Maybe10, _Maybe10
    ]
    derived: _Derived
    truth: _ByName
    percent_error: _ByName
    detections: tuple[Annotated[DetectionRecord, _known_to(DetectionRecord)], ...]
    consistency: Annotated[Consistency, _known_to(Consistency)]
    autopilot: Annotated[AutopilotSummary, _known_to(AutopilotSummary)]
    provenance: Annotated[Provenance, _known_to(Provenance)]
    timing: Annotated[RunTiming, _known_to(RunTiming)]
    data_quality: dict[str, Any] | None = None
    injected: tuple[Annotated[InjectedRecord, _known_to(InjectedRecord)], ...] | None = None
    identifiability: tuple[Annotated[Identifiability, _known_to(Identifiability)], ...] = ()
    events: tuple[Annotated[EventRecord, _known_to(EventRecord)], ...] = ()
    unconfirmed: tuple[Annotated[UnconfirmedRecord, _known_to(UnconfirmedRecord)], ...] = ()
    untested: tuple[Annotated[UntestedRecord, _known_to(UntestedRecord)], ...] = ()
    fault_probability: Annotated[FaultProbabilities, BeforeValidator(by_jet)] | None = None
    against: Annotated[Against, _known_to(Against)] | None = None
    intervals: Annotated[Intervals, _known_to(Intervals)] | None = None
    ended: Annotated[Ended, _known_to(Ended)] | None = None
    missing: tuple[Text, ...] = ()
    completeness: Completeness = "complete"
    completeness_detail: tuple[Text, ...] = ()

    @field_validator("data_quality")
    @classmethod
    def _has_warnings(cls, value: dict[str, Any] | None) -> dict[str, Any] | None:
        warnings = [] if value is None else value.get("warnings", [])
        if not (isinstance(warnings, list) and all(isinstance(text, str) for text in warnings)):
            raise ValueError("warnings: must be a list of text")
        return value


# -------------------------------------------------------------------------------- how it is computed


def summarize(
    scenario: Scenario,
    signals: Spool,
    found: Findings,
    covariance: Array,
    timing: RunTiming,
    parts: PartsMade,
) -> Summary:
    """Sums up a simulated run, but for what `looked_back_on` and the autopilot's authority add.

    Args:
        scenario: as run.
        signals: all of them, by name, with `time_s`.
        found: what the detector made of it.
        covariance: of the ten estimates at the end, shape (10, 10).
        timing: how long it took.
        parts: makes what may fail.
    """
    estimate, deviation = signals.last("estimate"), signals.last("standard_deviation")
    truth = _true_at_end(scenario, signals)
    return composed(
        scenario,
        duration_s=float(signals.last("time_s")),
        estimate=estimate,
        deviation=deviation,
        covariance=covariance,
        truth=truth,
        found=found,
        consistency=parts.make(
            "consistency",
            lambda: _judged(signals, estimate, deviation, truth, found.detections),
            Consistency(None, None, 0, TOO_LITTLE),
        ),
        bound=None,
        autopilot=parts.make("autopilot", lambda: _flown(scenario, signals), AutopilotSummary(0, 0.0)),
        timing=timing,
        injected=parts.make("injected", lambda: what_became(scenario, signals, found.detections), None)
        if "thrust" in signals
        else None,
    )


def _true_at_end(scenario: Scenario, signals: Spool) -> Array:
    """Returns the true ten parameters at the end, NaN where unknown, shape (10,).

    Where the estimators are told of parts that swing, and follow them, those at the start, when a model's parts rest.
    """
    if "truth" not in signals:
        return np.full(10, np.nan)
    if scenario.vehicle_data.moving and isinstance(scenario.plant, MultibodyBlock) and not scenario.plant.moves:
        first: Array = next(iter(signals.blocks("truth")))["truth"][0]
        return first
    return signals.last("truth")


def _flown(scenario: Scenario, signals: Spool) -> AutopilotSummary:
    """Counts firings and propellant."""
    return AutopilotSummary(
        firings=_firings(signals),
        propellant_mass=_propellant(scenario, signals),
        **_selection(signals),
        **_jets_in_question(scenario.vehicle_data, signals),
    )


def not_summed_up(scenario: Scenario, signals: Spool, timing: RunTiming) -> Summary:
    """Makes the summary of a run of which only its last estimates are known.

    Args:
        scenario: as run.
        signals: all of them, by name, with `time_s`.
        timing: how long it took.
    """
    vehicle, unknown = scenario.vehicle_data, np.full(10, np.nan)
    return Summary(
        version("massprop-drake"),
        scenario.name,
        vehicle.name,
        vehicle.units,
        scenario.seed,
        float(signals.last("time_s")),
        estimates=signals.last("estimate"),
        standard_deviations=signals.last("standard_deviation"),
        covariance=np.full((10, 10), np.nan),
        derived=Derived(None, None, None, None, False),
        truth=_true_at_end(scenario, signals),
        percent_error=unknown,
        detections=(),
        consistency=Consistency(None, None, 0, TOO_LITTLE),
        autopilot=AutopilotSummary(0, 0.0),
        provenance=Provenance(version("drake"), version("numpy"), digest(vehicle), digest(scenario)),
        timing=timing,
    )


def looked_back_on(results: Summary, scenario: Scenario, signals: Spool) -> Summary:
    """Adds the batch analysis of a simulated run to its summary: diagnoses, and what it has identified.

    Args:
        results: see `summarize`.
        scenario, signals: of the run.
    """
    estimate, covariance = results.estimates, results.covariance
    back = looked_back(scenario, signals, estimate, results.detections, results.events)
    verdict = results.consistency
    if back.diagnoses:
        verdict = _judged(
            signals, estimate, results.standard_deviations, results.truth, results.detections, back.diagnoses
        )
    return replace(results, consistency=verdict, identifiability=identified(scenario, estimate, covariance, back.bound))


def _judged(
    signals: Spool,
    estimate: Array,
    deviation: Array,
    truth: Array,
    found: Sequence[DetectionRecord],
    diagnoses: Sequence[Diagnosis] = (),
) -> Consistency:
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = (estimate - truth) / deviation
    rotation, mass = (_tallied(signals, name, found) for name in ("rotation", "mass"))
    return judged(rotation, mass, ratios, SYMBOLS, diagnoses)


def composed(
    scenario: Scenario,
    *,
    duration_s: float,
    estimate: Array,
    deviation: Array,
    covariance: Array,
    truth: Array,
    found: Findings,
    consistency: Consistency,
    bound: Array | None,
    autopilot: AutopilotSummary,
    timing: RunTiming,
    telemetry: str | None = None,
    telemetry_sha256: str | None = None,
    data_quality: Mapping[str, Any] | None = None,
    injected: tuple[InjectedRecord, ...] | None = None,
    losses: Sequence[Loss] = (),
) -> Summary:
    """Makes a summary from its parts, and adds what follows from them.

    Args:
        scenario: as run.
        duration_s: from the first sample to the last, s.
        estimate, deviation: of the ten parameters at the end, shape (10,).
        covariance: at the end, shape (10, 10).
        truth: at the end, NaN where unknown, shape (10,).
        found: what the detector made of it.
        bound: least 1-sigma that the run allows for rounding taken as noise, NaN where not known, shape (10,); None:
            what is identified will be said later.
        consistency, autopilot, timing: taken as they are.
        telemetry, telemetry_sha256, data_quality: of a record, its name, its digest and what it is worth.
        injected: of a simulated run, what became of its failures and jumps.
        losses: what could not be read of a record.
    """
    vehicle = scenario.vehicle_data
    known = params.known_parameters(scenario)
    certain = covariance.copy()  # what is not estimated is taken for known
    certain[known], certain[:, known] = 0.0, 0.0
    return Summary(
        version=version("massprop-drake"),
        scenario=scenario.name,
        vehicle=vehicle.name,
        units=vehicle.units,
        seed=scenario.seed,
        duration_s=duration_s,
        estimates=estimate,
        standard_deviations=deviation,
        covariance=covariance,
        derived=mass_properties.derived(estimate, certain),
        truth=truth,
        percent_error=mass_properties.percent_error(estimate, truth),
        detections=found.detections,
        consistency=consistency,
        autopilot=autopilot,
        provenance=Provenance(
            version("drake"),
            version("numpy"),
            digest(vehicle),
            digest(scenario),
            telemetry,
            telemetry_sha256,
            _executed(scenario, simulated=telemetry is None),
        ),
        timing=timing,
        data_quality=data_quality,
        injected=injected,
        identifiability=() if bound is None else identified(scenario, estimate, covariance, bound),
        events=found.events,
        unconfirmed=found.unconfirmed,
        untested=found.untested,
        fault_probability=found.fault_probability,
        completeness=completeness(losses),
        completeness_detail=tuple(one.text for one in losses),
    )


@cache
def version(package: str) -> str:
    """Returns the version of a package as installed; cached, as the search takes as long as a hundred cycles."""
    return metadata.version(package)


def _executed(scenario: Scenario, *, simulated: bool) -> str | None:
    """Describes what ran the scenario; None for a record that was read without compiled kernels."""
    words: list[str] = [scenario.execution.engine] if simulated else []
    if scenario.execution.compiled:
        words.append(f"compiled by numba {version('numba')}")
    return ", ".join(words) or None


def firings(on: NDArray[np.bool_], before: NDArray[np.bool_]) -> int:
    """Counts off-to-on transitions over all jets.

    Args:
        on: whether each jet is told to fire, shape (n_samples, n_jets).
        before: the same in the sample before the first, shape (n_jets,).
    """
    return int((on & ~np.vstack([before, on[:-1]])).sum())


def _intervals(signals: Spool, name: str) -> Iterator[Array]:
    """Yields the rows of a signal at the beginning of an interval: all but the last, block by block."""
    left = signals.n_rows - 1
    for block in blocks(signals, name):
        yield block[name][:left]
        left -= len(block[name])


def _firings(signals: Spool) -> int:
    count, before = 0, np.zeros(signals.last("command").size, dtype=bool)
    for commands in _intervals(signals, "command"):
        on = commands > 0.0
        count += firings(on, before)
        before = on[-1] if len(on) else before
    return count


def _propellant(scenario: Scenario, signals: Spool) -> float:
    """Computes propellant used, slug or kg: by the thrust of every sample or, where it is not known, its command."""
    vehicle = scenario.vehicle_data
    full, flows = np.linalg.norm(vehicle.thrusts, axis=1), true_params.plant_mass_flows(scenario)
    name, full = ("thrust", full) if "thrust" in signals else ("command", np.ones_like(full))
    flow = np.concatenate([np.nansum(level / full * flows, axis=1) for level in _intervals(signals, name)])
    return float(flow.sum() * vehicle.sample_period_s)


def _tallied(signals: Spool, name: str, found: Sequence[DetectionRecord]) -> Tally:
    """Tallies the NIS of a filter at the samples it used; all at once, so that sums do not depend on storage."""
    tally = Tally()
    if f"{name}_nis" in signals:
        parts = [used_nis(name, block) for block in blocks(signals, *_nis_signals(name, signals))]
        tally.add(*(np.concatenate(column) for column in zip(*parts, strict=True)))
    return explained(tally, signals, name, found)


def _nis_signals(name: str, signals: Spool) -> list[str]:
    """Returns the names of the signals that `used_nis` needs, of those that exist."""
    return [one for one in (f"{name}_nis", f"{name}_used", COMPONENTS[name]) if one in signals]


def explained(tally: Tally, signals: Spool, name: str, found: Sequence[DetectionRecord]) -> Tally:
    """Returns a tally of a filter's samples as the verdict is to judge them, given later declarations.

    Where hypotheses are followed it is that of the likeliest history, see `of_likeliest_history`. Of other detectors
    those samples are no fault that lie between an onset and its declaration, of a payload or of a jet named alone.

    Args:
        tally: of all samples.
        signals: of the run.
        name: see `used_nis`.
        found: what was declared; what was withdrawn explains nothing.
    """
    if f"{name}_nis" not in signals:
        return tally
    if gives_probabilities(signals):
        return _of_likeliest_history(tally, signals, name)
    named = [one for one in found if one.kind == JUMP or one.isolated_to == "jet"]
    spans = [(one.onset_s, one.time_s) for one in named if one.withdrawn_s is None]
    if spans:
        names, parts = _nis_signals(name, signals), []
        for block in blocks(signals, "time_s", *names):
            within = np.zeros(block["time_s"].shape[0], dtype=np.bool_)
            for onset_s, declared_s in spans:
                within |= (block["time_s"] > onset_s) & (block["time_s"] <= declared_s)
            parts.append(used_nis(name, {one: block[one][within] for one in names}))
        tally.explain(*(np.concatenate(column) for column in zip(*parts, strict=True)))
    return tally


def _of_likeliest_history(tally: Tally, signals: Spool, name: str) -> Tally:
    """Returns the tally of the likeliest history; the tally itself where that has never become another."""
    names = ("time_s", *_nis_signals(name, signals), *fork_signals(name))
    columns = {one: np.concatenate([block[one] for block in blocks(signals, one)]) for one in names}
    found = forks(name, columns)
    if not found.rows.size:
        return tally
    judged_by = Tally()
    judged_by.take(of_likeliest_history(innovations(name, columns), columns["time_s"], found))
    return judged_by


def _jets_in_question(vehicle: Vehicle, signals: Spool) -> dict[str, Any]:
    """Returns designations of the jets taken out of use, and of those left in because control needs them."""
    if "out_of_use" not in signals:
        return {}
    state = signals.last("out_of_use")
    return {
        name: [jet for jet, value in zip(vehicle.designations, state, strict=True) if value == wanted]
        for name, wanted in (("jets_out_of_use", 1.0), ("jets_left_in", -1.0))
    }


def _selection(signals: Spool) -> dict[str, Any]:
    """Counts requests that the jet selection solved, and those that it could not meet."""
    if "selection_counts" not in signals:
        return {}
    solved, reduced, closest, _ = signals.last("selection_counts").tolist()
    return {"lp_solves": int(solved), "lp_infeasible": int(reduced + closest)}


# ---------------------------------------------------------------------------------- arrays as JSON


def null_for_nan(values: Array) -> Any:
    """Turns an array into nested lists, NaN into None."""
    if values.ndim > 1:
        return [null_for_nan(row) for row in values]
    return [None if math.isnan(value) else value for value in values.tolist()]


def kept_onsets(onset_s: Array) -> dict[str, Any]:
    """Writes the onsets of a command, shape (n_jets,), into a saved state; nothing where all are levels."""
    return {"command_onset": null_for_nan(onset_s)} if np.isfinite(onset_s).any() else {}


def by_name(parameters: Array) -> dict[str, Any]:
    """Writes the ten parameters as files have them: matrix, vector and number; NaN becomes None."""
    values = null_for_nan(parameters)
    matrix = [[values[index] for index in row] for row in mass_properties.ELEMENT.tolist()]
    return {
        "inverse_inertia": matrix,
        "center_of_mass": values[CENTER_OF_MASS],
        "mass_reciprocal": values[MASS_RECIPROCAL],
    }


def from_names(values: Mapping[str, Any]) -> Array:
    """Reads what `by_name` writes: the ten parameters, None as NaN, shape (10,)."""
    inverse = np.array(values["inverse_inertia"], dtype=float)
    center = np.array(values["center_of_mass"], dtype=float)
    reciprocal = np.array([values["mass_reciprocal"]], dtype=float)
    return np.concatenate([six_elements(inverse), center, reciprocal])


def _array(values: Any) -> Array | None:
    return None if values is None else np.array(values, dtype=float)


def _without(record: Any, *names: str) -> dict[str, Any]:
    """Returns a record as JSON has it, without some of its fields."""
    kept = {key: value for key, value in record._asdict().items() if key not in names}
    return {key: list(value) if isinstance(value, tuple) else value for key, value in kept.items()}

"""Summary of a run: estimates, failures, consistency, and provenance; as `summary.json` on disk."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, ConfigDict, Field, field_validator

from massprop_drake.inputs.model import Count, Flag, Model, NotNegative, Real, Text, Whole, validate_data
from massprop_drake.maths import mass_properties, possible_inertia
from massprop_drake.maths.mass_properties import N_ROTATION, Derived
from massprop_drake.maths.signals import SYMBOLS
from massprop_drake.records.completeness import Completeness
from massprop_drake.results.against import Against
from massprop_drake.results.allowed import Intervals
from massprop_drake.results.consistency import Consistency
from massprop_drake.results.detections import JUMP, DetectionRecord
from massprop_drake.results.events import EventRecord
from massprop_drake.results.fault_probabilities import FaultProbabilities, read_fault_probability
from massprop_drake.results.identifiability_flags import Identifiability, bound_in_words
from massprop_drake.results.injected import InjectedRecord
from massprop_drake.results.json_arrays import null_for_nan, parameters_by_name, parameters_from_names
from massprop_drake.results.parts import EarlyEnd
from massprop_drake.results.unconfirmed import UnconfirmedRecord, UntestedRecord

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
        """1-sigma in percent of the estimate; NaN where estimate or a known truth is about zero."""
        if not self.estimate or (not math.isnan(self.truth) and math.isnan(self.percent_error)):
            return math.nan
        return 100.0 * self.standard_deviation / abs(self.estimate)

    @property
    def within_three_sigma(self) -> bool:
        """True if the estimate lies within 3 sigma of the truth; False where either is NaN."""
        return abs(self.estimate - self.truth) <= 3.0 * self.standard_deviation


class NearZeroParameter(Parameter):
    """Mass property whose estimate is as good as zero, so that no percentage refers to it."""

    @property
    def percent_deviation(self) -> float:
        """NaN: no percentage refers to an estimate of about zero."""
        return math.nan


class Findings(NamedTuple):
    """Findings of a detector in a run.

    Attributes:
        detections: failures and jumps in the order they were declared.
        events: all events, in the order they were declared.
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
    ended: EarlyEnd | None = None
    missing: tuple[str, ...] = ()
    completeness: Completeness = "complete"
    completeness_detail: tuple[str, ...] = ()

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Estimates of the ten mass properties with 1-sigma, truth and error, one entry each."""
        near_zero = np.abs(self.estimates) <= mass_properties.zero_floors(self.estimates)
        columns = (self.estimates, self.standard_deviations, self.truth, self.percent_error)
        rows = zip(mass_properties.NAMES, *(column.tolist() for column in columns), strict=True)
        return tuple(
            (NearZeroParameter if near else Parameter)(*row) for near, row in zip(near_zero, rows, strict=True)
        )

    @cached_property
    def nearest_possible(self) -> Array | None:
        """Nearest ten parameters that a rigid body can have, (10,); None if estimates are possible or none is found."""
        known = np.isfinite(self.estimates[:N_ROTATION]).all() and np.isfinite(self.covariance[:6, :6]).all()
        if self.derived.physically_possible or not known:
            return None
        return possible_inertia.nearest_possible(self.estimates, self.covariance)

    @property
    def has_failed(self) -> bool:
        """True if a jet failure was declared and not withdrawn."""
        return any(one.kind != JUMP and one.withdrawn_s is None for one in self.detections)

    @property
    def above_bound(self) -> str:
        """Range of 1-sigma over the Cramér-Rao bound in words; "" where that is not known."""
        deviations = self.standard_deviations.tolist()
        return bound_in_words(deviations, self.identifiability, SYMBOLS, has_failed=self.has_failed)

    @property
    def impossible(self) -> str:
        """Remark that no rigid body can have the estimated inertia; "" where one can, or inertia is unknown."""
        if self.derived.physically_possible or self.derived.inertia is None:
            return ""
        near = "; the nearest that one can have is in summary.json" if self.nearest_possible is not None else ""
        return f"no rigid body can have the inertia that was estimated{near}"

    def as_json(self) -> dict[str, Any]:
        """Returns the content of `summary.json` as dicts and lists; NaN becomes None."""
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
            "estimates": parameters_by_name(self.estimates),
            "standard_deviations": parameters_by_name(self.standard_deviations),
            "covariance": null_for_nan(self.covariance),
            "derived": {
                **derived._asdict(),
                "mass_std": None if derived.mass_std is None or math.isnan(derived.mass_std) else derived.mass_std,
                "inertia": None if derived.inertia is None else null_for_nan(derived.inertia),
                "inertia_std": None if derived.inertia_std is None else null_for_nan(derived.inertia_std),
                "nearest_possible": None if nearest is None else parameters_by_name(nearest),
            },
            "truth": parameters_by_name(self.truth),
            "percent_error": parameters_by_name(self.percent_error),
            "detections": [_without_fields(record, "jet_index", "before") for record in self.detections],
            "events": [_without_fields(record, "jet_index") for record in self.events],
            "unconfirmed": [_without_fields(record) for record in self.unconfirmed],
            "untested": [_without_fields(record) for record in self.untested],
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
            content["intervals"] = self.intervals._asdict()
        if self.ended is not None:
            content["ended"] = self.ended._asdict()
        if self.missing:
            content["missing"] = list(self.missing)
        return content

    @staticmethod
    def from_json(content: Any, source: str = "the summary") -> Summary:
        """Makes a summary from content of `summary.json`, of this or an earlier version.

        Entries that an earlier version did not write have their default; unknown keys are left out.

        Args:
            content: as JSON has it.
            source: its name in messages.

        Raises:
            InputError: when it is no summary; the message names each field that is wrong.
        """
        read = validate_data(SummaryFile, content, source=source)
        made: dict[str, Any] = {field.name: getattr(read, field.name) for field in fields(Summary)}
        for name in ("estimates", "standard_deviations", "truth", "percent_error"):
            made[name] = parameters_from_names(made[name].model_dump())
        found = read.derived
        inertia, inertia_std = (None if one is None else np.array(one) for one in (found.inertia, found.inertia_std))
        made["derived"] = Derived(found.mass, found.mass_std, inertia, inertia_std, found.physically_possible)
        made["covariance"] = np.array(read.covariance, dtype=float)
        return Summary(**made)


# --------------------------------------------------------------------------------- how it is stored

_Maybe = Real | None
_Maybe3 = tuple[_Maybe, _Maybe, _Maybe]
_Maybe10 = tuple[_Maybe, _Maybe, _Maybe, _Maybe, _Maybe, _Maybe, _Maybe, _Maybe, _Maybe, _Maybe]


def _drop_unknown_keys(record_type: Any) -> BeforeValidator:
    """Makes a validator that drops stored keys for which a named tuple has no field."""

    def keep_fields(content: Any) -> Any:
        """Returns a dict without keys that are no fields of the named tuple; other content unchanged."""
        return (
            {key: content[key] for key in record_type._fields if key in content}
            if isinstance(content, dict)
            else content
        )

    return BeforeValidator(keep_fields)


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
    detections: tuple[Annotated[DetectionRecord, _drop_unknown_keys(DetectionRecord)], ...]
    consistency: Annotated[Consistency, _drop_unknown_keys(Consistency)]
    autopilot: Annotated[AutopilotSummary, _drop_unknown_keys(AutopilotSummary)]
    provenance: Annotated[Provenance, _drop_unknown_keys(Provenance)]
    timing: Annotated[RunTiming, _drop_unknown_keys(RunTiming)]
    data_quality: dict[str, Any] | None = None
    injected: tuple[Annotated[InjectedRecord, _drop_unknown_keys(InjectedRecord)], ...] | None = None
    identifiability: tuple[Annotated[Identifiability, _drop_unknown_keys(Identifiability)], ...] = ()
    events: tuple[Annotated[EventRecord, _drop_unknown_keys(EventRecord)], ...] = ()
    unconfirmed: tuple[Annotated[UnconfirmedRecord, _drop_unknown_keys(UnconfirmedRecord)], ...] = ()
    untested: tuple[Annotated[UntestedRecord, _drop_unknown_keys(UntestedRecord)], ...] = ()
    fault_probability: Annotated[FaultProbabilities, BeforeValidator(read_fault_probability)] | None = None
    against: Annotated[Against, _drop_unknown_keys(Against)] | None = None
    intervals: Annotated[Intervals, _drop_unknown_keys(Intervals)] | None = None
    ended: Annotated[EarlyEnd, _drop_unknown_keys(EarlyEnd)] | None = None
    missing: tuple[Text, ...] = ()
    completeness: Completeness = "complete"
    completeness_detail: tuple[Text, ...] = ()

    @field_validator("data_quality")
    @classmethod
    def _require_text_lists(cls, value: dict[str, Any] | None) -> dict[str, Any] | None:
        """Checks that the information and the warnings on data quality are lists of text."""
        for key in ("information", "warnings"):
            told = [] if value is None else value.get(key, [])
            if not (isinstance(told, list) and all(isinstance(text, str) for text in told)):
                raise ValueError(f"{key}: must be a list of text")
        return value


def _without_fields(record: Any, *names: str) -> dict[str, Any]:
    """Converts a record to a dict for JSON, tuples to lists, without the named fields."""
    kept = {key: value for key, value in record._asdict().items() if key not in names}
    return {key: list(value) if isinstance(value, tuple) else value for key, value in kept.items()}

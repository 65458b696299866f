"""Filters and detectors in a scenario, and the priors of faults."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from massprop_drake.inputs import plausible
from massprop_drake.inputs.model import (
    Flag,
    Model,
    NotNegative,
    Positive,
    Probability,
    Real,
    RelativeSigma,
    Share,
    Text,
    Whole,
    described,
    field_validation_error,
)
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.inputs.vehicle_parts import MassPropertiesModel
from massprop_drake.inputs.yaml import FieldPath
from massprop_drake.maths.estimation.faults.priors import Priors
from massprop_drake.maths.linear_algebra import Array, is_covariance
from massprop_drake.maths.mass_properties import initial_standard_deviation

USUAL_FILTER: Literal["thesis", "joint", "pose"] = "joint"
_PRIORS = Priors()
_Sigma = NotNegative
_Ten = tuple[Real, Real, Real, Real, Real, Real, Real, Real, Real, Real]
_TEN_UNITS = "1/(slug-ft^2) | 1/(kg-m^2) (6), ft | m (3), 1/slug | 1/kg"


class ConvergenceLimits(Model):
    """1-sigma below which estimates may be acted on."""

    diagonal: Positive = described(0.02, "inverse inertia's diagonal, relative")
    mass_reciprocal: Positive = described(0.2, "mass reciprocal, relative")
    center_of_mass: Positive | None = described(None, "center of mass; null: 3 % of the jets' RMS arm", "ft | m")


class GivenStart(Model):
    """Mass properties known beforehand, with their uncertainty."""

    mass_properties: MassPropertiesModel | None = described(None, "estimates at the start; null: the nominal ones")
    standard_deviation: tuple[_Sigma, _Sigma, _Sigma, _Sigma, _Sigma, _Sigma, _Sigma, _Sigma, _Sigma, _Sigma] | None = (
        described(None, "1-sigma of the ten parameters", _TEN_UNITS)
    )
    covariance: tuple[_Ten, _Ten, _Ten, _Ten, _Ten, _Ten, _Ten, _Ten, _Ten, _Ten] | None = described(
        None, "covariance instead; none between 1/m and the others", "products of those"
    )

    @model_validator(mode="after")
    def _require_one_uncertainty(self) -> GivenStart:
        """Raises ValueError unless standard deviation or a valid covariance, block-diagonal in 1/m, is given."""
        if (self.standard_deviation is None) == (self.covariance is None):
            raise ValueError("give either standard_deviation or covariance")
        if self.covariance is not None:
            covariance = np.array(self.covariance)
            if not is_covariance(covariance):
                raise ValueError("covariance: must be symmetric and positive semidefinite")
            if covariance[9, :9].any():
                raise ValueError("covariance: must be zero between 1/m and the others, whose filters are apart")
        return self


class EstimationBlock(Model):
    """The estimators' starting point, and how they turn commands into thrust."""

    filter: Literal["thesis", "joint", "pose"] = described(
        USUAL_FILTER,
        "joint: one filter for mass properties, rate, velocity and thrust; thesis: two filters, blocks "
        "`rotation` and `mass`; pose: one in a fixed frame, for vehicles with pose or velocity sensors, "
        "without gyros, or in a plane. Unless named, it is as the vehicle needs; thesis where keys or a "
        "detector of its filters alone are set; else joint",
    )
    start: Literal["nominal", "zero", "given"] = described("nominal", "estimates at the start")
    given: GivenStart | None = described(None, "with start: given")
    std_fraction: Positive | None = described(
        None,
        "1-sigma at the start relative to nominal; null: the vehicle's for nominal, 1 for zero",
        span=plausible.UNCERTAINTY,
    )
    floors: Flag = described(True, "whether products of inertia and center of mass have a least 1-sigma at the start")
    thrust_transient: Literal["gate", "gate_lag"] = described(
        "gate_lag",
        "with filter: thesis; gate: skips samples whose jets have just changed; gate_lag: skips them, and"
        " takes impulses from the lagged thrust",
    )
    thrust_uncertainty: RelativeSigma = described(
        0.0, "with filter: thesis, 1-sigma of each jet's constant thrust error, relative, considered"
    )
    convergence: ConvergenceLimits = described(ConvergenceLimits(), "1-sigmas below which estimates may be acted on")
    readings_per_s: Positive | None = described(
        None,
        "with filter: joint, times a second at which anything is read, each a step of the filter; null: "
        "by `rate_hz` of sensors and rows of a record, else once a sample period",
        "1/s",
        span=plausible.FREQUENCY,
    )

    @model_validator(mode="after")
    def _require_given_mass_properties(self) -> EstimationBlock:
        """Raises ValueError where `start: given` comes without `given`, or `given` without it."""
        if (self.start == "given") != (self.given is not None):
            raise ValueError("start: given and the field `given` go together")
        return self

    def initial_covariance(self, vehicle: Vehicle) -> Array:
        """Returns the covariance of the ten parameters at the start, shape (10, 10)."""
        if self.given is not None:
            if self.given.covariance is not None:
                return np.array(self.given.covariance)
            return np.diag(np.square(np.array(self.given.standard_deviation)))
        fraction = self.std_fraction
        if fraction is None:
            fraction = vehicle.uncertainty if self.start == "nominal" else 1.0
        deviation = initial_standard_deviation(
            vehicle.nominal.vector(), fraction, vehicle.center_of_mass_floor, floors=self.floors
        )
        return np.diag(deviation**2)


class RotationBlock(Model):
    """The filter for inverse inertia and center of mass."""

    filter: Literal["second_order", "second_order_without_bias", "second_order_without_covariance", "extended"] = (
        described("second_order", "second_order: with bias and covariance of the curvature; extended: with neither")
    )
    coupling: Literal["subtract", "ignore", "hybrid", "model"] = described(
        "hybrid",
        "dynamic coupling; hybrid: subtracted once the estimates are good enough; model: part of the "
        "measurement model, for vehicles that turn fast",
    )
    coupling_limit: Positive = described(
        50.0, "hybrid subtracts below this ratio of innovation to measurement variance"
    )
    jump: Literal["none", "covariance_increment"] = described(
        "covariance_increment", "response to a too large innovation"
    )
    jump_threshold: Positive = described(25.0, "NIS that is too large; 11.34 in the thesis")
    jump_std_fraction: Real = described(1.0, "1-sigma then added, relative to the start", gt=0.0, le=100.0)
    process_noise_std: tuple[_Sigma, _Sigma, _Sigma, _Sigma, _Sigma, _Sigma, _Sigma, _Sigma, _Sigma] = described(
        (0.0,) * 9, "1-sigma of the change per sample", "1/(slug-ft^2) | 1/(kg-m^2), ft | m"
    )
    disturbance_std: NotNegative = described(
        0.0, "1-sigma per sample of unmodeled rate increments", "rad/s", span=plausible.RATE_STEP
    )
    largest_turn: Positive = described(0.2, "largest turn in a sample that is used", "rad")


class MassBlock(Model):
    """The filter for the mass reciprocal."""

    compensation: Literal["none", "transverse", "transverse_centripetal"] = described(
        "transverse", "terms of rotation taken out of velocity increments"
    )
    compensation_covariance: Flag = described(True, "whether their uncertainty adds to the measurement covariance")
    jump: Literal["none", "single_sample", "single_sample_thesis", "glr"] = described(
        "single_sample",
        "test for a jump of 1/m; single_sample_thesis: with the thesis's variance after it; glr: over a "
        "window of used samples",
    )
    jump_false_alarm_rate: Real = described(
        1e-6, "false alarms of the test per used sample; 0.01 in the thesis", ge=1e-100, lt=1.0
    )
    jump_window: Whole = described(5, "used samples in glr's window", ge=2, le=1000)
    process_noise_std: NotNegative = described(0.0, "1-sigma of the change of 1/m per sample", "1/slug | 1/kg")
    disturbance_std: NotNegative = described(
        0.0, "1-sigma per sample of unmodeled velocity increments", "ft/s | m/s", span=plausible.VELOCITY_STEP
    )


class JointBlock(Model):
    """The joint filter of mass properties, rate, velocity and thrust."""

    thrust_transient: Literal["none", "vehicle"] | None = described(
        None,
        "none: instantaneous thrust; vehicle: first-order lag, its time constants estimated; null: as "
        "plant.thrust_transient",
    )
    thrust_uncertainty: RelativeSigma | None = described(
        None,
        "1-sigma of each jet's constant thrust error, relative; 0 only where thrusts are exact; null: the vehicle's",
    )
    lag_uncertainty: Share | None = described(
        None, "1-sigma of the time constants, relative, one error per kind of jet; null: the vehicle's"
    )
    tank_fraction: Share | None = described(
        None, "shift by used propellant, as the vehicle's key; 0 only where it shifts nothing; null: the vehicle's"
    )
    rate_walk: NotNegative = described(
        0.0,
        "random walk of the rate by unmodeled torques, 1-sigma after 1 s",
        "rad/s/sqrt(s)",
        span=plausible.RATE_STEP,
    )
    velocity_walk: NotNegative = described(
        0.0,
        "random walk of the velocity by unmodeled forces, likewise",
        "ft/s/sqrt(s) | m/s/sqrt(s)",
        span=plausible.VELOCITY_STEP,
    )
    switching: Literal["ticks", "stamps"] = described(
        "ticks",
        "ticks: commands switch a sample period apart, stamps scatter about that; stamps: they switch at the stamps",
    )
    increment_rate: Real = described(
        1.5e-5,
        "probability of an innovation below which the covariance is inflated during the start",
        ge=1e-100,
        lt=1.0,
    )
    settled_after: Whole = described(
        60, "sample periods with a jet commanded after convergence that end the start", ge=0, le=1_000_000
    )


class CglrBlock(Model):
    """Detection and isolation of failed jets by the generalized likelihood ratio, and of jumps of mass properties."""

    kind: Literal["cglr", "off"] = described(
        "cglr",
        "off, or, usual with estimation.filter: thesis, the constrained generalized likelihood ratio of one sample",
    )
    margin: Positive = described(6.0, "lead in likelihood argument that a cluster, and a jet in it, needs")
    threshold: NotNegative = described(0.0, "least likelihood argument of an alarm")
    dispersion_threshold: NotNegative = described(16.0, "the same while jets fire, with thrust_uncertainty")
    magnitude_threshold: NotNegative = described(0.0, "least magnitude of an alarm", "lbf | N")
    mirror_sign_rule: Flag = described(False, "whether a jet that is on cannot give too much thrust")
    signature_uncertainty: Flag = described(True, "whether signatures are uncertain; not in the thesis")
    unexplained_limit: Positive | None = described(
        20.5, "largest unexplained part of the innovations (0.1 % of chi-square, 5 degrees); null: any"
    )
    on_detection: Literal["correct", "correct_thesis", "reject"] = described(
        "correct", "use of a sample that shows a failure"
    )
    reconfigure_after: Whole | None = described(2, "alarms in a row that declare a failure; null: never", ge=1)
    close_manifold: Flag = described(False, "whether a declared failure closes the jet's manifold")
    alarm_gap: Whole = described(
        3, "largest number of samples between two alarms in a row; untested ones do not count", ge=1
    )


class CusumBlock(Model):
    """Detection of failed jets by a cumulative sum for each; a baseline."""

    kind: Literal["cusum"] = described(..., "cumulative sums, jet by jet")
    drift: Positive = described(1.0, "taken off each sum at a sample, in its standard deviations")
    threshold: Positive = described(20.0, "sum above which a jet is declared")


class HypothesesBlock(Model):
    """Detection of failed jets, payloads and false readings with the joint filter, by their posterior probability."""

    kind: Literal["hypotheses"] = described(
        "hypotheses", "usual with estimation.filter: joint; what may fail stands in the block `faults`"
    )


FaultMode = Literal["stuck_on", "leak", "stuck_off", "loss", "drifting", "intermittent"]
_MODES: tuple[FaultMode, ...] = ("stuck_on", "leak", "stuck_off", "loss", "drifting", "intermittent")
_MORE, _LESS = set(_MODES) - {"stuck_off", "loss"}, set(_MODES) - {"stuck_on", "leak"}  # thrust than commanded
_NO_MODE = "name the fault modes that there may be; a jet that hardly ever fails has a low per_hour"


class JetFaults(Model):
    """Faults of one jet, where they are not those of all jets."""

    per_hour: Positive | None = described(None, "failures of this jet; null: faults.jet_per_hour", "1/h")
    modes: tuple[FaultMode, ...] | None = described(
        None, "its fault modes; null: faults.modes", min_length=1, reason=_NO_MODE
    )

    @property
    def gives_more(self) -> bool:
        """True if a fault mode lets the jet give more thrust than commanded; all modes count where none are named."""
        return not _MORE.isdisjoint(self.modes or _MODES)

    @property
    def gives_less(self) -> bool:
        """True if a fault mode lets the jet give less thrust than commanded; all modes count where none are named."""
        return not _LESS.isdisjoint(self.modes or _MODES)


class FaultsBlock(Model):
    """Priors of the faults that the detector of the joint filter looks for: rates and probabilities."""

    jet_per_hour: Positive = described(_PRIORS.jet_per_hour, "failures of one jet", "1/h")
    together: Probability = described(
        _PRIORS.together, "probability that a given other jet fails in the same interval, as by a shared driver"
    )
    full_thrust: Probability = described(_PRIORS.full_thrust, "share of failures with full thrust, as of stuck valves")
    drifting: Probability = described(_PRIORS.drifting, "share of failures whose force grows slowly")
    change_per_hour: Positive = described(_PRIORS.change_per_hour, "changes of a failed jet's force", "1/h")
    intermittent: Probability = described(_PRIORS.intermittent, "share of failures whose force changes all the time")
    payload_per_hour: Positive = described(_PRIORS.payload_per_hour, "payloads that come or leave", "1/h")
    reading_per_hour: Positive = described(
        _PRIORS.reading_per_hour, "sensor components that begin to read falsely, each", "1/h"
    )
    disturbed: Probability = described(
        _PRIORS.disturbed, "probability of an unstated disturbance, such as slosh, drag or a vent"
    )
    unknown_per_hour: Positive = described(_PRIORS.unknown_per_hour, "pushes that nothing known explains", "1/h")
    start: Probability = described(
        _PRIORS.start, "probability, when data contradict the start, that its uncertainty was stated too small"
    )
    false_per_hour: Positive = described(
        _PRIORS.false_per_hour, "accepted false declarations of one jet, or of anything else", "1/h"
    )
    slots: Whole = described(4, "failed jets whose forces are estimated at a time; each adds a state", ge=1, le=16)
    modes: tuple[FaultMode, ...] = described(
        _MODES,
        "fault modes that a jet may have; stuck_on and leak give more thrust than commanded, stuck_off "
        "and loss less, drifting and intermittent either",
        min_length=1,
        reason=_NO_MODE,
    )
    jets: dict[Text, JetFaults] = described({}, "jets unlike the others, by designation")

    @model_validator(mode="after")
    def _require_consistent_rates(self) -> FaultsBlock:
        """Raises ValidationError for shares that sum above 1, or false declarations as frequent as failures."""
        problems: list[tuple[FieldPath, str]] = []
        if (total := self.full_thrust + self.drifting) > 1.0 + 1e-12:
            problem = f"is with drifting {total:g} of all failures; both are shares, and sum to at most 1"
            problems.append((("full_thrust",), problem))
        if self.false_per_hour >= self.jet_per_hour:
            problem = (
                f"{self.false_per_hour:g} is not below jet_per_hour, {self.jet_per_hour:g}: declarations would be "
                "false as often as jets fail; give a small fraction of it"
            )
            problems.append((("false_per_hour",), problem))
        if problems:
            raise field_validation_error(problems)
        return self

    def of_each_jet(self, designations: Iterable[str]) -> FaultsBlock:
        """Returns the priors with rate and fault modes of each jet filled in, in the order of the designations."""
        default, faults_by_jet = JetFaults(per_hour=self.jet_per_hour, modes=self.modes), {}
        for name in designations:
            stated = self.jets.get(name, JetFaults()).model_dump(exclude_none=True)
            faults_by_jet[name] = default.model_copy(update=stated)
        return self.model_copy(update={"jets": faults_by_jet})


class ThrustFactorsBlock(Model):
    """Detection of jets that are weak or stand open, from the start or later, by hypotheses about their thrust."""

    kind: Literal["thrust_factors"] = described("thrust_factors", "usual with estimation.filter: pose")
    lead: Positive = described(6.0, "log-likelihood lead of a hypothesis over others that name a jet, nats")
    lead_nothing: Positive = described(12.0, "lead over no failure, nats")
    least: Probability = described(
        0.1, "least loss or opening that is declared, as a share of thrust; it must also exceed 3 sigma"
    )


DetectorBlock = Annotated[CglrBlock | CusumBlock | HypothesesBlock | ThrustFactorsBlock, Field(discriminator="kind")]

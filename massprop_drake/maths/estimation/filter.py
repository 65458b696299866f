"""Interface of every filter of mass properties, whatever its method.

A filter is a record of functions, as `Filter` says, in a file of its own under `filters/`; its `FILTER` stands in the
registry there, and blocks of the scenario make its parameters.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from massprop_drake.maths.arrays import FLAG, NUMBER, Layout
from massprop_drake.maths.estimation.adaptation import Adaptation
from massprop_drake.maths.estimation.detector import KnownForce
from massprop_drake.maths.estimation.impulses import Impulses
from massprop_drake.maths.estimation.joint.disturbance_states import NO_DISTURBANCE, DisturbanceParams
from massprop_drake.maths.estimation.joint.layout import EVERY_PERIOD, AttitudeSensors, Rates
from massprop_drake.maths.estimation.joint.modes import NO_MODES, ModeParams
from massprop_drake.maths.estimation.joint.tanks import NO_TANKS, TankParams
from massprop_drake.maths.estimation.joint.wheels import NO_WHEELS, WheelParams
from massprop_drake.maths.kernels import idiom
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.mass_properties import MASS_RECIPROCAL
from massprop_drake.maths.vehicle.engine_thrust import NO_ENGINES, EngineParams
from massprop_drake.maths.vehicle.mounting import EXACT, Mounting
from massprop_drake.maths.vehicle.on_times import Place

Groups = Mapping[str, Array]  # a state as vectors, by the part of the diagram that holds each


class Instruments(NamedTuple):
    """Noise and quanta of the packages of one kind, the preferred one first; rad/s, or ft/s and m/s.

    Attributes:
        quanta: step of a reading, shape (s,).
        noise_std: white noise of a reading, 1-sigma, shape (s,).
        bias_std: 1-sigma of a constant bias, of the acceleration where velocity is read, shape (s,).
    """

    quanta: Array
    noise_std: Array
    bias_std: Array


class ThrustModel(NamedTuple):
    """Thrust of the jets as stated, and its uncertainty.

    Attributes:
        wrenches: torque about the vehicle origin and force of each jet, shape (n_jets, 6).
        flows: propellant flow of each jet, slug/s or kg/s, shape (n_jets,).
        time_constants_s: of each jet's lag, zero: instantaneous, shape (n_jets,).
        kinds: index of each jet's kind, integers, shape (n_jets,).
        uncertainty: relative 1-sigma of each jet's constant thrust error, shape (n_jets,).
        lag_uncertainty: relative 1-sigma of each kind's time constant, shape (n_kinds,).
        repeatability: relative 1-sigma of each jet's impulse over a sample, white, shape (n_jets,).
        arm: root mean square distance of the jets from the nominal center of mass, ft or m.
        tank_fraction: share of it by which propellant from no tank shifts inertia and center of mass.
        mounting: see `Mounting`.
    """

    wrenches: Array
    flows: Array
    time_constants_s: Array
    kinds: np.ndarray
    uncertainty: Array
    lag_uncertainty: Array
    repeatability: Array
    arm: float
    tank_fraction: float
    mounting: Mounting = EXACT


class Setup(NamedTuple):
    """Vehicle, sensors and prior from which a filter makes its parameters.

    Attributes:
        period_s: sample period, s.
        gyro_variances: of the error of one reading of each gyro package, the preferred one first, rad^2/s^2,
            shape (s,).
        accelerometer_positions: the same order of accelerometer packages, vehicle frame, ft or m, shape (a, 3).
        accelerometer_variances: shape (a,).
        estimate, covariance: of the ten parameters at the start, shapes (10,) and (10, 10).
        nominal: the ten nominal parameters, shape (10,).
        thrust_errors: impulses of one sigma of each jet's thrust error at full level over a sample, about the
            vehicle origin, shape (n_jets, 6); None: thrust is taken as known.
        gyros, accelerometers: see `Instruments`.
        thrust: see `ThrustModel`.
        widest: 1-sigma of the ten parameters if nothing is known of them, shape (10,).
        limits: of convergence, see `mass_properties.is_converged`, shape (3,).
        trackers: of attitude.
        disturbance: see `DisturbanceParams`, for the nominal vehicle.
        opens_at: where in a sample an on-time lies of which no onset is told, see `maths.vehicle.on_times`; None:
            commands are levels.
        wheels: see `WheelParams`; the filter sets their sigma from `wheel_uncertainty`.
        wheel_uncertainty: 1-sigma of each wheel's inertia, relative, shape (n_wheels,).
        engines: see `engine_thrust.EngineParams`.
        engine_sigmas: 1-sigma of the six errors of each, shape (6 n_engines,).
        rates: see `Rates`.
        tanks: see `TankParams`.
        modes: see `ModeParams`.
        tracking: of a vehicle that is followed in a fixed frame, see `pose.setting.Tracking`; None: it is not.
    """

    period_s: float
    gyro_variances: Array
    accelerometer_positions: Array
    accelerometer_variances: Array
    estimate: Array
    covariance: Array
    nominal: Array
    thrust_errors: Array | None
    gyros: Instruments
    accelerometers: Instruments
    thrust: ThrustModel
    widest: Array
    limits: Array
    trackers: AttitudeSensors
    disturbance: DisturbanceParams = NO_DISTURBANCE
    opens_at: Place | None = None
    wheels: WheelParams = NO_WHEELS
    wheel_uncertainty: Array = NO_WHEELS.inertias
    engines: EngineParams = NO_ENGINES
    engine_sigmas: Array = np.zeros(0)
    rates: Rates = EVERY_PERIOD
    tanks: TankParams = NO_TANKS
    modes: ModeParams = NO_MODES
    tracking: Any = None


class Told(NamedTuple):
    """Commands to the jets and times of the readings, for a filter with a thrust model of its own.

    Attributes:
        time_s: of the sample, in sample periods from the first.
        stamp_s: when the readings were taken, by the record's clock.
        command: fraction commanded over the interval that ends, NaN where not known, shape (n_jets,).
        coming: fraction commanded from the sample's tick on; None: not known yet.
        outside_wrench: torque about the vehicle origin and force of known outside forces, mean over the interval,
            shape (6,).
        tracked: what is read besides gyros and accelerometers: of each pose sensor position and quaternion from body
            to fixed frame, of each velocity sensor the velocity, of each wheel the speed, of each engine level and two
            angles, NaN where missing, shape (7 n_poses + 3 n_velocities + n_wheels + 3 n_engines,); None: nothing.
        onset_s, coming_onset_s: of `command` and `coming`, see `maths.vehicle.on_times`, shape (n_jets,) each; None:
            not told.
    """

    time_s: float
    stamp_s: float
    command: Array
    coming: Array | None
    outside_wrench: Array
    tracked: Array | None = None
    onset_s: Array | None = None
    coming_onset_s: Array | None = None


class Interval(NamedTuple):
    """Known inputs of a sample interval before it is measured.

    Attributes:
        impulses: of the jets as commanded, of known outside forces, and of known forces of failed jets.
        known: the latter alone.
        told: see `Told`; None where a diagram gives a filter the impulses alone.
    """

    impulses: Impulses
    known: KnownForce
    told: Told | None = None


class Joint(NamedTuple):
    """Predictions and innovations of one sample, as a detector sees them; see `detector.Evidence`.

    Attributes:
        innovation, covariance: as there.
        coupled: as there.
        estimate, estimate_covariance, cross_covariance: as there.
    """

    innovation: Array
    covariance: Array
    coupled: bool
    estimate: Array
    estimate_covariance: Array
    cross_covariance: Array


JOINT = Layout(
    "evidence",
    innovation=6,
    covariance=(6, 6),
    coupled=FLAG,
    estimate=10,
    estimate_covariance=(10, 10),
    cross_covariance=(6, 10),
)
NOT_MEASURED = Joint(np.full(6, np.nan), np.zeros((6, 6)), False, np.zeros(10), np.zeros((10, 10)), np.zeros((6, 10)))


def _empty_joint():  # type: ignore[no-untyped-def] # compiled alone
    """Makes the result of `empty_joint` in compiled code."""
    unknown = np.full(6, np.nan)
    return Joint(unknown, np.zeros((6, 6)), False, np.zeros(10), np.zeros((10, 10)), np.zeros((6, 10)))


@idiom(_empty_joint)
def empty_joint() -> Joint:
    """Returns the innovations (`Joint`) of a sample that is not tested: NaN and zeros."""
    return NOT_MEASURED


class RotationReport(NamedTuple):
    """Log row of a cycle's rotation, by the signals' names.

    Attributes:
        estimate, standard_deviation: of inverse inertia and center of mass, after the measurement, shape (9,) each.
        rotation_innovation: measured minus predicted rate increment, rad/s, NaN where not measured, shape (3,).
        rotation_innovation_std: 1-sigma of it by the filter's own covariance, before any increment, shape (3,).
        rotation_nis: of the innovation, before any covariance increment.
        rotation_used: whether the estimate was updated.
        rotation_jump: whether the covariance was incremented.
        coupling_subtracted: whether dynamic coupling was to be subtracted.
    """

    estimate: Array
    standard_deviation: Array
    rotation_innovation: Array
    rotation_innovation_std: Array
    rotation_nis: float
    rotation_used: bool
    rotation_jump: bool
    coupling_subtracted: bool


class MassReport(NamedTuple):
    """Log row of a cycle's translation, by the signals' names.

    Attributes:
        mass_reciprocal, variance: after the measurement.
        mass_innovation: measured minus predicted velocity increment, ft/s or m/s, NaN where not measured, shape (3,).
        mass_innovation_std, mass_nis, mass_used: as in `RotationReport`.
        mass_jump: whether a jump of 1/m was found.
    """

    mass_reciprocal: float
    variance: float
    mass_innovation: Array
    mass_innovation_std: Array
    mass_nis: float
    mass_used: bool
    mass_jump: bool


ROTATION_REPORT = Layout(
    "rotation_report",
    estimate=9,
    standard_deviation=9,
    rotation_innovation=3,
    rotation_innovation_std=3,
    rotation_nis=NUMBER,
    rotation_used=FLAG,
    rotation_jump=FLAG,
    coupling_subtracted=FLAG,
)
MASS_REPORT = Layout(
    "mass_report",
    mass_reciprocal=NUMBER,
    variance=NUMBER,
    mass_innovation=3,
    mass_innovation_std=3,
    mass_nis=NUMBER,
    mass_used=FLAG,
    mass_jump=FLAG,
)


class FilterStep(NamedTuple):
    """A filter after one cycle.

    Attributes:
        state: to go on from.
        rotation, mass: for logs; mass is None without accelerometer.
        own: what the method logs besides, the fields of `Filter.report`; None: nothing.
        known: estimate and covariance of the ten parameters that are published; None: those of the state.
    """

    state: Any
    rotation: RotationReport
    mass: MassReport | None
    own: Any = None
    known: tuple[Array, Array] | None = None


def replace_state(step: FilterStep, state: Any, _params: Any) -> FilterStep:
    """Returns a filter step with the filter's state replaced."""
    return step._replace(state=state)


def publish_own_state(step: FilterStep, _state: Any, _params: Any) -> FilterStep:
    """Returns the filter step unchanged: a filter of this kind reports no estimates but its own."""
    return step


def replace_estimates(step: FilterStep, estimate: Array, covariance: Array) -> FilterStep:
    """Returns a filter step with the estimates in its log rows replaced; the innovations stay."""
    n_rotation = step.rotation.estimate.shape[0]
    rotation = step.rotation._replace(
        estimate=estimate[:n_rotation], standard_deviation=np.sqrt(covariance.diagonal())[:n_rotation]
    )
    mass = step.mass
    if mass is not None:
        mass = mass._replace(
            mass_reciprocal=float(estimate[MASS_RECIPROCAL]),
            variance=float(covariance[MASS_RECIPROCAL, MASS_RECIPROCAL]),
        )
    return step._replace(rotation=rotation, mass=mass)


class Filter(NamedTuple):
    """A method of estimating mass properties.

    Its state is a named tuple of arrays, floats and such tuples, of whatever size the method needs.

    Attributes:
        params: (setup, options) -> parameters; options are the scenario, word for word.
        initial: params -> state at the start.
        predicted: state -> the ten parameters before the sample's measurement, shape (10,).
        measure: (state, rates, velocities, interval, params) -> what the method makes of a sample before it is
            judged; readings of all packages, the preferred one first, NaN where missing, shape (s, 3) each.
        evidence: (state, measurement, interval) -> what the detector sees: `Joint`, or what one that is made for
            this filter takes.
        finish: (state, measurement, interval, adaptation, params) -> `FilterStep`.
        covariance: state -> of the ten parameters, NaN for what is not observed, shape (10, 10).
        saved: (state, params) -> vectors to keep it by.
        restored: (vectors, params) -> state.
        replaced: (`FilterStep`, state, params) -> `FilterStep` that goes on from what the detector gives.
        published: (`FilterStep`, state, params) -> `FilterStep` whose reports are of what the detector gives, while it
            goes on from its own.
        report: fields of `FilterStep.own`, of which each is a signal; None: it logs no more than every filter.
        growing: which of the vectors it is kept by has more numbers than at the start; "": none has.
    """

    params: Callable[[Setup, Any], Any]
    initial: Callable[[Any], Any]
    predicted: Callable[[Any], Array]
    measure: Callable[[Any, Array, Array, Interval, Any], Any]
    evidence: Callable[[Any, Any, Interval], Any]
    finish: Callable[[Any, Any, Interval, Adaptation, Any], FilterStep]
    covariance: Callable[[Any], Array]
    saved: Callable[[Any, Any], Groups]
    restored: Callable[[Groups, Any], Any]
    replaced: Callable[[FilterStep, Any, Any], FilterStep] = replace_state
    published: Callable[[FilterStep, Any, Any], FilterStep] = publish_own_state
    report: Layout | None = None
    growing: str = ""

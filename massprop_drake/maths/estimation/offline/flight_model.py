"""Model of a vehicle before a flight for the batch regression: its unknowns, and a part of a record."""

from __future__ import annotations

from functools import cache
from itertools import accumulate
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.maths.estimation.joint.disturbance_states import NO_DISTURBANCE, DisturbanceParams
from massprop_drake.maths.estimation.joint.layout import MASS, N_PROPERTIES
from massprop_drake.maths.estimation.joint.modes import ERRORS, NO_MODES, ModeParams
from massprop_drake.maths.estimation.joint.tanks import NO_TANKS, TankParams
from massprop_drake.maths.estimation.joint.wheels import NO_WHEELS, WheelParams
from massprop_drake.maths.estimation.offline.record_kernels import Compute
from massprop_drake.maths.linear_algebra import Array, is_positive_definite
from massprop_drake.maths.mass_properties import ELEMENT
from massprop_drake.maths.vehicle.engine_thrust import N_ERRORS, NO_ENGINES, EngineParams
from massprop_drake.maths.vehicle.mounting import EXACT, Mounting


class Columns(NamedTuple):
    """Places of the unknowns, a slice each."""

    properties: slice
    thrust: slice
    lag: slice
    gyro_bias: slice
    acceleration_bias: slice
    torque: slice
    drag: slice
    momentum: slice  # of wheels that turn steadily
    gyro_gain: slice
    accelerometer_gain: slice
    wheel: slice  # errors of the wheels' inertias, relative
    engine: slice  # errors of the engines, see `maths.vehicle.engine_thrust`
    mount: slice  # errors of the jets' mounting, in 1-sigmas, see `maths.vehicle.mounting`
    moving: slice  # errors of the parts that move inside, in units of their sigmas
    fill: slice  # errors of the propellant in tanks at the beginning, slug or kg
    flow: slice  # errors of the flow out of each, relative
    shift: slice  # of elements 0 to 8, for each unit of propellant from no tank that is still to be used


class FlightModel(NamedTuple):
    """Model of the vehicle before a flight.

    Attributes:
        period_s: between two ticks.
        wrenches: torque about the vehicle origin and force of each jet at full thrust, shape (n_jets, 6).
        flows: of propellant, slug/s or kg/s, shape (n_jets,).
        time_constants_s: of each jet's lag, zero: none, shape (n_jets,).
        kinds: index of each jet's kind, shape (n_jets,).
        positions: of the accelerometers, vehicle frame, shape (n_accelerometers, 3).
        variances: of a reading, by package, gyros first, shape (n_packages,).
        quanta: likewise, zero where noise dithers a reading.
        gyros: how many of the packages are gyros.
        prior: mean of all unknowns, shape (n,).
        sigma: their 1-sigma; zero: not reckoned with, shape (n,).
        compute: see `Compute`.
        at_stamps: whether commands switch at the stamps, and not at regular ticks; None: not asked, at these.
        walks: of the rate and of the velocity by unmodeled torques and forces, 1-sigma after one second.
        disturbance: see `joint.disturbance`.
        wheels: see `WheelParams`; what errors of their speeds make of the rate is in the gyros' variances.
        engines: see `maths.vehicle.engine_thrust.EngineParams`.
        tanks: see `TankParams`.
        mounting: see `maths.vehicle.mounting.Mounting`.
        modes: of parts that move inside, see `ModeParams`.
        followed: whether coupling is with the rates that come of it, in place of those that are read.
        own_times: whether rows come whenever anything is read, and intervals are as long as they are.
    """

    period_s: float
    wrenches: Array
    flows: Array
    time_constants_s: Array
    kinds: NDArray[np.int_]
    positions: Array
    variances: Array
    quanta: Array
    gyros: int
    prior: Array
    sigma: Array
    compute: Compute = Compute()
    at_stamps: bool | None = None
    walks: tuple[float, float] = (0.0, 0.0)
    disturbance: DisturbanceParams = NO_DISTURBANCE
    wheels: WheelParams = NO_WHEELS
    engines: EngineParams = NO_ENGINES
    tanks: TankParams = NO_TANKS
    mounting: Mounting = EXACT
    modes: ModeParams = NO_MODES
    followed: bool = False
    own_times: bool = False


def has_accumulating_noise(model: FlightModel) -> bool:
    """Tests whether rates or velocities hold noise that accumulates, as walks or a disturbance do."""
    return any(model.walks) or bool(model.disturbance.accelerations.any())


class Stretch(NamedTuple):
    """A part of a record without gaps, of m rows.

    Attributes:
        time_s: stamps, shape (m,).
        readings: of all packages, gyros first, NaN where missing, shape (m, n_packages, 3).
        commands: from each row on, shape (m, n_jets); the last row's is not used.
        before: the same of rows before, of which the first had been commanded for long, shape (b, n_jets), b > 0.
        outside: known torque about the vehicle origin and force from each row on, shape (m, 6).
        used_after: propellant that is used from each row to the end of the flight, slug or kg, shape (m,).
        onsets_s, before_onsets_s: of these commands, see `maths.vehicle.on_times`, shapes (m, n_jets) and (b, n_jets);
            None: jets switch with samples.
        speeds: of the wheels, NaN where not read, rad/s, shape (m, n_wheels); None: there are none.
        burns: level and angles of the engines at the start, middle and end of each interval, see
            `joint.burns.Burn`, shape (m, n_engines, 3, 3); None: there are none.
        seconds: of full thrust that each jet was commanded from the beginning of the record to each row, and from there
            to the end, s, shape (m, 2, n_jets); None: there are no tanks.
    """

    time_s: Array
    readings: Array
    commands: Array
    before: Array
    outside: Array
    used_after: Array
    onsets_s: Array | None = None
    before_onsets_s: Array | None = None
    speeds: Array | None = None
    burns: Array | None = None
    seconds: Array | None = None


def columns(model: FlightModel) -> Columns:
    """Returns the slice of each group of unknowns of a vehicle in the vector of all."""
    counts = model.flows.size, model.positions.shape[0], model.wheels.inertias.size
    sizes = model.engines.thrusts.size, model.mounting.jets.size, model.modes.sigmas.shape[0], model.tanks.fill.size
    return _place_unknowns(model.prior.shape[0], model.gyros, counts, sizes)


@cache
def _place_unknowns(
    n_parameters: int, n_gyros: int, counts: tuple[int, int, int], other_counts: tuple[int, ...]
) -> Columns:
    """Computes the slice of each group of unknowns from the numbers of jets, sensors and other parts."""
    (n_jets, n_accelerometers, n_wheels), (n_engines, n_mounts, n_parts, n_tanks) = counts, other_counts
    of_gyros, of_accelerometers = 3 * n_gyros, 3 * n_accelerometers
    others = n_wheels, N_ERRORS * n_engines, n_mounts, ERRORS * n_parts, n_tanks, n_tanks, MASS
    n_lags = n_parameters - (N_PROPERTIES + n_jets + 12 + of_gyros + 2 * of_accelerometers + sum(others))
    sizes = (N_PROPERTIES, n_jets, n_lags, 3, of_accelerometers, 3, 3, 3, of_gyros, of_accelerometers, *others)
    ends = list(accumulate(sizes))
    return Columns(*(slice(end - size, end) for end, size in zip(ends, sizes, strict=True)))


def relevant_unknowns(model: FlightModel) -> NDArray[np.bool_]:
    """Flags unknowns that a fit estimates or whose uncertainty it allows for, shape (n,)."""
    return (model.sigma > 0.0) | (np.arange(model.sigma.size) < N_PROPERTIES)


def is_physical(unknowns: Array) -> bool:
    """Tests whether a point of the fit has a positive definite inverse inertia and a positive mass."""
    return is_positive_definite(unknowns[:6][ELEMENT]) and bool(unknowns[MASS] > 0.0)

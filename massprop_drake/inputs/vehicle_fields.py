"""Fields of a vehicle's file, and arrays that follow from them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from massprop_drake.errors import InputError, suggestion
from massprop_drake.inputs import plausible
from massprop_drake.inputs.model import Model, Name, Positive, RelativeSigma, Share, Text, described
from massprop_drake.inputs.moving import MovingPart
from massprop_drake.inputs.vehicle_parts import (
    Disturbance,
    Jet,
    JetCommands,
    JetKind,
    MassPropertiesModel,
    Solid,
    Surroundings,
    Tank,
)
from massprop_drake.inputs.vehicle_sensors import (
    Accelerometer,
    Gyro,
    PoseSensor,
    RocketEngine,
    SensorPackage,
    VelocitySensor,
    Wheel,
    distinct_times_per_s,
)
from massprop_drake.maths.linear_algebra import Array
from massprop_drake.maths.mass_properties import MassProperties
from massprop_drake.maths.vehicle.depletion import Tanks
from massprop_drake.maths.vehicle.on_times import Place
from massprop_drake.maths.vehicle.thrust import thrust_wrenches

STANDARD_GRAVITY = {"us": plausible.GRAVITY / plausible.FOOT, "si": plausible.GRAVITY}  # ft/s^2, m/s^2
UNITS = {"us": {"length": "ft", "mass": "slug", "force": "lbf"}, "si": {"length": "m", "mass": "kg", "force": "N"}}
WITHOUT_RATES = "without measured rates neither inertia nor center of mass can be estimated"
_MOST_JETS = 500  # several times what any vehicle has
_Fixable = Literal["Ixx_inv", "Iyy_inv", "Izz_inv", "Iyz_inv", "Ixz_inv", "Ixy_inv", "x_cm", "y_cm", "z_cm", "m_inv"]


class VehicleFields(Model):
    """Fields of a vehicle, each sound by itself."""

    name: Name = described(..., "short name", min_length=1)
    description: Text = described("", "one line")
    source: Text = described("", "where the data come from")
    units: Literal["us", "si"] = described(..., "us: ft, slug, lbf; si: m, kg, N; both s, rad")
    sample_period_s: Positive = described(..., "period of control and estimation", "s", span=plausible.PERIOD)
    mass_properties: MassPropertiesModel = described(..., "nominal mass properties")
    uncertainty: Positive = described(
        0.3,
        "1-sigma of the nominal mass properties, relative to them; products have floors",
        span=plausible.UNCERTAINTY,
    )
    center_of_mass_std: Positive | None = described(
        None,
        "least 1-sigma of the center of mass at the start; null: 10 % of the jets' RMS arm",
        "ft | m",
        span=plausible.POSITION,
    )
    tank_fraction: Share = described(
        0.01,
        "share of the jets' RMS arm by which propellant from no stated tank shifts center of mass and "
        "inertia; 0.1 where tanks lie far out; for filter: joint",
    )
    mass_std: Positive | None = described(
        None,
        "1-sigma of the nominal mass, as of scales; null: by `uncertainty`; for filter: pose, like the next four keys",
        "slug | kg",
        span=plausible.MASS,
    )
    common_scale_uncertainty: RelativeSigma = described(
        0.0, "1-sigma of the thrust error common to all jets, relative, as by supply pressure"
    )
    common_scale_walk: RelativeSigma = described(0.0, "its random walk, 1-sigma after 1 s", "1/sqrt(s)")
    motion: Literal["free", "planar"] = described("free", "planar: in x, y and about z alone, as on an air bearing")
    fixed: tuple[_Fixable, ...] = described((), "parameters that are known, not estimated")
    surroundings: Surroundings = described(Surroundings(), "what moves the vehicle besides its jets; for filter: pose")
    disturbance: Disturbance | None = described(None, "slowly changing torque and force, estimated; for filter: joint")
    poses: tuple[PoseSensor, ...] = described((), "sensors of position and attitude in a fixed frame")
    velocities: tuple[VelocitySensor, ...] = described((), "sensors of velocity in the fixed frame")
    wheels: tuple[Wheel, ...] = described((), "reaction wheels; for filter: joint", max_length=8)
    engines: tuple[RocketEngine, ...] = described(
        (), "engines with a throttle or a gimbal; for filter: joint", max_length=8
    )
    tanks: tuple[Tank, ...] = described((), "tanks from which jets draw; for filter: joint", max_length=8)
    moving: tuple[MovingPart, ...] = described((), "parts that move inside; for filter: joint", max_length=8)
    gyros: tuple[Gyro, ...] = described(
        ..., "rate-gyro packages; [] only with a pose sensor that gives attitude", reason=WITHOUT_RATES
    )
    accelerometers: tuple[Accelerometer, ...] = described((), "integrating-accelerometer packages")
    preferred_accelerometer: Text | None = described(None, "package used where one is enough; null: the first")
    jet_kinds: dict[Name, JetKind] = described(..., "kinds of jets by name", min_length=1)
    jet_commands: JetCommands = described(JetCommands(), "meaning of a command between 0 and 1")
    jets: tuple[Jet, ...] = described(..., "reaction-control jets", min_length=1, max_length=_MOST_JETS)
    shape: tuple[Solid, ...] = described((), "solids of the 3-D replay; empty: a box between the jets")

    @property
    def sensors(self) -> tuple[SensorPackage, ...]:
        """All sensor packages, gyros first."""
        return (*self.gyros, *self.accelerometers)

    @property
    def tracked(self) -> tuple[PoseSensor | VelocitySensor | Wheel | RocketEngine, ...]:
        """Sensors other than the packages: those in a fixed frame, poses first, the wheels' speeds and the engines."""
        return (*self.poses, *self.velocities, *self.wheels, *self.engines)

    @property
    def has_own_rates(self) -> bool:
        """True if a sensor has a reading rate of its own, other than the sample rate."""
        return any(sensor.rate_hz is not None for sensor in self._timed)

    @property
    def readings_per_s(self) -> float:
        """Distinct times per second at which anything is read or commanded, all sensors being read at zero."""
        return distinct_times_per_s([1.0 / self.sample_period_s, *(one.rate_hz for one in self._timed if one.rate_hz)])

    @property
    def _timed(self) -> tuple[SensorPackage | PoseSensor | Wheel, ...]:
        """Sensors that may have a reading rate of their own: packages, poses, wheels."""
        return (*self.sensors, *self.poses, *self.wheels)

    @property
    def tracked_columns(self) -> tuple[str, ...]:
        """Columns of the tracked sensors in telemetry, in order."""
        return tuple(column for sensor in self.tracked for column in sensor.columns)

    @property
    def needs_pose_filter(self) -> bool:
        """True if the sensors and motion need the estimator in a fixed frame, `estimation.filter` pose."""
        located = bool(self.velocities) or any(pose.position_std is not None for pose in self.poses)
        return located or self.motion == "planar" or not self.gyros

    @property
    def has_on_times(self) -> bool:
        """True if jets open and close within a sample, see `maths.vehicle.on_times`."""
        stated = getattr(self.jet_commands, "as")
        if stated is not None:
            return bool(stated == "on_time")
        return any(0.0 < kind.minimum_on_time_s < self.sample_period_s for kind in self.jet_kinds.values())

    @property
    def opens_at(self) -> Place | None:
        """Place of an on-time in its sample where no onset is given; None: commands are levels."""
        return self.jet_commands.at if self.has_on_times else None

    @cached_property
    def designations(self) -> tuple[str, ...]:
        """The jets' designations, in order."""
        return tuple(jet.designation for jet in self.jets)

    @cached_property
    def positions(self) -> Array:
        """Positions of the jets in the vehicle frame, ft or m, shape (n_jets, 3)."""
        return np.array([jet.position for jet in self.jets])

    @cached_property
    def thrusts(self) -> Array:
        """Force vectors of the jets, thrust x direction / |direction|, lbf or N, shape (n_jets, 3)."""
        directions = np.array([jet.direction for jet in self.jets])
        magnitudes = np.array([jet.thrust for jet in self.jets])
        return directions * (magnitudes / np.linalg.norm(directions, axis=1))[:, None]

    @cached_property
    def wrenches(self) -> Array:
        """Torque about the vehicle origin and force of each jet, shape (n_jets, 6)."""
        return thrust_wrenches(self.positions, self.thrusts)

    @cached_property
    def mass_flows(self) -> Array:
        """Propellant flow of each jet at full thrust, slug/s or kg/s, shape (n_jets,)."""
        gravity = STANDARD_GRAVITY[self.units]

        def flow(jet: Jet) -> float:
            """Propellant flow of one jet at full thrust, slug/s or kg/s."""
            kind = self.jet_kinds[jet.kind]
            return jet.mass_flow or kind.nominal_thrust / (gravity * kind.specific_impulse_s)

        return self._per_jet(flow)

    @cached_property
    def time_constants_s(self) -> Array:
        """Time constant of each jet's thrust build-up and tail-off, s, shape (n_jets,)."""
        return self._per_jet(lambda jet: self.jet_kinds[jet.kind].time_constant_s)

    @cached_property
    def command_delays_s(self) -> Array:
        """Delay of each jet from command to action, s, shape (n_jets,)."""
        return self._per_jet(lambda jet: self.jet_kinds[jet.kind].command_delay_s)

    @cached_property
    def kind_indices(self) -> NDArray[np.int_]:
        """Index of each jet's kind in `jet_kinds`, shape (n_jets,)."""
        kinds = list(self.jet_kinds)
        return np.array([kinds.index(jet.kind) for jet in self.jets])

    def jets_of(self, tank: Tank) -> NDArray[np.bool_]:
        """Flags the jets that draw from a tank, shape (n_jets,)."""
        return np.array([jet.designation in tank.feeds or jet.kind in tank.feeds for jet in self.jets])

    @cached_property
    def tank_geometry(self) -> Tanks:
        """Outlets, propellant columns and fed jets of the tanks as arrays, see `maths.vehicle.depletion`."""
        axes = np.array([tank.axis for tank in self.tanks]).reshape(-1, 3)
        axes = axes / np.linalg.norm(axes, axis=1, keepdims=True)
        heights = np.array([tank.length / tank.capacity for tank in self.tanks])
        return Tanks(
            outlets=np.array([tank.outlet for tank in self.tanks]).reshape(-1, 3),
            columns=axes * heights[:, None],
            spreads=np.array(
                [
                    0.25 * tank.radius**2 * (np.eye(3) + np.outer(axis, axis))
                    for tank, axis in zip(self.tanks, axes, strict=True)
                ]
            ).reshape(-1, 3, 3),
            feeds=np.array([self.jets_of(tank) for tank in self.tanks], dtype=float).reshape(-1, len(self.jets)),
        )

    @cached_property
    def minimum_on_times_s(self) -> Array:
        """Minimum on-time of each jet, s, shape (n_jets,)."""
        return self._per_jet(lambda jet: self.jet_kinds[jet.kind].minimum_on_time_s)

    @cached_property
    def on_time_quanta_s(self) -> Array:
        """Step of each valve's clock, zero: none, s, shape (n_jets,)."""
        return self._per_jet(lambda jet: self.jet_kinds[jet.kind].on_time_quantum_s)

    @cached_property
    def thrust_uncertainties(self) -> Array:
        """1-sigma of each jet's constant thrust error, relative, shape (n_jets,)."""

        def uncertainty(jet: Jet) -> float:
            """Relative 1-sigma of one jet's thrust: its own, or its kind's."""
            stated = jet.thrust_uncertainty
            return self.jet_kinds[jet.kind].thrust_uncertainty if stated is None else stated

        return self._per_jet(uncertainty)

    @cached_property
    def mounting_sigmas(self) -> Array:
        """1-sigma of the direction, rad, and of the place, ft or m, of each jet, shape (n_jets, 2)."""
        kinds = [self.jet_kinds[jet.kind] for jet in self.jets]
        return np.array([(kind.direction_std, kind.position_std) for kind in kinds])

    def _per_jet(self, value: Callable[[Jet], float]) -> Array:
        """Computes a value for each jet, shape (n_jets,)."""
        return np.array([value(jet) for jet in self.jets])

    def __repr__(self) -> str:
        return (
            f"<Vehicle '{self.name}': {len(self.jets)} jets, {self.sensors_in_words}, "
            f"{self.nominal.mass:g} {self.unit_names['mass']}>"
        )

    __str__ = __repr__

    @cached_property
    def nominal(self) -> MassProperties:
        """Nominal mass properties as arrays."""
        return self.mass_properties.properties()

    @cached_property
    def rms_arm(self) -> float:
        """Root mean square distance of the jets from the nominal center of mass, ft or m."""
        arms = self.positions - self.nominal.center_of_mass
        return float(np.sqrt((arms**2).sum(axis=1).mean()))

    @property
    def center_of_mass_floor(self) -> float:
        """The floor of the center of mass's 1-sigma at the start, ft or m."""
        return self.center_of_mass_std or 0.1 * self.rms_arm

    @property
    def unit_names(self) -> dict[str, str]:
        """Names of the units of length, mass and force."""
        return UNITS[self.units]

    def gyro(self, name: str) -> Gyro:
        """Returns the gyro package of a name; raises InputError where there is none."""
        return _find_package("gyro package", name, self.gyros)

    def accelerometer(self, name: str) -> Accelerometer:
        """Returns the accelerometer package of a name; raises InputError where there is none."""
        return _find_package("accelerometer package", name, self.accelerometers)

    def jet_index(self, designation: str) -> int:
        """Returns the index of a jet in `jets`; raises KeyError for an unknown designation."""
        try:
            return self.designations.index(designation)
        except ValueError:
            raise KeyError(designation) from None

    @property
    def sensors_in_words(self) -> str:
        """Text with the number of sensors of each kind."""
        counts = {
            "pose sensor": len(self.poses),
            "velocity sensor": len(self.velocities),
            "reaction wheel": len(self.wheels),
            "engine": len(self.engines),
        }
        text = "".join(f", {count} {kind}{'s' if count > 1 else ''}" for kind, count in counts.items() if count)
        return f"{len(self.gyros)} gyro and {len(self.accelerometers)} accelerometer packages{text}"

    def sensor_names(self) -> list[str]:
        """Returns the names of the gyro and accelerometer packages, gyros first."""
        return [sensor.name for sensor in self.sensors]


_P = TypeVar("_P", bound=SensorPackage)


def _find_package(kind: str, name: str, packages: Sequence[_P]) -> _P:
    """Returns the sensor package of a name; raises InputError with a similar name where there is none."""
    found = next((package for package in packages if package.name == name), None)
    if found is None:
        raise InputError(f"'{name}' is no {kind} of the vehicle{suggestion(name, [one.name for one in packages])}")
    return found

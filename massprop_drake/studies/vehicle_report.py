"""Reports on a vehicle before it flies: how its jets push, what they show, which of them look alike."""

from __future__ import annotations

import math
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from massprop_drake.inputs import params
from massprop_drake.inputs.estimation_blocks import CglrBlock, MassBlock
from massprop_drake.inputs.scenario import Scenario, resolve_scenario
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.inputs.vehicle_sensors import Accelerometer
from massprop_drake.maths.autopilot.jet_selection import activity_vectors
from massprop_drake.maths.estimation import observability
from massprop_drake.maths.estimation.detectors.jet_tests import signatures
from massprop_drake.maths.estimation.filters.mass_filter import Rotation, compensate_rotation
from massprop_drake.maths.mass_properties import NAMES
from massprop_drake.maths.vehicle.sensing import increment_noise
from massprop_drake.results.identifiability_flags import increments_noise, unobservable_combinations
from massprop_drake.systems.autopilot.jet_selection_program import JetSelectionProgram

Array = NDArray[np.float64]

DIRECTIONS = tuple(f"{motion} {sign}{axis}" for motion, axis, sign in product(("turn", "translate"), "xyz", ("+", "-")))
_NOTHING = 1e-6  # of what all jets could do together: less is the solver's rounding
_THROUGH = 1e-3  # of the RMS arm: a line this close to the center of mass passes through it


def vehicle_report(vehicle: Vehicle, n_pairs: int = 5) -> dict[str, Any]:
    """Returns what jets and sensors can do at nominal mass properties: control, observability, isolation.

    It goes by the first gyro and the preferred accelerometer.

    Args:
        vehicle: the vehicle.
        n_pairs: how many pairs of jets to list, those hardest to tell apart first.

    Returns:
        Content for JSON, None standing for what is infinite or missing:

        - `body`: its `mass`, the radii of `gyration` about the principal axes, shape (3,), and the jets' `arms`, their
          distances from the center of mass, and `thrusts`, of each in the file's order: wrong units show here;
        - `control`: `rank` and `condition` of the activity matrix (`observability.activity_rank`, arm: the jets'
          RMS arm), `reach` in each of `DIRECTIONS` (`largest_accelerations`), and those that are `missing`;
        - `observability`: `rank` of as many as are `estimated`, ten but for what is fixed, and the `unobservable`
          combinations of parameters (`observability.unobservable_combinations`, in units of their 1-sigma at the
          start), each as weights by name;
        - `notes`: sentences on what follows from the geometry;
        - `alike`: pairs of jets, `angle_rad` between their signatures, and whether they are `opposed`;
        - `isolable`: per jet the smallest force, lbf or N, that one sample assigns to it, `on` untold and `lost` while
          it fires alone (`observability.smallest_isolable`), each with its `rival`.
    """
    nominal = vehicle.nominal.vector()
    activity = activity_vectors(vehicle.wrenches, nominal)
    rank, condition = observability.activity_rank(activity, vehicle.rms_arm or 1.0)
    reach = dict(zip(DIRECTIONS, largest_accelerations(activity), strict=True))
    unobservable, free = _unobservable(vehicle), 10 - int(_not_estimated(vehicle).sum())
    whitened = _whitened_signatures(vehicle)
    return {
        "body": _vehicle_dimensions(vehicle),
        "control": {
            "rank": rank,
            "condition": _finite(condition),
            "reach": reach,
            "missing": [name for name, value in reach.items() if value == 0.0],
        },
        "observability": {"rank": free - len(unobservable), "estimated": free, "unobservable": unobservable},
        "notes": _geometry_notes(vehicle),
        "alike": _similar_jet_pairs(vehicle, whitened, n_pairs),
        "isolable": _smallest_isolable(vehicle, whitened),
    }


def _vehicle_dimensions(vehicle: Vehicle) -> dict[str, Any]:
    """Returns mass, radii of gyration, jets' lever arms and thrusts of a vehicle, by name."""
    nominal = vehicle.nominal
    return {
        "mass": nominal.mass,
        "gyration": np.sqrt(np.linalg.eigvalsh(nominal.inertia) / nominal.mass).tolist(),
        "arms": np.linalg.norm(vehicle.positions - nominal.center_of_mass, axis=1).tolist(),
        "thrusts": [jet.thrust for jet in vehicle.jets],
    }


def largest_accelerations(activity: Array) -> list[float]:
    """Computes the largest acceleration in each of `DIRECTIONS`, others zero, with no jet beyond full thrust.

    Args:
        activity: activity vectors as columns, shape (6, n_jets).

    Returns:
        rad/s^2, then ft/s^2 or m/s^2; zero where the jets cannot push that way alone.
    """
    n_jets = activity.shape[1]
    program, limits = JetSelectionProgram(np.ones(n_jets)), np.ones(n_jets)
    floor = _NOTHING * np.abs(activity).sum(axis=1)
    accelerations = [
        (row, program.reach(activity, row, sign, limits, alone=True)) for row, sign in product(range(6), (1.0, -1.0))
    ]
    return [value if value > floor[row] else 0.0 for row, value in accelerations]


def _unobservable(vehicle: Vehicle) -> list[dict[str, float]]:
    """Returns unobservable combinations of the ten parameters, each as nonzero weights by parameter name."""
    known = _not_estimated(vehicle)
    rows = unobservable_combinations(vehicle, accelerometer=_has_velocity_sensor(vehicle), known=known)
    return [{name: float(weight) for name, weight in zip(NAMES, row, strict=True) if weight != 0.0} for row in rows]


def _not_estimated(vehicle: Vehicle) -> NDArray[np.bool_]:
    """Flags the parameters that are fixed, or have no effect in planar motion, shape (10,)."""
    if not vehicle.needs_pose_filter:
        return np.zeros(10, dtype=bool)
    return params.known_parameters(resolve_scenario({"vehicle": vehicle}))


def _has_velocity_sensor(vehicle: Vehicle) -> bool:
    """Tests whether any sensor measures translation: accelerometer, velocity or position sensor."""
    placed = any(pose.position_std is not None for pose in vehicle.poses)
    return bool(vehicle.accelerometers or vehicle.velocities or placed)


def _accelerometer(vehicle: Vehicle) -> Accelerometer | None:
    """Returns the preferred accelerometer, or else the first; None without any."""
    packages = vehicle.accelerometers
    preferred = (package for package in packages if package.name == vehicle.preferred_accelerometer)
    return next(preferred, packages[0] if packages else None)


def _whitened_signatures(vehicle: Vehicle) -> Array:
    """Computes each jet's signature per unit force over one sample's noise, shape (n_jets, 6 or 3).

    The noise is that of the increments of rate and of velocity, the latter compensated for rotation as in
    the mass filter. The mass properties are taken as known.
    """
    period, nominal = vehicle.sample_period_s, vehicle.nominal.vector()
    unit = vehicle.wrenches / np.linalg.norm(vehicle.thrusts, axis=1)[:, None]
    effects = signatures(unit, nominal, period)
    if vehicle.needs_pose_filter:
        noise = increments_noise(resolve_scenario({"vehicle": vehicle}))
        if not _has_velocity_sensor(vehicle):
            return observability.whiten_signatures(effects[:, 3:], noise[:3, :3])
        order = [3, 4, 5, 0, 1, 2]  # here of the velocity first
        return observability.whiten_signatures(effects, noise[np.ix_(order, order)])
    rate = increment_noise(vehicle.gyros[0].variance)
    accelerometer = _accelerometer(vehicle)
    if accelerometer is None:
        return observability.whiten_signatures(effects[:, 3:], rate)
    nothing = np.zeros(3)
    known = Rotation(nothing, nothing, float(rate[0, 0]), nominal[6:9], np.zeros((3, 3)))
    arm = np.array(accelerometer.position) - known.center
    chosen = params.mass_params(Scenario(vehicle=vehicle, mass=MassBlock(compensation="transverse")))
    _, velocity = compensate_rotation(nothing, increment_noise(accelerometer.variance), arm, known, chosen)
    covariance = np.zeros((6, 6))
    covariance[:3, :3], covariance[3:, 3:] = velocity, rate
    return observability.whiten_signatures(effects, covariance)


def _similar_jet_pairs(vehicle: Vehicle, whitened: Array, n_pairs: int) -> list[dict[str, Any]]:
    """Lists the pairs of jets with the smallest angles between whitened signatures, rad, smallest first."""
    names = vehicle.designations
    return [
        {"jets": [names[pair.first], names[pair.second]], "angle_rad": pair.angle, "opposed": pair.opposed}
        for pair in observability.jet_pairs(whitened)[:n_pairs]
    ]


def _smallest_isolable(vehicle: Vehicle, whitened: Array) -> list[dict[str, Any]]:
    """Lists the smallest isolable force of each jet, stuck on or lost, and the jet most similar to it."""
    names, margin = vehicle.designations, CglrBlock().margin
    found = {kind: observability.smallest_isolable(whitened, margin, lost=kind == "lost") for kind in ("on", "lost")}
    return [
        {
            "jet": name,
            **{
                kind: {
                    "force": _finite(float(force[jet])),
                    "rival": names[rival[jet]] if rival[jet] >= 0 else None,
                }
                for kind, (force, rival) in found.items()
            },
        }
        for jet, name in enumerate(names)
    ]


def _geometry_notes(vehicle: Vehicle) -> list[str]:
    """Returns sentences on what jets and sensors leave unobservable or uncontrolled."""
    notes = []
    if not _has_velocity_sensor(vehicle):
        notes.append("no accelerometer: the mass cannot be observed")
    forces = observability.span_basis(vehicle.thrusts)
    if len(forces) == 1:
        line = _direction_text(forces[0])
        notes.append(
            f"all forces lie along one line, {line}: where the center of mass lies along it cannot be observed"
        )
    elif len(forces) == 2:
        normal = _direction_text(np.cross(*forces))
        notes.append(f"all forces lie in one plane, normal to {normal}: no jet pushes out of it")
    torques = np.cross(vehicle.positions - vehicle.nominal.center_of_mass, vehicle.thrusts)
    distance = np.linalg.norm(torques, axis=1) / np.linalg.norm(vehicle.thrusts, axis=1)
    through = distance <= _THROUGH * vehicle.rms_arm
    if through.all():
        notes.append(
            "every jet's line passes through the nominal center of mass: "
            "inertia and center of mass show only as far as it lies elsewhere"
        )
        return notes
    if through.any():
        named = ", ".join(np.array(vehicle.designations)[through])
        notes.append(f"lines through the nominal center of mass, so no torque: {named}")
    axes = observability.span_basis(torques)
    if len(axes) == 1:
        notes.append(
            f"all torques lie along one line, {_direction_text(axes[0])}: about no other axis is there control"
        )
    elif len(axes) == 2:
        normal = _direction_text(np.cross(*axes))
        notes.append(f"all torques lie in one plane, normal to {normal}: no control about that axis")
    return notes


def _direction_text(direction: Array) -> str:
    """Formats a unit vector with its largest element positive, or the axis it lies along."""
    direction = direction * np.sign(direction[np.abs(direction).argmax()])
    axis = int(direction.argmax())
    if direction[axis] > 1.0 - 1e-9:
        return "xyz"[axis]
    return "(" + ", ".join(f"{element + 0.0:.3g}" for element in np.round(direction, 6)) + ")"


def _finite(value: float) -> float | None:
    """Returns the value, or None where it is not finite."""
    return value if math.isfinite(value) else None

"""What can be said of a vehicle before it flies: how its jets push, what they show, which look alike."""

from __future__ import annotations

import math
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog

from massprop_drake.inputs import params
from massprop_drake.inputs.scenario import DetectorBlock, MassBlock, Scenario
from massprop_drake.inputs.vehicle import Accelerometer, Vehicle
from massprop_drake.maths.autopilot.jet_selection import activity_vectors
from massprop_drake.maths.estimation import observability
from massprop_drake.maths.estimation.detectors.jet_tests import signatures
from massprop_drake.maths.estimation.filters.mass_filter import Rotation, compensated
from massprop_drake.maths.mass_properties import NAMES, initial_standard_deviation
from massprop_drake.maths.vehicle.sensing import increment_noise

Array = NDArray[np.float64]

DIRECTIONS = tuple(f"{motion} {sign}{axis}" for motion, axis, sign in product(("turn", "translate"), "xyz", ("+", "-")))
_OFFSET = np.array([0.62, -0.48, 0.62])  # a unit vector along no axis and in no plane of them
_THROUGH = 1e-3  # of the RMS arm: a line this close to the center of mass passes through it


def vehicle_report(vehicle: Vehicle, n_pairs: int = 5) -> dict[str, Any]:
    """What a vehicle's jets and sensors can do, at its nominal mass properties, with its first gyro and its
    preferred accelerometer. For JSON: null stands for what is infinite or there is none of.

    Args:
        vehicle: the vehicle.
        n_pairs: so many pairs of jets are listed, those hardest to tell apart.

    Returns:
        - `control`: `rank` and `condition` of the activity matrix (`observability.activity_rank`, arm: the jets'
          RMS arm), `reach` in each of `DIRECTIONS` (`reaches`), and those that are `missing`;
        - `observability`: `rank` of ten, and the `unobservable` combinations of parameters
          (`observability.unobservable`, in units of their 1-sigma at the start), each as weights by name;
        - `notes`: sentences on what follows from the geometry;
        - `alike`: pairs of jets, `angle_rad` between their signatures, and whether they are `opposed`;
        - `isolable`: per jet the smallest force, lbf or N, that one sample assigns to it, `on` untold and `lost` while
          it fires alone (`observability.smallest_isolable`), each with its `rival`.
    """
    nominal = vehicle.nominal.vector()
    activity = activity_vectors(vehicle.wrenches, nominal)
    rank, condition = observability.activity_rank(activity, vehicle.rms_arm or 1.0)
    reach = dict(zip(DIRECTIONS, reaches(activity), strict=True))
    hidden = _unobservable(vehicle)
    seen = _whitened_signatures(vehicle)
    return {
        "control": {
            "rank": rank,
            "condition": _finite(condition),
            "reach": reach,
            "missing": [name for name, value in reach.items() if value == 0.0],
        },
        "observability": {"rank": 10 - len(hidden), "unobservable": hidden},
        "notes": _notes(vehicle),
        "alike": _alike(vehicle, seen, n_pairs),
        "isolable": _isolable(vehicle, seen),
    }


def reaches(activity: Array) -> list[float]:
    """Largest acceleration in each of `DIRECTIONS`, all jets between off and full, nothing else changing.

    Args:
        activity: activity vectors as columns, shape (6, n_jets).

    Returns:
        rad/s^2, then ft/s^2 or m/s^2; zero where the jets cannot push that way alone.
    """
    # rows of a largest element 1: the solver's tolerances are absolute
    size = np.abs(activity).max(axis=1)
    rows = activity / np.where(size > 0.0, size, 1.0)[:, None]
    n_jets = activity.shape[1]
    found = []
    for row, sign in product(range(6), (1.0, -1.0)):
        # levels and the acceleration s, in units of the row: maximize s with rows @ levels = s along the direction
        column = np.zeros((6, 1))
        column[row] = -sign
        bounds = [(0.0, 1.0)] * n_jets + [(0.0, None)]
        cost = np.append(np.zeros(n_jets), -1.0)
        result = linprog(cost, A_eq=np.hstack([rows, column]), b_eq=np.zeros(6), bounds=bounds)
        share = float(result.x[-1]) if result.success else 0.0
        found.append(share * float(size[row]) if share > 1e-6 else 0.0)
    return found


def _unobservable(vehicle: Vehicle) -> list[dict[str, float]]:
    """Combinations that stay hidden, with the center of mass moved off places where terms vanish by chance."""
    parameters = vehicle.nominal.vector()
    scale = initial_standard_deviation(parameters, vehicle.uncertainty, vehicle.center_of_mass_floor or 1.0)
    parameters[6:9] += _OFFSET * (vehicle.center_of_mass_floor or 1.0)
    jacobian = observability.impulse_jacobian(
        vehicle.wrenches, parameters, accelerometer=_accelerometer(vehicle) is not None
    )
    return [
        {name: float(weight) for name, weight in zip(NAMES, row, strict=True) if weight != 0.0}
        for row in observability.unobservable(jacobian, scale)
    ]


def _accelerometer(vehicle: Vehicle) -> Accelerometer | None:
    packages = vehicle.accelerometers
    preferred = (package for package in packages if package.name == vehicle.preferred_accelerometer)
    return next(preferred, packages[0] if packages else None)


def _whitened_signatures(vehicle: Vehicle) -> Array:
    """Signatures per unit force in units of one sample's noise, shape (n_jets, 6), or 3 without accelerometer.

    The noise is that of the sensors' increments: of the velocity, freed of rotation by the measured rates
    as the mass filter does it, and of the rate. The mass properties are taken as known.
    """
    period, nominal = vehicle.sample_period_s, vehicle.nominal.vector()
    unit = vehicle.wrenches / np.linalg.norm(vehicle.thrusts, axis=1)[:, None]
    effects = signatures(unit, nominal, period)
    rate = increment_noise(vehicle.gyros[0].variance)
    accelerometer = _accelerometer(vehicle)
    if accelerometer is None:
        return observability.whitened(effects[:, 3:], rate)
    nothing = np.zeros(3)
    known = Rotation(nothing, nothing, float(rate[0, 0]), nominal[6:9], np.zeros((3, 3)))
    arm = np.array(accelerometer.position) - known.center
    chosen = params.mass_params(Scenario(vehicle=vehicle, mass=MassBlock(compensation="transverse")))
    _, velocity = compensated(nothing, increment_noise(accelerometer.variance), arm, known, chosen)
    covariance = np.zeros((6, 6))
    covariance[:3, :3], covariance[3:, 3:] = velocity, rate
    return observability.whitened(effects, covariance)


def _alike(vehicle: Vehicle, seen: Array, n_pairs: int) -> list[dict[str, Any]]:
    names = vehicle.designations
    return [
        {"jets": [names[pair.first], names[pair.second]], "angle_rad": pair.angle, "opposed": pair.opposed}
        for pair in observability.pairs(seen)[:n_pairs]
    ]


def _isolable(vehicle: Vehicle, seen: Array) -> list[dict[str, Any]]:
    names, margin = vehicle.designations, DetectorBlock().margin
    found = {kind: observability.smallest_isolable(seen, margin, lost=kind == "lost") for kind in ("on", "lost")}
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


def _notes(vehicle: Vehicle) -> list[str]:
    notes = []
    if not vehicle.accelerometers:
        notes.append("no accelerometer: the mass cannot be observed")
    forces = observability.span(vehicle.thrusts)
    if len(forces) == 1:
        line = _vector(forces[0])
        notes.append(
            f"all forces lie along one line, {line}: where the center of mass lies along it cannot be observed"
        )
    elif len(forces) == 2:
        normal = _vector(np.cross(*forces))
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
    axes = observability.span(torques)
    if len(axes) == 1:
        notes.append(f"all torques lie along one line, {_vector(axes[0])}: about no other axis is there control")
    elif len(axes) == 2:
        normal = _vector(np.cross(*axes))
        notes.append(f"all torques lie in one plane, normal to {normal}: no control about that axis")
    return notes


def _vector(direction: Array) -> str:
    """A unit vector in words: an axis where it is one, its largest element positive."""
    direction = direction * np.sign(direction[np.abs(direction).argmax()])
    axis = int(direction.argmax())
    if direction[axis] > 1.0 - 1e-9:
        return "xyz"[axis]
    return "(" + ", ".join(f"{element + 0.0:.3g}" for element in np.round(direction, 6)) + ")"


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None

"""Names, units and labels of the logged signals, in one place for files, plots and tables."""

from __future__ import annotations

import math
import re
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.maths.estimation.detector import STATUS
from massprop_drake.maths.estimation.faults.fault_report import HYPOTHESIS_REPORT
from massprop_drake.maths.estimation.filters.joint import JOINT_REPORT
from massprop_drake.maths.estimation.filters.pose import POSE_REPORT
from massprop_drake.maths.mass_properties import NAMES

Array = NDArray[np.float64]

AXES = ("x", "y", "z")


class Signal(NamedTuple):
    """A logged quantity.

    Attributes:
        name: as in `Run.signals` and files.
        label: what it is, in words.
        unit: with {length}, {mass}, {force} for the vehicle's units; "-" for none.
        components: names of its columns; empty for one per jet.
    """

    name: str
    label: str
    unit: str
    components: tuple[str, ...]


_INVERSE_INERTIA = "1/({mass}-{length}^2)"
_MASS_PROPERTY_UNITS = (_INVERSE_INERTIA,) * 6 + ("{length}",) * 3 + ("1/{mass}",)
_MIXED = "; ".join((_INVERSE_INERTIA + " (6)", "{length} (3)", "1/{mass} (1)"))

SIGNALS = {
    signal.name: signal
    for signal in (
        Signal("rate", "angular rate", "rad/s", AXES),
        Signal("attitude", "attitude quaternion q_NB", "-", ("w", "x", "y", "z")),
        Signal("position", "position of the center of mass", "{length}", AXES),
        Signal("velocity", "velocity of the center of mass", "{length}/s", AXES),
        Signal("truth", "true mass properties", _MIXED, NAMES),
        Signal("command", "commanded fraction", "-", ()),
        Signal("command_onset", "how long after the beginning of the coming sample each jet opens", "s", ()),
        Signal("thrust", "thrust, mean over the coming sample", "{force}", ()),
        Signal("torque", "torque about the center of mass", "{length}-{force}", AXES),
        Signal("force", "force", "{force}", AXES),
        Signal("gap", "1: no row of the record, put in where rows are missing", "-", ("gap",)),
        Signal(
            "outside_wrench",
            "known outside torque about the vehicle origin, and force",
            "{length}-{force} (3); {force} (3)",
            (*(f"torque_{a}" for a in AXES), *(f"force_{a}" for a in AXES)),
        ),
        Signal("hand_controllers", "hand controllers", "-", tuple(f"{c}_{a}" for c in ("rhc", "thc") for a in AXES)),
        Signal("attitude_error", "attitude error in hold", "rad", AXES),
        Signal(
            "request",
            "rate-change request",
            "rad/s (3); {length}/s (3); s; -",
            (*(f"dw_{a}" for a in AXES), *(f"dv_{a}" for a in AXES), "time_limit", "urgency"),
        ),
        Signal("selection_counts", "jet selection", "-", ("solved", "reduced", "closest", "granted")),
        Signal("angular_impulse", "angular impulse about the vehicle origin", "{force}-{length}-s", AXES),
        Signal("linear_impulse", "linear impulse", "{force}-s", AXES),
        Signal("usable", "steady combination of jets", "-", ("usable",)),
        Signal("firing", "any jet commanded", "-", ("firing",)),
        Signal("estimate", "estimated mass properties", _MIXED, NAMES),
        Signal("standard_deviation", "1-sigma of the estimates", _MIXED, NAMES),
        Signal("converged", "estimates may be acted on", "-", ("converged",)),
        Signal("rotation_innovation", "innovation of the rotation filter", "rad/s", AXES),
        Signal("rotation_innovation_std", "1-sigma of it by the filter's covariance", "rad/s", AXES),
        Signal("rotation_nis", "NIS of the rotation filter", "-", ("nis",)),
        Signal("rotation_used", "sample used by the rotation filter", "-", ("used",)),
        Signal("rotation_jump", "covariance incremented", "-", ("jump",)),
        Signal("coupling_subtracted", "dynamic coupling subtracted", "-", ("subtracted",)),
        Signal("mass_innovation", "innovation of the mass filter", "{length}/s", AXES),
        Signal("mass_innovation_std", "1-sigma of it by the filter's covariance", "{length}/s", AXES),
        Signal("mass_nis", "NIS of the mass filter", "-", ("nis",)),
        Signal("mass_used", "sample used by the mass filter", "-", ("used",)),
        Signal("mass_jump", "jump of 1/m found", "-", ("jump",)),
        Signal("out_of_use", "jets out of use (1), left in though in question (-1)", "-", ()),
        *(
            Signal(name, row.label, row.unit, (row.component or name,))
            for layout in (JOINT_REPORT, POSE_REPORT, STATUS, HYPOTHESIS_REPORT)
            for name, row in layout.logged.items()
        ),
        Signal("position_estimate", "estimated position of the center of mass", "{length}", AXES),
        Signal("velocity_estimate", "estimated velocity of the center of mass", "{length}/s", AXES),
        Signal("attitude_estimate", "estimated attitude quaternion", "-", ("w", "x", "y", "z")),
        Signal("rate_estimate", "estimated angular rate", "rad/s", AXES),
        Signal("thrust_factor", "acceleration by each jet over what it would nominally be", "-", ()),
        Signal("thrust_factor_std", "1-sigma of it", "-", ()),
        Signal("drag_rate", "drag over mass, angular drag over inertia", "1/s", ("translation", "rotation")),
        Signal("drag_rate_std", "1-sigma of it", "1/s", ("translation", "rotation")),
        Signal("heading_turn", "angular acceleration that goes with the heading", "rad/s^2", ("cosine", "sine")),
        Signal("heading_turn_std", "1-sigma of it", "rad/s^2", ("cosine", "sine")),
        Signal("jump_position", "where the mass of a jump was gained", "{length}", AXES),
        Signal("jump_position_std", "1-sigma of it", "{length}", AXES),
        Signal("likelihood", "likelihood argument", "-", ()),
        Signal("failure_magnitude", "estimated magnitude of a failure", "{force}", ()),
        Signal("known_force", "known force of a failed jet", "{force}", ()),
        Signal("known_force_variance", "variance of it", "{force}^2", ()),
        Signal("fault_probability", "probability that a jet has failed", "-", ()),
        Signal(
            "fault_mode",
            "likeliest mode of its failure: 1 stuck on, 2 leak, 3 stuck off, 4 loss, 5 drifting, 6 intermittent",
            "-",
            (),
        ),
        Signal("fault_force", "force of its failure by the likeliest hypothesis with one", "{force}", ()),
        Signal("fault_force_std", "1-sigma of it", "{force}", ()),
        Signal(
            "verdict", "what is said of a jet: 1 failed, 2 one of a group, 3 changed, 4 withdrawn, 5 erratic", "-", ()
        ),
        Signal("verdict_magnitude", "force of that jet's failure", "{force}", ()),
        Signal("verdict_std", "1-sigma of it", "{force}", ()),
        Signal("verdict_onset", "when it began", "s", ()),
        Signal(
            "verdict_group", "what names it: 1 the first thing said of jets, 2 the second, 4 the third, summed", "-", ()
        ),
        Signal("verdict_place", "place in its group, 1: the likeliest", "-", ()),
        Signal("verdict_apart_by", "index of the jet that, fired alone, would tell its group apart", "-", ()),
        Signal("verdict_apart_after", "time without any jet that would tell its group apart", "s", ()),
    )
}

# The ten parameters as people write them
SYMBOLS = ("Ixx⁻¹", "Iyy⁻¹", "Izz⁻¹", "Iyz⁻¹", "Ixz⁻¹", "Ixy⁻¹", "x_cm", "y_cm", "z_cm", "1/m")


def gyro_signal(name: str) -> Signal:
    """Returns the signal description (name, columns, unit) of a gyro package's readings."""
    return Signal(name, f"reading of {name}", "rad/s", AXES)


def accelerometer_signal(name: str) -> Signal:
    """Returns the signal description of an integrating-accelerometer package's readings."""
    return Signal(name, f"reading of {name}", "{length}/s", AXES)


def pose_signal(name: str) -> Signal:
    """Returns the signal description of a pose sensor's readings, position and attitude in a fixed frame."""
    return Signal(name, f"reading of {name}", "{length} (3); - (4)", (*AXES, *(f"q{part}" for part in "wxyz")))


def velocity_signal(name: str) -> Signal:
    """Returns the signal description of a velocity sensor's readings in a fixed frame."""
    return Signal(name, f"reading of {name}", "{length}/s", AXES)


def wheel_signal(name: str) -> Signal:
    """Returns the signal description of a reaction wheel's measured speed."""
    return Signal(name, f"speed of {name} as it is read", "rad/s", ("speed",))


def engine_signal(name: str, *, has_gimbal: bool) -> Signal:
    """Returns the signal description of an engine's measured level and, with a gimbal, its angles."""
    angles, unit = (("gimbal_1", "gimbal_2"), "- (1); rad (2)") if has_gimbal else ((), "-")
    return Signal(name, f"{name} as it is read", unit, ("level", *angles))


PROPELLANT = "propellant"
JOINTS = "joint_positions"


def propellant_signal(tanks: tuple[str, ...]) -> Signal:
    """Returns the signal description of the true propellant in named tanks."""
    return Signal(PROPELLANT, "propellant in the tank", "{mass}", tanks)


def joint_signal(columns: tuple[str, ...], units: tuple[str, ...]) -> Signal:
    """Returns the signal description of joint positions of a multibody plant.

    Args:
        columns: their names.
        units: of each.
    """
    return Signal(JOINTS, "positions of the joints", "; ".join(dict.fromkeys(units)), columns)


AGAINST = "against."  # begins the names of what a simulation beside a record reads


def simulated_signal(package: Signal) -> Signal:
    """Returns the signal description of simulated readings in place of a package's recorded ones."""
    return package._replace(name=AGAINST + package.name, label=f"{package.label} in the simulation")


_OWN = re.compile(r"[^./\\]+\.[^./\\]+")


def is_user_signal(name: str) -> bool:
    """Tests whether a signal's name is that of a user's own output port, `<system>.<port>`."""
    return _OWN.fullmatch(name) is not None


def user_signal(name: str, size: int) -> Signal:
    """Returns the signal description of an output port of a user's own system."""
    return Signal(
        name, f"output {name.rpartition('.')[2]} of {name.rpartition('.')[0]}", "-", tuple(map(str, range(size)))
    )


def fill_unit_template(unit: str, names: dict[str, str]) -> str:
    """Returns a unit in the vehicle's unit names: {length}/s becomes ft/s.

    Args:
        unit: template of a `Signal`.
        names: of the units of length, mass and force, as `Vehicle.unit_names`.
    """
    return unit.format(**names)


def mass_property_units(names: dict[str, str]) -> tuple[str, ...]:
    """Returns the units of the ten parameters, in order, in the vehicle's unit system."""
    return tuple(fill_unit_template(unit, names) for unit in _MASS_PROPERTY_UNITS)


def format_with_deviation(value: float, deviation: float) -> str:
    """Formats a signed value with its 1-sigma, rounded to two digits of the latter: '+868.810 ± 0.089'."""
    digits = max(0, 1 - math.floor(math.log10(deviation))) if deviation > 0.0 else 3
    return f"{value:+.{digits}f} ± {deviation:.{digits}f}"

"""Flights of a servicer with something that moves inside: slosh or panels, by Drake's MultibodyPlant."""

from __future__ import annotations

import re
from importlib import resources
from typing import Any

import numpy as np

from flights.flight import Flight, Random, failure, setting
from massprop_drake import load_scenario
from massprop_drake.inputs.moving import Slosh

_JOINTS = {"servicer_slosh": ("slosh_x", "slosh_y"), "servicer_panel": ("hinge_left", "hinge_right")}


_TURNED = 0.03  # rad: 1-sigma of a joint at the start
_OFF = 0.05  # 1-sigma by which a frequency is stated wrong
_LEAK, _LEAKS_S = 0.05, (25.0, 45.0)  # N: 5 % of a thruster; when it may begin


def inside(
    random: Random,
    number: int,
    *,
    name: str,
    told: tuple[float, float] | None = None,
    stated: bool = False,
    leaks: bool = False,
) -> Flight:
    """Draws frequency and damping, where it stands at the start, thrusts off by 1 % and the maneuver's times.

    Args:
        random: to draw with.
        number: of the flight.
        name: of a bundled scenario.
        told: walks of rate and velocity, rad/s/sqrt(s) and m/s/sqrt(s), at the model's own frequency, with which they
            grow; None: nothing is told.
        stated: whether what moves is, its frequency off by as much as is said.
        leaks: whether a jet begins to leak.
    """
    ratio = float(random.choice([0.8, 1.0, 1.5, 2.5]))
    ratio = min(ratio, 1.0) if stated and name == "servicer_panel" else ratio  # faster ones cannot be stated
    damping = float(random.choice([0.5, 1.0, 2.5]))
    starts = [{"joint": joint, "position": float(random.normal(0.0, _TURNED))} for joint in _JOINTS[name]]
    shifts = random.uniform(-0.4, 0.4, len(load_scenario(name).maneuver)).round(2)
    maneuver = [
        {**window.model_dump(), "start_s": window.start_s + shift, "end_s": window.end_s + shift}
        for window, shift in zip(load_scenario(name).maneuver, shifts.tolist(), strict=True)
    ]
    settings = [
        setting("plant.model", model(name, ratio, damping)),
        setting("plant.joints", starts),
        setting("maneuver", maneuver),
        "plant.thrust_dispersion=0.01",
    ]
    if told is not None:
        settings += [f"joint.rate_walk={ratio * told[0]:g}", f"joint.velocity_walk={ratio * told[1]:g}"]
    off = 1.0 + _OFF * float(random.standard_normal())
    if stated:
        settings.append(setting("moving", _stated(name, ratio * off, damping)))
    if leaks:
        jets = load_scenario(name).vehicle_data.designations
        leak = failure("leak", str(random.choice(jets)), float(random.uniform(*_LEAKS_S)), _LEAK)
        settings.append(setting("failures", [leak]))
    return Flight(name, tuple(settings))


def _stated(name: str, frequency: float, damping: float) -> list[dict[str, Any]]:
    """Returns the parts of a scenario that states them, with other springs and dampers."""
    parts = []
    for part in load_scenario(f"{name}_stated").moving:
        told = part.model_dump(exclude_none=True)
        told["frequency_hz"] *= frequency
        told["damping"] *= damping
        turns = np.linalg.norm(np.subtract(part.position, part.pivot)) if isinstance(part, Slosh) else 1.0
        parts.append(told | {"start_std": float(_TURNED * turns)})
    return parts


def model(name: str, frequency: float, damping: float) -> str:
    """Returns the model of a scenario with other springs and dampers, in one line.

    Args:
        name: of the scenario.
        frequency, damping: over those of the model.
    """
    text = (resources.files("massprop_drake.scenarios") / "models" / f"{name}.sdf").read_text(encoding="utf-8")
    text = re.sub(r"<!--.*?-->|<\?xml.*?\?>", "", text, flags=re.DOTALL)
    for element, factor in (("spring_stiffness", frequency**2), ("damping", frequency * damping)):
        text = re.sub(
            rf"<{element}>([^<]+)<", lambda found, f=factor, e=element: f"<{e}>{float(found[1]) * f:.6g}<", text
        )
    return " ".join(text.split())

"""Flights of a servicer with something that moves inside: slosh or panels, by Drake's MultibodyPlant."""

from __future__ import annotations

import re
from importlib import resources

from flights.flight import Flight, Random, setting
from massprop_drake import load_scenario

_JOINTS = {"servicer_slosh": ("slosh_x", "slosh_y"), "servicer_panel": ("hinge_left", "hinge_right")}


def inside(random: Random, number: int, *, name: str, told: tuple[float, float] | None = None) -> Flight:
    """Draws frequency and damping, where it stands at the start, thrusts off by 1 % and the maneuver's times.

    Args:
        name: of a bundled scenario.
        told: walks of rate and velocity, rad/s/sqrt(s) and m/s/sqrt(s), at the model's own frequency, with which they
            grow; None: nothing is told.
    """
    ratio = float(random.choice([0.8, 1.0, 1.5, 2.5]))
    damping = float(random.choice([0.5, 1.0, 2.5]))
    starts = [{"joint": joint, "position": float(random.normal(0.0, 0.03))} for joint in _JOINTS[name]]
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
    return Flight(name, tuple(settings))


def model(name: str, frequency: float, damping: float) -> str:
    """The model of a scenario with other springs and dampers, in one line.

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

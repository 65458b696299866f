"""Output of a design as data, as words, as a page and as a folder."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from massprop_drake.display import figures, interactive, plotted
from massprop_drake.inputs.model import yaml_text
from massprop_drake.results.folder import Place, require_writable, whole_folder
from massprop_drake.studies.design import pictures
from massprop_drake.studies.design.found import Design, PairFound, TargetFound

_TEMPLATE = Path(__file__).parent / "design.html"
_END = "...\n"  # closes a YAML document


def as_data(made: Design) -> dict[str, Any]:
    """Returns a design as data for `design.json`."""
    vehicle = made.scenario.vehicle_data
    return {
        "vehicle": vehicle.name,
        "begins_s": made.begins_s,
        "duration_s": made.duration_s,
        "firing_s": made.firing_s,
        "propellant": made.propellant,
        "largest": {"rate": made.rate, "angle": made.angle, "displacement": made.displacement},
        "targets": [one._asdict() for one in made.targets],
        "suspects": [one._asdict() for one in made.pairs],
        "expected_s": dict(made.expected_s),
        "named_s": {jet: list(times) for jet, times in made.named_s.items()},
        "course": {name: values.tolist() for name, values in made.course._asdict().items()},
        "front": {name: values.tolist() for name, values in made.front._asdict().items()},
    }


def verdict(made: Design) -> list[dict[str, Any]]:
    """Returns the verdict on a design as sentences, each with `good`: True, False, or None for no judgment."""
    vehicle = made.scenario.vehicle_data
    unit = vehicle.unit_names["mass"]
    lines: list[dict[str, Any]] = [
        {
            "good": None,
            "text": f"{made.duration_s:.3g} s with {made.firing_s:.3g} s of firings, {made.propellant:.3g} {unit} of "
            f"propellant; at most {math.degrees(made.rate):.3g} deg/s, {math.degrees(made.angle):.3g} deg and "
            f"{made.displacement:.3g} {vehicle.unit_names['length']} from where it began.",
        }
    ]
    for one in made.targets:
        flown = f", flown {_spread(one)}" if one.flown else ""
        lines.append(
            {
                "good": all(value <= 1.05 * one.asked for value in one.flown) if one.flown else None,
                "text": f"{one.name}, {one.value:.4g} {one.unit}: 1-sigma {one.predicted:.3g}{_percent(one)} "
                f"predicted, {one.asked:.3g} asked{flown}; no firing makes it less than {one.floor:.2g}.",
            }
        )
    by_jet: dict[str, list[PairFound]] = {}
    for pair in made.pairs:
        by_jet.setdefault(pair.jet, []).append(pair)
    for jet, pairs in by_jet.items():
        after = [pair.after_s for pair in pairs]
        told = "not told apart" if None in after else f"told after {max(filter(None, after), default=0.0):.2g} s"
        names = [pair.other for pair in pairs if pair.other]
        others = ", ".join(names[:4]) + (" and others" if len(names) > 4 else "")
        times = made.named_s.get(jet, ())
        named = [f"{time:.2g}" if time is not None else "never" for time in times]
        expected_s = made.expected_s[jet]
        when = "not" if expected_s is None else f"after {expected_s:.2g} s"
        flown = f"; named after {', '.join(named)} s in flights" if named else ""
        text = f"{jet} is {told} from {others}, from all other jets {when}{flown}."
        lines.append({"good": None not in times if times else None, "text": text})
    return lines


def _percent(one: TargetFound) -> str:
    """Formats a target's predicted 1-sigma in percent, of mass and moments of inertia alone."""
    scaled = one.name == "mass" or one.name in ("Ixx", "Iyy", "Izz")
    return f" ({100.0 * one.predicted / one.value:.2g} %)" if scaled else ""


def _spread(one: TargetFound) -> str:
    """Formats the range of a target's 1-sigma over the flights."""
    return f"{min(one.flown):.3g} to {max(one.flown):.3g}"


def firings(made: Design) -> list[tuple[str, float, float]]:
    """Lists the maneuver's commands in order of time: text of jet or wheel with torque, start and end, s."""
    return [
        (f"{one.name} {one.torque:+.3g}" if one.torque else one.name, one.start_s, one.end_s) for one in made.commanded
    ]


def page(made: Design) -> str:
    """Returns a design's page as the text of one HTML file that needs no network."""
    vehicle = made.scenario.vehicle_data
    content = {
        "title": f"Maneuver for {vehicle.name}",
        "about": "Predicted by the joint filter's own recursion along the firings, and flown in simulation.",
        "verdict": verdict(made),
        "targets": [
            {
                "name": f"{one.name}, {one.unit}",
                "numbers": [f"{value:.4g}" for value in (one.value, one.before, one.asked, one.predicted, one.floor)],
                "flown": _spread(one) if one.flown else "",
                "errors": f"{np.sqrt(np.mean(np.square(one.errors))):.3g}" if one.errors else "",
            }
            for one in made.targets
        ],
        "pairs": [
            (
                one.jet,
                one.other or "nothing",
                f"{one.force:.3g}",
                "not" if one.after_s is None else f"{one.after_s:.2g}",
            )
            for one in made.pairs
        ],
        "force": vehicle.unit_names["force"],
        "firings": [(name, f"{start:.3f}", f"{end - start:.3g}") for name, start, end in firings(made)],
        "plots": [interactive.plotly_figure(plot) for plot in pictures.plots(made, vehicle)],
    }
    return plotted.page(_TEMPLATE, content)


def save(
    made: Design, folder: str | Path | Place, *, force: bool = False, draw: bool = True, report: bool = True
) -> Path:
    """Writes a design's folder, whole or not at all, and returns its path.

    Args:
        made: see `Design`.
        folder: where to write; an earlier design that is unchanged is replaced.
        force: keep what is there as `<folder>.1`, `<folder>.2`, ....
        draw: whether figures are drawn.
        report: whether `design.html` is written.

    Raises:
        InputError: when the folder holds anything else, or cannot be written.
    """
    place = folder if isinstance(folder, Place) else require_writable(Path(folder), force=force)
    with whole_folder(place) as partial:
        (partial / "scenario.yaml").write_text(yaml_text(made.scenario) + _END, encoding="utf-8")
        text = json.dumps(as_data(made), indent=2, allow_nan=False) + "\n"
        (partial / "design.json").write_text(text, encoding="utf-8")
        if draw:
            (partial / "figures").mkdir()
            for plot in pictures.plots(made, made.scenario.vehicle_data):
                figures.draw_plot(plot).savefig(partial / "figures" / f"{plot.name}.png")
        if report:
            (partial / "design.html").write_text(page(made), encoding="utf-8")
    return place.shown

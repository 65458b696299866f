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


def as_data(design: Design) -> dict[str, Any]:
    """Returns a design as data for `design.json`."""
    vehicle = design.scenario.vehicle_data
    return {
        "vehicle": vehicle.name,
        "begins_s": design.begins_s,
        "duration_s": design.duration_s,
        "firing_s": design.firing_s,
        "propellant": design.propellant,
        "largest": {"rate": design.rate, "angle": design.angle, "displacement": design.displacement},
        "targets": [item._asdict() for item in design.targets],
        "suspects": [item._asdict() for item in design.pairs],
        "expected_s": dict(design.expected_s),
        "named_s": {jet: list(times) for jet, times in design.named_s.items()},
        "course": {name: values.tolist() for name, values in design.course._asdict().items()},
        "front": {name: values.tolist() for name, values in design.front._asdict().items()},
    }


def verdict(design: Design) -> list[dict[str, Any]]:
    """Returns the verdict on a design as sentences, each with `good`: True, False, or None for no judgment."""
    vehicle = design.scenario.vehicle_data
    unit = vehicle.unit_names["mass"]
    lines: list[dict[str, Any]] = [
        {
            "good": None,
            "text": f"{design.duration_s:.3g} s with {design.firing_s:.3g} s of firings, {design.propellant:.3g} "
            f"{unit} of propellant; at most {math.degrees(design.rate):.3g} deg/s, {math.degrees(design.angle):.3g} "
            f"deg and {design.displacement:.3g} {vehicle.unit_names['length']} from where it began.",
        }
    ]
    for target in design.targets:
        flown = f", flown {_spread(target)}" if target.flown else ""
        lines.append(
            {
                "good": all(value <= 1.05 * target.asked for value in target.flown) if target.flown else None,
                "text": f"{target.name}, {target.value:.4g} {target.unit}: 1-sigma {target.predicted:.3g}"
                f"{_percent(target)} predicted, {target.asked:.3g} asked{flown}; no firing makes it less "
                f"than {target.floor:.2g}.",
            }
        )
    by_jet: dict[str, list[PairFound]] = {}
    for pair in design.pairs:
        by_jet.setdefault(pair.jet, []).append(pair)
    for jet, pairs in by_jet.items():
        after = [pair.after_s for pair in pairs]
        separation = "not told apart" if None in after else f"told after {max(filter(None, after), default=0.0):.2g} s"
        names = [pair.other for pair in pairs if pair.other]
        others = ", ".join(names[:4]) + (" and others" if len(names) > 4 else "")
        times = design.named_s.get(jet, ())
        named = [f"{time:.2g}" if time is not None else "never" for time in times]
        expected_s = design.expected_s[jet]
        when = "not" if expected_s is None else f"after {expected_s:.2g} s"
        flown = f"; named after {', '.join(named)} s in flights" if named else ""
        text = f"{jet} is {separation} from {others}, from all other jets {when}{flown}."
        lines.append({"good": None not in times if times else None, "text": text})
    return lines


def _percent(target: TargetFound) -> str:
    """Formats a target's predicted 1-sigma in percent, of mass and moments of inertia alone."""
    scaled = target.name == "mass" or target.name in ("Ixx", "Iyy", "Izz")
    return f" ({100.0 * target.predicted / target.value:.2g} %)" if scaled else ""


def _spread(target: TargetFound) -> str:
    """Formats the range of a target's 1-sigma over the flights."""
    return f"{min(target.flown):.3g} to {max(target.flown):.3g}"


def firings(design: Design) -> list[tuple[str, float, float]]:
    """Lists the maneuver's commands in order of time: text of jet or wheel with torque, start and end, s."""
    return [
        (f"{one.name} {one.torque:+.3g}" if one.torque else one.name, one.start_s, one.end_s)
        for one in design.commanded
    ]


def page(design: Design) -> str:
    """Returns a design's page as the text of one HTML file that needs no network."""
    vehicle = design.scenario.vehicle_data
    content = {
        "title": f"Maneuver for {vehicle.name}",
        "about": "Predicted by the joint filter's own recursion along the firings, and flown in simulation.",
        "verdict": verdict(design),
        "targets": [
            {
                "name": f"{one.name}, {one.unit}",
                "numbers": [f"{value:.4g}" for value in (one.value, one.before, one.asked, one.predicted, one.floor)],
                "flown": _spread(one) if one.flown else "",
                "errors": f"{np.sqrt(np.mean(np.square(one.errors))):.3g}" if one.errors else "",
            }
            for one in design.targets
        ],
        "pairs": [
            (
                one.jet,
                one.other or "nothing",
                f"{one.force:.3g}",
                "not" if one.after_s is None else f"{one.after_s:.2g}",
            )
            for one in design.pairs
        ],
        "force": vehicle.unit_names["force"],
        "firings": [(name, f"{start:.3f}", f"{end - start:.3g}") for name, start, end in firings(design)],
        "plots": [interactive.plotly_figure(plot) for plot in pictures.plots(design, vehicle)],
    }
    return plotted.page(_TEMPLATE, content)


def save(
    design: Design, folder: str | Path | Place, *, force: bool = False, draw: bool = True, report: bool = True
) -> Path:
    """Writes a design's folder, whole or not at all, and returns its path.

    Args:
        design: see `Design`.
        folder: where to write; an earlier design that is unchanged is replaced.
        force: keep what is there as `<folder>.1`, `<folder>.2`, ....
        draw: whether figures are drawn.
        report: whether `design.html` is written.

    Raises:
        InputError: when the folder holds anything else, or cannot be written.
    """
    place = folder if isinstance(folder, Place) else require_writable(Path(folder), force=force)
    with whole_folder(place) as partial:
        (partial / "scenario.yaml").write_text(yaml_text(design.scenario) + _END, encoding="utf-8")
        text = json.dumps(as_data(design), indent=2, allow_nan=False) + "\n"
        (partial / "design.json").write_text(text, encoding="utf-8")
        if draw:
            (partial / "figures").mkdir()
            for plot in pictures.plots(design, design.scenario.vehicle_data):
                figures.draw_plot(plot).savefig(partial / "figures" / f"{plot.name}.png")
        if report:
            (partial / "design.html").write_text(page(design), encoding="utf-8")
    return place.shown

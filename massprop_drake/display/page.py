"""The report of a run: one self-contained HTML page that begins with the verdict."""

from __future__ import annotations

import math
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

from massprop_drake.display import events, interactive, plots, templates
from massprop_drake.inputs.model import yaml_text
from massprop_drake.maths.estimation.identifiability import Flag
from massprop_drake.maths.mass_properties import MASS_RECIPROCAL
from massprop_drake.results import events as said
from massprop_drake.results import unconfirmed
from massprop_drake.results.detections import DetectionRecord, remarks, size
from massprop_drake.results.folder import write_page
from massprop_drake.results.identifiability import in_words
from massprop_drake.results.summary import Summary
from massprop_drake.signals import SYMBOLS, mass_property_units

if TYPE_CHECKING:
    from massprop_drake.results.run import Run

_HERE = Path(__file__).parent
# plotly writes its own styles, and turns a plot into a picture for the reader to save
_PLOTLY = {"style-src": "'unsafe-inline'", "img-src": "data: blob:"}


def write_report(run: Run, path: str | Path, *, replay: str | None = None, force: bool = False) -> Path:
    """Writes the report of a run.

    Args:
        run: simulated, or estimated from telemetry.
        path: the HTML file to write; it appears whole or not at all, and replaces nothing but a page of ours.
        replay: path of the replay relative to the report; None: the report links to none.
        force: keep a file that is there and not ours as `<path>.1`, `<path>.2`, ....

    Raises:
        InputError: when a file is there that is not ours, or it cannot be written.
    """
    target = Path(path)
    write_page(target, report_html(run, replay=replay), force=force)
    return target


def summary_html(run: Run) -> str:
    """Returns the verdict and the table of ten parameters as HTML for a notebook."""
    content = {
        "title": f"{run.results.vehicle}: {run.results.scenario}",
        "verdict": _verdict(run.results),
        "parameters": _parameters(run),
    }
    return templates.fragment(_HERE / "summary.html", content)


def report_html(run: Run, *, replay: str | None = None) -> str:
    """Returns the report as the text of one HTML file that needs no network."""
    run = run.shown()
    results, scenario = run.results, run.scenario
    source = plots.source(run)
    described = {
        "time": interactive.times(run.time_s),
        "plots": [interactive.drawn(plot(source)) for plot in plots.available(source).values()],
    }
    units = scenario.vehicle_data.unit_names
    content = {
        "title": f"{results.vehicle}: {results.scenario}",
        "summary": run.summary,
        "units": units,
        "verdict": _verdict(results),
        "parameters": _parameters(run),
        "unidentified": in_words(results.identifiability, SYMBOLS),
        "mass": _mass(run),
        "detections": [_detection(entry, units) for entry in results.detections],
        "events": [(f"{event.time_s:.2f} s", said.in_words(event, units)) for event in results.events],
        "unconfirmed": [unconfirmed.in_words(one) for one in results.unconfirmed],
        "untested": [f"{', '.join(one.jets)}: {one.reason}" for one in results.untested],
        "autopilot": _autopilot(run),
        "quality": _quality(results.data_quality or {}),
        "scenario": yaml_text(scenario),
        "replay": replay,
    }
    plotly = (resources.files("plotly") / "package_data" / "plotly.min.js").read_text(encoding="utf-8")
    return templates.page(
        _HERE / "report.html",
        content,
        data=described,
        styles=[(_HERE / "report.css").read_text(encoding="utf-8")],
        scripts=[plotly, *((_HERE / name).read_text(encoding="utf-8") for name in ("themed.js", "report.js"))],
        needs=_PLOTLY,
    )


def _verdict(results: Summary) -> list[dict[str, Any]]:
    """Writes the few sentences that a reader wants first; `good` is None where there is nothing to judge."""
    sentences: list[dict[str, Any]] = []

    def say(good: bool | None, text: str) -> None:
        sentences.append({"good": good, "text": text})

    known = [one for one in results.parameters if math.isfinite(one.truth) and math.isfinite(one.estimate)]
    if known:
        inside = sum(one.within_three_sigma for one in known)
        say(inside == len(known), f"{inside} of {len(known)} parameters lie within 3 sigma of the truth.")
    else:
        say(None, "The truth is unknown: the table gives what was learned, and how surely.")
    for flag, words in (
        ("not_excited", "the start still tells more than the flight"),
        ("weak", "less is known than is asked"),
    ):
        of_it = [symbol for symbol, one in zip(SYMBOLS, results.identifiability, strict=False) if one.flag == flag]
        if of_it:
            say(False, f"{', '.join(of_it)}: {words}; the reasons stand below the table.")
    if not math.isfinite(results.estimates[MASS_RECIPROCAL]):
        say(None, "The mass is not observable: no accelerometer was read.")
    declared = [entry for entry in results.detections if entry.withdrawn_s is None]
    if declared:
        say(False, "Found: " + "; ".join(events.headline(entry) for entry in declared) + ".")
    else:
        say(True, "No failed jet and no jump of the mass properties was found.")
    lying = list(dict.fromkeys(f"{one.sensor}_{one.axis}" for one in results.events if one.kind == "false_reading"))
    if lying:
        say(False, f"Read falsely: {', '.join(lying)}.")
    if any(one.kind == "unexplained" for one in results.events):
        say(False, "Something happened that no failed jet, no jump and no false reading explains.")
    if results.unconfirmed:
        least = max(results.unconfirmed, key=lambda one: one.statistic)
        jets = f", above all {' or '.join(least.jets)}" if least.jets else ""
        say(None, f"Suspected and not confirmed: {len(results.unconfirmed)}{jets}; see below.")
    if not results.derived.physically_possible:
        near = "; the nearest that one can have is in summary.json" if results.nearest_possible is not None else ""
        say(False, f"No rigid body can have the inertia that was estimated{near}.")
    for warning in (results.data_quality or {}).get("warnings", []):
        say(False, warning)
    return sentences


def _parameters(run: Run) -> list[dict[str, Any]]:
    """Formats the table of ten parameters."""
    rows = []
    units = mass_property_units(run.scenario.vehicle_data.unit_names)
    told = [(entry.flag, entry.bound) for entry in run.results.identifiability] or [("", None)] * len(SYMBOLS)
    for symbol, unit, one, (flag, bound) in zip(SYMBOLS, units, run.results.parameters, told, strict=True):
        there, known = math.isfinite(one.estimate), math.isfinite(one.truth)
        relative = there and one.estimate != 0.0
        rows.append(
            {
                "symbol": symbol,
                "unit": unit,
                "estimate": f"{one.estimate:.6g}" if there else "not observable",
                "truth": f"{one.truth:.6g}" if known else "unknown",
                "error": f"{one.percent_error:+.4f} %" if math.isfinite(one.percent_error) else "",
                "sigma": f"{one.standard_deviation:.3g}" if there else "",
                "relative": f"{100.0 * one.standard_deviation / abs(one.estimate):.3g} %" if relative else "",
                "bound": "" if bound is None else f"{bound:.3g}",
                "inside": one.within_three_sigma if there and known and flag != Flag.NOT_EXCITED else None,
                "flag": flag.replace("_", " "),
            }
        )
    return rows


def _mass(run: Run) -> list[str]:
    """Formats the mass and inertia that the estimates imply, with their 1-sigma."""
    derived, units = run.results.derived, run.scenario.vehicle_data.unit_names
    lines = []
    if derived.mass is not None:
        lines.append(f"mass {derived.mass:.6g} ± {derived.mass_std:.3g} {units['mass']}")
    if derived.inertia is not None and derived.inertia_std is not None:
        unit = f"{units['mass']}-{units['length']}^2"
        for name, element in {
            "Ixx": (0, 0), "Iyy": (1, 1), "Izz": (2, 2), "Ixy": (0, 1), "Ixz": (0, 2), "Iyz": (1, 2)
        }.items():  # fmt: skip
            lines.append(f"{name} {derived.inertia[element]:.6g} ± {derived.inertia_std[element]:.3g} {unit}")
    return lines


def _detection(entry: DetectionRecord, units: Mapping[str, str]) -> dict[str, str]:
    """Formats a detection: what failed, when, by how much, and how sure that is."""
    return {
        "what": events.headline(entry),
        "since": f"{entry.onset_s:.2f} s",
        "declared": f"{entry.time_s:.2f} s",
        "cluster": "" if entry.cluster is None else str(entry.cluster),
        "magnitude": size(entry, units),
        "sure": f"{entry.statistic:.4g} after {entry.alarms} alarm{'s' if entry.alarms != 1 else ''}",
        "remarks": "; ".join(remarks(entry)),
    }


def _autopilot(run: Run) -> list[str]:
    """Describes in sentences what the autopilot did."""
    found, units = run.results.autopilot, run.scenario.vehicle_data.unit_names
    lines = [f"{found.firings} firings, {found.propellant_mass:.3g} {units['mass']} of propellant."]
    if found.jets_out_of_use:
        lines.append(f"Took out of use: {', '.join(found.jets_out_of_use)}.")
    if found.jets_left_in:
        lines.append(f"Left in use though in question, since control needs them: {', '.join(found.jets_left_in)}.")
    if found.lp_infeasible:
        lines.append(f"{found.lp_infeasible} of {found.lp_solves} requests were beyond the jets' reach.")
    return lines


def _quality(quality: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Formats the findings about a record as rows of heading and text; empty ones are left out."""
    rows = []
    for key, value in quality.items():
        heading = key.replace("_", " ")
        if key == "warnings":  # they are in the verdict
            continue
        if isinstance(value, dict) and any(isinstance(part, dict) for part in value.values()):
            rows += [(f"{heading}, {name}", _in_words(part)) for name, part in value.items()]
        else:
            rows.append((heading, _in_words(value)))
    return [(heading, text) for heading, text in rows if text]


def _in_words(value: Any) -> str:
    """Formats a value of the summary; empty for zero, null and empty values."""
    if isinstance(value, dict):
        parts = ((name.replace("_", " "), _in_words(part)) for name, part in value.items())
        return ", ".join(f"{name} {text}" for name, text in parts if text)
    if isinstance(value, list):
        return "; ".join(_in_words(part) for part in value)
    if isinstance(value, bool):
        return "yes" if value else ""
    if not value:
        return ""
    return f"{value:.6g}" if isinstance(value, float) else str(value)

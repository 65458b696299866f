"""The report of a run: one self-contained HTML page that begins with the verdict."""

from __future__ import annotations

import json
import math
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jinja2

from massprop_drake.display import events, interactive, plots
from massprop_drake.inputs.model import yaml_text
from massprop_drake.results.folder import write_whole
from massprop_drake.results.summary import from_names
from massprop_drake.signals import SYMBOLS, mass_property_units, with_deviation

if TYPE_CHECKING:
    from massprop_drake.results.run import Run


def write_report(run: Run, path: str | Path, *, replay: str | None = None) -> Path:
    """Writes the report of a run.

    Args:
        run: simulated, or estimated from telemetry.
        path: the HTML file to write; it appears whole or not at all.
        replay: path of the replay relative to the report; None: the report links to none.
    """
    target = Path(path)
    write_whole(target, report_html(run, replay=replay))
    return target


def summary_html(run: Run) -> str:
    """Returns the verdict and the table of ten parameters as HTML for a notebook."""
    return (
        _environment()
        .get_template("summary.html")
        .render(
            title=f"{run.summary['vehicle']}: {run.summary['scenario']}",
            verdict=_verdict(run.summary),
            parameters=_parameters(run),
        )
    )


def _environment() -> jinja2.Environment:
    loader = jinja2.FileSystemLoader(Path(__file__).parent)
    return jinja2.Environment(loader=loader, autoescape=True, trim_blocks=True, lstrip_blocks=True)


def report_html(run: Run, *, replay: str | None = None) -> str:
    """Returns the report as the text of one HTML file that needs no network."""
    run = run.shown()
    summary, scenario = run.summary, run.scenario
    source = plots.source(run)
    described = {
        "time": interactive.times(run.time_s),
        "plots": [interactive.drawn(plot(source)) for plot in plots.available(source).values()],
    }
    page: str = (
        _environment()
        .get_template("page.html")
        .render(
            title=f"{summary['vehicle']}: {summary['scenario']}",
            summary=summary,
            units=scenario.vehicle_data.unit_names,
            verdict=_verdict(summary),
            parameters=_parameters(run),
            mass=_mass(run),
            detections=[
                _detection(entry, scenario.vehicle_data.unit_names["force"]) for entry in summary["detections"]
            ],
            autopilot=_autopilot(run),
            quality=_quality(summary.get("data_quality") or {}),
            scenario=yaml_text(scenario),
            replay=replay,
            # between script tags '<' could end them, whatever the names in a user's files are
            plots=json.dumps(described, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c"),
            plotly=(resources.files("plotly") / "package_data" / "plotly.min.js").read_text(encoding="utf-8"),
        )
    )
    return page


def _verdict(summary: dict[str, Any]) -> list[dict[str, Any]]:
    """Writes the few sentences that a reader wants first; `good` is None where there is nothing to judge."""
    sentences: list[dict[str, Any]] = []

    def say(good: bool | None, text: str) -> None:
        sentences.append({"good": good, "text": text})

    estimates, truth = from_names(summary["estimates"]), from_names(summary["truth"])
    deviation = from_names(summary["standard_deviations"])
    known = [index for index in range(10) if math.isfinite(truth[index]) and math.isfinite(estimates[index])]
    if known:
        inside = sum(abs(estimates[index] - truth[index]) <= 3.0 * deviation[index] for index in known)
        sentences.append(
            {
                "good": inside == len(known),
                "text": f"{inside} of {len(known)} parameters lie within 3 sigma of the truth.",
            }
        )
    else:
        sentences.append(
            {"good": None, "text": "The truth is unknown: the table gives what was learned, and how surely."}
        )
    if not math.isfinite(estimates[9]):
        say(None, "The mass is not observable: no accelerometer was read.")
    declared = [entry for entry in summary["detections"] if entry["withdrawn_s"] is None]
    if declared:
        sentences.append(
            {"good": False, "text": "Found: " + "; ".join(events.headline(entry) for entry in declared) + "."}
        )
    else:
        sentences.append({"good": True, "text": "No failed jet and no jump of the mass properties was found."})
    if not summary["derived"]["physically_possible"]:
        say(False, "No rigid body can have the inertia that was estimated.")
    for warning in (summary.get("data_quality") or {}).get("warnings", []):
        say(False, warning)
    return sentences


def _parameters(run: Run) -> list[dict[str, Any]]:
    """Formats the table of ten parameters."""
    summary = run.summary
    keys = ("estimates", "truth", "standard_deviations", "percent_error")
    rows = []
    units = mass_property_units(run.scenario.vehicle_data.unit_names)
    for symbol, unit, estimate, truth, deviation, percent in zip(
        SYMBOLS, units, *(from_names(summary[key]) for key in keys), strict=True
    ):
        there, known = math.isfinite(estimate), math.isfinite(truth)
        rows.append(
            {
                "symbol": symbol,
                "unit": unit,
                "estimate": f"{estimate:.6g}" if there else "not observable",
                "truth": f"{truth:.6g}" if known else "unknown",
                "error": f"{percent:+.4f} %" if math.isfinite(percent) else "",
                "sigma": f"{deviation:.3g}" if there else "",
                "relative": f"{100.0 * deviation / abs(estimate):.3g} %" if there and estimate != 0.0 else "",
                "inside": bool(abs(estimate - truth) <= 3.0 * deviation) if there and known else None,
            }
        )
    return rows


def _mass(run: Run) -> list[str]:
    """Formats the mass and inertia that the estimates imply, with their 1-sigma."""
    derived, units = run.summary["derived"], run.scenario.vehicle_data.unit_names
    lines = []
    if derived["mass"] is not None:
        lines.append(f"mass {derived['mass']:.6g} ± {derived['mass_std']:.3g} {units['mass']}")
    if derived["inertia"] is not None:
        unit = f"{units['mass']}-{units['length']}^2"
        for name, (row, column) in {
            "Ixx": (0, 0), "Iyy": (1, 1), "Izz": (2, 2), "Ixy": (0, 1), "Ixz": (0, 2), "Iyz": (1, 2)
        }.items():  # fmt: skip
            value, deviation = derived["inertia"][row][column], derived["inertia_std"][row][column]
            lines.append(f"{name} {value:.6g} ± {deviation:.3g} {unit}")
    return lines


def _detection(entry: dict[str, Any], force: str) -> dict[str, str]:
    """Formats a detection: what failed, when, by how much, and how sure that is."""
    sure = "-" if entry["statistic"] is None else f"{entry['statistic']:.4g}"
    return {
        "what": events.headline(entry),
        "since": f"{entry['onset_s']:.2f} s",
        "declared": f"{entry['time_s']:.2f} s",
        "cluster": "" if entry["cluster"] is None else str(entry["cluster"]),
        "magnitude": ""
        if entry["magnitude"] is None
        else f"{with_deviation(entry['magnitude'], entry['magnitude_std'])} {force}",
        "sure": f"{sure} after {entry['alarms']} alarm{'s' if entry['alarms'] != 1 else ''}",
        "withdrawn": "" if entry["withdrawn_s"] is None else f"withdrawn at {entry['withdrawn_s']:.2f} s",
    }


def _autopilot(run: Run) -> list[str]:
    """Describes in sentences what the autopilot did."""
    found, units = run.summary["autopilot"], run.scenario.vehicle_data.unit_names
    lines = [f"{found['firings']} firings, {found['propellant_mass']:.3g} {units['mass']} of propellant."]
    if found.get("jets_out_of_use"):
        lines.append(f"Took out of use: {', '.join(found['jets_out_of_use'])}.")
    if found.get("jets_left_in"):
        lines.append(f"Left in use though in question, since control needs them: {', '.join(found['jets_left_in'])}.")
    if found.get("lp_infeasible"):
        lines.append(f"{found['lp_infeasible']} of {found['lp_solves']} requests were beyond the jets' reach.")
    return lines


def _quality(quality: dict[str, Any]) -> list[tuple[str, str]]:
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

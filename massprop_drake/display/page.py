"""Report of a run: one self-contained HTML page that begins with the verdict."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from massprop_drake.display import interactive, plots, templates
from massprop_drake.display.plot_source import PROMPT_S, Source, first_tested_s
from massprop_drake.errors import counted, moment
from massprop_drake.inputs.model import yaml_text
from massprop_drake.maths.mass_properties import MASS_RECIPROCAL
from massprop_drake.maths.signals import SYMBOLS
from massprop_drake.results import detections, table, unconfirmed
from massprop_drake.results import events as said
from massprop_drake.results.against import Against
from massprop_drake.results.consistency import CONSISTENT, INCONSISTENT, TOO_LITTLE, Consistency
from massprop_drake.results.detections import JUMP, DetectionRecord, remarks, size_in_words
from massprop_drake.results.fault_probabilities import format_probability
from massprop_drake.results.folder import write_page
from massprop_drake.results.identifiability_flags import in_words
from massprop_drake.results.summary import Summary

if TYPE_CHECKING:
    from massprop_drake.results.run_content import RunContent

_HERE = Path(__file__).parent


def write_report(run: RunContent, path: str | Path, *, replay: str | None = None, force: bool = False) -> Path:
    """Writes the report of a run as an HTML file and returns its path.

    Args:
        run: simulated, or estimated from telemetry.
        path: the HTML file to write; it appears whole or not at all, and replaces nothing but a report of ours.
        replay: path of the replay relative to the report; None: the report links to none.
        force: keep a file that is there and not ours as `<path>.1`, `<path>.2`, ....

    Raises:
        InputError: when a file is there that is not ours, or it cannot be written.
    """
    target = Path(path)
    write_page(target, report_html(run, replay=replay), "report", force=force)
    return target


def summary_html(run: RunContent) -> str:
    """Returns the verdict and the table of ten mass properties as HTML for a notebook."""
    content = {
        "title": f"{run.results.vehicle}: {run.results.scenario}",
        "verdict": _verdict(run),
        "parameters": table.parameter_rows(run.results, run.scenario.vehicle_data.unit_names),
    }
    return templates.fragment(_HERE / "summary.html", content)


def report_html(run: RunContent, *, replay: str | None = None) -> str:
    """Returns the report of a run as the text of one HTML file that needs no network."""
    run = run.thin_for_plots()
    results, scenario = run.results, run.scenario
    source = plots.source(run)
    jumps, window_by_failure = _list_time_windows(run)
    plot_data = {
        "time": interactive.round_times(run.time_s),
        **interactive.pack_figures(
            [interactive.plotly_figure(plot(source)) for plot in plots.available_plots(source).values()]
        ),
        "jumps": jumps,
        "failing": _failure_plot_name(source) if jumps else None,
    }
    units = scenario.vehicle_data.unit_names
    content = {
        "title": f"{results.vehicle}: {results.scenario}",
        "summary": run.summary,
        "innovations": results.consistency.in_words(),
        "units": units,
        "verdict": [*_verdict(run), *_arming_sentences(source, results)],
        "parameters": table.parameter_sheets(results, units, with_truth=source.simulated),
        "bound": results.above_bound,
        "intervals": results.intervals and results.intervals.in_words(),
        "allowed": results.intervals and results.intervals.guaranteed and table.interval_sheet(results, units),
        "contradicted": results.intervals is not None and results.intervals.contradicted,
        "simulated": source.simulated,
        "unidentified": in_words(results.identifiability, SYMBOLS),
        "injected": [_injected_row(run, number, window_by_failure) for number in range(len(results.injected or ()))],
        "detections": [_format_detection(entry, units) for entry in results.detections],
        "certainty": "probability" if scenario.detector.kind == "hypotheses" else "likelihood argument",
        "events": [(event.time_s, said.in_words(event, units)) for event in results.events],
        "probable": results.fault_probability and results.fault_probability.in_words(units),
        "against": results.against and _comparison_data(results.against),
        "unconfirmed": [unconfirmed.in_words(record) for record in results.unconfirmed],
        "untested": [f"{', '.join(record.jets)}: {record.reason}" for record in results.untested],
        "autopilot": _autopilot_sentences(run),
        "quality": _quality_rows(results),
        "scenario": yaml_text(scenario),
        "replay": replay,
    }
    return templates.page(
        _HERE / "report.html",
        content,
        data=plot_data,
        styles=[(_HERE / "report.css").read_text(encoding="utf-8")],
        scripts=interactive.scripts(),
        extra_policy=interactive.NEEDS,
    )


def _missing_sentences(results: Summary) -> Iterator[str]:
    """Yields sentences on an early end of a run, and on outputs that could not be written."""
    if results.ended is not None:
        yield f"Ended early, at {moment(results.ended.time_s)} s: {results.ended.reason}."
    if results.missing:
        yield f"Not all could be made: {'; '.join(results.missing)}."


def _verdict(run: RunContent) -> list[dict[str, Any]]:
    """Returns the verdict on a run as sentences, each with `is_good`: True, False, or None for no judgment."""
    results = run.results
    sentences: list[dict[str, Any]] = [{"good": False, "text": text} for text in _missing_sentences(results)]

    def say(is_good: bool | None, text: str) -> None:
        """Appends a sentence, good, bad, or without judgment (None)."""
        sentences.append({"good": is_good, "text": text})

    for is_good, text in _consistency_sentences(results.consistency):
        say(is_good, text)
    known = [
        item for item in results.parameters if math.isfinite(item.truth) and math.isfinite(item.standard_deviation)
    ]
    if known:
        inside = sum(item.within_three_sigma for item in known)
        say(inside == len(known), f"{inside} of {len(known)} parameters lie within 3 sigma of the truth.")
    else:
        say(None, "The truth is unknown: the table gives what was learned, and how surely.")
    for flag, words in (
        ("not_excited", "the start still tells more than the flight"),
        ("weak", "less is known than is asked"),
    ):
        flagged = [symbol for symbol, item in zip(SYMBOLS, results.identifiability, strict=False) if item.flag == flag]
        if flagged:
            say(False, f"{', '.join(flagged)}: {words}; the reasons stand below the table.")
    if not math.isfinite(results.estimates[MASS_RECIPROCAL]):
        say(None, "The mass is not observable: no accelerometer was read.")
    for is_good, text in _failure_sentences(results, run.scenario.vehicle_data.unit_names):
        say(is_good, text)
    for text in _other_sentences(results, run.scenario.vehicle_data.unit_names):
        say(False, text)
    if results.unconfirmed:
        least = max(results.unconfirmed, key=lambda item: item.statistic)
        jets = f", above all {' or '.join(least.jets)}" if least.jets else ""
        say(None, f"Suspected and not confirmed: {len(results.unconfirmed)}{jets}; see below.")
    if results.impossible:
        say(False, f"{results.impossible[0].upper()}{results.impossible[1:]}.")
    for text in _record_sentences(results):
        say(False, text)
    return sentences


def _consistency_sentences(consistency: Consistency) -> Iterator[tuple[bool | None, str]]:
    """Yields the sentence of the verdict on the innovations; none where the verdict is empty."""
    if consistency.verdict == INCONSISTENT:
        more = f" and {len(consistency.reasons) - 1} more, below" if len(consistency.reasons) > 1 else ""
        yield False, f"Inconsistent, so that a 1-sigma may say too little: {consistency.reasons[0]}{more}."
    elif consistency.verdict == CONSISTENT:
        yield True, "Consistent: the readings contradict none of the stated uncertainties."
    elif consistency.verdict == TOO_LITTLE:
        yield None, "Too few samples to judge whether the readings fit the stated uncertainties."


def _other_sentences(results: Summary, units: Mapping[str, str]) -> Iterator[str]:
    """Yields verdict sentences on false readings, engines, disturbances and unexplained events."""
    false = [event for event in results.events if event.kind == "false_reading"]
    components = list(dict.fromkeys("_".join(filter(None, (event.sensor, event.axis))) for event in false))
    if components:
        yield f"Read falsely: {', '.join(components)}."
    for event in results.events:
        if event.kind in ("engine_failed", "disturbance"):
            text = said.in_words(event, units)
            yield f"{text[0].upper()}{text[1:]}."
    if any(event.kind == "unexplained" for event in results.events):
        yield "Something happened that no failed jet, no jump and no false reading explains."


def _record_sentences(results: Summary) -> Iterator[str]:
    """Yields verdict sentences on a telemetry record: whether it is complete, and its warnings."""
    if results.completeness_detail:
        first, *others = results.completeness_detail
        yield f"The record is {results.completeness}: {first}{f', and {len(others)} more' if others else ''}."
    yield from (results.data_quality or {}).get("warnings", [])


def _failure_sentences(results: Summary, units: Mapping[str, str]) -> Iterator[tuple[bool, str]]:
    """Yields (is good, sentence) on declared failures, and on injected ones that were not found."""
    declared = [entry for entry in results.detections if entry.withdrawn_s is None]
    for entry in declared[:_WHOLE]:
        yield False, f"Found: {detections.in_words(entry, units, detailed=True)}; {_onset_text(entry, results)}."
    if declared[_WHOLE:]:
        yield False, f"Found as well: {'; '.join(detections.in_words(entry, units) for entry in declared[_WHOLE:])}."
    if not declared:
        yield True, "No failed jet and no jump of the mass properties was found."
    not_found = [event.name for event in results.injected or () if event.good is False]
    if not_found:
        yield False, f"Not found as what it is: {', '.join(not_found)}; see below."


def _onset_text(entry: DetectionRecord, results: Summary) -> str:
    """Formats onset and declaration time of a declaration, and its fault probability at the end."""
    since = f"since {entry.onset_s:.2f} s, declared at {entry.time_s:.2f} s"
    of_jets = {} if results.fault_probability is None else results.fault_probability.jets
    posterior = of_jets.get(entry.jet or "")
    if posterior is None:
        return since
    words = format_probability(posterior.probability)
    return f"{since}, with a probability {words if words.startswith('above') else f'of {words}'}"


_WHOLE = 6  # declarations that have a sentence each
_BEFORE_S, _AFTER_S = 2.0, 5.0  # that are shown around a failure


def _failure_plot_name(source: Source) -> str | None:
    """Returns the name of the plot that shows failures best in a run."""
    shown = plots.available_plots(source)
    return next((name for name in ("fault_probabilities", "likelihoods", "consistency") if name in shown), None)


def _list_time_windows(run: RunContent) -> tuple[list[dict[str, Any]], dict[int, int]]:
    """Lists time windows for the page's buttons, each from before a failure or jump to after its declaration.

    Returns:
        The windows as JSON has them, and the index of its window by the number of each injected failure.
    """
    results, (first, last) = run.results, (float(run.time_s[0]), float(run.time_s[-1]))
    spans: list[tuple[float, float, str]] = []  # from when, until when, and of what
    window_by_failure: dict[int, int] = {}
    for number, failure in enumerate(results.injected or ()):
        if first <= failure.start_s <= last:
            begun = failure.start_s if failure.first_acted_s is None else failure.first_acted_s
            window_by_failure[number] = len(spans)
            spans.append((begun, begun if failure.declared_s is None else failure.declared_s, failure.name))
    shown_until, units = {until for _, until, _ in spans}, run.scenario.vehicle_data.unit_names
    spans += [
        (entry.onset_s, entry.time_s, f"declared: {detections.in_words(entry, units)}")
        for entry in results.detections
        if entry.time_s not in shown_until
    ]
    jumps: list[dict[str, Any]] = []
    counts = {"failure": 0, "jump": 0, "declared": 0}
    for begun, until, what in spans:
        kind = "declared" if what.startswith("declared") else "jump" if what.startswith("payload") else "failure"
        counts[kind] += 1
        window = {"start": max(first, begun - _BEFORE_S), "end": min(last, until + _AFTER_S), "at": until}
        jumps.append({"text": f"{kind} {counts[kind]}", "title": what, **window})
    return jumps, window_by_failure


def _injected_row(run: RunContent, number: int, window_by_failure: Mapping[int, int]) -> dict[str, Any]:
    """Makes the table row of an injected failure or jump: times, true and detected size, and outcome."""
    results, units = run.results, run.scenario.vehicle_data.unit_names
    one = (results.injected or ())[number]
    said = (one.declared_s, one.magnitude)
    entry = next((each for each in results.detections if (each.time_s, each.magnitude) == said), None)
    if one.jet is None:
        before = sum(other.jet is None for other in (results.injected or ())[:number])
        jump = run.scenario.jumps[before]
        true = f"{-jump.mass if jump.kind == 'release' else jump.mass:+.4g} {units['mass']}"
        found = "" if entry is None or entry.kind != JUMP else size_in_words(entry, units)
    else:
        true = "" if one.force is None else f"{one.force:+.4g} {units['force']}"
        found = "" if entry is None else size_in_words(entry, units)
    delay_s = None if one.declared_s is None or one.first_acted_s is None else one.declared_s - one.first_acted_s
    before = delay_s is not None and delay_s <= 0.0  # its jet was known to have failed when it acted again
    return {
        "what": one.name,
        "times": [one.start_s, one.first_acted_s, one.first_alarm_s, None if before else one.declared_s],
        "delay": "-" if delay_s is None else "known before" if before else f"{delay_s:.2f} s",
        "true": true or "-",
        "found": found or "-",
        "outcome": one.outcome_text,
        "good": one.good,
        "jump": window_by_failure.get(number),
    }


def _arming_sentences(source: Source, results: Summary) -> list[dict[str, Any]]:
    """Returns verdict sentences on a detector that is off, never tested a sample, or began late; else none."""
    if "tested" not in source.signals:
        return [{"good": None, "text": "No failure was looked for: the detector is off."}]
    from_s = first_tested_s(source)
    if from_s is None:
        return [{"good": False, "text": "The detector was never armed: no sample was tested."}]
    if from_s - float(source.time_s[0]) <= PROMPT_S:
        return []
    before = [one for one in results.injected or () if one.first_acted_s is not None and one.first_acted_s < from_s]
    missed = f"; {counted(len(before), 'failure')} acted before" if before else ""
    return [{"good": False if before else None, "text": f"The detector was armed from {from_s:.2f} s on{missed}."}]


def _format_detection(entry: DetectionRecord, units: Mapping[str, str]) -> dict[str, Any]:
    """Makes the table row of a declaration: failure, times, size, and probability or likelihood argument."""
    statistic = "" if entry.statistic is None else f"{entry.statistic:.4g} "
    by_statistic = f"{statistic}after {counted(entry.alarms, 'alarm')}"
    return {
        "what": detections.in_words(entry, units),
        "since": [entry.onset_s] if entry.earliest_s is None else [entry.earliest_s, entry.latest_s],
        "declared": entry.time_s,
        "cluster": "" if entry.cluster is None else str(entry.cluster),
        "magnitude": size_in_words(entry, units),
        "certainty": by_statistic if entry.probability is None else format_probability(entry.probability),
        "remarks": "; ".join(remarks(entry)),
    }


def _autopilot_sentences(run: RunContent) -> list[str]:
    """Returns sentences on the autopilot: firings, propellant, jets out of use, and infeasible requests."""
    summary, units = run.results.autopilot, run.scenario.vehicle_data.unit_names
    lines = [f"{summary.firings} firings, {summary.propellant_mass:.3g} {units['mass']} of propellant."]
    if summary.jets_out_of_use:
        lines.append(f"Took out of use: {', '.join(summary.jets_out_of_use)}.")
    if summary.jets_left_in:
        lines.append(f"Left in use though in question, since control needs them: {', '.join(summary.jets_left_in)}.")
    if summary.lp_infeasible:
        lines.append(f"{summary.lp_infeasible} of {summary.lp_solves} requests were beyond the jets' reach.")
    return lines


def _comparison_data(comparison: Against) -> dict[str, Any]:
    """Returns page data of a record beside a simulation: residuals by signal, and possible causes."""
    return {
        "run": comparison.run,
        "words": comparison.in_words(),
        "residuals": table.residual_sheet(comparison),
        "causes": table.cause_sheet(comparison),
        "alike": comparison.causes[0].alike if comparison.causes else (),
    }


def _quality_rows(results: Summary) -> list[tuple[str, str]]:
    """Returns heading and text of each finding on a telemetry record's quality; empty ones are left out."""
    if results.data_quality is None:
        return []
    rows: list[tuple[str, str]] = [
        (results.completeness, sentence) for sentence in results.completeness_detail or ("all of the record was read",)
    ]
    for key, value in results.data_quality.items():
        heading = key.replace("_", " ")
        if key == "warnings":  # they are in the verdict
            continue
        if isinstance(value, dict) and any(isinstance(part, dict) for part in value.values()):
            rows += [(f"{heading}, {name}", _in_words(part)) for name, part in value.items()]
        else:
            rows.append((heading, _in_words(value)))
    return [(heading, text) for heading, text in rows if text]


def _in_words(value: Any) -> str:
    """Formats a nested value of the summary as text; empty for zero, null and empty values."""
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

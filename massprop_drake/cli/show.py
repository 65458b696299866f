"""Prints results: tables, JSON, schemas, and reports on vehicles and files."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any

from rich.cells import cell_len
from rich.table import Table
from rich.text import Text

from massprop_drake.cli.streams import escape_unprintable, say
from massprop_drake.cli.terminal import Terminal, print_table
from massprop_drake.errors import moment
from massprop_drake.inputs.campaign_file import CampaignSpec
from massprop_drake.inputs.model import Key
from massprop_drake.inputs.record_map import RecordMap
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.maths.signals import SYMBOLS, mass_property_units

if TYPE_CHECKING:
    from massprop_drake.results.against import Against
    from massprop_drake.results.consistency import Consistency
    from massprop_drake.results.detections import DetectionRecord
    from massprop_drake.results.events import EventRecord
    from massprop_drake.results.summary import AutopilotSummary, Parameter, Summary
    from massprop_drake.runners.forecast import Forecast

_READABLE = 60  # characters, of a column of sentences
_DIAGONAL = 3  # elements of the inverse inertia that are on its diagonal come first


def json_text(content: Any) -> str:
    """Formats data as indented JSON text, as files and standard output have it."""
    return json.dumps(content, indent=2, allow_nan=False) + "\n"


def print_json(content: Any) -> None:
    """Prints data as JSON, and nothing else, on standard output."""
    sys.stdout.write(json_text(content))


def print_forecast(forecast: Forecast, vehicle: Vehicle) -> None:
    """Prints a forecast: a table of 1-sigmas of the parameters, and one of the jets' leaks."""
    console, rows = Terminal(), []
    before, after = forecast.deviations[0], forecast.deviations[-1]
    for place, (symbol, unit) in enumerate(zip(SYMBOLS, mass_property_units(vehicle.unit_names), strict=True)):
        value, floor = forecast.properties[place], forecast.floors[place]
        scaled = place < _DIAGONAL or place == len(SYMBOLS) - 1  # products and centers may be zero
        percent = f"{100.0 * after[place] / abs(value):.3g}" if scaled else ""
        numbers = f"{value:.5g}", f"{before[place]:.3g}", f"{after[place]:.3g}"
        rows.append([symbol, unit, *numbers, percent, f"{floor:.3g}" if floor else ""])
    headings = ["parameter", "unit", "value", "1-sigma before", "1-sigma after", "%", "floor"]
    print_table(console, "mass properties", headings, rows, droppable=["1-sigma before", "unit"])
    console.say(f"propellant:  {forecast.propellant:.4g} {vehicle.unit_names['mass']}")
    jets = []
    for suspect in forecast.suspects:
        times = ("not" if time_s is None else f"{time_s:.3g}" for time_s in (suspect.noticed_s, suspect.after_s))
        jets.append([suspect.jet, f"{suspect.force:.3g}", *times, suspect.alike or ""])
    leak = f"leak, {vehicle.unit_names['force']}"
    headings = ["jet", leak, "something is wrong, s", "which it is, s", "longest taken for"]
    print_table(console, f"a jet that leaks from {forecast.fails_s:g} s on is told, in the mean", headings, jets)


def print_design(
    verdict: Iterable[Mapping[str, Any]], firings: Iterable[tuple[str, float, float]], folder: Path
) -> None:
    """Prints a designed maneuver: the sentences of its verdict, and a table of its firings.

    Args:
        verdict: see `saving.verdict`.
        firings: see `saving.firings`.
        folder: in which it is.
    """
    console = Terminal()
    for line in verdict:
        console.say(line["text"])
    rows = [[name, f"{start:.3f}", f"{end - start:.3g}"] for name, start, end in firings]
    print_table(console, "firings", ["jet or wheel", "begins, s", "lasts, s"], rows)
    console.say(f"written to {folder}/; fly it with: massprop run {folder}")


def print_listing(listing: Mapping[str, Mapping[str, str]]) -> None:
    """Prints bundled names with descriptions, a line each; a narrow terminal has the description below.

    Args:
        listing: descriptions by name, by kind in the plural.
    """
    console, table = Terminal(), Table.grid(padding=(0, 2))
    rows = [(kind.removesuffix("s"), name, text) for kind, items in listing.items() for name, text in items.items()]
    kinds, names = (max(cell_len(row[column]) for row in rows) for column in (0, 1))
    narrow = console.width - kinds - names - 4 < _READABLE
    for kind, name, text in rows:
        if not sys.stdout.isatty():
            console.say(f"{kind:{kinds}}  {name:{names}}  {text}")
        elif narrow:
            console.say((name, "bold"), f" ({kind})")
            console.say(f"    {text}")
        else:
            table.add_row(kind, console.words((name, "bold")), text)
    if table.rows:
        console.print(table)


def print_schema(keys: Iterable[Key]) -> None:
    """Prints a table of the keys that a file may have."""
    table = Table(box=None, header_style="bold")
    for heading in Key._fields:
        table.add_column(heading, overflow="fold", no_wrap=heading == "name")
    for key in keys:
        table.add_row(*key)
    Terminal(160).print(table)


# -------------------------------------------------------------------------------------------- runs


def print_simulation(results: Summary, vehicle: Vehicle, folder: Path) -> None:
    """Prints a simulated run: a table of the ten parameters, consistency, autopilot, detections and files."""
    console = Terminal(120)
    title = f"{results.scenario}: {results.vehicle}, {results.duration_s:g} s, seed {results.seed}"
    _print_parameters(console, title, results, vehicle, truth=True)
    console.say(_consistency_text(results.consistency))
    _print_doubts(console, results)
    autopilot = results.autopilot
    console.say(
        f"jets:        {autopilot.firings} firings, {autopilot.propellant_mass:.3g} {vehicle.unit_names['mass']} "
        "of propellant",
        *_infeasible_text(autopilot),
    )
    for jets, words in (
        (autopilot.jets_out_of_use, "out of use"),
        (autopilot.jets_left_in, "left in, though in question"),
    ):
        if jets:
            console.say(f"             {words}: {', '.join(jets)}")
    _print_detector_report(console, results, vehicle)
    _print_intervals(console, results, vehicle)
    console.say(f"speed:       {_speed_text(results.timing.real_time_factor)} times real time")
    _print_files(console, folder)


def print_estimation(results: Summary, vehicle: Vehicle, folder: Path) -> None:
    """Prints a run estimated from a record: a table of the ten parameters, warnings, detections and files."""
    console = Terminal(120)
    quality = results.data_quality or {}
    title = f"{results.provenance.telemetry}: {results.vehicle}, {results.duration_s:g} s"
    _print_parameters(console, title, results, vehicle, truth=False)
    for loss in results.completeness_detail:
        console.say((f"{results.completeness}:", "bold yellow"), f"{'':{13 - len(results.completeness) - 1}}{loss}")
    for fact in quality.get("information", ()):  # which runs of versions before have not
        console.say(f"note:        {fact}")
    for warning in quality["warnings"]:
        console.say(("warning:", "bold yellow"), f"     {warning}")
    console.say(_consistency_text(results.consistency))
    _print_doubts(console, results)
    counts = quality["samples"]["rotation"]
    skipped = ", ".join(
        f"{count} {reason.replace('_', ' ')}" for reason, count in counts.items() if count and reason != "used"
    )
    counted = sum(counts.values())  # of rows whenever anything is read
    apart = f", {counted} counted a sample period apart" if counted < quality["rows"] else ""
    console.say(f"samples:     {quality['rows']} rows{apart}; {counts['used']} used; skipped: {skipped or 'none'}")
    _print_detector_report(console, results, vehicle)
    if results.against is not None:
        _print_simulation_comparison(console, results.against)
    _print_intervals(console, results, vehicle)
    console.say(f"speed:       {_speed_text(quality['rows'] / results.timing.wall_s)} rows a second")
    _print_files(console, folder)


def _speed_text(value: float) -> str:
    """Formats a speed as a whole number, to two digits where it is below ten."""
    return f"{value:.0f}" if value >= 9.95 else f"{value:.2g}"


def _print_intervals(console: Terminal, results: Summary, vehicle: Vehicle) -> None:
    """Prints the intervals of the ten parameters that readings guarantee, or why there are none."""
    from massprop_drake.results import table  # noqa: PLC0415 (slow to load)

    intervals = results.intervals
    if intervals is None:
        return
    if intervals.guaranteed:
        headings, rows, _ = table.interval_sheet(results, vehicle.unit_names)
        print_table(console, "what readings allow", headings, rows)
    name = ("contradicted:", "bold red") if intervals.contradicted else "intervals:"
    console.say(name, f"{'' if intervals.contradicted else '  '} {intervals.in_words()}")


def _print_simulation_comparison(console: Terminal, comparison: Against) -> None:
    """Prints a table of residuals of a record from its simulation, and possible causes."""
    from massprop_drake.results import table  # noqa: PLC0415 (slow to load)

    headings, rows, _ = table.residual_sheet(comparison)
    print_table(console, f"beside {comparison.run}", headings, rows, droppable=("at",))
    console.say(f"against:     {comparison.in_words()}")
    if comparison.causes:
        headings, rows, _ = table.cause_sheet(comparison)
        print_table(console, "what would explain it", headings, rows)
        if comparison.causes[0].alike:
            console.say(f"             by itself as good as the first: {', '.join(comparison.causes[0].alike)}")


def comparison_data(results: Summary) -> dict[str, dict[str, float | None]]:
    """Maps the ten parameters of a run to estimate, 1-sigma and percent error; None for unknown ones."""

    def known(value: float) -> float | None:
        """Returns a number, None for NaN."""
        return None if math.isnan(value) else value

    return {
        parameter.name: {
            "estimate": known(parameter.estimate),
            "standard_deviation": known(parameter.standard_deviation),
            "percent_error": known(parameter.percent_error),
        }
        for parameter in results.parameters
    }


def print_side_by_side(summaries: Iterable[tuple[str, Summary]], vehicle: Vehicle) -> None:
    """Prints a table of the ten parameters: error or estimate, and 1-sigma, of several runs in columns.

    Args:
        summaries: name and summary of each run.
        vehicle: whose runs they are.
    """
    runs = list(summaries)
    headings, spare = ["parameter", "unit"], []
    for name, results in runs:
        what = "error %" if any(not math.isnan(one.percent_error) for one in results.parameters) else "estimate"
        headings += [f"{escape_unprintable(Path(name).name)}\n{column}" for column in (what, "1-sigma %")]
        spare.append(headings[-1])
    rows = [
        [symbol, unit, *(cell for _, results in runs for cell in _error_and_sigma(results.parameters[index], results))]
        for index, (symbol, unit) in enumerate(zip(SYMBOLS, mass_property_units(vehicle.unit_names), strict=True))
    ]
    print_table(Terminal(160), "estimates side by side", headings, rows, droppable=("unit", *spare))


def print_run_findings(runs: Iterable[tuple[str, Summary]], vehicle: Vehicle) -> None:
    """Prints a line for each run: duration, verdict of consistency, and detections."""
    from massprop_drake.results.detections import in_words  # noqa: PLC0415 (slow to load)

    for name, results in runs:
        what = "; ".join(in_words(one, vehicle.unit_names) for one in results.detections) or "no failure"
        verdict = results.consistency.verdict or "not judged"
        say(f"{escape_unprintable(name)}: {results.duration_s:.6g} s, {verdict}; found: {what}")


def _error_and_sigma(parameter: Parameter, results: Summary) -> tuple[str, str]:
    """Formats a parameter's error and 1-sigma, percent; its estimate, of a run without any truth."""
    if math.isnan(parameter.estimate):
        return "not observable", "-"
    simulated = any(not math.isnan(other.truth) for other in results.parameters)
    value = f"{parameter.percent_error:+.5f}" if simulated else f"{parameter.estimate:.6g}"
    if simulated and math.isnan(parameter.percent_error):
        value = "-"
    return value, "-" if math.isnan(parameter.percent_deviation) else f"{parameter.percent_deviation:.5f}"


def print_detection(entry: DetectionRecord, vehicle: Vehicle) -> None:
    """Prints a line on a detection, at once while rows come in."""
    say(_detection_text(entry, vehicle))


def print_event(event: EventRecord, vehicle: Vehicle) -> None:
    """Prints a line on an event, at once while rows come in, unless it is a new detection."""
    if event.kind not in _DETECTIONS:
        say(_event_text(event, vehicle))


def _print_parameters(console: Terminal, title: str, results: Summary, vehicle: Vehicle, *, truth: bool) -> None:
    """Prints a table of mass, center of mass and inertia, and below them the estimated reciprocals.

    The numbers of a row have the power of ten that stands with its unit.
    """
    from massprop_drake.results import table  # noqa: PLC0415 (slow to load)

    first, rest = table.parameter_sheets(results, vehicle.unit_names, with_truth=truth)
    rows: list[Sequence[Text | str] | None] = []
    for row in (*first.rows, None, *rest.rows):
        red = [console.words((cell, "bold red")) if cell == "no" else cell for cell in row or ()]
        rows.append(None if row is None else red[: len(first.headings)])
    spare = ("1-sigma %", table.IN_THREE_SIGMA, "truth")
    print_table(console, title, first.headings, rows, droppable=spare, hidden=(table.KNOWN,))


def _consistency_text(consistency: Consistency) -> str:
    """Formats the verdict of consistency and its statistics as one line."""
    return f"consistency: {consistency.verdict}; {consistency.in_words()}"


def _print_doubts(console: Terminal, results: Summary) -> None:
    """Prints why estimates are inconsistent, not identifiable, above their bound or impossible."""
    from massprop_drake.results.identifiability_flags import in_words  # noqa: PLC0415 (slow to load)

    for reason in results.consistency.reasons:
        console.say(("inconsistent:", "bold red"), f" {reason}")
    for what, why in in_words(results.identifiability, SYMBOLS):
        console.say((f"{what}:", "bold yellow"), f" {why}")
    if results.above_bound:
        console.say(f"bound:       {results.above_bound}")
    if results.impossible:
        console.say(("impossible:", "bold red"), f"  {results.impossible}")


def _infeasible_text(autopilot: AutopilotSummary) -> list[str | tuple[str, str]]:
    """Formats the number of requests beyond the jets' reach; empty without any."""
    count = autopilot.lp_infeasible
    return ["; ", (f"{count} requests beyond the jets' reach, met as far as they go", "bold yellow")] if count else []


_DETECTIONS = ("failed", "group", "jump")  # events that are the beginning of a detection
_BESIDE = (
    "changed",
    "withdrawn",
    "erratic",
    "false_reading",
    "engine_failed",
    "disturbance",
    "unexplained",
)  # events that are no new detection
_MOST_SUSPECTED = 5  # suspicions that are printed


def _print_detector_report(console: Terminal, results: Summary, vehicle: Vehicle) -> None:
    """Prints detections, events, fault probabilities, suspicions, missed failures, and untested jets."""
    from massprop_drake.results.unconfirmed import NOTHING_TESTED, in_words  # noqa: PLC0415 (slow to load)

    for entry in results.detections:
        console.say(_detection_text(entry, vehicle))
    untested = any(group.reason == NOTHING_TESTED for group in results.untested)
    if not results.detections:
        console.say(f"detected:    {'nothing, since no sample was tested' if untested else 'no failure'}")
    for event in results.events:
        if event.kind in _BESIDE:
            console.say(_event_text(event, vehicle))
    probable = results.fault_probability and results.fault_probability.in_words(vehicle.unit_names)
    if probable:
        console.say(f"probable:    {probable}")
    largest = sorted(results.unconfirmed, key=lambda one: -one.statistic)[:_MOST_SUSPECTED]
    for one in results.unconfirmed:
        if one in largest:
            console.say(("unconfirmed:", "bold yellow"), f" {in_words(one)}")
    if len(results.unconfirmed) > len(largest):
        console.say(f"             and {len(results.unconfirmed) - len(largest)} less likely ones in summary.json")
    for lost in results.injected or ():
        if lost.good is False:
            acted = "" if lost.first_acted_s is None else f", acting since {lost.first_acted_s:.2f} s"
            console.say(
                ("missed:", "bold red"), f"      {lost.name} at {lost.start_s:.2f} s{acted}: {lost.outcome_text}"
            )
    for group in results.untested:
        console.say(f"untested:    {', '.join(group.jets)}: {group.reason}")


def _event_text(event: EventRecord, vehicle: Vehicle) -> str:
    """Formats an event as one line."""
    from massprop_drake.results.events import in_words  # noqa: PLC0415 (slow to load)

    return f"event:       {event.time_s:.2f} s: {in_words(event, vehicle.unit_names)}"


def _detection_text(entry: DetectionRecord, vehicle: Vehicle) -> str:
    """Formats a detection as one line: what was found, when it was declared, and since when it acts."""
    from massprop_drake.results.detections import in_words, onset_in_words, remarks  # noqa: PLC0415 (slow to load)

    when = f"declared at {entry.time_s:.2f} s, {onset_in_words(entry)}"
    what = in_words(entry, vehicle.unit_names, detailed=True)
    return f"detected:    {', '.join([what, when, *remarks(entry)])}"


def _print_files(console: Terminal, folder: Path) -> None:
    """Prints the paths of a run's folder, pages and figures."""
    names = [name for name in ("report.html", "replay.html") if (folder / name).exists()]
    pages = [f"{name.partition('.')[0]}: {folder}/{name}" for name in names]
    figures = [f"figures: {folder}/figures/"] if (folder / "figures").exists() else []
    line = "   ".join([f"{folder}/", *pages, *figures])
    console.say(f"files:       {line}")


# ------------------------------------------------------------------------------------------- files


def describe_input(content: Vehicle | Scenario | CampaignSpec) -> str:
    """Formats a valid vehicle, scenario or campaign as one line: name, size and contents."""
    if isinstance(content, CampaignSpec):
        cells = math.prod(len(values) for values in content.file.sweep.values())
        cases = "every one" if content.file.cases is None else str(content.file.cases)
        swept = f", each in {cells} ways" if cells > 1 else ""
        drawn = f"{len(content.quantities)} quantities drawn"
        return f"campaign '{content.file.name}' of scenario '{content.base.name}', cases: {cases}{swept}, {drawn}"
    if isinstance(content, Scenario):
        return f"scenario '{content.name}', {content.duration_s:g} s, vehicle '{content.vehicle_data.name}'"
    sensors = content.sensors_in_words
    return f"vehicle '{content.name}', {len(content.jets)} jets, {sensors}, units {content.units}"


def describe_map(record_map: RecordMap) -> str:
    """Formats a valid map of a record as one line: its sensors, and the number of jets."""
    sensors = ", ".join(f"{sensor.kind} '{name}'" for name, sensor in record_map.sensors.items())
    jets = "all jets" if record_map.commands.jets is None else f"{len(record_map.commands.jets)} jets"
    return f"map of a record, {sensors}, commands of {jets}"


def describe_telemetry(facts: Mapping[str, Any], vehicle: Vehicle | None) -> str:
    """Formats what was found in a readable record as one line: rows, period, gaps, columns not used.

    Args:
        facts: see `records.structure_check.check`.
        vehicle: the vehicle it was checked against; None for any.
    """
    period = "" if facts["period_s"] is None else f", {facts['period_s']:.6g} s apart"
    parts = [f"telemetry{'' if vehicle is None else f' of {vehicle.name}'}, {facts['rows']} rows{period}"]
    parts[0] += f", from {moment(facts['first_s'])} to {moment(facts['last_s'])} s"
    for key, words in (("gaps", "gaps"), ("late", "rows whose time does not go on")):
        if facts[key]:
            parts.append(f"{facts[key]} {words}")
    if facts["unknown"]:
        parts.append(f"columns not used: {', '.join(facts['unknown'][:5])}{', ...' if facts['unknown'][5:] else ''}")
    if facts["absent"]:
        parts.append(f"no readings of {', '.join(facts['absent'])}")
    if facts["completeness_detail"]:
        parts.append(f"{facts['completeness']}: {'; '.join(facts['completeness_detail'])}")
    return "; ".join(parts)


def vehicle_lines(report: Mapping[str, Any], units: Mapping[str, str]) -> list[str]:
    """Formats the report on a vehicle as indented lines: body, control, observability, isolability.

    Args:
        report: as `studies.vehicle_report.vehicle_report` returns it.
        units: of mass, length and force.
    """
    control, seen = report["control"], report["observability"]
    push = (
        f"cannot push alone: {', '.join(control['missing'])}" if control["missing"] else "pushes in all 12 directions"
    )
    condition = "" if control["condition"] is None else f", condition {control['condition']:.1f}"
    length, force = units["length"], units["force"]
    gyration, arms, thrusts = (_range_text(report["body"][name]) for name in ("gyration", "arms", "thrusts"))
    lines = [
        f"body:        {report['body']['mass']:.4g} {units['mass']}, radii of gyration {gyration} {length}; "
        f"jets of {thrusts} {force}, {arms} {length} from the center of mass",
        f"control:     rank {control['rank']} of 6{condition}; {push}",
    ]
    lines.append(f"observable:  {seen['rank']} of the {seen['estimated']} mass properties by firing each jet alone")
    for combination in seen["unobservable"]:
        parts = " ".join(f"{weight:+.2g} {name}" for name, weight in combination.items())
        lines.append(f"             not: {next(iter(combination)) if len(combination) == 1 else parts}")
    lines += [f"note:        {note}" for note in report["notes"]]
    if report["alike"]:
        lines.append("look alike:  by the angle between what one sample shows of them")
    for pair in report["alike"]:
        first, second = pair["jets"]
        how = f"{first} failing {'off' if pair['opposed'] else 'on'} like {second} failing on"
        lines.append(f"             {math.degrees(pair['angle_rad']):7.3f} deg  {how}")
    lines.append(f"isolable:    smallest failure that one sample assigns to its jet, others off, {force}")
    for kind, words in (("on", "on untold"), ("lost", "lost, firing")):
        lines.append(f"             {words + ':':<13} {_isolable_words(report['isolable'], kind)}")
    return [f"  {line}" for line in lines]


def _range_text(values: Sequence[float]) -> str:
    """Formats the least and the largest of some values."""
    least, largest = f"{min(values):.3g}", f"{max(values):.3g}"
    return least if least == largest else f"{least} to {largest}"


def _isolable_words(jets: list[dict[str, Any]], kind: str) -> str:
    """Formats median and largest of the jets' smallest isolable failures, and the jets never isolable."""
    sizes = sorted((entry[kind]["force"], entry["jet"], entry[kind]["rival"]) for entry in jets if entry[kind]["force"])
    rivals = ((entry["jet"], entry[kind]["rival"]) for entry in jets if entry[kind]["force"] is None)
    never = [f"{jet} (not seen)" if rival is None else f"{jet} (like {rival})" for jet, rival in rivals]
    parts = []
    if sizes:
        force, jet, rival = sizes[-1]
        similar = "" if rival is None else f", like {rival}"
        parts.append(f"median {median(entry[0] for entry in sizes):.4g}, largest {force:.4g} ({jet}{similar})")
    if never:
        more = f" and {len(never) - 3} more" if len(never) > 3 else ""
        parts.append(f"never: {', '.join(never[:3])}{more}")
    return "; ".join(parts)


# --------------------------------------------------------------------------------------- campaigns

_GOOD_STYLES = {True: "green", False: "bold red", None: ""}


def print_verdict(sentences: Iterable[Mapping[str, Any]]) -> None:
    """Prints the sentences that a report begins with, colored by whether each is good."""
    console = Terminal()
    for sentence in sentences:
        console.say((sentence["text"], _GOOD_STYLES[sentence["good"]]))


def print_differences(comparison: Mapping[str, Any]) -> None:
    """Prints tables of differences between campaigns and their baseline, with 95 % bounds and p.

    Args:
        comparison: as `studies.campaign.compare.summary` returns it.
    """
    console = Terminal(120)
    for column in comparison["columns"]:
        if not column["differences"]:
            continue
        baseline = comparison["columns"][column["baseline"]]["label"]
        rows = []
        for one in column["differences"]:
            difference = one["difference"]
            numbers = (one["baseline"], one["here"], difference["value"])
            bounds = f"{_number_text(difference['low'])} to {_number_text(difference['high'])}"
            rows.append([one["what"], *map(_number_text, numbers), bounds, _number_text(one["p"])])
        title = f"{column['label']}, compared with {baseline}"
        print_table(console, title, ["", "there", "here", "difference", "95 %", "p"], rows)


def _number_text(value: float | None) -> str:
    """Formats a number to three digits, a missing one as "-"."""
    return "-" if value is None else f"{value:.3g}"

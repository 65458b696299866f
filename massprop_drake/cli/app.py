"""The command line: `massprop`."""

from __future__ import annotations

import json
import math
import sys
import time
from collections.abc import Iterable
from enum import StrEnum
from importlib.metadata import version
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from massprop_drake.errors import InputError, suggestion
from massprop_drake.inputs.model import Document, Key, exists, keys, read_text, validated
from massprop_drake.inputs.scenario import Scenario, bundled_scenarios, load_scenario, resolved
from massprop_drake.inputs.vehicle import Vehicle, bundled_vehicles, load_vehicle
from massprop_drake.results.folder import require_writable, write_whole
from massprop_drake.signals import with_deviation
from massprop_drake.telemetry.reader import check as check_telemetry
from massprop_drake.telemetry.reader import scenario_name, vehicle_scenario

if TYPE_CHECKING:
    from massprop_drake.studies.reproduction.report import Reproduced

app = typer.Typer(
    name="massprop",
    help="Estimates a spacecraft's mass properties in real time, and simulates the vehicle it does so for.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
    context_settings={"help_option_names": ["-h", "--help"]},
)

Json = Annotated[bool, typer.Option("--json", help="Print the result as JSON alone on standard output.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")]
View = Annotated[bool, typer.Option("--view", help="Write replay.html, the run in three dimensions, too.")]
Report = Annotated[bool, typer.Option("--report/--no-report", help="Write report.html, or not.")]
Figures = Annotated[bool, typer.Option("--figures/--no-figures", help="Draw the figures, or not, which is faster.")]
_PROGRESS_AFTER_S = 2.0
_TELEMETRY = (".csv", ".tsv", ".parquet", ".pq")  # endings of telemetry files


class Schema(StrEnum):
    """Kinds of files whose keys can be shown."""

    vehicle = "vehicle"
    scenario = "scenario"


def _show_version(shown: bool) -> None:
    if shown:
        sys.stdout.write(f"massprop {version('massprop-drake')}\n")
        raise typer.Exit


@app.callback()
def common(
    _: Annotated[
        bool, typer.Option("--version", is_eager=True, callback=_show_version, help="Show the version.")
    ] = False,
) -> None:
    """Estimates a spacecraft's mass properties and finds failed jets, in real time, and simulates the vehicle."""


def main() -> None:
    """Runs the command line; bad input ends with one message and exit status 2."""
    try:
        app()
    except InputError as error:
        _fail(str(error), 2)
    except KeyboardInterrupt:
        _fail("interrupted", 130)
    except BrokenPipeError:
        sys.exit(0)
    except Exception as error:  # the last line of defense: say it, and say it is ours
        _fail(f"internal failure: {type(error).__name__}: {error}", 1)


def _fail(message: str, status: int) -> None:
    Console(stderr=True, soft_wrap=True, highlight=False).print(f"massprop: {message}", markup=False)
    sys.exit(status)


@app.command("list", epilog="Example: `massprop list --json`")
def list_everything(as_json: Json = False) -> None:
    """Lists the bundled vehicles, scenarios and diagrams, a line each."""
    from massprop_drake.display import graphs  # noqa: PLC0415 (loads Drake)

    found = {
        "vehicles": {name: load_vehicle(name).description for name in bundled_vehicles()},
        "scenarios": {name: load_scenario(name).description for name in bundled_scenarios()},
        "diagrams": {name: graphs.describe(name) for name in graphs.DIAGRAMS},
        "campaigns": {},
    }
    if as_json:
        _print_json(found)
        return
    table = Table.grid(padding=(0, 2))
    for kind, items in found.items():
        for name, description in items.items():
            table.add_row(kind.removesuffix("s"), f"[bold]{name}[/bold]", description)
    Console().print(table)


@app.command(epilog="Example: `massprop run sample_maneuver --seed 3 --set rotation.filter=extended --out runs/ekf`")
def run(
    scenario: Annotated[str, typer.Argument(help="A bundled scenario, a YAML file, or an earlier run's folder.")],
    out: Annotated[Path | None, typer.Option(help="Folder to write; default runs/<name>.")] = None,
    seed: Annotated[int | None, typer.Option(help="Replaces the scenario's seed.")] = None,
    overrides: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="Replaces any field; VALUE is read as YAML. Repeatable."),
    ] = None,
    view: View = False,
    live: Annotated[
        bool, typer.Option("--live", help="Show the run in a browser on this machine as it is computed.")
    ] = False,
    speed: Annotated[float, typer.Option(help="With --live: times real time.")] = 1.0,
    report: Report = True,
    figures: Figures = True,
    force: Annotated[bool, typer.Option("--force", help="Write into a folder that is not an earlier run's.")] = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Simulates a scenario and estimates the vehicle's mass properties in it."""
    chosen = [*(overrides or []), *([] if seed is None else [f"seed={seed}"])]
    case = load_scenario(scenario, chosen)
    if not (math.isfinite(speed) and speed > 0.0):
        raise InputError(f"--speed {speed:g}: must be a number above zero, such as 10 for ten times real time")
    target = out or Path("runs") / case.name
    require_writable(target, force=force)

    from massprop_drake.runners.simulate import simulate  # noqa: PLC0415 (loads Drake)

    watch = None
    if live:
        from massprop_drake.display.live import Live  # noqa: PLC0415 (loads Drake)

        watch = Live(case, speed)
        Console(stderr=True, highlight=False).print(f"massprop: the run is shown at {watch.address}", markup=False)
    with _Progress(f"simulating {case.name}", case.duration_s, shown=not (as_json or quiet)) as progress:
        result = simulate(case, progress=progress, watch=watch)
    folder = result.save(target, force=force, pictures=figures, report=report, replay=view)
    if as_json:
        _print_json(result.summary)
    elif not quiet:
        _print_run(result.summary, case.vehicle_data, folder)


class Start(StrEnum):
    """Where the estimators begin."""

    nominal = "nominal"
    zero = "zero"


@app.command(epilog="Example: `massprop estimate flight.csv --vehicle orbiter --out runs/flight`")
def estimate(
    telemetry: Annotated[str, typer.Argument(help="A CSV or Parquet file, or - for rows on standard input.")],
    vehicle: Annotated[str | None, typer.Option(help="A bundled vehicle or a YAML file; settings by default.")] = None,
    like: Annotated[
        str | None, typer.Option(help="A run's folder or a scenario, for the vehicle and every setting.")
    ] = None,
    start: Annotated[
        Start | None,
        typer.Option(help="Begin at the nominal mass properties, or at zero; default as the settings say."),
    ] = None,
    resume_from: Annotated[
        Path | None, typer.Option(help="A run's folder: go on from the filter state at its end.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Folder to write; default runs/<name of the file>.")] = None,
    overrides: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="Replaces any field; VALUE is read as YAML. Repeatable."),
    ] = None,
    view: View = False,
    report: Report = True,
    figures: Figures = True,
    force: Annotated[bool, typer.Option("--force", help="Write into a folder that is not an earlier run's.")] = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Estimates mass properties and finds failed jets from recorded telemetry."""
    name = scenario_name(telemetry)
    chosen = [*(overrides or []), *([] if start is None else [f"estimation.start={start}"])]
    case = _case_of_a_record(name, vehicle, like, resume_from, chosen)
    target = out or Path("runs") / name
    _require_apart(target, telemetry, resume_from)
    require_writable(target, force=force)

    from massprop_drake.runners.recorded import estimate as estimate_record  # noqa: PLC0415 (loads Drake)

    live = telemetry == "-" and not (as_json or quiet)
    with _Progress(f"estimating {name}", 1.0, shown=telemetry != "-" and not (as_json or quiet)) as progress:
        result = estimate_record(
            telemetry,
            case,
            resume_from=resume_from,
            progress=progress,
            declared=(lambda entry: _print_declared(entry, case.vehicle_data)) if live else None,
            folder=target.parent,
        )
        folder = result.save(target, force=force, pictures=figures, report=report, replay=view)
    if as_json:
        _print_json(result.summary)
    elif not quiet:
        _print_estimate(result.summary, case.vehicle_data, folder)


def _case_of_a_record(
    name: str, vehicle: str | None, like: str | None, resume_from: Path | None, overrides: list[str]
) -> Scenario:
    """The vehicle and the settings to estimate with."""
    if vehicle is not None and like is not None:
        raise InputError("give either --vehicle or --like, not both: --like takes the vehicle, too")
    if vehicle is not None:
        return vehicle_scenario(name, vehicle, overrides)
    source = like or resume_from
    if source is None:
        raise InputError("whose telemetry is it? Give --vehicle (a vehicle) or --like (a run's folder or a scenario)")
    return load_scenario(source, overrides)


def _require_apart(target: Path, telemetry: str, resume_from: Path | None) -> None:
    """Keeps what is read from being replaced by what is written."""
    for source in (Path(telemetry).parent if telemetry != "-" else None, resume_from):
        if source is not None and exists(target) and exists(source) and target.resolve() == source.resolve():
            raise InputError(
                f"{target}: holds what is to be read, and would be replaced; give another folder with --out"
            )


@app.command("view", epilog="Example: `massprop view runs/stuck_on_29 --out stuck.html`")
def view_run(
    folder: Annotated[Path, typer.Argument(help="A run's folder.")],
    out: Annotated[Path | None, typer.Option(help="File to write; default replay.html in the run's folder.")] = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Writes a run in three dimensions as one HTML file that plays without a network."""
    target = out or folder / "replay.html"
    if target.is_dir() or not exists(target.parent):
        raise InputError(f"{target}: cannot be written; give a file in a folder that is there")

    from massprop_drake.display import write_replay, write_report  # noqa: PLC0415 (loads Drake)
    from massprop_drake.results.run import Run  # noqa: PLC0415 (slow to load)

    shown = Run.load(folder)
    try:
        write_replay(shown, target)
        beside = folder / "report.html"
        if out is None and exists(beside):  # its report then leads to the replay
            write_report(shown, beside, replay=target.name)
    except OSError as error:
        raise InputError(f"{target}: cannot be written: {error.strerror}") from None
    if as_json:
        _print_json(str(target))
    elif not quiet:
        Console(highlight=False, soft_wrap=True).print(str(target), markup=False)


@app.command(epilog="Example: `massprop reproduce --only fig_5_6 --only table_5_3`")
def reproduce(
    out: Annotated[Path, typer.Option(help="Folder to write; goes on with what it holds.")] = Path("runs/reproduction"),
    only: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="A figure or table alone, such as fig_5_6. Repeatable.")
    ] = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Reruns every figure and table of the thesis and says of each claim whether it holds."""
    from massprop_drake.studies.reproduction import catalog, report  # noqa: PLC0415 (loads matplotlib)
    from massprop_drake.studies.reproduction.reproduce import reproduce as rerun  # noqa: PLC0415

    entries = catalog.chosen(only)
    with _Progress("reproducing the thesis", 1.0, shown=not (as_json or quiet)) as progress:
        results = rerun(entries, out, lambda done, total: progress(done / total))
    if as_json:
        _print_json(report.as_data(results))
    elif not quiet:
        _print_reproduction(results, out)


@app.command(epilog="Example: `massprop graph closed_loop estimation --out graphs`")
def graph(
    diagrams: Annotated[list[str] | None, typer.Argument(help="Names as `massprop list` shows; default all.")] = None,
    out: Annotated[Path, typer.Option(help="Folder to write.")] = Path("runs/graphs"),
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Exports graphs of diagrams: DOT, and SVG where a program to draw it is installed."""
    from massprop_drake.display import graphs  # noqa: PLC0415 (loads Drake)

    names = diagrams or list(graphs.DIAGRAMS)
    for name in names:
        if name not in graphs.DIAGRAMS:
            raise InputError(f"'{name}' is no diagram{suggestion(name, list(graphs.DIAGRAMS))}")
    if out.exists() and not out.is_dir():
        raise InputError(f"{out}: is a file; give a folder to write to")
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{out}: cannot be written: {error.strerror}") from None
    written, drawn = [], True
    for name in names:
        diagram = graphs.build(name)
        shallow = graphs.dot_text(diagram, 1)
        deep = graphs.dot_text(diagram, 2)
        for dot, suffix in [(shallow, ""), *([(deep, "_inside")] if deep != shallow else [])]:
            written.append(out / f"{name}{suffix}.dot")
            write_whole(written[-1], dot)
            svg = graphs.svg_text(dot)
            drawn = drawn and svg is not None
            if svg is not None:
                written.append(out / f"{name}{suffix}.svg")
                write_whole(written[-1], svg)
    if as_json:
        _print_json([str(path) for path in written])
    elif not quiet:
        for path in written:
            Console(highlight=False, soft_wrap=True).print(str(path), markup=False)
    if not drawn and not quiet:
        hint = "massprop: no SVG: install a program that draws it, 'pip install graphviz-pure' or Graphviz's 'dot'"
        Console(stderr=True, highlight=False, soft_wrap=True).print(hint, markup=False)


@app.command(epilog="Example: `massprop check my_vehicle.yaml flight.csv --vehicle my_vehicle.yaml`")
def check(
    files: Annotated[
        list[str] | None, typer.Argument(help="Vehicle, scenario and telemetry files, or bundled names.")
    ] = None,
    vehicle: Annotated[str | None, typer.Option(help="The vehicle whose telemetry it should be.")] = None,
    schema: Annotated[Schema | None, typer.Option(help="Show every key of a kind of file instead.")] = None,
    pairs: Annotated[int, typer.Option(min=0, help="Of a vehicle: so many pairs of jets that look alike.")] = 5,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Validates vehicle, scenario and telemetry files and says what is wrong, or shows the keys they may have.

    Of a good vehicle it also reports how the jets push, which mass properties they show, and which jets look alike.
    """
    if schema is not None:
        found = keys(Vehicle) if schema is Schema.vehicle else keys(Scenario)
        # a scenario may hold a whole vehicle, whose keys are the other schema's
        _print_schema([key for key in found if not key.name.startswith("vehicle.")], as_json)
        return
    if not files:
        raise InputError("nothing to check: name a file, or --schema vehicle or --schema scenario")
    whose = None if vehicle is None else load_vehicle(vehicle)
    findings: list[dict[str, Any]] = []
    lines: list[str] = []
    for name in files:
        try:
            good = _checked(name, whose)
        except InputError as error:
            findings.append({"file": name, "ok": False, "findings": list(error.problems)})
            lines += error.problems
            continue
        about = good if isinstance(good, str) else _about(good)
        findings.append({"file": name, "ok": True, "findings": [about]})
        lines.append(f"{name}: ok: {about}")
        if isinstance(good, Vehicle) and not quiet:
            from massprop_drake.studies.vehicle import vehicle_report  # noqa: PLC0415 (loads an optimizer)

            findings[-1]["report"] = vehicle_report(good, pairs)
            lines += _report_lines(findings[-1]["report"], good.unit_names["force"])
    if as_json:
        _print_json(findings)
    elif not quiet:
        for line in lines:
            Console(highlight=False, soft_wrap=True).print(line, markup=False)
    if not all(finding["ok"] for finding in findings):
        raise typer.Exit(2)


def _checked(name: str, whose: Vehicle | None) -> Vehicle | Scenario | str:
    """What a good file holds, of telemetry in words; InputError for a bad one."""
    if Path(name).suffix.lower() in _TELEMETRY:
        return _about_telemetry(check_telemetry(Path(name), whose), whose)
    if name in bundled_vehicles():
        return load_vehicle(name)
    if name in bundled_scenarios():
        return load_scenario(name)
    document = Document(read_text(Path(name)), name)
    if "jets" in document.data or "jet_kinds" in document.data:
        return validated(Vehicle, document.data, document)
    return resolved(document.data, document, Path(name).parent)


def _about(good: Vehicle | Scenario) -> str:
    return _about_vehicle(good) if isinstance(good, Vehicle) else _about_scenario(good)


def _about_vehicle(vehicle: Vehicle) -> str:
    sensors = f"{len(vehicle.gyros)} gyro and {len(vehicle.accelerometers)} accelerometer packages"
    return f"vehicle '{vehicle.name}', {len(vehicle.jets)} jets, {sensors}, units {vehicle.units}"


def _about_scenario(scenario: Scenario) -> str:
    return f"scenario '{scenario.name}', {scenario.duration_s:g} s, vehicle '{scenario.vehicle_data.name}'"


def _about_telemetry(found: dict[str, Any], whose: Vehicle | None) -> str:
    period = "" if found["period_s"] is None else f", {found['period_s']:.6g} s apart"
    parts = [f"telemetry{'' if whose is None else f' of {whose.name}'}, {found['rows']} rows{period}"]
    parts[0] += f", from {found['first_s']:.6g} to {found['last_s']:.6g} s"
    for key, words in (("gaps", "gaps"), ("late", "rows whose time does not go on"), ("ragged", "rows cut short")):
        if found[key]:
            parts.append(f"{found[key]} {words}")
    if found["unknown"]:
        parts.append(f"columns not used: {', '.join(found['unknown'][:5])}{', ...' if found['unknown'][5:] else ''}")
    if found["absent"]:
        parts.append(f"no readings of {', '.join(found['absent'])}")
    return "; ".join(parts)


def _report_lines(report: dict[str, Any], force: str) -> list[str]:
    """A vehicle's report for reading, indented."""
    control, seen = report["control"], report["observability"]
    push = (
        f"cannot push alone: {', '.join(control['missing'])}" if control["missing"] else "pushes in all 12 directions"
    )
    condition = "" if control["condition"] is None else f", condition {control['condition']:.1f}"
    lines = [f"control:     rank {control['rank']} of 6{condition}; {push}"]
    lines.append(f"observable:  {seen['rank']} of the 10 mass properties by firing each jet alone")
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


def _isolable_words(jets: list[dict[str, Any]], kind: str) -> str:
    """The usual and the worst of all jets' smallest isolable failures."""
    found = sorted((entry[kind]["force"], entry["jet"], entry[kind]["rival"]) for entry in jets if entry[kind]["force"])
    rivals = ((entry["jet"], entry[kind]["rival"]) for entry in jets if entry[kind]["force"] is None)
    never = [f"{jet} (not seen)" if rival is None else f"{jet} (like {rival})" for jet, rival in rivals]
    parts = []
    if found:
        force, jet, rival = found[-1]
        beside = "" if rival is None else f", like {rival}"
        parts.append(f"median {median(entry[0] for entry in found):.4g}, largest {force:.4g} ({jet}{beside})")
    if never:
        more = f" and {len(never) - 3} more" if len(never) > 3 else ""
        parts.append(f"never: {', '.join(never[:3])}{more}")
    return "; ".join(parts)


# ---------------------------------------------------------------------------------------- printing


class _Progress:
    """A progress bar on a terminal, once the work has taken a while."""

    def __init__(self, title: str, total: float, *, shown: bool):
        self._title = title
        self._total = total
        self._shown = shown and sys.stderr.isatty()
        self._began = time.monotonic()
        self._bar: Any = None

    def __enter__(self) -> _Progress:
        return self

    def __call__(self, reached: float) -> None:
        """Reports how far the work has got, in what the total is in."""
        if not self._shown or time.monotonic() - self._began < _PROGRESS_AFTER_S:
            return
        if self._bar is None:
            from rich.progress import Progress  # noqa: PLC0415 (only for long work)

            self._bar = Progress(console=Console(stderr=True), transient=True)
            self._bar.start()
            self._task = self._bar.add_task(self._title, total=self._total)
        self._bar.update(self._task, completed=reached)

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.stop()


def _print_json(content: Any) -> None:
    sys.stdout.write(json.dumps(content, indent=2, allow_nan=False) + "\n")


def _print_schema(found: Iterable[Key], as_json: bool) -> None:
    if as_json:
        _print_json([key._asdict() for key in found])
        return
    table = Table(box=None, header_style="bold")
    for heading in Key._fields:
        table.add_column(heading, overflow="fold", no_wrap=heading == "name")
    for key in found:
        table.add_row(*(_escaped(part) for part in key))
    Console(width=None if sys.stdout.isatty() else 160).print(table)


def _escaped(text: str) -> str:
    return text.replace("[", r"\[")


def _print_run(summary: dict[str, Any], vehicle: Vehicle, folder: Path) -> None:
    """The table of ten parameters, how the run went, and where its files lie."""
    from massprop_drake.results.summary import from_names  # noqa: PLC0415 (loads Drake)
    from massprop_drake.signals import SYMBOLS, mass_property_units  # noqa: PLC0415

    console = Console(width=None if sys.stdout.isatty() else 120, highlight=False)
    title = f"{summary['scenario']}: {summary['vehicle']}, {summary['duration_s']:g} s, seed {summary['seed']}"
    table = Table(title=_escaped(title), title_justify="left", header_style="bold")
    for heading in ("parameter", "unit", "estimate", "truth", "error %", "1-sigma", "1-sigma %", "within 3 sigma"):
        table.add_column(heading, justify="left" if heading in ("parameter", "unit") else "right")
    columns = (summary[key] for key in ("estimates", "truth", "standard_deviations", "percent_error"))
    rows = zip(SYMBOLS, mass_property_units(vehicle.unit_names), *map(from_names, columns), strict=True)
    for symbol, unit, estimate, truth, deviation, percent in rows:
        if math.isnan(estimate):
            table.add_row(symbol, unit, "not observable", f"{truth:.6g}", *["-"] * 4)
            continue
        inside = abs(estimate - truth) <= 3.0 * deviation
        table.add_row(
            symbol,
            unit,
            f"{estimate:.6g}",
            f"{truth:.6g}",
            "-" if math.isnan(percent) else f"{percent:+.4f}",
            f"{deviation:.3g}",
            "-" if math.isnan(percent) else f"{100.0 * deviation / abs(truth):.4f}",
            "yes" if inside else "[bold red]no[/bold red]",
        )
    console.print(table)
    autopilot, consistency, timing = summary["autopilot"], summary["consistency"], summary["timing"]
    mass = vehicle.unit_names["mass"]
    console.print(
        f"consistency: mean NIS {_number(consistency['rotation_nis_mean'])} rotation, "
        f"{_number(consistency['translation_nis_mean'])} translation, over {consistency['samples']} samples used"
    )
    console.print(
        f"autopilot:   {autopilot['firings']} firings, {autopilot['propellant_mass']:.3g} {mass} of propellant"
        + _shortfalls(autopilot)
    )
    for key, words in (("jets_out_of_use", "out of use"), ("jets_left_in", "left in, though in question")):
        if autopilot[key]:
            console.print(f"             {words}: {', '.join(autopilot[key])}", markup=False)
    for entry in summary["detections"]:
        console.print(f"detected:    {_detected(entry, vehicle.unit_names['force'])}", soft_wrap=True)
    console.print(f"speed:       {timing['real_time_factor']:.0f} times real time")
    _print_files(console, folder)


def _print_estimate(summary: dict[str, Any], vehicle: Vehicle, folder: Path) -> None:
    """Warnings, the table of ten parameters, what follows from them, what failed, and what the record is like."""
    from massprop_drake.results.summary import from_names  # noqa: PLC0415 (loads Drake)
    from massprop_drake.signals import SYMBOLS, mass_property_units  # noqa: PLC0415

    console = Console(width=None if sys.stdout.isatty() else 120, highlight=False)
    quality = summary["data_quality"]
    title = f"{summary['provenance']['telemetry']}: {summary['vehicle']}, {summary['duration_s']:g} s"
    table = Table(title=_escaped(title), title_justify="left", header_style="bold")
    for heading in ("parameter", "unit", "estimate", "1-sigma", "1-sigma %"):
        table.add_column(heading, justify="left" if heading in ("parameter", "unit") else "right")
    columns = map(from_names, (summary["estimates"], summary["standard_deviations"]))
    for symbol, unit, estimate, deviation in zip(
        SYMBOLS, mass_property_units(vehicle.unit_names), *columns, strict=True
    ):
        if math.isnan(estimate):
            table.add_row(symbol, unit, "not observable", "-", "-")
            continue
        percent = f"{100.0 * deviation / abs(estimate):.4f}" if estimate else "-"
        table.add_row(symbol, unit, f"{estimate:.6g}", f"{deviation:.3g}", percent)
    _add_derived(table, summary["derived"], vehicle)
    console.print(table)
    for warning in quality["warnings"]:
        console.print(f"[bold yellow]warning:[/bold yellow]     {_escaped(warning)}", soft_wrap=True)
    consistency, counts = summary["consistency"], quality["samples"]["rotation"]
    console.print(
        f"consistency: mean NIS {_number(consistency['rotation_nis_mean'])} rotation, "
        f"{_number(consistency['translation_nis_mean'])} translation, over {consistency['samples']} samples used"
    )
    skipped = ", ".join(
        f"{count} {reason.replace('_', ' ')}" for reason, count in counts.items() if count and reason != "used"
    )
    console.print(
        f"samples:     {quality['rows']} rows; {counts['used']} used; skipped: {skipped or 'none'}", soft_wrap=True
    )
    for entry in summary["detections"]:
        console.print(f"detected:    {_detected(entry, vehicle.unit_names['force'])}", soft_wrap=True)
    if not summary["detections"]:
        console.print("detected:    no failure")
    console.print(f"speed:       {quality['rows'] / summary['timing']['wall_s']:.0f} rows a second")
    _print_files(console, folder)


def _add_derived(table: Table, derived: dict[str, Any], vehicle: Vehicle) -> None:
    """Rows for the mass and the inertia that the estimates mean."""
    units = vehicle.unit_names
    rows = [("m", units["mass"], derived["mass"], derived["mass_std"])]
    if derived["inertia"] is not None:
        for name, i, j in (("Ixx", 0, 0), ("Iyy", 1, 1), ("Izz", 2, 2), ("Iyz", 1, 2), ("Ixz", 0, 2), ("Ixy", 0, 1)):
            value, std = derived["inertia"][i][j], derived["inertia_std"][i][j]
            rows.append((name, f"{units['mass']}-{units['length']}^2", value, std))
    table.add_section()
    for name, unit, value, std in rows:
        if value is None or std is None:
            table.add_row(name, unit, "-", "-", "-")
        else:
            table.add_row(name, unit, f"{value:.6g}", f"{std:.3g}", f"{100.0 * std / abs(value):.4f}" if value else "-")


def _print_declared(entry: dict[str, Any], vehicle: Vehicle) -> None:
    text = f"detected:    {_detected(entry, vehicle.unit_names['force'])}"
    Console(highlight=False, soft_wrap=True).print(text, markup=False)
    sys.stdout.flush()


def _print_files(console: Console, folder: Path) -> None:
    """Where a run's files lie."""
    names = [name for name in ("report.html", "replay.html") if (folder / name).exists()]
    pages = [f"{name.partition('.')[0]}: {folder}/{name}" for name in names]
    figures = [f"figures: {folder}/figures/"] if (folder / "figures").exists() else []
    text = "   ".join([f"{folder}/", *pages, *figures])
    console.print(f"files:       {text}", markup=False, soft_wrap=True)


def _detected(entry: dict[str, Any], force: str) -> str:
    when = f"declared at {entry['time_s']:.2f} s, since {entry['onset_s']:.2f} s"
    kind = entry["kind"].replace("_", " ")
    if entry["cluster"] is None:
        return f"{kind}, {when}"
    where = (
        f"jet {entry['jet']} (cluster {entry['cluster']})" if entry["jet"] else f"a jet of cluster {entry['cluster']}"
    )
    withdrawn = "" if entry["withdrawn_s"] is None else f", withdrawn at {entry['withdrawn_s']:.2f} s"
    return f"{kind}: {where}, {with_deviation(entry['magnitude'], entry['magnitude_std'])} {force}, {when}{withdrawn}"


_VERDICT_STYLES = {"holds": "green", "holds within spread": "cyan", "differs": "yellow"}


def _print_reproduction(results: list[Reproduced], folder: Path) -> None:
    """A table of claims per entry, and how many of them hold."""
    from massprop_drake.studies.reproduction import report  # noqa: PLC0415 (loads matplotlib)

    console = Console(width=None if sys.stdout.isatty() else 160, highlight=False)
    for result in results:
        title = f"{report.label(result.entry)}: {result.entry.title}"
        table = Table(title=_escaped(title), title_justify="left", header_style="bold", expand=True)
        for heading, share in (("claim", 4), ("thesis", 4), ("measured", 4), ("verdict", 3)):
            table.add_column(heading, ratio=share)
        for outcome in result.outcomes:
            verdict = f"[{_VERDICT_STYLES[outcome.verdict]}]{outcome.verdict}[/]"
            why = f": {_escaped(outcome.why)}" if outcome.why else ""
            cells = map(_escaped, (outcome.claim.text, outcome.claim.thesis, outcome.measured))
            table.add_row(*cells, verdict + why)
        console.print(table)
    console.print(report.summary_line(results))
    console.print(f"files: {folder}/reproduction.html, reproduction.md, figures/", markup=False, soft_wrap=True)


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


def _shortfalls(autopilot: dict[str, Any]) -> str:
    missed = autopilot["lp_infeasible"]
    if not missed:
        return ""
    return f"; [bold yellow]{missed} requests beyond the jets' reach, met as far as they go[/bold yellow]"

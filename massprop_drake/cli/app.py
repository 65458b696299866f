"""The command line: `massprop`."""

from __future__ import annotations

import math
import sys
import warnings
from collections.abc import Callable
from enum import StrEnum
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any

import typer

from massprop_drake.cli import show
from massprop_drake.cli.progress import Progress
from massprop_drake.errors import InputError, suggestion
from massprop_drake.inputs.model import keys, validated
from massprop_drake.inputs.plausible import Finding
from massprop_drake.inputs.renamed import RenamedWarning
from massprop_drake.inputs.scenario import Scenario, bundled_scenarios, load_scenario, resolved
from massprop_drake.inputs.vehicle import Vehicle, bundled_vehicles, load_vehicle
from massprop_drake.inputs.yaml import Document, exists, read_text
from massprop_drake.results.folder import require_writable, write_whole
from massprop_drake.telemetry.reader import check as check_telemetry
from massprop_drake.telemetry.reader import scenario_name, vehicle_scenario

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
_TELEMETRY = (".csv", ".tsv", ".parquet", ".pq")  # endings of telemetry files


class Schema(StrEnum):
    """The kinds of files whose keys can be shown."""

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
        with warnings.catch_warnings():
            warnings.simplefilter("always", RenamedWarning)
            warnings.showwarning = _old_names_in_a_line(warnings.showwarning)
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
    show.note(message)
    sys.exit(status)


def _old_names_in_a_line(otherwise: Callable[..., None]) -> Callable[..., None]:
    """How warnings are shown: those of old names as messages of the command line, each once; others as always."""
    said: set[str] = set()

    def shown(message: Warning | str, category: type[Warning], *rest: Any, **options: Any) -> None:
        if not issubclass(category, RenamedWarning):
            otherwise(message, category, *rest, **options)
        elif str(message) not in said:
            said.add(str(message))
            show.note(str(message))

    return shown


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
        show.as_json(found)
    else:
        show.listing(found)


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
    _note_doubts(case.simulation_doubts, quiet=quiet)

    from massprop_drake.runners.simulate import simulate  # noqa: PLC0415 (loads Drake)

    watch = None
    if live:
        from massprop_drake.display.live import Live  # noqa: PLC0415 (loads Drake)

        watch = Live(case, speed)
        show.note(f"the run is shown at {watch.address}")
    with Progress(f"simulating {case.name}", case.duration_s, shown=not (as_json or quiet)) as progress:
        result = simulate(case, progress=progress, watch=watch)
    folder = result.save(target, force=force, pictures=figures, report=report, replay=view)
    if as_json:
        show.as_json(result.summary)
    elif not quiet:
        show.simulated(result.results, case.vehicle_data, folder)


def _note_doubts(doubts: list[Finding], *, quiet: bool) -> None:
    """Notes what may bear on a result otherwise than it was meant, a line each."""
    for doubt in () if quiet else doubts:
        show.note(f"warning: {doubt}")


class Start(StrEnum):
    """The mass properties that the estimators start from."""

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
    _note_doubts(case.estimation_doubts, quiet=quiet)

    from massprop_drake.runners.recorded import estimate as estimate_record  # noqa: PLC0415 (slow to load)

    live = telemetry == "-" and not (as_json or quiet)
    with Progress(f"estimating {name}", 1.0, shown=telemetry != "-" and not (as_json or quiet)) as progress:
        result = estimate_record(
            telemetry,
            case,
            resume_from=resume_from,
            progress=progress,
            declared=(lambda entry: show.declared(entry, case.vehicle_data)) if live else None,
            folder=target.parent,
        )
        folder = result.save(target, force=force, pictures=figures, report=report, replay=view)
    if as_json:
        show.as_json(result.summary)
    elif not quiet:
        show.estimated(result.results, case.vehicle_data, folder)


def _case_of_a_record(
    name: str, vehicle: str | None, like: str | None, resume_from: Path | None, overrides: list[str]
) -> Scenario:
    """Finds the vehicle and the settings to estimate with."""
    if vehicle is not None and like is not None:
        raise InputError("give either --vehicle or --like, not both: --like takes the vehicle, too")
    if vehicle is not None:
        return vehicle_scenario(name, vehicle, overrides)
    source = like or resume_from
    if source is None:
        raise InputError("whose telemetry is it? Give --vehicle (a vehicle) or --like (a run's folder or a scenario)")
    return load_scenario(source, overrides)


def _require_apart(target: Path, telemetry: str, resume_from: Path | None) -> None:
    """Makes sure that the output does not replace its own input."""
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
        show.as_json(str(target))
    elif not quiet:
        show.text(target)


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
    with Progress("reproducing the thesis", 1.0, shown=not (as_json or quiet)) as progress:
        results = rerun(entries, out, lambda done, total: progress(done / total))
    if as_json:
        show.as_json(report.as_data(results))
    elif not quiet:
        show.reproduced(results, out)


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
        show.as_json([str(path) for path in written])
    elif not quiet:
        for path in written:
            show.text(path)
    if not drawn and not quiet:
        show.note("no SVG: install a program that draws it, 'pip install graphviz-pure' or Graphviz's 'dot'")


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
        shown = [key for key in found if not key.name.startswith("vehicle.")]
        if as_json:
            show.as_json([key._asdict() for key in shown])
        else:
            show.schema(shown)
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
        about = good if isinstance(good, str) else show.about(good)
        doubts = [] if isinstance(good, str) else list(map(str, good.doubts))
        findings.append({"file": name, "ok": True, "findings": [about], "warnings": doubts})
        lines.append(f"{name}: ok: {about}")
        lines += [f"{name}: warning: {doubt}" for doubt in doubts]
        if isinstance(good, Vehicle) and not quiet:
            from massprop_drake.studies.vehicle import vehicle_report  # noqa: PLC0415 (loads Drake)

            findings[-1]["report"] = vehicle_report(good, pairs)
            lines += show.vehicle_lines(findings[-1]["report"], good.unit_names["force"])
    if as_json:
        show.as_json(findings)
    elif not quiet:
        for line in lines:
            show.text(line)
    if not all(finding["ok"] for finding in findings):
        raise typer.Exit(2)


def _checked(name: str, whose: Vehicle | None) -> Vehicle | Scenario | str:
    """Reads a file and returns what it holds, telemetry in words; raises InputError for a bad one."""
    if Path(name).suffix.lower() in _TELEMETRY:
        return show.about_telemetry(check_telemetry(Path(name), whose), whose)
    if name in bundled_vehicles():
        return load_vehicle(name)
    if name in bundled_scenarios():
        return load_scenario(name)
    document = Document(read_text(Path(name)), name)
    if "jets" in document.data or "jet_kinds" in document.data:
        return validated(Vehicle, document.data, document)
    return resolved(document.data, document, Path(name).parent)

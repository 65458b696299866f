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
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from massprop_drake.errors import InputError, suggestion
from massprop_drake.files import require_writable, write_whole
from massprop_drake.models import Document, Key, keys, read_text, validated
from massprop_drake.scenario import Scenario, bundled_scenarios, load_scenario, resolved
from massprop_drake.vehicle import Vehicle, bundled_vehicles, load_vehicle

if TYPE_CHECKING:
    from massprop_drake.reproduction.report import Reproduced

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
_PROGRESS_AFTER_S = 2.0


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
    except Exception as error:  # the last line of defence: say it, and say it is ours
        _fail(f"internal failure: {type(error).__name__}: {error}", 1)


def _fail(message: str, status: int) -> None:
    Console(stderr=True, soft_wrap=True, highlight=False).print(f"massprop: {message}", markup=False)
    sys.exit(status)


@app.command("list", epilog="Example: `massprop list --json`")
def list_everything(as_json: Json = False) -> None:
    """Lists the bundled vehicles, scenarios and diagrams, a line each."""
    from massprop_drake import graphs  # noqa: PLC0415 (loads Drake)

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
    force: Annotated[bool, typer.Option("--force", help="Write into a folder that is not an earlier run's.")] = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Simulates a scenario and estimates the vehicle's mass properties in it."""
    chosen = [*(overrides or []), *([] if seed is None else [f"seed={seed}"])]
    case = load_scenario(scenario, chosen)
    target = out or Path("runs") / case.name
    require_writable(target, force=force)

    from massprop_drake.simulation import simulate  # noqa: PLC0415 (loads Drake)

    with _Progress(f"simulating {case.name}", case.duration_s, shown=not (as_json or quiet)) as progress:
        result = simulate(case, progress=progress)
    folder = result.save(target, force=force)
    if as_json:
        _print_json(result.summary)
    elif not quiet:
        _print_run(result.summary, case.vehicle_data, folder)


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
    from massprop_drake.reproduction import catalogue, report  # noqa: PLC0415 (loads matplotlib)
    from massprop_drake.reproduction.reproduce import reproduce as rerun  # noqa: PLC0415

    entries = catalogue.chosen(only)
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
    from massprop_drake import graphs  # noqa: PLC0415 (loads Drake)

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
        for depth, suffix in ((1, ""), (2, "_inside")):
            dot = graphs.dot_text(diagram, depth)
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


@app.command(epilog="Example: `massprop check my_vehicle.yaml my_scenario.yaml`, `massprop check --schema vehicle`")
def check(
    files: Annotated[list[str] | None, typer.Argument(help="Vehicle and scenario files, or bundled names.")] = None,
    schema: Annotated[Schema | None, typer.Option(help="Show every key of a kind of file instead.")] = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Validates vehicle and scenario files and says what is wrong, or shows the keys they may have."""
    if schema is not None:
        found = keys(Vehicle) if schema is Schema.vehicle else keys(Scenario)
        # a scenario may hold a whole vehicle, whose keys are the other schema's
        _print_schema([key for key in found if not key.name.startswith("vehicle.")], as_json)
        return
    if not files:
        raise InputError("nothing to check: name a file, or --schema vehicle or --schema scenario")
    findings = []
    for name in files:
        try:
            findings.append({"file": name, "ok": True, "findings": [_checked(name)]})
        except InputError as error:
            findings.append({"file": name, "ok": False, "findings": list(error.problems)})
    if as_json:
        _print_json(findings)
    elif not quiet:
        for finding in findings:
            for line in finding["findings"]:  # type: ignore[attr-defined]
                text = f"{finding['file']}: ok: {line}" if finding["ok"] else line
                Console(highlight=False, soft_wrap=True).print(text, markup=False)
    if not all(finding["ok"] for finding in findings):
        raise typer.Exit(2)


def _checked(name: str) -> str:
    """What a good file holds; InputError for a bad one."""
    if name in bundled_vehicles():
        return _about_vehicle(load_vehicle(name))
    if name in bundled_scenarios():
        return _about_scenario(load_scenario(name))
    document = Document(read_text(Path(name)), name)
    if "jets" in document.data or "jet_kinds" in document.data:
        return _about_vehicle(validated(Vehicle, document.data, document))
    return _about_scenario(resolved(document.data, document, Path(name).parent))


def _about_vehicle(vehicle: Vehicle) -> str:
    sensors = f"{len(vehicle.gyros)} gyro and {len(vehicle.accelerometers)} accelerometer packages"
    return f"vehicle '{vehicle.name}', {len(vehicle.jets)} jets, {sensors}, units {vehicle.units}"


def _about_scenario(scenario: Scenario) -> str:
    return f"scenario '{scenario.name}', {scenario.duration_s:g} s, vehicle '{scenario.vehicle_data.name}'"


# ---------------------------------------------------------------------------------------- printing


class _Progress:
    """A progress bar on a terminal, once the work has taken a while."""

    def __init__(self, title: str, total_s: float, *, shown: bool):
        self._title = title
        self._total_s = total_s
        self._shown = shown and sys.stderr.isatty()
        self._began = time.monotonic()
        self._bar: Any = None

    def __enter__(self) -> _Progress:
        return self

    def __call__(self, reached_s: float) -> None:
        """Reports how far the simulation has got, s."""
        if not self._shown or time.monotonic() - self._began < _PROGRESS_AFTER_S:
            return
        if self._bar is None:
            from rich.progress import Progress  # noqa: PLC0415 (only for long work)

            self._bar = Progress(console=Console(stderr=True), transient=True)
            self._bar.start()
            self._task = self._bar.add_task(self._title, total=self._total_s)
        self._bar.update(self._task, completed=reached_s)

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
    from massprop_drake.signals import SYMBOLS, mass_property_units  # noqa: PLC0415
    from massprop_drake.summary import from_names  # noqa: PLC0415 (loads Drake)

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
        f"autopilot:   {autopilot['firings']} firings, {autopilot['propellant_mass']:.2f} {mass} of propellant"
        + _shortfalls(autopilot)
    )
    for key, words in (("jets_out_of_use", "out of use"), ("jets_left_in", "left in, though in question")):
        if autopilot[key]:
            console.print(f"             {words}: {', '.join(autopilot[key])}", markup=False)
    for entry in summary["detections"]:
        console.print(f"detected:    {_detected(entry, vehicle.unit_names['force'])}", soft_wrap=True)
    console.print(f"speed:       {timing['real_time_factor']:.0f} times real time")
    console.print(f"files:       {folder}/   figures: {folder}/figures/", markup=False, soft_wrap=True)


def _detected(entry: dict[str, Any], force: str) -> str:
    when = f"declared at {entry['time_s']:.2f} s, since {entry['onset_s']:.2f} s"
    kind = entry["kind"].replace("_", " ")
    if entry["cluster"] is None:
        return f"{kind}, {when}"
    where = (
        f"jet {entry['jet']} (cluster {entry['cluster']})" if entry["jet"] else f"a jet of cluster {entry['cluster']}"
    )
    withdrawn = "" if entry["withdrawn_s"] is None else f", withdrawn at {entry['withdrawn_s']:.2f} s"
    return f"{kind}: {where}, {entry['magnitude']:+.1f} +- {entry['magnitude_std']:.1f} {force}, {when}{withdrawn}"


_VERDICT_STYLES = {"holds": "green", "holds within spread": "cyan", "differs": "yellow"}


def _print_reproduction(results: list[Reproduced], folder: Path) -> None:
    """A table of claims per entry, and how many of them hold."""
    from massprop_drake.reproduction import report  # noqa: PLC0415 (loads matplotlib)

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

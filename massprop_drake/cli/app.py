"""Command line: `massprop`."""

from __future__ import annotations

import math
import sys
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from massprop_drake.cli import campaigns, completion
from massprop_drake.cli.options import (
    Compiled,
    Figures,
    Flight,
    Force,
    Guaranteed,
    Json,
    Overrides,
    Quiet,
    Report,
    Schema,
    View,
)
from massprop_drake.cli.streams import note, say
from massprop_drake.errors import InputError

app = typer.Typer(
    name="massprop",
    help="Estimates a spacecraft's mass properties in real time, and simulates the vehicle it does so for.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.add_typer(campaigns.app, name="campaign")


def _show_version(requested: bool) -> None:
    """Prints the version and ends the command, if `--version` is given."""
    if requested:
        from importlib.metadata import version

        sys.stdout.write(f"massprop {version('massprop-drake')}\n")
        raise typer.Exit


@app.callback()
def common(
    _: Annotated[
        bool, typer.Option("--version", is_eager=True, callback=_show_version, help="Show the version.")
    ] = False,
) -> None:
    """Estimates a spacecraft's mass properties and finds failed jets, in real time, and simulates the vehicle."""


@app.command("list", epilog="Example: `massprop list --json`")
def list_everything(as_json: Json = False) -> None:
    """Lists the bundled vehicles, scenarios, diagrams and campaigns, a line each."""
    from massprop_drake.cli import show
    from massprop_drake.display import graphs
    from massprop_drake.inputs.campaign_file import bundled_campaigns, campaign_description
    from massprop_drake.inputs.scenario import bundled_scenarios, load_scenario
    from massprop_drake.inputs.vehicle_file import bundled_vehicles, load_vehicle

    descriptions = {
        "vehicles": {name: load_vehicle(name).description for name in bundled_vehicles()},
        "scenarios": {name: load_scenario(name).description for name in bundled_scenarios()},
        "diagrams": {name: graphs.describe(name) for name in graphs.DIAGRAMS},
        "campaigns": {name: campaign_description(name) for name in bundled_campaigns()},
    }
    if as_json:
        show.print_json(descriptions)
    else:
        show.print_listing(descriptions)


@app.command(epilog="Example: `massprop run sample_maneuver --seed 3 --set rotation.filter=extended --out runs/ekf`")
def run(
    context: typer.Context,
    scenario: Flight,
    intervals: Guaranteed = False,
    out: Annotated[Path | None, typer.Option(help="Folder to write; default runs/<name>.")] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Replaces the scenario's seed.")] = None,
    overrides: Overrides = None,
    compiled: Compiled = False,
    view: View = False,
    live: Annotated[
        bool, typer.Option("--live", help="Show the run in a browser on this machine as it is computed.")
    ] = False,
    speed: Annotated[float, typer.Option(help="With --live: times real time.")] = 1.0,
    report: Report = True,
    figures: Figures = True,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Simulates a scenario and estimates the vehicle's mass properties in it."""
    from massprop_drake.cli import show, sources
    from massprop_drake.cli.progress import Progress
    from massprop_drake.inputs.yaml import collect_files_read
    from massprop_drake.results.folder import reserve_place

    chosen = [*(overrides or []), *([] if seed is None else [f"seed={seed}"])]
    chosen += ["execution={engine: loop, compiled: true}"] if compiled else []
    with collect_files_read() as files:
        case = sources.load_recovered_scenario(scenario, chosen)
    if not (math.isfinite(speed) and speed > 0.0):
        raise InputError(f"--speed {speed:g}: must be a number above zero, such as 10 for ten times real time")
    reads = sources.command_inputs([scenario], files)
    place = context.with_resource(reserve_place(out or Path("runs") / case.name, force=force, reads=reads))
    context.obj.watch(place.path / "summary.json", f"the run is saved in {place.shown}/")
    sources.note_doubts(case.simulation_doubts, quiet=quiet)
    save = sources.make_run_saver(place, pictures=figures, report=report, replay=view)

    from massprop_drake.runners.guaranteed_intervals import add_guaranteed_intervals
    from massprop_drake.runners.simulate import simulate

    watch = None
    if live:
        from massprop_drake.display.live import Live

        watch = Live(case, speed)
        note(f"the run is shown at {watch.address}")
    with (
        sources.report_compilation(case, quiet=quiet),
        Progress(f"simulating {case.name}", case.duration_s, shown=not (as_json or quiet)) as progress,
    ):
        result = simulate(case, progress=progress, watch=watch, folder=place.path.parent, keep=save)
        if intervals:
            result = sources.extend_or_save(add_guaranteed_intervals, result, save)
    folder = save(result)
    if as_json:
        show.print_json(result.summary)
    elif not quiet:
        show.print_simulation(result.results, case.vehicle_data, folder)


@app.command(epilog="Example: `massprop foretell small_satellite_maneuver --leak 0.02`")
def foretell(
    scenario: Flight,
    nominal: Annotated[
        bool, typer.Option("--nominal", help="About the vehicle as its file has it, not as the scenario's plant is.")
    ] = False,
    leak: Annotated[float, typer.Option(help="Share of its thrust that each suspect jet leaks.")] = 0.05,
    since: Annotated[
        float | None, typer.Option(help="From when on it leaks, s; default the middle of the flight.")
    ] = None,
    overrides: Overrides = None,
    as_json: Json = False,
) -> None:
    """Forecasts a flight before it is flown: sigmas, floors, propellant, and how soon each leak shows."""
    from massprop_drake.cli import show, sources
    from massprop_drake.runners import forecast

    case = sources.load_recovered_scenario(scenario, overrides or [])
    result = forecast.foretell(case, nominal=nominal, share=leak, since_s=since)
    if as_json:
        show.print_json(forecast.forecast_to_json(result))
    else:
        show.print_forecast(result, case.vehicle_data)


@app.command(epilog="Example: `massprop design servicer --target mass=1% --target inertia=0.5% --limit rate=1deg/s`")
def design(
    context: typer.Context,
    vehicle: Annotated[
        str,
        typer.Argument(
            help="A bundled vehicle or a YAML file of one; or a scenario, for its settings and its plant.",
            autocompletion=completion.make_completer("vehicle"),
        ),
    ],
    target: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=SIGMA", help="1-sigma that is wanted: mass=1%, center=2mm. Repeatable."),
    ] = None,
    suspect: Annotated[
        list[str] | None,
        typer.Option(help="A jet that may fail: told from all others, or several from each other. Repeatable."),
    ] = None,
    fault: Annotated[
        str, typer.Option("--force", help="That a suspect leaks, such as 5% or 0.2N; below zero: misses as it fires.")
    ] = "5%",
    limit: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=VALUE", help="Of rate, angle, displacement, propellant or time. Repeatable."),
    ] = None,
    without: Annotated[list[str] | None, typer.Option(help="A jet that is not to be fired. Repeatable.")] = None,
    spare: Annotated[str, typer.Option(help="What is to be spared: propellant or time.")] = "propellant",
    margin: Annotated[float, typer.Option(help="By which share each 1-sigma is to be smaller than asked.")] = 0.15,
    hold: Annotated[
        bool, typer.Option("--hold", help="Let the autopilot hold attitude between firings, by more of them.")
    ] = False,
    known: Annotated[
        Path | None, typer.Option("--from", help="A run's folder: go on from what is known at its end.")
    ] = None,
    flights: Annotated[int, typer.Option(help="How often the maneuver is flown, with seeds 0, 1, ....")] = 3,
    out: Annotated[Path | None, typer.Option(help="Folder to write; default runs/<vehicle>_design.")] = None,
    overrides: Overrides = None,
    report: Report = True,
    figures: Figures = True,
    replace: Annotated[
        bool, typer.Option("--keep-old", help="Keep what is there as <name>.1, <name>.2, ... instead of refusing it.")
    ] = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Designs the firings that make mass properties known, or tell which jet fails, with least propellant."""
    from massprop_drake.cli import show, sources
    from massprop_drake.inputs.yaml import collect_files_read
    from massprop_drake.results.folder import reserve_place
    from massprop_drake.studies.design import designing, saving

    with collect_files_read() as files:
        case = sources.load_vehicle_or_scenario(vehicle, overrides or [])
    name = getattr(case, "vehicle_data", case).name
    reads = sources.command_inputs([vehicle, known], files)
    place = context.with_resource(reserve_place(out or Path("runs") / f"{name}_design", force=replace, reads=reads))
    made = designing.design(
        case,
        sources.parse_assignments(target or [], "--target"),
        suspects=suspect or [],
        force=fault,
        limits=sources.parse_assignments(limit or [], "--limit"),
        without=without or [],
        spare=spare,
        margin=margin,
        hold=hold,
        known=known,
        flights=flights,
    )
    saving.save(made, place, draw=figures, report=report)
    if as_json:
        show.print_json(saving.as_data(made))
    elif not quiet:
        show.print_design(saving.verdict(made), saving.firings(made), place.shown)


class StartChoice(StrEnum):
    """The mass properties that the estimators start from."""

    nominal = "nominal"
    zero = "zero"


@app.command(epilog="Example: `massprop estimate flight.csv --vehicle orbiter --out runs/flight`")
def estimate(
    context: typer.Context,
    records: Annotated[
        list[str],
        typer.Argument(
            metavar="TELEMETRY...",
            help="A CSV or Parquet file, or several, each with its own times; or - for rows on standard input.",
        ),
    ],
    record_map: Annotated[
        Path | None,
        typer.Option("--map", help="What the columns of another program's file mean; see `massprop map`."),
    ] = None,
    vehicle: Annotated[
        str | None,
        typer.Option(
            help="A bundled vehicle or a YAML file; settings by default.",
            autocompletion=completion.make_completer("vehicle"),
        ),
    ] = None,
    like: Annotated[
        str | None,
        typer.Option(
            help="A run's folder or a scenario, for the vehicle and every setting.",
            autocompletion=completion.make_completer("scenario"),
        ),
    ] = None,
    start: Annotated[
        StartChoice | None,
        typer.Option(help="Begin at the nominal mass properties, or at zero; default as the settings say."),
    ] = None,
    resume_from: Annotated[
        Path | None, typer.Option(help="A run's folder: go on from the filter state at its end.")
    ] = None,
    against: Annotated[
        Path | None,
        typer.Option(help="A run's folder: put the record beside a simulation of its vehicle, told the same commands."),
    ] = None,
    intervals: Guaranteed = False,
    out: Annotated[Path | None, typer.Option(help="Folder to write; default runs/<name of the file>.")] = None,
    overrides: Overrides = None,
    compiled: Compiled = False,
    view: View = False,
    report: Report = True,
    figures: Figures = True,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Estimates mass properties and finds failed jets from recorded telemetry."""
    from massprop_drake.cli import show, sources
    from massprop_drake.cli.progress import Progress
    from massprop_drake.inputs.yaml import collect_files_read
    from massprop_drake.records.rows import scenario_name
    from massprop_drake.results.folder import reserve_place
    from massprop_drake.results.run_content import read_summary
    from massprop_drake.runners.simulation_comparison import compare_with_simulation, require_comparable

    telemetry: str | list[str] = records[0] if len(records) == 1 else records
    name = scenario_name(records[0])
    chosen = [*(overrides or []), *([] if start is None else [f"estimation.start={start}"])]
    chosen += ["execution.compiled=true"] if compiled else []
    if against is not None:
        read_summary(against)
        like = like or (None if vehicle or resume_from else str(against))
    with collect_files_read() as files:
        case = sources.scenario_for_record(name, vehicle, like, resume_from, chosen)
    if against is not None:
        require_comparable(case, against)  # before the work
    reads = sources.command_inputs([*records, record_map, vehicle, like, resume_from, against], files)
    place = context.with_resource(reserve_place(out or Path("runs") / name, force=force, reads=reads))
    context.obj.watch(place.path / "summary.json", f"the run is saved in {place.shown}/")
    sources.note_doubts(case.estimation_doubts, quiet=quiet)
    save = sources.make_run_saver(place, pictures=figures, report=report, replay=view)

    from massprop_drake.runners.guaranteed_intervals import add_guaranteed_intervals
    from massprop_drake.runners.recorded import estimate as estimate_record

    live = telemetry == "-" and not (as_json or quiet)
    with (
        sources.report_compilation(case, quiet=quiet),
        Progress(f"estimating {name}", 1.0, shown=telemetry != "-" and not (as_json or quiet)) as progress,
    ):
        result = estimate_record(
            telemetry,
            case,
            resume_from=resume_from,
            progress=progress,
            declared=(lambda entry: show.print_detection(entry, case.vehicle_data)) if live else None,
            said=(lambda event: show.print_event(event, case.vehicle_data)) if live else None,
            folder=place.path.parent,
            record_map=record_map,
            keep=save,
        )
        if against is not None:
            more = partial(compare_with_simulation, folder=against, spool_folder=place.path.parent)
            result = sources.extend_or_save(more, result, save)
        if intervals:
            result = sources.extend_or_save(add_guaranteed_intervals, result, save)
        folder = save(result)
    if as_json:
        show.print_json(result.summary)
    elif not quiet:
        show.print_estimation(result.results, case.vehicle_data, folder)


@app.command("map", epilog="Example: `massprop map flight.csv --vehicle my_vehicle.yaml --out flight_map.yaml`")
def map_record(
    record: Annotated[str, typer.Argument(help="A CSV, Parquet, .mat, ULog or MCAP file, or a ROS bag.")],
    vehicle: Annotated[str | None, typer.Option(help="A bundled vehicle or a YAML file, whose record it is.")] = None,
    record_map: Annotated[
        Path | None, typer.Option("--map", help="Show the first rows as this map has them, instead of proposing one.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="File to write the map to; default standard output.")] = None,
    make_vehicle: Annotated[
        Path | None, typer.Option(help="Write a vehicle's file from the parameters of a PX4 log, instead.")
    ] = None,
    mass: Annotated[float | None, typer.Option(help="With --make-vehicle: kg.")] = None,
    inertia: Annotated[
        str | None, typer.Option(metavar="IXX,IYY,IZZ", help="With --make-vehicle: principal moments, kg-m^2.")
    ] = None,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Proposes what the columns of a record mean, with reasons, and shows its first rows as understood."""
    from massprop_drake.cli import records
    from massprop_drake.inputs.vehicle_file import load_vehicle

    how = records.OutputOptions(force=force, as_json=as_json, quiet=quiet)
    if make_vehicle is not None:
        records.make_vehicle(record, make_vehicle, mass, records.parse_moments(inertia), how)
        return
    if vehicle is None:
        raise InputError("whose record is it? Give --vehicle, or --make-vehicle for a PX4 log")
    if record_map is not None:
        records.show_map(record, record_map, load_vehicle(vehicle), how)
    else:
        records.propose_map(record, load_vehicle(vehicle), out, how._replace(reads=(vehicle,)))


_Folder = Annotated[Path, typer.Argument(help="A run's folder.", autocompletion=completion.complete_run_folders)]


@app.command("compare", epilog="Example: `massprop compare runs/sample_maneuver runs/sample_maneuver_joint`")
def compare_runs(
    runs: Annotated[
        list[Path],
        typer.Argument(help="Folders of runs of one vehicle.", autocompletion=completion.complete_run_folders),
    ],
    out: Annotated[Path | None, typer.Option(help="Page to write; default runs/comparison.html.")] = None,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Compares runs: the errors and 1-sigma of their estimates in a table, what was found, and their plots overlaid."""
    from massprop_drake.cli import pages, show

    summaries, vehicle, target = pages.compare(runs, out, force=force)
    if as_json:
        show.print_json({name: show.comparison_data(results) for name, results in summaries})
    elif not quiet:
        pages.print_comparison(summaries, vehicle, target)


@app.command("view", epilog="Example: `massprop view runs/stuck_on_29 --out stuck.html`")
def view_run(
    context: typer.Context,
    folder: _Folder,
    out: Annotated[Path | None, typer.Option(help="File to write; default replay.html in the run's folder.")] = None,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Writes a run in three dimensions as one HTML file that plays without a network."""
    from massprop_drake.cli import pages

    _report_written_file(pages.write(pages.REPLAY, folder, out, force=force, watch=context.obj.watch), as_json, quiet)


@app.command("report", epilog="Example: `massprop report runs/stuck_on_29`")
def report_run(
    context: typer.Context,
    folder: _Folder,
    out: Annotated[Path | None, typer.Option(help="File to write; default report.html in the run's folder.")] = None,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Writes the report of a run again, from what is in its folder."""
    from massprop_drake.cli import pages

    _report_written_file(pages.write(pages.REPORT, folder, out, force=force, watch=context.obj.watch), as_json, quiet)


@app.command("export", epilog="Example: `massprop export runs/leak_named --to mcap --out leak.mcap`")
def export_run(
    context: typer.Context,
    folder: _Folder,
    to: Annotated[
        str,
        typer.Option(
            metavar="mcap|rerun",
            help="mcap: for Foxglove and PlotJuggler; rerun: for Rerun. Each needs the extra of its name.",
            autocompletion=completion.complete_formats,
        ),
    ],
    out: Annotated[
        Path | None, typer.Option(help="File to write; default run.mcap or run.rrd in the run's folder.")
    ] = None,
    epoch: Annotated[
        str | None,
        typer.Option(help="What time of day the run's time zero is, a date or seconds since 1970; default none."),
    ] = None,
    live: Annotated[
        bool,
        typer.Option("--live", help="Play the run to an open viewer on this machine instead; Ctrl-C ends it."),
    ] = False,
    speed: Annotated[float, typer.Option(help="With --live: times real time.")] = 1.0,
    port: Annotated[
        int | None,
        typer.Option(min=1, max=65535, help="With --live: where Foxglove is to connect to, or Rerun listens."),
    ] = None,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Writes a run for Foxglove, PlotJuggler or Rerun: signals, frames, a scene and events; or plays it to them."""
    from massprop_drake.cli import exports, show

    asked = exports.ExportOptions(to, epoch, force)
    if live:
        if out is not None:
            raise InputError("--live: writes no file; give --out without it")
        address = exports.play(folder, asked, port, speed, quiet=quiet)
        if as_json:
            show.print_json(address)
        return
    written = exports.write(folder, out, asked, context.obj.watch)
    if as_json:
        show.print_json(written._asdict())
    elif not quiet:
        say(f"{written.file}: {written.bytes / 1e6:.3g} MB, {len(written.signals)} signals, {written.rows} samples")
        for line in written.notes:
            say(f"  {line}")


def _report_written_file(target: Path, as_json: bool, quiet: bool) -> None:
    """Prints which file a command has written, in words or as JSON; if quiet, nothing."""
    from massprop_drake.cli import show

    if as_json:
        show.print_json(str(target))
    elif not quiet:
        say(target)


@app.command(hidden=True, context_settings={"ignore_unknown_options": True, "allow_extra_args": True})
def reproduce() -> None:
    """Says where the thesis is rerun: beside the package, in its repository."""
    raise InputError(
        "the thesis is rerun beside the package: 'make reproduce' in a clone of the repository, or there "
        "'python -m reproduction', which takes the options that this command took"
    )


@app.command(epilog="Example: `massprop graph closed_loop my_loop.py:build --out graphs`")
def graph(
    diagrams: Annotated[
        list[str] | None,
        typer.Argument(
            help="Names as `massprop list` shows; default all. Of your own MODULE:FUNCTION or FILE.py:FUNCTION, which "
            "takes nothing and returns a Diagram, a DiagramBuilder or a System.",
            autocompletion=completion.complete_diagrams,
        ),
    ] = None,
    like: Annotated[
        str | None,
        typer.Option(
            metavar="SCENARIO",
            help="Draw them as they are for this scenario, a name, file or run's folder.",
            autocompletion=completion.make_completer("scenario"),
        ),
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder to write.")] = Path("runs/graphs"),
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Exports graphs of diagrams as DOT and SVG, ours and your own."""
    from massprop_drake.cli import graphing, show

    written, drawn = graphing.write(graphing.find_diagram_builders(diagrams, like), out, force=force)
    if as_json:
        show.print_json([str(path) for path in written])
    elif not quiet:
        for path in written:
            say(path)
    if not drawn and not quiet:
        note("no SVG: install a program that draws it, 'pip install graphviz-pure' or Graphviz's 'dot'")


@app.command(epilog="Example: `massprop check my_vehicle.yaml flight.csv --vehicle my_vehicle.yaml`")
def check(
    files: Annotated[
        list[str] | None, typer.Argument(help="Vehicle, scenario, campaign and telemetry files, or bundled names.")
    ] = None,
    vehicle: Annotated[
        str | None,
        typer.Option(
            help="The vehicle whose telemetry it should be.", autocompletion=completion.make_completer("vehicle")
        ),
    ] = None,
    schema: Annotated[Schema | None, typer.Option(help="Show every key of a kind of file instead.")] = None,
    pairs: Annotated[int, typer.Option(min=0, help="Of a vehicle: so many pairs of jets that look alike.")] = 5,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Validates vehicle, scenario, campaign and telemetry files and says what is wrong, or shows their keys.

    Of a good vehicle it also reports how the jets push, which mass properties they show, and which jets look alike.
    """
    from massprop_drake.cli import checks, show
    from massprop_drake.inputs.vehicle_file import load_vehicle

    if schema is not None:
        keys = checks.list_schema_keys(schema)
        if as_json:
            show.print_json([key._asdict() for key in keys])
        else:
            show.print_schema(keys)
        return
    if not files:
        raise InputError("nothing to check: name a file, or --schema vehicle, scenario, campaign or map")
    telemetry_vehicle = None if vehicle is None else load_vehicle(vehicle)
    result = checks.check(files, telemetry_vehicle, pairs, report=not quiet)
    if as_json:
        show.print_json(result.findings)
    else:
        for line in result.problems if quiet else result.lines:
            (note if quiet else say)(line)
    if result.problems:
        raise typer.Exit(2)

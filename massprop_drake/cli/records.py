"""Maps of records at the command line: proposed, shown with the first rows as they are understood, and written."""

from __future__ import annotations

from pathlib import Path
from textwrap import wrap
from typing import Any, NamedTuple

from rich.table import Table

from massprop_drake.cli import show
from massprop_drake.cli.streams import note, say
from massprop_drake.cli.terminal import Terminal
from massprop_drake.errors import InputError, moment
from massprop_drake.inputs.model import validate_data
from massprop_drake.inputs.record_map import RecordMap, load_map
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.inputs.yaml import Document, to_yaml
from massprop_drake.records import channels, mapped_rows, mapping
from massprop_drake.records.evidence import describe_evidence
from massprop_drake.records.proposal import ROWS, Proposal, make_proposal
from massprop_drake.records.px4 import vehicle_from_log
from massprop_drake.records.reader import Reader
from massprop_drake.records.recording import open_recording
from massprop_drake.records.topics import Recording
from massprop_drake.results.folder import require_file, write_page

_WIDTH = 96  # of the comments in a file


class OutputOptions(NamedTuple):
    """Options of how a result is written and printed, and files that are read besides the record."""

    force: bool
    as_json: bool
    quiet: bool
    reads: tuple[str, ...] = ()


def propose_map(record: str, vehicle: Vehicle, out: Path | None, options: OutputOptions) -> None:
    """Proposes a map of a record's columns, writes it if asked, and prints it and the first rows by it.

    Raises:
        InputError: when something could not be found, or the record cannot be what the map says.
    """
    reads = [*_files_with_record(record), *options.reads]
    if out is not None:
        require_file(out, "map", force=options.force, reads=reads)
    recording = open_recording(record, None, ROWS)
    proposal = make_proposal(recording, vehicle)
    text = _map_text(proposal, record, vehicle)
    if out is not None:
        write_page(out, text, "map", yaml=True, force=options.force, reads=reads)
    if not (options.as_json or options.quiet):
        for line in text.splitlines():
            say(line)
    mapped = None
    if not proposal.lacking:
        document = Document(text, "the proposed map")
        record_map = validate_data(RecordMap, document.data, document)
        mapped = mapping.apply_map(open_recording(record, record_map, ROWS), record_map, vehicle, document.source)
    _print_map(proposal, mapped, options, recording)
    if proposal.lacking:
        raise InputError(*(f"{recording.source}: {problem}" for problem in proposal.lacking))


def show_map(record: str, map_file: Path, vehicle: Vehicle, options: OutputOptions) -> None:
    """Prints the first rows of a record as the map in a file interprets them, and the evidence for it."""
    record_map = load_map(map_file)
    recording = open_recording(record, record_map, ROWS)
    mapped, refusal = None, None
    try:
        mapped = mapping.apply_map(recording, record_map, vehicle, str(map_file))
    except InputError as error:
        refusal = error
    # units that cannot be do not hide how the jets act
    applied = mapped or mapping.apply_map(recording, record_map, vehicle, str(map_file), limits=False)
    reasons, warnings = describe_evidence(applied)
    proposal = Proposal(record_map.model_dump(mode="json"), reasons, [], [], warnings)
    if not (options.as_json or options.quiet):
        for line in reasons:
            say(line)
    if refusal is None or not options.as_json:
        _print_map(proposal, mapped, options, recording)
    if refusal is not None:
        raise refusal


def make_vehicle(
    record: str, target: Path, mass: float | None, inertia: tuple[float, float, float] | None, options: OutputOptions
) -> None:
    """Writes a vehicle's file from the parameters of a PX4 log, and prints what is assumed.

    Raises:
        InputError: when the record is no ULog, or says too little.
    """
    reads = _files_with_record(record)
    require_file(target, "vehicle", force=options.force, reads=reads)
    recording = open_recording(record)
    if recording.kind != "ulog":
        raise InputError(f"{record}: has no parameters of a vehicle, which a ULog (.ulg) has")
    vehicle = vehicle_from_log(recording, target.stem, mass, inertia)
    lines = [f"# Made of {Path(record).name}. What the log does not say:"]
    for assumption in vehicle.assumed:
        lines += _comment_lines(assumption)
    text = "\n".join(lines) + "\n" + to_yaml(vehicle.data)
    write_page(target, text, "vehicle", yaml=True, force=options.force, reads=reads)
    if options.as_json:
        show.print_json({"vehicle": str(target), "assumed": vehicle.assumed})
    elif not options.quiet:
        say(f"{target}: {len(vehicle.data['jets'])} thrusters; what is assumed stands at its beginning")


def _files_with_record(record: str) -> list[str]:
    """Returns paths that are read with a record: its own, a database's journals, a bag's metadata."""
    beside = Path(record).parent / "metadata.yaml"
    return [record, f"{record}-wal", f"{record}-shm", *([str(beside)] if beside.is_file() else [])]


def parse_moments(text: str | None) -> tuple[float, float, float] | None:
    """Parses three principal moments, kg-m^2, from an option such as 0.3,0.3,0.5; None stays None."""
    if text is None:
        return None
    try:
        first, second, third = (float(part) for part in text.split(","))
    except ValueError:
        raise InputError(f"--inertia {text}: must be three numbers, Ixx,Iyy,Izz in kg-m^2") from None
    return first, second, third


def _map_text(proposal: Proposal, record: str, vehicle: Vehicle) -> str:
    """Formats a proposed map as YAML text, with the reasons for it, and what it lacks, as comments."""
    lines = [f"# Proposed for {Path(record).name} and vehicle {vehicle.name}. Why it is so:"]
    for reason in proposal.reasons:
        lines += _comment_lines(reason)
    if proposal.lacking:
        lines.append("# What is to be filled in:")
        for problem in proposal.lacking:
            lines += _comment_lines(problem)
    order = ("topic", "time", "sensors", "commands", "csv")
    data = {key: proposal.data[key] for key in order if key in proposal.data}
    return "\n".join(lines) + "\n" + to_yaml(data)


def _comment_lines(text: str) -> list[str]:
    """Wraps a sentence into lines of a YAML comment."""
    printable = "".join(character if character.isprintable() else " " for character in text)
    first, others = "# - ", "#   "
    return wrap(
        printable,
        _WIDTH,
        initial_indent=first,
        subsequent_indent=others,
        break_long_words=False,
        break_on_hyphens=False,
    )


def _print_map(
    proposal: Proposal, mapped: channels.Mapped | None, options: OutputOptions, recording: Recording
) -> None:
    """Prints a record's first rows by a map, and notes on the record; as JSON the map, too."""
    rows = [] if mapped is None else mapped_rows.preview_rows(mapped)
    row_notes = () if mapped is None else (*mapped.notes, *_find_refusals(mapped))
    losses = [f"{loss.kind}: {loss.text}" for loss in recording.losses]
    facts = list(dict.fromkeys([*recording.information, *(() if mapped is None else mapped.information)]))
    notes = list(dict.fromkeys([*losses, *recording.notes, *proposal.warnings, *row_notes]))
    if options.as_json:
        explanation = {"reasons": proposal.reasons, "lacking": proposal.lacking, "left_out": proposal.left_out}
        show.print_json({"map": proposal.data, **explanation, "rows": rows, "notes": [*facts, *notes]})
    elif not options.quiet:
        if mapped is not None:
            Terminal(120).print(_make_rows_table(mapped, rows))
        for sentence in facts:
            note(sentence)
        for sentence in notes:
            note(f"warning: {sentence}")


def _find_refusals(mapped: channels.Mapped) -> list[str]:
    """Lists reasons for which massprop estimate would refuse the record as mapped; empty: none."""
    vehicle = mapped.vehicle
    gyro = None if vehicle.needs_pose_filter or not vehicle.gyros else vehicle.gyros[0].name
    try:
        reader = Reader(
            mapped_rows.make_table(mapped, gyro, own_times=mapped_rows.is_oversampled(mapped)),
            vehicle,
            gyro=gyro,
        )
        reader.own_times = mapped_rows.is_oversampled(mapped)
        for _ in reader:
            pass
    except InputError as error:
        return [f"'massprop estimate' will refuse it as it stands: {problem}" for problem in error.problems]
    return []


def _make_rows_table(mapped: channels.Mapped, rows: list[dict[str, Any]]) -> Table:
    """Makes a table of a record's first rows: a line per sensor component, and one for the open jets."""
    table = Table(title="the first rows as they are understood", title_justify="left", header_style="bold")
    table.add_column("")
    for row in rows:
        table.add_column(f"{moment(row['time_s'])} s", justify="right")
    for name, channel in mapped.channels.items():
        for component in channels.COMPONENTS[channel.kind][: channel.values.shape[1]]:
            values = [row["sensors"][name][component] for row in rows]
            if any(value is not None for value in values):
                unit = _unit_suffix(mapped, channel, component)
                table.add_row(f"{name} {component}{unit}", *("-" if one is None else f"{one:.5g}" for one in values))
    table.add_row("jets open", *(_open_jets_text(row["jets"]) for row in rows))
    return table


def _unit_suffix(mapped: channels.Mapped, channel: channels.Channel, component: str) -> str:
    """Returns the unit of a channel's component, after a blank; empty where it has none."""
    if component.startswith("q_") or component == "level":
        return ""
    length = mapped.vehicle.unit_names["length"]
    by_kind = {"gyro": "rad/s", "wheel": "rad/s", "engine": "rad", "velocity": f"{length}/s", "pose": length}
    integrates = channel.gives in ("integral", "increment")
    return " " + by_kind.get(channel.kind, f"{length}/s" if integrates else f"{length}/s^2")


def _open_jets_text(shares: dict[str, float | None]) -> str:
    """Formats the jets open in a row, with the share of the row where it is below 1 and ? where unknown."""
    shown = []
    for name, share in shares.items():
        shown.append(f"{name} ?" if share is None else name if share == 1.0 else f"{name} {share:.2f}")
    return " ".join(shown) or "none"

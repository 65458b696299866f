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


def propose_map(record: str, vehicle: Vehicle, out: Path | None, how: OutputOptions) -> None:
    """Proposes a map of a record's columns, writes it if asked, and prints it and the first rows by it.

    Raises:
        InputError: when something could not be found, or the record cannot be what the map says.
    """
    reads = [*_files_with_record(record), *how.reads]
    if out is not None:
        require_file(out, "map", force=how.force, reads=reads)
    recording = open_recording(record, None, ROWS)
    found = make_proposal(recording, vehicle)
    text = _map_text(found, record, vehicle)
    if out is not None:
        write_page(out, text, "map", yaml=True, force=how.force, reads=reads)
    if not (how.as_json or how.quiet):
        for line in text.splitlines():
            say(line)
    understood = None
    if not found.lacking:
        document = Document(text, "the proposed map")
        by = validate_data(RecordMap, document.data, document)
        understood = mapping.apply_map(open_recording(record, by, ROWS), by, vehicle, document.source)
    _print_map(found, understood, how, recording)
    if found.lacking:
        raise InputError(*(f"{recording.source}: {one}" for one in found.lacking))


def show_map(record: str, file: Path, vehicle: Vehicle, how: OutputOptions) -> None:
    """Prints the first rows of a record as the map in a file interprets them, and the evidence for it."""
    by = load_map(file)
    recording = open_recording(record, by, ROWS)
    understood, refusal = None, None
    try:
        understood = mapping.apply_map(recording, by, vehicle, str(file))
    except InputError as error:
        refusal = error
    # units that cannot be do not hide how the jets act
    applied = understood or mapping.apply_map(recording, by, vehicle, str(file), limits=False)
    reasons, warnings = describe_evidence(applied)
    found = Proposal(by.model_dump(mode="json"), reasons, [], [], warnings)
    if not (how.as_json or how.quiet):
        for line in reasons:
            say(line)
    if refusal is None or not how.as_json:
        _print_map(found, understood, how, recording)
    if refusal is not None:
        raise refusal


def make_vehicle(
    record: str, target: Path, mass: float | None, inertia: tuple[float, float, float] | None, how: OutputOptions
) -> None:
    """Writes a vehicle's file from the parameters of a PX4 log, and prints what is assumed.

    Raises:
        InputError: when the record is no ULog, or says too little.
    """
    reads = _files_with_record(record)
    require_file(target, "vehicle", force=how.force, reads=reads)
    recording = open_recording(record)
    if recording.kind != "ulog":
        raise InputError(f"{record}: has no parameters of a vehicle, which a ULog (.ulg) has")
    made = vehicle_from_log(recording, target.stem, mass, inertia)
    lines = [f"# Made of {Path(record).name}. What the log does not say:"]
    for one in made.assumed:
        lines += _comment(one)
    text = "\n".join(lines) + "\n" + to_yaml(made.data)
    write_page(target, text, "vehicle", yaml=True, force=how.force, reads=reads)
    if how.as_json:
        show.print_json({"vehicle": str(target), "assumed": made.assumed})
    elif not how.quiet:
        say(f"{target}: {len(made.data['jets'])} thrusters; what is assumed stands at its beginning")


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


def _map_text(found: Proposal, record: str, vehicle: Vehicle) -> str:
    """Formats a proposed map as YAML text, with the reasons for it, and what it lacks, as comments."""
    lines = [f"# Proposed for {Path(record).name} and vehicle {vehicle.name}. Why it is so:"]
    for reason in found.reasons:
        lines += _comment(reason)
    if found.lacking:
        lines.append("# What is to be filled in:")
        for one in found.lacking:
            lines += _comment(one)
    order = ("topic", "time", "sensors", "commands", "csv")
    data = {key: found.data[key] for key in order if key in found.data}
    return "\n".join(lines) + "\n" + to_yaml(data)


def _comment(text: str) -> list[str]:
    """Wraps a sentence into lines of a YAML comment."""
    printable = "".join(one if one.isprintable() else " " for one in text)
    first, others = "# - ", "#   "
    return wrap(
        printable,
        _WIDTH,
        initial_indent=first,
        subsequent_indent=others,
        break_long_words=False,
        break_on_hyphens=False,
    )


def _print_map(found: Proposal, understood: channels.Mapped | None, how: OutputOptions, recording: Recording) -> None:
    """Prints a record's first rows by a map, and notes on the record; as JSON the map, too."""
    rows = [] if understood is None else mapped_rows.preview_rows(understood)
    of_rows = () if understood is None else (*understood.notes, *_find_refusals(understood))
    losses = [f"{one.kind}: {one.text}" for one in recording.losses]
    facts = list(dict.fromkeys([*recording.information, *(() if understood is None else understood.information)]))
    notes = list(dict.fromkeys([*losses, *recording.notes, *found.warnings, *of_rows]))
    if how.as_json:
        said = {"reasons": found.reasons, "lacking": found.lacking, "left_out": found.left_out}
        show.print_json({"map": found.data, **said, "rows": rows, "notes": [*facts, *notes]})
    elif not how.quiet:
        if understood is not None:
            Terminal(120).print(_make_rows_table(understood, rows))
        for sentence in facts:
            note(sentence)
        for sentence in notes:
            note(f"warning: {sentence}")


def _find_refusals(understood: channels.Mapped) -> list[str]:
    """Lists reasons for which massprop estimate would refuse the record as mapped; empty: none."""
    vehicle = understood.vehicle
    gyro = None if vehicle.needs_pose_filter or not vehicle.gyros else vehicle.gyros[0].name
    try:
        reader = Reader(
            mapped_rows.make_table(understood, gyro, own_times=mapped_rows.is_oversampled(understood)),
            vehicle,
            gyro=gyro,
        )
        reader.own_times = mapped_rows.is_oversampled(understood)
        for _ in reader:
            pass
    except InputError as error:
        return [f"'massprop estimate' will refuse it as it stands: {one}" for one in error.problems]
    return []


def _make_rows_table(understood: channels.Mapped, rows: list[dict[str, Any]]) -> Table:
    """Makes a table of a record's first rows: a line per sensor component, and one for the open jets."""
    table = Table(title="the first rows as they are understood", title_justify="left", header_style="bold")
    table.add_column("")
    for row in rows:
        table.add_column(f"{moment(row['time_s'])} s", justify="right")
    for name, channel in understood.channels.items():
        for component in channels.COMPONENTS[channel.kind][: channel.values.shape[1]]:
            values = [row["sensors"][name][component] for row in rows]
            if any(value is not None for value in values):
                unit = _unit_suffix(understood, channel, component)
                table.add_row(f"{name} {component}{unit}", *("-" if one is None else f"{one:.5g}" for one in values))
    table.add_row("jets open", *(_open_jets_text(row["jets"]) for row in rows))
    return table


def _unit_suffix(understood: channels.Mapped, channel: channels.Channel, component: str) -> str:
    """Returns the unit of a channel's component, after a blank; empty where it has none."""
    if component.startswith("q_") or component == "level":
        return ""
    length = understood.vehicle.unit_names["length"]
    by_kind = {"gyro": "rad/s", "wheel": "rad/s", "engine": "rad", "velocity": f"{length}/s", "pose": length}
    integrates = channel.gives in ("integral", "increment")
    return " " + by_kind.get(channel.kind, f"{length}/s" if integrates else f"{length}/s^2")


def _open_jets_text(jets: dict[str, float | None]) -> str:
    """Formats the jets open in a row, with the share of the row where it is below 1 and ? where unknown."""
    shown = []
    for name, share in jets.items():
        shown.append(f"{name} ?" if share is None else name if share == 1.0 else f"{name} {share:.2f}")
    return " ".join(shown) or "none"

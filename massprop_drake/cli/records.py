"""Maps of records at the command line: proposed, shown with the first rows as they are understood, and written."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.table import Table

from massprop_drake.cli.show import Terminal
from massprop_drake.cli.streams import note
from massprop_drake.errors import InputError
from massprop_drake.inputs.model import validated
from massprop_drake.inputs.record_map import RecordMap, load_map
from massprop_drake.inputs.vehicle import Vehicle
from massprop_drake.inputs.yaml import Document, to_yaml
from massprop_drake.records import mapping
from massprop_drake.records.proposal import ROWS, Proposal, propose
from massprop_drake.records.px4 import vehicle_of
from massprop_drake.records.recording import Recording, open_recording

_WIDTH = 96  # of the comments in a file


def proposed(record: str, vehicle: Vehicle) -> tuple[Recording, Proposal]:
    """Proposes a map from the first rows of a record."""
    recording = open_recording(record, None, ROWS)
    return recording, propose(recording, vehicle)


def map_text(found: Proposal, record: str, vehicle: Vehicle) -> str:
    """A proposed map as a file, with its reasons as comments."""
    lines = [f"# Proposed for {Path(record).name} and vehicle {vehicle.name}. Why it is so:"]
    for reason in found.reasons:
        lines += _comment(reason)
    if found.lacking:
        lines.append("# What is to be filled in:")
        for one in found.lacking:
            lines += _comment(one)
    order = ("topic", "time", "sensors", "commands")
    data = {key: found.data[key] for key in order if key in found.data}
    return "\n".join(lines) + "\n" + to_yaml(data)


def _comment(text: str) -> list[str]:
    """A sentence as lines of a comment."""
    lines, line = [], "# -"
    for word in "".join(one if one.isprintable() else " " for one in text).split():
        if len(line) + len(word) >= _WIDTH:
            lines.append(line)
            line = "#  "
        line += f" {word}"
    return [*lines, line]


def understood(record: str, by: RecordMap, vehicle: Vehicle, source: str) -> mapping.Mapped:
    """A record by a map, from its first rows."""
    return mapping.mapped(open_recording(record, by, ROWS), by, vehicle, source)


def by_proposal(record: str, text: str, vehicle: Vehicle) -> mapping.Mapped:
    """A record by a map that is proposed."""
    document = Document(text, "the proposed map")
    return understood(record, validated(RecordMap, document.data, document), vehicle, "the proposed map")


def by_file(record: str, file: str | Path, vehicle: Vehicle) -> mapping.Mapped:
    """A record by the map of a file."""
    return understood(record, load_map(file), vehicle, str(file))


def vehicle_text(
    record: str, name: str, mass: float | None, inertia: tuple[float, float, float] | None
) -> tuple[str, list[str]]:
    """A vehicle's file from the parameters of a log, and what is assumed in it.

    Raises:
        InputError: when the record is no ULog, or says too little.
    """
    recording = open_recording(record)
    if recording.kind != "ulog":
        raise InputError(f"{record}: has no parameters of a vehicle, which a ULog (.ulg) has")
    made = vehicle_of(recording, name, mass, inertia)
    lines = [f"# Made of {Path(record).name}. What the log does not say:"]
    for one in made.assumed:
        lines += _comment(one)
    return "\n".join(lines) + "\n" + to_yaml(made.data), made.assumed


def moments(text: str | None) -> tuple[float, float, float] | None:
    """Principal moments from an option, such as 0.3,0.3,0.5."""
    if text is None:
        return None
    parts = text.split(",")
    try:
        first, second, third = (float(part) for part in parts)
    except ValueError:
        raise InputError(f"--inertia {text}: must be three numbers, Ixx,Iyy,Izz in kg-m^2") from None
    return first, second, third


def show_rows(record: mapping.Mapped) -> None:
    """Prints the first rows as they are understood."""
    rows = mapping.preview(record)
    units = _units(record)
    table = Table(title="the first rows as they are understood", title_justify="left", header_style="bold")
    table.add_column("")
    for row in rows:
        table.add_column(f"{row['time_s']:.6g} s", justify="right")
    for name, channel in record.channels.items():
        for component in mapping.COMPONENTS[channel.kind]:
            values = [row["sensors"][name][component] for row in rows]
            if any(value is not None for value in values):
                unit = "" if component.startswith("q_") else f" {units[name]}"
                table.add_row(f"{name} {component}{unit}", *("-" if one is None else f"{one:.5g}" for one in values))
    table.add_row("jets open", *(_open(row["jets"]) for row in rows))
    console = Terminal(120)
    console.print(table)
    for sentence in record.notes:
        note(f"warning: {sentence}")


def _units(record: mapping.Mapped) -> dict[str, str]:
    length = record.vehicle.unit_names["length"]
    by_kind = {"gyro": "rad/s", "velocity": f"{length}/s", "pose": length, "attitude": ""}
    found = {}
    for name, channel in record.channels.items():
        integrates = channel.gives in ("integral", "increment")
        found[name] = by_kind.get(channel.kind, f"{length}/s" if integrates else f"{length}/s^2")
    return found


def _open(jets: dict[str, float | None]) -> str:
    shown = [name if share == 1.0 else f"{name} {'?' if share is None else format(share, '.2f')}" for name, share in jets.items()]
    return " ".join(shown) or "none"


def as_data(data: dict[str, Any], reasons: Sequence[str], lacking: Sequence[str], record: mapping.Mapped | None) -> Any:
    """What is printed with --json."""
    return {
        "map": data,
        "reasons": list(reasons),
        "lacking": list(lacking),
        "rows": None if record is None else mapping.preview(record),
        "notes": [] if record is None else list(record.notes),
    }

"""Checks of vehicle, scenario, campaign, map and telemetry files, and the keys that they may have."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from massprop_drake.cli import show
from massprop_drake.cli.options import Schema
from massprop_drake.errors import InputError, counted
from massprop_drake.inputs.campaign_file import (
    CampaignSpec,
    bundled_campaigns,
    campaign_from,
    campaign_keys,
    load_campaign,
)
from massprop_drake.inputs.kinds import file_kind
from massprop_drake.inputs.model import Key, list_keys, validate_data
from massprop_drake.inputs.record_map import RecordMap, map_keys
from massprop_drake.inputs.scenario import Scenario, bundled_scenarios, load_scenario, resolve_scenario
from massprop_drake.inputs.vehicle_file import Vehicle, bundled_vehicles, load_vehicle
from massprop_drake.inputs.yaml import Document, read_text
from massprop_drake.records.recording import require_table
from massprop_drake.records.structure_check import check as check_telemetry
from massprop_drake.records.tables import require_file

_TELEMETRY = (".csv", ".tsv", ".parquet", ".pq")  # endings of telemetry files


KEYS: Mapping[Schema, Callable[[], list[Key]]] = {
    Schema.vehicle: partial(list_keys, Vehicle),
    Schema.scenario: partial(list_keys, Scenario),
    Schema.campaign: campaign_keys,
    Schema.map: map_keys,
}


def list_schema_keys(schema: Schema) -> list[Key]:
    """Lists the keys that a kind of file may have; those of a scenario leave out its vehicle's."""
    return [key for key in KEYS[schema]() if not key.name.startswith("vehicle.")]


class CheckFindings(NamedTuple):
    """Findings of a check of files.

    Attributes:
        findings: of each file, as JSON has it.
        lines: the same in words.
        problems: those of the lines that say what is wrong.
    """

    findings: list[dict[str, Any]]
    lines: list[str]
    problems: list[str]


def check(names: Iterable[str], vehicle: Vehicle | None, n_pairs: int, *, report: bool) -> CheckFindings:
    """Validates files; returns the findings on each as JSON data, the same in words, and the problems.

    Args:
        names: of files, or bundled ones.
        vehicle: that telemetry should be of.
        n_pairs: number of pairs of jets that look alike, in the report on a vehicle.
        report: whether a vehicle is reported on.
    """
    result = CheckFindings([], [], [])
    for name in names:
        try:
            content = read_checked_file(name, vehicle)
        except InputError as error:
            result.findings.append({"file": name, "ok": False, "findings": list(error.problems)})
            lines = _drop_repeated(name, error.problems, result.problems)
            result.problems.extend(lines)
            result.lines.extend(lines)
            continue
        description = content.words if isinstance(content, InputDescription) else show.describe_input(content)
        doubts = list(map(str, content.doubts))
        result.findings.append({"file": name, "ok": True, "findings": [description], "warnings": doubts})
        result.lines.extend([f"{name}: ok: {description}", *(f"{name}: warning: {doubt}" for doubt in doubts)])
        if isinstance(content, Vehicle) and report:
            from massprop_drake.studies.vehicle_report import vehicle_report  # noqa: PLC0415 (slow to load)

            facts = result.findings[-1]["report"] = vehicle_report(content, n_pairs)
            result.lines.extend(show.vehicle_lines(facts, content.unit_names))
    return result


def _drop_repeated(name: str, problems: Sequence[str], reported: Sequence[str]) -> list[str]:
    """Drops problems of a scenario that its vehicle's file has already reported; adds a line with their number."""
    known = {one.partition(": vehicle: ")[2] or one for one in reported}
    new = [one for one in problems if (one.partition(": vehicle: ")[2] or one) not in known or one in reported]
    repeated = counted(len(problems) - len(new), "problem")
    return new if len(new) == len(problems) else [*new, f"{name}: {repeated} of the vehicle, told above"]


class InputDescription(NamedTuple):
    """Description of a good file in words.

    Attributes:
        words: a line.
        doubts: on what may be meant otherwise, a sentence each.
    """

    words: str
    doubts: Sequence[str] = ()


def read_checked_file(name: str, vehicle: Vehicle | None) -> Vehicle | Scenario | CampaignSpec | InputDescription:
    """Reads and validates a file; returns its model, of telemetry and maps a description; raises InputError."""
    require_file(Path(name))
    if Path(name).suffix.lower() in _TELEMETRY:
        findings = check_telemetry(Path(name), vehicle)
        return InputDescription(show.describe_telemetry(findings, vehicle), findings["notes"])
    if name in bundled_vehicles():
        return load_vehicle(name)
    if name in bundled_scenarios():
        return _require_flyable(load_scenario(name), name)
    if name in bundled_campaigns():
        return load_campaign(name)
    require_table(name)
    document = Document(read_text(Path(name)), name)
    kind = file_kind(document.data)
    if kind == "vehicle":
        return validate_data(Vehicle, document.data, document)
    if "commands" in document.data and "sensors" in document.data:
        return InputDescription(show.describe_map(validate_data(RecordMap, document.data, document)))
    if kind == "campaign":
        return campaign_from(document, Path(name).parent)
    return _require_flyable(resolve_scenario(document.data, document, Path(name).parent), name)


def _require_flyable(scenario: Scenario, name: str) -> Scenario:
    """Returns the scenario; raises InputError where Drake cannot fly its multibody model."""
    if scenario.plant.kind == "multibody":
        from massprop_drake.diagrams.multibody_body import require_model  # noqa: PLC0415 (loads Drake's multibody library)

        try:
            require_model(scenario)
        except InputError as error:
            raise InputError(*(f"{name}: {problem.removeprefix('scenario: ')}" for problem in error.problems)) from None
    return scenario

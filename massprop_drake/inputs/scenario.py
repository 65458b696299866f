"""Scenarios: one case to simulate, and how to estimate in it; read from YAML and validated."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from pydantic import ModelWrapValidatorHandler, model_validator

from massprop_drake.errors import InputError, dotted
from massprop_drake.inputs import renamed
from massprop_drake.inputs.estimation_blocks import USUAL_FILTER, FaultsBlock
from massprop_drake.inputs.kinds import bundled_files
from massprop_drake.inputs.model import Model, field_validation_error, keys_of_former_kind, validate_data
from massprop_drake.inputs.model_file import model_text
from massprop_drake.inputs.plausible import Finding
from massprop_drake.inputs.scenario_checks import check_against_vehicle, scenario_findings, schedule_problems
from massprop_drake.inputs.scenario_fields import USUAL_VEHICLE, ScenarioFields
from massprop_drake.inputs.vehicle_checks import Problem
from massprop_drake.inputs.vehicle_file import Vehicle, load_vehicle
from massprop_drake.inputs.yaml import Document, FieldPath, exists, open_document

_INDEX = re.compile(r"[0-9]{1,6}")
_ESTIMATION = ("vehicle", "estimation", "rotation", "mass", "joint", "detector", "faults")
# detectors that a filter goes with, the usual one first
DETECTORS_OF = {"thesis": ("cglr", "cusum", "off"), "joint": ("hypotheses", "off"), "pose": ("thrust_factors", "off")}
# keys that speak to one filter alone
_KEYS_OF: dict[str, tuple[tuple[str, ...], ...]] = {
    "thesis": (
        ("rotation",),
        ("mass",),
        ("sensors", "combine"),
        ("estimation", "thrust_transient"),
        ("estimation", "thrust_uncertainty"),
    ),
    "joint": (("joint",), ("faults",)),
}


class Scenario(ScenarioFields):
    """One case: a vehicle, its commands and failures, and how its mass properties are estimated.

        Scenario(vehicle="servicer", duration_s=60.0, failures=[{"jet": "YP1", "kind": "stuck_on", "start_s": 30.0}])

    Files that it names are relative to the current folder; `load_scenario` reads one from a file.

    Raises:
        ValueError: naming each field that is wrong, or that does not go with the vehicle.
    """

    @model_validator(mode="wrap")
    @classmethod
    def _fill_in_defaults(cls, data: Any, validate: ModelWrapValidatorHandler[Scenario]) -> Scenario:
        """Validates a scenario after loading a vehicle that is named, and setting filter and dependent defaults."""
        if not isinstance(data, dict):
            return validate(data)
        if isinstance(data.get("vehicle"), str):  # in a program; names in files are `resolve_scenario` beside those
            data = {**data, "vehicle": load_vehicle(data["vehicle"])}
        data = _update_detector_terms(_inline_model_text(data, None, Path()))
        chosen, filled = filter_of(data), dict(data)
        kinds = {"plant": {"kind": "rigid"}, "estimation": {"filter": chosen}}
        if chosen in DETECTORS_OF:
            kinds["detector"] = {"kind": DETECTORS_OF[chosen][0]}
        for block, default in kinds.items():
            if isinstance(data.get(block, {}), dict):
                filled[block] = {**default, **data.get(block, {})}
        transient, joint = _block_value(data.get("plant"), "thrust_transient", "vehicle"), data.get("joint", {})
        takes_plant_transient = chosen == "joint" and isinstance(joint, dict) and joint.get("thrust_transient") is None
        if takes_plant_transient and transient in ("none", "vehicle"):
            filled["joint"] = {**joint, "thrust_transient": transient}
        scenario = validate(filled)
        if _block_value(data.get("estimation"), "filter", None) is None:
            scenario.estimation.model_fields_set.discard("filter")  # `doubts` tells of it
        return scenario

    @model_validator(mode="after")
    def _require_consistent_scenario(self) -> Scenario:
        """Raises ValidationError for foreign keys of a filter, overlapping schedules, or a misfit to the vehicle."""
        problems = list(_foreign_to_filter(self)) or list(schedule_problems(self))
        if not problems and isinstance(self.vehicle, Vehicle):  # an `Estimator` has its own beside the usual one
            problems = check_against_vehicle(self, self.vehicle)
        if problems:
            raise field_validation_error(problems)
        return self

    @property
    def doubts(self) -> list[Finding]:
        """Doubtful entries of the scenario and its vehicle, more likely a slip than meant."""
        vehicle = self.vehicle_data
        own = [finding for finding in scenario_findings(self, vehicle) if not finding.impossible]
        own += _filter_chosen_by_keys(self)
        return [finding._replace(path=("vehicle", *finding.path)) for finding in vehicle.doubts] + own

    @property
    def simulation_doubts(self) -> list[Finding]:
        """Doubts that bear on a simulation: a run may be cut short before the last of its commands."""
        late = {(field, "start_s") for field in ("maneuver", "jet_schedule")}
        return [finding for finding in self.doubts if (finding.path[0], finding.path[-1]) not in late]

    @property
    def estimation_doubts(self) -> list[Finding]:
        """Doubts that bear on estimation from a record, too."""
        return [finding for finding in self.doubts if finding.path[0] in _ESTIMATION]


def filter_of(data: Mapping[str, Any]) -> str:
    """Returns the filter, thesis, joint or pose, that a scenario's unvalidated data name or imply by their keys.

    Where none is named it is the usual one, unless there are keys of another and none of the usual one's: so it is in
    files of before there was a choice.
    """
    stated = _block_value(data.get("estimation"), "filter", None)
    if stated is not None:
        return str(stated)
    if _needs_pose_filter(data.get("vehicle")):
        return "pose"
    implied = {name for name, paths in _KEYS_OF.items() if any(value_at(data, path) is not None for path in paths)}
    kind = _block_value(data.get("detector"), "kind", "off")
    implied |= {name for name, kinds in DETECTORS_OF.items() if kind in kinds and kind != "off"}
    return implied.pop() if len(implied) == 1 else USUAL_FILTER


def _needs_pose_filter(vehicle: Any) -> bool:
    """Tests whether a vehicle, or its data that may not be validated yet, is one for `estimation.filter: pose`."""
    if isinstance(vehicle, Mapping):
        poses = [pose for pose in vehicle.get("poses") or () if isinstance(pose, Mapping)]
        located = bool(vehicle.get("velocities")) or any(pose.get("position_std") is not None for pose in poses)
        return located or vehicle.get("motion") == "planar"
    return isinstance(vehicle, Vehicle) and vehicle.needs_pose_filter


def _block_value(block: Any, key: str, default: str | None) -> Any:
    """Returns the value of a key of a block, a mapping or a model; the default where it lacks the key."""
    return block.get(key, default) if isinstance(block, dict) else getattr(block, key, default)


def _foreign_to_filter(scenario: Scenario) -> Iterator[Problem]:
    """Yields a problem for each key, and for the detector, of another filter than the scenario's."""
    named, detector = scenario.estimation.filter, scenario.detector.kind
    for other, path in [(other, path) for other, paths in _KEYS_OF.items() if other != named for path in paths]:
        block: Any = scenario
        for part in path[:-1]:
            block = getattr(block, part)
        value, default = getattr(block, path[-1]), type(block).model_fields[path[-1]].default
        key_paths: list[FieldPath] = [path] if value != default else []
        if isinstance(value, Model):
            keys = [key for key in type(value).model_fields if getattr(value, key) != getattr(default, key)]
            key_paths = [(*path, key) for key in keys]
        for key_path in key_paths:
            problem = (
                f"is a key of estimation.filter: {other}, and the filter is {named}; leave it out, or name the other"
            )
            yield key_path, problem
    if detector not in DETECTORS_OF[named]:
        allowed = " or ".join(DETECTORS_OF[named])
        yield ("detector", "kind"), f"{detector} does not go with estimation.filter: {named}; use {allowed}"


def _filter_chosen_by_keys(scenario: Scenario) -> Iterator[Finding]:
    """Yields a doubt where the filter is not named but chosen, against the usual one, by keys of its own."""
    chosen = scenario.estimation.filter
    if chosen not in _KEYS_OF or chosen == USUAL_FILTER or "filter" in scenario.estimation.model_fields_set:
        return
    keys = [path for path in _KEYS_OF[chosen] if _is_given(scenario, path)] or [("detector", "kind")]
    names = ", ".join(map(dotted, keys))
    problem = (
        f"is {chosen}, chosen by {names}: write filter: {chosen} if that is meant; without {names} it is "
        f"{USUAL_FILTER}, which uses all sensor packages as they are"
    )
    yield Finding(("estimation", "filter"), problem, False)


def _is_given(model: Any, path: FieldPath) -> bool:
    """Tests whether the key at a path in a model was set, not left at its default."""
    first, *nested = path
    return first in model.model_fields_set and (not nested or _is_given(getattr(model, str(first)), tuple(nested)))


def bundled_scenarios() -> list[str]:
    """Lists the names of the bundled scenarios."""
    return bundled_files("scenario")


def load_scenario(scenario: str | Path, overrides: list[str] | None = None) -> Scenario:
    """Loads a bundled scenario by name, or one from a YAML file or a run's folder, together with its vehicle.

    Args:
        scenario: a name that `massprop list` shows, or the path of a file or of a run's folder.
        overrides: `KEY=VALUE` each, KEY dotted (`sensors.errors[0].noise_std`, `vehicle.gyros[0].quantum`), VALUE
            read as YAML.

    Raises:
        InputError: when there is none of that name, or its data are wrong; the message says where.
    """
    document, folder = open_document(scenario, "scenario")
    for override in overrides or []:
        if override.startswith("vehicle."):
            _spell_out_vehicle(document, folder)
        set_field(document.data, override, document.overridden)
    return resolve_scenario(document.data, document, folder)


def _spell_out_vehicle(document: Document, folder: Path) -> None:
    """Replaces a vehicle's name in a scenario's document by the vehicle's data, so that its fields can be set."""
    vehicle = document.data.get("vehicle", USUAL_VEHICLE)
    if isinstance(vehicle, str):
        document.data["vehicle"] = _load_named_vehicle(vehicle, folder, document).model_dump(mode="json")


def resolve_scenario(data: Any, document: Document | None = None, folder: Path | None = None) -> Scenario:
    """Makes a validated scenario from data, loads its vehicle and checks one against the other.

    Args:
        data: a mapping of a scenario's fields.
        document: the document it came from, for messages.
        folder: what a vehicle's file is relative to; default the current one.

    Raises:
        InputError: naming each field that is wrong.
    """
    data = _inline_model_text(data, document, folder or Path())
    vehicle = data.get("vehicle", USUAL_VEHICLE)
    if isinstance(vehicle, dict):  # validated by itself, so that messages name its fields
        vehicle_document = (document or Document("{}", "scenario")).under(("vehicle",))
        vehicle = validate_data(Vehicle, vehicle, vehicle_document)
    elif isinstance(vehicle, str):
        vehicle = _load_named_vehicle(vehicle, folder or Path(), document)
    data = _update_detector_terms({**data, "vehicle": vehicle}, document)
    return validate_data(Scenario, data, document, "scenario")


def _inline_model_text(data: Any, document: Document | None, folder: Path) -> Any:
    """Returns a scenario's data with the text of a multibody model in place of its file name."""
    plant = data.get("plant")
    model = plant.get("model") if isinstance(plant, dict) else None
    if not isinstance(model, str) or plant.get("kind") != "multibody":
        return data
    try:
        return {**data, "plant": {**plant, "model": model_text(model, folder)}}
    except InputError as error:
        location = "scenario: plant.model" if document is None else document.where(("plant", "model"))
        raise InputError(*(f"{location}: {problem}" for problem in error.problems)) from None


def _update_detector_terms(data: Any, document: Document | None = None) -> Any:
    """Returns a scenario's data with former terms of the detector replaced, with one warning of all."""
    if not isinstance(data, dict):
        return data
    faults, default_kind = data.get("faults"), DETECTORS_OF.get(filter_of(data), ("off",))[0]
    if isinstance(faults, FaultsBlock):  # a program's; `slots` may have to be put in
        data = {**data, "faults": faults.model_dump(mode="json", exclude_unset=True)}
    data, messages = renamed.update_detector_terms(data, default_kind)
    if messages:
        renamed.warn(f"{'scenario' if document is None else document.source}: {', '.join(messages)}", 4)
    if messages and document is not None and "slots" not in data["detector"]:
        document.move(("detector", "slots"), ("faults", "slots"))
    return data


def _load_named_vehicle(name: str, folder: Path, document: Document | None) -> Vehicle:
    """Loads the vehicle that a scenario names: a file beside the scenario, or else a bundled one."""
    path = Path(os.path.normpath(folder / name))
    try:
        return load_vehicle(path if exists(path) else name)
    except InputError as error:
        if document is None:
            raise
        raise InputError(*(f"{document.where(('vehicle',))}: {problem}" for problem in error.problems)) from None


def set_field(data: Any, override: str, set_before: set[FieldPath] | None = None) -> None:
    """Sets one field of a scenario's data, in place, from a text KEY=VALUE.

    Args:
        data: of the scenario.
        override: KEY=VALUE.
        set_before: fields set before, which stay when the kind of their block is replaced; the field is added.

    Raises:
        InputError: when it says something else, or names what cannot be set.
    """
    key, separator, text = override.partition("=")
    if not separator or not key:
        raise InputError(f"--set {override}: expected KEY=VALUE, such as --set rotation.filter=extended")
    if len(text.splitlines()) > 1:
        raise InputError(
            f"--set {key}=...: the value has more than one line; write a list as [a, b], a mapping as {{a: 1, b: 2}}"
        )
    path = split_key(key, override)
    present_name = renamed.present_key_name(path)
    if present_name is not None:
        renamed.warn(f"--set {override}: {path[-1]} is now {present_name}")
        path[-1] = present_name
    text = f"value: {text}" if text.strip() else "value: null"
    value = Document(text, f"--set {override}", parent_path=tuple(path)).data["value"]
    replace_at(data, path, value, f"--set {override}", set() if set_before is None else set_before)


def replace_at(data: Any, path: list[str | int], value: Any, location: str, set_before: set[FieldPath]) -> None:
    """Sets a field of a scenario's data in place; a block's new kind drops former keys that are not in `set_before`."""
    *block, last = field = tuple(path)
    former = value_at(data, path) if last == "kind" else None
    of_detector = field == ("detector", "kind")
    if of_detector and value == renamed.FORMER_KIND:
        renamed.warn(f"{location}: {value} is now {renamed.PRESENT_KIND}", 3)
        value = renamed.PRESENT_KIND
    set_at(data, path, value, location)
    if last == "kind":
        leaving = keys_of_former_kind(Scenario, data, field[:-1], former)
        if of_detector:
            leaving += [key for key in renamed.obsolete_detector_keys(former, value) if key in value_at(data, block)]
        for key in dict.fromkeys(leaving):
            if not any(one[: len(field)] == (*block, key) for one in set_before):
                del value_at(data, block)[key]
    set_before.add(field)


# ------------------------------------------------------------------- fields of nested data


def value_at(data: Any, path: Sequence[str | int]) -> Any:
    """Returns the value at a path in nested data; None where there is none."""
    for part in path:
        try:
            data = data[part]
        except (KeyError, IndexError, TypeError):
            return None
    return data


def set_at(data: Any, path: list[str | int], value: Any, location: str) -> None:
    """Sets one field of nested data in place, and makes the blocks that are missing.

    Args:
        data: mappings and lists.
        path: keys and indices; an index may be one past the end of its list.
        value: to set.
        location: what to call it in messages.

    Raises:
        InputError: when the path leads nowhere.
    """
    block = data
    for part, following in pairwise(path):
        if isinstance(part, str) and isinstance(block, dict):
            block = block.setdefault(part, [] if isinstance(following, int) else {})
            continue
        if isinstance(part, int) and isinstance(block, list) and part < len(block):
            block = block[part]
            continue
        raise InputError(f"{location}: there is no {part!r} to set in")
    last = path[-1]
    if isinstance(last, str) and isinstance(block, dict):
        block[last] = value
    elif isinstance(last, int) and isinstance(block, list) and last <= len(block):
        block[last : last + 1] = [value]
    else:
        raise InputError(f"{location}: there is no {last!r} to set")


def split_key(key: str, override: str) -> list[str | int]:
    """Splits a dotted key such as sensors.errors[0].noise_std into a list of names and indices.

    Raises:
        InputError: when it is none; the message begins with --set and the override.
    """
    path: list[str | int] = []
    for part in key.split("."):
        name, *indices = part.split("[")
        if name:
            path.append(name)
        for index in indices:
            if not index.endswith("]") or not _INDEX.fullmatch(index[:-1]):
                raise InputError(f"--set {override}: expected an index such as [0] in {key!r}")
            path.append(int(index[:-1]))
        if not name and not indices:
            raise InputError(f"--set {override}: empty part in {key!r}")
    return path

"""Campaigns: many cases of one scenario with drawn and swept quantities, read from YAML and validated."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import Field, model_validator

from massprop_drake.errors import InputError, dotted, suggestion
from massprop_drake.inputs import true_params
from massprop_drake.inputs.distributions import KINDS, Choice, Distribution, Normal, distribution_in
from massprop_drake.inputs.kinds import bundled_files
from massprop_drake.inputs.model import (
    Flag,
    Key,
    Model,
    Positive,
    Real,
    Text,
    Whole,
    described,
    list_keys,
    validate_data,
)
from massprop_drake.inputs.scenario import (
    Scenario,
    load_scenario,
    replace_at,
    resolve_scenario,
    set_at,
    split_key,
)
from massprop_drake.inputs.true_blocks import Dispersion
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.inputs.yaml import Document, FieldPath, exists, open_document
from massprop_drake.maths.mass_properties import draw_body

MASS_PROPERTIES = "plant.mass_properties"  # the one key with a distribution of its own
MOST_CASES = 1_000_000


class Limits(Model):
    """Limits of one case, beyond which it counts as failed to run."""

    time_s: Positive = described(600.0, "of wall time", "s")
    memory_mb: Real = described(4000.0, "of resident memory; compiling kernels takes 2200", "MB", ge=200.0)


class Gate(Model):
    """Bounds that a figure of the report must satisfy."""

    min: Real | None = described(None, "least value that passes")
    max: Real | None = described(None, "largest value that passes")
    on: Literal["estimate", "lower_bound", "upper_bound"] = described(
        "estimate", "the figure itself, or a bound of its 95 % interval"
    )

    @model_validator(mode="after")
    def _require_bound(self) -> Gate:
        """Raises ValueError where a gate has neither a lower nor an upper bound."""
        if self.min is None and self.max is None:
            raise ValueError("give min, max or both")
        return self


class CampaignExecution(Model):
    """Computation of the cases; the engine changes no bit of a result."""

    engine: Literal["diagram", "loop"] | None = described(
        None, "as of a scenario; null: loop, or diagram where the plant of base is continuous"
    )
    compiled: Flag = described(False, "as of a scenario")


class CampaignFile(Model):
    """Many cases of one scenario."""

    name: Text = described(
        "campaign",
        "short name; the campaign's folder is named after it",
        pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$",
        max_length=100,
    )
    description: Text = described("", "one line")
    base: Text = described(..., "a bundled scenario, or a scenario's file relative to this one")
    records: Text | None = described(
        None,
        "telemetry to estimate instead of simulating, a pattern such as flights/*.csv; base gives vehicle and settings",
    )
    cases: Whole | None = described(
        None, "number of cases of each cell; null: all there are, with grid or records", ge=1, le=MOST_CASES
    )
    seed: Whole = described(0, "of everything drawn", ge=0, lt=2**63)
    method: Literal["random", "lhs", "sobol", "grid", "saltelli"] = described(
        "random",
        "random: independent draws; lhs: Latin hypercube; sobol: scrambled Sobol sequence; grid: every combination; "
        "saltelli: pairs of Sobol points, for Sobol indices",
    )
    set: dict[str, Any] = described({}, "fields of the scenario that have one value in all cases, by dotted key")
    draw: dict[str, Any] = described(
        {}, "fields of the scenario drawn for each case, by dotted key; a value may hold distributions anywhere"
    )
    sweep: dict[str, Annotated[list[Any], Field(min_length=1)]] = described(
        {}, "fields that take each of some values with the same draws, by dotted key"
    )
    times_s: tuple[Annotated[Real, Field(ge=0.0)], ...] = described(
        (), "times at which errors are kept besides those at the end", "s"
    )
    keep: Literal["failing", "all", "none"] = described("failing", "whose whole run folders are kept")
    gates: dict[str, Gate] = described({}, "what figures of the report must satisfy, by name of the figure")
    limits: Limits = described(Limits(), "what one case may take")
    execution: CampaignExecution = described(CampaignExecution(), "how cases are computed, whatever base says")

    @model_validator(mode="after")
    def _require_cases_and_distinct_keys(self) -> CampaignFile:
        """Raises ValueError without a number of cases, or for keys set twice or not allowed in a campaign."""
        if self.cases is None and self.method != "grid" and self.records is None:
            raise ValueError("cases: missing; say how many")
        if self.method == "grid" and self.records is not None:
            raise ValueError("method: grid has no case for each of the records; leave it out")
        keys = [*self.set, *self.draw, *self.sweep]
        for key in keys:
            if keys.count(key) > 1:
                raise ValueError(f"{key}: stands in two of set, draw and sweep; keep one")
            if key in ("name", "seed"):
                raise ValueError(f"{key}: every case has its own, by its number")
            if key.partition(".")[0] == "execution":
                raise ValueError(f"{key}: all cases are computed alike; it stands in the block execution of this file")
        return self


class Quantity(NamedTuple):
    """Quantity that is drawn.

    Attributes:
        label: what it is called in tables, the dotted path of its field.
        distribution: of it.
    """

    label: str
    distribution: Distribution


class CampaignSpec(NamedTuple):
    """Campaign file, with all that it refers to.

    Attributes:
        file: as written.
        base: the scenario, with what `set` says.
        quantities: all that is drawn, in the order of the coordinates of a draw.
        source: the path or name it was loaded from, for messages.
        folder: that its paths are relative to.
    """

    file: CampaignFile
    base: Scenario
    quantities: tuple[Quantity, ...]
    source: str
    folder: Path

    @property
    def doubts(self) -> list[str]:
        """Advice on valid entries that could be better: Sobol cases whose number is no power of two."""
        count = self.file.cases or 0
        if self.file.method == "sobol" and count & (count - 1):
            better = 1 << count.bit_length()
            return [f"cases: a Sobol sequence is balanced at powers of two, such as {better}; got {count}"]
        return []


def bundled_campaigns() -> list[str]:
    """Lists the campaigns that come with the package."""
    return bundled_files("campaign")


def campaign_description(name: str) -> str:
    """Returns the one-line description from a bundled campaign's file."""
    document, _ = open_document(name, "campaign")
    return validate_data(CampaignFile, document.data, document).description


def load_campaign(campaign: str | Path, overrides: Sequence[str] = ()) -> CampaignSpec:
    """Loads a bundled campaign by name, or one from a YAML file, with its base scenario and drawn quantities.

    Args:
        campaign: a name that `massprop list` shows, or the path of a file.
        overrides: `KEY=VALUE` each, as of a scenario, KEY being one of the campaign's.

    Raises:
        InputError: when there is none of that name, or its data are wrong; the message says where.
    """
    document, folder = open_document(campaign, "campaign")
    for override in overrides:
        _set_in_file(document.data, override)
    return campaign_from(document, folder)


def _set_in_file(data: dict[str, Any], override: str) -> None:
    """Sets one key of a campaign's data in place from KEY=VALUE; keys within set, draw and sweep have dots."""
    key, separator, text = override.partition("=")
    if not separator or not key:
        raise InputError(f"--set {override}: expected KEY=VALUE, such as --set cases=200")
    value = Document(f"value: {text if text.strip() else 'null'}", f"--set {override}").data["value"]
    block, _, field = key.partition(".")
    if block in ("set", "draw", "sweep", "gates") and field:
        data.setdefault(block, {})[field] = value
    else:
        set_at(data, split_key(key, override), value, f"--set {override}")


def campaign_from(document: Document, folder: Path) -> CampaignSpec:
    """Makes a validated campaign from its document: loads the base scenario and finds the drawn quantities.

    Raises:
        InputError: naming each field that is wrong.
    """
    file = validate_data(CampaignFile, document.data, document)
    try:
        base_path = folder / file.base
        base = load_scenario(base_path if exists(base_path) else file.base)
    except InputError as error:
        raise InputError(*(f"{document.where(('base',))}: {problem}" for problem in error.problems)) from None
    for key, value in file.set.items():
        base = _apply_settings(base, {key: value}, document.where(("set", key)))
    engine = file.execution.engine or ("diagram" if true_params.time_step(base) == 0.0 else "loop")
    execution = {"engine": engine, "compiled": file.execution.compiled}
    base = _apply_settings(base, {"execution": execution}, document.where(("execution", "engine")))
    quantities = tuple(
        quantity
        for key, value in file.draw.items()
        for quantity in _find_quantities(key, value, (key,), base.vehicle_data, document)
    )
    campaign = CampaignSpec(file, base, quantities, document.source, folder)
    _require_fields(campaign, document)
    return campaign


def _require_fields(campaign: CampaignSpec, document: Document) -> None:
    """Checks that drawn and swept keys are fields of the scenario, by a case with the median of every draw."""
    middle = campaign.base
    medians = {quantity.label: quantity.distribution.quantiles(np.array([0.5]))[0] for quantity in campaign.quantities}
    for key, value in settings_of(campaign, medians).items():
        middle = _apply_settings(middle, {key: value}, document.where(("draw", key)))
    for key, values in campaign.file.sweep.items():
        for index, value in enumerate(values):
            _apply_settings(middle, {key: value}, document.where(("sweep", key, index)))


def _apply_settings(base: Scenario, settings: Mapping[str, Any], location: str) -> Scenario:
    """Returns a scenario with settings applied; errors begin with the location in the campaign's file."""
    try:
        return with_settings(base, settings)
    except InputError as error:
        raise InputError(*(f"{location}: {problem.removeprefix('scenario: ')}" for problem in error.problems)) from None


def campaign_keys() -> list[Key]:
    """Lists every key of a campaign's file, and of the distributions in it, for documentation."""
    keys = list_keys(CampaignFile)
    drawn: dict[str, type[Model]] = {f"draw{{}} ({MASS_PROPERTIES})": Dispersion}
    drawn |= {f"draw{{}}.{tag}": kind for tag, kind in KINDS.items()}
    for name, model in drawn.items():
        meaning = (model.__doc__ or "").strip().partition("\n")[0].removesuffix(".")
        keys.append(Key(name, "mapping", "-", "-", "-", meaning))
        keys += list_keys(model, f"{name}.")
    return keys


# ------------------------------------------------------------------------------------ what is drawn


def _find_quantities(key: str, value: Any, path: FieldPath, vehicle: Vehicle, document: Document) -> Iterator[Quantity]:
    """Yields label and distribution of every quantity drawn in a value of the block `draw`, in its order."""
    location = document.where(("draw", *path))
    label = dotted(path)
    if key == MASS_PROPERTIES and len(path) == 1 and _is_dispersion(value):
        validate_data(Dispersion, value, None, location)
        normal = Normal(mean=0.0, std=1.0)
        yield Quantity(f"{label}.mass", normal)
        for part in ("center_of_mass", "second_moments", "axes"):
            yield from (Quantity(f"{label}.{part}.{axis}", normal) for axis in "xyz")
        return
    try:
        found = distribution_in(value)
    except ValueError as error:
        raise InputError(f"{location}: {error}") from None
    if found is not None:
        yield Quantity(label, _validate_distribution(*found, vehicle, location))
    elif isinstance(value, dict):
        for name, inner in value.items():
            yield from _find_quantities(key, inner, (*path, name), vehicle, document)
    elif isinstance(value, list):
        for index, inner in enumerate(value):
            yield from _find_quantities(key, inner, (*path, index), vehicle, document)


def _is_dispersion(value: Any) -> bool:
    """Tests whether drawn mass properties are a dispersion block, not mass and inertia with draws in them."""
    return isinstance(value, dict) and not {"mass", "inertia"} & set(value)


def _validate_distribution(tag: str, parameters: Any, vehicle: Vehicle, location: str) -> Distribution:
    """Makes a distribution from tag and parameters; a choice of a kind of jets becomes one of designations."""
    distribution = validate_data(KINDS[tag], parameters, None, f"{location}: {tag}")
    if isinstance(distribution, Choice) and isinstance(distribution.values, str):
        return distribution.model_copy(update={"values": _expand_jets(distribution.values, vehicle, location)})
    return distribution


def _expand_jets(jet_kind: str, vehicle: Vehicle, location: str) -> tuple[str, ...]:
    """Returns the designations of all jets, for `all`, or of one kind; raises InputError for an unknown kind."""
    if jet_kind == "all":
        return vehicle.designations
    if jet_kind not in vehicle.jet_kinds:
        raise InputError(
            f"{location}: choice: {jet_kind!r} is neither a list, nor 'all', nor a kind of jets of '{vehicle.name}'"
            f"{suggestion(jet_kind, list(vehicle.jet_kinds))}"
        )
    return tuple(jet.designation for jet in vehicle.jets if jet.kind == jet_kind)


def settings_of(campaign: CampaignSpec, drawn: Mapping[str, Any]) -> dict[str, Any]:
    """Maps each drawn field of the scenario, by dotted key, to its value in the case with these draws."""
    settings = {}
    for key, value in campaign.file.draw.items():
        if key == MASS_PROPERTIES and _is_dispersion(value):
            z = np.array([number for label, number in drawn.items() if label.startswith(f"{key}.")], dtype=float)
            body = draw_body(true_params.properties_before_draws(campaign.base), Dispersion(**value).spread, z)
            settings[key] = {name: np.asarray(part).tolist() for name, part in body._asdict().items()}
        else:
            settings[key] = _fill_in_draws(value, (key,), drawn)
        if key == "failures":
            settings[key] = _adjust_failures(campaign, settings[key])
    return settings


def _fill_in_draws(value: Any, path: FieldPath, drawn: Mapping[str, Any]) -> Any:
    """Returns a value of the block `draw` with each distribution replaced by its drawn value."""
    label = dotted(path)
    if label in drawn:
        return drawn[label]
    if isinstance(value, dict):
        filled = {name: _fill_in_draws(inner, (*path, name), drawn) for name, inner in value.items()}
        kind = filled.get("kind")
        return {**filled, **kind} if isinstance(kind, dict) else filled  # a kind may be chosen with keys of its own
    if isinstance(value, list):
        return [_fill_in_draws(inner, (*path, index), drawn) for index, inner in enumerate(value)]
    return value


_OF_KIND: Mapping[str, set[str]] = {
    "leak": {"force"},
    "degraded": {"fraction"},
    "intermittent": {"probability", "level"},
    "drift": {"rate_per_s"},
}
_SIZES = set[str]().union(*_OF_KIND.values())


def _adjust_failures(campaign: CampaignSpec, failures: Any) -> Any:
    """Returns a case's drawn failures, each with its own kind's sizes alone and a jet of its own.

    Where the kind is drawn, a block may give sizes for all kinds. The force of a degraded jet without a fraction is
    what it has lost. A force that is drawn is at most the jet's thrust. A jet that an earlier failure of the case has
    is replaced by the next one that is free.
    """
    if not isinstance(failures, list) or not all(isinstance(failure, dict) for failure in failures):
        return failures
    drawn = {quantity.label: quantity.distribution for quantity in campaign.quantities}
    thrusts = {jet.designation: jet.thrust for jet in campaign.base.vehicle_data.jets}
    used: list[Any] = []
    adjusted = []
    for index, failure in enumerate(failures):
        kind, jet, force = failure.get("kind"), failure.get("jet"), failure.get("force")
        choice = drawn.get(f"failures[{index}].jet")
        if jet in used and isinstance(choice, Choice):
            begin = choice.values.index(jet)
            jet = next((name for name in (*choice.values[begin:], *choice.values[:begin]) if name not in used), jet)
        used.append(jet)
        kept = {name: part for name, part in failure.items() if name not in _SIZES - _OF_KIND.get(str(kind), set())}
        if isinstance(force, (int, float)) and isinstance(jet, str) and jet in thrusts:
            if f"failures[{index}].force" in drawn:
                force = min(force, thrusts[jet])
            if kind == "leak":
                kept["force"] = force
            elif kind == "degraded" and "fraction" not in failure:
                kept["fraction"] = max(0.0, 1.0 - force / thrusts[jet])
        adjusted.append(kept if "jet" not in failure else {**kept, "jet": jet})
    return adjusted


def with_settings(base: Scenario, settings: Mapping[str, Any]) -> Scenario:
    """Returns a scenario with the fields at dotted keys replaced; only their blocks are validated again.

    Args:
        base: with its vehicle.
        settings: values by dotted key.

    Raises:
        InputError: when the result is no scenario.
    """
    data: dict[str, Any] = {name: getattr(base, name) for name in type(base).model_fields}
    set_fields: set[FieldPath] = set()
    for key, value in settings.items():
        path = split_key(key, key)
        block = str(path[0])
        if isinstance(data.get(block), (Model, tuple)):
            data[block] = base.model_dump(mode="json", include={block})[block]
        replace_at(data, path, value, key, set_fields)
    return resolve_scenario(data)

"""Stored files of a run's folder, read back: each through one schema, before it is used.

What is written is data of this program, but it lies in a user's folder: it may be cut short, edited, or of another
version. A file that is read is as the schema says, or there is one message that names the field.
"""

from __future__ import annotations

import json
import math
import re
import reprlib
import warnings
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, Field, ValidationError, field_validator, model_validator

from massprop_drake.errors import InputError, dotted, moment
from massprop_drake.inputs.model import Count, Model, Real, Text, Vector3, Whole, digest, validate_data
from massprop_drake.inputs.renamed import RenamedWarning
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.inputs.yaml import read_text
from massprop_drake.maths.estimation.detector import STATUS
from massprop_drake.maths.estimation.filter import MASS_REPORT, ROTATION_REPORT
from massprop_drake.maths.estimation.filters.joint import JOINT_REPORT
from massprop_drake.maths.signals import AXES, JOINTS, PROPELLANT, SIGNALS, is_user_signal
from massprop_drake.results.detections import DetectionRecord
from massprop_drake.results.events import EventRecord
from massprop_drake.results.parts import PartsMade
from massprop_drake.results.unconfirmed import UnconfirmedRecord

Array = NDArray[np.float64]

Fraction = Annotated[Real, Field(ge=0.0, le=1.0)]


# ------------------------------------------------------------------------------------------- JSON


def read_json(path: Path) -> Any:
    """Reads a JSON file, and refuses numbers that are not finite.

    Raises:
        InputError: when it is missing or no JSON, or a number in it is not finite.
    """
    text = read_text(path)
    try:
        return json.loads(text, parse_float=_parse_finite, parse_constant=_parse_finite)
    except ValueError as error:
        raise InputError(f"{path}: not valid JSON: {error}") from None
    except RecursionError:
        raise InputError(f"{path}: nested too deeply; no file of ours needs more than a few levels") from None


def _parse_finite(text: str) -> float:
    """Converts a JSON number to float; raises ValueError where it is not finite."""
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"{text} is not finite; what is not known is null")
    return value


def reduce_to_storable(content: Any, schema: type[BaseModel], parts_made: PartsMade) -> Any:
    """Replaces NaN and infinity in JSON content by None, and drops records in lists that then fail the schema.

    Args:
        content: to store.
        schema: of the file.
        parts_made: notes the key of each such number.
    """
    kept = _replace_infinite(content, (), parts_made)
    if not parts_made.missing:
        return kept
    try:
        schema.model_validate(kept)
    except ValidationError as error:
        locations = {location[:2] for location in (problem["loc"] for problem in error.errors()) if len(location) > 1}
        for name, index in sorted((location for location in locations if isinstance(location[1], int)), reverse=True):
            del kept[name][index]
    return kept


def _replace_infinite(content: Any, path: tuple[str | int, ...], parts_made: PartsMade) -> Any:
    """Replaces NaN and infinity by None at any depth; notes the key of each as a missing part."""
    if isinstance(content, Mapping):
        return {key: _replace_infinite(value, (*path, key), parts_made) for key, value in content.items()}
    if isinstance(content, list | tuple):
        return [_replace_infinite(value, (*path, index), parts_made) for index, value in enumerate(content)]
    if isinstance(content, float) and not math.isfinite(content):
        parts_made.note(dotted(path), ArithmeticError("is no finite number"))
        return None
    return content


# ----------------------------------------------------------------------------------- filter states

STATE_FILE = "filter_state.json"
FORMAT = 2  # of saved states; 1, up to version 0.2, does not say what it was made with


class MadeWith(Model):
    """Vehicle and settings that a state of the estimators belongs to."""

    vehicle: Text = Field(description="name")
    vehicle_sha256: Text = Field(description="digest of the vehicle in full")
    settings: dict[str, Any] = Field(description="blocks of the scenario that shape the estimators")


class EstimatorState(Model):
    """State of the estimators after a sample; vectors with None for unknown elements."""

    format: Annotated[Whole, Field(ge=1, le=FORMAT)] = 1
    made_with: MadeWith | None = None
    time_s: Real | None
    command: tuple[Fraction | None, ...]
    command_onset: tuple[Annotated[Real, Field(ge=0.0)] | None, ...] | None = None  # None: jets switch with samples
    outside_wrench: tuple[Real, Real, Real, Real, Real, Real] = (0.0,) * 6
    states: dict[str, list[list[Real | None]]]

    @property
    def onset_s(self) -> Array | None:
        """Opening times of jets in a sample, s, NaN: constant level, (n_jets,); None: jets switch with samples."""
        return None if self.command_onset is None else np.array(self.command_onset, dtype=float)

    @model_validator(mode="after")
    def _require_origin(self) -> EstimatorState:
        """Checks that a state of format 2 names its vehicle and settings."""
        if self.format > 1 and self.made_with is None:
            raise ValueError("has no 'made_with': nothing says which vehicle and settings it is of")
        return self


_TenOrNot = Annotated[tuple[Real | None, ...], Field(min_length=10, max_length=10)]


class FilterState(EstimatorState):
    """State of the estimators at the end of a run, and the data to go on with its record: `filter_state.json`."""

    time_s: Real
    row: Count
    recent_s: Annotated[tuple[Real, ...], Field(min_length=1)]
    detections: tuple[DetectionRecord, ...]
    events: tuple[EventRecord, ...] = ()
    unconfirmed: tuple[UnconfirmedRecord, ...] = ()
    commanded: tuple[tuple[Count, ...], ...] = ()  # by jet: samples commanded, and those of them that were tested
    velocity: dict[str, Vector3] = Field(default_factory=dict)
    estimate: _TenOrNot | None = None  # for readers; the states have them as well
    covariance: Annotated[tuple[_TenOrNot, ...], Field(min_length=10, max_length=10)] | None = None

    @field_validator("recent_s")
    @classmethod
    def _require_increasing_times(cls, value: tuple[float, ...]) -> tuple[float, ...]:
        """Checks that sample times increase."""
        if any(later <= earlier for earlier, later in pairwise(value)):
            raise ValueError("must go forward")
        return value

    @model_validator(mode="after")
    def _require_matching_counts_and_end(self) -> FilterState:
        """Checks that counts are given for each jet, and that the recent times end at the state's."""
        jets = len(self.command)
        if self.commanded and [len(row) for row in self.commanded] != [jets, jets]:
            raise ValueError(f"commanded: must be two counts for each of {jets} jets")
        if self.recent_s[-1] != self.time_s:
            raise ValueError(
                f"recent_s: must end at time_s, {moment(self.time_s)} s, got {moment(self.recent_s[-1])} s"
            )
        return self


# blocks of a scenario, and fields in them, that leave the estimators as they are
_ELSEWHERE: Any = {
    **dict.fromkeys(("name", "description", "vehicle", "duration_s", "seed", "maneuver", "jet_schedule"), True),
    **dict.fromkeys(("plant", "autopilot", "failures", "jumps", "execution"), True),
    "sensors": {"errors", "quantizer_phase"},
}


def state_origin(scenario: Scenario) -> dict[str, Any]:
    """Returns name and digest of the vehicle, and the scenario's settings, that a saved filter state depends on."""
    vehicle = scenario.vehicle_data
    return {"vehicle": vehicle.name, "vehicle_sha256": digest(vehicle), "settings": _settings(scenario)}


def _settings(scenario: Scenario) -> dict[str, Any]:
    """Returns the scenario's settings that shape the estimators, as JSON content."""
    return scenario.model_dump(mode="json", exclude=_ELSEWHERE)


def require_same_origin(state: EstimatorState, scenario: Scenario, source: str) -> None:
    """Checks that a saved state is of this vehicle and of these estimator settings.

    A state of format 1 does not say; a warning tells so.

    Args:
        state: as saved.
        scenario: to go on with.
        source: of the state, for messages.

    Raises:
        InputError: when it is of others; the message says what differs.
    """
    vehicle, origin = scenario.vehicle_data, state.made_with
    n_jets = len(vehicle.jets)
    if origin is not None and origin.vehicle_sha256 != digest(vehicle):
        raise InputError(
            f"{source}: is of vehicle '{origin.vehicle}' with the digest {origin.vehicle_sha256[:12]}, and "
            f"'{vehicle.name}' here has {digest(vehicle)[:12]}; go on with the vehicle of that run"
        )
    if len(state.command) != n_jets or len(state.command_onset or state.command) != n_jets:
        raise InputError(
            f"{source}: is of a vehicle with {len(state.command)} jets, and '{vehicle.name}' has {n_jets}; go on with "
            "the vehicle of that run"
        )
    if origin is None:
        warnings.warn(
            f"{source}: is of format 1, of version 0.2 or earlier, which does not say of which vehicle and settings: "
            "these here are taken for them; version 0.4 will refuse it",
            RenamedWarning,
            stacklevel=2,
        )
        return
    here = _settings(scenario)
    if origin.settings == here:
        return
    stored = validate_data(Scenario, origin.settings, source=f"{source}: made_with.settings")  # with what is new since
    differences = list(_changed_settings(_settings(stored), here))
    if differences:
        more = f" and {len(differences) - 3} more" if len(differences) > 3 else ""
        raise InputError(
            f"{source}: is of other settings: {', '.join(differences[:3])}{more}; go on with the settings of that run"
        )


def _changed_settings(old: Any, new: Any, path: tuple[str | int, ...] = ()) -> Iterator[str]:
    """Yields "key was old and is new" in words for each setting that differs, keys dotted."""
    if isinstance(old, dict) and isinstance(new, dict):
        for key in dict.fromkeys([*new, *old]):
            yield from _changed_settings(old.get(key), new.get(key), (*path, key))
    elif old != new:
        yield f"{dotted(path)} was {reprlib.repr(old)} and is {reprlib.repr(new)}"


# ---------------------------------------------------------------------------------------- histories

# signals that are there together or not at all; those of the first are in every run
_LATER = {"rotation_innovation_std", "mass_innovation_std"}  # not in runs made before they were logged
_ALWAYS = {
    *("estimate", "standard_deviation", "converged", "command"),
    *("angular_impulse", "linear_impulse", "usable", "firing"),
    *(name for name in ROTATION_REPORT if name in SIGNALS),
} - _LATER
_TRUTH = {"rate", "attitude", "position", "velocity", "truth", "thrust", "torque", "force"}  # each may be unknown
_THRUST = {"thrust", "force"}
_AUTOPILOT = {"hand_controllers", "attitude_error", "request", "selection_counts", "out_of_use"}
_JOINT = set(JOINT_REPORT.logged)
_MASS = {name for name in MASS_REPORT if name in SIGNALS} - _LATER
_DETECTOR = {*STATUS.logged, "likelihood", "failure_magnitude", "known_force", "known_force_variance"}
_HEADER = re.compile(rb"\{'descr': '<f8', 'fortran_order': False, 'shape': \(([0-9]{1,15}), ?([0-9]{0,15})\), \} *\n")
_AT_ONCE = 2**20  # bytes


def read_history(
    path: Path, vehicle: Vehicle, *, joints: int = 0, is_complete: bool = True
) -> tuple[Array, dict[str, Array]]:
    """Reads sample times and signals of a run from `history.npz`, with their shapes checked.

    Signals that are not known are passed over.

    Args:
        path: of `history.npz`.
        vehicle: whose sensors and jets they are of.
        joints: number of positions that its joints have.
        is_complete: whether the run came to its end; else its numbers are not checked.

    Returns:
        Sample times, s, shape (n,), and the signals by name, shape (n, components).

    Raises:
        InputError: when the file cannot be read, or a signal is missing or not as it should be.
    """
    columns = {name: len(signal.components) or len(vehicle.jets) for name, signal in SIGNALS.items()}
    columns |= {name: len(AXES) for name in vehicle.sensor_names()} | ({JOINTS: joints} if joints else {})
    columns |= {one.name: len(one.columns) for one in vehicle.tracked}
    columns |= {PROPELLANT: len(vehicle.tanks)} if vehicle.tanks else {}
    try:
        with path.open("rb") as file, zipfile.ZipFile(file) as archive:
            members = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
            _require_groups(set(members), vehicle)
            time_s = _read_array(archive, members["time_s"], None, 0)
            wanted = [name for name in members if name in columns or is_user_signal(name)]
            signals = {name: _read_array(archive, members[name], time_s.size, columns.get(name)) for name in wanted}
    except MemoryError:
        raise InputError(f"{path}: is too large for the memory of this machine") from None
    except (OSError, EOFError, ValueError, zipfile.BadZipFile, zlib.error) as error:
        raise InputError(f"{path}: holds no signals that can be read: {error}") from None
    if is_complete:
        _require_sound(path, time_s, signals, vehicle)
    return time_s, signals


def _require_groups(names: set[str], vehicle: Vehicle) -> None:
    """Checks that mandatory signals are there, and optional groups complete; else raises ValueError."""
    for group in ({"time_s"} | _ALWAYS | set(vehicle.sensor_names()), _THRUST, _AUTOPILOT, _MASS, _JOINT, _DETECTOR):
        missing = sorted(group - names)
        if missing and ("time_s" in group or group & names):
            raise ValueError(f"'{missing[0]}' is missing")


def _read_array(archive: zipfile.ZipFile, info: zipfile.ZipInfo, rows: int | None, columns: int | None) -> Array:
    """Reads one array of an NPZ file, shape (n,) or (n, columns).

    Args:
        archive: to read from.
        info: of its member.
        rows: expected; None: any but none.
        columns: expected; 0: it is a vector; None: any.

    Raises:
        ValueError: when it is anything else.
    """
    if info.flag_bits & 1 or info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise ValueError(f"'{info.filename}' is encrypted or compressed in a way that is not ours")
    with archive.open(info) as file:
        magic = file.read(10)
        header = file.read(int.from_bytes(magic[8:10], "little"))
        match = _HEADER.fullmatch(header)
        if magic[:8] != b"\x93NUMPY\x01\x00" or match is None:
            raise ValueError(f"'{info.filename}' is no array of numbers in double precision")
        shape = tuple(int(part) for part in match.groups() if part)
        if columns is None and len(shape) != 2:
            raise ValueError(f"'{info.filename}' has shape {shape}, expected rows and columns")
        width = shape[1:] if columns is None else (columns,) if columns else ()
        expected = (shape[0] if rows is None else rows, *width)
        if shape != expected or shape[0] == 0:
            raise ValueError(f"'{info.filename}' has shape {shape}, expected {('n',) if rows is None else expected}")
        if info.file_size != 10 + len(header) + 8 * math.prod(shape):
            raise ValueError(f"'{info.filename}' is not as long as its shape {shape} says")
        values = np.empty(shape)
        view = values.data.cast("B")
        for start in range(0, len(view), _AT_ONCE):
            view[start : start + _AT_ONCE] = file.read(_AT_ONCE)
    return values


def _require_sound(path: Path, time_s: Array, signals: Mapping[str, Array], vehicle: Vehicle) -> None:
    """Checks that times increase, numbers are finite and suspected jets exist; else raises InputError."""
    if not (np.isfinite(time_s).all() and (np.diff(time_s) > 0.0).all()):
        raise InputError(f"{path}: time_s: must be finite and go forward")
    for name in (_TRUTH & set(signals)) | {"estimate", "standard_deviation", "command", *vehicle.sensor_names()}:
        wrong = ~np.isfinite(signals[name]) if name in _TRUTH else np.isinf(signals[name])
        if wrong.any():
            raise InputError(f"{path}: {name}, row {int(np.argwhere(wrong)[0, 0])}: must be finite")
    if "alarm" in signals:
        suspected = signals["suspected_jet"][signals["alarm"][:, 0] != 0.0, 0]
        suspected = suspected[~np.isnan(suspected)]  # something that is no jet is suspected, too
        if not ((suspected >= 0.0) & (suspected < len(vehicle.jets))).all():
            raise InputError(f"{path}: suspected_jet: names a jet that vehicle '{vehicle.name}' does not have")

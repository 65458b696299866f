"""Arguments of commands: scenarios, runs and files by name, path or folder."""

from __future__ import annotations

import contextlib
import logging
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from massprop_drake.cli import functions, show
from massprop_drake.cli.options import Schema
from massprop_drake.cli.streams import note
from massprop_drake.errors import InputError, in_words, suggestion
from massprop_drake.inputs.campaign_file import (
    CampaignSpec,
    bundled_campaigns,
    campaign_from,
    campaign_keys,
    load_campaign,
)
from massprop_drake.inputs.kinds import kind_of
from massprop_drake.inputs.model import Key, keys, validated
from massprop_drake.inputs.plausible import Finding
from massprop_drake.inputs.record_map import RecordMap, map_keys
from massprop_drake.inputs.scenario import Scenario, bundled_scenarios, load_scenario, resolved
from massprop_drake.inputs.vehicle_file import Vehicle, bundled_vehicles, load_vehicle
from massprop_drake.inputs.yaml import Document, exists, read_text
from massprop_drake.maths.kernels import compiler
from massprop_drake.records.recording import require_table
from massprop_drake.records.rows import vehicle_scenario
from massprop_drake.records.structure_check import check as check_telemetry
from massprop_drake.records.tables import require_file
from massprop_drake.results.exchange import recover
from massprop_drake.results.folder import Place
from massprop_drake.results.run import Run

_TELEMETRY = (".csv", ".tsv", ".parquet", ".pq")  # endings of telemetry files


KEYS: Mapping[Schema, Callable[[], list[Key]]] = {
    Schema.vehicle: partial(keys, Vehicle),
    Schema.scenario: partial(keys, Scenario),
    Schema.campaign: campaign_keys,
    Schema.map: map_keys,
}


@contextlib.contextmanager
def compiling(case: Scenario, *, quiet: bool) -> Iterator[None]:
    """Reports that kernels are compiled, where a case asks for it and they have not been, and how long it took."""
    if not case.execution.compiled:
        yield
        return
    with _logged(quiet=quiet):
        found = compiler()
        yield
    if found.spent_s and not quiet:
        note(f"kernels were compiled in {found.spent_s:.0f} s")


@contextlib.contextmanager
def _logged(*, quiet: bool) -> Iterator[None]:
    """Prints what the package logs, a line each; if quiet, nothing."""
    logger, handler = logging.getLogger("massprop_drake"), logging.NullHandler() if quiet else _Noted()
    logger.addHandler(handler)
    try:
        yield
    finally:
        logger.removeHandler(handler)


class _Noted(logging.Handler):
    def emit(self, record: logging.LogRecord) -> None:
        note(record.getMessage())


def saving(place: Place, *, pictures: bool, report: bool, replay: bool) -> Callable[[Run], Path]:
    """Makes a function that saves a run in a place; returns it and its folder.

    While an error is handled, that one is told; after an interruption figures and pages, which take a while, are left
    out.
    """

    def save(run: Run) -> Path:
        handled = sys.exception()
        wait = isinstance(handled, Exception | None)
        if not wait and (pictures or report or replay):
            run.note_missing("figures and pages: left out after the interruption; 'massprop report' makes the page")
        try:
            return run.save(place, pictures=pictures and wait, report=report and wait, replay=replay and wait)
        except InputError as error:
            raise error if handled is None else InputError(f"{in_words(handled)}; {error}") from handled
        except Exception:  # of a part, which is noted in the summary
            if handled is None:
                raise
            return place.shown

    return save


def extended(add: Callable[[Run], Run], run: Run, save: Callable[[Run], Path]) -> Run:
    """Adds something to a run; where that fails, saves the run with the reason before the error goes on."""
    try:
        return add(run)
    except Exception as error:
        run.note_end(error, early=False)
        save(run)
        raise


def note_doubts(doubts: list[Finding], *, quiet: bool) -> None:
    """Prints doubts about a result, a line each: entries that may not have their intended effect."""
    for doubt in () if quiet else doubts:
        note(f"warning: {doubt}")


def case_of_a_record(
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
    return recovered(source, overrides)


def reads(named: Iterable[str | Path | None], files: Iterable[Path]) -> list[Path]:
    """Returns files and folders that a command reads: its arguments, and those that these name.

    Args:
        named: as given, bundled names among them.
        files: that have been read so far.
    """
    bundled = {*bundled_scenarios(), *bundled_vehicles(), "-"}
    given = [Path(one) for one in named if one is not None and one not in bundled]
    return given + [one for one in files if one.parent not in given]  # of a run's folder the folder stands for them


def recovered(scenario: str | Path, overrides: list[str]) -> Scenario:
    """Loads a scenario, also from a run's folder that a killed process has left unfinished."""
    if scenario not in bundled_scenarios():
        path = Path(scenario)
        recover(path)
        if not exists(path) and path.parent.name == "cases" and exists(path.parent.parent / "plan.parquet"):
            raise InputError(
                f"{path}: this case's folder was not kept; 'massprop campaign run {path.parent.parent} --only "
                f"{path.name.lstrip('0') or '0'}' flies it and keeps it"
            )
    return load_scenario(scenario, overrides)


def vehicle_or_scenario(name: str, overrides: list[str]) -> Vehicle | Scenario:
    """Loads a vehicle, or a scenario; fields that are set make a scenario of a vehicle."""
    path = Path(name)
    own = exists(path) and name not in bundled_vehicles()
    is_run = own and exists(path / "scenario.yaml")
    if name in bundled_scenarios() or is_run or (own and kind_of(Document(read_text(path), name).data) != "vehicle"):
        return recovered(name, overrides)
    return vehicle_scenario(name, name, overrides) if overrides else load_vehicle(name)


def assigned(words: Iterable[str], option: str) -> dict[str, str]:
    """Reads `NAME=VALUE` words; raises InputError for one that is none, or a name that comes twice."""
    found: dict[str, str] = {}
    for word in words:
        name, sign, value = word.partition("=")
        if not (name and sign and value):
            raise InputError(f"{option} {word}: write it like NAME=VALUE, such as mass=1%")
        if name in found:
            raise InputError(f"{option} {name} is given twice")
        found[name] = value
    return found


def diagrams(names: Sequence[str] | None, like: str | None) -> dict[str, Callable[[], Any]]:
    """Finds diagrams to draw: functions that build them, by the names of their files.

    Args:
        names: ours, or functions of the user's own, see `functions.call`; None or none: all that a scenario has.
        like: scenario to build ours for; None: those that they are drawn for.

    Raises:
        InputError: when one is not there, or two would have one name.
    """
    from massprop_drake.display import graphs  # noqa: PLC0415 (loads Drake's framework)

    case = None if like is None else recovered(like, [])
    found: dict[str, Callable[[], Any]] = {}
    for name in dict.fromkeys(names or graphs.names_for(case)):
        own = functions.is_named(name)
        if not own and name not in graphs.DIAGRAMS:
            if name.endswith(".py"):
                raise InputError(f"'{name}' is a file; say which of its functions builds the diagram: {name}:build")
            raise InputError(f"'{name}' is no diagram{suggestion(name, list(graphs.DIAGRAMS))}")
        if own and case is not None:
            raise InputError(f"--like: '{name}' is built by a function of your own, which takes no scenario")
        stem = functions.file_stem(name) if own else name
        if stem in found:
            raise InputError(f"{name}: its files would be called {stem}, as those of another; draw it apart")
        found[stem] = partial(_built_by, name) if own else partial(graphs.build, name, case)
    return found


def _built_by(target: str) -> Any:
    """Returns the diagram that a function of the user's own makes."""
    from massprop_drake.display import graphs  # noqa: PLC0415 (loads Drake's framework)

    made = functions.call(target)
    with functions.guarded(target):
        return graphs.as_diagram(made, target)


class Described(NamedTuple):
    """The content of a file in words.

    Attributes:
        words: a line.
        doubts: on what may be meant otherwise, a sentence each.
    """

    words: str
    doubts: Sequence[str] = ()


def checked(name: str, whose: Vehicle | None) -> Vehicle | Scenario | CampaignSpec | Described:
    """Reads a file and returns its content, telemetry and maps in words; raises InputError for a bad one."""
    require_file(Path(name))
    if Path(name).suffix.lower() in _TELEMETRY:
        found = check_telemetry(Path(name), whose)
        return Described(show.about_telemetry(found, whose), found["notes"])
    if name in bundled_vehicles():
        return load_vehicle(name)
    if name in bundled_scenarios():
        return _with_model(load_scenario(name), name)
    if name in bundled_campaigns():
        return load_campaign(name)
    require_table(name)
    document = Document(read_text(Path(name)), name)
    kind = kind_of(document.data)
    if kind == "vehicle":
        return validated(Vehicle, document.data, document)
    if "commands" in document.data and "sensors" in document.data:
        return Described(show.about_map(validated(RecordMap, document.data, document)))
    if kind == "campaign":
        return campaign_from(document, Path(name).parent)
    return _with_model(resolved(document.data, document, Path(name).parent), name)


def _with_model(scenario: Scenario, name: str) -> Scenario:
    """Returns a scenario whose multibody model, if any, Drake can fly; raises InputError for a bad one."""
    if scenario.plant.kind == "multibody":
        from massprop_drake.diagrams.multibody import require_model  # noqa: PLC0415 (loads Drake's multibody library)

        try:
            require_model(scenario)
        except InputError as error:
            raise InputError(*(f"{name}: {one.removeprefix('scenario: ')}" for one in error.problems)) from None
    return scenario

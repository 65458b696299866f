"""Arguments of commands: scenarios, runs and files by name, path or folder."""

from __future__ import annotations

import contextlib
import logging
import sys
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

from massprop_drake.cli.streams import note
from massprop_drake.display.run import Run
from massprop_drake.errors import InputError, in_words
from massprop_drake.inputs.kinds import file_kind
from massprop_drake.inputs.plausible import Finding
from massprop_drake.inputs.scenario import Scenario, bundled_scenarios, load_scenario
from massprop_drake.inputs.vehicle_file import Vehicle, bundled_vehicles, load_vehicle
from massprop_drake.inputs.yaml import Document, exists, read_text
from massprop_drake.maths.kernels import compiler
from massprop_drake.records.rows import vehicle_scenario
from massprop_drake.results.exchange import recover
from massprop_drake.results.folder import Place


@contextlib.contextmanager
def report_compilation(case: Scenario, *, quiet: bool) -> Iterator[None]:
    """Prints, around a with block, that kernels are being compiled, if they are, and how long it took."""
    if not case.execution.compiled:
        yield
        return
    with _print_log_messages(quiet=quiet):
        compiled_by = compiler()
        yield
    if compiled_by.spent_s and not quiet:
        note(f"kernels were compiled in {compiled_by.spent_s:.0f} s")


@contextlib.contextmanager
def _print_log_messages(*, quiet: bool) -> Iterator[None]:
    """Prints, in a with block, the package's log messages on the error stream; if quiet, none."""
    logger, handler = logging.getLogger("massprop_drake"), logging.NullHandler() if quiet else _NoteHandler()
    logger.addHandler(handler)
    try:
        yield
    finally:
        logger.removeHandler(handler)


class _NoteHandler(logging.Handler):
    """Log handler that prints each message as a note on the error stream."""

    def emit(self, record: logging.LogRecord) -> None:
        """Prints a message as a note."""
        note(record.getMessage())


def make_run_saver(place: Place, *, pictures: bool, report: bool, replay: bool) -> Callable[[Run], Path]:
    """Makes a function that saves a run in a place and returns the run's folder.

    While an error is handled, that one is told; after an interruption figures and pages, which take a while, are left
    out.
    """

    def save(run: Run) -> Path:
        """Saves a run and returns its folder, without figures and pages after an interruption."""
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


def extend_or_save(extend: Callable[[Run], Run], run: Run, save: Callable[[Run], Path]) -> Run:
    """Returns the run extended by a function; where that fails, saves the run with the reason and raises again."""
    try:
        return extend(run)
    except Exception as error:
        run.note_end(error, early=False)
        save(run)
        raise


def note_doubts(doubts: list[Finding], *, quiet: bool) -> None:
    """Prints doubts about a result as warnings on the error stream; if quiet, none."""
    for doubt in () if quiet else doubts:
        note(f"warning: {doubt}")


def scenario_for_record(
    name: str, vehicle: str | None, like: str | None, resume_from: Path | None, overrides: list[str]
) -> Scenario:
    """Returns the scenario to estimate a record by, from a vehicle, a run's folder or a scenario."""
    if vehicle is not None and like is not None:
        raise InputError("give either --vehicle or --like, not both: --like takes the vehicle, too")
    if vehicle is not None:
        return vehicle_scenario(name, vehicle, overrides)
    source = like or resume_from
    if source is None:
        raise InputError("whose telemetry is it? Give --vehicle (a vehicle) or --like (a run's folder or a scenario)")
    return load_recovered_scenario(source, overrides)


def command_inputs(arguments: Iterable[str | Path | None], files_read: Iterable[Path]) -> list[Path]:
    """Returns paths of files and folders that a command reads: its arguments, and those read through them.

    Args:
        arguments: as given, bundled names among them.
        files_read: that have been read so far.
    """
    bundled = {*bundled_scenarios(), *bundled_vehicles(), "-"}
    paths = [Path(one) for one in arguments if one is not None and one not in bundled]
    # of a run's folder the folder stands for them
    return paths + [one for one in files_read if one.parent not in paths]


def load_recovered_scenario(scenario: str | Path, overrides: list[str]) -> Scenario:
    """Loads a scenario by name, file or a run's folder, also one that a killed process left unfinished."""
    if scenario not in bundled_scenarios():
        path = Path(scenario)
        recover(path)
        if not exists(path) and path.parent.name == "cases" and exists(path.parent.parent / "plan.parquet"):
            raise InputError(
                f"{path}: this case's folder was not kept; 'massprop campaign run {path.parent.parent} --only "
                f"{path.name.lstrip('0') or '0'}' flies it and keeps it"
            )
    return load_scenario(scenario, overrides)


def load_vehicle_or_scenario(name: str, overrides: list[str]) -> Vehicle | Scenario:
    """Loads a vehicle or a scenario by its name or path; overrides make a scenario of a vehicle."""
    path = Path(name)
    own = exists(path) and name not in bundled_vehicles()
    is_run = own and exists(path / "scenario.yaml")
    if name in bundled_scenarios() or is_run or (own and file_kind(Document(read_text(path), name).data) != "vehicle"):
        return load_recovered_scenario(name, overrides)
    return vehicle_scenario(name, name, overrides) if overrides else load_vehicle(name)


def parse_assignments(words: Iterable[str], option: str) -> dict[str, str]:
    """Parses `NAME=VALUE` words to a dict; raises InputError for another word, or a repeated name."""
    values: dict[str, str] = {}
    for word in words:
        name, sign, value = word.partition("=")
        if not (name and sign and value):
            raise InputError(f"{option} {word}: write it like NAME=VALUE, such as mass=1%")
        if name in values:
            raise InputError(f"{option} {name} is given twice")
        values[name] = value
    return values

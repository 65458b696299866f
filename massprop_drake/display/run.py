"""Finished run with its figures, report and replay: loaded, saved, exported, shown in a notebook."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel

from massprop_drake.errors import InputError, in_words
from massprop_drake.inputs.model import validate_data, yaml_text
from massprop_drake.inputs.scenario import load_scenario
from massprop_drake.inputs.true_blocks import MultibodyBlock
from massprop_drake.inputs.yaml import exists, read_text
from massprop_drake.results.folder import Place, require_writable, whole_folder, write_file
from massprop_drake.results.parts import PartsMade
from massprop_drake.results.run_content import RunContent, read_summary
from massprop_drake.results.stored import STATE_FILE, FilterState, read_history, read_json, reduce_to_storable
from massprop_drake.results.summary import SummaryFile

if TYPE_CHECKING:
    from massprop_drake.display.figures import Plots

_END = "...\n"  # closes a YAML document: a file without it was cut short


class Run(RunContent):
    """Scenario that has been run.

    Arguments and attributes are those of `RunContent`.
    """

    @staticmethod
    def load(folder: str | Path) -> Run:
        """Reads a run from its folder, or from the unfinished one beside it that a killed process left.

        Raises:
            InputError: when the folder holds no run that can be read.
        """
        path = Path(folder)
        results = read_summary(path)
        scenario = load_scenario(path / "scenario.yaml")
        if not read_text(path / "scenario.yaml").endswith(_END):
            raise InputError(f"{path / 'scenario.yaml'}: is cut short: it must end with '...'; run the scenario anew")
        joints = len(scenario.plant.joint_columns) if isinstance(scenario.plant, MultibodyBlock) else 0
        whole = results.ended is None and not results.missing
        time_s, signals = read_history(path / "history.npz", scenario.vehicle_data, joints=joints, is_complete=whole)
        state: dict[str, Any] = {}
        if exists(path / STATE_FILE):
            state = read_json(path / STATE_FILE)
            validate_data(FilterState, state, source=str(path / STATE_FILE))
        return Run(scenario, results, time_s, signals, state)

    @property
    def plot(self) -> Plots:
        """Plots of the run: `run.plot.rates()` and the others return matplotlib figures."""
        from massprop_drake.display.figures import Plots  # noqa: PLC0415 (matplotlib is slow to load)
        from massprop_drake.display.plot_source import source  # noqa: PLC0415

        return Plots(source(self.thin_for_plots()))

    def save(
        self,
        folder: str | Path | Place,
        *,
        force: bool = False,
        pictures: bool = True,
        report: bool = True,
        replay: bool = False,
    ) -> Path:
        """Writes the run's folder, whole or not at all.

        A part that cannot be made is left out and noted in `summary.json`; what it raised is raised once the rest is
        written. A run that lacks data takes no earlier run's place, which is kept as `<folder>.1`, `<folder>.2`, ....

        Args:
            folder: where to write. A folder of an earlier run is replaced, when every file in it is in its
                `manifest.json` and unchanged. A place that was found before the work says what was there then.
            force: keep what is there as `<folder>.1`, `<folder>.2`, ...; nothing is replaced then.
            pictures: draw the figures, which takes most of the time.
            report: write `report.html`.
            replay: write `replay.html`, the run in three dimensions.

        Raises:
            InputError: when the folder holds anything else, cannot be written, or has been changed by others since
                it was found; the message then says where the run is.
        """
        place = folder if isinstance(folder, Place) else require_writable(Path(folder), force=force)
        try:
            error = self._write(place, {"figures": pictures, "replay.html": replay, "report.html": report})
        except Exception:
            raise
        except BaseException as interruption:  # without pages, which take most of the time
            if place.is_as_found:
                self._write(place, {}, f"figures and pages: {in_words(interruption)}")
            raise
        if error is not None:
            raise error
        return place.shown

    def _write(self, place: Place, pages: Mapping[str, bool], *missing: str) -> Exception | None:
        """Writes the run's folder with the wanted pages; notes missing files in its summary, and returns an error."""
        data, drawn = PartsMade(), PartsMade()
        with whole_folder(place, keep_old=lambda: bool(self.results.ended or data.missing)) as partial:

            def write_part(name: str, write: Callable[[Path], object], parts_made: PartsMade) -> None:
                """Writes one file of the folder, and notes its error; raises an OSError of data files."""
                try:
                    write(partial / name)
                except Exception as error:
                    if parts_made is data and isinstance(error, OSError):
                        raise
                    _remove_unfinished(partial / name)
                    parts_made.note(name, error)

            write_part("scenario.yaml", lambda path: _write_text(path, yaml_text(self.scenario) + _END), data)
            write_part("telemetry.csv", self.write_telemetry, data)
            write_part("history.npz", self.write_history, data)
            if self.state:
                write_part(
                    STATE_FILE, lambda path: _write_text(path, _json(self.filter_state(), FilterState, data)), data
                )
            shown = self.thin_for_plots() if any(pages.values()) else self  # once: it takes a while
            if pages.get("figures"):
                write_part("figures", shown._write_figures, drawn)
            if pages.get("replay.html"):
                write_part("replay.html", shown._write_replay, drawn)
            if pages.get("report.html"):
                write_part("report.html", shown._write_report, drawn)
            noted = (*self.results.missing, *data.missing, *drawn.missing, *missing)
            results = replace(self.results, missing=noted) if noted else self.results
            content = reduce_to_storable(results.as_json(), SummaryFile, lost := PartsMade())
            if lost.missing:
                content["missing"] = [*noted, *lost.missing]
            _write_text(partial / "summary.json", _text(content))
        return data.error or drawn.error or lost.error

    def _write_figures(self, folder: Path) -> None:
        """Writes every figure into a new folder."""
        folder.mkdir()
        self.plot.save(folder)

    def _write_replay(self, path: Path) -> None:
        """Writes the replay as an HTML file."""
        from massprop_drake.display.flight3d import replay_html  # noqa: PLC0415 (loads Drake)

        _write_text(path, replay_html(self))

    def _write_report(self, path: Path) -> None:
        """Writes the report as an HTML file, with a link to a replay beside it."""
        from massprop_drake.display.page import report_html  # noqa: PLC0415 (loads templates)

        replay = path.with_name("replay.html")
        _write_text(path, report_html(self, replay=replay.name if replay.exists() else None))

    def export(self, to: str, path: str | Path, *, epoch_s: float | None = None, force: bool = False) -> Path:
        """Exports the run for Foxglove, PlotJuggler or Rerun: signals with units, frames, a scene and messages.

        Args:
            to: "mcap", for Foxglove and PlotJuggler, or "rerun".
            path: of the file; it appears whole or not at all, and replaces nothing.
            epoch_s: time of the run's time zero, s since 1970; None: times are those of the run.
            force: keep a file that is there as `<path>.1`, `<path>.2`, ....

        Raises:
            InputError: when there is no such format, the package that writes it is missing, a file is there, or it
                cannot be written.
        """
        from massprop_drake.display import export  # noqa: PLC0415 (loads an extra)

        target, kind = Path(path), export.find_format(to).name
        content = export.Content(self, epoch_s=epoch_s)
        write_file(target, lambda ready: export.write(content, to, ready), kind, force=force)
        return target

    def _repr_html_(self) -> str:
        """Returns the verdict and the table of ten mass properties as HTML for a notebook."""
        from massprop_drake.display.page import summary_html  # noqa: PLC0415 (loads templates)

        return summary_html(self)


def _json(content: Any, schema: type[BaseModel], parts_made: PartsMade) -> str:
    """Returns content as JSON text that its schema accepts; notes numbers that are not finite."""
    return _text(reduce_to_storable(content, schema, parts_made))


def _text(content: Any) -> str:
    """Returns content as indented JSON text."""
    return json.dumps(content, indent=2, allow_nan=False) + "\n"


def _write_text(path: Path, text: str) -> None:
    """Writes a text file in UTF-8, its line ends unchanged."""
    path.write_text(text, encoding="utf-8", newline="")


def _remove_unfinished(path: Path) -> None:
    """Removes an incomplete file, or an empty folder."""
    if not path.is_dir():
        path.unlink(missing_ok=True)
    elif not any(path.iterdir()):
        path.rmdir()

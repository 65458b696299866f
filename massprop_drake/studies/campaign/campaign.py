"""Campaign from Python: load, plan, run, read."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
from collections.abc import Callable, Generator, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from massprop_drake.errors import InputError
from massprop_drake.inputs.campaign_file import CampaignSpec, load_campaign
from massprop_drake.inputs.model import yaml_text
from massprop_drake.inputs.yaml import collect_files_read, exists
from massprop_drake.maths.kernels import require_compiler
from massprop_drake.results.folder import resumable_folder
from massprop_drake.studies.campaign import TO_FLY, engine, reading, require_packages, store
from massprop_drake.studies.campaign.counts import Status
from massprop_drake.studies.campaign.plan import PlannedCase, case_name, plan_cases

if TYPE_CHECKING:
    import pandas
    from distributed import Client

_KIND = "campaign"  # of work, as folders are marked


class Campaign:
    """Many cases of one scenario, and their results.

    Attributes:
        spec: the file, and all that it refers to.
        folder: that plan and results are in; None before the first run.
        files: that it was read from.
    """

    def __init__(self, spec: CampaignSpec, folder: Path | None = None, files: Sequence[Path] = ()):
        self.spec = spec
        self.folder = folder
        self.files = tuple(files)

    def __repr__(self) -> str:
        where = "" if self.folder is None else f" in {self.folder}"
        return f"<Campaign '{self.spec.file.name}' on '{self.spec.base.name}'{where}>"

    @staticmethod
    def load(campaign: str | Path, overrides: Sequence[str] = ()) -> Campaign:
        """Loads a bundled campaign by name, a campaign file, or the folder of a planned or flown campaign.

        Raises:
            InputError: when there is none, or its data are wrong.
        """
        folder = Path(campaign)
        if exists(folder / store.PLAN):
            if overrides:
                raise InputError(f"--set {overrides[0]}: {folder} has its plan already; change the file and plan anew")
            return Campaign(store.planned_spec(folder), folder)
        with collect_files_read() as files:
            spec = load_campaign(campaign, overrides)
        if spec.file.gates:
            from massprop_drake.studies.campaign import merit  # noqa: PLC0415 (scipy.stats is slow to load)

            merit.require_known_figures(spec.file.gates, spec.source)
        return Campaign(spec, files=files)

    def planned(self) -> list[PlannedCase]:
        """Returns every case of the plan, fully resolved, from the folder if there is one."""
        if self.folder is not None:
            return store.read_plan(self.folder)[0]
        return plan_cases(self.spec)

    def advice(self) -> list[str]:
        """Returns warnings on entries of the campaign that are valid, but doubtful."""
        return self.spec.doubts

    def reason(self, case_id: int) -> str | None:
        """Returns why a case failed to run; None where it did not fail, or has not been flown."""
        rows = store.read_rows(self._require_folder(), ["case_id", "reason"])
        reasons = dict(zip(rows["case_id"].to_pylist(), rows["reason"].to_pylist(), strict=True)) if rows else {}
        return reasons.get(case_id)

    def case_folder(self, case_id: int) -> Path:
        """Returns the path of a case's run folder, which exists if the run is kept."""
        return self._require_folder() / store.CASES / case_name(case_id)

    def plan(self, folder: str | Path, *, force: bool = False) -> Campaign:
        """Writes campaign file, base scenario and plan into a new folder, or extends the plan in it.

        Args:
            folder: to write.
            force: keep a folder of anything else as `<folder>.1`, `<folder>.2`, ....

        Raises:
            InputError: when the folder holds another campaign, or anything else, or another process is at work in it.
        """
        target = Path(folder)
        cases = self.planned()  # before anything is made
        with resumable_folder(target, _KIND, force=force, reads=self._input_files(cases)) as path:
            self._write_plan(target, path, cases)
        return Campaign(self.spec, target)

    def _input_files(self, cases: Sequence[PlannedCase]) -> list[str | Path]:
        """Returns the paths of the campaign's files and of its cases' telemetry records."""
        return [*self.files, *(case.record for case in cases if case.record is not None)]

    def _write_plan(self, shown_folder: Path, folder: Path, cases: Sequence[PlannedCase]) -> dict[str, str]:
        """Writes campaign file and plan and returns the plan's metadata; InputError if the folder has another plan."""
        metadata = {"digest": _digest(self.spec), "campaign": self.spec.file.name}
        earlier: list[PlannedCase] = []
        if exists(folder / store.PLAN):
            earlier, stored = store.read_plan(folder)
            if stored.get("digest") != metadata["digest"]:
                raise InputError(
                    f"{shown_folder}: holds the plan of another campaign, or of an earlier version of this one; "
                    "give another folder with --out"
                )
            if len(cases) < len(earlier):
                raise InputError(f"{shown_folder}: holds a plan of {len(earlier)} cases, more than {len(cases)}")
            if any(old.digest != new.digest for old, new in zip(earlier, cases, strict=False)):
                raise InputError(
                    f"{shown_folder}: holds a plan of {len(earlier)} cases that are not the first of these "
                    f"{len(cases)}: {self.spec.file.method} makes draws as a whole, or records have come in between; "
                    "give another folder with --out"
                )
            metadata = stored
        store.write_text(folder / store.BASE, yaml_text(self.spec.base))
        store.write_text(folder / store.FILE, yaml_text(self.spec.file))  # gates and limits may be others
        if len(cases) > len(earlier):
            store.write_plan(folder, cases, metadata)
        return metadata

    def run(
        self,
        folder: str | Path | None = None,
        *,
        client: Client | None = None,
        workers: int | None = None,
        scheduler: str | None = None,
        resume: bool = False,
        only: Iterable[int] = (),
        force: bool = False,
        progress: Callable[[int, int], None] | None = None,
        dashboard: Callable[[str], None] | None = None,
    ) -> Campaign:
        """Flies the planned cases without a result row, or those of `only`, and returns the campaign in its folder.

        Args:
            folder: to write; default `runs/<name>`.
            client: of Dask; None: one of `scheduler`, or of a cluster on this machine.
            workers: processes of the latter; None: one for each processor that this one may use.
            scheduler: address of a Dask scheduler.
            resume: go on with what the folder holds.
            only: numbers of cases to fly alone, flown before or not; their run folders are kept, and what has failed to
                run gets another row.
            force: keep a folder of anything else as `<folder>.1`, `<folder>.2`, ....
            progress: called with the number of cases that have a row, and of all.
            dashboard: called with the address of Dask's dashboard.

        Raises:
            InputError: when Dask is not installed, the folder is taken, a case is not in the plan, what is to be
                compiled cannot be on this machine, or no worker can fly; what has been flown until then is kept.

        The processes of a cluster on this machine load the program that calls this: its own doings must stand under
        `if __name__ == "__main__":`.
        """
        require_packages("flights of a campaign", *TO_FLY)
        target = Path(folder) if folder is not None else self.folder or Path("runs") / self.spec.file.name
        selected = frozenset(only)
        cases = self.planned()
        unknown = sorted(selected - {case.case_id for case in cases})
        if unknown:
            raise InputError(f"--only {unknown[0]}: the plan has cases 0 to {len(cases) - 1}")
        compiles_here = self.spec.base.execution.compiled and client is None and scheduler is None
        if compiles_here and not resume:
            require_compiler()  # before anything is written
        with contextlib.ExitStack() as stack:
            if client is None and scheduler is not None:  # before anything is written
                client = stack.enter_context(engine.remote_client(scheduler))
            path = stack.enter_context(resumable_folder(target, _KIND, force=force, reads=self._input_files(cases)))
            flown = store.flown_ids(path)
            if flown and not resume and not selected:
                raise InputError(
                    f"{target}: holds results already; --resume goes on with them, --out names another folder"
                )
            metadata = self._write_plan(target, path, cases)
            if selected:
                store.remove_failed_rows(path, selected)
                flown = store.flown_ids(path)
            remaining = [
                case for case in cases if (case.case_id in selected if selected else case.case_id not in flown)
            ]
            if remaining:
                if compiles_here:
                    require_compiler()
                client = client or stack.enter_context(
                    engine.local_client(min(workers or len(os.sched_getaffinity(0)), len(remaining)))
                )
                link = engine.dashboard_address(client)
                if dashboard is not None and link is not None:
                    dashboard(link)
                counts = self._write_chunks(client, path, metadata, flown, self._make_work(path, remaining, selected))
                for count in stack.enter_context(contextlib.closing(counts)):
                    if progress is not None:
                        progress(count, len(cases))
        return Campaign(self.spec, target)

    def _make_work(self, folder: Path, cases: Sequence[PlannedCase], kept_ids: frozenset[int]) -> engine.CampaignWork:
        """Makes the work to distribute: cases, their common settings, and limits of time and memory."""
        file = self.spec.file
        setup = {
            "base": self.spec.base.model_dump(mode="json"),
            "campaign": file.name,
            "times_s": list(file.times_s),
            "keep": file.keep,
            "folder": str(folder),
        }
        return engine.CampaignWork(setup, cases, kept_ids, file.limits.time_s, file.limits.memory_mb)

    def _write_chunks(
        self, client: Client, folder: Path, metadata: dict[str, str], flown_ids: set[int], work: engine.CampaignWork
    ) -> Generator[int]:
        """Writes result rows chunk by chunk as cases are flown; yields the number of cases that have a row."""
        columns = store.schema(self.spec.file.times_s)
        execution = json.loads(metadata["execution"]) if "execution" in metadata else None
        with contextlib.closing(engine.fly_chunks(client, work, execution, folder)) as chunks:
            for chunk in chunks:
                if execution is None:
                    execution = chunk.execution
                    store.write_metadata(folder, {**metadata, "execution": json.dumps(execution)})
                # a case flown alone may have its row
                rows = [row for row in chunk.rows if row["case_id"] not in flown_ids]
                if rows:
                    store.write_rows(folder, sorted(rows, key=lambda row: row["case_id"]), columns)
                flown_ids.update(row["case_id"] for row in rows)
                yield len(flown_ids)

    def status(self) -> Status:
        """Returns progress and outcomes of the cases, read from the folder."""
        return reading.status(self._require_folder(), self.spec)

    def to_pandas(self) -> pandas.DataFrame:
        """Returns a data frame of all flown cases, draws and results, indexed by `case_id`.

        Raises:
            ImportError: when pandas is not installed.
            InputError: when nothing has been flown.
        """
        folder = self._require_folder()
        rows = store.read_rows(folder)
        if rows is None:
            raise InputError(f"{folder}: no case has been flown yet")
        drawn = store.read_draws(folder).to_pandas().set_index("case_id")
        return rows.to_pandas().set_index("case_id").join(drawn)

    def _repr_html_(self) -> str | None:
        """Returns title and verdict as HTML for a notebook; None before any case has been flown."""
        if self.folder is None or not store.flown_ids(self.folder):
            return None
        from massprop_drake.studies.campaign import campaign_report  # noqa: PLC0415 (templates and scipy are slow to load)

        return campaign_report.notebook_html(reading.read(self.folder))

    def _require_folder(self) -> Path:
        """Returns the campaign's folder; raises InputError where it has not been run."""
        if self.folder is None:
            raise InputError(f"campaign '{self.spec.file.name}' has not been run; give the folder of one that has")
        return self.folder


def _digest(spec: CampaignSpec) -> str:
    """Computes a SHA-256 digest of all settings that determine the plan, except the number of cases."""
    file = spec.file
    content = file.model_dump(mode="json", exclude={"cases", "gates", "keep", "limits", "description", "base", "set"})
    return hashlib.sha256(json.dumps([content, spec.base.model_dump(mode="json")]).encode()).hexdigest()

"""A campaign from Python: load, plan, run, read."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from massprop_drake.errors import InputError
from massprop_drake.inputs.campaign import CampaignSpec, campaign_from, load_campaign
from massprop_drake.inputs.model import yaml_text
from massprop_drake.inputs.yaml import Document, exists, read_text
from massprop_drake.results.folder import resumable_folder
from massprop_drake.studies.campaign import engine, store
from massprop_drake.studies.campaign.plan import PlannedCase, advice, planned
from massprop_drake.studies.campaign.worker import CannotFlyError

if TYPE_CHECKING:
    import pandas
    from distributed import Client

_CAN_GROW = ("random", "sobol")
_KIND = "campaign"  # of work, as folders are marked


class Status(NamedTuple):
    """How far a campaign is.

    Attributes:
        planned: number of cases.
        flown: of them have a row.
        failing: of those ended wrong.
        failed: of those could not be run.
    """

    planned: int
    flown: int
    failing: int
    failed: int


class Campaign:
    """Many cases of one scenario, and what came of them.

    Attributes:
        spec: the file, and all that it refers to.
        folder: that plan and results are in; None before the first run.
    """

    def __init__(self, spec: CampaignSpec, folder: Path | None = None):
        self.spec = spec
        self.folder = folder

    def __repr__(self) -> str:
        where = "" if self.folder is None else f" in {self.folder}"
        return f"<Campaign '{self.spec.file.name}' on '{self.spec.base.name}'{where}>"

    @staticmethod
    def load(campaign: str | Path, overrides: Sequence[str] = ()) -> Campaign:
        """Loads a bundled campaign by name, a file, or the folder of one that has been planned or run.

        Raises:
            InputError: when there is none, or its data are wrong.
        """
        folder = Path(campaign)
        if exists(folder / store.PLAN):
            if overrides:
                raise InputError(f"--set {overrides[0]}: {folder} has its plan already; change the file and plan anew")
            return Campaign(_kept(folder), folder)
        return Campaign(load_campaign(campaign, overrides))

    def planned(self) -> list[PlannedCase]:
        """Every case, fully resolved."""
        if self.folder is not None:
            return store.read_plan(self.folder)[0]
        return planned(self.spec)

    def advice(self) -> list[str]:
        """What is not wrong, but could be better."""
        return advice(self.spec)

    def plan(self, folder: str | Path, *, force: bool = False) -> Campaign:
        """Writes file, base scenario and plan into a folder that has none yet, or a plan that this one extends.

        Args:
            folder: to write.
            force: keep a folder of anything else as `<folder>.1`, `<folder>.2`, ....

        Raises:
            InputError: when the folder holds another campaign, or anything else, or another process is at work in it.
        """
        target = Path(folder)
        cases = self.planned()  # before anything is made
        with resumable_folder(target, _KIND, force=force) as path:
            self._plan(target, path, cases)
        return Campaign(self.spec, target)

    def _plan(self, target: Path, path: Path, cases: Sequence[PlannedCase]) -> None:
        """Writes the plan, or makes sure that the one that is there is this one's."""
        facts = {"digest": _digest(self.spec), "campaign": self.spec.file.name}
        if exists(path / store.PLAN):
            earlier, found = store.read_plan(path)
            if found.get("digest") != facts["digest"]:
                raise InputError(
                    f"{target}: holds the plan of another campaign, or of an earlier version of this one; "
                    "give another folder with --out"
                )
            if len(earlier) == len(cases):
                return
            if self.spec.file.method not in _CAN_GROW:
                raise InputError(
                    f"{target}: holds a plan of {len(earlier)} cases, which {self.spec.file.method} cannot change to "
                    f"{len(cases)}: its draws are made as a whole; give another folder with --out"
                )
            if len(cases) < len(earlier):
                raise InputError(f"{target}: holds a plan of {len(earlier)} cases, more than {len(cases)}")
            facts = found
        store.write_text(path / store.BASE, yaml_text(self.spec.base))
        store.write_text(path / store.FILE, yaml_text(self.spec.file))
        store.write_plan(path, cases, facts)

    def run(
        self,
        folder: str | Path | None = None,
        *,
        client: Client | None = None,
        workers: int = 2,
        scheduler: str | None = None,
        resume: bool = False,
        only: Iterable[int] = (),
        force: bool = False,
        progress: Callable[[int, int], None] | None = None,
        dashboard: Callable[[str], None] | None = None,
    ) -> Campaign:
        """Flies the cases that have no row yet.

        Args:
            folder: to write; default `runs/<name>`.
            client: of Dask; None: one of `scheduler`, or of a cluster on this machine.
            workers: processes of the latter.
            scheduler: address of a Dask scheduler.
            resume: go on with what the folder holds.
            only: numbers of cases to fly alone, flown before or not; their run folders are kept.
            force: keep a folder of anything else as `<folder>.1`, `<folder>.2`, ....
            progress: called with the number of cases that have a row, and of all.
            dashboard: called with the address of Dask's dashboard.

        Raises:
            InputError: when the folder is taken, a case is not in the plan, or no worker can fly.
        """
        target = Path(folder) if folder is not None else self.folder or Path("runs") / self.spec.file.name
        alone = frozenset(only)
        cases = self.planned()
        unknown = sorted(alone - {case.case_id for case in cases})
        if unknown:
            raise InputError(f"--only {unknown[0]}: the plan has cases 0 to {len(cases) - 1}")
        with resumable_folder(target, _KIND, force=force) as path:
            store.tidy(path)
            done = store.flown_ids(path)
            if done and not resume and not alone:
                raise InputError(
                    f"{target}: holds results already; --resume goes on with them, --out names another folder"
                )
            self._plan(target, path, cases)
            todo = [case for case in cases if (case.case_id in alone if alone else case.case_id not in done)]
            if todo:
                with _opened(client, workers, scheduler) as chosen:
                    if dashboard is not None and chosen.dashboard_link:
                        dashboard(chosen.dashboard_link)
                    self._fly(chosen, path, todo, alone, len(cases), progress)
        return Campaign(self.spec, target)

    def _fly(
        self,
        client: Client,
        target: Path,
        todo: Sequence[PlannedCase],
        alone: frozenset[int],
        total: int,
        progress: Callable[[int, int], None] | None,
    ) -> None:
        file = self.spec.file
        setup = {
            "base": self.spec.base.model_dump(mode="json"),
            "campaign": file.name,
            "times_s": list(file.times_s),
            "keep": file.keep,
            "folder": str(target),
        }
        setup["key"] = hashlib.sha256(json.dumps(setup).encode()).hexdigest()
        work = engine.Work(setup, todo, alone, file.limits.time_s, file.limits.memory_mb)
        cases, facts = store.read_plan(target)
        execution = json.loads(facts["execution"]) if "execution" in facts else None
        columns = store.schema(file.times_s)
        done = store.flown_ids(target)
        try:
            for rows, here in engine.flown(client, work, execution, target):
                if execution is None:
                    execution = here
                    store.write_plan(target, cases, {**facts, "execution": json.dumps(here)})
                rows = [row for row in rows if row["case_id"] not in done]  # one flown alone has its row already
                if rows:
                    store.write_rows(target, sorted(rows, key=lambda row: row["case_id"]), columns)
                done.update(row["case_id"] for row in rows)
                if progress is not None:
                    progress(len(done), total)
        except CannotFlyError as error:
            raise InputError(f"no case can be flown: {error}") from None

    def status(self) -> Status:
        """How far it is, from the folder alone."""
        folder = self._need_folder()
        cases, _ = store.read_plan(folder)
        rows = store.read_rows(folder, ["case_id", "status", "failing"])
        if rows is None:
            return Status(len(cases), 0, 0, 0)
        failing = sum(1 for reasons in rows["failing"].to_pylist() if reasons)
        failed = sum(1 for status in rows["status"].to_pylist() if status != "flown")
        return Status(len(cases), rows.num_rows, failing, failed)

    def to_pandas(self) -> pandas.DataFrame:
        """Every case that has been flown: what was drawn and what came of it, indexed by `case_id`.

        Raises:
            ImportError: when pandas is not installed.
            InputError: when nothing has been flown.
        """
        folder = self._need_folder()
        rows = store.read_rows(folder)
        if rows is None:
            raise InputError(f"{folder}: no case has been flown yet")
        drawn = store.read_draws(folder).to_pandas().set_index("case_id")
        return rows.to_pandas().set_index("case_id").join(drawn)

    def _need_folder(self) -> Path:
        if self.folder is None:
            raise InputError(f"campaign '{self.spec.file.name}' has not been run; give the folder of one that has")
        return self.folder


def _opened(client: Client | None, workers: int, scheduler: str | None) -> AbstractContextManager[Client]:
    if client is not None:
        return nullcontext(client)
    if scheduler is not None:
        return engine.remote_client(scheduler)
    return engine.local_client(workers)


def _kept(folder: Path) -> CampaignSpec:
    """The campaign that a folder was planned for, independent of where its file was."""
    text = read_text(folder / store.FILE)
    document = Document(text, str(folder / store.FILE))
    document.data["base"] = str((folder / store.BASE).resolve())
    document.data.pop("set", None)  # is in the base
    return campaign_from(document, folder)


def _digest(spec: CampaignSpec) -> str:
    """What makes a plan, but for the number of cases where it can grow."""
    file = spec.file
    content = file.model_dump(mode="json", exclude={"gates", "keep", "limits", "description", "base", "set"})
    if file.method in _CAN_GROW:
        content.pop("cases")
    return hashlib.sha256(json.dumps([content, spec.base.model_dump(mode="json")]).encode()).hexdigest()

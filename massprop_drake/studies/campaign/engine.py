"""Engine that flies the cases of a campaign on Dask: on this machine's processors, or on any scheduler's.

Rows come back to the driver, which alone writes results. A task is a chunk of cases that takes some seconds; each
worker flies its cases in a child process, so that a case that crashes, hangs or outgrows its memory is a row with
its reason and nothing else.
"""

from __future__ import annotations

import contextlib
import importlib.util
import logging
import threading
import uuid
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from massprop_drake.errors import InputError
from massprop_drake.studies.campaign.execution import differences
from massprop_drake.studies.campaign.plan import FAILED, FLOWN
from massprop_drake.studies.campaign.worker import CannotFlyError, end_campaign_work, fly_chunk, require_shared
from massprop_drake.studies.processes import defer_ctrl_c

if TYPE_CHECKING:
    from distributed import Client, Future

_CHUNK_S, _LEAST_S = 15.0, 2.0  # that a task is to take, and one of the last ones
_FIRST = 4  # cases of a task before it is known how long one takes
_MOST = 200
_WAITING = 2  # tasks for each worker, so that none runs dry
_LOST = 10  # tasks in a row whose workers were killed, after which it is no chance
_CONNECT_S = 10.0
_WORKERS_S = 60.0  # to wait for the first worker
_TIDY_S = 20.0  # that each part of tidying up may take
_SHORT_LOG = {"distributed.admin.low-level-log-length": 10}  # messages; they hold the cases of their chunks
_LOST_ERRORS = (OSError, CancelledError)  # of a connection to Dask, those of time among them


class Case(Protocol):
    """Interface of a case to fly, such as `plan.PlannedCase`."""

    @property
    def case_id(self) -> int:
        """Unique number of the case."""

    def _asdict(self) -> dict[str, Any]: ...


class CampaignWork(NamedTuple):
    """Cases to fly, with their common settings and limits.

    Attributes:
        setup: what all cases share, as of `campaign_flight.Flights`, without `key` and `token`.
        cases: to fly.
        kept: numbers of those to be kept whatever becomes of them.
        time_s, memory_mb: what each may take.
    """

    setup: Mapping[str, Any]
    cases: Sequence[Case]
    kept: frozenset[int]
    time_s: float
    memory_mb: float


class Flown(NamedTuple):
    """Chunk that has been flown.

    Attributes:
        rows: of its cases.
        execution: how it was executed.
    """

    rows: list[dict[str, Any]]
    execution: dict[str, str]


@contextlib.contextmanager
def local_client(workers: int) -> Iterator[Client]:
    """Yields a Dask client of a cluster on this machine, which is closed after the block.

    Args:
        workers: processes, each with one thread.
    """
    import dask  # noqa: PLC0415 (optional, slow to load)
    from distributed import Client, LocalCluster  # noqa: PLC0415

    settings = {
        "distributed.scheduler.allowed-failures": _LOST,
        "distributed.worker.multiprocessing-method": "spawn",  # Drake has threads, and a fork of them can hang
        "distributed.admin.tick.limit": "1h",  # of warnings
        "distributed.worker.profile.enabled": False,  # what nobody looks at grows in this process's memory
        "distributed.admin.system-monitor.log-length": 120,
    }
    with contextlib.ExitStack() as stack:
        stack.enter_context(dask.config.set({**_SHORT_LOG, **settings}))
        with defer_ctrl_c():  # the cluster's own threads start its workers, also those that replace others
            cluster = LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                processes=True,
                memory_limit=0,  # the limit is each case's
                dashboard_address="127.0.0.1:0",
                silence_logs="CRITICAL",
            )
        stack.callback(_tidy_with_timeout, cluster.close)
        yield stack.enter_context(Client(cluster))


@contextlib.contextmanager
def remote_client(address: str) -> Iterator[Client]:
    """Yields a Dask client of an existing scheduler, by its address.

    Raises:
        InputError: when none answers.
    """
    import dask  # noqa: PLC0415 (optional, slow to load)
    from distributed import Client  # noqa: PLC0415
    from distributed.utils import silence_logging_cmgr  # noqa: PLC0415

    try:
        with dask.config.set(_SHORT_LOG):
            client = Client(address, timeout=_CONNECT_S)
    except (OSError, ValueError, TimeoutError) as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(
            f"--scheduler {address}: no Dask scheduler answers there ({reason}); start one with `dask scheduler`, and "
            "give the address that it prints"
        ) from None
    with silence_logging_cmgr(logging.CRITICAL):  # of a lost scheduler, too, our message is enough
        try:
            yield client
        finally:
            with contextlib.suppress(*_LOST_ERRORS):
                client.close()


def dashboard_address(client: Client) -> str | None:
    """Returns the address of Dask's dashboard; None where the scheduler has none."""
    if client.run_on_scheduler(importlib.util.find_spec, "bokeh") is None:  # an extra of Dask's
        return None
    return client.dashboard_link if "dashboard" in client.scheduler_info()["services"] else None


def fly_chunks(
    client: Client, work: CampaignWork, execution: Mapping[str, str] | None, folder: Path
) -> Generator[Flown]:
    """Flies the cases of a campaign on Dask, and yields each chunk's rows as soon as it is done.

    Args:
        client: of a scheduler with workers.
        work: what to fly.
        execution: how the cases of the campaign are executed; None: as the first chunk is.
        folder: the campaign's; workers must see it where run folders are kept.

    Raises:
        InputError: when there are no workers, one cannot fly, executes differently or does not see the folder, or the
            scheduler is lost.
    """
    key = uuid.uuid4().hex
    with _folder_token(folder, needed=work.setup["keep"] != "none" or bool(work.kept)) as token:
        setup = {**work.setup, "key": key, "token": token}
        chunks = _Chunks(client, work._replace(setup=setup), execution)
        try:
            _require_workers(client, setup)
            yield from chunks.fly()
        except _LOST_ERRORS:
            raise InputError(
                "the connection to the Dask scheduler is lost; --resume goes on with what is there"
            ) from None
        finally:
            _tidy_with_timeout(chunks.cancel)
            _tidy_with_timeout(client.run, end_campaign_work, key, on_error="ignore")


def _tidy_with_timeout(cleanup: Callable[..., Any], *arguments: Any, **options: Any) -> None:
    """Calls a cleanup function for a limited time, as workers that are being lost may never answer."""

    def run_cleanup() -> None:
        """Calls the cleanup and ignores errors of a lost connection."""
        # lost anyway; a client without a scheduler may have no connection object to ask
        with contextlib.suppress(*_LOST_ERRORS, RuntimeError, AttributeError):
            cleanup(*arguments, **options)

    thread = threading.Thread(target=run_cleanup, daemon=True)
    thread.start()
    thread.join(_TIDY_S)


@contextlib.contextmanager
def _folder_token(folder: Path, *, needed: bool) -> Iterator[str | None]:
    """Makes a file for the block by which workers recognize the campaign's folder; yields its name or None."""
    if not needed:
        yield None
        return
    path = folder / f".seen-{uuid.uuid4().hex}"
    path.touch()
    try:
        yield path.name
    finally:
        path.unlink(missing_ok=True)


def _require_workers(client: Client, setup: Mapping[str, Any]) -> None:
    """Checks that Dask has workers, and that each can fly cases; InputError if not."""
    try:
        client.wait_for_workers(1, timeout=_WORKERS_S)
    except TimeoutError:
        raise InputError(f"the Dask scheduler has no workers after {_WORKERS_S:g} s; start some") from None
    for address, answer in client.run(require_shared, setup, on_error="return").items():
        if isinstance(answer, Exception) and not isinstance(answer, OSError):  # one that has just gone
            raise InputError(f"worker {address} cannot fly: {answer}")


class _Chunks:
    """Chunks of cases on Dask, sized to take some seconds each, the last ones shared among the workers.

    Args:
        client: of a scheduler with workers.
        work: what to fly.
        execution: how cases are executed; None: as the first chunk is.
    """

    def __init__(self, client: Client, work: CampaignWork, execution: Mapping[str, str] | None):
        self._client = client
        self._work = work
        self._execution = execution
        self._waiting = list(reversed(work.cases))
        self._under_way: dict[Future[Any], list[Case]] = {}
        self._per_case_s: float | None = None

    def fly(self) -> Iterator[Flown]:
        """Flies all chunks, and yields the rows of each as soon as it is done; resubmits cases of lost workers."""
        from distributed import as_completed  # noqa: PLC0415 (optional, slow to load)
        from distributed.scheduler import KilledWorker  # noqa: PLC0415

        lost = 0
        done = as_completed(self._submit_chunks())
        for future in done:
            chunk = self._under_way.pop(future)
            try:
                result = future.result()
            except KilledWorker:
                lost += 1
                if lost == _LOST:
                    raise InputError(
                        f"workers were killed again and again while they flew cases {chunk[0].case_id} to "
                        f"{chunk[-1].case_id}; see whether their machines have memory for them"
                    ) from None
                self._waiting += reversed(chunk)
            except CannotFlyError as error:
                raise InputError(f"no case can be flown on {error}") from None
            else:
                lost = 0
                yield self._collect_chunk(chunk, result)
            future.release()
            done.update(self._submit_chunks())

    def cancel(self) -> None:
        """Cancels the chunks that are submitted and not done."""
        self._client.cancel(list(self._under_way), force=True)

    def _submit_chunks(self) -> list[Future[Any]]:
        """Submits chunks until every worker thread has several waiting; returns their futures."""
        submitted = []
        threads = max(1, sum(self._client.nthreads().values()))
        while self._waiting and len(self._under_way) < _WAITING * threads:
            chunk = [self._waiting.pop() for _ in range(min(self._chunk_size(threads), len(self._waiting)))]
            requests = [{**case._asdict(), "keep": case.case_id in self._work.kept} for case in chunk]
            future = self._client.submit(
                fly_chunk,
                self._work.setup,
                requests,
                self._work.time_s,
                self._work.memory_mb,
                key=f"cases-{chunk[0].case_id}-{uuid.uuid4().hex}",
            )
            self._under_way[future] = chunk
            submitted.append(future)
        return submitted

    def _chunk_size(self, threads: int) -> int:
        """Computes the number of cases in the next chunk, from the time that a case takes."""
        share = len(self._waiting) // (_WAITING * threads)
        if self._per_case_s is None:
            return max(1, min(_FIRST, share))
        smallest, largest = (max(1, min(_MOST, round(span / self._per_case_s))) for span in (_LEAST_S, _CHUNK_S))
        return min(largest, max(smallest, share))

    def _collect_chunk(self, chunk: Sequence[Case], result: Mapping[str, Any]) -> Flown:
        """Checks that a chunk was executed like those before it, and returns its rows."""
        execution, answers = result["execution"], result["answers"]
        if self._execution is not None and differences(execution, self._execution):
            raise InputError(
                f"{result['worker']} executes cases differently, so that they would not be the same bit for bit: "
                f"{'; '.join(differences(execution, self._execution))}; give all workers the same environment"
            )
        self._execution = execution
        self._per_case_s = max(1e-3, sum(answer["wall_s"] for answer in answers) / len(answers))
        rows = [_result_row(case, answer, result["worker"]) for case, answer in zip(chunk, answers, strict=True)]
        return Flown(rows, execution)


def _result_row(case: Case, answer: Mapping[str, Any], worker: str) -> dict[str, Any]:
    """Makes the row of a case from a worker's answer: results, or the reason why it failed to run."""
    common = {"case_id": case.case_id, "wall_s": answer["wall_s"], "cpu_s": answer["cpu_s"], "worker": worker}
    if "row" in answer:
        return {**common, "status": FLOWN, "reason": None, **answer["row"]}
    return {**common, "status": FAILED, "reason": answer["failed"]}

"""Flies the cases of a campaign on Dask: on this machine's processors, or on any scheduler's.

Rows come back to the driver, which alone writes results. A task is a chunk of cases that takes some seconds; each
worker flies its cases in a child process, so that a case that crashes, hangs or outgrows its memory is a row with
its reason and nothing else.
"""

from __future__ import annotations

import contextlib
import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from massprop_drake.errors import InputError
from massprop_drake.studies.campaign.execution import differences
from massprop_drake.studies.campaign.plan import PlannedCase
from massprop_drake.studies.campaign.worker import fly_chunk, shares_folder

if TYPE_CHECKING:
    from distributed import Client

_CHUNK_S = 15.0  # that a task is to take
_FIRST = 4  # cases of a task before it is known how long one takes
_MOST = 200
_WAITING = 2  # tasks for each worker, so that none runs dry
_RETRIES = 10  # of a task whose worker was lost


class Work(NamedTuple):
    """What is to be flown, and how.

    Attributes:
        setup: what all cases share, as of `flight.Flights`, with `key`, its digest.
        cases: to fly.
        kept: numbers of those to be kept whatever becomes of them.
        time_s, memory_mb: what each may take.
    """

    setup: Mapping[str, Any]
    cases: Sequence[PlannedCase]
    kept: frozenset[int]
    time_s: float
    memory_mb: float


@contextlib.contextmanager
def local_client(workers: int) -> Iterator[Client]:
    """A client of a cluster on this machine, which ends with the block.

    Args:
        workers: processes, each with one thread.
    """
    import dask  # noqa: PLC0415 (optional, slow to load)
    from distributed import Client, LocalCluster  # noqa: PLC0415

    quiet = {
        "distributed.scheduler.allowed-failures": _RETRIES,
        "distributed.worker.multiprocessing-method": "spawn",
        "distributed.admin.tick.limit": "1h",
    }
    with (
        dask.config.set(quiet),
        LocalCluster(
            n_workers=workers, threads_per_worker=1, processes=True, memory_limit=0, dashboard_address="127.0.0.1:0",
            silence_logs="ERROR",
        ) as cluster,
        Client(cluster) as client,
    ):  # fmt: skip
        yield client


@contextlib.contextmanager
def remote_client(address: str) -> Iterator[Client]:
    """A client of a scheduler that is there.

    Raises:
        InputError: when none answers.
    """
    from distributed import Client  # noqa: PLC0415 (optional, slow to load)

    try:
        client = Client(address, timeout=10)
    except (OSError, ValueError, TimeoutError) as error:
        raise InputError(
            f"--scheduler {address}: no Dask scheduler answers there ({str(error).splitlines()[0]}); start one with "
            "`dask scheduler`, and give the address that it prints"
        ) from None
    with client:
        yield client


def flown(
    client: Client, work: Work, execution: Mapping[str, str] | None, folder: Path
) -> Iterator[tuple[list[dict[str, Any]], dict[str, str]]]:
    """Yields the rows of each chunk as it is done, with how it was executed.

    Args:
        client: of a scheduler with workers.
        work: what to fly.
        execution: how the cases of the campaign are executed; None: as the first chunk is.
        folder: the campaign's; workers must see it where run folders are kept.

    Raises:
        InputError: when a worker executes differently, or does not see the folder.
    """
    from distributed import as_completed  # noqa: PLC0415 (optional, slow to load)

    if not client.nthreads():
        client.wait_for_workers(1, timeout=60)
    if work.setup["keep"] != "none" or work.kept:
        _require_shared(client, folder)
    waiting = list(work.cases)
    chunks: dict[str, list[PlannedCase]] = {}
    running = as_completed()
    per_case_s: float | None = None

    def submit() -> None:
        """Hands out the next chunk, if there is one."""
        workers = max(1, len(client.nthreads()))
        wanted = _FIRST if per_case_s is None else max(1, min(_MOST, round(_CHUNK_S / per_case_s)))
        chunk = waiting[: min(wanted, -(-len(waiting) // workers))]  # the last ones are shared out
        if not chunk:
            return
        del waiting[: len(chunk)]
        requests = [{**case._asdict(), "keep": case.case_id in work.kept} for case in chunk]
        key = f"cases-{chunk[0].case_id}-{uuid.uuid4().hex}"
        chunks[key] = chunk
        running.add(
            client.submit(fly_chunk, work.setup, requests, work.time_s, work.memory_mb, key=key, retries=_RETRIES)
        )

    for _ in range(_WAITING * max(1, len(client.nthreads()))):
        submit()
    for future in running:
        result = future.result()
        chunk, here = chunks.pop(future.key), result["execution"]
        future.release()
        if execution is not None and differences(here, execution):
            raise InputError(
                "a worker executes cases differently, so that they would not be the same bit for bit: "
                f"{'; '.join(differences(here, execution))}; give all workers the same environment"
            )
        execution = here
        spent = [answer["wall_s"] for answer in result["answers"]]
        per_case_s = max(1e-3, sum(spent) / len(spent))
        yield [_row(case.case_id, answer) for case, answer in zip(chunk, result["answers"], strict=True)], here
        submit()


def _row(case_id: int, answer: Mapping[str, Any]) -> dict[str, Any]:
    common = {"case_id": case_id, "wall_s": answer.get("wall_s"), "cpu_s": answer.get("cpu_s")}
    if "row" in answer:
        return {**common, "status": "flown", "reason": None, **answer["row"]}
    return {**common, "status": "failed", "reason": answer["failed"]}


def _require_shared(client: Client, folder: Path) -> None:
    """Makes sure that every worker sees the folder that run folders are kept in."""
    token = f".seen-{uuid.uuid4().hex}"
    (folder / token).touch()
    try:
        seen = client.run(shares_folder, str(folder.resolve()), token)
    finally:
        (folder / token).unlink(missing_ok=True)
    blind = [address for address, sees in seen.items() if not sees]
    if blind:
        raise InputError(
            f"{folder}: worker {blind[0]} does not see this folder, in which run folders are to be kept; give a folder "
            "that all machines share, or `keep: none`"
        )

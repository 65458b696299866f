"""Dask within the process of the tests."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any

import pytest
from distributed import Client, LocalCluster

from massprop_drake.studies.campaign import worker


@contextlib.contextmanager
def client_here(workers: int = 1) -> Iterator[Client]:
    """A client of a scheduler and one worker that are threads of this process, which start at once."""
    options: dict[str, Any] = {"n_workers": 1, "memory_limit": 0, "dashboard_address": None}
    children, start = list[worker.Child](), worker.Child
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(worker, "Child", lambda setup: children.append(start(setup)) or children[-1])
        with (
            LocalCluster(processes=False, threads_per_worker=workers, silence_logs="CRITICAL", **options) as cluster,
            Client(cluster) as client,
        ):
            yield client
    for child in children:  # which else the end of the worker's process would end
        child.close()

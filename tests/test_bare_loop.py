"""The plain loop of the benchmarks: an independent wiring of the same mathematics."""

from __future__ import annotations

import importlib.util

import numpy as np
from conftest import REPOSITORY

from massprop_drake import Run


def test_the_plain_loop_gives_the_diagrams_numbers(short_run: Run) -> None:
    spec = importlib.util.spec_from_file_location("bare_loop", REPOSITORY / "benchmarks" / "bare_loop.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    loop = module.fly(short_run.scenario)
    np.testing.assert_array_equal(loop.estimate, short_run["estimate"][-1])
    np.testing.assert_array_equal(loop.standard_deviation, short_run["standard_deviation"][-1])
    np.testing.assert_array_equal(loop.commands, short_run["command"])
    assert short_run["rotation_used"].any()

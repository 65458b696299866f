"""Cases that the figures are made of: flights of a scenario, and calculations without one."""

from __future__ import annotations

import hashlib
import inspect
import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from importlib.metadata import version
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from massprop_drake.inputs.model import digest
from massprop_drake.inputs.scenario import Scenario, load_scenario
from reproduction.sources import PACKAGE, code_digest

Array = NDArray[np.float64]

_SIMULATE = PACKAGE / "runners" / "simulate.py"
PHASES = 20  # sensor phases: seeds 0 to 19

ESTIMATES = ("estimate", "standard_deviation", "truth")
CONSISTENCY = ("rotation_nis", "rotation_used", "mass_nis", "mass_used")
MOTION = ("rate", "velocity", "torque", "force", "command", "usable")
DETECTION = (
    *("command", "rate", "tested", "alarm", "suspected_cluster", "suspected_jet", "jet_isolated"),
    *("cluster_margin", "jet_margin", "likelihood", "failure_magnitude"),
)


@dataclass(frozen=True)
class Flight:
    """A scenario simulated once per sensor phase.

    Attributes:
        name: short, unique among all cases; part of a file's name.
        scenario: bundled.
        overrides: KEY=VALUE each, as for `massprop run --set`.
        signals: to keep, besides `time_s`.
        from_s: start of what is kept, s.
        seeds: how many phases; seeds 0, 1, ...
    """

    name: str
    scenario: str
    overrides: tuple[str, ...] = ()
    signals: tuple[str, ...] = (*ESTIMATES, *CONSISTENCY)
    from_s: float = 0.0
    seeds: int = PHASES

    def key(self) -> str:
        """Returns a digest of all that the result depends on, but for the seed."""
        content = [digest(_scenario(self.scenario, self.overrides)), self.signals, self.from_s, _code_and_versions()]
        return _sha256(json.dumps(content))

    def run(self, seed: int) -> dict[str, Array]:
        """Simulates one phase and returns the signals to keep."""
        from massprop_drake.runners.simulate import simulate  # noqa: PLC0415 (loads Drake)

        scenario = _scenario(self.scenario, self.overrides)
        flown = simulate(scenario.model_copy(update={"seed": seed}))
        kept = flown.time_s >= self.from_s - 1e-9
        return {"time_s": flown.time_s[kept], **{name: flown[name][kept] for name in self.signals}}


@dataclass(frozen=True)
class Calculation:
    """A calculation that needs no flight.

    Attributes:
        name: short, unique among all cases; part of a file's name.
        function: of a module, so that another process finds it; takes a seed, gives arrays by name.
        seeds: how often; once where nothing is drawn by chance, and then part of every phase.
    """

    name: str
    function: Callable[[int], dict[str, Array]]
    seeds: int = 1

    def key(self) -> str:
        """Returns a digest of all that the result depends on, but for the seed."""
        source = inspect.getsourcefile(self.function)
        assert source is not None
        return _sha256(
            json.dumps([self.function.__qualname__, _bundled_files_digest(), _code_and_versions(Path(source))])
        )

    def run(self, seed: int) -> dict[str, Array]:
        """Calculates the result for one seed."""
        return self.function(seed)


Case = Flight | Calculation


@lru_cache(maxsize=64)
def _scenario(name: str, overrides: tuple[str, ...]) -> Scenario:
    """Loads a scenario with overrides, once."""
    return load_scenario(name, list(overrides))


def _code_and_versions(*modules: Path) -> list[str]:
    """Digest of all code that a flight or some modules run, and versions of the packages that compute."""
    return [code_digest(_SIMULATE, *modules), *map(version, ("drake", "numpy", "scipy"))]


@lru_cache(maxsize=1)
def _bundled_files_digest() -> str:
    """Digest of the bundled vehicles and scenarios, which a calculation may load."""
    folders = [resources.files(f"massprop_drake.{part}") for part in ("scenarios", "vehicles")]
    files = [file for folder in folders for file in sorted(folder.iterdir(), key=lambda one: one.name)]
    return _sha256(json.dumps([_sha256(file.read_bytes()) for file in files if file.name.endswith(".yaml")]))


def _sha256(content: str | bytes) -> str:
    """SHA-256 of a text or of bytes, hexadecimal."""
    return hashlib.sha256(content.encode() if isinstance(content, str) else content).hexdigest()

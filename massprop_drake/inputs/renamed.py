"""Terms of earlier versions: accepted for one more release, with one warning that says what to write instead.

Keys of files are renamed by `yaml.Document` as it reads them. Those of a detector's former kind depend on the whole
scenario: `inputs.scenario` has them replaced by `update_detector_terms`.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Sequence
from typing import Any

from massprop_drake.errors import dotted

# keys by their place in a vehicle or a scenario: the present name
KEYS = {"sensors.quantiser_phase": "quantizer_phase", "shape[].colour": "color"}  # codespell:ignore
_OLD_KEYS = {place.rpartition(".")[2] for place in KEYS}

# the detector of the joint filter: former and present kind, former keys without effect, and the key that has moved
FORMER_KIND, PRESENT_KIND = "multi_hypothesis", "hypotheses"
_WITHOUT_EFFECT = ("trigger_jet", "trigger", "lead", "lead_nothing", "jump")
_MOVED_TO_FAULTS = "slots"


class RenamedWarning(FutureWarning):
    """Warning of a name of an earlier version, accepted once more."""


def warn(message: str, stacklevel: int = 2) -> None:
    """Issues a warning of an old name; `stacklevel` as of `warnings.warn`, counted from the caller."""
    warnings.warn(f"{message}; version 0.4 will know the new name alone", RenamedWarning, stacklevel + 1)


def present_key_name(path: Sequence[str | int]) -> str | None:
    """Returns the present name of the last key of a path in a vehicle or a scenario; None when it is not an old one."""
    if path[-1] not in _OLD_KEYS:
        return None
    return KEYS.get(re.sub(r"\[\d+\]", "[]", dotted(tuple(path))).removeprefix("vehicle."))


def update_detector_terms(data: dict[str, Any], default_kind: str) -> tuple[dict[str, Any], list[str]]:
    """Returns a scenario's data with former terms of the joint filter's detector replaced, and texts on each.

    Args:
        data: of a scenario, not validated; unchanged.
        default_kind: kind of detector that is meant where none is named.
    """
    block, faults = data.get("detector"), data.get("faults", {})
    if not isinstance(block, dict) or block.get("kind", default_kind) not in (FORMER_KIND, PRESENT_KIND):
        return data, []
    kept, messages = dict(block), []
    if kept.get("kind") == FORMER_KIND:
        kept["kind"] = PRESENT_KIND
        messages.append(f"detector.kind: {FORMER_KIND} is now {PRESENT_KIND}")
    if _MOVED_TO_FAULTS in kept and isinstance(faults, dict) and _MOVED_TO_FAULTS not in faults:
        data = {**data, "faults": {**faults, _MOVED_TO_FAULTS: kept.pop(_MOVED_TO_FAULTS)}}
        messages.append(f"detector.{_MOVED_TO_FAULTS} is now faults.{_MOVED_TO_FAULTS}")
    if gone := [key for key in _WITHOUT_EFFECT if key in kept]:
        names, verb = ", ".join(f"detector.{key}" for key in gone), "has" if len(gone) == 1 else "have"
        messages.append(f"{names} {verb} no effect any more: faults.false_per_hour says how sure a declaration is")
        kept = {key: value for key, value in kept.items() if key not in gone}
    return ({**data, "detector": kept}, messages) if messages else (data, [])


def obsolete_detector_keys(former_kind: Any, kind: Any) -> tuple[str, ...]:
    """Returns the keys of the joint filter's detector to drop where another kind of detector replaces it."""
    if former_kind not in (None, FORMER_KIND, PRESENT_KIND) or kind in (FORMER_KIND, PRESENT_KIND):
        return ()
    shared = ("lead", "lead_nothing") if former_kind is None else ()  # with other kinds
    return tuple(key for key in (*_WITHOUT_EFFECT, _MOVED_TO_FAULTS) if key not in shared)

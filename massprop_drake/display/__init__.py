"""Display of runs: figures, the report page and the replay in three dimensions.

Names are loaded when they are first used, so that figures need no Drake.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from massprop_drake.display.flight3d import write_replay as write_replay
    from massprop_drake.display.page import write_report as write_report

_HOMES = {"write_replay": "flight3d", "write_report": "page"}

__all__ = ["write_replay", "write_report"]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)

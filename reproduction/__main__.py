"""`python -m reproduction` reruns the thesis; see `command`."""

from __future__ import annotations

from typing import Any

from massprop_drake.cli.main import main

NAME = "python -m reproduction"


def load() -> Any:
    """Loads and returns the Typer app of the reproduction, which is slow."""
    from reproduction.command import app  # noqa: PLC0415 (a signal is told from the start)

    return app


if __name__ == "__main__":
    main(load, NAME)

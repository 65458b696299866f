"""Files that appear whole or not at all."""

from __future__ import annotations

import contextlib
import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

from massprop_drake.errors import InputError

MARKERS = ("summary.json", "scenario.yaml")  # a folder that holds them, or nothing, is one of ours


@contextlib.contextmanager
def whole_folder(target: Path, *, force: bool = False) -> Iterator[Path]:
    """A folder to write into that takes its place at the end, all at once.

    An earlier folder of ours is replaced. Into any other folder, with ``force``, the new files are moved
    one by one, and what else is in it stays.

    Args:
        target: where the folder is to be.
        force: whether a folder that is not ours may be written into.

    Raises:
        InputError: when the place is taken or cannot be written to.
    """
    require_writable(target, force=force)
    partial = Path(tempfile.mkdtemp(prefix=f".{target.name}.", dir=target.parent))
    try:
        yield partial
        partial.chmod(0o777 & ~_umask())
        if not target.exists():
            partial.rename(target)
        elif _is_ours(target):
            old = Path(tempfile.mkdtemp(prefix=f".{target.name}.", dir=target.parent))
            target.rename(old / "old")
            partial.rename(target)
            shutil.rmtree(old)
        else:
            for source in sorted(path for path in partial.rglob("*") if path.is_file()):
                destination = target / source.relative_to(partial)
                destination.parent.mkdir(parents=True, exist_ok=True)
                os.replace(source, destination)
    except OSError as error:
        raise InputError(f"{target}: cannot be written: {error.strerror}") from None
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def require_writable(target: Path, *, force: bool = False) -> None:
    """Checks, before any work is done, that a folder can be put there.

    Raises:
        InputError: when the place is taken by something that is not ours, or cannot be written to.
    """
    try:
        if target.exists() and not target.is_dir():
            raise InputError(f"{target}: is a file; give a folder to write to")
        if target.exists() and not _is_ours(target) and not force:
            raise InputError(
                f"{target}: holds files that are not of an earlier run; "
                "give another folder, or --force to write into it"
            )
        target.parent.mkdir(parents=True, exist_ok=True)
        probe = tempfile.mkdtemp(prefix=f".{target.name}.", dir=target.parent)
        os.rmdir(probe)
    except OSError as error:
        raise InputError(f"{target}: cannot be written: {error.strerror}; give a folder you may write to") from None


def resumable_folder(target: Path, kind: str) -> None:
    """A folder that work goes on in: made, or one that was made for the same kind of work.

    Args:
        target: where.
        kind: of work, kept in a marker file.

    Raises:
        InputError: when the place is taken by something else, or cannot be written to.
    """
    marker = target / ".massprop"
    try:
        if target.exists() and not target.is_dir():
            raise InputError(f"{target}: is a file; give a folder to write to")
        ours = marker.is_file() and marker.read_text(encoding="utf-8").strip() == kind
        if target.exists() and any(target.iterdir()) and not ours:
            raise InputError(f"{target}: holds files that are not of an earlier {kind}; give another folder")
        target.mkdir(parents=True, exist_ok=True)
        if not ours:
            write_whole(marker, kind + "\n")
    except OSError as error:
        raise InputError(f"{target}: cannot be written: {error.strerror}; give a folder you may write to") from None


def _is_ours(folder: Path) -> bool:
    return all((folder / name).is_file() for name in MARKERS) or not any(folder.iterdir())


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def write_whole(path: Path, text: str) -> None:
    """Writes a text file in one step."""
    with tempfile.NamedTemporaryFile(
        "w", encoding="utf-8", newline="", dir=path.parent, prefix=f".{path.name}.", delete=False
    ) as file:
        file.write(text)
    os.chmod(file.name, 0o666 & ~_umask())
    os.replace(file.name, path)

"""Files that appear whole or not at all."""

from __future__ import annotations

import contextlib
import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

from massprop_drake.errors import InputError

_MARKERS = ("summary.json", "scenario.yaml")  # a folder with both, or an empty one, may be replaced


@contextlib.contextmanager
def whole_folder(target: Path, *, force: bool = False) -> Iterator[Path]:
    """Yields a temporary folder that takes the target's place once the block ends without an error.

    The folder of an earlier run is replaced as a whole. With ``force`` any other folder keeps its files, and the
    new ones are moved in one by one.

    Args:
        target: path of the folder.
        force: also write into a non-empty folder that is no run's.

    Raises:
        InputError: when the target is taken or cannot be written.
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
    """Checks, before any work is done, that a run's folder can be written.

    Raises:
        InputError: when the target is taken by anything but an earlier run, or cannot be written.
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
    """Makes a folder for work that can be interrupted, or takes up one that was made for the same kind of work.

    Args:
        target: path of the folder.
        kind: of work, kept in a marker file.

    Raises:
        InputError: when the target is taken by anything else, or cannot be written.
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
    return all((folder / name).is_file() for name in _MARKERS) or not any(folder.iterdir())


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def write_whole(path: Path, text: str) -> None:
    """Writes a text file whole or not at all."""
    with tempfile.NamedTemporaryFile(
        "w", encoding="utf-8", newline="", dir=path.parent, prefix=f".{path.name}.", delete=False
    ) as file:
        file.write(text)
    os.chmod(file.name, 0o666 & ~_umask())
    os.replace(file.name, path)

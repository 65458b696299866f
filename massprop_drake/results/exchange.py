"""Exchange of finished work with what was there before, at once: stages, locks, and recovery of killed processes.

A stage is a hidden folder beside its target. Work in progress lies in its `partial/`, finished work that is to take
its place in `whole/`, what had to make room for it in `old/`. It is locked as long as its process lives, by a lock of
the operating system that ends with the process; so whoever comes next can tell what a kill has left. Where a file
system has no such locks (some network file systems), what is left stays until it is removed by hand.
"""

from __future__ import annotations

import contextlib
import ctypes
import errno
import fcntl
import itertools
import os
import re
import shutil
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from massprop_drake.results import manifest

_PREFIX = ".massprop-"
_STAGE = re.compile(re.escape(_PREFIX) + r"[a-z0-9_]{8}")
_PARTIAL, _WHOLE, _OLD = "partial", "whole", "old"
_NO_LOCKS = (errno.ENOLCK, errno.EBADF, errno.ENOTSUP, errno.ENOSYS)
_NO_SWAP = (errno.EINVAL, errno.ENOTSUP, errno.ENOSYS)


class Stage:
    """Hidden folder, at a path, in which files are prepared before they take their place."""

    def __init__(self, path: Path):
        self._path = path
        self.partial = path / _PARTIAL

    def finish(self, name: str) -> Path:
        """Moves a named folder from `partial` to `whole`, from which recovery can finish it; returns its new path."""
        whole = self._path / _WHOLE / name
        (self.partial / name).rename(whole)
        return whole

    def exchange(self, finished: Path, target: Path) -> Path:
        """Puts a finished folder in place of the target; returns the new path of the old folder."""
        if swap_folders(finished, target):
            return finished
        old = self._path / _OLD / target.name
        target.rename(old)
        finished.rename(target)
        return old


def lock(descriptor: int, *, wait: bool = True) -> bool:
    """Locks an open file or folder until it is closed; False where the file system has no locks.

    Raises:
        BlockingIOError: when another process has it and it is not to be waited for.
    """
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX if wait else fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno not in _NO_LOCKS:
            raise
        return False
    return True


@contextlib.contextmanager
def lock_folder(folder: Path) -> Iterator[None]:
    """Holds the lock of a folder, against exchanges by other processes; waits until it is free."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        lock(descriptor)
        yield
    finally:
        os.close(descriptor)


@contextlib.contextmanager
def stage(folder: Path) -> Iterator[Stage]:
    """Yields a hidden staging folder to prepare files in; then removes it, but for finished work left in it."""
    with lock_folder(folder):
        _recover_stages(folder)
        path = Path(tempfile.mkdtemp(prefix=_PREFIX, dir=folder))
        descriptor = os.open(path, os.O_RDONLY)
        lock(descriptor)
    try:
        for part in (_PARTIAL, _WHOLE, _OLD):
            (path / part).mkdir()
        yield Stage(path)
    finally:
        shutil.rmtree(path / _PARTIAL, ignore_errors=True)
        for emptied in (path / _WHOLE, path / _OLD, path):
            with contextlib.suppress(OSError):  # not empty: something stands in the way of finished work
                emptied.rmdir()
        os.close(descriptor)


def recover(path: Path) -> None:
    """Finishes or removes interrupted work of killed processes beside a run's path, before it is read."""
    try:
        real = Path(os.path.realpath(path))
    except ValueError:  # a name that no file can have
        return
    for folder in (real, *list(real.parents)[:2]):  # a run's folder, or a file in it
        with contextlib.suppress(OSError):  # where nothing may be changed, what is there can still be read
            if any(_leftover_stages(folder)):
                with lock_folder(folder):
                    _recover_stages(folder)


def set_aside(path: Path, base: Path) -> Path:
    """Renames a file or folder to the first free one of `<base>.1`, `<base>.2`, ...; returns its new path."""
    for number in itertools.count(1):
        free_path = base.with_name(f"{base.name}.{number}")
        if not os.path.lexists(free_path):
            path.rename(free_path)
            return free_path
    raise AssertionError


def drop(replaced: Path, base: Path) -> Path | None:
    """Deletes a replaced folder's own files; returns the path, `<base>.1` or so, of foreign files left, or None."""
    return None if manifest.discard(replaced) else set_aside(replaced, base)


def _leftover_stages(folder: Path) -> Iterator[Path]:
    """Yields the paths of hidden stages in a folder, those of running processes included."""
    if folder.is_dir():
        for path in sorted(folder.iterdir()):
            if _STAGE.fullmatch(path.name) and path.is_dir() and not path.is_symlink():
                yield path


def _recover_stages(folder: Path) -> None:
    """Recovers the stages of killed processes in a locked folder; those of living processes stay."""
    for path in _leftover_stages(folder):
        # another user's, of a living process, or of one that has just removed it
        with contextlib.suppress(PermissionError, BlockingIOError, FileNotFoundError):
            descriptor = os.open(path, os.O_RDONLY)
            try:
                if lock(descriptor, wait=False):
                    _recover_stage(path)
            finally:
                os.close(descriptor)


def _recover_stage(stage_path: Path) -> None:
    """Moves a killed process's finished folders to their place, if free, and removes its stage."""
    if {path.name for path in stage_path.iterdir()} - {_PARTIAL, _WHOLE, _OLD}:
        return  # no stage of ours
    shutil.rmtree(stage_path / _PARTIAL, ignore_errors=True)
    for part in (stage_path / _WHOLE, stage_path / _OLD):
        for path in sorted(part.iterdir()) if part.is_dir() else []:
            target = stage_path.parent / path.name
            if os.path.lexists(target):
                drop(path, target)
            else:
                path.rename(target)
        with contextlib.suppress(OSError):
            part.rmdir()
    with contextlib.suppress(OSError):  # not empty: somebody has put something there
        stage_path.rmdir()


def swap_folders(folder: Path, other_folder: Path) -> bool:
    """Exchanges two folders atomically; returns False where system or file system cannot."""
    library = ctypes.CDLL(None, use_errno=True)
    first, second = os.fsencode(folder), os.fsencode(other_folder)
    if sys.platform == "darwin":
        failed = library.renamex_np(first, second, 2)  # RENAME_SWAP
    elif hasattr(library, "renameat2"):
        here = -100  # AT_FDCWD: paths are absolute
        failed = library.renameat2(here, first, here, second, 2)  # RENAME_EXCHANGE
    else:
        return False
    if not failed:
        return True
    number = ctypes.get_errno()
    if number in _NO_SWAP:
        return False
    raise OSError(number, os.strerror(number))

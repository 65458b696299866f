"""What is ours: the manifest of a folder, which lists every file with its digest, and the seal of a single page.

Only what is as we wrote it may be replaced or removed; everything else is somebody's work.
"""

from __future__ import annotations

import hashlib
import os
import re
import secrets
from collections.abc import Iterator
from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, ValidationError

NAME = "manifest.json"

_SEAL = "<!-- massprop {} -->\n"
_SEAL_SIZE = len(_SEAL.format("0" * 64))


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class FileEntry(_Model):
    """A file's content: SHA-256 as hexadecimal digits, and size in bytes."""

    sha256: str
    bytes: int


class Manifest(_Model):
    """The content of `manifest.json`.

    Attributes:
        format: of the manifest itself.
        id: of the folder, drawn when it was first written.
        folders: below the folder, relative, with slashes.
        files: every other file by its relative path.
        pending: files that are about to be put in place of those in `files`; none but in the middle of writing.
    """

    format: Literal[1] = 1
    id: str
    folders: tuple[str, ...] = ()
    files: dict[str, FileEntry] = {}
    pending: dict[str, FileEntry] = {}

    def as_bytes(self) -> bytes:
        """The text of the file."""
        return (self.model_dump_json(indent=2, exclude_defaults=False) + "\n").encode()

    def lists(self, name: str, path: Path) -> bool:
        """Whether a path holds the regular file that is listed under a name."""
        expected = [entries[name] for entries in (self.files, self.pending) if name in entries]
        return bool(expected) and _is_plain(path) and _entry(path) in expected


def empty() -> Manifest:
    """The manifest of a new folder."""
    return Manifest(id=secrets.token_hex(16))


def listing(folder: Path) -> Manifest:
    """The manifest of a folder, all of whose files are ours."""
    found = list(_walk(folder))
    return empty().model_copy(
        update={
            "folders": tuple(name for name, path in found if path.is_dir()),
            "files": {name: _entry(path) for name, path in found if not path.is_dir()},
        }
    )


def read(folder: Path) -> Manifest | None:
    """Reads a folder's manifest; None where there is none of ours."""
    path = folder / NAME
    if not _is_plain(path):
        return None
    try:
        return Manifest.model_validate_json(path.read_bytes())
    except ValidationError:
        return None


def foreign(folder: Path, manifest: Manifest | None) -> Iterator[str]:
    """Names what is in a folder that is not in its manifest, or not as it says."""
    for name, path in _walk(folder):
        if manifest is not None and name == NAME:
            continue
        if path.is_dir() and not path.is_symlink():
            known = manifest is not None and name in manifest.folders
            if not known and not any(path.iterdir()):  # of any other unknown folder the files are named
                yield f"{name}/"
        elif manifest is None or not manifest.lists(name, path):
            yield f"{name} (changed)" if manifest is not None and name in manifest.files else name


def discard(folder: Path) -> bool:
    """Removes the files of a folder that its manifest lists, and the folder when nothing else was in it."""
    manifest = read(folder)
    if manifest is not None:
        for name, path in list(_walk(folder)):
            if manifest.lists(name, path):
                path.unlink()
        for name, path in reversed(list(_walk(folder))):
            if name in manifest.folders and not path.is_symlink() and not any(path.iterdir()):
                path.rmdir()
        (folder / NAME).unlink()  # last, so that what was begun can be ended later
    if any(folder.iterdir()):
        return False
    folder.rmdir()
    return True


def entry(content: bytes) -> FileEntry:
    """What a manifest says of a file with some content."""
    return FileEntry(sha256=hashlib.sha256(content).hexdigest(), bytes=len(content))


def sealed(text: str) -> bytes:
    """A page that can be told to be ours, and unchanged, wherever it lies: its last line has the digest of the rest."""
    content = text.encode()
    return content + _SEAL.format(hashlib.sha256(content).hexdigest()).encode()


def is_sealed(path: Path) -> bool:
    """Whether a path holds a page as `sealed` made it."""
    if not _is_plain(path) or path.stat().st_size < _SEAL_SIZE:
        return False
    with path.open("rb") as file:
        file.seek(-_SEAL_SIZE, os.SEEK_END)
        seal = file.read()
        if not re.fullmatch(re.escape(_SEAL.encode()).replace(rb"\{\}", b"[0-9a-f]{64}"), seal):
            return False
        file.seek(0)
        return seal == _SEAL.format(hashlib.sha256(file.read()[:-_SEAL_SIZE]).hexdigest()).encode()


def _walk(folder: Path) -> Iterator[tuple[str, Path]]:
    """Everything below a folder with its relative name, folders before what is in them; links are not followed."""
    waiting = [folder]
    while waiting:
        with os.scandir(waiting.pop()) as scanned:
            found = sorted(scanned, key=lambda item: item.name)
        for item in found:
            yield Path(item.path).relative_to(folder).as_posix(), Path(item.path)
        waiting += [Path(item.path) for item in reversed(found) if item.is_dir(follow_symlinks=False)]


def _is_plain(path: Path) -> bool:
    return path.is_file() and not path.is_symlink()


def _entry(path: Path) -> FileEntry:
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
        return FileEntry(sha256=digest, bytes=file.tell())

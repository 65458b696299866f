"""Ownership of files: the manifest of a folder, with every file's digest, and the seal of a single page or YAML file.

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

# of a page, without a kind up to version 0.2, or of a YAML file
_SEAL = re.compile(
    rb"(?:<!-- massprop (?:([a-z]{1,20}) )?([0-9a-f]{64}) -->|# massprop ([a-z]{1,20}) ([0-9a-f]{64}))\n"
)
_SEAL_SIZE = 128  # bytes, at most


class _Model(BaseModel):
    """Part of `manifest.json`, which has no other keys."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class FileEntry(_Model):
    """Content of a file: SHA-256 as hexadecimal digits, and size in bytes."""

    sha256: str
    bytes: int


class Manifest(_Model):
    """Content of `manifest.json`.

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
        """Returns the manifest as JSON text, as `manifest.json` holds it."""
        return (self.model_dump_json(indent=2, exclude_defaults=False) + "\n").encode()

    def has(self, path: Path, folder: Path) -> bool:
        """Tests whether a path is a listed file of the folder, by its name, in other case, or as the same file."""
        name = path.relative_to(folder).as_posix()
        candidates = (listed for listed in (*self.files, *self.pending, NAME) if listed.casefold() == name.casefold())
        return any(listed == name or _is_same_file(folder / listed, path) for listed in candidates)

    def holds(self, folder: str) -> bool:
        """Tests whether the manifest lists a subfolder, by relative path, or files in it."""
        return folder in self.folders or any(name.startswith(f"{folder}/") for name in (*self.files, *self.pending))

    def lists(self, name: str, path: Path) -> bool:
        """Tests whether the manifest lists a name, and a path is a regular file with that size and digest."""
        expected = [entries[name] for entries in (self.files, self.pending) if name in entries]
        return bool(expected) and _is_plain(path) and entry(path) in expected


def empty() -> Manifest:
    """Makes the manifest of a new folder: a random id, no files."""
    return Manifest(id=secrets.token_hex(16))


def listing(folder: Path) -> Manifest:
    """Makes the manifest of a folder, with the digests of all files in it."""
    found = list(_walk(folder))
    return empty().model_copy(
        update={
            "folders": tuple(name for name, path in found if path.is_dir()),
            "files": {name: entry(path) for name, path in found if not path.is_dir()},
        }
    )


def read(folder: Path) -> Manifest | None:
    """Reads a folder's manifest; None where it has none, or no valid one."""
    path = folder / NAME
    if not _is_plain(path):
        return None
    try:
        return Manifest.model_validate_json(path.read_bytes())
    except ValidationError:
        return None


def foreign_entries(folder: Path, manifest: Manifest | None) -> Iterator[str]:
    """Yields names of files and empty folders that are not listed in the manifest, or have changed since."""
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
    """Deletes a folder's unchanged listed files, its manifest, and itself if empty; returns whether it is gone."""
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


def entry(path: Path) -> FileEntry:
    """Computes the SHA-256 and the size in bytes of a file."""
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
        return FileEntry(sha256=digest, bytes=file.tell())


def seal_page(text: str, kind: str, *, yaml: bool = False) -> bytes:
    """Returns a page's text with a last line that holds its kind and digest, which reveals changes.

    Args:
        text: of the page.
        kind: of page, a word in small letters.
        yaml: the text is YAML, and no HTML.
    """
    content = text.encode()
    seal = f"massprop {kind} {hashlib.sha256(content).hexdigest()}"
    return content + (f"# {seal}\n" if yaml else f"<!-- {seal} -->\n").encode()


def sealed_kind(path: Path) -> str | None:
    """Returns the kind of a page sealed by `seal_page` and unchanged, "" where its seal has none; None for others."""
    if not _is_plain(path):
        return None
    with path.open("rb") as file:
        size = file.seek(0, os.SEEK_END)
        file.seek(max(size - _SEAL_SIZE, 0))
        seal = re.search(_SEAL.pattern + rb"\Z", file.read())
        if seal is None:
            return None
        file.seek(0)
        content = file.read()[: -len(seal[0])]
    kind, digest = seal[1] or seal[3] or b"", seal[2] or seal[4]
    return kind.decode() if digest == hashlib.sha256(content).hexdigest().encode() else None


def _walk(folder: Path) -> Iterator[tuple[str, Path]]:
    """Yields (relative name, path) of everything below a folder, folders first; links are not followed."""
    waiting = [folder]
    while waiting:
        with os.scandir(waiting.pop()) as scanned:
            found = sorted(scanned, key=lambda item: item.name)
        for item in found:
            yield Path(item.path).relative_to(folder).as_posix(), Path(item.path)
        waiting += [Path(item.path) for item in reversed(found) if item.is_dir(follow_symlinks=False)]


def _is_same_file(one: Path, other: Path) -> bool:
    """Tests whether two paths are the same file on disk; False where one is missing."""
    try:
        return one.samefile(other)
    except OSError:
        return False


def _is_plain(path: Path) -> bool:
    """Tests whether a path is a regular file, and no link."""
    return path.is_file() and not path.is_symlink()

"""Folders and files that appear whole or not at all, and never in place of another's.

One rule for everything that is written: it takes the place of nothing, of an empty folder, or of what we have written
of the same kind and nobody has changed since (`results.manifest`). Anything else is refused before the work, or kept
as `<name>.1`, `<name>.2`, ... where that is asked for (`force`). Nothing takes the place of what the work reads, nor of
what belongs to a run or a campaign, whatever is asked for; a run's own folder alone is kept for a new run.
"""

from __future__ import annotations

import contextlib
import errno
import os
import stat
from collections.abc import Callable, Iterable, Iterator, Mapping
from itertools import chain, islice
from pathlib import Path
from typing import NamedTuple

from massprop_drake.errors import InputError
from massprop_drake.results import manifest
from massprop_drake.results.exchange import Stage, drop, lock, lock_folder, recover, set_aside, stage
from massprop_drake.results.manifest import Manifest

Written = bytes | Callable[[Path], object]  # a file's content, or what writes it to a path where nothing is

_NAMED = 3  # files that a message names
_COUNTED = 1000  # files that it counts at the most
_ELSEWHERE = "give another folder"
_MARKER = ".massprop"  # of a folder for work that can be interrupted


class Place(NamedTuple):
    """Folder to write, as it was found before the work.

    Attributes:
        path: without links.
        shown: as the user gave it.
        force: keep what is there under another name.
        found: `id` of the folder's manifest; None where there was no folder, or an empty one.
    """

    path: Path
    shown: Path
    force: bool
    found: str | None

    @property
    def is_as_found(self) -> bool:
        """True if the folder's manifest still has the id that was found before the work."""
        manifest_now = manifest.read(self.path)
        return (None if manifest_now is None else manifest_now.id) == self.found

    def name_beside(self, sibling: Path) -> Path:
        """Converts the path of a sibling folder to the form in which the user gave this one."""
        return sibling if self.shown.is_symlink() else self.shown.with_name(sibling.name)


def require_writable(target: Path, *, force: bool = False, reads: Iterable[str | Path] = ()) -> Place:
    """Checks that a folder can be written, replacing neither foreign files nor what is read; returns its `Place`.

    Args:
        target: path of the folder; a link to a folder stands for that folder.
        force: keep what is there as `<name>.1`, `<name>.2`, ..., instead of replacing or refusing it.
        reads: files and folders that the work will read.

    Raises:
        InputError: when the target holds anything but what we have written, or cannot be written.
    """
    with _explain_os_error(target):
        path = _resolve_folder(target)
        path.parent.mkdir(parents=True, exist_ok=True)
        with stage(path.parent):  # can be made
            pass
        with lock_folder(path.parent):  # nobody exchanges it while it is looked at
            found = manifest.read(path)
            may_stay = force and found is not None and not _foreign_in_words(path, found)  # a run that is flown again
            _require_replaceable(target, path, [one for one in reads if not (may_stay and _resolve_path(one) == path)])
            if force:
                _require_apart(target, path, _inner_work_folders(path))
            elif path.exists():
                _require_only_ours(target, path, found)
        return Place(path, target, force, None if found is None else found.id)


@contextlib.contextmanager
def reserve_place(target: Path, *, force: bool = False, reads: Iterable[str | Path] = ()) -> Iterator[Place]:
    """Checks a folder as `require_writable`, yields its `Place`, and at the end removes parents left empty.

    Raises:
        InputError: as there; or the target is in the folder of a campaign.
    """
    with _explain_os_error(target):
        _require_apart(target, _resolve_folder(target))
        made = [folder for folder in _resolve_folder(target).parents if not os.path.lexists(folder)]
    place = require_writable(target, force=force, reads=reads)
    touched = place.path.parent.stat().st_mtime_ns
    try:
        yield place
    finally:
        with contextlib.suppress(OSError):  # it holds something, or is gone
            if place.path.parent.stat().st_mtime_ns == touched:  # else somebody has checked a place in it since
                for folder in made:
                    folder.rmdir()


@contextlib.contextmanager
def whole_folder(place: Place, keep_old: Callable[[], bool] = lambda: False) -> Iterator[Path]:
    """Yields a temporary folder that, with a manifest, replaces the target folder after an error-free block.

    A place that has changed meanwhile is left alone, and the new folder is kept under the next free name.

    Args:
        place: as `require_writable` found it.
        keep_old: tells at the end whether to keep the old folder as `<name>.1`, `<name>.2`, ....

    Raises:
        InputError: when the folder cannot be written, or somebody has changed the place meanwhile; the message says
            where the new folder is.
    """
    path = place.path
    with _explain_os_error(place.shown), stage(path.parent) as staging:
        partial = staging.partial / path.name
        partial.mkdir()
        yield partial
        (partial / manifest.NAME).write_bytes(manifest.listing(partial).as_bytes())
        finished = staging.finish(path.name)
        with lock_folder(path.parent):
            try:
                replaced = _put_in_place(finished, place._replace(force=place.force or keep_old()), staging)
            except (InputError, OSError) as error:
                kept = place.name_beside(set_aside(finished, path))
                raise InputError(
                    f"{place.shown}: {error} since the work began, and is left as it is; the new result is in {kept}"
                ) from None
            foreign = None if replaced is None else drop(replaced, path)
        if foreign is not None:
            raise InputError(
                f"{place.shown}: is written; what is not ours of the old one is in {place.name_beside(foreign)}"
            )


def _put_in_place(finished: Path, place: Place, staging: Stage) -> Path | None:
    """Moves a finished folder to its place; returns the new path of the folder that it replaced, or None.

    Raises:
        InputError: when the place has changed; it is left alone.
    """
    path = place.path
    if place.force and os.path.lexists(path) and not _is_empty(path):
        set_aside(path, path)
    if _move_to_free_path(finished, path):
        return None
    if not path.is_dir() or path.is_symlink():
        raise InputError("has become something else than a folder")
    with lock_folder(path):  # nobody puts pages into it
        folder_manifest = manifest.read(path)
        if others := _foreign_in_words(path, folder_manifest):
            raise InputError(f"has got files that are not ours ({others})")
        if folder_manifest is None or folder_manifest.id != place.found:
            raise InputError("has got another run")
        return staging.exchange(finished, path)


def require_no_run(folder: Path) -> None:
    """Checks that a folder is not, and is not within, the folder of a run or a campaign.

    Raises:
        InputError: when it is.
    """
    with _explain_os_error(folder):
        path = _resolve_folder(folder)
        _require_apart(folder, path)
        owned = manifest.read(path)
        if (path / _MARKER).is_file() or (owned is not None and owned.has(path / "summary.json", path)):
            raise InputError(f"{folder}: is the folder of a run or campaign; {_ELSEWHERE}")


def require_files(folder: Path, names: Iterable[str], *, force: bool = False) -> None:
    """Checks that files can be written into a folder: names are free, ours and unchanged, or force is asked.

    Args:
        folder: path of the folder; it need not be there.
        names: of the files, relative to it, with slashes.
        force: keep what is there as `<name>.1`, `<name>.2`, ....

    Raises:
        InputError: when a file of a name is there and not ours, or the folder cannot be written.
    """
    _require_writable_files(folder, names, _Rule(force))


def write_files(
    folder: Path, files: Mapping[str, Written], *, force: bool = False, manifest_id: str | None = None
) -> None:
    """Writes files into a folder, in whole or not at all, and lists them in its manifest.

    Args:
        folder: path of the folder; made where it is missing.
        files: content by name, relative to the folder, with slashes.
        force: keep what is there and not ours as `<name>.1`, `<name>.2`, ..., instead of refusing.
        manifest_id: `id` that the folder's manifest must have.

    Raises:
        InputError: when a file of a name is there and not ours, or the folder cannot be written; nothing has changed.
    """
    _write_by_rule(folder, files, _Rule(force), manifest_id)


def require_file(path: Path, kind: str, *, force: bool = False, reads: Iterable[str | Path] = ()) -> None:
    """Checks that a single file can be written: its name is free, ours and unchanged, or force is asked.

    Args:
        path: of the file, in a folder that is there.
        kind: of file; a page of ours of this kind that nobody has changed is replaced.
        force: keep what is there and not ours as `<name>.1`, `<name>.2`, ....
        reads: files and folders that the work reads.

    Raises:
        InputError: when something is there that must not be replaced, or the folder cannot be written.
    """
    _require_folder_of(path)
    _require_writable_files(path.parent, [path.name], _Rule(force, kind, tuple(map(Path, reads))))


def write_file(
    path: Path, content: Written, kind: str, *, force: bool = False, reads: Iterable[str | Path] = ()
) -> None:
    """Writes a single file, in whole or not at all.

    In a folder with a manifest it is listed there, too.

    Args:
        path, kind, force, reads: as `require_file` takes them.
        content: of the file.

    Raises:
        InputError: as `require_file`; nothing has changed.
    """
    _require_folder_of(path)
    _write_by_rule(path.parent, {path.name: content}, _Rule(force, kind, tuple(map(Path, reads))))


def write_page(
    path: Path, text: str, kind: str, *, yaml: bool = False, force: bool = False, reads: Iterable[str | Path] = ()
) -> None:
    """Writes an HTML page or a YAML file, sealed in its last line, in whole or not at all.

    Args:
        path, kind, force, reads: as `require_file` takes them.
        text: HTML, or YAML; a last line is added, by which the file is known to be ours.
        yaml: it is YAML.

    Raises:
        InputError: as `require_file`; nothing has changed.
    """
    write_file(path, manifest.seal_page(text, kind, yaml=yaml), kind, force=force, reads=reads)


def is_ours(folder: Path, name: str) -> bool:
    """Tests whether a file is in a folder, written by this package, and unchanged since."""
    return os.path.lexists(folder / name) and _Rule().may_replace(folder / name, folder, manifest.read(folder))


class _Rule(NamedTuple):
    """Rules for the files that may be replaced or renamed.

    Attributes:
        force: keep anything else under another name, where that is possible.
        kind: of the single file; None: the files are the folder's own.
        reads: files and folders that the work reads.
    """

    force: bool = False
    kind: str | None = None
    reads: tuple[Path, ...] = ()

    def may_replace(self, path: Path, folder: Path, folder_manifest: Manifest | None) -> bool:
        """Tests whether the file at a path may be overwritten: written by this package, unchanged, same kind."""
        name, sealed = path.relative_to(folder).as_posix(), manifest.sealed_kind(path)
        listed = folder_manifest is not None and folder_manifest.lists(name, path)
        if self.kind is not None:
            return sealed == self.kind or (sealed == "" and not listed)
        return sealed == "" or (listed and sealed is None) or (name == manifest.NAME and folder_manifest is not None)

    def reason_to_stay(self, path: Path, folder: Path) -> str | None:
        """Returns the reason why the file at a path must not even be renamed; None where it may."""
        real = _resolve_path(path)
        if path.is_dir():
            return "is a folder; give a file"
        if not (path.is_file() or path.is_symlink()):
            return "is no regular file; give another place"
        for source in self.reads:
            if _resolve_path(source) in (real, *real.parents, *path.parents):
                return f"belongs to what is read, {source}; give another place"
        for above in path.parents:
            owned = manifest.read(above)
            listed = owned is not None and owned.has(path, above)
            if (listed and above != folder) or (self.kind is not None and listed):
                return f"belongs to the run or campaign in {above}; give another place"
            if (above / _MARKER).is_file() and (self.kind is not None or not folder.is_relative_to(above)):
                return f"belongs to the work in {above}; give another place"
        return None

    def files_to_set_aside(self, shown_folder: Path, folder: Path, names: Iterable[str]) -> list[str]:
        """Lists names of existing files that must be renamed, not overwritten; InputError where that needs `force`.

        Raises:
            InputError: when one must not be renamed, or `force` is not set.
        """
        folder_manifest = manifest.read(folder)
        taken = [
            name
            for name in names
            if os.path.lexists(folder / name) and not self.may_replace(folder / name, folder, folder_manifest)
        ]
        stays = [(name, reason) for name in taken if (reason := self.reason_to_stay(folder / name, folder))]
        if stays:
            raise InputError(*(f"{shown_folder / name}: {reason}" for name, reason in stays))
        if taken and not self.force:
            first, *others = (f"{shown_folder / name}: is there already, and not as we wrote it" for name in taken)
            raise InputError(f"{first}; give another place, or --force to keep it as {Path(taken[0]).name}.1", *others)
        return taken


def _require_folder_of(path: Path) -> None:
    """Raises InputError where a file's path is a folder, or its parent folder does not exist."""
    with _explain_os_error(path):
        if path.is_dir() or not path.parent.is_dir():
            raise InputError(f"{path}: cannot be written; give a file in a folder that is there")


def _require_writable_files(folder: Path, names: Iterable[str], rule: _Rule) -> None:
    """Makes a folder, and requires by a rule that files with these names can be written into it."""
    with _explain_os_error(folder):
        path = _resolve_folder(folder)
        path.mkdir(parents=True, exist_ok=True)
        with stage(path):  # can be made
            pass
        rule.files_to_set_aside(folder, path, names)


def _write_by_rule(folder: Path, files: Mapping[str, Written], rule: _Rule, manifest_id: str | None = None) -> None:
    """Writes files into a folder by a rule, and lists them in its manifest."""
    with _explain_os_error(folder):
        path = _resolve_folder(folder)
        path.mkdir(parents=True, exist_ok=True)
        with stage(path) as staging:
            temporary = {name: staging.partial / str(number) for number, name in enumerate(files)}
            for name, content in files.items():
                if callable(content):
                    content(temporary[name])
                else:
                    temporary[name].write_bytes(content)
            with lock_folder(path):
                before = manifest.read(path)
                if manifest_id is not None and (before is None or before.id != manifest_id):
                    raise InputError(f"{folder}: has been replaced meanwhile; try again")
                own = [manifest.NAME] if rule.kind is None else []
                for name in rule.files_to_set_aside(folder, path, [*files, *own]):
                    set_aside(path / name, path / name)
                begun = before or (manifest.empty() if own else None)
                if begun is None:
                    _put_files(temporary, path)
                    return
                entries = {name: manifest.entry(file) for name, file in temporary.items()}
                parents = {str(parent) for name in files for parent in list(Path(name).parents)[:-1]}
                after = begun.model_copy(update={"folders": tuple(sorted({*begun.folders, *parents}))})
                _write_manifest(after.model_copy(update={"pending": entries}), staging.partial, path)
                _put_files(temporary, path)
                _write_manifest(after.model_copy(update={"files": {**after.files, **entries}}), staging.partial, path)


@contextlib.contextmanager
def resumable_folder(
    target: Path, kind: str, *, force: bool = False, reads: Iterable[str | Path] = ()
) -> Iterator[Path]:
    """Yields a folder, new or of earlier work of this kind, locked for one process at a time.

    Args:
        target: path of the folder.
        kind: of work, kept in a marker file.
        force: keep a folder of anything else as `<name>.1`, `<name>.2`, ..., but for runs and other work.
        reads: what the work reads, which is never moved.

    Raises:
        InputError: when the target is taken by anything else, cannot be written, or another process is at work in it.
    """
    with _explain_os_error(target):
        path = _resolve_folder(target)
        _require_apart(target, path)
        marker = path / _MARKER
        others = path.exists() and not marker.is_file() and not _is_empty(path)
        if others or (marker.is_file() and marker.read_text(encoding="utf-8").strip() not in ("", kind)):
            _require_replaceable(target, path, reads)
            if not force:
                raise InputError(
                    f"{target}: holds files that are not of an earlier {kind}; {_ELSEWHERE}, or {_force_hint(path)}"
                )
            _require_apart(target, path, _inner_work_folders(path), [path] if manifest.read(path) else [])
            set_aside(path, path)
        path.mkdir(parents=True, exist_ok=True)
        with marker.open("a", encoding="utf-8") as file:
            try:
                lock(file.fileno(), wait=False)
            except BlockingIOError:
                raise InputError(
                    f"{target}: another process is at work in it; wait for its end, or {_ELSEWHERE}"
                ) from None
            if not marker.stat().st_size:
                file.write(f"{kind}\n")
                file.flush()
            yield path


def _resolve_folder(target: Path) -> Path:
    """Returns a folder's path without symbolic links, once work of killed processes in it is recovered."""
    recover(target)
    try:
        path = Path(os.path.realpath(target))
    except ValueError:
        raise InputError(f"{str(target)!r}: no file can have this name; {_ELSEWHERE}") from None
    if target.is_symlink() and not target.exists():
        raise InputError(f"{target}: is a link to nowhere; remove it, or {_ELSEWHERE}")
    with contextlib.suppress(FileNotFoundError, NotADirectoryError):
        if not stat.S_ISDIR(path.stat().st_mode):
            raise InputError(f"{target}: is a file; give a folder to write to")
    return path


def _resolve_path(path: str | Path) -> Path:
    """Returns a path without symbolic links."""
    return Path(os.path.realpath(path))


def _require_replaceable(target: Path, path: Path, reads: Iterable[str | Path]) -> None:
    """Checks that a folder holds nothing of what is read, is no mount point, nor the current folder or above it."""
    for source in map(Path, reads):
        real, link = _resolve_path(source), _resolve_path(source.parent) / source.name
        if path in (real, *real.parents, *link.parents) and real.exists():
            raise InputError(f"{target}: holds what is to be read, and would be replaced; {_ELSEWHERE} with --out")
    if path in (here := Path.cwd(), *here.parents):
        raise InputError(f"{target}: is the current folder or one above it, which cannot be replaced; {_ELSEWHERE}")
    if path.is_mount():
        raise InputError(f"{target}: is a mount point, which cannot be replaced; give a folder in it")


def _require_apart(target: Path, path: Path, *inner_folders: Iterable[Path]) -> None:
    """Checks that a folder is not within a run or campaign, and that none would be moved with it.

    Args:
        target, path: as the user gave it, and without links.
        inner_folders: folders of runs and of work that would be moved with it.
    """
    for above in path.parents:
        owned = manifest.read(above)
        if (above / _MARKER).is_file() or (owned is not None and owned.holds(path.relative_to(above).as_posix())):
            raise InputError(f"{target}: is in the run or campaign in {above}; {_ELSEWHERE}")
    for inner in chain(*inner_folders):
        raise InputError(f"{target}: holds the run or campaign in {inner}, which stays where it is; {_ELSEWHERE}")


def _inner_work_folders(path: Path) -> Iterator[Path]:
    """Yields the folders of campaigns in a folder, itself included, and of runs below it."""
    for folder, below, names in os.walk(path):
        below.sort()
        here = Path(folder)
        if _MARKER in names or (here != path and manifest.NAME in names and manifest.read(here) is not None):
            yield here


@contextlib.contextmanager
def _explain_os_error(target: Path) -> Iterator[None]:
    """Turns an error of the operating system into an `InputError` that names the target."""
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        hint = "" if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG) else "; give a folder you may write to"
        raise InputError(f"{target}: cannot be written: {reason}{hint}") from None


def _require_only_ours(target: Path, path: Path, folder_manifest: Manifest | None) -> None:
    """Checks that a folder holds only files that its manifest lists, unchanged; else raises InputError."""
    others = _foreign_in_words(path, folder_manifest)
    if not others:
        return
    why = (
        ""
        if folder_manifest is not None
        else f" (it has no {manifest.NAME} of ours, which runs of 0.2 and before lack)"
    )
    raise InputError(
        f"{target}: holds files that are not of an earlier run, or changed since{why}: {others}; "
        f"{_ELSEWHERE}, or {_force_hint(path)}"
    )


def _force_hint(path: Path) -> str:
    """Returns the hint for messages that --force keeps a folder under another name."""
    return f"--force to keep what is there as {path.name}.1"


def _foreign_in_words(path: Path, folder_manifest: Manifest | None) -> str:
    """Lists in words the first three foreign files of a folder, and the number of the others; "" if none."""
    names = list(islice(manifest.foreign_entries(path, folder_manifest), _COUNTED + 1))
    more = f" and {'more than ' * (len(names) > _COUNTED)}{min(len(names), _COUNTED) - _NAMED} more"
    return ", ".join(names[:_NAMED]) + (more if len(names) > _NAMED else "")


def _move_to_free_path(finished: Path, path: Path) -> bool:
    """Moves a finished folder to a path that is free or an empty folder; False where something is there."""
    try:
        finished.rename(path)
    except OSError as error:
        if error.errno not in (errno.ENOTEMPTY, errno.EEXIST, errno.ENOTDIR):
            raise
        return False
    return True


def _is_empty(path: Path) -> bool:
    """Tests whether a path is an empty folder, and no link."""
    return path.is_dir() and not path.is_symlink() and not any(path.iterdir())


def _put_files(temporary: Mapping[str, Path], folder: Path) -> None:
    """Moves temporary files to their names in a folder, making subfolders and replacing what is there."""
    for name, file in temporary.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        file.replace(folder / name)


def _write_manifest(content: Manifest, temporary: Path, folder: Path) -> None:
    """Writes a manifest in a temporary folder, then moves it into its folder."""
    (temporary / manifest.NAME).write_bytes(content.as_bytes())
    (temporary / manifest.NAME).replace(folder / manifest.NAME)

"""Folders and files that appear whole or not at all."""

from __future__ import annotations

import stat
from pathlib import Path

import pytest

from massprop_drake import InputError
from massprop_drake.results.folder import require_writable, resumable_folder, whole_folder, write_whole

RUN = ("summary.json", "scenario.yaml")


class _BrokenError(Exception):
    """Stands for a bug while the folder is written."""


def _run(folder: Path, **more: str) -> Path:
    folder.mkdir()
    for name in RUN:
        (folder / name).write_text("earlier", encoding="utf-8")
    for name, text in more.items():
        (folder / name).write_text(text, encoding="utf-8")
    return folder


def _names(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*")}


def test_nothing_is_there_before_the_end(tmp_path: Path) -> None:
    with whole_folder(tmp_path / "run") as partial:
        (partial / "summary.json").write_text("new", encoding="utf-8")
        assert not (tmp_path / "run").exists()
    assert _names(tmp_path) == {"run", "run/summary.json"}


def test_an_error_leaves_the_earlier_folder(tmp_path: Path) -> None:
    target = _run(tmp_path / "run")

    def fail_halfway() -> None:
        with whole_folder(target) as partial:
            (partial / "summary.json").write_text("new", encoding="utf-8")
            raise _BrokenError

    with pytest.raises(_BrokenError):
        fail_halfway()
    assert (target / "summary.json").read_text(encoding="utf-8") == "earlier"
    assert _names(tmp_path) == {"run", *(f"run/{name}" for name in RUN)}


def test_an_earlier_run_is_replaced_as_a_whole(tmp_path: Path) -> None:
    target = _run(tmp_path / "run", stale="old")
    with whole_folder(target) as partial:
        (partial / "summary.json").write_text("new", encoding="utf-8")
    assert _names(tmp_path) == {"run", "run/summary.json"}


def test_with_force_other_files_stay(tmp_path: Path) -> None:
    target = tmp_path / "mine"
    target.mkdir()
    (target / "notes.txt").write_text("keep", encoding="utf-8")
    with pytest.raises(InputError, match="mine: holds files that are not of an earlier run"), whole_folder(target):
        pass
    with whole_folder(target, force=True) as partial:
        (partial / "figures").mkdir()
        (partial / "figures" / "rates.png").write_text("new", encoding="utf-8")
    assert _names(tmp_path) == {"mine", "mine/notes.txt", "mine/figures", "mine/figures/rates.png"}


def test_a_full_disk_is_told(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="run: cannot be written: No space left"), whole_folder(tmp_path / "run"):
        raise OSError(28, "No space left on device")
    assert _names(tmp_path) == set()


def test_a_place_is_checked_without_leaving_anything(tmp_path: Path) -> None:
    require_writable(tmp_path / "a" / "run")
    assert _names(tmp_path) == {"a"}
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="file: is a file; give a folder to write to"):
        require_writable(tmp_path / "file", force=True)
    with pytest.raises(InputError, match=r"run: cannot be written: .*; give a folder you may write to"):
        require_writable(tmp_path / "file" / "run")


def test_work_is_taken_up_where_it_was_left(tmp_path: Path) -> None:
    target = tmp_path / "deep" / "work"
    resumable_folder(target, "reproduction")
    (target / "half.npz").touch()
    resumable_folder(target, "reproduction")
    assert _names(target) == {".massprop", "half.npz"}
    with pytest.raises(InputError, match="work: holds files that are not of an earlier campaign"):
        resumable_folder(target, "campaign")


def test_work_does_not_begin_among_files_of_others(tmp_path: Path) -> None:
    (tmp_path / "letter.txt").touch()
    with pytest.raises(InputError, match="holds files that are not of an earlier reproduction"):
        resumable_folder(tmp_path, "reproduction")
    with pytest.raises(InputError, match=r"letter.txt: is a file"):
        resumable_folder(tmp_path / "letter.txt", "reproduction")
    assert _names(tmp_path) == {"letter.txt"}


def test_a_text_is_written_as_it_is_with_the_permissions_of_other_files(tmp_path: Path) -> None:
    (tmp_path / "plain").touch()
    write_whole(tmp_path / "page.html", "first")
    write_whole(tmp_path / "page.html", "one\ntwo ±\n")
    assert (tmp_path / "page.html").read_bytes() == "one\ntwo ±\n".encode()
    modes = {stat.S_IMODE(path.stat().st_mode) for path in tmp_path.iterdir()}
    assert len(modes) == 1
    assert _names(tmp_path) == {"plain", "page.html"}

"""Folders and files that appear whole or not at all, and replace nothing that is not ours."""

from __future__ import annotations

import json
import os
import stat
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from massprop_drake import InputError, Run
from massprop_drake.results import exchange, manifest
from massprop_drake.results.exchange import recover
from massprop_drake.results.folder import (
    Place,
    is_ours,
    require_files,
    require_writable,
    reserve_place,
    resumable_folder,
    whole_folder,
    write_files,
    write_page,
)

WHOLE = {"run", "run/summary", "run/manifest.json"}


def _write(target: Path | Place, *, force: bool = False, **files: str) -> None:
    place = target if isinstance(target, Place) else require_writable(target, force=force)
    with whole_folder(place) as partial:
        for name, text in files.items():
            path = partial / name.replace("__", "/")
            path.parent.mkdir(exist_ok=True)
            path.write_text(text, encoding="utf-8")


def _names(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*")}


def _text(path: Path) -> str:
    return path.read_text(encoding="utf-8")


def _contents(folder: Path) -> dict[str, str | bytes]:
    """Every entry of a folder: contents of files, where links lead, kinds of the rest."""
    return {
        str(path.relative_to(folder)): os.readlink(path)
        if path.is_symlink()
        else path.read_bytes()
        if path.is_file()
        else str(stat.S_IFMT(path.stat().st_mode))
        for path in folder.rglob("*")
    }


def test_a_folder_appears_whole_or_not_at_all(tmp_path: Path) -> None:
    run = tmp_path / "run"
    with whole_folder(require_writable(run)) as partial:
        (partial / "summary").write_text("earlier", encoding="utf-8")
        (partial / "stale").touch()
        assert not run.exists()

    def fail(error: Exception) -> None:
        with whole_folder(require_writable(run)) as partial:
            (partial / "summary").write_text("new", encoding="utf-8")
            raise error

    for error, raised in ((KeyError("a bug"), KeyError), (OSError(28, "No space left on device"), InputError)):
        with pytest.raises(raised):
            fail(error)
        assert _text(run / "summary") == "earlier"
    assert _names(tmp_path) == WHOLE | {"run/stale"}
    (run / "stale").unlink()  # a file that has gone is no obstacle
    _write(run, summary="new")
    assert (_names(tmp_path), _text(run / "summary")) == (WHOLE, "new")
    _write(run, force=True, summary="newest")
    assert (_text(tmp_path / "run.1" / "summary"), _text(run / "summary")) == ("new", "newest")


def test_the_manifest_lists_every_other_file(tmp_path: Path) -> None:
    _write(tmp_path / "run", summary="abc", figures__rates="")
    content = json.loads(_text(tmp_path / "run" / "manifest.json"))
    assert content["folders"] == ["figures"]
    assert content["files"] == {
        "summary": {"sha256": "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad", "bytes": 3},
        "figures/rates": {"sha256": "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855", "bytes": 0},
    }
    assert set(content) == {"format", "id", "folders", "files", "pending"}


def test_a_folder_that_was_made_stays_where_somebody_else_is_about_to_write(tmp_path: Path) -> None:
    with reserve_place(tmp_path / "new" / "runs" / "a"):
        pass
    assert _names(tmp_path) == set()
    with reserve_place(tmp_path / "runs" / "a"):
        other = require_writable(tmp_path / "runs" / "b")
    _write(other, there="")
    assert (tmp_path / "runs" / "b" / "there").exists()


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("file", "file: is a file; give a folder to write to"),
        ("file/run", r"run: cannot be written: .*; give a folder you may write to"),
        ("/proc", "is a mount point"),
        ("a\0b", "no file can have this name"),
        ("\ud800", "no file can have this name"),
        ("x" * 300, "cannot be written: File name too long"),
    ],
)
def test_a_place_that_cannot_be_written_is_told(tmp_path: Path, name: str, words: str) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match=words):
        require_writable(tmp_path / name, force=True)
    with pytest.raises(InputError, match=words), reserve_place(tmp_path / name):
        pass
    if "no file" in words:
        with pytest.raises(InputError, match="there is no such run"):
            Run.load(tmp_path / name)
    assert _names(tmp_path) == {"file"}


STRANGE: dict[str, tuple[Callable[[Path], object], str]] = {
    "a file below": (lambda run: (run / "figures" / "mine.png").touch(), "figures/mine.png"),
    "folders": (lambda run: [(run / str(number)).mkdir() for number in range(7)], r"0/, 1/, 2/ and 4 more"),
    "a link to a folder": (lambda run: (run / "link").symlink_to("figures"), "link"),
    "a link in place of a file": (
        lambda run: [(run / "summary").rename(run.parent / "s"), (run / "summary").symlink_to("../s")],
        r"summary \(changed\)",
    ),
    "a changed file": (lambda run: (run / "summary").write_text("EARLIER"), r"summary \(changed\)"),
    "a folder in place of a file": (lambda run: [(run / "summary").unlink(), (run / "summary").mkdir()], "summary/"),
    "no manifest": (lambda run: (run / "manifest.json").unlink(), "no manifest.json of ours.*: summary, figures/rates"),
    "a later manifest": (
        lambda run: (run / "manifest.json").write_text(_text(run / "manifest.json").replace(": 1,", ": 2,", 1)),
        "it has no manifest.json of ours",
    ),
    "a manifest by a link": (
        lambda run: [(run / "manifest.json").rename(run / "m"), (run / "manifest.json").symlink_to("m")],
        "it has no manifest.json of ours",
    ),
}


@pytest.mark.parametrize(("put", "named"), STRANGE.values(), ids=STRANGE)
def test_a_folder_with_anything_else_is_refused_and_kept_with_force(
    tmp_path: Path, put: Callable[[Path], object], named: str
) -> None:
    run = tmp_path / "run"
    _write(run, summary="earlier", figures__rates="picture")
    put(run)
    before, inside = _contents(tmp_path), _contents(run)
    with pytest.raises(InputError, match=rf"run: holds files .*{named}.*; give another folder, or --force .* run\.1"):
        require_writable(run)
    assert _contents(tmp_path) == before
    (tmp_path / "run.1").mkdir()  # taken
    _write(run, force=True, summary="new")
    assert _text(run / "summary") == "new"
    assert _contents(tmp_path / "run.2") == inside
    _write(run, summary="newer")  # is ours again


def test_what_is_to_be_read_is_not_replaced(tmp_path: Path) -> None:
    run = tmp_path / "run"
    _write(run, summary="earlier", figures__rates="picture")
    (tmp_path / "link").symlink_to("run/figures")
    link = tmp_path / "link"
    for target, source in ((run, run), (run, link / "rates"), (run / "figures", link), (tmp_path, run)):
        with pytest.raises(InputError, match="holds what is to be read, and would be replaced"):
            require_writable(target, reads=[source])
    require_writable(run, reads=[tmp_path / "other", tmp_path / "runs"])
    require_writable(run, reads=[run], force=True)
    with pytest.raises(InputError, match="holds what is to be read"):
        require_writable(run, reads=[run, run / "summary"], force=True)
    require_writable(run / "below", reads=[run])


MEANWHILE: dict[str, tuple[Callable[[Path], object], str]] = {
    "a file": (lambda run: (run / "notes.txt").write_text("mine"), "has got files .*notes.txt"),
    "another run": (lambda run: _write(run, summary="other"), "has got another run since"),
    "a link": (
        lambda run: [run.rename(run.parent / "run.0"), run.symlink_to("run.0")],
        "has become something else than a folder",
    ),
    "a file instead": (
        lambda run: [run.rename(run.parent / "run.0"), run.write_text("mine")],
        "has become something else than a folder",
    ),
}


@pytest.mark.parametrize(("put", "words"), MEANWHILE.values(), ids=MEANWHILE)
def test_what_others_do_meanwhile_is_kept_and_so_is_the_result(
    tmp_path: Path, put: Callable[[Path], object], words: str
) -> None:
    run = tmp_path / "run"
    _write(run, summary="earlier")
    place = require_writable(run)
    put(run)
    before = _contents(tmp_path)
    with pytest.raises(InputError, match=rf"run: {words}.*; the new result is in .*run\.1"):
        _write(place, summary="new")
    assert _text(tmp_path / "run.1" / "summary") == "new"
    assert before.items() <= _contents(tmp_path).items()
    assert set(os.listdir(tmp_path)) <= {"run", "run.0", "run.1"}


def test_what_arrives_in_the_very_moment_of_the_exchange_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = tmp_path / "run"
    _write(run, summary="earlier")
    swapped = exchange.swap_folders

    def late(one: Path, other: Path) -> bool:
        (other / "notes.txt").write_text("mine", encoding="utf-8")
        return swapped(one, other)

    monkeypatch.setattr(exchange, "swap_folders", late)
    with pytest.raises(InputError, match=r"run: is written; what is not ours of the old one is in .*run\.1"):
        _write(run, summary="new")
    assert (_text(run / "summary"), _names(tmp_path / "run.1")) == ("new", {"notes.txt"})


def test_writers_wait_for_each_other(tmp_path: Path) -> None:
    threads = [
        threading.Thread(target=_write, args=(tmp_path / "run",), kwargs={"force": True, "summary": str(number)})
        for number in range(8)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(_text(path / "summary") for path in tmp_path.iterdir()) == [str(number) for number in range(8)]


KILLED = """
import os, signal, sys
from pathlib import Path
from massprop_drake.results import exchange, folder

moment = sys.argv[2]
def die(*_):
    os.kill(os.getpid(), signal.SIGKILL)
if moment == "renames":  # a system that cannot exchange, and a kill between its two renames
    exchange.swap_folders = lambda *_: False
    real = Path.rename
    Path.rename = lambda self, target: (real(self, target), Path(target).parent.name == "old" and die())[0]
elif moment == "removal":
    exchange.drop = folder.drop = die
elif moment == "finished":
    finish = exchange.Stage.finish
    exchange.Stage.finish = lambda *given: (finish(*given), die())
with folder.whole_folder(folder.require_writable(Path(sys.argv[1]))) as partial:
    (partial / "summary").write_text("new")
    if moment == "writing":
        die()
"""


def _killed(run: Path, moment: str) -> None:
    assert subprocess.run([sys.executable, "-c", KILLED, str(run), moment], check=False).returncode == -9


@pytest.mark.parametrize(
    ("moment", "there", "then"),
    [
        ("writing", True, "earlier"),
        ("finished", True, "earlier"),
        ("finished", False, "new"),
        ("renames", True, "new"),
        ("removal", True, "new"),
    ],
)
def test_what_a_kill_leaves_is_brought_back_or_removed(tmp_path: Path, moment: str, there: bool, then: str) -> None:
    run = tmp_path / "run"
    if there:
        _write(run, summary="earlier")
    _killed(run, moment)
    assert any(name.startswith(".massprop-") for name in os.listdir(tmp_path))
    if moment != "renames" and there:  # whole at once, without help
        assert _text(run / "summary") == then
    recover(run / "summary")
    assert (os.listdir(tmp_path), _text(run / "summary")) == (["run"], then)
    _write(run, summary="newer")
    assert os.listdir(tmp_path) == ["run"]


def test_the_work_of_the_living_and_hidden_folders_of_others_are_left_alone(tmp_path: Path) -> None:
    kept = {".massprop-abcdefgh/mine", ".massprop-notes/partial", ".massprop/partial"}
    for name in kept:
        (tmp_path / name).mkdir(parents=True)
    (tmp_path / ".massprop-12345678").symlink_to(".massprop")
    with whole_folder(require_writable(tmp_path / "one")) as partial:
        (partial / "summary").touch()
        _write(tmp_path / "other", summary="new")
        recover(tmp_path / "one")
        assert (partial / "summary").exists()
    assert kept < _names(tmp_path)
    assert (tmp_path / ".massprop-12345678").is_symlink()


def test_without_locks_and_exchange_work_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As on some network file systems."""

    def fail(*_: object) -> None:
        raise OSError(37, "No locks available")

    monkeypatch.setattr("fcntl.flock", fail)
    monkeypatch.setattr(exchange, "swap_folders", lambda *_: False)
    (tmp_path / ".massprop-abcdefgh" / "partial").mkdir(parents=True)  # whose, nobody can tell
    for text in ("one", "two"):
        _write(tmp_path / "run", summary=text)
    assert _text(tmp_path / "run" / "summary") == "two"
    assert set(os.listdir(tmp_path)) == {"run", ".massprop-abcdefgh"}


def test_files_are_written_into_a_folder_and_listed(tmp_path: Path) -> None:
    run = tmp_path / "run"
    _write(run, summary="earlier")
    first = manifest.read(run)
    write_files(run, {"page.html": b"one", "figures/rates": b"picture"})
    write_files(run, {"page.html": b"two"})
    assert _names(run) == {"summary", "page.html", "figures", "figures/rates", "manifest.json"}
    now = manifest.read(run)
    assert first is not None
    assert now is not None
    assert (now.id, now.pending) == (first.id, {})
    assert is_ours(run, "page.html")
    _write(run, summary="new")
    assert _names(run) == {"summary", "manifest.json"}
    with pytest.raises(InputError, match="run: has been replaced meanwhile"):
        write_files(run, {"page": b"of the earlier"}, manifest_id=first.id)


def test_files_of_others_are_not_replaced(tmp_path: Path) -> None:
    write_files(tmp_path, {"a": b"ours", "b": b"ours"})
    (tmp_path / "b").write_text("mine", encoding="utf-8")
    (tmp_path / "c").symlink_to("nowhere")
    before = _contents(tmp_path)
    for check in (require_files, lambda folder, names: write_files(folder, dict.fromkeys(names, b"new"))):
        with pytest.raises(InputError, match=r"b: is there already.*as b\.1 \(and 1 more problem\)"):
            check(tmp_path, ["a", "b", "c"])
    assert _contents(tmp_path) == before
    write_files(tmp_path, dict.fromkeys("abc", b"new"), force=True)
    assert (_text(tmp_path / "b.1"), os.readlink(tmp_path / "c.1")) == ("mine", "nowhere")
    assert {_text(tmp_path / name) for name in "abc"} == {"new"}
    (tmp_path / "manifest.json").write_text('{"name": "my app"}', encoding="utf-8")
    with pytest.raises(InputError, match=r"manifest\.json: is there already"):
        write_files(tmp_path, {"d": b""})


@pytest.mark.parametrize("count", range(3))
def test_a_folder_is_ours_however_far_its_pages_were_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, count: int
) -> None:
    run, real, left = tmp_path / "run", Path.replace, [count]

    def replace(self: Path, target: Path) -> Path:
        if not left[0]:
            raise OSError(28, "No space left on device")
        left[0] -= 1
        return real(self, target)

    _write(run, summary="earlier", page="one")
    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", replace)
        with pytest.raises(InputError, match="No space left"):
            write_files(run, {"page": b"two", "other": b"two"})
    assert _names(run) <= {"summary", "page", "other", "manifest.json"}
    _write(run, summary="new")
    assert _names(tmp_path) == WHOLE


def test_a_page_is_replaced_as_long_as_it_is_ours(tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    (tmp_path / "plain").touch()
    write_page(page, "first", "report")
    write_page(page, "one\ntwo ±\n", "report")
    assert page.read_bytes().startswith("one\ntwo ±\n".encode())
    assert page.read_bytes().count(b"\n") == 3
    assert len({stat.S_IMODE(path.stat().st_mode) for path in tmp_path.iterdir()}) == 1
    for number, text in enumerate(("", _text(page).replace("o", "0", 1), _text(page) + "\n"), 1):
        page.write_text(text, encoding="utf-8")
        with pytest.raises(InputError, match=r"page\.html: is there already"):
            write_page(page, "two\n", "report")
        write_page(page, "two\n", "report", force=True)
        assert _text(tmp_path / f"page.html.{number}") == text
        assert _text(page).startswith("two\n")


def test_work_is_taken_up_where_it_was_left_by_one_process_at_a_time(tmp_path: Path) -> None:
    target = tmp_path / "deep" / "work"
    with resumable_folder(target, "reproduction"):
        (target / "half.npz").touch()
        with (
            pytest.raises(InputError, match="work: another process is at work in it"),
            resumable_folder(target, "reproduction"),
        ):
            pass
    with resumable_folder(target, "reproduction"):
        assert _names(target) == {".massprop", "half.npz"}
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "letter").touch()
    for place, words in ((tmp_path / "mine", "holds files that are not"), (tmp_path / "mine" / "letter", "is a file")):
        with pytest.raises(InputError, match=words), resumable_folder(place, "reproduction"):
            pass
    with resumable_folder(tmp_path / "mine", "reproduction", force=True) as path:
        assert _names(path) == {".massprop"}
    assert _names(tmp_path / "mine.1") == {"letter"}


def test_work_never_takes_the_place_of_other_work_of_a_run_or_of_what_it_reads(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with resumable_folder(tmp_path / "work", "reproduction"):
        (tmp_path / "work" / "cases").mkdir()
    _write(tmp_path / "run", figures__rates="picture")
    _write(tmp_path / "runs" / "a", summary="earlier")
    for name in ("here/mine", "data/mine"):
        (tmp_path / name).parent.mkdir()
        (tmp_path / name).touch()
    monkeypatch.chdir(tmp_path / "here")
    before = _names(tmp_path)
    names = ("work", "work/cases", "work/new", "run", "run/figures", "runs", "here/..", "here", "data")
    for name in names:
        for force in (False, True):
            target = Path(os.path.relpath(tmp_path / name)) if name in ("here", "data") else tmp_path / name
            with (
                pytest.raises(InputError, match="give another folder"),
                resumable_folder(target, "campaign", force=force, reads=["../data/mine"]),
            ):
                pass
            if name != "run":  # which another run may take the place of
                with (
                    pytest.raises(InputError, match="give another folder"),
                    reserve_place(target, force=force, reads=["../data/mine"]),
                ):
                    pass
    assert _names(tmp_path) == before

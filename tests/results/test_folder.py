"""Folders and files that appear whole or not at all, and replace nothing that is not ours."""

from __future__ import annotations

import json
import os
import stat
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from massprop_drake import InputError, Run
from massprop_drake.results import exchange, manifest
from massprop_drake.results.exchange import recover, stage
from massprop_drake.results.folder import (
    Place,
    is_ours,
    require_files,
    require_writable,
    reserved,
    resumable_folder,
    whole_folder,
    write_files,
    write_page,
)


class _BrokenError(Exception):
    """Stands for a bug while the folder is written."""


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


# ------------------------------------------------------------------------------------ whole or not


def test_nothing_is_there_before_the_end(tmp_path: Path) -> None:
    with whole_folder(require_writable(tmp_path / "run")) as partial:
        (partial / "summary").write_text("new", encoding="utf-8")
        assert not (tmp_path / "run").exists()
    assert _names(tmp_path) == {"run", "run/summary", "run/manifest.json"}


def test_an_error_leaves_the_earlier_folder(tmp_path: Path) -> None:
    _write(tmp_path / "run", summary="earlier")

    def fail_halfway() -> None:
        with whole_folder(require_writable(tmp_path / "run")) as partial:
            (partial / "summary").write_text("new", encoding="utf-8")
            raise _BrokenError

    with pytest.raises(_BrokenError):
        fail_halfway()
    assert _text(tmp_path / "run" / "summary") == "earlier"
    assert _names(tmp_path) == {"run", "run/summary", "run/manifest.json"}


def test_an_earlier_run_is_replaced_as_a_whole(tmp_path: Path) -> None:
    _write(tmp_path / "run", summary="earlier", stale="old", figures__rates="picture")
    _write(tmp_path / "run", summary="new")
    assert _names(tmp_path) == {"run", "run/summary", "run/manifest.json"}
    assert _text(tmp_path / "run" / "summary") == "new"


def test_the_manifest_lists_every_other_file(tmp_path: Path) -> None:
    _write(tmp_path / "run", summary="abc", figures__rates="")
    content = json.loads(_text(tmp_path / "run" / "manifest.json"))
    assert content["folders"] == ["figures"]
    assert content["files"] == {
        "summary": {"sha256": "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad", "bytes": 3},
        "figures/rates": {"sha256": "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855", "bytes": 0},
    }
    assert set(content) == {"format", "id", "folders", "files", "pending"}


def test_a_full_disk_is_told(tmp_path: Path) -> None:
    with (
        pytest.raises(InputError, match=r"run: cannot be written: No space left on device$"),
        whole_folder(require_writable(tmp_path / "run")),
    ):
        raise OSError(28, "No space left on device")
    assert _names(tmp_path) == set()


def test_a_folder_that_was_made_stays_where_somebody_else_is_about_to_write(tmp_path: Path) -> None:
    with reserved(tmp_path / "new" / "runs" / "a"):
        pass
    assert _names(tmp_path) == set()
    with reserved(tmp_path / "runs" / "a"):
        other = require_writable(tmp_path / "runs" / "b")
    with whole_folder(other) as partial:
        (partial / "there").touch()
    assert (tmp_path / "runs" / "b" / "there").exists()


def test_a_place_that_cannot_be_looked_at_is_told(tmp_path: Path) -> None:
    for name, words in (("x" * 300, "cannot be written: File name too long"), ("a\0b", "no file can have this name")):
        with pytest.raises(InputError, match=words), reserved(tmp_path / name / "b"):
            pass


def test_a_place_is_checked_without_leaving_anything(tmp_path: Path) -> None:
    require_writable(tmp_path / "a" / "run")
    assert _names(tmp_path) == {"a"}
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="file: is a file; give a folder to write to"):
        require_writable(tmp_path / "file", force=True)
    with pytest.raises(InputError, match=r"run: cannot be written: .*; give a folder you may write to"):
        require_writable(tmp_path / "file" / "run")
    for name in ("a\0b", "\ud800"):
        with pytest.raises(InputError, match="no file can have this name"):
            require_writable(tmp_path / name)
        with pytest.raises(InputError, match="there is no such run"):
            Run.load(tmp_path / name)
    with pytest.raises(InputError, match="is a mount point"):
        require_writable(Path("/proc"), force=True)


# ---------------------------------------------------------------------------------- what is not ours

STRANGE: dict[str, tuple[Callable[[Path], object], str]] = {
    "a file": (lambda run: (run / "notes.txt").touch(), "notes.txt"),
    "a hidden file": (lambda run: (run / ".notes").touch(), ".notes"),
    "a file below": (lambda run: (run / "figures" / "mine.png").touch(), "figures/mine.png"),
    "a folder": (lambda run: (run / "logs").mkdir(), "logs/"),
    "a file in a folder": (lambda run: [(run / "logs").mkdir(), (run / "logs" / "a").touch()], "logs/a"),
    "a link": (lambda run: (run / "link").symlink_to("summary"), "link"),
    "a link to nowhere": (lambda run: (run / "link").symlink_to("nowhere"), "link"),
    "a link to a folder": (lambda run: (run / "link").symlink_to("figures"), "link"),
    "a link in place of a file": (
        lambda run: [(run / "summary").rename(run.parent / "s"), (run / "summary").symlink_to("../s")],
        r"summary \(changed\)",
    ),
    "a link in place of a folder": (
        lambda run: [(run / "figures").rename(run.parent / "f"), (run / "figures").symlink_to("../f")],
        "figures",
    ),
    "a pipe": (lambda run: os.mkfifo(run / "pipe"), "pipe"),
    "a changed file": (lambda run: (run / "summary").write_text("EARLIER"), r"summary \(changed\)"),
    "a folder in place of a file": (lambda run: [(run / "summary").unlink(), (run / "summary").mkdir()], "summary/"),
    "no manifest": (
        lambda run: (run / "manifest.json").unlink(),
        "it has no manifest.json of ours.*: summary, figures/rates",
    ),
    "an empty manifest": (lambda run: (run / "manifest.json").write_text(""), "it has no manifest.json of ours"),
    "another manifest": (lambda run: (run / "manifest.json").write_text("[]"), "it has no manifest.json of ours"),
    "a later manifest": (
        lambda run: (run / "manifest.json").write_text(_text(run / "manifest.json").replace(": 1,", ": 2,", 1)),
        "it has no manifest.json of ours",
    ),
    "a manifest by a link": (
        lambda run: [(run / "manifest.json").rename(run / "m"), (run / "manifest.json").symlink_to("m")],
        "it has no manifest.json of ours",
    ),
}


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


def test_a_message_names_a_few_files_and_counts_the_others(tmp_path: Path) -> None:
    for number in range(7):
        (tmp_path / "mine" / str(number)).mkdir(parents=True)
    with pytest.raises(InputError, match=r"0/, 1/, 2/ and 4 more;"):
        require_writable(tmp_path / "mine")


def test_files_that_have_gone_are_no_obstacle(tmp_path: Path) -> None:
    _write(tmp_path / "run", summary="earlier", figures__rates="picture")
    (tmp_path / "run" / "figures" / "rates").unlink()
    _write(tmp_path / "run", summary="new")
    assert _names(tmp_path) == {"run", "run/summary", "run/manifest.json"}


def test_force_keeps_an_earlier_run_too(tmp_path: Path) -> None:
    _write(tmp_path / "run", summary="earlier")
    _write(tmp_path / "run", force=True, summary="new")
    assert _text(tmp_path / "run.1" / "summary") == "earlier"
    assert _text(tmp_path / "run" / "summary") == "new"


def test_what_is_to_be_read_is_not_replaced(tmp_path: Path) -> None:
    run = tmp_path / "run"
    _write(run, summary="earlier", figures__rates="picture")
    (tmp_path / "link").symlink_to("run/figures")
    for target, source in (
        (run, run),
        (run, run / "summary"),
        (run, tmp_path / "link" / "rates"),
        (run / "figures", tmp_path / "link"),
        (tmp_path, run),
    ):
        with pytest.raises(InputError, match="holds what is to be read, and would be replaced"):
            require_writable(target, reads=[source])
    require_writable(run, reads=[tmp_path / "other", tmp_path / "runs"])
    require_writable(run, reads=[run], force=True)
    with pytest.raises(InputError, match="holds what is to be read"):
        require_writable(run, reads=[run, run / "summary"], force=True)
    require_writable(run / "below", reads=[run])


# -------------------------------------------------------------------------- what happens meanwhile


def test_what_others_put_into_a_folder_meanwhile_is_kept_and_so_is_the_result(tmp_path: Path) -> None:
    run = tmp_path / "run"
    _write(run, summary="earlier")
    place = require_writable(run)
    (run / "notes.txt").write_text("mine", encoding="utf-8")
    with pytest.raises(InputError, match=r"run: has got files .*notes.txt.*; the new result is in .*run\.1"):
        _write(place, summary="new")
    assert _text(run / "notes.txt") == "mine"
    assert _text(run / "summary") == "earlier"
    assert _text(tmp_path / "run.1" / "summary") == "new"
    assert set(os.listdir(tmp_path)) == {"run", "run.1"}


@pytest.mark.parametrize("there", [True, False])
def test_two_writers_of_one_folder_lose_nothing(tmp_path: Path, there: bool) -> None:
    run = tmp_path / "run"
    if there:
        _write(run, summary="earlier")
    one, other = require_writable(run), require_writable(run)
    _write(one, summary="one")
    with pytest.raises(InputError, match=r"run: has got another run since .*; the new result is in .*run\.1"):
        _write(other, summary="other")
    assert _text(run / "summary") == "one"
    assert _text(tmp_path / "run.1" / "summary") == "other"
    assert set(os.listdir(tmp_path)) == {"run", "run.1"}


@pytest.mark.parametrize("what", ["file", "link", "gone"])
def test_a_folder_may_become_something_else(tmp_path: Path, what: str) -> None:
    run = tmp_path / "run"
    _write(run, summary="earlier")
    place = require_writable(run)
    run.rename(tmp_path / "elsewhere")
    if what == "gone":
        _write(place, summary="new")
        assert _text(run / "summary") == "new"
        return
    run.symlink_to("elsewhere") if what == "link" else run.write_text("mine", encoding="utf-8")
    with pytest.raises(InputError, match=r"else than a folder .*; the new result is in .*run\.1"):
        _write(place, summary="new")
    assert _text(tmp_path / "run.1" / "summary") == "new"
    assert _text(tmp_path / "elsewhere" / "summary") == "earlier"


def test_what_arrives_in_the_very_moment_of_the_exchange_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = tmp_path / "run"
    _write(run, summary="earlier")
    swapped = exchange._swapped

    def late(one: Path, other: Path) -> bool:
        (other / "notes.txt").write_text("mine", encoding="utf-8")
        return swapped(one, other)

    monkeypatch.setattr(exchange, "_swapped", late)
    with pytest.raises(InputError, match=r"run: is written; what is not ours of the old one is in .*run\.1"):
        _write(run, summary="new")
    assert _text(run / "summary") == "new"
    assert _names(tmp_path / "run.1") == {"notes.txt"}
    assert set(os.listdir(tmp_path)) == {"run", "run.1"}


@pytest.fixture
def impatient_threads() -> Iterator[None]:
    """Threads take turns so often that whatever can come between two steps of another does."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-5)
    yield
    sys.setswitchinterval(before)


@pytest.mark.usefixtures("impatient_threads")
def test_writers_wait_for_each_other(tmp_path: Path) -> None:
    done: list[int] = []

    def write(number: int) -> None:
        _write(tmp_path / "run", force=True, summary=str(number))
        done.append(number)

    threads = [threading.Thread(target=write, args=(number,)) for number in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(done) == list(range(8))
    assert {_text(path / "summary") for path in tmp_path.iterdir()} == {str(number) for number in range(8)}


# -------------------------------------------------------------------------------------------- kills

KILLED = """
import os, signal, sys
from pathlib import Path
from massprop_drake.results import exchange
from massprop_drake.results.folder import require_writable, whole_folder

moment = sys.argv[2]
def die(*_):
    os.kill(os.getpid(), signal.SIGKILL)
if moment == "renames":  # a system that cannot exchange, and a kill between its two renames
    exchange._swapped = lambda *_: False
    real, seen = Path.rename, []
    def rename(self, target):
        result = real(self, target)
        if Path(target).parent.name == "old":
            die()
        return result
    Path.rename = rename
elif moment == "removal":
    exchange.drop = die
    import massprop_drake.results.folder as folder
    folder.drop = die
elif moment == "finished":
    import massprop_drake.results.folder as folder
    folder._placed = die
with whole_folder(require_writable(Path(sys.argv[1]))) as partial:
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
        ("writing", False, None),
        ("finished", True, "earlier"),
        ("finished", False, "new"),
        ("renames", True, "new"),
        ("removal", True, "new"),
    ],
)
def test_what_a_kill_leaves_is_brought_back_or_removed(
    tmp_path: Path, moment: str, there: bool, then: str | None
) -> None:
    run = tmp_path / "run"
    if there:
        _write(run, summary="earlier")
    _killed(run, moment)
    assert any(name.startswith(".massprop-") for name in os.listdir(tmp_path))
    if moment != "renames" and there:  # whole at once, without help
        assert _text(run / "summary") == then
    recover(run / "summary")
    assert os.listdir(tmp_path) == ([] if then is None else ["run"])
    if then is not None:
        assert _text(run / "summary") == then
    _write(run, summary="newer")
    assert os.listdir(tmp_path) == ["run"]


def test_what_others_put_into_a_replaced_folder_survives_a_kill(tmp_path: Path) -> None:
    run = tmp_path / "run"
    _write(run, summary="earlier")
    _killed(run, "removal")
    (left,) = tmp_path.glob(".massprop-*/whole/run")
    (left / "notes.txt").write_text("mine", encoding="utf-8")
    (left / "summary").write_text("changed", encoding="utf-8")
    require_writable(run)
    assert set(os.listdir(tmp_path)) == {"run", "run.1"}
    assert _names(tmp_path / "run.1") == {"notes.txt", "summary"}


def test_the_work_of_the_living_is_left_alone(tmp_path: Path) -> None:
    with whole_folder(require_writable(tmp_path / "one")) as partial:
        (partial / "summary").touch()
        _write(tmp_path / "other", summary="new")
        recover(tmp_path / "one")
        assert (partial / "summary").exists()
    assert set(os.listdir(tmp_path)) == {"one", "other"}


def test_hidden_folders_of_others_are_left_alone(tmp_path: Path) -> None:
    kept = {".massprop-abcdefgh/mine", ".massprop-notes/partial", ".massprop/partial"}
    for name in kept:
        (tmp_path / name).mkdir(parents=True)
    (tmp_path / ".massprop-12345678").symlink_to(".massprop")
    _write(tmp_path / "run", summary="new")
    assert kept < _names(tmp_path)
    assert (tmp_path / ".massprop-12345678").is_symlink()


def test_without_locks_and_exchange_work_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As on some network file systems."""

    def fail(*_: object) -> None:
        raise OSError(37, "No locks available")

    monkeypatch.setattr("fcntl.flock", fail)
    monkeypatch.setattr(exchange, "_swapped", lambda *_: False)
    (tmp_path / ".massprop-abcdefgh" / "partial").mkdir(parents=True)  # whose, nobody can tell
    for text in ("one", "two"):
        _write(tmp_path / "run", summary=text)
    assert _text(tmp_path / "run" / "summary") == "two"
    assert set(os.listdir(tmp_path)) == {"run", ".massprop-abcdefgh"}


# --------------------------------------------------------------------------------- files in a folder


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
    assert now.id == first.id
    assert not now.pending
    assert is_ours(run, "page.html")
    _write(run, summary="new")
    assert _names(run) == {"summary", "manifest.json"}


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
    assert _text(tmp_path / "b.1") == "mine"
    assert os.readlink(tmp_path / "c.1") == "nowhere"
    assert {_text(tmp_path / name) for name in "abc"} == {"new"}
    assert _names(tmp_path) == {"a", "b", "c", "b.1", "c.1", "manifest.json"}


def test_a_manifest_of_others_is_not_replaced(tmp_path: Path) -> None:
    (tmp_path / "manifest.json").write_text('{"name": "my app"}', encoding="utf-8")
    with pytest.raises(InputError, match=r"manifest\.json: is there already"):
        write_files(tmp_path, {"a": b""})
    assert _names(tmp_path) == {"manifest.json"}


@contextmanager
def _no_room_after(count: int, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    real, left = Path.replace, [count]

    def replace(self: Path, target: Path) -> Path:
        if not left[0]:
            raise OSError(28, "No space left on device")
        left[0] -= 1
        return real(self, target)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", replace)
        yield


@pytest.mark.parametrize("count", range(4))
def test_a_folder_is_ours_however_far_its_pages_were_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, count: int
) -> None:
    run = tmp_path / "run"
    _write(run, summary="earlier", page="one")
    with _no_room_after(count, monkeypatch), pytest.raises(InputError, match="No space left"):
        write_files(run, {"page": b"two", "other": b"two"})
    assert _names(run) <= {"summary", "page", "other", "manifest.json"}
    _write(run, summary="new")
    assert _names(tmp_path) == {"run", "run/summary", "run/manifest.json"}


def test_pages_of_a_run_do_not_go_into_another(tmp_path: Path) -> None:
    run = tmp_path / "run"
    _write(run, summary="earlier")
    found = manifest.read(run)
    assert found is not None
    _write(run, summary="new")
    with pytest.raises(InputError, match="run: has been replaced meanwhile"):
        write_files(run, {"page": b"of the earlier"}, found=found.id)
    assert _names(run) == {"summary", "manifest.json"}


def test_a_page_is_written_as_it_is_with_the_permissions_of_other_files(tmp_path: Path) -> None:
    (tmp_path / "plain").touch()
    write_page(tmp_path / "page.html", "first", "report")
    write_page(tmp_path / "page.html", "one\ntwo ±\n", "report")  # it is ours
    content = (tmp_path / "page.html").read_bytes()
    assert content.startswith("one\ntwo ±\n".encode())
    assert content.count(b"\n") == 3
    modes = {stat.S_IMODE(path.stat().st_mode) for path in tmp_path.iterdir()}
    assert len(modes) == 1
    assert _names(tmp_path) == {"plain", "page.html"}


@pytest.mark.parametrize("change", [lambda text: "", lambda text: text.replace("o", "0", 1), lambda text: text + "\n"])
def test_a_page_that_was_changed_is_not_replaced(tmp_path: Path, change: Callable[[str], str]) -> None:
    page = tmp_path / "page.html"
    write_page(page, "one\n", "report")
    page.write_text(change(_text(page)), encoding="utf-8")
    before = page.read_bytes()
    with pytest.raises(InputError, match=r"page\.html: is there already"):
        write_page(page, "two\n", "report")
    assert page.read_bytes() == before
    write_page(page, "two\n", "report", force=True)
    assert (tmp_path / "page.html.1").read_bytes() == before
    assert _text(page).startswith("two\n")


# -------------------------------------------------------------------------------- interrupted work


def test_work_is_taken_up_where_it_was_left(tmp_path: Path) -> None:
    target = tmp_path / "deep" / "work"
    with resumable_folder(target, "reproduction"):
        (target / "half.npz").touch()
    with resumable_folder(target, "reproduction"):
        assert _names(target) == {".massprop", "half.npz"}
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "letter").touch()
    with resumable_folder(tmp_path / "mine", "reproduction", force=True) as path:
        assert _names(path) == {".massprop"}
    assert _names(tmp_path / "mine.1") == {"letter"}


def test_work_never_takes_the_place_of_other_work_or_of_a_run(tmp_path: Path) -> None:
    with resumable_folder(tmp_path / "work", "reproduction"):
        (tmp_path / "work" / "cases").mkdir()
    _write(tmp_path / "run", figures__rates="picture")
    _write(tmp_path / "runs" / "a", summary="earlier")
    before = _names(tmp_path)
    for name in ("work", "work/cases", "work/new", "run", "run/figures", "runs"):
        for force in (False, True):
            words = f"{name}: .*; give another folder"
            with (
                pytest.raises(InputError, match=words),
                resumable_folder(tmp_path / name, "campaign", force=force),
            ):
                pass
            if name != "run":  # which another run may take the place of
                with pytest.raises(InputError, match=words), reserved(tmp_path / name, force=force):
                    pass
    assert _names(tmp_path) == before
    assert (tmp_path / "work" / "cases").is_dir()


@pytest.mark.parametrize("target", [".", "..", "../here", "../data", "../data/../data"])
def test_work_does_not_move_what_it_reads_nor_the_current_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, target: str
) -> None:
    for name in ("here/mine", "data/mine"):
        (tmp_path / name).parent.mkdir()
        (tmp_path / name).touch()
    monkeypatch.chdir(tmp_path / "here")
    for check in (
        lambda: reserved(Path(target), force=True, reads=["../data/mine"]),
        lambda: resumable_folder(Path(target), "campaign", force=True, reads=["../data/mine"]),
    ):
        with pytest.raises(InputError, match="give another folder"), check():
            pass
    assert _names(tmp_path) == {"here", "here/mine", "data", "data/mine"}


def test_work_is_done_by_one_process_at_a_time(tmp_path: Path) -> None:
    with (
        resumable_folder(tmp_path / "work", "reproduction"),
        pytest.raises(InputError, match="work: another process is at work in it"),
        resumable_folder(tmp_path / "work", "reproduction"),
    ):
        pass


def test_work_does_not_begin_among_files_of_others(tmp_path: Path) -> None:
    (tmp_path / "letter.txt").touch()
    with (
        pytest.raises(InputError, match="holds files that are not of an earlier reproduction"),
        resumable_folder(tmp_path, "reproduction"),
    ):
        pass
    with pytest.raises(InputError, match=r"letter.txt: is a file"), resumable_folder(tmp_path / "letter.txt", "x"):
        pass
    assert _names(tmp_path) == {"letter.txt"}


def test_a_stage_leaves_nothing(tmp_path: Path) -> None:
    def fail_halfway() -> None:
        with stage(tmp_path) as prepared:
            (prepared.partial / "half").touch()
            raise _BrokenError

    with pytest.raises(_BrokenError):
        fail_halfway()
    assert _names(tmp_path) == set()

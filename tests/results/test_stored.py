"""A run's folder that was tampered with: each file is refused with one message, and nothing of it is used."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from massprop_drake import InputError, Run

Members = dict[str, bytes]


@pytest.fixture(scope="module")
def sound(stuck_run: Run, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return stuck_run.save(tmp_path_factory.mktemp("runs") / "sound", pictures=False, report=False)


@pytest.fixture
def folder(sound: Path, tmp_path: Path) -> Path:
    """A copy to spoil."""
    for name in ("scenario.yaml", "summary.json", "history.npz", "filter_state.json"):
        (tmp_path / name).write_bytes((sound / name).read_bytes())
    return tmp_path


def _npy(values: Any) -> bytes:
    stream = io.BytesIO()
    np.lib.format.write_array(stream, np.asarray(values), allow_pickle=True)
    return stream.getvalue()


def _put(name: str, change: Callable[[Any], Any]) -> Callable[[Members], None]:
    """Replaces a signal by what becomes of it."""

    def put(members: Members) -> None:
        members[name] = _npy(change(np.lib.format.read_array(io.BytesIO(members[name]))))

    return put


def _with(place: tuple[int, ...], value: float) -> Callable[[Any], Any]:
    def change(values: Any) -> Any:
        values[place] = value
        return values

    return change


def _promising(shape: str) -> Callable[[Members], None]:
    """A header that promises more than there is."""

    def put(members: Members) -> None:
        header = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}".ljust(117).encode() + b"\n"
        members["time_s.npy"] = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header + bytes(80)

    return put


NONE_READ = r"holds no signals that can be read: "
HISTORIES: dict[str, tuple[Callable[[Members], Any], str]] = {
    "no times": (lambda members: members.pop("time_s.npy"), f"{NONE_READ}'time_s' is missing"),
    "no gyro": (lambda members: members.pop("gyro.npy"), f"{NONE_READ}'gyro' is missing"),
    "half the detector": (lambda members: members.pop("likelihood.npy"), f"{NONE_READ}'likelihood' is missing"),
    "a row too few": (_put("rate.npy", lambda values: values[:-1]), r".*'rate.npy' has shape \(75, 3\), expected"),
    "no row": (_put("time_s.npy", lambda values: values[:0]), r".*'time_s.npy' has shape \(0,\)"),
    "objects": (_put("rate.npy", lambda values: values.astype(object)), ".*'rate.npy' is no array of numbers"),
    "integers": (_put("time_s.npy", lambda values: np.arange(76)), ".*'time_s.npy' is no array of numbers"),
    "other bytes": (lambda members: members.update({"rate.npy": b"x"}), ".*'rate.npy' is no array of numbers"),
    "large header": (_promising("(1000000000000,)"), ".*'time_s.npy' is not as long as its shape"),
    "negative header": (_promising("(-1,)"), ".*'time_s.npy' is no array of numbers"),
    "program in a header": (_promising("(__import__('os'),)"), ".*'time_s.npy' is no array of numbers"),
    "time goes back": (_put("time_s.npy", lambda values: values[::-1].copy()), "time_s: must be finite and go forward"),
    "time unknown": (_put("time_s.npy", _with((3,), np.nan)), "time_s: must be finite and go forward"),
    "attitude unknown": (_put("attitude.npy", _with((5, 1), np.nan)), "attitude, row 5: must be finite"),
    "reading infinite": (_put("gyro.npy", _with((6, 0), -np.inf)), "gyro, row 6: must be finite"),
    "no such jet": (
        _put("suspected_jet.npy", lambda values: np.where(np.isnan(values), values, 44.0)),
        "suspected_jet: names a jet that vehicle 'orbiter' does not have",
    ),
}


def _rewrite(path: Path, change: Callable[[Members], Any], method: int = zipfile.ZIP_DEFLATED) -> None:
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    change(members)
    with zipfile.ZipFile(path, "w", method) as archive:
        for name, content in members.items():
            archive.writestr(name, content)


@pytest.mark.parametrize("name", HISTORIES)
def test_a_history_that_no_run_writes_is_refused(folder: Path, name: str) -> None:
    change, words = HISTORIES[name]
    _rewrite(folder / "history.npz", change)
    with pytest.raises(InputError, match=rf"history\.npz: {words}"):
        Run.load(folder)


def test_signals_that_are_not_known_are_passed_over_and_another_archive_is_refused(
    folder: Path, stuck_run: Run
) -> None:
    _rewrite(folder / "history.npz", lambda members: members.update({"../x.npy": b"?", "later.npy": _npy([1.0])}))
    assert set(Run.load(folder).signals) == set(stuck_run.signals)
    _rewrite(folder / "history.npz", lambda members: None, zipfile.ZIP_BZIP2)
    with pytest.raises(InputError, match="compressed in a way that is not ours"):
        Run.load(folder)


@pytest.mark.parametrize("name", ["summary.json", "filter_state.json"])
@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"{", "not valid JSON"),
        (b"[" * 100_000, "nested too deeply"),
        (b'{"a": NaN}', "not valid JSON: NaN is not finite"),
        (b'{"a": 1e999}', "not valid JSON: 1e999 is not finite"),
        (b'{"a": ' + b"9" * 5000 + b"}", "not valid JSON"),
        (b"\xff", "not a text file in UTF-8"),
        (b"3", "input should be a valid mapping"),
    ],
)
def test_what_is_no_json_of_ours_is_refused(folder: Path, name: str, content: bytes, words: str) -> None:
    (folder / name).write_bytes(content)
    with pytest.raises(InputError, match=f"{name}: {words}"):
        Run.load(folder)


LOOSE = {"data_quality", "estimate", "covariance", "outside_wrench", "velocity", "scenario", "vehicle", "version"}
LISTS = {"states", "detections", "events", "unconfirmed", "untested", "commanded", "injected", "identifiability"}


@pytest.mark.parametrize("name", ["summary.json", "filter_state.json"])
@pytest.mark.parametrize("nasty", ["x", -1e300, []])
def test_every_field_of_the_wrong_type_is_read_or_refused_by_its_name(folder: Path, name: str, nasty: Any) -> None:
    content = json.loads((folder / name).read_text(encoding="utf-8"))
    refused = []
    for key in content:
        (folder / name).write_text(json.dumps({**content, key: nasty}), encoding="utf-8")
        try:
            Run.load(folder)
        except InputError as error:
            if f"{name}: {key}" in str(error):
                refused.append(key)
    harmless = {"time_s"} if nasty == -1e300 else LISTS | {"command", "completeness_detail"}
    assert set(content) - set(refused) <= LOOSE | harmless

"""Claims are met by signals made to meet them, and not by signals made not to: each can fail."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
import pytest

from reproduction import catalog, pure_rotations
from reproduction.claims import Claim, Verdict, judge
from reproduction.measures import YZ, ZZ, orbiter

ENTRIES = {entry.name: entry for entry in catalog.ENTRIES}
TRUTH = orbiter().nominal.vector()
TIME_S = np.round(0.08 * np.arange(726), 2)  # to 58 s


def claim(entry: str, text: str, words: str = "") -> Claim:
    """The one claim of an entry whose text begins so."""
    (found,) = (one for one in ENTRIES[entry].claims if one.text.startswith(text) and words in one.thesis)
    return found


def verdict(of: Claim, *phases: Any) -> Verdict:
    return judge(of, phases).verdict


def errors(*steps: tuple[float, float], element: int | slice = slice(None)) -> dict[str, Any]:
    """A run whose estimates are off by a share of the truth, each from a time on."""
    truth = np.tile(TRUTH, (TIME_S.size, 1))
    off = np.zeros_like(truth)
    for start_s, share in steps:
        off[start_s - 1e-6 <= TIME_S, element] = share
    return {"time_s": TIME_S, "truth": truth, "estimate": truth * (1.0 - off)}


def _both(one: dict[str, Any], other: dict[str, Any], element: int) -> dict[str, Any]:
    estimate = one["estimate"].copy()
    estimate[:, element] = other["estimate"][:, element]
    return {**one, "estimate": estimate}


@lru_cache(maxsize=4)
def _rotated(force: float) -> dict[str, Any]:
    return pure_rotations.rotations(0, force=force)


@pytest.fixture
def few_samples(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pure_rotations, "_SAMPLES", 60)


@pytest.mark.usefixtures("few_samples")
@pytest.mark.parametrize(
    ("entry", "text"),
    [
        ("fig_5_7", "1-sigma of the center of mass after rotations by torque alone"),
        ("fig_5_7", "change of its error in these rotations"),
        ("fig_5_9", "the same ratio after rotations by torque alone"),
    ],
)
def test_the_center_of_mass_shows_by_net_force_alone(entry: str, text: str) -> None:
    assert verdict(claim(entry, text), {"pure": _rotated(0.0)}) is Verdict.HOLDS
    assert verdict(claim(entry, text), {"pure": _rotated(1.0)}) is Verdict.DIFFERS


def test_the_extended_filter_diverges_in_the_rotations_or_not() -> None:
    of = claim("fig_5_9", "largest error of the diagonal after the rotations, 24.9 s")
    fine, late = errors((0.0, 1e-4)), errors((0.0, 1e-4), (25.0, 0.4))
    assert verdict(of, {"second": fine, "linear": errors((0.0, 0.02))}) is Verdict.HOLDS
    assert verdict(of, {"second": fine, "linear": late}) is Verdict.DIFFERS


@pytest.mark.parametrize(("share", "expected"), [(1.0, "holds"), (0.6, "holds"), (0.1, "differs"), (3.0, "differs")])
def test_coupling_is_as_large_as_the_residual_torque_or_not(share: float, expected: str) -> None:
    rate = np.tile(np.radians([0.5, 0.1, 0.2]), (TIME_S.size, 1))
    coupling = np.cross(rate, rate @ orbiter().nominal.inertia)
    of = claim("fig_5_6", "torque that coupling amounts to")
    assert verdict(of, {"with": {"time_s": TIME_S, "rate": rate, "torque": coupling / share}}) == expected


def test_digits_come_in_the_order_told_or_not() -> None:
    of = claim("fig_5_6", "time from when Izz⁻¹ keeps four digits")
    # half a unit of the digit: 0.035 % of Izz^-1, 8.8 % of Iyz^-1
    diagonal = errors((0.0, 1.0), (10.0, 3e-4), element=ZZ)
    early, late = (errors((0.0, 1.0), (start_s, 0.08), element=YZ) for start_s in (9.0, 11.0))
    assert verdict(of, {"with": _both(diagonal, late, YZ)}) is Verdict.HOLDS
    assert verdict(of, {"with": _both(diagonal, early, YZ)}) is Verdict.DIFFERS
    never = errors((0.0, 1.0), element=YZ)
    assert verdict(of, {"with": _both(diagonal, never, YZ)}) is Verdict.HOLDS
    coarse = errors((0.0, 1.0), (10.0, 4e-4), element=ZZ)
    assert verdict(of, {"with": _both(coarse, late, YZ)}) is Verdict.DIFFERS


def _failed(jet: int, likelihood: float, forces: list[float]) -> dict[str, Any]:
    """A failure from 50 s on, every sample tested; forces of the jet repeat, and it is the likeliest of its cluster."""
    rows = TIME_S.size
    found = np.zeros((rows, 44))
    found[:, jet - 1] = likelihood
    magnitude = np.zeros((rows, 44))
    magnitude[:, jet - 1] = np.resize(forces, rows)
    return {"time_s": TIME_S, "tested": np.ones((rows, 1)), "likelihood": found, "failure_magnitude": magnitude}


@pytest.mark.parametrize(("entry", "jet"), [("fig_5_22", 39), ("fig_5_25", 24)])
@pytest.mark.parametrize(
    ("orders", "expected"), [(3.0, "holds"), (3.5, "holds"), (4.0, "holds"), (2.85, "differs"), (4.2, "differs")]
)
def test_soft_failures_are_so_many_orders_below_hard_ones_or_not(
    entry: str, jet: int, orders: float, expected: str
) -> None:
    of = claim(entry, "orders of magnitude of the median argument below that of jet 29")
    hard = _failed(29, 1e6, [868.8])
    assert verdict(of, {"hard": hard, "flight": _failed(jet, 10.0 ** (6.0 - orders), [10.0])}) == expected


@pytest.mark.parametrize(("entry", "jet", "other", "force"), [("fig_5_24", 39, 9, 24.483), ("fig_5_27", 24, 42, 10.4)])
def test_the_force_of_the_likeliest_jet_is_right_or_not(entry: str, jet: int, other: int, force: float) -> None:
    of = claim(entry, "the same, (b) jet that maximizes")
    own = claim(entry, "share of tested samples whose force is within 1 lbf")
    right = _failed(jet, 100.0, [force + 0.9] * 4 + [force + 1.1])
    assert verdict(of, {"flight": right}) is Verdict.HOLDS
    assert verdict(of, {"flight": _failed(jet, 100.0, [force + 0.9] * 3 + [force + 1.1])}) is Verdict.DIFFERS
    # another jet of the cluster is likelier, and its force is wrong: panel (a) is as it was, (b) is not
    likelihood, magnitude = right["likelihood"].copy(), right["failure_magnitude"].copy()
    likelihood[:, other - 1], magnitude[:, other - 1] = 200.0, force + 5.0
    mistaken = {**right, "likelihood": likelihood, "failure_magnitude": magnitude}
    assert verdict(of, {"flight": mistaken}) is Verdict.DIFFERS
    assert verdict(own, {"flight": mistaken}) is Verdict.HOLDS


def test_a_failure_taken_for_a_jump_leads_astray_or_not() -> None:
    of = claim("section_5_3", "largest error of the diagonal 2 s after jet 29 sticks on and passes for jumps")
    assert verdict(of, {"jump": errors((0.0, 1e-4), (50.08, 0.5))}) is Verdict.HOLDS
    assert verdict(of, {"jump": errors((0.0, 1e-4), (52.2, 0.5))}) is Verdict.DIFFERS  # not quickly


def test_a_reset_keeps_the_states_or_not() -> None:
    with_reset = claim("section_5_3", "largest error of the diagonal 8 s after, jet logic reset")
    without = claim("section_5_3", "the same without a reset")
    kept, lost = errors((0.0, 1e-4), (50.2, 1.5e-4)), errors((0.0, 1e-4), (55.0, 3e-4))
    assert verdict(with_reset, {"reset": kept}) is Verdict.HOLDS
    assert verdict(with_reset, {"reset": lost}) is Verdict.DIFFERS
    assert without.measure({"flight": lost}) == pytest.approx(3.0)
    assert without.measure({"flight": kept}) == pytest.approx(1.5)


@pytest.mark.parametrize(("ratio", "expected"), [(4.66, "differs"), (1.5, "holds"), (0.9, "differs")])
def test_a_minor_gain_is_a_gain_and_minor(ratio: float, expected: str) -> None:
    for entry, labels in (("section_6_1", ("base", "ignored")), ("section_5_2", ("other", "ignored"))):
        of = claim(entry, "largest final error" if entry == "section_6_1" else "there,", "a minor increase in accuracy")
        phase = dict(zip(labels, (errors((0.0, 1e-4)), errors((0.0, ratio * 1e-4))), strict=True))
        assert of.expect.met(np.array([of.measure(phase)]))[0] == (expected == "holds")  # type: ignore[union-attr]


@pytest.mark.parametrize(("largest", "expected"), [(0.9, "holds"), (1.9, "differs")])
def test_a_force_varies_less_than_a_pound_over_the_whole_period(largest: float, expected: str) -> None:
    run = _failed(29, 1e6, [868.819] * 9 + [868.819 + largest])
    assert verdict(claim("fig_5_18", "largest error of the force"), {"flight": run}) == expected

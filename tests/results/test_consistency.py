"""The verdict on innovations, on numbers drawn from what they should be and from what they should not."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from massprop_drake.maths.mass_properties import NAMES
from massprop_drake.results.consistency import (
    Consistency,
    Forks,
    Innovations,
    Tally,
    judge_consistency,
    likeliest_innovations,
)

UNKNOWN = np.full(10, np.nan)


def _tally(values: np.ndarray) -> Tally:
    tally = Tally()
    for block in np.array_split(values, 7):
        tally.add(block, np.full(block.size, 3.0))
    return tally


def _verdict(rotation: np.ndarray, mass: np.ndarray | None = None, ratios: np.ndarray = UNKNOWN) -> Consistency:
    return judge_consistency(_tally(rotation), Tally() if mass is None else _tally(mass), ratios, NAMES)


def _drawn(n: int, seed: int, factor: float = 1.0) -> np.ndarray:
    return factor * np.random.default_rng(seed).chisquare(3, n)


def test_of_a_thousand_consistent_flights_one_is_called_inconsistent_at_the_most() -> None:
    """Nor where innovations are smaller than claimed."""
    verdicts = [_verdict(_drawn(n, seed)).verdict for seed in range(250) for n in (25, 60, 140, 800)]
    assert verdicts.count("inconsistent") <= 1
    assert verdicts.count("consistent") >= 999
    assert _verdict(_drawn(400, 1, 0.2)).verdict == "consistent"


@pytest.mark.parametrize(
    ("values", "words"),
    [
        (_drawn(140, 2, 4.0), "innovations are in their upper quarter"),  # half the sigma claimed
        (
            np.where(np.arange(140) % 10 == 0, 40.0, _drawn(140, 3)),
            "innovations are beyond their 99 % point",
        ),  # one in ten is bad
    ],
)
def test_too_large_ones_are_found_whether_all_or_some(values: np.ndarray, words: str) -> None:
    found = _verdict(values)
    assert found.verdict == "inconsistent"
    assert any(f"% of the rotation {words}" in reason for reason in found.reasons)
    assert any(f"% of the translation {words}" in reason for reason in _verdict(_drawn(140, 4), values).reasons)


def test_little_data_say_nothing_unless_they_shout() -> None:
    assert _verdict(_drawn(19, 6)).verdict == "not enough data"
    assert judge_consistency(Tally(), Tally(), UNKNOWN, NAMES)[:4] == (None, None, 0, "not enough data")
    assert _verdict(np.full(15, 50.0)).verdict == "inconsistent"


def test_an_error_that_is_known_and_far_off_is_told() -> None:
    ratios = np.array([0.1] * 6 + [-7.25] + [0.2] * 3)
    found = _verdict(_drawn(140, 7), ratios=ratios)
    assert (found.verdict, found.reasons) == ("inconsistent", ["x_cm is 7.25 of its sigmas off"])


def test_what_was_declared_explains_the_samples_until_then() -> None:
    """A payload that is told seconds after it has docked; what is wrong besides is still wrong."""
    values, late, wrong = _drawn(400, 8), np.full(40, 1e4), np.full(40, 1e4)
    for besides, verdict in ((values[:0], "consistent"), (wrong, "inconsistent")):
        tally = Tally()
        every = np.concatenate((values, late, besides))
        tally.add(every, np.full(every.size, 3.0))
        tally.exclude_from_faults(late, np.full(late.size, 3.0))
        assert judge_consistency(tally, Tally(), np.full(10, np.nan), [""] * 10).verdict == verdict
        assert tally.n == every.size


def _seen(nis: np.ndarray, components: float = 3.0) -> Innovations:
    """Innovations of samples a second apart, NaN where one was not used."""
    used = np.isfinite(nis)
    return Innovations(used, nis, np.full(nis.size, components), np.zeros(nis.size, dtype=bool))


def _by_history(seen: Innovations, *told: tuple[int, float, float, float]) -> Innovations:
    """Innovations after forks: row, time, sum of the NIS, its expectation."""
    rows, since_s, nis, components = np.array(told, dtype=float).reshape(-1, 4).T
    time_s = np.arange(seen.nis.size, dtype=float)
    return likeliest_innovations(seen, time_s, Forks(rows.astype(int), since_s, nis, components))


def test_a_fork_replaces_the_samples_after_it_by_the_mean_of_the_new_history() -> None:
    found = _by_history(_seen(np.array([1.0, 2.0, 400.0, 500.0, 3.0])), (3, 1.0, 14.0, 12.0))
    np.testing.assert_array_equal(found.nis, [1.0, 2.0, 3.5, 3.5, 3.0])
    np.testing.assert_array_equal(found.components, [3.0, 3.0, 6.0, 6.0, 3.0])
    np.testing.assert_array_equal(found.averaged, [False, False, True, True, False])
    assert found.used.all()


@pytest.mark.parametrize(
    ("second", "expected"),
    [
        ((4, 0.0, 24.0, 24.0), [1.0, 3.0, 3.0, 3.0, 3.0, 7.0]),  # begins earlier: in place of the first
        ((4, 1.0, 18.0, 18.0), [1.0, 2.0, 3.0, 3.0, 3.0, 7.0]),  # where it began
        ((4, 2.0, 12.0, 12.0), [1.0, 2.0, 9.0, 3.0, 3.0, 7.0]),  # within it: of the first its mean elsewhere
        ((5, 3.0, 12.0, 12.0), [1.0, 2.0, 9.0, 9.0, 3.0, 3.0]),  # after it
    ],
)
def test_a_later_fork_counts_where_two_overlap(second: tuple[int, float, float, float], expected: list[float]) -> None:
    seen = _seen(np.array([1.0, 2.0, 400.0, 500.0, 600.0, 7.0]))
    np.testing.assert_array_equal(_by_history(seen, (3, 1.0, 36.0, 12.0), second).nis, expected)


def test_a_sample_that_was_not_used_stays_so_unless_the_history_used_some_of_all() -> None:
    seen = _seen(np.array([1.0, np.nan, 400.0, np.nan]))
    found = _by_history(seen, (3, 0.0, 5.0, 6.0))
    np.testing.assert_array_equal(found.used, [True, False, True, False])
    assert found.components[2] == 6.0  # all that the history used
    np.testing.assert_array_equal(_by_history(seen, (3, 2.0, 5.0, 6.0)).used, [True, False, True, True])
    np.testing.assert_array_equal(_by_history(seen, (2, 0.0, 0.0, 0.0)).used, [True, False, False, False])


@pytest.mark.parametrize("components", [0.5, 3.0, 9.0])
def test_samples_of_which_the_mean_is_known_count_as_chi_square_that_is_scaled(components: float) -> None:
    degrees = max(components, 1.0)
    for factor in (0.3, 1.0, 1.5, 1e6):
        tally = Tally()
        nis = 3.0 * factor * degrees / components
        tally.add_averaged(np.full(50, nis), np.full(50, components))
        assert tally.n == 50
        assert tally.mean == pytest.approx(nis)
        assert tally.beyond == pytest.approx(stats.chi2.sf(stats.chi2.isf(0.01, degrees) / factor, degrees))
        assert (tally.within is None) == (factor == 1e6)
        assert bool(tally.faults("rotation")) == (factor == 1e6)


def test_a_rightly_named_failure_is_consistent_and_a_false_name_is_not() -> None:
    """Innovations that only the right history explains; that of a false name makes them smaller, not small."""
    values = np.concatenate([_drawn(300, 9), np.full(60, 1e4), _drawn(240, 10)])
    for total, verdict in ((0.0, "inconsistent"), (3.1 * 60, "consistent"), (40.0 * 60, "inconsistent")):
        tally = Tally()
        tally.add_innovations(_by_history(_seen(values), *([(359, 299.0, total, 180.0)] if total else [])))
        assert judge_consistency(tally, Tally(), UNKNOWN, NAMES).verdict == verdict
        assert tally.n == 600


def test_a_tally_goes_on_from_its_numbers() -> None:
    one, other = Tally(), Tally()
    seen = _by_history(_seen(_drawn(30, 11)), (20, 4.0, 60.0, 48.0))
    one.add_innovations(seen)
    for row in range(30):
        other = Tally.from_counts(other.numbers)
        other.add_innovations(Innovations(*(part[row : row + 1] for part in seen)))
    np.testing.assert_allclose(other.numbers, one.numbers, rtol=1e-12)

"""The verdict on innovations, on numbers drawn from what they should be and from what they should not."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from massprop_drake import Run, load_scenario, simulate
from massprop_drake.maths.estimation.joint.quantized import truncated_moments
from massprop_drake.maths.mass_properties import NAMES
from massprop_drake.results.consistency import Consistency, Tally, judged

UNKNOWN = np.full(10, np.nan)


def _tally(values: np.ndarray) -> Tally:
    tally = Tally()
    for block in np.array_split(values, 7):
        tally.add(block, np.full(block.size, 3.0))
    return tally


def _verdict(rotation: np.ndarray, mass: np.ndarray | None = None, ratios: np.ndarray = UNKNOWN) -> Consistency:
    return judged(_tally(rotation), Tally() if mass is None else _tally(mass), ratios, NAMES)


def _drawn(n: int, seed: int, factor: float = 1.0) -> np.ndarray:
    return factor * np.random.default_rng(seed).chisquare(3, n)


def test_of_a_thousand_consistent_flights_one_is_called_inconsistent_at_the_most() -> None:
    verdicts = [_verdict(_drawn(n, seed)).verdict for seed in range(250) for n in (25, 60, 140, 800)]
    assert verdicts.count("inconsistent") <= 1
    assert verdicts.count("consistent") >= 999


def test_smaller_innovations_than_claimed_are_no_fault() -> None:
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


def test_the_number_of_components_counts() -> None:
    random = np.random.default_rng(8)
    components = random.integers(1, 4, 20_000)
    nis = 3.0 * random.chisquare(components) / components  # as logs have it
    known, unknown = Tally(), Tally()
    known.add(nis, components)
    unknown.add(nis, np.full(nis.size, 3.0))
    assert judged(known, Tally(), UNKNOWN, NAMES).verdict == "consistent"
    assert known.beyond is not None
    assert unknown.beyond is not None
    assert known.beyond == pytest.approx(0.01, abs=0.003)
    assert unknown.beyond > 0.02


@pytest.mark.parametrize("width", [0.1, 1.0, 3.0, 6.0])
def test_what_cells_tell_is_counted_against_what_they_can(width: float) -> None:
    """Readings of a quantum of so many sigmas: their mean is three, and their tails are no heavier than chi-square."""
    random = np.random.default_rng(9)
    middle = width * np.rint(random.uniform(-50.0, 50.0, 4000))
    phase = width * random.uniform(-0.5, 0.5, 4000)
    errors = middle + phase - width * np.rint((middle + phase + random.standard_normal(4000)) / width)
    each = [truncated_moments(-error - width / 2.0, -error + width / 2.0) for error in errors.tolist()]
    degrees = np.array([1.0 - one.variance for one in each])
    tally = Tally()
    tally.add(3.0 * np.array([one.mean for one in each]) ** 2 / degrees, degrees)
    assert tally.mean == pytest.approx(3.0, abs=0.25)
    assert not tally.faults("rotation")


def test_one_bad_sample_does_not_rule() -> None:
    values = _drawn(140, 5)
    values[17] = 1e6
    found = _verdict(values)
    assert found.verdict == "consistent"
    assert found.rotation_nis_mean == pytest.approx(values.mean())
    assert found.rotation_nis_beyond == pytest.approx((values > stats.chi2.isf(0.01, 3)).mean())


def test_little_data_say_nothing_unless_they_shout() -> None:
    assert _verdict(_drawn(19, 6)).verdict == "not enough data"
    assert judged(Tally(), Tally(), UNKNOWN, NAMES)[:4] == (None, None, 0, "not enough data")
    assert _verdict(np.full(15, 50.0)).verdict == "inconsistent"


def test_an_error_that_is_known_and_far_off_is_told() -> None:
    ratios = np.array([0.1] * 6 + [-7.25] + [0.2] * 3)
    found = _verdict(_drawn(140, 7), ratios=ratios)
    assert (found.verdict, found.reasons) == ("inconsistent", ["x_cm is 7.25 of its sigmas off"])


def test_a_flight_tells_what_its_thrusts_are_worth(sample_run: Run) -> None:
    assert sample_run.results.consistency.verdict == "consistent"
    wrong = ["duration_s=40", "plant.thrust_dispersion=0.02", "seed=3"]
    found = simulate(load_scenario("sample_maneuver", wrong)).results.consistency
    assert found.verdict == "inconsistent"
    assert any("rotation innovations" in reason for reason in found.reasons)


def test_what_was_declared_explains_the_samples_until_then() -> None:
    """A payload that is told seconds after it has docked; what is wrong besides is still wrong."""
    values, late, wrong = _drawn(400, 8), np.full(40, 1e4), np.full(40, 1e4)
    for besides, verdict in ((values[:0], "consistent"), (wrong, "inconsistent")):
        tally = Tally()
        every = np.concatenate((values, late, besides))
        tally.add(every, np.full(every.size, 3.0))
        tally.explain(late, np.full(late.size, 3.0))
        assert judged(tally, Tally(), np.full(10, np.nan), [""] * 10).verdict == verdict
        assert tally.n == every.size


def test_words_are_not_ruled_by_a_few_samples() -> None:
    values = _drawn(200, 8)
    assert _verdict(values).in_words().startswith(f"mean NIS {values.mean():.2f} rotation, - translation, over 200 ")
    values[:2] = 1e6
    within = values[values < stats.chi2.isf(0.01, 3)]
    found = _verdict(values)
    assert found.rotation_nis_within == pytest.approx(within.mean())
    share = f"{100.0 * (1.0 - within.size / 200):.2g} % beyond their 99 % point"
    assert found.in_words().startswith(f"mean NIS {within.mean():.2f} ({values.mean():.4g} with the {share}) rotation")

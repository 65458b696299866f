"""Statistics of a campaign, beside published values and definitions."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from massprop_drake.inputs.campaign_file import load_campaign
from massprop_drake.studies.campaign import statistics
from massprop_drake.studies.campaign.plan import design
from massprop_drake.studies.campaign.statistics import Figure

# remission of leukemia patients under 6-mercaptopurine, weeks (Freireich et al. 1963)
RELAPSED = (6, 6, 6, 7, 10, 13, 16, 22, 23)
CENSORED = (6, 9, 10, 11, 17, 19, 20, 25, 32, 32, 34, 35)


def interval(figure: Figure) -> tuple[float, float]:
    return figure.low, figure.high


# ---------------------------------------------------------------------------------- rates and shares


@pytest.mark.parametrize(("events", "low", "high"), [(1, 0.0253, 5.572), (2, 0.2422, 7.225), (10, 4.795, 18.39)])
def test_poisson_bounds_are_garwoods(events: int, low: float, high: float) -> None:
    found = statistics.rate(events, 1.0)
    assert interval(found) == pytest.approx((low, high), rel=1e-3)  # as tables print them
    assert stats.poisson.sf(events - 1, found.low) == pytest.approx(0.025)
    assert stats.poisson.cdf(events, found.high) == pytest.approx(0.025)


def test_none_in_some_hours_is_three_over_these_hours() -> None:
    found = statistics.rate(0, 40.0)
    assert (found.value, found.low) == (0.0, 0.0)
    assert found.high == pytest.approx(3.0 / 40.0, rel=2e-3)
    assert stats.poisson.cdf(0, found.high * 40.0) == pytest.approx(0.05)


def test_without_exposure_there_is_no_rate() -> None:
    assert math.isnan(statistics.rate(0, 0.0).value)


def test_a_share_has_the_interval_of_clopper_and_pearson() -> None:
    assert interval(statistics.share(0, 10)) == pytest.approx((0.0, 0.3085), abs=5e-5)
    assert interval(statistics.share(1, 10)) == pytest.approx((0.0025, 0.4450), abs=5e-5)
    for k in range(13):
        exact = stats.binomtest(k, 12).proportion_ci(0.95, method="exact")
        assert interval(statistics.share(k, 12)) == pytest.approx((exact.low, exact.high), abs=1e-12)
    assert math.isnan(statistics.share(0, 0).value)


def test_one_value_in_each_cluster_is_a_plain_share() -> None:
    assert statistics.clustered_share([1, 0, 1, 1], [1, 1, 1, 1]) == statistics.share(3, 4)


def test_values_that_go_together_count_as_one() -> None:
    # thirty cases, ten values each that are all alike
    together = statistics.clustered_share([10] * 24 + [0] * 6, [10] * 30)
    assert together.value == 0.8
    assert together.n == 300
    assert interval(together) == pytest.approx(interval(statistics.share(24, 30)), abs=0.02)
    assert together.high - together.low > 2.5 * (statistics.share(240, 300).high - statistics.share(240, 300).low)


def test_values_that_do_not_go_together_count_by_themselves() -> None:
    hits = np.random.default_rng(3).binomial(10, 0.8, 400)
    apart = statistics.clustered_share(hits.tolist(), [10] * 400)
    plain = statistics.share(int(hits.sum()), 4000)
    assert apart.high - apart.low == pytest.approx(plain.high - plain.low, rel=0.15)


def test_clusters_without_a_miss_count_as_one_value_each() -> None:
    assert interval(statistics.clustered_share([10] * 20, [10] * 20)) == pytest.approx(
        interval(statistics.share(20, 20))
    )
    assert statistics.clustered_share([3, 0, 0], [3, 0, 0]).n == 3


def test_a_mean_has_students_interval() -> None:
    found = statistics.mean([1.0, 2.0, 3.0, 4.0])
    assert found.value == 2.5
    assert found.high - 2.5 == pytest.approx(3.182 * 1.29099 / 2.0, rel=1e-3)  # t of three degrees of freedom
    assert math.isnan(statistics.mean([1.0]).low)


def test_a_median_lies_between_the_second_and_the_ninth_of_ten() -> None:
    values = [5.0, 1.0, 9.0, 3.0, 7.0, 2.0, 8.0, 4.0, 10.0, 6.0]
    assert statistics.median(values) == Figure(5.5, 2.0, 9.0, 10)  # 97.9 %, as any table of the sign test has it
    assert interval(statistics.median(values[:5])) == (-math.inf, math.inf)
    assert interval(statistics.median(values[:6])) == (1.0, 9.0)


# ------------------------------------------------------------------------------------------- delays


def test_the_curve_of_delays_is_kaplan_and_meiers() -> None:
    curve = statistics.detection_curve(RELAPSED, CENSORED)
    np.testing.assert_array_equal(curve.delay_s, [6, 7, 10, 13, 16, 22, 23])
    np.testing.assert_allclose(1 - curve.found, [0.8571, 0.8067, 0.7529, 0.6902, 0.6275, 0.5378, 0.4482], atol=5e-5)
    assert (curve.n, curve.n_found, curve.followed_s) == (21, 9, 35.0)


def test_its_band_is_that_of_log_minus_log_once_something_is_censored() -> None:
    curve = statistics.detection_curve(RELAPSED, CENSORED)
    np.testing.assert_allclose(1 - curve.high[1:], [0.5631, 0.5032, 0.4316, 0.3675, 0.2678, 0.1881], atol=5e-5)
    np.testing.assert_allclose(1 - curve.low[1:], [0.9228, 0.8894, 0.8491, 0.8049, 0.7468, 0.6801], atol=5e-5)


def test_before_anything_is_censored_it_is_a_share() -> None:
    curve = statistics.detection_curve(RELAPSED, CENSORED)
    assert curve.at(6.0)[:3] == pytest.approx(statistics.share(3, 21)[:3])
    whole = statistics.detection_curve([1.0, 2.0, 2.0, 5.0], [])
    assert whole.at(2.0)[:3] == pytest.approx(statistics.share(3, 4)[:3])
    assert whole.at(0.5)[:3] == pytest.approx(statistics.share(0, 4)[:3])


def test_a_curve_says_nothing_of_times_that_nobody_saw() -> None:
    curve = statistics.detection_curve(RELAPSED, CENSORED)
    beyond = curve.at(36.0)
    assert math.isnan(beyond.value)
    assert interval(beyond) == (curve.low[-1], 1.0)
    assert curve.at(35.0).value == curve.found[-1]
    assert statistics.detection_curve([1.0, 2.0], []).at(30.0).value == 1.0  # all have been found before
    assert math.isnan(statistics.detection_curve([], [4.0]).at(5.0).value)
    assert statistics.detection_curve([], [4.0]).at(3.0).value == 0.0


def test_the_median_delay_has_the_interval_that_the_band_gives() -> None:
    # the published median is 23 weeks, from 13 on
    assert statistics.detection_curve(RELAPSED, CENSORED).quantile(0.5)[:3] == (23.0, 13.0, math.inf)
    assert math.isnan(statistics.detection_curve(RELAPSED, CENSORED).quantile(0.9).value)


def test_the_band_stays_where_it_was_when_the_last_one_is_found() -> None:
    curve = statistics.detection_curve([1.0, 2.0, 4.0, 5.0], [3.0])
    assert curve.found[-1] == 1.0
    assert (curve.low[-1], curve.high[-1]) == (curve.low[-2], 1.0)
    assert (np.diff(curve.low) >= 0.0).all()


# -------------------------------------------------------------------------------------- consistency


def test_the_band_of_a_mean_is_that_of_the_textbook() -> None:
    # Bar-Shalom, Li and Kirubarajan (2001), 5.4.2: 50 runs, two states
    assert statistics.mean_band(2, 50) == pytest.approx((1.5, 2.6), abs=0.02)


def test_the_share_in_the_band_counts_both_sides() -> None:
    values = stats.chi2.ppf((np.arange(1000) + 0.5) / 1000, 9)
    assert statistics.in_band(values, 9).value == 0.95
    assert statistics.in_band([0.1, 9.0, 90.0], 9).value == pytest.approx(1 / 3)


# -------------------------------------------------------------------------------------------- sizes


def test_with_two_sizes_the_curve_adds_half_to_each_count() -> None:
    # Firth's correction of a saturated model; 3 of 10 and 9 of 12 found
    sizes = [10.0] * 10 + [100.0] * 12
    curve = statistics.size_curve(sizes, [True] * 3 + [False] * 7 + [True] * 9 + [False] * 3)
    assert curve is not None
    odds = np.log([3.5 / 7.5, 9.5 / 3.5])
    np.testing.assert_allclose(curve.intercept + curve.slope * np.log([10.0, 100.0]), odds, atol=1e-5)
    np.testing.assert_allclose(curve.at(np.array([10.0]))[0], 3.5 / 11.0, atol=1e-5)


# beetles under carbon disulfide (Bliss 1935): logarithm of the dose, number, killed
BEETLES = (
    (1.6907, 59, 6), (1.7242, 60, 13), (1.7552, 62, 18), (1.7842, 56, 28), (1.8113, 63, 52), (1.8369, 59, 53),
    (1.8610, 62, 61), (1.8839, 60, 60),
)  # fmt: skip


def test_the_curve_of_many_is_the_published_one() -> None:
    sizes = [10.0**dose for dose, n, _ in BEETLES for _ in range(n)]
    killed = [place < dead for _, n, dead in BEETLES for place in range(n)]
    curve = statistics.size_curve(sizes, killed)
    assert curve is not None
    # without the correction, which is small for so many: -60.72 and 34.27 a decade
    assert curve.intercept == pytest.approx(-60.72, rel=0.015)
    assert curve.slope * math.log(10.0) == pytest.approx(34.27, rel=0.015)
    assert math.log10(curve.size_90.value) == pytest.approx((math.log(9.0) + 60.72) / 34.27, abs=1e-3)


def test_the_interval_of_a_size_is_where_the_likelihood_falls_by_what_is_allowed() -> None:
    sizes = np.geomspace(2.0, 200.0, 24)
    found = np.array([0, 0, 0, 0, 1, 0, 0, 0, 1, 0, 1, 1, 0, 1, 1, 0, 1, 1, 1, 1, 1, 1, 1, 1], dtype=bool)
    curve = statistics.size_curve(sizes.tolist(), found.tolist())
    assert curve is not None
    x = np.log(sizes)

    def likelihood(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        p = 1.0 / (1.0 + np.exp(-(a[..., None] + b[..., None] * x)))
        weight = p * (1.0 - p)
        information = weight.sum(-1) * (weight * x**2).sum(-1) - (weight * x).sum(-1) ** 2
        return np.log(np.where(found, p, 1.0 - p)).sum(-1) + 0.5 * np.log(information)

    a, b = np.meshgrid(np.linspace(-12.0, 0.0, 401), np.linspace(0.2, 4.0, 401))
    best = likelihood(a, b).max()
    assert likelihood(np.array(curve.intercept), np.array(curve.slope)) == pytest.approx(best, abs=2e-3)
    slopes = np.linspace(0.2, 6.0, 4000)
    for size in interval(curve.size_90):
        through = likelihood(math.log(9.0) - slopes * math.log(size), slopes).max()
        assert 2.0 * (best - through) == pytest.approx(3.841, abs=0.01)


def test_sizes_that_separate_have_a_curve_all_the_same() -> None:
    curve = statistics.size_curve([1, 2, 3, 4, 5, 6, 7, 8], [False] * 4 + [True] * 4)
    assert curve is not None
    assert 5.0 < curve.size_90.value < 8.0
    assert curve.size_90.low < curve.size_90.value
    assert math.isinf(curve.size_90.high)  # so few tell no upper bound


@pytest.mark.parametrize(
    ("sizes", "found"),
    [
        ([1.0, 2.0, 3.0], [False, True, True]),  # too few
        (list(range(1, 11)), [True] * 10),
        (list(range(1, 11)), [False] * 10),
        ([5.0] * 10, [True, False] * 5),
        (list(range(1, 11)), [True] * 5 + [False] * 5),  # smaller ones more often
    ],
)
def test_where_data_say_nothing_there_is_no_curve(sizes: list[float], found: list[bool]) -> None:
    assert statistics.size_curve(sizes, found) is None


def test_one_size_up_to_rounding_has_no_curve_and_a_narrow_range_has_one() -> None:
    found = [True] * 9 + [False]
    assert statistics.size_curve([20.0 + 1e-13 * number for number in range(10)], found) is None
    for spread in (0.02, 0.1, 1.0):
        sizes = [20.0 * (1.0 + spread * (number * 7 % 10) / 10.0) for number in range(10)]
        for k in range(10):
            curve = statistics.size_curve(sizes, [number != k for number in range(10)])
            if curve is not None:
                assert not math.isnan(curve.size_90.low)
                assert curve.size_90.low <= curve.size_90.high
                middle, low, high = curve.at(np.geomspace(1.0, 1000.0, 20))  # also where it is all or nothing
                assert ((low <= middle) & (middle <= high)).all()


def test_few_sizes_have_a_bin_each_and_many_share_them() -> None:
    few = statistics.binned([10, 30, 10, 30, 30], [False, True, True, True, False])
    assert [(low, high, share.value, share.n) for low, high, share in few] == [(10, 10, 0.5, 2), (30, 30, 2 / 3, 3)]
    many = statistics.binned(np.geomspace(1, 256, 33).tolist(), [True] * 33)
    assert [round(low, 6) for low, _, _ in many] == [1, 2, 4, 8, 16, 32, 64, 128]
    assert sum(share.n for _, _, share in many) == 33


# -------------------------------------------------------------------------------------- sensitivity


def test_a_rank_correlation_has_bonett_and_wrights_interval() -> None:
    x = list(range(10))
    y = [1, 0, 3, 2, 5, 4, 7, 6, 9, 8]  # d = 1 each: r = 1 - 6 * 10 / 990
    found = statistics.rank_correlation(x, y)
    r = 1.0 - 60.0 / 990.0
    half = 1.959964 * math.sqrt((1.0 + 0.5 * r * r) / 7.0)
    assert found.value == pytest.approx(r)
    assert interval(found) == pytest.approx((math.tanh(math.atanh(r) - half), math.tanh(math.atanh(r) + half)))
    assert statistics.rank_correlation(x, [math.exp(v) for v in x]).value == pytest.approx(1.0)


def test_what_does_not_vary_has_no_correlation() -> None:
    found = statistics.rank_correlations({"a": [1.0, 1.0, 1.0, 1.0], "b": [1.0, 2.0, 3.0, 4.0]}, [1.0, 3.0, 2.0, 4.0])
    assert list(found) == ["b"]
    assert found["b"].value == pytest.approx(0.8)


def test_sobol_indices_of_ishigamis_function_from_a_plan(tmp_path: Path) -> None:
    keys = ("detector.margin", "detector.threshold", "plant.thrust_dispersion")
    draw = {key: {"uniform": {"low": 0.1, "high": 0.2}} for key in keys}
    text = f"base: sample_maneuver\ncases: {5 * 1024}\nmethod: saltelli\nseed: 2\ndraw: {draw}\n"
    (tmp_path / "c.yaml").write_text(text)
    points = math.pi * (2.0 * design(load_campaign(tmp_path / "c.yaml")) - 1.0)
    x, y, z = points.T
    values = np.sin(x) + 7.0 * np.sin(y) ** 2 + 0.1 * z**4 * np.sin(x)
    found = statistics.sobol_indices(np.stack([values, values + 100.0]), 3)
    exact = {"first": (0.3139, 0.4424, 0.0), "total": (0.5576, 0.4424, 0.2437)}
    for output in range(2):
        for order, indices in exact.items():
            figures = getattr(found, order)[output]
            # other seeds and 1024 points leave up to two hundredths
            assert [figure.value for figure in figures] == pytest.approx(indices, abs=0.03)
            assert all(figure.low < index < figure.high for figure, index in zip(figures, indices, strict=True))
    again = statistics.sobol_indices(np.stack([values, values + 100.0]), 3)
    assert again == found


# -------------------------------------------------------------------------------------------- pairs


def shares_of(both: int, up: int, down: int, neither: int) -> statistics.Paired:
    first = [True] * both + [False] * up + [True] * down + [False] * neither
    second = [True] * both + [True] * up + [False] * down + [False] * neither
    return statistics.paired_share(first, second)


def test_mcnemars_exact_test_is_the_textbooks() -> None:
    found = shares_of(20, 2, 12, 16)  # Armitage and Berry (1994), p. 127
    assert found.p == pytest.approx(0.0129, abs=5e-5)
    assert found.difference.value == pytest.approx(-0.2)
    assert (found.up, found.down) == (2, 12)


def test_a_difference_of_shares_has_tangos_interval() -> None:
    # airway hyper-responsiveness before and after transplantation, as Fagerland et al. (2014) work it out
    assert interval(shares_of(1, 1, 7, 12).difference) == pytest.approx((-0.517, -0.026), abs=5e-4)
    low, high = interval(shares_of(1, 7, 1, 12).difference)
    assert (low, high) == pytest.approx((0.026, 0.517), abs=5e-4)


def test_pairs_that_never_differ_still_bound_the_difference() -> None:
    found = shares_of(30, 0, 0, 10)
    z = 1.959964
    assert interval(found.difference) == pytest.approx((-(z**2) / (40 + z**2), z**2 / (40 + z**2)), abs=1e-6)
    assert math.isnan(found.p)
    assert interval(shares_of(0, 5, 0, 0).difference)[1] == 1.0


def test_the_median_difference_comes_with_the_sign_test() -> None:
    found = statistics.paired_median([-1.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 0.0])
    assert (found.up, found.down) == (8, 1)
    assert found.p == pytest.approx(2.0 * (1 + 9) / 2**9)
    assert found.difference == statistics.median([-1.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 0.0])


def test_a_mean_difference_is_bootstrapped_the_same_way_each_time() -> None:
    differences = [0, 0, 1, 0, 2, 0, 0, -1, 1, 0, 0, 3]
    found = statistics.paired_mean(differences, scale=10.0)
    assert found == statistics.paired_mean(differences, scale=10.0)
    assert found.difference.value == pytest.approx(5.0)
    assert found.difference.low < 5.0 < found.difference.high
    assert math.isnan(statistics.paired_mean([0.0, 0.0]).difference.low)

"""Statistics of a campaign, beside published values and definitions."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from massprop_drake.inputs.campaign_file import load_campaign
from massprop_drake.studies.campaign import statistics
from massprop_drake.studies.campaign.plan import sample_coordinates
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


def test_a_share_has_the_interval_of_clopper_and_pearson() -> None:
    assert interval(statistics.share(0, 10)) == pytest.approx((0.0, 0.3085), abs=5e-5)
    assert interval(statistics.share(1, 10)) == pytest.approx((0.0025, 0.4450), abs=5e-5)
    for k in range(13):
        exact = stats.binomtest(k, 12).proportion_ci(0.95, method="exact")
        assert interval(statistics.share(k, 12)) == pytest.approx((exact.low, exact.high), abs=1e-12)
    assert math.isnan(statistics.share(0, 0).value)


def test_values_that_go_together_count_as_one() -> None:
    # thirty cases, ten values each that are all alike
    together = statistics.clustered_share([10] * 24 + [0] * 6, [10] * 30)
    assert together.value == 0.8
    assert together.n == 300
    assert interval(together) == pytest.approx(interval(statistics.share(24, 30)), abs=0.02)
    assert together.high - together.low > 2.5 * (statistics.share(240, 300).high - statistics.share(240, 300).low)


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


def test_a_curve_says_nothing_of_times_that_nobody_saw() -> None:
    curve = statistics.detection_curve(RELAPSED, CENSORED)
    beyond = curve.at(36.0)
    assert math.isnan(beyond.value)
    assert interval(beyond) == (curve.low[-1], 1.0)
    assert curve.at(35.0).value == curve.found[-1]
    assert statistics.detection_curve([1.0, 2.0], []).at(30.0).value == 1.0  # all have been found before
    assert math.isnan(statistics.detection_curve([], [4.0]).at(5.0).value)
    assert statistics.detection_curve([], [4.0]).at(3.0).value == 0.0


# -------------------------------------------------------------------------------------- consistency


def test_the_band_of_a_mean_is_that_of_the_textbook() -> None:
    # Bar-Shalom, Li and Kirubarajan (2001), 5.4.2: 50 runs, two states
    assert statistics.mean_band(2, 50) == pytest.approx((1.5, 2.6), abs=0.02)


# -------------------------------------------------------------------------------------------- sizes


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


def test_sobol_indices_of_ishigamis_function_from_a_plan(tmp_path: Path) -> None:
    keys = ("detector.margin", "detector.threshold", "plant.thrust_dispersion")
    draw = {key: {"uniform": {"low": 0.1, "high": 0.2}} for key in keys}
    text = f"base: sample_maneuver\ncases: {5 * 1024}\nmethod: saltelli\nseed: 2\ndraw: {draw}\n"
    (tmp_path / "c.yaml").write_text(text)
    points = math.pi * (2.0 * sample_coordinates(load_campaign(tmp_path / "c.yaml")) - 1.0)
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


def test_a_mean_difference_is_bootstrapped_the_same_way_each_time() -> None:
    differences = [0, 0, 1, 0, 2, 0, 0, -1, 1, 0, 0, 3]
    found = statistics.paired_mean(differences, scale=10.0)
    assert found == statistics.paired_mean(differences, scale=10.0)
    assert found.difference.value == pytest.approx(5.0)
    assert found.difference.low < 5.0 < found.difference.high
    assert math.isnan(statistics.paired_mean([0.0, 0.0]).difference.low)

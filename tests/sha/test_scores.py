"""Scores against their definitions, intervals against exact probabilities."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import ndtr, ndtri
from scipy.stats import binom, chi2

from sim import scores


@pytest.mark.parametrize(("mean", "sigma", "outcome"), [(0.0, 1.0, 0.3), (50.0, 2.0, 57.0), (-3.0, 0.1, -3.0)])
def test_gaussian_crps_is_the_integral_of_its_definition(mean: float, sigma: float, outcome: float) -> None:
    x = np.linspace(mean - 12 * sigma, max(mean, outcome) + 12 * sigma, 400_001)
    squared = (ndtr((x - mean) / sigma) - (x >= outcome)) ** 2
    assert float(scores.crps_gaussian(mean, sigma, outcome)) == pytest.approx(np.trapezoid(squared, x), rel=1e-3)


def test_crps_of_a_number_is_its_absolute_error() -> None:
    assert scores.crps_gaussian([20.0, 20.0], 0.0, [23.0, 19.0]).tolist() == [3.0, 1.0]
    assert scores.crps_sample([[20.0]], [23.0]).tolist() == [3.0]
    assert scores.crps_quantiles([0.5], [[20.0]], [23.0]).tolist() == [3.0]


@given(st.lists(st.floats(-100, 100), min_size=1, max_size=12), st.floats(-100, 100))
def test_sample_crps_is_mean_distance_less_half_the_mean_difference(samples: list[float], outcome: float) -> None:
    x = np.array(samples)
    expected = np.abs(x - outcome).mean() - 0.5 * np.abs(x[:, None] - x[None, :]).mean()
    assert float(scores.crps_sample(x, outcome)) == pytest.approx(expected, abs=1e-9)


def test_a_fine_fan_has_the_crps_of_its_law_and_five_levels_are_3_percent_low() -> None:
    outcome = np.random.default_rng(1).standard_normal(20_000)
    exact = float(scores.crps_gaussian(0.0, 1.0, outcome).mean())
    fine = (np.arange(400) + 0.5) / 400
    five = np.array([0.05, 0.25, 0.5, 0.75, 0.95])
    assert float(scores.crps_quantiles(fine, ndtri(fine), outcome).mean()) == pytest.approx(exact, rel=2e-3)
    assert float(scores.crps_quantiles(five, ndtri(five), outcome).mean()) / exact == pytest.approx(0.97, abs=0.01)


def test_the_fan_that_is_right_scores_best() -> None:
    outcome = np.random.default_rng(2).normal(3.0, 2.0, 20_000)
    best = scores.crps_gaussian(3.0, 2.0, outcome).mean()
    for mean, sigma in ((3.0, 1.0), (3.0, 4.0), (2.0, 2.0)):
        assert scores.crps_gaussian(mean, sigma, outcome).mean() > best
        assert scores.log_score_gaussian(mean, sigma, outcome).mean() > scores.log_score_gaussian(3, 2, outcome).mean()


def test_levels_that_do_not_ascend_inside_the_unit_interval_are_refused() -> None:
    for levels in ([], [0.5, 0.5], [0.0, 0.5], [0.5, 1.0]):
        with pytest.raises(ValueError, match="ascend inside"):
            scores.crps_quantiles(levels, np.zeros(len(levels)), 0.0)


def test_coverage_leaves_out_what_was_not_measured() -> None:
    assert scores.coverage([0.0, 0.0, 0.0], [1.0, 1.0, 1.0], [0.5, 2.0, np.nan]) == 0.5
    assert np.isnan(scores.coverage([0.0], [1.0], [np.nan]))


def test_brier_of_half_is_a_quarter() -> None:
    assert scores.brier([0.5, 0.5], [0.0, 1.0]) == 0.25
    assert scores.brier([1.0, 0.0], [1.0, 0.0]) == 0.0


def test_pit_is_uniform_for_the_right_law() -> None:
    outcome = np.random.default_rng(3).normal(10.0, 2.0, 10_000)
    counts, _ = np.histogram(scores.pit_gaussian(10.0, 2.0, outcome), bins=10, range=(0, 1))
    assert chi2.sf(((counts - 1000.0) ** 2 / 1000.0).sum(), 9) > 1e-4
    assert scores.pit_sample([1.0, 2.0, 3.0, 4.0], 2.0) == 0.375


def test_clopper_pearson_has_its_known_answers() -> None:
    none = scores.clopper_pearson(0, 29, level=0.90)
    assert (none.probability, none.low) == (0.0, 0.0)
    assert none.high == pytest.approx(0.0981446, abs=1e-7)
    assert scores.clopper_pearson(29, 29, level=0.90).low == pytest.approx(1 - 0.0981446, abs=1e-7)
    for bad in ((-1, 5), (6, 5), (0, 0)):
        with pytest.raises(ValueError, match="no binomial interval"):
            scores.clopper_pearson(*bad)


@pytest.mark.parametrize("p", [0.01, 0.1, 0.5, 0.93])
def test_clopper_pearson_covers_at_least_what_it_says(p: float) -> None:
    intervals = [scores.clopper_pearson(k, 40) for k in range(41)]
    covered = sum(binom.pmf(k, 40, p) for k, each in enumerate(intervals) if each.low <= p <= each.high)
    assert covered >= 0.95


def test_surprise_is_minus_log10_of_the_chi_square_tail_and_ends_at_99() -> None:
    assert scores.surprise(float(chi2.isf(0.001, 30)), 30) == pytest.approx(3.0)
    assert scores.surprise(0.0, 30) == 0.0
    for far in (1e4, 1e300, float("inf")):
        assert scores.surprise(far, 30) == 99.0


def test_block_bootstrap_sees_correlation_that_single_rows_hide() -> None:
    rng = np.random.default_rng(4)
    series = np.zeros(4000)
    for row in range(1, series.size):
        series[row] = 0.9 * series[row - 1] + rng.standard_normal()
    low, high = scores.block_bootstrap(series, 100, 2000, np.random.default_rng(5))
    single = scores.block_bootstrap(series, 1, 2000, np.random.default_rng(5))
    # Standard error of the mean of this AR(1): 10 / sqrt(4000); as if independent: 2.29 / sqrt(4000).
    assert (high - low) / (2 * 1.96) == pytest.approx(10 / np.sqrt(4000), rel=0.3)
    assert (single[1] - single[0]) / (2 * 1.96) == pytest.approx(2.29 / np.sqrt(4000), rel=0.15)
    assert low < series.mean() < high
    with pytest.raises(ValueError, match="no block bootstrap"):
        scores.block_bootstrap([], 1, 10, rng)

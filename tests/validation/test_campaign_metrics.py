"""Intervals that hold for correlated errors, and a band that is judged as it should be."""

import numpy as np
import pytest

from sim.lab.judge import metrics
from sim.lab.judge.metrics import block_length, judge_band, mae_interval, rmse_interval
from sim.scores import block_bootstrap, crps_gaussian
from sim.sha.trace import Array


def autoregressive(rho: float, size: int, rng: np.random.Generator) -> Array:
    """A stationary AR(1) series of variance 1."""
    shocks = np.sqrt(1 - rho**2) * rng.normal(size=size)
    series = np.empty(size)
    series[0] = rng.normal()
    for row in range(1, size):
        series[row] = rho * series[row - 1] + shocks[row]
    return series


def test_the_block_grows_with_the_correlation() -> None:
    rng = np.random.default_rng(1)
    lengths = [np.median([block_length(autoregressive(rho, 1000, rng)) for _ in range(20)]) for rho in (0.0, 0.5, 0.95)]
    assert lengths[0] <= 3 < lengths[1] < lengths[2]


def test_the_block_of_an_ar1_series_is_near_its_theoretical_optimum() -> None:
    """Patton, Politis & White (2009): b = (2 G^2 / D)^(1/3) n^(1/3), G = 2 rho / (1 - rho)^2 times 1 - rho^2."""
    rho, n, rng = 0.8, 20_000, np.random.default_rng(2)
    slope = 2 * rho / (1 - rho) ** 2
    level = (1 + rho) / (1 - rho)
    optimum = (1.5 * (slope / level) ** 2 * n) ** (1 / 3)
    found = np.median([block_length(autoregressive(rho, n, rng)) for _ in range(9)])
    assert found == pytest.approx(optimum, rel=0.25)


@pytest.mark.parametrize("values", [np.full(50, 3.0), np.zeros(50), np.array([1.0]), np.arange(3.0)])
def test_a_series_without_variation_or_length_has_blocks_of_one(values: Array) -> None:
    assert block_length(values) == 1


def test_a_block_is_at_most_a_third_of_the_series() -> None:
    assert block_length(np.linspace(0.0, 1.0, 90)) <= 30


def test_the_interval_covers_the_mean_of_correlated_errors_where_single_rows_would_not() -> None:
    rng = np.random.default_rng(3)
    true = np.sqrt(2 / np.pi)  # the mean of |N(0, 1)|
    ours = alone = 0
    for _ in range(150):
        errors = autoregressive(0.9, 800, rng)
        found = mae_interval(errors, rng)
        low, high = block_bootstrap(np.abs(errors), 1, 400, rng)
        ours += found.low <= true <= found.high
        alone += low <= true <= high
    assert ours >= 125 and alone <= 105


def test_few_readings_have_a_value_and_no_interval() -> None:
    found = rmse_interval(np.array([1.0, -1.0, 2.0]), np.random.default_rng(0))
    assert found.value == pytest.approx(np.sqrt(2.0)) and np.isnan([found.low, found.high]).all()


def test_the_value_lies_in_its_interval() -> None:
    errors = autoregressive(0.7, 500, np.random.default_rng(5))
    for interval in (mae_interval(errors, np.random.default_rng(0)), rmse_interval(errors, np.random.default_rng(0))):
        assert 0 < interval.low < interval.value < interval.high


def test_readings_from_the_law_are_covered_scored_and_beyond_three_sigma_as_the_law_says(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(metrics, "MAX_SORTED_VALUES", 7 * 2000)  # several parts, the last one shorter
    rng = np.random.default_rng(6)
    means = np.linspace(20.0, 60.0, 3000)
    readings = means + rng.normal(0.0, np.hypot(0.8, 0.6), size=means.size)
    rows = means[:, None] + 0.8 * rng.standard_normal((means.size, 2000))
    band, found = judge_band(rows, readings, 0.6, rng)
    assert found.coverage == pytest.approx(0.9, abs=0.02)
    assert found.crps == pytest.approx(float(crps_gaussian(means, 1.0, readings).mean()), rel=0.01)
    assert found.beyond == pytest.approx(0.0027, abs=0.003)
    assert band.mean == pytest.approx(means, abs=0.15) and band.sigma == pytest.approx(1.0, abs=0.1)
    assert np.all(band.high - band.low == pytest.approx(2 * 1.645, rel=0.15))


def test_a_long_series_is_resampled_in_bounded_memory() -> None:
    errors = np.random.default_rng(7).normal(size=1_000_000)
    found = mae_interval(errors, np.random.default_rng(0))
    assert found.low < np.sqrt(2 / np.pi) < found.high

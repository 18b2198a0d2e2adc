"""The local trend: it finds its smoothing as it runs, looks at nothing ahead, and says how far off it was."""

from math import inf

import numpy as np
import pytest

from sim.engine.belief import observe, start
from sim.engine.tracker import compile_model
from sim.forecast.fan import FAN_LEVELS, forecast
from sim.forecast.local_trend import LocalOutlook, LocalTrend, walk_outlook
from sim.sha import Array
from sim.sha.model import PlainMember, plain_model
from tests.gateway.support import two_modes

HORIZONS = (60.0, 300.0)


def follow(readings: Array) -> LocalTrend:
    trend = LocalTrend(HORIZONS, 1.0)
    for second, reading in enumerate(readings.tolist()):
        trend.take(float(second), reading)
    return trend


def outlook_of(readings: Array) -> LocalOutlook:
    outlook = follow(readings).look_ahead()
    assert outlook is not None
    return outlook


def test_a_steady_rise_is_followed_and_a_walk_is_not() -> None:
    seconds = np.arange(1800.0)
    rise = outlook_of(30.0 + 0.01 * seconds)
    assert rise.mean == pytest.approx(rise.reading + 0.01 * np.array(HORIZONS), abs=0.5)
    walk = np.cumsum(np.random.default_rng(3).normal(0.0, 0.05, 1800))
    drift = outlook_of(walk)
    assert abs(drift.mean[0] - drift.reading) < drift.sigma[0]
    assert drift.sigma[1] == pytest.approx(drift.sigma[0] * np.sqrt(5.0), rel=0.6), "as a walk's"


def test_a_slope_is_followed_no_further_than_it_was_seen_to_hold() -> None:
    trend = LocalTrend((60.0, 900.0), 1.0)
    for second in range(1900):
        trend.take(float(second), 30.0 + 0.01 * second)
        if second == 599:
            early = trend.look_ahead()
    late = trend.look_ahead()
    assert early is not None and late is not None
    assert early.mean[0] == pytest.approx(early.reading + 0.6, abs=0.1)
    assert early.mean[1] == early.mean[0] and early.sigma[1] > 3.0 * early.sigma[0]
    assert late.mean[1] > late.reading + 4.5, "by now it was seen to hold so long"


def test_noise_about_a_level_is_averaged() -> None:
    noise = np.random.default_rng(4).normal(0.0, 1.0, 1800)
    assert abs(outlook_of(noise).mean[0]) < 1.0
    assert outlook_of(noise).sigma[0] < 1.3, "persistence would err by 1.4"


def test_what_comes_later_changes_nothing() -> None:
    readings = np.cumsum(np.random.default_rng(5).normal(0.0, 0.05, 900))
    trend = LocalTrend(HORIZONS, 1.0)
    said = []
    for second, reading in enumerate(readings.tolist()):
        trend.take(float(second), reading)
        said.append(trend.look_ahead())
    known = said[599]
    assert known is not None
    assert np.array_equal(known.mean, outlook_of(readings[:600]).mean)


def test_it_says_nothing_at_first_without_readings_and_after_a_gap() -> None:
    readings = np.full(600, 40.0)
    assert follow(readings[:30]).look_ahead() is None
    trend = follow(readings)
    assert trend.look_ahead() is not None
    for second in range(600, 700):
        trend.take(float(second), float("nan"))
    assert trend.look_ahead() is None
    trend.take(10_000.0, 40.0)
    assert trend.look_ahead() is None, "it has begun anew"


def test_the_limit_is_reached_as_by_a_walk_with_a_drift() -> None:
    """Against simulated walks."""
    outlook = LocalOutlook(0.0, 50.0, np.array([60.0, 300.0]), np.array([51.0, 55.0]), np.array([1.0, 2.0]))
    made = outlook.forecast(np.ones(2), limit=54.0, levels=FAN_LEVELS)
    steps = np.random.default_rng(6).normal(5.0 / 4000, 2.0 / np.sqrt(4000), (2000, 4000))
    reached = float(np.mean(np.cumsum(steps, axis=1).max(axis=1) >= 4.0))
    assert made.exceedance[1].probability == pytest.approx(reached, abs=0.04)
    assert made.exceedance[0].probability < made.exceedance[1].probability
    assert made.quantiles[:, 0] == pytest.approx(51.0 + np.array([-1.645, -0.674, 0.0, 0.674, 1.645]), abs=1e-3)
    assert made.minutes_to_limit[1] < 5.0 < made.minutes_to_limit[2]
    there = outlook.forecast(np.ones(2), limit=50.0, levels=FAN_LEVELS)
    assert there.exceedance[0].probability == 1.0 and there.minutes_to_limit == (0.0, 0.0, 0.0)
    assert outlook.forecast(np.ones(2), limit=inf, levels=FAN_LEVELS).exceedance[1].probability == 0.0


def test_a_walk_says_what_its_runs_do() -> None:
    tracker = compile_model(plain_model(two_modes(), PlainMember("persistence", 0.0, 0.1)))
    belief = observe(tracker, start(tracker, 0.0), 0.0, 50.0)
    outlook, factors = walk_outlook(tracker, belief, HORIZONS), {60.0: 1.5, 300.0: 1.5}
    assert outlook is not None
    made = outlook.forecast(np.full(2, 1.5), limit=52.0, levels=FAN_LEVELS)
    drawn = forecast(
        tracker, belief, HORIZONS, np.random.default_rng(0), limit=52.0, runs=4000, events=(), calibration=factors
    )
    np.testing.assert_allclose(made.quantiles, drawn.quantiles, atol=1e-9)
    for ours, theirs in zip(made.exceedance, drawn.exceedance, strict=True):
        assert theirs.low - 0.01 < ours.probability < theirs.high + 0.01
    assert made.minutes_to_limit == pytest.approx(drawn.minutes_to_limit, rel=0.1)
    trend = compile_model(plain_model(two_modes(), PlainMember("damped trend", 0.0, 0.1, heat=0.01, memory=100.0)))
    assert walk_outlook(trend, belief, HORIZONS) is None

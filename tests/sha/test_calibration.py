"""Online recalibration: wrong bands become right, right ones stay, and nothing grows without bound."""

import numpy as np
import pytest
from scipy.special import ndtri

from sim.forecast.calibration import (
    LEAST_FACTOR,
    MOST_FACTOR,
    Calibration,
    calibrate,
    factor,
    factors,
    issue,
    recent_coverage,
    reshape,
    settle,
)
from sim.forecast.fan import FAN_LEVELS, Forecast
from sim.scores import Estimate

HORIZON = 20.0


def fan(time: float, median: float, sigma: float, widening: float = 1.0, horizon: float = HORIZON) -> Forecast:
    """A Gaussian fan for one horizon, whose issued band is `widening` times as wide as `sigma` says."""
    return Forecast(
        time=time,
        horizons=np.array([horizon]),
        levels=FAN_LEVELS,
        quantiles=(median + widening * sigma * ndtri(FAN_LEVELS))[:, None],
        locations=({"q": 1.0},),
        limit=80.0,
        exceedance=(Estimate(0.0, 0.0, 1.0, 10),),
        minutes_to_limit=(np.inf, np.inf, np.inf),
        runs=10,
        factors=np.array([widening]),
    )


def coverage_of(truth: float, prior: float, seed: int, seconds: int = 12_000) -> tuple[float, Calibration]:
    """Coverage of the recalibrated band over the last three quarters of a random walk forecast every second.

    The fan says that the walk's deviation over the horizon is 1; it is `truth`. Errors of neighbours overlap.
    """
    rng = np.random.default_rng(seed)
    walk = np.cumsum(rng.standard_normal(seconds + 1)) * truth / np.sqrt(HORIZON)
    state, issued, inside = calibrate({HORIZON: prior}), {}, []
    for second in range(seconds):
        state = settle(state, float(second), float(walk[second]))
        band = issued.pop(second, None)
        if band is not None and second > seconds / 4:
            inside.append(abs(walk[second] - band[0]) <= 1.6449 * band[1])
        now = factor(state, HORIZON)
        state = issue(state, fan(float(second), float(walk[second]), 1.0, now))
        issued[second + int(HORIZON)] = (walk[second], now)
    return float(np.mean(inside)), state


@pytest.mark.parametrize(("truth", "prior"), [(3.0, 1.0), (0.4, 1.0), (1.0, 1.0), (2.0, 2.0)])
def test_the_90_percent_band_comes_to_cover_90_percent_whatever_the_fan_says(truth: float, prior: float) -> None:
    coverage, state = coverage_of(truth, prior, seed=1)
    # 450 independent forecasts: a standard error of 1.4 %.
    assert coverage == pytest.approx(0.90, abs=0.04)
    assert factor(state, HORIZON) == pytest.approx(truth, rel=0.35)
    assert len(state.horizons[HORIZON].pending) <= HORIZON + 1


def test_a_band_that_is_right_is_left_alone() -> None:
    _, state = coverage_of(1.0, 1.0, seed=2, seconds=4000)
    assert 0.8 < factor(state, HORIZON) < 1.25


def test_without_evidence_the_factor_is_the_models_own() -> None:
    state = calibrate({60.0: 1.0, 900.0: 1.7})
    assert factors(state) == {60.0: 1.0, 900.0: 1.7}
    assert factors(calibrate({60.0: 50.0})) == {60.0: MOST_FACTOR}


def test_a_longer_horizon_begins_with_what_the_shorter_one_has_learned_of_the_day() -> None:
    state = calibrate({HORIZON: 1.0, 900.0: 1.5})
    for step in range(30):
        time = HORIZON * step
        state = settle(issue(state, fan(time, 30.0, 1.0)), time + HORIZON, 30.0 + (4.0 if step % 2 else -4.0))
    own = factors(state, integral=False)
    assert own[HORIZON] > 2.0
    assert own[900.0] == pytest.approx(1.5 * own[HORIZON]), "none of its own have matured"
    assert factor(state, 900.0) == pytest.approx(own[900.0]), "the shorter one's misses are its own"


def test_many_forecasts_of_one_moment_weigh_as_one() -> None:
    state = calibrate({HORIZON: 1.0})
    for step in range(100):
        state = issue(state, fan(0.01 * step, 30.0, 1.0))
    for step in range(100):
        state = settle(state, HORIZON + 0.01 * step, 36.0)
    one = state.horizons[HORIZON]
    assert one.matured == 100
    assert one.worth == pytest.approx(1.0, abs=0.06)
    # log 3.6 (or so) with weight 1 against 0 with weight 4, and the integral part of one missed band
    assert 1.2 < factor(state, HORIZON) < 1.6


def test_what_was_widened_already_is_not_widened_twice() -> None:
    plain, wide = calibrate({HORIZON: 1.0}), calibrate({HORIZON: 1.0})
    for step in range(50):
        time = HORIZON * step
        plain = settle(issue(plain, fan(time, 30.0, 1.0)), time + HORIZON, 32.0)
        wide = settle(issue(wide, fan(time, 30.0, 1.0, widening=2.5)), time + HORIZON, 32.0)
    assert wide.horizons[HORIZON].counts == pytest.approx(plain.horizons[HORIZON].counts)
    # The wide bands held what the narrow ones missed: the integral part is about what was published.
    assert wide.horizons[HORIZON].shift < plain.horizons[HORIZON].shift


def test_the_band_recovers_after_a_jump_of_the_regime_and_says_how_it_held() -> None:
    """White errors whose size trebles: 9 of 10 hold again within 40 independent forecasts, as the state says itself."""
    rng = np.random.default_rng(5)
    state, held = calibrate({HORIZON: 1.0}), []
    for step in range(400):
        time, size = HORIZON * step, 3.0 if step >= 200 else 1.0
        now = factor(state, HORIZON)
        error = size * float(rng.standard_normal())
        held.append(abs(error) <= 1.6449 * now)
        state = settle(issue(state, fan(time, 30.0, 1.0, widening=now)), time + HORIZON, 30.0 + error)
    assert np.mean(held[40:200]) == pytest.approx(0.9, abs=0.05)
    assert np.mean(held[240:]) == pytest.approx(0.9, abs=0.05)
    said = recent_coverage(state, HORIZON)
    assert said is not None and said == pytest.approx(float(np.mean(held[-60:])), abs=0.06)
    assert recent_coverage(calibrate({HORIZON: 1.0}), HORIZON) is None


def test_factors_stay_in_their_bounds() -> None:
    far, near = calibrate({HORIZON: 1.0}, weight=0.0), calibrate({HORIZON: 1.0}, weight=0.0)
    flat = calibrate({HORIZON: 1.0}, weight=0.0)
    for step in range(30):
        time = HORIZON * step
        far = settle(issue(far, fan(time, 30.0, 1.0)), time + HORIZON, 500.0)
        near = settle(issue(near, fan(time, 30.0, 1.0)), time + HORIZON, 30.0)
        flat = settle(issue(flat, fan(time, 30.0, 0.0)), time + HORIZON, 31.0)
    assert factor(far, HORIZON) == factor(flat, HORIZON) == MOST_FACTOR
    assert factor(near, HORIZON) == LEAST_FACTOR


def test_a_reading_that_never_comes_is_missed_and_forgotten() -> None:
    state = issue(calibrate({HORIZON: 1.0}, tolerance=5.0), fan(0.0, 30.0, 1.0))
    assert settle(state, 19.0, 35.0) == state
    waiting = settle(state, 22.0, float("nan"))
    assert len(waiting.horizons[HORIZON].pending) == 1
    assert settle(waiting, 24.0, 35.0).horizons[HORIZON].matured == 1
    late = settle(waiting, 26.0, 35.0).horizons[HORIZON]
    assert (late.matured, late.missed, late.pending) == (0, 1, ())
    unread = state
    for step in range(1, 500):
        unread = issue(unread, fan(float(step), 30.0, 1.0))
    assert len(unread.horizons[HORIZON].pending) <= HORIZON + 7


def test_horizons_that_are_not_calibrated_are_left_out() -> None:
    state = calibrate({HORIZON: 1.0})
    assert issue(state, fan(0.0, 30.0, 1.0, horizon=60.0)) == state


def test_bad_settings_are_refused() -> None:
    for bad in ({"horizons": {60.0: 0.0}}, {"horizons": {60.0: 1.0}, "memory": 0.0}):
        with pytest.raises(ValueError, match="must be positive"):
            calibrate(**bad)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="at least 0"):
        calibrate({60.0: 1.0}, weight=-1.0)


def settled(errors: list[float]) -> Calibration:
    """The state after forecasts of 0 +- 1 that did not overlap, and that were so far off."""
    state = calibrate({HORIZON: 1.0})
    for number, error in enumerate(errors):
        state = issue(state, fan(number * HORIZON, 0.0, 1.0))
        state = settle(state, (number + 1) * HORIZON, error)
    return state


def test_a_temperature_that_mostly_stands_still_gets_a_peak_about_the_same_90_percent_band() -> None:
    state = settled(([0.001] * 8 + [1.7, -1.7]) * 20)
    made = fan(0.0, 0.0, 1.0)
    shaped = reshape(made, state)
    low, lower, median, upper, high = shaped.quantiles[:, 0].tolist()
    assert (low, median, high) == tuple(made.quantiles[[0, 2, 4], 0].tolist())
    assert -0.05 < lower < 0.0 < upper < 0.05, "half of the outcomes were hardly off at all"


def test_gaussian_outcomes_leave_the_fan_as_it_is_and_so_do_none() -> None:
    made = fan(0.0, 0.0, 1.0)
    assert np.array_equal(reshape(made, calibrate({HORIZON: 1.0})).quantiles, made.quantiles)
    assert reshape(made, settled(np.random.default_rng(2).standard_normal(400).tolist())).quantiles == pytest.approx(
        made.quantiles, abs=0.2
    )


def test_a_longer_horizon_begins_with_all_of_what_widens_and_half_of_what_narrows() -> None:
    for error, part in ((4.0, 1.0), (0.2, 0.5)):
        state = calibrate({HORIZON: 1.0, 5 * HORIZON: 1.0})
        for number in range(200):
            state = issue(state, fan(number * HORIZON, 0.0, 1.0))
            state = settle(state, (number + 1) * HORIZON, error)
        short, long = factors(state, integral=False).values()
        assert np.log(long) == pytest.approx(part * np.log(short))

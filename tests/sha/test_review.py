"""The 3-sigma review: quiet under a right model, raised by a wrong one, no chatter; clamps of a belief are counted."""

from dataclasses import replace

import numpy as np
import pytest

from sim.engine.belief import advance, filter_trace, observe, start
from sim.engine.open_loop_run import open_loop
from sim.forecast.calibration import calibrate, issue, settle
from sim.forecast.fan import forecast
from sim.forecast.review import FORECASTS, ONE_STEP, Review, follow, follow_forecasts, review_errors, share, standardise
from sim.sha.automaton import Distribution
from sim.sha.trace import Trace
from tests.sha.plants import exponential_stays, relaxing, simulate_two, single, two_states


def followed(z: np.ndarray, review: Review | None = None) -> tuple[Review, int]:
    """The review after all of z, and how often its flag changed."""
    review, changes = review or Review(), 0
    for second, one in enumerate(z):
        after = follow(ONE_STEP, review, float(second), float(one))
        changes += after.flagged is not review.flagged
        review = after
    return review, changes


def test_a_right_model_is_not_flagged_in_a_hundred_thousand_readings_and_its_share_is_a_gaussians() -> None:
    review, changes = followed(np.random.default_rng(1).standard_normal(100_000))
    assert changes == 0 and not review.flagged
    assert review.beyond / review.readings == pytest.approx(0.0027, abs=0.0006)


def test_a_glitch_of_three_readings_raises_nothing_and_ten_in_a_row_do() -> None:
    calm = np.zeros(50)
    glitch, _ = followed(np.concatenate([calm, np.full(3, 9.0), calm]))
    assert not glitch.flagged and glitch.longest == 3.0
    run, changes = followed(np.concatenate([calm, np.full(10, -4.0)]))
    assert run.flagged and changes == 1 and run.since == 59.0 and run.run == 10.0


def test_a_share_between_the_thresholds_changes_nothing_so_the_flag_does_not_chatter() -> None:
    rng = np.random.default_rng(2)
    # 5 % of the readings beyond, the very threshold of raising: without hysteresis the flag would come and go.
    z = np.where(rng.random(20_000) < 0.05, 4.0, 0.0)
    review, changes = followed(z)
    assert changes == 1 and review.flagged
    cleared, more = followed(np.zeros(600), review)
    assert more == 1 and not cleared.flagged


def test_a_reading_without_a_number_is_no_evidence() -> None:
    assert follow(ONE_STEP, Review(), 1.0, float("nan")) == Review()


def test_overlapping_forecasts_are_one_surprise_and_lasting_ones_raise_the_flag() -> None:
    model = two_states(exponential_stays(), sensor=0.1)
    made = forecast(model, start(model, 0.0, 30.0), [60.0], np.random.default_rng(1))
    state, review = calibrate({60.0: 1.0}), Review()
    flagged = []
    for second in range(0, 400, 5):
        state = issue(state, replace(made, time=float(second)))
        review = follow_forecasts(review, state, 60.0, float(second), 300.0)
        state = settle(state, float(second), 300.0)
        flagged.append(review.flagged)
    first = flagged.index(True) * 5.0
    assert 60.0 + 55.0 <= first <= 60.0 + 65.0, "two horizons' worth: the first forecast and 60 s more"
    assert share(FORECASTS, review) == pytest.approx(review.outside / 60.0)


def test_an_open_loop_of_the_wrong_model_is_to_be_reviewed_and_of_the_right_one_is_not() -> None:
    right = two_states(exponential_stays(), sensor=0.1)
    trace, _ = simulate_two(right, 900, np.random.default_rng(4))
    good = review_errors(*standardise(open_loop(right, trace, "resync"), trace, right))
    assert not good.review and good.share < 0.05 and good.readings == 900
    moved = replace(trace, signals={"T": trace.signals["T"] + np.where(trace.times > 300, 25.0, 0.0)})
    bad = review_errors(*standardise(open_loop(right, moved, "resync"), moved, right))
    assert bad.review and bad.share > 0.5 and bad.run > 100 and bad.run_seconds >= bad.run - 1


def test_the_longest_run_is_told_in_readings_and_seconds() -> None:
    z = np.array([0.0, 4.0, 4.0, np.nan, -5.0, 0.0, 3.5])
    found = review_errors(np.arange(7.0) * 10.0, z)
    assert (found.readings, found.run, found.run_seconds) == (6, 3, 30.0)
    assert found.share == pytest.approx(4 / 6)


def test_a_belief_that_leaves_the_range_is_put_back_and_counted_and_a_reading_is_believed() -> None:
    hot = single(relaxing(0.05, 0.01), Distribution("normal", {"mu": 300.0, "sigma": 0.1}), sensor=0.1)
    belief = advance(hot, start(hot, 0.0, 140.0), 100.0)
    assert (belief.x, belief.clamps) == (150.0, 1)
    read = observe(hot, belief, 101.0, 152.0)
    assert read.clamps == 2 and read.last is not None and read.last.value == pytest.approx(2.0)
    times = np.arange(0.0, 50.0, 1.0)
    calm = filter_trace(two_states(), Trace("t", times, {"T": np.full(50, 25.0)}))
    assert calm.belief.clamps == 0

"""A forecast held against what was measured after like moments: which count, from how many on, and what is kept."""

import json
from collections.abc import Iterator

import numpy as np
import pytest

from sim.forecast import LikeMoments
from sim.forecast.past_readings import MIN_MOMENTS

HOUR, STAY, HORIZON = 3600.0, 400.0, 60.0


def days(readings: list[float], begin: float = 0.0) -> Iterator[tuple[float, str, float]]:
    """Scans every 20 s: each hour the machine runs for STAY s and reads the hour's value then, else 20 degC."""
    for hour, value in enumerate(readings):
        for time in np.arange(0.0, HOUR, 20.0).tolist():
            on = time < STAY
            yield begin + hour * HOUR + time, "on" if on else "off", value if on else 20.0


def followed(readings: list[float], like: LikeMoments | None = None, begin: float = 0.0) -> LikeMoments:
    """What is known after these hours, and at the beginning of one more stay."""
    found = like or LikeMoments((HORIZON,), 0.05, 5.0)
    for time, location, value in days(readings, begin):
        found.follow(time, location, value)
    found.follow(begin + len(readings) * HOUR, "on", None)
    return found


def readings(count: int) -> list[float]:
    return [60.0 + 2.0 * float(value) for value in np.random.default_rng(1).standard_normal(count)]


def test_a_median_beyond_three_deviations_of_what_came_after_like_moments_is_flagged() -> None:
    # Of the first stay nobody saw the beginning.
    values = readings(MIN_MOMENTS + 1)
    mean, sigma = float(np.mean(values[1:])), float(np.std(values[1:], ddof=1))
    like, now = followed(values), len(values) * HOUR
    for off, flagged in ((0.0, False), (2.9, False), (3.1, True), (-3.1, True)):
        (held,) = like.hold(now, {HORIZON: mean + off * sigma})
        assert held is not None and held.flagged is flagged and held.moments == MIN_MOMENTS
        assert (held.mean, held.sigma, held.deviations) == pytest.approx((mean, sigma, off))
    # What is usual while the machine runs says nothing of one that stands: begun before the rest, it is of the run.
    like.follow(now + 380.0, "on", None)
    like.follow(now + STAY, "off", None)
    (run,), (rest,) = (like.hold(now + begun, {HORIZON: 60.0}) for begun in (390.0, STAY))
    assert run is not None and not run.flagged and run.mean > 30.0
    assert rest is not None and rest.flagged and rest.mean == pytest.approx(20.0)
    assert rest.sigma == 0.05, "of the sensor, where nothing varies"


def test_on_ordinary_days_what_really_comes_is_hardly_ever_flagged_and_a_hot_bearing_is() -> None:
    """A stay's first moments said nothing of its later ones: a machine that had cooled was flagged all night."""
    horizons, rng = (300.0, 900.0), np.random.default_rng(0)
    rows, warm = list[tuple[float, str, float]](), 20.0
    for time in np.arange(0.0, 30 * 86_400.0, 60.0).tolist():
        on = time % 43_200.0 < 14_400.0
        if time % 43_200.0 == 0.0:
            heated = 60.0 + 2.0 * rng.standard_normal()
        warm += ((heated if on else 20.0) - warm) * 60.0 / 3600.0
        rows.append((time, "on" if on else "off", warm + 0.1 * rng.standard_normal()))
    like, found = LikeMoments(horizons, 0.1, 5.0), dict[float, list[bool]]()
    for at, (time, location, value) in enumerate(rows[:-15]):
        like.follow(time, location, value)
        for hotter in (0.0, 15.0) if at % 10 == 0 else ():
            held = like.hold(time, {each: rows[at + int(each / 60.0)][2] + hotter for each in horizons})
            found.setdefault(hotter, []).extend(each.flagged for each in held if each is not None)
    assert len(found[0.0]) > 4000
    assert np.mean(found[0.0]) < 0.02 and np.mean(found[15.0]) > 0.5, {at: np.mean(each) for at, each in found.items()}


def test_over_a_moments_doubt_a_stay_goes_on_and_over_a_long_one_nobody_knows() -> None:
    for doubt, known in ((40.0, True), (90.0, False)):
        like, now = followed(readings(MIN_MOMENTS + 1)), (MIN_MOMENTS + 1) * HOUR
        for time in np.arange(now, now + STAY, 10.0).tolist():
            like.follow(time, None if now + 20.0 <= time < now + 20.0 + doubt else "on", 60.0)
        (held,) = like.hold(now + STAY - 10.0, {HORIZON: 60.0})
        assert (held is not None) is known, doubt


def test_fewer_moments_and_a_place_that_is_not_known_tell_nothing() -> None:
    values = readings(MIN_MOMENTS)
    like, now = followed(values), len(values) * HOUR
    assert like.hold(now, {HORIZON: 500.0}) == (None,)
    like = followed(readings(MIN_MOMENTS + 1))
    now = (MIN_MOMENTS + 1) * HOUR
    assert like.hold(now, {900.0: 500.0}) == (None,), "a horizon that is not followed"
    like.follow(now + 20.0, None, 60.0)
    assert like.hold(now + 20.0, {HORIZON: 500.0}) == (None,)
    like.follow(now + 140.0, "on", 60.0)
    assert like.hold(now + 140.0, {HORIZON: 500.0}) == (None,), "since when is it on?"


def test_neighbouring_moments_late_readings_and_a_second_pass_of_the_clock_count_once_or_not() -> None:
    like = LikeMoments((HORIZON,), 0.05, 5.0)
    for turn in range(200):  # to and fro, every ten seconds
        like.follow(10.0 * turn, "on" if turn % 2 else "off", 60.0)
    assert [row[3] for row in like.snapshot()] == [1, 1]
    late = LikeMoments((HORIZON,), 0.05, 5.0)
    for time in (0.0, 10.0, 100.0):
        late.follow(time, "on" if time else "off", 60.0)
    assert late.snapshot() == [], "30 s after its moment a reading is another one"
    late.follow(110.0, "off", 60.0)
    late.follow(50.0, "off", 60.0)
    late.follow(171.0, "off", 60.0)
    assert late.snapshot() == [], "the clock was set back: what is awaited is of another time"


def test_a_restart_goes_on_from_what_was_measured_and_waits_for_a_new_stay() -> None:
    values = readings(MIN_MOMENTS + 1)
    kept = json.loads(json.dumps(followed(values).snapshot()))
    again = LikeMoments((HORIZON, 900.0), 0.05, 5.0)
    again.restore(kept)
    begin = 100.0 * HOUR
    again.follow(begin, "on", 60.0)
    assert again.hold(begin, {HORIZON: 60.0}) == (None,)
    followed([60.0], again, begin)
    held, other = again.hold(begin + HOUR, {HORIZON: 60.0, 900.0: 60.0})
    assert held is not None and held.moments == MIN_MOMENTS and other is None
    gone = LikeMoments((900.0,), 0.05, 5.0)
    gone.restore(kept)
    assert gone.snapshot() == []

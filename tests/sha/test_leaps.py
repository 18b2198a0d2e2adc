"""A trend follows what drifts, and takes no leap for a slope."""

from collections.abc import Callable, Iterable
from dataclasses import replace

import pytest

from sim.engine.belief import advance, observe, start
from sim.engine.belief_state import Belief
from sim.engine.tracker import Tracker, compile_model
from sim.forecast.leaps import observe_leap
from sim.sha.model import PlainMember, plain_model
from tests.gateway.support import two_modes

TREND = compile_model(plain_model(two_modes(), PlainMember("damped trend", 0.01, 0.04, heat=0.01, memory=100.0)))


def follow(readings: Iterable[float], observed: Callable[[Tracker, Belief, float, float], Belief]) -> Belief:
    """The trend's belief after readings (degC), one each ten seconds."""
    belief = start(TREND, 0.0)
    for number, reading in enumerate(readings):
        belief = observed(TREND, belief, 10.0 * number, reading)
    return belief


def minute_ahead(belief: Belief) -> float:
    return advance(TREND, belief, belief.time + 60.0).x


def test_a_leap_moves_the_level_and_gives_no_slope() -> None:
    still, leapt = [53.0] * 30, 22.0
    belief = follow([*still, leapt], observe_leap)
    assert belief.x == pytest.approx(leapt, abs=0.1)
    assert minute_ahead(belief) == pytest.approx(leapt, abs=1.0)
    assert minute_ahead(follow([*still, leapt], observe)) < leapt - 10.0, "what the filter alone makes of it"
    assert (
        belief.samples == 31 and belief.last is not None and belief.last.value == pytest.approx(leapt - 53.0, abs=0.1)
    )


def test_two_leaps_in_a_row_one_way_are_a_slope() -> None:
    assert minute_ahead(follow([50.0] * 30 + [60.0, 70.0], observe_leap)) > 80.0


def test_a_spike_gives_no_slope_either_way() -> None:
    belief = follow([50.0] * 30 + [80.0, 50.0], observe_leap)
    assert belief.x == pytest.approx(50.0, abs=0.1) and minute_ahead(belief) == pytest.approx(50.0, abs=1.0)


def test_what_a_trend_may_foresee_it_takes_in_as_ever() -> None:
    course = [50.0 + 0.002 * number**2 for number in range(40)]
    assert follow(course, observe_leap) == follow(course, observe)


def test_a_reading_that_is_none_and_one_of_the_past_move_nothing_else() -> None:
    before = follow([50.0] * 5, observe_leap)
    assert observe_leap(TREND, before, 60.0, float("nan")) == observe(TREND, before, 60.0, float("nan"))
    assert observe_leap(TREND, before, 1.0, 90.0) == replace(before, late=before.late + 1)

"""Importance splitting: unbiased, with an interval that holds the truth about as often as it says."""

import numpy as np
import pytest

from sim.lab.checking.query.tree import Always, At, Both, Either, Probability, TimeSpan, Until
from sim.lab.checking.smc.answers import QuerySettings, answer, prepare_question
from sim.lab.checking.smc.monitors.path import cuts
from sim.lab.checking.smc.paths.known_events import Cuts
from sim.lab.checking.smc.runs import engine
from sim.lab.checking.smc.splitting.estimator import SplitEstimate, skewed_interval, split_estimate
from sim.lab.checking.smc.start import initial
from tests.checking.worlds import along, compare, eventually, flow, model, normal
from tests.rig.quadrature import Stretch, brownian, first_passage

START = along(model([flow("linear")], [normal(0.0)]), 40.0, 400.0)


def one_split(
    limit: float, seed: int, runs: int = 100, repetitions: int = 12, where: Cuts | None = None
) -> SplitEstimate:
    one = prepare_question(eventually(compare(">=", limit), 400.0), START)
    made = engine(START.world, where or Cuts(400.0, (), (), ((0.0, 400.0),), longest=20.0))
    return split_estimate(made, one, np.random.default_rng(seed), runs=runs, repetitions=repetitions)


def test_the_interval_holds_the_truth_at_about_its_stated_rate_and_the_mean_is_unbiased() -> None:
    """24 estimates of 1.9e-5 by Brownian motion, whose passage is known: at 95 %, 5 misses or more are 6 in 1000."""
    exact = brownian(40.0, 0.0, 0.1, 48.55, 400.0)
    assert 1e-5 < exact < 3e-5
    found = [one_split(48.55, seed) for seed in range(24)]
    inside = sum(one.estimate.low <= exact <= one.estimate.high for one in found)
    assert inside >= 20
    values = np.array([one.estimate.probability for one in found])
    error = values.std(ddof=1) / np.sqrt(values.size)
    assert abs(values.mean() - exact) < 3.0 * error
    assert error < 0.13 * exact


@pytest.mark.parametrize(("known", "seeds", "misses"), [(True, 12, 2), (False, 5, 1)])
def test_with_a_mode_parameter_drawn_once_for_the_stay_the_interval_holds_too(
    known: bool, seeds: int, misses: int
) -> None:
    """A drift of N(0.002, 0.004^2) degC/s decides; 12 estimates of 1.2e-5: 3 misses or more are 2 in 100 at 95 %."""
    own = flow("linear")
    exact = first_passage([Stretch(own, 0.002, 400.0, 0.004)], 40.0, 52.0, points=500)
    assert 5e-6 < exact < 2e-5
    made = model([own], [normal(0.002, 0.004)], first=normal(40.0))
    start = along(made, 40.0, 400.0) if known else initial(made)
    one = prepare_question(eventually(compare(">=", 52.0), 400.0), start)
    engines = engine(start.world, Cuts(400.0, (), (), ((0.0, 400.0),), longest=40.0))
    assert engines.columns == 1
    found = [
        split_estimate(engines, one, np.random.default_rng(seed), runs=250, repetitions=16) for seed in range(seeds)
    ]
    assert sum(one.estimate.low <= exact <= one.estimate.high for one in found) >= seeds - misses
    values = np.array([one.estimate.probability for one in found])
    assert abs(values.mean() - exact) < 3.0 * values.std(ddof=1) / np.sqrt(values.size)
    assert values.std(ddof=1) < 0.4 * exact


def test_the_stays_whose_mode_parameter_matters_are_tilted_and_no_others() -> None:
    """Of 8 stays the short ones move X by a tenth of what the long one does."""
    flows = [flow("linear")] * 8
    made = model(flows, [normal(0.0, 0.004)] * 8)
    start = along(made, 40.0, 470.0, (10.0, 20.0, 30.0, 430.0, 440.0, 450.0, 460.0))
    assert engine(start.world, Cuts(470.0, (), (), ((0.0, 470.0),), longest=5.0)).columns == 1
    even = along(made, 40.0, 480.0, tuple(60.0 * stay for stay in range(1, 8)))
    assert engine(even.world, Cuts(480.0, (), (), ((0.0, 480.0),), longest=5.0)).columns == 6
    certain = along(model(flows, [normal(0.0)] * 8), 40.0, 480.0, (60.0,))
    assert engine(certain.world, Cuts(480.0, (), (), ((0.0, 480.0),), longest=5.0)).columns == 0


def test_a_skewed_mean_has_an_interval_that_reaches_further_up() -> None:
    """Log-normal values, 40 at a time: the interval holds their mean more often than Student's does."""
    rng = np.random.default_rng(7)
    held, plain, exact = 0, 0, 0.01 * np.exp(0.5)
    for _ in range(2000):
        values = 0.01 * np.exp(rng.standard_normal(40))
        low, high = skewed_interval(values, 0.95)
        mean, reach = values.mean(), 2.0227 * values.std(ddof=1) / np.sqrt(40.0)
        assert low < mean < high and high - mean > mean - low
        held += low <= exact <= high
        plain += abs(mean - exact) <= reach
    assert held / 2000 > plain / 2000 + 0.02 and held / 2000 > 0.90
    even = np.concatenate([np.full(20, 0.45), np.full(20, 0.55)])
    low, high = skewed_interval(even, 0.95)
    assert (
        high - 0.5
        == pytest.approx(0.5 - low, rel=1e-3)
        == pytest.approx(2.0227 * even.std(ddof=1) / np.sqrt(40.0), rel=1e-3)
    )
    assert skewed_interval(np.zeros(40), 0.95) == (0.0, 1.0)


def test_a_probability_of_1e_8_is_found() -> None:
    exact = brownian(40.0, 0.0, 0.1, 51.5, 400.0)
    assert exact < 2e-8
    found = one_split(51.5, 5, runs=500, repetitions=20)
    assert found.estimate.low <= exact <= found.estimate.high
    places, chances = zip(*found.levels, strict=True)
    assert len(places) > 5 and list(places) == sorted(places)
    for place, chance in zip(places, chances, strict=True):
        assert chance == pytest.approx(brownian(40.0, 0.0, 0.1, place, 400.0), rel=0.35)


def test_several_levels_within_one_step_are_all_passed() -> None:
    """Two steps for the whole way: a run that reaches a level may be beyond the next ones, by its bridge alone."""
    exact = brownian(40.0, 0.0, 0.1, 46.0, 400.0)
    found = one_split(46.0, 2, runs=2000, repetitions=20, where=Cuts(400.0, (), (), ((0.0, 400.0),), longest=200.0))
    assert found.estimate.low <= exact <= found.estimate.high


def test_falling_below_a_limit_and_breaking_an_always_are_split_too() -> None:
    exact = brownian(40.0, 0.0, 0.1, 48.0, 400.0)
    down = answer(eventually(compare("<=", 32.0), 400.0), START, QuerySettings(rare=True))
    assert down.numbers["low"] <= exact <= down.numbers["high"]
    always = Probability(400.0, Always(compare("<", 48.0), TimeSpan(0.0, 400.0)))
    kept = answer(always, START, QuerySettings(rare=True))
    assert kept.numbers["violation_low"] <= exact <= kept.numbers["violation_high"]
    assert kept.numbers["probability"] == pytest.approx(1.0 - kept.numbers["violation"])


def test_unknown_events_are_split_like_known_ones() -> None:
    made = model([flow("linear")], [normal(0.0)], first=normal(40.0))
    exact = brownian(40.0, 0.0, 0.1, 48.0, 400.0)
    start = initial(made)
    asked = prepare_question(eventually(compare(">=", 48.0), 400.0), start)
    unknown = engine(start.world, Cuts(400.0, (), (), ((0.0, 400.0),), longest=20.0))
    found = split_estimate(unknown, asked, np.random.default_rng(0), runs=250, repetitions=20)
    assert found.estimate.low <= exact <= found.estimate.high


def test_an_event_without_a_level_on_the_way_counts_as_well() -> None:
    """q_1 is entered for certain: the formula is true there whatever the temperature."""
    start = along(model([flow("linear")] * 2, [normal(0.0)] * 2), 40.0, 400.0, (200.0,))
    found = answer(eventually(Either(compare(">=", 60.0), At("q_1")), 400.0), start, QuerySettings(rare=True))
    assert found.numbers["probability"] == 1.0


def test_splitting_takes_over_after_many_runs_without_the_event_and_says_so() -> None:
    query = eventually(compare(">=", 49.0), 400.0)
    found = answer(query, START, QuerySettings(rule="fixed", runs=10_000))
    assert "splitting" in found.rule and "not once in 10000 runs" in found.notes[0]
    few = answer(query, START, QuerySettings(rule="fixed", runs=500))
    assert "Clopper" in few.rule and any("--rare" in note for note in few.notes)


def test_what_cannot_be_split_is_refused_with_the_reason() -> None:
    both = Both(compare(">=", 50.0), compare("<=", 51.0))
    until = Probability(400.0, Until(compare("<=", 60.0), compare(">=", 50.0), TimeSpan(0.0, 400.0)))
    for query, words in (
        (eventually(both, 400.0), "one direction"),
        (eventually(At("q_0"), 400.0), "needs a temperature"),
        (until, "<> and"),
    ):
        with pytest.raises(ValueError, match=words):
            answer(query, START, QuerySettings(rare=True))
    with pytest.raises(ValueError, match="finds no way"):
        cold = along(model([flow("exponential", 0.0, k=0.1)], [normal(40.0)]), 40.0, 400.0)
        answer(eventually(compare(">=", 50.0), 400.0), cold, QuerySettings(rare=True))


def test_the_path_decides_where_steps_end() -> None:
    one = prepare_question(eventually(compare(">=", 50.0), 400.0, 100.0), START)
    assert cuts((one,)).looked == ((100.0, 400.0),)

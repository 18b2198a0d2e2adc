"""Paths over the locations against closed forms, and what cannot be run."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import kstest

from sim.sha.automaton import Distribution, Input
from sim.sha.model import Stay
from sim.sha.semi_markov import MAX_STAYS, Paths, compile_chain, draw_paths, input_moments
from tests.sha.plants import exponential_stays, two_states

WEIBULL = Distribution("weibull", {"shape": 2.0, "scale": 60.0})


def place_at(paths: Paths, time: float) -> np.ndarray:
    row = (paths.entered <= time).sum(axis=0) - 1
    return paths.location[row, np.arange(row.size)]


@pytest.mark.parametrize("time", [5.0, 40.0, 300.0])
def test_location_probabilities_are_those_of_the_two_state_markov_chain(time: float) -> None:
    chain = compile_chain(two_states(exponential_stays(60.0, 90.0)))
    runs = 20_000
    hot = place_at(draw_paths(chain, 0, age=17.0, horizon=301.0, runs=runs, rng=np.random.default_rng(1)), time).mean()
    up, down = 1 / 60, 1 / 90
    exact = up / (up + down) * (1 - np.exp(-(up + down) * time))
    assert abs(hot - exact) < 4 * np.sqrt(exact * (1 - exact) / runs)


def test_the_present_stay_is_conditioned_on_its_age() -> None:
    stays = {"cold": Stay(WEIBULL, {"hot": 1.0}), "hot": Stay(WEIBULL, {"cold": 1.0})}
    paths = draw_paths(
        compile_chain(two_states(stays)), 0, age=45.0, horizon=1e4, runs=3000, rng=np.random.default_rng(2)
    )

    def left(t: np.ndarray) -> np.ndarray:
        return 1 - np.exp((45.0 / 60.0) ** 2 - ((45.0 + t) / 60.0) ** 2)

    assert kstest(paths.entered[1], left).pvalue > 1e-4
    assert kstest(paths.entered[2] - paths.entered[1], lambda t: 1 - np.exp(-((t / 60.0) ** 2))).pvalue > 1e-4


def test_next_locations_follow_their_probabilities() -> None:
    stays = {"cold": Stay(WEIBULL, {"hot": 0.25, "cold": 0.75})}
    paths = draw_paths(
        compile_chain(two_states(stays)), 0, age=0.0, horizon=1e4, runs=4000, rng=np.random.default_rng(3)
    )
    assert abs((paths.location[1] == 1).mean() - 0.25) < 4 * np.sqrt(0.25 * 0.75 / 4000)


def test_a_location_without_a_stay_is_never_left() -> None:
    paths = draw_paths(compile_chain(two_states()), 1, age=0.0, horizon=900.0, runs=10, rng=np.random.default_rng(4))
    assert paths.location.tolist() == [[1] * 10]
    assert paths.entered.tolist() == [[0.0] * 10]


def test_stays_too_short_for_the_horizon_end_the_path_and_are_counted() -> None:
    brief = exponential_stays(1e-4, 1e-4)
    paths = draw_paths(
        compile_chain(two_states(brief)), 0, age=0.0, horizon=900.0, runs=5, rng=np.random.default_rng(5)
    )
    assert paths.cut == 5
    assert MAX_STAYS <= len(paths.entered) < MAX_STAYS + 40


@pytest.mark.parametrize(
    ("stays", "said"),
    [
        ({"warm": Stay(WEIBULL, {"hot": 1.0})}, "belongs to no location"),
        ({"cold": Stay(WEIBULL, {"warm": 1.0})}, "'cold' leads to 'warm'"),
        ({"cold": Stay(WEIBULL, {"hot": 0.5})}, "sum to 0.5, not 1"),
        ({"cold": Stay(WEIBULL, {"cold": 1.5, "hot": -0.5})}, "next location 'hot' is -0.5; it must be at least 0"),
        ({"cold": Stay(WEIBULL, {"hot": float("nan")})}, "'hot' is nan; it must be at least 0"),
        ({"cold": Stay(Distribution("weibull", {"shape": 1.0}), {"hot": 1.0})}, "takes shape, scale"),
    ],
)
def test_stays_that_make_no_sense_are_refused_by_name(stays: dict[str, Stay], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        compile_chain(two_states(stays))


def test_inputs_of_future_stays_come_from_the_stay_else_from_what_is_held() -> None:
    stays = exponential_stays()
    model = two_states(stays, gain=0.2)
    assert input_moments(model, {}).tolist() == [[0.0, 0.0], [0.0, 0.0]]
    assert input_moments(model, {"A": 80.0}).tolist() == [[0.0, 0.0], [pytest.approx(6.0), 0.0]]
    learned = {**stays, "hot": replace(stays["hot"], inputs={"A": (60.0, 5.0)})}
    assert input_moments(two_states(learned, gain=0.2), {"A": 80.0})[1].tolist() == pytest.approx([2.0, 1.0])
    assert Input("A", 0.2, 50.0) in model.sha.locations[1].flow.inputs

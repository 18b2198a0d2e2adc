"""The runs under a forecast: steps laid out by hand, and the chance of touching a limit inside a step."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import ndtr

from sim.engine.belief import observe, on_event, start
from sim.engine.particles import bridges, draw_layout, survival
from sim.engine.tracker import compile_model
from sim.forecast.fan import fans, forecast
from sim.sha.automaton import Effect
from sim.sha.semi_markov import Paths
from sim.sha.trace import Array, Event
from tests.sha.plants import exponential_stays, two_states


def one_step(decay: float, variance: float, runs: int) -> Array:
    """The bridge of a single step with the given coefficients."""
    ones = np.ones((1, runs))
    return bridges(decay * ones, variance * ones)


@pytest.mark.parametrize("spent", [0.05, 0.4, 0.9])
def test_a_single_long_step_to_the_limit_is_exact_by_the_reflection_principle(spent: float) -> None:
    """A flow that relaxes to the limit itself, over `spent` relaxation times in one step, all ends integrated out."""
    below, noise, k = 1.5, 0.3, 0.02
    decay = np.exp(-spent)
    variance = noise**2 * (1 - decay**2) / (2 * k)
    ends = -below * decay + np.sqrt(variance) * np.linspace(-9, 9, 40_001)
    alive = survival(np.full((1, ends.size), -below), ends[None, :], one_step(decay, variance, ends.size), 0.0)[0]
    density = np.exp(-0.5 * (ends + below * decay) ** 2 / variance) / np.sqrt(2 * np.pi * variance)
    exact = 1 - 2 * ndtr(-below * decay / np.sqrt(variance))
    assert np.trapezoid(alive * density, ends) == pytest.approx(exact, abs=1e-6)


def test_widened_steps_touch_the_limit_as_steps_with_that_noise() -> None:
    start_at, end_at = np.array([[28.0, 29.0]]), np.array([[29.0, 29.5]])
    widened = survival(start_at, end_at, one_step(1.0, 0.5, 2), 30.0, np.full((1, 2), 2.0))
    assert widened == pytest.approx(survival(start_at, end_at, one_step(1.0, 2.0, 2), 30.0))
    assert np.all(widened < survival(start_at, end_at, one_step(1.0, 0.5, 2), 30.0))


def test_steps_without_noise_touch_only_at_their_ends() -> None:
    alive = survival(np.array([[29.0, 29.0]]), np.array([[29.9, 30.0]]), one_step(1.0, 0.0, 2), 30.0)
    assert alive.tolist() == [[1.0, 0.0]]


def test_a_step_of_many_relaxation_times_is_not_taken_for_a_certain_touch() -> None:
    alive = survival(np.array([[20.0]]), np.array([[20.0]]), one_step(1e-300, 0.01, 1), 80.0)
    assert alive.tolist() == [[1.0]]


def test_steps_are_cut_at_jumps_and_at_the_grid_each_run_on_its_own_clock() -> None:
    tracker = compile_model(two_states(exponential_stays()))
    entered = np.array([[0.0, 0.0], [5.0, 20.0], [25.0, np.inf]])
    paths = Paths(np.array([[0, 0], [1, 1], [0, 0]]), entered, age=7.0)
    grid = np.array([10.0, 20.0, 30.0])
    layout = draw_layout(
        tracker, start(tracker, 0.0, 30.0), paths, grid=grid, inputs=np.zeros((2, 2)), rng=np.random.default_rng(1)
    )
    ((_, steps),) = layout.blocks()
    assert (steps.begin + steps.dt).T.tolist() == [[5.0, 10.0, 20.0, 25.0, 30.0], [10.0, 20.0, 20.0, 30.0, 30.0]]
    # At one instant the jump comes first: the second run is in its new place when the grid's 20 s are told.
    assert steps.location.T.tolist() == [[0, 1, 1, 1, 0], [0, 0, 1, 1, 1]]
    assert steps.age.T.tolist() == [[7.0, 0.0, 5.0, 15.0, 0.0], [7.0, 17.0, 0.0, 0.0, 10.0]]
    assert layout.marks.T.tolist() == [[1, 2, 4], [0, 2, 3]]
    assert steps.dt.sum(axis=0).tolist() == [30.0, 30.0]
    assert np.array_equal(steps.target[1:4, 0], np.full(3, steps.target[1, 0]))
    assert layout.x0.shape == (2,)


def test_an_event_at_the_very_horizon_is_seen_in_the_location() -> None:
    model = two_states(exponential_stays())
    told = forecast(
        model, start(model, 0.0, 30.0), [30.0, 60.0], np.random.default_rng(1), events=[Event(30.0, "W_ON")]
    )
    assert told.locations == ({"hot": 1.0}, {"hot": 1.0})
    last = forecast(model, start(model, 0.0, 30.0), [30.0], np.random.default_rng(1), events=[Event(30.0, "W_ON")])
    assert last.locations == ({"hot": 1.0},)


@pytest.mark.parametrize("limits", [{}, {"max_rate": 0.02}, {"low": 29.5, "high": 31.0}])
@pytest.mark.parametrize("effects", [(), (Effect("heat-disturbance", {"sigma": 1e-3, "memory": 300.0}),)])
def test_forecasts_side_by_side_are_those_of_one_after_the_other(
    limits: dict[str, float], effects: tuple[Effect, ...]
) -> None:
    # A place that is left often and one that is not, two sets of horizons, and runs that meet a limit or none.
    model = two_states(exponential_stays(5.0, 400.0))
    tracker = compile_model(replace(model, sha=replace(model.sha, effects=effects, **limits)))
    belief = observe(tracker, start(tracker, 0.0, 30.0), 10.0, 30.2)
    hot = on_event(tracker, belief, Event(10.0, "W_ON"))
    horizons = [(60.0, 300.0), (60.0,), (60.0, 300.0)] * 4
    origins = [(one, ahead) for one, ahead in zip([belief, hot, hot] * 4, horizons, strict=True)]
    rng = np.random.default_rng(3)
    alone = [forecast(tracker, one, ahead, rng, runs=20).quantiles for one, ahead in origins]
    beside = fans(tracker, origins, np.random.default_rng(3), runs=20)
    for one, other in zip(alone, beside, strict=True):
        assert other == pytest.approx(one, rel=1e-12)

"""The forecast against independent simulation, closed forms of first passage, and what was simulated to happen."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import ndtr, ndtri

from sim.engine.belief import advance, filter_trace, on_event, start
from sim.engine.tracker import compile_model
from sim.forecast.fan import FAN_LEVELS, Forecast, forecast
from sim.sha.automaton import SHA, Distribution, Edge, Flow, Location
from sim.sha.events import DECANTER
from sim.sha.model import Model, Stay
from sim.sha.trace import Event
from tests.sha.plants import exponential_stays, normal, relaxing, simulate_two, single, two_states


def direct_runs(horizon: float, runs: int, rng: np.random.Generator) -> np.ndarray:
    """`two_states` from 30 degC, just entered `cold`, one run after another: (runs, 2) end temperature and location."""
    ends = np.empty((runs, 2))
    for run in range(runs):
        x, place, m, time = 30.0 + 0.1 * rng.standard_normal(), 0, rng.normal(25.0, 1.0), 0.0
        while time < horizon:
            dt = min(rng.exponential((60.0, 90.0)[place]), horizon - time)
            k, s = ((0.004, 0.03), (0.006, 0.05))[place]
            decay = np.exp(-k * dt)
            x = m + (x - m) * decay + s * np.sqrt((1 - decay**2) / (2 * k)) * rng.standard_normal()
            time += dt
            if time < horizon:
                place = 1 - place
                m = rng.normal(*((25.0, 1.0), (70.0, 3.0))[place])
        ends[run] = x + 0.1 * rng.standard_normal(), place
    return ends


@pytest.mark.parametrize("horizon", [20.0, 300.0])
def test_the_fan_is_that_of_a_direct_simulation(horizon: float) -> None:
    model, direct, runs = two_states(exponential_stays()), 4000, 8000
    ends = direct_runs(horizon, direct, np.random.default_rng(1))
    fan = forecast(model, start(model, 0.0, 30.0), [horizon, 400.0], np.random.default_rng(2), runs=runs)
    for level, quantile in zip(FAN_LEVELS, fan.quantiles[:, 0], strict=True):
        error = 4 * np.sqrt(level * (1 - level) * (1 / direct + 1 / runs))
        assert abs((ends[:, 0] <= quantile).mean() - level) < error
    hot = ends[:, 1].mean()
    assert abs(fan.locations[0].get("hot", 0.0) - hot) < 4 * np.sqrt(hot * (1 - hot) * (1 / direct + 1 / runs))


def brownian_passage(height: float, drift: float, noise: float, time: float) -> float:
    """P(max over [0, time] >= height) of a Brownian motion with drift: the inverse Gaussian law."""
    spread = noise * np.sqrt(time)
    back = np.exp(2 * drift * height / noise**2) * ndtr((-height - drift * time) / spread)
    return float(ndtr((drift * time - height) / spread) + back)


@pytest.mark.parametrize(("drift", "limit"), [(0.01, 31.0), (0.0, 31.5), (-0.005, 30.5), (0.01, 36.0)])
def test_the_chance_of_the_limit_is_the_inverse_gaussian_law(drift: float, limit: float) -> None:
    model = single(Flow("linear", {"noise": 0.1}), normal(drift, 0.0), sensor=0.0)
    runs = 4000
    told = forecast(model, start(model, 0.0, 30.0), [60.0, 200.0], np.random.default_rng(3), limit=limit, runs=runs)
    for horizon, estimate in zip((60.0, 200.0), told.exceedance, strict=True):
        exact = brownian_passage(limit - 30.0, drift, 0.1, horizon)
        assert abs(estimate.probability - exact) < 4 * np.sqrt(exact * (1 - exact) / runs) + 1e-9


def relaxing_passage(x0: float, m: float, k: float, noise: float, limit: float, time: float) -> float:
    """First passage of an Ornstein-Uhlenbeck path by propagating its density below the limit in steps of 0.5 s."""
    grid = np.linspace(limit - 8.0, limit, 1001)[:-1] + 0.004
    width, dt = 0.008, 0.5
    decay = np.exp(-k * dt)
    sigma = noise * np.sqrt((1 - decay**2) / (2 * k))

    def step(x: np.ndarray) -> np.ndarray:
        density = np.exp(-0.5 * ((grid[:, None] - m - (x - m) * decay) / sigma) ** 2) / (sigma * np.sqrt(2 * np.pi))
        return density * (1 - np.exp(-2 * (limit - grid[:, None]) * (limit - x) / (noise**2 * dt)))

    alive, kernel = step(np.array([x0]))[:, 0], step(grid) * width
    for _ in range(round(time / dt) - 1):
        alive = kernel @ alive
    return 1.0 - float(alive.sum() * width)


@pytest.mark.parametrize(("m", "limit"), [(34.0, 33.0), (33.0, 33.0), (31.5, 33.0)])
def test_the_chance_of_the_limit_under_relaxation_is_that_of_quadrature(m: float, limit: float) -> None:
    k, noise, runs = 0.02, 0.2, 6000
    exact = relaxing_passage(30.0, m, k, noise, limit, 120.0)
    if m == limit:  # a constant limit in the Brownian motion's own time: the reflection principle
        settled = noise * np.sqrt((1 - np.exp(-2 * k * 120.0)) / (2 * k))
        assert exact == pytest.approx(2 * ndtr(-3.0 * np.exp(-k * 120.0) / settled), abs=2e-3)
    model = single(relaxing(k, noise), normal(m, 0.0), sensor=0.0)
    told = forecast(model, start(model, 0.0, 30.0), [120.0], np.random.default_rng(4), limit=limit, runs=runs)
    assert abs(told.exceedance[0].probability - exact) < 4 * np.sqrt(exact * (1 - exact) / runs) + 2e-3


def test_minutes_to_the_limit_are_the_quantiles_of_the_first_passage() -> None:
    model = single(Flow("linear", {"noise": 0.05}), normal(0.02, 0.0), sensor=0.0)
    told = forecast(model, start(model, 0.0, 30.0), [900.0], np.random.default_rng(5), limit=33.0, runs=4000)
    for share, minutes in zip((0.05, 0.5, 0.95), told.minutes_to_limit, strict=True):
        assert brownian_passage(3.0, 0.02, 0.05, minutes * 60.0) == pytest.approx(share, abs=0.02)
    short = forecast(model, start(model, 0.0, 30.0), [150.0], np.random.default_rng(5), limit=33.0)
    assert short.minutes_to_limit[0] < short.minutes_to_limit[1] <= 2.5
    assert short.minutes_to_limit[2] == np.inf


def test_over_the_limit_now_is_certain_and_takes_no_time() -> None:
    model = two_states(exponential_stays())
    told = forecast(model, start(model, 0.0, 81.0), [60.0, 900.0], np.random.default_rng(6), limit=80.0)
    assert [each.probability for each in told.exceedance] == [1.0, 1.0]
    assert told.minutes_to_limit == (0.0, 0.0, 0.0)


def test_a_limit_out_of_reach_has_probability_0_with_an_upper_bound_and_no_minutes() -> None:
    model = two_states(exponential_stays())
    told = forecast(model, start(model, 0.0, 30.0), [60.0], np.random.default_rng(7), limit=140.0)
    assert told.exceedance[0].probability < 1e-12
    assert 0.0 < told.exceedance[0].high < 0.02
    assert told.minutes_to_limit == (np.inf, np.inf, np.inf)
    assert forecast(model, start(model, 0.0, 30.0), [60.0], np.random.default_rng(7)).exceedance[0].probability == 0.0


def test_exceedance_grows_with_the_horizon_and_location_chances_sum_to_one() -> None:
    model = two_states(exponential_stays())
    told = forecast(model, start(model, 5.0, 45.0), [30.0, 60.0, 300.0, 900.0], np.random.default_rng(8), limit=55.0)
    chances = [each.probability for each in told.exceedance]
    assert chances == sorted(chances)
    assert 0 < chances[2] < 1
    assert all(each.low <= each.probability <= each.high for each in told.exceedance)
    assert [sum(place.values()) for place in told.locations] == pytest.approx([1.0] * 4)
    assert np.all(np.diff(told.quantiles, axis=0) >= 0)
    assert (told.time, told.runs, told.cut, told.clamps) == (5.0, 256, 0, 0)


def test_the_same_seed_gives_the_same_forecast() -> None:
    model = two_states(exponential_stays())

    def told() -> Forecast:
        return forecast(model, start(model, 0.0, 30.0), [60.0, 300.0], np.random.default_rng(9), limit=40.0)

    one, two = told(), told()
    assert np.array_equal(one.quantiles, two.quantiles)
    assert (one.exceedance, one.minutes_to_limit) == (two.exceedance, two.minutes_to_limit)


def test_known_events_give_the_filters_own_prediction() -> None:
    model = two_states(exponential_stays(), sensor=0.2)
    belief = start(model, 100.0, 30.0)
    told = forecast(model, belief, [30.0, 200.0], np.random.default_rng(10), events=[Event(150.0, "W_ON")], runs=4000)
    hot = advance(model, on_event(model, belief, Event(150.0, "W_ON")), 300.0)
    spread = np.sqrt(hot.xx + 0.04)
    assert told.quantiles[:, 1] == pytest.approx(hot.x + spread * ndtri(FAN_LEVELS))
    assert told.locations == ({"cold": 1.0}, {"hot": 1.0})
    sampled = replace(model, semi_markov={})
    drawn = forecast(
        sampled, on_event(model, belief, Event(100.0, "W_ON")), [200.0], np.random.default_rng(1), runs=8000
    )
    exact = forecast(model, belief, [200.0], np.random.default_rng(1), events=[Event(100.0, "W_ON")])
    sigma = (exact.quantiles[4, 0] - exact.quantiles[0, 0]) / 3.29
    assert drawn.quantiles[:, 0] == pytest.approx(exact.quantiles[:, 0], abs=0.1 * sigma)


def test_known_events_lead_the_runs_to_the_limit_too() -> None:
    model = two_states(exponential_stays())
    belief = start(model, 0.0, 60.0)
    idle = forecast(model, belief, [900.0], np.random.default_rng(11), limit=62.0, events=[])
    busy = forecast(model, belief, [900.0], np.random.default_rng(11), limit=62.0, events=[Event(1.0, "W_ON")])
    assert idle.exceedance[0].probability < 0.05
    assert busy.exceedance[0].probability > 0.9


def test_inputs_of_later_stays_are_drawn_and_the_present_one_is_held() -> None:
    stays = exponential_stays()
    stays["hot"] = replace(stays["hot"], inputs={"A": (150.0, 0.0)})
    model = two_states(stays, gain=0.2)
    late = forecast(model, start(model, 0.0, 30.0), [900.0], np.random.default_rng(12), events=[Event(1.0, "W_ON")])
    held = start(two_states(gain=0.2), 0.0, 30.0, {"A": 50.0})
    now = forecast(
        two_states(gain=0.2),
        on_event(two_states(gain=0.2), held, Event(0.0, "W_ON")),
        [900.0],
        np.random.default_rng(12),
    )
    assert late.quantiles[2, 0] - now.quantiles[2, 0] == pytest.approx(20.0, abs=1.0)


def test_calibration_widens_the_fan_about_its_median_and_the_way_to_the_limit() -> None:
    model = two_states(exponential_stays())
    belief = start(model, 0.0, 30.0)

    def told(calibration: dict[float, float] | None) -> Forecast:
        return forecast(
            model, belief, [60.0, 180.0], np.random.default_rng(13), limit=62.0, runs=2000, calibration=calibration
        )

    plain, wide = told(None), told({60.0: 1.0, 300.0: 3.0})
    assert wide.factors.tolist() == [1.0, 2.0]
    assert wide.quantiles[:, 0] == pytest.approx(plain.quantiles[:, 0])
    assert wide.quantiles[2, 1] == plain.quantiles[2, 1]
    assert np.ptp(wide.quantiles[:, 1]) == pytest.approx(2 * np.ptp(plain.quantiles[:, 1]))
    assert wide.exceedance[1].low > plain.exceedance[1].high
    own = forecast(two_states(exponential_stays(), calibration={60.0: 2.0}), belief, [60.0], np.random.default_rng(13))
    assert own.factors.tolist() == [2.0]
    with pytest.raises(ValueError, match="positive and finite"):
        told({60.0: 0.0})


def test_a_widened_linear_flow_reaches_the_limit_as_one_with_that_noise() -> None:
    runs, rng = 4000, np.random.default_rng(14)
    model = single(Flow("linear", {"noise": 0.05}), normal(0.01, 0.0), sensor=0.0)
    told = forecast(model, start(model, 0.0, 30.0), [200.0], rng, limit=33.0, runs=runs, calibration={200.0: 2.0})
    exact = brownian_passage(3.0, 0.01, 0.1, 200.0)
    assert abs(told.exceedance[0].probability - exact) < 4 * np.sqrt(exact * (1 - exact) / runs)


def test_a_saturated_rate_and_the_range_hold_in_the_runs_and_clamps_are_counted() -> None:
    slow = two_states(max_rate=0.05)
    belief = on_event(slow, start(slow, 0.0, 20.0), Event(0.0, "W_ON"))
    told = forecast(slow, belief, [100.0], np.random.default_rng(15), runs=2000)
    assert told.quantiles[2, 0] == pytest.approx(25.0, abs=0.2)
    assert told.clamps == 0
    narrow = single(Flow("linear", {"noise": 0.01}), normal(0.1, 0.0), low=0.0, high=40.0)
    told = forecast(narrow, start(narrow, 0.0, 39.0), [60.0], np.random.default_rng(15), limit=39.9)
    assert told.quantiles[2, 0] == pytest.approx(40.0, abs=0.2)
    assert told.clamps > 100
    assert told.exceedance[0].probability == 1.0


def test_resampling_on_entry_is_in_the_runs() -> None:
    sha = SHA(
        "r",
        (
            Location("a", Flow("constant", {"noise": 0.01})),
            Location("b", Flow("constant", {"noise": 0.01}), normal(50.0, 2.0), "resample"),
        ),
        (Edge("a", "go", "b"),),
        "a",
    )
    model = Model(
        sha, DECANTER, "T", 0.0, semi_markov={"a": Stay(Distribution("exponential", {"mean": 1.0}), {"b": 1.0})}
    )
    told = forecast(model, start(model, 0.0, 20.0), [60.0], np.random.default_rng(16), limit=48.0, runs=4000)
    assert told.quantiles[:, 0] == pytest.approx(50.0 + 2.0 * ndtri(FAN_LEVELS), abs=0.25)
    assert told.exceedance[0].probability == pytest.approx(ndtr(1.0), abs=0.03)


@pytest.mark.parametrize(
    "flow",
    [
        Flow("logarithmic", {"t0": 5.0, "noise": 0.02}),
        Flow("transient", {"tau": 60.0, "noise": 0.02}),
        Flow("constant", {"noise": 0.02}),
    ],
)
def test_flows_that_depend_on_the_age_continue_at_the_present_one(flow: Flow) -> None:
    model = single(flow, normal(2.0, 0.1), sensor=0.05)
    belief = advance(model, start(model, 0.0, 30.0), 40.0)
    ahead = advance(model, belief, 340.0)
    told = forecast(model, belief, [300.0], np.random.default_rng(17), runs=8000)
    spread = np.sqrt(ahead.xx + 0.05**2)
    assert told.quantiles[:, 0] == pytest.approx(ahead.x + spread * ndtri(FAN_LEVELS), abs=0.1 * spread)


def test_the_90_percent_band_covers_90_percent_of_what_happens() -> None:
    model = two_states(exponential_stays(), sensor=0.2)
    tracker, cases = compile_model(model), 250
    inside = np.zeros((cases, 2))
    for case in range(cases):
        trace, _ = simulate_two(model, 400, np.random.default_rng(1000 + case))
        belief = filter_trace(tracker, trace.between(0.0, 101.0)).belief
        told = forecast(tracker, belief, [60.0, 240.0], np.random.default_rng(case))
        measured = trace.signals["T"][[160, 340]]
        inside[case] = (told.quantiles[0] <= measured) & (measured <= told.quantiles[4])
    # Binomial error of 250 cases, and 256 runs leave a band's coverage 1 % to 2 % short.
    assert np.all(np.abs(inside.mean(axis=0) - 0.9) < 4 * np.sqrt(0.09 / cases))


@pytest.mark.parametrize("horizons", [[], [0.0], [60.0, 60.0], [60.0, 30.0], [float("inf")], [float("nan")]])
def test_horizons_that_are_not_positive_and_ascending_are_refused(horizons: list[float]) -> None:
    model = two_states()
    with pytest.raises(ValueError, match="ascending order"):
        forecast(model, start(model, 0.0, 30.0), horizons, np.random.default_rng(1))
    with pytest.raises(ValueError, match="at least 2 runs"):
        forecast(model, start(model, 0.0, 30.0), [60.0], np.random.default_rng(1), runs=1)

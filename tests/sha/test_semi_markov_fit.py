"""Stays learned from traces: who was cut off, which law, where to next."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim.lab.learning.semi_markov import MIN_ENDED_STAYS, Sojourn, fit_law, fit_stays, sojourns
from sim.sha import distributions
from sim.sha.automaton import SHA, Distribution, Edge, Flow, Location
from sim.sha.events import DECANTER
from sim.sha.model import Model
from sim.sha.semi_markov import compile_chain
from sim.sha.trace import UNKNOWN, Event, Trace
from tests.sha.plants import simulate_two, two_states

THREE = Model(
    SHA(
        "three",
        tuple(Location(name, Flow("constant", {"noise": 0.1})) for name in ("off", "low", "high")),
        (
            Edge("off", "on", "low"),
            Edge("off", "burst", "high"),
            Edge("low", "up", "high"),
            Edge("low", "stop", "off"),
            Edge("high", "down", "low"),
            Edge("high", "stop", "off"),
        ),
        "off",
    ),
    DECANTER,
    "T",
    0.1,
)


def trace(end: float, *events: tuple[float, str], name: str = "t") -> Trace:
    times = np.linspace(0.0, end, 11)
    return Trace(name, times, {"T": np.full(11, 20.0)}, tuple(Event(*event) for event in events))


def test_stays_end_where_events_move_and_the_last_is_cut_off() -> None:
    assert sojourns(THREE, trace(10.0, (3.0, "on"), (7.0, "up"))) == (
        Sojourn("off", 0.0, 3.0, "low"),
        Sojourn("low", 3.0, 7.0, "high"),
        Sojourn("high", 7.0, 10.0, None),
    )


def test_moves_that_take_no_time_are_folded_into_one() -> None:
    found = sojourns(THREE, trace(10.0, (0.0, "on"), (4.0, "stop"), (4.0, "burst")))
    assert found == (Sojourn("low", 0.0, 4.0, "high"), Sojourn("high", 4.0, 10.0, None))


def test_a_stay_cut_by_unknown_is_censored_and_what_follows_is_a_gap() -> None:
    found = sojourns(THREE, trace(10.0, (2.0, "on"), (4.0, UNKNOWN), (6.0, "burst"), (8.0, "down")))
    assert [(stay.location, stay.to, stay.gap) for stay in found] == [
        ("off", "low", False),
        ("low", None, False),
        ("off", "high", True),
        ("high", "low", False),
        ("low", None, False),
    ]
    at_once = sojourns(THREE, trace(10.0, (4.0, UNKNOWN), (4.0, "burst")))
    assert [(stay.location, stay.to, stay.gap) for stay in at_once] == [("off", None, False), ("high", None, False)]


@pytest.mark.parametrize(
    "law",
    [
        Distribution("exponential", {"mean": 40.0}),
        Distribution("weibull", {"shape": 2.5, "scale": 40.0}),
        Distribution("lognormal", {"mu": 3.0, "sigma": 0.5}),
    ],
    ids=lambda law: law.kind,
)
def test_the_law_that_made_the_stays_is_found_under_censoring(law: Distribution) -> None:
    rng = np.random.default_rng(11)
    lasts = distributions.draw(law, 800, rng)
    cut = rng.exponential(80.0, 800)
    found = fit_law(np.minimum(lasts, cut), lasts <= cut, 40.0)
    assert found.kind == law.kind
    for name, value in law.params.items():
        assert found.params[name] == pytest.approx(value, rel=0.12)


def test_ignoring_censoring_would_be_far_off() -> None:
    rng = np.random.default_rng(12)
    lasts, cut = rng.exponential(100.0, 500), rng.exponential(50.0, 500)
    shown = np.minimum(lasts, cut)
    assert distributions.mean(fit_law(shown, lasts <= cut, 100.0)) == pytest.approx(100.0, rel=0.2)
    assert shown.mean() < 40.0


def test_few_stays_give_an_exponential_and_none_ended_a_finite_mean() -> None:
    few = fit_law([10.0] * (MIN_ENDED_STAYS - 1), [True] * (MIN_ENDED_STAYS - 1), 30.0)
    assert few.kind == "exponential"
    assert few.params["mean"] == pytest.approx((110.0 + 15.0) / 11.5)
    assert fit_law([50.0], [False], 30.0).params["mean"] == pytest.approx(130.0)
    assert fit_law([], [], 30.0).params["mean"] == 30.0


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.floats(0, 1e6), st.booleans()), max_size=40), st.floats(1e-3, 1e6))
def test_whatever_the_stays_the_law_can_be_run_and_has_a_finite_mean(
    stays: list[tuple[float, bool]], typical: float
) -> None:
    law = fit_law([length for length, _ in stays], [ended for _, ended in stays], typical)
    distributions.check_distribution(law)
    assert 0 < distributions.mean(law) < np.inf
    rest = distributions.draw_residual(law, 10.0, 50, np.random.default_rng(1))
    assert np.all((rest >= 0) & (rest < np.inf))


def test_bad_stays_are_refused() -> None:
    for lengths, ended, typical in (([1.0], [], 1.0), ([-1.0], [True], 1.0), ([1.0], [True], 0.0)):
        with pytest.raises(ValueError, match="stays need"):
            fit_law(lengths, ended, typical)


def test_next_locations_are_counts_and_a_half_for_each_edge_to_a_place_that_is_stayed_in() -> None:
    traces = [trace(10.0, (3.0, "on"), (5.0, "up"), (6.0, "stop"), (8.0, "on"))]
    stays = fit_stays(THREE, traces)
    assert stays["off"].to == pytest.approx({"low": 2.5 / 3.0, "high": 0.5 / 3.0})
    assert stays["low"].to == pytest.approx({"high": 0.75, "off": 0.25})
    assert stays["high"].to == pytest.approx({"off": 0.75, "low": 0.25})


def test_a_place_that_is_never_left_gets_no_stay() -> None:
    assert fit_stays(THREE, [trace(10.0)]) == {}
    assert set(fit_stays(THREE, [trace(10.0, (0.0, "on"))])) == set()
    assert fit_stays(THREE, []) == {}


def test_the_order_of_the_traces_does_not_matter() -> None:
    model = two_states()
    traces = [simulate_two(model, 1500, np.random.default_rng(seed))[0] for seed in range(4)]
    assert fit_stays(model, traces) == fit_stays(model, traces[::-1])


def test_a_simulated_plant_gives_back_its_stays_and_they_can_be_run() -> None:
    model = two_states()
    traces = [simulate_two(model, 3000, np.random.default_rng(seed))[0] for seed in range(6)]
    stays = fit_stays(model, traces)
    ended = 18_000 / 150
    assert distributions.mean(stays["cold"].law) == pytest.approx(60.0, rel=4 / np.sqrt(ended))
    assert distributions.mean(stays["hot"].law) == pytest.approx(90.0, rel=4 / np.sqrt(ended))
    assert stays["cold"].to == {"hot": 1.0}
    compile_chain(two_states(stays))


def test_inputs_vary_from_stay_to_stay_around_their_time_average() -> None:
    model = two_states(gain=0.1)
    times = np.arange(0.0, 50.0, 10.0)
    current = np.array([0.0, 60.0, np.nan, 0.0, 80.0])
    events = (Event(10.0, "W_ON"), Event(30.0, "W_OFF"), Event(40.0, "W_ON"), Event(40.0, "W_OFF"))
    first = Trace("a", times, {"T": np.full(5, 20.0), "A": current}, events)
    second = Trace(
        "b", times, {"T": np.full(5, 20.0), "A": np.full(5, 90.0)}, (Event(0.0, "W_ON"), Event(20.0, "W_OFF"))
    )
    stays = fit_stays(model, [first, second])
    # 20 s at 60 A in the first trace, 20 s at 90 A in the second.
    assert stays["hot"].inputs["A"] == pytest.approx((75.0, 15.0))
    assert stays["cold"].inputs == {}
    alone = fit_stays(model, [first])["hot"].inputs["A"]
    assert alone == pytest.approx((60.0, 0.0))

"""Thermostats whose openings the catalogue's formula does not contain are named, and gradual ones are followed."""

from collections.abc import Callable

import numpy as np
import pytest

from sim.lab.discrepancy.fitting.baseline import build_frame
from sim.lab.discrepancy.fitting.candidates import catalogue_entry
from sim.lab.discrepancy.fitting.course import run_frame
from sim.lab.discrepancy.fitting.free_run_fit import fit
from sim.lab.discrepancy.fitting.named import Named, automaton_effects
from sim.lab.discrepancy.fitting.record import build_record
from sim.lab.discrepancy.workflow import diagnose
from tests.discrepancy.plants import PERIOD, model
from tests.discrepancy.valves import Hidden, plant

SINK = 17.0


def opening(target: Callable[[float, float], float], loss: float, lag: float) -> Hidden:
    """A loss (1/s) towards SINK by an opening that follows, with a lag (s), what `target(X, before)` asks for."""
    share, asked = 0.0, 0.0

    def heat(_time: float, x: float, _signals: dict[str, float]) -> float:
        nonlocal share, asked
        asked = target(x, asked)
        share += (asked - share) * (1.0 - np.exp(-PERIOD / lag))
        return float(-loss * share * (x - SINK))

    return heat


def wax(x: float, _before: float) -> float:
    """Nearly closed at 44 degC, nearly open at 50."""
    return float(1.0 / (1.0 + np.exp(-(x - 47.0))))


def switch(x: float, before: float) -> float:
    """Open from 48 degC on, closed from 44 degC down."""
    return 1.0 if x >= 48.0 else 0.0 if x <= 44.0 else before


def test_a_valve_that_opens_gradually_is_followed_and_not_only_named() -> None:
    found = diagnose(model(), [plant(12, opening(wax, 6e-4, lag=20.0))], seed=0).diagnosis
    (effect,) = found.effects
    assert (found.verdict, effect.name, effect.params["gradual"]) == ("named", "thermostatic-cooling", 1.0)
    assert 42.0 < effect.params["opens"] < 47.0
    assert found.held_out is not None
    assert found.held_out.rmse_after < 0.2 * found.held_out.rmse_before  # a switch in its place: 0.31 of it


def test_a_switch_that_takes_its_time_stays_a_switch() -> None:
    found = diagnose(model(), [plant(11, opening(switch, 3e-4, lag=60.0), days=2)], seed=0).diagnosis
    effect = found.effects[0]
    assert (effect.name, effect.params["gradual"]) == ("thermostatic-cooling", 0.0)
    assert effect.params["opens"] == pytest.approx(48.0, abs=0.5)
    assert effect.params["closes"] == pytest.approx(44.0, abs=0.5)


def gradual(opens: float, loss: float) -> Named:
    params = {"opens": opens, "closes": opens, "sink": opens, "gradual": 1.0, "loss": loss}
    return Named(catalogue_entry("thermostatic-cooling"), {}, params)


def test_where_a_gradual_thermostat_opens_is_fitted_with_its_strength() -> None:
    trace = plant(3, lambda _time, x, _signals: -1.5e-3 * max(x - 47.0, 0.0), days=4)
    frame = build_frame(build_record(model(), [trace], ()))
    fitted = fit(frame, [gradual(43.0, 5e-4)])
    (effect,) = automaton_effects(fitted.state.named[0], model())
    assert effect.params["opens"] == pytest.approx(47.0, abs=0.5)
    assert effect.params["loss"] == pytest.approx(1.5e-3, rel=0.25)
    assert effect.params["opens"] == effect.params["closes"] == effect.params["sink"]


def test_a_gradual_thermostat_cools_from_where_it_opens_on() -> None:
    frame = build_frame(build_record(model(), [plant(5, lambda *_: 0.0, days=1)], ()))
    start = frame.record.reading[frame.record.window_first]
    valve = gradual(45.0, 2e-3)
    state = run_frame(frame, np.concatenate([frame.centre, valve.point]), start, [valve])
    runs = frame.record.runs
    middle = 0.5 * (state.course + np.concatenate([state.course[:1], state.course[:-1]]))
    later = ~runs.first
    np.testing.assert_array_equal(state.loss[later] > 0, middle[later] > 45.0)
    assert 0.1 < np.mean(state.loss > 0) < 0.9
    again = run_frame(frame, np.concatenate([frame.centre, valve.point]), start, [valve], state.course)
    np.testing.assert_allclose(again.course, state.course, atol=1e-6)


def test_a_fit_that_would_begin_with_a_loss_below_nothing_does_not_run_away() -> None:
    frame = build_frame(build_record(model(), [plant(3, opening(wax, 6e-4, lag=20.0), days=2)], ()))
    course = fit(frame, [gradual(41.0, -0.02)], rounds=1, iterations=1).state
    assert np.max(np.abs(course.mean)) < 200.0 and course.named[0].strength > 0

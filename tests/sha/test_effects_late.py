"""A heat that comes late: known from the signals alone, the same in schedule, filter, forecast and bounds."""

import json
from dataclasses import asdict, replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from sim.effects.check import check_effect
from sim.effects.late import late_jumps
from sim.engine.belief import WAITING_PARTS, advance, on_event, start, with_inputs
from sim.engine.belief_state import restore_belief
from sim.engine.moment_equations import moments
from sim.engine.plant import compile_plant
from sim.engine.schedules import schedule
from sim.engine.tracker import compile_model
from sim.forecast.fan import forecast
from sim.sha.automaton import SHA, Distribution, Edge, Effect, Flow, Location
from sim.sha.events import Alphabet, Switch
from sim.sha.model import Model
from sim.sha.trace import Array, Event, Trace

GAIN, REFERENCE = 2e-6, 150.0
EVENTS = [Event(100.0, "W_ON"), Event(3103.3, "W_OFF")]
OUTPUTS = np.arange(0.0, 6000.0, 50.0)


def late(lag: float, delay: float = 0.0) -> Effect:
    params = {"gain": GAIN, "reference": REFERENCE, "lag": lag, "delay": delay}
    return Effect("quadratic-current-heating", params, {"current": "I"}, ("on",))


def sha(*effects: Effect, k: float = 1 / 1500, spread: float = 0.0) -> SHA:
    places = tuple(
        Location(
            name,
            Flow("exponential", {"k": rate, "noise": spread}),
            Distribution("normal", {"mu": target, "sigma": spread}),
        )
        for name, rate, target in (("off", 1 / 3600, 17.0), ("on", k, 50.0))
    )
    return SHA("w", places, (Edge("off", "W_ON", "on"), Edge("on", "W_OFF", "off")), "off", effects=effects)


def model(*effects: Effect) -> Model:
    return Model(sha(*effects), Alphabet((Switch("on", "W_ON", "W_OFF"),)), "T", 0.1)


def current() -> Trace:
    """Changing while it runs, none after the stop, and the same again at times."""
    rng = np.random.default_rng(1)
    times = np.concatenate([[5.0], np.sort(rng.uniform(100.0, 3000.0, 25)), [3050.0, 3103.3, 5000.0]])
    return Trace("t", times, {"I": np.concatenate([[10.0], rng.uniform(100.0, 300.0, 25), [150.0, 0.0, 0.0]])})


def integrated(lag: float, k: float, inputs: Trace) -> Array:
    """X at the outputs, the heat through the lag being a state of its own."""
    clock, column = inputs.times, inputs.signals["I"]
    marks = np.unique(np.concatenate([clock, OUTPUTS, [event.time for event in EVENTS]]))
    x, warm, found = 20.0, np.nan, {}
    for begin, end in zip(marks, np.append(marks[1:], marks[-1] + 1.0), strict=True):
        found[begin] = x
        row = int(np.searchsorted(clock, begin, side="right")) - 1
        running, read = EVENTS[0].time <= begin < EVENTS[1].time, row >= 0
        square = float(column[row] ** 2) if read else 0.0
        warm = square if np.isnan(warm) and read else warm

        def slope(_t: float, s: Array, square: float = square, running: bool = running, read: bool = read) -> Array:
            rate, target = (k, 50.0) if running else (1 / 3600, 17.0)
            at_once = square - REFERENCE**2 if running and read else 0.0
            return np.array([rate * (target - s[0]) + GAIN * (at_once + s[1] - square), (square - s[1]) / lag])

        begun = [x, warm if read else 0.0]
        x, last = solve_ivp(slope, (begin, end), begun, rtol=1e-11, atol=1e-12, method="DOP853").y[:, -1]
        warm = last if read else np.nan
    return np.array([found[time] for time in OUTPUTS])


@pytest.mark.parametrize("lag", [3.0, 20.0, 90.0, 1500.0])
@pytest.mark.parametrize("k", [1 / 1500, 1 / 60])
def test_the_course_is_that_of_the_written_equations(lag: float, k: float) -> None:
    inputs = current()
    found = moments(schedule(sha(late(lag), k=k), EVENTS, OUTPUTS, inputs=inputs), 20.0).mean
    assert np.abs(found - integrated(lag, k, inputs)).max() < 1e-6


def test_without_a_lag_it_is_the_heat_that_is_there_at_once() -> None:
    at_once = replace(late(0.0), params={"gain": GAIN, "reference": REFERENCE})
    inputs = current()
    without, zero = (schedule(sha(each), EVENTS, OUTPUTS, inputs=inputs) for each in (at_once, late(0.0)))
    assert np.array_equal(moments(zero, 20.0).mean, moments(without, 20.0).mean)
    assert np.array_equal(zero.dt, without.dt)
    plant = compile_plant(sha(late(0.0)))
    assert plant.steady_linear and not plant.late
    assert not compile_plant(sha(late(1.0))).steady_linear


def test_a_short_lag_is_nearly_none() -> None:
    inputs = current()
    found, at_once = (
        moments(schedule(sha(late(lag)), EVENTS, OUTPUTS, inputs=inputs), 20.0).mean for lag in (0.05, 0.0)
    )
    assert 0.0 < np.abs(found - at_once).max() < 0.01


def test_what_was_not_read_makes_no_jump() -> None:
    assert late_jumps(np.array([np.nan, 1.0, 1.0]), np.array([1.0, 3.0, np.nan])).tolist() == [0.0, -2.0, 0.0]


@pytest.mark.parametrize("delay", [0.0, 400.0])
def test_the_filter_at_every_second_is_the_schedule_and_outlives_a_restart(delay: float) -> None:
    tracker, inputs = compile_model(model(late(60.0, delay))), current()
    clock = np.arange(0.0, 4000.0)
    expected = moments(schedule(tracker.model, EVENTS, clock, inputs=inputs), 20.0).mean
    belief, found = start(tracker, 0.0, 20.0), []
    coming = list(EVENTS)
    rows = list(zip(inputs.times.tolist(), inputs.signals["I"].tolist(), strict=True))
    for time in clock.tolist():
        while rows and rows[0][0] <= time:
            # Events come before the readings of their instant.
            while coming and coming[0].time <= rows[0][0]:
                belief = on_event(tracker, belief, coming.pop(0))
            at, value = rows.pop(0)
            belief = with_inputs(tracker, belief, at, {"I": value})
        while coming and coming[0].time <= time:
            belief = on_event(tracker, belief, coming.pop(0))
        belief = advance(tracker, belief, time)
        if time in (2000.0, 3120.0):  # while it runs, and while it goes on after the stop
            assert belief.hidden is not None and belief.hidden.late[0] != 0.0
            again = restore_belief(json.loads(json.dumps(asdict(belief))))
            assert again == belief
            belief = again
        found.append(belief.x)
    assert np.abs(np.array(found) - expected).max() < 1e-6


def test_a_current_that_is_read_twice_a_second_leaves_no_more_on_its_way_than_a_forecast_can_look_at() -> None:
    tracker, rng = compile_model(model(late(60.0, 600.0))), np.random.default_rng(2)
    times = np.arange(0.0, 1500.0, 0.5)
    inputs = Trace("t", times, {"I": np.where(times < 700.0, 200.0, 120.0) + 5.0 * rng.standard_normal(times.size)})
    running = [Event(0.0, "W_ON")]
    expected = moments(schedule(tracker.model, running, times, inputs=inputs), 20.0).mean
    belief, found, most = on_event(tracker, start(tracker, 0.0, 20.0), running[0]), [], 0
    for time, value in zip(times.tolist(), inputs.signals["I"].tolist(), strict=True):
        belief = with_inputs(tracker, belief, time, {"I": value})
        most = max(most, len(belief.hidden.pending if belief.hidden is not None else ()))
        found.append(belief.x)
    assert WAITING_PARTS <= most <= 2 * WAITING_PARTS
    # As if it came earlier by two parts of the delay at most: the noise of the current adds to what it takes.
    parts = 2 * 600.0 / WAITING_PARTS
    assert np.abs(np.array(found) - expected).max() < parts * np.abs(np.diff(expected) / np.diff(times)).max()


def test_a_belief_that_was_saved_before_there_were_late_heats_is_read() -> None:
    saved = json.loads(json.dumps(asdict(start(compile_model(model(late(0.0))), 0.0, 20.0))))
    del saved["hidden"]["late"]
    assert restore_belief(saved).hidden is not None


@pytest.mark.parametrize("delay", [0.0, 150.0])
def test_a_forecast_has_what_goes_on_after_the_stop(delay: float) -> None:
    tracker = compile_model(model(late(120.0, delay)))
    belief = start(tracker, 0.0, 20.0, {"I": 0.0})
    belief = with_inputs(tracker, on_event(tracker, belief, Event(0.0, "W_ON")), 0.0, {"I": 300.0})
    belief = on_event(tracker, advance(tracker, belief, 1000.0), Event(1000.0, "W_OFF"))
    belief = with_inputs(tracker, belief, 1000.0, {"I": 0.0})
    horizons = (60.0, 200.0, 900.0)
    fan = forecast(tracker, belief, horizons, np.random.default_rng(0), events=(), runs=4000, levels=(0.25, 0.5, 0.75))
    expected = [advance(tracker, belief, 1000.0 + ahead).x for ahead in horizons]
    assert np.abs(fan.quantiles[1] - expected).max() < 0.02
    settled = replace(belief, hidden=replace(belief.hidden, late=(0.0,), pending=()))  # type: ignore[type-var]
    assert expected[0] - advance(tracker, settled, 1060.0).x > 5.0


def test_a_negative_lag_is_refused() -> None:
    with pytest.raises(ValueError, match="'quadratic-current-heating': lag must be at least 0 and finite, got -1"):
        check_effect(late(-1.0))

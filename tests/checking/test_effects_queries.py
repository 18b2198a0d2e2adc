"""Queries about a model with effects run along recorded events: the law of the runs is that of the simulator."""

from dataclasses import replace

import numpy as np
import pytest

from sim.engine.belief import advance, filter_trace
from sim.engine.open_loop_run import open_loop
from sim.lab.checking.language.parse import parse_query
from sim.lab.checking.smc.answers import QuerySettings, answer
from sim.lab.checking.smc.start import believed_start, initial
from sim.sha.automaton import Effect
from sim.sha.events import Alphabet, Switch
from sim.sha.model import Model
from sim.sha.trace import Event, Trace
from tests.sha.effect_reference import EFFECTS, LATE, TOGETHER, course, plant

EVERY = {**EFFECTS, **TOGETHER, **LATE}
ALPHABET = Alphabet((Switch("on", "W_ON", "W_OFF"),))
RUNS = 1500
BEGIN = 1.0e6


def made(*effects: Effect, kind: str = "exponential") -> Model:
    return Model(plant(kind, effects), ALPHABET, "Temp", 0.1)


def recorded(length: float = 1200.0, begin: float = 0.0) -> Trace:
    """A trace with a reading each 50 s, starts, stops and changing signals."""
    events, inputs = course(4, length)
    readings = np.arange(0.0, length + 1.0, 50.0)
    times = np.union1d(inputs.times, readings).astype(np.float64)
    signals = {name: np.full(times.size, np.nan) for name in inputs.signals}
    for name, column in inputs.signals.items():
        signals[name][np.searchsorted(times, inputs.times)] = column
    signals["Temp"] = np.where(np.isin(times, readings), 24.0, np.nan)
    return Trace("course", times + begin, signals, tuple(Event(e.time + begin, e.symbol) for e in events))


@pytest.mark.parametrize("name", EVERY)
def test_the_temperature_at_the_end_has_the_mean_and_spread_of_the_open_loop(name: str) -> None:
    model, trace = made(*EVERY[name]), recorded()
    start = initial(model, trace)
    query = parse_query("simulate [<=1000; 600] {Temp}", model.sha)
    found = answer(query, start, QuerySettings(seed=3))
    last = np.array([one.values[0, -1] for one in found.courses or ()])
    native = open_loop(model, trace, "resync")
    row = int(np.searchsorted(native.times, 1000.0, side="right")) - 1
    assert native.times[row] == 1000.0
    sigma = float(np.sqrt(native.variance[row]))
    cycling = any(effect.kind == "thermostatic-cooling" for effect in EVERY[name])
    assert last.mean() == pytest.approx(
        native.mean[row], abs=1.5 if cycling else 5.0 * sigma / np.sqrt(last.size) + 0.01
    )
    assert cycling or last.std() == pytest.approx(sigma, rel=0.15)


def test_the_chance_of_a_peak_between_readings_is_that_of_a_fine_grid() -> None:
    """Half of the runs pass the mean of their highest temperatures, as two queries with grids of their own say."""
    model, trace = made(*EVERY["current-heating"]), recorded()
    start = initial(model, trace)
    peak = answer(parse_query(f"E[<=900; {RUNS}](max: Temp)", model.sha), start, QuerySettings(seed=1))
    level = peak.numbers["mean"]
    chance = answer(parse_query(f"Pr[<=900; {RUNS}](<> Temp >= {level:.4f})", model.sha), start, QuerySettings(seed=2))
    assert chance.numbers["probability"] == pytest.approx(0.5, abs=0.06)


def test_a_step_of_the_sensor_is_seen_at_its_moment() -> None:
    model = made(Effect("sensor-offset-step", {"size": 30.0, "at": BEGIN + 400.0}))
    start = initial(model, recorded(begin=BEGIN))
    seen = {
        bound: answer(parse_query(f"Pr[<={bound}; 200](<> Temp >= 48)", model.sha), start, QuerySettings()).numbers[
            "probability"
        ]
        for bound in (399, 401)
    }
    assert seen == {399: 0.0, 401: 1.0}


def test_runs_from_a_belief_go_on_where_its_hidden_state_is() -> None:
    model, trace = made(*EVERY["pump, housing, lag, dead time"], *EVERY["startup-churning"]), recorded(begin=BEGIN)
    start = believed_start(model, trace, BEGIN + 600.0, recorded=True)
    belief = start.world.belief
    assert belief is not None and belief.hidden is not None
    query = parse_query("simulate [<=400; 800] {Temp}", model.sha)
    found = answer(query, start, QuerySettings(seed=3))
    first, last = (np.array([one.values[0, at] for one in found.courses or ()]) for at in (0, -1))
    assert first.mean() == pytest.approx(belief.x, abs=5 * belief.sigma / np.sqrt(first.size) + 1e-3)
    blind = np.where(trace.times > BEGIN + 600.0, np.nan, trace.signals["Temp"])
    later = replace(trace, signals={**trace.signals, "Temp": blind}).between(BEGIN, BEGIN + 1000.0 + 1e-6)
    ahead = advance(model, filter_trace(model, later).belief, BEGIN + 1000.0)
    assert last.mean() == pytest.approx(ahead.x, abs=5 * ahead.sigma / np.sqrt(last.size))
    assert last.std() == pytest.approx(ahead.sigma, rel=0.12)


def test_what_is_not_done_says_so_in_one_sentence() -> None:
    model, trace = made(*EVERY["current-heating"]), recorded()
    query = parse_query("Pr[<=100](<> Temp >= 90)", model.sha)
    with pytest.raises(ValueError, match="importance splitting does not follow effects"):
        answer(query, initial(model, trace), QuerySettings(rare=True))
    free = replace(model, initial=model.sha.locations[0].distribution)
    with pytest.raises(ValueError, match="the semi-Markov law does not give: let a trace drive the runs"):
        answer(query, initial(free), QuerySettings())

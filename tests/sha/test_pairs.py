"""The engines of plain models and those of effects are pairs for speed (decision 0049): here they are held together.

A plain model goes through an engine of effects when it has an effect that does nothing. Where both are exact they agree
to rounding; where runs are drawn, in distribution; where only the plain one is in closed form, to the stated accuracy.
"""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import ks_2samp

from sim.engine.belief import Belief, advance, observe, on_event, start, with_inputs
from sim.engine.moment_equations import moments
from sim.engine.schedules import Schedule, schedule
from sim.engine.simulation import simulate
from sim.engine.tracker import compile_model
from sim.forecast.fan import forecast
from sim.lab.checking.language.parse import parse_query
from sim.lab.checking.smc.answers import QuerySettings, answer
from sim.lab.checking.smc.start import initial
from sim.sha.automaton import SHA, Distribution, Effect
from sim.sha.events import DECANTER
from sim.sha.model import Model
from sim.sha.trace import Event, Trace
from tests.sha.models import EVERYWHERE, limited
from tests.sha.plants import exponential_stays, two_states

NOTHING = (Effect("sensor-offset-step", {"size": 0.0, "at": 0.0}),)
CLOSED_FORM = ("off", "idle", "load", "hold", "fresh", "plain")
"""Where both engines are exact: all but the logarithmic flow, whose drive the engine of effects takes as parabolas."""

events_of = st.lists(st.tuples(st.floats(0.0, 40.0), st.sampled_from(CLOSED_FORM)), max_size=8)
readings_of = st.lists(st.tuples(st.floats(0.01, 30.0), st.floats(0.0, 60.0)), min_size=1, max_size=12)


def with_nothing(sha: SHA) -> SHA:
    return replace(sha, effects=NOTHING)


def along(gaps: list[tuple[float, str]]) -> list[Event]:
    times = np.cumsum([gap for gap, _ in gaps])
    return [Event(float(time), symbol) for time, (_, symbol) in zip(times, gaps, strict=True)]


def both(sha: SHA, events: list[Event], end: float = 400.0) -> tuple[Schedule, Schedule]:
    """The same course without effects and with the one that does nothing, the current changing on its way."""
    outputs = np.unique([*np.linspace(0.0, end, 21), *(event.time for event in events if event.time < end)])
    inputs = Trace("t", np.array([0.0, 70.0, 150.0]), {"Assorbimento": np.array([50.0, 90.0, 20.0])})
    plain, other = (schedule(each, events, outputs, inputs=inputs) for each in (sha, with_nothing(sha)))
    assert plain.segments is None and other.segments is not None
    return plain, other


@settings(deadline=None, max_examples=60)
@given(events_of, st.floats(0.0, 100.0), st.floats(0.0, 4.0))
def test_means_and_variances_along_a_schedule_agree(gaps: list[tuple[float, str]], x0: float, variance0: float) -> None:
    plain, other = (moments(steps, x0, variance0) for steps in both(EVERYWHERE, along(gaps)))
    assert other.mean == pytest.approx(plain.mean, abs=1e-9)
    assert other.variance == pytest.approx(plain.variance, rel=1e-9, abs=1e-9)
    assert other.location.tolist() == plain.location.tolist() and other.clamps == plain.clamps


@pytest.mark.parametrize(("sha", "accuracy"), [(EVERYWHERE, 1e-6), (limited(0.05), 0.05)], ids=["1/time", "limited"])
def test_what_only_the_plain_engine_takes_in_closed_form_comes_close(sha: SHA, accuracy: float) -> None:
    """Under a maximum rate the engine of effects limits a step's slope, the plain one the drift at every moment."""
    events = [Event(30.0, "peak"), Event(120.0, "idle"), Event(200.0, "peak"), Event(260.0, "load")]
    plain, other = (moments(steps, 20.0) for steps in both(sha, events))
    assert other.mean == pytest.approx(plain.mean, abs=accuracy)


@settings(deadline=None, max_examples=40)
@given(readings_of, events_of, st.lists(st.floats(0.0, 200.0), max_size=4))
def test_the_filter_agrees_on_states_and_likelihood(
    readings: list[tuple[float, float]], gaps: list[tuple[float, str]], currents: list[float]
) -> None:
    def followed(sha: SHA) -> Belief:
        tracker = compile_model(Model(sha, DECANTER, "T", 0.1))
        times = np.cumsum([gap for gap, _ in readings])
        coming: list[tuple[float, int, float | Event]] = [
            (float(time), 2, value) for time, (_, value) in zip(times, readings, strict=True)
        ]
        coming += [(event.time, 0, event) for event in along(gaps)]
        coming += [(25.0 * number, 1, value) for number, value in enumerate(currents)]
        belief = start(tracker, 0.0, 20.0)
        for time, rank, what in sorted(coming, key=lambda each: each[:2]):
            if isinstance(what, Event):
                belief = on_event(tracker, belief, what)
            elif rank == 1:
                belief = with_inputs(tracker, belief, time, {"Assorbimento": what})
            else:
                belief = observe(tracker, belief, time, what)
        return advance(tracker, belief, 600.0)

    plain, other = followed(EVERYWHERE), followed(with_nothing(EVERYWHERE))
    for part in ("x", "m", "xx", "xm", "mm", "evidence", "offset"):
        assert getattr(other, part) == pytest.approx(getattr(plain, part), rel=1e-6, abs=1e-6), part
    for part in ("location", "entered", "time", "signals", "samples", "unmatched", "late", "clamps"):
        assert getattr(other, part) == getattr(plain, part), part
    assert other.recent == pytest.approx(plain.recent, rel=1e-6, abs=1e-6)


@pytest.mark.parametrize("sha", [EVERYWHERE, limited(0.4)], ids=["free", "limited"])
def test_runs_have_the_same_law_at_every_output(sha: SHA) -> None:
    events = [
        Event(10.0, "load"),
        Event(60.0, "fresh"),
        Event(100.0, "idle"),
        Event(180.0, "peak"),
        Event(230.0, "off"),
    ]
    law = Distribution("normal", {"mu": 25.0, "sigma": 2.0})
    plain, other = (
        simulate(steps, law, 4000, np.random.default_rng(seed)).temperatures
        for seed, steps in enumerate(both(sha, events))
    )
    chances = [ks_2samp(a, b).pvalue for a, b in zip(plain.T, other.T, strict=True)]
    assert min(chances) > 0.01 / len(chances)


def test_forecasts_have_the_same_fan_and_exceedance() -> None:
    model = two_states(exponential_stays(), gain=0.02)
    made = []
    for seed, sha in enumerate((model.sha, with_nothing(model.sha))):
        tracker = compile_model(replace(model, sha=sha))
        belief = on_event(tracker, start(tracker, 0.0, 40.0, {"A": 60.0}), Event(0.0, "W_ON"))
        belief = observe(tracker, belief, 30.0, 44.0)
        rng = np.random.default_rng(seed)
        made.append(forecast(tracker, belief, (60.0, 300.0, 900.0), rng, limit=62.0, runs=4000))
    plain, other = made
    # A quantile of 4,000 runs scatters by a few hundredths of the band's width.
    width = plain.quantiles[-1] - plain.quantiles[0]
    assert np.all(np.abs(other.quantiles - plain.quantiles) < 0.05 * width)
    for a, b in zip(plain.exceedance, other.exceedance, strict=True):
        assert abs(a.probability - b.probability) < 4.0 * np.hypot(a.high - a.low, b.high - b.low) / 3.92


def test_runs_of_a_query_along_known_events_have_the_same_law() -> None:
    model = two_states()
    trace = Trace("t", np.array([0.0, 600.0]), {"T": np.full(2, 30.0)}, (Event(100.0, "W_ON"), Event(400.0, "W_OFF")))
    found = []
    for sha in (model.sha, with_nothing(model.sha)):
        query, begin = parse_query("Pr[<=600](<> Temp >= 62)", sha), initial(replace(model, sha=sha), trace)
        found.append(answer(query, begin, QuerySettings(seed=5, rule="fixed", runs=20_000)))
    plain, other = (one.numbers for one in found)
    assert 0.1 < plain["probability"] < 0.9
    assert plain["low"] - 0.01 < other["probability"] < plain["high"] + 0.01

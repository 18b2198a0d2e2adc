"""Stochastic runs and forecasts with effects: their law against the moments, and against each other."""

from dataclasses import replace

import numpy as np
import pytest

from sim.effects import with_targets
from sim.engine.belief import on_event, start, with_inputs
from sim.engine.moment_equations import mean_outputs, moments
from sim.engine.schedules import schedule
from sim.engine.simulation import simulate
from sim.engine.tracker import compile_model
from sim.forecast.fan import forecast
from sim.sha.automaton import Distribution, Effect
from sim.sha.events import Alphabet, Switch
from sim.sha.model import Model, Stay
from sim.sha.trace import Event, Trace
from tests.sha.effect_reference import EFFECTS, LATE, TOGETHER, course, plant
from tests.sha.models import normal

LINEAR = {name: each for name, each in (EFFECTS | TOGETHER | LATE).items() if "thermostat" not in name}
RUNS = 4000
FIVE_SIGMA = 5.0


def model(kind: str, effects: tuple[Effect, ...], **more: object) -> Model:
    return replace(
        Model(plant(kind, effects), Alphabet((Switch("on", "W_ON", "W_OFF"),)), "T", 0.1),
        **more,  # type: ignore[arg-type]
    )


@pytest.mark.parametrize("name", LINEAR)
def test_mean_and_variance_of_many_runs_are_the_moments(name: str) -> None:
    kind = {"sensor-lag 1": "logarithmic", "pump-cooling": "linear"}.get(name, "driven")
    events, inputs = course(3, 1500.0)
    steps = schedule(plant(kind, LINEAR[name]), events, np.arange(0.0, 1501.0, 75.0), inputs=inputs)
    expected = moments(steps, 21.0, 0.25)
    runs = simulate(steps, normal(21.0, 0.5), RUNS, np.random.default_rng(1)).temperatures
    z = (runs.mean(axis=0) - expected.mean) / np.sqrt(expected.variance / RUNS)
    assert np.abs(z).max() < FIVE_SIGMA
    assert np.abs(runs.var(axis=0) / expected.variance - 1.0).max() < FIVE_SIGMA * np.sqrt(2.0 / RUNS)


def test_each_run_has_a_thermostat_of_its_own() -> None:
    sha = plant("driven", EFFECTS["thermostatic-cooling"])
    inputs = Trace("i", np.array([0.0]), {"I": np.array([100.0])})
    steps = schedule(sha, [Event(0.0, "W_ON")], np.arange(0.0, 3000.0, 20.0), inputs=inputs)
    runs = simulate(steps, 21.0, 200, np.random.default_rng(0)).temperatures
    settled = runs[:, 50:]
    assert settled.max() < 39.5  # 38 and the noise of one segment
    assert settled.min() > 33.5
    assert np.diff(np.sort(settled[:, -1])).max() < 1.0  # they have lost step: all temperatures in between occur
    assert settled[:, -1].std() > 0.5


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("quadratic-current-heating", "driven"),
        ("pump-cooling", "linear"),
        ("startup-churning", "exponential"),
        ("sensor-lag 1", "driven"),
        ("sensor-offset-step", "linear"),
        ("housing-thermal-mass", "driven"),
        ("thermostatic-cooling", "driven"),
        ("radiation-loss", "driven"),
        ("pump, housing, lag, dead time", "driven"),
        ("late heat", "driven"),
    ],
)
def test_a_forecast_with_known_events_has_the_quantiles_of_the_simulation(name: str, kind: str) -> None:
    tracker = compile_model(model(kind, (EFFECTS | TOGETHER | LATE)[name]))
    held = {"I": 150.0, "Ta": 15.0, "P": 1.0, "M": 10.0}
    future = [Event(100.0, "W_ON"), Event(700.0, "W_OFF")]
    fan = forecast(
        tracker,
        start(tracker, 0.0, 21.0, held),
        (60.0, 300.0, 900.0),
        np.random.default_rng(1),
        events=future,
        runs=1000,
        levels=(0.05, 0.5, 0.95),
    )
    inputs = Trace("held", np.array([-100.0]), {signal: np.array([value]) for signal, value in held.items()})
    steps = schedule(tracker.model, future, np.array([0.0, 60.0, 300.0, 900.0]), inputs=inputs)
    runs = simulate(steps, normal(21.0, 0.1), RUNS, np.random.default_rng(2)).temperatures[:, 1:]
    expected = np.quantile(runs + 0.1 * np.random.default_rng(3).normal(size=runs.shape), fan.levels, axis=0)
    assert np.abs(fan.quantiles - expected).max() < 0.2 * max(runs.std(axis=0).max(), 1.0)


STAYS = {
    "off": Stay(Distribution("weibull", {"shape": 8.0, "scale": 300.0}), {"on": 1.0}, {"P": (0.0, 0.0)}),
    "on": Stay(Distribution("weibull", {"shape": 8.0, "scale": 600.0}), {"off": 1.0}, {"P": (1.0, 0.0)}),
}


def test_an_unknown_future_takes_effects_signals_from_the_stays_means() -> None:
    quiet = model("linear", EFFECTS["pump-cooling"], semi_markov=STAYS)
    pumped = compile_model(quiet)
    none = compile_model(replace(quiet, semi_markov={name: replace(stay, inputs={}) for name, stay in STAYS.items()}))
    fans = [
        forecast(each, start(each, 0.0, 60.0, {"P": 0.0}), (900.0,), np.random.default_rng(0))
        for each in (pumped, none)
    ]
    cooled, held = (fan.quantiles[2, 0] for fan in fans)
    assert cooled < held - 5.0  # the pump runs in `on`, which is known from its stays alone


def test_a_start_to_come_brings_its_churning_into_an_unknown_future() -> None:
    churning = (Effect("startup-churning", {"gain": 0.2, "tau": 60.0, "shape": 1.0}, {}, (), "W_ON"),)
    fans = []
    for effects in (churning, EFFECTS["sensor-offset-step"]):
        tracker = compile_model(model("constant", effects, semi_markov=STAYS))
        fans.append(forecast(tracker, start(tracker, 0.0, 22.0), (500.0,), np.random.default_rng(0)))
    warmed, plain = (fan.quantiles[2, 0] for fan in fans)
    assert warmed - plain == pytest.approx(0.2 * 60.0, abs=1.0)


def test_a_forecast_under_a_dead_time_knows_the_event_that_is_not_felt_yet() -> None:
    delayed = (Effect("dead-time", {"delay": 100.0}),)
    tracker = compile_model(model("linear", delayed, semi_markov=STAYS))
    belief = on_event(tracker, start(tracker, 0.0, 22.0), Event(10.0, "W_ON"))
    belief = with_inputs(tracker, belief, 20.0, {})
    assert belief.location == "off"
    fan = forecast(tracker, belief, (50.0, 200.0), np.random.default_rng(0))
    assert fan.locations[0] == {"off": 1.0}
    assert fan.locations[1] == {"on": 1.0}
    assert fan.quantiles[2, 1] > fan.quantiles[2, 0] + 0.5


@pytest.mark.parametrize("name", EFFECTS | TOGETHER | {"none": ()})
def test_the_means_of_several_runs_at_once_are_those_of_each_by_itself(name: str) -> None:
    """A run with other targets is that of an automaton whose locations have them; and they differ here."""
    events, inputs = course(3, 1500.0)
    sha, times = plant("driven", (EFFECTS | TOGETHER).get(name, ())), np.arange(0.0, 1501.0, 75.0)
    steps = schedule(sha, events, times, inputs=inputs)
    warmer = schedule(with_targets(sha, 3.0), events, times, inputs=inputs)
    found = mean_outputs(steps, [(21.0, 0.0), (22.0, 0.0), (21.0, 3.0), (21.0, np.full(steps.dt.size, 3.0))])
    expected = [moments(steps, 21.0), moments(steps, 22.0), moments(warmer, 21.0), moments(warmer, 21.0)]
    for mean, alone in zip(found, expected, strict=True):
        np.testing.assert_allclose(mean, alone.mean, rtol=0.0, atol=1e-9)
    assert np.abs(found[2] - found[0]).max() > 0.5 and np.abs(found[1] - found[0])[0] > 0.5

"""The mean course with effects: against the written equations, against the plain engines, under limits."""

from dataclasses import replace

import numpy as np
import pytest

from sim.engine.moment_equations import augmented_course, moments
from sim.engine.open_loop_run import open_loop
from sim.engine.schedules import schedule
from sim.engine.simulation import simulate
from sim.sha.automaton import SHA, Effect
from sim.sha.events import Alphabet, Switch
from sim.sha.model import Model
from sim.sha.trace import Array, Event, Trace
from tests.sha.effect_reference import EFFECTS, FLOWS, LATE, TOGETHER, course, plant, reference, without_noise
from tests.sha.models import EVERYWHERE, normal

ALL = EFFECTS | TOGETHER | LATE
EXACT, LINEARISED = 3e-5, 3e-4
OUTPUTS = np.concatenate([np.arange(0.0, 500.0, 10.0), [650.0, 900.0, 1390.0, 1400.0]])


def tolerance(name: str) -> float:
    """As docs/effects.md states: radiation is linearised, everything else is exact or nearly so."""
    return LINEARISED if "radiation" in name else EXACT


@pytest.mark.parametrize("name", ALL)
def test_the_mean_course_is_the_solution_of_the_written_equations(name: str) -> None:
    """Each effect over every other flow, and the next effect over those between them."""
    for seed, kind in list(enumerate(FLOWS))[list(ALL).index(name) % 2 :: 2]:
        sha = plant(kind, ALL[name])
        events, inputs = course(seed, 1400.0)
        expected = reference(sha, events, OUTPUTS, inputs, 21.0)
        found = moments(schedule(sha, events, OUTPUTS, inputs=inputs), 21.0)
        assert np.abs(found.mean - expected).max() < tolerance(name), kind


@pytest.mark.parametrize("name", ALL)
def test_runs_without_noise_are_the_mean_course(name: str) -> None:
    sha = without_noise(plant("driven", ALL[name]))
    events, inputs = course(7, 1400.0)
    steps = schedule(sha, events, OUTPUTS, inputs=inputs)
    expected = moments(steps, 21.0)
    found = simulate(steps, 21.0, 2, np.random.default_rng(0))
    assert np.abs(found.temperatures - expected.mean).max() < tolerance(name)
    assert expected.variance.max() < 1e-12


def idle() -> tuple[Effect, ...]:
    return tuple(
        replace(effect, params={**effect.params, name: 0.0})
        for effects in EFFECTS.values()
        for effect in effects
        for name in ("gain", "loss", "coupling", "size", "delay")
        if name in effect.params and effect.kind not in ("radiation-loss", "housing-thermal-mass")
        # A heat that comes late is as strong without its delay.
        if name != "delay" or effect.kind == "dead-time"
    )


def test_effects_of_strength_0_leave_the_plain_moments() -> None:
    for kind in FLOWS:
        off = [effect for effect in idle() if effect.kind != "dead-time"]
        plain, idling = plant(kind, ()), plant(kind, (*once(off), Effect("dead-time", {"delay": 0.0})))
        events, inputs = course(2)
        expected, found = (moments(schedule(sha, events, OUTPUTS, inputs=inputs), 21.0, 0.3) for sha in (plain, idling))
        np.testing.assert_allclose(found.mean, expected.mean, atol=1e-5)
        np.testing.assert_allclose(found.variance, expected.variance, rtol=1e-5, atol=1e-9)


def once(effects: list[Effect]) -> tuple[Effect, ...]:
    return tuple({effect.kind: effect for effect in effects}.values())


def test_a_location_that_draws_x_anew_does_so_with_effects_too() -> None:
    quiet = (Effect("wear-drift", {"gain": 0.0, "since": 0.0}), Effect("dead-time", {"delay": 0.0}))
    names = [place.name for place in EVERYWHERE.locations]
    rng = np.random.default_rng(4)
    times = np.cumsum(rng.uniform(5, 60, 40)).tolist()
    events = [Event(t, names[i]) for t, i in zip(times, rng.integers(0, 7, 40), strict=True)]
    inputs = Trace("i", np.arange(0.0, 1500.0, 20.0), {"Assorbimento": rng.uniform(0.0, 100.0, 75)})
    expected, found = (
        moments(schedule(sha, events, np.arange(0.0, 1400.0, 7.0), inputs=inputs), 20.0, 0.2)
        for sha in (EVERYWHERE, replace(EVERYWHERE, effects=quiet))
    )
    np.testing.assert_allclose(found.mean, expected.mean, atol=1e-4)
    np.testing.assert_allclose(found.variance, expected.variance, rtol=1e-4)


@pytest.mark.parametrize("name", ["thermostatic-cooling", "thermostat, radiation", "thermostat, housing, lag"])
def test_the_seconds_for_which_a_thermostat_is_open_do_not_depend_on_the_steps(name: str) -> None:
    """By the closed form for X alone, and by the kernel: a step in which it switches counts by its part."""
    sha = without_noise(plant("driven", ALL[name]))
    events, inputs = course(7, 1400.0)

    def opened(every: float) -> tuple[Array, Array]:
        steps = schedule(sha, events, np.arange(0.0, 1401.0, every), inputs=inputs)
        assert steps.segments is not None
        part = augmented_course(steps, 34.0)[2].opened
        ends = steps.segments.time + steps.segments.dt
        return part, np.interp(np.arange(0.0, 1401.0, 50.0), ends, np.cumsum(part * steps.segments.dt))

    (coarse, seconds), (_, finely) = opened(50.0), opened(0.25)
    assert ((coarse > 0.0) & (coarse < 1.0)).sum() >= 10 and seconds[-1] > 80.0
    np.testing.assert_allclose(seconds, finely, atol=1e-3)


def heated(effects: tuple[Effect, ...], **limits: float) -> SHA:
    return replace(plant("linear", effects), **limits)


HEATER = Effect("current-heating", {"gain": 1.0, "reference": 0.0}, {"current": "I"})
HOT = Trace("hot", np.array([0.0]), {"I": np.array([0.5])})


def test_the_mean_is_clamped_to_the_range_and_counted() -> None:
    steps = schedule(
        heated((HEATER,), low=0.0, high=40.0), [Event(10.0, "W_ON")], np.arange(0.0, 101.0, 10.0), inputs=HOT
    )
    found = moments(steps, 21.0)
    assert found.mean.max() == 40.0
    assert found.clamps > 0
    runs = simulate(steps, 21.0, 50, np.random.default_rng(0))
    assert runs.temperatures.max() <= 40.0
    assert (runs.clamps > 0).all()


def test_no_drift_exceeds_the_greatest_rate_and_such_steps_are_counted() -> None:
    steps = schedule(heated((HEATER,), max_rate=0.1), [Event(10.0, "W_ON")], np.arange(0.0, 101.0, 10.0), inputs=HOT)
    found = moments(steps, 21.0)
    assert np.diff(found.mean).max() == pytest.approx(1.0)
    assert found.limited == 10


def test_a_signal_that_was_not_read_yet_adds_nothing() -> None:
    pump = Effect("pump-cooling", {"loss": 0.01, "sink": 0.0}, {"pump": "P"})
    late = Trace("late", np.array([0.0, 100.0]), {"P": np.array([np.nan, 1.0])})
    outputs = np.array([0.0, 100.0, 200.0])
    plain = moments(schedule(plant("exponential", ()), [], outputs), 40.0)
    found = moments(schedule(plant("exponential", (pump,)), [], outputs, inputs=late), 40.0)
    assert found.mean[1] == pytest.approx(plain.mean[1])
    assert found.mean[2] < plain.mean[2] - 5.0


def test_an_effect_whose_signal_is_missing_is_told() -> None:
    with pytest.raises(ValueError, match="is driven by the signal 'P', which the inputs do not have"):
        schedule(plant("linear", EFFECTS["pump-cooling"]), [], np.array([0.0, 1.0]))


def test_an_open_loop_begins_where_the_sensor_reads_whatever_its_lag_and_offset() -> None:
    step = Effect("sensor-offset-step", {"size": 4.0, "at": -10.0})
    sha = plant("exponential", (step, *EFFECTS["sensor-lag 3"]))
    model = Model(sha, Alphabet((Switch("on", "W_ON", "W_OFF"),)), "T", 0.1)
    trace = Trace("t", np.array([0.0, 50.0]), {"T": np.array([26.0, 26.0])})
    assert open_loop(model, trace).mean == pytest.approx([26.0, 26.0])  # X is at 22, where `off` settles


def test_plain_models_give_the_numbers_they_gave_before_effects_existed() -> None:
    names = [place.name for place in EVERYWHERE.locations]
    events = [Event(17.0 * (i + 1), names[(3 * i * i + i) % 7]) for i in range(40)]
    inputs = Trace("i", np.arange(0.0, 700.0, 9.0), {"Assorbimento": 60.0 + 40.0 * np.sin(np.arange(78))})
    steps = schedule(EVERYWHERE, events, np.arange(0.0, 690.0, 6.0), inputs=inputs)
    found = moments(steps, 20.0, 0.3)
    runs = simulate(steps, normal(20.0, 0.5), 16, np.random.default_rng(3))
    sums = [steps.offset.sum(), found.mean.sum(), found.variance.sum(), runs.temperatures.sum()]
    assert steps.segments is None
    assert sums == pytest.approx(GOLDEN, rel=1e-12)


GOLDEN = [0.0, 3759.5942811054697, 109.14569452452966, 60565.14342429959]
"""Of the version before (commit 978045b); that day they were equal to the last bit."""

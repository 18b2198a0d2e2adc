"""The exported text of a model with effects, run by the interpreter, has the course of this program's open loop."""

from dataclasses import replace

import numpy as np
import pytest

from sim.effects.kinds import EFFECTS as KINDS
from sim.engine.open_loop_run import open_loop
from sim.lab.uppaal.model_export import Exported, ExportError, export
from sim.sha.events import Alphabet, Switch
from sim.sha.model import Model
from sim.sha.trace import Event, Trace
from tests.sha.effect_reference import EFFECTS, LATE, RANDOM, TOGETHER, course, plant
from tests.uppaal.support import courses, middle

START, LENGTH = 0.0, 1500.0
ALPHABET = Alphabet((Switch("on", "W_ON", "W_OFF"),))
EVERY = {**EFFECTS, **LATE, **TOGETHER}
POLLED = {name for name, many in EVERY.items() if any(one.kind == "thermostatic-cooling" for one in many)}


def cased(name: str, kind: str = "exponential", seed: int = 4) -> tuple[Model, Trace]:
    """The model, and a trace with a reading every 100 s, starts and stops, and signals that change."""
    events, inputs = course(seed, LENGTH)
    readings = np.arange(0.0, LENGTH + 1.0, 100.0)
    times = np.union1d(inputs.times, readings).astype(float)
    place = np.searchsorted(times, inputs.times)
    signals = {each: np.full(times.size, np.nan) for each in inputs.signals}
    for each, column in inputs.signals.items():
        signals[each][place] = column
    signals["T"] = np.where(np.isin(times, readings), 24.0, np.nan)
    model = Model(plant(kind, EVERY[name]), ALPHABET, "T", 0.1)
    moments = tuple(Event(round(event.time, 3), event.symbol) for event in events)
    return model, Trace("course", np.round(times, 3).astype(np.float64), signals, moments)


def seen_and_native(exported: Exported, model: Model, trace: Trace) -> list[tuple[float, float, float]]:
    """(time, exported, native) at every moment at which an event acts, and at the end."""
    _, seen = courses(exported.main.xml, exported.replay.duration, middle, most=1.0)
    looks = sorted({*exported.replay.times, exported.replay.duration})
    native = open_loop(model, replace(trace, events=trace.events), "resync")
    rows = []
    for time in looks:
        at = np.searchsorted(native.times - native.times[0], time + 1e-5) - 1
        if abs(native.times[at] - native.times[0] - time) < 1e-4:
            rows.append((time, float(np.mean(seen[time])), float(native.mean[at])))
    return rows


def test_every_kind_of_effect_is_exported_here() -> None:
    assert {one.kind for many in EVERY.values() for one in many} | set(RANDOM) == set(KINDS)


@pytest.mark.parametrize("kind", ["exponential", "driven"])
@pytest.mark.parametrize("name", EVERY)
def test_the_exported_course_is_the_native_one(name: str, kind: str) -> None:
    model, trace = cased(name, kind)
    exported = export(model, trace, tick=1 if name in POLLED else 0)
    rows = seen_and_native(exported, model, trace)
    assert rows and rows[-1][0] == exported.replay.duration
    bound = 0.05 if name in POLLED else 2e-3  # a valve that is looked at once a second
    for time, ours, native in rows:
        assert ours == pytest.approx(native, abs=bound), time


def test_noise_and_laws_are_those_of_the_native_runs() -> None:
    """A heat, a housing and a lag: the variance at each event is that of the exact joint law, ticks of 1 s."""
    runs = 3000
    rng = np.random.default_rng(8)
    model, trace = cased("current-heating")
    many = (*EFFECTS["current-heating"], *EFFECTS["housing-thermal-mass"], *EFFECTS["sensor-lag 1"])
    model = replace(model, sha=replace(model.sha, effects=many))
    exported = export(model, trace, tick=2)

    def draw(function: str, mean: float, sigma: float) -> np.ndarray:
        assert function == "random_normal" and sigma > 0
        return rng.normal(mean, sigma, runs)

    _, seen = courses(exported.main.xml, exported.replay.duration, draw, most=2.0)
    native = open_loop(model, trace, "resync")
    values, at = np.broadcast_to(seen[exported.replay.duration], runs), -1
    sigma = float(np.sqrt(native.variance[at]))
    assert values.mean() == pytest.approx(native.mean[at], abs=5 * sigma / np.sqrt(runs) + 2e-3)
    assert values.std() == pytest.approx(sigma, rel=0.08)


def test_a_thermostat_needs_a_tick_and_says_so() -> None:
    model, trace = cased("thermostatic-cooling")
    with pytest.raises(ExportError, match="the thermostat is looked at once a tick; give a tick of at least 1 s"):
        export(model, trace, tick=0)


def test_start_up_heat_cannot_count_from_an_event_that_is_passed_over() -> None:
    model, trace = cased("startup-churning")
    twice = (*trace.events[:1], Event(trace.events[0].time + 5.0, "W_ON"), *trace.events[1:])
    with pytest.raises(ExportError, match="an event 'W_ON', since which start-up heat counts, is passed over"):
        export(model, replace(trace, events=twice), policy="ignore")
    assert export(model, replace(trace, events=twice), policy="resync").main.xml

"""With effects, bounds are safe against thousands of random runs, words lead out, and models may be deployed."""

from dataclasses import replace
from math import inf

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim.checking.bounds import find_bounds
from sim.checking.drift import Drift, added
from sim.checking.envelope import DAY, Assumptions, envelopes
from sim.checking.structure import moves
from sim.checking.verify import verify
from sim.checking.word import parse_word, replay, word_text
from sim.sha.automaton import SHA, Distribution, Edge, Effect, Flow, Location
from sim.sha.effects import sensor_offset, sensor_offsets, signals_of
from sim.sha.events import Alphabet, Switch, alphabet_symbols
from sim.sha.model import Correction, Model, Stay
from sim.sha.moments import augmented_course, moments
from sim.sha.schedule import schedule
from sim.sha.trace import Event, Trace
from tests.sha.effect_reference import EFFECTS, TOGETHER, normal, plant, without_noise

RANGES = {"I": (50.0, 200.0), "M": (-5.0, 40.0), "Ta": (10.0, 30.0), "P": (0.0, 1.0)}
RUNS = 4
ALPHABET = Alphabet((Switch("on", "W_ON", "W_OFF"),))
EVERY = {**EFFECTS, **TOGETHER}
RELAXING = {
    "exponential": Location("on", Flow("exponential", {"k": 0.004, "noise": 0.0}), normal(55.0, 0.0)),
    "fresh": Location("on", Flow("exponential", {"k": 0.004, "noise": 0.0}), normal(55.0, 0.0), "resample"),
}


def model_of(name: str, kind: str = "exponential", **more: object) -> Model:
    sha = without_noise(plant(kind, EVERY[name]))
    return Model(replace(sha, **more), ALPHABET, "T", 0.1, normal(20.0, 1.0))  # type: ignore[arg-type]


def assumed(model: Model, **more: object) -> Assumptions:
    read = {one.signal for place in model.sha.locations for one in place.flow.inputs} | set(signals_of(model.sha))
    return Assumptions(inputs={name: RANGES[name] for name in read}, **more)  # type: ignore[arg-type]


def random_run(model: Model, rng: np.random.Generator, shortest: float, longest: float) -> tuple[list[Event], Trace]:
    """Random starts, stops and gaps, and signals that move anywhere in their ranges at times of their own."""
    times = np.cumsum(rng.uniform(shortest, longest, int(rng.integers(1, 10))))
    symbols = rng.choice(["W_ON", "W_ON", "W_OFF", "unknown"], times.size)
    begin = float(rng.choice([0.0, 700.0, 1e6]))
    events = [Event(begin + float(time), str(symbol)) for time, symbol in zip(times, symbols, strict=True)]
    clock = np.concatenate([[0.0], np.sort(rng.uniform(0.0, times[-1], 30))]) + begin
    signals = {
        name: np.where(rng.random(clock.size) < 0.4, rng.choice([low, high], clock.size), rng.uniform(low, high, clock.size))
        for name, (low, high) in RANGES.items()
    }
    return events, Trace("inputs", clock, signals)


@pytest.mark.parametrize("sojourn", ["any", (0.0, 900.0)])
@pytest.mark.parametrize("kind", ["exponential", "driven", "logarithmic", "linear", "constant"])
def test_no_random_run_with_random_signals_leaves_the_proven_interval(kind: str, sojourn: object) -> None:
    """Runs of each effect, with jumping signals; every segment's end is looked at, also with a rate limit."""
    rng = np.random.default_rng(3)
    for name in EVERY:
        for rate in (inf, 0.05):
            model = model_of(name, kind, max_rate=rate)
            given = assumed(model, sojourn=sojourn, start=(15.0, 60.0))
            found = find_bounds(model, -500.0, 500.0, given)
            assert found.settled, name
            for _ in range(RUNS):
                events, inputs = random_run(model, rng, 5.0, 890.0 if sojourn != "any" else 4000.0)
                begin = float(inputs.times[0])
                start = float(rng.uniform(15.0, 60.0))
                outputs = np.union1d(np.linspace(begin, events[-1].time, 60), [begin])
                steps = schedule(model, events, outputs, start=begin, inputs=inputs, policy="resync")
                steps = replace(steps, sha=replace(steps.sha, low=-1e9, high=1e9))
                read = moments(steps, start).mean
                places = [model.sha.locations[index].name for index in steps.output_location]
                low, high = np.array([found.intervals[place] for place in places]).T
                slack = 3e-3  # what the simulator's own course may be off by, docs/effects.md
                assert np.all(read >= low - slack) and np.all(read <= high + slack), (name, rate, start)


def test_thousands_of_words_with_every_stays_own_parameter_stay_inside() -> None:
    rng = np.random.default_rng(5)
    count = 0
    for name in EVERY:
        model = model_of(name)
        places = tuple(replace(place, distribution=normal(place.distribution.params["mu"], 3.0)) for place in model.sha.locations)  # type: ignore[union-attr]
        model = replace(model, sha=replace(model.sha, locations=places))
        given = assumed(model)
        found = find_bounds(model, -500.0, 500.0, given)
        rooms = {r.location: r for r in envelopes(model, given, moves(model.sha, alphabet_symbols(ALPHABET), "resync"))}
        low, high = (f(s) for f, s in zip((min, max), zip(*found.intervals.values(), strict=True), strict=True))
        for _ in range(70):
            items, time, here = [], 0.0, "off"
            for number in range(int(rng.integers(1, 8))):
                signals = [f"{one}={rng.choice([*RANGES[one], rng.uniform(*RANGES[one])])}" for one in given.inputs]
                m = rng.choice([*rooms[here].m, rng.uniform(*rooms[here].m)])
                start = [f"T={rng.uniform(*found.start)}", f"t={rng.choice([0.0, 900.0, 1e6])}"] if not number else []
                symbol = "" if not number else "W_ON" if here == "on" else "W_OFF"
                items.append(",".join([f"{symbol}@{time}", *start, f"m={m}", *signals]))
                time += float(rng.choice([rng.uniform(0.0, 60.0), rng.uniform(0.0, 5000.0)]))
                here = "on" if here == "off" else "off"
            done = replay(model, parse_word(" ".join([*items, f"@{time}"])))
            assert low - 3e-3 <= done.lowest and done.highest <= high + 3e-3, (name, items)
            count += 1
    assert count > 1800

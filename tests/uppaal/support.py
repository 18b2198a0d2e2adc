"""Models and traces that the export's tests share."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from math import inf
from typing import Any

import numpy as np
import pytest

from sim.lab.tuning.methods import METHODS, Task
from sim.plant.scenarios import SCENARIOS, scenario
from sim.sha.automaton import SHA, Distribution, Edge, Entry, Flow, Input, Location
from sim.sha.events import DECANTER, Alphabet, Bins, encode
from sim.sha.model import Model
from sim.sha.trace import Event, Trace
from tests.rig.no_bands import without_bands
from tests.uppaal.interpreter import Network

TEMPERATURE = "Temp"
START = 1_736_499_600.0
FLOWS = {
    "constant": Flow("constant", {"noise": 0.05}),
    "linear": Flow("linear", {"noise": 0.05}),
    "exponential": Flow("exponential", {"k": 0.03, "noise": 0.05}),
    "driven": Flow("driven", {"k": 0.03, "noise": 0.05}, (Input("load", 0.2, 100.0),)),
    "logarithmic": Flow("logarithmic", {"t0": 4.0, "noise": 0.05}),
    "transient": Flow("transient", {"tau": 6.0, "noise": 0.05}),
}
MODES = {
    "constant": (0.0, 0.0),
    "linear": (0.06, 0.02),
    "exponential": (45.0, 4.0),
    "driven": (45.0, 4.0),
    "logarithmic": (3.0, 0.8),
    "transient": (-4.0, 0.8),
}


def two_locations(kind: str, entry: Entry = "parameter", max_rate: float = inf, **changed: Any) -> Model:
    """`warm` with the flow in question, `cold` that relaxes to 25 degC; events `up` and `down` between them."""
    law: Distribution | None = Distribution("normal", dict(zip(("mu", "sigma"), MODES[kind], strict=True)))
    if entry == "resample":
        law = Distribution("normal", {"mu": 35.0, "sigma": 2.0})
    if kind == "constant" and entry == "parameter":
        law = None
    flow = FLOWS[kind]
    if entry == "resample" and kind in ("linear", "logarithmic", "transient"):
        flow = replace(flow, params={**flow.params, "m": MODES[kind][0]})
    cold = Distribution("normal", {"mu": 25.0, "sigma": 1.0})
    sha = SHA(
        "two",
        (
            Location("warm", flow, law, entry),
            Location("cold", Flow("exponential", {"k": 0.02, "noise": 0.02}), cold),
        ),
        (Edge("cold", "up", "warm"), Edge("warm", "up", "warm"), Edge("warm", "down", "cold")),
        "cold",
        max_rate=max_rate,
        **changed,
    )
    return Model(sha, Alphabet(()), TEMPERATURE, 0.1)


def replayed(symbols: Sequence[str] = ("up", "up", "down", "up", "down", "up"), gap: float = 17.3) -> Trace:
    """A trace of ten rows a gap with a swinging load, and an event every `gap` seconds, the first two at once."""
    times = START + np.round(np.arange(0.0, gap * (len(symbols) + 1), gap / 10), 3)
    events = [Event(float(times[0]), symbols[0]), Event(float(times[0]), symbols[1])]
    events += [Event(float(times[10 * number]), symbol) for number, symbol in enumerate(symbols[2:], 1)]
    signals = {
        TEMPERATURE: np.full(times.size, 30.0),
        "load": 100.0 + 60.0 * np.sin((times - START) / 9.0),
    }
    return Trace("swing", times, signals, tuple(events))


def middle(function: str, *arguments: Any) -> Any:
    """The answer of a random function without chance: a normal's mean."""
    assert function == "random_normal"
    return arguments[0]


def courses(xml: str, until: float, draw: Any, most: float = 0.25) -> tuple[Network, dict[float, Any]]:
    """The network after its run, and the temperature at every instant where something happened (the last at each)."""
    network = Network(xml, draw)
    seen: dict[float, Any] = {}

    def watch(now: Network) -> None:
        seen[round(now.now, 6)] = now.by_name["m_1"].own["Temp"]

    network.run(until, watch, most)
    return network, seen


def cd(name: str) -> Trace:
    """An encoded synthetic scenario."""
    trace = scenario(name)
    return replace(trace, events=encode(trace, DECANTER))


def learned(method: str = "bins") -> Model:
    """A model learned from two scenarios by either method; with `bins` it has three kinds of flow."""
    return _learned(method)  # so that the method left out and the method named are learned once


@cache
def _learned(method: str) -> Model:
    task = Task([scenario(name) for name in list(SCENARIOS)[:2]], DECANTER, "TCuscinettiRiduttore", 0, "decanter")
    with pytest.MonkeyPatch.context() as patch:
        without_bands(patch)  # an exported model has none
        return METHODS[method].learn(task, {}).model


def spindle(full: bool) -> tuple[Model, Trace]:
    """An automaton with 102 symbols, as a CNC spindle has: one location a symbol; `full`: an edge from each to each."""
    symbols = tuple(f"{100 * index}<=w<{100 * index + 100},start" for index in range(102))
    flow = Flow("exponential", {"k": 0.01, "noise": 0.05})
    places = tuple(
        Location(f"{symbol}|", flow, Distribution("normal", {"mu": 20.0 + index, "sigma": 0.5}))
        for index, symbol in enumerate(symbols)
    )
    order = range(len(symbols))
    pairs = [(a, b) for a in order for b in (order if full else ((a + 1) % 102, (a + 7) % 102)) if a != b]
    edges = tuple(Edge(places[a].name, symbols[b], places[b].name) for a, b in pairs)
    alphabet = Alphabet((Bins("w", tuple(100.0 * index for index in range(1, 102)), symbols),))
    model = Model(SHA("spindle", places, edges, places[0].name), alphabet, TEMPERATURE, 0.1)
    times = START + np.arange(0.0, 200.0)
    events = tuple(Event(float(times[index]), symbols[index]) for index in range(1, 102))
    return model, Trace("cycle 1", times, {TEMPERATURE: np.full(times.size, 21.0)}, events)

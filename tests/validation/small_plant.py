"""A plant of two locations, its model, and traces that follow that model exactly or with the sensor's noise."""

from dataclasses import replace

import numpy as np

from sim.sha.automaton import SHA, Distribution, Edge, Flow, Location
from sim.sha.events import Alphabet, Switch
from sim.sha.model import Model
from sim.sha.trace import Trace

ALPHABET = Alphabet((Switch("Motor", "M_ON", "M_OFF"),), gap=60.0)
HOT, COLD, K = 60.0, 20.0, 0.01


def location(name: str, mu: float, sigma: float = 0.0, noise: float = 0.0) -> Location:
    law = Distribution("normal", {"mu": mu, "sigma": sigma})
    return Location(name, Flow("exponential", {"k": K, "noise": noise}), law)


def plant_model(name: str = "plant", sensor: float = 0.1, sigma: float = 0.0, noise: float = 0.0) -> Model:
    """On leads towards 60 degC, off towards 20 degC; each symbol has an edge in each location."""
    edges = tuple(Edge(at, symbol, to) for at in ("off", "on") for symbol, to in (("M_ON", "on"), ("M_OFF", "off")))
    locations = (location("off", COLD, sigma, noise), location("on", HOT, sigma, noise))
    return Model(SHA(name, locations, edges, "off"), ALPHABET, "T", sensor)


def without_edge(model: Model, source: str, symbol: str) -> Model:
    edges = tuple(edge for edge in model.sha.edges if (edge.source, edge.symbol) != (source, symbol))
    return replace(model, sha=replace(model.sha, edges=edges))


def plant_trace(name: str = "run", rows: int = 300, noise: float = 0.0, seed: int = 0) -> Trace:
    """One row a second; the motor is on for 60 s, off for 60 s.

    The temperature follows the model exactly but for the sensor's noise, which the first reading does not have.
    """
    times = 1000.0 + np.arange(rows, dtype=float)
    motor = ((np.arange(rows) // 60) % 2 == 0).astype(float)
    values = np.empty(rows)
    values[0] = 30.0
    for row in range(1, rows):
        target = HOT if motor[row - 1] else COLD
        values[row] = target + (values[row - 1] - target) * np.exp(-K)
    values[1:] += noise * np.random.default_rng(seed).normal(size=rows - 1)
    return Trace(name, times, {"Motor": motor, "T": values})

"""Small models for the tests of statistical checking: one flow or a few, with known answers."""

from collections.abc import Sequence

import numpy as np

from sim.lab.checking.query.tree import (
    Compare,
    Comparison,
    Eventually,
    Formula,
    Number,
    Probability,
    Quantity,
    TimeSpan,
)
from sim.lab.checking.smc.answers import Start
from sim.lab.checking.smc.start import initial
from sim.sha.automaton import SHA, Distribution, Edge, Entry, Flow, Location
from sim.sha.events import Alphabet
from sim.sha.model import Model, Stay
from sim.sha.trace import Event, Trace

TEMP, TIME, AGE = Quantity("temperature"), Quantity("time"), Quantity("age")


def normal(mu: float, sigma: float = 0.0) -> Distribution:
    return Distribution("normal", {"mu": mu, "sigma": sigma})


def flow(kind: str, noise: float = 0.1, **constants: float) -> Flow:
    return Flow(kind, {"noise": noise, **constants})


def compare(op: Comparison, number: float, quantity: Quantity = TEMP) -> Compare:
    return Compare(op, quantity, Number(number))


def eventually(inner: Formula, bound: float, low: float = 0.0, runs: int | None = None) -> Probability:
    return Probability(bound, Eventually(inner, TimeSpan(low, bound)), runs)


def model(
    flows: Sequence[Flow],
    laws: Sequence[Distribution | None],
    *,
    entry: Entry = "parameter",
    first: Distribution | None = None,
    stay: Distribution | None = None,
    low: float = -1e6,
    high: float = 1e6,
    max_rate: float = float("inf"),
) -> Model:
    """Locations q_0, q_1 ... in a ring, each left by `next`; each stay lasts as `stay` says, where it is given."""
    names = [f"q_{index}" for index in range(len(flows))]
    after = [*names[1:], names[0]]
    locations = tuple(
        Location(name, own, law, entry if law is not None else "none")
        for name, own, law in zip(names, flows, laws, strict=True)
    )
    edges = tuple(Edge(a, "next", b) for a, b in zip(names, after, strict=True))
    sha = SHA("small", locations, edges, names[0], low=low, high=high, max_rate=max_rate)
    stays = {a: Stay(stay, {b: 1.0}) for a, b in zip(names, after, strict=True)} if stay is not None else {}
    return Model(sha, Alphabet(()), "T", 0.05, first, stays)


def along(made: Model, x0: float, seconds: float, events: Sequence[float] = ()) -> Start:
    """The model along a trace that begins at `x0`, with `next` at these times."""
    trace = Trace("t", np.array([0.0, seconds]), {"T": np.full(2, x0)}, tuple(Event(time, "next") for time in events))
    return initial(made, trace)

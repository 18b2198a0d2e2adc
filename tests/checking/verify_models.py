"""Random automata of all flow kinds for the tests of verification, and the thesis's model that reaches 700 degC."""

from math import inf

from hypothesis import strategies as st

from sim.proof.envelope import Assumptions
from sim.sha.automaton import SHA, Distribution, Edge, Entry, Flow, Input, Location
from sim.sha.events import DECANTER, Alphabet, Bins, Switch
from sim.sha.model import Correction, Model, Stay

LEVELS = Alphabet((Switch("On", "a", "b"), Bins("Load", (10.0,), ("c", "d"))))
SYMBOLS = ("a", "b", "c", "d")


def normal(mu: float, sigma: float) -> Distribution:
    return Distribution("normal", {"mu": mu, "sigma": sigma})


def of(*locations: Location, edges: tuple[Edge, ...] = (), **limits: float) -> Model:
    """A model that starts in the first location, every symbol leading on to the next one unless edges are given."""
    names = [location.name for location in locations]
    ring = tuple(Edge(name, "a", names[(place + 1) % len(names)]) for place, name in enumerate(names))
    sha = SHA("made", locations, edges or ring, names[0], **limits)
    return Model(sha, LEVELS, "T", 0.0, initial=normal(20.0, 1.0))


def linear(name: str, slope: float, sigma: float = 0.0, entry: Entry = "parameter") -> Location:
    return Location(name, Flow("linear", {"noise": 0.0}), normal(slope, sigma), entry)


def relaxing(name: str, target: float, k: float = 0.01, sigma: float = 0.0) -> Location:
    return Location(name, Flow("exponential", {"k": k, "noise": 0.0}), normal(target, sigma))


def thesis() -> Model:
    """Running warms at 0.05 degC/s for as long as it runs, at rest it cools: 700 degC after under four hours."""
    locations = (relaxing("rest", 20.0, 0.001), linear("run", 0.05))
    edges = (Edge("rest", "W_ON", "run"), Edge("run", "W_OFF", "rest"), Edge("run", "A_2", "run"))
    return Model(SHA("thesis", locations, edges, "rest"), DECANTER, "T", 0.1, normal(20.0, 1.0))


inner, outer = st.floats(5.0, 145.0), st.floats(-200.0, 300.0)
numbers = st.one_of(inner, inner, inner, outer).map(lambda x: round(x, 3))
sigmas = st.sampled_from([0.0, 0.0, 0.5, 10.0])


@st.composite
def locations(draw: st.DrawFn, name: str) -> Location:
    kind = draw(st.sampled_from(["constant", "linear", "exponential", "driven", "logarithmic", "transient"]))
    constants = {"noise": draw(st.sampled_from([0.0, 0.1]))}
    inputs: tuple[Input, ...] = ()
    if kind in ("exponential", "driven"):
        constants["k"] = draw(st.floats(1e-3, 1.0))
    if kind == "driven":
        inputs = (Input("Load", draw(st.floats(-3.0, 3.0)), draw(st.floats(0.0, 20.0))),)
    if kind == "logarithmic":
        constants["t0"] = draw(st.floats(1.0, 100.0))
    if kind == "transient":
        constants["tau"] = draw(st.floats(1.0, 100.0))
    scale = {"linear": 0.001, "logarithmic": 0.05, "transient": 0.05}.get(kind, 1.0)
    law = normal(draw(numbers) * scale, draw(sigmas) * scale)
    entry: Entry = draw(st.sampled_from(["parameter", "parameter", "none", "resample"]))
    if kind == "transient" and entry == "resample":
        constants["m"] = draw(numbers) * scale
    return Location(
        name, Flow(kind, constants, inputs), normal(draw(numbers), 1.0) if entry == "resample" else law, entry
    )


@st.composite
def models(draw: st.DrawFn) -> Model:
    """One to four locations, deterministic, with some symbols missing; with and without rate limit and correction."""
    names = ["p", "q", "r", "s"][: draw(st.integers(1, 4))]
    targets = {(name, symbol): draw(st.sampled_from([*names, None])) for name in names for symbol in SYMBOLS}
    edges = tuple(Edge(name, symbol, to) for (name, symbol), to in targets.items() if to is not None)
    rate = draw(st.sampled_from([inf, inf, 0.02, 1.0]))
    sha = SHA("random", tuple(draw(locations(name)) for name in names), edges, names[0], rate)
    stays = {
        name: Stay(Distribution("exponential", {"mean": draw(st.floats(1.0, 500.0))}), {name: 1.0})
        for name in names
        if draw(st.booleans())
    }
    correction = draw(st.sampled_from([Correction(), Correction(), Correction(1.2, -3.0)]))
    return Model(sha, LEVELS, "T", 0.1, normal(draw(numbers), 2.0), stays, correction=correction)


assumptions = st.builds(
    Assumptions,
    z=st.sampled_from([0.0, 1.0, 3.0]),
    sojourn=st.sampled_from(["any", "law", (0.0, 100.0), (30.0, 600.0), (50.0, 50.0)]),
    policy=st.sampled_from(["resync", "ignore"]),
    unknown=st.booleans(),
)

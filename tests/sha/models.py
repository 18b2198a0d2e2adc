"""Small models that several tests run."""

from dataclasses import replace

from sim.sha.automaton import SHA, Distribution, Edge, Flow, Input, Location


def normal(mu: float, sigma: float) -> Distribution:
    return Distribution("normal", {"mu": mu, "sigma": sigma})


OFF = Location("off", Flow("exponential", {"k": 0.01, "noise": 0.05}), normal(18.0, 1.0))
IDLE = Location(
    "idle", Flow("driven", {"k": 0.02, "noise": 0.1}, (Input("Assorbimento", 0.1, 50.0),)), normal(35.0, 2.0)
)
LOAD = Location("load", Flow("linear", {"noise": 0.02}), normal(0.04, 0.01))
PEAK = Location("peak", Flow("logarithmic", {"t0": 10.0, "noise": 0.03}), normal(4.0, 0.5))
HOLD = Location("hold", Flow("constant", {"noise": 0.08}))
FRESH = Location("fresh", Flow("exponential", {"k": 0.03, "noise": 0.2}), normal(45.0, 1.5), "resample")
SPIKE = Location("spike", Flow("transient", {"tau": 6.0, "noise": 0.05, "m": -5.0}), normal(48.0, 1.5), "resample")
SETTLE = Location("settle", Flow("transient", {"tau": 9.0, "noise": 0.05}), normal(3.0, 0.5))
PLAIN = Location("plain", Flow("exponential", {"k": 0.03, "noise": 0.2}), normal(30.0, 1.5), "none")

ALL = (OFF, IDLE, LOAD, PEAK, HOLD, FRESH, PLAIN, SPIKE, SETTLE)
"""Symbol X leads to location X from everywhere."""
EVERYWHERE = SHA(
    "everywhere",
    ALL,
    tuple(Edge(source.name, target.name, target.name) for source in ALL for target in ALL),
    "off",
)


def limited(rate: float) -> SHA:
    return replace(EVERYWHERE, max_rate=rate)

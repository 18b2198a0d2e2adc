"""A plant that relaxes towards 50 degC, and a method with two settings, of which the best are known: for the search."""

import numpy as np

from sim.lab.tuning.methods import Choice, Method, Real, Settings, Task, Taught
from sim.sha.automaton import SHA, Distribution, Flow, Location
from sim.sha.events import Alphabet
from sim.sha.model import Model
from sim.sha.trace import Array, Trace

TARGET, K = 50.0, 0.01
ALPHABET = Alphabet(())


def traces(count: int = 6) -> list[Trace]:
    """Traces from other starts, with a little noise of the sensor."""
    rng = np.random.default_rng(0)
    clock = np.arange(0.0, 300.0, 10.0)

    def course(start: float) -> Array:
        return TARGET + (start - TARGET) * np.exp(-K * clock) + rng.normal(0, 0.1, clock.size)

    return [Trace(f"t{n}", clock + 1000.0 * n, {"T": course(20.0 + 3.0 * n)}) for n in range(count)]


def relaxing(task: Task, settings: Settings) -> Taught:
    """Takes the target from the settings (20 degC by default); `kind` "broken" cannot be learned."""
    if settings.get("kind") == "broken":
        raise ValueError("a broken kind teaches nothing")
    flow = Flow("exponential", {"k": K, "noise": 0.05})
    law = Distribution("normal", {"mu": float(settings.get("target", 20.0)), "sigma": 1.0})
    sha = SHA(task.name, (Location("q", flow, law),), (), "q")
    return Taught(Model(sha, task.alphabet, task.temperature, 0.1), {})


def relaxing_method() -> Method:
    """The table's entry."""
    return Method((Real("target", 0.0, 100.0), Choice("kind", ("good", "broken"))), relaxing)

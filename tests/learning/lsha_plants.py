"""Known hybrid automata with few locations, and random traces of them: the truth that L*_SHA must find again."""

from collections.abc import Callable
from dataclasses import replace
from math import exp

import numpy as np

from sim.sha.events import Alphabet, Bins, Switch, encode
from sim.sha.trace import Trace

PLANT = Alphabet((Switch("On", "ON", "OFF"), Bins("Load", (1.0, 2.0), ("L_0", "L_1", "L_2"))), gap=60.0)
LEVELS = (0.5, 1.5, 2.5)

Target = Callable[[int, int, int], float]
"""(on, level, direction of the last change of level) -> the target temperature, or the level that is jumped to."""


def by_context(on: int, level: int, _: int) -> float:
    """Off at 20, on with a low or middle load at 50, on with a high load at 80.

    Four locations: off with a high load is one of its own, since ON leads from there to 80 and not to 50.
    """
    return 20.0 if not on else (80.0 if level == 2 else 50.0)


def by_direction(on: int, level: int, direction: int) -> float:
    """A middle load heats when it was reached from below and not when it was reached from above."""
    return 20.0 if not on else (80.0 if level == 2 or (level == 1 and direction > 0) else 50.0)


def random_traces(
    target: Target,
    seed: int,
    *,
    count: int = 12,
    stays: int = 24,
    tau: float = 200.0,
    scatter: float = 1.0,
    sensor: float = 0.1,
    period: float = 4.0,
    jumps: bool = False,
) -> list[Trace]:
    """Encoded traces that switch and change their load at random; with `jumps` the target itself is measured."""
    rng = np.random.default_rng(seed)
    return [
        _trace(target, rng, f"t{number:02d}", number * 1e5, stays, tau, scatter, sensor, period, jumps)
        for number in range(count)
    ]


def _trace(
    target: Target,
    rng: np.random.Generator,
    name: str,
    begin: float,
    stays: int,
    tau: float,
    scatter: float,
    sensor: float,
    period: float,
    jumps: bool,
) -> Trace:
    on, level, direction = int(rng.integers(2)), int(rng.integers(3)), 0
    x, columns = rng.uniform(20, 60), []
    for _ in range(stays):
        m = target(on, level, direction) + scatter * rng.normal()
        for _ in range(int(rng.integers(6, 30))):
            x = m if jumps else x
            columns.append((on, LEVELS[level], x + sensor * rng.normal()))
            x = m + (x - m) * exp(-period / tau)
        if rng.random() < 0.25:
            on = 1 - on
        else:
            following = int(rng.choice([other for other in range(3) if other != level]))
            level, direction = following, 1 if following > level else -1
    on_, load, temperature = np.array(columns).T
    trace = Trace(
        name,
        begin + period * np.arange(len(columns)),
        {"On": on_, "Load": load, "T": temperature},
        origin="known automaton",
        synthetic=True,
    )
    return replace(trace, events=encode(trace, PLANT))

"""The small plant with a valve, a level and a feed that no role of the catalogue knows, and a hidden heat of them."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from sim.sha.events import encode
from sim.sha.trace import Array, Trace
from tests.discrepancy.plants import ALPHABET, PERIOD, TARGETS, operation

Hidden = Callable[[float, float, dict[str, float]], float]
"""degC/s of (seconds since the beginning, bearing degC, the signals)."""


def _steps(rng: np.random.Generator, size: int, length: int, values: Callable[[int], Array]) -> Array:
    return np.repeat(values(size // length + 1), length)[:size]


def plant(seed: int, hidden: Hidden, days: int = 4) -> Trace:
    """`days` days of three cycles: rough as plants are, read to 0.1 degC, with the hidden heat on top."""
    rng = np.random.default_rng(seed)
    size = int(days * 86400 / PERIOD)
    on, current, _ = operation(rng, size)
    feed = np.convolve(_steps(rng, size, 60, lambda n: rng.uniform(10, 60, n)), np.ones(40) / 40, "same")
    signals = {
        "MarciaDecanter": on,
        "Assorbimento": current,
        "TMandata": feed,
        "Valvola": _steps(rng, size, 50, lambda n: (rng.random(n) < 0.5).astype(float)),
        "Livello": _steps(rng, size, 80, lambda n: rng.uniform(0, 100, n)),
        "Tappo": _steps(rng, size, 30, rng.random),
    }
    x, heat, friction = 17.0, 0.0, 1.0
    reading = np.empty(size)
    keep = np.exp(-PERIOD / 400)
    for row in range(size):
        reading[row] = x
        if row and on[row] > on[row - 1]:
            friction = 1 + 0.01 * rng.standard_normal()
        target, k = TARGETS["OFF" if not on[row] else "LOW" if current[row] < 200 else "HIGH"]
        heat = keep * heat + 4e-4 * np.sqrt(1 - keep**2) * rng.standard_normal()
        drive = k * (target - x) + on[row] * ((friction - 1) * k * (target - 17) + heat)
        drive += hidden(row * PERIOD, x, {name: float(column[row]) for name, column in signals.items()})
        x += PERIOD * drive + 0.003 * np.sqrt(PERIOD) * rng.standard_normal()
    read = np.round(reading + 0.06 * rng.standard_normal(size), 1)
    trace = Trace(f"valve{seed}", 1.7e9 + PERIOD * np.arange(size), {**signals, "T": read}, synthetic=True)
    return replace(trace, events=encode(trace, ALPHABET))

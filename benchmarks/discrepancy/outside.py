"""Effects that no name of the vocabulary stands for: the right answer to them is "unexplained"."""

from collections.abc import Mapping

import numpy as np

from benchmarks.discrepancy.effects import HEAT, Kind
from benchmarks.discrepancy.operation import DAY, Operation, lagged, steps, telegraph
from benchmarks.discrepancy.plant import Parts


def belt_slip(op: Operation, strength: float, rng: np.random.Generator) -> Parts:
    """Wet belts: on some starts, after rain that nobody records, they slip and heat the bearing until they are dry."""
    heat = np.zeros(op.times.size)
    for start in op.starts:
        if rng.random() < 0.5:
            age = op.times - op.times[start]
            dry = rng.uniform(900, 3500)
            heat += rng.uniform(0.3, 1.5) * np.where((age >= 0) & (age < dry), 1 - age / dry, 0.0)
    return Parts(heat=strength * HEAT * op.running * heat)


def grease_fill(op: Operation, strength: float, rng: np.random.Generator) -> Parts:
    """Grease filled in at two moments of the service: it churns for hours and then has spread."""
    heat = np.zeros(op.times.size)
    for low, high in ((0.05, 0.2), (0.4, 0.6)):
        age = op.times - rng.uniform(low, high) * op.times[-1]
        heat += np.where(age > 0, np.exp(-np.maximum(age, 0) / rng.uniform(9000, 20000)), 0.0)
    return Parts(heat=strength * HEAT * 2.0 * op.running * heat)


def load_memory(op: Operation, strength: float, rng: np.random.Generator) -> Parts:
    """Hysteresis of the load: after more than 260 A the races run rough until the load has been under 130 A."""
    rough, now = np.zeros(op.times.size), 0.0
    high, low = rng.uniform(240, 280), rng.uniform(110, 140)
    for row, current in enumerate(op.current):
        now = 1.0 if current > high else 0.0 if current < low else now
        rough[row] = now
    return Parts(heat=strength * HEAT * op.running * (rough - 0.5))


def neighbour_machine(op: Operation, strength: float, rng: np.random.Generator) -> Parts:
    """A machine beside it, on and off by its own plan, which warms the bearing's foot; nobody records it."""
    plan = telegraph(rng, op.times.size, 5400 / op.period, 7200 / op.period)
    return Parts(heat=strength * HEAT * lagged(plan, op.period, 900.0))


def seasonal_bath(op: Operation, strength: float, rng: np.random.Generator) -> Parts:
    """A cooling bath whose temperature swings with a plant-wide rhythm of some hours."""
    rhythm = rng.uniform(4.5, 9.0) * 3600
    return Parts(heat=strength * HEAT * np.sin(2 * np.pi * (op.times / rhythm + rng.random())))


def cleaning_in_place(op: Operation, strength: float, rng: np.random.Generator) -> Parts:
    """Cleaning in place by a timer: cold water through the casing for a quarter of an hour, again and again."""
    every, lasts = rng.uniform(5000, 9000), rng.uniform(600, 1200)
    wet = ((op.times + rng.uniform(0, every)) % every < lasts).astype(float)
    rate = strength * 2.5e-4 * lagged(wet, op.period, 60.0)
    return Parts(rate=rate, pull=rate * 12.0)


def second_bearing(op: Operation, strength: float, rng: np.random.Generator) -> Parts:
    """Conduction along the shaft from the second bearing, which has troubles of its own."""
    level = steps(rng, op.times.size, (2400 / op.period, 9000 / op.period), (-0.008, 0.012))
    return Parts(neighbour=strength * 2e-4, neighbour_heat=op.running * level)


def crew_change(op: Operation, strength: float, rng: np.random.Generator) -> Parts:
    """Another crew on every other day, with another polymer: friction differs from day to day and back."""
    odd = (op.times // DAY + rng.integers(2)) % 2
    return Parts(heat=strength * HEAT * op.running * (odd - 0.5))


OUTSIDE: Mapping[str, Kind] = {
    "belt-slip": Kind(belt_slip, 0.01, 8.0),
    "grease-fill": Kind(grease_fill, 0.01, 8.0),
    "load-memory": Kind(load_memory, 0.01, 8.0),
    "neighbour-machine": Kind(neighbour_machine, 0.01, 8.0),
    "seasonal-bath": Kind(seasonal_bath, 0.01, 8.0),
    "cleaning-in-place": Kind(cleaning_in_place, 0.01, 10.0),
    "second-bearing": Kind(second_bearing, 0.01, 10.0),
    "crew-change": Kind(crew_change, 0.01, 8.0),
}

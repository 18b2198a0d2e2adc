"""Known hybrid automata, simulated step by step in plain Python: the truth that the learner must find again."""

from dataclasses import dataclass, replace
from math import exp, sqrt

import numpy as np

from sim.sha.events import DECANTER, encode
from sim.sha.trace import Trace

MIDDLES = (50.0, 150.0, 250.0, 350.0)


@dataclass(frozen=True)
class Truth:
    """A decanter whose target is m(location) + gain * (current - middle of the bin), relaxing at k."""

    targets: tuple[float, float, float, float, float] = (20.0, 35.0, 50.0, 65.0, 80.0)
    tau: tuple[float, float] = (600.0, 600.0)
    gain: float = 0.0
    noise: float = 0.003
    scatter: float = 0.5
    sensor: float = 0.1

    def target(self, on: int, level: int) -> float:
        return self.targets[1 + level] if on else self.targets[0]


def simulate(
    truth: Truth, seed: int, *, cycles: int = 8, rows: int = 240, period: float = 8.0, hold: int = 12
) -> list[Trace]:
    """Encoded traces, one a cycle: rest, a run at currents held for `hold` rows, rest; the clock is irregular."""
    rng = np.random.default_rng(seed)
    return [_cycle(truth, rng, f"cycle{number:02d}", number * 1e5, rows, period, hold) for number in range(cycles)]


def _cycle(
    truth: Truth, rng: np.random.Generator, name: str, begin: float, rows: int, period: float, hold: int
) -> Trace:
    times = begin + np.cumsum(period * (1 + 0.2 * rng.uniform(-1, 1, rows)))
    running = np.zeros(rows)
    running[rows // 20 : int(rows * 0.8)] = 1
    levels = np.repeat(rng.uniform(30, 340, rows // hold + 1), hold)[:rows]
    current = np.where(running > 0, levels + rng.normal(0, 8, rows), rng.uniform(0, 2, rows))
    bins = np.searchsorted([100, 200, 300], current, side="right")
    x = np.empty(rows)
    x[0] = rng.uniform(15, 45)
    place, m = None, 0.0
    for row in range(rows):
        if row:
            on, level = int(running[row - 1]), int(bins[row - 1])
            k, dt = 1 / truth.tau[on], times[row] - times[row - 1]
            target = m + (truth.gain * (current[row - 1] - MIDDLES[level]) if on else 0.0)
            a = exp(-k * dt)
            spread = truth.noise * sqrt((1 - a * a) / (2 * k))
            x[row] = target + (x[row - 1] - target) * a + spread * rng.normal()
        if (running[row], bins[row]) != place:
            place = (running[row], bins[row])
            m = truth.target(int(running[row]), int(bins[row])) + truth.scatter * rng.normal()
    signals = {"MarciaDecanter": running, "Assorbimento": current, "T": x + truth.sensor * rng.normal(size=rows)}
    trace = Trace(name, times, signals, origin=f"test plant, {name}", synthetic=True)
    return replace(trace, events=encode(trace, DECANTER))


def with_signal(trace: Trace, **columns: np.ndarray) -> Trace:
    """The trace with columns replaced, encoded again."""
    changed = replace(trace, signals={**trace.signals, **columns}, events=())
    return replace(changed, events=encode(changed, DECANTER))


def without_rows(trace: Trace, keep: np.ndarray) -> Trace:
    """The trace with only the rows to `keep`, encoded again."""
    signals = {name: column[keep] for name, column in trace.signals.items()}
    changed = replace(trace, times=trace.times[keep], signals=signals, events=())
    return replace(changed, events=encode(changed, DECANTER))

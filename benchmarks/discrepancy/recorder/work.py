"""How a machine of the recorder's plant works: cycles of a shift plan, recipes of loads, and what else is measured."""

from dataclasses import dataclass

import numpy as np

from benchmarks.discrepancy.operation import Array

STEP = 5.0
"""Seconds of the plant's own grid; drives are held over each step."""
DAY = 86400.0
EDGES = (100.0, 200.0, 300.0)
"""A: where the given models' bins of the current meet."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Work:
    """Columns (n,) on the plant's grid: `running` (0/1), `load` (A, without the inrush of a start), `current` (A),
    `pump` (0/1) and its `flow` (%), `torque` (%), `differential` (rpm), `vibration` (mm/s), `feed` and `ambient`
    (degC); `starts` are the rows at which a cycle begins."""

    running: Array
    load: Array
    current: Array
    pump: Array
    flow: Array
    torque: Array
    differential: Array
    vibration: Array
    feed: Array
    ambient: Array
    starts: tuple[int, ...]

    @property
    def seconds(self) -> Array:
        """(n,) seconds since the first row."""
        return STEP * np.arange(self.running.size)

    @property
    def cycle(self) -> np.ndarray:
        """(n,) which cycle a row belongs to; -1 before the first."""
        return np.searchsorted(self.starts, np.arange(self.running.size), side="right") - 1

    @property
    def age(self) -> Array:
        """(n,) seconds since the cycle began; a day's worth before the first."""
        begun = np.asarray(self.starts)[np.maximum(self.cycle, 0)]
        return np.where(self.cycle < 0, DAY, STEP * (np.arange(self.running.size) - begun))

    @property
    def stage(self) -> np.ndarray:
        """(n,) 0 at rest, else 1 to 4 by the bin of the load."""
        return np.where(self.running > 0, 1 + np.digitize(self.load, EDGES), 0)


def follow(column: Array, memory: float) -> Array:
    """(n,) what follows a held column with `memory` seconds, settled at its first value."""
    keep, now = float(np.exp(-STEP / memory)), float(column[0])
    out = []
    for value in column.tolist():
        now = keep * now + (1.0 - keep) * value
        out.append(now)
    return np.array(out)


def roam(rng: np.random.Generator, n: int, memory: float, spread: float) -> Array:
    """(n,) a stationary first-order Gauss-Markov process of standard deviation `spread`."""
    keep, now = float(np.exp(-STEP / memory)), float(rng.standard_normal())
    out = []
    for shock in (np.sqrt(1.0 - keep**2) * rng.standard_normal(n)).tolist():
        out.append(now)
        now = keep * now + shock
    return spread * np.array(out)


def hold(rng: np.random.Generator, n: int, minutes: tuple[float, float], levels: tuple[float, float]) -> Array:
    """(n,) levels drawn anew after so many minutes, from low to high."""
    out, row = np.empty(n), 0
    while row < n:
        until = row + max(1, int(60.0 * rng.uniform(*minutes) / STEP))
        out[row:until] = rng.uniform(*levels)
        row = until
    return out


def shift_plan(rng: np.random.Generator, days: int, a_day: int) -> list[tuple[float, float]]:
    """(start, stop) in seconds of each cycle: `a_day` of them between five in the morning and ten at night."""
    plan = []
    for day in range(days):
        slot = 17.0 * 3600.0 / a_day
        for number in range(a_day):
            begin = day * DAY + 5.0 * 3600.0 + number * slot + rng.uniform(0.0, 0.12) * slot
            plan.append((begin, begin + rng.uniform(0.45, 0.72) * slot))
    return plan


def work(rng: np.random.Generator, days: int, a_day: int = 4) -> Work:
    """Some days of work; recipes keep 12 A off the edges of the bins, so that a bin is left by a step and not by a
    tremble."""
    n = int(days * DAY / STEP)
    running, starts = np.zeros(n), []
    for begin, end in shift_plan(rng, days, a_day):
        running[int(begin / STEP) : int(end / STEP)] = 1.0
        starts.append(int(begin / STEP))
    load = hold(rng, n, (8.0, 45.0), (115.0, 335.0))
    washing = hold(rng, n, (10.0, 60.0), (0.0, 1.0)) < 0.15
    for start in starts:
        washing[start : start + int(60.0 * rng.uniform(3.0, 12.0) / STEP)] = True
    for edge in EDGES:
        near = np.abs(load - edge) < 12.0
        load = np.where(near, edge + np.where(load < edge, -12.0, 12.0), load)
    tremble = np.clip(roam(rng, n, 120.0, 3.0), -9.0, 9.0)
    load = running * (np.where(washing, 58.0, load) + np.where(washing, 0.1, 1.0) * tremble)
    current = load.copy()
    for start in starts:
        current[start : start + int(rng.integers(1, 3))] = rng.uniform(360.0, 420.0)
    pump = running * ~washing * (hold(rng, n, (8.0, 70.0), (0.0, 1.0)) < 0.65)
    bursts = np.where(hold(rng, n, (2.0, 20.0), (0.0, 1.0)) < 0.2, hold(rng, n, (2.0, 20.0), (1.0, 5.0)), 0.0)
    differential = follow(hold(rng, n, (20.0, 100.0), (5.0, 27.0)), 30.0)
    solids = hold(rng, n, (25.0, 120.0), (20.0, 70.0)) + roam(rng, n, 600.0, 5.0)
    weather = np.interp(np.arange(n) * STEP / DAY, np.arange(days + 2), rng.normal(0.0, 2.5, days + 2))
    noon = rng.uniform(2.0, 4.0) * np.cos(2.0 * np.pi * (np.arange(n) * STEP / DAY - 14.5 / 24.0))
    return Work(
        running=running,
        load=load,
        current=current,
        pump=pump,
        flow=pump * hold(rng, n, (30.0, 150.0), (45.0, 95.0)),
        torque=running * np.clip(np.where(washing, 9.0, solids), 2.0, 98.0),
        differential=running * differential,
        vibration=np.where(running > 0, 1.3 + follow(bursts, 25.0), 0.1),
        feed=follow(hold(rng, n, (60.0, 300.0), (10.0, 38.0)), 700.0) + roam(rng, n, 2000.0, 0.4),
        ambient=18.0 + weather + noon + roam(rng, n, 1800.0, 0.3),
        starts=tuple(starts),
    )

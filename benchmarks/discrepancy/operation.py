"""How the benchmark's decanter is run: starts, loads, feeds, pump switching, idling, nights off, weather.

Everything is drawn from one generator on the log's own clock (rows of `period` seconds, readings held between rows),
and nothing here knows which effect will act: a case with an effect and one without it see the same operation.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

Array = NDArray[np.float64]
DAY = 86400.0
OFF, STAGES = 0, 5
"""Stage 0 is at rest; 1 to 4 are running below 100 A, 200 A, 300 A and above."""


@dataclass(frozen=True, slots=True)
class Operation:
    """Rows of one case, all (n,): seconds, drum running, current (A), slurry pump (0/1) and its speed (%), torque (%),
    differential speed (rpm), vibration (mm/s), feed and hall temperature (degC); `starts` are the rows of starts."""

    times: Array
    running: Array
    current: Array
    pump: Array
    pump_speed: Array
    torque: Array
    speed: Array
    vibration: Array
    feed: Array
    hall: Array
    starts: tuple[int, ...]

    @property
    def period(self) -> float:
        """Seconds from row to row."""
        return float(self.times[1] - self.times[0])

    @property
    def stage(self) -> NDArray[np.intp]:
        """The drive's stage of each row: the current's hundred while running, else 0."""
        return np.where(self.running > 0, 1 + np.clip(self.current // 100, 0, 3), OFF).astype(np.intp)


def wander(rng: np.random.Generator, n: int, period: float, memory: float, sigma: float) -> Array:
    """(n,) an Ornstein-Uhlenbeck process with standard deviation `sigma` and `memory` seconds, stationary."""
    keep = float(np.exp(-period / memory))
    shocks = sigma * np.sqrt(1 - keep**2) * rng.normal(size=n)
    shocks[0] = sigma * rng.normal()
    return np.asarray(lfilter([1.0], [1.0, -keep], shocks))


def lagged(values: Array, period: float, memory: float) -> Array:
    """(n,) first-order low-pass of held values, at rest at the first one."""
    keep = float(np.exp(-period / memory))
    out, _ = lfilter([0.0, 1 - keep], [1.0, -keep], values, zi=np.array([values[0]]))
    return np.asarray(out)


def steps(rng: np.random.Generator, n: int, stay: tuple[float, float], level: tuple[float, float]) -> Array:
    """(n,) held levels, uniform in `level`, each for a uniform number of rows in `stay`."""
    out = np.empty(n)
    at = 0
    while at < n:
        until = at + max(1, int(rng.uniform(*stay)))
        out[at:until] = rng.uniform(*level)
        at = until
    return out


def telegraph(rng: np.random.Generator, n: int, on: float, off: float) -> Array:
    """(n,) a switch with exponential stays of mean `on` and `off` rows."""
    out = np.zeros(n)
    at, up = 0, bool(rng.random() < on / (on + off))
    while at < n:
        until = at + 1 + int(rng.exponential(on if up else off))
        out[at:until] = up
        at, up = until, not up
    return out


def operate(rng: np.random.Generator, days: int = 4, cycles: int = 4, period: float = 10.0) -> Operation:
    """Some days of operation with `cycles` starts a day, from 6 h on; at night the machine rests."""
    n = int(days * DAY / period)
    times = period * np.arange(n, dtype=np.float64)
    running, starts = _shifts(rng, n, days, cycles, period)
    rows = 1.0 / period
    load = steps(rng, n, (500 * rows, 2400 * rows), (130.0, 335.0))
    idle = steps(rng, n, (400 * rows, 1800 * rows), (0.0, 1.0)) < 0.22
    for start in starts:
        idle[start : start + int(rng.uniform(120, 600) * rows)] = True
    current = np.where(idle, 62.0, load) + np.where(idle, 0.02, 1.0) * wander(rng, n, period, 60.0, 9.0)
    current = running * np.clip(current, 20.0, 345.0)
    pump = running * telegraph(rng, n, 1500 * rows, 700 * rows)
    solids = steps(rng, n, (1800 * rows, 7200 * rows), (25.0, 70.0)) + wander(rng, n, period, 700.0, 7.0)
    torque = running * np.clip(np.where(idle, 12.0, solids + 0.05 * (current - 200.0)), 2.0, 99.0)
    setpoint = steps(rng, n, (1200 * rows, 4500 * rows), (6.0, 26.0))
    speed = running * np.clip(lagged(setpoint, period, 25.0) + rng.normal(0, 0.05, n), 0.5, 30.0)
    return Operation(
        times=times,
        running=running,
        current=current,
        pump=pump,
        pump_speed=pump * steps(rng, n, (1800 * rows, 6000 * rows), (45.0, 90.0)),
        torque=torque,
        speed=speed,
        vibration=_vibration(rng, running, speed, period),
        feed=lagged(steps(rng, n, (3600 * rows, 14400 * rows), (11.0, 38.0)), period, 600.0)
        + wander(rng, n, period, 3600.0, 0.5),
        hall=_hall(rng, times, period),
        starts=tuple(starts),
    )


def _shifts(rng: np.random.Generator, n: int, days: int, cycles: int, period: float) -> tuple[Array, list[int]]:
    """(running (n,), rows of the starts): `cycles` stretches a day, with rests that leave room for all of them."""
    running, starts = np.zeros(n), []
    scale = min(1.0, 4 / cycles)
    for day in range(days):
        at = day * DAY + 6 * 3600 + rng.uniform(0, 1800)
        for _ in range(cycles):
            until = at + scale * rng.uniform(6300, 10800)
            first, last = int(at / period), min(int(until / period), n)
            running[first:last] = 1.0
            starts.append(first)
            at = until + scale * rng.uniform(2000, 5400)
    return running, starts


def _vibration(rng: np.random.Generator, running: Array, speed: Array, period: float) -> Array:
    """Bursts of some minutes over a floor that rises with the speed."""
    n = running.size
    level = np.zeros(n)
    for at in np.flatnonzero(rng.random(n) < period / 1500.0):
        level[at : at + int(rng.uniform(100, 700) / period) + 1] += rng.uniform(1.0, 4.5)
    moving = 1.2 + 0.03 * speed + lagged(level, period, 30.0) + np.abs(rng.normal(0, 0.1, n))
    return np.where(running > 0, np.clip(moving, 0.0, 12.0), 0.1)


def _hall(rng: np.random.Generator, times: Array, period: float) -> Array:
    """A hall that follows the sun late, with weather from day to day and a door that is opened."""
    nodes = np.arange(-DAY, times[-1] + 2 * DAY, DAY)
    weather = np.interp(times, nodes, rng.normal(0.0, 2.2, nodes.size))
    daily = rng.uniform(2.5, 4.5) * np.cos(2 * np.pi * (times / DAY - 15 / 24))
    door = lagged(telegraph(rng, times.size, 900 / period, 9000 / period), period, 400.0)
    return 17.0 + weather + daily - 3.0 * door + wander(rng, times.size, period, 1800.0, 0.3)

"""How the network's decanter is run, second by second: shifts or campaigns of days, orders, slurry, inrush, weather."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.signal import lfilter

from benchmarks.discrepancy.operation import Array

DAY = 86400
DutyKind = Literal["shifts", "campaign"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Duty:
    """Columns (n,) at 1 s: drum `running`, motor `current` (A, inrush included), `slurry` pump (0/1) with its `speed`
    (%), scroll `torque` (%), `differential` speed (rpm), `vibration` (mm/s), `feed` and `ambient` (degC).

    `load` (A) is the current without its inrush, `starts` the rows of starts.
    """

    running: Array
    load: Array
    current: Array
    slurry: Array
    speed: Array
    torque: Array
    differential: Array
    vibration: Array
    feed: Array
    ambient: Array
    starts: tuple[int, ...]

    @property
    def seconds(self) -> Array:
        """(n,) s since the first row."""
        return np.arange(self.running.size, dtype=float)

    @property
    def since_start(self) -> Array:
        """(n,) s since the last start; infinite before the first."""
        rows = np.arange(self.running.size)
        begun = np.searchsorted(self.starts, rows, side="right")
        last = np.asarray(self.starts)[np.maximum(begun, 1) - 1]
        return np.where(begun > 0, rows - last, np.inf)


def smoothed(column: Array, memory: float) -> Array:
    """(n,) a first-order lag of `memory` seconds, at rest at the first value."""
    keep = float(np.exp(-1.0 / memory))
    out, _ = lfilter([1 - keep], [1.0, -keep], column, zi=np.array([keep * column[0]]))
    return np.asarray(out)


def wandering(rng: np.random.Generator, n: int, memory: float, sigma: float) -> Array:
    """(n,) a stationary Ornstein-Uhlenbeck process."""
    keep = float(np.exp(-1.0 / memory))
    shocks = sigma * np.sqrt(1 - keep**2) * rng.standard_normal(n)
    shocks[0] = sigma * rng.standard_normal()
    return np.asarray(lfilter([1.0], [1.0, -keep], shocks))


def orders(rng: np.random.Generator, n: int, stay: tuple[float, float], level: tuple[float, float]) -> Array:
    """(n,) levels held for a log-uniform number of seconds."""
    out, at = np.empty(n), 0
    while at < n:
        until = at + int(np.exp(rng.uniform(*np.log(stay))))
        out[at:until] = rng.uniform(*level)
        at = until
    return out


def duty(rng: np.random.Generator, days: float, kind: DutyKind) -> Duty:
    """`shifts`: two to five runs a day with rests; `campaign`: one start, and days of running with slow orders."""
    n = int(days * DAY)
    running, starts = np.zeros(n), list[int]()
    at = int(rng.uniform(1.0, 3.0) * 3600)
    while at < n:
        lasts = rng.uniform(1.5, 5.0) * 3600 if kind == "shifts" else n
        running[at : at + int(lasts)] = 1.0
        starts.append(at)
        at += int(lasts + rng.uniform(0.7, 3.5) * 3600)
        if at % DAY > 20 * 3600:  # the night shift is not manned
            at += DAY - at % DAY + int(rng.uniform(5.0, 7.0) * 3600)
    # An order's solids set the load; between orders the bowl is rinsed and idles.
    order = orders(rng, n, (1200, 14000), (125.0, 330.0))
    rinse = orders(rng, n, (900, 6000), (0.0, 1.0)) < 0.15
    for start in starts:
        rinse[start : start + int(rng.uniform(180, 900))] = True
    load = np.where(rinse, 65.0, order) + np.where(rinse, 1.0, 7.0) * wandering(rng, n, 90.0, 1.0)
    load = running * np.clip(load, 25.0, 345.0)
    # Direct on line: five to seven times the idle current until the drum is at speed.
    current = load.copy()
    for start in starts:
        up = np.arange(int(rng.uniform(4, 14)))
        rows = start + up[start + up < n]
        current[rows] = 400.0 * np.exp(-up[: rows.size] / 12.0)
    slurry = running * ~rinse * (orders(rng, n, (600, 5000), (0.0, 1.0)) < 0.7)
    solids = orders(rng, n, (2000, 9000), (25.0, 70.0)) + wandering(rng, n, 900.0, 5.0)
    differential = running * np.clip(smoothed(orders(rng, n, (1500, 7000), (6.0, 26.0)), 20.0), 0.5, 30.0)
    bursts = np.zeros(n)
    for begin in np.flatnonzero(rng.random(n) < 1 / 2400):
        bursts[begin : begin + int(rng.uniform(200, 1200))] += rng.uniform(1.0, 4.0)
    weather = np.interp(np.arange(n), np.arange(0, n + DAY, DAY), rng.normal(0.0, 2.5, n // DAY + 1 + (n % DAY > 0)))
    sun = rng.uniform(2.0, 4.0) * np.sin(2 * np.pi * (np.arange(n) / DAY - 9 / 24))
    return Duty(
        running=running,
        load=load,
        current=current,
        slurry=slurry,
        speed=slurry * orders(rng, n, (2500, 9000), (45.0, 90.0)),
        torque=running * np.clip(np.where(rinse, 10.0, solids), 2.0, 99.0),
        differential=differential,
        vibration=np.where(running > 0, 1.2 + smoothed(bursts, 20.0), 0.1),
        feed=smoothed(orders(rng, n, (4000, 20000), (10.0, 38.0)), 500.0) + wandering(rng, n, 3000.0, 0.4),
        ambient=18.0 + weather + sun + wandering(rng, n, 2400.0, 0.3),
        starts=tuple(starts),
    )

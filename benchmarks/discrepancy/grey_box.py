"""A rival of the engineer's own: one or two masses, heat that signals drive, a thermostat; fitted by least squares.

It knows nothing of automata, noise or names: what it says is how far a free run is off with and without a second mass
or a valve, on stretches that it was not fitted to.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
import scipy

from sim.sha import Array, Trace

Part = Literal["second mass", "thermostat"]
HELD_OUT = 0.3
"""Share of the stretches, the last ones, that are not fitted."""
STEPS_A_STRETCH = 600
"""Steps of a stretch at most: what is slower than a six-hundredth of it is all that is looked for."""
LEAST_ROWS = 30
"""Rows that a stretch needs."""
EVALUATIONS = 40
"""Jacobians of one fit at most."""


@dataclass(frozen=True, slots=True)
class Stretches:
    """s stretches on a common grid: `dt` (s,) seconds, `read` (s, n) degC, NaN after the end, `drive` (s, n, k) in
    standard deviations of each signal."""

    dt: Array
    read: Array
    drive: Array


def stretches_of(traces: Sequence[Trace], temperature: str, signals: Sequence[str], pieces: int) -> Stretches:
    """The traces, each cut into `pieces` equal ones, interpolated to at most `STEPS_A_STRETCH` steps."""
    dt, read, drive = [], [], []
    for trace in traces:
        known = np.isfinite(trace.signals[temperature])
        times = trace.times[known]
        for low, high in pairwise(np.linspace(0, times.size, pieces + 1).astype(int).tolist()):
            if high - low < LEAST_ROWS:
                continue
            grid = np.linspace(times[low], times[high - 1], min(high - low, STEPS_A_STRETCH))
            dt.append(float(grid[1] - grid[0]))
            read.append(np.interp(grid, times, trace.signals[temperature][known]))
            columns = [_filled(trace, signal, grid) for signal in signals]
            drive.append(np.column_stack(columns) if columns else np.empty((grid.size, 0)))
    longest = max(row.size for row in read)
    filled = np.full((len(read), longest), np.nan)
    driven = np.zeros((len(read), longest, len(signals)))
    for number, (row, columns_of_row) in enumerate(zip(read, drive, strict=True)):
        filled[number, : row.size], driven[number, : row.size] = row, columns_of_row
    scale = np.nanstd(driven, axis=(0, 1))
    return Stretches(np.array(dt), filled, driven / np.where(scale > 0, scale, 1.0))


def _filled(trace: Trace, signal: str, grid: Array) -> Array:
    known = np.isfinite(trace.signals[signal])
    return np.interp(grid, trace.times[known], trace.signals[signal][known])


def free_run(stretches: Stretches, point: Array, parts: Sequence[Part]) -> Array:
    """(s, n) degC from the first reading of each stretch on, by implicit Euler steps."""
    kind = iter(point.tolist())
    rate, rest = np.exp(next(kind)), next(kind)
    gains = np.array([next(kind) for _ in range(stretches.drive.shape[2])])
    coupling, slow = (np.exp(next(kind)), np.exp(next(kind))) if "second mass" in parts else (0.0, 0.0)
    opens, valve = (next(kind), np.exp(next(kind))) if "thermostat" in parts else (np.inf, 0.0)
    heat = stretches.drive @ gains + rest * rate
    out = np.empty_like(stretches.read)
    mass = out[:, 0] = stretches.read[:, 0]
    dt = stretches.dt
    for step in range(1, out.shape[1]):
        before = out[:, step - 1]
        cooling = np.where(before > opens, valve, 0.0)
        gained = before + dt * (heat[:, step - 1] + coupling * mass + (cooling * opens if valve else 0.0))
        out[:, step] = gained / (1.0 + dt * (rate + coupling + cooling))
        mass = (mass + dt * slow * out[:, step]) / (1.0 + dt * slow)
    return out


def rms_of(stretches: Stretches, parts: Sequence[Part]) -> float:
    """degC rms over the last stretches of a model with these parts that was fitted to the others."""
    count = stretches.dt.size
    fitted = max(round((1.0 - HELD_OUT) * count), 1)
    begin = _begin(stretches, parts)

    def misses(point: Array) -> Array:
        part = Stretches(stretches.dt[:fitted], stretches.read[:fitted], stretches.drive[:fitted])
        error = free_run(part, point, parts) - part.read
        return np.nan_to_num(error[np.isfinite(part.read)], nan=1e6, posinf=1e6, neginf=-1e6)

    found = scipy.optimize.least_squares(misses, begin, x_scale="jac", loss="soft_l1", max_nfev=EVALUATIONS)
    error = (free_run(stretches, found.x, parts) - stretches.read)[fitted if count > 1 else 0 :]
    return float(np.sqrt(np.nanmean(error**2)))


def _begin(stretches: Stretches, parts: Sequence[Part]) -> Array:
    length = float(np.median(stretches.dt) * np.isfinite(stretches.read).sum(axis=1).mean())
    rate = np.log(5.0 / length)
    point = [rate, float(np.nanmean(stretches.read)), *np.zeros(stretches.drive.shape[2]).tolist()]
    point += [rate, rate - 1.0] if "second mass" in parts else []
    point += [float(np.nanquantile(stretches.read, 0.8)), rate] if "thermostat" in parts else []
    return np.array(point)


def compare(stretches: Stretches, parts: Sequence[Part]) -> Mapping[str, float]:
    """degC rms on held-out stretches: one mass, and with each of the parts beside it."""
    choices: dict[str, tuple[Part, ...]] = {"one mass": (), **{f"and a {part}": (part,) for part in parts}}
    return {words: rms_of(stretches, choice) for words, choice in choices.items()}

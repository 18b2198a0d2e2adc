"""The mean course of X alone under a thermostat and constant heats: a loop over floats, each crossing in closed form.

It does what `moments_augmented` does in general, some hundred times as fast where the thermostat switches often.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from math import exp, inf, log

import numpy as np

from sim.engine.tables import Half, Tables
from sim.sha import SHA, Array, Effect, Mask

_MAX_SWITCHES = 8


@dataclass(slots=True)
class Valve:
    """X and the thermostat's state as they go on; `clamps` and `limited` count as in `moments_augmented.MeanCourse`."""

    x: float
    opened: bool
    clamps: int = 0
    limited: int = 0


Row = tuple[tuple[float, float, float, float], tuple[float, float, float, float], float, float, bool]
"""(decay, gain, loss, heat) closed and open, length, X drawn anew (NaN: not), whether the range is looked at."""


def iterate_rows(steps: Tables, mode: Array, fresh: Array, checked: Mask) -> Iterator[Row]:
    """The steps as floats; `fresh` (n,) is NaN where X goes on."""
    closed, other = _columns(steps.closed, mode), _columns(steps.open or steps.closed, mode)
    return zip(closed, other, steps.dt.tolist(), fresh.tolist(), checked.tolist(), strict=True)


def _columns(half: Half, mode: Array) -> Iterator[tuple[float, float, float, float]]:
    heat = half.terms.heat[:, 0] + half.terms.drive[:, 0] * mode
    gain = half.added[:, 0] + half.pull[:, 0] * mode
    parts = (half.phi[:, 0, 0], gain, half.terms.loss, heat)
    return zip(*(part.tolist() for part in parts), strict=True)


def follow(sha: SHA, effect: Effect, steps: Iterator[Row], valve: Valve, n: int) -> tuple[Array, Array]:
    """(X after each of the n steps, part of each for which the thermostat was open); `valve` is moved on."""
    opens, closes, rate = effect.params["opens"], effect.params["closes"], sha.max_rate
    ends, parts = np.empty(n), np.zeros(n)
    for row, (closed, other, dt, fresh, checked) in enumerate(steps):
        x = valve.x if fresh != fresh else fresh  # NaN is the one number that is not itself
        valve.opened = (valve.opened and x > closes) or x >= opens
        decay, gain, _, _ = other if valve.opened else closed
        end, share = decay * x + gain, float(valve.opened)
        # X is monotone between switches, so that it has passed its threshold if and only if its end lies beyond.
        if dt > 0 and ((end <= closes) if valve.opened else (end >= opens)):
            end, share = _switch_valve(valve, (closed, other), (opens, closes), x, dt)
        if rate < inf and abs(end - x) > rate * dt * (1.0 + 1e-12):
            end = x + min(max(end - x, -rate * dt), rate * dt)
            valve.limited += 1
        if checked and not sha.low <= end <= sha.high:
            end = min(max(end, sha.low), sha.high)
            valve.clamps += 1
        ends[row], parts[row], valve.x = end, share, end
    return ends, parts


def _switch_valve(
    valve: Valve,
    both: tuple[tuple[float, float, float, float], tuple[float, float, float, float]],
    limits: tuple[float, float],
    x: float,
    dt: float,
) -> tuple[float, float]:
    """(X at the end, part of the step for which the thermostat was open) of a step in which it switches."""
    # From threshold to threshold, with the other mode's closed form each time, until the end of the step is reached
    # without another. The last round's end is kept even where it lies beyond: a valve that hunts so fast is cut off.
    left, opened, end = dt, 0.0, x
    for _ in range(_MAX_SWITCHES):
        wanted = limits[valve.opened]
        passed = min(_settling_time(wanted, x, *both[valve.opened][2:]), left)
        opened += passed * valve.opened
        left -= passed
        x, valve.opened = wanted, not valve.opened
        end = _relax(left, x, *both[valve.opened][2:])
        if (end > limits[1]) if valve.opened else (end < limits[0]):
            break
    return end, (opened + left * valve.opened) / dt


def _settling_time(wanted: float, x: float, loss: float, heat: float) -> float:
    """Seconds until X is at `wanted`; inf where it settles there, and only rounding says that it has come."""
    settled = heat / loss if loss > 0 else inf
    # X(t) - settled decays as exp(-loss t); without a loss X moves in a straight line.
    if wanted == x:
        return 0.0
    if settled == inf:
        return (wanted - x) / heat
    if (x - settled) * (wanted - settled) <= 0.0:
        return inf
    return log((x - settled) / (wanted - settled)) / loss


def _relax(seconds: float, x: float, loss: float, heat: float) -> float:
    if loss <= 0:
        return x + heat * seconds
    return heat / loss + (x - heat / loss) * exp(-loss * seconds)

"""Signal-to-noise of an effect: what it does to the temperature that the baseline's own parameters cannot imitate.

The baseline of these pages is the benchmark's own: one relaxation a stage, its start free in each cycle, fitted by
plain least squares (Gauss-Newton on its free run) to a run of the plant with the effect. What is left of the difference
between the runs with and without the effect, after the fit's tangent plane is taken out, over the sensor's sigma, is
the signal-to-noise ratio. Only the first 70 % of the time counts: what a tool that holds out the last 30 % may fit.
"""

from dataclasses import dataclass

import numpy as np

from benchmarks.discrepancy.operation import OFF, STAGES, Array, Operation
from benchmarks.discrepancy.plant import Bearing

FITTED = 0.7
ROUNDS = 2


@dataclass(frozen=True, slots=True)
class Family:
    """What a given model may adjust: the group of each stage's rate, and of its gain on the current (-1: none)."""

    rates: tuple[int, ...] = (0, 1, 1, 1, 1)
    gains: tuple[int, ...] = (-1, -1, -1, -1, -1)


@dataclass(frozen=True, slots=True)
class _Course:
    values: Array
    tangent: Array


def signal_to_noise(
    operation: Operation, bearing: Bearing, family: Family, without: Array, with_effect: Array, sensor: float
) -> float:
    """The ratio for noise-free sensor courses (n,) of a pair of runs; `sensor` in degC."""
    rows = slice(operation.starts[0], int(FITTED * operation.times.size))
    fitted = fit(operation, bearing, family, with_effect, rows)
    difference = with_effect[rows] - without[rows]
    left = difference - fitted.tangent @ _least_squares(fitted.tangent, difference)
    return float(np.sqrt(np.mean(left**2)) / sensor)


def left_over(operation: Operation, bearing: Bearing, family: Family, temperature: Array) -> float:
    """Root mean square (degC) of what the best baseline leaves of a noise-free course."""
    rows = slice(operation.starts[0], int(FITTED * operation.times.size))
    fitted = fit(operation, bearing, family, temperature, rows)
    return float(np.sqrt(np.mean((temperature[rows] - fitted.values) ** 2)))


def fit(operation: Operation, bearing: Bearing, family: Family, temperature: Array, rows: slice) -> _Course:
    """The baseline's free run nearest to `temperature`, and its tangent there (rows, parameters), one unit scaled."""
    shape = _Shape(operation, family, rows)
    theta = shape.begin(bearing, temperature[rows])
    course = shape.course(theta)
    for _ in range(ROUNDS):
        left = temperature[rows] - course.values
        change = _least_squares(course.tangent, left)
        for share in (1.0, 0.3, 0.1):
            ahead = shape.course(theta + share * change)
            if np.sum((temperature[rows] - ahead.values) ** 2) < np.sum(left**2):
                theta, course = theta + share * change, ahead
                break
    return course


def _least_squares(columns: Array, values: Array) -> Array:
    """Coefficients by the normal equations of scaled columns; directions that the rows do not show stay 0."""
    scale = np.sqrt(np.sum(columns**2, axis=0))
    scale[scale == 0] = 1.0
    scaled = columns / scale
    return np.asarray(np.linalg.pinv(scaled.T @ scaled, rcond=1e-12, hermitian=True) @ (scaled.T @ values) / scale)


class _Shape:
    """The baseline over some rows: parameters are log rates, targets (degC), gains (degC per 100 A), then starts."""

    def __init__(self, operation: Operation, family: Family, rows: slice) -> None:
        self.stage = operation.stage[rows]
        self.rate, self.gain = np.asarray(family.rates)[self.stage], np.asarray(family.gains)[self.stage]
        self.sizes = np.cumsum([max(family.rates) + 1, STAGES, max(family.gains) + 1])
        middle = np.array([0.0, 50.0, 150.0, 250.0, 350.0])[self.stage]
        self.above = np.where(self.gain >= 0, (operation.current[rows] - middle) / 100.0, 0.0)
        self.period = operation.period
        first = np.array(operation.starts) - rows.start
        self.cycle = first[first < self.stage.size]
        self.number = np.searchsorted(self.cycle, np.arange(self.stage.size), side="right") - 1

    def begin(self, bearing: Bearing, temperature: Array) -> Array:
        """The plant's own constants as parameters."""
        loss = np.array([bearing.loss_rest, *[bearing.loss_running] * (STAGES - 1)])
        targets = bearing.hall + np.asarray(bearing.heat) / loss
        running = np.full(self.sizes[0], bearing.loss_running)
        running[self.rate[self.stage == OFF]] = bearing.loss_rest
        gains = np.full(self.sizes[2] - self.sizes[1], 100.0 * bearing.slope / bearing.loss_running)
        return np.concatenate([np.log(running), targets, gains, temperature[self.cycle]])

    def course(self, theta: Array) -> _Course:
        """The free run and its derivatives by the parameters."""
        rates, targets, gains, starts = np.split(theta, self.sizes)
        k = np.exp(rates[self.rate])
        keep = np.exp(-k * self.period)
        target = targets[self.stage] + (gains[np.maximum(self.gain, 0)] * self.above if gains.size else 0.0)
        values = _relax(keep, (1 - keep) * target, self.cycle, starts)
        columns = [self.period * k * keep * (target - values) * (self.rate == one) for one in range(rates.size)]
        columns += [(1 - keep) * (self.stage == one) for one in range(STAGES)]
        columns += [(1 - keep) * self.above * (self.gain == one) for one in range(gains.size)]
        tangent = _driven(keep, np.stack(columns, axis=1), self.cycle)
        grown = np.cumsum(np.log(keep)) - np.log(keep)
        decay = np.exp(grown - grown[self.cycle][self.number])
        own = (self.number[:, None] == np.arange(self.cycle.size)) * decay[:, None]
        return _Course(values, np.hstack([tangent, own]))


def _relax(keep: Array, drive: Array, begins: np.ndarray, starts: Array) -> Array:
    """(n,) x[i+1] = keep[i] x[i] + drive[i], set to `starts` at the rows `begins`."""
    fresh = dict(zip(begins.tolist(), starts.tolist(), strict=True))
    out, now = [], 0.0
    for row, (factor, add) in enumerate(zip(keep.tolist(), drive.tolist(), strict=True)):
        if row in fresh:
            now = fresh[row]
        out.append(now)
        now = factor * now + add
    return np.array(out)


def _driven(keep: Array, drive: Array, begins: np.ndarray) -> Array:
    """(n, columns) the same recurrence for many drives at once, from 0 at each of `begins`."""
    out = np.empty_like(drive)
    fresh = set(begins.tolist())
    now = np.zeros(drive.shape[1])
    for row, factor in enumerate(keep.tolist()):
        if row in fresh:
            now = np.zeros(drive.shape[1])
        out[row] = now
        now = factor * now + drive[row]
    return out

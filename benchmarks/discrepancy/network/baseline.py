"""What a model of one relaxation a stage cannot say of a network's course: the benchmark's own, by least squares.

Parameters: one rate at rest and one running, for each stage of the current a target and a gain on the current, a start
temperature for each cycle. For given rates the course is linear in all others, so that only the two rates are searched
(variable projection, Golub & Pereyra 1973). What is left of an effect beyond these parameters and the tangents of the
rates, over the sensor's sigma, is its signal-to-noise ratio.
"""

import numpy as np
from scipy.linalg import solve_banded

from benchmarks.discrepancy.network.duty import Duty
from benchmarks.discrepancy.operation import Array

STEP = 20
"""Seconds between the rows that are looked at."""
FITTED = 0.7
STAGES = (100.0, 200.0, 300.0)
ROUNDS = 4


class FirstOrder:
    """The first-order model over the part of a duty that a tool may fit: from its first start, the first 70 %."""

    def __init__(self, duty: Duty) -> None:
        first = duty.starts[0]
        self.rows = np.arange(first, int(FITTED * duty.running.size), STEP)
        self.running = duty.running[self.rows]
        load = np.clip(duty.load, 0.0, 345.0)
        # Means over each step, so that a step that lies inside one is neither early nor late.
        cells = np.minimum(self.rows[:, None] - STEP + np.arange(STEP), duty.running.size - 1)
        stage = np.where(duty.running > 0, 1 + np.digitize(load, STAGES), 0)
        held = [(stage == one).astype(float) for one in range(5)]
        held += [np.where(stage == one, load - 200.0, 0.0) / 100.0 for one in range(1, 5)]
        self.drives = np.column_stack([np.mean(column[np.maximum(cells, 0)], axis=1) for column in held])
        starts = np.asarray(duty.starts)
        self.begins = np.searchsorted(self.rows, starts[starts < self.rows[-1]])
        self.rates = np.log([1 / 3600.0, 1 / 1400.0])

    def basis(self, rates: Array) -> Array:
        """(rows, columns) the responses to unit targets, gains and starts at log rates (rest, running)."""
        k = np.where(self.running > 0, *np.exp(rates)[::-1])
        keep = np.exp(-k * STEP)
        free = keep.copy()
        free[self.begins] = 0.0
        own = np.zeros((self.rows.size, self.begins.size))
        own[self.begins, np.arange(self.begins.size)] = 1.0
        push = (1.0 - keep)[:, None] * self.drives
        push[self.begins] = 0.0
        # x[i] - free[i] x[i-1] = push[i]: one bidiagonal system for all columns.
        band = np.vstack([np.ones(free.size), np.append(-free[1:], 0.0)])
        return np.asarray(solve_banded((1, 0), band, np.hstack([push, own])))

    def fit(self, course: Array) -> tuple[Array, Array]:
        """(what is left of a course (n,) at the rows, the tangent space (rows, columns) there)."""
        values = course[self.rows]
        for _ in range(ROUNDS):
            left, columns = self._tangent(values)
            change = np.linalg.lstsq(columns, left, rcond=None)[0][-2:]
            self.rates = self.rates + np.clip(change, -0.4, 0.4)
        return self._tangent(values)

    def _tangent(self, values: Array) -> tuple[Array, Array]:
        basis = self.basis(self.rates)
        best = np.linalg.lstsq(basis, values, rcond=None)[0]
        slopes = [(self.basis(self.rates + 1e-3 * one) - basis) @ best / 1e-3 for one in np.eye(2)]
        return values - basis @ best, np.column_stack([basis, *slopes])


def left_over(duty: Duty, course: Array) -> float:
    """degC rms that the best first-order model leaves of a noise-free course (n,)."""
    return float(np.sqrt(np.mean(FirstOrder(duty).fit(course)[0] ** 2)))


def visible(duty: Duty, without: Array, with_it: Array) -> float:
    """degC rms of the difference of two noise-free courses that the model's own parameters cannot imitate."""
    model = FirstOrder(duty)
    _, columns = model.fit(with_it)
    difference = (with_it - without)[model.rows]
    left = difference - columns @ np.linalg.lstsq(columns, difference, rcond=None)[0]
    return float(np.sqrt(np.mean(left**2)))

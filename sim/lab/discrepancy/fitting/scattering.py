"""Random effects beside a long band of states: a column for each cycle, which soon dies away, and a few that do not.

The windows' covariance is V = V0 + Z Z', V0 that of the banded states with the sensor's noise, Z the columns. Of
Woodbury's identity M = I + Z' V0^-1 Z is needed alone. A cycle's column has few rows that are not zero, and what
solving along the band makes of it fades as the plant and its disturbances forget. So M is a band of the cycles with a
border of the few other columns, and the cost is that of the cycles which are remembered, not of all.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy
from scipy.linalg.lapack import dtbtrs

from sim.lab.learning import Indices
from sim.sha import Array

CYCLES_IN_PIECE, MIN_PIECE_WINDOWS = 3, 64
"""Cycles of the usual length, and windows at least, that are worked out at a time: with more of them columns are solved
where they are nothing yet, and with fewer each piece costs more than what is in it."""
NEGLIGIBLE_SHARE = 1e-10
"""The share of a column's size below which what is left of it is nothing: of the order of rounding."""


@dataclass(frozen=True, slots=True)
class StateBand:
    """The states of m windows given readings: `factor` (d + 1, states m) is the lower Cholesky factor of their banded
    precision, `weight` (1/degC^2) that of one reading, which is the sum of every other state of its window."""

    factor: Array
    states: int
    weight: float

    def push(self, columns: Array) -> Array:
        """(states m, c) what the columns (m, c), read as residuals, say of the states."""
        pushed = np.zeros((self.states * columns.shape[0], columns.shape[1]), order="F")
        for part in range(0, self.states, 2):  # x and u
            pushed[part :: self.states] = columns * self.weight
        return pushed

    def half_solve(self, columns: Array) -> Array:
        """(states m, c) half of the solution: only down the factor."""
        return _solve_factor(self.factor, self.push(columns), "N")

    def back_solve(self, halved: Array) -> Array:
        """(states m, c) the states' means given columns that are half solved: the way back up the factor."""
        return _solve_factor(self.factor, halved, "T")

    def residual_weights(self, columns: Array, solved: Array) -> Array:
        """(m, c) V0^-1 times the columns, by the states' means given them."""
        shown = sum(solved[part :: self.states] for part in range(0, self.states, 2))
        return np.asarray((columns - shown) * self.weight)

    @property
    def reach(self) -> int:
        """How many states a state is tied to on either side."""
        return int(self.factor.shape[0]) - 1

    def border(self, at: int) -> Array:
        """(d, d) the factor's block that ties the first states from the window `at` on to the last before it."""
        first, reach = self.states * at, self.reach
        block = np.zeros((reach, reach))
        for column in range(reach):
            rows = np.arange(column + 1)
            block[rows, column] = self.factor[reach + rows - column, first - reach + column]
        return block

    def part(self, begin: int, end: int) -> Array:
        """The factor's columns of some windows."""
        return self.factor[:, self.states * begin : self.states * end]


@dataclass(frozen=True, slots=True)
class HalfWeighed:
    """`columns` (m, c) on half of the way to V^-1 times them: `halved` (states m, c) down the states' factor, `across`
    (C + c, c) down that of M; `weight` (1/degC^2) is that of one reading. All of it is linear in the columns."""

    columns: Array
    halved: Array
    across: Array
    weight: float

    def products(self, other: "HalfWeighed") -> Array:
        """(c, d) C' V^-1 D of the columns C with those of `other`, D."""
        plain = self.columns.T @ other.columns * self.weight
        return np.asarray(plain - self.halved.T @ other.halved - self.across.T @ other.across)

    def mix(self, mixing: Array) -> "HalfWeighed":
        """The columns times `mixing` (c, k)."""
        return HalfWeighed(self.columns @ mixing, self.halved @ mixing, self.across @ mixing, self.weight)


@dataclass(frozen=True, slots=True)
class Spans:
    """Where each of C columns has rows that are not zero: `begin` (C,) the first, `end` (C,) one beyond the last.

    Both rise: a column counts from the rows of the one before on, whatever it has there.
    """

    begin: Indices
    end: Indices


def column_spans(columns: Array) -> Spans:
    """The spans of the columns (m, C)."""
    there = columns != 0.0
    some = there.any(axis=0)
    begin = np.where(some, np.argmax(there, axis=0), columns.shape[0])
    end = np.where(some, columns.shape[0] - np.argmax(there[::-1], axis=0), 0)
    return Spans(np.minimum.accumulate(begin[::-1])[::-1], np.maximum.accumulate(end))


@dataclass(frozen=True, slots=True)
class _WindowBlock:
    """Windows `rows` with the columns that are something there: themselves, and half solved."""

    rows: slice
    columns: slice
    own: Array
    halved: Array


@dataclass(frozen=True, slots=True)
class SolvedPiece:
    """Windows `rows` with the columns whose solution is something there: themselves, and `states`, solved.

    `after` (d, c) are the first states of the windows that come next, as many as a state is tied to.
    """

    rows: slice
    columns: slice
    own: Array
    states: Array
    after: Array


class Scattering:
    """The columns Z beside a band: of the cycles, with the rows that their `spans` say, and `others` (m, c)."""

    def __init__(self, band: StateBand, cycles: Array, scatter: float, others: Array, spans: Spans) -> None:
        """Of the cycles' columns (m, C), each times the `scatter`."""
        self.band, self.others, self.count = band, others, cycles.shape[1]
        self._spans = spans
        self._pieces = list(_pieces(band, cycles, scatter, spans))
        self._others = band.half_solve(others)
        # M = (B F; F' H): B a band in lower form, its entry (j + i, j) in row i.
        width = max(1, *(piece.halved.shape[1] for piece in self._pieces))
        inner = np.zeros((width, self.count))
        inner[0] = 1.0
        for piece in self._pieces:
            gram = piece.own.T @ piece.own * band.weight - piece.halved.T @ piece.halved
            for row in range(gram.shape[0]):
                inner[row, piece.columns.start : piece.columns.stop - row] += np.diagonal(gram, -row)
        self._root = scipy.linalg.cholesky_banded(inner, lower=True, check_finite=False)
        border = self._by_cycles(others, self._others)
        self._border = self._forward(border)
        corner = np.eye(others.shape[1]) + others.T @ others * band.weight - self._others.T @ self._others
        self._corner = scipy.linalg.cholesky(corner - self._border.T @ self._border, lower=True, check_finite=False)

    @property
    def logdet(self) -> float:
        """ln |M|."""
        return 2.0 * float(np.log(self._root[0]).sum() + np.log(np.diag(self._corner)).sum())

    def cross_products(self, columns: Array, halved: Array) -> Array:
        """(C + c, k) Z' V0^-1 times the columns (m, k), which are half solved, too."""
        others = self.others.T @ columns * self.band.weight - self._others.T @ halved
        return np.vstack([self._by_cycles(columns, halved), others])

    def half(self, across: Array) -> Array:
        """(C + c, k) R^-1 times (C + c, k), with R R' = M."""
        cycles = self._forward(across[: self.count])
        others = across[self.count :] - self._border.T @ cycles
        return np.vstack([cycles, scipy.linalg.solve_triangular(self._corner, others, lower=True, check_finite=False)])

    def back_solve(self, half: Array) -> Array:
        """(C + c, k) R'^-1 times (C + c, k): with `half` before, M^-1."""
        others = scipy.linalg.solve_triangular(
            self._corner, half[self.count :], lower=True, trans="T", check_finite=False
        )
        return np.vstack([self._backward(half[: self.count] - self._border @ others), others])

    def times(self, strengths: Array) -> Array:
        """(m, k) Z times (C + c, k)."""
        out = np.asarray(self.others @ strengths[self.count :])
        for piece in self._pieces:
            out[piece.rows] += piece.own @ strengths[piece.columns]
        return out

    def halved_times(self, strengths: Array) -> Array:
        """(states m, k) Z, half solved, times (C + c, k)."""
        states, out = self.band.states, np.asarray(self._others @ strengths[self.count :])
        for piece in self._pieces:
            out[states * piece.rows.start : states * piece.rows.stop] += piece.halved @ strengths[piece.columns]
        return out

    def inner_inverse(self) -> Array:
        """(C, C) the inverse of B alone."""
        return np.asarray(scipy.linalg.cho_solve_banded((self._root, True), np.eye(self.count), check_finite=False))

    def others_besides(self) -> Array:
        """(C + c, c) the strengths S of columns beside which B alone stands for the cycles: M^-1 = B^-1 + S S'."""
        root = scipy.linalg.solve_triangular(
            self._corner, np.eye(self._corner.shape[0]), lower=True, trans="T", check_finite=False
        )
        return np.vstack([-self._backward(self._border @ root), root])

    def solve_cycles(self) -> Iterator[SolvedPiece]:
        """The cycles' columns solved along the band, from the last windows to the first."""
        band, reach = self.band, self.band.reach
        carried, size, high = np.zeros((reach, self.count)), np.zeros(self.count), 0
        after = np.zeros((reach, self.count))
        for number in range(len(self._pieces) - 1, -1, -1):
            piece = self._pieces[number]
            low, own = piece.columns.start, piece.halved.shape[1]
            high = max(high, piece.columns.stop)
            right = np.zeros((piece.halved.shape[0], high - low), order="F")
            right[:, :own] = piece.halved
            right[-reach:] -= carried[-right.shape[0] :, low:high]
            states = _solve_factor(band.part(piece.rows.start, piece.rows.stop), right, "T")
            columns = np.zeros((piece.own.shape[0], high - low))
            columns[:, :own] = piece.own
            yield SolvedPiece(piece.rows, slice(low, high), columns, states, after[:, low:high])
            if not number:
                return
            size[low:high] += np.einsum("ij,ij->j", right, right)
            carried, after = np.zeros((reach, self.count)), np.zeros((reach, self.count))
            after[:, low:high] = states[:reach]
            carried[:, low:high] = band.border(piece.rows.start).T @ states[:reach]
            # A column that begins later and is felt no more before it is done with.
            faded = np.max(carried**2, axis=0) <= NEGLIGIBLE_SHARE**2 * size
            kept = np.flatnonzero(~(faded & (self._spans.begin >= piece.rows.start))[low:high])
            high = low + (int(kept[-1]) + 1 if kept.size else 0)

    def _by_cycles(self, columns: Array, halved: Array) -> Array:
        """(C, k) the cycles' part of `cross_products`."""
        states = self.band.states
        out = np.zeros((self.count, columns.shape[1]))
        for piece in self._pieces:
            half = halved[states * piece.rows.start : states * piece.rows.stop]
            out[piece.columns] += piece.own.T @ columns[piece.rows] * self.band.weight - piece.halved.T @ half
        return out

    def _forward(self, columns: Array) -> Array:
        """Half of the solution with B."""
        return _solve_factor(self._root, columns, "N")

    def _backward(self, columns: Array) -> Array:
        """The other half."""
        return _solve_factor(self._root, columns, "T")


def _solve_factor(factor: Array, columns: Array, trans: str) -> Array:
    """The columns (n, c) solved for the lower banded factor (d + 1, n), or for its transpose ("T")."""
    # LAPACK's wrapper breaks the memory where there is no column.
    return np.asarray(dtbtrs(factor, columns, uplo="L", trans=trans)[0]) if columns.size else columns


def _pieces(band: StateBand, columns: Array, scatter: float, spans: Spans) -> Iterator[_WindowBlock]:
    """The columns (m, C) half solved, from the first windows to the last."""
    m, count = columns.shape
    reach = band.reach
    carried, size, low = np.zeros((reach, count)), np.zeros(count), 0
    length = max(CYCLES_IN_PIECE * m // max(count, 1), MIN_PIECE_WINDOWS)
    edges = [*range(0, max(m - length // 2, 1), length), m]
    for begin, end in pairwise(edges):
        high = max(int(np.searchsorted(spans.begin, end)), low)
        own = columns[begin:end, low:high] * scatter
        pushed = band.push(own)
        if begin:
            pushed[:reach] -= band.border(begin) @ carried[:, low:high]
        halved = _solve_factor(band.part(begin, end), pushed, "N")
        yield _WindowBlock(slice(begin, end), slice(low, high), own, halved)
        if end == m:
            return
        carried[:, low:high] = halved[-reach:]
        size[low:high] += np.einsum("ij,ij->j", halved, halved)
        # A column that has ended and is felt no more after it is done with.
        done = (spans.end[low:high] <= end) & (
            np.max(carried[:, low:high] ** 2, axis=0) <= NEGLIGIBLE_SHARE**2 * size[low:high]
        )
        left = np.flatnonzero(~done)
        low += int(left[0]) if left.size else high - low

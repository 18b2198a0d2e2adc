"""One exact step over several pieces, filled in for the runs that come near a line.

A flow without saturation is affine with normal noise, so that one step over several pieces has their exact law. Where
its bridge reaches none of the lines that are looked at (`plan.may_reach`), nothing happens in it and a run needs no
more. Elsewhere the middle is drawn given both ends, as in Lévy's construction of Brownian motion, and each half is
taken in the same way, down to single pieces, whose bridges are looked at as ever.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import sqrt

import numpy as np

from sim.lab.checking.smc.paths.plan import MIN_DECAY, Indices, Piece, State, may_reach
from sim.sha import SHA, Array

MAX_PIECES = 4
"""Pieces of one step at most. Over four as long as `plan.MAX_PIECE_TAUS` allows, the mean path strays from the bridge's
straight line by 0.5 % of the line's distance from the target: of lines up to ten stationary deviations away, the chance
that is left out stays below 1e-15."""

CLEAR_SIGMAS = 10.0
"""Standard deviations of a step by which all runs keep clear of the automaton's range, where each piece is clamped."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NestedStep:
    """X' = decay * X + pull * mode + shift + noise, over one piece or over those of two `halves`, all of one stay."""

    begin: float
    dt: float
    age: float
    location: int
    decay: float
    pull: float
    shift: float
    variance: float
    bridge: float
    halves: "tuple[NestedStep, NestedStep] | None" = None

    def mean(self, start: Array, mode: Array | float) -> Array:
        """(n,) the mean at the end."""
        mean = start * self.decay
        mean += self.pull * mode + self.shift
        return mean

    def piece(self, rows: Indices | None, start: Array, end: Array) -> Piece:
        """All of it as one piece of these runs."""
        return Piece(
            rows=rows,
            begin=self.begin,
            dt=self.dt,
            age=self.age,
            location=self.location,
            start=start,
            end=end,
            bridge=self.bridge,
        )

    def advance(
        self, state: State, mode: Array | float, *, sha: SHA, lines: Sequence[float], rng: np.random.Generator
    ) -> Iterator[Piece] | None:
        """Move all runs to the end: the pieces on the way. None, and nothing moved, where a run may leave the range."""
        start = state.x
        mean = self.mean(start, mode)
        # The target is one and the same, so that the mean goes one way only and on the way is between its two ends.
        apart = CLEAR_SIGMAS * sqrt(self.variance)
        if min(start.min(), mean.min()) - apart < sha.low or max(start.max(), mean.max()) + apart > sha.high:
            return None
        state.x = rng.standard_normal(start.size)
        state.x *= sqrt(self.variance)
        state.x += mean
        return self.pieces(None, start, state.x, mode=mode, lines=lines, rng=rng)

    def pieces(
        self,
        rows: Indices | None,
        start: Array,
        end: Array,
        *,
        mode: Array | float,
        lines: Sequence[float],
        rng: np.random.Generator,
    ) -> Iterator[Piece]:
        """The pieces of runs (`rows` of their state; None: all) between two ends, those of each run in order."""
        piece = self.piece(rows, start, end)
        if self.halves is None:
            yield piece
            return
        close = np.zeros(start.size, dtype=np.bool_)
        for line in lines:
            close |= may_reach(piece, line, line)
        far, some = np.flatnonzero(~close), np.flatnonzero(close)
        if far.size:
            # No bridge: it reaches nothing.
            where = far if rows is None else rows[far]
            yield replace(piece, rows=where, start=start[far], end=end[far], bridge=0.0)
        if not some.size:
            return
        rows, start, end = some if rows is None else rows[some], start[some], end[some]
        mode = mode[some] if isinstance(mode, np.ndarray) else mode
        # The middle given both ends: a normal law updated by what the second half's end tells of its start.
        first, second = self.halves
        middle = first.mean(start, mode)
        missed = end - second.mean(middle, mode)
        missed *= second.decay * first.variance / self.variance
        middle += missed
        middle += sqrt(first.variance * second.variance / self.variance) * rng.standard_normal(some.size)
        yield from first.pieces(rows, start, middle, mode=mode, lines=lines, rng=rng)
        yield from second.pieces(rows, middle, end, mode=mode, lines=lines, rng=rng)


def join_steps(parts: Sequence[NestedStep]) -> NestedStep:
    """One step over neighbouring ones of the same stay, with the same target and some noise in each."""
    if len(parts) == 1:
        return parts[0]
    half = (len(parts) + 1) // 2
    first, second = join_steps(parts[:half]), join_steps(parts[half:])
    decay, variance = second.decay * first.decay, second.decay**2 * first.variance + second.variance
    return NestedStep(
        begin=first.begin,
        dt=first.dt + second.dt,
        age=first.age,
        location=first.location,
        decay=decay,
        pull=second.decay * first.pull + second.pull,
        shift=second.decay * first.shift + second.shift,
        variance=variance,
        bridge=variance / max(decay, MIN_DECAY),
        halves=(first, second),
    )

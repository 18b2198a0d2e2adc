"""Bounded response followed while the runs go by: the earliest cause that still waits for its effect, and no more.

A run fails as soon as one cause has waited longer than it may, so that little is kept and failed runs can be left out.
With `phi -->[a,b] psi` each cause is looked at `a` seconds later, as one that waits from then on for b - a seconds.
"""

from dataclasses import dataclass, field
from math import inf

import numpy as np

from sim.lab.checking.smc.monitors.formula import (
    CompiledFormulas,
    Value,
    WatchedLines,
    comparisons,
    exists,
    region,
    region_truth,
    table,
    table_at_begin,
    watched_lines,
)
from sim.lab.checking.smc.monitors.monitor import inside
from sim.lab.checking.smc.paths import Indices, Piece
from sim.sha import Array, Mask

INWARD_S, SAME_INSTANT_S = 1e-6, 1e-7
"""Seconds by which an end that does not belong to a stretch is moved inwards (a cause that has just ended and an effect
that begins there are then apart), and by which two instants may differ and still be one."""


@dataclass(slots=True)
class ResponseMonitor:
    """Whether each instant of `cause` (formula 0) up to `until` (s) is followed by `effect` (formula 1) low..high s
    later; the runs must go on to until + high.

    `waiting` (n,) is since when the earliest unanswered cause has waited (`low` s after it; inf: none waits), `lost`
    where one waited too long. `later` are causes that do not wait yet, oldest first: the earliest of all runs, and
    (first, last) (n,) of a stretch in each.
    `left_out` (n,) counts the stretches of causes after `until`, up to `bound`.
    """

    compiled: CompiledFormulas
    low: float
    high: float
    until: float
    bound: float
    runs: int
    waiting: Array = field(init=False)
    lost: Mask = field(init=False)
    left_out: Indices = field(init=False)
    lasting: Mask = field(init=False)
    later: list[tuple[float, Array, Array]] = field(default_factory=list)
    lines: list[list[int]] = field(init=False)
    over: bool = False

    def __post_init__(self) -> None:
        self.waiting = np.full(self.runs, inf)
        self.lost, self.lasting = np.zeros((2, self.runs), dtype=np.bool_)
        self.left_out = np.zeros(self.runs, dtype=np.intp)
        place = self.compiled.place
        self.lines = [
            sorted({place[compare][0] for compare, _ in comparisons(formula) if compare in place})
            for formula in self.compiled.formulas
        ]

    def watch(self, piece: Piece, who: Indices) -> WatchedLines:
        """The lines of both formulas."""
        return watched_lines(self.compiled, piece)

    def see(self, piece: Piece, who: Indices) -> None:
        """Let causes of the piece wait, and its effect answer those that wait."""
        cause = self._stretch(0, piece) if inside(piece, 0.0, max(self.until, self.bound)) else None
        if not inside(piece, 0.0, self.until):
            self._count_late_causes(cause, piece, who)
            cause, self.over = None, self.over or not inside(piece, 0.0, self.bound)
        effect = self._stretch(1, piece)
        stop = _last_instant(piece)

        due = []
        if self.low == 0.0:
            due += [cause] if cause is not None else []
        else:
            if cause is not None:
                first, last = np.full(self.runs, inf), np.full(self.runs, -inf)
                first[who], last[who] = cause[0] + self.low, cause[1] + self.low
                self.later.append((float(first.min()), first, last))
            due = self._due(stop, who)

        waiting = self.waiting[who]
        for first, last in due:
            # What comes before the effect waits for it; without one the effect's first instant is inf.
            before = first < (effect[0] if effect is not None else inf)
            waiting = np.where(before & (first <= last), np.minimum(waiting, first), waiting)
        width = self.high - self.low
        lost = np.zeros(who.size, dtype=np.bool_)
        if effect is not None:
            answered = effect[0] < inf
            lost |= answered & (effect[0] > waiting + width + SAME_INSTANT_S)
            waiting[answered] = inf
            for first, last in due:
                # A cause that goes on beyond the effect waits from there on: the effect is over for it.
                rest = np.maximum(first, effect[1] + INWARD_S)
                waiting = np.where(answered & (rest <= last), np.minimum(waiting, rest), waiting)
        lost |= stop > waiting + width + SAME_INSTANT_S
        self.waiting[who] = waiting
        self.lost[who] |= lost

    def _due(self, stop: Value, who: Indices) -> list[tuple[Array, Array]]:
        """The parts of `later` that begin to wait by `stop`; what is beyond is kept."""
        due, latest = [], float(np.max(stop))
        for earliest, first, last in self.later:
            if earliest > latest:  # of none of the runs
                continue
            begins, ends = first[who], np.minimum(last[who], stop)
            if np.any(begins <= ends):
                due.append((begins, ends))
                first[who] = np.maximum(begins, stop + INWARD_S)
        # Lost runs are no longer shown, so that what they had to wait for stays.
        while self.later and not np.any((self.later[0][1] <= self.later[0][2]) & ~self.lost):
            del self.later[0]
        return due

    def _count_late_causes(self, cause: tuple[Array, Array] | None, piece: Piece, who: Indices) -> None:
        """Count the causes that begin in a piece, or go on in the first piece after `until`."""
        if cause is None:
            self.lasting[who] = False
            return
        self.left_out[who] += (cause[0] < inf) & ~(self.lasting[who] & (cause[0] == piece.begin))
        self.lasting[who] = cause[1] >= _last_instant(piece)

    def _stretch(self, which: int, piece: Piece) -> tuple[Array, Array] | None:
        """(n,) the first and the last instant of a formula in the piece, (inf, -inf) without; None: in no run.

        The piece's end belongs to what follows, which may be another location. A moment inside the piece at which the
        temperature crosses a line is taken from the straight line between the piece's ends.
        """
        truth = table(self.compiled, which, piece)
        opening = table_at_begin(self.compiled, which, piece)
        begin, stop = piece.begin, _last_instant(piece)
        at_begin: bool | Mask
        inner: bool | Mask
        if not self.lines[which]:
            # The same in every region: no temperature is compared.
            at_begin, inner = opening[0], truth[0]
            if not np.any(at_begin) and not np.any(inner):
                return None
            first = np.where(at_begin, begin, np.where(inner, begin + INWARD_S, inf))
            last = np.where(inner, stop, np.where(at_begin, begin, -inf))
        else:
            met = exists(self.compiled, which, piece)
            here, there = (region(self.compiled, piece, at_end=at_end) for at_end in (False, True))
            at_begin, inner, at_end = region_truth(opening, here), region_truth(truth, here), region_truth(truth, there)
            if not np.any(met) and not np.any(at_begin):
                return None
            moment = begin + piece.dt * self._share(which, piece)
            first = np.where(at_begin, begin, np.where(inner, begin + INWARD_S, np.where(met, moment, inf)))
            last = np.where(at_end, stop, np.where(inner | met, moment, np.where(at_begin, begin, -inf)))
        shape = piece.start.shape
        return np.broadcast_to(first, shape), np.broadcast_to(last, shape)

    def _share(self, which: int, piece: Piece) -> Array | float:
        """The share of the piece after which the straight line between its ends crosses the formula's one line."""
        if len(self.lines[which]) > 1:
            return 0.5
        before, after = self.compiled.lines[self.lines[which][0]].ends(piece)
        ahead, beyond = before - piece.start, piece.end - after
        crosses = ahead * beyond > 0.0
        return np.where(crosses, ahead / np.where(crosses, ahead + beyond, 1.0), 0.5)

    def open(self) -> Mask | None:
        """The runs that may still fail: those in which a cause waits, once no new ones come."""
        if self.over and not self.later:
            return ~self.lost & (self.waiting < inf)
        return ~self.lost

    def failed(self) -> Mask:
        """(n,) the runs in which some cause had no effect in time, once they have gone on to until + high."""
        return self.lost | (self.waiting < inf)


def _last_instant(piece: Piece) -> Value:
    """The last instant (s) that is the piece's own: its end is the begin of what follows, unless it has no length."""
    return piece.begin + piece.dt - np.where(np.asarray(piece.dt) > 0.0, INWARD_S, 0.0)

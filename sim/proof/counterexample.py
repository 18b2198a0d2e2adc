"""A timed word that leads out of a range, where the bounds say that there is one: found again move by move, forwards.

The bounds (`reach`) are limits; a word has finitely many stays of finite length. So the same equations are followed
from the start with finite stays, keeping the best way to each location for every number of events, until a stay leaves
the range. The last stay is cut where it has gone half-way beyond the border (at most 1 degC).
"""

from collections.abc import Iterator
from dataclasses import replace
from math import ceil, inf, isinf

import numpy as np
from numpy.typing import NDArray

from sim.effects import growth_starts, offset_times
from sim.proof.envelope import DAY_S, Envelope
from sim.proof.reach import Graph, Side, best_moves
from sim.proof.word import TimedWord, WordStep
from sim.sha import RELAXING_FLOWS, Model

MAX_STAYS = 5_000
"""Stays of a counterexample at most."""
MIN_EXCESS_DEGC = 1e-6
"""degC by which a bound must pass the border to count as outside."""
_FOLLOW_TAUS = (5.0, 10.0, 20.0, 40.0)
"""Time constants for which a relaxing flow is followed; after the last a float cannot tell it from its target."""
_FOLLOW_S = (1e4, 1e6, 1e8)
"""Seconds for which a drift outwards is followed; the shortest that does is taken."""
_PACE_STAYS = 200
"""Stays after which it is asked whether, at the pace of as many stays before, the rest can be enough."""
_FOREVER_S = 1e12
_EXTENSIONS_S = (0.0, 600.0, 3600.0, 6.0 * 3600.0, DAY_S, 7.0 * DAY_S)
"""Seconds by which the last stay is made longer where effects act: lags and housings are slower than the bounds."""


def escape(side: Side, start: float, border: float) -> TimedWord | None:
    """A word whose temperature passes `border` (both with the side's sign); None if none is found in MAX_STAYS.

    To be asked only where the bounds pass the border by more than MIN_EXCESS_DEGC.
    """
    for longest in _FOLLOW_S:
        path = _shortest_escape(_finite(side, _FOLLOW_TAUS[-1], longest), start, border + 0.5 * MIN_EXCESS_DEGC)
        if path:
            words = (
                _word_along_path(side, _finite(side, patience, longest), path, start, border)
                for patience in _FOLLOW_TAUS
            )
            return next((word for word in words if word is not None), None)
    return None


def variants(model: Model, graph: Graph, word: TimedWord, horizon: float) -> Iterator[TimedWord]:
    """The word itself and, where effects act, with a longer last stay and at the times at which wear and sensor are
    said to be worst; a wear is followed for `horizon` seconds.
    """
    sha = model.sha
    if not sha.effects:
        yield word
        return
    marks, worn = offset_times(sha), growth_starts(sha)
    # Path and places are one to one, so the last stay's own limit is that of where the word's moves lead.
    most = max((room.sojourn[1] for room in graph.envelopes), default=inf)
    for more in _EXTENSIONS_S if isinf(most) else _EXTENSIONS_S[:1]:
        end = word.end + more
        clocks = [0.0, *(mark for at in marks for mark in (at - 0.5 * end, at)), *(at + horizon - end for at in worn)]
        for clock in dict.fromkeys(clocks):
            first = replace(word.steps[0], clock=clock) if marks or worn else word.steps[0]
            yield TimedWord((first, *word.steps[1:]), end)


def _shortest_escape(side: Side, start: float, border: float) -> list[tuple[int, str]]:
    """The (location, symbol that leads there) of each stay on the way with the fewest; empty when none is found."""
    graph = side.graph
    entry, leaving = np.full((2, side.target.size), -inf)
    entry[graph.initial] = start
    ways: list[NDArray[np.int32]] = []
    changed, highest = [graph.initial], -inf
    for number in range(MAX_STAYS):
        peaks = {place: side.peak(place, float(entry[place])) for place in changed}
        best = max(peaks, key=lambda place: peaks[place])
        if peaks[best] > border:
            # Back along the moves by which each round improved a location; a location that a round left alone (-1) was
            # as good one event earlier.
            place, stays = best, list[tuple[int, str]]()
            for rows in reversed(ways):
                move = int(rows[place])
                if move >= 0:
                    stays.append((place, graph.symbol[move]))
                    place = int(graph.source[move])
            return [(place, ""), *reversed(stays)]
        # Where the pace of the last stays does not lead to the border, the rest would be followed for nothing.
        if number % _PACE_STAYS == _PACE_STAYS - 1:
            if (peaks[best] - highest) * (MAX_STAYS - number) / _PACE_STAYS < border - peaks[best]:
                return []
            highest = peaks[best]
        for place in changed:
            leaving[place] = side.leave(place, float(entry[place]))
        offered, row = best_moves(graph, leaving)
        offered = np.where((offered > -inf) & ~np.isnan(side.fresh), side.fresh, offered)
        better = offered > entry
        if not better.any():
            return []
        entry = np.where(better, offered, entry)
        ways.append(np.where(better, row, -1).astype(np.int32))
        changed = np.flatnonzero(better).tolist()
    return []


def _finite(side: Side, patience: float, longest: float) -> Side:
    """The side with endless stays cut off: what relaxes is followed until it has settled, what drifts for `longest`."""
    rate, rooms = side.graph.rate, list[Envelope]()
    for room in side.graph.envelopes:
        least, most = room.sojourn
        if not isinf(most):
            rooms.append(room)
            continue
        end = longest
        if room.forcing is not None:
            # Under effects the drift has several pieces; the slowest one that leads to a rest says how long it takes.
            drifts = [drift for up in (True, False) if (drift := room.drift(up))]
            rates = [drift.find_piece(edge)[1] for drift in drifts for edge in drift.rest if not isinf(edge)]
            slowest = min((each for each in rates if each > 0), default=0.0)
            end = ceil(patience / slowest) if slowest else longest
        elif room.flow.kind in RELAXING_FLOWS:
            ramp = 0.0 if isinf(rate) else 1e3 / rate  # under a limited rate the first 1000 degC are run through evenly
            end = ceil(patience / room.flow.params["k"] + ramp)
        rooms.append(replace(room, sojourn=(least, max(least, end))))
    return replace(side, graph=replace(side.graph, envelopes=tuple(rooms)))


def _word_along_path(
    side: Side, finite: Side, path: list[tuple[int, str]], start: float, border: float
) -> TimedWord | None:
    """The word along a path, each stay as long as drives it farther; None where that does not lead out."""
    x, time, steps = start, 0.0, list[WordStep]()
    for number, (place, symbol) in enumerate(path):
        fresh = float(side.fresh[place])
        drawn = number > 0 and fresh == fresh  # a NaN, where X goes on, differs from itself
        x = fresh if drawn else x
        room = side.graph.envelopes[place]
        m, inputs = room.corner(side.sign > 0)
        temperature = side.sign * x if drawn or not number else None
        steps.append(WordStep(time, symbol, None if room.flow.kind == "constant" else m, temperature, inputs))
        if number < len(path) - 1:
            least, most = finite.graph.envelopes[place].sojourn
            dt = max((least, most), key=lambda dt: finite.advance(place, x, dt))
            x, time = finite.advance(place, x, dt), time + dt
    last = _crossing_time(side, path[-1][0], x, border)
    return None if last is None else TimedWord(tuple(steps), time + last)


def _crossing_time(side: Side, place: int, x: float, border: float) -> float | None:
    """Seconds after which a stay is outside: half-way to its peak, at most 1 degC, beyond the border; None if never."""
    peak = side.peak(place, x)
    if not peak > border + 0.25 * MIN_EXCESS_DEGC:
        return None
    wanted = border + min(1.0, 0.5 * (peak - border))
    if x >= wanted:
        return 0.0
    most = side.graph.envelopes[place].sojourn[1]
    high = 1.0
    while side.advance(place, x, min(high, most)) < wanted:
        high *= 2.0
        if high > _FOREVER_S:
            return None
    # Doubled until it is outside, then halved: the side's course is monotone, so the crossing is bracketed.
    low, high = 0.0, min(high, most)
    for _ in range(60):  # more than the bits of a float's mantissa
        middle = 0.5 * (low + high)
        low, high = (low, middle) if side.advance(place, x, middle) >= wanted else (middle, high)
    # A tenth of a second reads better in a word, and later is still outside: the side's course is monotone.
    rounded = ceil(10.0 * high) / 10.0
    return rounded if rounded <= most else high

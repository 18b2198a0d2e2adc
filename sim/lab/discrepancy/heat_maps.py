"""Where the unexplained heat lies: its mean by location and by the time since the last start or stop."""

import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.lab.discrepancy.diagnosis import DiagnosisCourse
from sim.sha import Array, Mask

PHASE_EDGES_S = (0.0, 60.0, 120.0, 300.0, 600.0, 1200.0, 2400.0, 4800.0, 9600.0, 19200.0)
"""Seconds since the last start or stop at which columns begin; the last one has no end."""
MAX_PHASE_S = 30 * 86_400.0
"""Seconds beyond which the last start or stop counts as not seen."""
MIN_CYCLES_SOLID = 3
"""Cycles below which a mean is shown but not relied on."""
MAX_ROWS = 24
"""Locations at most: those with the most windows."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HeatMap:
    """Mean heat (degC/h) that a model leaves, by r `locations` and c spans of time since the last start or stop.

    `edges` (c + 1,) are seconds, the last inf. `before` and `after` are (r, c), NaN where nothing was seen; `after` is
    None where there is no model after. `cycles` (r, c) counts those that a mean is taken over; `left_out` are locations
    beyond MAX_ROWS.
    """

    locations: tuple[str, ...]
    edges: tuple[float, ...]
    before: Array
    after: Array | None
    cycles: NDArray[np.intp]
    left_out: int

    @property
    def columns(self) -> tuple[str, ...]:
        """The spans in words, such as "2-5 min"."""
        return tuple(span(low, high) for low, high in zip(self.edges[:-1], self.edges[1:], strict=True))

    @property
    def largest(self) -> float:
        """The largest mean of the map before without its sign, degC/h, where cycles are not few; 0 without any."""
        for values in (np.where(self.few, np.nan, self.before), self.before):
            if np.isfinite(values).any():
                return float(np.nanmax(np.abs(values)))
        return 0.0

    @property
    def few(self) -> Mask:
        """(r, c) True where a mean is taken over fewer than MIN_CYCLES_SOLID cycles, so that it says little."""
        return np.asarray(self.cycles < MIN_CYCLES_SOLID)


def heat_map(course: DiagnosisCourse) -> HeatMap | None:
    """The map of a course; None where no window has a heat and a start or stop before it."""
    since = np.asarray(course.since_event, dtype=float)
    known = np.isfinite(course.heat_before) & np.isfinite(since) & (since >= 0) & (since <= MAX_PHASE_S)
    if not known.any():
        return None
    names, place = np.unique(np.array(course.location)[known], return_inverse=True)
    counts = np.bincount(place, minlength=names.size)
    kept = np.argsort(-counts, kind="stable")[:MAX_ROWS]
    order = sorted(kept.tolist(), key=lambda number: natural(str(names[number])))
    column = np.searchsorted(PHASE_EDGES_S, since[known], side="right") - 1
    shape = (names.size, len(PHASE_EDGES_S))
    # Cycles, not windows, are what a mean rests on: each counts once in a cell, however many windows it has there.
    seen = np.unique(np.column_stack([place, column, course.cycle[known].astype(np.intp)]), axis=0)
    cycles = np.zeros(shape, dtype=np.intp)
    np.add.at(cycles, (seen[:, 0], seen[:, 1]), 1)
    used = np.flatnonzero(cycles[order].any(axis=0))
    spans = slice(0, int(used[-1]) + 1)
    before = _means(course.heat_before[known], place, column, shape)[order, spans]
    after = None
    if np.isfinite(course.heat_after).any():
        after = _means(course.heat_after[known], place, column, shape)[order, spans]
    edges = (*PHASE_EDGES_S, np.inf)[: int(used[-1]) + 2]
    locations = tuple(str(names[number]) for number in order)
    return HeatMap(
        locations=locations,
        edges=edges,
        before=before,
        after=after,
        cycles=cycles[order, spans],
        left_out=names.size - len(locations),
    )


def _means(values: Array, place: NDArray[np.intp], column: NDArray[np.intp], shape: tuple[int, int]) -> Array:
    known = np.isfinite(values)
    sums, counts = np.zeros(shape), np.zeros(shape)
    np.add.at(sums, (place[known], column[known]), values[known])
    np.add.at(counts, (place[known], column[known]), 1.0)
    return np.asarray(np.divide(sums, counts, out=np.full(shape, np.nan), where=counts > 0))


def natural(name: str) -> list[tuple[int, str]]:
    """A key that sorts digits as numbers."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"([0-9]+)", name)]


def span(low: float, high: float) -> str:
    """A span of seconds in words: "0-60 s", "2-5 min", "over 160 min", "any time"."""
    if low <= 0.0 and not np.isfinite(high):
        return "any time"
    unit, size = ("s", 1.0) if max(low, high if np.isfinite(high) else low) <= 120.0 else ("min", 60.0)
    if not np.isfinite(high):
        return f"over {low / size:g} {unit}"
    return f"{low / size:g}–{high / size:g} {unit}"

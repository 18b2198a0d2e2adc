"""Which signals follow the temperature: they are its consequences, and neither a law nor an advice may rest on them.

What heats or cools comes first and the temperature answers with a lag; what follows answers to the temperature, with a
lag or at once. So the signal's changes are foreseen from the temperature through one first-order lag of positive gain,
the form of an exchange of heat: once from its past, and once, with both courses run backwards, from its future. Of a
consequence the past tells as much as the future or more, of a cause the future tells more. Both are the same filter on
the same readings, so that noise and smoothing favour neither side; a free regression on the past would invert the lag
and find the cause in it as well. Where a signal is held while the temperature moves, little of it is foreseen.
"""

from collections.abc import Sequence

import numpy as np

from sim.engine import linear_recursion
from sim.lab.discrepancy.rules import DecisionRules
from sim.sha import Array, Trace

BLOCK_S = 120.0
"""Seconds over which readings are averaged."""
CHANGE_BLOCKS = 15
"""Blocks over which a change is taken, half an hour: starts and loads, and of a day's rhythm hardly anything."""
LAGS_S = (0.0, 120.0, 300.0, 600.0, 1200.0, 2400.0, 4800.0)
"""Seconds of the lags by which one is foreseen from the other."""
LEAST_CHANGES, LEAST_VALUES = 100, 8
"""Changes that are needed, and different values: a switch follows nothing by a lag."""


def follows(traces: Sequence[Trace], temperature: str, signal: str, rules: DecisionRules) -> bool:
    """True where a signal lags behind the temperature, or moves with it, and does not lead it."""
    having = [trace for trace in traces if {temperature, signal} <= trace.signals.keys() and trace.times.size]
    values = np.concatenate([np.empty(0), *(trace.signals[signal] for trace in having)])
    if np.unique(values[np.isfinite(values)]).size < LEAST_VALUES:
        return False
    pairs = [(_block_means(trace, temperature), _block_means(trace, signal)) for trace in having]
    past = _foreseen(pairs)
    if past < rules.follows_least_share:
        return False
    return _foreseen([(warm[::-1], own[::-1]) for warm, own in pairs]) - past < rules.follows_most_lead_share


def _block_means(trace: Trace, name: str) -> Array:
    """(b,) the mean reading of each block, NaN where there is none."""
    block = np.floor((trace.times - trace.times[0]) / BLOCK_S).astype(np.intp)
    column = trace.signals[name]
    known = np.isfinite(column)
    counts = np.bincount(block[known], minlength=int(block.max()) + 1)
    sums = np.bincount(block[known], column[known], minlength=counts.size)
    return np.where(counts > 0, sums / np.maximum(counts, 1), np.nan)


def _foreseen(pairs: Sequence[tuple[Array, Array]]) -> float:
    """The share of the variance of the second ones' changes that the first ones foresee through the best lag."""
    best = 0.0
    changes = np.concatenate([np.empty(0), *(_changes(own, 0.0) for _, own in pairs)])
    for lag in LAGS_S:
        from_ = np.concatenate([np.empty(0), *(_changes(warm, lag) for warm, _ in pairs)])
        known = np.isfinite(from_) & np.isfinite(changes)
        if np.count_nonzero(known) < LEAST_CHANGES:
            return 0.0
        cross = float(from_[known] @ changes[known])
        size = float(np.sum(from_[known] ** 2) * np.sum(changes[known] ** 2))
        best = max(best, cross**2 / size if cross > 0 else 0.0)
    return best


def _changes(means: Array, lag: float) -> Array:
    """(b - CHANGE_BLOCKS,) the changes of a column of blocks through a lag (s), NaN where it was not read at either
    end."""
    known = np.isfinite(means)
    if means.size <= CHANGE_BLOCKS or not known.any():
        return np.full(max(means.size - CHANGE_BLOCKS, 0), np.nan)
    held = means[np.maximum.accumulate(np.where(known, np.arange(means.size), int(np.argmax(known))))]
    keep = np.full(held.size, np.exp(-BLOCK_S / lag) if lag > 0 else 0.0)
    keep[0] = 0.0
    course = linear_recursion(keep, (1.0 - keep) * held, 0.0)
    return np.where(
        known[CHANGE_BLOCKS:] & known[:-CHANGE_BLOCKS], course[CHANGE_BLOCKS:] - course[:-CHANGE_BLOCKS], np.nan
    )

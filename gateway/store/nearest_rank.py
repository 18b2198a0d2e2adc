"""Percentiles of a few plain numbers, for those who need no numpy."""

from collections.abc import Sequence
from math import nan


def percentile(values: Sequence[float], share: float) -> float:
    """The value that `share` of the values do not exceed (nearest rank); NaN for none."""
    ordered = sorted(values)
    # Limited to the last one: a share of 1 would lie one beyond it.
    return ordered[min(int(share * len(ordered)), len(ordered) - 1)] if ordered else nan

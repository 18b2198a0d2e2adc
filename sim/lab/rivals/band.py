"""Quantiles of errors that were seen: the bands of the rivals."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sim.sha import Array


def weighted_quantiles(values: Array, weights: Array, levels: Sequence[float]) -> Array:
    """Quantiles (L,) of `values` (n,) with `weights` (n,), interpolated between the middles of their shares.

    With equal weights this is Hazen's definition (type 5 of Hyndman & Fan 1996). NaN when there are no values.
    """
    if values.size == 0:
        return np.full(len(levels), np.nan)
    order = np.argsort(values)
    share = weights[order] / weights.sum()
    return np.asarray(np.interp(levels, np.cumsum(share) - share / 2.0, values[order]))


def equal_shares(machines: NDArray[np.intp]) -> Array:
    """Weights (n,) under which each of the `machines` (n,) numbers counts the same, however many rows it has."""
    _, inverse, counts = np.unique(machines, return_inverse=True, return_counts=True)
    return np.asarray(1.0 / counts[inverse])

"""Statistical rivals that our forecasts are measured against: each gets the past up to the origin, nothing more."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sim.lab.judge.direct_rivals import Direct, arx, boosted_trees
from sim.lab.judge.past import (
    FittedRival,
    Past,
    Rival,
    equal_shares,
    interpolate_temperature,
    readings,
    trained_columns,
    weighted_quantiles,
)
from sim.lab.judge.univariate_rivals import Univariate
from sim.sha import Array

MAX_CHANGES = 1000
"""At most so many changes of a machine are kept for its band, evenly spread over its trace."""
OWN_WEIGHT_HORIZONS = 5.0
"""The machine's own past weighs as much as the training once it holds so many horizons one after the other."""


@dataclass(frozen=True, slots=True)
class Persistence:
    """The last reading, with a symmetric band of the changes over the horizon that were seen.

    The band's changes are those of the training machines, each machine alike, and those of the machine's own past,
    which weigh n / (n + 5) of the whole where n horizons fit into that past one after the other (none below one).
    """

    name: str = "persistence"

    def fit(self, training: Sequence[Past], horizons: Sequence[float]) -> FittedRival:
        """Collects the changes; raises ValueError on no training."""
        if not training:
            raise ValueError("persistence needs at least one training machine for its band")
        changes, weights = [], []
        for horizon in horizons:
            machines = [_changes(*each, horizon) for each in map(readings, training)]
            numbers = np.repeat(np.arange(len(machines)), [len(each) for each in machines])
            changes.append(np.concatenate(machines))
            weights.append(equal_shares(numbers))
        return FittedPersistence(tuple(horizons), tuple(changes), tuple(weights))


@dataclass(frozen=True, slots=True)
class FittedPersistence:
    """Persistence with the training's absolute changes over each horizon and their weights."""

    horizons: tuple[float, ...]
    changes: tuple[Array, ...]
    weights: tuple[Array, ...]

    def forecast(self, past: Past, horizons: Sequence[float], levels: tuple[float, ...]) -> Array:
        """(L, H) quantiles in degC; see `FittedRival`."""
        quantiles = np.full((len(levels), len(horizons)), np.nan)
        at, values = readings(past)
        if at.size == 0:
            return quantiles
        for column, trained in enumerate(trained_columns(self.horizons, horizons)):
            horizon = self.horizons[trained]
            changes, weights = self.changes[trained], self.weights[trained]
            own = _changes(at, values, horizon)
            if own.size:
                n = (at[-1] - at[0]) / horizon
                share = n / (n + OWN_WEIGHT_HORIZONS) if changes.size else 1.0
                total = weights.sum() if changes.size else 1.0
                weights = np.concatenate(((1.0 - share) * weights / total, np.full(own.size, share / own.size)))
                changes = np.concatenate((changes, own))
            # Both signs of each change: with a median of its own this would no longer be persistence.
            both, twice = np.concatenate((-changes, changes)), np.concatenate((weights, weights))
            quantiles[:, column] = values[-1] + weighted_quantiles(both, twice, levels)
        return quantiles


def _changes(at: Array, values: Array, horizon: float) -> Array:
    """Absolute changes over the horizon, at most MAX_CHANGES of them; empty where the past is shorter than the
    horizon."""
    if at.size < 2 or at[-1] - at[0] < horizon:
        return np.empty(0)
    starts = np.linspace(at[0], at[-1] - horizon, MAX_CHANGES)
    changes = np.abs(
        interpolate_temperature(at, values, starts + horizon) - interpolate_temperature(at, values, starts)
    )
    return np.asarray(changes[np.isfinite(changes)])


def rivals(seed: int) -> tuple[Rival, ...]:
    """Every rival, the simplest first; `seed` is for those that draw numbers. Univariate ones need the extra."""
    return (
        Persistence("persistence"),
        Univariate("damped trend", "damped_trend"),
        Univariate("AutoETS", "auto_ets"),
        Univariate("AutoARIMA", "auto_arima"),
        Univariate("AutoTheta", "auto_theta"),
        Direct("ARX, direct", arx, seed),
        Direct("boosted trees", boosted_trees, seed),
    )

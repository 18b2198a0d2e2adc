"""Direct rivals: for each horizon a regression of the change on a feature table, its band by residuals."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import ThreadpoolController

from sim.lab.judge.past import (
    FittedRival,
    Past,
    equal_shares,
    interpolate_temperature,
    readings,
    trained_columns,
    weighted_quantiles,
)
from sim.lab.tree_regressor import one_thread, tree_regressor
from sim.sha import Array, Mask

ORIGIN_STEP_S = 10.0
"""An origin of training each so many seconds, or fewer where a machine would have more than MAX_ORIGINS of them."""
MAX_ORIGINS = 1500
HELD_OUT_BLOCKS = 5
"""A single training machine is held out by so many blocks of its own time."""
PENALTIES = tuple(10.0**power for power in range(7))
MIN_SPREAD_DEGC = 0.02
"""No residual is expected to be smaller than this (degC): readings are not finer."""


@dataclass(frozen=True, slots=True)
class Examples:
    """Origins of the training machines: `features` (n, F), `changes` (n,) degC from the level to after the horizon.

    `times` (n,) s of the origins; `groups` (n,) numbers each row's machine, or the block of time of the only one.
    """

    features: Array
    changes: Array
    times: Array
    groups: NDArray[np.intp]
    one_machine: bool

    def rows(self, rows: Mask) -> "Examples":
        """Those of `rows` (n,)."""
        return Examples(self.features[rows], self.changes[rows], self.times[rows], self.groups[rows], self.one_machine)


class Regression(Protocol):
    """A fitted regression on features (n, F); sklearn's have this form."""

    def predict(self, features: Array, /) -> Array:
        """(n,) what is expected in degC."""
        ...


@dataclass(frozen=True, slots=True)
class LinearRegression:
    """Linear in standardised features; a missing one counts as its mean in the training."""

    centre: Array
    scale: Array
    coefficients: Array
    intercept: float

    def predict(self, features: Array, /) -> Array:
        """(n,) changes in degC."""
        standard = np.nan_to_num((features - self.centre) / self.scale, nan=0.0)
        return np.asarray(standard @ self.coefficients + self.intercept)


@dataclass(frozen=True, slots=True)
class HorizonFit:
    """One horizon: what change is expected, how large its error (None: the same everywhere), and the errors seen.

    `errors` (n,) are of origins whose machine was held out, divided by their expected size; `weights` (n,).
    """

    change: Regression
    spread: Regression | None
    errors: Array
    weights: Array


class DirectMethod(Protocol):
    """How a direct rival learns one horizon from examples."""

    def __call__(self, examples: Examples, horizon: float, seed: int) -> HorizonFit:
        """The fit; a method that draws numbers does so from `seed`."""
        ...


@dataclass(frozen=True, slots=True)
class Direct:
    """A rival that learns each horizon by itself from origins all over the training machines."""

    name: str
    method: DirectMethod
    seed: int

    def fit(self, training: Sequence[Past], horizons: Sequence[float]) -> FittedRival:
        """Learns every horizon; raises ValueError where no training machine has a trace longer than one of them."""
        inputs = tuple(sorted({name for machine in training for name in machine.inputs}))
        tables = []
        for machine in training:
            first, last = float(machine.times[0]), float(machine.times[-1])
            times = np.arange(first, last, max(ORIGIN_STEP_S, (last - first) / MAX_ORIGINS))
            tables.append((machine, times, feature_table(machine, times, inputs)))
        fits = []
        for horizon in horizons:
            machines = []
            for machine, times, features in tables:
                changes = interpolate_temperature(*readings(machine), times + horizon) - features[:, LEVEL_COLUMN]
                known = np.isfinite(changes)
                if known.any():
                    machines.append((features[known], changes[known], times[known]))
            if not machines:
                raise ValueError(
                    f"{self.name}: no training machine has a trace longer than the horizon of {horizon:g} s"
                )
            features, changes, times = (np.concatenate(parts) for parts in zip(*machines, strict=True))
            if len(machines) > 1:
                groups = np.repeat(np.arange(len(machines)), [len(times) for _, _, times in machines])
            else:
                groups = np.arange(times.size) * HELD_OUT_BLOCKS // times.size
            examples = Examples(features, changes, times, groups, one_machine=len(machines) == 1)
            with one_thread():
                fits.append(self.method(examples, horizon, self.seed))
        return FittedDirect(tuple(horizons), inputs, tuple(fits), ThreadpoolController())


@dataclass(frozen=True, slots=True)
class FittedDirect:
    """A fit for each horizon, on features of these inputs."""

    horizons: tuple[float, ...]
    inputs: tuple[str, ...]
    fits: tuple[HorizonFit, ...]
    threads: ThreadpoolController

    def forecast(self, past: Past, horizons: Sequence[float], levels: tuple[float, ...]) -> Array:
        """(L, H) quantiles in degC; see `FittedRival`."""
        origin = past.times[-1:]
        first = int(np.searchsorted(past.times, origin[0] - MEMORY_S))
        features = feature_table(past.rows(slice(first, None)), origin, self.inputs)
        level = features[0, LEVEL_COLUMN]
        quantiles = np.full((len(levels), len(horizons)), np.nan)
        if not np.isfinite(level):
            return quantiles
        with self.threads.limit(limits=1):
            for column, trained in enumerate(trained_columns(self.horizons, horizons)):
                fit = self.fits[trained]
                spread = 1.0 if fit.spread is None else max(float(fit.spread.predict(features)[0]), MIN_SPREAD_DEGC)
                errors = weighted_quantiles(fit.errors, fit.weights, levels)
                quantiles[:, column] = level + fit.change.predict(features)[0] + spread * errors
        return quantiles


def arx(examples: Examples, horizon: float, seed: int) -> HorizonFit:
    """Ridge regression (Hoerl & Kennard 1970) with the penalty of the smallest absolute errors on held-out groups."""
    weights = equal_shares(examples.groups)
    candidates = []
    for penalty in PENALTIES:
        errors = np.empty(examples.times.size)
        for held, others in _leave_groups(examples, horizon):
            errors[held] = examples.changes[held] - _ridge(others, penalty).predict(examples.features[held])
        candidates.append((float(np.average(np.abs(errors), weights=weights)), penalty, errors))
    _, penalty, errors = min(candidates, key=lambda candidate: candidate[:2])
    return HorizonFit(_ridge(examples, penalty), None, errors, weights)


def _ridge(examples: Examples, penalty: float) -> LinearRegression:
    from sklearn.linear_model import Ridge
    from sklearn.preprocessing import StandardScaler

    scaler = StandardScaler().fit(examples.features)
    standard = np.nan_to_num(scaler.transform(examples.features), nan=0.0)
    weights = equal_shares(examples.groups)
    ridge = Ridge(penalty).fit(standard, examples.changes, sample_weight=weights * weights.size / weights.sum())
    return LinearRegression(scaler.mean_, scaler.scale_, ridge.coef_, float(ridge.intercept_))


def boosted_trees(examples: Examples, horizon: float, seed: int) -> HorizonFit:
    """Boosted trees for the change, and others for how large their error is on held-out groups.

    The band is the conformal one of normalised residuals (Lei et al. 2018, section 5.2), held out by group.
    """
    weights = equal_shares(examples.groups)
    errors = np.empty(examples.times.size)
    for held, others in _leave_groups(examples, horizon):
        errors[held] = examples.changes[held] - _trees(others, others.changes, seed).predict(examples.features[held])
    spread = _trees(examples, np.abs(errors), seed)
    expected = np.maximum(spread.predict(examples.features), MIN_SPREAD_DEGC)
    return HorizonFit(_trees(examples, examples.changes, seed), spread, errors / expected, weights)


def _trees(examples: Examples, outcomes: Array, seed: int) -> Regression:
    weights = equal_shares(examples.groups)
    trees: Regression = tree_regressor(
        learning_rate=0.1,
        max_iter=60,
        max_leaf_nodes=15,
        min_samples_leaf=30,
        l2_regularization=1.0,
        early_stopping=False,
        random_state=seed,
    ).fit(examples.features, outcomes, sample_weight=weights * weights.size / weights.sum())
    return trees


def _leave_groups(examples: Examples, horizon: float) -> Iterator[tuple[Mask, Examples]]:
    """Each group's rows (n,), and the examples of the other groups whose outcomes do not overlap with its own."""
    for group in np.unique(examples.groups):
        held = examples.groups == group
        times = examples.times[held]
        # Blocks of one machine are on one clock: what stands beside a block knows its outcome.
        beside = (examples.times > times[0] - horizon) & (examples.times < times[-1] + horizon)
        others = ~held & ~(beside & examples.one_machine)
        if not others.any():
            raise ValueError(
                f"the only training machine is too short for a horizon of {horizon:g} s: nothing can be held out"
            )
        yield held, examples.rows(others)


LEVEL_WINDOW_S = 5.0
"""The level is the mean over so many seconds: where readings are many, single ones are noisy."""
LAGS_S = (10.0, 30.0, 60.0, 300.0, 900.0)
WINDOWS_S = (10.0, 60.0, 300.0)
MEMORY_S = 1000.0
"""Rows older than this (s) are not needed at an origin: the longest lag, its level, and room for a missing reading."""
LEVEL_COLUMN = 0


def feature_table(past: Past, origins: Array, inputs: Sequence[str]) -> Array:
    """Features (n, 8 + 3 len(inputs)) at `origins` (n,) s, each from the rows up to its origin.

    Level (degC), last reading less level, change of the level over each of LAGS_S (back to the oldest reading where the
    past is shorter), how far the past reaches back (s, at most the longest lag), then for each input, in the order
    given, its mean over each of WINDOWS_S. Where a window has no reading the last one before it holds; NaN where there
    is none.
    """
    temperature = RunningMeans.of_column(past.times, past.temperature)
    oldest = temperature.times[0] if temperature.times.size else np.nan
    level = temperature.before(origins, LEVEL_WINDOW_S)
    columns = [level, temperature.before(origins, 0.0) - level]
    columns += [level - temperature.before(np.maximum(origins - lag, oldest), LEVEL_WINDOW_S) for lag in LAGS_S]
    columns.append(np.clip(origins - oldest, 0.0, LAGS_S[-1]))
    for name in inputs:
        if name in past.inputs:
            means = RunningMeans.of_column(past.times, past.inputs[name])
            columns += [means.before(origins, window) for window in WINDOWS_S]
        else:
            columns += [np.full(origins.shape, np.nan)] * len(WINDOWS_S)
    return np.stack(columns, axis=1)


@dataclass(frozen=True, slots=True)
class RunningMeans:
    """Readings (m,) at `times` (m,) with their running `sums` (m + 1,)."""

    times: Array
    values: Array
    sums: Array

    @staticmethod
    def of_column(times: Array, values: Array) -> "RunningMeans":
        """Of a column with NaN where nothing was read."""
        known = np.isfinite(values)
        return RunningMeans(times[known], values[known], np.concatenate(([0.0], np.cumsum(values[known]))))

    def before(self, moments: Array, width: float) -> Array:
        """(n,) the mean over the `width` seconds up to each moment, else the last reading before it, else NaN."""
        if self.values.size == 0:
            return np.full(moments.shape, np.nan)
        last = np.searchsorted(self.times, moments, side="right")
        # The last reading belongs to every window, however narrow: so a window without a reading holds it.
        first = np.minimum(np.searchsorted(self.times, moments - width, side="right"), np.maximum(last - 1, 0))
        mean = (self.sums[last] - self.sums[first]) / np.maximum(last - first, 1)
        return np.asarray(np.where(last > 0, mean, np.nan))

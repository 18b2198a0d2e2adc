"""What a forecaster may know at its origin, the last reading held, and quantiles of errors that were seen."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from sim.forecast import DENSE_LEVELS
from sim.sha import Array

MAX_GAP_S = 30.0
"""Between readings further apart (s) than this, and than five usual intervals, nothing is interpolated."""


@dataclass(frozen=True, slots=True)
class Past:
    """What a forecaster may know at its origin, the last of `times`.

    `times` (n,) s, ascending, on no particular grid; `temperature` (n,) degC as read; `inputs` (n,) each: other signals
    known up to the origin. NaN where nothing was read. As training, a machine's whole trace. Raises ValueError on no
    rows, on shapes that do not match and on times that go back.
    """

    times: Array
    temperature: Array
    inputs: Mapping[str, Array]

    def __post_init__(self) -> None:
        rows = self.times.shape
        if len(rows) != 1 or rows[0] == 0:
            raise ValueError("the past of a forecast has no rows; at least the row of its origin is needed")
        for name, column in (("temperature", self.temperature), *self.inputs.items()):
            if column.shape != rows:
                raise ValueError(f"the past of a forecast: {name!r} has shape {column.shape}, its clock {rows}")
        if np.any(np.diff(self.times) < 0):
            raise ValueError("the past of a forecast: the clock goes back; its times must ascend")

    def truncate(self, time: float) -> "Past":
        """What was known at `time`: the rows up to and including it."""
        return self.rows(slice(0, int(np.searchsorted(self.times, time, side="right"))))

    def select_inputs(self, names: Sequence[str]) -> "Past":
        """With these inputs alone; one that was never read is NaN."""
        unknown = np.full(self.times.shape, np.nan)
        return Past(self.times, self.temperature, {name: self.inputs.get(name, unknown) for name in names})

    def rows(self, rows: slice) -> "Past":
        """These rows only; views, nothing is copied."""
        return Past(self.times[rows], self.temperature[rows], {name: each[rows] for name, each in self.inputs.items()})


class FittedRival(Protocol):
    """A rival after its training."""

    def forecast(self, past: Past, horizons: Sequence[float], levels: tuple[float, ...]) -> Array:
        """(L, H) quantiles in degC of the temperature `horizons` (s) after the past's last row.

        NaN where the past has no reading. Raises ValueError for a horizon that was not trained.
        """
        ...


class Rival(Protocol):
    """A way of forecasting that ours is measured against."""

    @property
    def name(self) -> str:
        """As tables call it."""
        ...

    def fit(self, training: Sequence[Past], horizons: Sequence[float]) -> FittedRival:
        """Trained on the whole traces of other machines for these horizons (s); raises ValueError on no training."""
        ...


def readings(past: Past) -> tuple[Array, Array]:
    """Times (m,) and temperatures (m,) of the rows that have a reading."""
    known = np.isfinite(past.temperature)
    return past.times[known], past.temperature[known]


def interpolate_temperature(at: Array, values: Array, times: Array) -> Array:
    """The temperature at `times` (n,), linear between readings (m,); NaN outside them and across gaps (see
    `MAX_GAP_S`)."""
    if at.size < 2:
        return np.full(times.shape, np.nan)
    after = np.clip(np.searchsorted(at, times), 1, at.size - 1)
    widest = max(MAX_GAP_S, 5.0 * float(np.median(np.diff(at))))
    known = (times >= at[0]) & (times <= at[-1]) & (at[after] - at[after - 1] <= widest)
    return np.where(known, np.interp(times, at, values), np.nan)


def trained_columns(trained: Sequence[float], horizons: Sequence[float]) -> list[int]:
    """Where each of `horizons` stands among the `train_rival` ones; raises ValueError for one that is not there."""
    missing = sorted(set(horizons) - set(trained))
    if missing:
        raise ValueError(f"a rival trained for horizons {sorted(trained)} s was asked for {missing} s")
    return [list(trained).index(horizon) for horizon in horizons]


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


def persistence(times: Array, temperature: Array, horizons: Sequence[float], levels: tuple[float, ...]) -> Array | None:
    """(L, H) quantiles in degC: the last of the readings `temperature` (n,) at `times` (n,); None without a reading.

    The band is symmetric: the quantiles of the absolute changes over the horizon so far. A past shorter than twice the
    horizon gives the changes over half of its length, times the root of the ratio, as of a random walk; a single
    reading gives no band at all.
    """
    known = np.isfinite(temperature)
    at, values = times[known], temperature[known]
    if not at.size:
        return None
    signs, shares = np.sign(np.array(levels) - 0.5), np.abs(2.0 * np.array(levels) - 1.0)
    fan = np.full((len(levels), len(horizons)), values[-1])
    for column, horizon in enumerate(horizons):
        lag = min(horizon, (at[-1] - at[0]) / 2.0)
        if lag > 0:
            starts = at <= at[-1] - lag
            changes = np.abs(np.interp(at[starts] + lag, at, values) - values[starts])
            fan[:, column] += signs * np.quantile(changes, shares) * np.sqrt(horizon / lag)
    return fan


PastForecaster = Callable[[Past], Array | None]
"""A method that is asked at an origin: (L, H) quantiles in degC at the levels DENSE_LEVELS; None where it says
nothing."""


def persist(past: Past, horizons: tuple[float, ...]) -> Array | None:
    """Persistence for these horizons (s)."""
    return persistence(past.times, past.temperature, horizons, DENSE_LEVELS)


def train_rival(rival: Rival, training: Sequence[Past], horizons: tuple[float, ...]) -> PastForecaster:
    """A rival fitted to whole traces by the inputs that all of them have. Raises ValueError as its `fit` does."""
    names = sorted(set.intersection(*(set(past.inputs) for past in training)))
    fitted = rival.fit([past.select_inputs(names) for past in training], horizons)
    return lambda past: np.asarray(fitted.forecast(past.select_inputs(names), horizons, DENSE_LEVELS))

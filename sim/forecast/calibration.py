"""Keeping a forecast's band honest while it runs: a factor for each horizon, learned from forecasts that have matured.

A matured forecast tells how far the reading came out, in units of the band: z = 1.645 |reading - median| / (edge of
the 90 % band on that side - median), taken before any widening. The band that covers 90 % is the one widened by
quantile_90(z) / 1.645. That quantile is taken from a histogram of z that forgets, so a state is small whatever its age.

Under a shift of regime a histogram lags behind. So the factor has an integral part beside it (adaptive conformal
inference as control of the quantile: Gibbs & Candes 2021; Angelopoulos, Candes & Tibshirani 2023): each published band
that missed widens the next ones, each that held narrows them, in the ratio at which nine in ten hold in the long run,
whatever the data do.

Forecasts made every second for 15 minutes ahead overlap and err together: the evidence counted is the time that they
span over their horizon, not their number. It is weighed against the model's own factor, on the scale of logarithms.
By what the next shorter horizon's factor has left the model's own, a longer one begins: how rough a day is shows at a
minute long before it can at fifteen. A rough minute foretells a rough quarter of an hour better than a calm one a calm
one (a day may drift that trembles little), so that only part of what narrows is passed on.

A second, slower histogram, of z over the factor that was published, tells the fan's shape inside and outside of that
band: a temperature that mostly stands still and sometimes leaps has a law of a high peak and long tails, which no
factor makes out of a Gaussian one.
"""

from bisect import bisect_left, bisect_right
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import cache
from math import erf, exp, inf, isfinite, log, nan, sqrt
from statistics import NormalDist
from typing import Any

import numpy as np

from sim.forecast.fan import FAN_LEVELS, Forecast
from sim.sha import Array

MISS_SHARE = 0.1
"""The share of outcomes that a 90 % band leaves out."""
WIDENING_GAIN = 0.15
"""By how much a missed band widens the next ones, on the scale of logarithms, for each independent forecast."""
MAX_LOG_SHIFT = 1.5
"""Bound of the integral part, on the scale of logarithms: a factor of 4.5."""
NARROWING_LENT = 0.5
"""The part of a shorter horizon's narrowing, on the scale of logarithms, with which a longer one begins."""
SHAPE_MEMORY = 60.0
"""Independent forecasts after which what the fan's shape was learned from has faded to 1/e."""
GAUSSIAN_FORECASTS = 10.0
"""Independent forecasts that the model's own shape counts for."""
LEAST_FACTOR, MOST_FACTOR = 0.2, 10.0
"""Bounds of a factor: beyond them the model is wrong, and no widening makes it right."""

Z90 = 1.6448536269514722
"""Half the width of a 90 % band in standard deviations."""
_HISTOGRAM_EDGES = np.geomspace(0.01, 100.0, 65)
_BIN_COUNT = len(_HISTOGRAM_EDGES) + 1
_GAUSSIAN_COUNTS = GAUSSIAN_FORECASTS * np.diff(
    [0.0, *(erf(edge / sqrt(2.0)) for edge in _HISTOGRAM_EDGES.tolist()), 1.0]
)
"""The histogram of a Gaussian's z."""
_STILL_Z, _FAR_Z = 5e-4, 115.0
"""The ends of the outermost bins."""
_LOG_FENCES = np.log([_STILL_Z, *_HISTOGRAM_EDGES, _FAR_Z])


@dataclass(frozen=True, slots=True)
class PendingForecast:
    """A forecast for one horizon that waits for its reading at `due`; the band's edges (degC) are not widened.

    `factor` is the one by which they were when it was published.
    """

    due: float
    low: float
    median: float
    high: float
    factor: float = 1.0


_PENDING_FIELDS = tuple(field.name for field in fields(PendingForecast))


@dataclass(frozen=True, slots=True)
class Horizon:
    """What one horizon has learned: forgetting counts of z by bins, the independent forecasts that they are worth.

    `prior` is the model's own factor, `last` the due time of the newest matured forecast (-inf before any), `missed`
    counts the forecasts whose reading never came, `due_forecasts` the others. `shift` is the integral part of the
    factor (its logarithm), `held` the fading evidence of published bands that held, out of `worth`. `shape` are slowly
    forgetting counts of z over the published factor; none before any matured.
    """

    prior: float
    counts: tuple[float, ...] = (0.0,) * _BIN_COUNT
    worth: float = 0.0
    last: float = -inf
    pending: tuple[PendingForecast, ...] = ()
    matured: int = 0
    missed: int = 0
    shift: float = 0.0
    held: float = 0.0
    shape: tuple[float, ...] = ()

    def plain(self) -> dict[str, Any]:
        """The state as JSON can carry it; `asdict` would copy each number of each waiting forecast by itself."""
        pending = [{key: getattr(waiting, key) for key in _PENDING_FIELDS} for waiting in self.pending]
        return {field.name: getattr(self, field.name) for field in fields(self)} | {"pending": pending}


@dataclass(frozen=True, slots=True)
class Calibration:
    """The state for all horizons (s), and how it learns.

    `memory` is the number of independent forecasts after which evidence has faded to 1/e, `weight` the number that the
    model's own factor counts for; a reading settles a forecast when it comes at most `tolerance` seconds after `due`.
    """

    horizons: Mapping[float, Horizon]
    memory: float = 60.0
    weight: float = 4.0
    tolerance: float = 5.0


def calibrate(
    horizons: Mapping[float, float], memory: float = 60.0, weight: float = 4.0, tolerance: float = 5.0
) -> Calibration:
    """A fresh state for `horizons` (s -> the model's own factor, 1.0 where it has none).

    Raises ValueError on factors, memory or tolerance that are not positive, and on a negative weight.
    """
    if not all(isfinite(factor) and factor > 0 for factor in horizons.values()) or not memory > 0 or not tolerance > 0:
        raise ValueError(f"factors, memory and tolerance must be positive: {dict(horizons)}, {memory}, {tolerance}")
    if not weight >= 0:
        raise ValueError(f"the weight of the model's own factor must be at least 0, got {weight}")
    return Calibration({h: Horizon(_clip_factor(f)) for h, f in sorted(horizons.items())}, memory, weight, tolerance)


def _clip_factor(factor: float) -> float:
    return min(max(factor, LEAST_FACTOR), MOST_FACTOR)


def issue(state: Calibration, forecast: Forecast) -> Calibration:
    """The state with `forecast` waiting to mature, at those of its horizons that are being calibrated.

    Forecasts come in the order of their times; what is overdue by then is dropped, so what waits is bounded.
    """
    state = settle(state, forecast.time, nan)
    low, median, high = (forecast.quantiles[FAN_LEVELS.index(level)] for level in (0.05, 0.5, 0.95))
    horizons = dict(state.horizons)
    for column, horizon in enumerate(forecast.horizons.tolist()):
        if horizon in horizons:
            middle, factor = float(median[column]), float(forecast.factors[column])
            down, up = (middle - float(low[column])) / factor, (float(high[column]) - middle) / factor
            waiting = PendingForecast(forecast.time + horizon, middle - down, middle, middle + up, factor)
            horizons[horizon] = replace(horizons[horizon], pending=(*horizons[horizon].pending, waiting))
    return replace(state, horizons=horizons)


def settle(state: Calibration, time: float, temperature: float) -> Calibration:
    """The state after the reading `temperature` (degC) at `time`: what is due is scored, what is overdue is dropped.

    A reading that is no number settles nothing, but time passes all the same.
    """
    if not any(horizon.pending and horizon.pending[0].due <= time for horizon in state.horizons.values()):
        return state
    horizons = dict(state.horizons)
    for ahead, horizon in state.horizons.items():
        # Forecasts wait in the order of their due times, so only the head of the queue is looked at.
        if not horizon.pending or horizon.pending[0].due > time:
            continue
        overdue = bisect_left(horizon.pending, time - state.tolerance, key=_due)
        reached = bisect_right(horizon.pending, time, key=_due)
        taken = reached if isfinite(temperature) else overdue
        counts, worth, last, shift, held = horizon.counts, horizon.worth, horizon.last, horizon.shift, horizon.held
        shape = horizon.shape or (0.0,) * _BIN_COUNT
        for waiting in horizon.pending[overdue:taken]:
            # Overlapping forecasts err together: each is worth the part of its horizon by which it is newer than the
            # one before. Evidence fades by that worth, not by the clock.
            gained = min(max(waiting.due - last, 0.0) / ahead, 1.0)
            fade = exp(-gained / state.memory)
            faded = [count * fade for count in counts]
            z = deviation(waiting, temperature)
            faded[int(np.searchsorted(_HISTOGRAM_EDGES, z))] += gained
            inside = z <= Z90 * waiting.factor
            fade_shape = exp(-gained / SHAPE_MEMORY)
            slow = [count * fade_shape for count in shape]
            slow[int(np.searchsorted(_HISTOGRAM_EDGES, z / waiting.factor))] += gained
            shape = tuple(slow)
            shift += WIDENING_GAIN * gained * ((0.0 if inside else 1.0) - MISS_SHARE)
            shift, held = min(max(shift, -MAX_LOG_SHIFT), MAX_LOG_SHIFT), held * fade + gained * inside
            counts, worth, last = tuple(faded), worth * fade + gained, max(last, waiting.due)
        horizons[ahead] = replace(
            horizon,
            counts=counts,
            worth=worth,
            last=last,
            pending=horizon.pending[taken:],
            matured=horizon.matured + taken - overdue,
            missed=horizon.missed + overdue,
            shift=shift,
            held=held,
            shape=shape,
        )
    return replace(state, horizons=horizons)


def _due(waiting: PendingForecast) -> float:
    return waiting.due


def due_forecasts(horizon: Horizon, time: float, tolerance: float) -> tuple[PendingForecast, ...]:
    """The forecasts that a reading at `time` settles: due by now, and not longer ago than `tolerance` seconds."""
    if not horizon.pending or horizon.pending[0].due > time:
        return ()
    first = bisect_left(horizon.pending, time - tolerance, key=_due)
    last = bisect_right(horizon.pending, time, key=_due)
    return horizon.pending[first:last]


def deviation(matured: PendingForecast, temperature: float) -> float:
    """|reading - median| in standard deviations of the band on that side, before any widening."""
    error = temperature - matured.median
    side = matured.high - matured.median if error >= 0 else matured.median - matured.low
    if side > 0:
        return Z90 * abs(error) / side
    return 0.0 if error == 0 else inf


def factor(state: Calibration, horizon: float, *, integral: bool = True) -> float:
    """The factor for one of the state's horizons (s), between 0.2 and 10; without its `integral` part if so wished."""
    return factors(state, integral=integral)[horizon]


def recent_coverage(state: Calibration, horizon: float) -> float | None:
    """The share of recent published bands of a horizon (s) that held their reading, fading; None before any matured."""
    learned = state.horizons[horizon]
    return learned.held / learned.worth if learned.worth > 0 else None


def factors(state: Calibration, *, integral: bool = True) -> dict[float, float]:
    """The factor of each horizon (s): what `forecast(..., calibration=...)` takes.

    Of a member of an ensemble without its `integral` part: that answers to what was published, which is the mixture.
    """
    made, lent = {}, 0.0
    for horizon, learned in state.horizons.items():
        # Weighed on the scale of logarithms: twice too wide and twice too narrow are equally wrong.
        level = log(learned.prior) + (lent if lent > 0 else NARROWING_LENT * lent)
        if learned.worth > 0:
            share = learned.worth / (learned.worth + state.weight)
            level = share * log(_clip_factor(_quantile(learned) / Z90)) + (1.0 - share) * level
        lent = level - log(learned.prior)
        made[horizon] = _clip_factor(exp(level + (learned.shift if integral and learned.worth > 0 else 0.0)))
    return made


def reshape(forecast: Forecast, state: Calibration) -> Forecast:
    """The forecast with its quantiles moved to where the outcomes of former ones lay, about median and 90 % band.

    Those two stay, as what is said of the limit does. So do horizons of which nothing has matured.
    """
    shares, gaussian = _gaussian_quantiles(forecast.levels)
    low, median, high = (forecast.levels.index(level) for level in (0.05, 0.5, 0.95))
    quantiles = forecast.quantiles.copy()
    for column, horizon in enumerate(forecast.horizons.tolist()):
        learned = state.horizons.get(horizon)
        if learned is None or not learned.shape:
            continue
        seen = _quantiles_of_z(np.asarray(learned.shape) + _GAUSSIAN_COUNTS, shares)
        about = forecast.quantiles[:, column] - forecast.quantiles[median, column]
        moved = seen / seen[high] * (Z90 / gaussian) * about
        # A fan that is no Gaussian one could cross its own band.
        moved[low : high + 1] = np.clip(moved[low : high + 1], about[low], about[high])
        moved[:low], moved[high + 1 :] = np.minimum(moved[:low], about[low]), np.maximum(moved[high + 1 :], about[high])
        quantiles[:, column] = forecast.quantiles[median, column] + np.sort(moved)
    return replace(forecast, quantiles=quantiles)


@cache
def _gaussian_quantiles(levels: tuple[float, ...]) -> tuple[Array, Array]:
    """(L,) the share of outcomes that are nearer to the median than each level's quantile, and a Gaussian's z there."""
    shares = np.abs(2.0 * np.array(levels) - 1.0)
    z = [NormalDist().inv_cdf((1.0 + share) / 2.0) if share > 0 else 1.0 for share in shares.tolist()]
    return shares, np.array(z)


def _quantiles_of_z(counts: Array, shares: Array) -> Array:
    """The quantiles of z at `shares`, linear in log z inside a bin."""
    total = np.concatenate([[0.0], np.cumsum(counts)])
    return np.asarray(np.exp(np.interp(shares * total[-1], total, _LOG_FENCES)))


def _quantile(horizon: Horizon) -> float:
    """The 90 % quantile of z, linear in log z inside a bin."""
    counts = np.asarray(horizon.counts)
    total = np.cumsum(counts)
    wanted = 0.9 * total[-1]
    row = int(np.searchsorted(total, wanted))
    if row == 0 or row >= len(_HISTOGRAM_EDGES):
        return float(_HISTOGRAM_EDGES[0] if row == 0 else _HISTOGRAM_EDGES[-1])
    part = (wanted - (total[row] - counts[row])) / counts[row]
    return float(_HISTOGRAM_EDGES[row - 1] * (_HISTOGRAM_EDGES[row] / _HISTOGRAM_EDGES[row - 1]) ** part)

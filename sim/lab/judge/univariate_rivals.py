"""Univariate rivals: a model of the past temperature alone, fitted anew at each origin on a grid of few points."""

import importlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from math import gcd
from typing import cast

import numpy as np
import scipy
from threadpoolctl import ThreadpoolController

from sim.lab.judge.direct_rivals import RunningMeans
from sim.lab.judge.past import FittedRival, Past, equal_shares, interpolate_temperature, readings, trained_columns
from sim.scores import crps_gaussian
from sim.sha import Array

WITHOUT_STATSMODELS = (
    "this rival needs statsmodels, which is not installed; install the extra: pip install 'decanter-gateway[bench]'"
)
MODELS = ("damped_trend", "auto_ets", "auto_arima", "auto_theta")
"""The functions of `sim.lab.judge.statsmodels_series` that a univariate rival may use."""
MAX_POINTS = 400
"""The model sees at most so many points of the past."""
MIN_POINTS = 12
"""With fewer points the last one stays, with the deviation of a random walk."""
HORIZON_STEPS = 6
"""So many steps of the grid make the shortest horizon, where readings come often enough."""
BAND_FACTORS = np.geomspace(0.25, 8.0, 21)
MIN_DEVIATION_DEGC = 0.02
"""A model may not be surer than this (degC): readings are not finer."""

SeriesModel = Callable[[Array, int], tuple[Array, Array]]


@dataclass(frozen=True, slots=True)
class Univariate:
    """One of MODELS on the past alone. What it learns from the training machines is how wide its band must be.

    A model's own deviations hold if the model is right. For each horizon they are multiplied by the one of BAND_FACTORS
    with the best CRPS at origins spread over the training machines, each machine alike.
    """

    name: str
    model: str
    origins: int = 40
    """The width of the band is measured at so many origins, spread evenly over all training machines."""

    def fit(self, training: Sequence[Past], horizons: Sequence[float]) -> FittedRival:
        """Measures the band; raises ValueError without statsmodels, on no training and for an unknown model."""
        if self.model not in MODELS:
            raise ValueError(f"there is no univariate model {self.model!r}; there are {', '.join(MODELS)}")
        if not training:
            raise ValueError(f"{self.name} needs at least one training machine for its band")
        if find_spec("statsmodels") is None:
            raise ValueError(WITHOUT_STATSMODELS)
        # statsmodels takes seconds to load, and only these rivals need it.
        module = importlib.import_module("sim.lab.judge.statsmodels_series")
        model = cast(SeriesModel, getattr(module, self.model))
        # On one thread: for matrices this small, threads that wait for one another cost fifty times what they gain.
        threads = ThreadpoolController()
        means, deviations, outcomes, machines = [], [], [], []
        for number, machine in enumerate(training):
            at, values = readings(machine)
            if at.size == 0:
                continue
            origins = np.linspace(at[0], at[-1], max(self.origins // len(training), 1) + 2)[1:-1]
            for past in map(machine.truncate, origins):
                with threads.limit(limits=1):
                    mean, deviation = _ahead(model, past, horizons)
                means.append(mean)
                deviations.append(deviation)
                outcomes.append(interpolate_temperature(at, values, past.times[-1] + np.asarray(horizons, dtype=float)))
                machines.append(number)
        scores = np.array([crps_gaussian(means, factor * np.array(deviations), outcomes) for factor in BAND_FACTORS])
        factors = []
        for column in range(len(horizons)):
            known = np.isfinite(scores[0, :, column])
            weights = equal_shares(np.array(machines)[known])
            factors.append(float(BAND_FACTORS[np.argmin(scores[:, known, column] @ weights)]) if known.any() else 1.0)
        return FittedUnivariate(tuple(horizons), model, np.array(factors), threads)


@dataclass(frozen=True, slots=True)
class FittedUnivariate:
    """A univariate model and how much wider (H,) than its own its band must be at each horizon."""

    horizons: tuple[float, ...]
    model: SeriesModel
    factors: Array
    threads: ThreadpoolController

    def forecast(self, past: Past, horizons: Sequence[float], levels: tuple[float, ...]) -> Array:
        """(L, H) quantiles in degC; see `FittedRival`."""
        columns = trained_columns(self.horizons, horizons)
        # All trained horizons, whichever are asked for: they make the grid on which the factors were measured.
        with self.threads.limit(limits=1):
            means, deviations = _ahead(self.model, past, self.horizons)
        quantiles = means + self.factors * deviations * scipy.special.ndtri(np.asarray(levels))[:, None]
        return np.asarray(quantiles[:, columns])


def _ahead(model: SeriesModel, past: Past, horizons: Sequence[float]) -> tuple[Array, Array]:
    """What the model expects at each horizon (s) after the past's last row, and its deviations (H,); NaN of no reading.

    The grid's points are means over its step. The last stands for the middle of its readings, up to half a step before
    the origin: so a horizon lies between two steps of the model.
    """
    step = _step(past.times, horizons)
    origin = past.times[-1]
    first = int(np.searchsorted(past.times, origin - (MAX_POINTS + 1) * step))
    recent = past.rows(slice(first, None))
    at, _ = readings(recent)
    if at.size == 0:
        return np.full(len(horizons), np.nan), np.full(len(horizons), np.nan)
    points = min(int((origin - at[0]) / step) + 1, MAX_POINTS)
    moments = origin - step * np.arange(points - 1, -1, -1.0)
    series = RunningMeans.of_column(recent.times, recent.temperature).before(moments, step)
    late = origin - float(np.mean(at[at > origin - step])) if at[-1] > origin - step else 0.0
    ahead = (np.asarray(horizons, dtype=float) + late) / step
    steps = int(np.ceil(ahead.max()))
    if points >= MIN_POINTS and np.ptp(series) > 0:
        means, deviations = model(series, steps)
    else:
        walk = float(np.std(np.diff(series))) if points > 1 else 0.0
        means, deviations = np.full(steps, series[-1]), walk * np.sqrt(np.arange(1.0, steps + 1.0))
    at_steps = np.arange(1.0, steps + 1.0)
    deviation = np.interp(ahead, at_steps, deviations)
    return np.interp(ahead, at_steps, means), np.maximum(deviation, MIN_DEVIATION_DEGC)


def _step(times: Array, horizons: Sequence[float]) -> float:
    """The grid's step (s): divides all horizons, the shortest into HORIZON_STEPS, but is no finer than the readings."""
    common = gcd(*(round(1000.0 * horizon) for horizon in horizons)) / 1000.0
    interval = float(np.median(np.diff(times[-MAX_POINTS:]))) if times.size > 1 else 0.0
    parts = max(round(HORIZON_STEPS * common / min(horizons)), 1)
    while parts > 1 and common / parts < interval:
        parts -= 1
    return common / parts

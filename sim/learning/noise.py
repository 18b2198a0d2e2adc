"""How noisy the plant is: sensor, process and scatter of the mode parameters, so that forecasts at every horizon fit.

The means are given (free-run fit). The exact Kalman filter on (X, m) is run over the readings, and its predictions are
scored one step ahead and at 60, 300 and 900 s (events and inputs known): a composite likelihood with equal weights
(Varin, Reid & Firth 2011). One-step likelihood alone would choose the noise by what happens between two readings, and
the bands at 15 minutes would be whatever comes out of it. Errors beyond three standard deviations count linearly.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from math import log, sqrt

import numpy as np
from scipy.optimize import minimize

from sim.learning.data import resolution
from sim.learning.free_run import RATES, FitShape, FreeRunFit, loads
from sim.learning.runs import FreeRuns, Indices, sampled
from sim.sha import FLOWS, Array, Flow, coefficients

HORIZONS = (60.0, 300.0, 900.0)
CHUNK = 150
"""Knots of a chunk at most: the filter's loop has so many rounds, however long the runs are."""
ORIGINS = 400
"""Pairs of readings by which each horizon is judged, at most."""
STEP = 1e-4
"""Of the logarithms, for the gradient by forward differences."""
DRIFT_SPAN = 300.0
"""The changes over so many seconds set the noise of locations in which nothing is known."""


@dataclass(frozen=True, slots=True)
class NoiseLevels:
    """`sensor` (degC); `process` (G,), degC/sqrt(s), by group of locations; `scatter` (L,), the sigma of each m.

    `score` is the mean log-likelihood per reading of the one-step predictions and of those at each of HORIZONS.
    """

    sensor: float
    process: Array
    scatter: Array
    score: Mapping[float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class _AffineSteps:
    """Every knot's affine step: X' = decay X + pull (m - mu) + drift, variance = density * process^2."""

    decay: Array
    pull: Array
    drift: Array
    density: Array
    place: Indices
    group: Indices
    stay: Indices
    time: Array
    reading: Array
    run: Indices


@dataclass(frozen=True, slots=True, kw_only=True)
class _Ahead:
    """Predictions from K origins: mean = decay X + own (m - mu) + drift; variance weights of the noises after it."""

    horizon: float
    origin: Indices
    outcome: Array
    decay: Array
    own: Array
    drift: Array
    process: Array
    scatter: Array


def _steps(runs: FreeRuns, shape: FitShape, fit: FreeRunFit, groups: Indices) -> _AffineSteps:
    n = len(runs)
    decay, pull, density = np.ones(n), np.zeros(n), np.zeros(n)
    for place in np.unique(runs.place):
        kind, rows = shape.kinds[place], runs.place == place
        params = dict.fromkeys(FLOWS[kind].params, 1.0)
        if kind in RATES:
            params[RATES[kind]] = float(fit.rates[shape.rate[place]])
        decay[rows], pull[rows], density[rows] = coefficients(Flow(kind, params), runs.age[rows], runs.dt[rows])
    return _AffineSteps(
        decay=decay,
        pull=pull,
        drift=pull * (loads(runs, shape) @ fit.linear),
        density=density,
        place=runs.place,
        group=groups[runs.place],
        stay=runs.stay,
        time=runs.time,
        reading=runs.reading,
        run=runs.run,
    )


def _chunks(steps: _AffineSteps) -> Indices:
    """(J, C) knot numbers of the chunks, filtered side by side; -1 beyond a chunk's end. Each begins at a reading."""
    columns: list[Indices] = []
    first = np.flatnonzero(np.diff(steps.run, prepend=-1) != 0)
    for low, high in zip(first, [*first[1:], steps.run.size], strict=True):
        begin = int(low)
        while begin < high - 1:
            end = min(begin + CHUNK, int(high))
            known = np.flatnonzero(np.isfinite(steps.reading[begin:end]))
            if known.size < 2:
                break
            # A chunk ends at its last reading, where the next one begins: that knot belongs to both.
            end = begin + int(known[-1]) + 1
            columns.append(np.arange(begin, end))
            begin = end - 1
    # The longest first: those that go on are then always the first columns of a row.
    columns.sort(key=lambda column: (-column.size, column[0]))
    table = np.full((columns[0].size if columns else 0, len(columns)), -1, dtype=np.intp)
    for number, column in enumerate(columns):
        table[: column.size, number] = column
    return table


def _filtered(
    steps: _AffineSteps, table: Indices, sensor: Array, process: Array, scatter: Array
) -> tuple[Array, Array]:
    """(log-likelihoods (n, Q), states (5, n, Q) after each knot) for Q sets of `sensor` (Q,), `process` (G, Q), ...

    The Kalman filter on (X, m - mu), vectorised twice: over the chunks, which begin at a reading and so need nothing of
    one another, and over the Q sets of noises that a gradient takes. A state is the means of X and m - mu, then xx, xm
    and mm of their covariance.
    """
    n, width = steps.run.size, sensor.size
    scores, states = np.full((n, width), np.nan), np.full((5, n, width), np.nan)
    if table.shape[0] < 2:
        return scores, states
    # All that does not depend on the state is made for all knots at once, in the order in which the loop meets them:
    # its rounds are many and their arrays small, so that what counts there is the number of operations.
    inside = table[1:] >= 0
    knots, ends = table[1:][inside], np.cumsum(inside.sum(axis=1))
    a, p = steps.decay[knots][:, None], steps.pull[knots][:, None]
    aa, ap, pp = a * a, 2 * a * p, p * p
    drift, reading = steps.drift[knots][:, None], steps.reading[knots][:, None]
    added = steps.density[knots][:, None] * process[steps.group[knots]] ** 2
    drawn, noise = scatter[steps.place[knots]] ** 2, sensor**2
    # A new stay draws its m anew, and so does a chunk's first step: what the stay before it knew is given up.
    fresh = (steps.stay[knots] != steps.stay[knots - 1])[:, None]
    fresh[: ends[0]] = True
    known = np.isfinite(reading)
    x = np.repeat(steps.reading[table[0]][:, None], width, axis=1)
    m = np.zeros_like(x)
    xx, xm, mm = m + noise, m, m
    innovation, variance = np.empty((knots.size, width)), np.empty((knots.size, width))
    after, begins = np.empty((5, knots.size, width)), np.append(0, ends[:-1])
    anew = np.logical_or.reduceat(fresh[:, 0], begins).tolist()
    full = np.logical_and.reduceat(known[:, 0], begins).tolist()
    for begin, end, some_fresh, all_known in zip(begins.tolist(), ends.tolist(), anew, full, strict=True):
        at, size = slice(begin, end), end - begin
        x, m, xx, xm, mm = x[:size], m[:size], xx[:size], xm[:size], mm[:size]
        if some_fresh:
            # A fresh m is independent of X: mean 0, variance that of its location, no covariance with what was before.
            new = fresh[at]
            m, xm, mm = np.where(new, 0.0, m), np.where(new, 0.0, xm), np.where(new, drawn[at], mm)
        # The prediction, by the step's own closed form; its innovation is scored before the reading is taken in.
        carried, pulled = a[at], p[at]
        x = carried * x + pulled * m + drift[at]
        xx, xm = aa[at] * xx + ap[at] * xm + pp[at] * mm + added[at], carried * xm + pulled * mm
        error = innovation[at] = reading[at] - x
        total = variance[at] = xx + noise
        # The scalar update needs no inverse.
        gain, turn = xx / total, xm / total
        if not all_known:
            # Without a reading gain and turn are 0, and the prediction stands.
            gain, turn = np.where(known[at], gain, 0.0), np.where(known[at], turn, 0.0)
            error = np.where(known[at], error, 0.0)
        x, m, mm, left = x + gain * error, m + turn * error, mm - turn * xm, 1 - gain
        xx, xm = left * xx, left * xm
        after[0, at], after[1, at], after[2, at], after[3, at], after[4, at] = x, m, xx, xm, mm
    scores[knots], states[:, knots] = _log_score(innovation, variance), after
    return scores, states


def _log_score(error: Array, variance: Array) -> Array:
    # Linear beyond three standard deviations (Huber): one wrong reading must not set the noise of a plant.
    z = np.abs(error) / np.sqrt(variance)
    return np.asarray(-0.5 * np.log(2 * np.pi * variance) - np.where(z < 3, 0.5 * z * z, 3 * z - 4.5))


def _ahead(steps: _AffineSteps, horizon: float, groups: int, places: int) -> _Ahead | None:
    """The predictions over `horizon`, or None when no two readings are so far apart.

    They are made for ORIGINS pairs at most of readings of one run, `horizon` to 1.2 times as far apart.
    """
    known = np.flatnonzero(np.isfinite(steps.reading))
    of_runs: list[Indices] = []
    for run in np.unique(steps.run[known]):
        of_run = known[steps.run[known] == run]
        outcome = np.searchsorted(steps.time[of_run], steps.time[of_run] + horizon)
        inside = outcome < of_run.size
        of_runs.append(np.column_stack([of_run[inside], of_run[outcome[inside]]]))
    pairs = np.concatenate(of_runs)
    # After a gap the next reading may come much later: that would be another horizon.
    pairs = pairs[steps.time[pairs[:, 1]] - steps.time[pairs[:, 0]] <= 1.2 * horizon]
    chosen = np.unique(np.linspace(0, len(pairs) - 1, min(len(pairs), ORIGINS)).astype(np.intp))
    origin, end = pairs[chosen, 0], pairs[chosen, 1]
    size = origin.size
    if not size:
        return None
    decay, own, drift, fresh = np.ones(size), np.zeros(size), np.zeros(size), np.zeros(size)
    process, scatter = np.zeros((size, groups)), np.zeros((size, places))
    # All origins walk on together, one knot a round, until each is at its outcome. The m of the stay in which an
    # origin lies is the filter's (`own`, while `still`); each later stay has one of its own, whose weight on X is
    # `fresh` while it lasts and which then goes, squared, to the scatter of its location.
    at, still = origin.copy(), np.ones(size, dtype=bool)
    for _ in range(int((end - origin).max())):
        go = np.flatnonzero(at < end)
        knots = at[go] + 1
        a, p = steps.decay[knots], steps.pull[knots]
        left = steps.stay[knots] != steps.stay[at[go]]
        ended = go[left & ~still[go]]
        scatter[ended, steps.place[at[ended]]] += fresh[ended] ** 2
        fresh[go[left]] = 0.0
        still[go[left]] = False
        decay[go] *= a
        own[go] = a * own[go] + np.where(still[go], p, 0.0)
        fresh[go] = a * fresh[go] + np.where(still[go], 0.0, p)
        drift[go] = a * drift[go] + steps.drift[knots]
        process[go] *= a[:, None] ** 2
        process[go, steps.group[knots]] += steps.density[knots]
        scatter[go] *= a[:, None] ** 2
        at[go] = knots
    scatter[np.arange(size), steps.place[end]] += fresh**2
    return _Ahead(
        horizon=horizon,
        origin=origin,
        outcome=steps.reading[end],
        decay=decay,
        own=own,
        drift=drift,
        process=process,
        scatter=scatter,
    )


def _mean_known(scores: Array) -> Array:
    """(Q,) the mean of the rows (n, Q) that are known; 0, which prefers nothing, where none is."""
    return np.asarray(np.nansum(scores, axis=0) / np.maximum(np.sum(~np.isnan(scores), axis=0), 1))


@dataclass(frozen=True, slots=True)
class _Task:
    """What the likelihood needs, and the floors and counts of its parameters."""

    steps: _AffineSteps
    table: Indices
    aheads: tuple[_Ahead, ...]
    groups: int
    seen: Indices
    places: int
    floor: float

    def unpack(self, theta: Array) -> tuple[Array, Array, Array]:
        """(sensor (Q,), process (G, Q), scatter (L, Q)) from theta (P, Q) of logarithms."""
        values = np.exp(theta)
        scatter = np.zeros((self.places, theta.shape[1]))
        scatter[self.seen] = values[1 + self.groups :]
        return values[0], values[1 : 1 + self.groups], scatter

    def scores(self, theta: Array) -> list[Array]:
        """(Q,) the mean log-likelihood one step ahead, then at each horizon."""
        sensor, process, scatter = self.unpack(theta)
        one_step, states = _filtered(self.steps, self.table, sensor, process, scatter)
        scores = [_mean_known(one_step)]
        for ahead in self.aheads:
            # An origin outside all chunks has no state: NaN, which the mean leaves out.
            x, m, xx, xm, mm = (part[ahead.origin] for part in states)
            a, own = ahead.decay[:, None], ahead.own[:, None]
            mean = a * x + own * m + ahead.drift[:, None]
            variance = a * a * xx + 2 * a * own * xm + own * own * mm
            variance = variance + ahead.process @ process**2 + ahead.scatter @ scatter**2 + sensor**2
            scores.append(_mean_known(_log_score(ahead.outcome[:, None] - mean, variance)))
        return scores

    def loss(self, theta: Array, weight: float) -> Array:
        """(Q,) minus the composite log-likelihood and the log-prior.

        The scatters are shrunk towards their common geometric mean (factor 1.6): a location that was entered three
        times says little about its own.
        """
        logs = theta[1 + self.groups :]
        shrink = np.sum((logs - logs.mean(axis=0)) ** 2, axis=0) / (2 * 0.5**2)
        vague = np.sum((theta - self.start()[:, None]) ** 2, axis=0) / (2 * 3.0**2)
        return np.asarray(shrink + vague - weight * np.sum(self.scores(theta), axis=0))

    def start(self) -> Array:
        """Where the search begins and the vague prior lies: 0.005 degC/sqrt(s) and 2 degC, sensor by differences."""
        reading = self.steps.reading[np.isfinite(self.steps.reading)]
        # White noise in second differences has 1 + 4 + 1 = 6 times its variance; a slow course nearly vanishes in them.
        rough = 1.4826 * float(np.median(np.abs(np.diff(reading, 2)))) / sqrt(6.0) if reading.size > 2 else 0.0
        logs = [log(max(rough, self.floor) * 1.01), *[log(0.005)] * self.groups, *[log(2.0)] * self.seen.size]
        return np.array(logs)

    def bounds(self) -> list[tuple[float, float]]:
        """Of the logarithms: no sensor is better than its rounding, no plant without noise."""
        sensor = (log(self.floor), log(max(50.0, 2 * self.floor)))
        return [sensor, *[(log(1e-4), log(1.0))] * self.groups, *[(log(0.05), log(60.0))] * self.seen.size]


def fit_noise(
    runs: FreeRuns, shape: FitShape, fit: FreeRunFit, groups: Indices, *, budget: int = 2500, floor: float = 1e-3
) -> NoiseLevels:
    """The noise of greatest composite likelihood, the means given by `fit`.

    `groups` (L,) numbers the locations that share one process noise. `floor` is the least sensor sigma (degC); the
    sensor's own rounding, step/sqrt(12), is taken where that is more. Rows are sampled to about `budget` knots.
    """
    few = sampled(runs, budget)
    steps = _steps(few, shape, fit, groups)
    count = int(groups.max()) + 1
    aheads = [_ahead(steps, horizon, count, groups.size) for horizon in HORIZONS]
    task = _Task(
        steps=steps,
        table=_chunks(steps),
        aheads=tuple(ahead for ahead in aheads if ahead is not None),
        groups=count,
        seen=np.flatnonzero(shape.target >= 0),
        places=groups.size,
        floor=max(floor, resolution(runs.reading) / sqrt(12.0)),
    )
    # As many independent looks as the data have stretches of 300 s, spread over one step and the horizons.
    weight = max(float(few.dt.sum()) / 300.0, 10.0)
    search = minimize(
        _value_and_slope,
        task.start(),
        args=(task, weight),
        jac=True,
        method="L-BFGS-B",
        bounds=task.bounds(),
        options={"maxiter": 60, "ftol": 1e-7},
    )
    best = np.asarray(search.x)[:, None]
    sensor, process, scatter = task.unpack(best)
    horizons = [0.0, *(ahead.horizon for ahead in task.aheads)]
    score = {horizon: float(value[0]) for horizon, value in zip(horizons, task.scores(best), strict=True)}
    return NoiseLevels(float(sensor[0]), process[:, 0], scatter[:, 0], score)


def _value_and_slope(theta: Array, task: _Task, weight: float) -> tuple[float, Array]:
    """The loss and its gradient by forward differences, all perturbations in one pass of the filter.

    In logarithms of standard deviations a step of 1e-4 is a hundredth of a percent: small against what the loss curves
    by, large against its rounding.
    """
    trials = theta[:, None] + STEP * np.eye(theta.size, theta.size + 1, 1)
    values = task.loss(trials, weight)
    return float(values[0]), (values[1:] - values[0]) / STEP


def drift_noise(runs: FreeRuns) -> float:
    """The random walk, degC/sqrt(s), whose changes over 300 s are as large as the readings' own (or over a shorter
    time, when no run lasts so long)."""
    time, reading = (column[np.isfinite(runs.reading)] for column in (runs.time, runs.reading))
    run = runs.run[np.isfinite(runs.reading)]
    squares: list[float] = []
    # A random walk's variance grows with time, so a squared change counts by the second that it took.
    for number in np.unique(run):
        of_run = run == number
        at, value = time[of_run], reading[of_run]
        span = min(DRIFT_SPAN, float(at[-1] - at[0]))
        later = np.minimum(np.searchsorted(at, at + span), at.size - 1)
        whole = at[later] - at >= span
        if span > 0:
            squares += ((value[later] - value)[whole] ** 2 / (at[later] - at)[whole]).tolist()
    return float(max(np.sqrt(np.mean(squares)) if squares else 0.0, 1e-3))

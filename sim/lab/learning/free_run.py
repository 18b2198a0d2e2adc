"""Free-run maximum likelihood: the parameters of a hybrid automaton's flows from traces, by variable projection.

In a free run the model gets the events, the inputs and a start temperature, and no other reading. Its mean is linear in
the mode parameters m, in the gains of the inputs and in the start temperatures; only the rates (k of the relaxing
flows, t0 of the logarithmic one, tau of the transient) enter otherwise. So for each trial of the rates the linear part
is solved exactly, the start temperature of each run in closed form, and only log(rate) is left to scipy's least
squares, with Kaufman's Jacobian (Golub & Pereyra 1973; Kaufman 1975).

The loss is Huber's (c = 1.345, 95 % efficient for normal errors) by iterated reweighting. Neighbouring residuals of a
free run resemble each other, so the likelihood is tempered by their correlation time: it says how strongly the weak
priors count, and standard errors would be several times too small without it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import scipy
from numpy.typing import NDArray

from sim.engine import linear_recursion
from sim.lab.learning.runs import FreeRuns, Indices
from sim.sha import FLOWS, RELAXING_FLOWS, Array, Coefficients, Flow, Mask, coefficients

HUBER_LIMIT = 1.345
ROUNDS, SETTLED = 12, 0.02
"""Rounds of fitting, reweighting and measuring the noise, at most: it ends when sigma changes by less than 2 %."""
RATE_PARAMETERS = {"exponential": "k", "driven": "k", "logarithmic": "t0", "transient": "tau"}
"""The constant that enters a flow's mean otherwise than linearly."""
MIN_RUNS = 8
"""Runs from which standard errors by run are to be had."""
RATE_SEARCH_SPREADS = 4.0
"""log(rate) is looked for within so many spreads of its prior's centre."""

Loss = Literal["huber", "squares"]


@dataclass(frozen=True, slots=True)
class FitShape:
    """Which parameter stands where: L locations, q inputs, p linear parameters, r rates. Equal numbers are shared.

    `kinds` (L,) are keys of FLOWS, `rate` (L,) the number of each location's rate, `target` (L,) that of its m and
    `gain` (L, q) those of its inputs' gains among the linear parameters; -1 where there is none. `reference` (L, q) is
    the input at which nothing is added. The prior of the linear parameters is normal with `centre` and `spread` (p,),
    that of log(rate) normal with `rate_centre` and `rate_spread` (r,).
    """

    kinds: tuple[str, ...]
    rate: Indices
    target: Indices
    gain: NDArray[np.intp]
    reference: Array
    centre: Array
    spread: Array
    rate_centre: Array
    rate_spread: Array


@dataclass(frozen=True, slots=True, kw_only=True)
class FreeRunFit:
    """The parameters that maximise the free-run likelihood, and how well they are known.

    `linear` (p,), `rates` (r,) natural units; `errors` (p + r,) are standard errors, of log(rate) for the rates;
    `covariance` (p + r, p + r) is theirs. `sigma` is the robust standard deviation of the residuals (degC),
    `correlation` how many neighbouring readings count as one. `mean` (n,) is the free run at every knot and `start`
    (R,) the start temperature of each run, in the order of the runs.
    """

    linear: Array
    rates: Array
    covariance: Array
    sigma: float
    correlation: float
    mean: Array
    start: Array

    @property
    def errors(self) -> Array:
        """Standard errors of the linear parameters, then of log(rate)."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))

    @property
    def errors_at_rates(self) -> Array:
        """(p,) standard errors of the linear parameters if the rates were exactly the fitted ones.

        A slow location hardly tells its target from its rate, only the drift that both make: this is how far off the
        drift may be, in degC of the target.
        """
        count = self.linear.size
        linear, cross, rates = (
            self.covariance[:count, :count],
            self.covariance[:count, count:],
            self.covariance[count:, count:],
        )
        # Schur's complement: the covariance of the linear parameters given the rates.
        explained = np.einsum("ij,ji->i", cross, np.linalg.solve(rates, cross.T)) if rates.size else 0.0
        return np.asarray(np.sqrt(np.maximum(np.diag(linear) - explained, 0.0)))


@dataclass(frozen=True, slots=True)
class _StepsOfOneKind:
    """The `rows` whose locations have one `kind` of flow and one `rate` (a number; -1: none), their age and length."""

    kind: str
    rate: int
    rows: Indices | slice
    age: Array
    dt: Array


@dataclass(frozen=True, slots=True)
class _StepsOfRuns:
    """All n steps of some runs, by what does not depend on the rates; `first` (n,) are the knots that begin a run."""

    alike: tuple[_StepsOfOneKind, ...]
    first: Mask

    def coefficients(self, rates: Sequence[float]) -> Coefficients:
        """(decay, pull, variance at a noise of 1) of every step at the given rates."""
        decay, pull, density = np.ones(self.first.size), np.zeros(self.first.size), np.zeros(self.first.size)
        for each in self.alike:
            params = dict.fromkeys(FLOWS[each.kind].params, 1.0)
            if each.kind in RATE_PARAMETERS:
                params[RATE_PARAMETERS[each.kind]] = float(rates[each.rate])
            rows = each.rows
            decay[rows], pull[rows], density[rows] = coefficients(Flow(each.kind, params), each.age, each.dt)
        return decay, pull, density

    def step_coefficients(self, log_rates: Array) -> tuple[Array, Array]:
        """(decay, pull) of every step at the given log(rate); exactly (0, 0) where a run begins."""
        decay, pull, _ = self.coefficients([float(np.exp(each)) for each in log_rates])
        # Nothing is carried over from the run before: exactly 0, so that one recursion serves all runs.
        decay[self.first] = 0.0
        pull[self.first] = 0.0
        return decay, pull


def _run_steps(runs: FreeRuns, shape: FitShape) -> _StepsOfRuns:
    # Locations of one kind and rate make the same steps, and are done together.
    alike: dict[tuple[str, int], list[int]] = {}
    for place in np.flatnonzero(np.bincount(runs.place)).tolist():
        kind = shape.kinds[place]
        alike.setdefault((kind, int(shape.rate[place]) if kind in RATE_PARAMETERS else -1), []).append(place)
    found = []
    for (kind, rate), places in alike.items():
        inside = np.zeros(len(shape.kinds), dtype=bool)
        inside[places] = True
        rows = np.flatnonzero(inside[runs.place]) if len(alike) > 1 else slice(None)
        found.append(_StepsOfOneKind(kind, rate, rows, runs.age[rows], runs.dt[rows]))
    return _StepsOfRuns(tuple(found), runs.first)


def steps(runs: FreeRuns, shape: FitShape, log_rates: Array) -> tuple[Array, Array]:
    """(decay, pull) of every step at the given log(rate); exactly (0, 0) where a run begins."""
    return _run_steps(runs, shape).step_coefficients(log_rates)


def plain_steps(runs: FreeRuns, shape: FitShape, rates: Array) -> Coefficients:
    """(decay, pull, variance at a noise of 1) of every step at the given rates, those at a run's beginning too."""
    return _run_steps(runs, shape).coefficients(rates.tolist())


def relaxing_rates(runs: FreeRuns, shape: FitShape, rates: Array) -> Array:
    """(n,) 1/s the rate of each step's flow, 0 where it does not relax."""
    relaxing = np.array([kind in RELAXING_FLOWS for kind in shape.kinds])
    return np.asarray(np.append(rates, 0.0)[np.where(relaxing, shape.rate, -1)][runs.place])


def load(runs: FreeRuns, shape: FitShape, parameter: int) -> Array:
    """(n,) what a linear parameter adds to the target of each step, per unit of the parameter."""
    total: Array = (shape.target == parameter)[runs.place].astype(float)
    for number in range(shape.gain.shape[1]):
        driven = shape.gain[:, number] == parameter
        if driven.any():
            total += np.where(driven[runs.place], _excess(runs, shape, number), 0.0)
    return total


def loads(runs: FreeRuns, shape: FitShape) -> Array:
    """(n, p) `load` of all linear parameters."""
    total = np.empty((len(runs), shape.centre.size))
    for parameter in range(shape.centre.size):
        total[:, parameter] = load(runs, shape, parameter)
    return total


def targets(runs: FreeRuns, shape: FitShape, linear: Array) -> Array:
    """(n,) the target of each step at the linear parameters (p,)."""
    values = np.append(linear, 0.0)  # the last is that of a place without a parameter (-1)
    total = np.asarray(values[shape.target][runs.place])
    for number in range(shape.gain.shape[1]):
        if (shape.gain[:, number] >= 0).any():
            total += values[shape.gain[:, number]][runs.place] * _excess(runs, shape, number)
    return total


def pushed_targets(runs: FreeRuns, shape: FitShape, linear: Array) -> Array:
    """(n,) what the inputs alone add to the target of each step."""
    return targets(runs, replace(shape, target=np.full_like(shape.target, -1)), linear)


def _excess(runs: FreeRuns, shape: FitShape, number: int) -> Array:
    """(n,) by how much an input is more than that at which it adds nothing; 0 while it was never read."""
    return np.nan_to_num(runs.inputs[:, number] - shape.reference[:, number][runs.place])


@dataclass(frozen=True, slots=True, kw_only=True)
class _Linear:
    """The linear problem at fixed rates, on the rows with a reading; start temperatures are projected out."""

    columns: Array
    start: Array
    residual: Array
    linear: Array
    inverse: Callable[[Array], Array]
    mean: Array
    decay: Array


@dataclass(frozen=True, slots=True, kw_only=True)
class _Problem:
    """Readings, loads and the present weights: all that does not depend on the rates."""

    runs: FreeRuns
    shape: FitShape
    steps: _StepsOfRuns
    load: Array
    rows: Indices
    reading: Array
    bounds: Indices
    sizes: Indices
    weight: Array
    noise: float

    def project(self, columns: Array, start: Array) -> tuple[Array, Array]:
        """(columns without their part along `start`, that part's factor), run by run, in the weighted product."""
        weighted = (self.weight * start)[:, None]
        norm = np.add.reduceat(weighted * start[:, None], self.bounds)
        part = np.add.reduceat(weighted * columns, self.bounds) / np.maximum(norm, 1e-300)
        return columns - start[:, None] * np.repeat(part, self.sizes, axis=0), part


def _initial_problem(runs: FreeRuns, shape: FitShape) -> _Problem:
    """The problem before there is a residual: all readings weigh the same."""
    rows = np.flatnonzero(np.isfinite(runs.reading))
    reading = runs.reading[rows]
    bounds = np.flatnonzero(np.concatenate([[True], np.diff(runs.run[rows]) != 0]))
    return _Problem(
        runs=runs,
        shape=shape,
        steps=_run_steps(runs, shape),
        load=loads(runs, shape),
        rows=rows,
        reading=reading,
        bounds=bounds,
        sizes=np.diff(np.append(bounds, rows.size)),
        weight=np.ones(rows.size),
        # Until there are residuals, a tenth of the readings' variance: the priors must neither rule nor vanish
        # meanwhile.
        noise=0.1 * float(np.var(reading - np.median(reading))) + 1e-6,
    )


def _solve(problem: _Problem, log_rates: Array) -> _Linear:
    """Golub & Pereyra's variable projection (1973): at fixed rates all else is linear and solved for exactly."""
    shape, first = problem.shape, problem.steps.first
    decay, pull = problem.steps.step_coefficients(log_rates)
    # Column j is the whole course that a unit of parameter j alone would make; `begun` that of a unit of a run's start.
    full = linear_recursion(decay[:, None], pull[:, None] * problem.load, np.zeros(shape.centre.size))
    begun = linear_recursion(decay, first.astype(float), 0.0)
    start = begun[problem.rows]
    # The starts, one for each run and often hundreds, are taken out run by run, not as columns of the normal equations.
    both, part = problem.project(np.column_stack([full[problem.rows], problem.reading]), start)
    columns, reading = both[:, :-1], both[:, -1]
    prior = problem.noise / shape.spread**2
    weighted = columns * problem.weight[:, None]
    factor = scipy.linalg.cho_factor(columns.T @ weighted + np.diag(prior))
    linear = scipy.linalg.cho_solve(factor, weighted.T @ reading + prior * shape.centre)
    starts = part[:, -1] - part[:, :-1] @ linear
    mean = full @ linear + begun * starts[np.cumsum(first) - 1]
    return _Linear(
        columns=columns,
        start=start,
        residual=reading - columns @ linear,
        linear=linear,
        inverse=lambda right: scipy.linalg.cho_solve(factor, right),
        mean=mean,
        decay=decay,
    )


def _sensitivity(problem: _Problem, log_rates: Array, solved: _Linear) -> Array:
    """(N, r) derivative of the mean at the readings by log(rate), linear parameters and starts held."""
    # x' = a x + p T, so dx' = a dx + (da x + dp T): the course's own recursion, driven by the change of its
    # coefficients. These are differentiated numerically, as any flow of the table may stand there.
    runs, shape, step = problem.runs, problem.shape, 1e-4
    target = problem.load @ solved.linear
    before = np.concatenate([[0.0], solved.mean[:-1]])
    groups = np.append(shape.rate, -1)[runs.place]
    up, down = (problem.steps.step_coefficients(log_rates + sign * step) for sign in (1, -1))
    forcing = ((up[0] - down[0]) * before + (up[1] - down[1]) * target) / (2 * step)
    forcings = np.where(groups[:, None] == np.arange(log_rates.size), forcing[:, None], 0.0)
    return np.asarray(linear_recursion(solved.decay[:, None], forcings, np.zeros(log_rates.size))[problem.rows])


def _stack_columns(problem: _Problem, log_rates: Array, solved: _Linear) -> Array:
    shape = problem.shape
    return np.concatenate(
        [
            np.sqrt(problem.weight) * solved.residual,
            np.sqrt(problem.noise) * (solved.linear - shape.centre) / shape.spread,
            np.sqrt(problem.noise) * (log_rates - shape.rate_centre) / shape.rate_spread,
        ]
    )


def _jacobian(problem: _Problem, log_rates: Array, solved: _Linear) -> Array:
    """Minus the sensitivity without its part in the space of the linear parameters.

    Kaufman (1975) leaves out the second term of Golub & Pereyra's derivative, which is of the order of the residual:
    hardly more steps to convergence, each at the price of one recursion a rate.
    """
    shape = problem.shape
    sense, _ = problem.project(_sensitivity(problem, log_rates, solved), solved.start)
    part = solved.inverse(solved.columns.T @ (problem.weight[:, None] * sense))
    return np.concatenate(
        [
            -np.sqrt(problem.weight)[:, None] * (sense - solved.columns @ part),
            -np.sqrt(problem.noise) * part / shape.spread[:, None],
            np.sqrt(problem.noise) * np.diag(1.0 / shape.rate_spread),
        ]
    )


def _best_rates(problem: _Problem, begin: Array) -> Array:
    """log(rate) of the least penalised squares, from `begin`."""
    if not begin.size:
        return begin
    shape = problem.shape
    low, high = (shape.rate_centre + sign * RATE_SEARCH_SPREADS * shape.rate_spread for sign in (-1, 1))
    # least_squares asks for residuals and slopes at the same point one after the other: one solution serves both.
    kept: dict[bytes, _Linear] = {}

    def solve_linear(log_rates: Array) -> _Linear:
        key = log_rates.tobytes()
        if key not in kept:
            kept.clear()
            kept[key] = _solve(problem, log_rates)
        return kept[key]

    def residuals(log_rates: Array) -> Array:
        return _stack_columns(problem, log_rates, solve_linear(log_rates))

    def slopes(log_rates: Array) -> Array:
        return _jacobian(problem, log_rates, solve_linear(log_rates))

    search = scipy.optimize.least_squares(
        residuals,
        np.clip(begin, low + 1e-6, high - 1e-6),
        jac=slopes,
        bounds=(low, high),
        xtol=1e-4,
        ftol=1e-6,
        max_nfev=40,
    )
    return np.asarray(search.x)


def robust_sigma(residual: Array) -> float:
    """1.4826 times the median distance from 0, and never exactly 0."""
    return max(1.4826 * float(np.median(np.abs(residual))), 1e-6)


def correlation_time(residual: Array, begins: Mask) -> float:
    """How many neighbouring readings count as one: 1 + 2 * the sum of autocorrelations up to the first below 0.05.

    Products across the beginning of a run are not formed. At least 1, at most a tenth of the readings.
    """
    # The integrated autocorrelation time, cut where only the noise of the estimate would be summed.
    total, run = 1.0, np.cumsum(begins)
    power = float(np.mean(residual**2))
    lag, limit = 1, max(residual.size // 5, 1)
    while lag < limit and power > 0:
        same = run[lag:] == run[:-lag]
        if not same.any():
            break
        rho = float(np.sum((residual[lag:] * residual[:-lag])[same])) / (power * residual.size)
        if rho < 0.05:
            break
        # Lags grow by a quarter: a sum over thousands of lags needs no more.
        following = max(lag + 1, lag * 5 // 4)
        total += 2.0 * rho * (following - lag)
        lag = following
    return min(max(total, 1.0), max(residual.size / 10.0, 1.0))


def fit_free_run(runs: FreeRuns, shape: FitShape, *, begin: Array | None = None, loss: Loss = "huber") -> FreeRunFit:
    """The parameters of greatest free-run likelihood (with the weak priors of `shape`) on `runs`.

    `begin` (r,) are the rates from which the search starts (default: the best of a coarse scan). With `huber` a reading
    further than 1.345 robust standard deviations from the free run pulls no stronger than one at that distance.
    """
    problem = _initial_problem(runs, shape)
    rows, reading = problem.rows, problem.reading
    begins = np.zeros(rows.size, dtype=bool)
    begins[problem.bounds] = True
    if begin is None:
        # The search is local, so it starts at the best of nine shifts of all rates together from the prior's centre,
        # two spreads to each side.
        trials = [shape.rate_centre + shift * shape.rate_spread for shift in np.linspace(-2.0, 2.0, 9)]
        costs = [float(np.sum(_stack_columns(problem, trial, _solve(problem, trial)) ** 2)) for trial in trials]
        log_rates = np.asarray(trials[int(np.argmin(costs))])
    else:
        log_rates = np.log(begin)
    sigma = float("inf")
    # Iteratively reweighted least squares (Holland & Welsch 1977): rates and linear parameters under fixed weights,
    # then the weights from their residuals. Errors of neighbouring readings are correlated, so the likelihood is
    # tempered: `noise` counts `correlation` readings as one, or the priors would have no say against thousands of rows.
    for _ in range(ROUNDS):
        log_rates = _best_rates(problem, log_rates)
        solved = _solve(problem, log_rates)
        error = reading - solved.mean[rows]
        before, sigma = sigma, robust_sigma(error)
        correlation = correlation_time(np.clip(error, -3 * sigma, 3 * sigma), begins)
        problem = replace(problem, weight=_weights(error, sigma, loss), noise=sigma**2 * correlation)
        if abs(sigma - before) < SETTLED * sigma:
            break
    sense, _ = problem.project(_sensitivity(problem, log_rates, solved), solved.start)
    covariance = _covariance(problem, np.column_stack([solved.columns, sense]), error)
    starts = solved.mean[runs.first]
    return FreeRunFit(
        linear=solved.linear,
        rates=np.exp(log_rates),
        covariance=covariance,
        sigma=sigma,
        correlation=correlation,
        mean=solved.mean,
        start=starts,
    )


@dataclass(frozen=True, slots=True)
class LinearFit:
    """The linear parameters of greatest likelihood at given rates: `linear` (p,), `sigma` (degC), the Huber `loss`."""

    linear: Array
    sigma: float
    loss: float


def fit_at_rates(
    runs: FreeRuns, shape: FitShape, rates: Array, rounds: int = 3, scale: float | None = None
) -> LinearFit:
    """`fit_free_run` without its search: the rates (r,) are given, and a few rounds of reweighting are enough.

    `loss` is the mean of Huber's loss at `scale` (degC; default: the fit's own), so that rates can be compared.
    """
    problem, log_rates = _initial_problem(runs, shape), np.log(rates)
    for _ in range(rounds):
        solved = _solve(problem, log_rates)
        error = problem.reading - solved.mean[problem.rows]
        sigma = robust_sigma(error)
        # Readings count as independent here: only losses at one scale are compared, and no standard error is asked for.
        problem = replace(problem, weight=_weights(error, sigma, "huber"), noise=sigma**2)
    return LinearFit(solved.linear, sigma, float(np.mean(huber_loss(np.abs(error) / (scale or sigma)))))


def huber_loss(z: Array) -> Array:
    """Huber's loss of standardised distances z >= 0: z^2 / 2 up to 1.345, a straight line from there on."""
    return np.where(z < HUBER_LIMIT, 0.5 * z * z, HUBER_LIMIT * z - 0.5 * HUBER_LIMIT**2)


def _weights(error: Array, sigma: float, loss: Loss) -> Array:
    if loss == "squares":
        return np.ones(error.size)
    return np.minimum(1.0, HUBER_LIMIT * sigma / np.maximum(np.abs(error), 1e-12))


def _covariance(problem: _Problem, columns: Array, error: Array) -> Array:
    """The tempered likelihood's covariance, widened where whole runs disagree by more than it says.

    With at least eight runs the sandwich estimate (Huber 1967; score sums by run) is there as well; of both the larger
    standard error of each parameter is taken, with the first one's correlations.
    """
    shape, noise = problem.shape, problem.noise
    prior = np.concatenate([noise / shape.spread**2, noise / shape.rate_spread**2])
    weighted = problem.weight[:, None] * columns
    inverse = np.linalg.inv(columns.T @ weighted + np.diag(prior))
    covariance = noise * inverse
    count = problem.bounds.size
    if count < MIN_RUNS:
        return np.asarray(covariance)
    # Whole runs are independent of one another where readings are not, so scores are summed by run;
    # count / (count - 1) is the usual correction for few of them.
    scores = np.add.reduceat(weighted * error[:, None], problem.bounds) @ inverse
    sandwich = np.sum(scores**2, axis=0) * count / (count - 1)
    widen = np.sqrt(np.maximum(sandwich / np.diag(covariance), 1.0))
    return np.asarray(covariance * np.outer(widen, widen))


def predict(runs: FreeRuns, shape: FitShape, linear: Array, rates: Array, sigma: float) -> Array:
    """(n,) the free run of given parameters; each run's start temperature fitted to its readings.

    The start temperature minimises the Huber loss at the scale `sigma` (degC).
    """
    rows = np.flatnonzero(np.isfinite(runs.reading))
    bounds = np.flatnonzero(np.concatenate([[True], np.diff(runs.run[rows]) != 0]))
    decay, pull = steps(runs, shape, np.log(rates))
    # The free run is linear in its start temperature: the course from 0 plus `begun` times the start.
    still = linear_recursion(decay, pull * (loads(runs, shape) @ linear), 0.0)
    begun = linear_recursion(decay, runs.first.astype(float), 0.0)
    order = np.cumsum(runs.first) - 1
    weight, mean = np.ones(rows.size), still
    # Four rounds of reweighting, each solved run by run: there is one unknown in each, and nothing joins them.
    for _ in range(4):
        missing, start = runs.reading[rows] - still[rows], begun[rows]
        norm = np.add.reduceat(weight * start**2, bounds)
        starts = np.add.reduceat(weight * start * missing, bounds) / np.maximum(norm, 1e-300)
        mean = still + begun * starts[order]
        error = runs.reading[rows] - mean[rows]
        weight = _weights(error, sigma, "huber")
    return mean

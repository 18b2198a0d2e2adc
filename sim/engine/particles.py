"""N runs of the temperature along given paths of locations, in exact steps, and their chance of touching a limit.

Each run stops at its own jumps and at the marks of a common grid; arrays are (S, N), S steps of N runs, and a step that
a run does not need has length 0.

A noisy path may touch the limit b between two points x0 and x1 that are both below it. For an affine flow with a fixed
target the chance of that is

    exp(-2 (b - x0) (b - x1) / V),    V = variance / decay.

It is the Brownian-bridge formula (V = s^2 dt without relaxation) carried through the change of time that makes a
relaxing flow a Brownian motion (V = s^2 sinh(k dt) / k); what is left out is the curvature of the limit in that time,
of second order in k dt. A step over several relaxation times is treated as one over one of them.

A disturbance of heat is drawn exactly at the ends of each step and taken at the mean of both in between, which is right
to second order in the step over its memory; a machine's offset moves the targets. Other effects have an engine of their
own (`sim.engine.particles_augmented`).
"""

from dataclasses import dataclass
from math import exp, isfinite, sqrt

import numpy as np

from sim.effects import disturbance_step
from sim.engine.belief import Belief, Hidden
from sim.engine.tracker import Tracker
from sim.sha import SHA, Array, Indices, Mask, Paths, flows

_LEAST_DECAY = exp(-1.0)


@dataclass(frozen=True, slots=True)
class Steps:
    """What the S steps of N runs do, before anything is known of X; every array is (S, N), times are seconds from now.

    `target` is m + offset (degC for a flow that moves towards it), `noise` the step's own random part and `variance`
    its variance; `drawn` is the temperature that a `resample` draws at the step's start, NaN elsewhere and None where
    no location does. `marks` (G, N) are the rows that end at the grid's points.
    """

    location: Indices
    begin: Array
    dt: Array
    age: Array
    target: Array
    decay: Array
    pull: Array
    variance: Array
    noise: Array
    drawn: Array | None
    marks: Indices


@dataclass(frozen=True, slots=True)
class PathRuns:
    """The temperatures (degC) at both ends of each step, (S, N); `clamps` counts the ends cut to the range."""

    start: Array
    end: Array
    clamps: int


def lay_out(
    tracker: Tracker, belief: Belief, paths: Paths, *, grid: Array, inputs: Array, rng: np.random.Generator
) -> tuple[Steps, Array]:
    """The steps along `paths` with all that is random in them drawn, and the N temperatures that the runs start from.

    `grid` (G,) ascends from above 0 to the horizon; `inputs` (L, 2) are the moments of a stay's offset
    (`semi_markov.input_moments`).
    """
    stay, begin, dt, first, marks = merge(paths, grid)
    # The order of the draws (X and m of the belief, targets, noise, X on entry) is part of a seed's forecast.
    if tracker.plant is None or belief.hidden is None:
        (x0, m0), own = draw_belief(belief, paths.location.shape[1], rng), None
    else:
        own, m0 = draw_states(belief.hidden, paths.location.shape[1], rng)
        x0 = own[:, 0]
    # m + offset of each stay: the belief's in the present one, drawn by its location's laws in the later ones.
    modes = [tracker.modes[place.name].parameter for place in tracker.model.sha.locations]
    mean = np.array([mode[0] for mode in modes]) + inputs[:, 0]
    sigma = np.sqrt(np.array([mode[1] for mode in modes]) + inputs[:, 1] ** 2)
    target = mean[paths.location] + sigma[paths.location] * rng.standard_normal(paths.location.shape)
    target[0] = m0 + belief.offset
    if tracker.plant is not None and own is not None and tracker.plant.machine is not None:
        target += (tracker.plant.rate > 0)[paths.location] * own[:, tracker.plant.offset_state]
    cell = stay * paths.location.shape[1] + np.arange(paths.location.shape[1])
    location = np.take(paths.location, cell)
    age = np.maximum(begin - np.take(paths.entered, cell), 0.0) + np.where(stay == 0, paths.age, 0.0)
    decay, pull, variance = _coefficients(tracker.model.sha, location, age, dt)
    white = rng.standard_normal(dt.shape)
    noise = np.sqrt(variance) * white
    if tracker.plant is not None and own is not None and tracker.plant.disturbance is not None:
        p = tracker.plant.disturbance.params
        step = disturbance_step(p["memory"], tracker.plant.rate[location], dt)
        # What of the disturbance's doing in X its own news do not tell is drawn with the white noise.
        noise = np.sqrt(variance + p["sigma"] ** 2 * step.own) * white
        into, fresh = step.into, p["sigma"] * np.sqrt(step.dd) * rng.standard_normal(dt.shape)
        heat = own[:, tracker.plant.heat_state]
        for row in range(len(dt)):
            noise[row] += step.carried[row] * heat + into[row] * fresh[row]
            heat = step.keep[row] * heat + fresh[row]
    steps = Steps(
        location=location,
        begin=begin,
        dt=dt,
        age=age,
        target=np.take(target, cell),
        decay=decay,
        pull=pull,
        variance=variance,
        noise=noise,
        drawn=drawn_temperatures(tracker, location, first, rng),
        marks=marks,
    )
    return steps, x0


def merge(paths: Paths, grid: Array) -> tuple[Indices, Array, Array, Mask, Indices]:
    """(stay, begin, dt, whether a stay begins with the step) of each step, and the rows that end at the grid's points.

    A jump's place among the steps is its own number plus that of the grid's points before it, so nothing is sorted. At
    one instant the jump comes first; jumps beyond the horizon come after the last point, with length 0.
    """
    jumps = paths.entered[1:]
    runs, columns = jumps.shape[1], np.arange(jumps.shape[1])
    place = np.arange(jumps.shape[0])[:, None] + np.searchsorted(grid, jumps, side="left")
    jumped = np.zeros((jumps.shape[0] + grid.size, runs), dtype=np.bool_)
    jumped[place, columns] = True
    marks = np.nonzero(~jumped.T)[1].reshape(runs, grid.size).T
    ends = np.empty(jumped.shape)
    ends[place, columns] = np.minimum(jumps, grid[-1])
    ends[marks, columns] = grid[:, None]
    begin = np.vstack([np.zeros(runs), ends[:-1]])
    first = np.vstack([np.zeros(runs, dtype=np.bool_), jumped[:-1]])
    return np.cumsum(first, axis=0), begin, ends - begin, first, marks


def _coefficients(sha: SHA, location: Indices, age: Array, dt: Array) -> tuple[Array, Array, Array]:
    """(decay, pull, variance) of each step; sorted by location once: a mask for each location costs twice that."""
    # int16 has a radix sort in numpy: linear in the steps, where the wider integers' merge sort is not.
    order = np.argsort(location.ravel().astype(np.int16), kind="stable")
    ages, steps = age.ravel()[order], dt.ravel()[order]
    ends = np.cumsum(np.bincount(location.ravel(), minlength=len(sha.locations)))
    parts = np.empty((3, steps.size))
    for place, begin, end in zip(sha.locations, [0, *ends], ends, strict=False):
        parts[:, begin:end] = flows.coefficients(place.flow, ages[begin:end], steps[begin:end])
    back = np.empty_like(parts)
    back[:, order] = parts
    decay, pull, variance = back.reshape(3, *dt.shape)
    return decay, pull, variance


def draw_belief(belief: Belief, runs: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """`runs` draws of (X, m), each (runs,), from the belief's joint normal law."""
    # The 2 x 2 Cholesky factor, written out: X first, then m given X. Rounding may leave m's own variance below 0.
    z, w = rng.standard_normal((2, runs))
    share = belief.xm / sqrt(belief.xx) if belief.xx > 0 else 0.0
    own = sqrt(max(belief.mm - share * share, 0.0))
    return belief.x + sqrt(belief.xx) * z, belief.m + share * z + own * w


def draw_states(hidden: Hidden, runs: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """N draws of (states (N, d), m (N,)) from a belief's joint normal law."""
    # Eigenvalues and not Cholesky: states of which one number is known are perfectly correlated.
    values, vectors = np.linalg.eigh(np.array(hidden.covariance))
    spread = vectors * np.sqrt(np.maximum(values, 0.0))
    drawn = np.array(hidden.mean) + rng.standard_normal((runs, len(hidden.mean))) @ spread.T
    return drawn[:, :-1], drawn[:, -1]


def drawn_temperatures(tracker: Tracker, location: Indices, first: Mask, rng: np.random.Generator) -> Array | None:
    """(S, N) the temperature that each step's stay draws, NaN where none is drawn; None where no location draws any."""
    laws = [tracker.modes[place.name].temperature for place in tracker.model.sha.locations]
    if all(law is None for law in laws):
        return None
    mean = np.array([np.nan if law is None else law[0] for law in laws])
    sigma = np.array([0.0 if law is None else sqrt(law[1]) for law in laws])
    values = mean[location] + sigma[location] * rng.standard_normal(location.shape)
    return np.where(first, values, np.nan)


def run(sha: SHA, steps: Steps, x0: Array) -> PathRuns:
    """The runs along `steps` from the temperatures `x0` (N,), by the limits of `sha`: its greatest rate and its range.

    The affine recursion is exact as long as no run meets a limit; when one does, all are done again with them.
    """
    end = np.empty(steps.dt.shape)
    start = np.empty(steps.dt.shape)
    shift = steps.pull * steps.target + steps.noise
    x = x0
    for row in range(len(end)):
        start[row] = x if steps.drawn is None else _entered(x, steps.drawn[row])
        np.multiply(steps.decay[row], start[row], out=end[row])
        end[row] += shift[row]
        x = end[row]
    outside = min(end.min(), start.min()) < sha.low or max(end.max(), start.max()) > sha.high
    return _limited(sha, steps, x0) if outside or _too_fast(sha, steps, start) else PathRuns(start, end, 0)


def _entered(x: Array, drawn: Array) -> Array:
    return np.where(np.isnan(drawn), x, drawn)


def _too_fast(sha: SHA, steps: Steps, start: Array) -> bool:
    """Whether some step begins with a drift beyond the greatest rate (inside a step the drift only shrinks)."""
    if not isfinite(sha.max_rate):
        return False
    for index in np.unique(steps.location):
        rows = steps.location == index
        drift = flows.drift(sha.locations[index].flow, start[rows], steps.target[rows], steps.age[rows])
        if np.any(np.abs(drift) > sha.max_rate):
            return True
    return False


def _limited(sha: SHA, steps: Steps, x0: Array) -> PathRuns:
    """The runs held to the range and to the greatest rate, row by row."""
    start, end = np.empty(steps.dt.shape), np.empty(steps.dt.shape)
    x: Array = np.clip(x0, sha.low, sha.high)
    clamps = int(((x0 < sha.low) | (x0 > sha.high)).sum())
    for row in range(len(end)):
        begins = x if steps.drawn is None else np.clip(_entered(x, steps.drawn[row]), sha.low, sha.high)
        start[row] = begins
        if isfinite(sha.max_rate):
            # Only a rate limit has to be looked at location by location: its closed form is the flow's.
            mean = np.empty(begins.shape)
            for index in np.unique(steps.location[row]):
                inside = steps.location[row] == index
                mean[inside] = flows.mean_step(
                    sha.locations[index].flow,
                    begins[inside],
                    steps.target[row, inside],
                    age=steps.age[row, inside],
                    dt=steps.dt[row, inside],
                    max_rate=sha.max_rate,
                )
        else:
            mean = steps.decay[row] * begins + steps.pull[row] * steps.target[row]
        free = mean + steps.noise[row]
        end[row] = x = np.asarray(np.clip(free, sha.low, sha.high))
        clamps += int((x != free).sum())
    return PathRuns(start, end, clamps)


def survival(start: Array, end: Array, steps: Steps, limit: float, widening: Array | float = 1.0) -> Array:
    """(S, N) the chance that a run has not reached `limit` by the end of each step, given its steps' two ends.

    `widening` is the factor by which the noise in each step was scaled, with its ends.
    """
    bridge = steps.variance / np.maximum(steps.decay, _LEAST_DECAY) * np.square(widening)
    before, after = limit - start, limit - end
    # Steps of length 0 and flows without noise have V = 0 (no chance in between); ends beyond the limit have touched it
    # for certain. Both are set afterwards, whatever the formula makes of them.
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        touched = np.exp(-2.0 * before * after / bridge)
    touched = np.where(bridge > 0, touched, 0.0)
    touched[(before <= 0) | (after <= 0)] = 1.0
    return np.asarray(np.cumprod(1.0 - touched, axis=0))

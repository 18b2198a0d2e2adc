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

from collections.abc import Iterator
from dataclasses import dataclass, fields
from math import exp, isfinite, sqrt

import numpy as np

from sim.effects import DisturbanceStep, disturbance_step
from sim.engine.belief_state import Belief, Hidden
from sim.engine.tracker import Tracker
from sim.sha import SHA, Array, Indices, Mask, Paths, flows

_LEAST_DECAY = exp(-1.0)


BLOCK_ROWS = 16
"""Steps of all runs that are worked out at a time: of their some twenty arrays only five are ever whole, and the rest
stays in the processor's cache."""


@dataclass(frozen=True, slots=True)
class Steps:
    """What some steps of N runs do, before anything is known of X; every array is (rows, N), times are s from now.

    `target` is m + offset (degC for a flow that moves towards it), `noise` the step's own random part and `variance`
    its variance; `drawn` is the temperature that a `resample` draws at the step's start, NaN elsewhere and None where
    no location does.
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


@dataclass(frozen=True, slots=True)
class Heat:
    """A disturbance along S steps of N runs: its `step`, what is new in each, `fresh` (S, N), and `first` (N,)."""

    step: DisturbanceStep
    sigma: float
    fresh: Array
    first: Array


@dataclass(frozen=True, slots=True)
class Layout:
    """S steps of N runs along `paths` with all that is random drawn, from which their arrays are made block by block.

    `ends` (S, N) are when the steps end (s from now), `first` (S, N) whether a stay begins with the step, `marks`
    (G, N) the rows that end at the grid's points; `target` is that of each stay (J, N), `white` (S, N) standard normal.
    """

    tracker: Tracker
    paths: Paths
    ends: Array
    first: Mask
    marks: Indices
    target: Array
    white: Array
    heat: Heat | None
    drawn: Array | None

    def blocks(self) -> Iterator[tuple[slice, Steps]]:
        """The steps, some rows at a time, with their rows."""
        paths, runs = self.paths, self.paths.location.shape[1]
        stay, begins = np.zeros(runs, dtype=np.intp), np.zeros(runs)
        heat = None if self.heat is None else self.heat.first
        for top in range(0, len(self.ends), BLOCK_ROWS):
            rows = slice(top, top + BLOCK_ROWS)
            ends = self.ends[rows]
            stays = stay + np.cumsum(self.first[rows], axis=0)
            begin = np.vstack([begins, ends[:-1]])
            stay, begins, dt = stays[-1], ends[-1], ends - begin
            cell = stays * runs + np.arange(runs)
            location = np.take(paths.location, cell)
            age = np.maximum(begin - np.take(paths.entered, cell), 0.0) + np.where(stays == 0, paths.age, 0.0)
            decay, pull, variance = flows.coefficients_along(self.tracker.flows, location, age, dt)
            if self.heat is None or heat is None:
                noise = np.sqrt(variance) * self.white[rows]
            else:
                noise, heat = _heated(self.heat, rows, variance, self.white[rows], heat)
            steps = Steps(
                location=location,
                begin=begin,
                dt=dt,
                age=age,
                target=np.take(self.target, cell),
                decay=decay,
                pull=pull,
                variance=variance,
                noise=noise,
                drawn=None if self.drawn is None else self.drawn[rows],
            )
            yield rows, steps


@dataclass(frozen=True, slots=True)
class PathRuns:
    """N runs in S steps: when each step ends (s from now), the temperatures (degC) at both its ends, and the `bridge`
    between them (`bridges`), all (S, N); `marks` (G, N) are the rows that end at the grid's points.

    `clamps` counts the ends cut to the range.
    """

    ends: Array
    start: Array
    end: Array
    bridge: Array
    marks: Indices
    clamps: int


def lay_out(
    tracker: Tracker, belief: Belief, paths: Paths, *, grid: Array, inputs: Array, rng: np.random.Generator
) -> tuple[Layout, Array]:
    """The steps along `paths` with all that is random in them drawn, and the N temperatures that the runs start from.

    `grid` (G,) ascends from above 0 to the horizon; `inputs` (L, 2) are the moments of a stay's offset
    (`semi_markov.input_moments`).
    """
    ends, first, marks = merge(paths, grid)
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
    white = rng.standard_normal(ends.shape)
    heat = None
    if tracker.plant is not None and own is not None and tracker.plant.disturbance is not None:
        p = tracker.plant.disturbance.params
        rate = tracker.plant.rate[locations(paths, first)]
        step = disturbance_step(p["memory"], rate, np.diff(ends, axis=0, prepend=0.0))
        fresh = p["sigma"] * np.sqrt(step.dd) * rng.standard_normal(ends.shape)
        heat = Heat(step, p["sigma"], fresh, own[:, tracker.plant.heat_state])
    drawn = drawn_temperatures(tracker, paths, first, rng)
    return Layout(tracker, paths, ends, first, marks, target=target, white=white, heat=heat, drawn=drawn), x0


def _heated(heat: Heat, rows: slice, variance: Array, white: Array, begins: Array) -> tuple[Array, Array]:
    """The noise of some steps under a disturbance that `begins` (N,) with them, and the disturbance at their end."""
    step = DisturbanceStep(*(getattr(heat.step, field.name)[rows] for field in fields(heat.step)))
    into, fresh = step.into, heat.fresh[rows]
    # What of the disturbance's doing in X its own news do not tell is drawn with the white noise.
    noise = np.sqrt(variance + heat.sigma**2 * step.own) * white
    for row in range(len(noise)):
        noise[row] += step.carried[row] * begins + into[row] * fresh[row]
        begins = step.keep[row] * begins + fresh[row]
    return noise, begins


def merge(paths: Paths, grid: Array) -> tuple[Array, Mask, Indices]:
    """(when it ends, whether a stay begins with it) of each step, (S, N), and the rows that end at the grid's points.

    A jump's place among the steps is its own number plus that of the grid's points before it, so nothing is sorted. At
    one instant the jump comes first; jumps beyond the horizon come after the last point, with length 0.
    """
    jumps = paths.entered[1:]
    runs, columns = jumps.shape[1], np.arange(jumps.shape[1])
    place = np.arange(jumps.shape[0])[:, None] + np.searchsorted(grid, jumps, side="left")
    jumped = np.zeros((jumps.shape[0] + grid.size, runs), dtype=np.bool_)
    jumped[place, columns] = True
    marks = np.nonzero(~jumped.T)[1].copy().reshape(runs, grid.size).T  # without what nonzero gives beside it
    ends = np.empty(jumped.shape)
    ends[place, columns] = np.minimum(jumps, grid[-1])
    ends[marks, columns] = grid[:, None]
    return ends, np.vstack([np.zeros(runs, dtype=np.bool_), jumped[:-1]]), marks


def locations(paths: Paths, first: Mask) -> Indices:
    """(S, N) the location of each step, by whether a stay begins with it."""
    return paths.location[np.cumsum(first, axis=0), np.arange(paths.location.shape[1])]


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


def drawn_temperatures(tracker: Tracker, paths: Paths, first: Mask, rng: np.random.Generator) -> Array | None:
    """(S, N) the temperature that each step's stay draws, NaN where none is drawn; None where no location draws any."""
    laws = [tracker.modes[place.name].temperature for place in tracker.model.sha.locations]
    if all(law is None for law in laws):
        return None
    location = locations(paths, first)
    mean = np.array([np.nan if law is None else law[0] for law in laws])
    sigma = np.array([0.0 if law is None else sqrt(law[1]) for law in laws])
    values = mean[location] + sigma[location] * rng.standard_normal(location.shape)
    return np.where(first, values, np.nan)


def run(sha: SHA, layout: Layout, x0: Array) -> PathRuns:
    """The runs along `layout` from the temperatures `x0` (N,), by the limits of `sha`: its greatest rate and its range.

    The affine recursion is exact as long as no run meets a limit; when one does, all are done again with them.
    """
    start, end = _both_ends(layout, x0)
    bridge, fast = np.empty(end.shape), False
    for rows, steps in layout.blocks():
        shift = steps.pull * steps.target
        shift += steps.noise
        for place, row in enumerate(range(rows.start, rows.start + len(shift))):
            if steps.drawn is not None:
                start[row] = _entered(x0 if row == 0 else end[row - 1], steps.drawn[place])
            np.multiply(steps.decay[place], start[row], out=end[row])
            end[row] += shift[place]
        bridge[rows] = bridges(steps.decay, steps.variance)
        if fast := _too_fast(sha, steps, start[rows]):
            break
    if fast or min(end.min(), start.min()) < sha.low or max(end.max(), start.max()) > sha.high:
        return _limited(sha, layout, x0)
    return PathRuns(layout.ends, start, end, bridge, marks=layout.marks, clamps=0)


def _both_ends(layout: Layout, x0: Array) -> tuple[Array, Array]:
    """Room for X at both ends of each step; where nothing is drawn a step begins as the last one ends."""
    path = np.empty((len(layout.ends) + 1, x0.size))
    path[0] = x0
    return path[:-1] if layout.drawn is None else np.empty(layout.ends.shape), path[1:]


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


def _limited(sha: SHA, layout: Layout, x0: Array) -> PathRuns:
    """The runs held to the range and to the greatest rate, row by row."""
    x: Array = np.clip(x0, sha.low, sha.high)
    clamps = int(((x0 < sha.low) | (x0 > sha.high)).sum())
    start, end = _both_ends(layout, x)
    bridge = np.empty(end.shape)
    for rows, steps in layout.blocks():
        for place, row in enumerate(range(rows.start, rows.start + len(steps.dt))):
            begins = x if steps.drawn is None else np.clip(_entered(x, steps.drawn[place]), sha.low, sha.high)
            start[row] = begins
            if isfinite(sha.max_rate):
                # Only a rate limit has to be looked at location by location: its closed form is the flow's.
                mean = np.empty(begins.shape)
                for index in np.unique(steps.location[place]):
                    inside = steps.location[place] == index
                    mean[inside] = flows.mean_step(
                        sha.locations[index].flow,
                        begins[inside],
                        steps.target[place, inside],
                        age=steps.age[place, inside],
                        dt=steps.dt[place, inside],
                        max_rate=sha.max_rate,
                    )
            else:
                mean = steps.decay[place] * begins + steps.pull[place] * steps.target[place]
            free = mean + steps.noise[place]
            end[row] = x = np.asarray(np.clip(free, sha.low, sha.high))
            clamps += int((x != free).sum())
        bridge[rows] = bridges(steps.decay, steps.variance)
    return PathRuns(layout.ends, start, end, bridge, marks=layout.marks, clamps=clamps)


def bridges(decay: Array, variance: Array) -> Array:
    """V of each step (degC^2), by which the chance is taken of a touch between its two ends (see above)."""
    return np.asarray(variance / np.maximum(decay, _LEAST_DECAY))


def survival(
    start: Array, end: Array, bridge: Array, limit: float, widening: Array | float = 1.0, alive: Array | float = 1.0
) -> Array:
    """(S, N) the chance that a run has not reached `limit` by the end of each step, given its steps' two ends.

    `alive` (N,) is that chance before the first step. `widening` is the factor by which the noise in each step was
    scaled, with its ends.
    """
    spread = bridge * np.square(widening)
    before, after = limit - start, limit - end
    # Steps of length 0 and flows without noise have V = 0 (no chance in between); ends beyond the limit have touched it
    # for certain. Both are set afterwards, whatever the formula makes of them.
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        touched = np.exp(-2.0 * before * after / spread)
    touched = np.where(spread > 0, touched, 0.0)
    touched[(before <= 0) | (after <= 0)] = 1.0
    missed = 1.0 - touched
    missed[0] *= alive
    return np.asarray(np.cumprod(missed, axis=0))

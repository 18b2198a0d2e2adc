"""N runs of the temperature along given paths of locations, in exact steps, and their chance of touching a limit.

The runs of one belief are laid out together; those of several beliefs are then joined and go side by side (`joined`).

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

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import exp, inf, isfinite, nan, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.effects import disturbance_step
from sim.engine.belief_state import Belief, Hidden
from sim.engine.tracker import Tracker
from sim.sha import Array, Effect, Indices, Mask, Paths, flows

_MIN_DECAY = exp(-1.0)


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
    """A disturbance of N runs: of all its `effect`, what is drawn of it in S steps, `white` (S, N) standard normal, and
    `first` (N,), degC/s."""

    effect: Effect
    white: Array
    first: Array


@dataclass(frozen=True, slots=True)
class Layout:
    """S steps of N runs along `paths` with all that is random drawn, from which their arrays are made block by block.

    `ends` (S, N) are when the steps end (s from now), `first` (S, N) whether a stay begins with the step, `marks`
    (G, N) the rows that end at the grid's points; `x0` (N,) are the temperatures (degC) that they start from, `target`
    is that of each stay (J, N), `white` (S, N) standard normal.
    """

    tracker: Tracker
    paths: Paths
    x0: Array
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
                noise, heat = self._heated(self.heat, rows, location, dt, variance=variance, begins=heat)
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

    def _heated(
        self, heat: Heat, rows: slice, location: Indices, dt: Array, *, variance: Array, begins: Array
    ) -> tuple[Array, Array]:
        """The noise of some steps under a disturbance that `begins` (N,) with them, and the disturbance after them."""
        p, plant = heat.effect.params, self.tracker.plant
        rate = np.zeros(location.shape) if plant is None else plant.rate[location]
        step = disturbance_step(p["memory"], rate, dt)
        into, fresh = step.coupling, p["sigma"] * np.sqrt(step.dd) * heat.white[rows]
        # What of the disturbance's doing in X its own news do not tell is drawn with the white noise.
        noise = np.sqrt(variance + p["sigma"] ** 2 * step.own) * self.white[rows]
        for row in range(len(noise)):
            noise[row] += step.carried[row] * begins + into[row] * fresh[row]
            begins = step.keep[row] * begins + fresh[row]
        return noise, begins

    def of(self, runs: Indices) -> "Layout":
        """These runs only."""
        paths, heat = self.paths, self.heat
        return replace(
            self,
            paths=replace(
                paths,
                location=paths.location[:, runs],
                entered=paths.entered[:, runs],
                age=np.broadcast_to(paths.age, self.x0.shape)[runs],
            ),
            x0=self.x0[runs],
            ends=self.ends[:, runs],
            first=self.first[:, runs],
            marks=self.marks[:, runs],
            target=self.target[:, runs],
            white=self.white[:, runs],
            heat=heat and replace(heat, white=heat.white[:, runs], first=heat.first[runs]),
            drawn=None if self.drawn is None else self.drawn[:, runs],
        )


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


def draw_layout(
    tracker: Tracker, belief: Belief, paths: Paths, *, grid: Array, inputs: Array, rng: np.random.Generator
) -> Layout:
    """The steps along `paths` with all that is random in them drawn.

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
        begins = own[:, tracker.plant.heat_state]
        heat = Heat(tracker.plant.disturbance, rng.standard_normal(ends.shape), begins)
    drawn = drawn_temperatures(tracker, paths, first, rng)
    return Layout(tracker, paths, x0, ends, first, marks, target=target, white=white, heat=heat, drawn=drawn)


def joined(layouts: Sequence[Layout]) -> Layout:
    """The runs of layouts of one tracker and grid side by side.

    Those that jump less often than others have steps without length at their end.
    """
    one, paths = layouts[0], [layout.paths for layout in layouts]
    heats = [layout.heat for layout in layouts if layout.heat is not None]
    drawn = [layout.drawn for layout in layouts if layout.drawn is not None]
    heat = None
    if heats:
        begins = np.concatenate([heat.first for heat in heats])
        heat = Heat(heats[0].effect, _beside([heat.white for heat in heats], 0.0), begins)
    return Layout(
        tracker=one.tracker,
        paths=Paths(
            _beside([path.location for path in paths], 0),
            _beside([path.entered for path in paths], inf),
            np.concatenate([np.broadcast_to(layout.paths.age, layout.x0.shape) for layout in layouts]),
            sum(path.cut for path in paths),
        ),
        x0=np.concatenate([layout.x0 for layout in layouts]),
        ends=_beside([layout.ends for layout in layouts], one.ends[-1, 0]),
        first=_beside([layout.first for layout in layouts], False),
        marks=np.hstack([layout.marks for layout in layouts]),
        target=_beside([layout.target for layout in layouts], 0.0),
        white=_beside([layout.white for layout in layouts], 0.0),
        heat=heat,
        drawn=_beside(drawn, nan) if drawn else None,
    )


def _beside(parts: Sequence[NDArray[Any]], filler: float) -> NDArray[Any]:
    """Arrays (S, N) side by side, the shorter ones filled up at their end."""
    rows = max(map(len, parts))
    return np.hstack([np.pad(part, ((0, rows - len(part)), (0, 0)), constant_values=filler) for part in parts])


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


def run(layout: Layout) -> PathRuns:
    """The runs along `layout`, by the limits of the automaton: its greatest rate and its range.

    The affine recursion is exact for runs that meet no limit; the others are done again with them.
    """
    tracker, x0 = layout.tracker, layout.x0
    sha = tracker.model.sha
    start, end = _both_ends(layout, x0)
    bridge, met = np.empty(end.shape), np.zeros(x0.size, dtype=np.bool_)
    for rows, steps in layout.blocks():
        shift = steps.pull * steps.target
        shift += steps.noise
        for place, row in enumerate(range(rows.start, rows.start + len(shift))):
            if steps.drawn is not None:
                start[row] = _enter_location(x0 if row == 0 else end[row - 1], steps.drawn[place])
            np.multiply(steps.decay[place], start[row], out=end[row])
            end[row] += shift[place]
        bridge[rows] = bridges(steps.decay, steps.variance)
        if isfinite(sha.max_rate):
            # Inside a step the drift only shrinks: what begins within the limit stays within it.
            drift = flows.drift_along(tracker.flows, steps.location, start[rows], steps.target, steps.age)
            met |= (np.abs(drift) > sha.max_rate).any(axis=0)
    met |= (np.minimum(start, end) < sha.low).any(axis=0) | (np.maximum(start, end) > sha.high).any(axis=0)
    clamps, again = 0, np.flatnonzero(met)
    if again.size:
        limited = _run_with_limits(layout.of(again))
        start[:, again], end[:, again], bridge[:, again] = limited.start, limited.end, limited.bridge
        clamps = limited.clamps
    return PathRuns(layout.ends, start, end, bridge, marks=layout.marks, clamps=clamps)


def _both_ends(layout: Layout, x0: Array) -> tuple[Array, Array]:
    """Room for X at both ends of each step; where nothing is drawn a step begins as the last one ends."""
    path = np.empty((len(layout.ends) + 1, x0.size))
    path[0] = x0
    return path[:-1] if layout.drawn is None else np.empty(layout.ends.shape), path[1:]


def _enter_location(x: Array, drawn: Array) -> Array:
    return np.where(np.isnan(drawn), x, drawn)


def _run_with_limits(layout: Layout) -> PathRuns:
    """The runs held to the range and to the greatest rate, row by row."""
    tracker, x0 = layout.tracker, layout.x0
    sha = tracker.model.sha
    x: Array = np.clip(x0, sha.low, sha.high)
    clamps = int(((x0 < sha.low) | (x0 > sha.high)).sum())
    start, end = _both_ends(layout, x)
    bridge = np.empty(end.shape)
    for rows, steps in layout.blocks():
        for place, row in enumerate(range(rows.start, rows.start + len(steps.dt))):
            begins = x if steps.drawn is None else np.clip(_enter_location(x, steps.drawn[place]), sha.low, sha.high)
            start[row] = begins
            if isfinite(sha.max_rate):
                mean = flows.mean_along(
                    tracker.flows,
                    steps.location[place],
                    begins,
                    steps.target[place],
                    age=steps.age[place],
                    dt=steps.dt[place],
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
    return np.asarray(variance / np.maximum(decay, _MIN_DECAY))


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

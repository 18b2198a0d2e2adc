"""Many stochastic runs of a model along one schedule: exact draws, no time step to choose, vectorised over the runs.

Each run has its own mode parameter in every stay and its own noise in every step. Without a rate limit a run is its
deterministic mean plus a deviation y, and the deviation follows

    y' = decay * y + pull * (m - mean of m) + noise

so that offsets and means never enter the inner loop. Steps that end at neither an event nor an output are composed
into one beforehand (the composition of affine Gaussian steps is one), and a normal m that only one step feels is drawn
together with that step's noise. Both leave the joint law of the outputs as it is.

Under a rate limit or effects a run goes row by row (`_row_runs`). With effects each step is exact in law where it is
linear. Radiation is linearised about the mean course, the same for all runs; what that leaves out is taken for each run
at its step's start.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from math import inf, isfinite

import numpy as np

from sim.effects import sensor_offset, sensor_offsets
from sim.engine.kernel import move
from sim.engine.moment_equations import AffineSteps, affine_steps, augmented_course, free_mean, run_flags, stay_draws
from sim.engine.moments_augmented import drawn_start
from sim.engine.plant import Plant
from sim.engine.recursion import linear_recursion
from sim.engine.schedules import Schedule
from sim.engine.tables import Tables, noise_root
from sim.sha import Array, Distribution, Indices, Mask, distributions, draw_parameter, draw_temperature, flows

CHUNK_RUNS = 8192
"""Runs that go through the steps together: few enough that their working rows stay in the cache."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SimulatedRuns:
    """N runs at the output times `times` (m,), absolute seconds.

    `temperatures` is (N, m) in degC, as the sensor reads them but without its noise (only lag and offset among the
    effects tell the two apart); it lies in memory one output time after the other.
    `location` (m,) is the location index at each output, the same for all runs since the events are given, and
    `final_location` the last one. `clamps` and `limited` (N,) count, for each run, the events and outputs at which it
    was put back to the border of the model's range, and the steps in which it met the maximum rate.
    """

    times: Array
    temperatures: Array
    location: Indices
    clamps: Indices
    limited: Indices
    unmatched: tuple[int, ...] = ()

    @property
    def final_location(self) -> int:
        """The location index after the last output time."""
        return int(self.location[-1])

    @property
    def flags(self) -> tuple[str, ...]:
        """What keeps the runs from being the model's own free course, totals over all runs; empty when nothing does."""
        return run_flags(int(self.clamps.sum()), int(self.limited.sum()), len(self.unmatched))


def simulate(
    steps: Schedule, x0: float | Distribution, runs: int, rng: np.random.Generator, *, out: Array | None = None
) -> SimulatedRuns:
    """`runs` independent runs from `x0`, a temperature (degC) or the law of one, drawn from `rng`.

    Exact in law: m per stay, Gaussian noise per step. Under a rate limit each step takes the limited flow's closed
    form for the run's own X and m and adds the unlimited flow's noise. The temperature is clamped to the SHA's range
    at every event and output time, and clamps are counted. Effects are as exact as docs/effects.md states; each run has
    its own thermostat, housing and lags. Equal arguments and an equal state of `rng` give equal runs.

    The temperatures need runs * m * 8 bytes; `out` (m, runs), one row an output time, takes them instead of fresh
    memory when many simulations follow one another. Raises ValueError for no runs, an unusable start or model, and an
    `out` of another shape.
    """
    if runs < 1:
        raise ValueError(f"a simulation needs at least 1 run, got {runs}")
    law = x0 if isinstance(x0, Distribution) else Distribution("normal", {"mu": float(x0), "sigma": 0.0})
    distributions.check_distribution(law)
    rows = np.empty((steps.times.size, runs)) if out is None else out
    if rows.shape != (steps.times.size, runs):
        raise ValueError(f"out must have the shape (outputs, runs) = {(steps.times.size, runs)}, got {rows.shape}")
    # All that is the same for every run is worked out once, here. Where a rate limit depends on the run's own X and m
    # no mean can be split off; with effects a run has more states than X.
    go: Kernel
    if steps.segments is not None:
        go = partial(_row_runs, augmented_plan(steps, distributions.mean(law)))
    elif isfinite(steps.sha.max_rate):
        go = partial(_row_runs, _LimitedPlan(steps, np.sqrt(affine_steps(steps).noise)))
    else:
        start = distributions.mean(law)
        go = partial(_free_runs, _free_plan(steps, affine_steps(steps), start), start)
    clamps, limited = np.zeros(runs, dtype=np.intp), np.zeros(runs, dtype=np.intp)
    for first in range(0, runs, CHUNK_RUNS):
        part = slice(first, min(first + CHUNK_RUNS, runs))
        begins = distributions.draw(law, part.stop - part.start, rng)
        go(begins, rng, rows[:, part], clamps[part], limited[part])
    return SimulatedRuns(
        times=steps.times,
        temperatures=rows.T,
        location=steps.output_location,
        clamps=clamps,
        limited=limited,
        unmatched=steps.unmatched,
    )


Kernel = Callable[[Array, np.random.Generator, Array, Indices, Indices], None]
"""Takes start temperatures (runs,) along the steps: fills (outputs, runs), adds to the counts of clamps and limits."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Free:
    """One step of the deviation y: draw y and m anew where a law is given, step, hold y in `low`..`high`, write out."""

    fresh_law: Distribution | None
    fresh_mean: float
    mode_law: Distribution | None
    mode_mean: float
    decay: float
    pull: float
    sigma: float
    low: float
    high: float
    mean: float
    output: int


def _free_plan(steps: Schedule, affine: AffineSteps, x0: float) -> list[_Free]:
    ends = steps.checked
    begins = np.concatenate([[True], ends[:-1]])
    # Steps up to the next check are composed into one: an affine Gaussian step after another is one again. The
    # recursions start anew wherever a group begins.
    going_on = np.where(begins, 0.0, affine.decay)
    decay = linear_recursion(going_on, np.where(begins, affine.decay, 0.0), 0.0)[ends]
    pull = linear_recursion(going_on, affine.pull, 0.0)[ends]
    variance = linear_recursion(going_on**2, affine.noise, 0.0)[ends]
    mean = free_mean(steps, affine, x0)[ends]
    spread, scatter, renewed = affine.drawn.spread[begins], affine.drawn.scatter[begins], affine.drawn.resampled[begins]
    location, entry = steps.location[begins], steps.entry[begins]
    fresh, mode = _laws(steps)
    normal_x, normal_m = (
        np.array([law is None or law.kind == "normal" for law in laws])[location] for laws in (fresh, mode)
    )
    low, high = steps.sha.low - mean, steps.sha.high - mean
    idle = (decay == 1) & (pull == 0) & (variance == 0) & ~renewed & (np.arange(mean.size) > 0)
    low[idle], high[idle] = -inf, inf  # X has not moved since it was last checked

    # A normal m that one step alone depends on is one noise with that step's own, and a normal X on entry one with the
    # noise of the step that follows: nothing else ever sees them, so one draw stands for both.
    stay = np.cumsum(entry) - 1
    dependent = np.bincount(stay, weights=pull != 0)[stay]
    alone, merged = normal_m & (dependent <= 1), renewed & normal_x
    variance += np.where(alone, pull**2 * spread, 0.0) + np.where(merged, decay**2 * scatter, 0.0)
    pull[alone | (spread == 0)] = 0.0
    decay[merged] = 0.0
    draws_x, draws_m = renewed & ~normal_x, entry & ~alone & (dependent > 0) & (spread > 0)
    columns = (
        draws_x,
        draws_m,
        location,
        affine.drawn.fresh[begins],
        affine.drawn.mode[begins],
        decay,
        pull,
        np.sqrt(variance),
        low,
        high,
        mean,
        steps.output[ends],
    )
    # Lists and not arrays: the loop over the steps takes them number by number, and a number out of an array is slow.
    return [
        _Free(
            fresh_law=fresh[place] if new_x else None,
            fresh_mean=mean_x,
            mode_law=mode[place] if new_m else None,
            mode_mean=mean_m,
            decay=decay_,
            pull=pull_,
            sigma=sigma,
            low=low_,
            high=high_,
            mean=mean_,
            output=output,
        )
        for new_x, new_m, place, mean_x, mean_m, decay_, pull_, sigma, low_, high_, mean_, output in zip(
            *(column.tolist() for column in columns), strict=True
        )
    ]


def _laws(steps: Schedule) -> tuple[list[Distribution | None], list[Distribution | None]]:
    """For each location the laws from which X and m are drawn on entry."""
    locations = steps.sha.locations
    return [draw_temperature(each) for each in locations], [draw_parameter(each) for each in locations]


def _free_runs(
    plan: list[_Free],
    x0: float,
    x: Array,
    rng: np.random.Generator,
    out: Array,
    clamps: Indices,
    _limited: Indices,
) -> None:
    # In place, on rows that fit the cache (CHUNK_RUNS): this loop is where a simulation spends its time. The extremes
    # are looked at first because a mask of the runs outside is nearly always empty.
    y = x - x0
    noise, pushed, mode = np.empty_like(y), np.empty_like(y), np.zeros_like(y)
    for step in plan:
        if step.fresh_law is not None:
            np.subtract(distributions.draw(step.fresh_law, y.size, rng), step.fresh_mean, out=y)
        if step.mode_law is not None:
            np.subtract(distributions.draw(step.mode_law, y.size, rng), step.mode_mean, out=mode)
        if step.decay != 1.0:
            y *= step.decay
        if step.pull:
            y += np.multiply(mode, step.pull, out=pushed)
        if step.sigma:
            rng.standard_normal(out=noise)
            noise *= step.sigma
            y += noise
        if y.min() < step.low or y.max() > step.high:
            clamps += (y < step.low) | (y > step.high)
            np.clip(y, step.low, step.high, out=y)
        if step.output >= 0:
            np.add(y, step.mean, out=out[step.output])


@dataclass(frozen=True, slots=True)
class SamplingPlan:
    """A schedule with effects made ready for runs: the steps' tables, roots of their noise (n, d, d), and how much too
    high the sensor reads at each output (degC)."""

    schedule: Schedule
    plant: Plant
    steps: Tables
    closed: Array
    open: Array
    read_offset: Array

    def start(self, x: Array, rng: np.random.Generator) -> Array:
        """(N, d) states of runs whose first readings are `x` (N,)."""
        return drawn_start(self.plant, x, sensor_offset(self.schedule.sha, self.schedule.start), rng)

    def advance(
        self, row: int, s: Array, mode: Array, opened: Mask, rng: np.random.Generator
    ) -> tuple[Array, Mask, Mask]:
        """(states, thermostat open, rate limit met) of the runs after a step; each has its own thermostat."""
        # The same numbers serve an open and a closed thermostat: how many are drawn does not depend on the run.
        drawn = rng.standard_normal((len(s), self.plant.size))
        noise = drawn @ self.closed[row].T
        if opened.any():
            noise = np.where(opened[:, None], drawn @ self.open[row].T, noise)
        moved = move(self.plant, self.steps, row, s=s, mode=mode, opened=opened, noise=noise)
        return moved.s, moved.opened, moved.met

    def readings(self, s: Array, output: int) -> Array:
        """(N,) what the sensor reads at the output time."""
        return np.asarray(s[:, self.plant.sensor_state] + self.read_offset[output])


def augmented_plan(steps: Schedule, x0: float) -> SamplingPlan:
    """The plan of runs under effects whose first reading has the mean `x0` (degC)."""
    plant, _, course = augmented_course(steps, x0)
    closed, other = course.steps.closed, course.steps.open
    roots = noise_root(closed)
    return SamplingPlan(
        schedule=steps,
        plant=plant,
        steps=course.steps,
        closed=roots,
        open=roots if other is None else noise_root(other),
        read_offset=sensor_offsets(steps.sha, steps.times),
    )


@dataclass(frozen=True, slots=True)
class _LimitedPlan:
    """The same of X alone, (N, 1), under a rate limit that depends on the run's own X and m; `sigma` (n,) is noise."""

    schedule: Schedule
    sigma: Array

    def start(self, x: Array, _rng: np.random.Generator) -> Array:
        return x[:, None]

    def advance(
        self, row: int, s: Array, mode: Array, opened: Mask, rng: np.random.Generator
    ) -> tuple[Array, Mask, Mask]:
        steps, x = self.schedule, s[:, 0]
        flow, rate, age = steps.sha.locations[steps.location[row]].flow, steps.sha.max_rate, steps.age[row]
        target = mode + steps.offset[row]
        met = np.abs(flows.drift(flow, x, target, age)) > rate
        # The mean is limited, the noise is the free flow's: the semantics of the model, not an approximation to it.
        x = flows.mean_step(flow, x, target, age=age, dt=steps.dt[row], max_rate=rate)
        if self.sigma[row]:
            x = x + self.sigma[row] * rng.standard_normal(x.size)
        return x[:, None], opened, met

    def readings(self, s: Array, _output: int) -> Array:
        return s[:, 0]


def _row_runs(
    plan: SamplingPlan | _LimitedPlan,
    x: Array,
    rng: np.random.Generator,
    out: Array,
    clamps: Indices,
    limited: Indices,
) -> None:
    """Runs that cannot be parted into a mean and a deviation: each step for each run's own state."""
    steps = plan.schedule
    drawn, (fresh, laws) = stay_draws(steps), _laws(steps)
    s, mode, opened = plan.start(x, rng), np.zeros(x.size), np.zeros(x.size, dtype=np.bool_)
    low, high = steps.sha.low, steps.sha.high
    for row, place in enumerate(steps.location.tolist()):
        # X before m, both before the step's noise: a seed's runs depend on the order.
        if drawn.resampled[row] and (renewal := fresh[place]) is not None:
            s[:, 0] = distributions.draw(renewal, x.size, rng)
        if steps.entry[row]:
            law = laws[place]
            mode = np.full(x.size, drawn.mode[row]) if law is None else distributions.draw(law, x.size, rng)
        if steps.dt[row] > 0:
            s, opened, met = plan.advance(row, s, mode, opened, rng)
            limited += met
        if steps.checked[row] and (s[:, 0].min() < low or s[:, 0].max() > high):
            clamps += (s[:, 0] < low) | (s[:, 0] > high)
            s[:, 0] = np.clip(s[:, 0], low, high)
        if steps.output[row] >= 0:
            out[steps.output[row]] = plan.readings(s, int(steps.output[row]))

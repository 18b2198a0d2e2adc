"""Mean and variance of the temperature along a schedule in closed form: the deterministic run of a model."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import isfinite, nan

import numpy as np

from sim.effects import check_sha, sensor_offset, sensor_offsets
from sim.engine.moments_augmented import DrawnMoments, MeanCourse, covariance, mean_course, start_state
from sim.engine.plant import Plant, compile_plant
from sim.engine.recursion import MAX_LOOP_STEPS, linear_recursion
from sim.engine.schedules import Schedule, step_coefficients
from sim.engine.tables import Tables
from sim.engine.terms import Segments
from sim.sha import Array, Indices, distributions, draw_temperature, flows, mode_parameter


@dataclass(frozen=True, slots=True)
class Prediction:
    """What a model foresees at `times` (m,), absolute seconds, when the events are given and nothing is measured.

    `mean` (degC) and `variance` (degC^2, without the sensor's noise) are (m,); they are those of what the sensor reads,
    which only lag and offset among the effects tell from the temperature itself. `location` (m,) is the index into the
    SHA's locations after the events of each instant. `clamps` counts the events and output times at which the mean had
    left the model's range and was put back to its border, `limited` the steps that ran at the model's maximum rate,
    `unmatched` holds the indices of events without an edge that a policy passed over.
    """

    times: Array
    mean: Array
    variance: Array
    location: Indices
    clamps: int = 0
    limited: int = 0
    unmatched: tuple[int, ...] = ()

    @property
    def flags(self) -> tuple[str, ...]:
        """What keeps the run from being the model's own free course, one sentence each; empty when nothing does."""
        return run_flags(self.clamps, self.limited, len(self.unmatched))


def run_flags(clamps: int, limited: int, unmatched: int) -> tuple[str, ...]:
    """The sentences of a run's flags."""
    flags = (
        (clamps, f"clamps: the temperature left the model's range {clamps} times and was put back to its border"),
        (limited, f"rate limit: {limited} steps ran at the maximum rate, which a closed-form variance does not see"),
        (unmatched, f"events: {unmatched} had no edge and were passed over"),
    )
    return tuple(sentence for count, sentence in flags if count)


@dataclass(frozen=True, slots=True, kw_only=True)
class AffineSteps:
    """The steps of a schedule without effects as x' = decay * x + pull * (m + offset) + noise; all arrays (n,).

    `noise` is the noise's variance, `limit` the |m + offset - x| above which a step meets the maximum rate. `drawn` is
    what the stays draw.
    """

    decay: Array
    pull: Array
    noise: Array
    limit: Array
    drawn: DrawnMoments


def affine_steps(steps: Schedule) -> AffineSteps:
    """The coefficients of every step. Raises ValueError, naming the location, for a model that cannot be executed."""
    check_sha(steps.sha)
    decay, pull, noise = step_coefficients(steps)
    limit = np.array([flows.free_distance(place.flow, steps.sha.max_rate) for place in steps.sha.locations])
    return AffineSteps(decay=decay, pull=pull, noise=noise, limit=limit[steps.location], drawn=stay_draws(steps))


def moments(steps: Schedule, x0: float, variance0: float = 0.0) -> Prediction:
    """Mean and variance of X at the output times, from X0 with mean `x0` (degC) and variance `variance0`.

    Exact for flows without a rate limit, with the covariance of X and m within a stay. Under a rate limit the mean is
    the limited flow's closed form at the mean m, and the variance that of the unlimited flow. The mean is clamped to
    the SHA's range at every event and output time; clamps are counted, and the variance does not see them. With
    effects a thermostat switches as the mean says, radiation is linearised about the mean, and the rate limit holds for
    the whole drift (docs/effects.md states the accuracy of each). Raises ValueError when `x0` or `variance0` is no
    number, the variance is negative, or the model cannot be executed.
    """
    if not (isfinite(x0) and isfinite(variance0) and variance0 >= 0):
        raise ValueError(f"a run needs a start temperature and a variance of at least 0, got {x0} and {variance0}")
    if steps.segments is None:
        affine = affine_steps(steps)
        mean, clamps, limited = _mean(steps, affine, x0)
        variance = _variance(steps, affine, variance0)
    else:
        plant, drawn, course = augmented_course(steps, x0)
        mean, clamps, limited = _readings(steps, steps.segments, plant, course), course.clamps, course.limited
        variance = covariance(plant, course, drawn, variance0)
    ends = steps.output >= 0
    return Prediction(
        times=steps.times,
        mean=mean[ends],
        variance=variance[ends],
        location=steps.output_location,
        clamps=clamps,
        limited=limited,
        unmatched=steps.unmatched,
    )


def mean_readings(steps: Schedule, x0: float, drawn: DrawnMoments) -> Array:
    """(n,) the mean of what the sensor reads after each step, from the reading `x0` (degC), when stays draw `drawn`."""
    if steps.segments is None:
        affine = replace(affine_steps(steps), drawn=drawn)
        return _mean(steps, affine, x0, loop=steps.dt.size <= MAX_LOOP_STEPS)[0]
    plant, _, course = augmented_course(steps, x0, drawn)
    return _readings(steps, steps.segments, plant, course)


def mean_outputs(steps: Schedule, runs: Sequence[tuple[float, Array | float]]) -> list[Array]:
    """(m,) each: the mean at the output times of several runs of one schedule, as `moments` has it.

    A run is its first reading and by how much its targets lie above the model's, step by step (n,) or all alike, both
    degC. What the steps do to the state is worked out once for all. Raises ValueError as `moments` does.
    """
    draws, ends = stay_draws(steps), steps.output >= 0
    moved = [(x0, replace(draws, mode=draws.mode + higher)) for x0, higher in runs]
    if steps.segments is None:
        affine = affine_steps(steps)
        return [_mean(steps, replace(affine, drawn=drawn), x0)[0][ends] for x0, drawn in moved]
    found, known = [], None
    for x0, drawn in moved:
        plant, _, course = augmented_course(steps, x0, drawn, known)
        known = course.steps
        found.append(_readings(steps, steps.segments, plant, course)[ends])
    return found


def stay_draws(steps: Schedule) -> DrawnMoments:
    """What the stays of a schedule draw by their locations' laws, step by step."""
    rows = []
    for place in steps.sha.locations:
        law = draw_temperature(place)  # None where X goes on: NaN in the table
        renewal = (nan, 0.0) if law is None else (distributions.mean(law), distributions.variance(law))
        rows.append((*mode_parameter(place), *renewal))
    mode, spread, fresh, scatter = np.array(rows).T[:, steps.location]
    resampled = steps.entry & ~np.isnan(fresh)
    resampled[0] = False  # X is given at the start
    return DrawnMoments(
        mode=mode,
        spread=spread,
        resampled=resampled,
        fresh=np.nan_to_num(fresh),
        scatter=scatter,
        entry=steps.entry,
        checked=steps.checked,
    )


def augmented_course(
    steps: Schedule, x0: float, drawn: DrawnMoments | None = None, known: Tables | None = None
) -> tuple[Plant, DrawnMoments, MeanCourse]:
    """The mean course of a schedule with effects from the reading `x0` (degC); for `known` see `mean_course`.

    Raises ValueError as `moments` does.
    """
    check_sha(steps.sha)
    if steps.segments is None:
        raise ValueError(f"SHA {steps.sha.name!r} has no effects: its course is that of `moments`")
    plant, drawn = compile_plant(steps.sha), stay_draws(steps) if drawn is None else drawn
    start = start_state(plant, x0, sensor_offset(steps.sha, steps.start))
    return plant, drawn, mean_course(plant, steps.segments, drawn, start, known=known)


def _readings(steps: Schedule, segments: Segments, plant: Plant, course: MeanCourse) -> Array:
    """(n,) what the sensor reads after each step of a course."""
    offset = sensor_offsets(steps.sha, segments.time + steps.dt)
    # At the outputs' own times: begin + length may miss the very moment of a sensor step by a rounding.
    offset[steps.output >= 0] = sensor_offsets(steps.sha, steps.times)
    return np.asarray(course.s[:, plant.sensor_state] + offset)


def free_mean(steps: Schedule, affine: AffineSteps, x0: float) -> Array:
    """(n,) the mean after each step without clamps and rate limit."""
    return _mean_recursion(affine, affine.pull * (affine.drawn.mode + steps.offset), x0)


def _mean_recursion(affine: AffineSteps, added: Array, x0: float, *, loop: bool = False) -> Array:
    drawn = affine.drawn
    renewed = np.where(drawn.resampled, affine.decay * drawn.fresh, 0.0)
    return linear_recursion(np.where(drawn.resampled, 0.0, affine.decay), added + renewed, x0, loop=loop)


def _variance(steps: Schedule, affine: AffineSteps, variance0: float) -> Array:
    """Var X after each step; the covariance with m comes first and starts at 0 in each stay."""
    decay, pull, drawn = affine.decay, affine.pull, affine.drawn
    # Var X' = a^2 Var X + 2 a p Cov(X, m) + p^2 Var m + noise, with the covariance before the step. On entry it is 0: m
    # is new and independent of X.
    covariance = linear_recursion(np.where(steps.entry, 0.0, decay), pull * drawn.spread, 0.0)
    before = np.where(steps.entry, 0.0, np.concatenate([[0.0], covariance[:-1]]))
    added = 2.0 * decay * pull * before + pull**2 * drawn.spread + affine.noise
    renewed = np.where(drawn.resampled, decay**2 * drawn.scatter, 0.0)
    return linear_recursion(np.where(drawn.resampled, 0.0, decay**2), added + renewed, variance0)


def _mean(steps: Schedule, affine: AffineSteps, x0: float, *, loop: bool = False) -> tuple[Array, int, int]:
    """The mean after each step, the number of clamps and the number of limited steps.

    A clamp, or a rate limit that depends on X, makes the recursion non-linear: up to the first of them it is solved as
    a whole, and from there on step by step over floats.
    """
    sha, drawn = steps.sha, affine.drawn
    target = drawn.mode + steps.offset
    added, met = _increments(steps, affine.pull * target, target)
    mean = _mean_recursion(affine, added, x0, loop=loop)
    before = np.where(drawn.resampled, drawn.fresh, np.concatenate([[x0], mean[:-1]]))
    odd = (np.abs(target - before) > affine.limit) & (steps.dt > 0)
    odd |= drawn.checked & ((mean < sha.low) | (mean > sha.high))
    if not odd.any():
        return mean, 0, met
    first, clamps = int(np.argmax(odd)), 0
    renewed = np.where(drawn.resampled, drawn.fresh, nan)
    columns = (affine.decay, added, target, affine.limit, renewed, drawn.checked)
    rows = zip(*(column[first:].tolist() for column in columns), strict=True)
    x = float(before[first])
    for k, (decay, gain, towards, limit, fresh, checked) in enumerate(rows, start=first):
        if fresh == fresh:  # not NaN
            x = fresh
        if abs(towards - x) > limit and steps.dt[k] > 0:
            flow = sha.locations[steps.location[k]].flow
            x = float(flows.mean_step(flow, x, towards, age=steps.age[k], dt=steps.dt[k], max_rate=sha.max_rate))
            met += 1
        else:
            x = decay * x + gain
        if checked and not sha.low <= x <= sha.high:
            x = min(max(x, sha.low), sha.high)
            clamps += 1
        mean[k] = x
    return mean, clamps, met


def _increments(steps: Schedule, free: Array, target: Array) -> tuple[Array, int]:
    """What each step adds to decay * x, limited where the drift does not depend on x, and how many steps that met."""
    added, met, rate = free.copy(), 0, steps.sha.max_rate
    for index in np.unique(steps.location).tolist() if isfinite(rate) else ():
        flow = steps.sha.locations[index].flow
        if flow.kind in flows.RELAXING_FLOWS:
            continue
        rows = np.flatnonzero((steps.location == index) & (steps.dt > 0))
        added[rows] = flows.mean_step(flow, 0.0, target[rows], age=steps.age[rows], dt=steps.dt[rows], max_rate=rate)
        met += int(np.count_nonzero(np.abs(flows.drift(flow, 0.0, target[rows], steps.age[rows])) > rate))
    return added, met

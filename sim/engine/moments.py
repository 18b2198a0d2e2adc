"""Mean and variance of the temperature along a schedule in closed form: the deterministic run of a model."""

from dataclasses import dataclass
from math import isfinite, nan

import numpy as np

from sim.effects.kinds import sensor_offset, sensor_offsets
from sim.engine.course import DrawnMoments, MeanCourse, covariance, mean_course, start_state
from sim.engine.plant import Plant, compile_plant
from sim.engine.recursion import linear_recursion
from sim.engine.schedule import Indices, Schedule, step_coefficients
from sim.sha import distributions, flows
from sim.sha.automaton import Location
from sim.sha.entry import check_sha, drawn_temperature, mode_parameter
from sim.sha.trace import Array, Mask


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
    said = (
        (clamps, f"clamps: the temperature left the model's range {clamps} times and was put back to its border"),
        (limited, f"rate limit: {limited} steps ran at the maximum rate, which a closed-form variance does not see"),
        (unmatched, f"events: {unmatched} had no edge and were passed over"),
    )
    return tuple(sentence for count, sentence in said if count)


@dataclass(frozen=True, slots=True)
class Affine:
    """The steps as x' = decay * x + pull * (m + offset) + noise, and what happens before each; all arrays (n,).

    `mode` and `spread` are mean and variance of the stay's m. `resampled` steps begin with X drawn anew, with the mean
    `fresh` and the variance `scatter`. `limit` is the |m + offset - x| above which a step meets the maximum rate.
    """

    decay: Array
    pull: Array
    noise: Array
    mode: Array
    spread: Array
    resampled: Mask
    fresh: Array
    scatter: Array
    limit: Array


def affine_steps(steps: Schedule) -> Affine:
    """The coefficients of every step. Raises ValueError, naming the location, for a model that cannot be executed."""
    check_sha(steps.sha)
    decay, pull, noise = step_coefficients(steps)
    table = np.array(
        [
            (*mode_parameter(location), *_renewal(location), flows.free_distance(location.flow, steps.sha.max_rate))
            for location in steps.sha.locations
        ]
    )
    mode, spread, fresh, scatter, limit = table.T[:, steps.location]
    resampled = steps.entry & ~np.isnan(fresh)
    resampled[0] = False
    return Affine(decay, pull, noise, mode, spread, resampled, fresh, scatter, limit)


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
    if steps.segments is not None:
        return _augmented(steps, x0, variance0)
    affine = affine_steps(steps)
    mean, clamps, limited = _mean(steps, affine, x0)
    ends = steps.output >= 0
    return Prediction(
        times=steps.times,
        mean=mean[ends],
        variance=_variance(steps, affine, variance0)[ends],
        location=steps.output_location,
        clamps=clamps,
        limited=limited,
        unmatched=steps.unmatched,
    )


def stay_draws(steps: Schedule) -> DrawnMoments:
    """What the stays of a schedule draw, step by step."""
    table = np.array([(*mode_parameter(place), *_renewal(place)) for place in steps.sha.locations])
    mode, spread, fresh, scatter = table.T[:, steps.location]
    resampled = steps.entry & ~np.isnan(fresh)
    resampled[0] = False
    return DrawnMoments(mode, spread, resampled, np.nan_to_num(fresh), scatter, steps.entry, steps.checked)


def augmented_course(steps: Schedule, x0: float) -> tuple[Plant, DrawnMoments, MeanCourse]:
    """The mean course of a schedule with effects from the reading `x0` (degC). Raises ValueError as `moments` does."""
    check_sha(steps.sha)
    if steps.segments is None:
        raise ValueError(f"SHA {steps.sha.name!r} has no effects: its course is that of `moments`")
    plant, drawn = compile_plant(steps.sha), stay_draws(steps)
    start = start_state(plant, x0, sensor_offset(steps.sha, steps.start))
    return plant, drawn, mean_course(plant, steps.segments, drawn, start)


def _augmented(steps: Schedule, x0: float, variance0: float) -> Prediction:
    plant, drawn, course = augmented_course(steps, x0)
    ends = steps.output >= 0
    return Prediction(
        times=steps.times,
        mean=course.s[ends, plant.sensed] + sensor_offsets(steps.sha, steps.times),
        variance=covariance(plant, course, drawn, variance0)[ends],
        location=steps.output_location,
        clamps=course.clamps,
        limited=course.limited,
        unmatched=steps.unmatched,
    )


def free_mean(steps: Schedule, affine: Affine, x0: float) -> Array:
    """(n,) the mean after each step without clamps and rate limit."""
    return _recursion(affine, affine.pull * (affine.mode + steps.offset), x0)


def _recursion(affine: Affine, added: Array, x0: float) -> Array:
    renewed = np.where(affine.resampled, affine.decay * affine.fresh, 0.0)
    return linear_recursion(np.where(affine.resampled, 0.0, affine.decay), added + renewed, x0)


def _variance(steps: Schedule, affine: Affine, variance0: float) -> Array:
    """Var X after each step; the covariance with m comes first and starts at 0 in each stay."""
    decay, pull = affine.decay, affine.pull
    covariance = linear_recursion(np.where(steps.entry, 0.0, decay), pull * affine.spread, 0.0)
    before = np.where(steps.entry, 0.0, np.concatenate([[0.0], covariance[:-1]]))
    added = 2.0 * decay * pull * before + pull**2 * affine.spread + affine.noise
    renewed = np.where(affine.resampled, decay**2 * affine.scatter, 0.0)
    return linear_recursion(np.where(affine.resampled, 0.0, decay**2), added + renewed, variance0)


def _mean(steps: Schedule, affine: Affine, x0: float) -> tuple[Array, int, int]:
    """The mean after each step, the number of clamps and the number of limited steps."""
    target = affine.mode + steps.offset
    added, limited = _increments(steps, affine.pull * target, target)
    mean = _recursion(affine, added, x0)
    before = np.where(affine.resampled, affine.fresh, np.concatenate([[x0], mean[:-1]]))
    odd = (np.abs(target - before) > affine.limit) & (steps.dt > 0)
    odd |= steps.checked & ((mean < steps.sha.low) | (mean > steps.sha.high))
    if not odd.any():
        return mean, 0, limited
    clamps, met = _walk_on(steps, affine, added, mean, before, int(np.argmax(odd)))
    return mean, clamps, limited + met


def _increments(steps: Schedule, free: Array, target: Array) -> tuple[Array, int]:
    """What each step adds to decay * x, limited where the drift does not depend on x, and how many steps that met."""
    added, met, rate = free.copy(), 0, steps.sha.max_rate
    for index in np.unique(steps.location).tolist() if isfinite(rate) else ():
        flow = steps.sha.locations[index].flow
        if flow.kind in flows.RELAXING:
            continue
        rows = np.flatnonzero((steps.location == index) & (steps.dt > 0))
        added[rows] = flows.mean_step(flow, 0.0, target[rows], steps.age[rows], steps.dt[rows], rate)
        met += int(np.count_nonzero(np.abs(flows.drift(flow, 0.0, target[rows], steps.age[rows])) > rate))
    return added, met


def _walk_on(steps: Schedule, affine: Affine, added: Array, mean: Array, before: Array, first: int) -> tuple[int, int]:
    """Rewrites `mean` from step `first` on, which meets a clamp or the rate limit; returns how many did.

    Either makes the recursion non-linear, so this is a plain loop over floats.
    """
    sha, clamps, met = steps.sha, 0, 0
    rest = slice(first, None)
    renewed = np.where(affine.resampled, affine.fresh, nan)
    columns = (affine.decay, added, affine.mode + steps.offset, affine.limit, renewed, steps.checked)
    rows = zip(*(column[rest].tolist() for column in columns), strict=True)
    x = float(before[first])
    for k, (decay, gain, target, limit, drawn, checked) in enumerate(rows, start=first):
        if drawn == drawn:  # not NaN
            x = drawn
        if abs(target - x) > limit and steps.dt[k] > 0:
            flow = sha.locations[steps.location[k]].flow
            x = float(flows.mean_step(flow, x, target, steps.age[k], steps.dt[k], sha.max_rate))
            met += 1
        else:
            x = decay * x + gain
        if checked and not sha.low <= x <= sha.high:
            x = min(max(x, sha.low), sha.high)
            clamps += 1
        mean[k] = x
    return clamps, met


def _renewal(location: Location) -> tuple[float, float]:
    """Mean and variance of X on entry; NaN where X goes on."""
    law = drawn_temperature(location)
    return (nan, 0.0) if law is None else (distributions.mean(law), distributions.variance(law))

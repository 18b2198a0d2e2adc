"""One step of N runs with all that is not linear: thermostat, what radiation's tangent leaves out, the rate limit.

A thermostat switches inside a step, where the run crosses its threshold. An excursion beyond it that begins and ends
inside one step is not seen.
"""

from dataclasses import dataclass
from math import inf

import numpy as np

from sim.effects import parameter
from sim.engine.plant import Indices, Plant
from sim.engine.response import step_answer
from sim.engine.tables import Half, Tables
from sim.sha import Array, Mask

Rows = int | slice

_SECANT_STEPS = 4
"""Steps of the secant search for a crossing. Inside a segment, at most a fifth of X's fastest time constant long
(`cuts`), X is nearly a straight line, on which the first step is exact; the method's order is 1.6 from there."""
_MAX_SWITCHES = 8
"""Switches of one run in one segment at most: a valve that hunts faster than that is finer than any record shows."""


def is_valve_open(plant: Plant, x: Array, opened: Mask) -> Mask:
    """(N,) whether the thermostat is open at the temperatures `x`, given whether it was."""
    if plant.thermostat is None:
        return opened
    p = plant.thermostat.effect.params
    return np.asarray((opened & (x > p["closes"])) | (x >= p["opens"]))


@dataclass(frozen=True, slots=True)
class Moved:
    """N runs after a step: states `s` (N, d), thermostat `opened` (N,), whether the rate limit was `met` (N,).

    `share` (N,) is the part of the step during which the thermostat was open.
    """

    s: Array
    opened: Mask
    met: Mask
    share: Array


def move(
    plant: Plant, steps: Tables, row: Rows, *, s: Array, mode: Array, opened: Mask, noise: Array | float = 0.0
) -> Moved:
    """The runs after the step `row` from the states `s` (N, d).

    `row` is one step for all runs, or a slice of N steps, one for each. `mode` (N,) is m, `opened` (N,) the thermostat
    after the last step, `noise` (N, d) the step's noise.
    """
    # In this order: the thermostat as the state says it, the linear step, the rate limit, the noise, and last the runs
    # whose end lies beyond a threshold, which are cut where they crossed it.
    opened = is_valve_open(plant, s[:, 0], opened)  # a jump of X, or the range's clamp, may have passed a threshold
    # What radiation's tangent leaves out is a heat of second order in y, taken at the step's start: (a + y)^4 less its
    # tangent is what is left of the binomial.
    rest = None
    if steps.about is not None and steps.radiated is not None and plant.radiation is not None:
        away = steps.about[row] - parameter(plant.radiation.effect, "zero")
        y = s[:, 0] - steps.about[row]
        rest = np.asarray(-steps.radiated[row] * y * y * (6.0 * away * away + 4.0 * away * y + y * y))
    if steps.open is None or not opened.any():
        after = _affine(steps.closed, row, s, mode, rest)
    elif opened.all():
        after = _affine(steps.open, row, s, mode, rest)
    else:
        both = (_affine(half, row, s, mode, rest) for half in (steps.open, steps.closed))
        after = np.where(opened[:, None], *both)
    # The rate limit holds for the mean slope of a step, as in `sim.sha.flows`; the slack is rounding, so that a step
    # exactly at the limit is not counted as limited. The noise comes after it: the limit is the mean's alone.
    rate, dt = plant.sha.max_rate, steps.dt[row]
    met = np.zeros(len(s), dtype=np.bool_)
    if rate < inf:
        change = after[:, 0] - s[:, 0]
        met = np.abs(change) > rate * dt * (1.0 + 1e-12)
        if met.any():
            after = after.copy()
            after[:, 0] = s[:, 0] + np.clip(change, -rate * dt, rate * dt)
    after = after + noise
    now = is_valve_open(plant, after[:, 0], opened)
    at = np.flatnonzero(now != opened)
    # Most runs switch in few segments: only those that crossed are cut, the others have their whole step already.
    if steps.open is None or not at.size:
        return Moved(after, opened, met, opened.astype(float))
    which = np.arange(steps.dt.size)[row][at] if isinstance(row, slice) else np.full(at.size, row)
    spread = noise[at] if isinstance(noise, np.ndarray) else np.zeros((at.size, plant.size))
    rests = np.zeros(at.size) if rest is None else rest[at]
    run = _CrossingRuns(
        which=which,
        s=s[at],
        mode=mode[at],
        rest=rests,
        opened=opened[at],
        noise=spread,
        share=np.zeros(at.size),
    )
    share = opened.astype(float)
    after[at], opened = _switch_ends(plant, steps, run, after[at]), opened.copy()
    opened[at], share[at] = run.opened, run.share
    return Moved(after, opened, met, share)


def _affine(half: Half, row: Rows, s: Array, mode: Array, rest: Array | None) -> Array:
    phi = half.phi[row]  # one (d, d) for all runs, or one for each (N, d, d)
    if s.shape[1] == 1:  # X alone: a product of numbers instead of one of 1 x 1 matrices
        transported = phi[..., 0] * s
    elif phi.ndim == 2:
        transported = s @ phi.T
    else:
        transported = (phi @ s[:, :, None])[:, :, 0]
    after = transported + half.pull[row] * mode[:, None] + half.added[row]
    return np.asarray(after if rest is None else after + half.unit[row] * rest[:, None])


@dataclass(slots=True)
class _CrossingRuns:
    """n runs, each in its step `which`: states (n, d), m, the heat that the tangent leaves out, thermostat, noise.

    `share` is the part of the step for which the thermostat was open.
    """

    which: Indices
    s: Array
    mode: Array
    rest: Array
    opened: Mask
    noise: Array
    share: Array


def _switch_ends(plant: Plant, steps: Tables, run: _CrossingRuns, end: Array) -> Array:
    """(n, d) the ends of runs that would come to `end` if none switched: to the threshold, and from there switched.

    The thermostat of `run` is moved on. A run may switch several times in a step.
    """
    begin, end = np.zeros(len(end)), end.copy()
    for _ in range(_MAX_SWITCHES):
        now = is_valve_open(plant, end[:, 0], run.opened)
        crossed = now != run.opened
        if not crossed.any():
            break
        part, at_crossing = _find_crossing(plant, steps, run, begin, end)
        # From its crossing on a run is in the other mode, over what is left of the step, where it may cross again.
        run.s = np.where(crossed[:, None], at_crossing, run.s)
        run.share += np.where(crossed & run.opened, part - begin, 0.0)
        begin = np.where(crossed, part, begin)
        run.opened = now
        after = _piece(plant, steps, run, begin, np.ones_like(begin))
        end = np.where(crossed[:, None], after, end)
    run.share += np.where(run.opened, 1.0 - begin, 0.0)
    return end


def _find_crossing(plant: Plant, steps: Tables, run: _CrossingRuns, begin: Array, end: Array) -> tuple[Array, Array]:
    """(part of the step, state) at which each run meets its threshold, by the secant method on its exact course.

    The secant method (Press et al., Numerical Recipes, 9.2) needs no derivative of the course, which with a housing, a
    lag and a varying heat has no short form, and evaluates it once a step; all runs are searched at once. The bracket
    is the piece from where the run last switched to the segment's end, and a step that leaves it is cut to its border:
    the crossing is known to lie inside.
    """
    p = plant.thermostat.effect.params if plant.thermostat is not None else {}
    threshold = np.where(run.opened, p["closes"], p["opens"])
    old, part, s = begin, np.ones_like(begin), end
    old_error, error = run.s[:, 0] - threshold, end[:, 0] - threshold
    for _ in range(_SECANT_STEPS):
        # Two equal errors (a run that stands at its threshold already) would divide by 0; any change will do, as the
        # error is 0 too.
        change = np.where(error == old_error, 1.0, error - old_error)
        old, part, old_error = part, np.clip(part - error * (part - old) / change, begin, 1.0), error
        s = _piece(plant, steps, run, begin, part)
        error = s[:, 0] - threshold
    return part, s


def _piece(plant: Plant, steps: Tables, run: _CrossingRuns, begin: Array, until: Array) -> Array:
    """(n, d) the states at `until` from the runs' at `begin`, both parts of their steps; noise is spread evenly."""
    closed, other = steps.closed.terms, (steps.open or steps.closed).terms
    which, opened, length = run.which, run.opened, until - begin
    loss = np.where(opened, other.loss[which], closed.loss[which])
    heat = np.where(opened[:, None], other.heat[which], closed.heat[which]) + run.mode[:, None] * closed.drive[which]
    heat[:, 0] += run.rest
    if closed.powers > 1:
        # The heat is a parabola in the whole step's v; on a piece v = begin + length w it is one in w.
        first, second = heat[:, 1].copy(), heat[:, 2].copy()
        heat[:, 0] += (first + second * begin) * begin
        heat[:, 1], heat[:, 2] = (first + 2.0 * second * begin) * length, second * length * length
    # A table's row is made for the whole step; a piece has its own length, so its exponential is worked out afresh.
    phi, poly = step_answer(plant, loss, steps.couplings[which], steps.dt[which] * length, closed.powers)
    after = np.einsum("nij,nj->ni", phi, run.s) + np.einsum("niq,nq->ni", poly, heat)
    return np.asarray(after + length[:, None] * run.noise)

"""The mean course of an automaton with effects, and its covariance; `sim.engine.moment_equations` has plain ones.

The segments are known beforehand. Where no thermostat switches and nothing meets a limit, the course is one linear
recursion. Each switch, clamp and limited step is found in it, done singly, and the recursion goes on from there.
Radiation is linearised about the course itself: course and linearisation are repeated until they agree (Newton's
method on the whole course).
"""

from dataclasses import dataclass, replace
from math import inf

import numpy as np

from sim.engine.kernel import is_valve_open, move
from sim.engine.plant import Plant
from sim.engine.recursion import matrix_recursion
from sim.engine.tables import Half, Tables, blend_steps, tables
from sim.engine.terms import Segments
from sim.engine.valve import Valve, follow, iterate_rows
from sim.sha import Array, Mask

COURSE_TOLERANCE_DEGC = 1e-5
"""degC by which the course about which radiation is linearised may differ from the course that follows."""

_MAX_ROUNDS = 10
_MIN_BATCH = 8


@dataclass(frozen=True, slots=True, kw_only=True)
class DrawnMoments:
    """What stays draw, for each of n steps: moments of m; whether X is drawn anew before the step, and its moments.

    `entry` marks the steps that begin a stay, `checked` those that end where the temperature is held against the range.
    """

    mode: Array
    spread: Array
    resampled: Mask
    fresh: Array
    scatter: Array
    entry: Mask
    checked: Mask


@dataclass(frozen=True, slots=True, kw_only=True)
class MeanCourse:
    """The means after each step, `s` (n, d), with the `steps` that led there.

    `opened` (n,) is the part of each step for which the thermostat was open, `valve` its state at the end. `clamps`
    and `limited` count the steps that were cut to the range or met the rate limit.
    """

    s: Array
    steps: Tables
    opened: Array
    clamps: int
    limited: int
    valve: bool


def start_state(plant: Plant, temperature: Array | float, offset: float) -> Array:
    """(..., d) the mean state at a first reading: X, housing and lags alike, less what the sensor reads too much.

    A disturbance and the machine's offset, of which it says nothing, are at their mean 0.
    """
    state = np.repeat(np.asarray(temperature, dtype=float)[..., None] - offset, plant.size, axis=-1)
    for place, _ in plant.own_states:
        state[..., place] = 0.0
    return state


def start_covariance(plant: Plant, variance: float) -> Array:
    """(d, d) the covariance at a first reading that has the `variance` (degC^2).

    One number is known of X, housing and lags, so that they are perfectly correlated until time tells them apart.
    """
    covariance = np.full((plant.size, plant.size), variance)
    for place, sigma in plant.own_states:
        covariance[place, :], covariance[:, place] = 0.0, 0.0
        covariance[place, place] = sigma**2
    return covariance


def drawn_start(plant: Plant, temperature: Array, offset: float, rng: np.random.Generator) -> Array:
    """(N, d) states of runs whose first readings are `temperature` (N,), by the law of `start_covariance`."""
    state = start_state(plant, temperature, offset)
    for place, sigma in plant.own_states:
        state[:, place] = sigma * rng.standard_normal(temperature.size)
    return state


def mean_course(
    plant: Plant,
    segments: Segments,
    drawn: DrawnMoments,
    start: Array,
    *,
    valve: bool = False,
    known: Tables | None = None,
) -> MeanCourse:
    """The course from the state `start` (d,), with the thermostat open if `valve`.

    `known` are the steps of another course along the same segments, which without radiation are those of each.
    """
    if plant.radiation is None:
        return _march(plant, tables(plant, segments) if known is None else known, drawn, start, valve)
    about = np.full(segments.dt.size, float(start[0]))
    for _ in range(_MAX_ROUNDS):
        course = _march(plant, tables(plant, segments, about), drawn, start, valve)
        # The tangent lies at the middle of the segment as it runs: where X is drawn anew, from its new mean on.
        before = np.where(drawn.resampled, drawn.fresh, np.concatenate([start[:1], course.s[:-1, 0]]))
        middle = 0.5 * (before + course.s[:, 0])
        moved, about = float(np.abs(middle - about).max()), middle
        if moved < COURSE_TOLERANCE_DEGC:
            break
    return course


def _march(plant: Plant, steps: Tables, drawn: DrawnMoments, start: Array, first: bool) -> MeanCourse:
    """The course along `steps`, with the thermostat open at the start if `first`.

    The recursion is solved over a stretch of rows as if nothing odd happened in it, and taken up to the first row in
    which something does. That row is done singly, and the next stretch is short: what switches often, switches soon.
    """
    sha = plant.sha
    fresh = np.where(drawn.resampled, drawn.fresh, np.nan)
    if plant.thermostat is not None and plant.size == 1 and steps.closed.terms.powers == 1:
        valve_state = Valve(float(start[0]), first)
        rows_of_floats = iterate_rows(steps, drawn.mode, fresh, drawn.checked)
        x, parts = follow(sha, plant.thermostat.effect, rows_of_floats, valve_state, fresh.size)
        return MeanCourse(
            s=x[:, None],
            steps=steps,
            opened=parts,
            clamps=valve_state.clamps,
            limited=valve_state.limited,
            valve=valve_state.opened,
        )
    n = steps.dt.size
    s, opened = np.empty((n, plant.size)), np.zeros(n)
    clamps, limited, row, piece = 0, 0, 0, n
    state, valve = start, np.array([first])
    # The linearisation follows the mean itself, so that its tangent leaves nothing out.
    alone = replace(steps, about=None, radiated=None)
    while row < n:
        rows = slice(row, min(row + piece, n))
        half = steps.open if valve[0] and steps.open is not None else steps.closed
        phi, added = _redraw_steps(half, drawn, rows)
        run = matrix_recursion(phi, added + half.pull[rows] * drawn.mode[rows, None], state)
        before = np.where(drawn.resampled[rows], drawn.fresh[rows], np.concatenate([state[:1], run[:-1, 0]]))
        after = run[:, 0]
        odd = drawn.checked[rows] & ((after < sha.low) | (after > sha.high))
        if sha.max_rate < inf:
            odd |= np.abs(after - before) > sha.max_rate * steps.dt[rows] * (1.0 + 1e-12)
        if plant.thermostat is not None:
            odd |= (is_valve_open(plant, before, valve) != valve) | (is_valve_open(plant, after, valve) != valve)
        good = int(np.argmax(odd)) if odd.any() else len(run)
        s[row : row + good], opened[row : row + good] = run[:good], valve[0]
        row, state = row + good, run[good - 1] if good else state
        piece = min(2 * piece, n) if good == len(run) else _MIN_BATCH
        if good == len(run):
            continue
        # The odd row by the kernel, with everything in it, and from its end the recursion again.
        if drawn.resampled[row]:
            state = np.concatenate([[drawn.fresh[row]], state[1:]])
        moved = move(plant, alone, row, s=state[None, :], mode=drawn.mode[row : row + 1], opened=valve)
        state, valve, opened[row] = moved.s[0], moved.opened, moved.share[0]
        held = min(max(state[0], sha.low), sha.high) if drawn.checked[row] else state[0]
        clamps, limited = clamps + (held != state[0]), limited + int(moved.met[0])
        state[0] = held
        s[row] = state
        row += 1
    return MeanCourse(s=s, steps=steps, opened=opened, clamps=int(clamps), limited=limited, valve=bool(valve[0]))


def _redraw_steps(half: Half, drawn: DrawnMoments, rows: slice) -> tuple[Array, Array]:
    """(phi, added) in which steps before which X is drawn anew forget the old X and begin with the mean of the new."""
    phi, added, new = half.phi[rows], half.added[rows], drawn.resampled[rows]
    if not new.any():
        return phi, added
    phi, added = phi.copy(), added.copy()
    added[new] += phi[new, :, 0] * drawn.fresh[rows][new, None]
    phi[new, :, 0] = 0.0
    return phi, added


def covariance(plant: Plant, course: MeanCourse, drawn: DrawnMoments, variance0: float) -> Array:
    """(n,) the variance (degC^2) of what the sensor reads after each step, its own noise apart.

    The thermostat switches as it does for the mean, and limits are not seen.
    """
    half = blend_steps(course.steps, course.opened)
    n, d = half.pull.shape
    phi, _ = _redraw_steps(half, drawn, slice(0, n))
    # First the covariance of the states with m, which starts at 0 in each stay; what a step adds to P needs the one
    # before the step.
    kept = np.where(drawn.entry[:, None, None], 0.0, phi)
    shared = matrix_recursion(kept, half.pull * drawn.spread[:, None], np.zeros(d))
    last = np.where(drawn.entry[:, None], 0.0, np.vstack([np.zeros(d), shared[:-1]]))
    crossed = np.einsum("nij,nj,nk->nik", phi, last, half.pull)
    fresh = np.where(drawn.resampled, drawn.scatter, 0.0)[:, None, None]
    first = half.phi[:, :, 0]
    added = crossed + crossed.transpose(0, 2, 1) + half.noise
    added += drawn.spread[:, None, None] * np.einsum("ni,nj->nij", half.pull, half.pull)
    added += fresh * np.einsum("ni,nj->nij", first, first)
    return _propagate_covariance(phi, added, start_covariance(plant, variance0).ravel())[
        :, plant.sensor_state * (d + 1)
    ]


_CHUNK_STEPS = 4096


def _propagate_covariance(phi: Array, added: Array, start: Array) -> Array:
    """(n, d * d) the covariances P' = phi P phi^T + added, from `start` (d * d,), in pieces for their memory."""
    n, d, _ = phi.shape
    out = np.empty((n, d * d))
    # Row by row, vec(phi P phi^T) = (phi x phi) vec(P) with the Kronecker product: the covariance is a linear recursion
    # too, of d^2 numbers, and one banded solve takes all steps at once.
    for first in range(0, n, _CHUNK_STEPS):
        rows = slice(first, min(first + _CHUNK_STEPS, n))
        twice = np.einsum("nij,nkl->nikjl", phi[rows], phi[rows]).reshape(-1, d * d, d * d)
        out[rows] = matrix_recursion(twice, added[rows].reshape(-1, d * d), start)
        start = out[rows][-1]
    return out

"""Stochastic runs of an automaton with effects: every run has its own m, noise, housing, lags and thermostat.

Each step is exact in law where it is linear. Radiation is linearised about the mean course, the same for all runs; what
that leaves out is taken for each run at its step's start.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sim.effects import sensor_offset, sensor_offsets
from sim.engine.kernel import move
from sim.engine.moment_equations import augmented_course
from sim.engine.moments_augmented import drawn_start
from sim.engine.plant import Indices, Plant
from sim.engine.schedules import Schedule
from sim.engine.tables import Half, Tables
from sim.sha import Array, Distribution, Mask, distributions, draw_parameter, draw_temperature


@dataclass(frozen=True, slots=True)
class SamplingPlan:
    """A schedule made ready for runs: the steps' tables, roots of their noise (n, d, d), laws by location."""

    schedule: Schedule
    plant: Plant
    steps: Tables
    closed: Array
    open: Array
    mode: Array
    resampled: Mask
    temperature_laws: Sequence[Distribution | None]
    mode_laws: Sequence[Distribution | None]
    read_offset: Array
    first_offset: float


def augmented_plan(steps: Schedule, x0: float) -> SamplingPlan:
    """The plan of runs whose first reading has the mean `x0` (degC)."""
    plant, drawn, course = augmented_course(steps, x0)
    closed = root(course.steps.closed)
    return SamplingPlan(
        schedule=steps,
        plant=plant,
        steps=course.steps,
        closed=closed,
        open=closed if course.steps.open is None else root(course.steps.open),
        mode=drawn.mode,
        resampled=drawn.resampled,
        temperature_laws=[draw_temperature(place) for place in steps.sha.locations],
        mode_laws=[draw_parameter(place) for place in steps.sha.locations],
        read_offset=sensor_offsets(steps.sha, steps.times),
        first_offset=sensor_offset(steps.sha, steps.start),
    )


def root(half: Half) -> Array:
    """(n, d, d) matrices R with R R^T = noise, also where that is singular."""
    if half.noise.shape[1] == 1:
        return np.sqrt(half.noise)
    # Eigenvalues and not Cholesky: a lag gets its noise through X alone, over a short step almost none. What rounding
    # leaves below 0 is 0.
    values, vectors = np.linalg.eigh(half.noise)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :])


def augmented_runs(
    plan: SamplingPlan, x: Array, rng: np.random.Generator, out: Array, clamps: Indices, limited: Indices
) -> None:
    """Takes the first readings `x` (N,) along the plan: fills `out` (outputs, N), adds to the counts (N,)."""
    schedule, plant = plan.schedule, plan.plant
    s, mode = drawn_start(plant, x, plan.first_offset, rng), np.zeros(x.size)
    opened = np.zeros(x.size, dtype=np.bool_)
    low, high = schedule.sha.low, schedule.sha.high
    for row, place in enumerate(schedule.location.tolist()):
        if schedule.entry[row]:
            # X before m, both before the step's noise: a seed's runs depend on the order.
            fresh, law = plan.temperature_laws[place], plan.mode_laws[place]
            if fresh is not None and plan.resampled[row]:
                s[:, 0] = distributions.draw(fresh, x.size, rng)
            mode = np.full(x.size, plan.mode[row]) if law is None else distributions.draw(law, x.size, rng)
        if schedule.dt[row] > 0:
            # The same numbers serve an open and a closed thermostat: how many are drawn does not depend on the run.
            drawn = rng.standard_normal((x.size, plant.size))
            noise = drawn @ plan.closed[row].T
            if opened.any():
                noise = np.where(opened[:, None], drawn @ plan.open[row].T, noise)
            moved = move(plant, plan.steps, row, s=s, mode=mode, opened=opened, noise=noise)
            s, opened = moved.s, moved.opened
            limited += moved.met
        if schedule.checked[row] and (s[:, 0].min() < low or s[:, 0].max() > high):
            clamps += (s[:, 0] < low) | (s[:, 0] > high)
            s[:, 0] = np.clip(s[:, 0], low, high)
        if schedule.output[row] >= 0:
            np.add(s[:, plant.sensor_state], plan.read_offset[schedule.output[row]], out=out[schedule.output[row]])

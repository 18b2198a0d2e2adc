"""The heat that a fit leaves unexplained: how fast the residual moves beyond what the flow itself would do to it."""

from dataclasses import dataclass, fields

import numpy as np

from sim.lab.discrepancy.fitting import Fitted, Record, decay_and_pull, sensor_view
from sim.lab.discrepancy.screen import Projector
from sim.lab.learning import Indices, first_switch
from sim.sha import Array, Mask

BLOCK_S = 600.0
"""Seconds over which the heat is averaged: shorter, the sensor's noise hides it."""
HOUR_S = 3600.0
REACH_DELAYS = 3.0
"""Mean delays after which a change has reached the reading."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Blocks:
    """b stretches of about ten minutes inside one location: the mean implied heat of each and where it was.

    `heat` (b,) degC/h, `seconds` (b,) its length, `time` (b,) absolute s of its middle, `location` (b,) the index,
    `cycle` (b,), `since_start` and `since_stop` (b,) s, `running` (b,), `course` (b,) degC the temperature, `signals`
    (b, q) their means. Only blocks with a step inside are there.
    """

    heat: Array
    seconds: Array
    time: Array
    location: Indices
    cycle: Indices
    since_start: Array
    since_stop: Array
    running: Array
    course: Array
    signals: Array

    def select(self, kept: Mask) -> "Blocks":
        """The blocks (b,) that are kept."""
        return Blocks(**{each.name: getattr(self, each.name)[kept] for each in fields(self)})


def implied_heat(fitted: Fitted) -> Array:
    """(m,) degC/s over the step to each window: (x' - decay x) / pull of the smoothed residual; NaN at a run's first.

    The part that the model's own parameters would take up is taken out before. NaN too where a change is still on its
    way to the reading, in a model with a dead time or a sensor's lag: there the residual tells how that smears, and no
    heat; and where a switch between two rows moves the temperature by more than a reading errs by.
    """
    # The smoothed residual is an estimate of x in dx/dt = -k x + h; solved for h over each step, held constant in it.
    smoothed = Projector(fitted).smoothed_residual
    grid = fitted.grid
    decay, pull = decay_and_pull(grid.k, grid.dt)
    before = np.concatenate([smoothed[:1], smoothed[:-1]])
    heat = (smoothed - decay * before) / np.maximum(pull, 1e-9)
    # Which readings still follow a change of location. A ramp sent through whatever lies between heat and reading is
    # read late by that chain's mean delay, dead times and lags together, without asking which of them there are.
    record = fitted.frame.record
    runs = record.runs
    clock = runs.time - runs.time[0]
    late = float(np.max(clock - sensor_view(fitted.frame, fitted.state, clock)))
    changed = runs.first | (np.diff(runs.place, prepend=-1) != 0)
    since = runs.time - (runs.time - runs.dt)[changed][np.cumsum(changed) - 1]
    unknown = grid.first | (record.window_means(since) < REACH_DELAYS * late) | (grid.late > fitted.noise.sensor**2)
    return np.where(unknown, np.nan, heat)


def since_switch(record: Record) -> Array:
    """(n,) s since the machine last stopped, or since the run began while it never did."""
    runs, on = record.runs, record.running > 0.5
    changed = runs.first | (np.diff(on.astype(int), prepend=int(on[0]) if on.size else 0) != 0)
    moment = (runs.time - runs.dt)[changed][np.cumsum(changed) - 1]
    return np.asarray(runs.time - runs.dt - moment)


def heat_blocks(fitted: Fitted, length: float = BLOCK_S) -> Blocks:
    """The implied heat of a fit in blocks of at most `length` seconds."""
    record = fitted.frame.record
    runs = record.runs
    heat = implied_heat(fitted)
    last = record.rows[np.append(record.begins[1:], record.rows.size) - 1]
    place, times = runs.place[last], record.times
    phase = since_switch(record)[last]
    # A block ends where the location, the cycle or the phase's grid does, and a window without a heat is one by itself
    # (weight 0, dropped below), so that no block reaches across a gap.
    new = np.isnan(heat) | (np.diff(place, prepend=-1) != 0) | (np.diff(record.window_cycle, prepend=-1) != 0)
    new |= np.diff(np.floor(phase / length), prepend=-1) != 0
    new |= np.concatenate([[True], np.isnan(heat[:-1])])
    begins = np.flatnonzero(new)
    weight = np.where(np.isnan(heat), 0.0, fitted.grid.dt)
    total = np.add.reduceat(weight, begins)
    signals = record.window_means(np.nan_to_num(runs.inputs)) if runs.inputs.shape[1] else np.empty((times.size, 0))

    def mean(column: Array) -> Array:
        weights = weight if column.ndim == 1 else weight[:, None]
        divisor = np.maximum(total, 1e-9)
        return np.asarray(
            np.add.reduceat(weights * np.nan_to_num(column), begins, axis=0)
            / (divisor if column.ndim == 1 else divisor[:, None])
        )

    kept = total > 0
    on = record.window_means(record.running)
    stopped = np.where(on > 0.5, 0.0, record.window_means(since_switch(record)))
    columns = (heat * HOUR_S, times, record.window_means(np.minimum(record.since, 1e6)), stopped, on, record.reading)
    implied, middle, started, stop, running, course = (mean(column)[kept] for column in columns)
    return Blocks(
        heat=implied,
        seconds=total[kept],
        time=middle,
        location=place[begins][kept],
        cycle=record.window_cycle[begins][kept],
        since_start=started,
        since_stop=stop,
        running=running,
        course=course,
        signals=mean(signals)[kept],
    )


def event_names(record: Record) -> tuple[str, str]:
    """The symbols of a start and of a stop; ("", "") without a switch."""
    switch = first_switch(record.model.alphabet)
    return (switch.rising, switch.falling) if switch else ("", "")


def flips(cycles: int, seed: int, draws: int) -> Array:
    """(draws + 1, cycles) signs: every flip of the cycles where they are few, else random ones; the first is none."""
    if 2**cycles <= draws:
        # Few cycles: all flips, an exact test, in which the first row (no bit set) is the data themselves.
        bits = (np.arange(2**cycles)[:, None] >> np.arange(cycles)) & 1
        return np.asarray(1.0 - 2.0 * bits)
    rng = np.random.default_rng(seed)
    signs = rng.choice([-1.0, 1.0], size=(draws, cycles))
    return np.vstack([np.ones(cycles), signs])

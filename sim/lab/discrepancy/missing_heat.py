"""The heat over time that would have to be added to a fitted model for it to follow the measurement, with its band.

A smoother (Rauch, Tung and Striebel 1965, in its banded form: Rue & Held 2005, ch. 2) of the noise's own heat, given
all readings. It knows no effect and no place: what it shows was there before anything was named.
"""

from dataclasses import replace

import numpy as np

from sim.effects import disturbance_step
from sim.lab.discrepancy.diagnosis import MissingHeat
from sim.lab.discrepancy.fitting import Fitted, NoiseModel, Record, Whitener, friction_heat
from sim.lab.discrepancy.heat import HOUR_S
from sim.lab.discrepancy.held_out import let_run
from sim.lab.learning import Indices

SIGMAS_95 = 1.96
"""Standard deviations of a normal law on either side of its mean that hold 95 % of it."""


def missing_heat(base: Fitted, record: Record, held_out: Indices) -> MissingHeat:
    """The heat that `base` lacks over all windows of a record, of which the cycles `held_out` were not fitted.

    The fit's parameters are taken as they are. Where the model has a dead time or a sensor's lag the heat is that at
    the reading: as late as it is read.
    """
    trial = let_run(base, record)
    noise = as_one_heat(base)
    grid = replace(trial.whitener.grid, heats=np.empty((record.times.size, 0)))
    running = record.window_means(record.running) > 0.5
    # What heats at rest and what heats while the machine runs are two: neither is foreseen by the other, so that a heat
    # that begins with a start or ends with a stop does so at once.
    step = disturbance_step(noise.memory, grid.k, grid.dt)
    switched = np.diff(running, prepend=running[:1])
    step = replace(
        step,
        keep=np.where(switched, 0.0, step.keep),
        xd=np.where(switched, 0.0, step.xd),
        dd=np.where(switched, 1.0, step.dd),
    )
    mean, variance = Whitener(grid, noise, step).heat(trial.residual)
    acts = HOUR_S * np.where(running, 1.0, noise.rest)
    half = SIGMAS_95 * acts * np.sqrt(variance)
    return MissingHeat(
        times=record.times,
        mean=acts * mean,
        low=acts * mean - half,
        high=acts * mean + half,
        running=running,
        held_out=np.isin(record.window_whole, held_out),
    )


def as_one_heat(base: Fitted) -> NoiseModel:
    """The fit's noise in which one heat with a memory stands for all that heats: the rough heat, the white one and the
    scatter of the cycles' friction.

    Of a gap each of the three takes its share in a fit. What is asked here is all of it.
    """
    # White heat of s degC/sqrt(s) moves the temperature in the long run as heat with a memory tau of s^2 / (2 tau)
    # does: both have the same spectral density at rate 0.
    noise, record = base.noise, base.frame.record
    white = noise.process**2 / (2.0 * noise.memory)
    friction = friction_heat(base.frame, base.state)[record.running > 0.5]
    scatter = noise.cycle**2 * float(np.mean(friction**2)) if friction.size else 0.0
    whole, at_rest = noise.rough**2 + white + scatter, (noise.rest * noise.rough) ** 2 + noise.still**2 * white
    return replace(noise, process=0.0, cycle=0.0, rough=float(np.sqrt(whole)), rest=float(np.sqrt(at_rest / whole)))

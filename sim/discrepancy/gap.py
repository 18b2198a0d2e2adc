"""Is there a gap at all: how far off the refitted free run is, beside what the given model says of its own noise.

The floor is never the fit's to choose. What a refit adds to its noise on the measured traces (a disturbance with a
memory, a scatter of the cycles) is a finding about them: as a floor it would swallow whole effects.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim.discrepancy.augment import as_white, process_noise
from sim.discrepancy.fitting import Fitted, Grid, Record, readings_in_window, rounding
from sim.discrepancy.held_out import let_run
from sim.effects import of_feature, without
from sim.engine import linear_recursion, open_loop
from sim.sha import Model, Trace, content_hash

WIDE, MOSTLY, SHARE = 1.5, 1.2, 0.2
"""A gap: the median cycle is so many times as far off as the model's own noise allows, and all but this share of the
cycles at least so many times."""
ROUGHER, FELT = 4.5, 0.75
"""A gap as well: heat so many times as rough, that moves the temperature by so many sensor sigmas (stationary rms)."""


LEAST_ROWS = 50
"""Rows at rest from which the sensor's noise is told by them alone."""


@dataclass(frozen=True, slots=True)
class NoiseFloor:
    """degC rms of a free run over windows where nothing is missing.

    `given`: as the given model states it for itself, from days of its own; else it is the sensor's noise alone, since a
    model that has learned these very traces holds what is missing in them for noise. In both what switches between two
    rows do (`between_rows`) is added: it belongs to the rows at hand, not to those of the model's own days.
    """

    error: float
    given: bool


@dataclass(frozen=True, slots=True)
class Excess:
    """Of the fitted cycles: the free run's error over the given model's own spread, the median and the lower fifth.

    Roughness that the model has learned counts as its spread, so a rough plant has no excess; a heat that came after it
    was learned has, even where nothing measured says what it is. `rougher` is the fit's process noise over the given
    model's (0 where it is too little to matter).
    """

    median: float
    low: float
    rougher: float

    @property
    def wide(self) -> bool:
        """True where the model's noise does not cover its errors."""
        return self.median >= WIDE and self.low >= MOSTLY

    @property
    def exceeded(self) -> bool:
        """True where there is a gap: the errors are too great, or the heat is rougher than the model has learned."""
        return self.wide or self.rougher >= ROUGHER

    @property
    def words(self) -> str:
        """What is too much, in a sentence."""
        if self.wide:
            return f"the free run is {self.median:.1f} times as far off as the model's own noise allows"
        return f"the heat is {self.rougher:.1f} times as rough as the model has learned"


def floor_of(model: Model, traces: Sequence[Trace], laid_out: Sequence[Trace], fitted: Fitted) -> NoiseFloor:
    """The floor under the free runs of a fit to `traces`, which `laid_out` holds in their order and with events."""
    record = fitted.frame.record
    sensor = sensor_noise(record)
    looks = readings_in_window(record)
    in_window = max(sensor / float(np.sqrt(looks)), rounding(model, record))
    in_window = float(np.hypot(in_window, between_rows(fitted.grid)))
    if not {content_hash(trace) for trace in traces}.isdisjoint(model.provenance.contents):
        return NoiseFloor(in_window, given=False)
    stated = model.provenance.scores.get("held_out_rmse", 0.0)
    if stated > 0:
        # Stated of single readings: their noise gives way to that of a window's mean.
        return NoiseFloor(float(np.hypot(np.sqrt(max(stated**2 - sensor**2, 0.0)), in_window)), given=True)
    spread = spread_of(model, laid_out, fitted)
    return NoiseFloor(float(np.hypot(spread, in_window)) if spread > 0 else in_window, given=spread > 0)


def between_rows(grid: Grid) -> float:
    """degC rms over the windows of what a free run is off by because switches are known to a row only."""
    decay = np.where(grid.first, 0.0, np.exp(-2.0 * grid.k * grid.dt))
    apart = linear_recursion(decay, grid.late, 0.0)
    return float(np.sqrt(np.mean(apart + grid.shared**2)))


def sensor_noise(record: Record) -> float:
    """degC the standard deviation of a reading, by the second differences of neighbouring rows, at rest if possible.

    What the temperature does over three rows is nearly a straight line, and drops out of them. So would an error that
    lasts over rows: of such a sensor the model's own figure is taken.
    """
    if record.model.sensor_memory:
        return record.model.sensor_sigma
    runs, rows = record.runs, record.rows
    reading, time, run = runs.reading[rows], runs.time[rows], runs.run[rows]
    step = np.diff(time)
    together = (run[2:] == run[:-2]) & (np.abs(step[1:] - step[:-1]) < 0.1 * np.median(step))
    resting = together & (np.maximum(record.running[rows][2:], record.running[rows][:-2]) < 0.5)
    chosen = resting if int(resting.sum()) >= LEAST_ROWS else together
    second = (reading[2:] - 2.0 * reading[1:-1] + reading[:-2])[chosen]
    # Var(a - 2 b + c) is 6 of one reading's.
    return float(np.sqrt(np.mean(second**2) / 6.0)) if second.size else 0.0


def excess(fitted: Fitted, floor: NoiseFloor) -> Excess | None:
    """The excess of a fit over the given model's floor; None where the model states none of its own."""
    if not floor.given:
        return None
    trial = let_run(fitted, fitted.frame.record.by_cycles())
    count = np.bincount(trial.order)
    ratio = np.sqrt(np.bincount(trial.order, trial.residual**2) / np.maximum(count, 1)) / floor.error
    return Excess(float(np.median(ratio)), float(np.quantile(ratio, SHARE)), rougher(fitted))


def rougher(fitted: Fitted) -> float:
    """The fit's process noise over the given model's own, heat with a memory in both; 0 where it hardly moves the
    sensor."""
    sha = fitted.frame.record.model.sha
    flows = [location.flow for location in sha.locations if location.flow.kind != "constant"]
    own = [flow.params["noise"] for flow in flows if flow.params.get("noise", 0.0) > 0]
    rates = [flow.params["k"] for flow in flows if flow.params.get("k", 0.0) > 0]
    if not own or not rates:
        return 0.0
    rate = float(np.median(rates))
    noise = process_noise(fitted, rate)
    moves = noise / np.sqrt(2.0 * rate)
    heats = [as_white(heat.params["sigma"], heat.params["memory"], rate) for heat in of_feature(sha, "disturbance")]
    learned = float(np.hypot(np.median(own), sum(heats)))
    return noise / learned if moves >= FELT * fitted.sensor_sigma else 0.0


def spread_of(model: Model, traces: Sequence[Trace], fitted: Fitted) -> float:
    """degC of the given model's own spread on a fit's cycles, the median; 0 where it says nothing of it."""
    # The fit's targets are those of this machine: what the model allows one machine to lie off is no allowance beside.
    model = replace(model, sha=without(model.sha, "machine offset"))
    spreads = []
    for cycle in _cycles(fitted.frame.record, traces):
        readings = cycle.signals.get(model.temperature, np.empty(0))
        if np.isfinite(readings).sum() < 2:  # nothing to start from, or nothing after it: no run along this cycle
            continue
        # "resync": an event for which the given model has no edge costs a jump here, and not the whole diagnosis.
        spread = float(np.sqrt(np.mean(open_loop(model, cycle, "resync").variance)))
        if np.isfinite(spread) and spread > 0:
            spreads.append(spread)
    return float(np.median(spreads)) if spreads else 0.0


def _cycles(record: Record, traces: Sequence[Trace]) -> Iterator[Trace]:
    """The traces' rows in each of the record's cycles, with all events up to their ends."""
    runs = record.runs
    for number in np.unique(record.cycle):
        times = runs.time[record.cycle == number]
        begin, end = float(times[0]), float(np.nextafter(times[-1], np.inf))
        for trace in traces:
            piece = trace.between(begin, end)
            if piece.times.size:
                yield replace(piece, events=tuple(event for event in trace.events if event.time < end))

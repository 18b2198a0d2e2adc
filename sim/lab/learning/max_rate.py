"""The greatest rate at which a temperature was seen to move, as a limit for a model's flows (MAX_RATE).

The slope is that of a straight line through the readings of a window; what a window vouches for is its slope less two
standard errors. The third greatest such rate is taken: a rate that was reached three times is the plant's, one reached
once may be a sensor's. A margin is put on it, since no trace holds the worst that may come.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import inf, sqrt

import numpy as np

from sim.engine import errors, open_loop
from sim.lab.learning.data import resolution, without_spikes
from sim.lab.learning.structure import LearningError
from sim.sha import Array, Model, Trace

WINDOW_SECONDS, WINDOW_READINGS = 30.0, 10
"""A window lasts this long and has so many readings, whichever is longer."""
REACHED = 3
RATE_MARGIN = 1.5


@dataclass(frozen=True, slots=True)
class MaxRate:
    """`rate` (degC/s, of the sensor) is `margin` times the `observed` one; `windows` and their length in seconds."""

    rate: float
    observed: float
    margin: float
    windows: int
    window_seconds: float


@dataclass(frozen=True, slots=True)
class Bite:
    """What a limit does to a model along traces: `limited` steps, and the mean absolute error (degC) without and with.

    `accepted`: the error grows by no more than the standard error of that growth over the traces.
    """

    limited: int
    before: float
    after: float
    accepted: bool


def learn_max_rate(traces: Sequence[Trace], temperature: str, *, margin: float = RATE_MARGIN) -> MaxRate:
    """The limit that the readings of `temperature` suggest.

    Raises LearningError when there are fewer than 30 windows, or the temperature never moves beyond its noise.
    """
    if not margin >= 1.0:
        raise LearningError(f"the margin on the greatest rate must be at least 1, got {margin:g}")
    spans, rates = [], []
    for trace in traces:
        column = trace.signals.get(temperature)
        if column is not None and np.count_nonzero(np.isfinite(column)) >= WINDOW_READINGS:
            cleaned = without_spikes(column, resolution(column))
            finite = np.isfinite(cleaned)
            times, values = trace.times[finite], cleaned[finite]
            span = max(WINDOW_SECONDS, WINDOW_READINGS * float(np.median(np.diff(times))))
            spans.append(span)
            cuts = np.searchsorted(times, np.arange(times[0], times[-1] + span, span))
            # A window with half of its readings still has a slope; with fewer than three none has a standard error.
            rates += [
                _certain_slope(times[begin:end], values[begin:end])
                for begin, end in pairwise(cuts.tolist())
                if end - begin >= max(WINDOW_READINGS // 2, 3)
            ]
    if len(rates) < 10 * REACHED:
        raise LearningError(f"{len(rates)} windows of {temperature!r} are too few for a greatest rate; 30 are needed")
    observed = sorted(rates)[-REACHED]
    if not observed > 0:
        raise LearningError(f"{temperature!r} never moves by more than its noise, so its greatest rate is not known")
    return MaxRate(margin * observed, observed, margin, len(rates), float(np.median(spans)))


def _certain_slope(times: Array, values: Array) -> float:
    """|slope| of the readings less two standard errors, degC/s: the rate that they vouch for; 0 at least."""
    t, y = times - times.mean(), values - values.mean()
    room = float(t @ t)
    if room == 0:
        return 0.0
    slope = float(t @ y) / room
    error = np.sqrt(float(np.sum((y - slope * t) ** 2)) / (t.size - 2) / room)
    return max(abs(slope) - 2.0 * float(error), 0.0)


def with_max_rate(model: Model, limit: MaxRate) -> Model:
    """The model with the limit, which is the sensor's and so divided by the correction's gain."""
    sha = replace(model.sha, max_rate=limit.rate / model.correction.gain)
    settings = {**model.provenance.settings, "max_rate_observed": limit.observed, "max_rate_margin": limit.margin}
    return replace(model, sha=sha, provenance=replace(model.provenance, settings=settings))


def bite(model: Model, traces: Sequence[Trace]) -> Bite:
    """What the model's limit does along encoded traces, open loop.

    Raises LearningError when no trace has its temperature.
    """
    free = replace(model, sha=replace(model.sha, max_rate=inf))
    usable = [trace for trace in traces if np.isfinite(trace.signals.get(model.temperature, np.empty(0))).any()]
    if not usable:
        raise LearningError(f"no trace has a reading of {model.temperature!r}")
    runs = [open_loop(model, trace, "resync") for trace in usable]
    before = [errors(open_loop(free, trace, "resync"), trace, model.temperature).at_samples.mae for trace in usable]
    after = [errors(run, trace, model.temperature).at_samples.mae for run, trace in zip(runs, usable, strict=True)]
    growth = np.array(after) - np.array(before)
    error = float(growth.std(ddof=1)) / sqrt(growth.size) if growth.size > 1 else 0.0
    met = sum(run.limited for run in runs)
    return Bite(met, float(np.mean(before)), float(np.mean(after)), accepted=bool(growth.mean() <= error))

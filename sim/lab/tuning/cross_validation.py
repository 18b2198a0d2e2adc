"""Cross-validation by trace: whole traces are held out, and each is predicted from its first reading on, open loop."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim.engine import measured, open_loop
from sim.lab.learning import in_order
from sim.scores import crps_gaussian, log_score_gaussian
from sim.sha import Array, Model, Trace, encoded

LEAST_READINGS = 3
LEAST_SIGMA = 1e-6


@dataclass(frozen=True, slots=True)
class HeldOutFold:
    """How a model predicts one trace: means over its readings but the first, at which the run starts.

    `crps` and `mae` in degC, `log_likelihood` in nats per reading; `largest` is the largest error (degC).
    """

    trace: str
    readings: int
    crps: float
    log_likelihood: float
    mae: float
    largest: float


def predicted(model: Model, trace: Trace) -> tuple[Array, Array, Array]:
    """(readings, mean, standard deviation), each (n - 1,) in degC, of an open-loop run from the first of n readings.

    Closed form: mean and variance of `moments`, with the sensor's variance added. The trace is encoded by the model's
    own alphabet; an event without an edge leads where its symbol does most often (`resync`). Raises ValueError where
    the model cannot be run along the trace.
    """
    run = open_loop(model, encoded(trace, model.alphabet), "resync")
    times, values = measured(trace, model.temperature)
    # The last output at each reading's time; without the first reading, from which the run starts.
    rows = np.searchsorted(run.times, times, side="right")[1:] - 1
    return values[1:], run.mean[rows], np.sqrt(run.variance[rows] + model.sensor_sigma**2)


def held_out(model: Model, trace: Trace) -> HeldOutFold:
    """The scores of one trace. Raises ValueError as `predicted` does."""
    values, mean, sigma = predicted(model, trace)
    error = mean - values
    # A model may be certain of itself (sigma 0): the log-likelihood would be infinite, so it gets a least sigma. The
    # CRPS needs none: there it is the absolute error.
    return HeldOutFold(
        trace=trace.name,
        readings=int(values.size),
        crps=float(np.mean(crps_gaussian(mean, sigma, values))),
        log_likelihood=-float(np.mean(log_score_gaussian(mean, np.maximum(sigma, LEAST_SIGMA), values))),
        mae=float(np.mean(np.abs(error))),
        largest=float(np.max(np.abs(error))),
    )


def usable(traces: Sequence[Trace], temperature: str) -> tuple[tuple[Trace, ...], tuple[str, ...], str]:
    """(the traces that can be held out, in an order of their own; sentences about the others; the hash of the first).

    Copies count once. Traces of equal names but other content get a number, so that scores can be told apart.
    """
    readable, notes = [], []
    for trace in traces:
        readings = int(np.isfinite(trace.signals.get(temperature, np.empty(0))).sum())
        if readings < LEAST_READINGS:
            notes.append(f"{trace.name} is left out: it has {readings} readings of {temperature!r}")
        else:
            readable.append(trace)
    ordered, digest = in_order(readable)
    copies = len(readable) - len(ordered)
    if copies:
        notes.append(f"{copies} cop{'y is' if copies == 1 else 'ies are'} left out")
    names: dict[str, int] = {}
    named = []
    for trace in ordered:
        names[trace.name] = names.get(trace.name, 0) + 1
        number = names[trace.name]
        named.append(trace if number == 1 else replace(trace, name=f"{trace.name} #{number}"))
    return tuple(named), tuple(notes), digest


def folds(count: int, wanted: int, seed: int) -> list[list[int]]:
    """Which of `count` traces each fold holds out: shuffled by `seed`, dealt one after another.

    There are no more folds than traces. Raises ValueError for fewer than two traces or folds.
    """
    if count < 2 or wanted < 2:
        raise ValueError(
            f"a cross-validation by trace needs 2 traces and 2 folds at least; there are {count} usable traces and "
            f"{wanted} folds (a long recording can be cut into cycles first)"
        )
    shuffled = np.random.default_rng(seed).permutation(count)
    number = min(wanted, count)
    return [sorted(shuffled[first::number].tolist()) for first in range(number)]

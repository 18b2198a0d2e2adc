"""What is familiar to a model: made of its training when it is learned or proposed, and kept beside it."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf, sqrt

import numpy as np

from gateway.outside.texts import all_words, strange_sentence
from sim.artefacts import FAMILIARITY_FILE, Familiarity
from sim.engine import open_loop
from sim.familiarity import (
    MIN_CYCLES,
    CyclePoints,
    FamiliarityReference,
    PointSource,
    Strangeness,
    cycle_points,
    error_curve,
    fit_reference,
)
from sim.forecast import Z90, widening_factors
from sim.lab.recordings import split_cycles
from sim.sha import Array, Model, Switch, Trace

MIN_CYCLE_READINGS = 20
"""Readings below which a cycle says nothing."""

ErrorPair = tuple[float, float]
"""A cycle's strangeness, and the relative error that a model's free run had along it."""


@dataclass(frozen=True, slots=True)
class FreeRunError:
    """Root mean squares (degC) along a cycle: the free run's `error`, and by how much the temperature `moved`.

    `allowed` (degC) is half its 90 % band where the errors are: `error` is above it where the root mean square of each
    reading's error over its own band is above 1. A wide band elsewhere allows nothing.
    """

    error: float
    allowed: float
    moved: float


def free_run_error(model: Model, cycle: Trace) -> FreeRunError | None:
    """How far the free run from the cycle's first reading is off; None where it cannot be run or says nothing."""
    try:
        run = open_loop(model, cycle, "resync")
    except ValueError:
        return None
    measured = cycle.signals[model.temperature]
    known = np.isfinite(measured)
    times, readings = cycle.times[known], measured[known]
    places = np.searchsorted(run.times, times)
    # The reading that it begins from says nothing.
    inside = (places < run.times.size) & (times > run.times[0])
    if np.count_nonzero(inside) < MIN_CYCLE_READINGS:
        return None
    places, readings, ages = places[inside], readings[inside], times[inside] - run.times[0]
    factor = np.maximum(widening_factors(model.calibration, ages), 1.0)
    allowed = Z90 * factor * np.sqrt(run.variance[places] + model.sensor_sigma**2)
    off, moved = readings - run.mean[places], readings - measured[known][0]
    error, beyond, move = (sqrt(float(np.mean(values**2))) for values in (off, off / allowed, moved))
    return FreeRunError(error, error / beyond if beyond else float(allowed[0]), move)


def cycle_features(model: Model, trace: Trace, begin: float = -inf, end: float = inf) -> CyclePoints:
    """The features along an encoded trace, or along the part of it from `begin` to `end` (s UTC)."""
    first, last = float(trace.times[0]), float(trace.times[-1])
    source = PointSource.for_alphabet(model.alphabet, model.temperature, model.roles)
    return cycle_points(trace, source, begin=max(begin, first), end=min(end, last))


def strange_words(strange: Strangeness) -> str:
    """What is strange in an operator's words."""
    return strange_sentence(all_words()["en"], strange.thing)


def make_reference(points: Sequence[Array], machines: Sequence[str] | None = None) -> FamiliarityReference | None:
    """The law of cycles with these points; None where too few of them say anything."""
    if sum(bool(len(each)) for each in points) < MIN_CYCLES:
        return None
    return fit_reference(points, machines)


def error_pair(reference: FamiliarityReference, model: Model, cycle: Trace, points: Array) -> ErrorPair | None:
    """What a cycle tells of the error that goes with strangeness; None where it cannot be run or did not move."""
    off = free_run_error(model, cycle)
    if off is None or off.moved <= 0 or not len(points):
        return None
    return reference.strangeness(points, np.arange(len(points), dtype=float)).value, off.error / off.moved


def familiarity(reference: FamiliarityReference, pairs: Sequence[ErrorPair], *, held_out: bool) -> Familiarity:
    """The reference with the curve of errors of cycles that were `held_out` of the model's training, or of it."""
    curve = error_curve([one for one, _ in pairs], [one for _, one in pairs]) if pairs else None
    return Familiarity(reference, curve, held_out)


def cycles_with_points(model: Model, trace: Trace) -> list[tuple[Trace, Array]]:
    """The cycles of an encoded trace, each with the features along it, for which what went before counts too."""
    found: list[tuple[Trace, Array]] = []
    for piece in split_cycles(trace, model.alphabet, gap=model.alphabet.gap):
        if piece.times.size:
            begin, end = float(piece.times[0]), float(piece.times[-1])
            found.append((piece, cycle_features(model, trace, begin, end).values))
    return found


def trained_familiarity(model: Model, traces: Sequence[Trace]) -> Familiarity | None:
    """What is familiar to a model that was learned from encoded traces; None where they have too few cycles.

    A cycle needs an hour before a point of it, so many short traces may tell nothing. The errors are those of the
    training itself: a retraining measures them on cycles held out.
    """
    if not any(isinstance(channel, Switch) for channel in model.alphabet.channels):
        return None
    cycles = [each for trace in traces for each in cycles_with_points(model, trace)]
    reference = make_reference([points for _, points in cycles], [cycle.machine for cycle, _ in cycles])
    if reference is None:
        return None
    pairs = [pair for cycle, points in cycles if (pair := error_pair(reference, model, cycle, points)) is not None]
    return familiarity(reference, pairs, held_out=False)


def familiarity_files(found: Familiarity | None) -> dict[str, str]:
    """The file to be written beside the model, by its name; none without."""
    return {} if found is None else {FAMILIARITY_FILE: found.text()}

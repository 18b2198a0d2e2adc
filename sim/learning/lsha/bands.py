"""Forecasts of what a model of the same structure was not fitted to: by how much its bands must be widened."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from sim.learning.calibrate import Coverage, Scored, coverage_of, score_forecasts
from sim.learning.lsha.ground import Ground
from sim.learning.preparation import splits
from sim.sha.model import Model
from sim.sha.trace import Mask, Trace

LEAST_KNOTS = 10


def bands(
    ground: Ground,
    traces: Sequence[Trace],
    *,
    temperature: str,
    fitted: Callable[[Ground], Model],
    seed: int,
    origins: int,
) -> tuple[Coverage, ...]:
    """The coverage of forecasts over the parts of `preparation.splits`, `origins` of them a part.

    `fitted` gives the parameters anew for the readings that are known in each part. The structure stays: what is
    learned here is how wrong flows and laws may be.
    """
    rng = np.random.default_rng(seed)
    read = [trace for trace in traces if np.isfinite(trace.signals.get(temperature, np.empty(0))).any()]
    scored: list[Scored] = []
    for known, asked, since in _parts(ground, read):
        if np.isfinite(ground.runs.reading[known]).sum() >= LEAST_KNOTS:
            model = fitted(replace(ground, runs=ground.runs.where(known), group=ground.group[known]))
            scored += score_forecasts(model, asked, since, rng, origins=origins)
    return coverage_of(scored)


def _parts(ground: Ground, traces: Sequence[Trace]) -> Iterator[tuple[Mask, Sequence[Trace], Sequence[float]]]:
    """(knots that are known, traces to forecast, since when) of each part."""
    runs = ground.runs
    usable = np.array([number for number, trace in enumerate(traces) if trace.times.size > 1], dtype=np.intp)
    rank = np.searchsorted(usable, runs.trace)
    for part, (_, asked, since) in enumerate(splits(traces)):
        if usable.size >= 6:
            yield rank % 3 != part, asked, since
        else:
            # Whole runs have to be kept: one that goes on beyond the cut ends there.
            yield runs.time < np.asarray(since)[rank], asked, since

"""What every learner does first and last: encode, refuse what cannot teach, range, initial law, parts to forecast."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim.lab.learning.runs import FreeRuns
from sim.lab.learning.structure import LearningError
from sim.sha import SHA, Alphabet, Distribution, Trace, encode

MIN_TRAINING_READINGS = 10
MIN_READING_SHARE = 0.1
"""A location in which a channel is not known is fitted like the known ones when it holds this share of the readings."""


def with_events(trace: Trace, alphabet: Alphabet) -> Trace:
    """The trace that a model is to be learned from, with its events: those it has, else those of `alphabet`.

    One that meets a model which there is already gets them from `sim.sha.encode_trace`.
    """
    return trace if trace.events else replace(trace, events=encode(trace, alphabet))


def check_data(traces: Sequence[Trace], temperature: str) -> None:
    """Raises LearningError, in one sentence, when the encoded traces cannot teach anything about `temperature`."""
    if not traces:
        raise LearningError("there is no trace to learn from")
    having = [trace for trace in traces if temperature in trace.signals]
    if not having:
        known = sorted({name for trace in traces for name in trace.signals})
        raise LearningError(f"no trace has the temperature {temperature!r}; their signals are {', '.join(known)}")
    finite = [trace.signals[temperature][np.isfinite(trace.signals[temperature])] for trace in having]
    readings = np.concatenate(finite)
    if not readings.size:
        raise LearningError(f"the temperature {temperature!r} has no reading in any trace")
    if readings.size < MIN_TRAINING_READINGS:
        raise LearningError(
            f"the temperature {temperature!r} has {readings.size} reading{'s' if readings.size > 1 else ''} in all; "
            f"a model needs at least {MIN_TRAINING_READINGS}"
        )
    if np.ptp(readings) == 0:
        raise LearningError(
            f"the temperature {temperature!r} is {readings[0]:g} in every row, so there is nothing to learn"
        )
    if not any(trace.events for trace in traces):
        raise LearningError("no event of the alphabet happens in any trace, so no location is ever known")


def with_range(sha: SHA, runs: FreeRuns, margin: float = 0.0) -> SHA:
    """The usual range of 0 to 150 degC, wider by 50 degC on a side where the readings leave it or come within `margin`
    of its end, and reaching 50 degC above the hottest reading: overheating is what is to be foreseen."""
    low, high = float(np.nanmin(runs.reading)) - margin, float(np.nanmax(runs.reading)) + margin
    return replace(sha, low=sha.low if low >= sha.low else low - 50.0, high=max(sha.high, high + 50.0))


def initial_law(traces: Sequence[Trace], temperature: str) -> Distribution:
    """The law of a trace's first temperature; with one trace its scatter is that of all its readings."""
    columns = [trace.signals[temperature] for trace in traces if temperature in trace.signals]
    finite = [column[np.isfinite(column)] for column in columns]
    firsts = [float(column[0]) for column in finite if column.size]
    sigma = np.std(firsts, ddof=1) if len(firsts) > 1 else np.std(np.concatenate(finite))
    return Distribution("normal", {"mu": float(np.mean(firsts)), "sigma": max(float(sigma), 0.5)})


@dataclass(frozen=True, slots=True)
class Split:
    """A part of the calibration: the traces `known`, those `ahead` that are forecast, each `since` a moment (s).

    `held` are the places of those ahead among the traces of two rows or more; None where times were cut instead.
    """

    known: Sequence[Trace]
    ahead: Sequence[Trace]
    since: Sequence[float]
    held: frozenset[int] | None = None


def splits(traces: Sequence[Trace]) -> list[Split]:
    """The parts of the calibration: machines held out where there are several, else thirds of traces, else times."""
    usable = [trace for trace in traces if trace.times.size > 1]
    machines = list(dict.fromkeys(trace.machine for trace in usable))
    parts: list[frozenset[int]] = []
    if len(machines) > 1:
        # Each machine in one part: what is asked of a model is another machine's temperature.
        count = min(len(machines), 3)
        part_of = {machine: number % count for number, machine in enumerate(machines)}
        parts = [frozenset(n for n, t in enumerate(usable) if part_of[t.machine] == part) for part in range(count)]
    elif len(usable) >= 6:
        parts = [frozenset(range(third, len(usable), 3)) for third in range(3)]
    if parts:
        return [
            Split(
                [trace for number, trace in enumerate(usable) if number not in held],
                [usable[number] for number in sorted(held)],
                [float(usable[number].times[0]) for number in sorted(held)],
                held,
            )
            for held in parts
        ]
    quarters: list[Split] = []
    for share in (0.5, 0.75):
        cuts = [_moment(trace, share) for trace in usable]
        ends = [_moment(trace, share + 0.25) for trace in usable]
        known = [trace.between(trace.times[0], cut) for trace, cut in zip(usable, cuts, strict=True)]
        # Forecasts of the third quarter must not be judged by the fourth; the row at the end itself still counts.
        ahead = [
            trace.between(trace.times[0], np.nextafter(end, np.inf)) for trace, end in zip(usable, ends, strict=True)
        ]
        quarters.append(Split([trace for trace in known if trace.times.size], ahead, cuts))
    return quarters


def _moment(trace: Trace, share: float) -> float:
    return float(trace.times[0] + share * (trace.times[-1] - trace.times[0]))

"""Stages 5 to 8 for one model and one trace: encode, check, simulate, compare, score. Pure but for the wall clock."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from hashlib import sha256
from math import nan
from time import perf_counter
from typing import Any

import numpy as np

from sim.engine import (
    Indices,
    Policy,
    Prediction,
    Score,
    errors,
    measured,
    moments,
    open_loop_schedule,
    schedule,
    score,
    simulate,
    start_law,
)
from sim.sha import Array, Event, Model, Trace, distributions, encode
from sim.validation.compatibility import Compatibility, compatibility, dense_events, symbols_of
from sim.validation.metrics import Band, Covered, error_quantiles, judge_band, mae_interval, rmse_interval
from sim.validation.results import TraceResult

MEMORY = 128 * 2**20
"""Bytes that the runs of one trace may take: of a longer trace a part of the readings, evenly spread, is simulated."""
DENSE_ROWS = 500_000
"""Rows of a trace that the dense comparison takes, at most (its first ones)."""
CLAMPED = 0.01
"""Share of the runs that may meet the border of the model's range unsaid: a normal law has tails."""
DRAWN = 2_000
"""Points of a curve that a picture needs."""
TROUBLE = (ValueError, ArithmeticError, MemoryError)
"""What unusable numbers and a lack of room can raise; everything else is a defect and is not caught."""


@dataclass(frozen=True, slots=True)
class TraceRunSettings:
    """How a campaign simulates: runs a trace, the policy for events without an edge, the seed."""

    runs: int = 1000
    policy: Policy = "resync"
    seed: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class TraceJob:
    """One model under one semantics along one trace (not yet encoded; only the signals that matter).

    `refusal` says why the model cannot be run: then nothing is done after the check of the events.
    """

    label: str
    semantics: str
    model: Model
    trace: Trace
    settings: TraceRunSettings
    refusal: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class TraceCourse:
    """What a picture shows, at most a few thousand points each: (times, ...) in absolute s and degC."""

    measured: tuple[Array, Array]
    mean: tuple[Array, Array]
    band: tuple[Array, Array, Array]
    inputs: Mapping[str, tuple[Array, Array]]
    events: tuple[Event, ...]
    seen: int


@dataclass(frozen=True, slots=True)
class Comparison:
    """Sparse against dense. `apart` is the largest difference of the two courses at the readings (degC).

    `rows` are the rows that were encoded fully, `events` the events that they gave, `taken` those the model has seen.
    """

    rows: int = 0
    events: int = 0
    taken: int = 0
    apart: float = nan


@dataclass(frozen=True, slots=True)
class TraceOutcome:
    """A job's result, with what the records of stages 5 to 8 and the picture need.

    `rows` of the trace, events of the `full` encoding, readings `simulated`, `seconds` by stage.
    """

    result: TraceResult
    compatibility: Compatibility | None = None
    comparison: Comparison = Comparison()
    rows: int = 0
    full: int = 0
    simulated: int = 0
    course: TraceCourse | None = None
    seconds: Mapping[int, float] = field(default_factory=dict)


@dataclass(slots=True)
class _Found:
    """What is known so far, so that a failure at any stage loses nothing of the stages before it."""

    outcome: TraceOutcome
    stage: int = 5
    seconds: dict[int, float] = field(default_factory=dict)

    @contextmanager
    def at(self, stage: int) -> Iterator[None]:
        """The block belongs to `stage`; its time is counted there."""
        self.stage, begin = stage, perf_counter()
        try:
            yield
        finally:
            self.seconds[stage] = self.seconds.get(stage, 0.0) + perf_counter() - begin

    def note(self, **figures: Any) -> None:
        """Put figures into the result."""
        self.outcome = replace(self.outcome, result=replace(self.outcome.result, **figures))


@dataclass(frozen=True, slots=True)
class _Readings:
    """The encoded trace, the times and values (n,) of its temperature, and the first rows in the full encoding."""

    trace: Trace
    times: Array
    values: Array
    full: Trace


@dataclass(frozen=True, slots=True)
class _Simulated:
    """The mean at every reading and event; the runs (m, runs) at `times` (m,), where `readings` (m,) were read."""

    mean: Prediction
    times: Array
    readings: Array
    rows: Array
    clamped: int


def run_job(job: TraceJob) -> TraceOutcome:
    """The job done, or the sentence of the stage that could not be passed. Equal jobs give equal results anywhere."""
    result = TraceResult(job.label, job.trace.name, job.semantics, synthetic=job.trace.synthetic)
    found = _Found(TraceOutcome(result, rows=job.trace.times.size))
    try:
        _stages(job, found)
    except TROUBLE as error:
        found.note(stage=found.stage, failure=str(error) or type(error).__name__)
    found.note(seconds=sum(found.seconds.values()))
    return replace(found.outcome, seconds=found.seconds)


def _stages(job: TraceJob, found: _Found) -> None:
    rng = generator(job)
    with found.at(5):
        read = _encoded(job)
        duration = float(read.times[-1] - read.times[0])
        found.outcome = replace(found.outcome, full=len(read.full.events))
        found.note(events=len(read.trace.events), readings=read.times.size, duration=duration)
    with found.at(6):
        checked = compatibility(job.model.sha, read.trace.events, job.settings.policy)
        found.outcome = replace(found.outcome, compatibility=checked)
        found.note(accepted=checked.accepted, rejected=checked.sentence)
        if job.refusal:
            found.stage = 4
            raise ValueError(job.refusal)
        _refuse(checked, job)
        runs = _simulate(job, read, rng)
    with found.at(7):
        dense, comparison = _dense(job, read, runs.mean)
        wrong = errors(runs.mean, read.trace, job.model.temperature)
        found.outcome = replace(found.outcome, comparison=comparison, simulated=runs.times.size)
        found.note(dense=dense, at_events=wrong.at_events, at_samples=wrong.at_samples)
        found.note(final_error=wrong.final, final_percent=wrong.final_percent)
    with found.at(8):
        band, covered = judge_band(runs.rows, runs.readings, job.model.sensor_sigma, rng)
        found.note(**_figures(job, read, runs, covered, rng))
        found.outcome = replace(found.outcome, course=_course(job, read, runs, band))


def generator(job: TraceJob) -> np.random.Generator:
    """The random numbers of a job: of its model, semantics and trace, and of nothing else that runs beside it."""
    name = "\n".join((job.label, job.semantics, job.trace.name)).encode()
    return np.random.default_rng([job.settings.seed, *sha256(name).digest()])


def _encoded(job: TraceJob) -> _Readings:
    trace, model = job.trace, job.model
    times, values = measured(trace, model.temperature)
    if times.size < 2:
        raise ValueError(f"trace {trace.name!r} has one reading of {model.temperature}; a run needs at least two")
    end = float(np.nextafter(trace.times[min(DENSE_ROWS, trace.times.size) - 1], np.inf))
    first = replace(trace, events=()).between(float(trace.times[0]), end)
    full = replace(first, events=encode(first, model.alphabet, "full"))
    return _Readings(replace(trace, events=encode(trace, model.alphabet)), times, values, full)


def _refuse(checked: Compatibility, job: TraceJob) -> None:
    """Raises ValueError where it makes no sense to go on."""
    if checked.accepted:
        return
    if job.settings.policy == "reject":
        raise ValueError(f"{checked.sentence}; the policies 'ignore' and 'resync' go on all the same")
    symbols = symbols_of(job.model.sha)
    if not {symbol for _, symbol in checked.pairs} & set(symbols) and checked.missing == checked.events:
        known = ", ".join(symbols[:12]) + (" ..." if len(symbols) > 12 else "")
        raise ValueError(f"{checked.sentence}; the model knows none of the trace's events, its own are {known}")


def _simulate(job: TraceJob, read: _Readings, rng: np.random.Generator) -> _Simulated:
    model, settings = job.model, job.settings
    law = start_law(model, read.trace)
    steps = open_loop_schedule(model, read.trace, settings.policy)
    mean = moments(steps, distributions.mean(law))
    places = _spread(read.times.size, max(2, MEMORY // (8 * settings.runs)))
    times, first = np.unique(read.times[places], return_index=True)
    some = schedule(model, read.trace.events, times, start=steps.start, inputs=read.trace, policy=settings.policy)
    rows = np.empty((times.size, settings.runs))
    runs = simulate(some, law, settings.runs, rng, out=rows)
    return _Simulated(mean, times, read.values[places][first], rows, int(np.count_nonzero(runs.clamps)))


def _spread(size: int, most: int) -> Indices:
    """At most `most` of `size` places, evenly spread, the first and the last among them."""
    return np.arange(size) if size <= most else np.unique(np.linspace(0, size - 1, most).astype(np.intp))


def _dense(job: TraceJob, read: _Readings, sparse: Prediction) -> tuple[Score, Comparison]:
    """The mean under the full encoding against all readings of its rows (the thesis's second run)."""
    model, policy = job.model, job.settings.policy
    end = float(read.full.times[-1])
    filtered = [event for event in read.trace.events if event.time <= end]
    events = dense_events(model.sha, read.full.events, filtered, policy)
    inside = read.times <= end
    times, values = read.times[inside], read.values[inside]
    outputs = np.unique(times)
    steps = schedule(model, events, outputs, start=float(times[0]), inputs=read.trace, policy=policy)
    course = moments(steps, float(values[0])).mean
    apart = np.abs(course - sparse.mean[np.searchsorted(sparse.times, outputs)])
    residual = course[np.searchsorted(outputs, times)] - values
    rows = read.full.times.size
    return score(residual), Comparison(rows, len(read.full.events), len(events), float(apart.max()))


def _figures(
    job: TraceJob, read: _Readings, runs: _Simulated, covered: Covered, rng: np.random.Generator
) -> dict[str, Any]:
    """The fields of the result that stage 8 gives."""
    predicted = runs.mean.mean[np.searchsorted(runs.mean.times, read.times)]
    residual = predicted - read.values
    return {
        "mae": mae_interval(residual, rng),
        "rmse": rmse_interval(residual, rng),
        "max_error": float(np.abs(residual).max()),
        "error_sigma": float(residual.std()),
        "coverage": covered.coverage,
        "crps": covered.crps,
        "beyond": covered.beyond,
        "persistence": float(np.abs(read.values - read.values[0]).mean()),
        "clamps": runs.mean.clamps,
        "limited": runs.mean.limited,
        "flags": _flags(job, runs),
        "error_quantiles": error_quantiles(residual),
    }


def _flags(job: TraceJob, runs: _Simulated) -> tuple[str, ...]:
    channels = job.model.alphabet.channels
    unheard = [channel.signal for channel in channels if channel.signal not in job.trace.signals]
    said = [f"signals: the trace has no {', '.join(unheard)}, so their events cannot be seen"] if unheard else []
    if runs.clamped > CLAMPED * job.settings.runs:
        said.append(f"runs: {runs.clamped} of {job.settings.runs} met the border of the model's range")
    return (*runs.mean.flags, *said)


def _course(job: TraceJob, read: _Readings, runs: _Simulated, band: Band) -> TraceCourse:
    def thinned(*columns: Array) -> tuple[Array, ...]:
        places = _spread(columns[0].size, DRAWN)
        return tuple(column[places] for column in columns)

    def read_signal(name: str) -> tuple[Array, Array]:
        times, values = measured(read.trace, name)
        return thinned(times, values)[0], thinned(times, values)[1]

    signals = read.trace.signals
    levels = {channel.signal: signals.get(channel.signal, np.empty(0)) for channel in job.model.alphabet.channels}
    inputs = {name: read_signal(name) for name, column in levels.items() if np.any(column > 1)}
    places = _spread(read.times.size, DRAWN)
    times, mean = thinned(runs.mean.times, runs.mean.mean)
    moments_of, low, high = thinned(runs.times, band.low, band.high)
    events = read.trace.events
    shown = tuple(events[place] for place in _spread(len(events), DRAWN).tolist())
    return TraceCourse(
        measured=(read.times[places], read.values[places]),
        mean=(times, mean),
        band=(moments_of, low, high),
        inputs=inputs,
        events=shown,
        seen=len(events),
    )

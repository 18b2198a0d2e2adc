"""A model's free run along one trace: stages 5 to 8 (encode, check, simulate, compare, score), or in closed form."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from hashlib import sha256
from math import nan
from time import perf_counter
from typing import Any

import numpy as np

from sim.engine import (
    Policy,
    Prediction,
    Score,
    errors,
    moments,
    open_loop,
    open_loop_schedule,
    readings,
    schedule,
    score,
    simulate,
    start_law,
)
from sim.lab.judge.compatibility import Compatibility, compatibility, dense_events, edge_symbols
from sim.lab.judge.metrics import error_quantiles, judge_band, mae_interval, rmse_interval
from sim.lab.judge.results import Seen, TraceResult
from sim.scores import crps_gaussian, log_score_gaussian
from sim.sha import Array, Event, Indices, Model, Trace, distributions, encode, encode_trace, signal_unit

MAX_RUN_BYTES = 128 * 2**20
"""Bytes that the runs of one trace may take: of a longer trace a part of the readings, evenly spread, is simulated."""
MAX_DENSE_ROWS = 500_000
"""Rows of a trace that the dense comparison takes, at most (its first ones)."""
MAX_CLAMPED_SHARE = 0.01
"""Share of the runs that may meet the border of the model's range unsaid: a normal law has tails."""
MAX_CURVE_POINTS = 2_000
"""Points of a curve that a picture needs."""
MIN_SIGMA_DEGC = 1e-6
"""A least standard deviation (degC) of a law that has a likelihood."""
RUN_ERRORS = (ValueError, ArithmeticError, MemoryError)
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

    `refusal` says why the model cannot be run: then nothing is done after the check of the events. `seen` says whether
    the model was trained on the trace.
    """

    label: str
    semantics: str
    model: Model
    trace: Trace
    settings: TraceRunSettings
    refusal: str = ""
    seen: Seen = "unknown"


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
class _PartialOutcome:
    """What is known so far, so that a failure at any stage loses nothing of the stages before it."""

    outcome: TraceOutcome
    stage: int = 5
    seconds: dict[int, float] = field(default_factory=dict)

    @contextmanager
    def time_stage(self, stage: int) -> Iterator[None]:
        """The block belongs to `stage`; its time is counted there."""
        self.stage, begin = stage, perf_counter()
        try:
            yield
        finally:
            self.seconds[stage] = self.seconds.get(stage, 0.0) + perf_counter() - begin

    def note(self, **figures: Any) -> None:
        """Put figures into the result."""
        self.outcome = replace(self.outcome, result=replace(self.outcome.result, **figures))


def run_job(job: TraceJob) -> TraceOutcome:
    """The job done, or the sentence of the stage that could not be passed. Equal jobs give equal results anywhere."""
    unit = signal_unit([job.trace], job.model.temperature, job.model.unit)
    result = TraceResult(
        job.label, job.trace.name, job.semantics, synthetic=job.trace.synthetic, unit=unit, seen=job.seen
    )
    partial = _PartialOutcome(TraceOutcome(result, rows=job.trace.times.size))
    try:
        _stages(job, partial)
    except RUN_ERRORS as error:
        partial.note(stage=partial.stage, failure=str(error) or type(error).__name__)
    partial.note(seconds=sum(partial.seconds.values()))
    return replace(partial.outcome, seconds=partial.seconds)


def _stages(job: TraceJob, partial: _PartialOutcome) -> None:
    """Stages 5 to 8. Raises RUN_ERRORS; what was noted in `partial` by then stays."""
    model, settings = job.model, job.settings
    rng = generator(job)
    with partial.time_stage(5):
        times, values = readings(job.trace, model.temperature)
        if times.size < 2:
            raise ValueError(
                f"trace {job.trace.name!r} has one reading of {model.temperature}; a run needs at least two"
            )
        # `between` leaves its end out, so the end lies one float behind the last row that is wanted.
        end = float(np.nextafter(job.trace.times[min(MAX_DENSE_ROWS, job.trace.times.size) - 1], np.inf))
        full = replace(job.trace, events=()).between(float(job.trace.times[0]), end)
        full = replace(full, events=encode(full, model.alphabet, "full"))
        trace = encode_trace(job.trace, model.alphabet)
        partial.outcome = replace(partial.outcome, full=len(full.events))
        partial.note(events=len(trace.events), readings=times.size, duration=float(times[-1] - times[0]))
    with partial.time_stage(6):
        checked = compatibility(model.sha, trace.events, settings.policy)
        partial.outcome = replace(partial.outcome, compatibility=checked)
        partial.note(accepted=checked.accepts_all, rejected=checked.sentence)
        # Only now: a model that cannot be run still says which of the trace's events it has edges for.
        if job.refusal:
            partial.stage = 4
            raise ValueError(job.refusal)
        if not checked.accepts_all and settings.policy == "reject":
            raise ValueError(f"{checked.sentence}; the policies 'ignore' and 'resync' go on all the same")
        # A model that knows none of the symbols belongs to another plant or another alphabet: any policy would give
        # figures, and they would mean nothing.
        symbols = edge_symbols(model.sha)
        strange = checked.missing == checked.events and not {symbol for _, symbol in checked.pairs} & set(symbols)
        if not checked.accepts_all and strange:
            known = ", ".join(symbols[:12]) + (" ..." if len(symbols) > 12 else "")
            raise ValueError(f"{checked.sentence}; the model knows none of the trace's events, its own are {known}")
        law = start_law(model, trace)
        steps = open_loop_schedule(model, trace, settings.policy)
        prediction = moments(steps, distributions.mean(law))
        # The mean is exact at every reading; the runs are drawn at as many of them as MAX_RUN_BYTES holds (8 bytes a
        # number).
        places = _spread_places(times.size, max(2, MAX_RUN_BYTES // (8 * settings.runs)))
        run_times, first = np.unique(times[places], return_index=True)
        some = schedule(model, trace.events, run_times, start=steps.start, inputs=trace, policy=settings.policy)
        runs = np.empty((run_times.size, settings.runs))
        clamped = int(np.count_nonzero(simulate(some, law, settings.runs, rng, out=runs).clamps))
    with partial.time_stage(7):
        dense, comparison = _dense(job, trace, full, prediction)
        wrong = errors(prediction, trace, model.temperature)
        partial.outcome = replace(partial.outcome, comparison=comparison, simulated=run_times.size)
        partial.note(dense=dense, at_events=wrong.at_events, at_samples=wrong.at_samples)
        partial.note(final_error=wrong.final, final_percent=wrong.final_percent)
    with partial.time_stage(8):
        band, covered = judge_band(runs, values[places][first], model.sensor_sigma, rng)
        residual = prediction.mean[np.searchsorted(prediction.times, times)] - values
        flags = list(prediction.flags)
        unheard = [channel.signal for channel in model.alphabet.channels if channel.signal not in job.trace.signals]
        if unheard:
            flags.append(f"signals: the trace has no {', '.join(unheard)}, so their events cannot be seen")
        if clamped > MAX_CLAMPED_SHARE * settings.runs:
            flags.append(f"runs: {clamped} of {settings.runs} met the border of the model's range")
        partial.note(
            # In this order: both intervals draw from the job's one sequence of random numbers.
            mae=mae_interval(residual, rng),
            rmse=rmse_interval(residual, rng),
            max_error=float(np.abs(residual).max()),
            error_sigma=float(residual.std()),
            coverage=covered.coverage,
            crps=covered.crps,
            beyond=covered.beyond,
            persistence=float(np.abs(values - values[0]).mean()),
            clamps=prediction.clamps,
            limited=prediction.limited,
            flags=tuple(flags),
            error_quantiles=error_quantiles(residual),
            level=float(np.abs(values).mean()),
        )
        course = _course(model, trace, prediction, (run_times, band.low, band.high))
        partial.outcome = replace(partial.outcome, course=course)


def generator(job: TraceJob) -> np.random.Generator:
    """The random numbers of a job: of its model, semantics and trace, and of nothing else that runs beside it."""
    name = "\n".join((job.label, job.semantics, job.trace.name)).encode()
    return np.random.default_rng([job.settings.seed, *sha256(name).digest()])


def _spread_places(size: int, most: int) -> Indices:
    """At most `most` of `size` places, evenly spread, the first and the last among them."""
    return np.arange(size) if size <= most else np.unique(np.linspace(0, size - 1, most).astype(np.intp))


def _dense(job: TraceJob, trace: Trace, full: Trace, sparse: Prediction) -> tuple[Score, Comparison]:
    """The mean under the full encoding against all readings of its rows (the thesis's second run).

    `trace` has the events of the filtered encoding, `full` its first rows with those of the full one.
    """
    model, policy = job.model, job.settings.policy
    end = float(full.times[-1])
    filtered = [event for event in trace.events if event.time <= end]
    events = dense_events(model.sha, full.events, filtered, policy)
    times, values = readings(trace, model.temperature)
    inside = times <= end
    times, values = times[inside], values[inside]
    outputs = np.unique(times)
    steps = schedule(model, events, outputs, start=float(times[0]), inputs=trace, policy=policy)
    course = moments(steps, float(values[0])).mean
    apart = np.abs(course - sparse.mean[np.searchsorted(sparse.times, outputs)])
    residual = course[np.searchsorted(outputs, times)] - values
    return score(residual), Comparison(full.times.size, len(full.events), len(events), float(apart.max()))


def _course(model: Model, trace: Trace, prediction: Prediction, band: tuple[Array, Array, Array]) -> TraceCourse:
    """What a picture of the encoded `trace` shows; `band` is (times, low, high) of the runs."""

    def thin_curve(*columns: Array) -> tuple[Array, ...]:
        places = _spread_places(columns[0].size, MAX_CURVE_POINTS)
        return tuple(column[places] for column in columns)

    inputs = {}
    for channel in model.alphabet.channels:
        # What is never above 1 is a switch, which the picture shows by its events.
        if np.any(trace.signals.get(channel.signal, np.empty(0)) > 1):
            read_at, levels = thin_curve(*readings(trace, channel.signal))
            inputs[channel.signal] = (read_at, levels)
    times, values = thin_curve(*readings(trace, model.temperature))
    mean_times, mean = thin_curve(prediction.times, prediction.mean)
    band_times, low, high = thin_curve(*band)
    return TraceCourse(
        measured=(times, values),
        mean=(mean_times, mean),
        band=(band_times, low, high),
        inputs=inputs,
        events=tuple(trace.events[place] for place in _spread_places(len(trace.events), MAX_CURVE_POINTS).tolist()),
        seen=len(trace.events),
    )


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


def predict_trace(model: Model, trace: Trace) -> tuple[Array, Array, Array]:
    """(readings, mean, standard deviation), each (n - 1,) in degC, of an open-loop run from the first of n readings.

    Closed form: mean and variance of `moments`, with the sensor's variance added. The trace is encoded by the model's
    own alphabet; an event without an edge leads where its symbol does most often (`resync`). Raises ValueError where
    the model cannot be run along the trace.
    """
    run = open_loop(model, encode_trace(trace, model.alphabet), "resync")
    times, values = readings(trace, model.temperature)
    # The last output at each reading's time; without the first reading, from which the run starts.
    rows = np.searchsorted(run.times, times, side="right")[1:] - 1
    return values[1:], run.mean[rows], np.sqrt(run.variance[rows] + model.sensor_sigma**2)


def score_fold(model: Model, trace: Trace) -> HeldOutFold:
    """The scores of one trace. Raises ValueError as `predict_trace` does."""
    values, mean, sigma = predict_trace(model, trace)
    error = mean - values
    # A model may be certain of itself (sigma 0): the log-likelihood would be infinite, so it gets a least sigma. The
    # CRPS needs none: there it is the absolute error.
    return HeldOutFold(
        trace=trace.name,
        readings=int(values.size),
        crps=float(np.mean(crps_gaussian(mean, sigma, values))),
        log_likelihood=-float(np.mean(log_score_gaussian(mean, np.maximum(sigma, MIN_SIGMA_DEGC), values))),
        mae=float(np.mean(np.abs(error))),
        largest=float(np.max(np.abs(error))),
    )

"""Many models along many traces: the jobs, where they run (here, in processes, on a Dask cluster), what came out.

A job depends on its model, its trace and the seed alone, so that results do not depend on the number of workers, on
where they run or on what runs beside them.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import groupby

from sim.effects import signals_of
from sim.lab.recordings import LoadReport
from sim.lab.validation.results import TraceResult
from sim.lab.validation.seen import seen_traces
from sim.lab.validation.stages import Prepared
from sim.lab.validation.trace_run import TraceJob, TraceOutcome, TraceRunSettings, run_job
from sim.lab.workers import cluster, processes
from sim.sha import Model, Trace

Progress = Callable[[str, float], None]
Runner = Callable[[Sequence[TraceJob]], Iterator[TraceOutcome]]
"""Gives the outcomes of jobs in the jobs' order, each as soon as it and all before it are there."""

TINY = 20_000_000
"""Simulated temperatures (readings times runs) below which worker processes would cost more than they save."""


@dataclass(frozen=True, slots=True)
class Unread:
    """A file that gave no trace, and why."""

    name: str
    reason: str


def unread(report: LoadReport, traces: Sequence[Trace]) -> tuple[Unread, ...]:
    """The files of a load that gave nothing, but for parts of a trace that was put together from other parts."""
    loaded = {trace.name for trace in traces}
    failed = (file for file in report.files if file.error and file.path.absolute().parent.name not in loaded)
    return tuple(Unread(file.path.stem, file.error) for file in failed)


def jobs_of(prepared: Prepared, traces: Sequence[Trace], settings: TraceRunSettings) -> list[TraceJob]:
    """The jobs of one model: its semantics one after the other, each along all traces.

    A model that cannot be run has one job a trace all the same, which ends after the check of the events.
    """
    if not prepared.variants:
        (semantics, reason), *_ = prepared.refusals.items()
        jobs = [(semantics or "none", prepared.structure, reason)]
    else:
        jobs = [(semantics, model, "") for semantics, model in prepared.variants.items()]
    # Of the structure, which has the origin of all variants, and of whole traces: a slim one has another content.
    seen = seen_traces(prepared.structure, traces)
    return [
        TraceJob(
            label=prepared.label,
            semantics=semantics,
            model=model,
            trace=slim(trace, model),
            settings=settings,
            refusal=reason,
            seen=seen[trace.name],
        )
        for semantics, model, reason in jobs
        for trace in traces
    ]


def slim(trace: Trace, model: Model) -> Trace:
    """The signals that the model can see; events are encoded where the job runs."""
    wanted = {model.temperature, *(channel.signal for channel in model.alphabet.channels)}
    wanted |= {driving.signal for location in model.sha.locations for driving in location.flow.inputs}
    wanted |= set(signals_of(model.sha))
    signals = {name: column for name, column in trace.signals.items() if name in wanted}
    bad = {name: column for name, column in trace.bad.items() if name in wanted}
    return replace(trace, signals=signals, bad=bad, events=())


def outcomes_by_model(
    prepared: Sequence[Prepared],
    traces: Sequence[Trace],
    *,
    without: Sequence[Unread],
    settings: TraceRunSettings,
    run: Runner,
    progress: Progress,
) -> Iterator[tuple[Prepared, list[TraceOutcome]]]:
    """Each model with its outcomes, as soon as they are there; files that gave no trace have failed at stage 5."""
    jobs = [job for model in prepared for job in jobs_of(model, traces, settings)]
    by_label = {model.label: model for model in prepared}
    running = zip(jobs, run(jobs), strict=True)
    done = 0
    for label, group in groupby(running, key=lambda pair: pair[0].label):
        outcomes = []
        for job, outcome in group:
            outcomes.append(outcome)
            done += 1
            progress(f"{label}: {job.trace.name}", done / len(jobs))
        for semantics in dict.fromkeys(outcome.result.semantics for outcome in outcomes):
            for file in without:
                outcomes.append(TraceOutcome(TraceResult(label, file.name, semantics, stage=5, failure=file.reason)))
        yield by_label[label], outcomes


def run_here(workers: int) -> Runner:
    """Jobs in this process (one worker, or little to do), else in `workers` processes."""

    def run(jobs: Sequence[TraceJob]) -> Iterator[TraceOutcome]:
        work = sum(job.trace.times.size * job.settings.runs for job in jobs if not job.refusal)
        return processes(1 if work < TINY else workers)(run_job, jobs, _undone)

    return run


@contextmanager
def run_there(address: str) -> Iterator[Runner]:
    """Jobs on the Dask cluster at `address`. Raises ValueError as `cluster` does."""
    with cluster(address) as workers:
        yield lambda jobs: workers(run_job, jobs, _undone)


def _undone(job: TraceJob, reason: str) -> TraceOutcome:
    result = TraceResult(job.label, job.trace.name, job.semantics, synthetic=job.trace.synthetic, stage=5)
    return TraceOutcome(replace(result, seen=job.seen, failure=reason), rows=job.trace.times.size)

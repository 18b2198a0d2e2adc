"""Many models along many traces: the jobs, where they run (here, in processes, on a Dask cluster), what came out.

A job depends on its model, its trace and the seed alone, so that results do not depend on the number of workers, on
where they run or on what runs beside them.
"""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib import import_module
from itertools import groupby
from typing import TypeVar

from sim.sha.model import Model
from sim.sha.trace import Trace
from sim.validation.load_report import LoadReport
from sim.validation.results import TraceResult
from sim.validation.stages import Prepared
from sim.validation.trace_run import Job, Outcome, Settings, run_job

Progress = Callable[[str, float], None]
T = TypeVar("T")
R = TypeVar("R")
Runner = Callable[[Sequence[Job]], Iterator[Outcome]]
"""Gives the outcomes of jobs in the jobs' order, each as soon as it and all before it are there."""

TINY = 20_000_000
"""Simulated temperatures (readings times runs) below which worker processes would cost more than they save."""
REACHABLE_WITHIN = 10.0
"""Seconds in which a cluster must answer and have a worker."""


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


def jobs_of(prepared: Prepared, traces: Sequence[Trace], settings: Settings) -> list[Job]:
    """The jobs of one model: its semantics one after the other, each along all traces.

    A model that cannot be run has one job a trace all the same, which ends after the check of the events.
    """
    if not prepared.variants:
        (semantics, reason), *_ = prepared.refusals.items()
        jobs = [(semantics or "none", prepared.skeleton, reason)]
    else:
        jobs = [(semantics, model, "") for semantics, model in prepared.variants.items()]
    return [
        Job(prepared.label, semantics, model, slim(trace, model), settings, reason)
        for semantics, model, reason in jobs
        for trace in traces
    ]


def slim(trace: Trace, model: Model) -> Trace:
    """The signals that the model can see; events are encoded where the job runs."""
    wanted = {model.temperature, *(channel.signal for channel in model.alphabet.channels)}
    wanted |= {given.signal for location in model.sha.locations for given in location.flow.inputs}
    signals = {name: column for name, column in trace.signals.items() if name in wanted}
    bad = {name: column for name, column in trace.bad.items() if name in wanted}
    return replace(trace, signals=signals, bad=bad, events=())


def outcomes_by_model(
    prepared: Sequence[Prepared],
    traces: Sequence[Trace],
    without: Sequence[Unread],
    settings: Settings,
    run: Runner,
    progress: Progress,
) -> Iterator[tuple[Prepared, list[Outcome]]]:
    """Each model with its outcomes, as soon as they are there; files that gave no trace have failed at stage 5."""
    jobs = [job for one in prepared for job in jobs_of(one, traces, settings)]
    by_label = {one.label: one for one in prepared}
    running = zip(jobs, run(jobs), strict=True)
    done = 0
    for label, group in groupby(running, key=lambda pair: pair[0].label):
        outcomes = []
        for job, outcome in group:
            outcomes.append(outcome)
            done += 1
            progress(f"{label}: {job.trace.name}", done / len(jobs))
        for semantics in dict.fromkeys(outcome.result.semantics for outcome in outcomes):
            outcomes += [_lost(label, semantics, file) for file in without]
        yield by_label[label], outcomes


def _lost(label: str, semantics: str, file: Unread) -> Outcome:
    return Outcome(TraceResult(label, file.name, semantics, stage=5, failure=file.reason))


def run_here(workers: int) -> Runner:
    """Jobs in this process (one worker, or little to do), else in `workers` processes."""

    def run(jobs: Sequence[Job]) -> Iterator[Outcome]:
        if workers == 1 or _work(jobs) < TINY:
            yield from map(run_job, jobs)
        else:
            yield from parallel(run_job, jobs, workers)

    return run


def _work(jobs: Sequence[Job]) -> int:
    return sum(job.trace.times.size * job.settings.runs for job in jobs if not job.refusal)


def parallel(function: Callable[[T], R], items: Sequence[T], workers: int) -> Iterator[R]:
    """`map` over processes, in order. Raises ValueError when a process was killed."""
    from joblib import Parallel, delayed

    pool = Parallel(n_jobs=workers, return_as="generator")
    try:
        yield from pool(delayed(function)(item) for item in items)
    except BrokenProcessPool:
        raise ValueError(
            "a worker process was killed, most often for want of memory; take fewer --jobs or --runs"
        ) from None


@contextmanager
def cluster(address: str) -> Iterator[Runner]:
    """Jobs on the workers of the Dask scheduler at `address` (tcp://host:port), which must have this package too.

    What a worker cannot do (it was killed, it lacks the package) is that job's failure. Raises ValueError without the
    extra `cluster`, and where no scheduler answers within REACHABLE_WITHIN or it has no worker.
    """
    try:
        distributed = import_module("distributed")
    except ImportError:
        raise ValueError(
            "--cluster needs Dask, which is not installed; install the extra: pip install 'decanter-gateway[cluster]'"
        ) from None
    try:
        client = distributed.Client(address, timeout=REACHABLE_WITHIN, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        raise ValueError(
            f"{address}: no Dask scheduler answers there ({_reason(error)}); give tcp://HOST:PORT"
        ) from None

    def run(jobs: Sequence[Job]) -> Iterator[Outcome]:
        futures = [client.submit(run_job, job, pure=False) for job in jobs]
        for job, future in zip(jobs, futures, strict=True):
            error = future.exception()
            yield future.result() if error is None else _undone(job, error)

    with client:
        try:
            client.wait_for_workers(1, timeout=REACHABLE_WITHIN)
        except TimeoutError:
            raise ValueError(f"{address}: the Dask scheduler has no worker; start one: dask worker {address}") from None
        yield run


def _undone(job: Job, error: BaseException) -> Outcome:
    result = TraceResult(job.label, job.trace.name, job.semantics, synthetic=job.trace.synthetic, stage=5)
    said = f"the cluster could not run it ({type(error).__name__}: {_reason(error)})"
    return Outcome(replace(result, failure=said), rows=job.trace.times.size)


def _reason(error: BaseException) -> str:
    return " ".join(str(error).split())[:300] or type(error).__name__

"""Many models along many traces: the jobs, where they run (here, in processes, on a Dask cluster), what came out.

A job depends on its model, its trace and the seed alone, so that results do not depend on the number of workers, on
where they run or on what runs beside them.
"""

import logging
import re
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib import import_module
from itertools import groupby
from typing import Any, TypeVar
from warnings import catch_warnings, simplefilter

from sim.effects import signals_of
from sim.sha import Model, Trace
from sim.traces import LoadReport
from sim.validation.results import TraceResult
from sim.validation.seen import seen_traces
from sim.validation.stages import Prepared
from sim.validation.trace_run import TraceJob, TraceOutcome, TraceRunSettings, run_job

Progress = Callable[[str, float], None]
T = TypeVar("T")
R = TypeVar("R")
Runner = Callable[[Sequence[TraceJob]], Iterator[TraceOutcome]]
"""Gives the outcomes of jobs in the jobs' order, each as soon as it and all before it are there."""

TINY = 20_000_000
"""Simulated temperatures (readings times runs) below which worker processes would cost more than they save."""
KILLED = "a worker process was killed, most often for want of memory; take fewer --jobs or --runs"
ADDRESS = re.compile(r"(tcp|tls)://(\[[0-9a-fA-F:.%]+\]|[^\s:/\[\]]+):[0-9]{1,5}")
"""What a Dask scheduler's address looks like."""
REACHABLE_WITHIN = 10.0
"""Seconds in which a cluster must answer and have a worker."""
PATIENCE = 3
"""So many times that long a cluster may be without any worker while work waits for it: a nanny starts a new one."""


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
        if workers == 1 or work < TINY:
            yield from map(run_job, jobs)
        else:
            yield from parallel(run_job, jobs, workers, lambda job: _undone(job, KILLED))

    return run


def parallel(
    function: Callable[[T], R], items: Sequence[T], workers: int, lost: Callable[[T], R] | None = None
) -> Iterator[R]:
    """`map` over processes, in order.

    When a process is killed, the first item without a result is done again by itself and the rest goes on after it. If
    it is killed then too, `lost` says what stands in its place; without `lost` that raises ValueError.
    """
    from joblib import Parallel, delayed

    done, alone = 0, False
    while done < len(items):
        part = items[done : done + 1] if alone else items[done:]
        work = Parallel(n_jobs=workers, return_as="generator")
        try:
            with _quietly_closed(work(delayed(function)(item) for item in part)) as results:
                for result in results:
                    yield result
                    done += 1
            alone = False
        except BrokenProcessPool:
            if alone:
                if lost is None:
                    raise ValueError(KILLED) from None
                yield lost(items[done])
                done += 1
            alone = not alone


@contextmanager
def _quietly_closed(results: Generator[R, None, None]) -> Iterator[Generator[R, None, None]]:
    """Where the caller stops early, joblib need not say what was left undone."""
    try:
        yield results
    finally:
        with catch_warnings():
            simplefilter("ignore", UserWarning)
            results.close()


@contextmanager
def cluster(address: str) -> Iterator[Runner]:
    """Jobs on the workers of the Dask scheduler at `address` (tcp://host:port), which must have this package too.

    What a worker cannot do (it was killed, it lacks the package) is that job's failure. Raises ValueError without the
    extra `cluster`, where no scheduler answers within REACHABLE_WITHIN or it has no worker, and when the scheduler or
    all workers go away for good.
    """
    try:
        distributed = import_module("distributed")
    except ImportError:
        raise ValueError(
            "--cluster needs Dask, which is not installed; install the extra: pip install 'decanter-gateway[cluster]'"
        ) from None
    # The address is looked at before a client is made: one that cannot be made waits 20 s and complains when it is
    # collected.
    if not ADDRESS.fullmatch(address):
        raise ValueError(f"{address!r}: no Dask scheduler answers there, as it is no address; give tcp://HOST:PORT")
    if address.startswith("tls") and distributed.Security().get_connection_args("client").get("ssl_context") is None:
        raise ValueError(
            f"{address}: a TLS connection needs its certificates in Dask's configuration (distributed.comm.tls); "
            "see Dask's documentation on TLS"
        )
    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)  # what it would say becomes a sentence here
    try:
        client = distributed.Client(address, timeout=REACHABLE_WITHIN, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        raise ValueError(
            f"{address}: no Dask scheduler answers there ({_reason(error)}); give tcp://HOST:PORT"
        ) from None

    def run(jobs: Sequence[TraceJob]) -> Iterator[TraceOutcome]:
        # Not pure: Dask takes a pure call with equal arguments for one that it has done already.
        futures = [client.submit(run_job, job, pure=False) for job in jobs]
        for job, future in zip(jobs, futures, strict=True):
            error = waited_for(future, client, address)
            if error is None:
                yield future.result()
            else:
                yield _undone(job, f"the cluster could not run it ({type(error).__name__}: {_reason(error)})")

    with client:
        try:
            client.wait_for_workers(1, timeout=REACHABLE_WITHIN)
        except TimeoutError:
            raise ValueError(f"{address}: the Dask scheduler has no worker; start one: dask worker {address}") from None
        yield run


def waited_for(future: Any, client: Any, address: str) -> BaseException | None:
    """What went wrong with a future, once it is over. Raises ValueError when there is nobody left to do it."""
    without = 0
    try:
        while without < PATIENCE:
            try:
                error: BaseException | None = future.exception(timeout=REACHABLE_WITHIN)
            except TimeoutError:
                without = 0 if client.scheduler_info()["workers"] else without + 1
            else:
                if future.cancelled():
                    break
                return error
    except OSError:
        without = 0
    reason = "the cluster has no worker any more" if without else "the connection to the Dask scheduler was lost"
    raise ValueError(f"{address}: {reason}; start it again, and the campaign with --overwrite")


def _undone(job: TraceJob, reason: str) -> TraceOutcome:
    result = TraceResult(job.label, job.trace.name, job.semantics, synthetic=job.trace.synthetic, stage=5)
    return TraceOutcome(replace(result, seen=job.seen, failure=reason), rows=job.trace.times.size)


def _reason(error: BaseException) -> str:
    return " ".join(str(error).split())[:300] or type(error).__name__

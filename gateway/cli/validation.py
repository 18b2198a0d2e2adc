"""A validation campaign for the command line: everything checked and read before the first file is written."""

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from time import perf_counter

from sim.sha.trace import Trace
from sim.validation.campaign import Progress, Runner, cluster, run_here, unread
from sim.validation.column_map import ColumnMap, load_map
from sim.validation.conduct import Plan, conduct
from sim.validation.output_folder import check_folder, claim_folder
from sim.validation.report import Campaign
from sim.validation.results import TraceResult
from sim.validation.stage_records import load_stage
from sim.validation.stages import Prepared, Wanted, prepare, relabelled
from sim.validation.trace_run import Settings
from sim.validation.traces import load_traces, units


@dataclass(frozen=True, slots=True)
class Request:
    """The options of `decanter model validate`. `created` is the time for the report, in seconds UTC."""

    models: Sequence[str]
    paths: Sequence[str]
    map_file: Path
    out: Path
    overwrite: bool
    wanted: Wanted
    training: Sequence[str]
    settings: Settings
    jobs: int | None
    address: str | None
    pictures: bool
    created: float


def campaign(
    request: Request, tell: Callable[[str], None], progress: Progress
) -> tuple[list[Prepared], list[TraceResult]]:
    """The models and the results of all of them; the folder is complete then.

    Raises ValueError or OSError, before anything is written, for a folder, a map, a model, a set of traces or a cluster
    that cannot be used.
    """
    stale = check_folder(request.out, overwrite=request.overwrite)
    column_map = load_map(request.map_file)
    workers = request.jobs or len(os.sched_getaffinity(0))
    with _runner(request.address, workers) as run:
        prepared = _prepared(request, column_map, progress)
        progress("reading traces", 0.0)
        begin = perf_counter()
        traces, report = load_traces(list(request.paths), column_map)
        loading = load_stage(report, perf_counter() - begin)
        facts = _facts(request, traces)
        created = datetime.fromtimestamp(request.created, UTC).strftime("%Y-%m-%d %H:%M UTC")
        labels = [one.label for one in prepared]
        folder = claim_folder(request.out, stale, labels, {"created": created, **facts})
        plan = Plan(request.settings, run, workers, request.pictures, units(column_map), Campaign(created, facts))
        missing = unread(report, traces)
        return prepared, conduct(prepared, traces, missing, loading, plan, folder, tell, progress)


@contextmanager
def _runner(address: str | None, workers: int) -> Iterator[Runner]:
    if address is None:
        yield run_here(workers)
        return
    with cluster(address) as run:
        yield run


def _prepared(request: Request, column_map: ColumnMap, progress: Progress) -> list[Prepared]:
    """Every model after its stages 1 to 4. Raises ValueError where one cannot be read."""
    training = load_traces(list(request.training), column_map)[0] if request.training else None
    made = []
    for number, where in enumerate(request.models):
        progress(where, number / len(request.models))
        made.append(
            prepare(
                where,
                column_map.alphabet,
                column_map.temperature,
                wanted=request.wanted,
                training=training,
                seed=request.settings.seed,
            )
        )
    return relabelled(made)


def _facts(request: Request, traces: Sequence[Trace]) -> dict[str, str]:
    settings = request.settings
    return {
        "traces": f"{len(traces)} from {', '.join(request.paths)}",
        "map": request.map_file.stem,
        "runs": str(settings.runs),
        "policy": settings.policy,
        "semantics": request.wanted,
        "seed": str(settings.seed),
        "decanter": version("decanter-gateway"),
    }

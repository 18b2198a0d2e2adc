"""A validation campaign for the command line: everything checked and read before the first file is written."""

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from time import perf_counter

from sim.artefacts.model_directory import write_model_directory
from sim.ranking.tuning_methods import METHODS, Task
from sim.sha.trace import Trace
from sim.traces.column_map import ColumnMap, load_map
from sim.traces.traces import load_traces, units
from sim.validation.campaign import Progress, Runner, cluster, run_here, unread
from sim.validation.conduct import CampaignPlan, conduct
from sim.validation.output_folder import LEARNED, check_folder, claim_folder, held
from sim.validation.report import CampaignSummary
from sim.validation.results import TraceResult
from sim.validation.stage_records import load_stage
from sim.validation.stages import Prepared, Wanted, prepare, relabelled
from sim.validation.trace_run import TraceRunSettings


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
    settings: TraceRunSettings
    jobs: int | None
    address: str | None
    pictures: bool
    created: float


def campaign(
    request: Request, tell: Callable[[str], None], progress: Progress
) -> tuple[list[Prepared], list[TraceResult]]:
    """The models and the results of all of them; the folder is complete then.

    Raises ValueError or OSError, before anything is written, for a folder, a map, a model, a set of traces or a cluster
    that cannot be used. Models that are to be learned (see `methods_in`) are learned once all that is known to be good.
    """
    check_folder(request.out, overwrite=request.overwrite)
    column_map = load_map(request.map_file)
    workers = request.jobs or len(os.sched_getaffinity(0))
    with _runner(request.address, workers) as run:
        training = _training(request, column_map)
        ready = _ready(request, column_map, training, progress)
        progress("reading traces", 0.0)
        begin = perf_counter()
        traces, report = load_traces(list(request.paths), column_map)
        loading = load_stage(report, perf_counter() - begin)
        facts = _facts(request, traces)
        created = datetime.fromtimestamp(request.created, UTC).strftime("%Y-%m-%d %H:%M UTC")
        plan = CampaignPlan(
            request.settings, run, workers, request.pictures, units(column_map), CampaignSummary(created, facts)
        )
        with held(request.out):
            stale = check_folder(request.out, overwrite=request.overwrite)  # again: nobody else can write there now
            folder = claim_folder(request.out, stale, (), {"created": created, **facts})
            known = training or ()
            made = [one or _taught(where, request, column_map, known, progress) for where, one in ready]
            prepared = relabelled(made)
            folder.assign([one.label for one in prepared])
            return prepared, conduct(prepared, traces, unread(report, traces), loading, plan, folder, tell, progress)


@contextmanager
def _runner(address: str | None, workers: int) -> Iterator[Runner]:
    if address is None:
        yield run_here(workers)
        return
    with cluster(address) as run:
        yield run


def to_learn(models: Sequence[str]) -> list[str]:
    """Those of the MODEL arguments that name a method of learning and nothing that is there."""
    return [name for name in models if name in METHODS and not Path(name).exists()]


def _training(request: Request, column_map: ColumnMap) -> list[Trace] | None:
    """Raises ValueError where they cannot be read, or are not given and a model is to be learned from them."""
    wanted = to_learn(request.models)
    if wanted and not request.training:
        raise ValueError(f"{wanted[0]}: there is no such model; to learn one by this method give --training TRACES")
    return load_traces(list(request.training), column_map)[0] if request.training else None


def _ready(
    request: Request, column_map: ColumnMap, training: Sequence[Trace] | None, progress: Progress
) -> list[tuple[str, Prepared | None]]:
    """Each model argument with its model after stages 1 to 4, None where it is to be learned. Raises ValueError."""
    unlearned = to_learn(request.models)
    ready: list[tuple[str, Prepared | None]] = []
    for number, where in enumerate(request.models):
        progress(where, number / len(request.models))
        ready.append((where, None if where in unlearned else _prepared(where, request, column_map, training)))
    return ready


def _prepared(where: str, request: Request, column_map: ColumnMap, training: Sequence[Trace] | None) -> Prepared:
    return prepare(
        where,
        column_map.alphabet,
        column_map.temperature,
        wanted=request.wanted,
        training=training,
        seed=request.settings.seed,
    )


def _taught(
    name: str, request: Request, column_map: ColumnMap, training: Sequence[Trace], progress: Progress
) -> Prepared:
    """A model learned by the method `name` with its defaults, written to the campaign's folder, and then prepared."""
    progress(f"learning by {name}", 0.0)
    silent = [replace(trace, events=()) for trace in training]
    task = Task(silent, column_map.alphabet, column_map.temperature, request.settings.seed, name)
    taught = METHODS[name].learn(task, {})
    place = request.out / LEARNED / name
    write_model_directory(place, taught.model, taught.values)
    return _prepared(str(place), request, column_map, training)


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

"""A validation campaign: 17 traces x 4 models x 1000 runs, simulation and metrics (stages 5 to 8), then its pictures.

The traces are the SYNTHETIC cd1 to cd17. The models take the four ways through the simulator: the learned model, its
counterpart under the thesis semantics, one whose targets are driven by the current, one with a rate limit. Worker
processes are started and have imported everything before the clock starts. The yardstick, in the same run and process:
the simulation of the same runs alone, without encoding, comparison, band, scores and intervals.

The goal is 10 s on two cores. The thesis states 2 to 5 minutes a trace for its chain with UPPAAL, on another machine.

A long trace (2.6 million rows, 30 days at one a second) shows that memory stays bounded: runs x readings would be
21 GB.
"""

import os
import resource
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from time import perf_counter, process_time

import click
import numpy as np

from benchmarks.figures import Figure, best, give
from benchmarks.processes import learned_model
from sim.engine.open_loop_run import open_loop_schedule, start_law
from sim.engine.simulation import simulate
from sim.lab.formats.find import find_model
from sim.lab.judge.campaign import slim
from sim.lab.judge.free_run import TraceJob, TraceOutcome, TraceRunSettings, run_job
from sim.lab.judge.pictures import draw_one, drawings
from sim.lab.judge.semantics import side_by_side
from sim.lab.workers import parallel
from sim.plant.scenarios import SCENARIOS, scenario
from sim.sha.automaton import Input, Location
from sim.sha.events import encode
from sim.sha.flows import RELAXING_FLOWS
from sim.sha.model import Model
from sim.sha.trace import Trace

GOAL = 10.0
RUNS = 1000
LONG_ROWS = 2_600_000
RATE = 0.05
"""degC/s of the rate-limited model: few steps of these traces meet it, all pay for looking."""


def models(folder: Path) -> dict[str, Model]:
    """The four ways through the simulator, by name."""
    learned = find_model(learned_model(folder)).runnable()
    both = side_by_side(learned, None)
    driven = tuple(_driven(location) for location in learned.sha.locations)
    return {
        "carried": both["carried"],
        "resampled": both["resampled"],
        "driven": replace(learned, sha=replace(learned.sha, locations=driven)),
        "limited": replace(learned, sha=replace(learned.sha, max_rate=RATE)),
    }


def _driven(location: Location) -> Location:
    if location.flow.kind not in RELAXING_FLOWS:
        return location
    inputs = (Input("Assorbimento", 0.02, 150.0),)
    return replace(location, flow=replace(location.flow, kind="driven", inputs=inputs))


def jobs(named: dict[str, Model], traces: Sequence[Trace], runs: int) -> list[TraceJob]:
    """Every model along every trace."""
    return [
        TraceJob(label=name, semantics=name, model=model, trace=slim(trace, model), settings=TraceRunSettings(runs))
        for name, model in named.items()
        for trace in traces
    ]


def simulated_alone(todo: Sequence[TraceJob]) -> None:
    """The runs of the jobs and nothing else."""
    rng = np.random.default_rng(0)
    for job in todo:
        encoded = replace(job.trace, events=encode(job.trace, job.model.alphabet))
        simulate(open_loop_schedule(job.model, encoded), start_law(job.model, encoded), job.settings.runs, rng)


def speeds(todo: Sequence[TraceJob], repeats: int) -> tuple[list[Figure], list[TraceOutcome]]:
    """The campaign in one process and in one a core, and what it gave."""
    cores = len(os.sched_getaffinity(0))
    what = f"campaign, {len(todo)} jobs of {todo[0].settings.runs} runs"
    outcomes: list[TraceOutcome] = []

    def here() -> None:
        outcomes[:] = map(run_job, todo)

    alone = best(lambda: simulated_alone(todo), repeats)
    begin = process_time()
    sequential = best(here, repeats)
    worked = (process_time() - begin) / repeats
    list(parallel(run_job, todo[: 4 * cores], cores))  # starts the processes, which import what they need
    together = best(lambda: list(parallel(run_job, todo, cores)), repeats)
    failed = [outcome.result.failure for outcome in outcomes if outcome.result.failure]
    if failed:
        raise click.ClickException(f"{len(failed)} jobs failed, the first: {failed[0]}")
    return [
        Figure(f"{what}, 1 process", sequential, "s", "the simulation of the same runs alone", alone),
        Figure(f"{what}, processor time", worked, "s", "the goal on two cores", 2 * GOAL),
        Figure(f"{what}, {cores} processes", together, "s", "the goal", GOAL),
        Figure(f"{what}, {cores} processes", together, "s", "1 process", sequential),
    ], outcomes


def pictures(outcomes: Sequence[TraceOutcome], folder: Path) -> Figure:
    """Wall time of stage 9's pictures, a PNG and a PDF each, in processes that are there already."""
    cores = len(os.sched_getaffinity(0))
    wanted = list(drawings(folder, outcomes, "TCuscinettiRiduttore", {}).values())
    list(parallel(draw_one, wanted[: 2 * cores], cores))  # the processes import what they need
    draw_one(wanted[0])
    worked = process_time()
    draw_one(wanted[0])
    alone = process_time() - worked
    begin = perf_counter()
    list(parallel(draw_one, wanted, cores))
    what = f"{len(wanted)} pictures (PNG and PDF), {cores} processes"
    return Figure(what, perf_counter() - begin, "s", "processor time of one, times as many", alone * len(wanted))


def long_trace(model: Model, rows: int) -> list[Figure]:
    """Time and memory of one long trace: cd17 over and over, one row a second."""
    piece = scenario("cd17")
    repeats = -(-rows // piece.times.size)
    signals = {name: np.tile(column, repeats)[:rows] for name, column in piece.signals.items()}
    trace = slim(Trace("long", 1.0 * np.arange(rows), signals, synthetic=True), model)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    begin = perf_counter()
    outcome = run_job(
        TraceJob(label="carried", semantics="carried", model=model, trace=trace, settings=TraceRunSettings(RUNS))
    )
    seconds = perf_counter() - begin
    after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    if outcome.result.failure:
        raise click.ClickException(outcome.result.failure)
    return [
        Figure(f"one trace of {rows:,} rows, {RUNS} runs", seconds, "s"),
        Figure(f"peak resident size with {rows:,} rows", after, "MB", "before it", before),
    ]


def measure(folder: Path, *, repeats: int, count: int, runs: int, rows: int) -> list[Figure]:
    """All figures; `count` traces, each simulated `runs` times by each model, and a long trace of `rows`."""
    named = models(folder)
    traces = [scenario(name) for name in list(SCENARIOS)[:count]]
    figures, outcomes = speeds(jobs(named, traces, runs), repeats)
    return [*figures, pictures(outcomes, folder / "pictures"), *long_trace(named["carried"], rows)]


@click.command(help=__doc__)
@click.option("--json", "as_json", is_flag=True, help="One JSON object instead of a table.")
@click.option("--quick", is_flag=True, help="Four traces, once, and a shorter long trace.")
@click.option("--model-folder", type=click.Path(path_type=Path), help="Where the learned model is kept between runs.")
@click.option("--repeats", default=3, show_default=True, type=click.IntRange(1), help="Repetitions; the best counts.")
@click.option("--traces", type=click.IntRange(1, len(SCENARIOS)), help="So many traces.  [default: all, or 4]")
@click.option("--runs", default=RUNS, show_default=True, type=click.IntRange(2), help="Runs of a model along a trace.")
@click.option("--rows", type=click.IntRange(2), help=f"Rows of the long trace.  [default: {LONG_ROWS:,}, or 50,000]")
def main(
    as_json: bool,
    quick: bool,
    model_folder: Path | None,
    repeats: int,
    traces: int | None,
    runs: int,
    rows: int | None,
) -> None:
    with tempfile.TemporaryDirectory(prefix="decanter-bench-") as own:
        figures = measure(
            model_folder or Path(own),
            repeats=1 if quick else repeats,
            count=traces or (4 if quick else len(SCENARIOS)),
            runs=runs,
            rows=rows or (50_000 if quick else LONG_ROWS),
        )
    give("validation campaign", figures, as_json=as_json)


if __name__ == "__main__":
    main()

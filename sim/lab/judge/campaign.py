"""Many models along many traces: the jobs, where they run, what came out, and the complete folder of it.

A job depends on its model, its trace and the seed alone, so that results do not depend on the number of workers, on
where they run or on what runs beside them.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import groupby

from sim.artefacts import JudgedCriterion
from sim.effects import effect_signals
from sim.lab.judge.fitness import Facts, judge_semantics
from sim.lab.judge.free_run import TraceJob, TraceOutcome, TraceRunSettings, run_job
from sim.lab.judge.output_folder import COMPLETE, RESULTS, SKILL_FILE, Folder, results_csv, results_json
from sim.lab.judge.pictures import draw_one, drawings
from sim.lab.judge.report import CampaignSummary, ModelReport, ReportEntry, choose_figures, index_html, model_html
from sim.lab.judge.results import TraceResult, seen_traces
from sim.lab.judge.stages import Prepared, Stage, records, time_stage
from sim.lab.judge.worth import ForecastSkill
from sim.lab.recordings import LoadReport
from sim.lab.workers import cluster, parallel, processes
from sim.sha import Model, Trace
from sim.strict_json import json_text

Progress = Callable[[str, float], None]
Runner = Callable[[Sequence[TraceJob]], Iterator[TraceOutcome]]
"""Gives the outcomes of jobs in the jobs' order, each as soon as it and all before it are there."""

MIN_PARALLEL_TEMPERATURES = 20_000_000
"""Simulated temperatures (readings times runs) below which worker processes would cost more than they save."""


@dataclass(frozen=True, slots=True)
class Unread:
    """A file that gave no trace, and why."""

    name: str
    reason: str


def unread_traces(report: LoadReport, traces: Sequence[Trace]) -> tuple[Unread, ...]:
    """The files of a load that gave nothing, but for parts of a trace that was put together from other parts."""
    loaded = {trace.name for trace in traces}
    failed = (file for file in report.files if file.error and file.path.absolute().parent.name not in loaded)
    return tuple(Unread(file.path.stem, file.error) for file in failed)


def model_jobs(prepared: Prepared, traces: Sequence[Trace], settings: TraceRunSettings) -> list[TraceJob]:
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
    wanted |= set(effect_signals(model.sha))
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
    jobs = [job for model in prepared for job in model_jobs(model, traces, settings)]
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


def local_runner(workers: int) -> Runner:
    """Jobs in this process (one worker, or little to do), else in `workers` processes."""

    def run_jobs(jobs: Sequence[TraceJob]) -> Iterator[TraceOutcome]:
        work = sum(job.trace.times.size * job.settings.runs for job in jobs if not job.refusal)
        return processes(1 if work < MIN_PARALLEL_TEMPERATURES else workers)(run_job, jobs, _undone)

    return run_jobs


@contextmanager
def cluster_runner(address: str) -> Iterator[Runner]:
    """Jobs on the Dask cluster at `address`. Raises ValueError as `cluster` does."""
    with cluster(address) as workers:
        yield lambda jobs: workers(run_job, jobs, _undone)


def _undone(job: TraceJob, reason: str) -> TraceOutcome:
    result = TraceResult(job.label, job.trace.name, job.semantics, synthetic=job.trace.synthetic, stage=5)
    return TraceOutcome(replace(result, seen=job.seen, failure=reason), rows=job.trace.times.size)


MAX_LOCAL_PICTURES = 2
"""Pictures that are drawn in this process: fewer are done before another process has started."""


@dataclass(frozen=True, slots=True)
class CampaignPlan:
    """What a campaign is to do. `units` of the signals by name, `pictures` whether to draw, `workers` processes."""

    settings: TraceRunSettings
    run: Runner
    workers: int
    pictures: bool
    units: Mapping[str, str]
    campaign: CampaignSummary


def conduct(
    prepared: Sequence[Prepared],
    traces: Sequence[Trace],
    without: Sequence[Unread],
    loading: Stage,
    plan: CampaignPlan,
    folder: Folder,
    tell: Callable[[str], None],
    progress: Progress,
    skill: Mapping[str, ForecastSkill] | None = None,
    facts: Mapping[str, Mapping[str, Facts]] | None = None,
) -> tuple[list[TraceResult], str]:
    """Stages 5 to 9 of every model; all results in the order of models, semantics and traces, and the folder's seal.

    `skill` is that of the models' forecasts by label, which stands in their reports and in a file of its own; `facts`
    are what is known of the models besides, by label and semantics.

    Everything is written as soon as it is known; the index and the state "complete" come last. Raises ValueError where
    the folder can no longer be written.
    """
    log: list[Stage] = []

    def note(stage: Stage) -> None:
        log.append(stage)
        tell(stage.line)
        folder.write("campaign.log", "".join(f"{each.line}\n" for each in log))
        if stage.model:
            folder.stage(stage)

    for model in prepared:
        for stage in model.stages:
            note(stage)
    note(loading)
    if skill:
        folder.write(SKILL_FILE, json_text({label: each.as_plain() for label, each in skill.items()}, indent=2) + "\n")
    results: list[TraceResult] = []
    entries: list[ReportEntry] = []
    for model, outcomes in outcomes_by_model(
        prepared, traces, without=without, settings=plan.settings, run=plan.run, progress=progress
    ):
        stages = records(model.label, outcomes)
        for stage in stages:
            note(stage)
        results += [outcome.result for outcome in outcomes]
        folder.write(f"{RESULTS}.json", results_json(results))
        folder.write(f"{RESULTS}.csv", results_csv(results))
        last, report = _report_stage(
            model,
            outcomes,
            before=(*model.stages, loading, *stages),
            plan=plan,
            folder=folder,
            progress=progress,
            skill=(skill or {}).get(model.label),
            findings=judge_semantics([outcome.result for outcome in outcomes], (facts or {}).get(model.label, {})),
        )
        note(last)
        entries.append(ReportEntry(folder.places[model.label], report))
    # Last: whoever finds "complete" finds everything else, and the seal is of all of it.
    folder.write("index.html", index_html(plan.campaign, entries, log))
    folder.state(COMPLETE)
    return results, folder.seal()


def _report_stage(
    prepared: Prepared,
    outcomes: Sequence[TraceOutcome],
    *,
    before: Sequence[Stage],
    plan: CampaignPlan,
    folder: Folder,
    progress: Progress,
    skill: ForecastSkill | None,
    findings: Mapping[str, Sequence[JudgedCriterion]],
) -> tuple[Stage, ModelReport]:
    """Stage 9: pictures, then the report."""
    last = Stage(9, prepared.label)
    home = folder.path / folder.places[prepared.label]
    with time_stage(last):
        # The PNG of each (semantics, trace); the PDF lies beside it.
        files = {}
        if plan.pictures:
            wanted = drawings(home / "pictures", outcomes, prepared.structure.temperature, plan.units)
            todo = list(wanted.values())
            in_process = plan.workers == 1 or len(todo) <= MAX_LOCAL_PICTURES
            done = map(draw_one, todo) if in_process else parallel(draw_one, todo, plan.workers)
            for number, file in enumerate(done, 1):
                progress(f"{prepared.label}: picture {file.stem}", number / len(todo))
            files = {key: drawing.png for key, drawing in wanted.items()}
        results = [outcome.result for outcome in outcomes]
        missing = Counter[str]()
        for outcome in outcomes:
            pairs = outcome.compatibility.pairs if outcome.compatibility else {}
            missing.update({f"{symbol} in {place}": count for (place, symbol), count in pairs.items()})
        pictures = choose_figures(results, files, home)
        report = ModelReport(
            campaign=plan.campaign,
            prepared=prepared,
            stages=(*before, last),
            results=results,
            pictures=pictures,
            missing=dict(missing.most_common(20)),
            skill=skill,
            findings=findings,
        )
        drawn = f"{2 * len(files)} pictures" if plan.pictures else "no pictures asked for"
        last.found = f"{drawn}, report.html"
        last.details = {"report": "report.html", "pictures": [str(file.relative_to(home)) for file in files.values()]}
    folder.write(f"{folder.places[prepared.label]}/report.html", model_html(report))
    return last, report

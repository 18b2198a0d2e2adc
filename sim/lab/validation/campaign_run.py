"""A campaign from prepared models and loaded traces to a complete folder, each stage told as it ends."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from sim.lab.skill import ForecastSkill
from sim.lab.validation.campaign import Progress, Runner, Unread, outcomes_by_model
from sim.lab.validation.fitness import Facts, Finding, findings_of
from sim.lab.validation.output_folder import COMPLETE, RESULTS, SKILL, Folder, results_csv, results_json
from sim.lab.validation.pictures import draw_one, drawings
from sim.lab.validation.report import CampaignSummary, ModelReport, ReportEntry, index_html, model_html, shown
from sim.lab.validation.results import TraceResult
from sim.lab.validation.stage_records import records
from sim.lab.validation.stages import Prepared, Stage, timed
from sim.lab.validation.trace_run import TraceOutcome, TraceRunSettings
from sim.lab.workers import parallel
from sim.sha import Trace
from sim.strict_json import json_text

PICTURES_HERE = 2
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
) -> list[TraceResult]:
    """Stages 5 to 9 of every model; returns all results in the order of models, semantics and traces.

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
        folder.write(SKILL, json_text({label: each.as_plain() for label, each in skill.items()}, indent=2) + "\n")
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
        last, report = _reported(
            model,
            outcomes,
            before=(*model.stages, loading, *stages),
            plan=plan,
            folder=folder,
            progress=progress,
            skill=(skill or {}).get(model.label),
            findings=findings_of([outcome.result for outcome in outcomes], (facts or {}).get(model.label, {})),
        )
        note(last)
        entries.append(ReportEntry(folder.places[model.label], report))
    # Last: whoever finds "complete" finds everything else.
    folder.write("index.html", index_html(plan.campaign, entries, log))
    folder.state(COMPLETE)
    return results


def _reported(
    prepared: Prepared,
    outcomes: Sequence[TraceOutcome],
    *,
    before: Sequence[Stage],
    plan: CampaignPlan,
    folder: Folder,
    progress: Progress,
    skill: ForecastSkill | None,
    findings: Mapping[str, Sequence[Finding]],
) -> tuple[Stage, ModelReport]:
    """Stage 9: pictures, then the report."""
    last = Stage(9, prepared.label)
    home = folder.path / folder.places[prepared.label]
    with timed(last):
        # The PNG of each (semantics, trace); the PDF lies beside it.
        files = {}
        if plan.pictures:
            wanted = drawings(home / "pictures", outcomes, prepared.structure.temperature, plan.units)
            todo = list(wanted.values())
            in_process = plan.workers == 1 or len(todo) <= PICTURES_HERE
            done = map(draw_one, todo) if in_process else parallel(draw_one, todo, plan.workers)
            for number, file in enumerate(done, 1):
                progress(f"{prepared.label}: picture {file.stem}", number / len(todo))
            files = {key: drawing.png for key, drawing in wanted.items()}
        results = [outcome.result for outcome in outcomes]
        missing = Counter[str]()
        for outcome in outcomes:
            pairs = outcome.compatibility.pairs if outcome.compatibility else {}
            missing.update({f"{symbol} in {place}": count for (place, symbol), count in pairs.items()})
        pictures = shown(results, files, home)
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

"""`decanter model judge validation`: models along measured traces in nine stages, with a report each."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from time import perf_counter

import click

from gateway.console import CommandResult, Part, Rows, conclude, progress
from gateway.entry import Exit, fail, interruptible, sentences
from gateway.lab.judging.request import JudgingRequest
from gateway.lab.traces.load import channel_warnings
from sim.lab.formats import write_model_directory
from sim.lab.judge import (
    LEARNED_FOLDER,
    CampaignPlan,
    CampaignSummary,
    Facts,
    ForecastSkill,
    Prepared,
    Progress,
    TraceResult,
    check_folder,
    claim_folder,
    cluster_runner,
    conduct,
    distinct_labels,
    fitness_verdict,
    gain,
    hold_folder,
    judge_semantics,
    load_stage,
    local_runner,
    model_facts_by_semantics,
    natural,
    summaries,
    unread_traces,
    verdict,
)
from sim.lab.recordings import ColumnMap, load_map, load_traces, units
from sim.lab.tuning import METHODS, Task
from sim.sha import Trace, display_unit


@dataclass(frozen=True, slots=True)
class CampaignFindings:
    """The results of all models; by label the skill of their forecasts, if asked for, and what else is known.

    `seal` is that of the folder's files.
    """

    results: list[TraceResult]
    skill: Mapping[str, ForecastSkill]
    facts: Mapping[str, Mapping[str, Facts]]
    seal: str

    @property
    def fitness(self) -> dict[str, dict[str, str]]:
        """The answer to "may I use this model" with its reason and the next step, by label and semantics."""
        sentences = {}
        for name in dict.fromkeys(result.model for result in self.results):
            found = judge_semantics(
                [result for result in self.results if result.model == name], self.facts.get(name, {})
            )
            sentences[name] = {semantics: fitness_verdict(each).sentence for semantics, each in found.items()}
        return sentences


def campaign(
    request: JudgingRequest,
    out: Path,
    *,
    overwrite: bool,
    address: str | None,
    pictures: bool,
    created: str,
    tell: Callable[[str], None],
    progress: Progress,
) -> CampaignFindings:
    """What came out; the folder `out` is complete then. `created` is the time that its reports say.

    Raises ValueError or OSError, before anything is written, for a folder, a map, a model, a set of traces or a cluster
    that cannot be used. Models that are to be learned (see `methods_in`) are learned once all that is known to be good.
    """
    check_folder(out, overwrite=overwrite)
    column_map = load_map(request.map_file)
    with nullcontext(local_runner(request.workers)) if address is None else cluster_runner(address) as run:
        # The models come before the traces and the learning after both: what can be refused at once is refused first.
        unlearned = to_learn(request.models)
        if unlearned and not request.training:
            raise ValueError(
                f"{unlearned[0]}: there is no such model; to learn one by this method give --training TRACES"
            )
        training = None
        if request.training:
            training, learned_from = load_traces(list(request.training), column_map)
            column_map = column_map.model_copy(update={"alphabet": learned_from.alphabet})
            if unlearned:
                channel_warnings(training, column_map.alphabet)
        ready: list[tuple[str, Prepared | None]] = []
        for number, where in enumerate(request.models):
            progress(where, number / len(request.models))
            ready.append((where, None if where in unlearned else request.prepare_model(where, column_map, training)))
        progress("reading traces", 0.0)
        begin = perf_counter()
        traces, report = load_traces(list(request.paths), column_map)
        loading = load_stage(report, perf_counter() - begin)
        facts = {
            "traces": f"{len(traces)} from {', '.join(request.paths)}",
            "map": request.map_file.stem,
            "runs": str(request.settings.runs),
            "policy": request.settings.policy,
            "semantics": request.wanted,
            "seed": str(request.settings.seed),
            "decanter": version("decanter-gateway"),
        }
        plan = CampaignPlan(
            settings=request.settings,
            run=run,
            workers=request.workers,
            pictures=pictures,
            units=units(column_map),
            campaign=CampaignSummary(created, facts),
        )
        with hold_folder(out):
            stale = check_folder(out, overwrite=overwrite)  # again: nobody else can write there now
            folder = claim_folder(out, stale, (), {"created": created, **facts})
            known = training or ()
            models = [
                model or _learn_model(where, request, column_map, known, out=out, progress=progress)
                for where, model in ready
            ]
            prepared = distinct_labels(models)
            folder.assign([model.label for model in prepared])
            made = request.forecasts(prepared, traces, training, progress)
            seed = request.settings.seed
            skill = {model.label: made.skill(model.label, seed=seed) for model in prepared} if made else {}
            known_facts = {model.label: model_facts_by_semantics(model) for model in prepared}
            results, seal = conduct(
                prepared,
                traces,
                unread_traces(report, traces),
                loading=loading,
                plan=plan,
                folder=folder,
                tell=tell,
                progress=progress,
                skill=skill,
                facts=known_facts,
            )
            return CampaignFindings(results, skill, known_facts, seal)


def to_learn(models: Sequence[str]) -> list[str]:
    """Those of the MODEL arguments that name a method of learning and nothing that is there."""
    return [name for name in models if name in METHODS and not Path(name).exists()]


def _learn_model(
    name: str,
    request: JudgingRequest,
    column_map: ColumnMap,
    training: Sequence[Trace],
    *,
    out: Path,
    progress: Progress,
) -> Prepared:
    """A model learned by the method `name` with its defaults, written to the campaign's folder, and then prepared."""
    progress(f"learning by {name}", 0.0)
    # The method encodes the events itself, by the alphabet that it is given.
    silent = [replace(trace, events=()) for trace in training]
    task = Task(silent, column_map.alphabet, column_map.temperature, request.settings.seed, name)
    learned = METHODS[name].learn(task, {})
    place = out / LEARNED_FOLDER / name
    write_model_directory(place, learned.model, learned.values)
    return request.prepare_model(str(place), column_map, training)


MOST_REASONS = 5
"""Reasons that are printed for each model."""


def validate(
    request: JudgingRequest, out: Path, overwrite: bool, address: str | None, pictures: bool, as_json: bool
) -> None:
    """Carry out `decanter model judge validation`; its options and its help are in judging/commands.py."""
    request.check_training()
    try:
        with sentences(), progress("validating") as bar, interruptible(bar) as report:
            # With --json the stages are in the folder alone.
            found = campaign(
                request,
                out,
                overwrite=overwrite,
                address=address,
                pictures=pictures,
                created=datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
                tell=(lambda _: None) if as_json else click.echo,
                progress=report,
            )
    except KeyboardInterrupt:
        begun = (out / "campaign.json").is_file()
        left = f"what was done lies in {out}, and --overwrite begins anew there" if begun else "nothing was written"
        fail(f"stopped before the end; {left}", Exit.INTERRUPTED)
    results = found.results
    names = dict.fromkeys(run.model for run in results)
    gains = {name: gain([run for run in results if run.model == name]) for name in names}
    data = {
        "out": str(out),
        "report": str(out / "index.html"),
        "seal": found.seal,
        "summaries": [asdict(summary) for summary in summaries(results)],
        "gains": {name: asdict(gained) | {"sentence": gained.sentence} for name, gained in gains.items() if gained},
        "fitness": found.fitness,
        "forecasts": {name: each.as_plain() for name, each in found.skill.items()},
        "results": [asdict(run) | {"verdict": asdict(verdict(run))} for run in results],
    }
    complaint = ""
    if all(result.failure for result in results):
        complaint = f"no model could be run along any trace; {results[0].trace}: {results[0].failure}"
    conclude(CommandResult(data, complaint), lambda _: _show(out, found), as_json=as_json)


def _show(out: Path, found: CampaignFindings) -> Iterator[Part]:
    results = found.results
    columns = (
        "model",
        "semantics",
        "traces",
        "good",
        "review",
        "failed",
        "MAE",
        "RMSE",
        "at events",
        "dense",
        "final %",
    )
    more = ("coverage", "CRPS", "persistence")
    names = ("mae", "rmse", "at_events", "dense", "final_percent", "coverage", "crps", "persistence")
    rows = [
        [summary.model, summary.semantics, summary.sample, summary.good, summary.review, summary.failed]
        + [getattr(summary, name) for name in names]
        for summary in summaries(results)
    ]
    units = " and ".join(dict.fromkeys(display_unit(result.unit) for result in results))
    yield Rows(f"validation, means over traces ({units})", (*columns, *more), rows)
    for name, by_semantics in found.fitness.items():
        own = [result for result in results if result.model == name]
        for semantics, sentence in by_semantics.items():
            yield f"{name}{f' ({semantics})' if len(by_semantics) > 1 else ''}: {sentence}"
        gained = gain(own)
        if gained is not None:
            yield f"{name}: {gained.sentence}"
        # Why traces failed or are to be looked at, the failed ones first; the report has all of them.
        judged = [(result, verdict(result)) for result in sorted(own, key=lambda result: natural(result.trace))]
        lines = [
            f"{judgement.word}: {result.trace} ({result.semantics}): {'; '.join(judgement.reasons)}"
            for word in ("failed", "review")
            for result, judgement in judged
            if judgement.word == word
        ]
        for sentence in lines[:MOST_REASONS]:
            yield f"{name}: {sentence}"
        if len(lines) > MOST_REASONS:
            yield f"{name}: {len(lines) - MOST_REASONS} more of these are in the report"
    for name, each in found.skill.items():
        for sentence in (*each.sentences, *(f"note: {note}" for note in each.notes)):
            yield f"{name}: {sentence}"
    yield f"report: {out / 'index.html'}"
    yield f"seal: {found.seal}"

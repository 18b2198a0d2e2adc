"""`decanter model rank`: several models on the same traces; which of them are fit for deployment."""

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click

from drivers.named_files import regular
from gateway.console import emit, json_option, map_option, progress, seed_option, shipped, table
from gateway.entry import Exit, fail, interruptible, sentences
from gateway.lab.judging.figures import facts_of, gate_of, judged_forecasts, origin_of, skill_options
from gateway.lab.judging.skill import show_skill
from sim.lab.judge import (
    CAMPAIGN,
    Facts,
    ForecastSkill,
    Prepared,
    Progress,
    Ranking,
    TraceResult,
    TraceRunSettings,
    Wanted,
    Weights,
    as_plain,
    draw_ranking,
    entrants,
    limits_of,
    outcomes_by_model,
    prepare,
    read_results,
    relabelled,
    run_here,
    unread,
    write_page,
)
from sim.lab.judge import rank as ranked
from sim.lab.pictures import check_picture
from sim.lab.recordings import load_map, load_traces
from sim.sha import Trace, shown_unit

GENERATION = "04_model_generation.json"


@dataclass(frozen=True, slots=True)
class RankingInput:
    """What is ranked: the results, what is known of each model by entrant, and its forecasts' skill, if asked for."""

    results: list[TraceResult]
    facts: dict[str, Facts]
    skill: ForecastSkill | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class RankingRequest:
    """What to compare: `models` along the traces of `paths`, or the results in `folders` (with models at hand)."""

    models: Sequence[str]
    paths: Sequence[str]
    folders: Sequence[Path]
    map_file: Path
    wanted: Wanted
    training: Sequence[str]
    runs: int
    jobs: int | None
    seed: int
    skill: bool
    rivals: bool


def compared(request: RankingRequest, progress: Progress) -> RankingInput:
    """Runs every model along every trace, or reads what an earlier campaign found.

    Raises ValueError or OSError for what cannot be read, and for a model at hand that has no results in the folders.
    """
    if not request.folders:
        column_map = load_map(request.map_file)
        traces, report = load_traces(list(request.paths), column_map)
        training = load_traces(list(request.training), column_map)[0] if request.training else None
        prepared = _prepared(request, training)
        run = run_here(request.jobs or len(os.sched_getaffinity(0)))
        settings = TraceRunSettings(request.runs, seed=request.seed)
        by_model = outcomes_by_model(
            prepared, traces, without=unread(report, traces), settings=settings, run=run, progress=progress
        )
        results = [outcome.result for _, outcomes in by_model for outcome in outcomes]
        facts_at_hand = _by_entrant(results, {model.label: facts_of(model) for model in prepared})
        if not request.skill:
            return RankingInput(results, facts_at_hand)
        learned = training if request.rivals else None
        made = judged_forecasts(prepared, traces, training=learned, seed=request.seed, report=progress)
        return RankingInput(results, facts_at_hand, made.skill(seed=request.seed))
    results = [result for folder in request.folders for result in read_results(folder)]
    labels = sorted({result.model for result in results})
    facts: dict[str, dict[str, Facts]] = {}
    for path in request.folders:
        # What the campaign's records say of its models, by label and semantics; a missing or odd record says nothing.
        folder = path if path.is_dir() else path.parent
        for label, place in _document(folder / CAMPAIGN).get("folders", {}).items():
            facts[label] = {}
            for semantics, row in _document(folder / place / GENERATION).get("variants", {}).items():
                traced = bool(row.get("data_hash") or row.get("training_traces"))
                facts[label][semantics] = Facts(synthetic=bool(row.get("synthetic")) if traced else None)
    # A model at hand is that of the results with its name: it is verified, which the records cannot say.
    for at_hand in _prepared(request, None):
        if at_hand.label not in labels:
            raise ValueError(
                f"{at_hand.where}: the results have no model {at_hand.label!r}; they have {', '.join(labels) or 'none'}"
            )
        own: dict[str, Facts] = {}
        for semantics, model in at_hand.variants.items():
            verified, gate = gate_of(model)
            own[semantics] = replace(origin_of(model), verified=verified, gate=gate)
        # The gate's word on the model at hand is its word on the recorded semantics too.
        word = next(iter(own.values()), Facts(verified=False, gate="; ".join(at_hand.refusals.values())))
        recorded = {
            name: replace(known, verified=word.verified, gate=word.gate)
            for name, known in facts.get(at_hand.label, {}).items()
        }
        facts[at_hand.label] = {**recorded, **own}
    return RankingInput(results, _by_entrant(results, facts))


def _prepared(request: RankingRequest, training: Sequence[Trace] | None) -> list[Prepared]:
    column_map = load_map(request.map_file)
    alphabet, temperature = column_map.alphabet, column_map.temperature
    return relabelled(
        [
            prepare(where, alphabet, temperature, wanted=request.wanted, training=training, seed=request.seed)
            for where in request.models
        ]
    )


def _by_entrant(results: Sequence[TraceResult], facts: Mapping[str, Mapping[str, Facts]]) -> dict[str, Facts]:
    """Facts by model and semantics become facts by entrant."""
    by_entrant = {}
    for name, own in entrants(results).items():
        result = next(iter(own.values()))
        known = facts.get(result.model, {})
        if result.semantics in known:
            by_entrant[name] = known[result.semantics]
        elif "" in known:
            by_entrant[name] = known[""]
    return by_entrant


def _document(file: Path) -> dict[str, Any]:
    try:
        document = json.loads(regular(file).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return document if isinstance(document, dict) else {}


LIMITS = """
\b
Limits of fitness, judged on traces that were not in training where there are any:
  coverage_low 0.8    least mean share of the readings inside the 90 % band
  coverage_high 0.99  largest
  persistence 1       MAE below so many times that of the first reading held
  largest 30          no error above this, degC
  clamps 0            clamps to the model's range at most
  rejecting 0         traces at most with an event that has no edge
  unseen 1            traces at least that were not in training
"""


@click.command(epilog=LIMITS, short_help="Compare models on the same traces; say which are fit for deployment.")
@click.argument("models", nargs=-1, metavar="[MODEL...]")
@click.option("--traces", "paths", multiple=True, help="A file, a folder or a glob; may be given again.")
@click.option(
    "--results",
    "folders",
    multiple=True,
    type=click.Path(path_type=Path),
    help="The folder of an earlier `validate`; may be given again.",
)
@map_option
@click.option(
    "--semantics",
    "wanted",
    type=click.Choice(["written", "carried", "resampled", "both"]),
    default="written",
    show_default=True,
    help="The temperature is carried over events or resampled on entry (the thesis); both are ranked apart.",
)
@click.option(
    "--training",
    multiple=True,
    help="Traces that give the resampled semantics its entry laws; rivals are fitted to them.",
)
@skill_options
@click.option(
    "--weights",
    type=click.FloatRange(0.0),
    nargs=3,
    default=(0.5, 0.3, 0.2),
    show_default=True,
    help="Of MAE, largest error and sigma of the errors in the score.",
)
@click.option(
    "--limit",
    "limits",
    type=(str, str),
    multiple=True,
    metavar="NAME NUMBER",
    help="A limit of fitness, as `--limit coverage_low 0.85`; may be given again. Names and defaults are below.",
)
@click.option("--allow-synthetic", is_flag=True, help="A model learned from synthetic traces may be fit.")
@click.option("--runs", type=click.IntRange(100, 100_000), default=1000, show_default=True, help="Runs a trace.")
@click.option("--jobs", type=click.IntRange(1), help="Worker processes.  [default: one a core]")
@click.option(
    "--page", type=click.Path(path_type=Path, dir_okay=False), help="Also write the ranking as one HTML page."
)
@click.option(
    "--picture",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Also draw errors and wins to this file (.png, .pdf, .svg).",
)
@seed_option
@json_option
def rank(
    models: Sequence[str],
    paths: Sequence[str],
    folders: Sequence[Path],
    map_name: str,
    wanted: Wanted,
    training: Sequence[str],
    skill: bool,
    rivals: bool,
    weights: tuple[float, float, float],
    limits: Sequence[tuple[str, str]],
    allow_synthetic: bool,
    runs: int,
    jobs: int | None,
    page: Path | None,
    picture: Path | None,
    seed: int,
    as_json: bool,
) -> None:
    """Compare models on the same traces by S = w1 MAE + w2 largest error + w3 sigma(error), with paired tests.

    Give MODEL... and --traces to run them (open loop), or --results of an earlier `decanter model validate`; models
    given beside --results are verified. A model that has seen a trace in training is marked in-sample. The limits of
    fitness for deployment are options; `open` means that one of them could not be looked at. With --skill the models'
    forecasts along the traces are scored too, beside persistence, and it is said where they are not worth it.
    """
    if bool(paths) == bool(folders) or (paths and not models):
        raise click.UsageError("Give MODEL... with --traces, or --results of an earlier campaign.")
    if (skill or rivals) and not paths:
        raise click.UsageError("--skill forecasts along traces: give MODEL... with --traces instead of --results.")
    if rivals and not training:
        raise click.UsageError("--rivals are fitted to traces: name them with --training")
    try:
        with sentences(), progress("ranking") as bar, interruptible(bar) as report:
            if picture is not None:
                check_picture(picture)
            used, bounds = Weights(*weights), limits_of(limits, synthetic=allow_synthetic)
            request = RankingRequest(
                models=models,
                paths=paths,
                folders=folders,
                map_file=shipped("traces", map_name),
                wanted=wanted,
                training=training,
                runs=runs,
                jobs=jobs,
                seed=seed,
                skill=skill or rivals,
                rivals=rivals,
            )
            seen = compared(request, report)
            ranking = ranked(seen.results, seen.facts, weights=used, limits=bounds, seed=seed, skill=seen.skill)
            if page is not None:
                write_page(ranking, seen.results, page)
            if picture is not None:
                draw_ranking(ranking, seen.results, picture)
            data = {**as_plain(ranking), "page": page and str(page), "picture": picture and str(picture)}
    except KeyboardInterrupt:
        fail("stopped before the end; nothing was written", Exit.INTERRUPTED)
    emit(data, lambda: _show(ranking, page, picture), as_json_line=as_json)


def _show(ranking: Ranking, page: Path | None, picture: Path | None) -> None:
    weights = ranking.weights
    formula = f"S = {weights.mae:g} MAE + {weights.largest:g} max + {weights.scatter:g} sigma"
    columns = ("rank", "model", "for deployment", "S", "MAE", "max", "sigma", "CRPS", "coverage 90 %", "persistence")
    names = ("score", "mae", "largest", "scatter", "crps", "coverage", "persistence", "wins")
    rows = [
        [row.rank or "–", row.entrant, row.fitness, *(getattr(row, name) for name in names), row.failed, row.in_sample]
        for row in ranking.standings
    ]
    table(
        f"{formula} ({shown_unit(ranking.unit)}), means over {len(ranking.common)} common traces",
        (*columns, "wins", "failed", ""),
        rows,
    )
    pairs = [
        [
            pair.one,
            pair.other,
            pair.difference.n,
            pair.difference.mean,
            f"{pair.difference.low:.3g} to {pair.difference.high:.3g}" if pair.difference.interval else "–",
            pair.p,
            f"{pair.wins[0]:g} : {pair.wins[1]:g}",
            pair.sentence,
        ]
        for pair in ranking.pairs
    ]
    if pairs:
        heads = ("first", "second", "traces", "first - second", "95 %", "p (Holm)", "wins", "what it tells")
        table(f"differences of S on the same traces ({shown_unit(ranking.unit)})", heads, pairs)
    if ranking.skill is not None:
        show_skill(ranking.skill, ("by horizon", "by machine"))
    for row in ranking.standings:
        for finding in row.findings:
            if finding.kept is not True:
                word = "not kept" if finding.kept is False else "not known"
                said = f"{row.entrant}: {finding.criterion} {word}: {finding.sentence}"
                click.echo(f"{said}; next: {finding.next_step}")
    for note in ranking.notes:
        click.echo(f"note: {note}")
    for kind, file in (("page", page), ("picture", picture)):
        if file is not None:
            click.echo(f"{kind}: {file}")

"""`decanter model judge rank`: several models on the same traces; which of them are fit for deployment."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import click

from gateway.console import CommandResult, Part, Rows, conclude, progress
from gateway.entry import Exit, fail, interruptible, sentences
from gateway.lab.judging.request import JudgingRequest
from gateway.lab.judging.skill import show_skill
from sim.lab.judge import (
    Facts,
    ForecastSkill,
    Progress,
    Ranking,
    TraceResult,
    Weights,
    as_plain,
    distinct_labels,
    draw_ranking,
    entrants,
    local_runner,
    model_facts_by_semantics,
    outcomes_by_model,
    parse_limits,
    read_results,
    recorded_facts,
    unread_traces,
    write_page,
)
from sim.lab.judge import rank as ranked
from sim.lab.pictures import check_picture
from sim.lab.recordings import load_map, load_traces
from sim.sha import display_unit


@dataclass(frozen=True, slots=True)
class RankingInput:
    """What is ranked: the results, what is known of each model by entrant, and its forecasts' skill, if asked for."""

    results: list[TraceResult]
    facts: dict[str, Facts]
    skill: ForecastSkill | None = None


def compare_models(request: JudgingRequest, folders: Sequence[Path], progress: Progress) -> RankingInput:
    """Runs every model along every trace, or reads what an earlier campaign found.

    Raises ValueError or OSError for what cannot be read, and for a model at hand that has no results in the folders.
    """
    column_map = load_map(request.map_file)
    if not folders:
        traces, report = load_traces(list(request.paths), column_map)
        training = load_traces(list(request.training), column_map)[0] if request.training else None
        prepared = distinct_labels([request.prepare_model(where, column_map, training) for where in request.models])
        run, settings = local_runner(request.workers), request.settings
        by_model = outcomes_by_model(
            prepared, traces, without=unread_traces(report, traces), settings=settings, run=run, progress=progress
        )
        results = [outcome.result for _, outcomes in by_model for outcome in outcomes]
        facts_at_hand = _by_entrant(results, {model.label: model_facts_by_semantics(model) for model in prepared})
        made = request.forecasts(prepared, traces, training, progress)
        return RankingInput(results, facts_at_hand, made.skill(seed=settings.seed) if made else None)
    results = [result for folder in folders for result in read_results(folder)]
    labels = sorted({result.model for result in results})
    facts = {label: found for folder in folders for label, found in recorded_facts(folder).items()}
    # A model at hand is that of the results with its name: it is verified, which the records cannot say.
    for at_hand in distinct_labels([request.prepare_model(where, column_map, None) for where in request.models]):
        if at_hand.label not in labels:
            raise ValueError(
                f"{at_hand.where}: the results have no model {at_hand.label!r}; they have {', '.join(labels) or 'none'}"
            )
        own = model_facts_by_semantics(at_hand)
        unfit = own.pop("")
        # The gate's word on the model at hand is its word on the recorded semantics too.
        word = next(iter(own.values()), unfit)
        recorded = {
            name: replace(known, verified=word.verified, gate=word.gate)
            for name, known in facts.get(at_hand.label, {}).items()
        }
        facts[at_hand.label] = {**recorded, **own}
    return RankingInput(results, _by_entrant(results, facts))


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


def rank(
    request: JudgingRequest,
    folders: Sequence[Path],
    weights: tuple[float, float, float],
    limits: Sequence[tuple[str, str]],
    allow_synthetic: bool,
    page: Path | None,
    picture: Path | None,
    as_json: bool,
) -> None:
    """Carry out `decanter model judge rank`; its options and its help are in judging/commands.py."""
    if bool(request.paths) == bool(folders) or (request.paths and not request.models):
        raise click.UsageError("Give MODEL... with --traces, or --results of an earlier campaign.")
    if request.skill and not request.paths:
        raise click.UsageError("--skill forecasts along traces: give MODEL... with --traces instead of --results.")
    request.check_training()
    try:
        with sentences(), progress("ranking") as bar, interruptible(bar) as report:
            if picture is not None:
                check_picture(picture)
            used, bounds = Weights(*weights), parse_limits(limits, synthetic=allow_synthetic)
            seen = compare_models(request, folders, report)
            ranking = ranked(
                seen.results,
                seen.facts,
                weights=used,
                limits=bounds,
                seed=request.settings.seed,
                skill=seen.skill,
            )
            if page is not None:
                write_page(ranking, seen.results, page)
            if picture is not None:
                draw_ranking(ranking, seen.results, picture)
            data = {**as_plain(ranking), "page": page and str(page), "picture": picture and str(picture)}
    except KeyboardInterrupt:
        fail("stopped before the end; nothing was written", Exit.INTERRUPTED)
    conclude(CommandResult(data), lambda _: _show(ranking, page, picture), as_json=as_json)


def _show(ranking: Ranking, page: Path | None, picture: Path | None) -> Iterator[Part]:
    weights = ranking.weights
    formula = f"S = {weights.mae:g} MAE + {weights.largest:g} max + {weights.scatter:g} sigma"
    columns = (
        "rank",
        "model",
        "for deployment",
        "S",
        "S %",
        "MAE",
        "max",
        "sigma",
        "CRPS",
        "coverage 90 %",
        "persistence",
    )
    names = ("score", "score_percent", "mae", "largest", "scatter", "crps", "coverage", "persistence", "wins")
    rows = [
        [row.rank or "–", row.entrant, row.fitness, *(getattr(row, name) for name in names), row.failed, row.in_sample]
        for row in ranking.standings
    ]
    yield Rows(
        f"{formula} ({display_unit(ranking.unit)}), means over {len(ranking.common)} common traces",
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
        yield Rows(f"differences of S on the same traces ({display_unit(ranking.unit)})", heads, pairs)
    if ranking.skill is not None:
        yield from show_skill(ranking.skill, ("by horizon", "by machine"))
    for row in ranking.standings:
        for finding in row.findings:
            if finding.kept is not True:
                word = "not kept" if finding.kept is False else "not known"
                said = f"{row.entrant}: {finding.criterion} {word}: {finding.sentence}"
                yield f"{said}; next: {finding.next_step}"
    for note in ranking.notes:
        yield f"note: {note}"
    for kind, file in (("page", page), ("picture", picture)):
        if file is not None:
            yield f"{kind}: {file}"

"""`decanter model rank`: several models on the same traces, and which of them are fit for deployment."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from gateway.console.interrupt import interruptible
from gateway.console.options import json_option, map_option, seed_option
from gateway.console.output import Exit, emit, fail, progress, sentences, table
from gateway.console.places import shipped

if TYPE_CHECKING:
    from gateway.lab.ranking import Compared
    from sim.ranking.ranking import Ranking
    from sim.validation.stages import Wanted

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


@click.command(
    short_help="Compare models on the same traces; say which are fit for deployment and why not.", epilog=LIMITS
)
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
    type=click.Choice(["written", "own", "thesis", "both"]),
    default="written",
    show_default=True,
    help="The temperature is carried over events (own) or drawn on entry (thesis); both are ranked apart.",
)
@click.option("--training", multiple=True, help="Traces that give the thesis semantics its entry laws.")
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
    wanted: "Wanted",
    training: Sequence[str],
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
    fitness for deployment are options; `open` means that one of them could not be looked at.
    """
    from gateway.lab.ranking import Campaign, compared
    from sim.ranking.fitness import limits_of
    from sim.ranking.ranking import Weights
    from sim.ranking.ranking import rank as ranked
    from sim.ranking.report import check_picture

    if bool(paths) == bool(folders) or (paths and not models):
        raise click.UsageError("Give MODEL... with --traces, or --results of an earlier campaign.")
    try:
        with sentences(), progress("ranking") as bar, interruptible(bar) as report:
            if picture is not None:
                check_picture(picture)
            used, bounds = Weights(*weights), limits_of(limits, synthetic=allow_synthetic)
            wish = Campaign(models, paths, folders, shipped("traces", map_name), wanted, training, runs, jobs, seed)
            seen = compared(wish, report)
            found = ranked(seen.results, seen.facts, weights=used, limits=bounds, seed=seed)
            data = _written(found, seen, page, picture)
    except KeyboardInterrupt:
        fail("stopped before the end; nothing was written", Exit.INTERRUPTED)
    emit(data, lambda: _show(found, page, picture), as_json_line=as_json)


def _written(found: "Ranking", seen: "Compared", page: Path | None, picture: Path | None) -> dict[str, Any]:
    """Write what was asked for; the ranking as plain values."""
    from sim.ranking.report import as_plain, draw_ranking, write_page

    if page is not None:
        write_page(found, seen.results, page)
    if picture is not None:
        draw_ranking(found, seen.results, picture)
    return {**as_plain(found), "page": page and str(page), "picture": picture and str(picture)}


def _show(found: "Ranking", page: Path | None, picture: Path | None) -> None:
    weights = found.weights
    formula = f"S = {weights.mae:g} MAE + {weights.largest:g} max + {weights.scatter:g} sigma"
    columns = ("rank", "model", "for deployment", "S", "MAE", "max", "sigma", "CRPS", "coverage 90 %", "persistence")
    names = ("score", "mae", "largest", "scatter", "crps", "coverage", "persistence", "wins")
    rows = [
        [one.rank or "–", one.entrant, one.verdict, *(getattr(one, name) for name in names), one.failed, one.in_sample]
        for one in found.standings
    ]
    table(f"{formula} (°C), means over {len(found.common)} common traces", (*columns, "wins", "failed", ""), rows)
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
        for pair in found.pairs
    ]
    if pairs:
        heads = ("first", "second", "traces", "first - second", "95 %", "p (Holm)", "wins", "what it tells")
        table("differences of S on the same traces (°C)", heads, pairs)
    for one in found.standings:
        for finding in one.findings:
            if finding.kept is not True:
                word = "not kept" if finding.kept is False else "not known"
                click.echo(f"{one.entrant}: {finding.criterion} {word}: {finding.sentence}")
    for note in found.notes:
        click.echo(f"note: {note}")
    for kind, file in (("page", page), ("picture", picture)):
        if file is not None:
            click.echo(f"{kind}: {file}")

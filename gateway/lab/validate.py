"""`decanter model validate`: models along measured traces in nine stages, with a report each."""

import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from gateway.console.interrupt import interruptible
from gateway.console.options import json_option, map_option, seed_option
from gateway.console.output import Exit, emit, fail, progress, sentences, table
from gateway.console.places import shipped

if TYPE_CHECKING:
    from sim.engine.schedule import Policy
    from sim.validation.results import TraceResult
    from sim.validation.stages import Wanted


TOLD = 5
"""Reasons that are printed for each model."""


@click.command(short_help="Validate models along measured traces in nine stages; write a report for each.")
@click.argument("models", nargs=-1, required=True, metavar="MODEL...")
@click.option("--traces", "paths", multiple=True, required=True, help="A file, a folder or a glob; may be given again.")
@map_option
@click.option("--out", type=click.Path(path_type=Path), required=True, help="The folder for reports and results.")
@click.option("--overwrite", is_flag=True, help="Replace the results of an earlier campaign in --out.")
@click.option(
    "--semantics",
    "wanted",
    type=click.Choice(["written", "own", "thesis", "both"]),
    default="written",
    show_default=True,
    help="The temperature is carried over events (own) or drawn on entry (thesis); both side by side.",
)
@click.option(
    "--training",
    multiple=True,
    help="Traces to learn `bins` or `lsha` from, and to give the thesis semantics its entry laws.",
)
@click.option(
    "--policy",
    type=click.Choice(["reject", "ignore", "resync"]),
    default="resync",
    show_default=True,
    help="An event without an edge.",
)
@click.option("--runs", type=click.IntRange(100, 100_000), default=1000, show_default=True, help="Runs a trace.")
@click.option("--jobs", type=click.IntRange(1), help="Worker processes.  [default: one a core]")
@click.option("--cluster", "address", help="Run on the Dask cluster whose scheduler is at this address (tcp://...).")
@click.option("--pictures/--no-pictures", default=True, show_default=True, help="A PNG and a PDF a trace.")
@seed_option
@json_option
def validate(
    models: Sequence[str],
    paths: Sequence[str],
    map_name: str,
    out: Path,
    overwrite: bool,
    wanted: "Wanted",
    training: Sequence[str],
    policy: "Policy",
    runs: int,
    jobs: int | None,
    address: str | None,
    pictures: bool,
    seed: int,
    as_json: bool,
) -> None:
    """Validate models along measured traces: artefacts checked, every event followed, open-loop runs compared.

    MODEL is a model directory, a store, STORE@VERSION, a model.json, or DIR/NAME of a set of artefacts; `bins` or
    `lsha`, where nothing of that name is there, is learned from --training first. --out gets the record of each of the
    nine stages, results as JSON and CSV, pictures, one HTML report a model and an index. A trace that fails is reported
    and the others go on; the exit code is 1 only when nothing could be simulated.
    """
    try:
        with sentences(), progress("validating") as bar, interruptible(bar) as report:
            from gateway.lab.validation import Request, campaign
            from sim.validation.trace_run import TraceRunSettings

            place, settings = shipped("traces", map_name), TraceRunSettings(runs, policy, seed)
            request = Request(
                models, paths, place, out, overwrite, wanted, training, settings, jobs, address, pictures, time.time()
            )
            _, results = campaign(request, _quiet if as_json else click.echo, report)
    except KeyboardInterrupt:
        begun = (out / "campaign.json").is_file()
        left = f"what was done lies in {out}, and --overwrite begins anew there" if begun else "nothing was written"
        fail(f"stopped before the end; {left}", Exit.INTERRUPTED)
    emit(_data(out, results), lambda: _show(out, results), as_json_line=as_json)
    if all(one.failure for one in results):
        fail(f"no model could be run along any trace; {results[0].trace}: {results[0].failure}", Exit.CHECK_FAILED)


def _quiet(_: str) -> None:
    """With --json the stages are in the folder alone."""


def _data(out: Path, results: "Sequence[TraceResult]") -> dict[str, Any]:
    """What --json gives: summaries, gains, verdicts and results."""
    from dataclasses import asdict

    from sim.validation.verdicts import gain, summaries, verdict

    models = list(dict.fromkeys(one.model for one in results))
    gains = {name: gain([one for one in results if one.model == name]) for name in models}
    return {
        "out": str(out),
        "report": str(out / "index.html"),
        "summaries": [asdict(one) for one in summaries(results)],
        "gains": {name: asdict(found) | {"sentence": found.sentence} for name, found in gains.items() if found},
        "results": [asdict(one) | {"verdict": asdict(verdict(one))} for one in results],
    }


def _show(out: Path, results: "Sequence[TraceResult]") -> None:
    from sim.validation.verdicts import gain, summaries

    columns = ("model", "semantics", "good", "review", "failed", "MAE", "RMSE", "at events", "dense", "final %")
    more = ("coverage", "CRPS", "persistence")
    names = ("mae", "rmse", "at_events", "dense", "final_percent", "coverage", "crps", "persistence")
    rows = [
        [one.model, one.semantics, one.good, one.review, one.failed, *(getattr(one, name) for name in names)]
        for one in summaries(results)
    ]
    table("validation, means over traces (°C)", (*columns, *more), rows)
    for name in dict.fromkeys(one.model for one in results):
        found = gain([one for one in results if one.model == name])
        if found is not None:
            click.echo(f"{name}: {found.sentence}")
        for sentence in _reasons([one for one in results if one.model == name]):
            click.echo(f"{name}: {sentence}")
    click.echo(f"report: {out / 'index.html'}")


def _reasons(results: "Sequence[TraceResult]") -> list[str]:
    """Why traces failed or are to be looked at, the first TOLD of them; the report has all."""
    from sim.validation.report import natural
    from sim.validation.verdicts import verdict

    judged = [(one, verdict(one)) for one in sorted(results, key=lambda one: natural(one.trace))]
    said = [
        f"{found.word}: {one.trace} ({one.semantics}): {'; '.join(found.reasons)}"
        for word in ("failed", "review")
        for one, found in judged
        if found.word == word
    ]
    return said[:TOLD] + ([f"{len(said) - TOLD} more of these are in the report"] if len(said) > TOLD else [])

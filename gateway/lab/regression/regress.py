"""`decanter model regress`: a standard set against all models, and what became worse since which version."""

import os
import time
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import click

from gateway.console import emit, json_option, map_option, progress, seed_option, table
from gateway.entry import Exit, interruptible, sentences
from gateway.lab.regression.history import opened_history, run_standard
from gateway.lab.regression.standard import code_version, models_in, read_standard
from gateway.lab.regression.worse import regressions_of
from gateway.lab.retraining.judging import PRESENT
from sim.learning import PERSISTENCE
from sim.sha import DEGREES, Model, shown_unit


@click.command("regress", short_help="Run a standard set against all models; say what became worse since when.")
@click.argument("places", metavar="MODELS...", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--standard", required=True, help="The traces: a folder, a file, a glob, or a TOML list of them.")
@click.option(
    "--history",
    "file",
    type=click.Path(path_type=Path, dir_okay=False),
    default=Path("out/regressions.jsonl"),
    show_default=True,
    help="All results so far, which this run is held against and added to.",
)
@click.option("--accept", "reason", help="From now on the models as they are at this run are what counts; say why.")
@map_option
@seed_option
@json_option
def regress(
    places: Sequence[Path], standard: str, file: Path, reason: str | None, map_name: str, seed: int, as_json: bool
) -> None:
    """Forecast along the standard set with every model of MODELS (stores, folders, models), and keep the results.

    Each model is held against its best former run by a paired test, at the forecast's horizons. Where it is worse, it
    is said since which program or model, and the exit code is 1. A result that the history has is not computed again,
    and a run that was stopped or killed goes on with the same command.
    """
    if reason is not None and not reason.strip():
        raise click.UsageError("--accept needs a reason")
    with sentences(), progress("standard set") as bar, interruptible(bar) as report:
        traces = read_standard(standard, map_name)
        models: dict[str, Model | str] = {}
        for place in places:
            found = models_in(place, traces)
            # As seen from the history: the same subject from wherever the command is called, and after a move of both.
            models |= {os.path.relpath(Path(name).resolve(), file.parent.resolve()): found[name] for name in found}
        code = code_version()
        with opened_history(file) as history:
            run_standard(models, traces, history, code=code, seed=seed, clock=time.time, report=report)
            worse = [each for subject in models for each in regressions_of(subject, history, seed=seed)]
            last = history.rows[-1]
            results = {subject: history.results(last, subject) for subject in models}
            if reason is not None:
                when = datetime.fromtimestamp(time.time(), UTC).isoformat(timespec="seconds")
                history.add({"kind": "accepted", "when": when, "reason": reason})
    unit = {subject: DEGREES if isinstance(model, str) else model.unit for subject, model in models.items()}
    said = [each if isinstance(each, str) else each.sentence(unit[each.subject]) for each in worse]
    rows = [row for subject in models for row in _means(subject, results[subject])]
    data: dict[str, Any] = {"history": str(file), "code": code.content, "release": code.release, "commit": code.commit}
    data |= {"results": rows, "units": unit, "worse": said, "accepted": reason}
    data |= {"failed": {subject: _failed(own) for subject, own in results.items() if _failed(own)}}

    def show() -> None:
        if rows:
            units = ", ".join(sorted({shown_unit(each) for each in unit.values()}))
            title = f"standard set, {len(traces.traces)} traces, CRPS in {units}, program {code}"
            table(title, list(rows[0]), [list(row.values()) for row in rows])
        for subject, reasons in data["failed"].items():
            for each in reasons:
                click.echo(f"{subject}: {each}")
        for each in said:
            click.secho(each, fg="red")
        click.echo(f"{len(said)} became worse; history: {file}" if said else f"nothing became worse; history: {file}")

    emit(data, show, as_json_line=as_json)
    if said and reason is None:
        click.get_current_context().exit(Exit.CHECK_FAILED)


def _means(subject: str, results: Mapping[str, Mapping[str, Any]]) -> list[dict[str, Any]]:
    """A row a horizon (s): means over the traces."""
    scores = [score for row in results.values() for score in row["scores"]]
    rows: list[dict[str, Any]] = []
    for horizon in sorted({score["horizon"] for score in scores}):
        own = [score for score in scores if (score["horizon"], score["method"]) == (horizon, PRESENT)]
        simple = [score for score in scores if (score["horizon"], score["method"]) == (horizon, PERSISTENCE)]
        row: dict[str, Any] = {"model": subject, "horizon (s)": horizon, "traces": len(own)}
        for name in ("crps", "coverage"):
            row[name] = sum(score[name] for score in own) / len(own)
        row["persistence"] = sum(score["crps"] for score in simple) / len(simple)
        rows.append(row)
    return rows


def _failed(results: Mapping[str, Mapping[str, Any]]) -> list[str]:
    return sorted({row["failed"] for row in results.values() if row["failed"]})

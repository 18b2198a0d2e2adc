"""`decanter trace map`: a column map drafted from a CSV that nobody has described."""

import sys
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path

import click

from drivers.named_files import writing
from gateway.console import emit, json_option
from gateway.entry import sentences
from sim.lab.recordings.mapping import NONE, Answers, DraftedMap, Undecided, draft_map


@click.command("map", short_help="Draft a column map from a CSV: clock, units, switches, temperature, thresholds.")
@click.argument("file", type=click.Path(path_type=Path))
@click.option("-o", "--out", type=click.Path(path_type=Path), help="The map to write; without it, it is printed.")
@click.option("--overwrite", is_flag=True, help="Replace a map that is there.")
@click.option("--temperature", default="", help="The column that is modelled.")
@click.option("--current", default="", help=f"The column of the motor's current; {NONE} for none.")
@click.option("--running", default="", help=f"The column that says whether the machine runs; {NONE} for none.")
@click.option("--on", default="", help="The word of that column that means running.")
@click.option("--time", default="", help="The column of times.")
@click.option("--dates", type=click.Choice(["day", "month"]), help="What comes first in 03/04/2024.")
@click.option("--timezone", default="", help="The zone of times that do not say theirs, such as Europe/Rome [UTC].")
@json_option
def map_command(file: Path, out: Path | None, overwrite: bool, dates: str | None, as_json: bool, **names: str) -> None:
    """Draft a column map from FILE, for `trace show` and `model learn`.

    Finds the clock and its format, separator and decimals, numbers, switches and their words, units, temperature and
    current, and thresholds. Where two columns fit it asks; off a terminal the option decides that it names.
    """
    with sentences():
        if out is not None and out.exists() and not overwrite:
            raise ValueError(f"{out}: is there already; give another name, or --overwrite")
        answers = Answers(dates=dates or "", **names)
        drafted = asked_map(file, answers)
        if out is not None:
            with writing(out):
                out.write_text(drafted.text, encoding="utf-8")
    data = {"file": str(file), "map": out and str(out), **asdict(drafted)}

    def show() -> None:
        if out is None:
            click.echo(drafted.text, nl=False)
        for sentence in drafted.report:
            click.secho(sentence, fg="yellow", err=True)
        click.echo(f"{file}: {drafted.rows} of {drafted.of} rows are read by this map", err=out is None)
        if out is not None:
            click.echo(f"column map: {out}")
            click.echo(f"next: decanter trace show {file} --map {out}")

    emit(data, show, as_json_line=as_json)


def asked_map(file: Path, answers: Answers, names: Mapping[str, str] | None = None) -> DraftedMap:
    """The map, a person asked for what the file leaves open, as long as one is there; `names` as `draft_map` has them.

    Raises Undecided where nobody is there, TraceError where there is no map.
    """
    while True:
        try:
            return draft_map(file, answers, names)
        except Undecided as open_point:
            if not (sys.stdin.isatty() and sys.stderr.isatty()):
                raise
            click.echo(f"{open_point.question}:", err=True)
            chosen = click.prompt("which", type=click.Choice(list(open_point.choices)), err=True)
            answers = answers.with_answer(open_point.field, chosen)

"""`decanter trace map`: a column map drafted from a CSV that nobody has described."""

import sys
import time
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path

import click

from drivers.named_files import name_write_errors
from gateway.console import CommandResult, Line, Part, conclude, json_option
from gateway.entry import sentences
from sim.lab.recordings.mapping import BLANK_IS_GOOD, CHOICES, NO_COLUMN, Answers, DraftedMap, Undecided, draft_map

MOST_QUESTIONS = 3
"""Of one export; what is open beyond them is taken as it most likely is, and said."""


@click.command("map", short_help="Draft a column map from a CSV: clock, units, switches, temperature, thresholds.")
@click.argument("file", type=click.Path(path_type=Path))
@click.option("-o", "--out", type=click.Path(path_type=Path), help="The map to write; without it, it is printed.")
@click.option("--overwrite", is_flag=True, help="Replace a map that is there.")
@click.option("--temperature", default="", help="The column that is modelled.")
@click.option(
    "--current",
    multiple=True,
    help=f"The column of the motor's current, or of what else loads the machine; again for several; {NO_COLUMN} for "
    "none.",
)
@click.option("--running", default="", help=f"The column that says whether the machine runs; {NO_COLUMN} for none.")
@click.option("--on", multiple=True, help="A word of that column that means running; may be given several times.")
@click.option("--time", default="", help="The column of times.")
@click.option("--dates", type=click.Choice(CHOICES["dates"]), help="What comes first in 03/04/2024.")
@click.option("--timezone", default="", help="The zone of times that do not say theirs, such as Europe/Rome [UTC].")
@click.option("--unit", multiple=True, help="The unit of a column that does not say it, as 'Bearing temperature=K'.")
@click.option("--machine", default="", help=f"The column that says which machine a row is of; {NO_COLUMN} for none.")
@click.option("--session", default="", help=f"The column that says which session a row is of; {NO_COLUMN} for none.")
@click.option(
    "--good",
    multiple=True,
    help=f"A word of the quality of good readings; {BLANK_IS_GOOD}: also where it is blank; {NO_COLUMN}: it says "
    "nothing.",
)
@click.option("--stored", type=click.Choice(CHOICES["stored"]), help="How values were stored.")
@click.option("--duplicates", type=click.Choice(CHOICES["duplicates"]), help="What becomes of rows with the same time.")
@click.option("--clock-back", type=click.Choice(CHOICES["clock_back"]), help="What becomes of a clock that goes back.")
@click.option("--yes", is_flag=True, help="Take what is most likely wherever a question says it.")
@json_option
def map_command(
    file: Path,
    out: Path | None,
    overwrite: bool,
    current: tuple[str, ...],
    on: tuple[str, ...],
    unit: tuple[str, ...],
    good: tuple[str, ...],
    yes: bool,
    as_json: bool,
    **names: str | None,
) -> None:
    """Draft a column map from FILE, for `trace show` and `model learn`; FILE may be a folder of one recording's files.

    Finds the clock and its format, separator and decimals, numbers, switches and their words, units, temperature and
    current, machines, sessions, and thresholds. Where two columns fit it asks; off a terminal the option decides that
    it names.
    """
    with sentences():
        if out is not None and out.exists() and not overwrite:
            raise ValueError(f"{out}: is there already; give another name, or --overwrite")
        answers = Answers(
            current=current, on=on, unit=unit, good=good, **{name: given or "" for name, given in names.items()}
        )
        drafted = ask_map(file, answers, yes=yes)
        if out is not None:
            with name_write_errors(out):
                out.write_text(drafted.text, encoding="utf-8")
    data = {"file": str(file), "map": out and str(out), **asdict(drafted)}

    def show() -> Iterator[Part]:
        if out is None:
            yield drafted.text.removesuffix("\n")
        for sentence in drafted.report:
            yield Line(sentence, "yellow", aside=True)
        yield Line(f"{file}: {drafted.rows} of {drafted.of} rows are read by this map", aside=out is None)
        for sentence in drafted.account:
            yield Line(sentence, aside=out is None)
        if out is not None:
            yield f"column map: {out}"
            yield f"next: decanter trace show {file} --map {out}"

    conclude(CommandResult(data), lambda _: show(), as_json=as_json)


def ask_map(file: Path, answers: Answers, names: Mapping[str, str] | None = None, *, yes: bool = False) -> DraftedMap:
    """The map, a person asked for what the file leaves open, as long as one is there; `names` as `draft_map` has them.

    With `yes` what is most likely is taken, and said. Raises Undecided where nobody is there, TraceError where there is
    no map.
    """
    asked = 0
    while True:
        try:
            return draft_map(file, answers, names, now=time.time())
        except Undecided as open_point:
            if open_point.guess and (yes or asked >= MOST_QUESTIONS):
                click.secho(
                    f"taken: --{open_point.field} {open_point.guess}: {open_point.question}", fg="yellow", err=True
                )
                answers = answers.with_answer(open_point.field, open_point.guess)
                continue
            if not (sys.stdin.isatty() and sys.stderr.isatty()):
                raise
            asked += 1
            click.echo(f"{open_point.question}:", err=True)
            for choice, seen in zip(open_point.choices, open_point.seen, strict=False):
                click.echo(f"  {choice}: {seen}", err=True)
            chosen = click.prompt(
                "which", type=click.Choice(list(open_point.choices)), default=open_point.guess or None, err=True
            )
            answers = answers.with_answer(open_point.field, chosen)

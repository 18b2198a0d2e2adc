"""`decanter trace map`: a column map drafted from a CSV that nobody has described."""

import sys
import time
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path

import click

from drivers.named_files import name_write_errors
from gateway.console import CommandResult, Line, Part, conclude
from gateway.entry import sentences
from sim.lab.recordings.mapping import Answers, DraftedMap, Undecided, draft_map

MOST_QUESTIONS = 3
"""Of one export; what is open beyond them is taken as it most likely is, and said."""


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
    """The work of `trace map`."""
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

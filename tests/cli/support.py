"""What the command line's tests share: a run of `decanter` in this process, and checks on what came out."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NoReturn

import click
from click.testing import CliRunner, Result

from gateway.cli.main import main
from gateway.entry import FirstWordCommand, LazyGroup

ROOT = Path(__file__).parents[2]
DATA = ROOT.parent / "shared" / "data"


def decanter(*arguments: object) -> Result:
    """Run one command; a defect is raised instead of becoming an exit code."""
    result = CliRunner().invoke(main, [str(argument) for argument in arguments])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


Tree = LazyGroup | FirstWordCommand
"""What has commands by their names."""


def command_paths(tree: Tree = main, before: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Tree]]:
    """Every command by its words, with what has it; then the works of one that does several."""
    context = click.Context(tree)
    for name in tree.list_commands(context) if isinstance(tree, LazyGroup) else tree.table:
        command = tree.get_command(context, name)
        assert command is not None
        if not isinstance(command, LazyGroup):
            yield (*before, name), tree
        if isinstance(command, LazyGroup | FirstWordCommand):
            yield from command_paths(command, (*before, name))


def find_command(words: tuple[str, ...]) -> click.Command:
    """The command that these words call, as the tables have it. Raises KeyError for a word that is in none."""
    command: click.Command = main
    for word in words:
        assert isinstance(command, LazyGroup | FirstWordCommand)
        found = command.get_command(click.Context(command), word)
        if found is None or found.hidden:
            raise KeyError(word)
        command = found
    return command


def _no_such_number(word: str) -> NoReturn:
    raise AssertionError(f"{word} is no JSON")


def only_object(text: str) -> dict[str, Any]:
    """The one strict JSON object that is all of `text`."""
    data = json.loads(text, parse_constant=_no_such_number)
    assert isinstance(data, dict)
    assert text.count("\n") == 1
    return data


def refused(result: Result, code: int, *words: str) -> str:
    """The command left with `code`, said nothing on stdout and one sentence with these words on stderr."""
    assert (result.exit_code, result.stdout) == (code, ""), result.output
    said = result.stderr.strip()
    assert "\n" not in said and said.startswith("decanter: ") and "Traceback" not in said
    assert "Errno" not in said
    for word in words:
        assert word in said, said
    return said


def misused(result: Result, *words: str) -> None:
    """The command was called wrongly: one sentence that names its help, code 2."""
    assert "--help`" in refused(result, 2, *words)


def with_one_bearing(trace: Path, folder: Path, rows: int | None = None) -> Path:
    """The trace without the feed bearing's column: what is not measured is not predicted, and one model is enough.

    With `rows` it is no more than its first ones.
    """
    lines = trace.read_text(encoding="utf-8").splitlines()
    head = next(number for number, line in enumerate(lines) if not line.startswith("#"))
    place = lines[head].split(",").index("TCuscinettiAlimentazione")
    cells = [line.split(",") for line in lines[head : None if rows is None else head + 1 + rows]]
    path = folder / f"{trace.stem}.csv"
    kept = [*lines[:head], *(",".join((*row[:place], *row[place + 1 :])) for row in cells)]
    path.write_text("\n".join(kept) + "\n", encoding="utf-8")
    return path

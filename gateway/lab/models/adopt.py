"""`decanter diagnose adopt`: a law that a diagnosis found becomes an engineer's own effect, under a name of theirs."""

import json
from dataclasses import replace
from pathlib import Path

import click

from gateway.console import CommandResult, conclude, json_option
from gateway.entry import sentences
from sim.artefacts import effect_lines_text, read_effect_lines, read_embedded_line
from sim.effects import LineError, own_kind
from sim.files import replace_durably
from sim.sha import EffectLine


def read_law(folder: Path, number: int) -> EffectLine:
    """The line of the `number`-th law (from 1) in a diagnosis' folder. Raises ValueError or OSError."""
    file = folder / "diagnosis.json"
    try:
        laws = json.loads(file.read_text(encoding="utf-8"))["laws"]
        law = laws[number - 1] if number <= len(laws) else None
    except (ValueError, KeyError, TypeError, IndexError):
        raise ValueError(
            f"{file}: is no diagnosis with laws; give the folder that `decanter diagnose --out` wrote"
        ) from None
    if law is None:
        found = (
            f"its laws are 1 to {len(laws)}" if laws else "it has no laws: they are looked for where nothing has a name"
        )
        raise ValueError(f"{file}: there is no law {number}; {found}")
    if law.get("line") is None:
        raise ValueError(
            f"{file}: law {number} ({law.get('expression')}) cannot be a line: no engine has lags, rhythms or a "
            "calendar; record what lies behind it as a signal, and diagnose again"
        )
    return read_embedded_line(law["line"], file, f"laws[{number - 1}].line")


@click.command()
@click.argument("folder", type=click.Path(path_type=Path))
@click.option("--law", "number", type=click.IntRange(1, 3), default=1, show_default=True, help="Which of its laws.")
@click.option("--name", required=True, help="The effect's name, such as slurry-coupling.")
@click.option("--meaning", help="What it is, in one phrase; the expression by default.")
@click.option("--look", default="", help="What to look at at the machine when it is named.")
@click.option("--effects", "file", type=click.Path(path_type=Path), required=True, help="The file it is added to.")
@json_option
def adopt(folder: Path, number: int, name: str, meaning: str | None, look: str, file: Path, as_json: bool) -> None:
    """Make a law that a diagnosis found an effect of your own, one entry of a TOML file.

    FOLDER is what `decanter diagnose --out` wrote. What the law means is yours to say: the program found that heat goes
    with an expression, and no more. `decanter diagnose --effects FILE` then tests it like those of the catalogue.
    """
    with sentences():
        line = read_law(folder, number)
        line = replace(line, name=name, meaning=meaning or line.meaning, look=look)
        try:
            own_kind(line)
        except LineError as error:
            raise ValueError(f"--{error.key}: {error.sentence}") from None
        known = read_effect_lines(file) if file.exists() else ()
        if name in [other.name for other in known]:
            raise ValueError(f"{file}: has an effect {name!r} already; give --name another one")
        # Added at the end as text, so that what somebody wrote before it stays as it was, comments and all.
        before = file.read_text(encoding="utf-8").rstrip() + "\n\n" if known else ""
        replace_durably(file, before + effect_lines_text([line]))
    conclude(
        CommandResult({"effects": str(file), "name": line.name, "heat": line.heat}),
        lambda _: [f"{file}: {line.name} is heat = {line.heat!r}; test it with decanter diagnose --effects {file}"],
        as_json=as_json,
    )

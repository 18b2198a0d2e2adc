"""Slips in a plant file and what is said of each: `python -m benchmarks.broken_plants`.

Every slip of `tests.rig.broken_plants` in a plant that is in order: values that nobody can mean, then what people
mistype, and files that are no files. Prints the table, what nobody noticed, and of what is refused each command that
says something else.
"""

import shutil
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import click
from click.testing import CliRunner

from gateway.cli.main import main as decanter
from tests.rig.broken_plants import COMMANDS, judge_plant, seed_with_device, slips, spoiled_plants


def _slips() -> Iterator[tuple[str, Callable[[Path], object], str]]:
    """(what, how a folder is spoiled, words that are said of it) of all."""
    for slip in slips():

        def spoil(folder: Path, slip: object = slip) -> None:
            plant = folder / "plant.toml"
            plant.write_text(slip.text(plant.read_text(encoding="utf-8")), encoding="utf-8")  # type: ignore[attr-defined]

        yield str(slip), spoil, ""
    yield from spoiled_plants()


def _who_says_else(plant: Path, sentence: str) -> list[str]:
    """The commands that do not refuse the plant file with this sentence."""
    wanted = "".join(sentence.split())
    found = []
    for command in COMMANDS:
        told = CliRunner().invoke(decanter, [*command.split(), "--config", str(plant)])
        if told.exit_code != 2 or wanted not in "".join(told.stderr.split()):
            found.append(command)
    return found


@click.command()
def main() -> None:
    """Try them all; leaves with 1 if one slip was not noticed, or a command says something else of one."""
    counts = {"refused": 0, "found": 0, "not noticed": 0, "said otherwise by a command": 0}
    with tempfile.TemporaryDirectory() as home:
        seed_with_device(Path(home) / "whole")
        for number, (what, spoil, words) in enumerate(_slips()):
            folder = Path(home) / str(number)
            shutil.copytree(Path(home) / "whole", folder, symlinks=True)
            spoil(folder)
            said = judge_plant(folder / "plant.toml")
            noticed = any(words in sentence for sentence in said.sentences)
            word = "not noticed" if not noticed else "refused" if said.refused else "found"
            counts[word] += 1
            sentence = next(iter(said.sentences), "")
            shown = sentence.replace(f"{folder}/", "")
            click.echo(f"{word:12} {what.encode('unicode_escape').decode():60.60} {shown[:160]}")
            if said.refused and (others := _who_says_else(folder / "plant.toml", sentence)):
                counts["said otherwise by a command"] += 1
                click.echo(f"             another sentence: {', '.join(others)}")
            shutil.rmtree(folder)
    click.echo(", ".join(f"{count} {word}" for word, count in counts.items()))
    raise SystemExit(bool(counts["not noticed"] or counts["said otherwise by a command"]))


if __name__ == "__main__":
    main()

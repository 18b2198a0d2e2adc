"""Starts of a gateway after one of its files was damaged, file by file: `python -m benchmarks.broken_starts`.

Each file that a start reads is emptied, cut, flipped, filled with zeros, ones and text, at PLACES places of it; after
each damage both machines of the plant have to be scanned and alarmed, and a model that cannot be run has to be an alarm
(`tests.rig.broken_starts`). Prints the matrix, files by damages, with what was wrong.
"""

import random
import tempfile
from collections import Counter
from pathlib import Path

import click

from tests.rig.broken_starts import damages, files_of, seed, tried


@click.command()
@click.option("--places", default=10, show_default=True, help="Places in each file; a small file has as many as bytes.")
@click.option("--seed", "number", default=0, show_default=True, help="Draws the places and what is done there.")
@click.option("--file", "only", multiple=True, help="Only files whose name holds this; may be given several times.")
@click.option("--folder", type=click.Path(path_type=Path), help="Where the plants are made, such as /dev/shm.")
def main(places: int, number: int, only: tuple[str, ...], folder: Path | None) -> None:
    """Try them all; leaves with 1 if one start was not as it has to be."""
    wrong = 0
    with tempfile.TemporaryDirectory(dir=folder) as home:
        plant = Path(home) / "plant"
        seed(plant)
        click.echo(f"{'file':60} {'damages':>8} {'wrong':>6}")
        for file in files_of(plant):
            if only and not any(part in file for part in only):
                continue
            found, count = Counter[str](), 0
            for damage in damages(file, (plant / file).read_bytes(), places, random.Random(f"{number} {file}")):
                count += 1
                found.update(f"{damage}: {problem}" for problem in tried(plant, Path(home) / "trial", damage))
            click.echo(f"{file:60} {count:8} {len(found):6}")
            for sentence in list(found)[:5]:
                click.echo(f"    {sentence}")
            wrong += len(found)
    raise SystemExit(bool(wrong))


if __name__ == "__main__":
    main()

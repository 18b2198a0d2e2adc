"""Slips in a plant file and what is said of each: `python -m benchmarks.broken_plants`.

Every slip of `tests.rig.broken_plants` in a plant that is in order; prints the table, and what nobody noticed.
"""

import tempfile
from pathlib import Path

import click

from tests.rig.broken_plants import judge_plant, slips
from tests.rig.broken_starts import seed


@click.command()
def main() -> None:
    """Try them all; leaves with 1 if one slip was not noticed."""
    with tempfile.TemporaryDirectory() as home:
        plant = Path(home) / "plant" / "plant.toml"
        seed(plant.parent)
        whole = plant.read_text(encoding="utf-8")
        counts = {"refused": 0, "found": 0, "not noticed": 0}
        for slip in slips():
            plant.write_text(slip.text(whole), encoding="utf-8")
            said = judge_plant(plant)
            word = "refused" if said.refused else "found" if said.sentences else "not noticed"
            counts[word] += 1
            sentence = next(iter(said.sentences), "").replace(f"{plant.parent}/", "")
            click.echo(f"{word:12} {slip!s:60.60} {sentence[:160]}")
    click.echo(", ".join(f"{count} {word}" for word, count in counts.items()))
    raise SystemExit(bool(counts["not noticed"]))


if __name__ == "__main__":
    main()

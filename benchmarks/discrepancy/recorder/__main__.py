"""The benchmark of `decanter diagnose` on recorders as plants have them: make cases, score. Running is the others'.

\b
python -m benchmarks.discrepancy.recorder generate --set development --stratum all --count 3 --out DIR
python -m benchmarks.discrepancy run DIR --in-process --limit 120
python -m benchmarks.discrepancy.recorder score DIR --cases
"""

from pathlib import Path

import click

from benchmarks.discrepancy.recorder.cases import SETS, STRATA, make, read_verdicts, specs, write_verdicts
from benchmarks.discrepancy.recorder.figures import tables
from benchmarks.discrepancy.report import judge
from benchmarks.discrepancy.seal import commit, labelled, write_labels

FOLDER = click.Path(path_type=Path, file_okay=False)
BATCH = 8
"""Cases that are made, and sealed, at once."""


@click.group(help=__doc__)
def main() -> None:
    """The commands."""


@main.command()
@click.option("--set", "set_", type=click.Choice(list(SETS)), required=True, help="Which seeds.")
@click.option("--stratum", type=click.Choice([*STRATA, "all"]), required=True)
@click.option("--count", type=click.IntRange(1), default=3, show_default=True, help="Cases of each stratum.")
@click.option("--first", type=click.IntRange(0), default=0, show_default=True, help="The first one's number.")
@click.option("--out", type=FOLDER, required=True, help="Where the cases go; those that are there are not made again.")
def generate(set_: str, stratum: str, count: int, first: int, out: Path) -> None:
    """Write cases (traces, models, configurations), and their labels sealed, with the labels' hash."""
    chosen = STRATA if stratum == "all" else (stratum,)
    there = labelled(out)
    every = [spec for one in chosen for spec in specs(set_, one, range(first, first + count))]
    left = [spec for spec in every if spec.identifier not in there]
    for days in sorted({spec.days for spec in left}):  # cases of one length are integrated side by side
        same = [spec for spec in left if spec.days == days]
        for at in range(0, len(same), BATCH):
            part = same[at : at + BATCH]
            labels, verdicts = make(part, out)
            name = part[0].identifier
            write_verdicts(out, name, verdicts)
            write_labels(out, name, labels)
            click.echo(f"{len(part)} cases of {days} days", err=True)
    click.echo(f"{len(every)} cases in {out}; labels sealed under {commit(out)}")


@main.command()
@click.argument("folder", type=FOLDER)
@click.option("--name", default="decanter", show_default=True, help="The results that are scored.")
@click.option("--cases", is_flag=True, help="Every case in a line too.")
def score(folder: Path, name: str, cases: bool) -> None:
    """Open the labels, compare, and print the figures with what an ideal judge would have known."""
    try:
        click.echo(tables(judge(folder, name), read_verdicts(folder), every=cases))
    except ValueError as error:
        raise click.ClickException(str(error)) from None


if __name__ == "__main__":
    main()

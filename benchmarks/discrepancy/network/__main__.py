"""The benchmark of `decanter diagnose` on a thermal network: make cases, score. They are run as the other plant's are.

\b
python -m benchmarks.discrepancy.network generate --set fresh --stratum clean --count 20 --out DIR
python -m benchmarks.discrepancy run DIR
python -m benchmarks.discrepancy.network score DIR
"""

from pathlib import Path

import click

from benchmarks.discrepancy.network.cases import SETS, make, specs
from benchmarks.discrepancy.network.figures import tables
from benchmarks.discrepancy.report import judge
from benchmarks.discrepancy.seal import commit, write_labels

FOLDER = click.Path(path_type=Path, file_okay=False)


@click.group(help=__doc__)
def main() -> None:
    """The commands."""


@main.command()
@click.option("--set", "set_", type=click.Choice(list(SETS)), required=True, help="Which seeds.")
@click.option("--stratum", type=click.Choice(["clean", "singles", "outside", "pairs"]), required=True)
@click.option("--count", type=click.IntRange(1), default=21, show_default=True, help="Cases.")
@click.option("--first", type=click.IntRange(0), default=0, show_default=True, help="The first one's number.")
@click.option("--out", type=FOLDER, required=True, help="Where the cases go.")
def generate(set_: str, stratum: str, count: int, first: int, out: Path) -> None:
    """Write cases (traces, models, configurations), and their labels sealed, with the labels' hash."""
    wanted = specs(set_, stratum, range(first, first + count))
    for days in sorted({spec.days for spec in wanted}):  # cases of one length are integrated side by side
        part = [spec for spec in wanted if spec.days == days]
        write_labels(out, f"{set_}-{stratum}-{first}-{count}-{days}d", make(part, out))
    click.echo(f"{len(wanted)} cases in {out}; labels sealed under {commit(out)}")


@main.command()
@click.argument("folder", type=FOLDER)
@click.option("--name", default="decanter", show_default=True, help="The results that are scored.")
@click.option("--cases", is_flag=True, help="Every case in a line too.")
def score(folder: Path, name: str, cases: bool) -> None:
    """Open the labels, compare, and print the tables."""
    try:
        click.echo(tables(judge(folder, name), every=cases))
    except ValueError as error:
        raise click.ClickException(str(error)) from None


if __name__ == "__main__":
    main()

"""The benchmark of `decanter diagnose` on a thermal network: make cases, score. They are run as the other plant's are.

\b
python -m benchmarks.discrepancy.network measure --set final --out DIR    # everything, resumable
python -m benchmarks.discrepancy.network generate --set fresh --stratum clean --count 20 --out DIR
python -m benchmarks.discrepancy run DIR
python -m benchmarks.discrepancy.network score DIR
"""

from pathlib import Path

import click

from benchmarks.discrepancy.network.cases import SETS, make, specs
from benchmarks.discrepancy.network.figures import tables
from benchmarks.discrepancy.network.measure import drawn_order, judged, measure
from benchmarks.discrepancy.report import judge
from benchmarks.discrepancy.runner import by_call
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


@main.command("measure")
@click.option("--set", "set_", type=click.Choice(list(SETS)), required=True, help="Which seeds.")
@click.option("--out", type=FOLDER, required=True, help="Where cases and results go, and are found again.")
@click.option("--cases", "count", type=click.IntRange(1), help="Only so many, the first of the drawn order.")
@click.option("--seconds", type=click.FloatRange(0), default=float("inf"), help="Begin nothing new after so long.")
@click.option("--limit", type=click.FloatRange(1), default=900.0, show_default=True, help="Seconds a case at most.")
@click.option("--make-only", is_flag=True, help="Make the cases and diagnose none.")
@click.option("--lines", is_flag=True, help="Every case in a line too.")
def measure_command(
    set_: str, out: Path, count: int | None, seconds: float, limit: float, make_only: bool, lines: bool
) -> None:
    """Make and diagnose 300 cases in which something acts and 200 clean ones, in a drawn order; print the table.

    It goes on where it was stopped. The table is of the cases that have a result.
    """
    order = drawn_order(set_)[:count]
    out.mkdir(parents=True, exist_ok=True)
    measure(
        order,
        out,
        None if make_only else by_call,
        limit=limit,
        seconds=seconds,
        told=lambda words: click.echo(words, err=True),
    )
    if not make_only:
        click.echo(tables(judged(order, out), every=lines))


if __name__ == "__main__":
    main()

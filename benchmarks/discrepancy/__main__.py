"""The blind benchmark of `decanter diagnose`: make cases, run the tool and its rivals on them, score.

\b
python -m benchmarks.discrepancy generate --set development --strata clean,singles --count 17 --out DIR
python -m benchmarks.discrepancy run DIR --jobs 2
python -m benchmarks.discrepancy rivals DIR --jobs 2
python -m benchmarks.discrepancy score DIR
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import click

from benchmarks.discrepancy.strata import SETS, STRATA, chosen, specs

BATCH = 34
FOLDER = click.Path(path_type=Path, file_okay=False)


@click.group(help=__doc__)
def main() -> None:
    """The commands."""


@main.command()
@click.option("--set", "set_", type=click.Choice(list(SETS)), required=True, help="Which seeds.")
@click.option("--strata", default="all", show_default=True, help=f"Of {', '.join(['all', 'clean', *STRATA])}.")
@click.option("--count", type=click.IntRange(1), help="Cases of each stratum [as many as the full benchmark has].")
@click.option("--first", type=click.IntRange(0), default=0, show_default=True, help="The first one's number.")
@click.option("--out", type=FOLDER, required=True, help="Where the cases go.")
@click.option("--quick", is_flag=True, help="One case of each stratum: whether it works, not how well.")
@click.option("--jobs", type=click.IntRange(1), default=1, show_default=True, help="Processes.")
def generate(set_: str, strata: str, count: int | None, first: int, out: Path, quick: bool, jobs: int) -> None:
    """Write cases (traces, models, configurations), and their labels sealed, with the labels' hash."""
    from benchmarks.discrepancy.batches import generate_all

    with _sentences():
        wanted = specs(set_, chosen(strata), 1 if quick else count, first)
    digest = generate_all(wanted, out, jobs=jobs, size=BATCH, told=_told)
    click.echo(f"{len(wanted)} cases in {out}; labels sealed under {digest}")


@main.command()
@click.argument("folder", type=FOLDER)
@click.option("--name", default="decanter", show_default=True, help="Under which name the results are kept.")
@click.option("--command", help="What stands before `diagnose` [this interpreter's decanter].")
@click.option("--in-process", is_flag=True, help="Call the command inside the workers: faster, and not what is timed.")
@click.option("--only", multiple=True, help="Only this case; may be given again.")
@click.option("--again", is_flag=True, help="Run cases that failed or took too long once more.")
@click.option("--limit", type=click.FloatRange(1), default=300.0, show_default=True, help="Seconds a case at most.")
@click.option("--jobs", type=click.IntRange(1), default=1, show_default=True, help="Processes.")
def run(
    folder: Path, name: str, command: str | None, in_process: bool, only: tuple[str, ...], again: bool, limit: float,
    jobs: int,
) -> None:  # fmt: skip
    """Diagnose every case that has no result yet."""
    from benchmarks.discrepancy.runner import DECANTER, by_call, by_process, run_all

    diagnose = by_call if in_process else by_process(command or DECANTER)
    with _sentences():
        results = run_all(folder, name, diagnose, jobs=jobs, limit=limit, only=only, again=again, told=_told)
    click.echo(f"results in {results}")


@main.command()
@click.argument("folder", type=FOLDER)
@click.option("--method", "methods", multiple=True, help="Only this rival; may be given again.")
@click.option("--jobs", type=click.IntRange(1), default=1, show_default=True, help="Processes.")
def rivals(folder: Path, methods: tuple[str, ...], jobs: int) -> None:
    """Let the rivals diagnose every case that they have no result of."""
    from benchmarks.discrepancy.rivals import METHODS, Rival
    from benchmarks.discrepancy.runner import run_all

    strange = set(methods) - set(METHODS)
    if strange:
        raise click.ClickException(f"there is no rival {min(strange)!r}; there are {', '.join(METHODS)}")
    with _sentences():
        for method in methods or METHODS:
            run_all(folder, method, Rival(method), jobs=jobs, limit=300.0, told=_told)


@main.command()
@click.argument("folder", type=FOLDER)
@click.option("--jobs", type=click.IntRange(1), default=1, show_default=True, help="Processes.")
def tune(folder: Path, jobs: int) -> None:
    """Say which settings of the rivals do best on development cases (they are kept in rivals.py)."""
    from benchmarks.discrepancy.tuning import tune as best

    with _sentences():
        for one in best(folder, jobs):
            right = f"exact {one.exact} of {one.acting}, named {one.named} of {one.clean} clean"
            click.echo(f"{one.method}: {one.settings}, {right}")


@main.command()
@click.argument("folder", type=FOLDER)
@click.option("--name", default="decanter", show_default=True, help="The results that are scored first.")
@click.option("--out", type=FOLDER, help="Where table, figures and picture go [FOLDER/score].")
def score(folder: Path, name: str, out: Path | None) -> None:
    """Open the labels, compare, and write table.md, figures.json and picture.png."""
    from benchmarks.discrepancy.report import write_report

    with _sentences():
        words = write_report(folder, name, out or folder / "score")
    click.echo(words)


def _told(words: str) -> None:
    click.echo(words, err=True)


@contextmanager
def _sentences() -> Iterator[None]:
    try:
        yield
    except ValueError as error:
        raise click.ClickException(str(error)) from None


if __name__ == "__main__":
    main()

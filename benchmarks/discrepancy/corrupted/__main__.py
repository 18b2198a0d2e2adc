"""What random corruptions of five records change in their diagnoses: errors, refusals, verdicts and first names.

\b
python -m benchmarks.discrepancy.corrupted --dropped 150 --count 25 --out DIR --changed
"""

import json
from dataclasses import asdict
from itertools import chain
from pathlib import Path
from tempfile import TemporaryDirectory

import click

from benchmarks.discrepancy.corrupted.cases import DROPPED, RECORDS, CorruptedRecord, corruptions, write_model
from benchmarks.discrepancy.corrupted.figures import tables
from benchmarks.discrepancy.runner import Case, Outcome, by_call

LIMIT_S = 600.0
"""Seconds that one diagnosis may take on a busy machine."""


def diagnose(one: CorruptedRecord) -> Outcome:
    """What `decanter diagnose` says of it."""
    with TemporaryDirectory(prefix="decanter-corrupted-") as scratch:
        traces, model = Path(scratch) / "traces", Path(scratch) / "model.json"
        one.write(traces)
        write_model(model)
        return by_call(Case(one.name, traces, model, seed=0), LIMIT_S)


def _kept(one: CorruptedRecord, out: Path) -> tuple[CorruptedRecord, Outcome]:
    path = out / f"{one.name}.json"
    if path.exists():
        return one, Outcome(**json.loads(path.read_text(encoding="utf-8")))
    outcome = diagnose(one)
    draft = path.with_suffix(".draft")
    draft.write_text(json.dumps(asdict(outcome)) + "\n", encoding="utf-8")
    draft.replace(path)
    return one, outcome


@click.command(help=__doc__)
@click.option("--dropped", type=click.IntRange(0), default=150, show_default=True, help=f"Corruptions: {DROPPED}.")
@click.option("--count", type=click.IntRange(0), default=25, show_default=True, help="Corruptions of each other class.")
@click.option("--first", type=click.IntRange(0), default=0, show_default=True, help="The first corruption's number.")
@click.option("--jobs", type=click.IntRange(1), default=1, show_default=True, help="Processes.")
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), required=True, help="Where results are kept.")
@click.option("--changed", "every", is_flag=True, help="Each case that changed in a line too.")
def main(dropped: int, count: int, first: int, jobs: int, out: Path, every: bool) -> None:
    """Diagnose each record as it is and each corruption, and print what changed. What lies there is not done again."""
    from joblib import Parallel, delayed

    out.mkdir(parents=True, exist_ok=True)
    wanted = list(chain(map(CorruptedRecord, RECORDS), corruptions(count, dropped, first)))
    found: dict[CorruptedRecord, Outcome] = {}
    for one, outcome in Parallel(n_jobs=jobs, return_as="generator_unordered")(
        delayed(_kept)(one, out) for one in wanted
    ):
        found[one] = outcome
        if len(found) % 25 == 0:
            click.echo(f"{len(found)} of {len(wanted)}", err=True)
    click.echo(tables(found, every=every))


if __name__ == "__main__":
    main()

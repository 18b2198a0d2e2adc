"""CPU time of a verification: the decanter's product automaton, and one of 303 locations over 102 symbols (CNC).

Both have random relaxing locations, so that all is proven; the second figure of each is one with linear flows among
them, which is refuted with a word. The limit is what a gateway's start can afford: a second.

`--verdicts` prints instead what the gate says of learned, public and broken models (`benchmarks.verdicts`); that learns
some dozens of models and takes minutes.
"""

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from time import process_time

import click
import numpy as np
from rich.console import Console

from benchmarks import verdicts
from benchmarks.figures import Figure, give
from sim.lab.learning.structure import contexts, product_sha
from sim.proof.envelope import Assumptions
from sim.proof.verification import verify
from sim.sha.automaton import Distribution, Flow, Location
from sim.sha.events import DECANTER, Alphabet, Bins, Switch
from sim.sha.model import Model

AFFORDABLE = 1.0
"""Seconds."""
CNC = Alphabet(
    (
        Switch("Running", "start", "stop"),
        Bins("Speed", tuple(100.0 * (n + 1) for n in range(99)), tuple(f"m_{n}" for n in range(100))),
    )
)


def plant(alphabet: Alphabet, rng: np.random.Generator, linear: float) -> Model:
    """The product automaton of an alphabet; a share of `linear` of its known locations drifts without a target."""
    places = {name: _location(name, None in context, rng, linear) for name, context in contexts(alphabet).items()}
    return Model(product_sha(alphabet, places, "benchmark"), alphabet, "T", 0.1)


def _location(name: str, unknown: bool, rng: np.random.Generator, linear: float) -> Location:
    if unknown:
        return Location(name, Flow("constant", {"noise": 0.1}), None, "none")
    if rng.random() < linear:
        return Location(name, Flow("linear", {"noise": 0.1}), _normal(0.01, 0.01))
    flow = Flow("exponential", {"k": float(rng.uniform(1e-3, 1e-1)), "noise": 0.1})
    return Location(name, flow, _normal(float(rng.uniform(20, 90)), 3.0))


def _normal(mu: float, sigma: float) -> Distribution:
    return Distribution("normal", {"mu": mu, "sigma": sigma})


def measure(what: str, model: Model, assumptions: Assumptions, repeats: int) -> Figure:
    """The CPU time of one whole verification, the best of `repeats`, named by what came out."""
    times = []
    for _ in range(repeats):
        begin = process_time()
        found = verify(model, assumptions=assumptions)
        times.append(process_time() - begin)
    growth = found.check("growth").verdict
    size = f"{len(model.sha.locations)} locations, {len(model.sha.edges)} edges"
    return Figure(f"{what}, {size}: growth {growth}", min(times), "s", "a second", AFFORDABLE)


@click.command(help=__doc__)
@click.option("--json", "as_json", is_flag=True, help="One JSON object instead of a table.")
@click.option("--quick", is_flag=True, help="Once each.")
@click.option("--repeats", default=3, show_default=True, type=click.IntRange(1), help="Repetitions; the best counts.")
@click.option("--seed", default=1, show_default=True, help="Seed of the automata.")
@click.option("--verdicts", "judge", is_flag=True, help="The table of verdicts instead of the times.")
@click.option(
    "--data",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path(__file__).parents[2] / "shared" / "data",
    help="Where the real traces and the public automata lie, for --verdicts.",
)
@click.option("--words", default=2000, show_default=True, type=click.IntRange(0), help="Random words a model.")
@click.option("--part", "parts", multiple=True, type=click.Choice(list(verdicts.PARTS)), help="Only this part of it.")
def main(
    as_json: bool, quick: bool, repeats: int, seed: int, judge: bool, data: Path, words: int, parts: Sequence[str]
) -> None:
    if judge:
        _judge(parts, data, words, as_json=as_json)
        return
    figures = []
    for name, alphabet in (("decanter", DECANTER), ("CNC", CNC)):
        for linear in (0.0, 0.3):
            model = plant(alphabet, np.random.default_rng(seed), linear)
            for assumed in (Assumptions(), Assumptions(sojourn=(5.0, 600.0))):
                stays = "stays of 5 to 600 s" if assumed.sojourn != "any" else "any stay"
                figures.append(measure(f"{name}, {stays}", model, assumed, 1 if quick else repeats))
    give("verification", figures, as_json=as_json)


def _judge(parts: Sequence[str], data: Path, words: int, *, as_json: bool) -> None:
    """Print the table of verdicts; each row is also said on standard error as soon as it is there."""
    rows = []
    for part in parts or verdicts.PARTS:
        for row in verdicts.PARTS[part](data, words):
            rows.append(row)
            click.echo(json.dumps(asdict(row)), err=True)
    if as_json:
        click.echo(json.dumps({"benchmark": "verdicts", "rows": [asdict(one) for one in rows]}))
    else:
        Console(width=200).print(verdicts.as_table(rows))


if __name__ == "__main__":
    main()

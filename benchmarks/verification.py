"""Time of a verification: the decanter's product automaton, and one of 303 locations over 102 symbols (CNC).

Both have random relaxing locations, so that all is proven; the second figure of each is one with linear flows among
them, which is refuted with a word. The limit is what a gateway's start can afford: a second.
"""

import click
import numpy as np

from benchmarks.figures import Figure, best, give
from sim.checking.envelope import Assumptions
from sim.checking.verify import Verification, verify
from sim.learning.structure import contexts, product_sha
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
    """The time of one whole verification, named by what came out."""
    found: list[Verification] = []
    seconds = best(lambda: found.append(verify(model, assumptions=assumptions)), repeats)
    growth = found[0].check("growth").verdict
    size = f"{len(model.sha.locations)} locations, {len(model.sha.edges)} edges"
    return Figure(f"{what}, {size}: growth {growth}", seconds, "s", "a second", AFFORDABLE)


@click.command(help=__doc__)
@click.option("--json", "as_json", is_flag=True, help="One JSON object instead of a table.")
@click.option("--quick", is_flag=True, help="Once each.")
@click.option("--repeats", default=3, show_default=True, type=click.IntRange(1), help="Repetitions; the best counts.")
@click.option("--seed", default=1, show_default=True, help="Seed of the automata.")
def main(as_json: bool, quick: bool, repeats: int, seed: int) -> None:
    figures = []
    for name, alphabet in (("decanter", DECANTER), ("CNC", CNC)):
        for linear in (0.0, 0.3):
            model = plant(alphabet, np.random.default_rng(seed), linear)
            for assumed in (Assumptions(), Assumptions(sojourn=(5.0, 600.0))):
                stays = "stays of 5 to 600 s" if assumed.sojourn != "any" else "any stay"
                figures.append(measure(f"{name}, {stays}", model, assumed, 1 if quick else repeats))
    give("verification", figures, as_json=as_json)


if __name__ == "__main__":
    main()

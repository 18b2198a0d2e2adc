"""Queries: what the statistical rules cost and keep, and how fast a query is read, decided and its runs are judged.

Coverage and mean runs of the two sequential intervals are exact sums over all paths of successes, no simulation. The
runs are coin tosses: what is measured is the rule, not the model.
"""

from collections import deque
from collections.abc import Callable
from functools import partial

import click
import numpy as np
from numpy.typing import NDArray

from benchmarks.figures import Figure, best, give
from sim.lab.checking.language.parse import parse_query
from sim.lab.checking.query.symbolic import decide
from sim.lab.checking.query.tree import Symbolic
from sim.lab.checking.smc.rules.estimation import Draw, mixture_interval, to_half_width, uppaal_interval
from sim.lab.checking.smc.rules.paired import compare
from sim.lab.checking.smc.rules.sprt import acceptance, expected_runs, sprt, wald_test
from sim.sha.automaton import SHA, Edge, Flow, Location
from sim.sha.trace import Array

Interval = Callable[[Array, NDArray[np.int_], float], tuple[Array, Array]]
LEVEL, EPSILON = 0.95, 0.05
RULES: dict[str, Interval] = {"sequential Clopper-Pearson": uppaal_interval, "anytime-valid": mixture_interval}
ASKED = "Pr[<=444](<> Temp >= 80 && (q_1 || q_2 || !q_3)) >= 0.9"
PLACES, EDGES = 300, 30_000


def exact(interval: Interval, p: float) -> tuple[float, float]:
    """How often the interval at the stop holds p, and the mean number of runs until it is narrow: over all paths."""
    mass, covered, runs, n = np.array([1.0]), 0.0, 0.0, 0
    while mass.sum() > 1e-12:
        n += 1
        mass = np.append(mass * (1.0 - p), 0.0) + np.append(0.0, mass * p)
        low, high = interval(np.arange(n + 1.0), np.full(n + 1, n), LEVEL)
        stop = high - low <= 2.0 * EPSILON
        covered += float(mass[stop & (low <= p) & (p <= high)].sum())
        runs += n * float(mass[stop].sum())
        mass = np.where(stop, 0.0, mass)
    return covered, runs


def coverage(quick: bool) -> list[Figure]:
    """Each rule at three probabilities; quick: at the one where UPPAAL's is known to fall short."""
    found = []
    for name, interval in RULES.items():
        for p in (0.1,) if quick else (0.01, 0.1, 0.5):
            covered, runs = exact(interval, p)
            found.append(Figure(f"{name}: coverage at p = {p}", covered, "", "its level", LEVEL))
            found.append(Figure(f"{name}: mean runs at p = {p}", runs, "runs"))
    return found


def coin(p: float, rng: np.random.Generator) -> Draw:
    """Runs that succeed with probability p."""
    return lambda n: (rng.random(n) < p).astype(float)


def ratio_test(tests: int, rng: np.random.Generator) -> list[Figure]:
    """Wald's test of >= 0.9 with delta 0.02, at both ends of the region of indifference."""
    test, found = wald_test(">=", 0.9, 0.02), []
    for name, p in (("accept", test.accept), ("reject", test.reject)):
        ends = [sprt(coin(p, rng), test, batch=500) for _ in range(tests)]
        holds = float(np.mean([bool(end.holds) for end in ends]))
        runs = float(np.mean([end.estimate.runs for end in ends]))
        found.append(Figure(f"SPRT says it holds, p at {name}", holds, "", "Wald's approximation", acceptance(test, p)))
        found.append(
            Figure(f"SPRT, mean runs, p at {name}", runs, "runs", "Wald's approximation", expected_runs(test, p))
        )
    return found


def judged(rng: np.random.Generator, repeats: int) -> list[Figure]:
    """Runs a second that the sequential rule looks at, against those that are only drawn and added up."""
    outcomes = (rng.random(300_000) < 0.3).astype(float)

    def draw(n: int) -> Array:
        return outcomes[:n]

    runs = to_half_width(draw, 0.002, LEVEL, batch=10_000).estimate.runs
    sequential = runs / best(lambda: to_half_width(draw, 0.002, LEVEL, batch=10_000), repeats)
    summed = runs / best(lambda: [draw(10_000).sum() for _ in range(0, runs, 10_000)], repeats)
    return [Figure("runs judged by the sequential rule", sequential, "runs/s", "only added up", summed)]


def paired(rng: np.random.Generator) -> list[Figure]:
    """Pairs until 0.52 is known to exceed 0.5, with common random numbers and without."""

    def pairs(common: bool) -> float:
        def draw(n: int) -> tuple[Array, Array]:
            u = rng.random(n)
            return (u < 0.52).astype(float), ((u if common else rng.random(n)) < 0.5).astype(float)

        return float(np.mean([compare(draw, 0.001).left.runs for _ in range(20)]))

    return [Figure("pairs to tell 0.52 from 0.5, common numbers", pairs(True), "pairs", "independent", pairs(False))]


def structure(rng: np.random.Generator) -> SHA:
    """Random edges over many locations."""
    ends = rng.integers(0, PLACES, (EDGES, 2))
    places = tuple(Location(f"q_{place}", Flow("constant"), None, "none") for place in range(PLACES))
    edges = tuple(Edge(f"q_{a}", f"s_{number}", f"q_{b}") for number, (a, b) in enumerate(ends))
    return SHA("random", places, edges, "q_0")


def breadth_first(sha: SHA) -> int:
    """How many locations can be reached: the least that any exhaustive answer must do."""
    following: dict[str, set[str]] = {}
    for edge in sha.edges:
        following.setdefault(edge.source, set()).add(edge.target)
    reached, waiting = {sha.initial}, deque([sha.initial])
    while waiting:
        new = following.get(waiting.popleft(), set()) - reached
        reached |= new
        waiting.extend(new)
    return len(reached)


def deciding(rng: np.random.Generator, repeats: int) -> list[Figure]:
    """Reading a query, and deciding three symbolic ones over the random structure."""
    sha = structure(rng)
    least = 1e3 * best(lambda: breadth_first(sha), repeats)
    read = 1e3 * best(lambda: parse_query(ASKED, sha), repeats)
    found = [Figure(f"reading a query, {PLACES} locations", read, "ms")]
    for text in ("A[] !deadlock", "A<> q_299", "q_7 --> q_200"):
        query = parse_query(text, sha)
        if isinstance(query, Symbolic):
            took = 1e3 * best(partial(decide, query, sha), repeats)
            found.append(Figure(f"{text}, {EDGES} edges", took, "ms", "reaching all locations", least))
    return found


@click.command(help=__doc__)
@click.option("--json", "as_json", is_flag=True, help="One JSON object instead of a table.")
@click.option("--quick", is_flag=True, help="Fewer tests and repetitions.")
@click.option("--seed", default=1, show_default=True, help="Seed of the coins and the edges.")
def main(as_json: bool, quick: bool, seed: int) -> None:
    rng, repeats = np.random.default_rng(seed), 2 if quick else 5
    found = [*coverage(quick), *ratio_test(100 if quick else 2000, rng), *paired(rng), *judged(rng, repeats)]
    give("queries", [*found, *deciding(rng, repeats)], as_json=as_json)


if __name__ == "__main__":
    main()

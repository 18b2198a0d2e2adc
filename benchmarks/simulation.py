"""Simulation speed for 47 events in 444 s: runs per second at the events alone, and on all 401 rows besides.

Three yardsticks: the figures of the method's reference (numpy, same class of machine), the speed limit measured in the
same process (drawing as many standard normals as the runs need, with the same generator, and doing nothing with them),
and the deterministic mean and variance of the same schedule.
"""

import click
import numpy as np

from benchmarks.figures import Figure, best, give
from sim.engine.moment_equations import moments
from sim.engine.schedules import Schedule, schedule
from sim.engine.simulation import CHUNK_RUNS, simulate
from sim.sha.automaton import SHA, Distribution, Edge, Flow, Location
from sim.sha.trace import Event

EVENTS, SECONDS, ROWS = 47, 444.0, 401
SYMBOLS = ("W_ON", "W_OFF", "A_0", "A_1", "A_2", "A_3")
REFERENCE = {"events": 1.0e6, "dense": 1.9e5}
"""Runs per second of the reference implementation in numpy, one thread."""


def plant() -> SHA:
    """One location a symbol, each with a target temperature of its own that the stay draws."""
    locations = tuple(
        Location(
            symbol,
            Flow("exponential", {"k": 0.004, "noise": 0.05}),
            Distribution("normal", {"mu": 20.0 + 5.0 * place, "sigma": 1.0}),
        )
        for place, symbol in enumerate(SYMBOLS)
    )
    edges = tuple(Edge(source, symbol, symbol) for source in SYMBOLS for symbol in SYMBOLS)
    return SHA("benchmark", locations, edges, SYMBOLS[1])


def cases(rng: np.random.Generator) -> dict[str, Schedule]:
    """The two schedules: events lie on rows, as an encoder puts them, and the run ends at the last event or row."""
    clock = np.linspace(0.0, SECONDS, ROWS)
    rows = np.sort(rng.choice(np.arange(1, ROWS), EVENTS, replace=False))
    events = [Event(float(clock[row]), SYMBOLS[rng.integers(len(SYMBOLS))]) for row in rows]
    at_events = [event.time for event in events]
    return {
        "events": schedule(plant(), events, at_events, start=0.0),
        "dense": schedule(plant(), events, clock, start=0.0),
    }


def measure(name: str, steps: Schedule, runs: int, repeats: int, rng: np.random.Generator) -> list[Figure]:
    """The speeds of one schedule; `fresh`: each call allocates the memory of its result instead of being given it."""
    moving = steps.dt > 0
    stays = np.bincount(steps.stay, weights=moving)
    normals = int(moving.sum() + np.count_nonzero(stays > 1))  # one a step, and one a stay that has several steps
    out, row = np.zeros((steps.times.size, runs)), np.empty(CHUNK_RUNS)
    speed = runs / best(lambda: simulate(steps, 18.2, runs, rng, out=out), repeats)
    fresh = runs / best(lambda: simulate(steps, 18.2, runs, rng), repeats)
    limit = CHUNK_RUNS / best(lambda: [rng.standard_normal(out=row) for _ in range(normals)], repeats)
    closed = 1e3 * best(lambda: moments(steps, 18.2), repeats)
    what = f"simulation, {steps.times.size} outputs"
    return [
        Figure(what, speed, "runs/s", "reference in numpy, measured elsewhere", REFERENCE[name]),
        Figure(what, speed, "runs/s", f"drawing its {normals} normals a run", limit),
        Figure(f"{what}, fresh memory", fresh, "runs/s", "into a given array", speed),
        Figure(f"mean and variance, {steps.times.size} outputs", closed, "ms"),
    ]


@click.command(help=__doc__)
@click.option("--json", "as_json", is_flag=True, help="One JSON object instead of a table.")
@click.option("--quick", is_flag=True, help="A quarter of the runs, twice.")
@click.option("--repeats", default=7, show_default=True, type=click.IntRange(1), help="Repetitions; the best counts.")
@click.option("--seed", default=1, show_default=True, help="Seed of the events and the runs.")
def main(as_json: bool, quick: bool, repeats: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    runs = {"events": (5 if quick else 20) * CHUNK_RUNS, "dense": (1 if quick else 4) * CHUNK_RUNS}
    found = [measure(name, steps, runs[name], 2 if quick else repeats, rng) for name, steps in cases(rng).items()]
    give("simulation, 47 events in 444 s", [figure for some in found for figure in some], as_json=as_json)


if __name__ == "__main__":
    main()

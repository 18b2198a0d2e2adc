"""Simulation speed for 47 events in 444 s: runs per second at the events alone, and on all 401 rows besides.

Three yardsticks: the figures of the method's reference (numpy, same class of machine), the speed limit measured in the
same process (drawing as many standard normals as the runs need, with the same generator, and doing nothing with them),
and the deterministic mean and variance of the same schedule. `python -m benchmarks.simulation [--json]`.
"""

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from time import perf_counter

import click
import numpy as np

from sim.sha.automaton import SHA, Distribution, Edge, Flow, Location
from sim.sha.moments import moments
from sim.sha.schedule import Schedule, schedule
from sim.sha.simulate import CHUNK, simulate
from sim.sha.trace import Event

EVENTS, SECONDS, ROWS = 47, 444.0, 401
SYMBOLS = ("W_ON", "W_OFF", "A_0", "A_1", "A_2", "A_3")
REFERENCE = {"events": 1.0e6, "dense": 1.9e5}
"""Runs per second of the reference implementation in numpy, one thread."""


@dataclass(frozen=True)
class Speed:
    """Runs per second, best of the repetitions; `limit` is that of drawing the needed normals alone.

    `fresh` is the speed when each call allocates the memory of its result, the others write into one given array.
    """

    outputs: int
    steps: int
    normals: int
    runs: int
    runs_per_s: float
    fresh: float
    reference: float
    limit: float
    of_reference: float
    of_limit: float
    moments_ms: float


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


def best(work: Callable[[], object], repeat: int) -> float:
    """Seconds of the fastest of `repeat` calls: the other ones were disturbed."""
    times = []
    for _ in range(repeat):
        begin = perf_counter()
        work()
        times.append(perf_counter() - begin)
    return min(times)


def measure(name: str, steps: Schedule, runs: int, repeat: int, rng: np.random.Generator) -> Speed:
    """The speeds of one schedule."""
    moving = steps.dt > 0
    stays = np.bincount(steps.stay, weights=moving)
    normals = int(moving.sum() + np.count_nonzero(stays > 1))  # one a step, and one a stay that has several steps
    out, row = np.zeros((steps.times.size, runs)), np.empty(CHUNK)
    seconds = best(lambda: simulate(steps, 18.2, runs, rng, out=out), repeat)
    fresh = best(lambda: simulate(steps, 18.2, runs, rng), repeat)
    drawing = best(lambda: [rng.standard_normal(out=row) for _ in range(normals)], repeat) / CHUNK
    closed = best(lambda: moments(steps, 18.2), repeat)
    return Speed(
        outputs=steps.times.size,
        steps=steps.dt.size,
        normals=normals,
        runs=runs,
        runs_per_s=runs / seconds,
        fresh=runs / fresh,
        reference=REFERENCE[name],
        limit=1.0 / drawing,
        of_reference=runs / seconds / REFERENCE[name],
        of_limit=runs / seconds * drawing,
        moments_ms=1e3 * closed,
    )


@click.command(help=__doc__)
@click.option("--json", "as_json", is_flag=True, help="One JSON object instead of a table.")
@click.option("--repeat", default=7, show_default=True, type=click.IntRange(1), help="Repetitions; the best counts.")
@click.option("--seed", default=1, show_default=True, help="Seed of the events and the runs.")
def main(as_json: bool, repeat: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    runs = {"events": 20 * CHUNK, "dense": 4 * CHUNK}
    found = {name: measure(name, steps, runs[name], repeat, rng) for name, steps in cases(rng).items()}
    if as_json:
        click.echo(json.dumps({name: asdict(speed) for name, speed in found.items()}))
        return
    for name, speed in found.items():
        click.echo(
            f"{name:6}  {speed.outputs} outputs, {speed.steps} steps, {speed.normals} normals a run\n"
            f"        {speed.runs_per_s:12,.0f} runs/s into a given array ({speed.fresh:,.0f} into fresh memory)\n"
            f"        {speed.of_reference:12.2f} of the reference's {speed.reference:,.0f} runs/s\n"
            f"        {speed.of_limit:12.2f} of the limit, {speed.limit:,.0f} runs/s for the normals alone\n"
            f"        {speed.moments_ms:12.3f} ms for mean and variance in closed form"
        )


if __name__ == "__main__":
    main()

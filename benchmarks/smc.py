"""Statistical checking: agreement with quadrature on first passage, and runs per second against scalar C.

The table of parameter sets (`--table --seeds 5`) is the proof of agreement: for each, the probability by quadrature
(`tests.rig.quadrature`), the answer's interval, and how often the one lies in the other. The speeds are those of
47 events in 444 s, looked at when the run ends, and on 400 bridged steps; and of one relaxing location that is never
left (an Ornstein-Uhlenbeck first passage in 5 s steps), once with known and once with unknown events, of which there
are none. The C program (`smc.c`) walks the same steps and is compiled here; without a compiler the method's own figures
stand in its place, and the row says so. Ours draws normals by numpy's generator: what one for each step would take,
without anything else, is a figure of its own.
"""

import os
import shutil
import subprocess
import tempfile
import tracemalloc
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from time import perf_counter, process_time

import click
import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.figures import Figure, give
from benchmarks.simulation import EVENTS, ROWS, SECONDS, SYMBOLS, plant
from sim.lab.checking.query.tree import Compare, Eventually, Number, Probability, Quantity, TimeSpan
from sim.lab.checking.smc.answers import Answer, QuerySettings, Start, answer, prepare_question
from sim.lab.checking.smc.chunks import LARGEST
from sim.lab.checking.smc.monitors import PreparedPath
from sim.lab.checking.smc.paths.known_events import Known
from sim.lab.checking.smc.runs import Sampler, sampler
from sim.lab.checking.smc.start import initial
from sim.lab.workers import threads
from sim.sha.automaton import SHA, Distribution, Edge, Flow, Location
from sim.sha.events import Alphabet
from sim.sha.model import Model
from sim.sha.trace import Event, Trace
from tests.rig.quadrature import Stretch, first_passage

REFERENCE = {"events": 2.25e6, "dense": 3.2e5}
"""Runs per second of the reference in scalar C, one thread, measured elsewhere."""

RARE = 1e-3
"""Below this the table takes importance splitting."""


@dataclass(frozen=True, slots=True)
class Case:
    """A start temperature, the stays to come (with events between them), and the limit to be reached."""

    name: str
    x0: float
    stretches: tuple[Stretch, ...]
    limit: float


def _flow(kind: str, **constants: float) -> Flow:
    return Flow(kind, {"noise": 0.1, **constants})


def parameter_sets() -> list[Case]:
    """All kinds of flow, one stay to three, with and without drawn mode parameters, from 0.9 to below 1e-6."""
    slow, own, quick = (_flow("exponential", k=k) for k in (0.003, 0.01, 0.2))
    hot = Stretch(Flow("exponential", {"k": 0.02, "noise": 0.15}), 43.0, 344.0, 0.5)
    ageing = Stretch(_flow("logarithmic", t0=30.0), 0.8, 144.0)
    table: list[tuple[str, tuple[Stretch, ...], tuple[float, ...]]] = [
        ("drift", (Stretch(_flow("linear"), 0.005, 444.0),), (41.0, 44.0, 46.0, 50.0, 52.0)),
        ("drift downwards", (Stretch(_flow("linear"), -0.004, 444.0),), (41.0, 44.0, 47.5)),
        ("drift, m drawn", (Stretch(_flow("linear"), 0.004, 444.0, 0.004),), (44.0, 49.0, 54.0)),
        ("no drift", (Stretch(_flow("constant"), 0.0, 444.0),), (42.0, 46.0, 49.0)),
        ("relaxing", (Stretch(own, 42.0, 444.0),), (42.5, 44.0, 45.0, 45.5, 46.0)),
        ("relaxing, m drawn", (Stretch(own, 42.0, 444.0, 1.0),), (44.0, 45.0, 46.0, 47.0, 48.0)),
        ("relaxing slowly", (Stretch(slow, 44.0, 444.0),), (43.0, 46.0, 49.0)),
        ("relaxing fast", (Stretch(quick, 40.5, 444.0),), (41.0, 41.5)),
        ("logarithmic", (Stretch(_flow("logarithmic", t0=20.0), 1.0, 444.0, 0.2),), (44.0, 47.0, 50.0, 54.0)),
        ("two stays, m drawn", (Stretch(own, 42.0, 100.0, 1.0), hot), (45.0, 46.0, 47.5)),
        (
            "three stays",
            (Stretch(_flow("linear"), 0.01, 100.0), ageing, Stretch(own, 43.0, 200.0, 0.4)),
            (43.0, 45.0, 47.0, 50.0),
        ),
    ]
    return [Case(name, 40.0, stretches, limit) for name, stretches, limits in table for limit in limits]


def start_of(case: Case) -> Start:
    """The case as a model along a trace with one event between two stays."""
    names = [f"q_{index}" for index in range(len(case.stretches))]
    laws = [Distribution("normal", {"mu": one.mean, "sigma": one.sigma}) for one in case.stretches]
    locations = tuple(Location(name, one.flow, law) for name, one, law in zip(names, case.stretches, laws, strict=True))
    edges = tuple(Edge(a, "next", b) for a, b in pairwise(names))
    sha = SHA("passage", locations, edges, names[0], low=-1e6, high=1e6)
    ends = np.cumsum([one.seconds for one in case.stretches])
    events = tuple(Event(float(end), "next") for end in ends[:-1])
    trace = Trace("passage", np.array([0.0, ends[-1]]), {"T": np.full(2, case.x0)}, events)
    return initial(Model(sha, Alphabet(()), "T", 0.0), trace)


def question(limit: float, bound: float, low: float = 0.0) -> Probability:
    """Is the limit reached between `low` and the bound?"""
    reached = Compare(">=", Quantity("temperature"), Number(limit))
    return Probability(bound, Eventually(reached, TimeSpan(low, bound)))


def checked(
    case: Case, seeds: Sequence[int], runs: int, *, points: int | None = None, nodes: int | None = None
) -> tuple[float, list[Answer]]:
    """(the probability by quadrature, the answer of each seed) of a case; a rare one is split."""
    exact = first_passage(case.stretches, case.x0, case.limit, points=points, nodes=nodes)
    asked, start = question(case.limit, sum(one.seconds for one in case.stretches)), start_of(case)
    settings = QuerySettings(rule="fixed", runs=None if exact < RARE else runs, rare=exact < RARE)
    return exact, [answer(asked, start, replace(settings, seed=seed)) for seed in seeds]


def agreement(
    seeds: Sequence[int], runs: int, quick: bool, rare: bool = False
) -> Iterator[tuple[Case, float, list[Answer]]]:
    """Every case (four with `quick`, the last of each name with `rare`), the quadrature and the answers."""
    cases = parameter_sets()[:: 11 if quick else 1]
    for number, case in enumerate(list({case.name: case for case in cases}.values()) if rare else cases):
        own = [seed + 1000 * number for seed in seeds]  # no two sets share their runs: their misses are independent
        exact, found = checked(case, own, runs)
        yield case, exact, found


def contains(exact: float, found: Answer) -> bool:
    """Whether the answer's interval holds the exact value."""
    return found.numbers["low"] <= exact <= found.numbers["high"]


# ---------------------------------------------------------------- speed


def speed_start(k: float) -> Start:
    """The benchmark plant with flows of this relaxation (1/s), along 47 events in 444 s."""
    sha = plant()
    flow = Flow("exponential", {"k": k, "noise": 0.05})
    sha = replace(sha, locations=tuple(replace(location, flow=flow) for location in sha.locations))
    rng = np.random.default_rng(1)
    clock = np.linspace(0.0, SECONDS, ROWS)
    rows = np.sort(rng.choice(np.arange(1, ROWS), EVENTS, replace=False))
    events = tuple(Event(float(clock[row]), SYMBOLS[rng.integers(len(SYMBOLS))]) for row in rows)
    trace = Trace("benchmark", np.array([0.0, SECONDS]), {"T": np.full(2, 18.2)}, events)
    return initial(Model(sha, Alphabet(()), "T", 0.0), trace)


def speeds(runs: int, repeats: int) -> list[Figure]:
    """Runs per second at the events alone, and with 400 bridged steps; the limits leave most runs undecided."""
    figures = []
    with tempfile.TemporaryDirectory(prefix="decanter-smc-") as folder:
        program = compiled(Path(folder))
        for name, k, low, limit in (("events", 0.004, SECONDS, 32.0), ("dense", 0.045, 0.0, 45.0)):
            start = speed_start(k)
            one = prepare_question(question(limit, SECONDS, low), start)
            drawn = sampler(start.world, (one,), 1)
            drawn.draw(2 * LARGEST)  # past the small chunks
            own = runs / min(processor_time(partial(drawn.draw, runs)) for _ in range(repeats))
            steps, share = _moving(drawn), drawn.draw(runs).mean()
            figures.append(Figure(f"{name}: {steps} steps a run", own, "runs/s", "scalar C, stated", REFERENCE[name]))
            if program is not None:
                speed, hits = scalar(program, drawn, limit, watched=low == 0.0, x0=18.2, runs=runs)
                figures.append(Figure(f"{name}: {steps} steps a run", own, "runs/s", "scalar C, measured now", speed))
                figures.append(Figure(f"{name}: share of successes", float(share), "", "scalar C", hits))
        figures += passage_speeds(program, runs, repeats)
    return [*figures, shared(start, one, runs)]


def shared(start: Start, path: PreparedPath, runs: int) -> Figure:
    """How many times sooner a thread on each core has these runs than one alone, by the wall clock."""
    cores, walls = len(os.sched_getaffinity(0)), []
    for count in (1, cores):
        with threads(count) as helpers:
            begin = perf_counter()
            sampler(start.world, (path,), 1, helpers, runs).draw(runs)
            walls.append(perf_counter() - begin)
    return Figure("dense: time of one thread, of that of all cores", walls[0] / walls[1], "", "cores", cores)


def relaxing_start(known: bool) -> Start:
    """One location that relaxes within 100 s and starts at its target, 60 degC; a trace without events if `known`."""
    law, flow = Distribution("normal", {"mu": 60.0, "sigma": 0.0}), Flow("exponential", {"k": 0.01, "noise": 0.1})
    model = Model(SHA("relaxing", (Location("q_0", flow, law),), (), "q_0"), Alphabet(()), "T", 0.0, initial=law)
    return initial(model, Trace("rest", np.array([0.0, 1800.0]), {"T": np.full(2, 60.0)}) if known else None)


def passage_speeds(program: Path | None, runs: int, repeats: int) -> list[Figure]:
    """Runs per second of a first passage (62 degC within 1800 s), by both engines, and of the normals that it takes."""
    asked, samplers = question(62.0, 1800.0), {}
    for name, known in (("known events", True), ("unknown events", False)):
        start = relaxing_start(known)
        samplers[name] = sampler(start.world, (prepare_question(asked, start),), 1)
        samplers[name].draw(2 * LARGEST)  # past the small chunks
    steps, rng = _moving(samplers["known events"]), np.random.Generator(np.random.SFC64(1))
    block = np.empty(LARGEST)
    normals = min(processor_time(partial(rng.standard_normal, out=block)) for _ in range(50 * repeats))
    figures = [Figure("relaxing: a normal for each step alone", LARGEST / (normals * steps), "runs/s")]
    for name, drawn in samplers.items():
        speed, hits = np.inf, np.nan
        if program is not None:
            speed, hits = scalar(program, samplers["known events"], 62.0, watched=True, x0=60.0, runs=runs)
        own = runs / min(processor_time(partial(drawn.draw, runs)) for _ in range(repeats))
        share = float(drawn.draw(runs).mean())
        if program is None:
            figures.append(Figure(f"relaxing, {name}: {steps} steps a run", own, "runs/s"))
        else:
            figures.append(
                Figure(f"relaxing, {name}: {steps} steps a run", own, "runs/s", "scalar C, measured now", speed)
            )
            figures.append(Figure(f"relaxing, {name}: share of successes", share, "", "scalar C", hits))
    return figures


def memory(runs: int) -> Figure:
    """Megabytes at the most while `runs` runs are made on all cores, against those of a tenth of them."""
    start, sizes = speed_start(0.004), []
    for some in (runs // 10, runs):
        tracemalloc.start()
        with threads(len(os.sched_getaffinity(0))) as helpers:
            answer(question(32.0, SECONDS, SECONDS), start, QuerySettings(rule="fixed", runs=some), threads=helpers)
        sizes.append(tracemalloc.get_traced_memory()[1] / 1e6)
        tracemalloc.stop()
    return Figure(f"events: memory of {runs:,} runs", sizes[1], "MB", f"of {runs // 10:,}", sizes[0])


def processor_time(work: Callable[[], object]) -> float:
    """Seconds of processor time of one call: what the C program counts too, so that a busy machine favours neither."""
    begin = process_time()
    work()
    return process_time() - begin


def compiled(folder: Path) -> Path | None:
    """The C program, or None where there is no compiler."""
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        return None
    program, source = folder / "smc", Path(__file__).with_suffix(".c")
    subprocess.run([compiler, "-O3", "-march=native", "-o", str(program), str(source), "-lm"], check=True)
    return program


def _moving(drawn: Sampler) -> int:
    assert isinstance(drawn.engine, Known)
    return sum(row.dt > 0 for row in drawn.engine.rows)


def scalar(program: Path, drawn: Sampler, limit: float, *, watched: bool, x0: float, runs: int) -> tuple[float, float]:
    """(runs per second, share of successes) of the C program along the same steps."""
    assert isinstance(drawn.engine, Known)
    rows = [row for row in drawn.engine.rows if row.dt > 0]
    lines = [f"{runs} 1 {x0!r} {limit!r} {len(rows)} {0 if watched else len(rows)}"]
    sha, begun = drawn.engine.world.sha, False
    for row in rows:
        law = sha.locations[row.location].distribution
        assert law is not None
        enters = row.own and (row.drawn is not None or not begun)
        begun = begun or row.own
        numbers = (row.decay, row.pull if row.own else 0.0, row.shift, row.sigma, row.bridge, float(enters))
        lines.append(" ".join(repr(float(number)) for number in (*numbers, law.params["mu"], law.params["sigma"])))
    done = subprocess.run([str(program)], input="\n".join(lines), check=True, capture_output=True, text=True)
    hits, seconds = done.stdout.split()
    return runs / float(seconds), float(hits) / runs


def show_agreement(rows: Sequence[tuple[Case, float, list[Answer]]]) -> None:
    """Print the table: of each set the first seed's answer, and the share of seeds whose interval holds the truth."""
    table = Table(title="first passage: quadrature against statistical checking", title_justify="left", pad_edge=False)
    for name in ("flow", "limit", "quadrature", "answer", "95 % interval", "inside", "mean ratio", "rule"):
        table.add_column(name)
    for case, exact, found in rows:
        low, high, p = (found[0].numbers[name] for name in ("low", "high", "probability"))
        inside = f"{sum(contains(exact, one) for one in found)} of {len(found)}"
        ratio = f"{np.mean([one.numbers['probability'] for one in found]) / exact:.3f}"
        cells = (f"{case.limit:g}", f"{exact:.4g}", f"{p:.4g}", f"[{low:.4g}, {high:.4g}]", inside, ratio)
        table.add_row(case.name, *cells, found[0].rule.split(",")[0])
    Console(width=150).print(table)


def agreement_figures(rows: Sequence[tuple[Case, float, list[Answer]]]) -> list[Figure]:
    """How many intervals hold the quadrature, of all answers and of the rare ones, and how far off the answers are."""
    figures = []
    for name, some in (
        ("first passage", rows),
        (f"first passage below {RARE:g}", [row for row in rows if row[1] < RARE]),
    ):
        inside = [contains(exact, one) for _, exact, found in some for one in found]
        ratios = [one.numbers["probability"] / exact for _, exact, found in some for one in found]
        if inside:
            figures.append(Figure(f"{name}: 95 % intervals that hold it", sum(inside), "", "answers", len(inside)))
            figures.append(
                Figure(f"{name}: greatest relative difference", float(np.max(np.abs(np.array(ratios) - 1))), "")
            )
    return figures


@click.command(help=__doc__)
@click.option("--json", "as_json", is_flag=True, help="One JSON object instead of a table.")
@click.option("--quick", is_flag=True, help="Four of the sets, fewer runs.")
@click.option("--table", is_flag=True, help="Also print the table of parameter sets.")
@click.option("--runs", default=200_000, show_default=True, type=click.IntRange(1000), help="Runs of a parameter set.")
@click.option("--seeds", default=1, show_default=True, type=click.IntRange(1), help="Answers of each parameter set.")
@click.option("--rare", is_flag=True, help="Only the rarest set of each kind.")
@click.option("--seed", default=1, show_default=True, help="The first seed.")
def main(as_json: bool, quick: bool, table: bool, runs: int, seeds: int, rare: bool, seed: int) -> None:
    rows = list(agreement(range(seed, seed + seeds), 20_000 if quick else runs, quick, rare))
    if table and not as_json:
        show_agreement(rows)
    figures = [*agreement_figures(rows), *speeds(LARGEST if quick else 8 * LARGEST, 2 if quick else 5)]
    figures.append(memory(100_000 if quick else 1_000_000))
    give("statistical checking", figures, as_json=as_json)


if __name__ == "__main__":
    main()

"""L*_SHA on the real CNC traces, on cd1 to cd17 and on automata that are known: time, size, order, error, truth.

The public learner's time (99 to 199 s on these 15 CNC files, 2 cores) was measured elsewhere, by the wall clock. Wall
times hold for a machine that does nothing else, so the CPU time stands beside. Held-out: every trace is left out once
(five folds by trace), the model learned on the others runs freely from its first reading on (events without an edge:
resync), and all its readings count. `bins`, a table by level and direction, and persistence (it stays as at the first
reading) see the same; `bins` on the CNC traces takes minutes for that: `--bins-on-cnc`. The CNC traces are looked for
in `../shared/data`. What known automata are says `benchmarks/known_automata.py`; `--trials 200 --automata 20` for
figures that tell.
"""

import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from time import perf_counter, process_time

import click
import numpy as np

from benchmarks.figures import Figure, best, give
from benchmarks.known_automata import SCATTER, Family, found_again, query_p, random_automaton, traces_of
from sim.artefacts.model_json import model_text
from sim.engine.open_loop_run import open_loop, readings
from sim.lab.learning.bins.learn import learn_bins
from sim.lab.learning.lsha.learn import LearnedLsha, learn_lsha
from sim.lab.recordings.column_map import load_map
from sim.lab.recordings.traces import load_traces
from sim.plant.scenarios import SCENARIOS, scenario
from sim.sha.events import DECANTER, Alphabet, Bins, encode
from sim.sha.model import Model
from sim.sha.trace import Trace

ROOT = Path(__file__).parents[1]
CNC = ROOT.parent / "shared" / "data" / "lsha_upstream" / "made_cnc"
PUBLIC = (99.0, 199.0)
"""Seconds of the public learner on the CNC traces: fastest and slowest of its runs."""
FOLDS, SHUFFLES = 5, 5
TEMPERATURE = "TCuscinettiRiduttore"

Learner = Callable[[Sequence[Trace]], Model]


def read_cnc() -> tuple[list[Trace], Alphabet, str]:
    """The CNC traces, encoded, with their alphabet and the signal that is followed."""
    column_map = load_map(ROOT / "config" / "traces" / "made_cnc.toml")
    traces, _ = load_traces(CNC, column_map)
    return traces, column_map.alphabet, column_map.temperature


def held_out(traces: Sequence[Trace], learner: Learner, temperature: str) -> tuple[float, float]:
    """(MAE, RMSE) of the free runs of models that did not see the trace, over all readings."""
    errors: list[np.ndarray] = []
    for fold in range(FOLDS):
        model = learner([trace for number, trace in enumerate(traces) if number % FOLDS != fold])
        errors += [_error(model, trace, temperature) for trace in traces[fold::FOLDS]]
    return _figures(np.concatenate(errors))


def _error(model: Model, trace: Trace, temperature: str) -> np.ndarray:
    times, values = readings(trace, temperature)
    run = open_loop(replace(model, calibration={}), trace, "resync")
    row = np.searchsorted(run.times, times, side="right") - 1
    return np.asarray(run.mean[row] - values)


def persistence(traces: Sequence[Trace], temperature: str) -> tuple[float, float]:
    """(MAE, RMSE) of what stays as it was at the first reading."""
    values = [readings(trace, temperature)[1] for trace in traces]
    return _figures(np.concatenate([column - column[0] for column in values]))


def table(traces: Sequence[Trace], alphabet: Alphabet, temperature: str) -> tuple[float, float]:
    """(MAE, RMSE) of a table: the mean of the other folds' readings by the last level and whether it rose or fell.

    Where they have none, that by the level alone; and where they have not even that, the mean of all.
    """
    levels = {
        symbol: float(level)
        for channel in alphabet.channels
        if isinstance(channel, Bins)
        for level, symbol in enumerate(channel.symbols)
    }
    keys: list[np.ndarray] = []
    for trace in traces:
        begins = [(event.time, levels[event.symbol]) for event in trace.events if event.symbol in levels]
        since, level = np.array(begins).T
        turn = np.sign(np.diff(level, prepend=level[:1]))
        row = np.maximum(np.searchsorted(since, readings(trace, temperature)[0], side="right") - 1, 0)
        keys.append(np.column_stack([level[row], turn[row]]))
    values = [readings(trace, temperature)[1] for trace in traces]
    errors: list[np.ndarray] = []
    for number, own in enumerate(keys):
        others = [each for each in range(len(traces)) if each % FOLDS != number % FOLDS]
        key, value = np.concatenate([keys[each] for each in others]), np.concatenate([values[each] for each in others])
        foretold = np.full(len(own), value.mean())
        for columns in (1, 2):
            for cell in np.unique(own[:, :columns], axis=0):
                known = (key[:, :columns] == cell).all(axis=1)
                if known.any():
                    foretold[(own[:, :columns] == cell).all(axis=1)] = value[known].mean()
        errors.append(foretold - values[number])
    return _figures(np.concatenate(errors))


def _figures(error: np.ndarray) -> tuple[float, float]:
    return float(np.mean(np.abs(error))), float(np.sqrt(np.mean(error**2)))


def same_whatever_the_order(traces: Sequence[Trace], alphabet: Alphabet, temperature: str, seed: int) -> int:
    """How many different models come out of shuffled traces."""
    rng = np.random.default_rng(seed)
    found = set()
    for _ in range(SHUFFLES):
        order = rng.permutation(len(traces))
        learned = learn_lsha([traces[number] for number in order], alphabet, temperature, seed=0)
        found.add(model_text(learned.model))
    return len(found)


def fastest(learn: Callable[[], LearnedLsha], repeats: int) -> tuple[float, float, LearnedLsha]:
    """(seconds, processor seconds) of the fastest of `repeats` calls, and what the last one learned."""
    times = []
    for _ in range(repeats):
        begin, used = perf_counter(), process_time()
        learned = learn()
        times.append((perf_counter() - begin, process_time() - used))
    return *min(times), learned


def command(repeats: int) -> float:
    """Seconds of `decanter model learn --method lsha` on the CNC files, from the shell, imports and files included."""
    what = "from gateway.cli.main import main; main()"
    with tempfile.TemporaryDirectory(prefix="decanter-bench-") as folder:
        given = ["model", "learn", "--method", "lsha", "--traces", str(CNC), "--map", "made_cnc", "--out", folder]
        line = [sys.executable, "-c", what, *given]
        return best(lambda: subprocess.run(line, check=True, cwd=ROOT, stdout=subprocess.DEVNULL), repeats)


def size(label: str, learned: LearnedLsha) -> list[Figure]:
    """Locations, edges and acceptance of one model."""
    report = learned.report
    laws = sum(one.mu == one.mu for one in report.locations)
    transients = sum(one.flow == "transient" for one in report.locations)
    return [
        Figure(f"{label}, locations with a law", laws, "", "all locations", len(report.locations)),
        Figure(f"{label}, locations with a transient", transients, "", "all locations", len(report.locations)),
        Figure(f"{label}, observed edges", report.observed_edges, "", "default edges", report.default_edges),
        Figure(
            f"{label}, training traces accepted", report.acceptance.accepted, "", "traces", report.acceptance.traces
        ),
    ]


def errors(
    label: str,
    traces: Sequence[Trace],
    learner: Learner,
    rivals: dict[str, Learner],
    signal: str,
    known: dict[str, tuple[float, float]] | None = None,
) -> list[Figure]:
    """Held-out MAE and RMSE, against those of each rival, those that are `known` already, and persistence."""
    mine = held_out(traces, learner, signal)
    against = {name: held_out(traces, rival, signal) for name, rival in rivals.items()}
    against |= known or {}
    against["persistence"] = persistence(traces, signal)
    unit = "kW" if signal == "SpindlePower" else "degC"
    return [
        Figure(f"{label}, held-out {what}", mine[number], unit, f"{name}, {what}", other[number])
        for name, other in against.items()
        for number, what in enumerate(("MAE", "RMSE"))
    ]


def cnc(repeats: int, *, quick: bool, with_bins: bool) -> list[Figure]:
    """The figures of the CNC traces."""
    traces, alphabet, signal = read_cnc()

    def learner(part: Sequence[Trace]) -> Model:
        return learn_lsha(part, alphabet, signal, seed=0).model

    def whole() -> LearnedLsha:
        again, known, followed = read_cnc()
        return learn_lsha(again, known, followed, seed=0)

    seconds, spent, learned = fastest(whole, repeats)
    public = "public learner, {}, measured elsewhere"
    found = [
        Figure("CNC, reading and learning", seconds, "s", public.format("fastest"), PUBLIC[0]),
        Figure("CNC, reading and learning", seconds, "s", public.format("slowest"), PUBLIC[1]),
        Figure("CNC, reading and learning, CPU time", spent, "s", public.format("fastest"), PUBLIC[0]),
        Figure("CNC, the command with imports", command(repeats), "s", public.format("fastest"), PUBLIC[0]),
        *size("CNC", learned),
    ]
    if quick:
        return found
    models = same_whatever_the_order(traces, alphabet, signal, seed=1)
    found.append(Figure("CNC, different model.json", models, "", "shuffled orders of the files", SHUFFLES))
    rivals: dict[str, Learner] = {}
    if with_bins:
        rivals["bins"] = lambda part: learn_bins(part, alphabet, signal, seed=0).model
    known = {"table by level and direction": table(traces, alphabet, signal)}
    return found + errors("CNC", traces, learner, rivals, signal, known)


def decanter(repeats: int, *, quick: bool, seed: int) -> list[Figure]:
    """The figures of cd1 to cd17."""
    traces = [scenario(name, seed) for name in SCENARIOS if name.startswith("cd")]

    def lsha(part: Sequence[Trace]) -> Model:
        return learn_lsha(part, DECANTER, TEMPERATURE, seed=0).model

    def bins(part: Sequence[Trace]) -> Model:
        return learn_bins(part, DECANTER, TEMPERATURE, seed=0).model

    begin = perf_counter()
    bins(traces)
    other = perf_counter() - begin
    seconds, _, learned = fastest(lambda: learn_lsha(traces, DECANTER, TEMPERATURE, seed=0), repeats)
    found = [
        Figure("cd1 to cd17, learning", seconds, "s", "bins", other),
        *size("cd1 to cd17", learned),
    ]
    return found if quick else found + errors("cd1 to cd17", encoded(traces), lsha, {"bins": bins}, TEMPERATURE)


def encoded(traces: Sequence[Trace]) -> list[Trace]:
    """The traces with their events."""
    return [replace(trace, events=encode(trace, DECANTER)) for trace in traces]


FAMILIES: tuple[tuple[Family, int], ...] = (
    ("context", 3),
    ("context", 5),
    ("direction", 3),
    ("direction", 5),
    ("free", 3),
    ("free", 5),
)


def truth(seeds: int, families: Sequence[tuple[Family, int]] = FAMILIES) -> list[Figure]:
    """How often known automata come back, over so many of each family."""
    figures = []
    for family, laws in families:
        found = []
        for seed in range(seeds):
            rng = np.random.default_rng(5000 + seed)
            automaton = random_automaton(family, laws, rng)
            found.append(found_again(automaton, traces_of(automaton, rng), traces_of(automaton, rng)))
        what = f"known automata, {family}, {laws} laws"
        figures += [
            Figure(f"{what}, right number of locations", sum(one.count for one in found), "", "automata", seeds),
            Figure(f"{what}, isomorphic", sum(one.isomorphic for one in found), "", "automata", seeds),
            Figure(f"{what}, right law in new words", float(np.mean([one.right for one in found])), "", "all", 1.0),
        ]
    return figures


def queries(trials: int) -> list[Figure]:
    """How often one hypothesis-test query at 0.05 tells two locations apart, by how far their targets are apart."""
    figures = []
    for share in (0.0, 0.25, 0.5, 1.0):
        p = [query_p(share * SCATTER, np.random.default_rng(9000 + seed)) for seed in range(trials)]
        what = "one query at 0.05, equal laws" if share == 0 else f"one query at 0.05, {share:g} scatters apart"
        against = ("nominal", 0.05) if share == 0 else ("all", 1.0)
        figures.append(Figure(f"{what}, told apart", float(np.mean(np.array(p) < 0.05)), "", *against))
    return figures


@click.command(help=__doc__)
@click.option("--json", "as_json", is_flag=True, help="One JSON object instead of a table.")
@click.option("--quick", is_flag=True, help="Time, size, acceptance, and few known automata.")
@click.option("--bins-on-cnc", is_flag=True, help="Also the held-out error of bins on the CNC traces.")
@click.option("--repeats", default=3, show_default=True, type=click.IntRange(1), help="Repetitions; the best counts.")
@click.option("--trials", default=40, show_default=True, type=click.IntRange(1), help="Hypothesis-test queries.")
@click.option("--automata", default=4, show_default=True, type=click.IntRange(1), help="Known automata per family.")
@click.option("--seed", default=0, show_default=True, help="Seed of the scenarios.")
def main(as_json: bool, quick: bool, bins_on_cnc: bool, repeats: int, trials: int, automata: int, seed: int) -> None:
    times = 1 if quick else repeats
    found = decanter(times, quick=quick, seed=seed)
    if CNC.is_dir():
        found += cnc(times, quick=quick, with_bins=bins_on_cnc)
    else:
        click.echo(f"{CNC}: not there, so nothing is said about the CNC traces", err=True)
    found += queries(2 if quick else trials) + (truth(1, FAMILIES[::2]) if quick else truth(automata))
    give("L*_SHA", found, as_json=as_json)


if __name__ == "__main__":
    main()

"""L*_SHA on the real CNC traces and on cd1 to cd17: time, size, acceptance, order of the files, held-out error.

The public learner's time (99 to 199 s on these 15 CNC files, 2 cores) was measured elsewhere; ours includes reading the
files, not Python's imports, which are a figure of their own. Held-out: every trace is left out once (five folds by
trace), the model learned on the others runs freely from its first reading on (events without an edge: resync), and all
its readings count. `bins` and persistence (it stays as at the first reading) see the same. `bins` on the CNC traces has
303 locations and takes minutes: `--bins-on-cnc`. The CNC traces are looked for in `../shared/data`.
"""

import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from time import perf_counter

import click
import numpy as np

from benchmarks.figures import Figure, best, give
from sim.artefacts.model_json import model_hash
from sim.learning.bins import learn_bins
from sim.learning.candidates import Candidate
from sim.learning.lsha.learn import LearnedLsha, learn_lsha
from sim.plant.scenarios import SCENARIOS, scenario
from sim.sha.events import DECANTER, Alphabet, encode
from sim.sha.model import Model
from sim.sha.open_loop import measured, open_loop
from sim.sha.trace import Trace
from sim.validation.column_map import load_map
from sim.validation.traces import load_traces

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
    times, values = measured(trace, temperature)
    run = open_loop(replace(model, calibration={}), trace, "resync")
    row = np.searchsorted(run.times, times, side="right") - 1
    return np.asarray(run.mean[row] - values)


def persistence(traces: Sequence[Trace], temperature: str) -> tuple[float, float]:
    """(MAE, RMSE) of what stays as it was at the first reading."""
    values = [measured(trace, temperature)[1] for trace in traces]
    return _figures(np.concatenate([column - column[0] for column in values]))


def _figures(error: np.ndarray) -> tuple[float, float]:
    return float(np.mean(np.abs(error))), float(np.sqrt(np.mean(error**2)))


def same_whatever_the_order(traces: Sequence[Trace], alphabet: Alphabet, temperature: str, seed: int) -> int:
    """How many different models come out of shuffled traces."""
    rng = np.random.default_rng(seed)
    found = set()
    for _ in range(SHUFFLES):
        order = rng.permutation(len(traces))
        learned = learn_lsha([traces[number] for number in order], alphabet, temperature, seed=0)
        found.add(model_hash(learned.model))
    return len(found)


def imports() -> float:
    """Seconds in which a fresh interpreter has imported learner and reader."""
    code = "import sim.learning.lsha.learn, sim.validation.traces"
    return best(lambda: subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT), 3)


def size(label: str, learned: LearnedLsha) -> list[Figure]:
    """Locations, edges and acceptance of one model."""
    report = learned.report
    laws = sum(one.mu == one.mu for one in report.locations)
    return [
        Figure(f"{label}, locations with a law", laws, "", "all locations", len(report.locations)),
        Figure(f"{label}, observed edges", report.observed_edges, "", "default edges", report.default_edges),
        Figure(
            f"{label}, training traces accepted", report.acceptance.accepted, "", "traces", report.acceptance.traces
        ),
    ]


def errors(
    label: str, traces: Sequence[Trace], learner: Learner, rivals: dict[str, Learner], signal: str
) -> list[Figure]:
    """Held-out MAE and RMSE, against those of each rival and against persistence."""
    mine = held_out(traces, learner, signal)
    against = {name: held_out(traces, rival, signal) for name, rival in rivals.items()}
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

    def whole() -> None:
        given, known, followed = read_cnc()
        learn_lsha(given, known, followed, seed=0)

    seconds = best(whole, repeats)
    found = [
        Figure("CNC, reading and learning", seconds, "s", "public learner, fastest, measured elsewhere", PUBLIC[0]),
        Figure("CNC, reading and learning", seconds, "s", "public learner, slowest, measured elsewhere", PUBLIC[1]),
        Figure("CNC, imports besides", imports(), "s"),
        *size("CNC", learn_lsha(traces, alphabet, signal, seed=0)),
    ]
    if quick:
        return found
    models = same_whatever_the_order(traces, alphabet, signal, seed=1)
    found.append(Figure("CNC, different models", models, "", "shuffled orders of the files", SHUFFLES))
    only = (Candidate("constant", "shared"),)
    rivals: dict[str, Learner] = {}
    if with_bins:
        rivals["bins (constant, one k)"] = lambda part: (
            learn_bins(part, alphabet, signal, seed=0, candidates=only).model
        )
    return found + errors("CNC", traces, learner, rivals, signal)


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
    found = [
        Figure("cd1 to cd17, learning", best(lambda: lsha(traces), repeats), "s", "bins", other),
        *size("cd1 to cd17", learn_lsha(traces, DECANTER, TEMPERATURE, seed=0)),
    ]
    return found if quick else found + errors("cd1 to cd17", encoded(traces), lsha, {"bins": bins}, TEMPERATURE)


def encoded(traces: Sequence[Trace]) -> list[Trace]:
    """The traces with their events."""
    return [replace(trace, events=encode(trace, DECANTER)) for trace in traces]


@click.command(help=__doc__)
@click.option("--json", "as_json", is_flag=True, help="One JSON object instead of a table.")
@click.option("--quick", is_flag=True, help="Time, size and acceptance only.")
@click.option("--bins-on-cnc", is_flag=True, help="Also the held-out error of bins on the CNC traces: ten minutes.")
@click.option("--repeats", default=3, show_default=True, type=click.IntRange(1), help="Repetitions; the best counts.")
@click.option("--seed", default=0, show_default=True, help="Seed of the scenarios.")
def main(as_json: bool, quick: bool, bins_on_cnc: bool, repeats: int, seed: int) -> None:
    times = 1 if quick else repeats
    found = decanter(times, quick=quick, seed=seed)
    if CNC.is_dir():
        found += cnc(times, quick=quick, with_bins=bins_on_cnc)
    else:
        click.echo(f"{CNC}: not there, so nothing is said about the CNC traces", err=True)
    give("L*_SHA", found, as_json=as_json)


if __name__ == "__main__":
    main()

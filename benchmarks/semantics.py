"""What carrying the temperature over events gains against drawing it on entry (the thesis), on held-out traces.

A model (method `bins`) is learned from one half of cd1..cd17 and predicts the other half from its first readings on,
and the other way round; so each trace is held out once. Its counterpart has the same flows and takes its laws of the
temperature on entry from the same training half. The gain is (thesis - own), its interval the paired bootstrap over
traces. With real data at hand the same is done along the first and second half of SKAB's pump, cut into ten pieces.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import click
import numpy as np

from benchmarks.figures import Figure, give
from sim.lab.judge.differences import Paired, compare_pairs
from sim.lab.judge.free_run import HeldOutFold, score_fold
from sim.lab.judge.semantics import side_by_side
from sim.lab.learning.bins.learn import learn_bins
from sim.lab.recordings.column_map import load_map
from sim.lab.recordings.traces import load_traces
from sim.plant.scenarios import SCENARIOS, scenario
from sim.sha.events import DECANTER, Alphabet, encode
from sim.sha.trace import Trace

ROOT = Path(__file__).parents[1]
SKAB = ROOT.parent / "shared" / "data" / "skab" / "anomaly-free.csv"
MEASURES = {"mae": "MAE", "crps": "CRPS", "largest": "largest error"}
PIECES = 10
Scores = dict[str, list[HeldOutFold]]


def compare(known: Sequence[Trace], asked: Sequence[Trace], alphabet: Alphabet, temperature: str, seed: int) -> Scores:
    """Both semantics of a model of `known` along `asked`. Raises ValueError where one of them cannot be made."""
    encoded = [replace(trace, events=encode(trace, alphabet)) for trace in known]
    model = learn_bins(encoded, alphabet, temperature, seed=seed).model
    both = side_by_side(model, encoded, seed=seed)
    return {name: [score_fold(one, trace) for trace in asked] for name, one in both.items()}


def scenarios(seed: int, count: int) -> Scores:
    """Each of `count` traces held out once: the odd ones by a model of the even ones, and the other way round."""
    traces = [scenario(name, seed) for name in list(SCENARIOS)[:count]]
    found: Scores = {}
    for known, asked in ((traces[1::2], traces[::2]), (traces[::2], traces[1::2])):
        for name, scores in compare(known, asked, DECANTER, "TCuscinettiRiduttore", seed).items():
            found.setdefault(name, []).extend(scores)
    return found


def skab(seed: int) -> Scores:
    """The second half of the recording, in pieces, by a model of the first half."""
    column_map = load_map(ROOT / "config" / "traces" / "skab.toml")
    (trace, *_), _ = load_traces(str(SKAB), column_map)
    edges = np.linspace(trace.times[0], np.nextafter(trace.times[-1], np.inf), 2 * PIECES + 1)
    pieces = [
        replace(trace.between(start, end), name=f"piece{number}", events=())
        for number, (start, end) in enumerate(pairwise(edges))
    ]
    full = [piece for piece in pieces if np.isfinite(piece.signals[column_map.temperature]).sum() > 2]
    half = len(full) // 2
    return compare(full[:half], full[half:], column_map.alphabet, column_map.temperature, seed)


def gain(scores: Scores, measure: str, seed: int) -> Paired:
    """(thesis - own) of one measure, paired by trace; above 0 where carrying the temperature is better."""
    pairs = zip(scores["resampled"], scores["carried"], strict=True)
    return compare_pairs(
        [getattr(old, measure) - getattr(new, measure) for old, new in pairs], np.random.default_rng(seed)
    )


def figures_of(what: str, scores: Scores, seed: int) -> list[Figure]:
    """Each measure of both semantics, and the gain with its interval."""
    figures = []
    for measure, name in MEASURES.items():
        own, thesis = (
            float(np.mean([getattr(one, measure) for one in scores[kind]])) for kind in ("carried", "resampled")
        )
        found = gain(scores, measure, seed)
        figures += [
            Figure(f"{what}: {name}, carried", own, "°C", "drawn on entry", thesis),
            Figure(f"{what}: gain in {name}, {found.n} traces, p = {found.p:.2g}", found.mean, "°C"),
            Figure(f"{what}: gain in {name}, 95 % from", found.low, "°C"),
            Figure(f"{what}: gain in {name}, 95 % to", found.high, "°C"),
        ]
    wins = sum(new.mae < old.mae for new, old in zip(scores["carried"], scores["resampled"], strict=True))
    return [*figures, Figure(f"{what}: carried is better (MAE)", wins, "traces", "of", len(scores["carried"]))]


@click.command(help=__doc__)
@click.option("--json", "as_json", is_flag=True, help="One JSON object instead of a table.")
@click.option("--quick", is_flag=True, help="Two traces only: whether it works.")
@click.option("--traces", type=click.IntRange(2, len(SCENARIOS)), help="So many traces.  [default: all, or 2]")
@click.option("--seed", default=0, show_default=True, type=click.IntRange(0), help="Seed of the scenarios.")
def main(as_json: bool, quick: bool, traces: int | None, seed: int) -> None:
    count = traces or (2 if quick else len(SCENARIOS))
    figures = figures_of("cd1..cd17, held out", scenarios(seed, count), seed)
    if SKAB.is_file() and not quick:
        try:
            figures += figures_of("SKAB, held out", skab(seed), seed)
        except ValueError as error:
            click.echo(f"SKAB: {error}", err=True)
    give("semantics", [one for one in figures if np.isfinite(one.value)], as_json=as_json)


if __name__ == "__main__":
    main()

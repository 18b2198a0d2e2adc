"""Formulas: statistical checking against exact answers, random formulas against a literal evaluator, and their cost.

The reference queries are over a continuous-time Markov chain and have their probability from matrix exponentials
(`tests.rig.chain`). Random formulas, with the temperature among them, are evaluated word by word on runs drawn apart
(`tests.rig.literal`), and on courses along traces in which instants meet, where every verdict must be the same. The
coverage is that of the 95 % intervals over 300 seeds. Deviations are in standard errors: among 39 right answers the
largest is about 2.5, among 200 about 3.
"""

from dataclasses import replace
from fractions import Fraction

import click
import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.figures import Figure, best, give
from sim.lab.checking.language.parse import parse_query
from sim.lab.checking.query.tree import Probability
from sim.lab.checking.smc.answers import QuerySettings, answer, prepare_question
from sim.lab.checking.smc.runs import sampler
from sim.lab.checking.smc.start import initial
from sim.sha.automaton import Distribution, Flow
from sim.sha.model import Model
from tests.rig.formulas import CHAIN, SLOPES, START, Reference, random_path, references, small_model, traced_course
from tests.rig.literal import apart, drawn_course, holds, needed

BOUND, FORMULAS, SEEDS = 40.0, 200, 300
COSTS = {
    "locations": ("Pr[<=444](<> q_3 && age > 60)", "Pr[<=444](q_1 --> q_3 within 60)"),
    "interval": ("Pr[<=444](<> q_3 && age > 60)", "Pr[<=444](q_1 -->[10,60] q_3)"),
    "temperature": ("Pr[<=444](<> Temp > 45)", "Pr[<=444](Temp > 40 --> q_3 within 60)"),
}


def deviations(model: Model, every: list[Reference], runs: int, seed: int) -> list[tuple[Reference, float, float]]:
    """(reference, answer, its distance from the exact one in standard errors) of each reference query."""
    found = []
    for number, reference in enumerate(every):
        settings = QuerySettings(rule="fixed", runs=runs, seed=seed + number)
        p = answer(reference.query(model), initial(model), settings).numbers["probability"]
        error = np.sqrt(reference.exact * (1.0 - reference.exact) / runs)
        found.append((reference, p, (p - reference.exact) / error))
    return found


def coverage(model: Model, every: list[Reference], runs: int, seed: int) -> list[Figure]:
    """How often the 95 % interval of so many runs holds the exact answer: all queries together, and the worst one."""
    shares = []
    for reference in every:
        start, query = initial(model), reference.query(model)
        inside = 0
        for number in range(SEEDS):
            settings = QuerySettings(rule="fixed", runs=runs, seed=seed + number)
            numbers = answer(query, start, settings).numbers
            inside += numbers["low"] <= reference.exact <= numbers["high"]
        shares.append(inside / SEEDS)
    name = f"95 % intervals of {runs} runs over {SEEDS} seeds, {len(every)} queries"
    return [
        Figure(f"{name}: coverage", float(np.mean(shares)), "", "its level", 0.95),
        Figure(f"{name}: coverage of the worst query", min(shares), "", "its level", 0.95),
    ]


def along_traces(model: Model, formulas: int, rng: np.random.Generator) -> Figure:
    """Random formulas on courses along traces: how many verdicts are not those of the literal evaluator."""
    wrong = 0
    for _ in range(formulas):
        path = random_path(rng, BOUND, whole=True)
        trace, course = traced_course(rng, BOUND, needed(path, BOUND))
        start = initial(model, trace)
        verdict = sampler(start.world, (prepare_question(Probability(BOUND, path), start),), 0).draw(1)[0, 0]
        wrong += bool(verdict) != holds(path, course, Fraction(BOUND))
    return Figure("random formulas along traces: wrong verdicts", wrong, "", "formulas", formulas)


def on_own_runs(model: Model, runs: int, theirs: int, rng: np.random.Generator) -> Figure:
    """Random formulas: the largest distance from the share of `theirs` runs drawn apart, in standard errors."""
    largest = 0.0
    for number in range(FORMULAS):
        path = random_path(rng, BOUND, whole=False)
        settings = QuerySettings(rule="fixed", runs=runs, seed=number)
        found = answer(Probability(BOUND, path), initial(model), settings).numbers["probability"]
        courses = (drawn_course(CHAIN, SLOPES, START, needed(path, BOUND), rng) for _ in range(theirs))
        share = float(np.mean([holds(path, course, Fraction(BOUND)) for course in courses]))
        largest = max(largest, apart(found, runs, share, theirs))
    return Figure(f"{FORMULAS} random formulas, {theirs} runs each drawn apart: largest deviation", largest, "s.e.")


def costs(runs: int, repeats: int) -> list[Figure]:
    """A bounded response against `<>` on the same noisy model, in runs a second."""
    quiet = small_model()
    flow, laws = Flow("exponential", {"k": 0.02, "noise": 0.1}), (30.0, 40.0, 50.0, 35.0)
    places = tuple(
        replace(place, flow=flow, distribution=Distribution("normal", {"mu": target, "sigma": 1.0}))
        for place, target in zip(quiet.sha.locations, laws, strict=True)
    )
    model = replace(quiet, sha=replace(quiet.sha, locations=places))
    start, figures = initial(model), []
    for name, texts in COSTS.items():
        speeds = []
        for text in texts:
            query, settings = parse_query(text, model), QuerySettings(rule="fixed", runs=runs)
            speeds.append(runs / best(lambda query=query, settings=settings: answer(query, start, settings), repeats))
        figures.append(Figure(f"bounded response, {name}", speeds[1], "runs/s", "<> of the same kind", speeds[0]))
    return figures


@click.command(help=__doc__)
@click.option("--json", "as_json", is_flag=True, help="One JSON object instead of a table.")
@click.option("--quick", is_flag=True, help="Fewer runs, and the coverage of every tenth query.")
@click.option("--table", is_flag=True, help="Also print the table of reference queries.")
@click.option("--seed", default=1, show_default=True, help="The first seed, and that of the random formulas.")
def main(as_json: bool, quick: bool, table: bool, seed: int) -> None:
    model, every, rng = small_model(), references(), np.random.default_rng(seed)
    runs = 10_000 if quick else 50_000
    rows = deviations(model, every, runs, seed)
    if table and not as_json:
        shown = Table(title=f"reference queries, {runs} runs", title_justify="left", pad_edge=False)
        for name in ("query", "exact", "answer", "standard errors"):
            shown.add_column(name)
        for reference, p, distance in rows:
            shown.add_row(reference.text, f"{reference.exact:.5f}", f"{p:.5f}", f"{distance:+.2f}")
        Console(width=120).print(shown)
    largest = max(abs(distance) for *_, distance in rows)
    give(
        "formulas",
        [
            Figure(f"{len(every)} reference queries, {runs} runs: largest deviation", largest, "s.e."),
            *coverage(model, every[::10] if quick else every, 64, seed),
            along_traces(model, FORMULAS if quick else 10 * FORMULAS, rng),
            on_own_runs(model, 448 if quick else 4_000, 50 if quick else 200, rng),
            *costs(4_000 if quick else 16_000, 1 if quick else 2),
        ],
        as_json=as_json,
    )


if __name__ == "__main__":
    main()

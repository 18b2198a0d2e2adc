"""The one door for queries: `answer(query, start)` sends each kind to what answers it."""

from sim.checking.proof.symbolic import decide
from sim.checking.query import tree as q
from sim.checking.smc.estimates import comparison, hypothesis, probability
from sim.checking.smc.record import Answer, Rule, Settings
from sim.checking.smc.runs import Report
from sim.checking.smc.start import Start, believed, initial
from sim.checking.smc.values import expectation, simulation
from sim.sha.automaton import SHA

__all__ = ["Answer", "Rule", "Settings", "Start", "answer", "believed", "decided", "initial"]


MOST_RUNS, LONGEST_RUN = 100_000_000, 1e9
"""Runs that a query may ask for, and their length (s)."""


def quiet(_what: str, _share: float) -> None:
    """No progress."""


def answer(query: q.Query, start: Start, settings: Settings | None = None, report: Report = quiet) -> Answer:
    """The answer to a query about runs from `start` (`answer_start.initial`, `believed`).

    Equal arguments give equal answers. Raises ValueError for what cannot be answered, with the reason, and for symbolic
    queries, which need no runs (`decided`).
    """
    chosen = settings or Settings()
    if isinstance(query, q.Symbolic):
        raise ValueError("a symbolic query is decided over the locations, not answered by runs")
    if chosen.rare and not isinstance(query, q.Probability):
        raise ValueError("importance splitting answers Pr[...](<> ...) and Pr[...]([] ...) without a comparison")
    _check_size(query, chosen)
    if isinstance(query, q.Probability):
        return probability(query, start, chosen, report)
    if isinstance(query, q.Hypothesis):
        return hypothesis(query, start, chosen, report)
    if isinstance(query, q.PairedComparison):
        return comparison(query, start, chosen, report)
    if isinstance(query, q.Expectation):
        return expectation(query, start, chosen, report)
    return simulation(query, start, chosen, report)


def _check_size(
    query: q.Probability | q.Hypothesis | q.PairedComparison | q.Expectation | q.Simulation, settings: Settings
) -> None:
    """Raises ValueError for more runs, or longer ones, than can be made."""
    if isinstance(query, q.PairedComparison):
        parts: tuple[q.Probability | q.Expectation | q.Simulation, ...] = (query.left, query.right)
    else:
        parts = (query.question if isinstance(query, q.Hypothesis) else query,)
    for runs in (settings.runs, *(part.runs for part in parts)):
        if runs is not None and not 1 <= runs <= MOST_RUNS:
            raise ValueError(f"{runs} runs cannot be made; ask for a number from 1 to {MOST_RUNS}")
    for part in parts:
        if not 0.0 < part.bound <= LONGEST_RUN:
            raise ValueError(f"a run of {part.bound:g} s cannot be made; the bound lies above 0 and at most at 1e9 s")


def decided(query: q.Symbolic, sha: SHA) -> Answer:
    """The answer to a symbolic query, with the word that shows it where one does. Raises ValueError as `decide`."""
    found = decide(query, sha)
    said = f"{query.kind}: {'holds' if found.holds else 'does not hold'}"
    if found.shows:
        said += f"; {found.shows}: {_route(found.path, found.word) or sha.initial}"
        if found.loop:
            said += f", then again and again {_route(found.loop_path, found.loop)}"
    numbers = {"locations looked at": float(found.explored)}
    rule = f"exhaustive, {found.explored} locations looked at"
    return Answer(query, "symbolic", said, found.holds, numbers, rule, 0, 0, "", found.notes)


def _route(places: tuple[str, ...], word: tuple[str, ...]) -> str:
    """`a -e-> b -f-> c`: the path's locations with the symbols between them; a loop's path has no first location."""
    ahead = places[1:] if len(places) > len(word) else places
    begin = places[0] if len(places) > len(word) else ""
    return begin + "".join(f" -{symbol}-> {place}" for symbol, place in zip(word, ahead, strict=True))

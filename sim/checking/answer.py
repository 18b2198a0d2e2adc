"""The one door for queries: `answer(query, start)` sends each kind to what answers it."""

from sim.checking import query as q
from sim.checking.answer_estimates import comparison, hypothesis, probability
from sim.checking.answer_record import Answer, Rule, Settings
from sim.checking.answer_runs import Report
from sim.checking.answer_start import Start, believed, initial
from sim.checking.answer_values import expectation, simulation
from sim.checking.symbolic import decide
from sim.sha.automaton import SHA

__all__ = ["Answer", "Rule", "Settings", "Start", "answer", "believed", "decided", "initial"]


MOST_RUNS = 100_000_000
"""Runs that a query may ask for."""


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
    asked = max((one for one in (chosen.runs, _runs(query)) if one is not None), default=1)
    if not 1 <= asked <= MOST_RUNS:
        raise ValueError(f"{asked} runs cannot be made; ask for a number from 1 to {MOST_RUNS}")
    if isinstance(query, q.Probability):
        return probability(query, start, chosen, report)
    if isinstance(query, q.Hypothesis):
        return hypothesis(query, start, chosen, report)
    if isinstance(query, q.Compared):
        return comparison(query, start, chosen, report)
    if isinstance(query, q.Expectation):
        return expectation(query, start, chosen, report)
    return simulation(query, start, chosen, report)


def _runs(query: q.Probability | q.Hypothesis | q.Compared | q.Expectation | q.Simulation) -> int | None:
    """The greatest number of runs that the query itself asks for."""
    if isinstance(query, q.Hypothesis):
        return query.question.runs
    if isinstance(query, q.Compared):
        return max(query.left.runs or 1, query.right.runs or 1)
    return query.runs


def decided(query: q.Symbolic, sha: SHA) -> Answer:
    """The answer to a symbolic query, with the word that shows it where one does. Raises ValueError as `decide`."""
    found = decide(query, sha)
    said = f"{query.kind}: {'holds' if found.holds else 'does not hold'}"
    if found.shows:
        said += f"; {found.shows}: {_route(found.path, found.word) or sha.initial}"
        if found.loop:
            said += f", then again and again {_route(found.loop_path, found.loop)}"
    numbers = {"locations looked at": float(found.explored)}
    return Answer(query, "symbolic", said, found.holds, numbers, f"exhaustive, {found.explored} locations looked at", 0, 0, "", found.notes)


def _route(places: tuple[str, ...], word: tuple[str, ...]) -> str:
    """`a -e-> b -f-> c`: the path's locations with the symbols between them; a loop's path has no first location."""
    ahead = places[1:] if len(places) > len(word) else places
    begin = places[0] if len(places) > len(word) else ""
    return begin + "".join(f" -{symbol}-> {place}" for symbol, place in zip(word, ahead, strict=True))

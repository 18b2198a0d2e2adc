"""The queries that go with an exported model: a default set, and those asked for, in UPPAAL 5's form."""

import re
from collections.abc import Sequence

from sim.lab.checking.language import QueryError, parse_query, query_text, uppaal_refusal
from sim.lab.checking.query import Symbolic
from sim.lab.uppaal.document import ExportedQuery, number
from sim.lab.uppaal.replay import ReplayedTrace
from sim.sha import Model

EXPECTATION_RUNS = 1000
"""Runs of an expectation in the default set."""

_OWN = re.compile(r"\b(?:[pi]_1\.|N_E\b|N_R\b|m_1\.(?:clamps|taken)\b)")
"""What only the exported model has: queries about it are passed on in UPPAAL's words."""


def compatibility() -> ExportedQuery:
    """The minimal model's question: does the automaton take every event of the trace?"""
    return ExportedQuery("A<> p_1.next_i == N_E", "the automaton accepts every event of the trace")


def default_questions(replay: ReplayedTrace, peak: float) -> tuple[ExportedQuery, ...]:
    """Course, limits, extremes and the replay's own health; `peak` (degC) is a temperature worth asking about."""
    bound, level = replay.time_bound, number(peak)
    questions = [
        ExportedQuery(f"simulate [<={bound}; 10] {{m_1.Temp}}", "ten courses of the temperature"),
        ExportedQuery(f"Pr[<={bound}](<> m_1.Temp >= {level})", "the temperature reaches the model's own mean peak"),
        ExportedQuery(f"E[<={bound}; {EXPECTATION_RUNS}](max: m_1.Temp)", "the mean highest temperature"),
        ExportedQuery(f"E[<={bound}; {EXPECTATION_RUNS}](min: m_1.Temp)", "the mean lowest temperature"),
        ExportedQuery(
            f"E[<={bound}; {EXPECTATION_RUNS}](max: m_1.clamps)", "how often a run is put back into its range"
        ),
        ExportedQuery(f"Pr[<={bound}](<> p_1.next_i == N_E) >= 0.99", "every event is played in time"),
    ]
    if not replay.dropped:
        taken = ExportedQuery(
            f"Pr[<={bound}](<> m_1.taken == N_E) >= 0.99", "no event is lost on its broadcast channel"
        )
        questions.append(taken)
    return tuple(questions)


def export_questions(texts: Sequence[str], model: Model) -> tuple[tuple[ExportedQuery, ...], tuple[ExportedQuery, ...]]:
    """Queries in the program's own language (docs/checking.md) as (main, minimal) questions of the export.

    Symbolic ones go to the minimal model, since UPPAAL decides none over hybrid clocks. A query about the players or
    the counters (`p_1.next_i`, `m_1.taken` ...) is UPPAAL's alone and passed on as it is. Raises QueryError for text
    that cannot be read, and for a query that UPPAAL has no form for.
    """
    main: list[ExportedQuery] = []
    minimal: list[ExportedQuery] = []
    for text in texts:
        if _OWN.search(text):
            formula, symbolic = " ".join(text.split()), re.match(r"\s*(?:[AE]\s*(?:<>|\[\]))", text) is not None
        else:
            query = parse_query(text, model)
            refusal = uppaal_refusal(query)
            if refusal:
                raise QueryError(f"query {text!r}: {refusal}")
            formula, symbolic = query_text(query, model), isinstance(query, Symbolic)
        (minimal if symbolic else main).append(ExportedQuery(formula, "asked for"))
    return tuple(main), tuple(minimal)


def query_file(questions: Sequence[ExportedQuery]) -> str:
    """The `.q` file: each query on a line of its own below a comment, as verifyta reads it."""
    return "".join(f"// {question.comment}\n{question.formula}\n\n" for question in questions)

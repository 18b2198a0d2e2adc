"""The learning report: what was asked, what the traces answered, and why locations were merged or kept."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from math import isfinite
from typing import Any

from sim.lab.learning.lsha.learn import LshaReport, RowOfWords
from sim.lab.learning.lsha.merging import Decision
from sim.lab.learning.lsha.words import Word
from sim.strict_json import strict

VERDICTS: Mapping[str, str] = {
    "new": "a location of its own",
    "merged": "merged",
    "default": "default hypothesis",
    "dissolved": "location dissolved",
}
MAX_WORD_SYMBOLS = 8
"""Symbols up to which a single word is spelled out."""
MAX_ROWS = 400
"""Rows of a table that the text shows; the JSON form has all."""


def report_document(report: LshaReport) -> dict[str, Any]:
    """The whole report as plain values, for JSON: numbers that are none become None."""
    document = {
        "settings": asdict(report.settings),
        "flow_hypotheses": [asdict(rival) for rival in report.flows],
        "flow_sample": {"traces": report.flow_traces, "events": report.flow_events},
        "structure_hypotheses": [asdict(rival) for rival in report.structures],
        "delta": report.delta,
        "parameter_spread": report.spread,
        "parameter_scatter": report.scatter,
        "segments": report.segments,
        "copies_left_out": report.copies,
        "classes_of_words": [asdict(row) for row in report.rows.values()],
        "hypothesis_test_queries": report.queries,
        "p_below_which_rows_differ": report.level,
        "decisions": [_decision(decision, report) for decision in report.decisions],
        "counterexamples": [_counterexample(decision, report) for decision in counterexamples(report)],
        "model_identification_queries": [
            {**asdict(query), "location": report.locations[query.location].name} for query in report.identified
        ],
        "observation_table": {
            "suffixes": [list(suffix) for suffix in report.table.suffixes],
            "upper": [asdict(row) for row in report.table.upper],
            "lower": [asdict(row) for row in report.table.lower],
        },
        "locations": [asdict(location) for location in report.locations],
        "edges": {"observed": report.observed_edges, "default": report.default_edges},
        "acceptance": asdict(report.acceptance),
        "coverage": [asdict(horizon) for horizon in report.coverage],
    }
    return {key: strict(value) for key, value in document.items()}


def counterexamples(report: LshaReport) -> list[Decision]:
    """The decisions by which a word of a trace refuted the hypothesis so far: its row equalled no location."""
    return [decision for decision in report.decisions if decision.verdict == "new" and decision.rival is not None]


def report_text(report: LshaReport, name: str) -> str:
    """The report for people, in Markdown."""
    return "\n".join(_lines(report, name)) + "\n"


def _lines(report: LshaReport, name: str) -> Iterator[str]:
    laws = sum(location.mu == location.mu for location in report.locations)  # NaN, which no law has, equals nothing
    accepted = report.acceptance
    yield f"# How {name} was learned (L*_SHA)"
    yield ""
    yield (
        f"{accepted.traces} traces with {accepted.events} events, {report.segments} segments that tell their parameter"
        + (f"; {report.copies} identical copies were left out." if report.copies else ".")
    )
    yield (
        f"{laws} locations with a law of their own, {len(report.locations) - laws} in which something is not known; "
        f"{report.observed_edges} observed edges, {report.default_edges} default edges for what was never seen."
    )
    yield f"Every training trace is followed by the observed edges alone: {accepted.accepted} of {accepted.traces}."
    yield ""
    yield "## Which flow (held-out free runs)"
    yield ""
    if report.flow_events < accepted.events:
        yield (
            f"Compared on the beginnings of {report.flow_traces} traces with {report.flow_events} of all "
            f"{accepted.events} events; locations, edges and parameters are learned from all of them."
        )
        yield ""
    columns = ("hypothesis", "parameters", "log-likelihood", "RMSE", "MAE", "")
    yield from _grid(columns, _rivals(report.flows))
    yield ""
    yield "## Which memory and merge tolerance (held-out segments)"
    yield ""
    yield "Errors are in units of a segment's own uncertainty."
    yield ""
    yield from _grid(("hypothesis", "locations", *columns[2:]), _rivals(report.structures))
    yield from _query_lines(report)
    yield from _result_lines(report)


def _rivals(rivals: Iterable[Any]) -> list[tuple[object, ...]]:
    return [
        (r.label, r.parameters, r.likelihood, r.held_out_rmse, r.held_out_mae, "chosen" if r.chosen else r.note)
        for r in rivals
    ]


def _query_lines(report: LshaReport) -> Iterator[str]:
    """What was asked: hypothesis-test queries, the counterexamples among them, model-identification queries."""
    yield ""
    yield "## Hypothesis-test queries"
    yield ""
    yield (
        f"{report.queries} two-sample tests (Welch, weighted by measurement error). Two rows differ where p < "
        f"{report.level:.3g}: all merges together keep a row apart wrongly with a probability of at most "
        f"{report.settings.alpha:g}. Differences up to {report.delta * report.spread:.3g} count as none (delta "
        f"{report.delta:g} of the spread {report.spread:.3g})."
    )
    yield ""
    yield (
        "A row is a class of words that share what is remembered of them, or one word (after =). `with` is the "
        "location that it joined, or the most similar one that it was kept apart from; `difference` (in the unit of "
        "the parameter), `t` beyond delta and `p` belong to that pair. `told apart by` names the suffix after which "
        "the two differ, where it is not their own segments that do."
    )
    yield ""
    columns = ("words", "verdict", "with", "segments", "difference", "t", "p", "told apart by")
    keys = ("words", "verdict", "other", "segments", "difference", "statistic", "p", "suffix")
    shown = [_decision(decision, report) for decision in report.decisions]
    yield from _grid(columns, [tuple(row[key] for key in keys) for row in shown])
    yield ""
    yield "## Counterexamples"
    yield ""
    refuting = [_counterexample(decision, report) for decision in counterexamples(report)]
    yield (
        f"{len(refuting)} words of the traces refuted the hypothesis of their time and became locations."
        if refuting
        else "None."
    )
    for example in refuting:
        yield f"- {example['words']}: trace {example['trace']}, its first {example['events']} events"
    if not report.identified:
        return
    yield ""
    yield "## Model-identification queries"
    yield ""
    yield "Does another flow fit a location's segments better than that of all? Held-out free runs have to confirm it."
    yield ""
    rows = [
        (report.locations[q.location].name, q.default, q.kind, q.segments, q.gain, q.p, "kept" if q.kept else "changed")
        for q in report.identified
    ]
    yield from _grid(("location", "default flow", "best fit", "segments", "gain per segment", "p", ""), rows)


def _decision(decision: Decision, report: LshaReport) -> dict[str, object]:
    other = decision.rival if decision.verdict == "new" else decision.other
    answer = decision.answer
    return {
        "words": _row_name(report.rows[decision.row]),
        "verdict": VERDICTS[decision.verdict],
        "other": "" if other is None else _row_name(report.rows[other]),
        "location": report.rows[decision.row].location,
        "segments": decision.evidence,
        "difference": answer.difference if answer else None,
        "statistic": answer.statistic if answer else None,
        "p": answer.p if answer else None,
        "suffix": _word(decision.suffix) if decision.suffix else "",
    }


def _row_name(row: RowOfWords) -> str:
    """What a row is called: its context, and the word itself, the middle of a long one left out."""
    if row.word is None:
        return row.name
    short = (
        row.word
        if len(row.word) <= MAX_WORD_SYMBOLS
        else (*row.word[:2], f"… {len(row.word) - 5} more …", *row.word[-3:])
    )
    return f"{row.name} = {_word(short)}"


def _counterexample(decision: Decision, report: LshaReport) -> dict[str, object]:
    row = report.rows[decision.row]
    return {"words": _row_name(row), "trace": row.trace, "events": row.events, "suffix": _word(decision.suffix)}


def _result_lines(report: LshaReport) -> Iterator[str]:
    """What was learned: locations, their bands on held-out data, the observation table."""
    yield ""
    yield "## Locations"
    yield ""
    columns = (
        *("location", "flow", "entry", "mean", "error of it", "scatter"),
        *("segments", "readings", "seconds", "words"),
    )
    rows = [
        (e.name, e.flow, e.entry, e.mu, e.mu_error, e.scatter, e.segments, e.readings, e.seconds, ", ".join(e.words))
        for e in report.locations
    ]
    yield from _grid(columns, rows)
    if report.coverage:
        yield ""
        yield "## Bands on held-out data"
        yield ""
        bands = [
            (row.horizon, row.forecasts, row.covered, row.factor, row.crps, row.persistence) for row in report.coverage
        ]
        yield from _grid(
            ("horizon, s", "forecasts", "covered by the 90 % band", "factor", "CRPS", "persistence's CRPS"), bands
        )
    yield ""
    yield "## Observation table"
    yield ""
    yield "Cells are the locations that word and suffix lead to; ε is the empty word, – was not observed."
    yield ""
    suffixes = ("word", *(_word(suffix) for suffix in report.table.suffixes))
    for title, part in (("Access words", report.table.upper), ("Extensions", report.table.lower)):
        yield f"### {title}"
        yield ""
        yield from _grid(suffixes, [(_word(row.word), *(cell or "–" for cell in row.cells)) for row in part])
        yield ""


def _word(word: Word) -> str:
    return " ".join(word) or "ε"


def _grid(columns: Sequence[str], rows: Sequence[Sequence[object]]) -> Iterator[str]:
    """A Markdown table; a sign that would end a cell is escaped."""
    yield "| " + " | ".join(columns) + " |"
    yield "|" + " --- |" * len(columns)
    for row in rows[:MAX_ROWS]:
        yield "| " + " | ".join(_cell(value) for value in row) + " |"
    if len(rows) > MAX_ROWS:
        yield f"| and {len(rows) - MAX_ROWS} more: see the JSON form |" + " |" * (len(columns) - 1)


def _cell(value: object) -> str:
    if value is None or (isinstance(value, float) and not isfinite(value)):
        return "–"
    return f"{value:.4g}" if isinstance(value, float) else str(value).replace("|", "\\|")

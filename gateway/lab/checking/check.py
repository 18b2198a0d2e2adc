"""`decanter model check`: a query put to a model, answered by runs or decided over its locations."""

import os
from collections.abc import Iterator
from math import inf, isfinite, nan, nextafter
from pathlib import Path

from drivers.csv_rows import write_rows
from drivers.named_files import name_write_errors
from gateway.console import (
    CommandResult,
    Line,
    Part,
    Progress,
    Rows,
    conclude,
    progress,
)
from gateway.entry import sentences
from gateway.lab.checking.answer_picture import draw_answer
from gateway.lab.traces.load import load
from gateway.store import newest_scan, reading, to_trace
from sim.lab.checking.language import parse_query
from sim.lab.checking.query import Simulation, Symbolic
from sim.lab.checking.smc import Answer, QuerySettings, Rule, Start, answer, believed_start, decide_symbolic, initial
from sim.lab.formats import FoundModel, find_model
from sim.lab.workers import threads
from sim.sha import DEFAULT_UNIT, Model, Trace, display_unit, encode_trace

HISTORY_S = 24 * 3600.0
"""Seconds of a historian that are filtered to know what is believed at its end; a stay is seldom longer."""


def check(
    model_name: str,
    query_text: str,
    events: str | None,
    map_name: str,
    origin: str,
    future: str | None,
    rule: Rule,
    runs: int | None,
    alpha: float,
    epsilon: float,
    delta: float,
    rare: bool,
    seed: int,
    courses: Path | None,
    picture: Path | None,
    machine: str | None,
    as_json: bool,
) -> None:
    """Carry out `decanter model check`; its options and its help are in checking/commands.py."""
    settings = QuerySettings(alpha, epsilon, rule, runs, delta, seed=seed, rare=rare)
    with sentences(), progress("checking") as report:
        report("model and query", 0.0)
        trace = None
        if events is None:
            found_model = find_model(model_name)
        else:
            # The trace comes first: a set of artefacts is read by its column map's alphabet.
            traces, column_map = load([events], map_name)
            if len(traces) != 1:
                raise ValueError(
                    f"{events} holds {len(traces)} traces; --events takes one, whose events drive the runs"
                )
            trace = traces[0]
            found_model = find_model(model_name, alphabet=column_map.alphabet, temperature=column_map.temperature)
        unit = display_unit(found_model.model.unit if found_model.model is not None else DEFAULT_UNIT)
        result = answer_query(
            query_text,
            found_model,
            trace,
            settings=settings,
            origin=origin,
            future=future,
            machine=machine,
            report=report,
        )
        if courses is not None:
            if not result.courses:
                raise ValueError("--csv writes the courses of a simulate query; this query has none")
            labels = result.query.labels if isinstance(result.query, Simulation) else ()
            with name_write_errors(courses), courses.open("w", encoding="utf-8", newline="") as file:
                write_rows(file, [("run", "time", *labels)])
                for number, course in enumerate(result.courses):
                    moments = enumerate(course.times.tolist())
                    write_rows(file, ((number, time, *course.values[:, row].tolist()) for row, time in moments))
        if picture is not None:
            draw_answer(result, query_text, picture, unit)
    data = {
        "query": query_text,
        "kind": result.kind,
        "answer": result.sentence,
        "verdict": result.verdict,
        "numbers": dict(result.numbers),
        "rule": result.rule,
        "runs": result.runs,
        "seed": result.seed,
        "start": result.start,
        "levels": [{"temperature": level, "chance": chance} for level, chance in result.levels],
        "notes": list(result.notes),
        "csv": courses and str(courses),
        "picture": picture and str(picture),
    }
    holds = result.kind not in ("hypothesis", "comparison", "symbolic") or result.verdict is True
    found = CommandResult(data, ok=holds)
    conclude(found, lambda _: _show(result, query_text, courses, picture, unit=unit), as_json=as_json)


def answer_query(
    query_text: str,
    found_model: FoundModel,
    trace: Trace | None,
    *,
    settings: QuerySettings,
    origin: str = "initial",
    future: str | None = None,
    machine: str | None = None,
    report: Progress = lambda what, share: None,
) -> Answer:
    """The answer to a query about a model, whose runs a recorded `trace` drives where there is one.

    `origin` and `future` are the command's --from and --future. Raises ValueError for a query that cannot be read or
    put to this model.
    """
    model = found_model.model
    query = parse_query(query_text, model if model is not None else found_model.structure)
    if isinstance(query, Symbolic):
        return decide_symbolic(query, found_model.structure)
    start = _start(found_model.runnable(), trace, origin=origin, future=future, machine=machine)
    with threads(len(os.sched_getaffinity(0))) as helpers:
        return answer(query, start, settings, report, helpers)


def _start(model: Model, trace: Trace | None, *, origin: str, future: str | None, machine: str | None) -> Start:
    """Where the runs start, by --from and --future. Raises ValueError for options that do not go together."""
    trace = trace and encode_trace(trace, model.alphabet)
    kind, _, value = origin.partition(":")
    if kind == "initial" and not value:
        if future == "semi-markov" and trace is not None:
            raise ValueError("--events gives the events to come: leave it or --future semi-markov out")
        return initial(model, trace)
    if kind == "location" and value:
        if trace is not None:
            raise ValueError("--from location:NAME goes on by the semi-Markov law: leave --events out")
        return initial(model, location=value)
    if kind == "trace":
        if trace is None:
            raise ValueError("--from trace:TIME needs the trace: name it with --events")
        try:
            seconds = float(value)
        except ValueError:
            seconds = nan
        if not (isfinite(seconds) and seconds >= 0):
            raise ValueError(f"--from trace:{value}: give the seconds since the trace's first row, such as trace:600")
        recorded = future != "semi-markov"
        return believed_start(model, trace, float(trace.times[0]) + seconds, recorded=recorded)
    if kind == "historian" and value:
        if trace is not None or future == "recorded":
            raise ValueError("what comes after a historian's end is not recorded: leave --events and --future out")
        path = Path(value)
        with reading(path) as connection:
            last = newest_scan(connection, machine=machine)
        if last is None:
            raise ValueError(f"{path}: this historian has no scans yet; let the gateway run first")
        past = to_trace(path, path.name, start=last - HISTORY_S, end=nextafter(last, inf), machine=machine)
        return believed_start(model, encode_trace(past, model.alphabet))
    raise ValueError(f"--from {origin!r}: write initial, location:NAME, trace:SECONDS or historian:FILE")


def _show(result: Answer, text: str, courses: Path | None, picture: Path | None, *, unit: str) -> Iterator[Part]:
    """The answer on one screen: what was asked, the answer, how it came about, what limits it."""
    yield text
    yield Line(f"  {result.sentence}", bold=True)
    if isinstance(result.query, Simulation):
        kinds = ("least", "greatest", "mean at the end")
        named = [(label, [result.numbers[f"{label}: {kind}"] for kind in kinds]) for label in result.query.labels]
        rows = [[label, *(f"{number:.5g}" for number in numbers)] for label, numbers in named]
        yield Rows("courses", ["expression", *kinds], rows)
    if result.levels:
        # The levels lead to the event; of an invariant that is its violation, and `probability` is the complement.
        chance = result.numbers.get("violation", result.numbers["probability"])
        rows = [[f"{level:.4g} {unit}", f"{share:.2e}"] for level, share in result.levels]
        yield Rows("way", ["level", "chance to reach it"], [*rows, ["the event", f"{chance:.2e}"]])
    yield f"  method   {result.rule}"
    if result.runs:
        yield f"  runs     {result.runs}, seed {result.seed}"
    if result.start:
        yield f"  start    {result.start}"
    for note in result.notes:
        yield f"  note     {note}"
    for name, path in (("csv", courses), ("picture", picture)):
        if path is not None:
            yield f"{name}: {path}"

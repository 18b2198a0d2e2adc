"""`decanter model judge proof`: what is certain about a model before it runs, and the word that shows what is wrong."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from time import perf_counter
from typing import Any

import click
from click.core import ParameterSource

from drivers.named_files import name_write_errors
from gateway.console import CommandResult, Line, Part, Rows, conclude, shipped_file
from gateway.entry import sentences
from gateway.lab.models.show import show_verdict
from gateway.lab.traces.load import load
from sim.engine import Policy
from sim.lab.formats import FoundModel, find_model
from sim.lab.recordings import load_map
from sim.proof import DAY_S, Assumptions, Sojourn, TimedWord, Verification, verify, word_text
from sim.sha import encode_trace

GROWS = (
    "A flow that relaxes cannot grow: learn with `decanter model learn --method bins`, "
    "or with `decanter model learn --method lsha --default-flow exponential`."
)
NEXT = "Read the evidence above; learn anew with more traces, or with another `decanter model learn --method`."
STAYS, CASES, WIDTH = 12, 4, 150
"""What the text shows of a counterexample and of a check's cases, and signs a case; --json has all of them."""


def prove(
    model: str,
    paths: Sequence[str],
    map_name: str,
    bounds: tuple[float, float] | None,
    sojourn: Sojourn,
    z: float,
    inputs: dict[str, tuple[float, float]],
    start: tuple[float, float] | None,
    policy: Policy,
    known: bool,
    wear: float | None,
    out: Path | None,
    as_json: bool,
) -> None:
    """The work of `model judge proof`."""
    with sentences():
        traces, column_map = load(paths, map_name) if paths else ([], None)
        # Artefacts take their alphabet from a column map that was named, also without a trace; --map has a default,
        # which says nothing about a model that has an alphabet of its own.
        source = click.get_current_context().get_parameter_source("map_name")
        if not paths and source is ParameterSource.COMMANDLINE:
            column_map = load_map(shipped_file("traces", map_name))
        if column_map is None:
            found = find_model(model)
        else:
            found = find_model(model, alphabet=column_map.alphabet, temperature=column_map.temperature)
        if found.model is not None:
            alphabet = found.model.alphabet
            traces = [encode_trace(trace, alphabet) for trace in traces]
        assumptions = Assumptions(
            z=z,
            sojourn=sojourn,
            inputs=inputs,
            start=start,
            policy=policy,
            unknown=not known,
            horizon=None if wear is None else wear * DAY_S,
        )
        # The alphabet of artefacts is the one that their report lists, if it lists one.
        reported = tuple(name for name, _ in found.artefacts.report.events) if found.artefacts else ()
        result = verify(
            found.model or found.structure,
            symbols=reported or None,
            traces=traces,
            bounds=bounds,
            assumptions=assumptions,
            refusal=found.refusal,
            clock=perf_counter,
        )
        worst = _counterexample(result)
        if out is not None and worst is not None:
            with name_write_errors(out):
                out.write_text(word_text(worst[1]) + "\n", encoding="utf-8")
    data = plain(result, found)
    proved = CommandResult(data, ok=data["fitness"] != "unfit")
    conclude(proved, lambda _: _show(result, found, model, out), as_json=as_json)


def plain(result: Verification, found: FoundModel) -> dict[str, Any]:
    """The verification as plain values for JSON."""
    rows = [
        {
            "check": row.name,
            "verdict": row.verdict,
            "blocking": row.blocking,
            "evidence": row.evidence,
            "details": list(row.details),
            "words": [word_text(word) for word in row.words],
            "seconds": row.seconds,
        }
        for row in result.checks
    ]
    return {
        "model": found.name,
        # What is proven may foresee nothing: that is the verdict's, where one was kept.
        "fitness": "unfit" if not result.deployable else "not known" if found.verdict is None else found.verdict.word,
        "verdict": None if found.verdict is None else found.verdict.as_command_json(),
        "deployable": result.deployable,
        "reasons": list(result.reasons),
        "assumptions": list(result.assumptions),
        "checks": rows,
        "intervals": {name: list(row) for name, row in result.bounds.intervals.items()} if result.bounds else {},
        "notes": list(found.notes),
    }


def _show(result: Verification, found: FoundModel, model: str, out: Path | None) -> Iterator[Part]:
    seconds = sum(each.seconds for each in result.checks)
    rows = [
        [each.name, each.verdict, "" if each.blocking else "no", f"{1e3 * each.seconds:.1f}"] for each in result.checks
    ]
    yield Rows(f"{found.name}: verified in {seconds:.2f} s", ("check", "verdict", "decides", "ms"), rows)
    for each in result.checks:
        yield f"{each.name}: {each.evidence}"
        # The cases, where there is something to look for; those of `bounds` are its intervals, and are long.
        if each.verdict == "proven" or each.name == "bounds" or len(each.details) < 2:
            continue
        for detail in each.details[:CASES]:
            yield f"    {detail if len(detail) <= WIDTH else detail[:WIDTH] + ' ...'}"
        if len(each.details) > CASES:
            yield f"    ... and {len(each.details) - CASES} more (--json has them all)"
    if result.bounds is not None:
        yield f"assumed: {'; '.join(result.assumptions)}"
    worst = _counterexample(result)
    if worst is not None:
        name, word = worst
        size = f"{len(word.steps)} stays"
        if out is not None:
            replayed = f"decanter model simulate {model} --word {out}"
            yield f"counterexample to {name}, of {size}: {out}; replay it: {replayed}"
        elif len(word.steps) <= STAYS:
            yield f"counterexample to {name}: decanter model simulate {model} --word '{word_text(word)}'"
        else:
            yield f"a counterexample to {name}, of {size}, was found; --word FILE writes it, for model simulate"
    against = [each.name for each in result.checks if each.blocking and each.verdict != "proven"]
    # What is not decided is not proven: promotion refuses both alike.
    sentence = f"unfit: not proven: {', '.join(against)}" if against else "proven: every check that decides"
    yield Line(sentence, "red" if against else "green", bold=True)
    if found.verdict is not None or not against:
        yield from show_verdict(found.verdict)
    if "growth" in against and result.executable:
        yield f"next: {GROWS}"
    elif against:
        yield f"next: {NEXT}"


def _counterexample(result: Verification) -> tuple[str, TimedWord] | None:
    """(check, word) of the first counterexample: one that decides comes before one that only informs."""
    ordered = sorted(result.checks, key=lambda row: not row.blocking)
    return next(((row.name, word) for row in ordered for word in row.words), None)

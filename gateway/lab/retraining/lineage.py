"""`decanter model version lineage`: the family of a store's versions, and one made again from its record bit by bit."""

from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import click

from gateway.console import CommandResult, Part, conclude, progress
from gateway.entry import sentences
from gateway.lab.retraining.cycle_library import list_library
from gateway.lab.retraining.study import learned_model
from gateway.lab.retraining.training_record import code_hash, creation_time, read_record, software
from gateway.lab.traces.load import load
from sim.artefacts import current, model_hash, version_directory, versions
from sim.artefacts import load as load_version
from sim.sha import Trace, content_hash


def lineage_command(
    store: Path, version: str | None, folder: Path | None, former: tuple[str, ...], map_name: str, as_json: bool
) -> None:
    """Carry out `decanter model version lineage`; its options and its help are in retraining/commands.py."""
    if version is not None and folder is None and not former:
        raise click.UsageError("--remake needs the traces: give --library, --traces, or both")
    with sentences(), progress("learning again") as report:
        running = current(store)
        family: list[dict[str, Any]] = []
        for name in versions(store):
            home = version_directory(store, name)
            record, model = read_record(home), load_version(store, name)
            family.append(
                {
                    "version": name,
                    "parent": None if record is None else record.parent,
                    "created": creation_time(home),
                    "method": model.provenance.method,
                    "traces": len(model.provenance.contents or model.provenance.traces),
                    "record": record is not None,
                    "current": name == running,
                }
            )
        again: dict[str, Any] | None = None
        if version is not None:
            report("reading", 0.0)
            again = _remake(store, version, folder, load(former, map_name)[0] if former else [])

    def show() -> Iterator[Part]:
        drawn = _lineage_lines(family, None, "")
        yield from drawn
        # Each of these is learned beside one of them, so that none is the first.
        circle = [each["version"] for each in family if not any(each["version"] in line for line in drawn)]
        if circle:
            yield f"not drawn, as their records name one another as what came before: {', '.join(circle)}"
        if again is not None:
            yield again["sentence"]

    found = CommandResult({"versions": family, "remade": again}, ok=again is None or again["same"])
    conclude(found, lambda _: show(), as_json=as_json)


def _lineage_lines(family: list[dict[str, Any]], parent: str | None, indent: str) -> list[str]:
    """A line for each version that was learned beside `parent`, and under it those that were learned beside it."""
    known = {each["version"] for each in family}
    own = [each for each in family if (each["parent"] if each["parent"] in known else None) == parent]
    lines: list[str] = []
    for place, each in enumerate(own):
        date = datetime.fromtimestamp(each["created"], UTC).strftime("%Y-%m-%d %H:%M")
        last = place == len(own) - 1
        branch = "" if parent is None else ("└─ " if last else "├─ ")
        marks = "  RUNS" if each["current"] else ""
        marks += "" if each["record"] else "  (by hand: it has no record)"
        lines.append(f"{indent}{branch}{each['version']}  {date}  {each['method']}, {each['traces']} traces{marks}")
        lines += _lineage_lines(
            family, each["version"], indent + ("" if parent is None else ("   " if last else "│  "))
        )
    return lines


def _remake(store: Path, version: str, folder: Path | None, former: list[Trace]) -> dict[str, Any]:
    """The version learned again, and whether it is the same. Raises ValueError where it cannot be."""
    home = version_directory(store, version)
    record = read_record(home)
    if record is None:
        raise ValueError(f"{home}: has no record; versions that `decanter model version retrain` has made have one")
    given = {content_hash(trace): replace(trace, events=()) for trace in former}
    traces = []
    if folder is None:
        missing = [name for name, content in record.training if content not in given]
        if missing:
            raise ValueError(f"{missing[0]}: is in the record and not among --traces; give the --library that has it")
        traces = [given[content] for _, content in record.training]
    else:
        with list_library(folder) as library:
            traces = [
                given[content] if content in given else library.readings(content) for _, content in record.training
            ]
    before = load_version(store, version)
    made = learned_model(record, traces, before).model
    same = model_hash(made) == model_hash(before)
    changed = ["the program"] if record.code != code_hash() else []
    changed += [f"{name} (then {was})" for name, was in record.software.items() if software().get(name) != was]
    reason = f"; what has changed since: {', '.join(changed)}" if changed else ""
    sentence = (
        f"{version} was made again bit for bit: {model_hash(made)[:12]}"
        if same
        else f"{version} came out as another model, {model_hash(made)[:12]} for {model_hash(before)[:12]}{reason}"
    )
    return {"version": version, "same": same, "changed": changed, "hash": model_hash(made), "sentence": sentence}

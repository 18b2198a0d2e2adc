"""`decanter model judge regression`: a standard set against all models, and what became worse since which version."""

import os
import time
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import click

from gateway.console import CommandResult, Line, Part, Rows, conclude, progress
from gateway.entry import interruptible, sentences
from gateway.lab.regression.history import open_history, run_standard
from gateway.lab.regression.standard import StandardSet, code_version, load_models, read_standard
from gateway.lab.regression.worse import find_regressions, gone_models, trace_notes
from sim.files import ArtefactError, check_utf8, resolve_links
from sim.lab.judge import PRESENT
from sim.lab.learning import PERSISTENCE
from sim.sha import DEFAULT_UNIT, Model, display_unit


def regress(
    places: Sequence[Path], standard: str, file: Path, reason: str | None, map_name: str, seed: int, as_json: bool
) -> None:
    """Carry out `decanter model judge regression`; its options and its help are in regression/commands.py."""
    if reason is not None and not reason.strip():
        raise click.UsageError("--accept needs a reason")
    with sentences(), progress("standard set") as bar, interruptible(bar) as report:
        check_utf8(file)
        traces = read_standard(standard, map_name)
        models, broken = _models(places, file.parent, traces)
        asked = [_relative_place(file.parent, place) for place in places]
        code = code_version()
        with open_history(file) as history:
            run_standard(models, traces, history, places=asked, code=code, seed=seed, clock=time.time, report=report)
            worse = [each for subject in models for each in find_regressions(subject, history, seed=seed)]
            gone, notes = gone_models(history), trace_notes(history)
            last = history.rows[-1]
            results = {subject: history.results(last, subject) for subject in models}
            if reason is not None:
                when = datetime.fromtimestamp(time.time(), UTC).isoformat(timespec="seconds")
                history.add({"kind": "accepted", "when": when, "reason": reason, "models": list(models), "seed": seed})
    unit = {subject: DEFAULT_UNIT if isinstance(model, str) else model.unit for subject, model in models.items()}
    said = [each if isinstance(each, str) else each.sentence(unit[each.subject]) for each in worse]
    rows = [row for subject in models for row in _means(subject, results[subject])]
    data: dict[str, Any] = {"history": str(file), "code": code.content, "release": code.release, "commit": code.commit}
    data |= {"results": rows, "units": unit, "worse": said, "accepted": reason}
    data |= {"failed": {subject: _failures(own) for subject, own in results.items() if _failures(own)}}
    data |= {"gone": gone, "trace_problems": traces.problems, "notes": notes}
    summary = {
        f"{len(said) or 'nothing'} became worse": True,
        f"{len(gone)} gone": gone,
        f"{len(data['failed'])} not run along every trace": data["failed"],
        f"{len(traces.problems)} of the set's traces not read": traces.problems,
    }

    def show() -> Iterator[Part]:
        if rows:
            units = ", ".join(sorted({display_unit(each) for each in unit.values()}))
            title = f"standard set, {len(traces.traces)} traces, CRPS in {units}, program {code}"
            yield Rows(title, list(rows[0]), [list(row.values()) for row in rows])
        for subject, reasons in data["failed"].items():
            for each in reasons:
                yield f"{subject}: {each}"
        for each in (*said, *gone, *traces.problems):
            yield Line(each, "red")
        for each in notes:
            yield Line(each, "yellow")
        yield f"{', '.join(part for part, there in summary.items() if there)}; history: {file}"

    # What is accepted are models as they are: what could not be run or read says nothing of them.
    refused = bool(broken or traces.problems or ((said or gone) and reason is None))
    conclude(CommandResult(data, ok=not refused), lambda _: show(), as_json=as_json)


def _models(places: Sequence[Path], folder: Path, traces: StandardSet) -> tuple[dict[str, Model | str], list[str]]:
    """The models under all places by their subjects, and the sentences of places that cannot be run.

    Raises ArtefactError where that is so of all of them.
    """
    models: dict[str, Model | str] = {}
    broken: list[str] = []
    for place in places:
        found: Mapping[str, Model | str]
        try:
            found = load_models(place, traces)
        except ArtefactError as error:
            broken.append(str(error))
            found = {str(place): str(error)}
        models |= {_relative_place(folder, Path(name)): model for name, model in found.items()}
    if len(broken) == len(places):
        raise ArtefactError(broken[0])
    return models, broken


def _relative_place(folder: Path, path: Path) -> str:
    """The path as seen from the history: the same from wherever the command is called, and after a move of both."""
    check_utf8(path)
    return os.path.relpath(resolve_links(path), resolve_links(folder))


def _means(subject: str, results: Mapping[str, Mapping[str, Any]]) -> list[dict[str, Any]]:
    """A row a horizon (s): means over the traces."""
    scores = [score for row in results.values() for score in row["scores"]]
    rows: list[dict[str, Any]] = []
    for horizon in sorted({score["horizon"] for score in scores if score["method"] == PRESENT}):
        own = [score for score in scores if (score["horizon"], score["method"]) == (horizon, PRESENT)]
        simple = [score for score in scores if (score["horizon"], score["method"]) == (horizon, PERSISTENCE)]
        row: dict[str, Any] = {"model": subject, "horizon (s)": horizon, "traces": len(own)}
        for name in ("crps", "coverage"):
            row[name] = sum(score[name] for score in own) / len(own)
        row["persistence"] = sum(score["crps"] for score in simple) / len(simple) if simple else None
        rows.append(row)
    return rows


def _failures(results: Mapping[str, Mapping[str, Any]]) -> list[str]:
    return sorted({row["failed"] for row in results.values() if row["failed"]})

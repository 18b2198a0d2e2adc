"""The work behind `decanter model export`: traces exported one by one, and UPPAAL's engine run on what was written."""

import os
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sim.artefacts.find import FoundModel, find_model
from sim.artefacts.formats.bundle import file_names, write_artefacts
from sim.artefacts.formats.from_model import to_artefacts
from sim.engine.open_loop import Start
from sim.engine.schedule import Policy
from sim.sha.model import Model
from sim.sha.trace import Trace
from sim.uppaal.compare import compare, native_runs
from sim.uppaal.export import Document, Exported, base_name, write
from sim.uppaal.export import export as export_trace
from sim.uppaal.verifyta import EngineError, find_engine, run_engine

if TYPE_CHECKING:
    from sim.traces.column_map import ColumnMap


@dataclass(frozen=True, slots=True)
class Engine:
    """How verifyta is to be run: the option's path (None: look for it), seconds a file, seed."""

    path: str | None
    timeout: float
    seed: int


@dataclass(frozen=True, slots=True)
class Export:
    """What is to be written, and where; `engine` None does not run anything."""

    out: Path
    queries: tuple[str, ...]
    policy: Policy
    start: Start
    tick: int
    engine: Engine | None


def export_artefacts(where: str, out: Path) -> list[str]:
    """Writes the public artefact files of a model; returns their paths. Raises ArtefactError."""
    found = find_model(where)
    artefacts = found.artefacts or to_artefacts(found.runnable())
    write_artefacts(out, artefacts)
    return [str(out / file) for file in file_names(artefacts.name).values() if (out / file).is_file()]


def export_uppaal(
    where: str, traces: Sequence[Trace], column_map: "ColumnMap", order: Export, report: Callable[[str, float], None]
) -> list[dict[str, Any]]:
    """One row a trace; a trace that fails has `error` and does not stop the others.

    A missing or failing engine is told in `engine`, and the files stand. Raises ValueError for a model that is none.
    """
    found: FoundModel = find_model(where, alphabet=column_map.alphabet, temperature=column_map.temperature)
    model = found.runnable()
    _check_names(model, traces)
    engine, missing = _engine(order.engine)
    rows = []
    for index, trace in enumerate(traces):
        report(trace.name, index / len(traces))
        try:
            rows.append(_one(model, trace, order, engine, missing))
        except ValueError as error:
            rows.append({"trace": trace.name, "error": str(error)})
    return rows


def _check_names(model: Model, traces: Sequence[Trace]) -> None:
    """Raises ValueError when two traces would be written to one file."""
    seen: dict[str, str] = {}
    for trace in traces:
        name = base_name(model.sha.name, trace.name).casefold()
        if name in seen:
            raise ValueError(
                f"the traces {seen[name]!r} and {trace.name!r} would both be written to {name}.xml; rename one of them"
            )
        seen[name] = trace.name


def _engine(wanted: Engine | None) -> tuple[Path | None, str]:
    if wanted is None:
        return None, ""
    try:
        return find_engine(wanted.path, os.environ), ""
    except EngineError as error:
        return None, str(error)


def _one(model: Model, trace: Trace, order: Export, engine: Path | None, missing: str) -> dict[str, Any]:
    exported = export_trace(
        model, trace, policy=order.policy, start=order.start, tick=order.tick, formulas=order.queries
    )
    files = [str(path) for path in write(order.out, exported)]
    compared, failures = _run(model, trace, exported, order, engine) if engine else ([], [])
    return {
        "trace": trace.name,
        "events": len(exported.replay.times),
        "seconds": exported.replay.duration,
        "accepted": exported.replay.accepted,
        "files": files,
        "notes": list(exported.main.notes),
        "comparison": compared,
        "engine": missing or "; ".join(failures),
    }


def _run(
    model: Model, trace: Trace, exported: Exported, order: Export, engine: Path
) -> tuple[list[dict[str, Any]], list[str]]:
    """Both files answered by the engine: the comparison's rows, and a sentence for each file that failed."""
    chosen = order.engine or Engine(None, 600.0, 0)
    rng = np.random.default_rng(chosen.seed)
    native = native_runs(model, trace, exported.replay, order.policy, order.tick, rng)
    rows, failures = [], []
    for document in (exported.minimal, exported.main):
        path = _path(order.out, document)
        wanted = len(document.questions)
        ran = run_engine(engine, path, path.with_suffix(".q"), wanted, chosen.timeout, chosen.seed)
        rows += compare(document.questions, ran.output.answers, native, model)
        if ran.failure:
            failures.append(f"{document.name}: {ran.failure}")
    return [asdict(row) for row in rows], failures


def _path(out: Path, document: Document) -> Path:
    return out / f"{document.name}.xml"

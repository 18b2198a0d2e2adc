"""`decanter model export`: a model for UPPAAL along traces, run there where a plant has it; or the public artefacts."""

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np

from gateway.console import CommandResult, Part, Rows, conclude, json_option, map_option, progress, seed_option
from gateway.entry import Exit, sentence, sentences
from gateway.lab.options import policy_option, start_option, trace_option
from gateway.lab.traces.load import load
from sim.engine import Policy, Start
from sim.files import read_text
from sim.lab.formats import FoundModel, find_model
from sim.lab.formats.foreign import file_names, to_artefacts, write_artefacts
from sim.lab.recordings import ColumnMap
from sim.lab.uppaal import EngineError, base_name, compare, find_engine, native_runs, run_engine, write
from sim.lab.uppaal import export as export_trace
from sim.sha import Model, Trace, encode_trace


@dataclass(frozen=True, slots=True)
class EngineOptions:
    """How verifyta is to be run: the option's path (None: look for it), seconds a file, seed."""

    path: str | None
    timeout: float
    seed: int


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportOptions:
    """What is to be written, and where; `engine` None does not run anything."""

    out: Path
    queries: tuple[str, ...]
    policy: Policy
    start: Start
    tick: int
    engine: EngineOptions | None
    template: str = ""


def export_artefacts(where: str, out: Path) -> list[str]:
    """Writes the public artefact files of a model; returns their paths. Raises ArtefactError."""
    found_model = find_model(where)
    artefacts = found_model.artefacts or to_artefacts(found_model.runnable())
    write_artefacts(out, artefacts)
    return [str(out / file) for file in file_names(artefacts.name).values() if (out / file).is_file()]


def export_uppaal(
    where: str,
    traces: Sequence[Trace],
    column_map: ColumnMap,
    order: ExportOptions,
    report: Callable[[str, float], None],
) -> list[dict[str, Any]]:
    """One row a trace; a trace that fails has `error` and does not stop the others.

    A missing or failing engine is told in `engine`, and the files stand. Raises ValueError for a model that is none.
    """
    found_model: FoundModel = find_model(where, alphabet=column_map.alphabet, temperature=column_map.temperature)
    model = found_model.runnable()
    traces = [encode_trace(trace, model.alphabet) for trace in traces]
    # Looked at before anything is written. Two file names that differ by case alone are one on some systems.
    files: dict[str, str] = {}
    for trace in traces:
        name = base_name(model.sha.name, trace.name).casefold()
        if name in files:
            raise ValueError(
                f"the traces {files[name]!r} and {trace.name!r} would both be written to {name}.xml; rename one of them"
            )
        files[name] = trace.name
    engine, missing = None, ""
    if order.engine is not None:
        try:
            engine = find_engine(order.engine.path, os.environ)
        except EngineError as error:
            missing = str(error)
    rows = []
    for index, trace in enumerate(traces):
        report(trace.name, index / len(traces))
        try:
            rows.append(_export_trace(model, trace, order, engine, missing))
        except ValueError as error:
            rows.append({"trace": trace.name, "error": sentence(error)})
    return rows


def _export_trace(
    model: Model, trace: Trace, order: ExportOptions, engine: Path | None, missing: str
) -> dict[str, Any]:
    """The files of one trace, and where there is an engine its answers beside the native ones."""
    exported = export_trace(
        model,
        trace,
        policy=order.policy,
        start=order.start,
        tick=order.tick,
        formulas=order.queries,
        xml_template=order.template,
    )
    files = [str(path) for path in write(order.out, exported)]
    rows: list[dict[str, Any]] = []
    failures: list[str] = []
    if engine is not None and order.engine is not None:
        rng = np.random.default_rng(order.engine.seed)
        native = native_runs(model, trace, exported.replay, policy=order.policy, tick=order.tick, rng=rng)
        for document in (exported.minimal, exported.main):
            path = order.out / f"{document.name}.xml"
            queries, wanted = path.with_suffix(".q"), len(document.questions)
            ran = run_engine(engine, path, queries, wanted=wanted, timeout=order.engine.timeout, seed=order.engine.seed)
            rows += [asdict(row) for row in compare(document.questions, ran.output.answers, native, model)]
            if ran.failure:
                failures.append(f"{document.name}: {ran.failure}")
    return {
        "trace": trace.name,
        "events": len(exported.replay.times),
        "seconds": exported.replay.duration,
        "accepted": exported.replay.accepted,
        "files": files,
        "notes": list(exported.main.notes),
        "comparison": rows,
        "engine": missing or "; ".join(failures),
    }


@click.command(short_help="Write a model for UPPAAL along traces; compare with its engine.")
@click.argument("model")
@click.option("--uppaal", is_flag=True, help="Main and minimal model and queries of each trace.")
@click.option("--artefacts", is_flag=True, help="The public learner's files: graph, report, flows.")
@trace_option
@map_option
@click.option("--out", type=click.Path(path_type=Path), required=True, help="The folder to write to.")
@click.option("--query", "queries", multiple=True, help="One more query (docs/checking.md); may be given again.")
@click.option("--template", type=click.Path(path_type=Path), help="A Jinja template for the .xml files, not our own.")
@policy_option
@start_option
@click.option(
    "--tick", type=click.IntRange(0, 3600), default=1, show_default=True, help="Seconds between draws of the noise."
)
@click.option("--run/--no-run", "wanted", default=False, help="Let verifyta answer, and compare.")
@click.option("--verifyta", help="UPPAAL's engine; else DECANTER_VERIFYTA, else PATH. Implies --run.")
@click.option(
    "--timeout", type=click.FloatRange(0, min_open=True), default=600.0, show_default=True, help="Seconds a file."
)
@seed_option
@json_option
def export(
    model: str,
    uppaal: bool,
    artefacts: bool,
    paths: Sequence[str],
    map_name: str,
    out: Path,
    queries: Sequence[str],
    template: Path | None,
    policy: Policy,
    start: Start,
    tick: int,
    wanted: bool,
    verifyta: str | None,
    timeout: float,
    seed: int,
    as_json: bool,
) -> None:
    """Write a model for other programs: for UPPAAL (--uppaal, one pair of files a trace), or as public artefacts.

    MODEL_TRACE.xml is the whole model that replays the trace, MODEL_TRACE_val.xml the small one that asks whether the
    automaton accepts it; each has its queries in a .q file beside it. docs/uppaal.md says what they mean.
    """
    if not (uppaal or artefacts):
        raise click.UsageError("say what to write: --uppaal, --artefacts or both")
    if uppaal and not paths:
        raise click.UsageError("--uppaal needs the traces that the model replays: --trace FILE")
    if template is not None and not uppaal:
        raise click.UsageError("--template is that of the files of --uppaal")
    data: dict[str, Any] = {"model": model, "out": str(out), "artefacts": [], "traces": []}
    with sentences(), progress("exporting") as report:
        if artefacts:
            data["artefacts"] = export_artefacts(model, out)
        if uppaal:
            traces, column_map = load(paths, map_name)
            engine = EngineOptions(verifyta, timeout, seed) if wanted or verifyta else None
            order = ExportOptions(
                out=out,
                queries=tuple(queries),
                policy=policy,
                start=start,
                tick=tick,
                engine=engine,
                template="" if template is None else read_text(template),
            )
            data["traces"] = export_uppaal(model, traces, column_map, order, report)
    failed = [str(row["error"]) for row in data["traces"] if "error" in row]
    missing = [str(row["engine"]) for row in data["traces"] if row.get("engine")]
    complaint = "; ".join(dict.fromkeys(failed or missing))
    found = CommandResult(data, complaint, Exit.USAGE if failed else Exit.CHECK_FAILED)
    conclude(found, lambda _: _show(data), as_json=as_json)


def _show(data: dict[str, Any]) -> Iterator[Part]:
    """The files by trace, and the comparison with UPPAAL's answers where there are any."""
    for path in data["artefacts"]:
        yield f"wrote {path}"
    done = [row for row in data["traces"] if "error" not in row]
    if done:
        columns = ("trace", "events", "seconds", "accepted", "files")
        cells = [
            [
                *(row[name] for name in columns[:3]),
                "yes" if row["accepted"] else "NO",
                ", ".join(Path(path).name for path in row["files"]),
            ]
            for row in done
        ]
        yield Rows(f"exported for UPPAAL to {data['out']}", columns, cells)
    for row in done:
        for note in row["notes"]:
            yield f"{row['trace']}: {note}"
        if row["comparison"]:
            headings = ("quantity", "native", "UPPAAL", "difference", "native 95 %", "UPPAAL 95 %", "agree", "note")
            lines, intervals = [], ("native_interval", "uppaal_interval")
            for line in row["comparison"]:
                spans = [f"{line[name][0]:.4g} to {line[name][1]:.4g}" for name in intervals]
                agree = {True: "yes", False: "NO", None: ""}[line["agree"]]
                numbers = (line["native"], line["uppaal"], line["difference"])
                lines.append([line["quantity"], *numbers, *spans, agree, line["note"]])
            yield Rows(f"{row['trace']}: native against UPPAAL", headings, lines)

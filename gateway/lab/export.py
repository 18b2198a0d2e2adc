"""`decanter model export`: a model for UPPAAL along traces, run there where a plant has it; or the public artefacts."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from gateway.console.options import json_option, map_option, seed_option
from gateway.console.output import Exit, emit, fail, progress, sentences, table
from gateway.console.traces import load

if TYPE_CHECKING:
    from sim.engine.open_loop import Start
    from sim.engine.schedule import Policy


@click.command(short_help="Write a model for UPPAAL along traces; compare with its engine.")
@click.argument("model")
@click.option("--uppaal", is_flag=True, help="Main and minimal model and queries of each trace.")
@click.option("--artefacts", is_flag=True, help="The public learner's files: graph, report, flows.")
@click.option("--trace", "paths", multiple=True, help="A file, a folder or a glob; may be given again.")
@map_option
@click.option("--out", type=click.Path(path_type=Path), required=True, help="The folder to write to.")
@click.option("--query", "queries", multiple=True, help="One more query (docs/queries.md); may be given again.")
@click.option(
    "--policy",
    type=click.Choice(["reject", "ignore", "resync"]),
    default="resync",
    show_default=True,
    help="An event without an edge.",
)
@click.option(
    "--start", type=click.Choice(["measured", "law"]), default="measured", show_default=True, help="First temperature."
)
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
    policy: "Policy",
    start: "Start",
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
    from gateway.lab.exporting import Engine, Export, export_artefacts, export_uppaal

    data: dict[str, Any] = {"model": model, "out": str(out), "artefacts": [], "traces": []}
    with sentences(), progress("exporting") as report:
        if artefacts:
            data["artefacts"] = export_artefacts(model, out)
        if uppaal:
            traces, column_map = load(paths, map_name)
            engine = Engine(verifyta, timeout, seed) if wanted or verifyta else None
            order = Export(out, tuple(queries), policy, start, tick, engine)
            data["traces"] = export_uppaal(model, traces, column_map, order, report)
    emit(data, lambda: _show(data), as_json_line=as_json)
    failed = [str(row["error"]) for row in data["traces"] if "error" in row]
    if failed:
        fail("; ".join(dict.fromkeys(failed)))
    missing = [str(row["engine"]) for row in data["traces"] if row.get("engine")]
    if missing:
        fail("; ".join(dict.fromkeys(missing)), Exit.CHECK_FAILED)


def _show(data: dict[str, Any]) -> None:
    """The files by trace, and the comparison with UPPAAL's answers where there are any."""
    for path in data["artefacts"]:
        click.echo(f"wrote {path}")
    done = [row for row in data["traces"] if "error" not in row]
    if done:
        columns = ("trace", "events", "seconds", "accepted", "files")
        cells = [[row[name] for name in columns[:3]] + [_accepted(row), _names(row)] for row in done]
        table(f"exported for UPPAAL to {data['out']}", columns, cells)
    for row in done:
        for note in row["notes"]:
            click.echo(f"{row['trace']}: {note}")
        if row["comparison"]:
            headings = ("quantity", "native", "UPPAAL", "difference", "native 95 %", "UPPAAL 95 %", "agree", "note")
            table(f"{row['trace']}: native against UPPAAL", headings, [_cells(one) for one in row["comparison"]])


def _accepted(row: dict[str, Any]) -> str:
    return "yes" if row["accepted"] else "NO"


def _names(row: dict[str, Any]) -> str:
    return ", ".join(Path(path).name for path in row["files"])


def _cells(row: dict[str, Any]) -> list[Any]:
    spans = [f"{row[name][0]:.4g} to {row[name][1]:.4g}" for name in ("native_interval", "uppaal_interval")]
    agree = {True: "yes", False: "NO", None: ""}[row["agree"]]
    return [row["quantity"], row["native"], row["uppaal"], row["difference"], *spans, agree, row["note"]]

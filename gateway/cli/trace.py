"""`decanter trace`: make synthetic traces, look at recorded ones."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from gateway.cli.trace_can import can_log
from gateway.console.options import json_option, map_option, picture_option, seed_option
from gateway.console.output import emit, make_folder, progress, sentences, table
from gateway.console.places import shipped

if TYPE_CHECKING:
    from sim.sha.trace import Trace
    from sim.traces.load_report import LoadReport


@click.group()
def trace() -> None:
    """Make and look at traces."""


trace.add_command(can_log)


@trace.command(short_help="Write SYNTHETIC traces as CSV.")
@click.argument("names", nargs=-1)
@click.option("--all", "everything", is_flag=True, help="All scenarios cd1..cd17.")
@click.option("--days", type=click.IntRange(1, 400), help="Production over so many days instead of a scenario.")
@click.option("--cycles", type=click.IntRange(1, 48), default=4, show_default=True, help="Runs a day, with --days.")
@click.option("--period", type=click.FloatRange(0.1, 3600), default=10.0, show_default=True, help="s, with --days.")
@seed_option
@click.option("--out", type=click.Path(path_type=Path), default=Path("out/traces"), show_default=True)
@json_option
def synth(
    names: Sequence[str],
    everything: bool,
    days: int | None,
    cycles: int,
    period: float,
    seed: int,
    out: Path,
    as_json: bool,
) -> None:
    """Write SYNTHETIC traces as CSV: scenarios (cd1 cd8 ...), all of them, or production over several days.

    No plant produced them; every file says so in its first line.
    """
    from sim.plant.scenarios import SCENARIOS, production, scenario
    from sim.sha.events import DECANTER, encode
    from sim.traces.trace_file import write_trace

    wanted = list(SCENARIOS) if everything else list(names)
    if not wanted and days is None:
        raise click.UsageError("name scenarios (cd1 ... cd17), or give --all or --days N")
    with sentences(), progress("synthetic traces") as report:
        traces = []
        for index, name in enumerate(wanted):
            report(name, index / len(wanted))
            traces.append(scenario(name, seed))
        if days is not None:
            report(f"{days} days", 0.5)
            traces.append(production(days, cycles, seed=seed, period=period, name=f"production_{days}d_seed{seed}"))
        make_folder(out)
        files = [out / f"{made.name}.csv" for made in traces]
        for made, file in zip(traces, files, strict=True):
            write_trace(made, file)
    encoded = [replace(made, events=encode(made, DECANTER)) for made in traces]
    rows = [_summary(made, file) for made, file in zip(encoded, files, strict=True)]
    emit({"synthetic": True, "traces": rows}, lambda: _show_summaries("SYNTHETIC traces", rows), as_json_line=as_json)


@trace.command(short_help="Load traces; say what was used, what was refused and why.")
@click.argument("paths", nargs=-1, required=True)
@map_option
@picture_option
@json_option
def show(paths: Sequence[str], map_name: str, picture: Path | None, as_json: bool) -> None:
    """Load traces (files, a folder or a glob) by a column map; say what was used, what was refused and why."""
    from sim.traces.column_map import load_map
    from sim.traces.traces import load_traces

    with sentences():
        column_map = load_map(shipped("traces", map_name))
        traces, report = load_traces(paths[0] if len(paths) == 1 else list(paths), column_map)
        if picture is not None:
            units = {name: signal.unit for name, signal in column_map.signals.items()}
            _draw(traces[0], column_map.temperature, units, picture)
    rows = [_summary(each, None) for each in traces]
    data = {"traces": rows, "report": report.as_table(), "picture": picture and str(picture)}

    def show_all() -> None:
        _show_summaries("traces", rows)
        _show_report(report)
        if picture is not None:
            click.echo(f"picture: {picture}")

    emit(data, show_all, as_json_line=as_json)


def _summary(made: "Trace", file: Path | None) -> dict[str, Any]:
    import numpy as np

    return {
        "name": made.name,
        "file": file and str(file),
        "synthetic": made.synthetic,
        "rows": made.times.size,
        "seconds": float(made.times[-1] - made.times[0]) if made.times.size else 0.0,
        "events": len(made.events),
        "signals": {
            name: [float(np.nanmin(column)), float(np.nanmax(column))]
            for name, column in made.signals.items()
            if not np.all(np.isnan(column))
        },
    }


def _show_summaries(title: str, rows: Sequence[dict[str, Any]]) -> None:
    columns = ("name", "rows", "seconds", "events", "file")
    table(
        title, columns, [[row["name"], row["rows"], row["seconds"], row["events"], row["file"] or ""] for row in rows]
    )
    for row in rows if len(rows) <= 3 else ():
        ranges = [[name, low, high] for name, (low, high) in row["signals"].items()]
        table(f"{row['name']}: ranges", ("signal", "lowest", "highest"), ranges)


def _show_report(report: "LoadReport") -> None:
    for sentence in report.sentences():
        click.echo(sentence)


def _draw(first: "Trace", temperature: str, units: Mapping[str, str], picture: Path) -> None:
    import numpy as np

    from sim.validation.plots import Curve, Picture, draw

    def curve(name: str) -> Curve:
        there = ~np.isnan(first.signals[name])
        return Curve(name, first.times[there], first.signals[name][there])

    others = [
        name for name in first.signals if name != temperature and not set(np.unique(first.signals[name])) <= {0.0, 1.0}
    ]
    note = "SYNTHETIC: not measured on a plant" if first.synthetic else first.origin
    draw(
        Picture(
            first.name,
            curve(temperature),
            inputs=[curve(name) for name in others[:3]],
            events=first.events,
            note=note,
            units=units,
        ),
        picture,
    )

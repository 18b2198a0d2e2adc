"""`decanter trace show`: recorded traces, and what was refused of them and why."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import click
import numpy as np

from gateway.console import emit, json_option, map_option, shipped
from gateway.entry import sentences
from gateway.lab.traces.picture import picture_option
from gateway.lab.traces.summary import show_summaries, summary_of
from sim.sha import Trace
from sim.traces import load_map, load_traces
from sim.validation import Curve, Picture, draw


@click.command(short_help="Load traces; say what was used, what was refused and why.")
@click.argument("paths", nargs=-1, required=True)
@map_option
@picture_option
@json_option
def show(paths: Sequence[str], map_name: str, picture: Path | None, as_json: bool) -> None:
    """Load traces (files, a folder or a glob) by a column map; say what was used, what was refused and why."""
    with sentences():
        column_map = load_map(shipped("traces", map_name))
        traces, report = load_traces(paths[0] if len(paths) == 1 else list(paths), column_map)
        if picture is not None:
            units = {name: signal.unit for name, signal in column_map.signals.items()}
            _draw(traces[0], column_map.temperature, units, picture)
    rows = [summary_of(each, None) for each in traces]
    data = {"traces": rows, "report": report.as_table(), "picture": picture and str(picture)}

    def show_all() -> None:
        show_summaries("traces", rows)
        for sentence in report.sentences():
            click.echo(sentence)
        if picture is not None:
            click.echo(f"picture: {picture}")

    emit(data, show_all, as_json_line=as_json)


def _draw(first: Trace, temperature: str, units: Mapping[str, str], picture: Path) -> None:
    def curve(name: str) -> Curve:
        present = ~np.isnan(first.signals[name])
        return Curve(name, first.times[present], first.signals[name][present])

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

"""`decanter trace show`: recorded traces, and what was refused of them and why."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from gateway.console import CommandResult, Part, conclude, shipped_file
from gateway.entry import sentences
from gateway.lab.traces.summary import show_summaries, trace_summary
from sim.lab.pictures import Curve, Picture, draw
from sim.lab.recordings import load_map, load_traces

MOST_INPUTS = 3
"""Inputs that are drawn below the temperature."""


def show(paths: Sequence[str], map_name: str, picture: Path | None, as_json: bool) -> None:
    """The work of `trace show`."""
    with sentences():
        column_map = load_map(shipped_file("traces", map_name))
        traces, report = load_traces(paths[0] if len(paths) == 1 else list(paths), column_map)
        if picture is not None:
            first, temperature = traces[0], column_map.temperature
            present = {name: ~np.isnan(column) for name, column in first.signals.items()}
            curves = {
                name: Curve(name, first.times[present[name]], column[present[name]])
                for name, column in first.signals.items()
            }
            # Flags are left out: the events show them, and a curve of 0 and 1 takes a panel for itself.
            inputs = [
                curve
                for name, curve in curves.items()
                if name != temperature and not set(np.unique(first.signals[name])) <= {0.0, 1.0}
            ]
            drawn = Picture(
                first.name,
                curves[temperature],
                inputs=inputs[:MOST_INPUTS],
                events=first.events,
                note="SYNTHETIC: not measured on a plant" if first.synthetic else first.origin,
                units={name: signal.unit for name, signal in column_map.signals.items()},
            )
            draw(drawn, picture)
    rows = [trace_summary(trace, None) for trace in traces]
    data = {"traces": rows, "report": report.as_table(), "picture": picture and str(picture)}

    def show_all() -> Iterator[Part]:
        yield from show_summaries("traces", rows)
        yield from report.sentences()
        if picture is not None:
            yield f"picture: {picture}"

    conclude(CommandResult(data), lambda _: show_all(), as_json=as_json)

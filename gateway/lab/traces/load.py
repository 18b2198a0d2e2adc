"""Traces for the commands: read by a column map, with what was refused said on standard error."""

from collections.abc import Sequence

import click

from gateway.console import shipped
from sim.sha import Trace
from sim.traces import ColumnMap, load_map, load_traces


def load(paths: Sequence[str], map_name: str) -> tuple[list[Trace], ColumnMap]:
    """Encoded traces by a column map; what was refused goes to standard error. Raises ValueError."""
    column_map = load_map(shipped("traces", map_name))
    traces, report = load_traces(paths[0] if len(paths) == 1 else list(paths), column_map)
    if report.refused or report.errors:
        for sentence in report.sentences():
            click.secho(sentence, fg="yellow", err=True)
    return traces, column_map

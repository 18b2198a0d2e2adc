"""Traces for the commands: read by a column map, with what was refused said on standard error."""

from collections.abc import Sequence

import click

from gateway.console import shipped_file
from sim.lab.recordings import ColumnMap, LoadReport, channel_uses, load_map, load_traces
from sim.sha import Alphabet, Trace


def load(paths: Sequence[str], map_name: str) -> tuple[list[Trace], ColumnMap]:
    """Encoded traces by a column map, and the map with the thresholds that they decided. Raises ValueError.

    What was refused of them, or understood otherwise than it stands there, goes to standard error.
    """
    traces, column_map, _ = load_with_report(paths, map_name)
    return traces, column_map


def load_with_report(paths: Sequence[str], map_name: str) -> tuple[list[Trace], ColumnMap, LoadReport]:
    """As `load`, with what became of every file."""
    column_map = load_map(shipped_file("traces", map_name))
    traces, report = load_traces(paths[0] if len(paths) == 1 else list(paths), column_map)
    for sentence in report.sentences() if report.refused or report.errors else report.warnings:
        click.secho(sentence, fg="yellow", err=True)
    return traces, column_map.model_copy(update={"alphabet": report.alphabet}), report


def channel_warnings(traces: Sequence[Trace], alphabet: Alphabet) -> list[str]:
    """What of the alphabet these traces cannot teach, one sentence a channel, also said on standard error.

    Raises ValueError where they have none of its signals.
    """
    warnings = [use.sentence for use in channel_uses(traces, alphabet) if use.sentence]
    for warning in warnings:
        click.secho(f"warning: {warning}", fg="yellow", err=True)
    return warnings

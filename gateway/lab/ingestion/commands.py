"""The options of what takes files in and their help; the work is loaded when it is asked for."""

from pathlib import Path
from typing import Any

import click

from gateway.console import json_option, map_option


@click.command("import", short_help="Take a recording into a historian; what is there already must agree.")
@click.argument("paths", nargs=-1, required=True)
@map_option
@click.option(
    "--historian", "path", type=click.Path(path_type=Path), required=True, help="The historian's file; made if absent."
)
@click.option("--machine", default="", help="The machine that the rows are of.  [default: as the map says]")
@json_option
def import_command(**given: Any) -> None:
    """Take recordings (files, a folder or a glob), read as `trace show` reads them, into a historian.

    Retraining, cycles, familiarity and diagnosis can then be used on them. A sample is stored by the law of a running
    gateway. A second import of the same stores nothing; rows that contradict what is there are refused, and so are
    those before the machine's newest ones.
    """
    from gateway.lab.ingestion.into_historian import import_command as work

    work(**given)


@click.command(
    "ingest", short_help="Take a folder's files into an archive: recognised, copied, listed; doubles refused."
)
@click.argument("folder", type=click.Path(path_type=Path))
@click.option("--into", "archive", type=click.Path(path_type=Path), default=Path("archive"), show_default=True)
@click.option(
    "--map",
    "map_names",
    multiple=True,
    help="Column map that reads the traces; may be given again  [all shipped ones].",
)
@click.option("--move", is_flag=True, help="Remove what was taken from FOLDER; without it, it is copied.")
@click.option("--dry-run", is_flag=True, help="Say what would become of each file, and write nothing.")
@click.option("--watch", is_flag=True, help="Go on until Ctrl-C: take what comes into FOLDER when it is at rest.")
@click.option(
    "--every", type=click.FloatRange(0.05), default=10.0, show_default=True, help="With --watch: s between two looks."
)
@click.option(
    "--rest", type=click.FloatRange(0.0), default=60.0, show_default=True, help="With --watch: s without a change."
)
@click.option("--for", "seconds", type=click.FloatRange(0.0), help="With --watch: stop after so many seconds.")
@json_option
def ingest(**given: Any) -> None:
    """Take what lies in FOLDER into an archive, each file by its kind: traces, artefact sets, flow files, PLC
    recordings, historians, CAN logs, plots.

    Every file is read by the program's own reader of its kind; what none reads, what is there already by content, and
    a name that another content has are refused, in one sentence each, and the exit code is 1. The archive's
    manifest.jsonl has a row for each. Killed at any moment, the same command goes on.
    """
    from gateway.lab.ingestion.ingest import ingest as work

    work(**given)

"""The options of `model learn fleet` and its help; the work is loaded when it is asked for."""

from pathlib import Path
from typing import Any

import click

from gateway.console import json_option, map_option, seed_option
from gateway.lab.options import cluster_option, jobs_option, temperature_option


@click.command("fleet", short_help="Learn a type's model from many machines; say which stands out.")
@click.argument("place")
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), required=True, help="The folder to write.")
@map_option
@temperature_option
@click.option("--schema", default="decanter", show_default=True, help="Of a database: the schema of its samples.")
@click.option(
    "--sample", type=click.IntRange(1), default=12, show_default=True, help="Machines that teach the type's model."
)
@click.option("--own", is_flag=True, help="Learn a model of each machine's own too.")
@click.option("--diagnose", "diagnosis", is_flag=True, help="Diagnose each machine against its corrected type.")
@jobs_option
@cluster_option
@seed_option
@json_option
def fleet(**given: Any) -> None:
    """Learn one model from machines of a type, each machine's own targets, and say which machine stands out.

    PLACE is a folder or glob of traces (whose machine the map tells), a Parquet file of `samples` that `decanter
    historian export` wrote, or a PostgreSQL address (postgresql://...) with the table that [[northbound.postgres]]
    fills. Each machine's result is kept in --out as soon as it is there, and the same command goes on after a kill.
    What is held out is the last quarter of each machine's record.
    """
    from gateway.lab.fleet.fleet import fleet as work

    work(**given)

"""`decanter model simulate`: a model let run along measured traces, and how far off it comes out."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from gateway.cli.options import json_option, map_option, picture_option, seed_option
from gateway.cli.output import emit, fail, progress, sentences, table
from gateway.cli.traces import load

if TYPE_CHECKING:
    from sim.sha.open_loop import Start
    from sim.sha.schedule import Policy


@click.command(short_help="Let a model run along measured traces; say how far off it is.")
@click.argument("directory")
@click.option("--trace", "paths", multiple=True, required=True, help="A file, a folder or a glob; may be given again.")
@map_option
@click.option(
    "--runs", type=click.IntRange(2, 1_000_000), default=1000, show_default=True, help="Stochastic runs a trace."
)
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
@seed_option
@picture_option
@json_option
def simulate(
    directory: str,
    paths: Sequence[str],
    map_name: str,
    runs: int,
    policy: "Policy",
    start: "Start",
    seed: int,
    picture: Path | None,
    as_json: bool,
) -> None:
    """Let a model run along measured traces (open loop) and say how far off it comes out.

    Errors are given at all readings, at the events (the thesis's way) and for the last reading, apart; the band is
    that of the stochastic runs, the sensor's noise included.
    """
    from gateway.cli.simulation import simulate_traces
    from sim.artefacts.find import find_model

    with sentences(), progress("simulating") as report:
        traces, column_map = load(paths, map_name)
        found = find_model(directory, alphabet=column_map.alphabet, temperature=column_map.temperature)
        chosen = found.runnable()
        rows = simulate_traces(
            chosen, traces, runs=runs, policy=policy, start=start, seed=seed, picture=picture, report=report
        )
    data = {"model": chosen.sha.name, "traces": rows, "picture": picture and str(picture)}

    def show_rows() -> None:
        columns = ("trace", "events", "rmse", "mae", "rmse at events", "final", "coverage 90 %", "clamps", "flags")
        done = [[row[name] for name in columns] for row in rows if "error" not in row]
        if done:
            table("open loop (°C)", columns, done)
        if picture is not None:
            click.echo(f"picture: {picture}")

    emit(data, show_rows, as_json_line=as_json)
    if any("error" in row for row in rows):
        fail("; ".join(str(row["error"]) for row in rows if "error" in row))

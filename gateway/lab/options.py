"""Options that several commands of the laboratory share."""

from pathlib import Path
from typing import Literal, get_args

import click

Method = Literal["bins", "lsha"]
"""How a model is learned."""
Rating = Literal["badly predicted", "rare", "near a difficult one", "ordinary"]
RATINGS: tuple[Rating, ...] = get_args(Rating)
"""What a cycle is rated as, the one that teaches most first."""
MOST_MOMENTS = 1000
"""Forecasts of a trace at most, unless somebody asks for more: each takes some ten milliseconds, rivals as much."""
historian_option = click.option(
    "--historian", type=click.Path(path_type=Path), required=True, help="The gateway's historian."
)
jobs_option = click.option("--jobs", type=click.IntRange(1), help="Worker processes.  [default: one a core]")
library_option = click.option(
    "--library", "folder", type=click.Path(path_type=Path), help="Its cycles  [cycles beside the historian]."
)
method_option = click.option("--method", type=click.Choice(get_args(Method)), default="bins", show_default=True)
optional_traces_option = click.option(
    "--traces", "paths", multiple=True, help="A file, a folder or a glob; may be given again."
)
policy_option = click.option(
    "--policy",
    type=click.Choice(["reject", "ignore", "resync"]),
    default="resync",
    show_default=True,
    help="An event without an edge.",
)
cluster_option = click.option(
    "--cluster", "address", help="Work on the Dask cluster whose scheduler is at this address (tcp://...)."
)
start_option = click.option(
    "--start", type=click.Choice(["measured", "law"]), default="measured", show_default=True, help="First temperature."
)
temperature_option = click.option(
    "--temperature", metavar="SIGNAL", help="The signal that is predicted.  [default: the map's]"
)
trace_option = click.option("--trace", "paths", multiple=True, help="A file, a folder or a glob; may be given again.")
traces_option = click.option(
    "--traces", "paths", multiple=True, required=True, help="A file, a folder or a glob; may be given again."
)


def _drawable(_: click.Context, __: click.Parameter, path: Path | None) -> Path | None:
    """Refuse what cannot be drawn before anything is computed."""
    if path is None:
        return None
    from sim.lab.pictures import PICTURE_SUFFIXES

    if path.suffix.lower() not in PICTURE_SUFFIXES:
        raise click.BadParameter(f"{str(path)!r} is no picture; give a name that ends in {', '.join(PICTURE_SUFFIXES)}")
    return path


picture_option = click.option(
    "--picture",
    type=click.Path(path_type=Path, dir_okay=False),
    callback=_drawable,
    help="Also draw the first trace to this file.",
)

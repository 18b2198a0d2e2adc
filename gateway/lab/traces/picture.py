"""The option --picture of commands that draw a trace."""

from pathlib import Path

import click

from sim.lab.pictures import PICTURE_SUFFIXES


def _drawable(_: click.Context, __: click.Parameter, path: Path | None) -> Path | None:
    """Refuse what cannot be drawn before anything is computed."""
    if path is not None and path.suffix.lower() not in PICTURE_SUFFIXES:
        raise click.BadParameter(f"{str(path)!r} is no picture; give a name that ends in {', '.join(PICTURE_SUFFIXES)}")
    return path


picture_option = click.option(
    "--picture",
    type=click.Path(path_type=Path, dir_okay=False),
    callback=_drawable,
    help="Also draw the first trace to this file.",
)

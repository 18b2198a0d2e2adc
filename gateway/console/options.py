"""Options that several commands share."""

from math import isfinite
from pathlib import Path

import click

map_option = click.option(
    "--map",
    "map_name",
    default="decanter",
    show_default=True,
    help="Column map: a TOML file, or a name in config/traces.",
)
json_option = click.option("--json", "as_json", is_flag=True, help="One JSON object instead of text.")
seed_option = click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="0 is the reference.")


def finite(_: click.Context, __: click.Parameter, number: float | None) -> float | None:
    """Refuse `nan`, which no range keeps out."""
    if number is not None and not isfinite(number):
        raise click.BadParameter(f"{number} is no finite number")
    return number


def _drawable(_: click.Context, __: click.Parameter, path: Path | None) -> Path | None:
    """Refuse what cannot be drawn before anything is computed."""
    if path is not None:
        from sim.validation.plots import ENDINGS

        if path.suffix.lower() not in ENDINGS:
            raise click.BadParameter(f"{str(path)!r} is no picture; give a name that ends in {', '.join(ENDINGS)}")
    return path


picture_option = click.option(
    "--picture",
    type=click.Path(path_type=Path, dir_okay=False),
    callback=_drawable,
    help="Also draw the first trace to this file.",
)

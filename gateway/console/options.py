"""Options that several commands share."""

from math import isfinite

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

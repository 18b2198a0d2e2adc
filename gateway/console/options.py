"""Options that several commands share."""

from collections.abc import Callable
from math import isfinite
from pathlib import Path
from typing import Any

import click

map_option = click.option(
    "--map",
    "map_name",
    default="decanter",
    show_default=True,
    help="Column map: a TOML file, or a name in config/traces.",
)
historian_machine_option = click.option(
    "--machine", metavar="NAME", help="Of a historian that has several machines: which one's rows."
)
json_option = click.option("--json", "as_json", is_flag=True, help="One JSON object instead of text.")
socket_option = click.option(
    "--socket",
    type=click.Path(path_type=Path),
    help="The running gateway's control socket.  [default: as the plant file says]",
)
seed_option = click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="0 is the reference.")


def renamed_option(old: str, now: str) -> Callable[[Any], Any]:
    """The command with an option's name of the last release, hidden: who gives it is told what to type now."""

    def answer(_: click.Context, __: click.Parameter, given: str | None) -> None:
        if given is not None:
            raise click.UsageError(f"{old} has another name now: {now}")

    return click.option(old, hidden=True, expose_value=False, callback=answer)


def finite(_: click.Context, __: click.Parameter, number: float | None) -> float | None:
    """Refuse `nan`, which no range keeps out."""
    if number is not None and not isfinite(number):
        raise click.BadParameter(f"{number} is no finite number")
    return number

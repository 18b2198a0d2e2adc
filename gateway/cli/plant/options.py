"""Options of the commands that read a plant file: the one named, or the one of the folder they are called in."""

from pathlib import Path
from typing import Any

import click

from gateway.console import find_plant_file
from gateway.entry import fail


def config_option(command: Any) -> Any:
    """The command with --config; it gets `path`, which is None only while the command line is looked through."""

    def find_default(context: click.Context, _: click.Parameter, given: Path | None) -> Path | None:
        # While a line is being completed or its help is shown, nothing has to be there.
        if given is not None or context.resilient_parsing:
            return given
        try:
            return find_plant_file()
        except ValueError as error:
            fail(str(error))

    return click.option(
        "--config",
        "path",
        type=click.Path(path_type=Path),
        callback=find_default,
        help="The gateway's configuration (TOML).  "
        "[default: ./plant.toml, ./config/plant.toml, /etc/decanter/plant.toml]",
    )(command)


by_option = click.option("--by", default="", envvar="DECANTER_BY", help="Who does it.  [default: the login]")
machine_option = click.option(
    "--machine", metavar="NAME", help="One machine of several.  [default: the only one, else all]"
)

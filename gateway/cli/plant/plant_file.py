"""The plant file of the commands that read one: the one named, or the one of the folder they are called in."""

from pathlib import Path
from typing import Any

import click

from drivers.settings import with_place
from gateway.console import find_plant_file
from gateway.entry import fail
from gateway.outside.status import connect
from gateway.settings import Config, gateway_places, load_plant


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


def control_socket(path: Path, given: Path | None) -> Path:
    """Where the running gateway can be asked: at the socket that is named, or where the plant file says.

    A file that cannot be used any more is no obstacle, as the gateway runs by what it was: that is said on standard
    error. Raises ConfigError for such a file where no gateway is found.
    """
    if given is not None:
        return given
    places = gateway_places(path)
    if places.problem is not None:
        if (line := connect(places.socket)) is None:
            raise places.problem
        line.close()
        click.echo(f"{places.problem}; the gateway that runs at {places.socket} is asked all the same", err=True)
    return places.socket


def load(path: Path, host: str | None, port: int | None, speed: float | None) -> tuple[Config, ...]:
    """The configurations of all machines with what the command line replaces. Raises ConfigError (a ValueError)."""
    place = {key: value for key, value in (("host", host), ("port", port)) if value is not None}
    overrides = {f"device.{key}": value for key, value in (with_place(place) if host else place).items()}
    return load_plant(path, overrides if speed is None else {**overrides, "clock.speed": speed})

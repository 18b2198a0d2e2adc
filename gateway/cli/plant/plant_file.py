"""What commands take from a plant file: where its gateway can be asked, and the configurations of its machines."""

from pathlib import Path

import click

from drivers.settings import with_place
from gateway.outside.status import connect
from gateway.settings import Config, gateway_places, load_plant


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

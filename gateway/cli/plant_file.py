"""The plant file that `decanter run` and `decanter check` take, with what the command line replaces in it."""

from pathlib import Path
from typing import Any

import click

from gateway.console import config_dir
from gateway.settings import Config, load_config


def config_option(command: Any) -> Any:
    """The command with --config; it gets `path`."""
    return click.option(
        "--config",
        "path",
        type=click.Path(path_type=Path),
        default=lambda: config_dir() / "plant.toml",
        show_default="config/plant.toml",
        help="The gateway's configuration (TOML).",
    )(command)


def load(path: Path, host: str | None, port: int | None, speed: float | None) -> Config:
    """The configuration with what the command line replaces. Raises ConfigError (a ValueError)."""
    overrides = {"device.host": host, "device.port": port, "clock.speed": speed}
    return load_config(path, {key: value for key, value in overrides.items() if value is not None})

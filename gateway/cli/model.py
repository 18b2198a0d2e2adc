"""`decanter model`: the model laboratory, one module a command."""

import click

from gateway.cli.lazy import LazyGroup, Table

COMMANDS: Table = {
    "learn": ("gateway.cli.learn:learn", "Learn a model from traces and write its directory."),
    "show": ("gateway.cli.show:show", "Show a model and where it comes from."),
    "simulate": ("gateway.cli.simulate:simulate", "Let a model run along measured traces; say how far off it is."),
}


@click.group(cls=LazyGroup, table=COMMANDS)
def model() -> None:
    """Learn, look at, validate and check models."""

"""`decanter config`: the configurations that a gateway has taken over, and the way back to one of them."""

import click

from gateway.entry import LazyGroup, Table

COMMANDS: Table = {
    "history": ("gateway.cli.keep.configurations:history", "List the configurations that were taken over."),
    "diff": (
        "gateway.cli.keep.configurations:diff",
        "Show what differs between two configurations, or to the files now.",
    ),
    "rollback": (
        "gateway.cli.keep.configurations:rollback",
        "Put the files of a former configuration back, never armed.",
    ),
}
EXAMPLES = {
    "history": "config history --config plant.toml",
    "diff": "config diff 3 --config plant.toml",
    "rollback": "config rollback 3 --reason 'the new limit was wrong' --config plant.toml",
}


@click.group(cls=LazyGroup, table=COMMANDS, examples=EXAMPLES)
def config() -> None:
    """A gateway's former configurations."""

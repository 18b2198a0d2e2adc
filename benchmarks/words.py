"""How much there is to learn: leaf commands, and places where an option is listed in a help text."""

import click

from benchmarks.figures import Figure, give
from gateway.cli.main import main as decanter
from gateway.connection import SharedOption, shared_options
from gateway.entry import LazyGroup

BEFORE = {"leaf commands": 48, "option places": 777}
"""Before `check`, `scan`, `write`, `loop`, `conformance` and the connection's options were drawn together."""


def commands(group: LazyGroup) -> list[click.Command]:
    """Every command of the group and of its groups, old names aside."""
    context = click.Context(group)
    found: list[click.Command] = []
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        if isinstance(command, LazyGroup):
            found += commands(command)
        elif command is not None:
            found.append(command)
    return found


def measure() -> list[Figure]:
    """The counts now, against those before."""
    leaves = commands(decanter)
    options = [
        param for leaf in leaves for param in leaf.params if isinstance(param, click.Option) and not param.hidden
    ]
    listed = [option for option in options if not isinstance(option, SharedOption)]
    shared = sum(map(len, shared_options()))
    return [
        Figure("leaf commands", len(leaves), "", "before", BEFORE["leaf commands"]),
        Figure("option places in help texts", len(listed) + shared, "", "before", BEFORE["option places"]),
        Figure("options that commands take", len(options), "", "before", BEFORE["option places"]),
    ]


@click.command(help=__doc__)
@click.option("--json", "as_json", is_flag=True, help="One JSON object instead of a table.")
def main(as_json: bool) -> None:
    give("words", measure(), as_json=as_json)


if __name__ == "__main__":
    main()

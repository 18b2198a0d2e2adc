"""How much there is to learn: leaf commands, and places where an option is listed in a help text."""

import click

from benchmarks.figures import Figure, give
from gateway.cli.main import main as decanter
from gateway.commission.options import SharedOption, shared_options
from gateway.entry import FirstWordCommand, LazyGroup

BEFORE = {"commands": 81, "places": 538, "options": 914}
"""Before `plc check`, `model judge`, `model version`, `keep` and `top` took in what asks the same in other ways."""


def leaves(group: LazyGroup) -> list[click.Command]:
    """Every command of the group and of its groups, former names aside; one that does several works is one."""
    context = click.Context(group)
    found: list[click.Command] = []
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        if isinstance(command, LazyGroup):
            found += leaves(command)
        elif command is not None:
            found.append(command)
    return found


def works(command: click.Command) -> list[click.Command]:
    """What a command does by its first word, each with a help of its own; else the command."""
    if not isinstance(command, FirstWordCommand):
        return [command]
    return [command.get_command(click.Context(command), word) for word in command.table]


def taken_options(command: click.Command) -> list[click.Option]:
    """The options that a command takes: of one that does several works those of all, each once."""
    options = [each for work in works(command) for each in work.params if isinstance(each, click.Option)]
    return list({option.opts[0]: option for option in options if not option.hidden}.values())


def measure() -> list[Figure]:
    """The counts now, against those before."""
    found = leaves(decanter)
    pages = [work for leaf in found for work in works(leaf)]
    listed = [option for page in pages for option in taken_options(page) if not isinstance(option, SharedOption)]
    shared = sum(
        not option.hidden for group in shared_options() for option in group if isinstance(option, click.Option)
    )
    return [
        Figure("leaf commands", len(found), "", "before", BEFORE["commands"]),
        Figure("help texts of commands and of their works", len(pages), "", "before", BEFORE["commands"]),
        Figure("option places in help texts", len(listed) + shared, "", "before", BEFORE["places"]),
        Figure(
            "options that commands take",
            sum(len(taken_options(each)) for each in found),
            "",
            "before",
            BEFORE["options"],
        ),
    ]


@click.command(help=__doc__)
@click.option("--json", "as_json", is_flag=True, help="One JSON object instead of a table.")
def main(as_json: bool) -> None:
    give("words", measure(), as_json=as_json)


if __name__ == "__main__":
    main()

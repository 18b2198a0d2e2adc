"""A group whose commands are modules, imported when one of them is asked for, so that help answers at once."""

from collections.abc import Mapping
from importlib import import_module
from typing import Any

import click

from gateway.entry.exits import Exit, fail

Table = Mapping[str, tuple[str, str]]
"""Command name -> ("module:attribute", its line in the help text)."""


class LazyGroup(click.Group):
    """A click group with a table of commands that are not imported for the help text, in the table's order.

    `renamed` are names of the last release with what to type now: they run nothing and say so, with exit code 2.
    """

    def __init__(self, *args: Any, table: Table, renamed: Mapping[str, str] | None = None, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.table = table
        self.renamed = renamed or {}

    def list_commands(self, ctx: click.Context) -> list[str]:
        """The names in the order of the table."""
        return list(self.table)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """The command, or None for a name that is not in the table."""
        if cmd_name in self.renamed:
            return _renamed(f"{ctx.command_path} {cmd_name}", self.renamed[cmd_name])
        if cmd_name not in self.table:
            return None
        place = self.table[cmd_name][0]
        module, _, attribute = place.partition(":")
        command = getattr(import_module(module), attribute)
        if not isinstance(command, click.Command):
            raise TypeError(f"{place} is no command")
        return command

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command; Control-C that it has no words of its own for ends it with a sentence and its code."""
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            if ctx.find_root().params.get("traceback"):
                raise
            fail("stopped before the end", Exit.INTERRUPTED)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """The list in the help text, from the table: no command is imported for it."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, text) for name, (_, text) in self.table.items()])


def _renamed(name: str, now: str) -> click.Command:
    """The command of an earlier release: whatever it is given, it says what to type now."""

    @click.command(name, hidden=True, context_settings={"ignore_unknown_options": True}, add_help_option=False)
    @click.argument("arguments", nargs=-1, type=click.UNPROCESSED)
    def answer(arguments: tuple[str, ...]) -> None:
        fail(f"`{name}` has another name now: {now}; nothing was done")

    return answer

"""A group whose commands are modules, imported when one of them is asked for, so that help answers at once."""

import sys
from collections.abc import Mapping, Sequence
from functools import partial
from importlib import import_module
from typing import Any

import click

from drivers.errors import did_you_mean
from gateway.entry.exits import Exit, fail, run_command
from gateway.entry.interrupt import control_c
from gateway.entry.threads import one_thread

Table = Mapping[str, tuple[str, str]]
"""Command name -> ("module:attribute", its line in the help text)."""


class LazyGroup(click.Group):
    """A click group with a table of commands that are not imported for the help text, in the table's order.

    Groups that are added to it (`add_command`) come after them, with the names of their own commands. `examples` are
    one command line a command, without the program's name; the command's help ends with it.
    `elsewhere` are names that commands had, or that people look for here, with what to type: they run nothing and say
    so, with exit code 2.
    """

    def __init__(
        self,
        *args: Any,
        table: Table,
        examples: Mapping[str, str] | None = None,
        elsewhere: Mapping[str, str] | None = None,
        **kwargs: Any,
    ) -> None:
        super().__init__(*args, **kwargs)
        self.table = table
        self.examples = examples or {}
        self.elsewhere = elsewhere or {}

    def main(
        self,
        args: Sequence[str] | None = None,
        prog_name: str | None = None,
        complete_var: str | None = None,
        standalone_mode: bool = True,
        **extra: Any,
    ) -> Any:
        """Run the program: every error is one sentence, with --json also one object, and an exit code."""
        # Here and not in the group's own function: click imports the command that is asked for before it calls that.
        one_thread()
        if not standalone_mode:
            return super().main(args, prog_name, complete_var, False, **extra)
        run = partial(super().main, prog_name=prog_name, complete_var=complete_var, **extra)
        return run_command(run, sys.argv[1:] if args is None else args)

    def list_commands(self, ctx: click.Context) -> list[str]:
        """The names in the order of the table, then those of the groups."""
        return [*self.table, *self.commands]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """The command, or None for a name that is not in the table."""
        if cmd_name in self.elsewhere:
            return _elsewhere(f"{ctx.command_path} {cmd_name}", self.elsewhere[cmd_name])
        if cmd_name not in self.table:
            return self.commands.get(cmd_name)
        place = self.table[cmd_name][0]
        module, _, attribute = place.partition(":")
        command = getattr(import_module(module), attribute)
        if not isinstance(command, click.Command):
            raise TypeError(f"{place} is no command")
        if cmd_name in self.examples:
            command.epilog = f"\b\nExample:\n  decanter {self.examples[cmd_name]}"
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """The command that the words begin with. Raises UsageError, with the name that may have been meant."""
        name = args[0]
        if self.get_command(ctx, name) is None and not ctx.resilient_parsing and not name.startswith("-"):
            there = [
                f"`{ctx.find_root().info_name} {group} {name}`"
                for group, commands in self.commands.items()
                if isinstance(commands, LazyGroup) and name in (*commands.table, *commands.elsewhere)
            ]
            meant = f"there is {' and '.join(there)}" if there else did_you_mean(name, self.list_commands(ctx))
            ctx.fail(f"No such command {name!r}; {meant}".rstrip("; "))
        return super().resolve_command(ctx, args)

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command; Control-C that it has no words of its own for ends it with a sentence and its code."""
        try:
            with control_c():
                return super().invoke(ctx)
        except KeyboardInterrupt:
            if ctx.find_root().params.get("traceback"):
                raise
            fail("stopped before the end", Exit.INTERRUPTED)

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """The options; where there are groups too, in one line, so that all commands fit on a screen."""
        if not self.commands:
            super().format_options(ctx, formatter)
            return
        records = filter(None, (option.get_help_record(ctx) for option in self.get_params(ctx)))
        formatter.write_paragraph()
        formatter.write_text(f"Options: {', '.join(names for names, _ in records)}")
        self.format_commands(ctx, formatter)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """The list in the help text, from the table: no command is imported for it."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, text) for name, (_, text) in self.table.items()], col_max=12)
        groups = [
            (name, f"{group.get_short_help_str(80)} {', '.join(group.table)}")
            for name, group in self.commands.items()
            if isinstance(group, LazyGroup)
        ]
        if groups:
            with formatter.section("Groups of commands"):
                formatter.write_dl(groups, col_max=12)


def _elsewhere(name: str, now: str) -> click.Command:
    """The command with another name now: whatever it is given, it says what to type."""

    @click.command(name, hidden=True, context_settings={"ignore_unknown_options": True}, add_help_option=False)
    @click.argument("arguments", nargs=-1, type=click.UNPROCESSED)
    def answer(arguments: tuple[str, ...]) -> None:
        fail(f"`{name}` has another name now: {now}; nothing was done")

    return answer

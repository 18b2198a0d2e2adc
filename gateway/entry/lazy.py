"""Commands that are modules, imported when one of them is asked for, so that help answers at once."""

import sys
from collections.abc import Mapping, Sequence
from functools import partial
from importlib import import_module
from typing import Any

import click
from click.shell_completion import CompletionItem

from drivers.errors import did_you_mean
from gateway.entry.exits import Exit, fail, run_command
from gateway.entry.former import FormerName
from gateway.entry.interrupt import control_c
from gateway.entry.threads import one_thread

Table = Mapping[str, tuple[str, str]]
"""Command name -> ("module:attribute", its line in the help text)."""


def load_command(place: str, example: str = "") -> click.Command:
    """The command at "module:attribute"; its help ends with the example, a command line without the program's name.

    Raises TypeError where no command is.
    """
    module, _, attribute = place.partition(":")
    command = getattr(import_module(module), attribute)
    if not isinstance(command, click.Command):
        raise TypeError(f"{place} is no command")
    return _with_example(command, example)


def _with_example(command: click.Command, example: str) -> click.Command:
    if example:
        listed = dict.fromkeys(getattr(option, "listed_by", "") for option in command.params)
        places = "".join(f"{where}\n\n" for where in listed if where)
        command.epilog = f"{places}\b\nExample:\n  decanter {example}"
    return command


class LazyGroup(click.Group):
    """A click group with a table of commands that are not imported for the help text, in the table's order.

    Groups that are added to it (`add_command`) come after them, with the names of their own commands. `examples` are
    one command line a command, without the program's name; the command's help ends with it.
    `elsewhere` are names that people look for here, with what to type: they run nothing and say so, with exit code 2.
    `former`, of the program's own group, are the names that commands had in the last release, by the words that are
    typed for them now: they run, are in no help, and say their new name once.
    """

    def __init__(
        self,
        *args: Any,
        table: Table,
        examples: Mapping[str, str] | None = None,
        elsewhere: Mapping[str, str] | None = None,
        former: Mapping[str, str] | None = None,
        **kwargs: Any,
    ) -> None:
        super().__init__(*args, **kwargs)
        self.table = table
        self.examples = examples or {}
        self.elsewhere = elsewhere or {}
        self.former = former or {}

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
        if cmd_name in self.table:
            return load_command(self.table[cmd_name][0], self.examples.get(cmd_name, ""))
        if cmd_name in self.commands:
            return _with_example(self.commands[cmd_name], self.examples.get(cmd_name, ""))
        former = " ".join([*_words(ctx), cmd_name])
        now = _former_names(ctx).get(former)
        return None if now is None else FormerName(cmd_name, former=former, now=now)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """The command that the words begin with. Raises UsageError, with the name that may have been meant."""
        name = args[0]
        if self.get_command(ctx, name) is None and not ctx.resilient_parsing and not name.startswith("-"):
            there = [
                f"`{ctx.find_root().info_name} {group} {name}`"
                for group, commands in self.commands.items()
                if (isinstance(commands, LazyGroup | FirstWordCommand) and name in commands.table)
                or (isinstance(commands, LazyGroup) and name in commands.elsewhere)
            ]
            there += [f"`decanter {now}`" for old, now in _former_names(ctx).items() if old.split()[-1] == name]
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
            if isinstance(group, LazyGroup | FirstWordCommand)
        ]
        if groups:
            with formatter.section("Groups of commands"):
                formatter.write_dl(groups, col_max=12)


class FirstWordCommand(click.Command):
    """A command that does several works, whose first word says which: `plc check soak`.

    `table` has the works, which are commands that are not imported for its help, `examples` a line for each. Without
    such a word the `usual` work is done, if there is one.
    """

    def __init__(self, name: str, *, table: Table, examples: Mapping[str, str], usual: str = "", **kwargs: Any) -> None:
        super().__init__(name, no_args_is_help=True, **kwargs)
        self.table = table
        self.examples = examples
        self.usual = usual

    def get_command(self, _: click.Context, word: str) -> click.Command:
        """The work that a word of the table names."""
        return load_command(self.table[word][0], self.examples[word])

    def make_context(
        self, info_name: str | None, args: list[str], parent: click.Context | None = None, **extra: Any
    ) -> click.Context:
        """That of the work. Raises UsageError for a first word that names none."""
        word, rest = (args[0], args[1:]) if args and args[0] in self.table else ("", args)
        own = click.Context(self, parent=parent, info_name=info_name)
        # While a line is completed, a first word that is still to come is one of the table.
        if not word and self.usual and not {*args} & {*own.help_option_names} and (args or not extra):
            work = self.get_command(own, self.usual)
            takes = any(isinstance(parameter, click.Argument) for parameter in work.params)
            word = self.usual if takes or not args or args[0].startswith("-") else ""
        if word:
            return self.get_command(own, word).make_context(f"{info_name} {word}", rest, parent=parent, **extra)
        if args and not args[0].startswith("-") and not extra.get("resilient_parsing"):
            own.fail(f"No such word {args[0]!r}; {did_you_mean(args[0], [*self.table])}".rstrip("; "))
        return super().make_context(info_name, args, parent=parent, **extra)

    def collect_usage_pieces(self, _: click.Context) -> list[str]:
        """What stands behind the name in the help's first line."""
        return ["[WORD]" if self.usual else "WORD", "[OPTIONS]", "[ARGS]..."]

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """The words, from the table: no work is imported for it."""
        with formatter.section("Words"):
            formatter.write_dl([(name, text) for name, (_, text) in self.table.items()], col_max=12)
        formatter.write_paragraph()
        usual = f"; without a word it is `{self.usual}`" if self.usual else ""
        formatter.write_text(f"Options of each: `{ctx.command_path} WORD --help`{usual}.")

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        """The words, else what the usual work takes."""
        words = [CompletionItem(name, help=line) for name, (_, line) in self.table.items()]
        found = [item for item in words if item.value.startswith(incomplete)]
        return found or (self.get_command(ctx, self.usual).shell_complete(ctx, incomplete) if self.usual else [])


def _words(ctx: click.Context) -> list[str]:
    """What was typed behind the program's name to come to a group."""
    words: list[str] = []
    while ctx.parent is not None:
        words.insert(0, ctx.info_name or "")
        ctx = ctx.parent
    return words


def _former_names(ctx: click.Context) -> Mapping[str, str]:
    program = ctx.find_root().command
    return program.former if isinstance(program, LazyGroup) else {}


def _elsewhere(name: str, now: str) -> click.Command:
    """The command with another name now: whatever it is given, it says what to type."""

    @click.command(name, hidden=True, context_settings={"ignore_unknown_options": True}, add_help_option=False)
    @click.argument("arguments", nargs=-1, type=click.UNPROCESSED)
    def answer(arguments: tuple[str, ...]) -> None:
        fail(f"`{name}` has another name now: {now}; nothing was done")

    return answer

"""Names of the last release: they do what they did, and say once what is typed now."""

import shlex
from collections.abc import Mapping
from types import TracebackType
from typing import Any

import click
from click.core import ParameterSource

from gateway.entry.exits import CallAnswer


class FormerName(click.Command):
    """A command by its name of the last release: it does what it did, and says once what to type now.

    It is said behind the work; not beside a complaint, which stays the one sentence of its call, and not to a program,
    which asks for JSON and may read both streams as one.
    """

    def __init__(self, name: str, *, former: str, now: str) -> None:
        super().__init__(name, hidden=True, add_help_option=False)
        self.former = former
        self.now = now

    def make_context(
        self, info_name: str | None, args: list[str], parent: click.Context | None = None, **extra: Any
    ) -> click.Context:
        """That of the command by its name of today."""
        if parent is None:
            return super().make_context(info_name, args, parent, **extra)
        typed = [*self.now.split(), *args]
        hint = _Hint(f"`decanter {self.former}` is now `decanter {shlex.join(typed)}`")
        context, command, words = parent.find_root(), parent.find_root().command, typed
        while isinstance(command, click.Group) and words:
            name, found, words = command.resolve_command(context, words)
            if found is None or not isinstance(found, click.Group):
                command = found or command
                break
            command, context = found, click.Context(found, parent=context, info_name=name)
        try:
            made = command.make_context(name, words, parent=context, **extra)
        except click.exceptions.Exit:  # help was asked for, and shown
            hint.say()
            raise
        if not extra.get("resilient_parsing"):
            made.with_resource(hint)
        return made


class FormerOption(click.Option):
    """An option of the last release: in no help, it does what it did, and says once what to type now.

    `now` is what is typed instead, with {} in the place of what was given: "--set baud={}".
    """

    def __init__(self, *args: Any, now: str, **settings: Any) -> None:
        super().__init__(*args, **settings)
        self.hidden = True
        self.now = now

    def handle_parse_result(
        self, ctx: click.Context, opts: Mapping[str, Any], args: list[str]
    ) -> tuple[Any, list[str]]:
        """As of any option; where it was typed, what to type now is said behind the work."""
        value, rest = super().handle_parse_result(ctx, opts, args)
        if ctx.get_parameter_source(self.name or "") is ParameterSource.COMMANDLINE and not ctx.resilient_parsing:
            given = "" if self.is_flag else f" {shlex.quote(str(value))}"
            now = self.now.format(shlex.quote(str(value)))
            ctx.with_resource(_Hint(f"`{self.opts[0]}{given}` is now `{now}`"))
        return value, rest


class _Hint:
    """Around the work of a command that was called by a former name, or with one."""

    def __init__(self, sentence: str) -> None:
        self.sentence = f"decanter: {sentence}"

    def say(self) -> None:
        """Say it on standard error."""
        click.echo(self.sentence, err=True)

    def __enter__(self) -> None:
        """Nothing: it is said behind the work."""

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        """Say it to a person whose work ended without a complaint."""
        context = click.get_current_context(silent=True)
        answer = (None if context is None else context.find_object(CallAnswer)) or CallAnswer()
        if (kind is None or issubclass(kind, SystemExit)) and not (answer.complained or answer.as_json):
            self.say()

"""`decanter completion`: what makes a shell complete the commands and options, printed or installed."""

import os
from pathlib import Path

import click
from click.shell_completion import get_completion_class

from drivers.named_files import name_write_errors
from gateway.entry import fail, sentences

PLACES = {
    "bash": (".local/share/bash-completion/completions/decanter", "it holds in new shells"),
    "zsh": (".zfunc/_decanter", "~/.zshrc needs, before compinit: fpath+=~/.zfunc"),
    "fish": (".config/fish/completions/decanter.fish", "it holds in new shells"),
}
"""Shell -> where it looks for completions, below the home folder, and what a person has to do yet."""


@click.command(short_help="Print what makes a shell complete, or install it.")
@click.argument("shell", type=click.Choice(list(PLACES)), required=False)
@click.option("--install", is_flag=True, help="Write it where the shell looks for it, instead of printing it.")
def completion(shell: str | None, install: bool) -> None:
    """Print the completion of SHELL, by default the one that runs here ($SHELL), or install it for this user."""
    name = shell or Path(os.environ.get("SHELL", "")).name
    kind = get_completion_class(name)
    if name not in PLACES or kind is None:
        fail(f"which shell? $SHELL names {name or 'none'!r}; give one of {', '.join(PLACES)}")
    program = click.get_current_context().find_root().command
    script = kind(program, {}, "decanter", "_DECANTER_COMPLETE").source()
    if not install:
        click.echo(script)
        return
    place, then = PLACES[name]
    file = Path.home() / place
    with sentences(), name_write_errors(file):
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(script + "\n", encoding="utf-8")
    click.echo(f"{file} is written; {then}")

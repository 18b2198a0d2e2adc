"""The commands of `decanter user`: who may change something at the page."""

import sys
from collections.abc import Iterator
from pathlib import Path

import click

from gateway.console import CommandResult, Part, Rows, conclude
from gateway.entry import sentences
from gateway.outside.web.access import ROLES, AccountRole, add_account, change_password, read_accounts, remove_account
from gateway.settings import Config, load_plant


def _asked_password() -> str:
    """A new password: typed twice at a terminal, else one line of standard input."""
    if sys.stdin.isatty():
        typed: str = click.prompt("Password", hide_input=True, confirmation_prompt=True, err=True)
        return typed
    return sys.stdin.readline(1000).rstrip("\r\n")


def _config(path: Path) -> Config:
    return load_plant(path)[0]


def add(name: str, role: str, path: Path) -> None:
    """The work of `user add`."""
    with sentences():
        file = _config(path).users
        add_account(file, name, AccountRole(role), _asked_password())
    click.echo(f"{name} may log in as {role} ({file})")


def list_accounts(path: Path, as_json: bool) -> None:
    """The work of `user list`."""
    with sentences():
        file = _config(path).users
        accounts = {name: account.role for name, account in read_accounts(file).items()}

    def show() -> Iterator[Part]:
        if accounts:
            rows = [(name, str(role), ROLES[role]) for name, role in accounts.items()]
            yield Rows(str(file), ("account", "role", "may do"), rows)
        else:
            yield f"there is no account yet ({file}); make one with `decanter user add NAME --role administrator`"

    conclude(CommandResult({"file": str(file), "accounts": accounts}), lambda _: show(), as_json=as_json)


def password(name: str, path: Path) -> None:
    """The work of `user password`."""
    with sentences():
        change_password(_config(path).users, name, _asked_password())
    click.echo(f"{name} has another password; its sessions have ended")


def remove(name: str, path: Path) -> None:
    """The work of `user remove`."""
    with sentences():
        remove_account(_config(path).users, name)
    click.echo(f"{name} is removed; its sessions have ended")

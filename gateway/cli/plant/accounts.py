"""The commands of `decanter user`: who may change something at the page."""

import sys
from collections.abc import Iterator
from pathlib import Path

import click

from gateway.cli.plant.plant_file import config_option
from gateway.console import CommandResult, Part, Rows, conclude, json_option
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


@click.command(short_help="Make an account; its password is asked for.")
@click.argument("name")
@click.option(
    "--role",
    type=click.Choice([role.value for role in AccountRole]),
    required=True,
    help="; ".join(f"{role}: {meaning}" for role, meaning in ROLES.items()) + ".",
)
@config_option
def add(name: str, role: str, path: Path) -> None:
    """Make an account NAME for the page. There is none at first, and no password that anybody knows.

    The password is asked for twice at a terminal, and is one line of standard input elsewhere: 12 to 128 characters.
    """
    with sentences():
        file = _config(path).users
        add_account(file, name, AccountRole(role), _asked_password())
    click.echo(f"{name} may log in as {role} ({file})")


@click.command("list", short_help="List the accounts and what each may do.")
@config_option
@json_option
def list_accounts(path: Path, as_json: bool) -> None:
    """List the accounts of the page, with their roles."""
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


@click.command(short_help="Give an account another password; its sessions end.")
@click.argument("name")
@config_option
def password(name: str, path: Path) -> None:
    """Give the account NAME another password; whoever is logged in with it is logged out."""
    with sentences():
        change_password(_config(path).users, name, _asked_password())
    click.echo(f"{name} has another password; its sessions have ended")


@click.command(short_help="Remove an account; its sessions end.")
@click.argument("name")
@config_option
def remove(name: str, path: Path) -> None:
    """Remove the account NAME; whoever is logged in with it is logged out."""
    with sentences():
        remove_account(_config(path).users, name)
    click.echo(f"{name} is removed; its sessions have ended")

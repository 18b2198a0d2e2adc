"""`decanter certificates`: what Modbus/TCP Security needs on both sides, or an OPC UA server, for commissioning."""

from pathlib import Path

import click

from gateway.entry import sentences
from gateway.network import make_all, make_application


def certificates(folder: Path, hosts: tuple[str, ...], role: str, days: int, opcua: bool) -> None:
    """The work of `certificates`."""
    if opcua:
        with sentences():
            written = make_application(folder, hosts=hosts, days=days)
        click.echo(f"{written}: opcua.pem, opcua.key ({days} days); clients' certificates go to {written / 'trusted'}")
        return
    with sentences():
        written = make_all(folder, hosts=hosts, role=role, days=days)
    click.echo(f"{written}: ca.pem, ca.key, server.pem, server.key, client.pem, client.key (role {role}, {days} days)")

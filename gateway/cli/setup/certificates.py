"""`decanter certificates`: what Modbus/TCP Security needs on both sides, or an OPC UA server, for commissioning."""

from pathlib import Path

import click

from gateway.entry import sentences
from gateway.network import make_all, make_application


@click.command(short_help="Make certificates and keys for Modbus/TCP Security or OPC UA.")
@click.argument("folder", type=click.Path(path_type=Path, file_okay=False))
@click.option(
    "--host", "hosts", multiple=True, required=True, help="A name or address by which the PLC is called; repeatable."
)
@click.option("--role", default="Gateway", show_default=True, help="The gateway's role, which the PLC knows.")
@click.option("--days", type=click.IntRange(1, 3650), default=825, show_default=True, help="How long they are valid.")
@click.option("--opcua", is_flag=True, help="Those of the gateway's OPC UA server instead; HOST is the gateway's.")
def certificates(folder: Path, hosts: tuple[str, ...], role: str, days: int, opcua: bool) -> None:
    """Make an authority, a certificate for the PLC and one with a role for the gateway, in FOLDER.

    server.pem, server.key and ca.pem go to the PLC; ca.pem, client.pem and client.key stay with the gateway, whose link
    names FOLDER as `certificates`. Keep ca.key away from both: it makes further certificates.

    With --opcua: opcua.pem and opcua.key, which [northbound.opcua] names FOLDER for, and FOLDER/trusted, where the
    certificates of the clients go that may connect.
    """
    if opcua:
        with sentences():
            written = make_application(folder, hosts=hosts, days=days)
        click.echo(f"{written}: opcua.pem, opcua.key ({days} days); clients' certificates go to {written / 'trusted'}")
        return
    with sentences():
        written = make_all(folder, hosts=hosts, role=role, days=days)
    click.echo(f"{written}: ca.pem, ca.key, server.pem, server.key, client.pem, client.key (role {role}, {days} days)")

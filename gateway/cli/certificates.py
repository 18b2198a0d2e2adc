"""`decanter certificates`: what Modbus/TCP Security needs on both sides, for commissioning and tests."""

from pathlib import Path

import click

from gateway.certificates import make_all
from gateway.entry import sentences


@click.command(short_help="Make certificates and keys for Modbus/TCP Security.")
@click.argument("folder", type=click.Path(path_type=Path, file_okay=False))
@click.option(
    "--host", "hosts", multiple=True, required=True, help="A name or address by which the PLC is called; repeatable."
)
@click.option("--role", default="Gateway", show_default=True, help="The gateway's role, which the PLC knows.")
@click.option("--days", type=click.IntRange(1, 3650), default=825, show_default=True, help="How long they are valid.")
def certificates(folder: Path, hosts: tuple[str, ...], role: str, days: int) -> None:
    """Make an authority, a certificate for the PLC and one with a role for the gateway, in FOLDER.

    server.pem, server.key and ca.pem go to the PLC; ca.pem, client.pem and client.key stay with the gateway, whose link
    names FOLDER as `certificates`. Keep ca.key away from both: it makes further certificates.
    """
    with sentences():
        written = make_all(folder, hosts=hosts, role=role, days=days)
    click.echo(f"{written}: ca.pem, ca.key, server.pem, server.key, client.pem, client.key (role {role}, {days} days)")

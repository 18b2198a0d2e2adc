"""The options of what makes a plant's folder, certificates or its PLC; the work is loaded when it is asked for."""

from pathlib import Path
from typing import Any

import click

from gateway.commission.options import HEARTBEAT, list_options, pairs, place_options

_PATH = click.Path(path_type=Path)


@click.command(short_help="Make a folder that runs, from an address and an I/O list.")
@click.argument("folder", type=_PATH, default=".")
@click.option("--list", "list_path", type=_PATH, help="The PLC's I/O list (CSV, XLSX).")
@list_options
@click.option("--without", multiple=True, metavar="TAG", help="Leave this tag of the list out; may be given again.")
@click.option("--skip-bad", is_flag=True, help="Leave out rows of the list that cannot be used.")
@click.option(
    "--temperature",
    "temperatures",
    multiple=True,
    metavar="TAG",
    help="A tag that is predicted and watched; may be given again.  [default: those that the device takes blocks of]",
)
@click.option("--trace", type=_PATH, help="A recorded CSV, for which a column map is drafted.")
@click.option(
    "--rename", multiple=True, metavar="COLUMN=TAG", callback=pairs, help="Which tag a column of the trace is."
)
@click.option("--overwrite", is_flag=True, help="Replace files that are there.")
@HEARTBEAT
@place_options
def init(**options: Any) -> None:
    """Make FOLDER (this one by default) a plant's: plant.toml, devices/plc.toml, columns.toml, models/, README.md.

    On a terminal it asks for what is not given. Where the PLC is, --host or --serial say, or any other option of
    `decanter plc`; where its tags lie, --list or --device FILE, which may be a shipped one such as decanter_plc. In
    /etc/decanter it is the plant of the installed service: records in /var/lib/decanter, the page enabled; in
    /etc/decanter/GROUP that of the service decanter@GROUP. The PLC is not asked, and nothing is written where something
    is wrong: what is made is checked as `decanter run` does.
    """
    from gateway.cli.setup.init import init as work

    work(**options)


@click.command(short_help="Make certificates and keys for Modbus/TCP Security or OPC UA.")
@click.argument("folder", type=click.Path(path_type=Path, file_okay=False))
@click.option(
    "--host", "hosts", multiple=True, required=True, help="A name or address by which the PLC is called; repeatable."
)
@click.option("--role", default="Gateway", show_default=True, help="The gateway's role, which the PLC knows.")
@click.option("--days", type=click.IntRange(1, 3650), default=825, show_default=True, help="How long they are valid.")
@click.option("--opcua", is_flag=True, help="Those of the gateway's OPC UA server instead; HOST is the gateway's.")
def certificates(**options: Any) -> None:
    """Make an authority, a certificate for the PLC and one with a role for the gateway, in FOLDER.

    server.pem, server.key and ca.pem go to the PLC; ca.pem, client.pem and client.key stay with the gateway, whose link
    names FOLDER as `certificates`. Keep ca.key away from both: it makes further certificates.

    With --opcua: opcua.pem and opcua.key, which [northbound.opcua] names FOLDER for, and FOLDER/trusted, where the
    certificates of the clients go that may connect.
    """
    from gateway.cli.setup.certificates import certificates as work

    work(**options)


@click.command(
    context_settings={"ignore_unknown_options": True, "help_option_names": []},
    add_help_option=False,
    short_help="Start the software PLC, which replays a trace.",
)
@click.option("--trace", type=click.Path(path_type=Path), help="Trace to replay.")
@click.option("--columns", metavar="MAP", help="Column map by which --trace is read: an export of one's own.")
@click.argument("arguments", nargs=-1, type=click.UNPROCESSED)
def emulate(**options: Any) -> None:
    """Start the software PLC; all arguments are its own (try `decanter emulate --help`).

    This process becomes the PLC's, so that signals and exit codes are the PLC's too.
    """
    from gateway.cli.setup.emulate import emulate as work

    work(**options)

"""`decanter plc`: commissioning, one module a command; the options that they share are in `plc_options`."""

import click

from gateway.cli.lazy import LazyGroup, Table

COMMANDS: Table = {
    "doctor": ("gateway.cli.plc_doctor:doctor", "Look at this machine before the plant: clock, network, ports, files."),
    "probe": ("gateway.cli.plc_probe:probe", "Is the device there, does it speak, and who is it?"),
    "scan": ("gateway.cli.plc_scan:scan", "Look for units, nodes, CAN frames, or readable registers."),
    "read": ("gateway.cli.plc_read:read", "Read tags or bare addresses: raw words and values side by side."),
    "guess": ("gateway.cli.plc_guess:guess", "Find type, word order, scale and address from what the HMI shows."),
    "watch": ("gateway.cli.plc_watch:watch", "Watch tags as they change."),
}


@click.group(cls=LazyGroup, table=COMMANDS)
def plc() -> None:
    """Commission a PLC: look, read, understand, bind, verify. Nothing is written unless armed.

    Every command appends what it did to a file of records, from which the acceptance report is made.

    Exit codes: 0 in order, 1 a check failed, 2 wrong usage or input, 3 cannot connect, 4 the device refused, 5 no
    reply in time, 6 not armed.
    """

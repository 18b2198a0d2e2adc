"""`decanter plc probe`: the way to a device, step by step."""

from collections.abc import Mapping
from typing import Any

import click

from gateway.commission.plc_options import Given, link_options
from gateway.commission.plc_perform import perform


@click.command()
@link_options
def probe(given: Given) -> None:
    """Is the device there, does it speak, and who is it?

    Name, route, connection, first reply, identity, tables and round trip; for CAN the bus, its traffic and the node.
    Each step that fails has its own sentence. Nothing but reads is sent.
    """
    from gateway.commission.probe import probe as work

    perform(given, "probe", {}, work, show_steps)


def show_steps(data: Mapping[str, Any]) -> None:
    """One line a step."""
    colours = {"ok": "green", "warning": "yellow", "failed": "red"}
    for step in data["steps"]:
        state = click.style(f"{step['state']:8}", fg=colours.get(step["state"]))
        click.echo(f"{state} {step['step']:12} {step['sentence']}")

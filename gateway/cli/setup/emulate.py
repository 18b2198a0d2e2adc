"""`decanter emulate`: the software PLC, as a process of its own."""

import os
import sys

import click

# The emulator is started by its name: nothing of the gateway imports it.
PROGRAM = """\
import sys
from functools import partial
from gateway.entry import run_command
from sim.plc.__main__ import main
run_command(partial(main.main, prog_name="decanter emulate"), sys.argv[1:])
"""


@click.command(
    context_settings={"ignore_unknown_options": True, "help_option_names": []},
    add_help_option=False,
    short_help="Start the software PLC, which replays a trace.",
)
@click.argument("arguments", nargs=-1, type=click.UNPROCESSED)
def emulate(arguments: tuple[str, ...]) -> None:
    """Start the software PLC; all arguments are its own (try `decanter emulate --help`).

    This process becomes the PLC's, so that signals and exit codes are the PLC's too.
    """
    sys.stdout.flush()
    os.execv(sys.executable, [sys.executable, "-c", PROGRAM, *arguments])

"""`decanter emulate`: the software PLC, as a process of its own."""

import os
import sys
import tempfile
from pathlib import Path

import click

from gateway.entry import sentences

# The emulator is started by its name: nothing of the gateway imports it.
PROGRAM = """\
import sys
from functools import partial
from gateway.entry import run_command
from sim.plc.__main__ import main
run_command(partial(main.main, prog_name="decanter emulate"), sys.argv[1:])
"""


def emulate(trace: Path | None, columns: str | None, arguments: tuple[str, ...]) -> None:
    """The work of `emulate`."""
    if columns is not None:
        if trace is None:
            raise click.UsageError("--columns says how a trace is read; give --trace FILE, too")
        with sentences():
            trace = _plain_trace(trace, columns)
    played = () if trace is None else ("--trace", str(trace))
    sys.stdout.flush()
    os.execv(sys.executable, [sys.executable, "-c", PROGRAM, *played, *arguments])


def _plain_trace(export: Path, columns: str) -> Path:
    """The export as the PLC replays traces: a file without a name, which is gone when the PLC's process ends.

    Raises TraceError; ValueError for several traces.
    """
    from gateway.console import shipped_file
    from sim.lab.recordings import load_map, load_traces, write_trace

    traces, _ = load_traces(export, load_map(shipped_file("traces", columns)))
    if len(traces) != 1:
        raise ValueError(f"{export}: has {len(traces)} traces by {columns}; the PLC replays one: give its file alone")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "trace.csv"
        write_trace(traces[0], path)
        descriptor = os.open(path, os.O_RDONLY)
    os.set_inheritable(descriptor, True)
    return Path("/dev/fd") / str(descriptor)

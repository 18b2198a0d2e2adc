"""`decanter run`: the gateway at the plant, until it is told to stop."""

import os
import signal
import sys
import threading
from contextlib import AbstractContextManager, nullcontext, suppress
from functools import partial
from math import isfinite
from pathlib import Path

import click

from gateway.cli.plant.plant_file import config_option, load
from gateway.entry import Exit, fail, sentences
from gateway.machine.reading import PlantClock
from gateway.settings import Config


@click.command(short_help="Run the gateway with a configuration file.")
@config_option
@click.option("--host", help="Instead of device.host.")
@click.option("--port", type=click.IntRange(1, 65535), help="Instead of device.port.")
@click.option(
    "--clock",
    "clock_text",
    metavar="EPOCH,MONOTONIC,SPEED",
    help="The clock of a replay, as the software PLC announces it.",
)
@click.option(
    "--status", type=click.Path(path_type=Path), help="Rewrite this file with the present state (one line of JSON)."
)
@click.option("--watch", is_flag=True, help="Show the live panel, as `decanter top` does; lines off a terminal.")
@click.option("--quiet", is_flag=True, help="Log to the file only.")
@click.option("--stdin", is_flag=True, help="Also stop when standard input ends, as it does when the parent is gone.")
def run(
    path: Path,
    host: str | None,
    port: int | None,
    clock_text: str | None,
    status: Path | None,
    watch: bool,
    quiet: bool,
    stdin: bool,
) -> None:
    """Run the gateway until it is told to stop (SIGTERM or Ctrl-C).

    It begins with three lines (model, PLC, records) and says each change of state in one line on standard output.
    Other events of the log go to standard error. SIGHUP, sent to a gateway that runs off a terminal, has it read its
    configuration anew, as `decanter reload` does.
    """
    if watch and quiet:
        raise click.UsageError("--watch and --quiet exclude each other: one shows what the other hides")
    clock = _clock(clock_text) if clock_text else None
    speed = clock.speed if clock else None
    with sentences():
        read_anew = partial(load, path, host, port, speed)
        configs = read_anew()
        # After the configuration, so that what is wrong with it is said at once.
        from gateway.plant import keep_freed_memory, serve

        keep_freed_memory()
        if stdin:
            threading.Thread(target=_stop_at_end, name="stdin", daemon=True).start()
        drawn = watch and sys.stdout.isatty()
        silent = quiet or drawn
        with _panel(configs[0]) if drawn else nullcontext():
            last = serve(
                configs,
                clock=clock,
                status_path=status,
                console=not silent,
                say=None if silent else _say,
                read_anew=read_anew,
            )
    machines = last.get("machines", {"": last})
    # What is lost is one count for all: the records are common.
    records = next(iter(machines.values()))["historian"]
    if records["failure"]:
        fail(f"records could not be stored: {records['failure']}", Exit.CHECK_FAILED)
    if lost := records["dropped"] + records["refused"]:
        fail(f"{lost} rows could not be stored: see the log for the reason of each kind", Exit.CHECK_FAILED)
    failed = {
        f"{name} {part}".strip(): how
        for name, status in machines.items()
        for part, how in status["parts"].items()
        if how["restarts"]
    }
    if failed:
        reasons = "; ".join(f"{name} ({part['restarts']}): {part['failure']}" for name, part in failed.items())
        fail(f"parts of the gateway failed and were begun anew: {reasons}", Exit.CHECK_FAILED)


def _panel(config: Config) -> AbstractContextManager[None]:
    from gateway.cli.plant.top import live_panel

    return live_panel(config.control_socket)


def _say(line: str) -> None:
    # A terminal or a pipe that has gone is no reason for a gateway to stop.
    with suppress(OSError, ValueError):
        click.echo(line)


def _stop_at_end() -> None:
    """Wait for the end of standard input, then ask this process to stop as anybody else would."""
    while os.read(sys.stdin.fileno(), 4096):
        pass
    os.kill(os.getpid(), signal.SIGTERM)


def _clock(text: str) -> PlantClock:
    try:
        epoch, start, speed = (float(part) for part in text.split(","))
    except ValueError:
        raise click.BadParameter(f"{text!r}: give three numbers, EPOCH,MONOTONIC,SPEED", param_hint="--clock") from None
    if not (speed > 0 and all(map(isfinite, (epoch, start, speed)))):
        raise click.BadParameter(
            f"{text!r}: give three finite numbers, EPOCH,MONOTONIC,SPEED, the speed above 0", param_hint="--clock"
        )
    return PlantClock(epoch, start, speed)

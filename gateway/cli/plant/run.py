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

from gateway.cli.plant.plant_file import load
from gateway.entry import Exit, fail, sentences
from gateway.machine.reading import PlantClock
from gateway.settings import Config


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
    """The work of `run`."""
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

"""`decanter run` and `decanter check`: the gateway at the plant, and what is wrong with its configuration."""

import os
import signal
import sys
import threading
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from drivers.errors import DriverError
from gateway.console.options import json_option
from gateway.console.output import Exit, emit, exit_code, fail, sentences, table
from gateway.console.places import config_dir

if TYPE_CHECKING:
    from drivers.tag import Sample, Tag
    from gateway.machine.reading.clock import PlantClock
    from gateway.settings.config import Config
    from gateway.settings.links import DeviceLink


def _config_option(command: Any) -> Any:
    return click.option(
        "--config",
        "path",
        type=click.Path(path_type=Path),
        default=lambda: config_dir() / "plant.toml",
        show_default="config/plant.toml",
        help="The gateway's configuration (TOML).",
    )(command)


@click.command()
@_config_option
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
@click.option("--quiet", is_flag=True, help="Log to the file only.")
@click.option("--stdin", is_flag=True, help="Also stop when standard input ends, as it does when the parent is gone.")
def run(
    path: Path,
    host: str | None,
    port: int | None,
    clock_text: str | None,
    status: Path | None,
    quiet: bool,
    stdin: bool,
) -> None:
    """Run the gateway until it is told to stop (SIGTERM or Ctrl-C)."""
    clock = _clock(clock_text) if clock_text else None
    speed = clock.speed if clock else None
    with sentences():
        from gateway.plant.app import serve

        config = load(path, host, port, speed)
        if stdin:
            threading.Thread(target=_stop_at_end, name="stdin", daemon=True).start()
        last = serve(config, clock=clock, status_path=status, console=not quiet)
    if last["historian"]["failure"]:
        fail(f"records could not be stored: {last['historian']['failure']}", Exit.CHECK_FAILED)


@click.command()
@_config_option
@click.option("--host", help="Instead of device.host.")
@click.option("--port", type=click.IntRange(1, 65535), help="Instead of device.port.")
@click.option("--connect", is_flag=True, help="Also read every tag of the PLC once.")
@json_option
def check(path: Path, host: str | None, port: int | None, connect: bool, as_json: bool) -> None:
    """Check a configuration, its register map and its model; with --connect the PLC too."""
    with sentences():
        from gateway.machine.model.loading import load_model

        config = load(path, host, port, None)
        loaded = load_model(config)
        plan, cautions = _plan(config)
    facts: dict[str, str | int] = {
        "configuration": str(path),
        "register map": str(config.map.path),
        "tags": len(config.map.tags),
        "links": "; ".join(f"{link.name} ({link.map.driver}, {link.place})" for link in config.links),
        "model": f"{loaded.model.sha.name} {loaded.hash[:12]}"
        if loaded
        else "none: threshold alarm and historian only",
        "write-back": config.writeback.mode,
        "historian": str(config.historian.path),
        "requests of a scan": "; ".join(plan),
        "cautions": "; ".join(cautions) or "none",
    }
    rows: list[dict[str, Any]] = []
    if connect:
        try:
            rows = _read_once(config)
        except DriverError as error:
            emit({"ok": False, **facts, "readings": [], "reason": str(error)}, lambda: None, as_json_line=as_json)
            fail(f"{error}; is the PLC there? Give --host and --port, or start one: decanter emulate", exit_code(error))
    bad = [row for row in rows if row["quality"] != "GOOD"]
    emit({"ok": not bad, **facts, "readings": rows}, lambda: _show_check(facts, rows, len(bad)), as_json_line=as_json)
    if rows and len(bad) == len(rows):
        fail(f"no tag could be read: {bad[0]['reason']}", _connection_code(bad))
    if bad:
        fail(f"{len(bad)} tags are not good, {bad[0]['tag']} the first: {bad[0]['reason']}", Exit.CHECK_FAILED)


def _plan(config: "Config") -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The requests by which a scan reads all tags, in the driver's own sentences, and its cautions; nothing is sent."""
    from drivers.driver import Cautions, Explains
    from gateway.machine.reading.clock import plant_clock
    from gateway.plant.device import make_driver

    driver = make_driver(config, plant_clock())
    plan = driver.explain(config.map.tags) if isinstance(driver, Explains) else ()
    return plan, driver.cautions() if isinstance(driver, Cautions) else ()


def _show_check(facts: dict[str, str | int], rows: list[dict[str, Any]], bad: int) -> None:
    table("configuration is in order", ("what", "value"), [[name, value] for name, value in facts.items()])
    if rows:
        table(f"{len(rows) - bad} of {len(rows)} tags good", list(rows[0]), [list(row.values()) for row in rows])


def _stop_at_end() -> None:
    """Wait for the end of standard input, then ask this process to stop as anybody else would."""
    while os.read(sys.stdin.fileno(), 4096):
        pass
    os.kill(os.getpid(), signal.SIGTERM)


def load(path: Path, host: str | None, port: int | None, speed: float | None) -> "Config":
    """The configuration with what the command line replaces. Raises ConfigError (a ValueError)."""
    from gateway.settings.config import load_config

    given = {"device.host": host, "device.port": port, "clock.speed": speed}
    return load_config(path, {key: value for key, value in given.items() if value is not None})


def _clock(text: str) -> "PlantClock":
    from gateway.machine.reading.clock import PlantClock

    try:
        epoch, start, speed = (float(part) for part in text.split(","))
    except ValueError:
        raise click.BadParameter(f"{text!r}: give three numbers, EPOCH,MONOTONIC,SPEED", param_hint="--clock") from None
    if not (speed > 0 and all(map(isfinite, (epoch, start, speed)))):
        raise click.BadParameter(
            f"{text!r}: give three finite numbers, EPOCH,MONOTONIC,SPEED, the speed above 0", param_hint="--clock"
        )
    return PlantClock(epoch, start, speed)


def _read_once(config: "Config") -> list[dict[str, Any]]:
    """One reading of every tag over every link. Raises DriverError when no link has a connection."""
    import asyncio

    from gateway.machine.reading.clock import plant_clock
    from gateway.plant.device import link_driver

    with sentences():
        drivers = [link_driver(config, link, plant_clock()) for link in config.links]

    async def read() -> list[dict[str, Any]]:
        failures: list[DriverError] = []
        rows: list[dict[str, Any]] = []
        for link, driver in zip(config.links, drivers, strict=True):
            try:
                try:
                    await driver.open()
                except DriverError as error:
                    failures.append(error)
                rows += [
                    _row(link, tag, s) for tag, s in zip(link.map.tags, await driver.read(link.map.tags), strict=True)
                ]
            finally:
                await driver.close()
        if len(failures) == len(drivers):
            raise failures[0]
        return rows

    return asyncio.run(read())


def _row(link: "DeviceLink", tag: "Tag", sample: "Sample") -> dict[str, Any]:
    seen = {"value": sample.value, "unit": tag.unit, "quality": sample.quality.name, "reason": sample.reason}
    return {"link": link.name, "tag": sample.tag, **seen}


def _connection_code(bad: list[dict[str, Any]]) -> Exit:
    qualities = {row["quality"] for row in bad}
    if qualities & {"NOT_CONNECTED", "COMMUNICATION_ERROR"}:
        return Exit.CANNOT_CONNECT
    return Exit.TIMEOUT if "TIMEOUT" in qualities else Exit.DEVICE_EXCEPTION

"""`decanter check`: what is wrong with a configuration, and with --connect whether the PLC answers."""

import asyncio
from pathlib import Path
from typing import Any

import click

from drivers.driver import Cautions, Explains
from drivers.errors import DriverError
from gateway.cli.plant_file import config_option, load
from gateway.console import emit, json_option, table
from gateway.entry import Exit, exit_code, fail, sentences
from gateway.machine.model import load_model
from gateway.machine.reading import plant_clock
from gateway.plant import link_driver, make_driver
from gateway.settings import Config


@click.command()
@config_option
@click.option("--host", help="Instead of device.host.")
@click.option("--port", type=click.IntRange(1, 65535), help="Instead of device.port.")
@click.option("--connect", is_flag=True, help="Also read every tag of the PLC once.")
@json_option
def check(path: Path, host: str | None, port: int | None, connect: bool, as_json: bool) -> None:
    """Check a configuration, its register map and its model; with --connect the PLC too."""
    with sentences():
        config = load(path, host, port, None)
        loaded = load_model(config)
        driver = make_driver(config, plant_clock())
        plan = driver.explain(config.map.tags) if isinstance(driver, Explains) else ()
        cautions = driver.cautions() if isinstance(driver, Cautions) else ()
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

    def show() -> None:
        table("configuration is in order", ("what", "value"), [[name, value] for name, value in facts.items()])
        if rows:
            title = f"{len(rows) - len(bad)} of {len(rows)} tags good"
            table(title, list(rows[0]), [list(row.values()) for row in rows])

    emit({"ok": not bad, **facts, "readings": rows}, show, as_json_line=as_json)
    if rows and len(bad) == len(rows):
        # A device that is away explains a timeout beside it, and a timeout a refusal.
        qualities = {row["quality"] for row in bad}
        code = Exit.TIMEOUT if "TIMEOUT" in qualities else Exit.DEVICE_EXCEPTION
        if qualities & {"NOT_CONNECTED", "COMMUNICATION_ERROR"}:
            code = Exit.CANNOT_CONNECT
        fail(f"no tag could be read: {bad[0]['reason']}", code)
    if bad:
        fail(f"{len(bad)} tags are not good, {bad[0]['tag']} the first: {bad[0]['reason']}", Exit.CHECK_FAILED)


def _read_once(config: Config) -> list[dict[str, Any]]:
    """One reading of every tag over every link. Raises DriverError when no link has a connection."""
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
                # Read also where it did not open: each tag then has its own bad quality and reason.
                for tag, sample in zip(link.map.tags, await driver.read(link.map.tags), strict=True):
                    row = {"link": link.name, "tag": sample.tag, "value": sample.value, "unit": tag.unit}
                    rows.append(row | {"quality": sample.quality.name, "reason": sample.reason})
            finally:
                await driver.close()
        if len(failures) == len(drivers):
            raise failures[0]
        return rows

    return asyncio.run(read())

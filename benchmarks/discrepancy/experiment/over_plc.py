"""Rows over the software PLC: it is sought from row to row of a trace, and each row is read off it by Modbus TCP.

So set-points come to a machine and its recording to the diagnosis: with what registers make of them, and without a
wait. The PLC obeys no set-point that is written to it; it serves them, as `decanter emulate` replays the file.
"""

import asyncio
import json
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import pandas as pd

from benchmarks.processes import MAP, ROOT, Plc
from drivers.driver import Driver, open_driver
from drivers.tag import Quality, Sample, Tag
from gateway.settings import load_device

CYCLE_S = 0.001
NEW_CYCLES = 2
"""Cycles of the program after which it shows the row that it was sought to, whatever it was about."""
HEARTBEATS = 0xFFFF
"""After so many the program counts them anew."""
PATIENCE_S = 20.0


def over_plc(trace: Path, out: Path) -> None:
    """Write to `out` what is read off a software PLC that replays `trace`, at the trace's own times.

    Columns that the PLC's map has no register for are missing in it, as are readings that are not good. Raises
    TimeoutError when the PLC does not answer.
    """
    table = pd.read_csv(trace, comment="#")
    names = [name for name in table.columns if name != "time"]
    times = table["time"].drop_duplicates().to_numpy(float)
    device = load_device(MAP)
    tags = [tag for tag in device.tags if tag.name in names or tag.name == device.heartbeat]
    with _plc(trace) as plc:
        settings = {**device.settings, "host": "127.0.0.1", "port": plc.port}
        driver = open_driver("modbus", settings, clock=time.time)
        rows = asyncio.run(_read_all(plc, driver, tags, device.heartbeat or "", times - times[0]))
    found = pd.DataFrame(rows)
    found.insert(0, "time", times)
    with out.open("w", encoding="utf-8", newline="") as file:
        file.write("# SYNTHETIC: read off the software PLC\n")
        found.to_csv(file, index=False)


@contextmanager
def _plc(trace: Path) -> Iterator[Plc]:
    command = [sys.executable, "-m", "sim.plc", "--device", str(MAP), "--trace", str(trace), "--stdin"]
    pipe = subprocess.PIPE
    with subprocess.Popen([*command, "--cycle", str(CYCLE_S)], stdin=pipe, stdout=pipe, text=True, cwd=ROOT) as process:
        try:
            plc = Plc(process, json.loads(process.stdout.readline() if process.stdout else ""), Path())
            plc.order("pause")
            yield plc
        finally:
            process.terminate()


async def _read_all(
    plc: Plc, driver: Driver, tags: Sequence[Tag], heartbeat: str, positions: Sequence[float]
) -> list[dict[str, float | None]]:
    rows = []
    await driver.open()
    try:
        async with asyncio.timeout(PATIENCE_S):
            while _beat(await _read(driver, tags), heartbeat) is None:
                await asyncio.sleep(0.05)
        for position in positions:
            plc.order("seek", position=float(position))
            async with asyncio.timeout(PATIENCE_S):
                since = _beat(await _read(driver, tags), heartbeat)
                while True:
                    row = await _read(driver, tags)
                    now = _beat(row, heartbeat)
                    if since is not None and now is not None and (now - since) % HEARTBEATS >= NEW_CYCLES:
                        break
            rows.append({name: _value(one) for name, one in row.items() if name != heartbeat})
    finally:
        await driver.close()
    return rows


async def _read(driver: Driver, tags: Sequence[Tag]) -> dict[str, Sample]:
    samples = await driver.read(tags)
    return dict(zip([tag.name for tag in tags], samples, strict=True))


def _value(sample: Sample) -> float | None:
    return None if sample.value is None or sample.quality is not Quality.GOOD else float(sample.value)


def _beat(row: Mapping[str, Sample], heartbeat: str) -> int | None:
    value = _value(row[heartbeat])
    return None if value is None else int(value)

"""Units behind one connection, one of them under each fault in turn: what that costs the others' readings.

`python -m benchmarks.unit_faults [--link units|serial] [--fault NAME] [--repeats N] [--outstanding N] [--json]`. One
software PLC serves ten units; here are their drivers alone, each read at absolute deadlines a period apart, so that
what a busy gateway loses is not counted (`benchmarks.isolation` has all of it). Each fault is ordered of the last unit
once it is read again after the one before. Lateness is how long after its deadline a reading was complete; a reading
that was not done was left out because the one before it took longer than the period.
"""

import asyncio
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import click

from benchmarks.figures import Figure, give, percentile
from benchmarks.isolation import AGAIN_S, PERIODS, faults_over, plc_options
from drivers.connections import Connections
from drivers.device_file import read_device_file
from drivers.modbus.driver import ModbusDriver, open_modbus
from drivers.tag import Tag
from sim.traces.trace_file import write_trace
from tests.rig.pair import CYCLE_S, MAP, TIMEOUT_S, Plc, end, plc_process, restless_trace

QUIET_S = 3.0
"""So long nothing is wrong before the first fault."""
NONE = "no fault"


@dataclass
class Reader:
    """Reads one unit's tags each `period` s from the loop's time `begin` on; `rows`: deadline, lateness, all good."""

    driver: ModbusDriver
    tags: Sequence[Tag]
    begin: float
    period: float
    rows: list[tuple[float, float, bool]] = field(default_factory=list)

    async def run(self) -> None:
        """Until it is cancelled."""
        loop, tick = asyncio.get_running_loop(), 0
        while True:
            due = self.begin + tick * self.period
            await asyncio.sleep(due - loop.time())
            good = all(sample.quality.is_good for sample in await self.driver.read(self.tags))
            self.rows.append((due, loop.time() - due, good))
            tick = max(tick + 1, int((loop.time() - self.begin) / self.period) + 1)


@dataclass
class Spell:
    """What the others did in all the times of one kind: readings due, lateness of those done (ms), how many were good;
    connections made."""

    due: float = 0.0
    lateness: list[float] = field(default_factory=list)
    good: int = 0
    connects: int = 0

    def take(self, others: Sequence[Reader], begin: float, end_at: float) -> None:
        """Add the readings that were due from one moment to another."""
        for reader in others:
            rows = [row for row in reader.rows if begin <= row[0] < end_at]
            self.due += (end_at - begin) / reader.period
            self.lateness += [1000.0 * late for _, late, _ in rows]
            self.good += sum(good for _, _, good in rows)


def settings_of(plc: Plc, link: str, names: Sequence[str], outstanding: int) -> list[dict[str, Any]]:
    """The driver's settings for each unit."""
    first: Mapping[str, Any] = plc.ready["machines"][names[0]]
    if link == "serial":
        where = {"transport": "rtu", "serial": first["faces"]["serial"]["path"], "baud": 115200, "parity": "N"}
    else:
        where = {"host": "127.0.0.1", "port": first["port"], "outstanding": outstanding}
    return [{**where, "unit": unit, "timeout": TIMEOUT_S} for unit, _ in enumerate(names, start=1)]


async def measured(
    plc: Plc, link: str, names: Sequence[str], faults: Mapping[str, Mapping[str, Any]], repeats: int, outstanding: int
) -> dict[str, Spell]:
    """The others without a fault and under each, by its name."""
    loop, period, connections = asyncio.get_running_loop(), PERIODS[link], Connections()
    tags = [row.tag() for row in read_device_file(MAP).tags]
    readers: list[Reader] = []
    for number, settings in enumerate(settings_of(plc, link, names, outstanding)):
        driver = open_modbus(settings, clock=time.time, connections=connections)
        await driver.open()
        readers.append(Reader(driver, tags, loop.time() + 0.5 + number * period / len(names), period))
    harmed, others, spells = readers[-1], readers[:-1], {NONE: Spell()}
    tasks = [asyncio.ensure_future(reader.run()) for reader in readers]
    spans: list[tuple[str, float, float]] = []

    async def watch(kind: str, seconds: float) -> None:
        begin, before = loop.time(), harmed.driver.statistics()["connects"]
        await asyncio.sleep(seconds)
        spans.append((kind, begin, loop.time()))
        spells.setdefault(kind, Spell()).connects += int(harmed.driver.statistics()["connects"] - before)

    try:
        await asyncio.sleep(1.0)
        await watch(NONE, QUIET_S)
        for kind, fault in [row for row in faults.items() for _ in range(repeats)]:
            await asyncio.to_thread(plc.order, "fault", machine=names[-1], fault=dict(fault))
            await watch(kind, fault.get("duration", 1.0) + 0.5)
            patience = loop.time() + AGAIN_S
            while not harmed.rows[-1][2] and loop.time() < patience:
                await asyncio.sleep(0.05)
        await asyncio.sleep(2 * period)
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        for reader in readers:
            await reader.driver.close()
    for kind, begin, end_at in spans:
        spells[kind].take(others, begin, end_at)
    return spells


@click.command()
@click.option("--units", type=click.IntRange(2, 100), default=10, show_default=True, help="Units of the connection.")
@click.option(
    "--link", type=click.Choice(("units", "serial")), default="units", show_default=True, help="A port, or a line."
)
@click.option("--fault", "only", multiple=True, metavar="NAME", help="This fault only; may be given again.")
@click.option("--repeats", type=click.IntRange(1), default=3, show_default=True, help="How often each fault.")
@click.option("--outstanding", type=click.IntRange(1, 16), default=1, show_default=True, help="Requests under way.")
@click.option("--quick", is_flag=True, help="Three units, one fault.")
@click.option("--json", "as_json", is_flag=True, help="One JSON object instead of a table.")
def main(
    *, units: int, link: str, only: tuple[str, ...], repeats: int, outstanding: int, quick: bool, as_json: bool
) -> None:
    """Set the other units' readings under each fault of one against theirs without."""
    if quick:
        units, only, repeats = 3, ("wrong unit",), 1
    faults = faults_over(link)
    if unknown := [name for name in only if name not in faults]:
        raise click.BadParameter(f"{unknown[0]!r} is none of {', '.join(faults)}", param_hint="--fault")
    faults = {name: fault for name, fault in faults.items() if not only or name in only}
    names = [f"unit{number}" for number in range(1, units + 1)]
    with tempfile.TemporaryDirectory(prefix="decanter-units-") as folder:
        write_trace(restless_trace(160.0), Path(folder) / "trace.csv")
        options = plc_options(Path(folder), link, names, Path(folder))
        plc = plc_process(*options, "--trace", f"{folder}/trace.csv", "--cycle", CYCLE_S, "--loop", "--stdin")
        try:
            spells = asyncio.run(measured(plc, link, names, faults, repeats, outstanding))
            plc.order("stop")
        finally:
            end(plc.process)
    quiet, figures = spells[NONE], list[Figure]()
    for kind, spell in spells.items():
        done, good = len(spell.lateness), 100.0 * spell.good / max(1, len(spell.lateness))
        usual = 100.0 * len(quiet.lateness) / quiet.due
        figures += [
            Figure(f"{kind}: readings done", 100.0 * done / spell.due, "%", NONE, usual),
            Figure(
                f"{kind}: lateness, p99", percentile(spell.lateness, 99), "ms", "p50", percentile(spell.lateness, 50)
            ),
            Figure(f"{kind}: good of those done", good, "%", "connections made anew", spell.connects),
        ]
    give(f"one of {units} units ({link}) under each fault, the others' readings", figures, as_json=as_json)


if __name__ == "__main__":
    main()

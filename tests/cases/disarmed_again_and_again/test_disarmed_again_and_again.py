"""For as long as a disk was full the gateway disarmed itself at each scan, and whoever armed heard of nothing else.

It is disarmed once, with one row, and who arms is told what stands in the way.
"""

import asyncio
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from random import Random
from typing import Any

import pytest

from gateway.machine import Machine
from gateway.machine.writing.arming import ArmingError, arm
from gateway.plant import open_log
from gateway.store.audit import DISARMED, Audit, open_audit, read
from gateway.store.historian import Historian
from tests.cases.disarm_was_overtaken.test_disarm_was_overtaken import KEY, slow
from tests.gateway.support import Bench, JumpClock, as_driver, config_in, scan_of, two_modes
from tests.gateway.test_writeback import CLOCK
from tests.gateway.test_writeback import scan as a_scan

ARMED = {
    "writeback__mode": "armed",
    "writeback__armed_by": "Ada",
    "writeback__reason": "test",
    "writeback__minutes": 60.0,
}
FULL = "database or disk is full"


@pytest.fixture
def full(monkeypatch: pytest.MonkeyPatch) -> asyncio.Event:
    """While it is set neither store takes anything."""
    event = asyncio.Event()
    for kind, name in ((Historian, "_store"), (Audit, "_commit")):
        real = getattr(kind, name)

        def failing(self: Any, *given: Any, real: Any = real, **keys: Any) -> Any:
            if event.is_set():
                raise sqlite3.OperationalError(FULL)
            return real(self, *given, **keys)

        monkeypatch.setattr(kind, name, failing)
    return event


@contextmanager
def running(folder: Path) -> Iterator[tuple[Machine, Bench]]:
    config = config_in(folder, model=two_modes(), historian__disarm_after=20.0, **ARMED)
    bench = Bench(config, JumpClock(), armed=True)
    with open_log(None, "error") as log:
        machine = Machine(config, driver=as_driver(bench), clock=bench.clock, log=log, rng=Random(0))
        try:
            yield machine, bench
        finally:
            machine.close()


async def scan(machine: Machine, bench: Bench) -> None:
    samples = {sample.tag: sample for sample in await bench.read(machine.config.map.tags)}
    await machine.take(replace(scan_of({}, bench.clock.now()), samples=samples))
    bench.clock.time += 1.0


async def test_a_full_disk_disarms_once_and_says_so_to_whoever_arms(tmp_path: Path, full: asyncio.Event) -> None:
    with running(tmp_path) as (machine, bench):
        await bench.open()
        for _ in range(3):
            await scan(machine, bench)
        assert machine.writing is not None and machine.writing.armed
        full.set()
        async with asyncio.timeout(120.0):
            while not machine.historian.stuck:
                await scan(machine, bench)
                await asyncio.sleep(0.01)
        for _ in range(60):
            await scan(machine, bench)
        assert not machine.writing.armed
        for _ in range(3):
            with pytest.raises(ArmingError, match=FULL) as refused:
                await machine.arm("Bea", "again", 5.0)
            assert "at this moment" not in str(refused.value)
            await scan(machine, bench)
        full.clear()
        async with asyncio.timeout(120.0):
            while machine.historian.stuck:
                await asyncio.sleep(0.01)
        await scan(machine, bench)
        assert (await machine.arm("Bea", "mended", 5.0)).by == "Bea"
    rows = [row.entry for row in read(machine.config.audit) if row.entry.kind == DISARMED]
    assert [(row.who, "nothing has been on record for 20 s" in row.reason) for row in rows] == [("the gateway", True)]


async def test_who_arms_during_a_disarming_that_the_disk_does_not_take_is_told_why(
    tmp_path: Path, full: asyncio.Event
) -> None:
    writer, wire = await slow()
    writer.audit = audit = open_audit(tmp_path / "audit.sqlite")
    full.set()
    with pytest.raises(ArmingError, match="does not take it: .*" + FULL):
        await arm([writer], wire, by="Cai", reason="at once", minutes=5, key=KEY)  # type: ignore[arg-type]
    disarming = asyncio.create_task(writer.disarm(CLOCK.now(), "Bea", "enough", scan=a_scan()))
    await wire.waiting.wait()
    with pytest.raises(ArmingError, match=f"being disarmed at this moment, .*{FULL}"):
        await arm([writer], wire, by="Cai", reason="at once", minutes=5, key=KEY)  # type: ignore[arg-type]
    wire.go.set()
    await disarming
    full.clear()
    assert audit.close()

"""Disarming at random moments of a writer that writes without a pause, over any link of the drivers' contract suite."""

import asyncio
import random
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from drivers.device_file import BlockField
from drivers.driver import BeforeSending, Writes, anyhow
from drivers.tag import Tag, Value
from gateway.machine.reading.clock import plant_clock
from gateway.machine.writing.block import Validity
from gateway.machine.writing.writeback import Arming, Writer
from gateway.settings.devices import WritebackLayout
from gateway.store.audit import open_audit
from tests.drivers.benches import Bench
from tests.gateway.support import scan_of

USABLE = Validity(31)
PATIENCE_S = 60.0

PERMITTED = {"WritePermit": True, "Challenge": 77.0}


@dataclass
class Wiretap:
    """Notes the validity of what passes the last look, at the moment when it goes on the wire."""

    inner: Writes
    validity: Tag
    sent: list[int] = field(default_factory=list)

    async def write(self, values: Sequence[tuple[Tag, Value]], *, before_sending: BeforeSending = anyhow) -> None:
        number = next(int(value or 0) for tag, value in values if tag.name == self.validity.name)

        def look() -> None:
            before_sending()
            self.sent.append(number)

        await self.inner.write(values, before_sending=look)


@dataclass(frozen=True)
class Disarms:
    """What was seen: disarmings with usable blocks before them, and those after which one left, or stands usable."""

    moments: int
    usable_before: int
    overtaken: int
    left_usable: int


async def disarmed_at_random(bench: Bench, folder: Path, rng: random.Random, moments: int, span: float) -> Disarms:
    """Arm, wait up to `span` seconds, disarm, and watch what leaves afterwards; so many `moments` times.

    The first of them waits for a usable block instead, so that there is one to be taken back on a slow machine too.
    """
    await bench.open()
    driver, clock = bench.driver, plant_clock()
    assert isinstance(driver, Writes)
    amount, validity = bench.tags.write_map
    fields = tuple(BlockField(name, scale=1.0, signed=False) for name in ("zone", "validity"))
    tap = Wiretap(driver, validity)
    audit = open_audit(folder / "audit.sqlite")
    layout = WritebackLayout(version=2, timeout=5.0, unknown=0xFFFF, fields=fields, words=(amount, validity))
    writer = Writer(layout, clock, "shadow", 4711, audit=audit, max_age=2.0)
    stop = asyncio.Event()

    async def offers() -> None:
        while not stop.is_set():
            await writer.offer(scan_of(PERMITTED, clock.now()), {"zone": 1.0}, USABLE)
            await asyncio.sleep(0)

    offering = asyncio.create_task(offers())
    before = overtaken = usable = 0
    try:
        for moment in range(moments):
            writer.arm(tap, Arming("Ada", "campaign", clock.now() + 600.0))
            patience = time.monotonic() + PATIENCE_S
            while moment == 0 and not any(word & 1 for word in tap.sent) and time.monotonic() < patience:
                await asyncio.sleep(span / 4)
            await asyncio.sleep(rng.uniform(0.0, span))
            # As often as not somebody else arms or disarms in the same moment.
            second = asyncio.create_task(writer.disarm(clock.now(), "Cai", "too")) if rng.random() < 0.5 else None
            await writer.disarm(clock.now(), "Bea", "enough", scan=scan_of(PERMITTED, clock.now()))
            before += any(word & 1 for word in tap.sent)
            tap.sent.clear()
            stands = (await driver.read([validity]))[0].value
            await asyncio.sleep(rng.uniform(0.0, span / 4))
            overtaken += any(word & 1 for word in tap.sent)
            usable += stands is not None and bool(int(stands) & 1)
            if second is not None:
                await second
            tap.sent.clear()
    finally:
        stop.set()
        await offering
        audit.close()
    return Disarms(moments, before, overtaken, usable)

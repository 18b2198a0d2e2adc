"""After the block of validity 0 a usable one went out: a write under way knew nothing of the disarming."""

import asyncio
import random
from collections.abc import AsyncIterator
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from drivers.driver import BeforeSending, anyhow
from gateway.machine.writing.arming import ArmingError, arm
from gateway.machine.writing.writeback import Writer
from gateway.store.arming_rows import armings
from gateway.store.audit import ARMED, CANCELLED, DISARMED, open_audit, read
from tests.drivers.benches import Bench
from tests.drivers.test_contract import BENCHES
from tests.gateway.test_writeback import CLOCK, USABLE, Wire, armed, scan
from tests.rig.disarms import disarmed_at_random

pytestmark = pytest.mark.usefixtures("patient_disk")

MOMENTS, SPAN_S = 25, 0.02
KEY = Ed25519PrivateKey.generate()


class SlowWire(Wire):
    """A driver that has to wait before it may send, as for a lock, a pause or a silent line."""

    def __init__(self) -> None:
        super().__init__()
        self.waiting, self.go = asyncio.Event(), asyncio.Event()

    async def write(self, values: list[tuple[object, int]], *, before_sending: BeforeSending = anyhow) -> None:
        self.waiting.set()
        await self.go.wait()
        await super().write(values, before_sending=before_sending)


async def slow() -> tuple[Writer, SlowWire]:
    writer, _ = await armed()
    wire = SlowWire()
    await wire.soft.open()
    assert writer.arming is not None
    writer.arm(wire, writer.arming)
    return writer, wire


@pytest.fixture(params=sorted(BENCHES))
async def bench(request: pytest.FixtureRequest) -> AsyncIterator[Bench]:
    async for made in BENCHES[request.param]():
        yield made


async def test_after_the_reply_to_disarm_nothing_usable_leaves_on_any_link(tmp_path: Path, bench: Bench) -> None:
    seen = await disarmed_at_random(bench, tmp_path, random.Random(7), MOMENTS, SPAN_S)
    assert (seen.overtaken, seen.left_usable) == (0, 0), seen
    assert seen.usable_before > 0


async def test_a_block_that_waits_in_the_driver_is_stopped_there_and_validity_0_is_the_last_word() -> None:
    writer, wire = await slow()
    offer = asyncio.create_task(writer.offer(scan(), {}, USABLE))
    await wire.waiting.wait()
    disarming = asyncio.create_task(writer.disarm(CLOCK.now(), "Bea", "enough", scan=scan()))
    await asyncio.sleep(0)
    wire.go.set()
    attempt, last = await offer, await disarming
    assert attempt is not None and (attempt.verdict, attempt.reason) == ("not permitted", "it was disarmed meanwhile")
    assert last is not None and last.verdict == "written" and [block[3] for block in wire.blocks] == [0]
    shadow = await writer.offer(scan(), {}, USABLE)
    assert shadow is not None and shadow.verdict == "shadow"


async def test_who_arms_while_somebody_disarms_is_refused_and_a_restart_knows_it(tmp_path: Path) -> None:
    writer, wire = await slow()
    writer.audit = open_audit(tmp_path / "audit.sqlite")
    offer = asyncio.create_task(writer.offer(scan(), {}, USABLE))
    await wire.waiting.wait()
    # One arms and is stored, the other disarms meanwhile; a third comes while that is under way.
    arming = asyncio.create_task(arm([writer], wire, by="Cai", reason="at once", minutes=5, key=KEY))  # type: ignore[arg-type]
    await asyncio.sleep(0)
    disarming = asyncio.create_task(writer.disarm(CLOCK.now(), "Bea", "enough", scan=scan()))
    await asyncio.sleep(0)
    with pytest.raises(ArmingError, match="being disarmed at this moment"):
        await arm([writer], wire, by="Dan", reason="at once", minutes=5, key=KEY)  # type: ignore[arg-type]
    wire.go.set()
    with pytest.raises(ArmingError, match="disarmed meanwhile"):
        await arming
    await offer
    await disarming
    assert not writer.armed and [block[3] for block in wire.blocks] == [0]
    assert writer.audit.close()
    kinds = [row.entry.kind for row in read(writer.audit.path) if row.entry.kind in (ARMED, DISARMED, CANCELLED)]
    assert sorted(kinds) == sorted([ARMED, DISARMED, CANCELLED])
    assert [row.entry.kind for row in armings(writer.audit.path)] == [DISARMED]


async def test_a_disarming_whose_client_goes_away_is_carried_to_its_end() -> None:
    writer, wire = await slow()
    offer = asyncio.create_task(writer.offer(scan(), {}, USABLE))
    await wire.waiting.wait()
    inner = asyncio.ensure_future(writer.disarm(CLOCK.now(), "Bea", "enough", scan=scan()))
    client = asyncio.create_task(asyncio.wait_for(asyncio.shield(inner), 60.0))
    await asyncio.sleep(0)
    client.cancel()
    wire.go.set()
    await asyncio.gather(offer, inner, client, return_exceptions=True)
    assert [block[3] for block in wire.blocks] == [0]

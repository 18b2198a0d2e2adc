"""What may end a write, at the worst moment: between the decision to send and the wire."""

import asyncio
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from random import Random

import pytest

from drivers.driver import BeforeSending, anyhow
from gateway.machine.model.loading import load_model
from gateway.machine.model.pickup import ReadyModel
from gateway.machine.model.predict import Predictor
from gateway.machine.pipeline import Machine
from gateway.machine.writing.writeback import Writer
from gateway.plant.log import open_log
from gateway.store.audit import open_audit, read
from tests.gateway.support import EPOCH, JumpClock, config_in, scan_of, two_modes
from tests.gateway.test_app import ARMED
from tests.gateway.test_arming import bench_of
from tests.gateway.test_writeback import USABLE, Wire, armed

pytestmark = pytest.mark.usefixtures("patient_disk")


class HeldWire(Wire):
    """A driver in whose last wait before the wire something happens."""

    def __init__(self, happens: Callable[[], None]) -> None:
        super().__init__()
        self.happens = happens

    async def write(self, values: list[tuple[object, int]], *, before_sending: BeforeSending = anyhow) -> None:
        self.happens()
        await super().write(values, before_sending=before_sending)


async def held(tmp_path: Path, happens: Callable[[Writer, JumpClock], None]) -> tuple[Writer, HeldWire, JumpClock]:
    writer, _ = await armed(minutes=1.0)
    clock = JumpClock()
    wire = HeldWire(lambda: happens(writer, clock))
    await wire.soft.open()
    assert writer.arming is not None
    writer.clock, writer.audit = clock, open_audit(tmp_path / "audit.sqlite")
    writer.arm(wire, writer.arming)
    return writer, wire, clock


def passes(seconds: float) -> Callable[[Writer, JumpClock], None]:
    def happens(_: Writer, clock: JumpClock) -> None:
        clock.time += seconds

    return happens


@pytest.mark.parametrize(
    ("happens", "words"),
    [
        (passes(0.3), "waited 0.30 s"),
        (passes(2.0), "its readings are 2.00 s old"),
        (passes(61.0), "the arming is over"),
    ],
)
async def test_a_block_that_waited_too_long_in_the_driver_is_not_sent(
    tmp_path: Path, happens: Callable[[Writer, JumpClock], None], words: str
) -> None:
    writer, wire, _ = await held(tmp_path, happens)
    attempt = await writer.offer(scan_of({"WritePermit": True, "Challenge": 77.0}, EPOCH), {}, USABLE)
    assert attempt is not None and attempt.verdict in ("held back", "not permitted") and words in attempt.reason
    assert wire.blocks == []
    assert writer.audit is not None and writer.audit.close()
    assert [row.entry.kind for row in read(writer.audit.path)] == ["write", "write refused"], "and it is accounted for"


async def test_an_arming_that_expires_while_a_block_waits_ends_with_validity_0(tmp_path: Path) -> None:
    writer, wire, clock = await held(tmp_path, passes(0.0))
    clock.time = EPOCH + 59.9
    first = await writer.offer(scan_of({"WritePermit": True, "Challenge": 77.0}, clock.time), {}, USABLE)
    assert first is not None and first.verdict == "written"
    wire.happens = lambda: passes(0.2)(writer, clock)
    second = await writer.offer(scan_of({"WritePermit": True, "Challenge": 77.0}, clock.time), {}, USABLE)
    assert second is not None and second.reason == "the arming is over"
    await writer.disarm(clock.time, scan=scan_of({"WritePermit": True, "Challenge": 77.0}, clock.time))
    assert [block[3] for block in wire.blocks] == [31, 0]
    assert writer.audit is not None and writer.audit.close()


async def test_a_permit_that_was_read_long_ago_is_none_and_one_that_went_away_stops_the_next_block(
    tmp_path: Path,
) -> None:
    writer, wire, clock = await held(tmp_path, passes(0.0))
    scan = scan_of({"WritePermit": True, "Challenge": 77.0}, clock.time)
    old = replace(scan.samples["WritePermit"], time=clock.time - 1.5)
    attempt = await writer.offer(replace(scan, samples={**scan.samples, "WritePermit": old}), {}, USABLE)
    assert attempt is not None and "WritePermit was read 1.50 s ago" in attempt.reason
    gone = await writer.offer(scan_of({"WritePermit": False, "Challenge": 77.0}, clock.time), {}, USABLE)
    assert gone is not None and gone.verdict == "not permitted" and wire.blocks == []
    assert writer.audit is not None and writer.audit.close()


async def test_a_model_that_takes_over_in_the_middle_of_a_write_writes_from_the_next_scan_on(tmp_path: Path) -> None:
    config = config_in(tmp_path, model=two_modes(), **ARMED)
    bench = bench_of(config)
    with open_log(None, "error") as log:
        machine = Machine(config, driver=bench, clock=bench.clock, log=log, rng=Random(0))
        loaded = load_model(config)
        assert loaded is not None and machine.model is not None and machine.writing is not None
        other = replace(loaded, hash="f" * len(loaded.hash), version="another")
        model, sent = machine.model, bench.write

        async def promoted_meanwhile(values: object, *, before_sending: BeforeSending = anyhow) -> None:
            model.pickup.ready = model.pickup.ready or ready
            await asyncio.sleep(0)
            await sent(values, before_sending=before_sending)

        ready = ReadyModel(other, Predictor(other.model, config.model.temperature), bench.clock.now())
        bench.write = promoted_meanwhile  # type: ignore[method-assign]
        await bench.open()
        for number in range(3):
            samples = {sample.tag: sample for sample in await bench.read(config.map.tags)}
            await machine.take(replace(scan_of({}, bench.clock.now()), samples=samples))
            bench.clock.time += 1.0
            assert model.loaded.hash == (loaded.hash if number == 0 else other.hash)
        before, after = int(loaded.hash[-4:], 16), 0xFFFF
        assert [block["model_hash"] for block in bench.written] == [before, after, after]
        machine.close()

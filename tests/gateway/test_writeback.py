"""Writing back: nothing unless armed, permitted and in time; a block that failed is never sent again."""

import pytest

from drivers.driver import BeforeSending, anyhow, open_driver
from drivers.tag import Quality, Sample
from gateway.machine.reading.scan import Scan
from gateway.machine.writing.block import Validity
from gateway.machine.writing.writeback import Arming, Writer
from gateway.settings.devices import load_device
from tests.gateway.support import EPOCH, MAP, JumpClock, scan_of

_DEVICE = load_device(MAP)
LAYOUT = _DEVICE.writeback
assert LAYOUT is not None
CLOCK = JumpClock()
USABLE = Validity(31)


class Wire:
    """Notes what is written; `refuse` makes the device confirm writes and forget them."""

    def __init__(self) -> None:
        self.soft = open_driver("soft", {}, clock=CLOCK.now, write_map=LAYOUT.words)
        self.blocks: list[list[int]] = []

    async def write(self, values: list[tuple[object, int]], *, before_sending: BeforeSending = anyhow) -> None:
        before_sending()
        self.blocks.append([value for _, value in values])
        await self.soft.write(values)


async def armed(minutes: float = 60.0) -> tuple[Writer, Wire]:
    wire = Wire()
    await wire.soft.open()
    arming = Arming("Ada", "test", EPOCH + 60.0 * minutes)
    return Writer(LAYOUT, CLOCK, "armed", 4711, wire, arming), wire


def scan(permit: bool | None = True, **values: float | None) -> Scan:
    return scan_of({"WritePermit": permit, "Challenge": 77.0, **values}, CLOCK.now())


async def test_off_computes_nothing_and_shadow_writes_nothing_and_says_so_in_the_word() -> None:
    assert await Writer(LAYOUT, CLOCK, "off", 4711).offer(scan(), {}, USABLE) is None
    attempt = await Writer(LAYOUT, CLOCK, "shadow", 4711).offer(scan(), {"temperature_now": 45.0}, USABLE)
    assert attempt is not None and attempt.verdict == "shadow"
    assert attempt.block.validity == USABLE | Validity.SHADOW
    assert attempt.block.words[7] == 4500


async def test_armed_writes_each_block_once_with_a_sequence_and_a_heartbeat_that_move() -> None:
    writer, wire = await armed()
    attempts = [await writer.offer(scan(), {}, USABLE) for _ in range(3)]
    assert [a.verdict for a in attempts if a] == ["written"] * 3
    assert [block[1:4] for block in wire.blocks] == [[1, 1, 31], [2, 2, 31], [3, 3, 31]]
    assert all(a is not None and a.latency_ms is not None for a in attempts)


@pytest.mark.parametrize("permit", [False, None])
async def test_without_the_plcs_permit_nothing_is_sent_and_it_is_counted(permit: bool | None) -> None:
    writer, wire = await armed()
    attempt = await writer.offer(scan(permit), {}, USABLE)
    assert attempt is not None and attempt.verdict == "not permitted"
    assert wire.blocks == [] and writer.counters.not_permitted == 1


async def test_a_permit_that_is_not_good_is_no_permit() -> None:
    writer, wire = await armed()
    stale = Scan(0, EPOCH, {"WritePermit": Sample("WritePermit", True, Quality.LAST_USABLE, EPOCH)}, 0, 0.0)
    attempt = await writer.offer(stale, {}, USABLE)
    assert attempt is not None and attempt.verdict == "not permitted" and wire.blocks == []


@pytest.mark.parametrize("fault", ["refuse", "silent", "mismatch", "busy", "ignore-writes"])
async def test_a_failed_write_is_counted_and_its_sequence_is_never_used_again(fault: str) -> None:
    writer, wire = await armed()
    wire.soft.fail(fault)
    failed = await writer.offer(scan(), {}, USABLE)
    wire.soft.fail(None)
    written = await writer.offer(scan(), {}, USABLE)
    assert failed is not None and failed.verdict == "failed" and failed.reason
    assert written is not None and written.verdict == "written"
    assert [block[1] for block in wire.blocks] == [1, 2]
    assert (writer.counters.failed, writer.counters.written) == (1, 1)


async def test_arming_ends_by_itself_with_a_block_of_validity_0_and_then_silence() -> None:
    writer, wire = await armed(minutes=1.0)
    assert not writer.expired(EPOCH + 59.9)
    assert writer.expired(EPOCH + 60.0)
    await writer.withdraw(scan(), alarms=1)
    await writer.disarm()
    await writer.offer(scan(), {}, USABLE)
    assert len(wire.blocks) == 1
    assert wire.blocks[0][3] == 0 and wire.blocks[0][19] == 1, "validity 0, the measured alarm still said"
    assert writer.mode == "shadow"


async def test_the_sequence_and_the_heartbeat_round_their_ends() -> None:
    writer, wire = await armed()
    writer.sequence, writer.heartbeat = 0xFFFF, 0xFFFF
    await writer.offer(scan(), {}, USABLE)
    assert wire.blocks[0][1:3] == [0, 1]


def test_the_plcs_counters_are_summed_over_their_wrap_and_its_restart() -> None:
    writer = Writer(LAYOUT, CLOCK, "shadow", 4711)
    refusals = {3: "CRC"}
    for accepted, refused, code in [(65530, 0, 0), (4, 1, 3), (10, 1, 3), (0, 0, 0), (2, 0, 0)]:
        said = {"BlocksAccepted": accepted, "BlocksRefused": refused, "LastRefusal": code}
        writer.take_counts(scan(**said), refusals)
    assert writer.counters.accepted == 10 + 6 + 2
    assert (writer.counters.refused, writer.counters.last_refusal) == (1, "CRC")
    writer.take_counts(scan(BlocksAccepted=None, BlocksRefused=9.0), refusals)
    assert writer.counters.refused == 1, "half an answer is none"

"""After a second without permit, at fifty scans a second, the PLC refused what came: more than 100 numbers ahead."""

from gateway.machine.writing.writeback import Writer
from tests.gateway.test_writeback import USABLE, Wire, armed, scan


async def test_a_block_that_was_not_sent_uses_no_number_up() -> None:
    writer, wire = await armed()
    first = await offered(writer)
    for _ in range(150):
        attempt = await writer.offer(scan(permit=False), {}, USABLE)
        assert attempt is not None and attempt.verdict == "not permitted"
    assert await offered(writer) == first + 1
    assert sequences(wire) == [first, first + 1]


async def test_a_block_that_failed_has_used_its_number_up() -> None:
    writer, wire = await armed()
    first = await offered(writer)
    await wire.soft.close()
    attempt = await writer.offer(scan(), {}, USABLE)
    assert attempt is not None and attempt.verdict == "failed"
    await wire.soft.open()
    assert await offered(writer) == first + 2


async def offered(writer: Writer) -> int:
    attempt = await writer.offer(scan(), {}, USABLE)
    assert attempt is not None and attempt.verdict == "written", attempt
    return attempt.block.sequence


def sequences(wire: Wire) -> list[int]:
    return [block[1] for block in wire.blocks]

"""Transaction ids began at 1 with each connection, and bytes of the next reply made one whole that was cut short.

So what a device server still had for the former connection answered the first question of the next, and 0x1235 was read
as 0x1200 and 0x0002. All in memory and virtual time.
"""

import asyncio
import struct
from collections.abc import Callable
from dataclasses import dataclass, field

import pytest

from benchmarks.memory_net import MemoryLoop, MemoryTransport
from drivers.connections import Connections
from drivers.modbus.driver import ModbusDriver, open_modbus
from drivers.modbus.replies import ID_REUSE_DELAY_S, TransactionIds
from drivers.modbus.rtu import crc
from drivers.tag import Sample, Tag

TEN, FIFTY = Tag("ten", "holding:10"), Tag("fifty", "holding:50")
SHARED = pytest.mark.parametrize("shared", [False, True], ids=["alone", "shared"])
Said = Callable[["Device", MemoryTransport, bytes], None]


@dataclass
class Device:
    """Says `said` to each request; a register holds its own number unless `registers` says otherwise."""

    said: Said
    registers: dict[int, int] = field(default_factory=dict)
    is_line: bool = False
    requests: list[bytes] = field(default_factory=list)
    connections: list[MemoryTransport] = field(default_factory=list)

    def connected(self, connection: MemoryTransport) -> None:
        self.connections.append(connection)

    def heard(self, connection: MemoryTransport, data: bytes) -> None:
        self.requests.append(data)
        self.said(self, connection, data)

    def honest(self, request: bytes) -> bytes:
        head = 0 if self.is_line else 6
        unit, function, address, count = struct.unpack(">BBHH", request[head : head + 6])
        words = [self.registers.get(number, number) for number in range(address, address + count)]
        body = struct.pack(f">BBB{count}H", unit, function, 2 * count, *words)
        return body + crc(body) if self.is_line else request[:4] + len(body).to_bytes(2, "big") + body


def open_on(device: Device, *, shared: bool = False, **settings: object) -> ModbusDriver:
    loop = asyncio.get_running_loop()
    assert isinstance(loop, MemoryLoop)
    loop.peer = device
    given = {"host": "device", "timeout": 0.2, **settings}
    return open_modbus(given, clock=loop.time, connections=Connections() if shared else None)


def run(work: Callable[[], object]) -> None:
    with asyncio.Runner(loop_factory=MemoryLoop) as runner:
        runner.run(work())  # type: ignore[arg-type]


async def read_one(driver: ModbusDriver, tag: Tag) -> Sample:
    """One reading; before the next one there is time for a new connection."""
    (sample,) = await driver.read([tag])
    await asyncio.sleep(1.0)
    return sample


@SHARED
def test_what_a_device_server_has_left_of_the_former_connection_answers_nobody(shared: bool) -> None:
    """Register 10's answer, too late for its connection, is given on the next one when register 50 is asked for."""
    left: list[bytes] = []

    def said(device: Device, connection: MemoryTransport, request: bytes) -> None:
        if int.from_bytes(request[8:10], "big") == 10:
            left.append(device.honest(request))
            connection.hang_up()
        else:
            connection.send([(0.01, frame) for frame in (*left, device.honest(request))])
            left.clear()

    async def work() -> None:
        device = Device(said)
        driver = open_on(device, shared=shared)
        await driver.open()
        for _ in range(3):
            assert not (await read_one(driver, TEN)).quality.is_good
            assert (await read_one(driver, FIFTY)).value == 50
        await driver.close()

    run(work)


@SHARED
@pytest.mark.parametrize("missing", [1, 2, 3, 4, 7, 10])
def test_a_reply_cut_short_is_not_made_whole_by_the_next(shared: bool, missing: int) -> None:
    def said(device: Device, connection: MemoryTransport, request: bytes) -> None:
        honest = device.honest(request)
        pieces = [honest[:missing], honest[missing:]] if len(device.requests) > 1 else [honest[:-missing]]
        connection.send([(0.01, piece) for piece in pieces])

    async def work() -> None:
        device = Device(said, {10: 0x1235})
        driver = open_on(device, shared=shared, attempts=3)
        await driver.open()
        samples = [await read_one(driver, TEN) for _ in range(3)]
        assert {sample.value for sample in samples if sample.quality.is_good} == {0x1235}
        assert len(device.connections) == 2
        await driver.close()

    run(work)


@SHARED
@pytest.mark.parametrize("missing", [1, 2])
def test_nor_by_one_that_nobody_asked_for(shared: bool, missing: int) -> None:
    """Of another reply come just as many bytes as were missing, and its rest later or never."""
    rests = {"soon": (0.01,), "never": ()}

    def said(device: Device, connection: MemoryTransport, request: bytes) -> None:
        honest = device.honest(request)
        if len(device.requests) == 1:
            return
        other = device.honest(device.requests[0])
        more = [(after, other[missing:]) for after in rests[device_rest[0]]]
        if len(device.requests) == 2:
            connection.send([(0.01, honest[:-missing]), (0.01, other[:missing]), *more])
        else:
            connection.send([(0.01, honest)])

    device_rest = [""]

    async def work() -> None:
        device = Device(said, {10: 0x1235})
        driver = open_on(device, shared=shared, attempts=2)
        await driver.open()
        samples = [await read_one(driver, TEN) for _ in range(4)]
        assert {sample.value for sample in samples if sample.quality.is_good} == {0x1235}
        await driver.close()

    for device_rest[0] in rests:
        run(work)


@SHARED
def test_a_reply_in_single_bytes_is_still_one(shared: bool) -> None:
    def said(device: Device, connection: MemoryTransport, request: bytes) -> None:
        connection.send([(0.002, bytes((octet,))) for octet in device.honest(request)])

    async def work() -> None:
        device = Device(said)
        driver = open_on(device, shared=shared)
        await driver.open()
        assert [(await read_one(driver, tag)).value for tag in (TEN, FIFTY) * 300] == [10, 50] * 300
        assert len(device.connections) == 1
        await driver.close()

    run(work)


@SHARED
def test_the_answer_to_an_earlier_reading_is_not_that_of_a_later_ones_second_attempt(shared: bool) -> None:
    """The value of long ago, with the time of now."""

    def said(device: Device, connection: MemoryTransport, request: bytes) -> None:
        if len(device.requests) == 3:
            # Something is answered, so that it is asked again.
            connection.send([(0.01, device.honest(device.requests[1]))])
        elif len(device.requests) == 4:
            connection.send([(0.01, device.honest(device.requests[0]))])

    async def work() -> None:
        device = Device(said, {10: 1})
        driver = open_on(device, shared=shared, attempts=2, max_failures=100, max_silence=60)
        await driver.open()
        assert (await read_one(driver, TEN)).value is None
        await asyncio.sleep(100.0)
        assert (await read_one(driver, TEN)).value is None
        await driver.close()

    run(work)


def test_a_line_does_not_ask_while_the_answer_before_is_being_repeated() -> None:
    """The rest of the copy would be the answer to the next request: unit, function, length and CRC are right."""

    def said(device: Device, connection: MemoryTransport, request: bytes) -> None:
        honest = device.honest(request)
        connection.send([(0.01, honest + honest[:1]), (0.01, honest[1:])])

    async def work() -> None:
        device = Device(said, is_line=True)
        driver = open_on(device, transport="rtu-tcp", attempts=1)
        await driver.open()
        for _ in range(3):
            assert [sample.value for sample in await driver.read([TEN, FIFTY])] == [10, 50]
        await driver.close()

    run(work)


class Drawn:
    """A random generator that draws this."""

    def __init__(self, number: int) -> None:
        self.number = number

    def randint(self, low: int, high: int) -> int:
        assert low <= self.number <= high
        return self.number


def test_an_id_without_an_answer_is_not_used_again_for_ten_minutes() -> None:
    ids = TransactionIds(Drawn(65534))  # type: ignore[arg-type]
    assert [ids.take(0.0) for _ in range(3)] == [65535, 1, 2]
    ids.note_reply(1)
    rest = [ids.take(1.0) for _ in range(65532)]
    assert (rest[0], rest[-1], len(set(rest))) == (3, 65534, 65532)
    assert ids.take(2.0) == 1
    assert ids.take(ID_REUSE_DELAY_S + 0.5) in (65535, 2)

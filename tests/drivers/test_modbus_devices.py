"""What devices are and take: who they say they are, other functions, other frames, connections that end."""

import asyncio
import socket
import struct
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field, replace
from typing import Any

import pytest

from drivers.connections import Connections
from drivers.driver import Complains
from drivers.errors import AddressError, DeviceException, DriverError, LinkDown
from drivers.modbus.address import Area
from drivers.modbus.ascii import AsciiStream, ascii_frame
from drivers.modbus.driver import PinnedDriver, open_modbus
from drivers.modbus.identity import pinned_marks, stranger, text_of_server_id
from drivers.modbus.rtu import crc
from drivers.modbus.settings import connection_place, read_settings
from drivers.modbus.survey import open_survey
from drivers.modbus.wire import read_request
from drivers.tag import DType, Order, Quality, Sample, Tag

TAGS = [Tag(f"T{number}", f"holding:{number}", DType.INT16, writable=True) for number in range(8)]
SOON = {"timeout": 0.5, "backoff_first": 0.01, "backoff_cap": 0.02, "connect_timeout": 5.0}
"""Waits that a busy machine does not meet, but for the pauses between attempts."""


@dataclass
class Device:
    """A device of registers that hold their own numbers, and what it says of itself."""

    objects: dict[int, bytes] = field(default_factory=dict)
    server_id: bytes = b""
    serial: str = "SN-0001"
    refused: frozenset[int] = frozenset()
    ends_connections: bool = False
    even: bool = False
    silent_next: int = 0
    unreached_next: int = 0
    registers: dict[int, int] = field(default_factory=lambda: {number: number for number in range(64)})
    coils: dict[int, int] = field(default_factory=lambda: dict.fromkeys(range(16), 0))
    asked: list[tuple[int, ...]] = field(default_factory=list)

    def __post_init__(self) -> None:
        words = struct.unpack(">8H", self.serial.encode().ljust(16, b"\0"))
        self.registers |= dict(zip(range(40, 48), words, strict=True))

    def answer(self, pdu: bytes) -> bytes | None:
        function = pdu[0]
        if self.silent_next:
            self.silent_next -= 1
            return None
        if self.unreached_next:
            self.unreached_next -= 1
            return bytes((function | 0x80, 11))
        if function in self.refused:
            return bytes((function | 0x80, 1))
        if function == 43:
            self.asked.append((43, pdu[2], pdu[3]))
            known = {key: text for key, text in self.objects.items() if key >= pdu[3]}
            body = b"".join(bytes((key, len(text))) + text for key, text in known.items())
            return bytes((43, 14, pdu[2], 1, 0, 0, len(known))) + body if self.objects else bytes((43 | 0x80, 1))
        if function == 17:
            self.asked.append((17,))
            return bytes((17, len(self.server_id))) + self.server_id if self.server_id else bytes((17 | 0x80, 1))
        start, number = struct.unpack(">HH", pdu[1:5])
        self.asked.append((function, start, number))
        if function == 6:
            self.registers[start] = number
            return pdu[:5]
        if function == 5:
            self.coils[start] = number == 0xFF00
            return pdu[:5]
        if function == 16:
            words = struct.unpack(f">{number}H", pdu[6:])
            self.registers |= dict(zip(range(start, start + number), words, strict=True))
            return pdu[:5]
        if function == 1:
            bits = sum(self.coils[start + place] << place for place in range(number))
            return bytes((1, (number + 7) // 8)) + bits.to_bytes((number + 7) // 8, "little")
        if self.even and (start % 2 or number % 2):
            return bytes((function | 0x80, 3))
        return struct.pack(
            f">BB{number}H", function, 2 * number, *(self.registers[at] for at in range(start, start + number))
        )


@dataclass
class Socket:
    """A plug: whatever device is put in answers on connections to it."""

    device: Device
    connections: int = 0
    tasks: set[Any] = field(default_factory=set)
    open: list[asyncio.StreamWriter] = field(default_factory=list)

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.connections += 1
        self.tasks.add(asyncio.current_task())
        self.open.append(writer)
        try:
            while True:
                head = await reader.readexactly(7)
                pdu = self.device.answer(await reader.readexactly(int.from_bytes(head[4:6], "big") - 1))
                if pdu is None:
                    continue
                writer.write(head[:4] + (len(pdu) + 1).to_bytes(2, "big") + head[6:] + pdu)
                if self.device.ends_connections:
                    break
        except (asyncio.IncompleteReadError, OSError, asyncio.CancelledError):
            pass
        self.open.remove(writer)
        writer.close()

    async def close(self) -> None:
        for task in self.tasks:
            task.cancel()
        await asyncio.gather(*self.tasks, return_exceptions=True)

    def swap(self, device: Device, *, cable: bool = True) -> None:
        """Put another device in; with `cable` the connections end, without it they go on to the other one."""
        self.device = device
        for writer in self.open if cable else ():
            writer.transport.abort()


@asynccontextmanager
async def plugged(device: Device, write_map: list[Tag] = TAGS, **settings: Any) -> AsyncIterator[tuple[Socket, Any]]:
    plug = Socket(device)
    server = await asyncio.start_server(plug.serve, "127.0.0.1", 0)
    where = {"host": "127.0.0.1", "port": server.sockets[0].getsockname()[1], **SOON, **settings}
    driver = open_modbus(where, clock=asyncio.get_running_loop().time, write_map=write_map)
    try:
        await driver.open()
        yield plug, driver
    finally:
        await driver.close()
        server.close()
        await plug.close()


async def read_until(driver: Any, done: Callable[[list[Sample]], bool]) -> list[Sample]:
    async with asyncio.timeout(60):
        while not done(samples := await driver.read(TAGS)):
            for number, sample in enumerate(samples):
                assert not sample.quality.is_good or sample.value == number
            await asyncio.sleep(0.01)
    return samples


def good(samples: list[Sample]) -> bool:
    return all(sample.quality.is_good for sample in samples)


# ---------------------------------------------------------------- who it is

FIRST = {0: b"Maker", 1: b"P-1", 2: b"v3"}
MARKS: dict[str, tuple[dict[str, Any], dict[str, Any], dict[str, Any]]] = {
    # the setting, the device that it is of, and another one
    "an object": ({"product code": "P-1"}, {"objects": FIRST}, {"objects": FIRST | {1: b"P-2"}}),
    "an object of the maker's own": (
        {"object 128": "4711"},
        {"objects": FIRST | {128: b"4711"}},
        {"objects": FIRST | {128: b"4712"}},
    ),
    "an object that the other one lacks": ({"model": "M"}, {"objects": FIRST | {5: b"M"}}, {"objects": FIRST}),
    "a server id": ({"server id": "PLC 1"}, {"server_id": b"PLC 1\xff"}, {"server_id": b"PLC 2\xff"}),
    "a server id that is no text": ({"server id": "0901"}, {"server_id": b"\x09\x01"}, {"server_id": b"\x09\x02"}),
    "no server id at all": ({"server id": "PLC 1"}, {"server_id": b"PLC 1"}, {}),
    "a serial number as text": ({"holding:40-47": "SN-0001"}, {}, {"serial": "SN-0002"}),
    "a serial number that goes on": ({"holding:40-47": "SN-0001"}, {}, {"serial": "SN-00012"}),
    "a number": ({"holding:40-41": 0x534E2D30}, {}, {"serial": "SM-0001"}),
    "words": ({"holding:42-43": [0x3030, 0x3100]}, {}, {"serial": "SN-0009"}),
    "two marks": (
        {"vendor": "Maker", "holding:40-47": "SN-0001"},
        {"objects": FIRST},
        {"objects": FIRST, "serial": "SN-0002"},
    ),
}  # fmt: skip


@pytest.mark.parametrize(
    ("mark", "shown_by"),
    [*((mark, by) for mark in MARKS for by in ("a connection", "silence")), ("a serial number as text", "a gateway")],
)
async def test_a_device_that_is_not_the_pinned_one_is_not_believed_and_not_written(mark: str, shown_by: str) -> None:
    (setting, own, other), cable = MARKS[mark], shown_by == "a connection"
    async with plugged(Device(**own), identity=setting) as (plug, driver):
        assert isinstance(driver, PinnedDriver) and isinstance(driver, Complains)
        assert good(await driver.read(TAGS)) and driver.complaints() == ()
        await driver.write([(TAGS[0], 0)])
        # Behind a device server the connection stays, and what shows the change is one question without an answer.
        stranger = Device(**other, silent_next=shown_by == "silence", unreached_next=shown_by == "a gateway")
        plug.swap(stranger, cable=cable)
        samples = await read_until(driver, lambda samples: bool(driver.complaints()))
        assert all(sample.value is None and sample.quality is Quality.NOT_CONNECTED for sample in samples)
        assert "another device" in samples[0].reason and "pinned" in samples[0].reason
        with pytest.raises(LinkDown, match="another device"):
            await driver.write([(TAGS[0], 7)])
        assert not [row for row in stranger.asked if row[0] in (5, 6, 15, 16)]
        back = Device(**own)
        plug.swap(back)
        assert good(await read_until(driver, good)) and driver.complaints() == ()


async def test_a_write_is_not_sent_over_a_connection_on_which_the_device_has_not_said_who_it_is() -> None:
    async with plugged(Device(), identity={"holding:40-47": "SN-0001"}) as (plug, driver):
        assert good(await driver.read(TAGS))
        stranger = Device(serial="SN-0002")

        def swapped_in_the_last_moment() -> None:
            plug.swap(stranger)

        # Whatever happens between the question and the write: where it is sent it goes to the device that has answered.
        with pytest.raises(DriverError):
            await driver.write([(TAGS[0], 7)], before_sending=swapped_in_the_last_moment)
        await read_until(driver, lambda samples: bool(driver.complaints()))
        assert not [row for row in stranger.asked if row[0] == 16]


def swapped_at(own: Device, plug: Socket, stranger: Device, question: bytes, count: int = 1) -> None:
    """Put the stranger in, over the same connection, once its own device has answered the question so often."""
    answer, left = own.answer, count

    def answer_and_go(pdu: bytes) -> bytes | None:
        nonlocal left
        said = answer(pdu)
        if pdu.startswith(question):
            left -= 1
            if not left:
                plug.swap(stranger, cable=False)
        return said

    own.answer = answer_and_go  # type: ignore[method-assign]


SERIAL_ASKED = bytes((3, 0, 40, 0, 8))


@pytest.mark.parametrize("shown_by", ["silence", "a gateway"])
async def test_marks_that_are_told_before_and_after_a_silence_are_not_one_devices(shown_by: str) -> None:
    own, pinned = Device(objects=FIRST), {"holding:40-47": "SN-0001", "vendor": "Maker"}
    # Of the stranger all is the same but the mark that has been told already.
    stranger = Device(
        objects=FIRST, serial="SN-0002", silent_next=shown_by == "silence", unreached_next=shown_by == "a gateway"
    )
    async with plugged(own, identity=pinned) as (plug, driver):
        swapped_at(own, plug, stranger, SERIAL_ASKED)
        samples = await read_until(driver, lambda _: bool(driver.complaints()))
        assert not any(sample.quality.is_good for sample in samples)
        with pytest.raises(LinkDown):
            await driver.write([(TAGS[0], 7)])
        assert stranger.registers[0] == 0


async def test_an_answer_that_came_to_a_question_asked_again_is_no_proof_of_who_is_there_now() -> None:
    # It may be the late one to the first attempt, of whom was there then.
    own, stranger = Device(silent_next=1), Device(serial="SN-0002")
    async with plugged(own, identity={"holding:40-47": "SN-0001"}) as (plug, driver):
        swapped_at(own, plug, stranger, SERIAL_ASKED, count=2)
        await read_until(driver, lambda _: bool(driver.complaints()))
        with pytest.raises(LinkDown):
            await driver.write([(TAGS[0], 7)])


async def test_parts_of_an_identification_before_and_after_a_silence_are_not_one_devices() -> None:
    class InParts(Device):
        def answer(self, pdu: bytes) -> bytes | None:
            if pdu[0] != 43 or self.silent_next:
                return super().answer(pdu)
            later = pdu[3] > 0
            objects = ((1, self.objects[1]),) if later else ((0, self.objects[0]),)
            reply = identification_of(*objects)
            return reply if later else reply[:4] + bytes((0xFF, 1)) + reply[6:]

    own, pinned = InParts(objects=FIRST), {"product code": "P-1", "vendor": "Maker"}
    stranger = InParts(objects=FIRST | {0: b"Others"}, silent_next=1)
    async with plugged(own, identity=pinned) as (plug, driver):
        assert good(await driver.read(TAGS))
        plug.swap(own)
        swapped_at(own, plug, stranger, bytes((43, 14, 1, 0)))
        samples = await read_until(driver, lambda _: bool(driver.complaints()))
        assert not any(sample.quality.is_good for sample in samples)


async def test_who_says_a_thing_in_two_ways_over_two_replies_has_not_said_it() -> None:
    class TwoFaced(Device):
        def answer(self, pdu: bytes) -> bytes | None:
            if pdu[0] != 43:
                return super().answer(pdu)
            if pdu[3]:
                return identification_of((0, b"Maker"), (1, b"P-1"), count=2)
            return bytes((43, 14, 1, 1, 0xFF, 1, 1)) + identification_of((0, b"Others"))[7:]

    # Whichever is asked for first, and by whom.
    for pinned in ({"product code": "P-1", "vendor": "Maker"}, {"vendor": "Others", "product code": "P-1"}):
        async with plugged(TwoFaced(), identity=pinned) as (_, driver):
            samples = await driver.read(TAGS)
            assert not any(sample.quality.is_good for sample in samples)
            assert "vendor is said in two ways" in samples[0].reason
    async with plugged(TwoFaced()) as (plug, _):
        where = {"host": "127.0.0.1", "port": plug.open[0].get_extra_info("sockname")[1], **SOON}
        async with open_survey(where, clock=asyncio.get_running_loop().time) as survey:
            with pytest.raises(DriverError, match="vendor is said in two ways"):
                await survey.identity()


async def test_an_object_that_is_not_pinned_may_be_told_anew_each_time() -> None:
    class Telling(Device):
        """It has an object with how long it has been on, and says its last object in a second part."""

        def answer(self, pdu: bytes) -> bytes | None:
            if pdu[0] != 43:
                return super().answer(pdu)
            self.asked.append((43,))
            if pdu[3]:
                return identification_of((131, b"Rack 2"))
            said = identification_of((0, b"Maker"), (128, b"%d s" % len(self.asked)), (130, b"SN-0001"), count=3)
            return said[:4] + bytes((0xFF, 131)) + said[6:]

    pinned = {"object 130": "SN-0001", "object 131": "Rack 2"}
    async with plugged(Telling(), identity=pinned) as (plug, driver):
        samples = await driver.read(TAGS)
        assert good(samples), samples[0].reason
        where = {"host": "127.0.0.1", "port": plug.open[0].get_extra_info("sockname")[1], **SOON}
        async with open_survey(where, clock=asyncio.get_running_loop().time) as survey:
            said = await survey.identity()
            assert said["vendor"] == "Maker" and said["object 131"] == "Rack 2"


async def test_a_pinned_device_is_asked_again_where_a_gateway_says_that_it_gave_no_reply() -> None:
    async with plugged(Device(), identity={"holding:40-47": "SN-0001"}) as (plug, driver):
        assert good(await driver.read(TAGS))
        plug.swap(Device())
        await read_until(driver, good)
        plug.swap(gone := Device(unreached_next=2), cable=False)
        # The reading and its repeat; who it is with the next one.
        assert all(sample.quality is Quality.NO_COMMUNICATION for sample in await driver.read(TAGS))
        assert good(await driver.read(TAGS)) and not gone.unreached_next
        driver._proof = None
        gone.unreached_next = 1
        assert good(await driver.read(TAGS)), "one disturbed line is no silence of a unit that has been reached"
        driver._proof = None
        gone.unreached_next = 99
        samples = await driver.read(TAGS)
        assert all(sample.quality is Quality.NO_COMMUNICATION for sample in samples)
        assert "exception 11" in samples[0].reason
        left = gone.unreached_next
        await driver.read(TAGS)
        assert gone.unreached_next == left - 1, "a unit that is gone is asked once"


async def test_a_pinned_device_behind_a_gateway_is_surveyed_as_any_is() -> None:
    own = Device(unreached_next=2)
    async with plugged(own, identity={"holding:40-47": "SN-0001"}) as (plug, _):
        where = {"host": "127.0.0.1", "port": plug.open[0].get_extra_info("sockname")[1], **SOON}
        pinned = {**where, "identity": {"holding:40-47": "SN-0001"}}
        async with open_survey(pinned, clock=asyncio.get_running_loop().time) as survey:
            assert good([raw.sample for raw in await survey.tags(TAGS)])


@pytest.mark.parametrize("asked_by", ["another driver of the unit", "somebody who looks on", "a reading given up"])
@pytest.mark.parametrize("shown_by", ["silence", "a gateway"])
async def test_a_silence_of_the_unit_counts_whoever_has_asked(asked_by: str, shown_by: str) -> None:
    plug = Socket(Device())
    server = await asyncio.start_server(plug.serve, "127.0.0.1", 0)
    where = {"host": "127.0.0.1", "port": server.sockets[0].getsockname()[1], **SOON}
    connections, clock = Connections(), asyncio.get_running_loop().time
    pinned = {**where, "identity": {"holding:40-47": "SN-0001"}}
    driver = open_modbus(pinned, clock=clock, write_map=TAGS, connections=connections)
    other = open_modbus(where, clock=clock, connections=connections)
    try:
        await driver.open()
        await other.open()
        assert good(await driver.read(TAGS))
        silent = shown_by == "silence"
        stranger = Device(serial="SN-0002", silent_next=int(silent), unreached_next=int(not silent))
        plug.swap(stranger, cable=False)
        if asked_by == "another driver of the unit":
            await other.read(TAGS)
        elif asked_by == "somebody who looks on":
            with pytest.raises(DriverError):
                await other.by_hand(read_request(Area.HOLDING, 0, 1, 1), 0.1)
        else:
            asked = asyncio.ensure_future(driver.read(TAGS))
            async with asyncio.timeout(60):
                while stranger.silent_next or stranger.unreached_next:
                    await asyncio.sleep(0.005)
            asked.cancel()
            await asyncio.wait([asked])
        with pytest.raises(LinkDown, match="another device"):
            await driver.write([(TAGS[0], 7)])
        assert stranger.registers[0] == 0
    finally:
        await driver.close()
        await other.close()
        server.close()
        await plug.close()


async def test_a_device_that_does_not_say_who_it_is_is_not_believed() -> None:
    async with plugged(Device(), identity={"vendor": "Maker"}) as (_, driver):
        samples = await driver.read(TAGS)
        assert not any(sample.quality.is_good for sample in samples) and "says nothing of it" in samples[0].reason


def identification_of(*objects: tuple[int, bytes], count: int = 1, longer: int = 0, behind: bytes = b"") -> bytes:
    body = b"".join(bytes((number, len(text) + longer)) + text for number, text in objects)
    return bytes((43, 14, 1, 1, 0, 0, count)) + body + behind


@pytest.mark.parametrize(
    ("reply", "reason"),
    [
        (identification_of((0, b"Maker"), count=9), ""),  # of some devices the count is that of all replies
        (identification_of((0, b"Maker"), longer=3), "vendor ends 3 bytes behind the reply"),
        (identification_of((0, b"Maker"), behind=b" of others"), "10 bytes follow its last object"),
        (identification_of((0, b"Others"), (0, b"Maker"), count=2), "vendor is said in two ways"),
        (identification_of((0, b"Maker"), behind=b"\1", count=2), "product code ends 1 bytes behind the reply"),
        (identification_of((0, b"Others"), count=0), "8 bytes follow its last object"),
        (bytes((43, 14, 1, 1, 0xFF, 1, 1, 1, 1)) + b"x", "says nothing of it"),  # more follows, for ever the same
    ],
)
async def test_who_says_itself_in_a_broken_way_has_not_said_it(reply: bytes, reason: str) -> None:
    class Broken(Device):
        def answer(self, pdu: bytes) -> bytes | None:
            return reply if pdu[0] == 43 else super().answer(pdu)

    async with plugged(Broken(), identity={"vendor": "Maker"}) as (plug, driver):
        samples = await driver.read(TAGS)
        if not reason:
            assert good(samples)
            return
        assert not any(sample.quality.is_good for sample in samples) and reason in samples[0].reason
        with pytest.raises(LinkDown):
            await driver.write([(TAGS[0], 7)])
        assert not [row for row in plug.device.asked if row[0] == 16]


@pytest.mark.parametrize("said", ["Größe".encode(), "Größe".encode("cp1252")], ids=["UTF-8", "cp1252"])
@pytest.mark.parametrize("pinned", ["Größe", "Größe".encode().decode("latin-1")], ids=["as read", "a character a byte"])
async def test_a_text_is_the_same_in_whatever_bytes_it_is_said(said: bytes, pinned: str) -> None:
    device = Device(objects={0: said})
    async with plugged(device, identity={"vendor": pinned}) as (_, driver):
        assert good(await driver.read(TAGS))


async def test_a_pinned_device_that_hangs_up_after_each_answer_is_read_and_never_written() -> None:
    async with plugged(Device(ends_connections=True), identity={"holding:40-47": "SN-0001"}) as (plug, driver):
        assert good(await read_until(driver, good))
        with pytest.raises(DriverError):
            await driver.write([(TAGS[0], 7)])
        assert not [row for row in plug.device.asked if row[0] == 16]


@pytest.mark.parametrize(
    ("setting", "word"),
    [
        ({}, "must be a table"),
        ({"colour": "red"}, "says nothing of who"),
        ({"vendor": 3}, "give the text"),
        ({"vendor": " "}, "give the text"),
        ({"holding:300-307": ""}, "never given a text"),
        ({"holding:300": "SN4711"}, "room for 2 characters"),
        ({"holding:300": 70000}, "list of its 1 words"),
        ({"holding:300-301": [1]}, "list of its 2 words"),
        ({"holding:9-3": 1}, "no stretch"),
        ({"coil:3": 2}, "list of its 1 words"),
        ("SN", "must be a table"),
    ],
)
def test_an_identity_that_says_nothing_is_refused(setting: Any, word: str) -> None:
    with pytest.raises(DriverError, match="identity") as caught:
        read_settings({"host": "h", "identity": setting})
    assert word in str(caught.value)


# ---------------------------------------------------------------- functions and places


async def test_registers_and_coils_are_written_one_by_one_where_the_device_takes_no_other_function() -> None:
    coils = [Tag(f"C{number}", f"coil:{number}", DType.BOOL, writable=True) for number in range(3)]
    device = Device(refused=frozenset({15, 16}))
    async with plugged(device, [*TAGS, *coils], write_with=[6, 5]) as (_, driver):
        await driver.write([(TAGS[2], 20), (TAGS[1], 10), (TAGS[3], 30)])
        await driver.write([(coil, number != 1) for number, coil in enumerate(coils)])
    assert [row for row in device.asked if row[0] in (5, 6)] == [
        (6, 1, 10), (6, 2, 20), (6, 3, 30), (5, 0, 0xFF00), (5, 1, 0), (5, 2, 0xFF00)
    ]  # fmt: skip
    async with plugged(device) as (_, driver):
        with pytest.raises(DeviceException, match="write_with = 6"):
            await driver.write([(TAGS[0], 1)])


async def test_what_cannot_be_read_back_is_not_where_the_setting_says_so() -> None:
    device = Device()
    device.registers = dict.fromkeys(range(64), 0)
    keep = device.answer
    device.answer = lambda pdu: pdu[:5] if pdu[0] == 16 else keep(pdu)  # type: ignore[method-assign]
    async with plugged(device, read_back="never") as (_, driver):
        await driver.write([(TAGS[0], 1)])
    assert not [row for row in device.asked if row[0] == 3]


async def test_reads_are_aligned_where_the_device_takes_no_others() -> None:
    device = Device(even=True)
    tags = [Tag("A", "holding:3"), Tag("B", "holding:6", DType.FLOAT32), Tag("C", "holding:21")]
    async with plugged(device, aligned=2, max_registers=10) as (_, driver):
        samples = await driver.read(tags)
    assert samples[0].value == 3 and samples[2].value == 21
    assert all(not start % 2 and not number % 2 and number <= 10 for _, start, number in device.asked)


@pytest.mark.parametrize("kind", ["alone", "shared", "as on a line"])
async def test_a_wire_asks_the_system_for_a_few_frames_at_once(monkeypatch: pytest.MonkeyPatch, kind: str) -> None:
    # asyncio's own 256 KiB a reply are page faults: a third of a scan's processor time.
    sizes: dict[int, set[int]] = {}

    def receive(self: socket.socket, size: int, *flags: int) -> bytes:
        sizes.setdefault(self.getpeername()[1], set()).add(size)
        return super(socket.socket, self).recv(size, *flags)

    monkeypatch.setattr(socket.socket, "recv", receive)
    server = await asyncio.start_server(Socket(Device()).serve, "127.0.0.1", 0)
    port = server.sockets[0].getsockname()[1]
    own = {"transaction_id": "any"} if kind == "as on a line" else {}
    connections = Connections() if kind == "shared" else None
    where = {"host": "127.0.0.1", "port": port, **SOON, **own}
    driver = open_modbus(where, clock=asyncio.get_running_loop().time, connections=connections)
    try:
        await driver.open()
        assert good(await driver.read(TAGS))
    finally:
        await driver.close()
        server.close()
    assert max(sizes[port]) <= 16_384


WIDE = {"wide_registers": ["holding:5001-5099", "input:7001-7003"]}
WIDE_TAGS = [
    Tag("volume", "holding:5001", DType.INT32),
    Tag("flow", "holding:5003", DType.FLOAT32),
    Tag("swapped", "holding:5004", DType.FLOAT32, order=Order.CDAB),
    Tag("total", "holding:5010", DType.UINT64),
    Tag("plain", "holding:5000"),
    Tag("beyond", "holding:5100", DType.INT32),
    Tag("rate", "input:7003", DType.FLOAT32),
]


class WideDevice(Device):
    """A flow computer: from a wide address on it answers four bytes for each."""

    def answer(self, pdu: bytes) -> bytes | None:
        function, start, number = struct.unpack(">BHH", pdu[:5])
        self.asked.append((function, start, number))
        held = {5000: b"\0\7", 5001: struct.pack(">i", -123456789), 5003: struct.pack(">f", 2.5)}
        held |= {
            5004: struct.pack(">f", -7.25)[2:] + struct.pack(">f", -7.25)[:2],
            5010: b"\0\0\0\1",
            5011: b"\0\0\0\2",
        }
        held |= {5100: b"\0\1", 5101: b"\0\2", 7003: struct.pack(">f", 0.125)}
        wide = 5001 <= start < 5100 or start >= 7001
        data = b"".join(held.get(at, bytes(4 if wide else 2)) for at in range(start, start + number))
        return bytes((function, len(data))) + data


@pytest.mark.parametrize("attached", [{}, {"transaction_id": "any"}])
async def test_registers_of_32_bits_are_one_address_each(attached: dict[str, Any]) -> None:
    async with plugged(device := WideDevice(), [], **WIDE, **attached) as (_, driver):
        samples = await driver.read(WIDE_TAGS)
        raws = [driver.raw(tag, sample) for tag, sample in zip(WIDE_TAGS, samples, strict=True)]
    values = [sample.value for sample in samples]
    assert values == [-123456789, 2.5, -7.25, (1 << 32) + 2, 7, 65538, 0.125], [sample.reason for sample in samples]
    assert (raws[1].place, raws[1].count, raws[1].raw) == ("holding:5003", 1, (0x4020, 0))
    asked = [(start, number) for _, start, number in device.asked]
    assert sorted(asked) == [(5000, 1), (5001, 11), (5100, 2), (7003, 1)], "no request has both widths"


class FirstDecides(Device):
    """A flow computer that answers a block in the width of its first register."""

    def answer(self, pdu: bytes) -> bytes | None:
        function, start, number = struct.unpack(">BHH", pdu[:5])
        size = number * (4 if 5001 <= start < 5100 else 2)
        return bytes((function, size)) + bytes(size)


async def test_a_block_over_the_border_of_32_bits_is_asked_as_its_first_register_is() -> None:
    plug = Socket(FirstDecides())
    server = await asyncio.start_server(plug.serve, "127.0.0.1", 0)
    settings = SOON | WIDE | {"host": "127.0.0.1", "port": server.sockets[0].getsockname()[1]}
    try:
        async with open_survey(settings, clock=lambda: 0.0) as survey:
            for start, count in ((5000, 2), (5003, 1), (5098, 3)):
                assert len((await survey.read("holding", start, count)).words) == count
    finally:
        server.close()
        await plug.close()


async def test_registers_of_32_bits_without_the_setting_are_refused_with_it() -> None:
    async with plugged(WideDevice(), []) as (_, driver):
        (sample,) = await driver.read([Tag("volume", "holding:5001", DType.INT32)])
    assert sample.value is None and "give wide_registers" in sample.reason


@pytest.mark.parametrize(
    ("tag", "said"),
    [
        (Tag("a", "holding:5001"), "is a register of 32 bits"),
        (Tag("a", "holding:5001", DType.BOOL, bit=3), "the tag is one bit"),
        (Tag("a", "holding:5000", DType.INT32), "begins before holding:5001-5099"),
        (Tag("a", "input:7003", DType.FLOAT64), "reach beyond input:7001-7003"),
    ],
)
async def test_what_is_no_whole_register_of_32_bits_is_no_tag(tag: Tag, said: str) -> None:
    async with plugged(WideDevice(), [], **WIDE) as (_, driver):
        (sample,) = await driver.read([tag])
    assert sample.quality is Quality.CONFIGURATION_ERROR and said in sample.reason


def test_registers_of_32_bits_are_read_alone() -> None:
    tag = Tag("a", "holding:5001", DType.INT32, writable=True)
    with pytest.raises(AddressError, match="such registers are read alone"):
        open_modbus({"host": "127.0.0.1", **WIDE}, clock=lambda: 0.0, write_map=[tag])


@pytest.mark.parametrize("given", ["5001-5999", ["holding:5999-5001"], ["coil:1-2"], ["holding:1-70000"], [5], 7])
def test_a_range_of_32_bits_that_is_none_is_refused(given: object) -> None:
    with pytest.raises(DriverError, match="give ranges of PDU addresses"):
        read_settings({"host": "plc", "wide_registers": given})


def test_ranges_of_32_bits_do_not_overlap() -> None:
    with pytest.raises(DriverError, match="has holding:20 twice"):
        read_settings({"host": "plc", "wide_registers": ["holding:10-20", "holding:20-30", "input:10-20"]})


async def test_a_tag_with_a_period_is_read_no_more_often_and_what_was_read_stands_meanwhile() -> None:
    slow, late, fast = (
        Tag("slow", "holding:1", period=3600.0),
        Tag("late", "holding:2", period=0.05),
        Tag("f", "holding:3"),
    )
    async with plugged(Device()) as (plug, driver):
        first = await driver.read([slow, late, fast])
        assert [sample.value for sample in first] == [1, 2, 3]
        plug.device.registers |= {1: 10, 2: 20, 3: 30}
        second = await driver.read([slow, late, fast])
        assert second[0] == first[0] and second[2].value == 30, "it keeps its time"
        async with asyncio.timeout(60):
            while (await driver.read([slow, late, fast]))[1].value != 20:
                await asyncio.sleep(0.01)
        plug.device.silent_next = 100
        lost = await driver.read([slow, late, fast])
        assert lost[0] == first[0] and not lost[2].quality.is_good
    assert sum(start <= 1 < start + number for _, start, number in plug.device.asked) == 1


SLOW, OTHER, FAST = (
    Tag("slow", "holding:1", DType.INT16, period=3600.0, writable=True),
    Tag("other", "holding:2", DType.INT16, period=3600.0, writable=True),
    Tag("fast", "holding:3", DType.INT16, writable=True),
)


async def test_a_write_lets_go_of_what_it_wrote_over_and_of_nothing_else() -> None:
    tags = [SLOW, OTHER, FAST]
    async with plugged(Device(), tags) as (plug, driver):
        assert [sample.value for sample in await driver.read(tags)] == [1, 2, 3]
        plug.device.registers[1] = 10
        await driver.write([(FAST, 30)])
        assert [sample.value for sample in await driver.read(tags)] == [1, 2, 30], "the period stands"
        await driver.write([(OTHER, 20)])
        assert [sample.value for sample in await driver.read(tags)] == [1, 20, 30]


async def test_what_is_written_while_it_is_read_is_read_again() -> None:
    tags = [SLOW, OTHER, Tag("far", "holding:40")]
    async with plugged(Device(), tags[:2]) as (plug, driver):
        keep, writing = plug.device.answer, list[asyncio.Task[None]]()

        def written_after_the_first_block(pdu: bytes) -> bytes | None:
            if pdu[:3] == bytes((3, 0, 1)) and not writing:
                writing.append(asyncio.ensure_future(driver.write([(OTHER, 20)])))
            return keep(pdu)

        plug.device.answer = written_after_the_first_block  # type: ignore[method-assign]
        await driver.read(tags)
        await writing[0]
        plug.device.registers[1] = 10
        assert [sample.value for sample in await driver.read(tags)][:2] == [1, 20], "what was not written stands"


async def test_what_was_kept_is_asked_again_over_a_connection_that_is_made_within_a_reading() -> None:
    async with plugged(Device()) as (plug, driver):
        assert good(await driver.read([SLOW, FAST]))
        other = Device(registers={number: 100 + number for number in range(64)})
        plug.swap(other)
        async with asyncio.timeout(60):
            while driver.connected:
                await asyncio.sleep(0.005)
        assert good(await read_again(driver, [SLOW, FAST]))
        # And where it is noticed in the middle of a reading: by a device server that goes on to the other one.
        keep = other.answer

        def gone(pdu: bytes) -> bytes | None:
            plug.swap(Device())
            return keep(pdu)

        other.answer = gone  # type: ignore[method-assign]
        samples = await driver.read([SLOW, FAST])
        while not samples[1].quality.is_good:
            samples = await driver.read([SLOW, FAST])
        assert [sample.value for sample in samples] == [1, 3]


async def read_again(driver: Any, tags: list[Tag]) -> list[Sample]:
    """The first reading of which all are good."""
    async with asyncio.timeout(60):
        while not good(samples := await driver.read(tags)):
            await asyncio.sleep(0.01)
    return samples


async def test_what_was_kept_of_another_device_is_forgotten() -> None:
    slow = Tag("slow", "holding:1", period=3600.0)
    async with plugged(Device(), identity={"holding:40-47": "SN-0001"}) as (plug, driver):
        other = Device(serial="SN-0002")
        other.registers[1] = 666
        keep = plug.device.answer

        def swapped(pdu: bytes) -> bytes | None:
            if pdu[0] == 3 and struct.unpack(">H", pdu[1:3])[0] == 1:
                plug.swap(other)
                return other.answer(pdu)
            return keep(pdu)

        plug.device.answer = swapped  # type: ignore[method-assign]
        async with asyncio.timeout(60):
            while not driver.complaints():
                assert not (await driver.read([slow]))[0].quality.is_good
                await asyncio.sleep(0.01)
        plug.swap(Device())
        async with asyncio.timeout(60):
            while not (samples := await driver.read([slow]))[0].quality.is_good:
                await asyncio.sleep(0.01)
        assert samples[0].value == 1


# ---------------------------------------------------------------- connections that end


async def test_a_device_that_hangs_up_after_each_answer_is_read_and_a_write_is_read_back() -> None:
    tags = [*TAGS, Tag("far", "holding:40")]
    async with plugged(Device(ends_connections=True)) as (plug, driver):
        async with asyncio.timeout(60):
            while not good(await driver.read(tags)):
                await asyncio.sleep(0.01)
        for _ in range(3):
            assert good(await driver.read(tags)), "of several requests each has its connection"
        async with asyncio.timeout(60):
            while True:
                try:
                    await driver.write([(TAGS[0], 0)])
                    break
                except LinkDown:  # it hung up in the very moment: nothing is sent twice
                    await asyncio.sleep(0.01)
        assert (16, 0, 1) in plug.device.asked


async def test_one_that_hangs_up_under_the_question_of_reading_back_is_asked_on_the_next_connection() -> None:
    device = Device()
    async with plugged(device, timeout=5.0) as (plug, driver):
        keep, cut = device.answer, list[bytes]()

        def hung_up(pdu: bytes) -> bytes | None:
            if cut or pdu[0] != 3 or (16, 0, 1) not in device.asked:
                return keep(pdu)
            cut.append(pdu)
            plug.open[-1].close()
            return None

        device.answer = hung_up  # type: ignore[method-assign]
        await driver.write([(TAGS[0], 7)])
        assert cut and device.asked.count((16, 0, 1)) == 1 and device.asked[-1] == (3, 0, 1)


async def test_a_write_without_an_answer_ends_the_connection_that_it_was_sent_on() -> None:
    async with plugged(Device(ends_connections=True)) as (plug, driver):
        async with asyncio.timeout(60):
            while not good(await driver.read(TAGS)) or plug.connections < 5:
                await asyncio.sleep(0.01)
        plug.device.ends_connections = False  # it has the habit, and is in the middle of a connection
        async with asyncio.timeout(60):
            while not plug.open or not good(await driver.read(TAGS)):
                await asyncio.sleep(0.01)
        keep, sent_on = plug.device.answer, list[asyncio.StreamWriter]()

        def unanswered(pdu: bytes) -> bytes | None:
            if pdu[0] != 16:
                return keep(pdu)
            sent_on.extend(plug.open[-1:])
            return None

        plug.device.answer = unanswered  # type: ignore[method-assign]
        with pytest.raises(DriverError):
            await driver.write([(TAGS[1], 777)])
        assert len(sent_on) == 1
        async with asyncio.timeout(20):
            while sent_on[0] in plug.open:
                await asyncio.sleep(0.01)


async def test_a_connection_is_left_to_others_between_two_scans() -> None:
    async with plugged(Device(), close_between_scans=True) as (plug, driver):
        for count in (1, 2, 3):
            assert good(await driver.read(TAGS)) and driver.connected
            async with asyncio.timeout(60):
                while plug.open:
                    await asyncio.sleep(0.005)
            assert plug.connections in (count, count + 1), "the first one is made by the start"
        await driver.write([(TAGS[0], 0)])
        async with asyncio.timeout(60):
            while plug.open:
                await asyncio.sleep(0.005)


async def test_a_pinned_device_is_asked_who_it_is_once_a_scan_over_the_connection_that_is_read() -> None:
    async with plugged(Device(), identity={"holding:40-47": "SN-0001"}, close_between_scans=True) as (plug, driver):
        for count in (1, 2, 3):
            assert good(await driver.read(TAGS))
            async with asyncio.timeout(60):
                while plug.open:
                    await asyncio.sleep(0.005)
            assert plug.connections in (count, count + 1), "the first one is made by the start"
            assert plug.device.asked == [(3, 40, 8), (3, 0, 8)]
            plug.device.asked.clear()
        plug.swap(Device(serial="SN-0002"))
        assert not any(sample.quality.is_good for sample in await driver.read(TAGS))
        assert "another device" in driver.complaints()[0]


async def test_what_has_a_period_is_kept_over_the_connections_of_a_pinned_device() -> None:
    pinned = {"identity": {"holding:40-47": "SN-0001"}, "close_between_scans": True}
    async with plugged(Device(), **pinned) as (plug, driver):
        assert good(first := await driver.read([SLOW, FAST]))
        plug.device.registers[3] = 30
        second = await driver.read([SLOW, FAST])
        assert second[0] == first[0] and second[1].value == 30
        plug.swap(Device(serial="SN-0002"))
        assert not any(sample.quality.is_good for sample in await driver.read([SLOW, FAST]))


# ---------------------------------------------------------------- other frames


class Datagrams(asyncio.DatagramProtocol):
    """A device over UDP that loses the first of two questions and says everything twice."""

    def __init__(self, device: Device) -> None:
        self.device, self.count = device, 0

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self.transport: Any = transport

    def datagram_received(self, data: bytes, addr: Any) -> None:
        self.count += 1
        pdu = self.device.answer(data[7:])
        if self.count % 2 and pdu is not None:
            frame = data[:4] + (len(pdu) + 1).to_bytes(2, "big") + data[6:7] + pdu
            self.transport.sendto(b"\0\1" + frame[2:], addr)
            self.transport.sendto(frame, addr)
            self.transport.sendto(frame, addr)


async def test_datagrams_that_are_lost_doubled_or_of_another_number_are_told_apart() -> None:
    loop, device = asyncio.get_running_loop(), Device()
    transport, _ = await loop.create_datagram_endpoint(lambda: Datagrams(device), local_addr=("127.0.0.1", 0))
    port = transport.get_extra_info("sockname")[1]
    where = {"transport": "udp", "host": "127.0.0.1", "port": port, "timeout": 0.2, "attempts": 2, "unit": 0}
    driver = open_modbus(where, clock=loop.time, write_map=TAGS)
    try:
        await driver.open()
        assert good(await read_until(driver, good))
        assert good(await read_until(driver, good))
        await read_until(driver, lambda samples: samples[7].value == 7)
    finally:
        await driver.close()
        transport.close()


def test_an_ascii_frame_is_the_rtu_frame_of_its_content() -> None:
    plain = bytes((1, 3, 0, 0, 0, 2))
    frame = ascii_frame(plain + crc(plain))
    assert frame == b":010300000002FA\r\n"  # MODBUS over Serial Line V1.02, appendix B
    stream = AsciiStream()
    assert b"".join(stream.take(frame[at : at + 1]) for at in range(len(frame))) == plain + crc(plain)
    assert stream.take(b"\0\xff" + frame + frame) == 2 * (plain + crc(plain)) and not stream.spoilt
    assert stream.take(b":0103" + frame) == plain + crc(plain), "one that was cut short is passed over"
    for broken in (frame.replace(b"FA", b"FB"), b":\r\n", b":01\r\n", b":0103000000 2FA\r\n", b"0103\r\n", b":0\r\n"):
        assert stream.take(broken) == b""
    assert stream.spoilt == 6


@pytest.mark.parametrize("noise", [b"", b"\0", b":01"])
async def test_ascii_frames_are_read_and_written(noise: bytes) -> None:
    device, stream, gone = Device(), AsciiStream(), asyncio.Event()

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while data := await reader.read(600):
            if frame := stream.take(data):
                pdu = device.answer(frame[1:-2])
                if pdu is not None:
                    plain = frame[:1] + pdu
                    writer.write(noise + ascii_frame(plain + crc(plain)))
        writer.close()
        gone.set()

    server = await asyncio.start_server(serve, "127.0.0.1", 0)
    where = {"transport": "ascii-tcp", "host": "127.0.0.1", "port": server.sockets[0].getsockname()[1], "timeout": 5.0}
    driver = open_modbus(where, clock=asyncio.get_running_loop().time, write_map=TAGS)
    try:
        await driver.open()
        assert good(await driver.read(TAGS)) and [s.value for s in await driver.read(TAGS)] == list(range(8))
        await driver.write([(TAGS[0], -5)])
        assert device.registers[0] == 0x10000 - 5
    finally:
        await driver.close()
        async with asyncio.timeout(60):
            await gone.wait()
        server.close()


# ---------------------------------------------------------------- hosts as people write them


@pytest.mark.parametrize(
    ("given", "host", "port"),
    [
        ("[::1]", "::1", 502), ("::1", "::1", 502), ("[fe80::1%eth0]:1502", "fe80::1%eth0", 1502),
        ("plc.local:1502", "plc.local", 1502), ("tcp://10.0.0.5:502/", "10.0.0.5", 502), (" plc ", "plc", 502),
        ("modbus-tcp://plc", "plc", 502),
    ],
)  # fmt: skip
def test_a_host_is_taken_as_people_write_it(given: str, host: str, port: int) -> None:
    settings = read_settings({"host": given})
    assert (settings.host, settings.port) == (host, port)
    assert connection_place(settings) == connection_place(read_settings({"host": host, "port": port}))


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ("192.168.1.010", r"write its numbers without a 0 before them \(192\.168\.1\.10\)"),
        ("010.0.0.300", "give four numbers from 0 to 255"), ("...", "give four numbers from 0 to 255"),
        ("10.0.0.5:", "is no IPv6 address; give a port behind one colon"), (":502", "is no IPv6 address"),
        ("plc:502:3", "is no IPv6 address"), ("plc:123456", "is no IPv6 address"), ("[plc:502]", "is no IPv6 address"),
    ],
)  # fmt: skip
def test_what_can_be_no_host_is_refused_with_what_would_be_one(given: str, words: str) -> None:
    with pytest.raises(DriverError, match=words):
        read_settings({"host": given})


def test_a_host_that_contradicts_the_port_is_refused() -> None:
    assert read_settings({"host": "plc:1502", "port": 1502}).port == 1502
    for given in ({"host": "plc:1502", "port": 502}, {"host": "plc:70000"}):
        with pytest.raises(DriverError, match="port"):
            read_settings(given)


def test_whether_a_device_runs_is_no_part_of_who_it_is() -> None:
    running, stopped = b"\x0a\x42\xff", b"\x0a\x42\x00"
    assert text_of_server_id(running) == text_of_server_id(stopped) != text_of_server_id(b"\x0a\x43\x00")
    assert text_of_server_id(b"PLC 7\xff") == text_of_server_id(b"PLC 7\x00") == "PLC 7"


@pytest.mark.parametrize(
    ("said", "pinned", "same"),
    [
        (b"\x0a\x42\xff", "0a42ff", True), (b"\x0a\x42\x00", "0A 42 FF", True), (b"\x0a\x43\x00", "0a42ff", False),
        (b"12FF34\xff", "12FF34", True), (b"120034\xff", "12FF34", False), (b"PLC 7\x00", "PLC 7", True),
    ],
)  # fmt: skip
def test_a_server_id_is_pinned_as_it_was_written_down_while_it_ran_or_did_not(
    said: bytes, pinned: str, same: bool
) -> None:
    (mark,) = pinned_marks({"server id": pinned})
    assert (stranger(mark, mark.found(said), "here") == "") is same


# ---------------------------------------------------------------- factors in registers


def scaled(name: str, at: int, factor: int, **more: Any) -> Tag:
    return Tag(name, f"holding:{at}", DType.INT16, scale_from=f"holding:{factor}", **more)


@pytest.mark.parametrize(
    ("raw", "factor", "value", "quality"),
    [
        (2301, 0xFFFF, 230.1, Quality.GOOD), (2301, 0, 2301, Quality.GOOD), (23, 2, 2300, Quality.GOOD),
        (0xFFFF, 0xFFFE, -0.01, Quality.GOOD), (2301, 0x8000, None, Quality.NO_DATA),
        (2301, 11, None, Quality.OUT_OF_RANGE), (9999, 1, 99990, Quality.OUT_OF_RANGE),
    ],
)  # fmt: skip
async def test_a_value_is_scaled_by_the_register_that_its_tag_names(
    raw: int, factor: int, value: float | None, quality: Quality
) -> None:
    device = Device()
    device.registers |= {10: raw, 12: factor}
    async with plugged(device) as (_, driver):
        (sample,) = await driver.read([scaled("V", 10, 12, low=-100.0, high=5000.0)])
    assert (sample.value, sample.quality) == (value, quality)
    assert device.asked == [(3, 10, 3)], "one reply has both"


@pytest.mark.parametrize(("at", "factor"), [(2, 40), (40, 2)], ids=["behind it", "before it"])
async def test_a_value_and_a_factor_of_two_replies_count_where_the_factor_did_not_change(at: int, factor: int) -> None:
    device = Device()
    device.registers |= {at: 2301, factor: 0xFFFF}
    tags = [scaled("V", at, factor), scaled("U", at + 1, factor)]
    async with plugged(device) as (_, driver):
        for _ in range(2):
            samples = await driver.read(tags)
            assert samples[0].value == 230.1 and good(samples)
        keep = device.answer

        def changed(pdu: bytes) -> bytes | None:
            answered = keep(pdu)
            if pdu[:3] == bytes((3, 0, at)):  # the device changes both when one of them has been read
                device.registers |= {at: 23, factor: 1}
            return answered

        device.answer = changed  # type: ignore[method-assign]
        (torn, _) = await driver.read(tags)
        assert torn.value is None and "factor" in torn.reason
        assert (await driver.read(tags))[0].value == 230


async def test_two_blocks_that_have_the_factors_of_one_another_are_read() -> None:
    device = Device()
    device.registers |= {2: 2301, 3: 0xFFFE, 40: 50, 41: 0xFFFF}
    async with plugged(device) as (_, driver):
        for _ in range(2):
            assert [s.value for s in await driver.read([scaled("A", 2, 41), scaled("B", 40, 3)])] == [230.1, 0.5]


async def test_a_scaled_tag_may_have_a_period() -> None:
    device = Device()
    device.registers |= {10: 2301, 12: 0xFFFF}
    tags = [scaled("V", 10, 12, period=3600.0), Tag("f", "holding:3")]
    async with plugged(device) as (_, driver):
        assert [s.value for s in await driver.read(tags)] == [230.1, 3]
        device.registers |= {10: 1, 3: 30}
        assert [s.value for s in await driver.read(tags)] == [230.1, 30]
    assert sum(start <= 10 < start + number for _, start, number in device.asked) == 1


async def test_a_scaled_tag_with_a_period_whose_factor_changed_is_asked_for_with_the_next_scan() -> None:
    device = Device()
    device.registers |= {2: 2301, 40: 0xFFFF}
    keep = device.answer

    def changed(pdu: bytes) -> bytes | None:
        answered = keep(pdu)
        if pdu[:3] == bytes((3, 0, 2)):
            device.registers |= {2: 23015, 40: 0xFFFE}
        return answered

    device.answer = changed  # type: ignore[method-assign]
    tags = [scaled("V", 2, 40, period=3600.0)]
    async with plugged(device) as (_, driver):
        (torn,) = await driver.read(tags)
        assert torn.value is None and "factor" in torn.reason
        assert [(await driver.read(tags))[0].value for _ in range(2)] == [230.15, 230.15]


async def test_words_that_seem_swapped_are_doubted_with_a_factor_as_they_are_without() -> None:
    device = Device()
    device.registers |= {10: 12345, 11: 0, 12: 0xFFFF}
    tag = Tag("E", "holding:10", DType.UINT32, unit="Wh")
    async with plugged(device) as (_, driver):
        plain, with_factor = await driver.read([tag, replace(tag, name="F", scale_from="holding:12")])
    assert plain.quality is with_factor.quality is Quality.UNCERTAIN and plain.reason == with_factor.reason


async def test_a_factor_that_is_nowhere_is_said() -> None:
    async with plugged(Device()) as (_, driver):
        wrong = [scaled("V", 10, 0), Tag("W", "holding:10", scale_from="coil:3"), Tag("X", "holding:1", scale_from="x")]
        samples = await driver.read([*wrong, Tag("B", "holding:1", DType.BOOL, scale_from="holding:3")])
    assert samples[0].value == 10
    assert all("scale_from" in sample.reason and sample.value is None for sample in samples[1:])

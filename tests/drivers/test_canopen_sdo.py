"""SDO transfers: the driver's client against the software PLC's server, and each against the canopen library."""

import asyncio
import io
import queue
from collections.abc import Callable

import pytest
from canopen import LocalNode, Network
from canopen.objectdictionary.eds import import_eds
from canopen.sdo import SdoClient
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.canopen.channel import SdoChannel
from drivers.canopen.place import ObjectPlace
from drivers.canopen.sdo import SdoAbort, Transfer, block_download, block_upload, download, upload
from drivers.errors import LinkDown, ReplyMismatch, ReplyTimeout
from sim.plc.canopen.eds import Address
from sim.plc.canopen.sdo import NO_OBJECT, READ_ONLY, Abort, SdoServer
from tests.drivers.scripted_node import NODE, eds

HERE, THERE = ObjectPlace(0x2102, 0), ObjectPlace(0x2001, 3)
Lost = Callable[[int, bytes], bool]


class Device:
    """Objects behind the software PLC's SDO server."""

    def __init__(self, **objects: bytes) -> None:
        self.objects: dict[Address, bytes] = {(int(name[1:], 16), 0): data for name, data in objects.items()}
        self.server = SdoServer(self.read, self.write)

    def read(self, address: Address) -> bytes:
        if address not in self.objects:
            raise Abort(NO_OBJECT)
        return self.objects[address]

    def write(self, address: Address, data: bytes) -> None:
        if address[0] == 0x1000:
            raise Abort(READ_ONLY)
        self.objects[address] = data


def carry(transfer: Transfer, server: SdoServer, lost: Lost = lambda number, frame: False) -> bytes:
    """Carry a transfer to its end without a bus; `lost` says which of the client's and server's frames are not."""
    answers: list[bytes] = []
    sent = received = 0
    try:
        frames = next(transfer)
        while True:
            for frame in frames or ():
                sent += 1
                if not lost(sent, frame):
                    answers += server.take(frame)
            if not answers:
                raise TimeoutError
            received += 1
            frames = transfer.send(answers.pop(0))
    except StopIteration as stop:
        data: bytes = stop.value
        return data


@settings(max_examples=60, deadline=None)
@given(st.binary(max_size=2000))
def test_every_length_comes_back_as_it_was_by_each_kind_of_transfer(data: bytes) -> None:
    for put, get in ((download, upload), (block_download, block_upload), (download, block_upload)):
        device = Device(x2102=b"old")
        carry(put(HERE, data), device.server)
        assert device.objects[0x2102, 0] == data
        assert carry(get(HERE), device.server) == data


@pytest.mark.parametrize("size", [1, 6, 7, 8, 447, 448, 449, 889, 890])
def test_a_segment_lost_on_the_way_there_is_sent_again_in_a_block_download(size: int) -> None:
    data = bytes(number % 251 for number in range(size))
    for victim in (2, 3, 20):
        device = Device(x2102=b"")
        # The last segment of a block asks for the answer: without it both sides wait, and the client gives up.
        carried = size > 7 * victim
        if carried:
            carry(block_download(HERE, data), device.server, lambda number, _, at=victim: number == at)
            assert device.objects[0x2102, 0] == data


def test_an_object_that_is_not_there_is_an_abort_with_its_code() -> None:
    for transfer in (upload(THERE), block_upload(THERE)):
        with pytest.raises(SdoAbort, match="object does not exist") as caught:
            carry(transfer, Device().server)
        assert caught.value.code == NO_OBJECT
    for transfer in (
        download(ObjectPlace(0x1000), b"x"),
        download(ObjectPlace(0x1000), bytes(9)),
        block_download(ObjectPlace(0x1000), b"xy"),
    ):
        with pytest.raises(SdoAbort, match="read-only"):
            carry(transfer, Device().server)


def test_a_wrong_checksum_of_a_block_upload_is_not_believed() -> None:
    transfer, server = block_upload(HERE), Device(x2102=bytes(range(50))).server
    answers = [answer for frame in next(transfer) or () for answer in server.take(frame)]
    with pytest.raises(ReplyMismatch, match="CRC"):
        while True:
            answer = answers.pop(0)
            if 0 < answer[0] < 0x80:
                answer = answer[:1] + bytes([answer[1] ^ 1]) + answer[2:]
            answers += [one for frame in transfer.send(answer) or () for one in server.take(frame)]


def test_the_servers_checksum_refuses_a_corrupted_block_download() -> None:
    transfer, device = block_download(HERE, bytes(range(50))), Device(x2102=b"old")
    with pytest.raises(SdoAbort, match="CRC"):
        carry(corrupted(transfer), device.server)
    assert device.objects[0x2102, 0] == b"old"


def corrupted(transfer: Transfer) -> Transfer:
    frames = next(transfer)
    while True:
        bent = [frame[:3] + bytes([frame[3] ^ 8]) + frame[4:] if frame[0] == 2 else frame for frame in frames or ()]
        frames = transfer.send((yield bent))


def test_answers_for_another_object_are_passed_over() -> None:
    transfer = upload(HERE, 2)
    assert next(transfer) == [bytes.fromhex("4002210000000000")]
    assert transfer.send(bytes.fromhex("4b01200301000000")) is None, "an answer for 0x2001:3"
    assert transfer.send(bytes.fromhex("8001200300000206")) is None, "an abort for 0x2001:3"
    with pytest.raises(StopIteration) as stop:
        transfer.send(bytes.fromhex("4b02210007000000"))
    assert stop.value.value == bytes([7, 0])


# ---------------------------------------------------------------- the channel


class Line:
    """A server at the other end of a channel whose answers a test may hold back."""

    def __init__(self, device: Device, timeout: float = 0.3) -> None:
        self.device, self.held, self.sent = device, False, list[bytes]()
        self.waiting: list[bytes] = []
        self.channel = SdoChannel(self.send, timeout)

    def send(self, frame: bytes) -> None:
        self.sent.append(frame)
        self.waiting += self.device.server.take(frame)
        if not self.held:
            self.release()

    def release(self) -> None:
        waiting, self.waiting = self.waiting, []
        for answer in waiting:
            asyncio.get_running_loop().call_soon(self.channel.receive, answer)


async def test_a_late_answer_is_never_taken_for_the_next_request() -> None:
    line = Line(Device(x1000=bytes(4), x2102=b"\1\0"))
    assert await line.channel.read(HERE, 2) == b"\1\0"
    line.held = True
    with pytest.raises(ReplyTimeout):
        await line.channel.read(HERE, 2)
    line.device.objects[0x2102, 0] = b"\2\0"
    line.held = False  # what was held back comes first, as from a server that works through its queue
    assert await line.channel.read(HERE, 2) == b"\2\0"
    assert line.channel.counts["timeouts"] == 1


async def test_a_request_that_was_given_up_is_aborted() -> None:
    line = Line(Device(x1000=bytes(4), x2102=bytes(100)))
    await line.channel.read(HERE)
    line.held = True
    with pytest.raises(ReplyTimeout):
        await line.channel.read(HERE)
    assert line.sent[-1] == bytes.fromhex("8002210000000405"), "0x05040000: timed out"


async def test_without_block_transfer_in_the_server_segments_are_used() -> None:
    device = Device(x1000=bytes(4), x2102=bytes(range(200)))
    line = Line(device)
    take = device.server.take

    def no_blocks(frame: bytes) -> list[bytes]:
        return [bytes.fromhex("8002210001000405")] if frame[0] >> 5 in (5, 6) else take(frame)

    device.server.take = no_blocks  # type: ignore[method-assign]
    for _ in range(2):
        assert await line.channel.read(HERE, block=True) == bytes(range(200))
    assert sum(frame[0] >> 5 == 5 for frame in line.sent) == 1, "it is tried once"


async def test_a_closed_channel_ends_what_waits() -> None:
    line = Line(Device(x1000=bytes(4)), timeout=5.0)
    line.held = True
    reading = asyncio.create_task(line.channel.read(HERE))
    await asyncio.sleep(0.01)
    line.channel.close("the bus is gone")
    with pytest.raises(LinkDown, match="the bus is gone"):
        await reading


# ---------------------------------------------------------------- against the library


class Shortcut(Network):
    """The library's network, with the software PLC's server in the place of the bus."""

    def __init__(self, server: SdoServer) -> None:
        super().__init__()
        self.server, self.client = server, SdoClient(0x601, 0x581, import_eds(io.StringIO(eds()), NODE))
        self.client.network = self

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        for answer in self.server.take(bytes(data)):
            self.client.responses.put(answer)


@pytest.mark.parametrize("size", [1, 4, 5, 7, 8, 48, 448, 1000])
@pytest.mark.parametrize("block", [False, True])
def test_the_software_plcs_server_serves_the_librarys_client(size: int, block: bool) -> None:
    data, device = bytes(number % 256 for number in range(size)), Device(x2102=b"old")
    client = Shortcut(device.server).client
    with client.open(0x2102, 0, "wb", size=size, block_transfer=block, buffering=7) as stream:
        stream.write(data)
    assert device.objects[0x2102, 0] == data
    with client.open(0x2102, 0, "rb", block_transfer=block) as stream:
        assert stream.read() == data


@pytest.mark.parametrize("text", ["a", "four", "seven77", "a text of more than seven bytes", "x" * 500])
def test_the_drivers_client_is_served_by_the_librarys_server(text: str) -> None:
    node = LocalNode(NODE, import_eds(io.StringIO(eds()), NODE))
    answers: queue.Queue[bytes] = queue.Queue()
    node.sdo.send_response = lambda frame: answers.put(bytes(frame))  # type: ignore[method-assign]

    class Served:
        def take(self, frame: bytes) -> list[bytes]:
            node.sdo.on_request(0x600 + NODE, frame, 0.0)
            return [answers.get() for _ in range(answers.qsize())]

    served = Served()
    carry(download(ObjectPlace(0x2200), text.encode()), served)  # type: ignore[arg-type]
    assert node.sdo[0x2200].raw == text
    assert carry(upload(ObjectPlace(0x2200)), served) == text.encode()  # type: ignore[arg-type]

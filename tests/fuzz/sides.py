"""Protocol sides, fed with bytes and frames in memory, and what each has to keep whatever they hold."""

import asyncio
import struct
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path

from drivers.can import CanFrame, TagReading
from drivers.can.fields import decode_value, encode_raw, parse_field
from drivers.canopen.emergency import Emergencies
from drivers.canopen.pdo import map_objects
from drivers.canopen.place import ObjectPlace, from_bytes
from drivers.canopen.sdo import Transfer
from drivers.errors import EncodingError
from drivers.modbus import rtu
from drivers.modbus.verify import Asked, check_reply, split_frames, unpack_words
from drivers.tag import DType, Tag
from drivers.vehicle.isotp import Reassembler
from drivers.vehicle.j1939_transport import Key, TransportSessions
from drivers.vehicle.obd import ObdListener
from gateway.outside.northbound.sparkplug import LONGEST_NAME, MOST_COMMANDS, parse_commands
from gateway.outside.serving import PeerServer
from sim.plc.canopen.node import SDO_ANSWER, CanopenNode
from sim.plc.canopen.objects import read_layout
from sim.plc.canopen.pdo import RPDO
from sim.plc.modbus import framing
from sim.plc.program import ModbusRequest, NodeDisturbance
from tests.fuzz.target import Run
from tests.gateway.support import ROOT
from tests.plc.bench import DECANTER
from tests.plc.test_pdu import plc_of

ASKED = Asked(7, 1, 3, 100, 2)
ANSWER = struct.pack(">HHHBBBHH", 7, 0, 7, 1, 3, 4, 11, 22)


def modbus_client(data: bytes) -> object:
    """What passes the check is the answer, byte for byte, but for the values in it."""
    frames, rest = split_frames(data)
    assert b"".join(frames) + rest == data
    for frame in frames:
        if frame[:2] == ANSWER[:2]:
            check_reply(ASKED, frame)
            assert frame[:9] == ANSWER[:9] and len(frame) == len(ANSWER)
    return frames


def sparkplug_command(data: bytes) -> object:
    """Whatever a broker hands on, what is heard of it is few short lines."""
    heard = parse_commands(data)
    assert len(heard) <= MOST_COMMANDS
    for command in heard:
        assert command.text.isprintable() and len(command.text) <= LONGEST_NAME and isinstance(command.is_true, bool)
    return heard


def rtu_client(data: bytes) -> object:
    """As `modbus_client`; on a line the checksum has to be right, too."""
    asked = Asked(0, 1, 3, 100, 2)
    length = rtu.reply_length(asked, data)
    if length is None or len(data) < length:
        return None
    check_reply(asked, rtu.unwrap(asked, data[:length]))
    assert length == 9 and rtu.crc(data[:7]) == data[7:9]
    return unpack_words(asked, data[3 : length - 2])


class _Numbered:
    """Every address below 1000 holds its own number; the others are not there."""

    def read(self, table: str, start: int, count: int) -> list[int] | int:
        return list(range(start, start + count)) if start + count <= 1000 else 2


def peer_server(data: bytes) -> object:
    """A unit and a request's PDU: the reply is of its function and fits a frame; only a read is answered."""
    if len(data) < 2:
        return None
    reply = PeerServer("127.0.0.1", 0, {1: _Numbered()}).answer(data[0], data[1:])
    assert reply[0] & 0x7F == data[1] & 0x7F and len(reply) <= 253
    assert reply[0] & 0x80 or data[1] in (1, 2, 3, 4)
    return reply


def modbus_server(framed: framing.Framing) -> Callable[[Path], AbstractContextManager[Run]]:
    """Requests cut from a stream and answered by the PLC's program: each reply is of the function that was asked."""

    @contextmanager
    def bench(_: Path) -> Iterator[Run]:
        plc = plc_of(DECANTER)

        async def serve(data: bytes) -> None:
            reader = asyncio.StreamReader()
            reader.feed_data(data)
            reader.feed_eof()
            with suppress(asyncio.IncompleteReadError):
                while not reader.at_eof():
                    frame = await framed.read(reader)
                    if frame.pdu is None:
                        continue
                    head = ("fuzz", frame.transaction, frame.unit, frame.pdu)
                    reply = plc.exchange(ModbusRequest(*head, rtu=framed.rtu), 0.0)
                    assert reply is None or (reply.pdu[0] & 0x7F == frame.pdu[0] & 0x7F and len(reply.frame()) <= 260)

        with asyncio.Runner() as runner:
            yield lambda data: runner.run(serve(data))

    return bench


def frames_of(data: bytes) -> list[bytes]:
    """The bytes eight at a time, as CAN frames have them."""
    return [data[at : at + 8] for at in range(0, len(data), 8)]


def sdo_client(transfer: Callable[[], Transfer]) -> Run:
    """A transfer fed with eight bytes at a time; what comes out has a bound."""

    def run(data: bytes) -> object:
        going = transfer()
        try:
            next(going)
            for frame in frames_of(data):
                if len(frame) == 8:
                    going.send(frame)
        except StopIteration as end:
            assert len(end.value) <= len(data)
            return end.value
        return None

    return run


@contextmanager
def canopen_node(_: Path) -> Iterator[Run]:
    """The software PLC's node: SDO requests, and where bit 7 of the first byte says so, NMT, SYNC and RPDO frames."""
    plc = plc_of(DECANTER)
    layout = read_layout(ROOT / "config/devices/decanter_canopen.toml", plc.registers.tags, plc.registers.blocks)
    node = CanopenNode(layout, plc)

    def run(data: bytes) -> object:
        node.boot(0.0)
        others = [0x000, 0x080, *(pdo.cob_id for pdo in node.objects.pdos(RPDO))]
        which, answers = data[:1] or b"\0", 0
        for number, frame in enumerate(frames_of(data[1:])):
            if which[0] & 0x80 and number % 2:
                for identifier, sent in node.take(others[frame[0] % len(others)], frame[1:], 0.0, NodeDisturbance()):
                    assert 0 <= identifier <= 0x7FF and identifier != SDO_ANSWER and len(sent) <= 8
                continue
            replies = node.answers(frame)
            # A block has at most 127 segments; everything else is answered by one frame.
            assert len(replies) <= 127 and all(len(reply) == 8 for reply in replies)
            answers += len(replies)
        return answers

    yield run


def isotp(data: bytes) -> object:
    """No payload is longer than the standard's, nor all of them than what came in."""
    reassembler, size = Reassembler(), 0
    for number, frame in enumerate(frames_of(data)):
        payload = reassembler.take(0.01 * number, frame)
        size += len(payload or b"")
        assert payload is None or 1 <= len(payload) <= 4095
    assert size <= len(data)
    return reassembler.counts


def obd(data: bytes) -> object:
    """A car's answers: what is read of a tag is GOOD with a value, or says in one line why it is not."""
    listener = ObdListener([Tag("speed", "obd:0C"), Tag("coolant", "obd:05"), Tag("vin", "obd:vin", DType.STRING)])
    read: list[TagReading] = []
    for number, frame in enumerate(frames_of(data)):
        read += listener.take(CanFrame(time=0.01 * number, id=0x7E8 + number % 2, extended=False, data=frame))
    for _, (value, quality, reason) in read:
        assert quality.is_good == (value is not None) and (quality.is_good or reason.isprintable())
    return read


def j1939(data: bytes) -> object:
    """Connection management and data in turns."""
    sessions, key = TransportSessions(), Key("can0", 1, 255)
    for number, frame in enumerate(frames_of(data)):
        if number % 3:
            sessions.packet(0.01 * number, key, frame)
        else:
            sessions.control(0.01 * number, key, frame)
    return sessions.counts()


def can_fields(data: bytes) -> object:
    """A plain field's address, then a payload: a value that is GOOD goes back into the bits that it was read from."""
    address, _, payload = data.partition(b"\n")
    kinds = (DType.UINT16, DType.INT16, DType.UINT32, DType.INT64, DType.FLOAT32, DType.BCD16, DType.BOOL, DType.UINT8)
    tag = Tag("T", address.decode(errors="replace"), kinds[len(payload) % len(kinds)])
    field = parse_field(tag)
    value, quality, reason = decode_value(tag, field, payload)
    assert quality.is_good == (value is not None) and (quality.is_good or reason.isprintable())
    if value is not None:
        with suppress(EncodingError):
            assert decode_value(tag, field, field.bits.put(payload, encode_raw(tag, field, value)))[0] == value
    return value


def canopen_pdo(data: bytes) -> object:
    """A tag's value is GOOD only for the bytes that its type has."""
    objects = map_objects([(ObjectPlace(0x2001, 1 + at), size) for at, size in enumerate(data[:4])], "PDO")
    for mapped in objects:
        piece = mapped.cut(data[4:12])
        value, quality, _ = from_bytes(Tag("T", "0x2001:1", DType.UINT16), piece)
        assert not quality.is_good or (len(piece) == 2 and value == int.from_bytes(piece, "little"))
    return objects


def emergency(data: bytes) -> object:
    """Emergency frames of any length, and what is said of them."""
    emergencies = Emergencies()
    for frame in frames_of(data):
        emergencies.take(frame)
    return emergencies.verdict(), emergencies.sentences()

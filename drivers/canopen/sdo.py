"""SDO transfers of a client as frames in and out: expedited, segmented and block, both ways (CiA 301, 7.2.4; no I/O).

A transfer is a generator: it yields the frames to be sent, is sent the next answer of the server, and returns what was
read. An empty list waits for the next of several answers, None for another one instead of the last. Answers that belong
to another object, such as a late one to a request that was given up, are passed over. `channel.py` carries the frames.

The library's own client is not used: it takes the abort of another request for its own, does not look at the object of
a confirmed download, and blocks a thread.
"""

from binascii import crc_hqx
from collections.abc import Generator

from drivers.canopen.place import ObjectPlace
from drivers.errors import DeviceException, ReplyMismatch

Transfer = Generator[list[bytes] | None, bytes, bytes]

MAX_OBJECT_BYTES = 1 << 20
"""Bytes of one object: a server that announces or sends more is not believed."""
BLOCK_SEGMENTS = 127
TIMED_OUT, UNKNOWN_COMMAND = 0x05040000, 0x05040001
ABORTS = {
    0x05030000: "toggle bit not alternated",
    0x05040000: "SDO protocol timed out",
    0x05040001: "command specifier not valid or unknown",
    0x05040002: "invalid block size",
    0x05040003: "invalid sequence number",
    0x05040004: "CRC error",
    0x05040005: "out of memory",
    0x06010000: "unsupported access to an object",
    0x06010001: "attempt to read a write-only object",
    0x06010002: "attempt to write a read-only object",
    0x06020000: "object does not exist",
    0x06040041: "object cannot be mapped to the PDO",
    0x06040042: "the mapped objects would exceed the PDO's length",
    0x06040043: "general parameter incompatibility",
    0x06040047: "general internal incompatibility in the device",
    0x06060000: "access failed due to a hardware error",
    0x06070010: "length of the parameter does not match",
    0x06070012: "length of the parameter too high",
    0x06070013: "length of the parameter too low",
    0x06090011: "sub-index does not exist",
    0x06090030: "invalid value for the parameter",
    0x06090031: "value written too high",
    0x06090032: "value written too low",
    0x060A0023: "resource not available",
    0x08000000: "general error",
    0x08000020: "data cannot be transferred or stored",
    0x08000021: "data cannot be stored because of local control",
    0x08000022: "data cannot be stored in the present device state",
    0x08000023: "no object dictionary is present",
    0x08000024: "no data available",
}
ABOUT_OBJECTS = frozenset(code for code in ABORTS if code >> 24 == 0x06)
"""Aborts that are about the object asked for and not about the moment."""


class SdoAbort(DeviceException):
    """The server aborted the transfer; `code` is its abort code."""

    def __init__(self, place: ObjectPlace, code: int) -> None:
        super().__init__(code, f"{place}: SDO abort 0x{code:08X}, {ABORTS.get(code, 'no code of CiA 301')}")
        self.place = place


def abort_frame(place: ObjectPlace, code: int) -> bytes:
    """The frame by which a client gives a transfer up."""
    return _head(0x80, place) + code.to_bytes(4, "little")


def upload(place: ObjectPlace, size: int | None = None) -> Transfer:
    """Read an object. `size` (bytes) cuts an expedited answer that does not say how much of it is data."""
    answer = yield from _await_initiation([_head(0x40, place) + bytes(4)], place, 2)
    # CiA 301, 7.2.4.3.6: bit 1 expedited, bit 0 whether a size is said, bits 2..3 how many of the four bytes are none.
    command = answer[0]
    if command & 2:
        count = 4 - (command >> 2 & 3) if command & 1 else min(size or 4, 4)
        return answer[4 : 4 + count]
    announced = int.from_bytes(answer[4:8], "little") if command & 1 else None
    if announced is not None and announced > MAX_OBJECT_BYTES:
        raise ReplyMismatch(f"{place}: {announced} bytes are announced, and {MAX_OBJECT_BYTES} are the most")
    # 7.2.4.3.7: the toggle bit (4) changes with every segment, so that one that comes twice is not taken for the next;
    # bits 1..3 are the bytes without data, bit 0 says that it was the last.
    data, toggle, more = bytearray(), 0, True
    while more:
        answer = yield from _segment(bytes([0x60 | toggle]) + bytes(7), place, 0, toggle)
        data += answer[1 : 8 - (answer[0] >> 1 & 7)]
        more, toggle = not answer[0] & 1, toggle ^ 0x10
        if len(data) > MAX_OBJECT_BYTES:
            raise ReplyMismatch(f"{place}: more than {MAX_OBJECT_BYTES} bytes, and no end")
    return _whole(place, bytes(data), announced)


def download(place: ObjectPlace, data: bytes) -> Transfer:
    """Write an object, expedited up to 4 bytes and in segments above."""
    if 1 <= len(data) <= 4:
        yield from _await_initiation([_head(0x23 | (4 - len(data)) << 2, place) + data.ljust(4, b"\0")], place, 3)
        return b""
    yield from _await_initiation([_head(0x21, place) + len(data).to_bytes(4, "little")], place, 3)
    toggle = 0
    for at in range(0, max(len(data), 1), 7):
        piece = data[at : at + 7]
        last = at + 7 >= len(data)
        command = toggle | (7 - len(piece)) << 1 | last
        yield from _segment(bytes([command]) + piece.ljust(7, b"\0"), place, 1, toggle)
        toggle ^= 0x10
    return b""


def block_upload(place: ObjectPlace) -> Transfer:
    """Read an object by block transfer with CRC. A server that knows none aborts with UNKNOWN_COMMAND."""
    answer = yield from _await_initiation([_head(0xA4, place) + bytes([BLOCK_SEGMENTS, 0, 0, 0])], place, 6)
    announced = int.from_bytes(answer[4:8], "little") if answer[0] & 2 else None
    checked = bool(answer[0] & 4)
    data, confirm, more = bytearray(), [bytes([0xA3]) + bytes(7)], True
    while more:
        # 7.2.4.3.14: a block ends with its last segment, or with the one marked by bit 7. Segments after a gap are not
        # kept: the confirmation names the last in sequence, and the server goes on behind it.
        taken, sequence, answer = 0, 0, b""
        while sequence != BLOCK_SEGMENTS and not (answer and answer[0] & 0x80):
            answer = yield confirm
            confirm = []
            sequence = answer[0] & 0x7F
            if sequence == 0:  # no segment has that number; an abort (0x80) looks so
                _check_abort(answer, place)
                answer = b""
            elif sequence == taken + 1:
                data += answer[1:8]
                taken, more = sequence, not answer[0] & 0x80
            if len(data) > MAX_OBJECT_BYTES:
                raise ReplyMismatch(f"{place}: more than {MAX_OBJECT_BYTES} bytes, and no end")
        confirm = [bytes([0xA2, taken, BLOCK_SEGMENTS]) + bytes(5)]
    answer = yield confirm
    while answer[0] & 0xE3 != 0xC1:
        _check_abort(answer, place)
        answer = yield None
    # Only the end says how much of the last segment was data, and the CRC-16-CCITT of it all (7.2.4.3.15 and .16).
    whole = bytes(data[: len(data) - (answer[0] >> 2 & 7)])
    if checked and crc_hqx(whole, 0) != int.from_bytes(answer[1:3], "little"):
        raise ReplyMismatch(f"{place}: the CRC of the block transfer is wrong")
    return _whole(place, whole, announced)


BLOCK_UPLOAD_END = bytes([0xA1]) + bytes(7)
"""What a client confirms a block upload with, after its end; nothing answers it."""


def block_download(place: ObjectPlace, data: bytes) -> Transfer:
    """Write an object by block transfer with CRC."""
    answer = yield from _await_initiation([_head(0xC6, place) + len(data).to_bytes(4, "little")], place, 5)
    checked, size = bool(answer[0] & 4), answer[4]
    pieces = [data[at : at + 7] for at in range(0, max(len(data), 1), 7)]
    done = 0
    while done < len(pieces):
        # 7.2.4.3.10: each confirmation says how many segments have come in sequence, and how many the next block may
        # have; what did not come in sequence is sent again.
        if not 1 <= size <= BLOCK_SEGMENTS:
            raise ReplyMismatch(f"{place}: the server asks for blocks of {size} segments")
        burst = pieces[done : done + size]
        last = done + len(burst) == len(pieces)
        frames = [
            bytes([number | (0x80 if last and number == len(burst) else 0)]) + piece.ljust(7, b"\0")
            for number, piece in enumerate(burst, start=1)
        ]
        answer = yield frames
        while answer[0] & 0xE3 != 0xA2 or answer[1] > len(burst):
            _check_abort(answer, place)
            answer = yield None
        done, size = done + answer[1], answer[2]
    unused = 7 - len(pieces[-1])
    end = bytes([0xC1 | unused << 2]) + (crc_hqx(data, 0) if checked else 0).to_bytes(2, "little") + bytes(5)
    answer = yield [end]
    while answer[0] & 0xE3 != 0xA1:
        _check_abort(answer, place)
        answer = yield None
    return b""


def _head(command: int, place: ObjectPlace) -> bytes:
    return bytes([command]) + place.index.to_bytes(2, "little") + bytes([place.subindex])


def _await_initiation(frames: list[bytes], place: ObjectPlace, specifier: int) -> Transfer:
    """The answer to a first request: the one that names the object; all others are not for it."""
    answer = yield frames
    # Nothing numbers SDO answers; index and sub-index are all by which a late answer to an earlier request is told.
    while answer[1:4] != frames[0][1:4] or answer[0] >> 5 not in (specifier, 4):
        answer = yield None
    _check_abort(answer, place)
    return answer


def _segment(frame: bytes, place: ObjectPlace, specifier: int, toggle: int) -> Transfer:
    """The answer to a segment. A server that has lost count is told so."""
    answer = yield [frame]
    while answer[0] >> 5 != specifier:
        _check_abort(answer, place)
        answer = yield None
    if answer[0] & 0x10 != toggle:
        raise ReplyMismatch(f"{place}: an SDO segment came twice or is missing")
    return answer


def _check_abort(answer: bytes, place: ObjectPlace) -> None:
    """Raises SdoAbort if the answer is the server's abort of this transfer."""
    if answer[0] >> 5 == 4 and ObjectPlace(int.from_bytes(answer[1:3], "little"), answer[3]) == place:
        raise SdoAbort(place, int.from_bytes(answer[4:8], "little"))


def _whole(place: ObjectPlace, data: bytes, announced: int | None) -> bytes:
    if announced is not None and announced != len(data):
        raise ReplyMismatch(f"{place}: {announced} bytes were announced and {len(data)} came")
    return data

"""Does this reply answer that request? Modbus TCP frames checked byte by byte, before any library decodes them (pure).

pymodbus accepts any number of registers, any function and any echo; what is refused here never reaches it. Clauses are
those of the MODBUS Application Protocol V1.1b3 and of MODBUS Messaging on TCP/IP V1.0b.
"""

import struct
from dataclasses import dataclass

from drivers.errors import DeviceException, ReplyMismatch
from drivers.tag import Quality

REGISTER_BYTES, WIDE_REGISTER_BYTES = 2, 4
HEADER = 6
"""Bytes before unit and PDU: transaction and protocol id, length."""
_SHORTEST, _LONGEST = 3, 254  # the length field: unit, function and at least one byte; a PDU has at most 253 bytes
IDENTIFY = 43
"""Function 43 with MEI type 14: the device says who it is (V1.1b3, 6.21)."""
_MEI_IDENTITY = 14
REPORT = 17
"""Function 17: the device says who it is in bytes of its maker's own (6.13)."""
SAYS_WHO = frozenset({REPORT, IDENTIFY})
"""Questions without an address; the words of their replies are the bytes of what the device says."""
_ECHO = 4
"""Bytes of a read's request behind its function: address and count."""
_TABLES = {1: "coil", 2: "discrete", 3: "holding", 4: "input", 5: "coil", 6: "holding", 15: "coil", 16: "holding"}
_BITS, _REGISTERS = frozenset({1, 2}), frozenset({3, 4})
ECHOED = frozenset({5, 6})
"""Functions that write one address; what confirms them is the request itself (V1.1b3, 6.5, 6.6)."""
WRITES = ECHOED | {15, 16}

# V1.1b3 section 7: what the device says, and what that makes of a reading.
EXCEPTIONS: dict[int, tuple[str, Quality]] = {
    1: ("illegal function: the device does not offer this table or operation", Quality.CONFIGURATION_ERROR),
    2: ("illegal data address: an address of the request does not exist", Quality.CONFIGURATION_ERROR),
    3: (
        "illegal data value: the device does not take a request of this length or content",
        Quality.CONFIGURATION_ERROR,
    ),
    4: ("server device failure: the device failed while it answered", Quality.DEVICE_FAILURE),
    5: ("acknowledge: the device has accepted and needs longer", Quality.NO_DATA),
    6: ("server device busy: ask again later", Quality.NO_DATA),
    8: ("memory parity error", Quality.DEVICE_FAILURE),
    10: ("gateway path unavailable: the gateway has no way to this unit", Quality.NO_COMMUNICATION),
    11: ("gateway target device failed to respond: the unit behind the gateway is silent", Quality.NO_COMMUNICATION),
}


@dataclass(frozen=True, slots=True)
class Asked:
    """What a request asked for, read from its own bytes; of one that writes a single address `count` is its value.

    `width` are the bytes of a register, which the bytes of a request do not say.
    """

    transaction: int
    unit: int
    function: int
    address: int
    count: int
    width: int = REGISTER_BYTES

    def __str__(self) -> str:
        if self.function in SAYS_WHO:
            return f"function {self.function} (who are you?)"
        return f"{_TABLES[self.function]}:{self.address} count {1 if self.function in ECHOED else self.count}"


def parse_request(request: bytes, width: int = REGISTER_BYTES) -> Asked:
    """Read a request of function 1 to 6, 15 or 16, or of 17 or 43 (which have neither address nor count)."""
    if request[7] in SAYS_WHO:
        return Asked(int.from_bytes(request[:2], "big"), request[6], request[7], 0, 0)
    transaction, _, _, unit, function, address, count = struct.unpack(">HHHBBHH", request[:12])
    return Asked(transaction, unit, function, address, count, width)


def split_frames(stream: bytes) -> tuple[list[bytes], bytes]:
    """Cut a received stream into whole frames and the incomplete rest.

    Raises ReplyMismatch if a header, or what has come of it, cannot be one (protocol id, length): from there on nothing
    can be told apart.
    """
    frames: list[bytes] = []
    while len(stream) >= HEADER:
        _, protocol, length = struct.unpack(">HHH", stream[:HEADER])
        if protocol != 0 or not _SHORTEST <= length <= _LONGEST:
            raise ReplyMismatch(f"what arrives is not Modbus TCP (protocol id {protocol}, length {length})")
        if len(stream) < HEADER + length:
            break
        frames.append(stream[: HEADER + length])
        stream = stream[HEADER + length :]
    if any(stream[2:5]):
        raise ReplyMismatch(f"what arrives is not Modbus TCP (it begins with {stream[:5].hex(' ')})")
    return frames, stream


def as_asked(request: Asked, frame: bytes, answers_as: int | None) -> bytes:
    """The reply with the unit that was asked in the place of the one as which the device answers."""
    return frame if frame[6] != answers_as else frame[:6] + bytes((request.unit,)) + frame[7:]


def leaves_open(request: Asked, frame: bytes) -> bool:
    """Whether the answer may still come behind a frame with the request's number: another unit's, or the request.

    So it is with gateways that hand on what other units of their line say, and where something gives back what is sent.
    """
    return frame[6] != request.unit or _is_echo(request, frame[7], frame[8:])


def _is_echo(request: Asked, function: int, body: bytes) -> bool:
    is_read = function in _BITS or function in _REGISTERS
    return is_read and function == request.function and body == struct.pack(">HH", request.address, request.count)


def check_reply(request: Asked, reply: bytes) -> None:
    """Pass if the frame answers the request in unit, function, length and count or echo.

    The transaction id has been compared before: a reply to another request is no mismatch, it is merely late. Raises
    ReplyMismatch, or DeviceException if the device refuses.
    """
    unit, function, body = reply[6], reply[7], reply[8:]
    if unit != request.unit:
        raise ReplyMismatch(
            f"{request}: the reply is from unit {unit} and unit {request.unit} was asked; if one device alone is "
            f"behind the connection, give unit = {unit}, or answers_as = {unit}",
            remedy={"answers_as": unit},
        )
    # An exception reply has the request's function with its highest bit set (section 7).
    if function == request.function | 0x80:
        if len(body) != 1:
            raise ReplyMismatch(f"{request}: an exception reply has 1 byte, not {len(body)}")
        sentence, _ = EXCEPTIONS.get(body[0], ("a code that the standard does not know", Quality.BAD))
        raise DeviceException(body[0], f"{request}: exception {body[0]}, {sentence}")
    if function != request.function:
        raise ReplyMismatch(f"{request}: the reply is of function {function} and {request.function} was asked")
    # Before the counts: of 17 to 24 bits from 0x0300 on it looks like a reply, and no plan asks for them in one.
    if len(body) == _ECHO and _is_echo(request, function, body):
        raise ReplyMismatch(f"{request}: what comes back is the request itself: something gives back what is sent")
    if function == IDENTIFY:
        if len(body) < 6 or body[0] != _MEI_IDENTITY:
            raise ReplyMismatch(f"{request}: the reply holds no identification")
    elif function == REPORT:
        if len(body) < 2 or body[0] != len(body) - 1:
            raise ReplyMismatch(f"{request}: the reply announces {body[0]} bytes and has {len(body) - 1}")
    elif function in WRITES:
        # A write is confirmed by its own address and count (6.11, 6.12), of which the values are no part; that of one
        # address by itself (6.5, 6.6).
        echo = struct.pack(">HH", request.address, request.count)
        if body != echo:
            raise ReplyMismatch(f"{request}: the device confirms {body.hex()} instead of {echo.hex()}")
    else:
        # The byte count must be what was asked, and be true: a reply that is longer or shorter belongs to other values.
        expected = request.width * request.count if function in _REGISTERS else (request.count + 7) // 8
        if body[0] != expected or len(body) - 1 != expected:
            wide = function in _REGISTERS and body[0] == len(body) - 1 == WIDE_REGISTER_BYTES * request.count
            hint = "; if its registers have 32 bits each (Enron), give wide_registers" if wide else ""
            raise ReplyMismatch(
                f"{request}: {expected} bytes were asked, the reply announces {body[0]} and has {len(body) - 1}{hint}"
            )


def exception_quality(code: int) -> Quality:
    """What a device exception makes of a reading."""
    return EXCEPTIONS.get(code, ("", Quality.BAD))[1]


def unpack_words(request: Asked, data: bytes) -> tuple[int, ...]:
    """The registers, or bits as 0 and 1, in the data of a verified reply (after its byte count); none of a write's.

    Of what a device says of itself they are its bytes, behind MEI type or byte count.
    """
    if request.function in _REGISTERS:
        return struct.unpack(f">{request.count}{'H' if request.width == REGISTER_BYTES else 'I'}", data)
    if request.function in _BITS:
        packed = int.from_bytes(data, "little")
        return tuple(packed >> index & 1 for index in range(request.count))
    return tuple(data) if request.function in SAYS_WHO else ()

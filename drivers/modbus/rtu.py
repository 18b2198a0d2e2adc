"""RTU frames: unit, PDU and CRC in a stream that has neither header nor transaction id (pure).

MODBUS over Serial Line V1.02: a frame ends with a silence of 3.5 characters. Bytes reach a program through buffers that
keep no such times, so a reply's length is taken from its content and checked by its CRC.
"""

from pymodbus.framer import FramerRTU
from pymodbus.pdu import ModbusPDU

from drivers.errors import ReplyMismatch
from drivers.modbus.verify import IDENTIFY, REGISTER_BYTES, REPORT, SAYS_WHO, WRITES, Asked

BITS = 11
"""Of one character on a serial Modbus line: start, eight data, parity and stop, or a second stop."""
FAST_BAUD = 19200
FAST_SILENCE_S = 0.00175
"""Above 19200 bit/s the silence between frames is fixed (V1.02, 2.5.1.1)."""
LONGEST = 256
_EXCEPTION, _CONFIRMATION = 5, 8


def request_frame(request: ModbusPDU) -> bytes:
    """The bytes of a request."""
    plain = bytes((request.dev_id, request.function_code)) + request.encode()
    return plain + crc(plain)


def crc(data: bytes) -> bytes:
    """CRC-16/MODBUS as it goes on the wire."""
    return FramerRTU.compute_CRC(data).to_bytes(2, "big")


def parse_request(frame: bytes, width: int = REGISTER_BYTES) -> Asked:
    """What a request of function 1 to 6, 15 or 16 asks for, from its own bytes; 17 and 43 have no address."""
    if frame[1] in SAYS_WHO:
        return Asked(0, frame[0], frame[1], 0, 0)
    return Asked(0, frame[0], frame[1], int.from_bytes(frame[2:4], "big"), int.from_bytes(frame[4:6], "big"), width)


def silence(baud: int) -> float:
    """Seconds of silence between two frames: 3.5 characters."""
    return FAST_SILENCE_S if baud > FAST_BAUD else 3.5 * BITS / baud


def transmission(octets: int, baud: int) -> float:
    """Seconds that so many bytes take on the line."""
    return octets * BITS / baud


def reply_octets(request: Asked) -> int:
    """How long the reply to a request is, if it is none of an exception; the most for functions 17 and 43."""
    if request.function in SAYS_WHO:
        return LONGEST
    if request.function in WRITES:
        return _CONFIRMATION
    return 5 + (request.width * request.count if request.function in (3, 4) else (request.count + 7) // 8)


def reply_length(request: Asked, data: bytes) -> int | None:
    """The length of the reply that begins with `data` by what it says itself; None while that is not known.

    Raises ReplyMismatch for one whose function has no known length: where it ends cannot be said.
    """
    if len(data) < 2:
        return None
    if data[1] & 0x80:
        return _EXCEPTION
    if data[1] in WRITES:
        return _CONFIRMATION
    if data[1] in (1, 2, 3, 4) or data[1] == request.function == REPORT:
        return data[2] + 5 if len(data) > 2 else None
    if data[1] == request.function == IDENTIFY:
        return _identity_length(data)
    raise ReplyMismatch(f"{request}: the reply is of function {data[1]} and {request.function} was asked")


def begins_reply(request: Asked, data: bytes) -> bool:
    """Whether the data begin with a whole reply to the request: its unit, its function or refusal, length and CRC."""
    if len(data) < _EXCEPTION or data[0] != request.unit or data[1] & 0x7F != request.function:
        return False
    try:
        length = reply_length(request, data)
    except ReplyMismatch:
        return False
    if length is None or len(data) < length:
        return False
    return crc(data[: length - 2]) == data[length - 2 : length]


def _identity_length(data: bytes) -> int | None:
    """An identification's length: 8 bytes of head, then so many objects of number, length and text; then the CRC."""
    if len(data) < 8:
        return None
    end = 8
    for _ in range(data[7]):
        if len(data) < end + 2:
            return None
        end += 2 + data[end + 1]
    return end + 2


def unwrap(request: Asked, frame: bytes) -> bytes:
    """The frame as Modbus TCP would have it (the header's first six bytes are 0). Raises ReplyMismatch by the CRC."""
    if crc(frame[:-2]) != frame[-2:]:
        raise ReplyMismatch(f"{request}: the reply's CRC is wrong (noise on the line, or another baud rate or parity?)")
    return bytes(6) + frame[:-2]

"""Modbus requests and replies as bytes (MODBUS Application Protocol V1.1b3); no socket, no clock.

The server is our own because a test bench must answer several requests in one segment, close on a bad protocol id,
stay silent for a strange unit, and send what no library lets itself send.
"""

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

HEADER = struct.Struct(">HHHB")  # transaction, protocol, length (unit and PDU), unit
MAX_PDU = 253

ILLEGAL_FUNCTION = 1
ILLEGAL_ADDRESS = 2
ILLEGAL_VALUE = 3
TARGET_SILENT = 11

_MAX_BITS_READ = 2000
_MAX_WORDS_READ = 125
_MAX_WRITE_BITS = 1968
_MAX_WRITE_WORDS = 123
_MAX_EXCHANGE_WORDS = 121
_IDENTITY = {0: b"decanter", 1: b"software PLC", 2: b"1"}


class ModbusRefusal(Exception):
    """The request is answered with this exception code."""

    def __init__(self, code: int) -> None:
        super().__init__(f"exception {code}")
        self.code = code


class Memory(Protocol):
    """What the functions act on. Both verbs raise Refusal for addresses that are not there or not writable."""

    @property
    def max_registers(self) -> int:
        """The device's own limit of registers in one request."""
        ...

    def read(self, table: str, address: int, count: int) -> list[int]:
        """The words or bits of `count` addresses."""
        ...

    def write(self, table: str, address: int, values: Sequence[int]) -> None:
        """Store the values as one step."""
        ...


@dataclass(frozen=True, slots=True)
class ModbusRequest:
    """One request as it arrived at a face. RTU has no transactions: there it is 0.

    `refused` is the exception code by which the face itself refuses it, if it does.
    """

    peer: str
    transaction: int
    unit: int
    pdu: bytes
    face: str = "tcp"
    rtu: bool = False
    refused: int | None = None

    @property
    def function(self) -> int:
        """The function code."""
        return self.pdu[0]


@dataclass(frozen=True, slots=True)
class ModbusReply:
    """One reply, and how it goes out: after `delay_s`, `copies` times, in pieces of `piece` bytes, or not at all.

    `rtu`: framed by unit and CRC as on a serial line, instead of by a header. `raw` stands in for the whole frame;
    `cut` sends only so many bytes of it and then resets the connection.
    """

    transaction: int
    unit: int
    pdu: bytes
    sent: bool = True
    delay_s: float = 0.0
    copies: int = 1
    piece: int | None = None
    cut: int | None = None
    raw: bytes | None = None
    rtu: bool = False

    def frame(self) -> bytes:
        """The bytes for the wire."""
        if self.rtu:
            plain = bytes((self.unit,)) + self.pdu
            whole = plain + crc(plain)
        else:
            whole = HEADER.pack(self.transaction, 0, len(self.pdu) + 1, self.unit) + self.pdu
        return (whole if self.raw is None else self.raw) * self.copies


def crc(data: bytes) -> bytes:
    """CRC-16/MODBUS (polynomial 0x8005 reflected, start 0xFFFF) bit by bit, low byte first as on the wire."""
    register = 0xFFFF
    for octet in data:
        register ^= octet
        for _ in range(8):
            register = register >> 1 ^ 0xA001 if register & 1 else register >> 1
    return register.to_bytes(2, "little")


def exception(function: int, code: int) -> bytes:
    """The PDU that refuses a request."""
    return bytes((function & 0x7F | 0x80, code))


def answer(pdu: bytes, memory: Memory) -> bytes:
    """The reply PDU to a request PDU: what was asked, or an exception (1 function, 2 address, 3 value or length)."""
    act = FUNCTIONS.get(pdu[0])
    try:
        if act is None:
            raise ModbusRefusal(ILLEGAL_FUNCTION)
        return pdu[:1] + act(pdu[1:], memory)
    except ModbusRefusal as refusal:
        return exception(pdu[0], refusal.code)


def span(pdu: bytes) -> tuple[int | None, int | None]:
    """The address and the count that a request names (count 1 for single writes), None where it has none."""
    if pdu[0] in (5, 6, 22) and len(pdu) >= 3:
        return struct.unpack_from(">H", pdu, 1)[0], 1
    if pdu[0] in (1, 2, 3, 4, 15, 16, 23) and len(pdu) >= 5:
        address, count = struct.unpack_from(">HH", pdu, 1)
        return address, count
    return None, None


def reads(pdu: bytes) -> list[tuple[str, range]]:
    """Every stretch of addresses that a request touches, reading or writing."""
    address, count = span(pdu)
    if address is None or count is None:
        return []
    table = {1: "coil", 2: "discrete", 4: "input", 5: "coil", 15: "coil"}.get(pdu[0], "holding")
    stretches = [(table, range(address, address + count))]
    if pdu[0] == 23 and len(pdu) >= 9:
        start, words = struct.unpack_from(">HH", pdu, 5)
        stretches.append(("holding", range(start, start + words)))
    return stretches


def _two_words(body: bytes) -> tuple[int, int]:
    if len(body) != 4:
        raise ModbusRefusal(ILLEGAL_VALUE)
    first, second = struct.unpack(">HH", body)
    return first, second


def _read_table(memory: Memory, table: str, address: int, count: int, most: int) -> list[int]:
    if not 1 <= count <= most:
        raise ModbusRefusal(ILLEGAL_VALUE)
    if address + count > 0x10000:
        raise ModbusRefusal(ILLEGAL_ADDRESS)
    return memory.read(table, address, count)


def _read_bits(table: str) -> "Function":
    def act(body: bytes, memory: Memory) -> bytes:
        address, count = _two_words(body)
        bits = _read_table(memory, table, address, count, _MAX_BITS_READ)
        packed = sum(bit << index for index, bit in enumerate(bits)).to_bytes((count + 7) // 8, "little")
        return bytes((len(packed),)) + packed

    return act


def _read_words(table: str) -> "Function":
    def act(body: bytes, memory: Memory) -> bytes:
        address, count = _two_words(body)
        words = _read_table(memory, table, address, count, min(_MAX_WORDS_READ, memory.max_registers))
        return struct.pack(f">B{count}H", 2 * count, *words)

    return act


def _write_coil(body: bytes, memory: Memory) -> bytes:
    address, value = _two_words(body)
    if value not in (0x0000, 0xFF00):
        raise ModbusRefusal(ILLEGAL_VALUE)
    memory.write("coil", address, [int(value == 0xFF00)])
    return body


def _write_word(body: bytes, memory: Memory) -> bytes:
    address, value = _two_words(body)
    memory.write("holding", address, [value])
    return body


def _write_coils(body: bytes, memory: Memory) -> bytes:
    if len(body) < 5:
        raise ModbusRefusal(ILLEGAL_VALUE)
    address, count, size = struct.unpack_from(">HHB", body)
    if not 1 <= count <= _MAX_WRITE_BITS or size != (count + 7) // 8 or len(body) != 5 + size:
        raise ModbusRefusal(ILLEGAL_VALUE)
    packed = int.from_bytes(body[5:], "little")
    memory.write("coil", address, [packed >> index & 1 for index in range(count)])
    return body[:4]


def _words_to_write(body: bytes, most: int) -> tuple[int, list[int]]:
    if len(body) < 5:
        raise ModbusRefusal(ILLEGAL_VALUE)
    address, count, size = struct.unpack_from(">HHB", body)
    if not 1 <= count <= most or size != 2 * count or len(body) != 5 + size:
        raise ModbusRefusal(ILLEGAL_VALUE)
    return address, list(struct.unpack_from(f">{count}H", body, 5))


def _write_words(body: bytes, memory: Memory) -> bytes:
    address, words = _words_to_write(body, min(_MAX_WRITE_WORDS, memory.max_registers))
    memory.write("holding", address, words)
    return body[:4]


def _mask_word(body: bytes, memory: Memory) -> bytes:
    if len(body) != 6:
        raise ModbusRefusal(ILLEGAL_VALUE)
    address, keep, put = struct.unpack(">HHH", body)
    (word,) = memory.read("holding", address, 1)
    memory.write("holding", address, [word & keep | put & ~keep & 0xFFFF])
    return body


def _exchange_words(body: bytes, memory: Memory) -> bytes:
    if len(body) < 9:
        raise ModbusRefusal(ILLEGAL_VALUE)
    read_at, count = struct.unpack_from(">HH", body)
    if not 1 <= count <= min(_MAX_WORDS_READ, memory.max_registers):
        raise ModbusRefusal(ILLEGAL_VALUE)
    memory.read("holding", read_at, count)  # refused as a whole before anything is written
    address, words = _words_to_write(body[4:], min(_MAX_EXCHANGE_WORDS, memory.max_registers))
    memory.write("holding", address, words)
    return struct.pack(f">B{count}H", 2 * count, *memory.read("holding", read_at, count))


def _identify(body: bytes, _: Memory) -> bytes:
    if len(body) != 3 or body[0] != 14 or body[1] not in (1, 4):
        raise ModbusRefusal(ILLEGAL_FUNCTION if body[:1] != b"\x0e" else ILLEGAL_VALUE)
    wanted = [body[2]] if body[1] == 4 else [number for number in _IDENTITY if number >= body[2]]
    if not set(wanted) <= set(_IDENTITY):
        raise ModbusRefusal(ILLEGAL_ADDRESS)
    objects = b"".join(bytes((number, len(_IDENTITY[number]))) + _IDENTITY[number] for number in wanted)
    return bytes((14, body[1], 0x81, 0, 0, len(wanted))) + objects


Function = Callable[[bytes, Memory], bytes]

FUNCTIONS: dict[int, Function] = {
    1: _read_bits("coil"),
    2: _read_bits("discrete"),
    3: _read_words("holding"),
    4: _read_words("input"),
    5: _write_coil,
    6: _write_word,
    15: _write_coils,
    16: _write_words,
    22: _mask_word,
    23: _exchange_words,
    43: _identify,
}

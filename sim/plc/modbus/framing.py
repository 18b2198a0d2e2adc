"""How requests lie in a stream of bytes: behind a header (TCP, TLS), or between a unit and a CRC (RTU)."""

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass

from sim.plc.program import HEADER, MAX_PDU, crc

GAP_S = 0.05
"""A pause in the middle of an RTU request that ends it. A serial line's own 3.5 characters are far less, but bytes come
here through buffers of an operating system, which keeps no such times."""

_WRITES_MANY = (15, 16)
_FIXED_PDU_BYTES = {43: 5}
"""Bytes of a PDU with neither address and count nor a byte count."""


@dataclass(frozen=True, slots=True)
class ReceivedRequest:
    """One request, or, with `pdu` None, bytes that are none."""

    transaction: int
    unit: int
    pdu: bytes | None
    raw: bytes = b""


@dataclass(frozen=True, slots=True)
class Framing:
    """How frames are read. `closes`: what is no Modbus ends the connection, instead of being passed over."""

    read: Callable[[asyncio.StreamReader], Awaitable[ReceivedRequest]]
    rtu: bool
    closes: bool


async def read_mbap(reader: asyncio.StreamReader) -> ReceivedRequest:
    """The next request behind a header. Raises IncompleteReadError at the end of the stream."""
    head = await reader.readexactly(HEADER.size)
    transaction, protocol, length, unit = HEADER.unpack(head)
    if protocol != 0 or not 2 <= length <= MAX_PDU + 1:
        return ReceivedRequest(transaction, unit, None, head)
    return ReceivedRequest(transaction, unit, await reader.readexactly(length - 1))


async def read_rtu(reader: asyncio.StreamReader) -> ReceivedRequest:
    """The next RTU request: as many bytes as its function needs, or all up to a pause where that cannot be said."""
    data = await reader.readexactly(1)
    while len(data) < 256 and ((size := _rtu_size(data)) is None or len(data) < size):
        try:
            # Not wait_for: Python 3.11's loses a cancellation that comes with the octet, and the serving goes on.
            async with asyncio.timeout(GAP_S):
                data += await reader.readexactly(1)
        except TimeoutError:
            break
    if len(data) >= 4 and crc(data[:-2]) == data[-2:]:
        return ReceivedRequest(0, data[0], data[1:-2])
    return ReceivedRequest(0, data[0], None, data)


def _rtu_size(data: bytes) -> int | None:
    """The length of the request that begins like this, unit and CRC included; None: not known (yet)."""
    if len(data) < 2:
        return None
    function = data[1]
    if 1 <= function <= 6:
        return 8
    if function in _WRITES_MANY:
        return data[6] + 9 if len(data) > 6 else None
    if function == 22:
        return 10
    if function == 23:
        return data[10] + 13 if len(data) > 10 else None
    return _FIXED_PDU_BYTES[function] + 2 if function in _FIXED_PDU_BYTES else None


MBAP = Framing(read_mbap, rtu=False, closes=True)
RTU = Framing(read_rtu, rtu=True, closes=False)

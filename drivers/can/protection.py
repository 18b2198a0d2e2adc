"""End-to-end protection of a message: a CRC-16 and a counter that tell it from garbage, repetition and loss (pure).

The profile is AUTOSAR's E2E Profile 5 (specification of the E2E protocol, PRS_E2EProtocol, 6.6): bytes 0 and 1 hold
the CRC-16/IBM-3740 (polynomial 0x1021, start 0xFFFF), low byte first, over the rest of the frame and the message's
data id (low byte first); byte 2 holds a counter, 0 to 255 and round again.
"""

from binascii import crc_hqx
from dataclasses import dataclass

PROFILE = "P05"
MIN_CONFIRMING_FRAMES = 2
"""Frames that must follow a jump of the counter before one is believed, at least."""
_HEADER_BYTES = 3


@dataclass(frozen=True, slots=True)
class Protection:
    """`data_id` (0..65535) is known to both ends and not sent; up to `max_delta` - 1 frames in a row may be lost.

    `confirmed` frames must follow a jump of the counter: as many as the message has layouts, and MIN_CONFIRMING_FRAMES
    at least.
    """

    data_id: int
    max_delta: int = 10
    confirmed: int = MIN_CONFIRMING_FRAMES


@dataclass(frozen=True, slots=True)
class Count:
    """Where a message's counter stands, and how many frames must still follow it before one is believed."""

    counter: int
    doubts: int = 0


def check_frame(protection: Protection, last: Count | None, data: bytes) -> tuple[Count | None, str]:
    """What to compare the next frame with, and why this frame must not be used, "" if it may.

    `last` is None before the first frame of right CRC, which is believed. Later ones must follow; after a jump of the
    counter `protection.confirmed` frames must, so that neither a chance hit among garbage (one in 65,536 has the right
    CRC) nor old frames that are repeated in turn, one of each layout, are taken for readings.
    """
    if len(data) < _HEADER_BYTES:
        return last, f"it has {len(data)} bytes, too few for its checksum and counter"
    if crc(protection, data) != int.from_bytes(data[:2], "little"):
        return last, "its CRC is wrong"
    counter = data[2]
    if last is None:
        return Count(counter), ""
    delta = (counter - last.counter) % 256
    if delta == 0:
        return last, "its counter has not moved on"
    if delta > protection.max_delta:
        return Count(counter, protection.confirmed), f"its counter jumped by {delta}"
    doubts = max(0, last.doubts - 1)
    return Count(counter, doubts), "its counter has jumped and must be seen to count on" if doubts else ""


def crc(protection: Protection, data: bytes) -> int:
    """The CRC that a frame must have: over all behind it, and the data id."""
    return crc_hqx(data[2:] + protection.data_id.to_bytes(2, "little"), 0xFFFF)


def protect_frame(protection: Protection, counter: int, data: bytes) -> bytes:
    """The frame with its counter (of which the low byte counts) and its CRC put in."""
    whole = bytes(2) + bytes((counter & 0xFF,)) + data[_HEADER_BYTES:]
    return crc(protection, whole).to_bytes(2, "little") + whole[2:]

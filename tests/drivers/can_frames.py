"""Frames for the tests of CAN: payloads cut up as ISO 15765-2 and J1939-21 say, candump lines, and layouts."""

from collections.abc import Iterable, Iterator

from drivers.can.fields import Field
from drivers.can.frame import CanFrame


def isotp(payload: bytes) -> list[bytes]:
    """The data of the frames that carry a payload of 1 to 4095 bytes."""
    if len(payload) <= 7:
        return [(bytes([len(payload)]) + payload).ljust(8, b"\0")]
    frames = [bytes([0x10 | len(payload) >> 8, len(payload) & 0xFF]) + payload[:6]]
    for number, start in enumerate(range(6, len(payload), 7), start=1):
        frames.append((bytes([0x20 | number % 16]) + payload[start : start + 7]).ljust(8, b"\xaa"))
    return frames


def packets(payload: bytes) -> list[bytes]:
    """The data of the TP.DT frames of a message of 9 to 1785 bytes."""
    cut = [payload[start : start + 7].ljust(7, b"\xff") for start in range(0, len(payload), 7)]
    return [bytes([number]) + part for number, part in enumerate(cut, start=1)]


def control(kind: int, payload: bytes, pgn: int, middle: bytes | None = None) -> bytes:
    """A TP.CM frame's data; `middle` are its bytes 2 to 5, those of RTS and BAM by default."""
    size = len(payload).to_bytes(2, "little") + bytes([-(-len(payload) // 7), 0xFF])
    return bytes([kind]) + (middle or size) + pgn.to_bytes(3, "little")


def bam(payload: bytes, pgn: int) -> list[tuple[int, bytes]]:
    """(identifier without source address, data) of a broadcast message."""
    return [(0x1CECFF00, control(32, payload, pgn)), *((0x1CEBFF00, data) for data in packets(payload))]


def timed(frames: Iterable[tuple[int, bytes]], *, start: float = 0.0, step: float = 0.01) -> Iterator[CanFrame]:
    """Frames at equal distances; an identifier above 0x7FF is a 29-bit one."""
    for number, (identifier, data) in enumerate(frames):
        yield CanFrame(start + number * step, identifier, identifier > 0x7FF, data)


def candump(frames: Iterable[CanFrame], channel: str = "can0") -> str:
    """The frames as `candump -L` writes them."""
    lines = []
    for frame in frames:
        identifier = f"{frame.id:0{8 if frame.extended else 3}X}"
        lines.append(f"({frame.time:.6f}) {frame.channel or channel} {identifier}#{frame.data.hex().upper()}\n")
    return "".join(lines)


def lies_in(field: Field, data: bytes) -> bool:
    """Whether a frame's payload is of the layout that holds the field."""
    return all(condition.holds(data) for condition in field.conditions)

"""ASCII frames: colon, two hexadecimal digits a byte, LRC, CR LF (MODBUS over Serial Line V1.02, 2.5.2), pure.

They become the RTU frames of the same content, so that one set of rules tells on every line which reply answers which
request: a frame whose LRC is wrong is none, and one that is right gets the checksum that it would have had.
"""

from pymodbus.framer import FramerAscii

from drivers.modbus.rtu import crc

_LONGEST = 2 * 255 + 3
"""Of a frame: unit, PDU and LRC as digits, colon, CR and LF."""


def ascii_frame(frame: bytes) -> bytes:
    """The ASCII frame of an RTU frame's content."""
    plain = frame[:-2]
    return b":" + (plain + bytes((FramerAscii.compute_LRC(plain),))).hex().upper().encode() + b"\r\n"


class AsciiStream:
    """What comes on a line, as RTU frames of the same content; `spoilt` counts what was none."""

    def __init__(self) -> None:
        self._rest = b""
        self.spoilt = 0

    def take(self, data: bytes) -> bytes:
        """Take in what has come; gives the frames that are whole by it, one after another."""
        self._rest += data
        frames = b""
        while (end := self._rest.find(b"\n")) >= 0:
            line, self._rest = self._rest[:end], self._rest[end + 1 :]
            # A frame begins with its last colon: what stands before it was cut short, or is noise.
            start = line.rfind(b":")
            plain = _content(line[start + 1 :].rstrip(b"\r")) if start >= 0 else None
            if plain is None:
                self.spoilt += 1
            else:
                frames += plain + crc(plain)
        if len(self._rest) > _LONGEST:
            self._rest = self._rest[-_LONGEST:]
        return frames


def _content(digits: bytes) -> bytes | None:
    """Unit and PDU; None for what is no frame."""
    try:
        data = bytes.fromhex(digits.decode("ascii"))
    except ValueError:
        return None
    whole = len(data) >= 3 and len(digits) == 2 * len(data)
    return data[:-1] if whole and FramerAscii.compute_LRC(data[:-1]) == data[-1] else None

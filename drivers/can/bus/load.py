"""How much of a CAN bus's time its frames take: bits on the wire at most, by the second (pure)."""

from dataclasses import dataclass

_WINDOW = 1.0


def frame_bits(length: int, *, extended: bool) -> int:
    """The most bits that a classic frame of `length` bytes takes, the gap of three behind it included.

    8 n + g + 13 + (g + 8 n - 1) // 4, where g = 34 or 54 bits are stuffed beside the data (Davis, Burns, Bril, Lukkien:
    Controller Area Network schedulability analysis, 2007, equation 1). An FD frame's faster data phase is not counted.
    """
    header, payload = (54 if extended else 34), 8 * length
    return payload + header + 13 + (header + payload - 1) // 4


@dataclass(slots=True)
class BusLoad:
    """The load of the last full second at `bitrate` (bit/s), and the highest one; moments are monotonic seconds."""

    bitrate: int
    bits: int = 0
    since: float = 0.0
    last: float = 0.0
    peak: float = 0.0

    def add(self, length: int, *, extended: bool, now: float) -> None:
        """Count one frame."""
        if now - self.since >= _WINDOW:
            self._close(now)
        self.bits += frame_bits(length, extended=extended)

    def percent(self, now: float) -> float:
        """The share of the bus's time that was taken in the last full second, in per cent."""
        if now - self.since >= _WINDOW:
            self._close(now)
        return self.last

    def _close(self, now: float) -> None:
        """End the second; one that began long ago tells of all the time since."""
        self.last = 100.0 * self.bits / self.bitrate / max(now - self.since, _WINDOW) if self.since else 0.0
        self.peak = max(self.peak, self.last)
        self.bits, self.since = 0, now

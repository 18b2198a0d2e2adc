"""ISO-TP (ISO 15765-2) as a listener hears it: single, first and consecutive frames to whole payloads (pure).

The listener takes no part: it sends no flow control, and the log's own clock runs its timeout. A payload is given only
when every frame of it was heard in sequence; whatever is missing, late or malformed drops the whole message.
"""

from dataclasses import dataclass, field

N_CR = 1.0
"""Seconds within which the next consecutive frame must follow (ISO 15765-2, N_Cr)."""
MAX_PAYLOAD = 4095
"""Longest payload with the 12-bit length; OBD-II needs no more, so the 32-bit escape is counted and left alone."""

SINGLE, FIRST, CONSECUTIVE, FLOW_CONTROL = range(4)


@dataclass(slots=True)
class _PartialMessage:
    """A message that is being received: `next` is the sequence number (0..15) that must come."""

    total: int
    data: bytearray
    next: int
    time: float


@dataclass(slots=True)
class Reassembler:
    """The payloads of one CAN id, from 1 to 4095 bytes (normal addressing).

    Counted: `payloads` given, `lost` (a sequence number missing or doubled), `late` (N_Cr passed), `replaced` (a new
    message before the end of the last), `orphans` (consecutive frames of no message) and `malformed` frames.
    """

    counts: dict[str, int] = field(
        default_factory=lambda: dict.fromkeys(
            ("payloads", "lost", "late", "replaced", "orphans", "malformed", "flow_control"), 0
        )
    )
    _open: _PartialMessage | None = None

    def take(self, time: float, data: bytes) -> bytes | None:
        """The payload that this frame completes, if it does. `time` in seconds; `data` are the frame's 0 to 8 bytes."""
        # Either way: the clock of a log may have been set back.
        if self._open is not None and abs(time - self._open.time) > N_CR:
            self._drop("late")
        kind = data[0] >> 4 if data else -1
        if kind == SINGLE:
            return self._single(data)
        if kind == CONSECUTIVE:
            return self._consecutive(time, data)
        if kind == FIRST:
            self._first(time, data)
            return None
        self.counts["flow_control" if kind == FLOW_CONTROL else "malformed"] += 1
        return None

    def restart(self) -> None:
        """Let go of a message that is not whole: what comes is another connection's."""
        if self._open is not None:
            self._drop("lost")

    def _single(self, data: bytes) -> bytes | None:
        # Whatever is wrong with it: where a message begins, the one before it has ended.
        if self._open is not None:
            self._drop("replaced")
        length = data[0]
        if not 1 <= length <= 7 or len(data) < length + 1:
            self.counts["malformed"] += 1
            return None
        self.counts["payloads"] += 1
        return bytes(data[1 : length + 1])

    def _first(self, time: float, data: bytes) -> None:
        if self._open is not None:
            self._drop("replaced")
        total = int.from_bytes(data[:2], "big") & 0x0FFF
        # What a single frame could have carried is never sent in several.
        if len(data) != 8 or total <= 7:
            self.counts["malformed"] += 1
            return
        self._open = _PartialMessage(total, bytearray(data[2:]), 1, time)

    def _consecutive(self, time: float, data: bytes) -> bytes | None:
        message = self._open
        if message is None:
            self.counts["orphans"] += 1
            return None
        # Only the last frame may be shorter; behind its payload there may be padding.
        left = message.total - len(message.data)
        part = data[1 : 1 + left]
        if data[0] & 0x0F != message.next or len(part) < min(left, 7):
            self._drop("malformed" if data[0] & 0x0F == message.next else "lost")
            return None
        message.data += part
        message.next, message.time = (message.next + 1) % 16, time
        if len(message.data) < message.total:
            return None
        self._open = None
        self.counts["payloads"] += 1
        return bytes(message.data)

    def _drop(self, why: str) -> None:
        self._open = None
        self.counts[why] += 1

"""J1939-21 transport protocol as a listener hears it: BAM and RTS/CTS sessions to whole messages (pure).

Sessions of different senders and receivers run interleaved. A message is given only when every packet of it was heard
under its own sequence number. Every transport frame is accounted for: in a message that was given, in a session that
was dropped (and why), in one that is still open, or in none at all.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

TP_CM, TP_DT = 0xEC00, 0xEB00
BROADCAST = 0xFF
MAX_PAYLOAD = 1785
RTS, CTS, END_OF_MESSAGE, BAM, ABORT = 16, 17, 19, 32, 255
T1, T2 = 0.75, 1.25
"""Seconds of silence that end a session (J1939-21, 5.10.2.4): between packets of a BAM; T2 = T3 with a receiver."""

_DROPS = ("lost", "late", "replaced", "aborted", "malformed")


class Message(NamedTuple):
    """A whole message of more than 8 bytes."""

    pgn: int
    source: int
    destination: int
    data: bytes


class Key(NamedTuple):
    """Who sends what to whom, on which bus."""

    channel: str
    source: int
    destination: int


@dataclass(slots=True)
class _OpenMessage:
    """`data` is filled up to packet `next` - 1; `repeat` is the next packet if the receiver asked for some again."""

    pgn: int
    size: int
    packets: int
    time: float
    data: bytearray = field(default_factory=bytearray)
    next: int = 1
    repeat: int = 1
    frames: int = 1
    given: bool = False


@dataclass(slots=True)
class TransportSessions:
    """All sessions on the buses that are listened to.

    `frames` counts transport frames by what became of them: `complete` (in messages that were given), the reasons for
    which a session was dropped, and `orphans` (of no session, or of one already dropped); `sessions` counts sessions in
    the same way. Both are of sessions that have ended; `counts` adds those that have not.
    """

    frames: dict[str, int] = field(default_factory=lambda: dict.fromkeys(("complete", *_DROPS, "orphans"), 0))
    sessions: dict[str, int] = field(default_factory=lambda: dict.fromkeys(("complete", *_DROPS), 0))
    _open: dict[Key, _OpenMessage] = field(default_factory=dict)

    def counts(self) -> dict[str, int]:
        """Frames (`tp_`) and sessions (`sessions_`) by what became of them; a message that was given is complete."""
        frames, sessions = self.frames | {"open": 0}, self.sessions | {"open": 0}
        for session in self._open.values():
            what = "complete" if session.given else "open"
            frames[what] += session.frames
            sessions[what] += 1
        named = {f"tp_{name}": count for name, count in frames.items()}
        return named | {f"sessions_{name}": count for name, count in sessions.items()}

    def control(self, time: float, key: Key, data: bytes) -> None:
        """Take a TP.CM frame from `key.source` to `key.destination`: it begins, steers or ends a session."""
        self._expire(time, (key, _reverse(key)))
        kind = data[0] if len(data) == 8 else -1
        pgn = int.from_bytes(data[5:8], "little")
        if kind in (RTS, BAM):
            self._begin(time, key, data, pgn)
        elif kind in (CTS, END_OF_MESSAGE):
            self._take_answer(time, _reverse(key), data, pgn)
        elif kind == ABORT:
            self._take_abort(key, pgn)
        else:
            self.frames["orphans"] += 1

    def packet(self, time: float, key: Key, data: bytes) -> Message | None:
        """Take a TP.DT frame; the message that it completes, if it does."""
        self._expire(time, (key,))
        session = self._open.get(key)
        if session is None:
            self.frames["orphans"] += 1
            return None
        session.frames += 1
        session.time = time
        number = data[0] if data else 0
        last = number == session.packets
        if len(data) != 8 and not (last and len(data) > session.size - (session.packets - 1) * 7):
            self._drop(key, "malformed")
            return None
        if number != session.repeat or number > session.packets:
            self._drop(key, "lost")
            return None
        return self._store(key, session, number, data[1:])

    def restart(self) -> None:
        """Let go of all sessions: what comes is another connection's."""
        for key in list(self._open):
            self._drop(key, "lost")

    def _store(self, key: Key, session: _OpenMessage, number: int, part: bytes) -> Message | None:
        session.repeat = number + 1
        if number < session.next:
            return None  # asked for again by its receiver; we had it
        session.data += part
        session.next = number + 1
        # Packets that the receiver asks for again after its last one make no second message.
        if number < session.packets or session.given:
            return None
        session.given = True
        message = Message(session.pgn, key.source, key.destination, bytes(session.data[: session.size]))
        if key.destination == BROADCAST:
            self._end(key, "complete")
        return message

    def _begin(self, time: float, key: Key, data: bytes, pgn: int) -> None:
        if key in self._open:
            self._end(key, "complete" if self._open[key].given else "replaced")
        size, packets = int.from_bytes(data[1:3], "little"), data[3]
        broadcast = data[0] == BAM
        if not 9 <= size <= MAX_PAYLOAD or packets != -(-size // 7) or broadcast != (key.destination == BROADCAST):
            self.frames["malformed"] += 1
            self.sessions["malformed"] += 1
            return
        # Sessions that nobody ends are looked for when one begins, so that their number stays bounded.
        self._expire(time, list(self._open))
        self._open[key] = _OpenMessage(pgn, size, packets, time)

    def _take_answer(self, time: float, key: Key, data: bytes, pgn: int) -> None:
        """What the receiver says: which packets it wants next (CTS), or that it has all."""
        session = self._open.get(key)
        if session is None or session.pgn != pgn or key.destination == BROADCAST:
            self.frames["orphans"] += 1
            return
        session.frames += 1
        session.time = time
        if data[0] == END_OF_MESSAGE:
            self._end(key, "complete" if session.given else "lost")
        elif data[1] > 0:  # 0: hold the connection open
            session.repeat = data[2]
            if not 1 <= data[2] <= session.next:  # it has packets that we have not heard
                self._drop(key, "lost")

    def _take_abort(self, key: Key, pgn: int) -> None:
        """Either side may give up."""
        for side in (key, _reverse(key)):
            session = self._open.get(side)
            if session is not None and session.pgn == pgn:
                session.frames += 1
                self._end(side, "complete" if session.given else "aborted")
                return
        self.frames["orphans"] += 1

    def _expire(self, time: float, keys: "tuple[Key, ...] | list[Key]") -> None:
        for key in keys:
            session = self._open.get(key)
            limit = T1 if key.destination == BROADCAST else T2
            if session is not None and abs(time - session.time) > limit:
                self._end(key, "complete" if session.given else "late")

    def _drop(self, key: Key, why: str) -> None:
        self._end(key, "complete" if self._open[key].given else why)

    def _end(self, key: Key, why: str) -> None:
        session = self._open.pop(key)
        self.frames[why] += session.frames
        self.sessions[why] += 1


def _reverse(key: Key) -> Key:
    return Key(key.channel, key.destination, key.source)

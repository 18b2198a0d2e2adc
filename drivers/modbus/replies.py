"""What keeps replies apart on TCP and TLS: ids that go on over connections, and frames that are whole by themselves.

No byte of a reading may come from a reply to another request, of this connection or a former one. An id says which
request a frame answers as long as no other request has had it: a device server that brings on a new connection what
the former one was to have must not meet the same numbers there. Where a frame ends its length says, and a peer that
cuts one short makes the beginning of the next its end: so nothing is asked behind a part of a frame, and what ends as
another frame may begin is believed once nothing follows it.
"""

import asyncio
import random
from collections.abc import Callable, Collection

from drivers.errors import LinkDown
from drivers.modbus.verify import HEADER, split_frames

ID_REUSE_DELAY_S = 600.0
"""So long an id is not used again after a question without an answer."""
FRAME_REST_TIMEOUT_S = 0.05
"""The rest of a frame whose first bytes have come follows within so long: a system's delayed acknowledgement is 0.04 s
(RFC 9293, 3.8.6.3), for which a peer that writes a frame in two pieces waits with the second."""
MAX_RECENT_REQUESTS = 1024
"""Replies to so many requests, the latest, are reckoned with."""
_AMBIGUOUS_BYTES = HEADER + 1
"""Bytes up to which a few registers may look like the beginning of a frame."""
_LAST_ID = 0xFFFF


class TransactionIds:
    """The ids of all requests to one place, over all connections to it; they begin at random, and 0 is none of them.

    0 is left out since devices are met that answer everything with it.
    """

    def __init__(self, rng: random.Random) -> None:
        self._last = rng.randint(1, _LAST_ID)
        # Of requests without an answer, with the loop's time of asking, oldest first.
        self._unanswered: dict[int, float] = {}

    def take(self, now: float) -> int:
        """The next id that no request without an answer has. Raises LinkDown where all are taken."""
        while self._unanswered and next(iter(self._unanswered.values())) < now - ID_REUSE_DELAY_S:
            del self._unanswered[next(iter(self._unanswered))]
        if len(self._unanswered) >= _LAST_ID:
            raise LinkDown("every transaction id waits for an answer")
        self._last = self._last % _LAST_ID + 1
        while self._last in self._unanswered:
            self._last = self._last % _LAST_ID + 1
        self._unanswered[self._last] = now
        return self._last

    def note_reply(self, number: int) -> None:
        """A reply with this id has come."""
        self._unanswered.pop(number, None)

    def may_begin(self, piece: bytes, own: int) -> bool:
        """Whether a reply to another request than `own` may begin so: one of the latest, or, where so little of it has
        come that registers look like that, one without an answer.
        """
        if not _is_head(piece):
            return False
        if len(piece) > _AMBIGUOUS_BYTES:
            return (self._last - _number(piece)) % _LAST_ID < MAX_RECENT_REQUESTS
        return any(number.to_bytes(2, "big").startswith(piece[:2]) for number in self._unanswered if number != own)


class ReplyStream:
    """The bytes of one connection as frames, each given to `give` once it is whole by itself.

    `cut` hears, in words, that one was cut short: then nothing that came with it is given, nor anything after it.
    """

    def __init__(self, ids: TransactionIds, give: Callable[[bytes], None], cut: Callable[[str], None]) -> None:
        self._ids, self._give, self._cut = ids, give, cut
        self._rest = b""
        # The frame that is not believed yet.
        self._held = b""
        # Where in the rest something begins that came by itself.
        self._starts: list[int] = []
        self._settling: asyncio.TimerHandle | None = None

    @property
    def remainder(self) -> bytes:
        """What has come of a frame that is not whole, or of one that is not believed yet; empty if there is none."""
        return self._held or self._rest

    def take(self, data: bytes, expected: Collection[int]) -> None:
        """Take in what has come; `expected` are the ids of the requests on this connection without an answer.

        Raises ReplyMismatch, and gives nothing of it, where these are no frames.
        """
        starts = [*self._starts, len(self._rest)] if self._rest else []
        frames, self._rest = split_frames(self._rest + data)
        if len(frames) == 1 and not (starts or self._rest or self._held):
            self._give(frames[0])  # as it nearly always is: one whole frame, by itself
            return
        # Only the first frame can have come in pieces; the rest has come with its end.
        self._starts = [] if frames else starts
        pieces = [frames[0][start:] for start in starts] if frames and _number(frames[0]) in expected else []
        if any(self._ids.may_begin(piece, _number(frames[0])) for piece in pieces):
            self._cut("a reply ends as another one begins: one of them was cut short")
            return
        # A longer piece has shown by its id what it is.
        heads = [piece for piece in pieces if len(piece) <= _AMBIGUOUS_BYTES and _is_head(piece)]
        doubted = len(frames) == 1 and not self._rest and bool(heads)
        if self._held:
            frames.insert(0, self._held)
            self._release()
        answers = [number for number in map(_number, frames) if number in expected]
        if answers and self._rest:
            others = [number.to_bytes(2, "big") for number in expected if number not in answers]
            if not any(number.startswith(self._rest[:2]) for number in others):
                self._cut("what follows a reply is no other one: one of them was cut short")
                return
        if answers and answers[-1] == _number(frames[-1]) and (doubted or 0 < len(self._rest) < HEADER):
            self._held = frames.pop()
            self._settling = asyncio.get_running_loop().call_later(FRAME_REST_TIMEOUT_S, self._settle)
        for frame in frames:
            self._give(frame)

    def close(self) -> None:
        """Nothing is given any more."""
        self._release()
        self._rest = b""

    def _release(self) -> bytes:
        held, self._held = self._held, b""
        if self._settling is not None:
            self._settling.cancel()
            self._settling = None
        return held

    def _settle(self) -> None:
        held = self._release()
        if self._rest:
            self._cut("what follows a reply is not whole: one of them was cut short")
        elif held:
            self._give(held)


def _number(frame: bytes) -> int:
    return int.from_bytes(frame[:2], "big")


def _is_head(piece: bytes) -> bool:
    """Whether a frame may begin so, as far as it goes: an id, twice 0, and a length below 256."""
    return not any(piece[2:5])

"""A Modbus device or device server that has bad habits, in memory, and what it said to each request (the judge).

Every register holds another number each time it is asked for, so that a byte of any other reply shows. A reply may
have several habits at once.
"""

import asyncio
import random
import struct
from collections import Counter, defaultdict, deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from itertools import pairwise

from benchmarks.memory_net import MemoryTransport, Piece
from drivers.modbus.rtu import crc

SPLIT_S = 0.03
"""Longest pause between two pieces of a reply: below what a reply's rest is waited for."""
KEPT = 64
"""So many former replies are kept, to be sent again."""


@dataclass(slots=True)
class Reply:
    """What is sent instead of the `honest` frame: when, in which pieces, and what happens to the connection."""

    honest: bytes
    frame: bytes
    delay: float = 0.001
    cuts: tuple[int, ...] = ()
    pause: float = 0.0
    again: tuple[float, ...] = ()
    before: bytes = b""
    on_next_connection: bool = False
    hang_up: bool = False

    def pieces(self, rng: random.Random) -> list[Piece]:
        """The frame in its pieces."""
        frame = self.before + self.frame
        places = sorted({0, *(cut for cut in self.cuts if 0 < cut < len(frame)), len(frame)})
        parts = [frame[start:end] for start, end in pairwise(places)]
        return [(rng.random() * self.pause if number else 0.0, part) for number, part in enumerate(parts)]


Place = tuple[int, int, int]
"""Unit, function, address."""
Habit = Callable[["HostileDevice", Reply, random.Random], None]


def _split(_: "HostileDevice", reply: Reply, rng: random.Random) -> None:
    length = len(reply.frame)
    some = rng.randint(1, 3) if rng.random() < 0.8 else length
    # Often near an end: where another frame's first bytes may lie.
    near = [place % max(1, length) for place in (1, 2, 3, 6, 7, -1, -2)]
    reply.cuts += tuple(rng.choice(near) if rng.random() < 0.6 else rng.randint(0, length) for _ in range(some))
    reply.pause = rng.random() * SPLIT_S


def _cut(_: "HostileDevice", reply: Reply, rng: random.Random) -> None:
    missing = rng.randint(1, 2) if rng.random() < 0.6 else rng.randint(0, len(reply.frame))
    reply.frame = reply.frame[: max(0, len(reply.frame) - missing)]


def _late(device: "HostileDevice", reply: Reply, rng: random.Random) -> None:
    reply.delay = rng.random() * device.latest_s


def _leave_over(_: "HostileDevice", reply: Reply, rng: random.Random) -> None:
    reply.on_next_connection = True
    reply.hang_up = rng.random() < 0.5
    reply.delay = rng.random() * 0.05


def _duplicate(device: "HostileDevice", reply: Reply, rng: random.Random) -> None:
    # On a line at once, since it has no ids: behind a silence it is the answer to the next request.
    reply.again = tuple(0.0 if device.is_line else rng.random() for _ in range(rng.randint(1, 3)))


def _swap(device: "HostileDevice", reply: Reply, rng: random.Random) -> None:
    """After the answer to the next request, if that comes in time."""
    reply.delay = rng.uniform(0.25, min(0.9, device.latest_s))


def _send_former(device: "HostileDevice", reply: Reply, rng: random.Random) -> None:
    """A reply to any earlier request before this one's."""
    if device.former:
        reply.before = rng.choice(device.former)


def _noise(device: "HostileDevice", reply: Reply, rng: random.Random) -> None:
    if device.is_line and len(reply.frame) > 2 and rng.random() < 0.7:
        # A burst of up to 16 bits, which a CRC of 16 bits always tells.
        start, mask = rng.randint(0, 8 * len(reply.frame) - 16), rng.randint(1, 0xFFFF)
        reply.frame = (int.from_bytes(reply.frame, "big") ^ mask << start).to_bytes(len(reply.frame), "big")
    elif device.is_line:
        reply.before = rng.randbytes(rng.randint(1, 8))
    else:
        # More than is missing of any reply: what is none and fills the gap in one to a byte, nothing tells.
        reply.before = rng.randbytes(rng.randint(64, 80))


def _hang_up(_: "HostileDevice", reply: Reply, rng: random.Random) -> None:
    reply.frame, reply.hang_up = reply.frame[: rng.randint(0, len(reply.frame))], True


def _silent(_: "HostileDevice", reply: Reply, _rng: random.Random) -> None:
    reply.frame = b""


def _busy(device: "HostileDevice", reply: Reply, rng: random.Random) -> None:
    unit, function = reply.honest[device.head], reply.honest[device.head + 1]
    reply.frame = device.framed(reply.honest[:2], bytes((unit, function | 0x80, rng.choice((5, 6, 11)))))


def _other_unit(device: "HostileDevice", reply: Reply, rng: random.Random) -> None:
    pdu = reply.honest[device.head : len(reply.honest) - (2 if device.is_line else 0)]
    # Of one that is not asked: on a line its number is all that a unit's late reply is known by.
    reply.frame = device.framed(reply.honest[:2], bytes((pdu[0] + rng.randint(10, 13),)) + pdu[1:])


HABITS: Mapping[str, Habit] = {
    "split": _split,
    "cut short": _cut,
    "late": _late,
    "left over for the next connection": _leave_over,
    "sent again": _duplicate,
    "swapped with the next": _swap,
    "behind a former reply": _send_former,
    "noise": _noise,
    "hung up in the middle": _hang_up,
    "silent": _silent,
    "busy": _busy,
    "from another unit": _other_unit,
}
LATER_THAN_A_LINE_CAN_TELL = frozenset({"behind a former reply"})
"""On a line without ids no habit of those that it can be held against (see docs/links.md, Serial lines)."""


@dataclass
class HostileDevice:
    """`is_line`: RTU frames, else Modbus TCP's. `latest_s`: the latest that a reply comes.

    `share` of the replies have a habit, and of those a share another one, and so on.
    """

    rng: random.Random
    is_line: bool
    latest_s: float
    share: float
    habits: tuple[str, ...] = tuple(HABITS)
    requests: int = 0
    seen: Counter[str] = field(default_factory=Counter)
    former: deque[bytes] = field(default_factory=lambda: deque(maxlen=KEPT))
    _said: dict[Place, deque[tuple[float, int, tuple[str, ...]]]] = field(
        default_factory=lambda: defaultdict(lambda: deque(maxlen=KEPT))
    )
    _left_over: list[tuple[float, bytes]] = field(default_factory=list)
    _rests: dict[MemoryTransport, bytes] = field(default_factory=dict)

    @property
    def head(self) -> int:
        """Bytes before the unit."""
        return 0 if self.is_line else 6

    # ------------------------------------------------------------ the judge

    def habits_of(self, place: Place, value: int, begin: float, received: float) -> tuple[str, ...] | None:
        """The habits of the reply that said so of a register to a request of between these times.

        None: nothing of the kind was said.
        """
        for at, said, habits in reversed(self._said[place]):
            if said == value and begin <= at <= received:
                return habits
        return None

    # ------------------------------------------------------------ the peer

    def connected(self, connection: MemoryTransport) -> None:
        """A new connection; what the former ones were to have comes on it, in time."""
        self._rests[connection] = b""
        left, self._left_over = self._left_over, []
        now = asyncio.get_running_loop().time()
        for until, frame in left:
            delay = self.rng.random() * 0.3
            if now + delay < until:
                asyncio.get_running_loop().call_later(delay, connection.send, [(0.0, frame)])

    def heard(self, connection: MemoryTransport, data: bytes) -> None:
        """Bytes of the driver: whole requests are answered."""
        rest = self._rests.get(connection, b"") + data
        size = 8 if self.is_line else 12
        while len(rest) >= size:
            request, rest = rest[:size], rest[size:]
            self._answer(connection, request)
        self._rests[connection] = rest

    def framed(self, transaction: bytes, plain: bytes) -> bytes:
        """Unit and PDU as they go on this link."""
        if self.is_line:
            return plain + crc(plain)
        return transaction + b"\0\0" + len(plain).to_bytes(2, "big") + plain

    def _answer(self, connection: MemoryTransport, request: bytes) -> None:
        loop = asyncio.get_running_loop()
        unit, function, address, count = struct.unpack(">BBHH", request[self.head : self.head + 6])
        self.requests += 1
        names = self._drawn()
        numbers = [self._number(function) for _ in range(count)]
        for offset, number in enumerate(numbers):
            self._said[unit, function, address + offset].append((loop.time(), number, names))
        if function in (1, 2):
            packed = sum(bit << place for place, bit in enumerate(numbers))
            body = packed.to_bytes((count + 7) // 8, "little")
        else:
            body = struct.pack(f">{count}H", *numbers)
        honest = self.framed(request[:2], bytes((unit, function, len(body))) + body)
        reply = Reply(honest, honest)
        for name in names:
            HABITS[name](self, reply, self.rng)
            self.seen[name] += 1
        self.former.append(honest)
        # Whatever is late on a line is so by its last byte.
        until = loop.time() + self.latest_s - (SPLIT_S * len(reply.cuts) if self.is_line else 0.0)
        if reply.on_next_connection:
            self._left_over.append((until, reply.before + reply.frame))
        elif reply.frame or reply.before:
            pieces = reply.pieces(self.rng)
            delay = min(reply.delay, until - loop.time())
            for after in (0.0, *reply.again):
                loop.call_later(delay + after, connection.send, pieces)
        if reply.hang_up:
            loop.call_later(reply.delay + 0.001, connection.hang_up)

    def _drawn(self) -> tuple[str, ...]:
        names: dict[str, None] = {}
        while len(names) < len(self.habits) and self.rng.random() < self.share:
            names[self.rng.choice(self.habits)] = None
        return tuple(names)

    def _number(self, function: int) -> int:
        if function in (1, 2):
            return self.rng.randrange(2)
        # Small ones too: they look like a frame's head.
        return self.rng.randrange(12) if self.rng.random() < 0.2 else self.rng.randrange(0x10000)

"""Hostile CAN buses: a protected message, an SDO server and a sender of long messages with bad habits (the judge too).

What a bus itself does (CiA 301, ISO 11898): frames of one identifier keep their order, and their own CRC finds bits
that were turned. So nothing here overtakes; what is beyond that, docs/can.md and docs/canopen.md say.
"""

import asyncio
import random
from collections import deque
from dataclasses import dataclass, field

from benchmarks.hostile_tally import Tally
from drivers.can.frame import CanFrame
from drivers.can.protection import Protection, protect_frame
from drivers.can.reception import MessageRules, Reception
from drivers.canopen.channel import SdoChannel
from drivers.canopen.place import ObjectPlace
from drivers.canopen.sdo import UNKNOWN_COMMAND, abort_frame
from drivers.errors import DriverError
from drivers.vehicle.isotp import Reassembler

FRAMES, READINGS, MESSAGES = 400, 100, 60
"""Of one episode: of a message, of the SDO client, of a sender of long messages."""
FORMER = 200
"""A counter of 8 bits tells a frame from one so many before it."""


# ---------------------------------------------------------------- a protected message

_KEY, _PERIOD_S, _DATA_ID = 0x181, 0.1, 0x1234
CAN_HABITS = ("lost", "cut short", "noise", "sent again", "swapped with the next", "a former frame", "new connection")


async def can_frames(_link: str, rng: random.Random, tally: Tally) -> None:
    """A protected message as the driver's reception hears it: a frame that is believed is newer than all before."""
    guard = Protection(_DATA_ID)
    reception = Reception()
    reception.listen(MessageRules(_KEY, "Speed", 8, guard), (), 3 * _PERIOD_S, 0.0)
    share, habits = rng.choice((0.05, 0.2, 0.4)), rng.sample(CAN_HABITS, rng.randint(2, len(CAN_HABITS)))
    sent: list[bytes] = []
    numbers: dict[bytes, int] = {}
    newest, former_at, outage = -1, -10, 0
    kept: bytes | None = None
    begin = rng.randrange(256)
    for number in range(FRAMES):
        now = number * _PERIOD_S
        frame = protect_frame(guard, begin + number, bytes(3) + number.to_bytes(2, "little") + rng.randbytes(3))
        sent.append(frame)
        numbers[frame] = number
        habit = rng.choice(habits) if rng.random() < share else ""
        tally.note(habit)
        arriving = [frame]
        if outage:
            outage -= 1
            arriving = []
        elif habit == "lost":
            arriving = []
        elif habit == "cut short":
            arriving = [frame[: rng.randrange(8)]]
        elif habit == "noise":
            turned = int.from_bytes(frame, "big") ^ rng.randint(1, 0xFFFF) << rng.randint(0, 48)
            arriving = [turned.to_bytes(8, "big")]
        elif habit == "sent again":
            arriving = [frame] * rng.randint(2, 4)
        elif habit == "swapped with the next" and kept is None:
            kept, arriving = frame, []
        elif habit == "a former frame" and number - former_at > 4:
            # One at a time: three former ones in their order are what a device sends that has begun anew.
            former_at = number
            arriving = [rng.choice(sent[-FORMER:]), frame]
        elif habit == "new connection":
            outage = rng.randrange(60)
            reception.restart(now)
            if number - former_at > 4 and rng.random() < 0.7:
                former_at, arriving = number, [rng.choice(sent[-FORMER:])]
        if kept is not None and kept != frame and arriving:
            arriving, kept = [*arriving, kept], None
        for data in arriving:
            fresh = reception.take(_KEY, CanFrame(now, _KEY, False, data), now)
            if fresh:
                newer = numbers.get(data, -1) > newest
                tally.judge(f"frame {numbers.get(data)} behind {newest}", (habit,), good=newer)
                newest = max(newest, numbers.get(data, -1))
        tally.exchanges += 1


# ---------------------------------------------------------------- an SDO server

OBJECTS = {ObjectPlace(0x2001, 1): 4, ObjectPlace(0x2001, 2): 4, ObjectPlace(0x2001, 3): 2, ObjectPlace(0x2200): 26}
"""Bytes of each; the last one comes in segments."""
SDO_HABITS = ("late", "cut short", "sent again", "silent", "request lost", "aborted", "no end", "held over")


@dataclass
class HostileNode:
    """An SDO server whose answers keep their order, as those of one node on one bus do, however late they are.

    `said` are the object, the loop's time and the bytes of each answer; `channel` hears them.
    """

    rng: random.Random
    tally: Tally
    share: float
    habits: tuple[str, ...]
    channel: SdoChannel | None = None
    said: deque[tuple[ObjectPlace, float, bytes]] = field(default_factory=lambda: deque(maxlen=64))
    _free_at: float = 0.0
    _left: bytes = b""
    _toggle: int = 0

    def heard(self, frame: bytes) -> None:
        """A frame of the client."""
        habit = self.rng.choice(self.habits) if self.rng.random() < self.share else ""
        self.tally.note(habit)
        self.tally.exchanges += frame[0] >> 5 in (2, 5)
        if habit == "request lost":
            return
        answer = self._answer(frame)
        if answer and habit == "aborted":
            answer, self._left = abort_frame(_place(frame), 0x08000000), b""
        if answer and habit == "no end":
            self._left = b""
        if not answer or habit == "silent":
            return
        if habit == "cut short":
            answer = answer[: self.rng.randrange(8)]
        loop = asyncio.get_running_loop()
        delay = {"late": self.rng.random() * 2.0, "held over": self.rng.uniform(1.0, 3.0)}.get(habit, 0.001)
        at = self._free_at = max(self._free_at, loop.time() + delay)
        for _ in range(self.rng.randint(2, 3) if habit == "sent again" else 1):
            loop.call_at(at, self._put, answer)

    def _put(self, answer: bytes) -> None:
        if self.channel is not None:
            self.channel.receive(answer)

    def _answer(self, frame: bytes) -> bytes:
        command, place = frame[0], _place(frame)
        if command >> 5 == 2:
            data = self.rng.randbytes(OBJECTS.get(place, 4))
            self.said.append((place, asyncio.get_running_loop().time(), data))
            if len(data) <= 4:
                return bytes([0x43 | (4 - len(data)) << 2]) + frame[1:4] + data.ljust(4, b"\0")
            self._left, self._toggle = data, 0
            return bytes([0x41]) + frame[1:4] + len(data).to_bytes(4, "little")
        if command >> 5 == 3:
            piece, self._left = self._left[:7], self._left[7:]
            if command & 0x10 != self._toggle or not piece:
                return abort_frame(place, 0x05030000)
            self._toggle ^= 0x10
            return bytes([command & 0x10 | (7 - len(piece)) << 1 | (not self._left)]) + piece.ljust(7, b"\0")
        if command >> 5 == 5:
            return abort_frame(place, UNKNOWN_COMMAND)
        self._left = b""
        return b""


def _place(frame: bytes) -> ObjectPlace:
    return ObjectPlace(int.from_bytes(frame[1:3], "little"), frame[3])


async def sdo_readings(_link: str, rng: random.Random, tally: Tally) -> None:
    """One SDO client after the other, as connections follow one another, and one server."""
    loop = asyncio.get_running_loop()
    habits = tuple(rng.sample(SDO_HABITS, rng.randint(2, len(SDO_HABITS))))
    node = HostileNode(rng, tally, rng.choice((0.05, 0.15, 0.3)), habits)
    timeout = rng.choice((0.1, 0.3))

    def send(frame: bytes) -> None:
        loop.call_later(0.001, node.heard, frame)

    for _ in range(READINGS):
        if node.channel is None or rng.random() < 0.05:
            node.channel = SdoChannel(send, timeout)
        place = rng.choice(tuple(OBJECTS))
        begin = loop.time()
        try:
            data = await node.channel.read(place, OBJECTS[place], block=OBJECTS[place] > 4 and rng.random() < 0.3)
        except DriverError:
            pass
        else:
            said = any((where, what) == (place, data) and at >= begin for where, at, what in node.said)
            tally.judge(f"{place} read as {data.hex()} at {loop.time():.3f}", (), good=said)
        await asyncio.sleep(rng.choice((0.0, 0.01, 0.3, 1.0)))


# ---------------------------------------------------------------- messages of several frames

ISOTP_HABITS = ("lost", "cut short", "sent again", "swapped with the next", "new connection")


async def isotp_messages(_link: str, rng: random.Random, tally: Tally) -> None:
    """Long messages of one unit: what is put together was sent as one. Losses are shorter than a message."""
    habits = rng.sample(ISOTP_HABITS, rng.randint(1, len(ISOTP_HABITS)))
    share, receiver, now = rng.choice((0.02, 0.1, 0.3)), Reassembler(), 0.0
    length, sent = rng.randint(20, 60), set()
    outage = 0
    for _ in range(MESSAGES):
        payload = rng.randbytes(length)
        sent.add(payload)
        rest = [payload[at : at + 7] for at in range(6, length, 7)]
        frames = [(0x1000 | length).to_bytes(2, "big") + payload[:6]]
        frames += [bytes([0x20 | number % 16]) + part for number, part in enumerate(rest, start=1)]
        at, lost_in_a_row, swapped_at = 0, 0, -1
        while at < len(frames):
            now += 0.01
            habit = rng.choice(habits) if rng.random() < share else ""
            tally.note(habit)
            arriving = [frames[at]]
            if outage:
                outage, arriving = outage - 1, []
            elif habit == "lost" and lost_in_a_row < 1:
                arriving = []
            elif habit == "cut short":
                arriving = [frames[at][: rng.randrange(len(frames[at]))]]
            elif habit == "sent again":
                arriving = [frames[at]] * 2
            elif habit == "swapped with the next" and swapped_at < at < len(frames) - 1:
                frames[at], frames[at + 1], swapped_at = frames[at + 1], frames[at], at + 1
                arriving = [frames[at]]
            elif habit == "new connection":
                receiver.restart()
                outage, arriving = rng.randrange(3 * len(frames)), []
            lost_in_a_row = 0 if arriving else lost_in_a_row + 1
            for data in arriving:
                heard = receiver.take(now, data)
                if heard is not None:
                    tally.judge(f"a message of {len(heard)} bytes that nobody sent", (habit,), good=heard in sent)
            at += 1
        tally.exchanges += 1

"""Evidence: whoever listens gets every byte that the drivers opened within `tap_frames` put on a wire or take from one.

A wire asks `current()` once, when it is made, and tells what it moves. A tap crosses all layers between a command and a
socket, and none of them has to know of it: hence a context variable and no argument.
"""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Literal

Medium = Literal["tcp", "udp", "serial", "can"]


@dataclass(frozen=True, slots=True, kw_only=True)
class TapFrame:
    """Bytes as they were moved: `time` in seconds UTC (the wall clock), `sent` by us or received.

    `place` is the far end (`192.168.1.10:502`, `/dev/ttyUSB0`, `socketcan can0`), `local` our end where there is one.
    Of TLS the plain text is told. A CAN frame is 8 bytes of head (id and flags, length, both big-endian) and its data,
    as LINKTYPE_CAN_SOCKETCAN has it.
    """

    time: float
    sent: bool
    medium: Medium
    place: str
    data: bytes
    local: str = ""


Tap = Callable[[TapFrame], None]

_TAP: ContextVar[Tap | None] = ContextVar("tap", default=None)


@contextmanager
def tap_frames(tap: Tap) -> Iterator[None]:
    """Tell `tap` of everything that is opened within; tasks and threads that are started within belong to it."""
    token = _TAP.set(tap)
    try:
        yield
    finally:
        _TAP.reset(token)


def current() -> Tap | None:
    """Who is to be told, if anybody."""
    return _TAP.get()


def make_frame(medium: Medium, place: str, data: bytes, *, sent: bool, local: str = "") -> TapFrame:
    """A frame of this moment."""
    return TapFrame(time=time.time(), sent=sent, medium=medium, place=place, data=data, local=local)

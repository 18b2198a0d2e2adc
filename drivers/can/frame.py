"""One data frame as the decoders of OBD-II and J1939 see it, and what they find in it."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple, Protocol

from drivers.codec import Reading
from drivers.tag import Tag


class CanFrame(NamedTuple):
    """A data frame: `time` in seconds of the clock that stamped it, `id` without flags, 8 bytes at most unless `fd`."""

    time: float
    id: int
    extended: bool
    data: bytes
    channel: str = ""
    fd: bool = False


class TagReading(NamedTuple):
    """What a message says of one tag."""

    tag: Tag
    reading: Reading


class FrameListener(Protocol):
    """A decoder that follows a bus: frames in, readings of its tags out; it never raises for what a frame holds."""

    def take(self, frame: CanFrame) -> Sequence[TagReading]:
        """What the frame, or the message that it completes, says of the tags."""
        ...

    def counts(self) -> Mapping[str, int]:
        """What became of the frames and messages so far; all only grow."""
        ...

    def restart(self) -> None:
        """It is another connection: no message that began before it is gone on with."""
        ...

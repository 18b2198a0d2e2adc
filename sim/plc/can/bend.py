"""What faults do to the frames of the raw-frame CAN face, and to the bus itself (pure)."""

from collections.abc import Iterable
from dataclasses import dataclass
from random import Random


@dataclass(frozen=True, slots=True)
class CanBend:
    """What is wrong with the frames of the named `messages` (empty: all of them), or with the bus.

    `loss` is the share of frames that are lost, `cut` the bytes by which they are shorter, `stale` repeats the last
    ones as they were, `corrupt` makes one drawn bit another one. `babble` (frames/s) is what a strange node sends, with
    the PLC's own ids if `known`. `bus_off` takes every controller off the bus.
    """

    messages: frozenset[str] = frozenset()
    loss: float = 0.0
    cut: int = 0
    stale: bool = False
    corrupt: bool = False
    babble: float = 0.0
    known: bool = False
    bus_off: bool = False

    def strikes(self, message: str) -> bool:
        """True if the frames of this message are bent."""
        return not self.messages or message in self.messages


def bent(bends: Iterable[CanBend], data: bytes, last: bytes | None, rng: Random) -> bytes | None:
    """The payload that goes out in the place of `data`, None where none does; `last` is what went out before."""
    for bend in bends:
        if bend.loss and rng.random() < bend.loss:
            return None
        if bend.stale:
            data = last or data
        if bend.corrupt and data:
            at = rng.randrange(8 * len(data))
            data = data[: at // 8] + bytes((data[at // 8] ^ 1 << at % 8,)) + data[at // 8 + 1 :]
        data = data[: max(0, len(data) - bend.cut)]
    return data

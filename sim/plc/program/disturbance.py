"""What faults do to frames on a CAN bus, to the bus itself, and to a CANopen node (pure)."""

from collections.abc import Iterable
from dataclasses import dataclass
from random import Random


@dataclass(frozen=True, slots=True)
class BusDisturbance:
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
        """True if the frames of this message are disturbed."""
        return not self.messages or message in self.messages


def disturb_payload(
    disturbances: Iterable[BusDisturbance], data: bytes, last: bytes | None, rng: Random
) -> bytes | None:
    """The payload that goes out in the place of `data`, None where none does; `last` is what went out before."""
    for disturbance in disturbances:
        if disturbance.loss and rng.random() < disturbance.loss:
            return None
        if disturbance.stale:
            data = last or data
        if disturbance.corrupt and data:
            at = rng.randrange(8 * len(data))
            data = data[: at // 8] + bytes((data[at // 8] ^ 1 << at % 8,)) + data[at // 8 + 1 :]
        data = data[: max(0, len(data) - disturbance.cut)]
    return data


@dataclass(frozen=True, slots=True)
class NodeDisturbance:
    """What is wrong with the node: no heartbeat, TPDOs `length` bytes longer (shorter: negative), an emergency.

    `pdo` is the TPDO that is disturbed, 0 all of them. `emergency` is error code and error register; `reset` boots the
    node when the fault begins.
    """

    no_heartbeat: bool = False
    pdo: int = 0
    length: int = 0
    emergency: tuple[int, int] | None = None
    reset: bool = False

    def payload(self, number: int, data: bytes) -> bytes:
        """The payload of TPDO `number` as it goes out: 0 to 8 bytes."""
        if not self.length or self.pdo not in (0, number):
            return data
        return data[: max(0, len(data) + self.length)] if self.length < 0 else (data + bytes(self.length))[:8]


def together(disturbances: Iterable[NodeDisturbance]) -> NodeDisturbance:
    """Several faults as one; of two that change PDOs or announce an emergency the later one wins."""
    whole = NodeDisturbance()
    for disturbance in disturbances:
        changing = disturbance if disturbance.length else whole
        whole = NodeDisturbance(
            no_heartbeat=whole.no_heartbeat or disturbance.no_heartbeat,
            pdo=changing.pdo,
            length=changing.length,
            emergency=disturbance.emergency or whole.emergency,
            reset=whole.reset or disturbance.reset,
        )
    return whole

"""What faults do to the CANopen node (pure)."""

from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class NodeBend:
    """What is wrong with the node: no heartbeat, TPDOs `length` bytes longer (shorter: negative), an emergency.

    `pdo` is the TPDO that is bent, 0 all of them. `emergency` is error code and error register; `reset` boots the node
    when the fault begins.
    """

    no_heartbeat: bool = False
    pdo: int = 0
    length: int = 0
    emergency: tuple[int, int] | None = None
    reset: bool = False

    def bent(self, number: int, data: bytes) -> bytes:
        """The payload of TPDO `number` as it goes out: 0 to 8 bytes."""
        if not self.length or self.pdo not in (0, number):
            return data
        return data[: max(0, len(data) + self.length)] if self.length < 0 else (data + bytes(self.length))[:8]


def together(bends: Iterable[NodeBend]) -> NodeBend:
    """Several faults as one; of two that bend PDOs or announce an emergency the later one wins."""
    whole = NodeBend()
    for bend in bends:
        bending = bend if bend.length else whole
        whole = NodeBend(
            whole.no_heartbeat or bend.no_heartbeat,
            bending.pdo,
            bending.length,
            bend.emergency or whole.emergency,
            whole.reset or bend.reset,
        )
    return whole

"""What a CAN controller says of itself and of the wire: error frames to a state and counters (pure).

The classes and bytes are those of linux/can/error.h, which python-can hands on as they are.
"""

from dataclasses import dataclass, field
from enum import StrEnum

_CONTROLLER, _BUS_OFF, _BUS_ERROR, _RESTARTED, _COUNTERS = 0x04, 0x40, 0x80, 0x100, 0x200
_PROTOCOL, _NO_ACKNOWLEDGE, _LOST_ARBITRATION = 0x08, 0x20, 0x02
_OVERFLOW, _WARNING, _PASSIVE, _ACTIVE = 0x03, 0x0C, 0x30, 0x40


class ControllerState(StrEnum):
    """The states of ISO 11898-1's fault confinement; `warning` is active, with a counter of 96 or more."""

    ACTIVE = "active"
    WARNING = "warning"
    PASSIVE = "passive"
    BUS_OFF = "bus-off"


@dataclass(slots=True)
class BusErrors:
    """The controller's state by its error frames so far, its error counters (0..255), and how often what was seen."""

    state: ControllerState = ControllerState.ACTIVE
    transmit_errors: int = 0
    receive_errors: int = 0
    counts: dict[str, int] = field(
        default_factory=lambda: dict.fromkeys(
            ("error_frames", "bus_errors", "no_acknowledge", "lost_arbitration", "overruns", "passive", "bus_off"), 0
        )
    )

    def take(self, classes: int, data: bytes) -> None:
        """Take in one error frame: the classes in its id, and its eight bytes."""
        data = data.ljust(8, b"\0")
        before = self.state
        self.counts["error_frames"] += 1
        self.counts["bus_errors"] += bool(classes & (_BUS_ERROR | _PROTOCOL))
        self.counts["no_acknowledge"] += bool(classes & _NO_ACKNOWLEDGE)
        self.counts["lost_arbitration"] += bool(classes & _LOST_ARBITRATION)
        if classes & (_CONTROLLER | _COUNTERS):
            self.transmit_errors, self.receive_errors = data[6], data[7]
        if classes & _CONTROLLER:
            self.counts["overruns"] += bool(data[1] & _OVERFLOW)
            # The worst flag of the frame counts; a frame about an overrun alone has none of the three.
            if data[1] & _PASSIVE:
                self.state = ControllerState.PASSIVE
            elif data[1] & _WARNING:
                self.state = ControllerState.WARNING
            elif data[1] & _ACTIVE:
                self.state = ControllerState.ACTIVE
        if classes & _RESTARTED:
            self.restart()
        if classes & _BUS_OFF:
            self.state = ControllerState.BUS_OFF
        self.counts["passive"] += self.state is ControllerState.PASSIVE is not before
        self.counts["bus_off"] += self.state is ControllerState.BUS_OFF is not before

    def restart(self) -> None:
        """The controller begins anew."""
        self.state, self.transmit_errors, self.receive_errors = ControllerState.ACTIVE, 0, 0

"""A CAN bus whose frames are also told to a tap (`drivers.tap`): whatever is received, and whatever could be sent."""

import struct

import can

from drivers.tap import Tap, make_frame

_EXTENDED, _REMOTE, _ERROR = 0x80000000, 0x40000000, 0x20000000


class TappedBus(can.BusABC):
    """Hands everything through to `bus`, which it owns; `place` is what the bus is called in the evidence."""

    def __init__(self, bus: can.BusABC, tap: Tap, place: str) -> None:
        self.bus, self._tap, self._place = bus, tap, place
        self._can_protocol = bus.protocol
        super().__init__(place, bus.filters)
        self.channel_info = bus.channel_info

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Put one frame on the bus."""
        self.bus.send(msg, timeout)
        self._report(msg, sent=True)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Take one frame, or None after `timeout` seconds."""
        message = self.bus.recv(timeout)
        if message is not None:
            self._report(message, sent=False)
        return message

    def _report(self, message: can.Message, *, sent: bool) -> None:
        self._tap(make_frame("can", self._place, pack_frame(message), sent=sent))

    def fileno(self) -> int:
        """The bus's own descriptor."""
        return self.bus.fileno()

    def set_filters(self, filters: can.typechecking.CanFilters | None = None) -> None:
        """The bus's own filters."""
        self.bus.set_filters(filters)

    @property
    def state(self) -> can.BusState:
        """The controller's state."""
        return self.bus.state

    @state.setter
    def state(self, new_state: can.BusState) -> None:
        self.bus.state = new_state

    def shutdown(self) -> None:
        """Leave the bus. May be called twice."""
        super().shutdown()
        self.bus.shutdown()


def pack_frame(message: can.Message) -> bytes:
    """A frame as LINKTYPE_CAN_SOCKETCAN has it: id with flags and length, both big-endian, then the data."""
    word = message.arbitration_id
    word |= _EXTENDED if message.is_extended_id else 0
    word |= _REMOTE if message.is_remote_frame else 0
    word |= _ERROR if message.is_error_frame else 0
    data = b"" if message.is_remote_frame else bytes(message.data)
    return struct.pack(">IB3x", word, message.dlc if message.is_remote_frame else len(data)) + data

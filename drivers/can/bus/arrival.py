"""When a frame came, whatever kept this process from taking it at once: on the monotonic clock, and on a driver's.

Over SocketCAN and a hub a frame's `timestamp` is when the system received it, by the wall clock. Where that was set
meanwhile, the frame is no younger for it. Other interfaces have clocks of their own, or stamp what is taken from them
when it is taken: of their frames nothing is known but that.
"""

import time
from collections.abc import Callable

import can

from drivers.can.bus.hub_bus import HubBus
from drivers.can.bus.tapped import TappedBus

_STAMP_TOLERANCE_S = 0.001
"""A stamp may differ by so much from what the clocks read before and after it say."""
_MAX_FRAME_AGE_S = 60.0
"""So long a frame may have waited; a stamp that says more is of a wall clock that was set."""
_MIN_SPEED_BASE_S = 1.0
"""The seconds of a driver's clock, at least, by which its speed is known."""


class Arrivals:
    """The moments (monotonic s) at which the frames of one bus came."""

    def __init__(self, bus: can.BusABC) -> None:
        self._stamped = _stamps(bus)
        self._empty = time.monotonic()
        self._ahead = time.time() - time.monotonic()

    def found_empty(self, moment: float) -> None:
        """Nothing waited on the bus at this moment (monotonic s)."""
        self._empty = moment
        self._ahead = time.time() - time.monotonic()

    def moment(self, message: can.Message) -> float:
        """When this frame came, which has just been taken."""
        wall, now = time.time(), time.monotonic()
        if not self._stamped:
            return now
        # By as much as the wall clock was set back since the bus was last found empty, the frame is older than it says.
        age = wall - message.timestamp + max(0.0, self._ahead - (wall - now))
        return now - max(age, 0.0) if -_STAMP_TOLERANCE_S <= age <= _MAX_FRAME_AGE_S else min(self._empty, now)


class ClockBefore:
    """What a driver's clock showed at a moment of the near past (monotonic s); it runs evenly, at whatever speed."""

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._base = self._next = (time.monotonic(), clock())

    def clock_time(self, moment: float) -> float:
        """The clock's time at a moment, never later than it shows now."""
        now, shown = time.monotonic(), self._clock()
        if now - self._next[0] >= _MIN_SPEED_BASE_S:
            self._base, self._next = self._next, (now, shown)
        then, showed = self._base
        speed = (shown - showed) / (now - then) if now > then else 0.0
        return shown - max(0.0, speed * (now - moment))


def _stamps(bus: can.BusABC) -> bool:
    """True if the system stamps what this bus receives."""
    from can.interfaces.socketcan import SocketcanBus

    while isinstance(bus, TappedBus):
        bus = bus.bus
    return isinstance(bus, HubBus | SocketcanBus)

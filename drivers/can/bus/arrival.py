"""When a frame came, whatever kept this process from taking it at once: on the monotonic clock, and on a driver's.

Where the system stamps what a socket receives (SocketCAN, the hub), a frame's `timestamp` is that stamp, by the wall
clock. No frame came before the bus was last found empty: where a stamp cannot be (the wall clock was set meanwhile),
that moment is taken; where an interface has a clock of its own, or none, the moment at which the frame was taken.
"""

import time
from collections.abc import Callable

import can

_SLACK_S = 0.001
"""A stamp may differ by so much from what the clocks read before and after it say."""
_OPENING_S = 60.0
"""Frames may have waited so long on a bus that is heard for the first time."""
_BASE_S = 1.0
"""The seconds of a driver's clock, at least, by which its speed is known."""


class Arrivals:
    """The moments (monotonic s) at which the frames of one bus came."""

    def __init__(self) -> None:
        self._empty = time.monotonic() - _OPENING_S
        self._ahead = time.time() - time.monotonic()
        self._stamped = False

    def found_empty(self, moment: float) -> None:
        """Nothing waited on the bus at this moment (monotonic s)."""
        self._empty = moment
        self._ahead = time.time() - time.monotonic()

    def moment(self, message: can.Message) -> float:
        """When this frame came, which has just been taken; never before the bus was last found empty."""
        wall, now = time.time(), time.monotonic()
        age = wall - message.timestamp
        if -_SLACK_S <= age <= now - self._empty + _SLACK_S:
            self._stamped = True
            # By as much as the wall clock was set back meanwhile the frame is older than it says.
            age += max(0.0, self._ahead - (wall - now))
            return min(max(now - age, self._empty), now)
        return self._empty if self._stamped else now


class ClockBefore:
    """What a driver's clock showed at a moment of the near past (monotonic s); it runs evenly, at whatever speed."""

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._base = self._next = (time.monotonic(), clock())

    def at(self, moment: float) -> float:
        """The clock's time at a moment, never later than it shows now."""
        now, shown = time.monotonic(), self._clock()
        if now - self._next[0] >= _BASE_S:
            self._base, self._next = self._next, (now, shown)
        then, showed = self._base
        speed = (shown - showed) / (now - then) if now > then else 0.0
        return shown - max(0.0, speed * (now - moment))

"""A CAN bus read by a thread of its own: frames reach the event loop in order, stamped when they came off the bus.

The thread is there for the stamps: the loop may be busy for some milliseconds, and a frame must not look younger than
it is. It only waits, stamps and hands over; everything else happens in the loop.
"""

import asyncio
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import can

from drivers.driver import Clock
from drivers.errors import LinkDown
from drivers.supervision import Supervisor

POLL = 0.05
"""Seconds after which the thread looks whether it is to end."""
WAITING = 8192
"""Frames kept for a loop that is behind; then the oldest are dropped and counted."""
_BUS_OFF = 0x40  # linux/can/error.h: error class "bus-off"


@dataclass(frozen=True, slots=True)
class StampedFrame:
    """One data frame with an 11-bit identifier; `time` by the driver's clock, `moment` by the loop's."""

    id: int
    data: bytes
    time: float
    moment: float


class Port:
    """One open bus. `take` gets each frame and `lost` the reason when the bus is gone, both in the event loop.

    Remote frames, frames with 29-bit identifiers and FD frames are not CANopen's; they are counted and left alone.
    """

    def __init__(
        self,
        bus: can.BusABC,
        clock: Clock,
        take: Callable[[StampedFrame], None],
        lost: Callable[[str], None],
        *,
        supervisor: Supervisor,
    ) -> None:
        self._bus, self._clock, self._take, self._lost = bus, clock, take, lost
        self._loop = asyncio.get_running_loop()
        self._frames: deque[StampedFrame] = deque()
        self._scheduled = self._closing = False
        self._ended = threading.Event()
        self.counts = dict.fromkeys(("frames", "foreign_frames", "dropped_frames", "error_frames"), 0)
        self._thread = supervisor.thread("bus receiver", self._read, stop=self._ended)

    def send(self, identifier: int, data: bytes) -> None:
        """Put one frame on the bus. Raises LinkDown."""
        if self._closing:
            raise LinkDown("the bus is closed")
        message = can.Message(arbitration_id=identifier, data=data, is_extended_id=identifier > 0x7FF)
        try:
            self._bus.send(message, timeout=POLL)
        except (can.CanError, OSError) as error:
            reason = f"the bus takes no frame: {error}"
            self._loop.call_soon(self._lost, reason)
            raise LinkDown(reason) from None

    def close(self) -> None:
        """Let the bus go, at once for the caller; the thread closes it within POLL seconds."""
        self._closing = True
        self._ended.set()

    async def closed(self) -> None:
        """Wait until the bus is closed."""
        await asyncio.to_thread(self._thread.join, 2.0)

    def _read(self) -> None:
        reason, known = "", False
        try:
            while not self._ended.is_set() and not reason:
                reason = self._heard(self._bus.recv(POLL))
            known = True
        except (can.CanError, OSError, ValueError) as error:
            reason, known = str(error) or type(error).__name__, True
        finally:
            # Whatever has ended it, also what the supervisor hears of: the bus is opened anew.
            if not self._closing:
                self._in_loop(self._lost, reason or "the bus cannot be read any more")
            if known:
                self._ended.set()
                self._bus.shutdown()

    def _heard(self, message: can.Message | None) -> str:
        """Hand a frame over; the reason if the controller says that it is off the bus."""
        if message is None:
            return ""
        if message.is_error_frame:
            self.counts["error_frames"] += 1
            return "the controller is bus-off" if message.arbitration_id & _BUS_OFF else ""
        self.counts["frames"] += 1
        if message.is_extended_id or message.is_remote_frame or message.is_fd:
            self.counts["foreign_frames"] += 1
            return ""
        if len(self._frames) >= WAITING:
            self._frames.popleft()
            self.counts["dropped_frames"] += 1
        frame = StampedFrame(message.arbitration_id, bytes(message.data), self._clock(), self._loop.time())
        self._frames.append(frame)
        if not self._scheduled:
            self._scheduled = True
            self._in_loop(self._drain)
        return ""

    def _drain(self) -> None:
        self._scheduled = False
        while self._frames:
            self._take(self._frames.popleft())

    def _in_loop(self, function: Callable[..., None], *arguments: object) -> None:
        try:
            self._loop.call_soon_threadsafe(function, *arguments)
        except RuntimeError:  # the loop has ended, and with it everybody who would listen
            self.close()

"""A CAN bus as CANopen has it: its data frames, in order and stamped, and how many others there were."""

import asyncio
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import can

from drivers.can.bus import ClockBefore, Pump
from drivers.driver import Clock
from drivers.errors import LinkDown
from drivers.supervision import Supervisor

_SEND_TIMEOUT = 0.05
_BUS_OFF = 0x40  # linux/can/error.h: error class "bus-off"


@dataclass(frozen=True, slots=True)
class StampedFrame:
    """One data frame with an 11-bit identifier; it came at `time` by the driver's clock, `moment` by the loop's."""

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
        self._clock_before, self._take, self._lost = ClockBefore(clock), take, lost
        self._loop = asyncio.get_running_loop()
        self._closing = False
        self._counts = dict.fromkeys(("frames", "foreign_frames", "error_frames"), 0)
        self._pump = Pump(bus, self._receive, lost, supervisor)

    @property
    def counts(self) -> Mapping[str, int]:
        """Frames that have come, those that are not CANopen's, error frames, and those that were too many."""
        return {**self._counts, "dropped_frames": self._pump.dropped}

    def send(self, identifier: int, data: bytes) -> None:
        """Put one frame on the bus. Raises LinkDown."""
        if self._closing:
            raise LinkDown("the bus is closed")
        message = can.Message(arbitration_id=identifier, data=data, is_extended_id=identifier > 0x7FF)
        try:
            self._pump.bus.send(message, timeout=_SEND_TIMEOUT)
        except (can.CanError, OSError, ValueError) as error:
            reason = f"the bus takes no frame: {error}"
            self._loop.call_soon(self._lost, reason)
            raise LinkDown(reason) from None

    def close(self) -> None:
        """Let the bus go. Nothing is given after that."""
        self._closing = True
        self._pump.close()

    async def join(self) -> None:
        """Wait until the bus is closed."""
        await self._pump.join()

    def drain(self) -> None:
        """Give all that has come by now, so that after a pause no frame in the midst of it is the newest."""
        self._pump.drain()

    def _receive(self, message: can.Message) -> None:
        if message.is_error_frame:
            self._counts["error_frames"] += 1
            if message.arbitration_id & _BUS_OFF:
                self._lost("the controller is bus-off")
            return
        self._counts["frames"] += 1
        if message.is_extended_id or message.is_remote_frame or message.is_fd:
            self._counts["foreign_frames"] += 1
            return
        came = message.timestamp
        self._take(StampedFrame(message.arbitration_id, bytes(message.data), self._clock_before.clock_time(came), came))

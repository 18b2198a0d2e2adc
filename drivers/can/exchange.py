"""One write: its frames on the bus, each once, and the wait for the device's echo of every one."""

import asyncio
import time
from collections.abc import Callable, Sequence

import can

from drivers.can.bus import Pump
from drivers.can.fields import frame_key, frame_name
from drivers.can.reception import Reception, Slot
from drivers.can.writing import Outgoing, WriteMap
from drivers.driver import BeforeSending
from drivers.errors import LinkDown, ReplyTimeout, WriteUnverified

_SEND_TIMEOUT = 0.05


class Exchange:
    """Sends frames of the write map and no others. `heard` is to be set when frames have come, or the bus is gone."""

    def __init__(self, write_map: WriteMap, reception: Reception, deadline: float) -> None:
        self.heard = asyncio.Event()
        self.counts = dict.fromkeys(("sent", "writes", "timeouts", "mismatches"), 0)
        self._write_map = write_map
        self._reception = reception
        self._deadline = deadline
        self._lock = asyncio.Lock()

    async def write(
        self,
        pump: Pump,
        composed: Sequence[tuple[Outgoing, bytes]],
        lost: Callable[[], str],
        before_sending: BeforeSending,
    ) -> None:
        """Send each frame once, then wait for the echoes; `lost` says why the bus is gone, "" while it is there.

        Raises LinkDown, ReplyTimeout or WriteUnverified.
        """
        async with self._lock:
            if reason := lost():
                raise LinkDown(reason)
            self.counts["writes"] += 1
            begun = time.monotonic()
            echoes: list[tuple[Outgoing, bytes, Slot]] = []
            for frame, data in composed:
                place = self._write_map.echoes[next(iter(frame.places))]
                _, slot = self._reception.listen(place.rules, place.field.conditions, place.timeout, begun)
                before_sending()
                send_frame(pump, frame.number, frame.is_extended, self._write_map.seal(frame, data))
                self.counts["sent"] += 1
                echoes.append((frame, data, slot))
            deadline = asyncio.get_running_loop().time() + self._deadline
            while True:
                self.heard.clear()
                missing, wrong = [], []
                for frame, data, slot in echoes:
                    if slot.frame is None or slot.heard < begun:
                        missing.append(frame)
                    elif difference := frame.echo_problem(data, slot.frame.data):
                        wrong.append(difference)
                if not missing and not wrong:
                    return
                if reason := lost():
                    raise LinkDown(f"it is not known whether the device took the write: {reason}")
                # An echo that differs may still be that of the write before; the right one has until the deadline.
                try:
                    async with asyncio.timeout_at(deadline):
                        await self.heard.wait()
                except TimeoutError:
                    break
            if wrong:
                self.counts["mismatches"] += 1
                raise WriteUnverified(wrong[0])
            self.counts["timeouts"] += 1
            frame = missing[0]
            raise ReplyTimeout(
                f"no echo {frame_name(frame.echo)} of {frame_name(frame.key)} within {self._deadline:g} s"
            )


def send_frame(pump: Pump, number: int, extended: bool, data: bytes) -> None:
    """Put one frame on the bus: all that the driver ever sends goes this way. Raises LinkDown if it cannot."""
    message = can.Message(arbitration_id=number, is_extended_id=extended, data=data, is_fd=len(data) > 8)
    try:
        pump.bus.send(message, timeout=_SEND_TIMEOUT)
    except (can.CanError, OSError, ValueError) as error:
        raise LinkDown(
            f"frame {frame_name(frame_key(number, extended=extended))} could not be sent: {error}"
        ) from error

"""What both CAN faces share: their place on a bus, its going and coming back, and the faults of the wire itself."""

import asyncio
from collections.abc import Callable, Sequence
from math import inf
from random import Random

import can

from drivers.can.bus import Pump, open_bus
from drivers.errors import DriverError
from sim.plc.program import BusDisturbance, Plc

_REOPEN_S = 0.1
_MIN_WAIT_S = 0.001
_BUS_OFF_PERIOD_S = 0.05
_BURST_FRAMES = 400
# linux/can/error.h: classes of error frames.
_BUS_OFF, _RESTARTED = 0x40, 0x100


class Station:
    """A place on the bus `where` (interface, channel) that gives each frame it hears to `heard`.

    `off` is true while a fault holds the bus off. Whatever is random comes from `rng`.
    """

    def __init__(
        self, where: tuple[str, str], heard: Callable[[can.Message], None], complain: Callable[[str], None], rng: Random
    ) -> None:
        self.interface, self.channel = where
        self.off = False
        self._heard, self._complain, self._rng = heard, complain, rng
        self._pump: Pump | None = None
        self._next_open = self._next_off = self._babbled_to = 0.0
        self._timer: asyncio.TimerHandle | None = None

    def open(self) -> None:
        """Join the bus. Raises OSError with a reason."""
        try:
            self._join()
        except DriverError as error:
            raise OSError(0, str(error)) from None

    def close(self) -> None:
        """Leave the bus."""
        if self._timer is not None:
            self._timer.cancel()
        if self._pump is not None:
            self._pump.close()
            self._pump = None

    def on_bus(self, now: float) -> bool:
        """Whether it is on the bus; a bus that went is tried again from time to time."""
        if self._pump is not None or now < self._next_open:
            return self._pump is not None
        self._next_open = now + _REOPEN_S
        try:
            self._join()
        except DriverError:
            return False
        return True

    def wake(self, moment: float, now: float, work: Callable[[], None]) -> None:
        """Have `work` done at a moment (monotonic), in the place of what was to be done before; inf: nothing.

        A controller keeps its messages' periods by a timer of its own: by the program's cycle alone a period would be
        rounded up to whole cycles.
        """
        if self._timer is not None:
            self._timer.cancel()
        loop = asyncio.get_running_loop()
        self._timer = loop.call_later(max(moment - now, _MIN_WAIT_S), work) if moment < inf else None

    def put(self, message: can.Message) -> None:
        """Send one frame; without a bus it is lost."""
        if self._pump is None:
            return
        try:
            self._pump.bus.send(message, timeout=0.01)
        except (can.CanError, OSError) as error:
            self._lose_bus(str(error))

    def disturb(self, disturbances: Sequence[BusDisturbance], ours: Sequence[int], now: float) -> None:
        """Once a cycle: the bus taken off, and a strange node's babble, with random ids or with `ours`."""
        self._silence_bus(disturbances, now)
        self._babble(disturbances, ours, now)

    def _join(self) -> None:
        self._pump = Pump(open_bus(self.interface, self.channel), self._heard, self._lose_bus)

    def _lose_bus(self, reason: str) -> None:
        if self._pump is not None:
            self.close()
            self._complain(f"the CAN bus {self.channel} is gone ({reason}); joining again as soon as it is back")

    def _silence_bus(self, disturbances: Sequence[BusDisturbance], now: float) -> None:
        """Bus-off for all: said again and again, as a controller that comes back finds the wire as it was."""
        off = any(disturbance.bus_off for disturbance in disturbances)
        if off and now >= self._next_off:
            self._next_off = now + _BUS_OFF_PERIOD_S
            self._error_frame(_BUS_OFF)
        elif self.off and not off:
            self._error_frame(_RESTARTED)
        self.off = off

    def _error_frame(self, kind: int) -> None:
        self.put(can.Message(is_error_frame=True, arbitration_id=kind, dlc=8, data=bytes(8)))

    def _babble(self, disturbances: Sequence[BusDisturbance], ours: Sequence[int], now: float) -> None:
        rate = sum(disturbance.babble for disturbance in disturbances)
        begun = self._babbled_to or now
        self._babbled_to = now if rate else 0.0
        known = ours and any(disturbance.known for disturbance in disturbances)
        for _ in range(min(_BURST_FRAMES, round(rate * (now - begun)))):
            number = self._rng.choice(ours) if known else self._rng.randrange(0x800)
            data = self._rng.randbytes(self._rng.randrange(9))
            self.put(can.Message(arbitration_id=number, is_extended_id=False, data=data))


def record(plc: Plc, face: str, number: int, data: bytes | None, *, sent: bool) -> None:
    """The recorder's row of a frame; one that a fault has kept from the bus has no data."""
    row = {"face": face, "sent": sent, "id": number, "data": None if data is None else data.hex()}
    plc.record("frame", plc.clock.monotonic(), {**row, "version": plc.image.version})

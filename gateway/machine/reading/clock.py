"""Plant time: seconds UTC that run on the monotonic clock, so that a jump of the wall clock moves no deadline."""

import asyncio
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Protocol


class Clock(Protocol):
    """What the gateway needs of time: to read it and to sleep until it. `speed` is plant seconds per real second."""

    @property
    def speed(self) -> float: ...

    def now(self) -> float:
        """Plant time in seconds since 1970 UTC; never goes back."""
        ...

    async def sleep_until(self, moment: float, stop: asyncio.Event | None = None) -> None:
        """Return when `now()` has reached `moment`; at once if it has passed (after giving other tasks their turn).

        `stop`, once it is set, may end the wait before.
        """
        ...


@dataclass(frozen=True, slots=True)
class PlantClock:
    """Plant time = epoch + (monotonic - start) * speed.

    The epoch is the wall clock at start: a later correction of the wall clock (NTP, an operator) shows in
    `wall_offset` and takes effect at the next start; until then the time line has neither a jump nor a gap.
    """

    epoch: float
    start: float
    speed: float = 1.0
    monotonic: Callable[[], float] = time.monotonic
    wall: Callable[[], float] = time.time

    def now(self) -> float:
        """Plant time in seconds since 1970 UTC; never goes back."""
        return self.epoch + (self.monotonic() - self.start) * self.speed

    async def sleep_until(self, moment: float, stop: asyncio.Event | None = None) -> None:
        """Return when `now()` has reached `moment`, or `stop` is set; at once if it has passed (after giving other
        tasks their turn)."""
        if (left := moment - self.now()) <= 0:
            await asyncio.sleep(0)
        while left > 0:
            if stop is None:
                await asyncio.sleep(left / self.speed)
            else:
                # A deadline around the wait for the stop: no task of its own for either, at every scan.
                with suppress(TimeoutError):
                    async with asyncio.timeout(left / self.speed):
                        await stop.wait()
                        return
            left = moment - self.now()

    def wall_offset(self) -> float:
        """By how many seconds the wall clock has moved away from the epoch's time line since the start."""
        return self.wall() - self.epoch - (self.monotonic() - self.start)


def plant_clock(speed: float = 1.0, epoch: float | None = None) -> PlantClock:
    """A clock that starts now. Raises ValueError unless speed is positive."""
    if not speed > 0:
        raise ValueError(f"the clock's speed must be positive, got {speed}")
    return PlantClock(epoch=time.time() if epoch is None else epoch, start=time.monotonic(), speed=speed)

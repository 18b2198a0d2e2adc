"""Plant time: a straight line over the monotonic clock, which on Linux is the same for every process of the machine."""

import time
from collections.abc import Callable
from dataclasses import dataclass

Monotonic = Callable[[], float]


@dataclass(frozen=True, slots=True)
class EmulatorClock:
    """Plant time = epoch + (monotonic - start) * speed; the line never changes while the process lives.

    Whoever knows the three numbers (they are in the ready line) reads the same plant time.
    """

    epoch: float
    start: float
    speed: float = 1.0
    monotonic: Monotonic = time.monotonic

    def plant_time(self, moment: float) -> float:
        """Plant time (seconds UTC) of a monotonic moment."""
        return self.epoch + (moment - self.start) * self.speed

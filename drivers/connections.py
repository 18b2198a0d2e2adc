"""Connections that several drivers of one program share: made by who makes the drivers, and handed to each of them."""

from collections.abc import Callable, Hashable
from typing import Any


class Connections:
    """What leads to several devices, by its place (a host and port, a serial line): one owner each, for all drivers.

    Whoever makes the drivers of one program makes one of these and gives it to `drivers.driver.open_driver` each time.
    Which places there are, and what is shared at them, is the drivers' own.
    """

    def __init__(self) -> None:
        self._at: dict[Hashable, Any] = {}

    def obtain(self, place: Hashable, make: Callable[[], Any]) -> Any:
        """What is shared at the place, made by the first who asks."""
        if place not in self._at:
            self._at[place] = make()
        return self._at[place]

"""The newest picture of all machines for every browser that listens: encoded once a language, and never queued.

A browser that is slow is sent the newest picture when it has taken the one before; what lay between it never sees, and
what it costs here is one picture. So an update is never old when it is sent.
"""

import asyncio
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from gateway.network import SharedPlaces
from gateway.outside.status import GatewayStatus
from sim.strict_json import json_text

Show = Callable[[str, GatewayStatus], Mapping[str, Any]]
"""Gives what a browser of a language is shown of a machine."""


@dataclass(slots=True)
class MachinePicture:
    """A machine's status, taken at a time (s UTC, the wall's), and what it is in each language that was asked for."""

    version: int
    status: GatewayStatus
    taken: float
    encoded: dict[str, bytes] = field(default_factory=dict)


class LiveStream:
    """Takes statuses and gives events (`text/event-stream`); all methods belong to the page's own loop.

    `places` are those for `most` who follow; who has one is told by its event to end. `listeners` counts those who
    follow: while there is none, nobody need take a picture.
    """

    def __init__(self, show: Show, most: int) -> None:
        self._show = show
        self.places: SharedPlaces[asyncio.Event] = SharedPlaces(most, asyncio.Event.set)
        self._pictures: dict[str, MachinePicture] = {}
        self._order: tuple[str, ...] = ()
        self._version = 0
        self._changed = asyncio.Event()
        self.listeners = 0
        self.closed = False

    def take(self, statuses: Mapping[str, GatewayStatus], order: Sequence[str], taken: float) -> None:
        """Take the statuses of some machines; `order` names all that there are."""
        for name, status in statuses.items():
            self._version += 1
            self._pictures[name] = MachinePicture(self._version, status, taken)
        for gone in [name for name in self._pictures if name not in order]:
            del self._pictures[gone]
        self._order = tuple(order)
        self._tell()

    def close(self) -> None:
        """End all that follow."""
        self.closed = True
        self._tell()

    def _tell(self) -> None:
        changed, self._changed = self._changed, asyncio.Event()
        changed.set()

    async def follow(self, language: str) -> AsyncIterator[bytes]:
        """One event after the other, each with the machines of which there is a newer picture than the last sent."""
        seen = 0
        if not self.listeners:
            # Nobody has listened, so that no picture was taken for a while: what is left of them is not of now.
            self._pictures.clear()
            self._order = ()
        self.listeners += 1
        try:
            while not self.closed:
                changed = self._changed
                newer = [name for name in self._order if self._pictures[name].version > seen]
                if newer:
                    seen = max(self._pictures[name].version for name in newer)
                    yield self._event(language, newer)
                await changed.wait()
        finally:
            self.listeners -= 1

    def _event(self, language: str, names: Sequence[str]) -> bytes:
        parts = []
        for name in names:
            picture = self._pictures[name]
            if language not in picture.encoded:
                shown = {"taken": picture.taken, **self._show(language, picture.status)}
                picture.encoded[language] = f"{json_text(name)}:{json_text(shown)}".encode()
            parts.append(picture.encoded[language])
        head = f'data: {{"order":{json_text(self._order)},"machines":{{'.encode()
        return head + b",".join(parts) + b"}}\n\n"

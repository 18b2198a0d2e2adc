"""An event loop whose time is virtual and whose network is memory: no socket, no thread, the same on every machine.

A peer is what a place (host and port) leads to. What it sends on a connection leaves frame by frame, in the order in
which each became due, in the pieces that it says; nothing is interleaved, as TCP interleaves nothing.
"""

import asyncio
import selectors
from collections.abc import Callable, Iterable
from typing import Any, Protocol

Piece = tuple[float, bytes]
"""Seconds after the piece before, and what comes then."""


class Peer(Protocol):
    """The far end of all connections to one place."""

    def connected(self, connection: "MemoryTransport") -> None: ...

    def heard(self, connection: "MemoryTransport", data: bytes) -> None: ...


class _NothingReady(selectors.SelectSelector):
    """Waits for no time to pass: `now` (s) goes on at once to what is due next."""

    now = 0.0

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        if timeout is None:
            raise RuntimeError("nothing is due any more, and somebody waits")
        self.now += max(0.0, timeout)
        return []


class MemoryLoop(asyncio.SelectorEventLoop):
    """`peer` is who answers on every place; None: connections are refused."""

    def __init__(self) -> None:
        self._nothing = _NothingReady()
        super().__init__(self._nothing)
        self.peer: Peer | None = None
        self.connect_s: Callable[[], float] = lambda: 0.001

    def time(self) -> float:
        """Virtual seconds since the loop was made."""
        return self._nothing.now

    async def create_connection(  # type: ignore[override]
        self, protocol_factory: Callable[[], asyncio.Protocol], *_place: Any, **_options: Any
    ) -> tuple[asyncio.Transport, asyncio.Protocol]:
        """A connection to the peer, whatever the place; TLS is left out: its byte stream is TCP's."""
        await asyncio.sleep(self.connect_s())
        if self.peer is None:
            raise ConnectionRefusedError(111, "Connection refused")
        protocol = protocol_factory()
        transport = MemoryTransport(self, protocol, self.peer)
        protocol.connection_made(transport)
        self.peer.connected(transport)
        return transport, protocol


class MemoryTransport(asyncio.Transport):
    """One connection: the driver's end writes, the peer's `send`s."""

    def __init__(self, loop: MemoryLoop, protocol: asyncio.Protocol, peer: Peer) -> None:
        super().__init__()
        self._loop, self._protocol, self._peer = loop, protocol, peer
        self._closed = False
        self._free_at = 0.0

    # ------------------------------------------------------------ the driver's end

    def write(self, data: Any) -> None:
        """Bytes to the peer."""
        if not self._closed:
            self._loop.call_soon(self._peer.heard, self, bytes(data))

    def close(self) -> None:
        """Nothing comes any more."""
        self._closed = True

    def abort(self) -> None:
        """As `close`."""
        self.close()

    def is_closing(self) -> bool:
        """True once it is closed, by either end."""
        return self._closed

    # ------------------------------------------------------------ the peer's end

    def send(self, pieces: Iterable[Piece]) -> None:
        """Bytes to the driver, from now on, or after what is still on its way."""
        at = max(self._loop.time(), self._free_at)
        for after, data in pieces:
            at += after
            self._loop.call_at(at, self._deliver, data)
        self._free_at = at

    def hang_up(self) -> None:
        """The peer closes, after what is still on its way."""
        self._loop.call_at(max(self._loop.time(), self._free_at), self._lost)

    def _deliver(self, data: bytes) -> None:
        if not self._closed:
            self._protocol.data_received(data)

    def _lost(self) -> None:
        if not self._closed:
            self._closed = True
            self._protocol.connection_lost(None)

"""A listening socket whose connections are bounded where they are accepted, before TLS or a request takes time."""

from __future__ import annotations

import socket
from typing import Any

from gateway.network.shares import SharedPlaces


class SharingListener(socket.socket):
    """Accepts at most `most` connections at a time, of which no address takes those that another wants."""

    places: SharedPlaces[socket.socket]

    def limit_connections(self, most: int) -> None:
        """Bound the connections; before the first is accepted."""
        self.places = SharedPlaces(most, _end)

    def bind_address(self, address: Any, backlog: int) -> None:
        """Take an address, also one that a program before this has just left. Raises OSError."""
        self.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self.bind(address)
        self.listen(backlog)

    def accept(self) -> tuple[socket.socket, Any]:
        """The next connection. Raises BlockingIOError where none waits, or where that one has no place.

        So whoever connects without end keeps no event loop here: others have their turn before the next is looked at.
        """
        connection, address = super().accept()
        for other in self.places.holders:
            if other.fileno() < 0:  # closed by whoever served it
                self.places.release(other)
        if self.places.take(connection, str(address[0])):
            return connection, address
        connection.close()
        raise BlockingIOError("there is no place for it")


def _end(connection: socket.socket) -> None:
    """Have whoever serves a connection see its end: the socket is that one's to close."""
    try:
        connection.shutdown(socket.SHUT_RDWR)
    except OSError:  # it has ended by itself
        return

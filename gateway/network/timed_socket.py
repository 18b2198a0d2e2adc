"""Sockets whose waits end at one deadline in all, and whose peers can send so much and no more.

The time-out of a socket is that of a single operation: a peer that sends a byte now and then holds for ever whoever
reads a line from it. Here each operation may take what is left until the deadline.
"""

import socket
import threading
from collections.abc import Callable
from ipaddress import ip_address
from math import inf
from time import monotonic
from typing import Any, Self, TypeVar

T = TypeVar("T")


def remaining_seconds(end: float) -> float:
    """Seconds until `end` (monotonic s), infinite for none. Raises TimeoutError once it has passed."""
    left = end - monotonic()
    if left <= 0:
        raise TimeoutError("no answer in time")
    return left


class TimedSocket(socket.socket):
    """A connection whose operations raise TimeoutError once `end` (monotonic s) has passed; infinite: as any socket.

    More than `room` bytes are not received: then OSError is raised.
    """

    end = inf
    room: float = inf

    def limit(self) -> Self:
        """Give the next operation what is left of the time."""
        if self.end < inf:
            self.settimeout(remaining_seconds(self.end))
        return self

    def connect(self, address: Any) -> None:
        """As a socket's, within the time."""
        self.limit()
        super().connect(address)

    def recv(self, *given: Any) -> bytes:
        """As a socket's, within the time and the room."""
        self.limit()
        data = super().recv(*given)
        self._count(len(data))
        return data

    def recv_into(self, *given: Any) -> int:
        """As a socket's, within the time and the room."""
        self.limit()
        count = super().recv_into(*given)
        self._count(count)
        return count

    def send(self, *given: Any) -> int:
        """As a socket's, within the time."""
        self.limit()
        return super().send(*given)

    def sendall(self, *given: Any) -> None:
        """As a socket's, within the time."""
        self.limit()
        super().sendall(*given)

    def _count(self, received: int) -> None:
        self.room -= received
        if self.room < 0:
            raise OSError(0, "it sends more than any answer has")


def call_with_deadline(end: float, ask: Callable[[], T]) -> T:
    """What a call gives that has no deadline of its own, as the system's resolver. Raises TimeoutError, or as it does.

    A call that is late is left to end by itself: nobody looks at what it gives.
    """
    seconds = remaining_seconds(end)
    answers: list[T] = []
    errors: list[OSError | ValueError] = []

    def run() -> None:
        try:
            answers.append(ask())
        except (OSError, ValueError) as error:
            errors.append(error)

    thread = threading.Thread(target=run, name="resolver", daemon=True)
    thread.start()
    thread.join(seconds)
    if answers:
        return answers[0]
    raise errors[0] if errors else TimeoutError("the name is not found in time")


def resolve_host(host: str, port: int, end: float) -> list[tuple[Any, ...]]:
    """What `getaddrinfo` says of a TCP port. Raises OSError: TimeoutError at the deadline; UnicodeError for no name."""

    def ask(flags: int = 0) -> list[tuple[Any, ...]]:
        return list(socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=flags))

    try:
        ip_address(host)
    except ValueError:
        return call_with_deadline(end, ask)
    return ask(socket.AI_NUMERICHOST)  # nobody has to be asked


def connect(host: str, port: int, end: float) -> TimedSocket:
    """A TCP connection to the first address that takes it until `end` (monotonic s). Raises OSError, UnicodeError."""
    failure = OSError(0, f"{host} has no address")
    for family, kind, protocol, _, address in resolve_host(host, port, end):
        line = TimedSocket(family, kind, protocol)
        line.end = end
        try:
            line.connect(address)
            line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        except OSError as error:
            line.close()
            failure = error
        else:
            return line
    raise failure

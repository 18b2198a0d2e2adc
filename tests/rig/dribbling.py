"""A peer that answers a byte now and then and never to an end, as a hanging proxy does."""

import socket
import ssl
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field

PAUSE_S = 0.02
"""Seconds between two bytes: far less than any time-out of a single operation."""


@dataclass
class Dribbler:
    """Listens at `port`; counts the connections that it has taken and those that the other side has ended."""

    port: int
    taken: int = 0
    ended: int = 0
    over: threading.Event = field(default_factory=threading.Event)


@contextmanager
def dribbling(
    begin: bytes, endless: bytes, tls: ssl.SSLContext | None = None, answers: Sequence[bytes] = ()
) -> Iterator[Dribbler]:
    """A server that says `begin` to whoever connects, and then the bytes of `endless` over and over, one at a time.

    With `tls` it does so inside an encrypted connection. Before the endless part it is asked for each of `answers`.
    """
    threads: list[threading.Thread] = []
    with socket.create_server(("127.0.0.1", 0)) as listener:
        seen = Dribbler(listener.getsockname()[1])

        def talk(raw: socket.socket) -> None:
            with suppress(OSError), raw if tls is None else tls.wrap_socket(raw, server_side=True) as line:
                line.sendall(begin)
                for answer in answers:
                    line.recv(4096)
                    line.sendall(answer)
                place = 0
                while not seen.over.wait(PAUSE_S):
                    line.sendall(endless[place % len(endless) : place % len(endless) + 1])
                    place += 1
            seen.ended += 1

        def accept() -> None:
            with suppress(OSError):
                while not seen.over.is_set():
                    line = listener.accept()[0]
                    seen.taken += 1
                    threads.append(threading.Thread(target=talk, args=(line,), daemon=True))
                    threads[-1].start()

        accepting = threading.Thread(target=accept, daemon=True)
        accepting.start()
        try:
            yield seen
        finally:
            seen.over.set()
            with suppress(OSError):
                listener.shutdown(socket.SHUT_RDWR)
            for thread in (accepting, *threads):
                thread.join(30.0)

"""A CAN bus between processes: every frame that one client of a Unix socket sends reaches all the others.

For machines whose kernel has no CAN, and for tests. The frames are the kernel's own `struct can_frame` (16 bytes) and
`struct canfd_frame` (72 bytes), one a packet, so the order of a sender is kept. A frame is kept for a client that is
behind only as long as its queue has room; then its newest frames are dropped and counted, and it is told by an error
frame ("receive buffer overflow", as a controller tells), while all the others go on. What a wire does and a hub does
not: priorities, bit timing, collisions.

    python -m drivers.can.hub PATH [--queue FRAMES] [--stdin]
"""

import argparse
import json
import os
import selectors
import signal
import socket
import struct
import sys
import threading
from collections import deque
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType

FRAME_SIZES = frozenset({16, 72})
QUEUE = 4096
_BURST = 64
_MODE = 0o660  # who may join may say anything to the plant: the owner and the group
# linux/can/error.h: error frame, class "controller", "receive buffer overflow".
_OVERFLOW = struct.pack("=IB3x8s", 0x20000000 | 0x04, 8, b"\0\x01\0\0\0\0\0\0")


@dataclass(slots=True, eq=False)
class _Client:
    """One connection, the packets that it has not taken yet, and how many were dropped since it was told so."""

    sock: socket.socket
    waiting: deque[bytes] = field(default_factory=deque)
    untold: int = 0


class Hub:
    """The bus: listens at `path` from the start on, forwards while `run` runs. Use as a context manager in a program.

    Raises OSError if the path is in use by a living hub or cannot be made. `queue` is the number of frames kept for
    each client that is behind, beyond what the kernel's buffer holds.
    """

    def __init__(self, path: str | Path, *, queue: int = QUEUE) -> None:
        self._path = Path(path)
        self._queue = queue
        self._clients: dict[int, _Client] = {}
        self._counts = dict.fromkeys(("frames", "delivered", "dropped", "malformed", "joined", "left"), 0)
        self._selector = selectors.DefaultSelector()
        self._stopped = False
        self._thread: threading.Thread | None = None
        self._listener = _listen(self._path)
        self._wake_read, self._wake_write = os.pipe()
        self._selector.register(self._listener, selectors.EVENT_READ)
        self._selector.register(self._wake_read, selectors.EVENT_READ)

    def __enter__(self) -> "Hub":
        self._thread = threading.Thread(target=self.run, name="can hub", daemon=True)
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()
        if self._thread is not None:
            self._thread.join()

    def stop(self) -> None:
        """End `run`; the clients see the interface go down. From any thread, or a signal handler."""
        if not self._stopped:
            self._stopped = True
            os.write(self._wake_write, b"\0")

    def statistics(self) -> Mapping[str, float]:
        """Frames taken, copies delivered, copies dropped for clients that were behind, packets that were no frame."""
        return {**self._counts, "clients": len(self._clients)}

    def run(self) -> None:
        """Forward frames until `stop`."""
        try:
            while True:
                for key, mask in self._selector.select():
                    # `stop` has written to the pipe, and does not touch it any more.
                    if key.fd == self._wake_read:
                        return
                    self._serve(key.fd, mask)
        finally:
            self._stopped = True
            self._close()

    def _serve(self, fd: int, mask: int) -> None:
        if fd == self._listener.fileno():
            self._accept()
        elif fd in self._clients:
            client = self._clients[fd]
            if mask & selectors.EVENT_WRITE:
                self._catch_up(client)
            if mask & selectors.EVENT_READ and fd in self._clients:
                self._take(client)

    def _accept(self) -> None:
        try:
            sock, _ = self._listener.accept()
        except OSError:
            return
        sock.setblocking(False)
        self._clients[sock.fileno()] = _Client(sock)
        self._selector.register(sock, selectors.EVENT_READ)
        self._counts["joined"] += 1

    def _take(self, sender: _Client) -> None:
        """A burst of the sender's frames, to all the others; then it is the next sender's turn."""
        for _ in range(_BURST):
            try:
                packet = sender.sock.recv(128)
            except BlockingIOError:
                return
            except OSError:
                packet = b""
            if not packet:
                self._part(sender)
                return
            if len(packet) not in FRAME_SIZES:
                self._counts["malformed"] += 1
                continue
            self._counts["frames"] += 1
            for client in list(self._clients.values()):
                if client is not sender:
                    self._give(client, packet)

    def _give(self, client: _Client, packet: bytes) -> None:
        if not client.waiting and not client.untold:
            if self._send(client, packet):
                return
            if client.sock.fileno() < 0:
                return
            self._selector.modify(client.sock, selectors.EVENT_READ | selectors.EVENT_WRITE)
        if client.untold or len(client.waiting) >= self._queue:
            client.untold += 1
            self._counts["dropped"] += 1
        else:
            client.waiting.append(packet)

    def _catch_up(self, client: _Client) -> None:
        """What waits for a client that can take something again, and then the news that some was lost."""
        while client.waiting:
            if not self._send(client, client.waiting[0]):
                return
            client.waiting.popleft()
        if client.untold:
            if not self._send(client, _OVERFLOW):
                return
            client.untold = 0
        self._selector.modify(client.sock, selectors.EVENT_READ)

    def _send(self, client: _Client, packet: bytes) -> bool:
        """True if the kernel took the packet; a client that is gone is let go."""
        try:
            client.sock.send(packet)
        except BlockingIOError:
            return False
        except OSError:
            self._part(client)
            return False
        self._counts["delivered"] += 1
        return True

    def _part(self, client: _Client) -> None:
        if client.sock.fileno() < 0:
            return
        del self._clients[client.sock.fileno()]
        self._selector.unregister(client.sock)
        client.sock.close()
        self._counts["left"] += 1

    def _close(self) -> None:
        for client in list(self._clients.values()):
            self._part(client)
        self._selector.close()
        self._listener.close()
        self._path.unlink(missing_ok=True)
        os.close(self._wake_read)
        os.close(self._wake_write)


def _listen(path: Path) -> socket.socket:
    """The listening socket; a path that a dead hub has left behind is taken over."""
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    try:
        if path.is_socket() and _is_dead(path):
            path.unlink()
        listener.bind(str(path))
        path.chmod(_MODE)
        listener.listen(64)
    except OSError as error:
        listener.close()
        raise OSError(error.errno, f"no CAN hub at {path}: {error.strerror or error}") from None
    listener.setblocking(False)
    return listener


def _is_dead(path: Path) -> bool:
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as probe:
        try:
            probe.connect(str(path))
        except ConnectionRefusedError:
            return True
    return False


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a hub until SIGINT or SIGTERM; say on the first line that it is ready, on the last what it has carried."""
    parser = argparse.ArgumentParser(prog="python -m drivers.can.hub", description="A CAN bus between processes.")
    parser.add_argument("path", help="Unix socket; python-can programs join with interface='hub', channel=PATH")
    parser.add_argument("--queue", type=int, default=QUEUE, help=f"frames kept for a client behind ({QUEUE})")
    parser.add_argument("--stdin", action="store_true", help="end when standard input ends")
    options = parser.parse_args(arguments)
    if options.queue < 1:
        parser.error("--queue must be at least 1")
    try:
        hub = Hub(options.path, queue=options.queue)
    except OSError as error:
        sys.stderr.write(f"{error.strerror}\n")
        return 1
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: hub.stop())
    if options.stdin:
        threading.Thread(target=_stop_at_end_of_input, args=(hub,), daemon=True).start()
    _say(event="ready", path=options.path)
    hub.run()
    _say(event="stopped", **hub.statistics())
    return 0


def _stop_at_end_of_input(hub: Hub) -> None:
    while os.read(sys.stdin.fileno(), 4096):
        pass
    hub.stop()


def _say(**words: object) -> None:
    # Whoever started the hub may have gone before its last word.
    with suppress(OSError):
        os.write(sys.stdout.fileno(), (json.dumps(words) + "\n").encode())


if __name__ == "__main__":
    raise SystemExit(main())

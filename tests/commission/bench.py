"""What the tests of `decanter plc` share: a run with records of its own, and servers that are no PLC."""

import json
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from click.testing import Result

from tests.cli.support import decanter
from tests.plc.bench import Process, wait_until

Handler = Callable[[socket.socket], None]


def plc(folder: Path, *arguments: object) -> Result:
    """One `decanter plc` command that keeps its records in `folder`; the group comes first, the options after."""
    words = [str(argument) for argument in arguments]
    return decanter("plc", *words, "--records", folder / "records.jsonl", "--by", "the engineer")


def answer(folder: Path, *arguments: object) -> dict[str, Any]:
    """The JSON object that a command gives, whatever its exit code."""
    result = plc(folder, *arguments, "--json")
    data: dict[str, Any] = json.loads(result.stdout.splitlines()[0])
    assert data["exit"] == result.exit_code, result.output
    return data


def at(process: Process) -> tuple[str, ...]:
    """The options that name a running PLC."""
    return "--host", f"127.0.0.1:{process.port}"


def force(process: Process, tag: str, value: object) -> None:
    """Hold a tag at a value, and wait until the PLC's program has put it into its memory."""
    before = process.order("status")["version"]
    assert process.order("force", tag=tag, value=value)["ok"]
    wait_until(lambda: process.order("status")["version"] > before + 2)


def free_port() -> int:
    """A port that nobody listens on."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        return int(server.getsockname()[1])


@contextmanager
def server(handle: Handler) -> Iterator[int]:
    """A TCP server of one thread a connection; gives its port."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        connections: list[socket.socket] = []

        def serve() -> None:
            with suppress(OSError):
                while True:
                    connection, _ = listener.accept()
                    connections.append(connection)
                    threading.Thread(target=handled, args=(connection,), daemon=True).start()

        def handled(connection: socket.socket) -> None:
            with suppress(OSError):
                handle(connection)

        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        try:
            yield listener.getsockname()[1]
        finally:
            with suppress(OSError):
                listener.shutdown(socket.SHUT_RDWR)
            for connection in connections:
                connection.close()
            thread.join(60.0)


def ssh(connection: socket.socket) -> None:
    connection.sendall(b"SSH-2.0-OpenSSH_9.2p1 Debian\r\n")
    connection.recv(1024)


def web(connection: socket.socket) -> None:
    data = b""
    while b"\r\n\r\n" not in data:
        part = connection.recv(1024)
        if not part:
            return
        data += part
    connection.sendall(b"HTTP/1.0 404 Not Found\r\n\r\n")


def tls(connection: socket.socket) -> None:
    connection.recv(1024)
    connection.sendall(b"\x15\x03\x03\x00\x02\x02\x0a")


def silent(connection: socket.socket) -> None:
    while connection.recv(1024):
        pass


def closes(connection: socket.socket) -> None:
    connection.close()

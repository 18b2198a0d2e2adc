"""Requests that mean no good, over real sockets: they cost the page little and the gateway nothing."""

import asyncio
import json
import socket
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

import gateway.outside.web.server as page_server
from gateway.machine.reading import plant_clock
from gateway.outside.web.access import AccountRole
from gateway.plant.app import run
from tests.gateway.support import Bench, config_in, logged
from tests.page.served import PAGE, Client, Served, eventually, served

MOST = 4


@pytest.fixture(scope="module")
def gateway(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(page_server, "IDLE_S", 1.0)
        text = PAGE.replace("port = 0", f"port = 0\nmost_clients = {MOST}")
        with served(tmp_path_factory.mktemp("page"), text, {"olga": AccountRole.OPERATOR}) as running:
            yield running


def sent(gateway: Served, data: bytes, seconds: float = 60.0) -> bytes:
    """All that comes back to some bytes, until the server ends the connection."""
    with socket.create_connection(("127.0.0.1", gateway.port), seconds) as client:
        client.sendall(data)
        answered = b""
        while part := client.recv(65536):
            answered += part
    return answered


def scans(gateway: Served) -> int:
    found: int = Client(gateway.port).ask("GET", "/api/plant")[1]["machines"]["decanter"]["status"]["scan"]["count"]
    return found


@pytest.mark.parametrize(
    "path",
    [
        "/static/../server.py",
        "/static/..%2f..%2fserver.py",
        "/static/%2e%2e/%2e%2e/server.py",
        "/static//etc/passwd",
        "/static/..\\server.py",
        "/static/page.js%00.css",
        "/users.json",
        "/static/",
    ],
)
def test_no_path_leads_out_of_the_pages_own_files(gateway: Served, path: str) -> None:
    head = f"GET {path} HTTP/1.1\r\nhost: localhost\r\nconnection: close\r\n\r\n".encode()
    answered = sent(gateway, head)
    assert answered.startswith((b"HTTP/1.1 404", b"HTTP/1.1 400")) and b"class PageServer" not in answered


@pytest.mark.parametrize(
    "data",
    [
        b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc",
        b"GET\r\n\r\n",
        b"GET / HTTP/9.9\r\n\r\n",
        b"GET / HTTP/1.1\r\n" + b"a: b\r\n" * 20_000,
        b"GET /" + b"a" * 100_000,
        b"POST /api/session HTTP/1.1\r\nhost: localhost\r\ncontent-length: -1\r\n\r\n",
        b"POST /api/session HTTP/1.1\r\nhost: localhost\r\ncontent-length: 5\r\n"
        b"transfer-encoding: chunked\r\n\r\n0\r\n\r\n",
        b"GET / HTTP/1.1\r\nhost: localhost\r\nhost: evil\r\n\r\n",
    ],
    ids=["TLS", "no version", "another version", "heads", "long", "negative", "two lengths", "two hosts"],
)
def test_what_is_no_http_is_refused_and_the_connection_ended(gateway: Served, data: bytes) -> None:
    try:
        answered = sent(gateway, data)
    except (ConnectionResetError, BrokenPipeError):
        answered = b""
    assert answered == b"" or answered.startswith((b"HTTP/1.1 400", b"HTTP/1.1 4", b"HTTP/1.1 505"))
    assert scans(gateway) >= 0, "the next one is answered"


@pytest.mark.parametrize(
    ("body", "status"),
    [
        (b"x" * 9000, 413),
        (b"[" * 4000, 400),
        (b"{", 400),
        (b"[]", 400),
        (b"\xff\xfe", 400),
        (b'{"name": "olga", "password": NaN}', 400),
        (b'{"name": 7, "password": "p"}', 422),
        (b'{"name": "olga", "password": "p", "role": "administrator"}', 422),
        (b'{"name": "' + b"o" * 70 + b'", "password": "p"}', 422),
        (b'{"name": "olga\\ud800", "password": "p\\ud800"}', 400),
    ],
)
def test_a_body_that_cannot_be_used_is_one_sentence(gateway: Served, body: bytes, status: int) -> None:
    answered = Client(gateway.port).raw("POST", "/api/session", body)
    assert answered[0] == status
    assert "\n" not in json.loads(answered[2])["reason"]


def test_other_methods_and_long_queries_are_refused(gateway: Served) -> None:
    client = Client(gateway.port)
    assert client.raw("PUT", "/api/plant")[0] == 405
    assert client.raw("POST", "/api/plant")[0] == 405
    assert client.raw("TRACE", "/")[0] == 405
    assert client.ask("GET", f"/api/machine?machine={'m' * 3000}")[0] == 414


def test_whoever_sends_or_takes_nothing_is_let_go_and_too_many_are_not_let_in(gateway: Served) -> None:
    slow = [socket.create_connection(("127.0.0.1", gateway.port), 60.0) for _ in range(2 * MOST + 40)]
    try:
        for place, client in enumerate(slow):
            with suppress(OSError):  # one too many
                client.sendall(b"GET / HT" if place % 2 else b"")
        eventually(lambda: _serves(gateway))
        # All of them are ended by the server: the last ones at once, the others when their time is over.
        for client in slow:
            client.settimeout(120.0)
            with suppress(ConnectionResetError):
                assert client.recv(100) == b""
    finally:
        for client in slow:
            client.close()


def _serves(gateway: Served) -> bool:
    try:
        return scans(gateway) >= 0
    except OSError:
        return False


def test_a_stream_too_many_is_refused_and_those_that_follow_go_on(gateway: Served) -> None:
    head = b"GET /api/live HTTP/1.1\r\nhost: localhost\r\n\r\n"
    followers = [socket.create_connection(("127.0.0.1", gateway.port), 60.0) for _ in range(MOST)]
    try:
        for follower in followers:
            follower.sendall(head)
            assert follower.recv(65536).startswith(b"HTTP/1.1 200")
        eventually(lambda: Client(gateway.port).raw("GET", "/api/live")[0] == 503)
        for follower in followers:
            assert b"data: " in _until(follower, b"data: ")
    finally:
        for follower in followers:
            follower.close()
    eventually(lambda: _follows(gateway, head))


def _until(client: socket.socket, word: bytes) -> bytes:
    heard = b""
    while word not in heard:
        part = client.recv(65536)
        assert part
        heard += part
    return heard


def _follows(gateway: Served, head: bytes) -> bool:
    with socket.create_connection(("127.0.0.1", gateway.port), 60.0) as client:
        client.sendall(head)
        return client.recv(65536).startswith(b"HTTP/1.1 200")


def test_while_all_that_goes_on_no_scan_is_missed_by_more_than_a_busy_computer_misses(gateway: Served) -> None:
    status = Client(gateway.port).ask("GET", "/api/plant")[1]["machines"]["decanter"]["status"]
    assert status["failures"] == 0 and not status["scan"]["late"]
    assert all(not part["failure"] for part in status["parts"].values())


def test_a_port_that_is_taken_is_said_in_one_sentence_and_stops_no_scan(tmp_path: Path) -> None:

    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        config = config_in(tmp_path, f"[page]\nenabled = true\nport = {port}\n[scan]\nperiod = 0.05\n")

        async def main() -> dict[str, object]:
            clock = plant_clock(1.0)
            bench = Bench(config, clock, stop_after=15)  # type: ignore[arg-type]
            return await asyncio.wait_for(run(config, clock=clock, driver=bench, stop=bench.stop), 120.0)

        last = asyncio.run(main())
    assert last["scan"]["count"] >= 14  # type: ignore[index]
    reasons = [line["reason"] for line in logged(tmp_path) if line["event"].startswith("a part of the gateway failed")]
    assert reasons and f"127.0.0.1:{port} cannot be served: address already in use" in reasons[0]

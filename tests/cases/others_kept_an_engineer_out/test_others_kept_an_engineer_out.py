"""Whoever reached the page could keep an engineer out, who may need it to disarm.

Wrong passwords of one address locked an account for all others; one address took all connections, or all places of the
live stream; and in a burst more streams were let in than there are places.
"""

import asyncio
import socket
import threading
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass

import pytest

from gateway.outside.northbound.metrics_server import MOST_REQUESTS, MetricsServer
from gateway.outside.serving import PeerServer
from gateway.outside.web.access import AccountRole, Lockout
from gateway.settings import MetricsSection
from tests.page.served import PAGE, Client, Served, eventually, served
from tests.rig.servers import free_port

STRANGER, AT_HOME = "127.0.0.9", "127.0.0.2"
MOST = 4
DAY_S = 86_400.0


@dataclass
class Hand:
    """A clock that is set by hand."""

    time: float = 1000.0

    def __call__(self) -> float:
        return self.time


def attack(lockout: Lockout, clock: Hand, addresses: list[str], seconds: float = DAY_S) -> None:
    """Give a wrong password for the engineer from each address, as often as one is looked at."""
    until = clock.time + seconds
    while clock.time < until:
        for address in addresses:
            if lockout.wait("enzo", address) == 0.0:
                lockout.failed("enzo", address)
        clock.time += 1.0


def test_where_an_engineer_has_logged_in_he_is_not_locked_out_by_others() -> None:
    clock = Hand()
    lockout = Lockout(clock)
    lockout.note_success("enzo", AT_HOME)
    attack(lockout, clock, [f"10.0.0.{number}" for number in range(9)], seconds=2000.0)
    assert lockout.wait("enzo", AT_HOME) == 0.0 and lockout.wait("enzo", "10.0.0.1") > 0.0
    for number in range(30):  # nor by what others give at his own computer for other accounts
        lockout.failed(f"name {number}", AT_HOME)
    assert lockout.wait("enzo", AT_HOME) == 0.0 and lockout.wait("olga", AT_HOME) > 0.0
    for _ in range(5):
        lockout.failed("enzo", AT_HOME)
    assert lockout.wait("enzo", AT_HOME) == 30.0, "his own address guesses no better than another"


def test_one_stranger_locks_nobody_but_himself() -> None:
    clock = Hand()
    lockout = Lockout(clock)
    attack(lockout, clock, [STRANGER], seconds=4 * 3600.0)
    assert lockout.wait("enzo", STRANGER) > 0.0 and lockout.wait("enzo", AT_HOME) == 0.0


def test_many_strangers_guess_little() -> None:
    clock, tried = Hand(), 0
    lockout = Lockout(clock)
    while clock.time < DAY_S:
        for number in range(200):
            if lockout.wait("enzo", f"10.0.1.{number}") == 0.0:
                lockout.failed("enzo", f"10.0.1.{number}")
                tried += 1
        clock.time += 60.0
    assert tried < 200, "an account locks for strangers, however many they are"
    for number in range(1000):
        lockout.failed("enzo", f"2001:db8::{number:x}")
    assert lockout.wait("olga", "2001:db8::ffff") > 0.0, "all addresses of a network are one client"


@pytest.fixture(scope="module")
def gateway(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    text = PAGE.replace("enabled = true", f"enabled = true\nmost_clients = {MOST}")
    with served(tmp_path_factory.mktemp("page"), text, {"enzo": AccountRole.ENGINEER}) as running:
        yield running


def connected(gateway: Served, address: str) -> socket.socket:
    return socket.create_connection(("127.0.0.1", gateway.port), 120.0, source_address=(address, 0))


def test_who_has_logged_in_disarms_while_another_address_gives_wrong_passwords(gateway: Served) -> None:
    engineer, stranger = (Client(gateway.port, address=address) for address in (AT_HOME, STRANGER))
    assert engineer.log_in("enzo") == 200
    assert [stranger.log_in("enzo", "a wrong password") for _ in range(6)] == [401] * 5 + [429]
    again = Client(gateway.port, address=AT_HOME)
    assert again.log_in("enzo") == 200
    assert again.ask("POST", "/api/disarm", {"machine": "decanter", "reason": "test"})[0] == 200


def test_one_address_does_not_take_the_connections_of_another(gateway: Served) -> None:
    taken = list[socket.socket]()
    try:
        for _ in range(3 * (2 * MOST + 20)):
            with suppress(OSError):
                taken.append(connected(gateway, STRANGER))
        for _ in range(5):
            assert Client(gateway.port, address=AT_HOME).raw("GET", "/api/plant")[0] == 200
    finally:
        for each in taken:
            each.close()


def follower(gateway: Served, address: str) -> tuple[socket.socket, bytes]:
    """A browser that follows, and the head of what it is answered."""
    client = connected(gateway, address)
    client.sendall(b"GET /api/live HTTP/1.1\r\nhost: localhost\r\n\r\n")
    return client, client.recv(65536)


def test_one_address_does_not_take_the_streams_of_another(gateway: Served) -> None:
    taken = [follower(gateway, STRANGER) for _ in range(MOST)]
    own = [follower(gateway, AT_HOME) for _ in range(3)]
    try:
        assert [head[9:12] for _, head in taken] == [b"200"] * MOST
        assert [head[9:12] for _, head in own] == [b"200", b"200", b"503"], "they share alike"
    finally:
        for client, _ in (*taken, *own):
            client.close()
    eventually(lambda: follows_again(gateway))


def follows_again(gateway: Served) -> bool:
    client, head = follower(gateway, STRANGER)
    client.close()
    return head.startswith(b"HTTP/1.1 200")


@pytest.mark.parametrize("again", range(3))
def test_a_burst_of_streams_is_let_in_no_further_than_there_are_places(gateway: Served, again: int) -> None:
    eventually(lambda: follows_again(gateway))
    clients = [connected(gateway, f"127.0.1.{again}") for _ in range(2 * MOST + 18)]
    try:
        for client in clients:
            client.sendall(b"GET /api/live HTTP/1.1\r\nhost: localhost\r\n\r\n")
        heads = [client.recv(65536) for client in clients]
        assert sum(head.startswith(b"HTTP/1.1 200") for head in heads) <= MOST
        assert sum(head.startswith(b"HTTP/1.1 503") for head in heads) >= MOST
    finally:
        for client in clients:
            client.close()


async def test_one_address_does_not_take_the_places_of_a_peer() -> None:
    server = PeerServer("127.0.0.1", 0, {}, most_clients=3)
    serving = asyncio.create_task(server.serve())
    async with asyncio.timeout(120.0):
        while server.port == 0:
            await asyncio.sleep(0)
        taken = [await asyncio.open_connection("127.0.0.1", server.port) for _ in range(3)]
        request = bytes.fromhex("000100000006010300000001")
        for reader, writer in taken:
            writer.write(request)
            assert await reader.read(9)
        reader, writer = await asyncio.open_connection("127.0.0.1", server.port, local_addr=(AT_HOME, 0))
        writer.write(request)
        assert await reader.read(9), "another address is served"
        for _, other in (*taken, (reader, writer)):
            other.close()
    serving.cancel()
    await asyncio.gather(serving, return_exceptions=True)


async def test_one_address_does_not_take_the_connections_of_monitoring() -> None:
    port = free_port()
    server = MetricsServer(MetricsSection(port=port), dict, ())
    thread = threading.Thread(target=server.run)
    thread.start()
    taken = list[socket.socket]()

    def scraped() -> bytes:
        for _ in range(4 * MOST_REQUESTS):
            with suppress(OSError):
                taken.append(socket.create_connection(("127.0.0.1", port), 120.0, source_address=(STRANGER, 0)))
        with socket.create_connection(("127.0.0.1", port), 120.0, source_address=(AT_HOME, 0)) as client:
            client.sendall(b"GET /metrics HTTP/1.1\r\nhost: localhost\r\n\r\n")
            return client.recv(65536)

    def listens() -> bool:
        with suppress(OSError), socket.create_connection(("127.0.0.1", port), 120.0):
            return True
        return False

    try:
        await asyncio.to_thread(eventually, listens)
        assert (await asyncio.to_thread(scraped)).startswith(b"HTTP/1.1 200")
    finally:
        server.close()
        for client in taken:
            client.close()
        await asyncio.to_thread(thread.join, 300.0)
    assert not thread.is_alive()

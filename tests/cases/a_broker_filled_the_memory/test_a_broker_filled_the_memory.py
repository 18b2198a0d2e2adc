"""What a broker sends was kept whatever its size and number: 94 to 294 MB of the gateway's memory.

A packet is bounded at reception, and told so beforehand where the protocol has a word for it; what waits to be looked
at is bounded, and what is left out is counted.
"""

import socket
import struct
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial

import pytest

from gateway.outside.northbound import SinkUnreachable, mqtt
from gateway.outside.northbound.mqtt import (
    FLOOD_DELAY_SECONDS,
    MOST_PACKET_BYTES,
    MOST_RECEIVED,
    MOST_UNSENT,
    BrokerConnection,
)
from gateway.settings import MqttRow
from tests.rig.servers import until

LARGEST = b"\xff\xff\xff\x7f"
"""The largest length that MQTT can state: 268,435,455 bytes."""
TOPIC = "decanter/gateway/one/acknowledge"
MUCH = 1 << 24
"""Bytes: far more than a packet and the buffers of both sockets hold."""


class Peer:
    """A broker that lets in, agrees to a subscription, and then does what a test wants."""

    def __init__(self, version: str, work: "Callable[[Peer], None]") -> None:
        self.five, self.work = version == "5", work
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.asked, self.sent, self.done = b"", 0, threading.Event()
        self.thread = threading.Thread(target=self._serve, daemon=True)
        self.thread.start()

    def _serve(self) -> None:
        with suppress(OSError):
            self.line = self.listener.accept()[0]
            with self.line:
                self.asked = self.line.recv(65536)
                self.line.sendall(b"\x20\x03\0\0\0" if self.five else b"\x20\x02\0\0")
                number = self.line.recv(65536)[2:4]
                self.line.sendall(b"\x90\x04" + number + b"\0\x01" if self.five else b"\x90\x03" + number + b"\x01")
                self.work(self)
                self.done.set()
                while self.line.recv(65536):
                    pass
        self.done.set()

    def send(self, data: bytes) -> None:
        self.line.sendall(data)
        self.sent += len(data)

    def publish(self, topic: bytes, payload: bytes, number: int = 0, quality: int = 0) -> None:
        content = struct.pack(">H", len(topic)) + topic
        content += (struct.pack(">H", number) if quality else b"") + (b"\0" if self.five else b"") + payload
        self.send(bytes([0x30 | quality << 1, len(content)]) + content)


@contextmanager
def connected(version: str, work: Callable[[Peer], None]) -> Iterator[tuple[Peer, BrokerConnection]]:
    peer = Peer(version, work)
    port = peer.listener.getsockname()[1]
    row = MqttRow.model_validate(
        {"name": "m", "host": "127.0.0.1", "port": port, "tls": False, "payload": "json", "version": version}
    )
    connection = BrokerConnection(row, None)
    try:
        connection.open("x", b"offline", retain=False, subscribed=["decanter/gateway/+/acknowledge"])
        yield peer, connection
    finally:
        connection.close()
        peer.listener.close()
        peer.thread.join(30.0)


both = pytest.mark.parametrize("version", ["5", "3.1.1"])


def receive(connection: BrokerConnection, until_true: Callable[[], bool]) -> None:
    """Receive until it is so, and what is still under way."""
    connection.wait(until_true, 60.0)
    for _ in range(200):
        connection.turn(0.0)


@both
def test_a_packet_larger_than_any_command_ends_the_connection_before_it_is_kept(version: str) -> None:
    def flood(peer: Peer) -> None:
        peer.send(b"\x30" + LARGEST + struct.pack(">H", len(TOPIC)) + TOPIC.encode())
        while peer.sent < MUCH:
            peer.send(b"x" * 65536)

    with connected(version, flood) as (peer, connection):
        with pytest.raises(SinkUnreachable):
            receive(connection, peer.done.is_set)
        connection.close()
        until(peer.done.is_set)
        assert peer.sent < MUCH


def test_the_broker_is_told_beforehand_how_large_a_packet_may_be() -> None:
    with connected("5", lambda _: None) as (peer, _):
        assert b"\x27" + struct.pack(">I", MOST_PACKET_BYTES) in peer.asked


@both
def test_no_operation_of_an_open_connection_waits_by_itself(version: str) -> None:
    """paho reads until nothing is there: a read that waits for a slow packet would look at no deadline."""
    with connected(version, lambda _: None) as (_, connection):
        line = connection.client.socket()
        assert isinstance(line, socket.socket) and line.gettimeout() == 0.0


@both
def test_what_waits_to_be_looked_at_is_bounded_and_what_is_left_out_is_counted(version: str) -> None:
    def flood(peer: Peer) -> None:
        for number in range(5000):
            peer.publish(TOPIC.encode(), b"alarm %d" % number)

    with connected(version, flood) as (peer, connection):
        receive(connection, lambda: peer.done.is_set() and len(connection.received) + connection.dropped == 5000)
        assert len(connection.received) == MOST_RECEIVED and connection.received[0].payload == b"alarm 0"
        assert connection.dropped == 5000 - MOST_RECEIVED


@both
def test_what_nobody_asked_for_is_not_kept_whatever_its_topic(version: str) -> None:
    def send(peer: Peer) -> None:
        for topic in (b"x", b"a/b", b"\xff\xfe", b"decanter/gateway/one/two/acknowledge"):
            peer.publish(topic, b"alarm")
        peer.publish(TOPIC.encode(), b"alarm")

    with connected(version, send) as (_, connection):
        connection.wait(lambda: bool(connection.received), 60.0)
        assert [message.topic for message in connection.received] == [TOPIC] and connection.dropped == 4


@both
def test_a_broker_that_begins_exchanges_and_ends_none_is_left(version: str) -> None:
    """QoS 2: paho keeps each message until the broker releases it."""

    def begin(peer: Peer) -> None:
        for number in range(1, 1001):
            peer.publish(TOPIC.encode(), b"x", number, 2)

    with connected(version, begin) as (peer, connection), pytest.raises(SinkUnreachable):
        receive(connection, lambda: peer.done.is_set() and False)


def test_a_flood_is_read_no_faster_than_leaves_time_to_the_scans(monkeypatch: pytest.MonkeyPatch) -> None:
    """One that sent as fast as it could kept half a processor, and so the interpreter, busy with what was left out."""
    pauses = list[float]()
    monkeypatch.setattr(mqtt, "MOST_AT_ONCE", 50, raising=False)
    monkeypatch.setattr(mqtt, "sleep", pauses.append, raising=False)
    monkeypatch.setattr(mqtt._BoundedClient, "_spare", 50, raising=False)

    def flood(peer: Peer) -> None:
        for number in range(200):
            if number % 2:
                peer.send(b"\xd0\0")  # an answer to a ping that was never sent
            else:
                peer.publish(TOPIC.encode(), b"alarm")

    with connected("5", flood) as (peer, connection):
        receive(connection, lambda: peer.done.is_set() and len(pauses) >= 100)
        assert set(pauses) == {FLOOD_DELAY_SECONDS} and len(pauses) <= 200


@both
def test_what_the_broker_answers_is_read_at_once(version: str, monkeypatch: pytest.MonkeyPatch) -> None:
    pauses = list[float]()
    monkeypatch.setattr(mqtt, "MOST_AT_ONCE", 5)
    monkeypatch.setattr(mqtt, "sleep", pauses.append)
    monkeypatch.setattr(mqtt._BoundedClient, "_spare", 5)

    def acknowledge(peer: Peer) -> None:
        for number in range(2, 102):
            head = peer.line.recv(1)
            peer.line.recv(peer.line.recv(1)[0])
            assert head == b"\x32"
            peer.send(b"\x40\x02" + struct.pack(">H", number))

    with connected(version, acknowledge) as (_, connection):
        for _number in range(100):
            sent = connection.publish("x", b"row", qos=1)
            connection.wait(partial(connection.pop_answer, sent), 60.0)
    assert pauses == []


def test_a_broker_that_takes_no_answers_is_left() -> None:
    with connected("5", lambda _: None) as (_, connection):
        assert not connection.client.is_overfull
        connection.client._out_packet.extend([{}] * (MOST_UNSENT + 1))  # type: ignore[list-item]
        assert connection.client.is_overfull
        connection.client._out_packet.clear()

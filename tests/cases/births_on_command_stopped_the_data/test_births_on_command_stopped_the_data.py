"""One NCMD of 2.8 kB made 200 Sparkplug births, and fifty of them stopped all data for 45 s.

However often a birth is commanded, one waits, and none comes within some seconds of the one before.
"""

from collections import deque
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import pytest

from drivers.tag import Quality
from gateway.outside.northbound import mqtt
from gateway.outside.northbound.feed import OutgoingRow
from gateway.outside.northbound.mqtt import ACKNOWLEDGE, BIRTH_SECONDS, JsonSink, SparkplugSink
from gateway.outside.northbound.sparkplug import BOOLEAN, STRING, Payload
from gateway.settings import MqttRow
from gateway.store import FollowedRow, RowPosition, RowStream
from tests.gateway.support import EPOCH
from tests.northbound.rig import TAGS

STREAM = RowStream("one", "", "samples", 1)
ROW = FollowedRow(
    stream=STREAM, key=1, time=EPOCH, position=RowPosition(1, EPOCH),
    values={"tag": "T", "time": EPOCH, "value": 1.0, "quality": Quality.GOOD, "sent": None, "unit": ""},
)  # fmt: skip


class Broker:
    """Takes all that is published at once, and gives what a test puts into `received`."""

    def __init__(self) -> None:
        self.received: deque[Any] = deque()
        self.published: list[str] = []
        self.dropped = 0

    def open(self, *_: Any, **__: Any) -> None:
        return

    def publish(self, topic: str, *_: Any, **__: Any) -> int:
        self.published.append(topic.split("/")[2])
        return 1

    def confirm(self) -> None:
        return

    def turn(self, _: float) -> None:
        return

    def command(self, payload: Any, kind: str = "NCMD", device: Sequence[str] = ()) -> None:
        topic = "/".join(("spBv1.0", "decanter", kind, "gateway", *device))
        self.received.append(SimpleNamespace(topic=topic, payload=payload.SerializeToString(), retain=False))


def rebirths(count: int) -> Any:
    payload = Payload(timestamp=1)
    for _ in range(count):
        payload.metrics.add(name="Node Control/Rebirth", datatype=BOOLEAN, boolean_value=True)
    return payload


@pytest.fixture
def time(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The monotonic time, which stands until it is set."""
    now = [1000.0]
    monkeypatch.setattr(mqtt, "monotonic", lambda: now[0])
    return now


def a_sink(told: list[Any]) -> tuple[SparkplugSink, Broker]:
    row = MqttRow(name="m", host="127.0.0.1", tls=False, commands=True)
    sink = SparkplugSink(
        row, None, tags=lambda: {"one": TAGS}, now=lambda: EPOCH, acknowledge=lambda *words: told.append(words)
    )
    broker: Any = Broker()
    sink._broker = broker
    sink.open({"one": [ROW]})
    broker.published.clear()
    return sink, broker


def deliver(sink: SparkplugSink) -> None:
    assert list(sink.deliver([OutgoingRow(ROW, historical=False)])) == [1]


def test_one_message_makes_one_birth(time: list[float]) -> None:
    sink, broker = a_sink([])
    broker.command(rebirths(100))
    broker.command(rebirths(100))
    deliver(sink)
    assert broker.published == ["NBIRTH", "DBIRTH", "DDATA"], "the first is born at once"


def test_a_flood_of_commands_stops_no_data_and_the_last_of_them_is_obeyed(time: list[float]) -> None:
    sink, broker = a_sink([])
    for _ in range(60):
        for _ in range(50):
            broker.command(rebirths(100))
        deliver(sink)
        time[0] += 1.0
    assert broker.published.count("NBIRTH") == 60.0 / BIRTH_SECONDS and broker.published.count("DDATA") == 60
    broker.published.clear()
    deliver(sink)
    assert broker.published == ["NBIRTH", "DBIRTH", "DDATA"], "one birth waited"
    time[0] += 2 * BIRTH_SECONDS
    broker.published.clear()
    deliver(sink)
    assert broker.published == ["DDATA"], "and no other"


def test_what_is_commanded_while_one_waits_is_that_one(time: list[float]) -> None:
    sink, broker = a_sink([])
    broker.command(rebirths(1))
    deliver(sink)
    broker.published.clear()
    for _ in range(3):
        broker.command(rebirths(1))
        time[0] += BIRTH_SECONDS / 4
        deliver(sink)
    assert "NBIRTH" not in broker.published
    time[0] += BIRTH_SECONDS / 4
    deliver(sink)
    assert broker.published.count("NBIRTH") == 1


def test_an_alarm_named_a_hundred_times_is_acknowledged_once(time: list[float]) -> None:
    told: list[Any] = []
    sink, broker = a_sink(told)
    payload = Payload(timestamp=1)
    for number in range(100):
        payload.metrics.add(name=ACKNOWLEDGE, datatype=STRING, string_value="over limit T" if number else "link")
    broker.command(payload, "DCMD", ("one",))
    deliver(sink)
    assert told == [("one", ["link"], "mqtt m"), ("one", ["over limit T"], "mqtt m")]
    plain = JsonSink(sink._row, None, acknowledge=lambda *words: told.append(words))
    plain._broker = broker
    told.clear()
    for _ in range(100):
        topic = "decanter/gateway/one/acknowledge"
        broker.received.append(SimpleNamespace(topic=topic, payload=b"link", retain=False))
    plain._obey()
    assert told == [("one", ["link"], "mqtt m")]

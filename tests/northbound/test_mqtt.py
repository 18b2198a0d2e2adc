"""MQTT against mosquitto, over TLS: every row once and in its order over an outage; Sparkplug B as others read it."""

import json
import subprocess
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from paho.mqtt.client import Client, MQTTMessage
from paho.mqtt.enums import CallbackAPIVersion
from sparkplub_b_packets.core.sparkplug_b_pb2 import Payload

from gateway.network.certificates import make_all
from gateway.outside.northbound.mqtt import ACKNOWLEDGE, JsonSink, SparkplugSink
from gateway.settings import MqttRow
from tests.gateway.support import EPOCH
from tests.northbound.rig import MACHINES, TAGS, Plant
from tests.rig.servers import Line, free_port, program, running, until

MOSQUITTO = program("mosquitto")
pytestmark = pytest.mark.skipif(MOSQUITTO is None, reason="needs mosquitto (apt-get install mosquitto)")
TOPIC = "spBv1.0/plant/{}/box"


@dataclass
class Broker:
    folder: Path
    certificates: Path
    plain: int
    tls: int

    @property
    def command(self) -> list[str]:
        return [str(MOSQUITTO), "-c", str(self.folder / "mosquitto.conf")]


@pytest.fixture(scope="module")
def broker(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Broker]:
    """One listener over TLS that wants a password, and one for whoever listens in here."""
    folder = tmp_path_factory.mktemp("broker")
    certificates = make_all(folder / "certificates", hosts=["127.0.0.1"])
    here = Broker(folder, certificates, free_port(), free_port())
    passwords = program("mosquitto_passwd")
    assert passwords is not None
    subprocess.run(
        [passwords, "-c", "-b", str(folder / "users"), "gateway", "battery"], check=True, capture_output=True
    )
    (folder / "mosquitto.conf").write_text(
        f"user root\nper_listener_settings true\nlistener {here.plain} 127.0.0.1\nallow_anonymous true\n"
        f"listener {here.tls} 127.0.0.1\nallow_anonymous false\npassword_file {folder / 'users'}\n"
        f"certfile {certificates / 'server.pem'}\nkeyfile {certificates / 'server.key'}\n",
        encoding="utf-8",
    )
    with running(here.command, here.plain):
        yield here


class Listener:
    """Whoever listens in: every message in its order."""

    def __init__(self, broker: Broker) -> None:
        self.messages: list[MQTTMessage] = []
        self.client = Client(CallbackAPIVersion.VERSION2)
        self.client.on_message = lambda _client, _data, message: self.messages.append(message)
        subscribed: list[int] = []
        self.client.on_subscribe = lambda *_: subscribed.append(1)
        self.client.connect("127.0.0.1", broker.plain)
        self.client.loop_start()
        self.client.subscribe("#", qos=1)
        until(lambda: subscribed)

    def close(self) -> None:
        self.client.disconnect()
        self.client.loop_stop()

    def said(self, topic: str) -> list[bytes]:
        return [message.payload for message in list(self.messages) if message.topic == topic]

    def payloads(self, kind: str) -> list[tuple[str, Any]]:
        """(topic, payload) of Sparkplug's messages of a kind, read by the definition of Eclipse Tahu."""
        return [
            (message.topic, Payload.FromString(message.payload))
            for message in list(self.messages)
            if f"/{kind}/" in message.topic
        ]


@pytest.fixture
def listener(broker: Broker) -> Iterator[Listener]:
    one = Listener(broker)
    yield one
    # What a test has left at the broker would be heard by the next one, whatever became of it.
    one.client.publish(STATE, b"", qos=1, retain=True).wait_for_publish(60.0)
    one.close()


def until_born(listener: Listener) -> None:
    """Wait for the births of all machines: what a feed has delivered may still be on its way to who listens in."""
    until(lambda: {topic.rpartition("/")[2] for topic, _ in listener.payloads("DBIRTH")} == set(MACHINES))


def row_of(broker: Broker, port: int, **keys: Any) -> MqttRow:
    given = {"name": "scada", "host": "127.0.0.1", "port": port, "group": "plant", "node": "box", "user": "gateway"}
    return MqttRow.model_validate({**given, "ca": broker.certificates / "ca.pem", **keys})


def sparkplug(plant: Plant, broker: Broker, port: int, commands: list[Any] | None = None, **keys: Any) -> SparkplugSink:
    told: list[Any] = [] if commands is None else commands
    row = row_of(broker, port, commands=commands is not None, **keys)
    tags = dict.fromkeys(MACHINES, TAGS)
    return SparkplugSink(
        row, "battery", tags=lambda: tags, now=plant.now, acknowledge=lambda *words: told.append(words)
    )


class Host:
    """What a Sparkplug host makes of the messages: values by the births' names, and how the messages follow."""

    def __init__(self, listener: Listener) -> None:
        self.values: defaultdict[tuple[str, str], list[tuple[int, Any, bool]]] = defaultdict(list)
        self.births: list[int] = []
        names: dict[tuple[str, int], Any] = {}
        sequence, self.gaps = -1, 0
        for message in list(listener.messages):
            if "/STATE/" in message.topic:
                continue
            _, _, kind, _, *device = message.topic.split("/")
            payload = Payload.FromString(message.payload)
            machine = device[0] if device else ""
            if kind in ("NBIRTH", "DBIRTH", "DDATA"):
                sequence = -1 if kind == "NBIRTH" else sequence
                self.gaps += payload.seq != (sequence + 1) % 256
                sequence = payload.seq
            if kind == "NBIRTH":
                self.births.append(payload.metrics[0].long_value)
                names.clear()
            for metric in payload.metrics if kind in ("DBIRTH", "DDATA") else ():
                if kind == "DBIRTH":
                    names[machine, metric.alias] = metric
                else:
                    assert not metric.name
                    born = names[machine, metric.alias]
                    assert born.datatype == metric.datatype
                    kind_of_value = metric.WhichOneof("value")
                    value = None if metric.is_null else getattr(metric, kind_of_value)
                    self.values[machine, born.name].append((metric.timestamp, value, metric.is_historical))
        self.born = names


def test_every_row_reaches_a_sparkplug_host_once_in_order_and_marked_over_two_outages(
    plant: Plant, broker: Broker, listener: Listener
) -> None:
    """The line is cut for so long that rows are packed meanwhile; then the gateway itself is gone for a while."""
    line = Line(broker.tls)
    plant.scan(5)
    feed = plant.feed(sparkplug(plant, broker, line.port))
    until(lambda: feed.delivered == plant.count)
    for _ in range(5):
        plant.scan()
        until(lambda: feed.delivered == plant.count)
    before = plant.scans
    line.cut()
    plant.scan(150)
    until(lambda: "cannot be reached" in feed.reason)
    plant.scan(5)
    until(lambda: feed.waiting > 155 * 8 + 155 * 2)
    line.mend()
    until(lambda: feed.delivered == plant.count)
    assert feed.waiting == 0
    after = plant.scans
    plant.scan(3)
    until(lambda: feed.delivered == plant.count)
    feed.stop()
    feed.join()
    gone = plant.scans
    plant.scan(60)
    again = plant.feed(sparkplug(plant, broker, broker.tls, version="3.1.1"))
    until(lambda: feed.delivered + again.delivered == plant.count)
    again.stop()
    again.join()
    until(lambda: len(listener.payloads("NDEATH")) >= 3)

    host = Host(listener)
    assert host.gaps == 0 and feed.lost == again.lost == feed.refused == 0
    assert len(host.births) == len(set(host.births)) == 3
    deaths = [payload.metrics[0].long_value for _, payload in listener.payloads("NDEATH")]
    assert sorted(deaths) == sorted(host.births)
    marked = {True: [(0, 5), (before, after), (gone, plant.scans)], False: [(5, before), (after, gone)]}
    for machine in MACHINES:
        for tag in TAGS:
            kept = [values for one, _, values in plant.rows("samples") if (one, values["tag"]) == (machine, tag)]
            seen = host.values[machine, f"Measured/{tag}"]
            expected = [None if row["value"] is None else row["value"] for row in kept]
            assert [(time, value) for time, value, _ in seen] == [
                (round(1000 * row["time"]), value) for row, value in zip(kept, expected, strict=True)
            ]
            for historical, spans in marked.items():
                for begin, end in spans:
                    own = [flag for time, _, flag in seen if begin < time / 1000 - EPOCH <= end]
                    assert len(own) == end - begin and set(own) == {historical}
        predictions = [values for one, _, values in plant.rows("predictions") if one == machine]
        assert [value for _, value, _ in host.values[machine, "Predicted/T/mean"]] == [
            row["mean"] for row in predictions
        ]
        assert {value for _, value, _ in host.values[machine, "Forecast/T/60 s/q95"]} == {3.0}
        alarms = [row for one, _, row in plant.rows("alarms") if one == machine]
        assert len(host.values[machine, "Alarm/over limit T"]) == len(alarms) > 20
    born = {metric.name: metric for metric in host.born.values()}
    assert (
        dict(zip(born["Measured/T"].properties.keys, born["Measured/T"].properties.values, strict=True))[
            "engUnit"
        ].string_value
        == "degC"
    )
    assert (born["Measured/Run"].datatype, born["Measured/Recipe"].datatype) == (11, 12)


def test_a_host_can_ask_for_birth_again_and_acknowledge_and_nothing_else_does_anything(
    plant: Plant, broker: Broker, listener: Listener
) -> None:
    commands: list[Any] = []
    plant.scan(10)
    feed = plant.feed(sparkplug(plant, broker, broker.tls, commands))
    until(lambda: feed.delivered == plant.count)
    until_born(listener)
    births = len(listener.payloads("DBIRTH"))
    nonsense = [b"\xff\xff no payload", b"", b"\x12\x04\x0a\x02\xff\xfe", bytes(5000), b"\x12\xff\xff\xff\x7f"]
    for bad in nonsense:
        listener.client.publish(TOPIC.format("NCMD"), bad)
        listener.client.publish(f"{TOPIC.format('DCMD')}/two", bad)
    rebirth = Payload(timestamp=1)
    rebirth.metrics.add(name="Node Control/Rebirth", datatype=11, boolean_value=True)
    listener.client.publish(TOPIC.format("NCMD"), rebirth.SerializeToString())
    until(lambda: len(listener.payloads("NBIRTH")) == 2 and len(listener.payloads("DBIRTH")) == births + 2)
    assert len({payload.metrics[0].long_value for _, payload in listener.payloads("NBIRTH")}) == 1
    (_, again) = listener.payloads("DBIRTH")[-1]
    present = {metric.name: metric for metric in again.metrics}
    newest = [row for one, _, row in plant.rows("samples") if (one, row["tag"]) == ("two", "T")][-1]
    assert present["Measured/T"].timestamp == round(1000 * newest["time"]) and ACKNOWLEDGE in present
    command = Payload(timestamp=1)
    command.metrics.add(name=ACKNOWLEDGE, datatype=12, string_value="over limit T")
    command.metrics.add(name="Measured/T", datatype=10, double_value=1.0)
    listener.client.publish(f"{TOPIC.format('DCMD')}/two", command.SerializeToString())
    until(lambda: commands)
    assert commands == [("two", ["over limit T"], "mqtt scada")]


def test_a_gateway_that_is_gone_without_a_word_is_dead_to_the_host(
    plant: Plant, broker: Broker, listener: Listener
) -> None:
    sink = sparkplug(plant, broker, broker.tls)
    sink.open({})
    sink._broker.client.socket().close()  # type: ignore[union-attr]
    until(lambda: listener.payloads("NDEATH"))
    ((topic, death),) = listener.payloads("NDEATH")
    assert topic == TOPIC.format("NDEATH") and death.metrics[0].long_value == (int(plant.now()) + 1) % 256


STATE = "spBv1.0/STATE/scada-host"


def state_of(online: bool, timestamp: int) -> bytes:
    return json.dumps({"online": online, "timestamp": timestamp}).encode()


def test_a_primary_host_that_is_offline_is_told_nothing_and_everything_in_its_order_once_it_is_back(
    plant: Plant, broker: Broker, listener: Listener
) -> None:
    plant.scan(10)
    feed = plant.feed(sparkplug(plant, broker, broker.tls, primary_host="scada-host"))
    until(lambda: "'scada-host' is not online" in feed.reason)
    assert not listener.payloads("NBIRTH") and not listener.payloads("DDATA")
    for bad in (
        b"",
        b"online",
        b"[1]",
        b'{"online": 1, "timestamp": 5}',
        b'{"online": true}',
        b"[" * 1000,
        b"\xff" * 3000,
    ):
        listener.client.publish(STATE, bad, retain=True)
    listener.client.publish(STATE, state_of(True, 100), qos=1, retain=True)
    until(lambda: feed.delivered == plant.count, 60.0)
    until_born(listener)
    assert feed.reason == "" and len(listener.payloads("NBIRTH")) == 1
    # The will of a session that was over before is no news.
    listener.client.publish(STATE, state_of(False, 50), qos=1, retain=True)
    plant.scan(5)
    until(lambda: feed.delivered == plant.count)
    assert not listener.payloads("NDEATH")
    listener.client.publish(STATE, state_of(False, 200), qos=1, retain=True)
    until(lambda: listener.payloads("NDEATH"))
    until(lambda: "'scada-host'" in feed.reason)
    before = feed.delivered
    plant.scan(20)
    listener.client.publish(STATE, state_of(True, 300), qos=1, retain=True)
    until(lambda: feed.delivered == plant.count, 60.0)
    assert feed.delivered > before
    rows = [row for one, _, row in plant.rows("samples") if (one, row["tag"]) == ("one", "T")]
    until(lambda: len(Host(listener).values["one", "Measured/T"]) >= len(rows))
    host = Host(listener)
    times = [time for time, _, _ in host.values["one", "Measured/T"]]
    assert times == [round(1000 * row["time"]) for row in rows] and host.gaps == 0
    assert any(historical for _, _, historical in host.values["one", "Measured/T"][15:])
    listener.client.publish(STATE, b"", qos=1, retain=True)


def test_a_device_dies_with_its_machine_and_is_born_anew_with_other_tags(
    plant: Plant, broker: Broker, listener: Listener
) -> None:
    tags, machines = dict.fromkeys(MACHINES, TAGS), list(MACHINES)
    row = row_of(broker, broker.tls)
    # A copy each time, as the gateway gives: what is being looked through does not change.
    sink = SparkplugSink(row, "battery", tags=lambda: dict(tags), now=plant.now, acknowledge=lambda *_: None)
    plant.scan(10)
    feed = plant.feed(sink, machines=lambda: list(machines))
    until(lambda: feed.delivered == plant.count)
    until_born(listener)
    born = len(listener.payloads("DBIRTH"))
    # As a reload takes it over: a tag of the one is gone, and so is the other.
    tags["one"] = {name: tag for name, tag in TAGS.items() if name != "Run"}
    until(lambda: len(listener.payloads("DBIRTH")) > born)
    topic, again = listener.payloads("DBIRTH")[-1]
    names = {metric.name for metric in again.metrics}
    assert topic.endswith("/one") and "Measured/T" in names and "Measured/Run" not in names
    machines.remove("two")
    del tags["two"]
    until(lambda: listener.payloads("DDEATH"))
    ((topic, death),) = listener.payloads("DDEATH")
    assert topic == f"{TOPIC.format('DDEATH')}/two" and not death.metrics
    # A death takes its place in the sequence, and the node's next birth says nothing of the machine.
    messages = [m for m in listener.messages if m.topic.split("/")[2] in ("DBIRTH", "DDATA", "DDEATH")]
    numbers = [Payload.FromString(message.payload).seq for message in messages]
    assert numbers == [(numbers[0] + place) % 256 for place in range(len(numbers))]
    rebirth = Payload(timestamp=1)
    rebirth.metrics.add(name="Node Control/Rebirth", datatype=11, boolean_value=True)
    births = len(listener.payloads("DBIRTH"))
    listener.client.publish(TOPIC.format("NCMD"), rebirth.SerializeToString())
    until(lambda: len(listener.payloads("DBIRTH")) > births)
    until(lambda: len(listener.payloads("NBIRTH")) == 2)
    assert [topic.rpartition("/")[2] for topic, _ in listener.payloads("DBIRTH")[births:]] == ["one"]
    machines.append("two")
    tags["two"] = TAGS
    plant.scan(3)
    until(lambda: listener.payloads("DBIRTH")[-1][0].endswith("/two"))


@pytest.mark.parametrize("version", ["5", "3.1.1"])
def test_json_messages_come_once_and_in_order_over_an_outage(
    plant: Plant, broker: Broker, listener: Listener, version: str
) -> None:
    line = Line(broker.tls)
    feed = plant.feed(JsonSink(row_of(broker, line.port, version=version), "battery", acknowledge=lambda *_: None))
    until(lambda: feed.connected)
    plant.scan(3)
    until(lambda: feed.delivered == plant.count)
    line.cut()
    plant.scan(80)
    until(lambda: not feed.connected)
    line.mend()
    until(lambda: feed.delivered == plant.count)
    feed.stop()
    feed.join()
    # What an earlier gateway has left there may come before it; the last messages may still be under way.
    until(lambda: listener.said("plant/box/status")[-4:] == [b"online", b"offline", b"online", b"offline"])
    told: defaultdict[str, list[Any]] = defaultdict(list)
    for message in listener.messages:
        if message.topic != "plant/box/status":
            told[message.topic].append(json.loads(message.payload))
    for machine in MACHINES:
        for tag in TAGS:
            kept = [row for one, _, row in plant.rows("samples") if (one, row["tag"]) == (machine, tag)]
            own = told[f"plant/box/{machine}/samples/{tag.replace('/', '_')}"]
            assert [(row["time"], row["value"], row["quality"]) for row in own] == [
                (row["time"], row["value"], row["quality"].name) for row in kept
            ]
            assert [row["historical"] for row in own] == [False] * 3 + [True] * 80
        forecasts = told[f"plant/box/{machine}/forecasts/T"]
        assert len(forecasts) == 8 and forecasts[0]["quantiles"] == [1.0, 2.0, 3.0]
        assert told[f"plant/box/{machine}/predictions/T"][0]["free_run"] is None
    assert sum(map(len, told.values())) == plant.count


# paho leaves the socket of a failed handshake to the collector.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_broker_that_refuses_the_password_is_named_and_tried_again(plant: Plant, broker: Broker) -> None:
    feed = plant.feed(JsonSink(row_of(broker, broker.tls), "wrong", acknowledge=lambda *_: None))
    until(lambda: feed.reason)
    assert "refuses the connection: Not authorized" in feed.reason and "wrong" not in feed.reason
    feed.stop()
    feed.join()
    stranger = plant.feed(JsonSink(row_of(broker, broker.tls, ca=None), "battery", acknowledge=lambda *_: None))
    until(lambda: stranger.reason)
    assert "certificate verify failed" in stranger.reason

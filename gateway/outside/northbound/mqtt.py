"""MQTT 3.1.1 and 5 by paho: one connection to a broker, and the two ways of telling it, Sparkplug B and plain JSON.

A message counts as handed on when the broker has said so: of JSON (QoS 1) by its own acknowledgement. Sparkplug wants
its data with QoS 0, which nobody acknowledges; a broker takes what one connection sends in its order, though, so that
the answer to an UNSUBSCRIBE behind them, of a filter that nobody has, says that all of them have arrived.

paho gets no thread of its own: all is done in the feed's.
"""

import json
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import groupby
from math import inf, isfinite
from ssl import SSLError
from threading import Event
from time import monotonic, sleep
from typing import Any

from paho.mqtt.client import (
    Client,
    ConnectFlags,
    DisconnectFlags,
    MQTTMessage,
    topic_matches_sub,
)
from paho.mqtt.enums import CallbackAPIVersion, MQTTErrorCode, MQTTProtocolVersion
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode

from drivers.settings import is_in_names
from drivers.tag import Quality, Tag
from gateway.network import TimedSocket, connect, failure_reason, load_pair, make_tls, remaining_seconds
from gateway.outside.northbound.sink import Acknowledge, OutgoingRow, Present, Sink, SinkContext, SinkUnreachable, Tags
from gateway.outside.northbound.sparkplug import (
    BOOLEAN,
    INT64,
    LONGEST_NAME,
    STRING,
    HostState,
    Payload,
    SparkplugMetric,
    add_metric,
    host_state,
    milliseconds,
    parse_commands,
    row_metrics,
)
from gateway.settings import MqttRow, NorthboundSecrets
from gateway.store import FollowedRow

OPEN_SECONDS, ANSWER_SECONDS = 15.0, 10.0
"""How long it may take in all until the broker has let in and subscribed what is heard, and how long an answer may."""
KEEPALIVE_SECONDS = 20
MAX_UNCONFIRMED_MESSAGES = 100
"""JSON messages that wait for their acknowledgement at a time; fewer where the broker says so (MQTT 5)."""
MOST_METRICS = 500
"""Metrics in one Sparkplug message."""
HOST_SECONDS = 2.0
"""How long the word of a primary host may take that the broker has kept."""
MESSAGES_PER_CONFIRMATION = 10
"""Sparkplug messages that are confirmed together."""
MOST_PACKET_BYTES = 1 << 16
"""Bytes of one packet from the broker: many times what any command or answer has. One that is larger ends the
connection, which MQTT 5 tells the broker beforehand."""
MOST_RECEIVED = 100
"""Messages from the broker that wait to be looked at; what comes while so many wait is left out and counted."""
MOST_UNSENT = 1_000
"""Packets that paho holds for a broker that does not take them, and half of an exchange of QoS 2 from one that never
ends it: nobody may subscribe by that here."""
MOST_AT_ONCE = 5_000
"""Packets from the broker that are taken as fast as they come, beside those that answer the gateway's own."""
FLOOD_DELAY_SECONDS = 0.001
"""How long is waited before each that comes beyond them: so a broker that floods waits at its own end of the line, and
does not take the interpreter from the scans."""
ANSWERS_PER_PACKET = 2
"""Packets of the broker's that one of the gateway's may call for: QoS 2 has as many."""
BIRTH_SECONDS = 5.0
"""From a birth that was commanded to the next such birth at least."""
ACKNOWLEDGE = "Alarm Control/Acknowledge"
"""The metric by which a device is told to acknowledge an alarm, by the alarm's name."""


def make_sink(row: MqttRow, secrets: NorthboundSecrets, context: SinkContext) -> Sink:
    """The sink of a broker, by its kind of payload."""
    password = secrets.passwords.get(row.name)
    if row.payload == "json":
        return JsonSink(row, password, acknowledge=context.acknowledge)
    return SparkplugSink(row, password, tags=context.tags, now=context.now, acknowledge=context.acknowledge)


class _BoundedClient(Client):
    """paho's client, which connects until `end` (monotonic s) and receives packets of MOST_PACKET_BYTES at most.

    paho has no bound of either. What is overridden is its own, and held to by tests.
    """

    end = inf
    _spare = MOST_AT_ONCE

    def _packet_queue(self, *given: Any, **keys: Any) -> MQTTErrorCode:
        self._spare = min(self._spare + ANSWERS_PER_PACKET, MOST_AT_ONCE)
        return super()._packet_queue(*given, **keys)

    def _packet_handle(self) -> MQTTErrorCode:
        if self._spare:
            self._spare -= 1
        else:
            sleep(FLOOD_DELAY_SECONDS)
        return super()._packet_handle()

    def _create_socket_connection(self) -> TimedSocket:
        return connect(self._host, self._port, self.end)

    def _sock_recv(self, bufsize: int) -> bytes:
        # It asks for all that a packet has yet, before any of it is there.
        if bufsize > MOST_PACKET_BYTES:
            raise ConnectionAbortedError("a packet is larger than any that is taken")
        return bytes(super()._sock_recv(bufsize))

    @property
    def is_overfull(self) -> bool:
        """Whether more is held for the broker, or of what it has begun, than any exchange needs."""
        return len(self._out_packet) > MOST_UNSENT or len(self._in_messages) > MOST_RECEIVED


class BrokerConnection:
    """A connection to the broker of a row of the plant file. Raises SinkUnreachable wherever it ends or is refused."""

    def __init__(self, row: MqttRow, password: str | None) -> None:
        self._row, self._password = row, password
        self._client: _BoundedClient | None = None
        self._ended = ""
        self._accepted = False
        self._answered: set[int] = set()
        self.window = MAX_UNCONFIRMED_MESSAGES
        self.received: deque[MQTTMessage] = deque()
        self._subscribed: Sequence[str] = ()
        self.dropped = 0

    def open(self, will_topic: str, will: bytes, *, retain: bool, subscribed: Sequence[str]) -> None:
        """Connect with a will (QoS 1), and subscribe, in OPEN_SECONDS in all."""
        row, end = self._row, monotonic() + OPEN_SECONDS
        five = row.version == "5"
        client = _BoundedClient(
            CallbackAPIVersion.VERSION2,
            client_id=f"{row.group}-{row.node}-{row.name}",
            protocol=MQTTProtocolVersion.MQTTv5 if five else MQTTProtocolVersion.MQTTv311,
            clean_session=None if five else True,
        )
        self.close()
        self._ended, self._accepted = "", False
        self._answered.clear()
        self.received.clear()
        self._subscribed = subscribed
        self._client = client
        client.end, client.connect_timeout = end, OPEN_SECONDS
        client.max_inflight_messages = MAX_UNCONFIRMED_MESSAGES
        client.on_connect, client.on_disconnect = self._on_connect, self._on_disconnect
        client.on_publish = lambda _client, _data, number, reason, _: self._note_answer(number, [reason])
        client.on_subscribe = lambda _client, _data, number, reasons, _: self._note_answer(number, reasons)
        client.on_unsubscribe = lambda _client, _data, number, reasons, _: self._note_answer(number, reasons)
        client.on_message = lambda _client, _data, message: self._take(message)
        client.will_set(will_topic, will, qos=1, retain=retain)
        properties: Properties | None = None
        if five:
            properties = Properties(PacketTypes.CONNECT)  # type: ignore[no-untyped-call]
            properties.MaximumPacketSize = MOST_PACKET_BYTES
            properties.ReceiveMaximum = MOST_RECEIVED
        try:
            if row.tls:
                context = make_tls(row.ca)
                if row.certificate is not None and row.key is not None:
                    load_pair(context, row.certificate, row.key)
                client.tls_set_context(context)
            if row.user is not None:
                client.username_pw_set(row.user, self._password)
            client.connect(row.host, row.port, KEEPALIVE_SECONDS, properties=properties)
            line = client.socket()
            if isinstance(line, TimedSocket):
                line.end = inf  # from here on paho waits for nothing by itself
                line.setblocking(False)  # sending the CONNECT has left its time-out
            self.wait(lambda: self._accepted, remaining_seconds(end))
            for topic in subscribed:
                self._answer(client.subscribe(topic, qos=1), remaining_seconds(end))
        except (OSError, ValueError) as error:
            reason = (
                failure_reason(error) if isinstance(error, SSLError) else getattr(error, "strerror", None) or str(error)
            )
            raise SinkUnreachable(f"{row.host}:{row.port} cannot be reached: {reason}") from None

    def _on_connect(
        self, _client: Client, _data: Any, _flags: ConnectFlags, reason: ReasonCode, properties: Properties | None
    ) -> None:
        self._accepted = not reason.is_failure
        if reason.is_failure:
            self._ended = f"it refuses the connection: {reason}"
        # A broker that is sent more at a time closes the connection (MQTT 5, 3.3.4).
        self.window = min(MAX_UNCONFIRMED_MESSAGES, getattr(properties, "ReceiveMaximum", MAX_UNCONFIRMED_MESSAGES))

    def _on_disconnect(
        self, _client: Client, _data: Any, _flags: DisconnectFlags, reason: ReasonCode, _: Properties | None
    ) -> None:
        self._ended = self._ended or f"the connection has ended: {reason}"

    def _take(self, message: MQTTMessage) -> None:
        try:
            asked_for = any(topic_matches_sub(topic, message.topic) for topic in self._subscribed)
        except UnicodeDecodeError:
            asked_for = False
        if asked_for and len(self.received) < MOST_RECEIVED:
            self.received.append(message)
        else:
            self.dropped += 1

    def _note_answer(self, number: int, reasons: Sequence[ReasonCode]) -> None:
        self._answered.add(number)
        if (refused := next((reason for reason in reasons if reason.is_failure), None)) is not None:
            self._ended = f"it refuses a message or a subscription: {refused}"

    @property
    def client(self) -> _BoundedClient:
        """paho's client."""
        if self._client is None:
            raise SinkUnreachable("there is no connection")
        return self._client

    def turn(self, seconds: float) -> None:
        """Receive and send what there is, or wait for it so long."""
        client = self.client
        code = client.loop(seconds)
        if client.is_overfull:
            raise SinkUnreachable(f"{self._row.host}:{self._row.port}: it sends, and takes no answers")
        if code != MQTTErrorCode.MQTT_ERR_SUCCESS or self._ended:
            reason = self._ended or f"the connection has ended: {code.name}"
            raise SinkUnreachable(f"{self._row.host}:{self._row.port}: {reason}")

    def wait(self, true: Callable[[], bool], seconds: float = ANSWER_SECONDS) -> None:
        """Receive until it is so."""
        end = monotonic() + seconds
        while not true():
            if monotonic() > end:
                raise SinkUnreachable(f"{self._row.host}:{self._row.port} does not answer for {seconds:g} s")
            self.turn(0.05)

    def publish(self, topic: str, payload: bytes, *, qos: int, retain: bool = False) -> int:
        """Send a message; gives the number under which `pop_answer` knows it."""
        info = self.client.publish(topic, payload, qos=qos, retain=retain)
        if info.rc != MQTTErrorCode.MQTT_ERR_SUCCESS:
            raise SinkUnreachable(f"{self._row.host}:{self._row.port}: the connection has ended: {info.rc.name}")
        return info.mid

    def pop_answer(self, number: int) -> bool:
        """Whether the broker has acknowledged it; once it has, that is forgotten."""
        if number not in self._answered:
            return False
        self._answered.remove(number)
        return True

    def confirm(self) -> None:
        """Wait until the broker has received all that was sent."""
        self._answer(self.client.unsubscribe(f"{self._row.group}/{self._row.node}/none"))
        self._answered.clear()

    def _answer(self, asked: tuple[MQTTErrorCode, int | None], seconds: float = ANSWER_SECONDS) -> None:
        code, number = asked
        if code != MQTTErrorCode.MQTT_ERR_SUCCESS or number is None:
            raise SinkUnreachable(f"{self._row.host}:{self._row.port}: the connection has ended: {code.name}")
        self.wait(lambda: self.pop_answer(number), seconds)

    def close(self) -> None:
        """Disconnect, so that the broker does not tell the will."""
        client, self._client = self._client, None
        if client is not None:
            client.on_disconnect = None
            client.disconnect()
            client.loop(0.0)


class SparkplugSink:
    """An edge node of Sparkplug B whose devices are the machines.

    It is born with what stands now, and dies by its own word or by the broker's; it is reborn on demand, and a device
    when it has a signal that it was not born with.
    """

    def __init__(
        self, row: MqttRow, password: str | None, *, tags: Tags, now: Callable[[], float], acknowledge: Acknowledge
    ) -> None:
        self._row, self._tags, self._now, self._acknowledge = row, tags, now, acknowledge
        self._broker = BrokerConnection(row, password)
        # Not from 0 after each start: a death that is told late would be taken for that of the present session.
        self._births, self._sequence = int(now()) % 256, 0
        self._aliases: dict[tuple[str, str], int] = {}
        self._present: dict[str, dict[str, SparkplugMetric]] = {}
        self._is_born = False
        self._rebirth_wanted, self._reborn_at = False, -inf
        self._host: HostState | None = None
        self._born_tags: dict[str, Mapping[str, Tag]] = {}

    @property
    def dropped(self) -> int:
        """The messages from the broker that were left out: too many at a time, or not asked for."""
        return self._broker.dropped

    def _topic(self, kind: str, device: str = "") -> str:
        return "/".join(filter(None, ("spBv1.0", self._row.group, kind, self._row.node, device)))

    def open(self, present: Present) -> None:
        """Connect, wait for the primary host where there is one, and be born."""
        self._births = (self._births + 1) % 256
        self._host = None
        self._rebirth_wanted = False
        # The devices' commands only where somebody may give them: else nothing that is sent there is even received.
        commands = [self._topic("NCMD"), *([self._topic("DCMD", "+")] if self._row.commands else [])]
        state = [] if self._row.primary_host is None else [f"spBv1.0/STATE/{self._row.primary_host}"]
        self._broker.open(self._topic("NDEATH"), self._death(), retain=False, subscribed=[*state, *commands])
        self._wait_for_host()
        tags = self._tags()
        self._present = {
            machine: {metric.name: metric for row in rows for metric in row_metrics(row, tags.get(machine, {}))}
            for machine, rows in present.items()
        }
        self._give_birth()

    def _wait_for_host(self) -> None:
        """Wait for the word of the primary host, which the broker keeps. Raises SinkUnreachable where it is offline."""
        if self._row.primary_host is None:
            return
        end = monotonic() + HOST_SECONDS
        while self._host is None or not self._host.online:
            if monotonic() > end:
                raise SinkUnreachable(f"the primary host {self._row.primary_host!r} is not online")
            self._broker.turn(0.05)
            self._obey()

    def _take_host_state(self, payload: bytes) -> None:
        """A host's death is its will, which may come late: one that is older than what it has said since is no news."""
        state = host_state(payload)
        if state is None or (self._host is not None and state.timestamp < self._host.timestamp):
            return
        self._host = state
        if not state.online and self._is_born:
            raise SinkUnreachable(f"the primary host {self._row.primary_host!r} has gone offline")

    def _death(self) -> bytes:
        death = Payload(timestamp=milliseconds(self._now()))
        death.metrics.add(name="bdSeq", timestamp=death.timestamp, datatype=INT64, long_value=self._births)
        return bytes(death.SerializeToString())

    def _give_birth(self) -> None:
        """Tell all that stands; what is told after it is told against this."""
        self._sequence = 0
        now = self._now()
        birth = Payload(timestamp=milliseconds(now))
        birth.metrics.add(name="bdSeq", timestamp=birth.timestamp, datatype=INT64, long_value=self._births)
        birth.metrics.add(name="Node Control/Rebirth", timestamp=birth.timestamp, datatype=BOOLEAN, boolean_value=False)
        self._send("NBIRTH", "", birth)
        for machine in self._present:
            self._publish_birth(machine)
        self._broker.confirm()
        self._is_born = True

    def _publish_birth(self, machine: str) -> None:
        birth = Payload(timestamp=milliseconds(self._now()))
        for metric in self._present[machine].values():
            add_metric(birth, metric, alias=self._alias(machine, metric.name), birth=True)
        if self._row.commands:
            birth.metrics.add(name=ACKNOWLEDGE, timestamp=birth.timestamp, datatype=STRING, string_value="")
        self._born_tags[machine] = self._tags().get(machine, {})
        self._send("DBIRTH", machine, birth)

    def _follow_reload(self) -> None:
        """A device dies with its machine; one whose tags have changed is born anew, without those that it has no more.

        Only once all is handed on: what is on record of a machine that is gone comes before its death.
        """
        tags = self._tags()
        for machine in [name for name in self._present if name not in tags]:
            del self._present[machine]
            if self._born_tags.pop(machine, None) is not None:
                self._send("DDEATH", machine, Payload(timestamp=milliseconds(self._now())))
        for machine, own in tags.items():
            if self._born_tags.get(machine, own) == own:
                continue
            former = self._born_tags[machine]
            for name in former.keys() - own.keys():
                self._present[machine].pop(f"Measured/{name}", None)
            self._publish_birth(machine)

    def _alias(self, machine: str, name: str) -> int:
        return self._aliases.setdefault((machine, name), len(self._aliases) + 1)

    def _send(self, kind: str, device: str, payload: Any) -> None:
        payload.seq = self._sequence
        self._sequence = (self._sequence + 1) % 256
        self._broker.publish(self._topic(kind, device), payload.SerializeToString(), qos=0)

    def deliver(self, rows: Sequence[OutgoingRow]) -> Iterator[int]:
        """Send a message a machine with at most MOST_METRICS or one row's; each is confirmed before it counts."""
        self._obey()
        tags = self._tags()
        unconfirmed = messages = 0
        for machine, own in groupby(rows, key=lambda one: one.row.stream.machine):
            mine = [(one, list(row_metrics(one.row, tags.get(machine, {})))) for one in own]
            self._announce(machine, mine)
            while mine:
                data = Payload(timestamp=milliseconds(self._now()))
                count = 0
                while count < len(mine) and len(data.metrics) < MOST_METRICS:
                    one, metrics = mine[count]
                    for metric in metrics:
                        alias = self._alias(machine, metric.name)
                        add_metric(data, metric, alias=alias, birth=False, historical=one.historical)
                    count += 1
                del mine[:count]
                self._send("DDATA", machine, data)
                unconfirmed, messages = unconfirmed + count, messages + 1
                if messages % MESSAGES_PER_CONFIRMATION == 0:
                    self._broker.confirm()
                    yield unconfirmed
                    unconfirmed = 0
        if unconfirmed:
            self._broker.confirm()
            yield unconfirmed

    def _announce(self, machine: str, rows: Sequence[tuple[OutgoingRow, Sequence[SparkplugMetric]]]) -> None:
        """Have the device born anew where it has signals that it was not born with; keep what stands now."""
        present = self._present.setdefault(machine, {})
        is_new = False
        for one, metrics in rows:
            for metric in metrics:
                known = present.get(metric.name)
                is_new = is_new or known is None or known.datatype != metric.datatype
                if known is None or known.datatype != metric.datatype or not one.historical:
                    present[metric.name] = metric
        if is_new:
            self._publish_birth(machine)

    def idle(self, seconds: float, stop: Event) -> None:
        """Keep the connection alive, hear commands, and follow what a reload has changed."""
        self._follow_reload()
        end = monotonic() + seconds
        while not stop.is_set() and (left := end - monotonic()) > 0:
            self._broker.turn(min(left, 0.2))
            self._obey()

    def _obey(self) -> None:
        """Do what was commanded; what makes no sense is passed over, as the specification wants it.

        However often a birth is commanded, one waits, and none comes within BIRTH_SECONDS of the one before.
        """
        alarms: dict[str, dict[str, None]] = {}
        while self._broker.received:
            message = self._broker.received.popleft()
            if message.topic.startswith("spBv1.0/STATE/"):
                self._take_host_state(bytes(message.payload))
                continue
            kind, *device = message.topic.split("/")[2:3] + message.topic.split("/")[4:]
            for command in parse_commands(bytes(message.payload)):
                if kind == "NCMD" and command.name == "Node Control/Rebirth" and command.is_true:
                    self._rebirth_wanted = self._is_born
                elif kind == "DCMD" and device and command.name == ACKNOWLEDGE and command.text:
                    alarms.setdefault(device[0], {})[command.text] = None
        for machine, names in alarms.items():
            for name in names:
                self._acknowledge(machine, [name], f"mqtt {self._row.name}")
        if self._rebirth_wanted and monotonic() - self._reborn_at >= BIRTH_SECONDS:
            self._rebirth_wanted, self._reborn_at = False, monotonic()
            self._give_birth()

    def close(self) -> None:
        """Die in order: a broker tells the will only of who is gone without a word."""
        try:
            if self._is_born:
                self._broker.publish(self._topic("NDEATH"), self._death(), qos=0)
        except SinkUnreachable:
            pass
        self._is_born = False
        self._broker.close()


class JsonSink:
    """One message a row, as JSON: topics are group/node/machine/table/signal.

    `group/node/status` is retained and says `online` or `offline`, the latter also where the gateway is gone without a
    word. A message is told at least once: its `row` (and `time`) are the same when it comes again.
    """

    def __init__(self, row: MqttRow, password: str | None, *, acknowledge: Acknowledge) -> None:
        self._row, self._acknowledge = row, acknowledge
        self._broker = BrokerConnection(row, password)
        self._base = f"{row.group}/{row.node}"
        self._is_online = False

    @property
    def dropped(self) -> int:
        """The messages from the broker that were left out: too many at a time, or not asked for."""
        return self._broker.dropped

    def open(self, present: Present) -> None:
        """Connect, and say so."""
        commands = [f"{self._base}/+/acknowledge"] if self._row.commands else []
        self._broker.open(f"{self._base}/status", b"offline", retain=True, subscribed=commands)
        self._broker.publish(f"{self._base}/status", b"online", qos=1, retain=True)
        self._is_online = True

    def deliver(self, rows: Sequence[OutgoingRow]) -> Iterator[int]:
        """Send a message a row, so many at a time as the broker takes; they count in their order."""
        self._obey()
        waiting: deque[int] = deque()
        left = deque(rows)
        while left or waiting:
            while left and len(waiting) < self._broker.window:
                topic, payload = json_message(self._base, left.popleft())
                waiting.append(self._broker.publish(topic, payload, qos=1))
            first = waiting[0]
            self._broker.wait(lambda first=first: self._broker.pop_answer(first))  # type: ignore[misc]
            waiting.popleft()
            count = 1
            while waiting and self._broker.pop_answer(waiting[0]):
                waiting.popleft()
                count += 1
            yield count

    def idle(self, seconds: float, stop: Event) -> None:
        """Keep the connection alive, and hear commands."""
        end = monotonic() + seconds
        while not stop.is_set() and (left := end - monotonic()) > 0:
            self._broker.turn(min(left, 0.2))
            self._obey()

    def _obey(self) -> None:
        alarms: dict[str, dict[str, None]] = {}
        while self._broker.received:
            message = self._broker.received.popleft()
            alarm = message.payload.decode(errors="replace").strip()
            if 0 < len(alarm) <= LONGEST_NAME and alarm.isprintable() and not message.retain:
                alarms.setdefault(message.topic.split("/")[2], {})[alarm] = None
        for machine, names in alarms.items():
            for name in names:
                self._acknowledge(machine, [name], f"mqtt {self._row.name}")

    def close(self) -> None:
        """Say that it is offline, and disconnect."""
        try:
            if self._is_online:
                number = self._broker.publish(f"{self._base}/status", b"offline", qos=1, retain=True)
                self._broker.wait(lambda: self._broker.pop_answer(number), 1.0)
        except SinkUnreachable:
            pass
        self._is_online = False
        self._broker.close()


def json_message(base: str, outgoing: OutgoingRow) -> tuple[str, bytes]:
    """The topic and the payload of a row; `time` is in s UTC, `row` numbers the rows of a table of the machine."""
    row = outgoing.row
    signal = _topic_signal(row)
    levels = [base, row.stream.machine, row.stream.table, *([] if signal is None else [_level(signal)])]
    plain = {key: _plain(value) for key, value in row.values.items()}
    plain |= {key: json.loads(row.values[key]) for key in ("levels", "quantiles") if key in row.values}
    content = {**plain, "row": row.key, "historical": outgoing.historical}
    return "/".join(levels), json.dumps(content, separators=(",", ":"), allow_nan=False).encode()


def _topic_signal(row: FollowedRow) -> str | None:
    """The last level of a row's topic."""
    match row.stream.table:
        case "samples":
            return str(row.values["tag"])
        case "alarms":
            return str(row.values["condition"])
    return row.stream.temperature or None


def _level(name: str) -> str:
    """A name as one level of a topic: none of the characters for levels and wild cards, or that no name may hold.

    Names of former maps come from the records.
    """
    return "".join(mark if mark not in "/+#" and is_in_names(mark) else "_" for mark in name)


def _plain(value: Any) -> Any:
    """A value as JSON has it: a quality is its name, what is no number is null."""
    if isinstance(value, Quality):
        return value.name
    if isinstance(value, float) and not isfinite(value):
        return None
    return value

"""A tag with a tab in its name passed `check`, the broker ended the connection for it, and nobody's data got further.

`a\\` arrived in InfluxDB as `a` and replaced its points, and two of three odd mail addresses led elsewhere, or to an
error that nobody had foreseen. What is named in the plant reaches the other side as exactly one thing of exactly that
name, as the other side's own reader says, or is refused at check in one sentence.
"""

import email
import json
import random
from collections.abc import Iterator, Mapping
from dataclasses import replace
from email import policy
from email.message import EmailMessage
from email.utils import getaddresses
from types import SimpleNamespace
from typing import Any

import pytest
from asyncua import ua
from asyncua.ua import ua_binary
from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.openmetrics import exposition, parser
from prometheus_client.parser import text_string_to_metric_families
from psycopg.conninfo import conninfo_to_dict, make_conninfo
from pydantic import ValidationError
from sparkplub_b_packets.core.sparkplug_b_pb2 import Payload

from drivers.device_file import TagTable
from drivers.settings import ConfigError, validate_section
from drivers.tag import Quality, Tag
from gateway.outside.northbound.influx import InfluxSink, format_row
from gateway.outside.northbound.metrics import GatewayCollector
from gateway.outside.northbound.mqtt import JsonSink, json_message
from gateway.outside.northbound.opcua import OpcUaServer
from gateway.outside.northbound.postgres import PostgresSink
from gateway.outside.northbound.sink import OutgoingRow
from gateway.outside.northbound.sparkplug import add_metric, row_metrics
from gateway.outside.notify import AlarmMessage, senders
from gateway.outside.status import read_status
from gateway.settings import InfluxRow, MqttRow, NotifySection, RecipientRow, load_northbound_secrets, load_secrets
from gateway.settings.northbound import NorthboundSection
from gateway.store import FollowedRow, RowPosition, RowStream
from tests.gateway.status_picture import picture, tag
from tests.gateway.support import EPOCH
from tests.gateway.test_notify import MESSAGE
from tests.northbound.test_mqtt import MOSQUITTO, Broker, Listener
from tests.northbound.test_sinks import Database, Influx
from tests.rig.servers import until

PIECES = (
    "T", "a", "é", "温度", "'", '"', ";", ",", "=", " ", "\\", "\\\\", "/", "+", "#", "$SYS", "..", "%s", "%25", "${x}",
    "{{x}}", "<b>", "&amp;", "--", "'; DROP TABLE samples; --", "=cmd|", "@", ":", "(x)", "[1]", "|", "`", "*",
    "\u00a0", "\u00ad", "\u200f", "😀", "\t", "\n", "\r\n", "\0", "\x01", "\x1b[2J", "\x7f", "\x9b", "\x85", "\u2028",
    "\u202e", "\u2066", "\ufffe", "\ufdd0", "\U0001ffff", "\ud800", "x" * 199,
)  # fmt: skip
REFUSED_BY_BROKERS = ("a\tb", "a\x01", "a\x7f", "a\x9b", "a\ufffe", "a\ufdd0", "a\U0001ffff")


def drawn(count: int = 1500, seed: int = 36) -> list[str]:
    """Names that nobody means well with, each once."""
    rng = random.Random(seed)
    found = {"".join(rng.choices(PIECES, k=rng.randrange(4))) for _ in range(count)}
    return sorted({*found, *PIECES, *REFUSED_BY_BROKERS, "\\", "a\\", "a\\,b", " a", "a ", "x" * 201})


def sentence_of(**keys: Any) -> str:
    """What a check says of a tag; "" where it has nothing to say."""
    try:
        validate_section(TagTable, {"name": "T", "address": "holding:1", **keys}, "device.toml")
    except ConfigError as error:
        (sentence,) = error.problems
        return sentence
    return ""


NAMES = [name for name in drawn() if not sentence_of(name=name)]
"""Those that a check takes."""


def row(number: int, name: str, *, text: str = "on", unit: str = "") -> OutgoingRow:
    """A reading of the tag of this name."""
    time = EPOCH + number
    values = {"tag": name, "time": time, "value": text, "quality": Quality.GOOD, "sent": None, "unit": unit}
    stream = RowStream("one", "", "samples", 1)
    followed = FollowedRow(stream=stream, key=number, time=time, values=values, position=RowPosition(number, time))
    return OutgoingRow(followed, historical=False)


def test_what_no_system_can_be_told_is_refused_at_check_in_one_sentence() -> None:
    known = {"T", "'; DROP TABLE samples; --", "$SYS", "..", "\u00a0", "a\\,b", " a"}
    assert len(NAMES) > 300 and known <= {*NAMES}
    for name in drawn():
        said = sentence_of(name=name)
        assert name in NAMES or (said.startswith("device.toml: name: ") and said.isprintable())
        # A unit, and the words of a number, stand beside the name wherever that goes.
        if name:
            assert bool(sentence_of(unit=name)) == bool(said) == bool(sentence_of(labels={"0": name}))
    assert not [name for name in NAMES if name not in name.splitlines() or name.encode().decode() != name]
    for name in (*REFUSED_BY_BROKERS, "\x1b[2J", "\u202eabc", "a\\", "a\0"):
        assert "device.toml: name: " in sentence_of(name=name)


# ---------------------------------------------------------------- InfluxDB


def read_points(text: str) -> list[tuple[str, dict[str, str], dict[str, str], str]]:
    """Measurement, tags, fields and time of each point, as the specification of line protocol has them."""
    found, at = [], 0

    def until_one_of(ends: str, escaped: str) -> str:
        nonlocal at
        said = ""
        while at < len(text) and text[at] not in ends:
            if text[at] == "\\" and at + 1 < len(text) and text[at + 1] in escaped:
                at += 1
            said += text[at]
            at += 1
        return said

    while at < len(text):
        measurement, tags, fields = until_one_of(", \n", ", "), dict[str, str](), dict[str, str]()
        while text[at] == ",":
            at += 1
            key = until_one_of(",= \n", ",= ")
            assert text[at] == "=" and key and key not in tags
            at += 1
            tags[key] = until_one_of(",= \n", ",= ")
            assert tags[key] and text[at] in ", "
        while (text[at] == " " and not fields) or text[at] == ",":
            at += 1
            key = until_one_of(",= \n", ",= ")
            assert text[at] == "=" and key and key not in fields
            at += 1
            if text[at] == '"':
                at += 1
                fields[key] = until_one_of('"', '"\\')
                at += 1
            else:
                fields[key] = until_one_of(", \n", "")
        assert text[at] == " "
        at += 1
        found.append((measurement, tags, fields, until_one_of("\n", "")))
        at += 1
    return found


def test_a_name_is_one_point_of_that_name_in_line_protocol() -> None:
    rows = [row(number, name, text=f"{name}\\", unit=name) for number, name in enumerate(NAMES)]
    points = read_points("\n".join(format_row(one.row, "box") for one in rows))
    assert [(tags, fields["text"]) for _, tags, fields, _ in points] == [
        ({"node": "box", "machine": "one", "tag": name, "unit": name}, f"{name}\\") for name in NAMES
    ]
    # Names of former maps are on record: none takes another's place, or ends a line.
    former = [name for name in drawn() if name and not {"\n", "\r\n", "\ud800"} & {*name, name}]
    kept = read_points("\n".join(format_row(row(number, name).row, "box") for number, name in enumerate(former)))
    assert len({tags["tag"] for _, tags, _, _ in kept}) >= len({name.replace("\r", " ") for name in former})


def test_influxdb_has_a_point_for_each_name(influx: Influx) -> None:
    influx.query("CREATE DATABASE names")
    sink = InfluxSink(InfluxRow(name="x", url=f"http://127.0.0.1:{influx.port}", database="names"), None, None)
    sink.open({})
    assert sum(sink.deliver([row(number, name) for number, name in enumerate(NAMES)])) == len(NAMES)
    sink.close()
    (series,) = influx.query('SELECT "tag", "text" FROM samples', db="names")
    columns = series["columns"].index("tag"), series["columns"].index("text")
    assert sorted(tuple(values[each] for each in columns) for values in series["values"]) == [
        (name, "on") for name in sorted(NAMES)
    ]


# ---------------------------------------------------------------- PostgreSQL


def test_postgres_has_a_row_for_each_name_and_all_its_tables(database: Database) -> None:
    sink = PostgresSink(database.row(database.port, table_schema="Select.1-x", tables=["samples"]), None)
    sink.open({})
    rows = [row(number, name, text=name, unit=name) for number, name in enumerate(NAMES)]
    assert sum(sink.deliver(rows)) == len(NAMES)
    sink.close()
    found = database.query('SELECT tag, text, unit FROM "Select.1-x".samples ORDER BY row')
    assert found == [(name, name, name) for name in NAMES]
    database.query('DROP SCHEMA "Select.1-x" CASCADE')


def test_the_name_of_a_database_sets_nothing_else() -> None:
    for name in NAMES:
        assert conninfo_to_dict(make_conninfo("", dbname=name, user=name)) == {"dbname": name, "user": name}


# ---------------------------------------------------------------- MQTT and Sparkplug


@pytest.mark.skipif(MOSQUITTO is None, reason="needs mosquitto (apt-get install mosquitto)")
@pytest.mark.parametrize("version", ["5", "3.1.1"])
def test_no_name_ends_the_connection_to_a_broker(broker: Broker, version: str) -> None:
    """Also none of a former map, whose readings are still on record."""
    names = [name for name in drawn() if name and "\ud800" not in name]
    listener = Listener(broker)
    given = {"name": "n", "host": "127.0.0.1", "port": broker.plain, "tls": False, "payload": "json"}
    sink = JsonSink(MqttRow.model_validate({**given, "version": version}), None, acknowledge=lambda *_: None)
    try:
        sink.open({})
        assert sum(sink.deliver([row(number, name) for number, name in enumerate(names)])) == len(names)
        until(lambda: len(listener.messages) >= len(names) + 1)
    finally:
        sink.close()
        listener.close()
    told = [message for message in listener.messages if "/samples/" in message.topic]
    assert [json.loads(message.payload)["tag"] for message in told] == names
    for message in told:
        assert message.topic.split("/")[:4] == ["decanter", "gateway", "one", "samples"]
        assert message.topic.count("/") == 4 and not {"+", "#"} & {*message.topic}


def test_a_topic_is_the_name_itself_where_it_may_be() -> None:
    for name in NAMES:
        topic, _ = json_message("g/n", row(0, name))
        assert topic.startswith("g/n/one/samples/") and len(topic.encode()) < 65_536
        assert {"/", "+", "#"} & {*name} or topic == f"g/n/one/samples/{name}"


def test_a_metric_of_sparkplug_bears_its_name() -> None:
    birth = Payload()
    own = senders_payload(NAMES)
    birth.ParseFromString(own)
    assert [one.name for one in birth.metrics] == [f"Measured/{name}" for name in NAMES]


def senders_payload(names: list[str]) -> bytes:
    from gateway.outside.northbound.sparkplug import Payload as OwnPayload

    birth = OwnPayload()
    for number, name in enumerate(names):
        (metric,) = row_metrics(row(number, name, unit=name).row, {name: Tag(name, "holding:1")})
        add_metric(birth, metric, alias=number, birth=True)
    return bytes(birth.SerializeToString())


# ---------------------------------------------------------------- OPC UA and Prometheus


def test_a_node_of_opc_ua_is_one_names() -> None:
    server: Any = SimpleNamespace(_namespace=2)
    nodes = {}
    for name in NAMES:
        node = OpcUaServer._id(server, ("one", "Measured", name))
        read = ua_binary.nodeid_from_binary(ua.ua_binary.Buffer(ua_binary.nodeid_to_binary(node)))
        assert read == node and node.Identifier.count("/") == 2
        nodes[read] = name
        browsed = OpcUaServer._browse_name(server, name)
        again = ua_binary.struct_from_binary(ua.QualifiedName, ua.ua_binary.Buffer(ua_binary.struct_to_binary(browsed)))
        assert again.Name == name
    assert len(nodes) == len(NAMES)


def test_prometheus_reads_each_name_as_a_label() -> None:
    status = read_status(picture(values={"T": tag(1.5)}))
    status = replace(status, values={name: replace(status.values["T"], unit=name) for name in NAMES})
    registry = CollectorRegistry()
    registry.register(GatewayCollector({"decanter": status}, []))
    plain = text_string_to_metric_families(generate_latest(registry).decode())
    opened = parser.text_string_to_metric_families(exposition.generate_latest(registry).decode())
    for families in (plain, opened):
        values = next(one for one in families if one.name == "decanter_value")
        assert [(one.labels["tag"], one.labels["unit"]) for one in values.samples] == [(name, name) for name in NAMES]


# ---------------------------------------------------------------- mail and web hooks

ADDRESS_PIECES = (
    "a", "b.c", "(c)", "[", "]", ":", "\\", "'", "%s", "${x}", "!", "@", "..", "é", "=?utf-8?q?x?=", "=", "?", "\n",
    ",", "\r\nBcc: x@example.com", "\u202e", "\0", ";", "<", ">", '"', " ", "root", "+x", "undisclosed:", "\\,",
)  # fmt: skip


def address_problem(address: str) -> str:
    """What is said of a mail address; "" where it is taken."""
    try:
        RecipientRow(name="a", email=address)
    except ValidationError as error:
        return str(error)
    return ""


def test_a_mail_goes_to_the_address_that_was_given_or_it_is_refused_at_check() -> None:
    rng, taken = random.Random(37), 0
    hosts = ("example.com", "[192.0.2.1]", "b", "é.example.com")
    for number in range(1200):
        local = "".join(rng.choices(ADDRESS_PIECES, k=rng.randrange(1, 4)))
        address = f"{local}@{rng.choice(hosts)}"
        if address_problem(address):
            continue
        taken += 1
        if taken % 4:
            continue  # the library takes its time for one
        mail = EmailMessage()
        mail["To"] = address
        assert [found for _, found in getaddresses([str(mail["To"])])] == [address], (number, address)
    assert taken > 60
    for address in ("shift@example.com", "o'neil+night@box.example.com", "root@localhost", "a@[192.0.2.1]", "é@é.it"):
        assert not address_problem(address)
    for address in (
        "x:a@example.com",
        "a(b)@example.com",
        "a@b@example.com",
        "..:@x",
        "(c).%s@x",
        "a@",
        "@x",
        "a..b@x",
    ):
        assert "is no mail address; give one such as" in address_problem(address)


HEADERS = [
    "Auto-Submitted", "Content-Transfer-Encoding", "Content-Type", "Date", "From", "MIME-Version", "Message-ID",
    "Subject", "To",
]  # fmt: skip


class KeptMail:
    """A mail server's way in, which keeps what it is given."""

    kept: list[bytes] = []  # noqa: RUF012 - emptied by the test

    def __init__(self, *_: Any, **__: Any) -> None:
        return

    def __enter__(self) -> "KeptMail":
        return self

    def __exit__(self, *_: object) -> None:
        return

    def send_message(self, mail: EmailMessage) -> None:
        self.kept.append(mail.as_bytes(policy=policy.SMTP))


def messages(names: list[str]) -> Iterator[AlarmMessage]:
    for name in names:
        plain = {key: getattr(MESSAGE, key) for key in AlarmMessage.__slots__}
        yield AlarmMessage(**{**plain, "alarm": f"over limit {name}", "tag": name})


def test_a_mail_about_any_name_has_one_subject_and_no_further_header(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(senders, "_TimedSmtp", KeptMail)
    KeptMail.kept.clear()
    server = {"host": "127.0.0.1", "port": 25, "sender": "gateway@example.com", "security": "none"}
    section = NotifySection.model_validate({"smtp": server, "to": [{"name": "a", "email": "shift@example.com"}]})
    send = senders.make_senders(section, load_secrets(section))["a"]
    names = NAMES[::7]
    for message in messages(names):
        send([message], EPOCH)
    for message, content in zip(messages(names), KeptMail.kept, strict=True):
        mail = email.message_from_bytes(content, policy=policy.default)
        assert sorted(mail.keys()) == HEADERS
        assert mail["To"] == "shift@example.com"
        assert " ".join(mail["Subject"].split()) == " ".join(senders.subject_line([message]).split())
    with pytest.raises(senders.RefusedError, match="cannot be written as a mail"):  # of a former map, and no error
        send(list(messages(["a\nBcc: x@example.com"])), EPOCH)


@pytest.mark.parametrize("token", ["abc\n", "a b\r\nX: y", "é", " abc", "a\0"])
def test_a_token_that_no_header_holds_is_refused_at_check_and_quoted_nowhere(token: str, tmp_path: Any) -> None:
    path = tmp_path / "secrets.toml"
    path.write_text(f"[tokens]\nx = {json.dumps(token)}\n")
    path.chmod(0o600)
    given: Mapping[str, Any] = {"name": "x", "url": "http://127.0.0.1:8086", "bucket": "b"}
    with pytest.raises(ConfigError, match="tokens: that of 'x' has a line end") as refused:
        load_northbound_secrets(NorthboundSection.model_validate({"secrets": path, "influx": [given]}))
    assert "abc" not in str(refused.value)
    with pytest.raises(ConfigError, match="tokens: that of 'x' has a line end"):
        load_secrets(NotifySection.model_validate({"secrets": path}))


def test_an_address_with_more_than_an_address_is_refused() -> None:
    for url in ("https://influx.example.com:8086\n", "https://in flux:8086", "https://a\x01b:8086"):
        with pytest.raises(ValidationError, match="is no address of a server"):
            InfluxRow(name="x", url=url, bucket="b")


def test_the_parser_of_this_test_tells_points_apart() -> None:
    told = read_points('m,a=b\\,c\\ d\\=e f=1i,g="x\\"y\\\\" 5\nm h=true 6')
    assert told == [("m", {"a": "b,c d=e"}, {"f": "1i", "g": 'x"y\\'}, "5"), ("m", {}, {"h": "true"}, "6")]

"""A hanging proxy that sent a header byte every few seconds kept everybody from the alarms, and no alarm said so.

The time-out of a socket's operation was taken for the deadline of the whole, one thread told all recipients one after
the other, and only what had failed was complained of.
"""

import socket
import ssl
import threading
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from functools import partial
from pathlib import Path
from typing import Any

import psycopg
import pytest

from drivers.supervision import Supervisor
from gateway.network import timed_socket
from gateway.network.certificates import make_all
from gateway.network.timed_socket import call_with_deadline
from gateway.network.timed_tls import make_tls
from gateway.outside.northbound import SinkUnreachable, feed, influx, mqtt, postgres
from gateway.outside.notify import AlarmMessage, Notifier, UndeliveredError, make_senders, senders
from gateway.outside.status import GatewayLine
from gateway.plant.service import ServiceManager
from gateway.settings import InfluxRow, MqttRow, NotifySecrets, NotifySection, PostgresRow, RecipientRow
from gateway.store import RowPosition, RowStream
from tests.gateway.support import EPOCH
from tests.gateway.test_alarm_machine import Kept, Silent
from tests.gateway.test_notify import HOT, MESSAGE, Hand, at, raised
from tests.northbound.rig import Plant
from tests.rig.dribbling import Dribbler, dribbling
from tests.rig.servers import until

DEADLINE_S = 0.3
ENDLESS_HEADER = b"x"


def failure_of(work: Callable[[], object]) -> BaseException:
    """What a call that may never end by itself raises; the call that is held for ever fails the test."""
    found: list[BaseException] = []

    def run() -> None:
        try:
            work()
        except (OSError, UndeliveredError, SinkUnreachable) as error:
            found.append(error)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    thread.join(60.0)
    assert found, "it is held by a peer that goes on sending a byte now and then"
    return found[0]


def mail_section(port: int, **smtp: Any) -> NotifySection:
    server = {"host": "127.0.0.1", "port": port, "sender": "gateway@example.com", "security": "none", **smtp}
    return NotifySection.model_validate({"smtp": server, "to": [{"name": "a", "email": "shift@example.com"}]})


@pytest.fixture
def short_deadlines(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(senders, "DELIVERY_SECONDS", DEADLINE_S)
    monkeypatch.setattr(influx, "ANSWER_SECONDS", DEADLINE_S)
    monkeypatch.setattr(postgres, "ANSWER_SECONDS", DEADLINE_S)
    monkeypatch.setattr(mqtt, "OPEN_SECONDS", DEADLINE_S)


@pytest.mark.usefixtures("short_deadlines")
@pytest.mark.parametrize(
    "begin", [b"HTTP/1.1 200 OK\r\nX-Waiting: ", b"HTTP/1.1 ", b"HTTP/1.1 100 Continue\r\n\r\nHTTP/1.1 ", b""]
)
def test_a_web_hook_that_never_ends_its_answer_is_given_up_at_the_deadline(begin: bytes) -> None:
    with dribbling(begin, ENDLESS_HEADER) as peer:
        section = NotifySection.model_validate({"to": [{"name": "a", "webhook": f"http://127.0.0.1:{peer.port}/x"}]})
        error = failure_of(partial(make_senders(section, NotifySecrets())["a"], [MESSAGE], EPOCH))
        assert isinstance(error, UndeliveredError) and "no answer in time" in str(error)
        until(lambda: peer.ended == peer.taken == 1)


@pytest.mark.usefixtures("short_deadlines")
@pytest.mark.parametrize(("begin", "endless"), [(b"220 ", b"x"), (b"220-", b"x\r\n220-"), (b"220 here\r\n250-", b"x")])
def test_a_mail_server_that_never_ends_its_greeting_is_given_up_at_the_deadline(begin: bytes, endless: bytes) -> None:
    with dribbling(begin, endless) as peer:
        error = failure_of(partial(make_senders(mail_section(peer.port), NotifySecrets())["a"], [MESSAGE], EPOCH))
        assert isinstance(error, UndeliveredError) and "no answer in time" in str(error)
        until(lambda: peer.ended == peer.taken == 1)


def test_what_is_no_mail_server_is_said_so() -> None:
    """It was said to answer -1."""
    with dribbling(b"neither code nor word\r\n", b"x") as peer:
        error = failure_of(partial(make_senders(mail_section(peer.port), NotifySecrets())["a"], [MESSAGE], EPOCH))
        assert isinstance(error, UndeliveredError) and str(error) == "the mail server's answer is none of SMTP's"


@pytest.mark.usefixtures("short_deadlines")
@pytest.mark.parametrize("security", ["tls", "starttls"])
def test_encryption_has_no_deadline_of_its_own(security: str, tmp_path: Path) -> None:
    certificates = make_all(tmp_path / "certificates", hosts=["127.0.0.1"])
    tls = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    tls.load_cert_chain(certificates / "server.pem", certificates / "server.key")
    with ExitStack() as stack:
        if security == "tls":  # encrypted at once, and the greeting without an end within it
            peer = stack.enter_context(dribbling(b"220 ", b"x", tls))
        else:  # STARTTLS is agreed to, and the handshake dribbles
            agreed = (b"250-here\r\n250 STARTTLS\r\n", b"220 go on\r\n", b"\x16\x03\x03\x3f\xff")
            peer = stack.enter_context(dribbling(b"220 here\r\n", b"\2", answers=agreed))
        section = mail_section(peer.port, security=security, ca=certificates / "ca.pem")
        error = failure_of(partial(make_senders(section, NotifySecrets())["a"], [MESSAGE], EPOCH))
        assert isinstance(error, UndeliveredError) and "no answer in time" in str(error)


@pytest.mark.usefixtures("short_deadlines")
def test_a_reply_without_end_is_not_kept() -> None:
    """A peer that sends as fast as it can fills no memory until the deadline has come."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        sent = [0]

        def flood() -> None:
            line = listener.accept()[0]
            try:
                while sent[0] < 1 << 28:
                    sent[0] += line.send(b"220-" + b"x" * 500 + b"\r\n")
            except OSError:
                return
            finally:
                line.close()

        thread = threading.Thread(target=flood, daemon=True)
        thread.start()
        section = mail_section(listener.getsockname()[1])
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(senders, "DELIVERY_SECONDS", 60.0)
            error = failure_of(partial(make_senders(section, NotifySecrets())["a"], [MESSAGE], EPOCH))
        assert isinstance(error, UndeliveredError)
        thread.join(60.0)
        assert sent[0] < 1 << 25, "far more was taken than any reply has"


# ---------------------------------------------------------------- northbound

ROW = feed.FollowedRow(
    stream=RowStream("one", "", "samples", 1), key=1, time=EPOCH, position=RowPosition(1, EPOCH),
    values={"tag": "T", "time": EPOCH, "value": 1.0, "quality": 0, "sent": None, "unit": ""},
)  # fmt: skip


@pytest.mark.usefixtures("short_deadlines")
@pytest.mark.parametrize("begin", [b"HTTP/1.1 204 No Content\r\nX-Waiting: ", b"HTTP/1.1 500 x\r\n\r\n", b""])
def test_a_time_series_database_that_never_ends_its_answer_is_given_up(begin: bytes) -> None:
    with dribbling(begin, ENDLESS_HEADER) as peer:
        row = InfluxRow(name="tsdb", url=f"http://127.0.0.1:{peer.port}", database="d")
        sink = influx.InfluxSink(row, None, None)
        sink.open({})
        error = failure_of(lambda: list(sink.deliver([feed.OutgoingRow(ROW, historical=False)])))
        assert isinstance(error, SinkUnreachable) and "no answer in time" in str(error)
        sink.close()
        until(lambda: peer.ended == peer.taken == 1)


def postgres_row(peer: Dribbler) -> PostgresRow:
    return PostgresRow(name="db", host="127.0.0.1", port=peer.port, database="d", user="u")


@pytest.mark.usefixtures("short_deadlines")
def test_a_database_that_lets_in_and_never_answers_a_statement_is_given_up() -> None:
    """It says all that the protocol's start has, and then notices without an end: no time-out of the server's helps."""
    authenticated = b"R\0\0\0\x08\0\0\0\0" + b"K\0\0\0\x0c\0\0\0\1\0\0\0\1" + b"Z\0\0\0\5I"
    notice = b"N\0\0\0\x0cSNOTICE\0\0"
    with dribbling(authenticated, notice) as peer:
        # The first answer to libpq's question for encryption is one byte.
        sink = postgres.PostgresSink(postgres_row(peer), None)
        error = failure_of(lambda: sink.open({}))
        assert isinstance(error, SinkUnreachable)
        sink.close()
        until(lambda: peer.taken and peer.ended == peer.taken)


@pytest.mark.usefixtures("short_deadlines")
def test_a_database_that_is_given_up_in_a_transaction_is_no_line_on_standard_error(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """The library told its own log, which nobody has set up, of each rollback; the sink's sentence says it all."""
    authenticated = b"R\0\0\0\x08\0\0\0\0" + b"K\0\0\0\x0c\0\0\0\1\0\0\0\1" + b"Z\0\0\0\5I"
    with dribbling(b"", b"N\0\0\0\x0cSNOTICE\0\0", answers=(b"N", authenticated)) as peer:
        sink = postgres.PostgresSink(postgres_row(peer), None)
        error = failure_of(lambda: sink.open({}))
        assert isinstance(error, SinkUnreachable) and "no answer in time" in str(error)
        assert [record for record in caplog.records if record.name.startswith("psycopg")] == []
        sink.close()


def test_a_statement_ends_at_the_deadline_whatever_comes_meanwhile() -> None:
    """By psycopg's own machinery: what waits for the connection is resumed, and gives up."""
    connection = postgres.TimedConnection.__new__(postgres.TimedConnection)
    connection.end = 0.0

    def asking() -> Any:
        while True:
            yield 1

    near, far = socket.socketpair()
    with near, far, pytest.raises(TimeoutError):
        psycopg.waiting.wait(connection.limit_time(asking()), near.fileno(), interval=0.01)


@pytest.mark.usefixtures("short_deadlines")
@pytest.mark.parametrize("begin", [b"", b"\x20\x0f", b"\x20\x03\0\0\0\x90\xff\x03"])
def test_a_broker_that_never_ends_its_answer_is_given_up_at_the_deadline(begin: bytes) -> None:
    with dribbling(begin, b"\0") as peer:
        row = MqttRow(name="m", host="127.0.0.1", port=peer.port, tls=False, payload="json", commands=True)
        sink = mqtt.JsonSink(row, None, acknowledge=lambda *_: None)
        error = failure_of(lambda: sink.open({}))
        assert isinstance(error, SinkUnreachable)
        sink.close()
        until(lambda: peer.ended == peer.taken == 1)


@pytest.mark.usefixtures("short_deadlines")
def test_a_brokers_handshake_that_dribbles_is_given_up_at_the_deadline() -> None:
    with dribbling(b"\x16\x03\x03\x3f\xff", b"\2") as peer:
        row = MqttRow(name="m", host="127.0.0.1", port=peer.port, payload="json")
        sink = mqtt.JsonSink(row, None, acknowledge=lambda *_: None)
        error = failure_of(lambda: sink.open({}))
        assert isinstance(error, SinkUnreachable) and "cannot be reached" in str(error)


def test_a_system_that_takes_nothing_is_complained_of(plant: Plant, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each new connection took the complaint away before the alarm was raised."""

    class Deaf:
        dropped = 0
        opened = 0

        def open(self, present: Any) -> None:
            self.opened += 1

        def deliver(self, rows: Any) -> Any:
            raise SinkUnreachable("it does not answer")
            yield 0

        def idle(self, seconds: float, stop: threading.Event) -> None:
            stop.wait(seconds)

        def close(self) -> None:
            return

    sink, reasons = Deaf(), []
    plant.scan(3)
    fed = plant.feed(sink)
    original = fed._begin_session
    monkeypatch.setattr(fed, "_begin_session", lambda: (original(), reasons.append(fed.complaint)))
    until(lambda: sink.opened > 5)
    assert reasons[2:] and all(reasons[2:]), reasons


def test_a_system_that_hangs_is_complained_of_before_it_has_failed(
    plant: Plant, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(feed, "COMPLAIN_SECONDS", 0.1)
    over = threading.Event()

    class Hanging:
        dropped = 0

        def open(self, present: Any) -> None:
            return

        def deliver(self, rows: Any) -> Any:
            over.wait(120.0)
            yield len(rows)

        def idle(self, seconds: float, stop: threading.Event) -> None:
            stop.wait(seconds)

        def close(self) -> None:
            return

    plant.scan(3)
    fed = plant.feed(Hanging())
    try:
        until(lambda: fed.complaint)
        assert fed.reason == "" and "nothing was taken" in fed.complaint
    finally:
        over.set()
    until(lambda: fed.delivered and not fed.complaint)


# ---------------------------------------------------------------- recipients, each by itself

ROWS = [RecipientRow(name="hanging", email="a@example.com"), RecipientRow(name="shift", email="b@example.com")]


def test_recipients_do_not_wait_for_one_another_and_what_is_not_delivered_is_complained_of() -> None:
    hand, over = Hand(), threading.Event()

    def hanging(_: Sequence[AlarmMessage], __: float) -> None:
        over.wait(120.0)
        raise UndeliveredError("it hung")

    ways = {"hanging": hanging, "shift": hand.sender("shift")}
    log: Any = Silent()
    notifier = Notifier(ROWS, ways, now=hand.now, supervisor=Supervisor(), log=log, clock=hand.clock)
    store: Any = Kept()
    notifier.attach("decanter", store, [], known=(HOT.name, "link"))
    try:
        notifier.take("decanter", *raised(hand))
        until(lambda: hand.sent)
        at(hand, notifier, 110.0)
        notifier.take("decanter", *raised(hand, "link"))
        until(lambda: len(hand.sent) == 2)
        assert not notifier.complaint
        at(hand, notifier, 159.9)
        assert not notifier.complaint
        at(hand, notifier, 160.0)
        assert notifier.complaint == "hanging: not delivered yet", "60 s after it was asked for, whatever holds it"
    finally:
        over.set()
        notifier.close()


# ---------------------------------------------------------------- others of the kind


def test_a_name_that_nobody_resolves_is_given_up_at_the_deadline(monkeypatch: pytest.MonkeyPatch) -> None:
    over = threading.Event()
    monkeypatch.setattr(timed_socket.socket, "getaddrinfo", lambda *_, **__: [over.wait(120.0)][1:])
    try:
        error = failure_of(lambda: timed_socket.connect("mail.example.com", 25, timed_socket.monotonic() + DEADLINE_S))
        assert isinstance(error, TimeoutError)
        assert isinstance(failure_of(lambda: call_with_deadline(0.0, lambda: over.wait(120.0))), TimeoutError)
    finally:
        over.set()


def test_a_gateway_that_dribbles_its_reply_is_given_up_at_the_deadline(tmp_path: Path) -> None:
    path, over = tmp_path / "s", threading.Event()
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as listener:
        listener.bind(str(path))
        listener.listen()
        line = GatewayLine(path, DEADLINE_S)
        far = listener.accept()[0]

        def talk() -> None:
            with suppress(OSError):
                while not over.wait(0.02):
                    far.sendall(b"x")

        thread = threading.Thread(target=talk, daemon=True)
        thread.start()
        try:
            assert isinstance(failure_of(lambda: line.ask("status")), TimeoutError)
        finally:
            over.set()
            thread.join(30.0)
            line.close()
            far.close()


def test_a_service_manager_that_reads_nothing_holds_nobody(tmp_path: Path) -> None:
    path = tmp_path / "notify"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind(str(path))
        manager = ServiceManager(str(path))
        done = threading.Event()

        def tell() -> None:
            for _ in range(40):  # far more than its queue holds (net.unix.max_dgram_qlen)
                manager.tell("WATCHDOG=1")
            done.set()

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("gateway.plant.service.PATIENCE_SECONDS", 0.01, raising=False)
            threading.Thread(target=tell, daemon=True).start()
            assert done.wait(60.0), "the gateway hangs with its service manager"


def test_a_certificate_is_still_asked_for(tmp_path: Path) -> None:
    context = make_tls(None)
    assert context.check_hostname and context.verify_mode is ssl.CERT_REQUIRED
    assert context.minimum_version >= ssl.create_default_context().minimum_version

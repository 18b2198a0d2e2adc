"""Of a certificate that is not accepted nothing was said but that; who ended no handshake kept his place for a minute.

Expired, of another name, of another authority: each was CERTIFICATE_VERIFY_FAILED to whom an alarm is mailed. A key
that others may read was taken, one with a password had the start wait at the terminal, and a certificate that was
renewed was shown after the next start.
"""

import asyncio
import socket
import ssl
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.serialization import (
    BestAvailableEncryption,
    Encoding,
    PrivateFormat,
    load_pem_private_key,
)

from drivers.settings import ConfigError
from gateway.network.certificates import application_problem, issue, make_all, make_application, make_authority, write
from gateway.network.key_pair import load_pair
from gateway.outside.northbound import SinkUnreachable, opcua
from gateway.outside.northbound.influx import InfluxSink
from gateway.outside.northbound.mqtt import JsonSink
from gateway.outside.northbound.opcua import OpcUaServer
from gateway.outside.notify import UndeliveredError, make_senders
from gateway.outside.web import check_page
from gateway.outside.web import server as page_server
from gateway.settings import InfluxRow, MqttRow, NotifySecrets, NotifySection, OpcUaSection
from tests.gateway.support import EPOCH, config_in, logged, two_modes
from tests.gateway.test_notify import MESSAGE
from tests.page.served import PAGE, Client, eventually, served

NOW = datetime.now(UTC)
OVER_TLS = PAGE.replace("port = 0", 'port = 0\ncertificates = "tls"')
PATIENCE_S = 40.0
"""Seconds that a peer waits for its end: less than the minute that a handshake once had."""


@contextmanager
def talking(talk: Callable[[socket.socket], None]) -> Iterator[int]:
    """A server on loopback, by its port, that does this to whoever connects, and no more than a minute."""
    threads: list[threading.Thread] = []

    def one(line: socket.socket) -> None:
        line.settimeout(60.0)
        with suppress(OSError), line:
            talk(line)

    def accept() -> None:
        with suppress(OSError):
            while True:
                threads.append(threading.Thread(target=one, args=(listener.accept()[0],), daemon=True))
                threads[-1].start()

    with socket.create_server(("127.0.0.1", 0)) as listener:
        accepting = threading.Thread(target=accept, daemon=True)
        accepting.start()
        yield listener.getsockname()[1]
        with suppress(OSError):
            listener.shutdown(socket.SHUT_RDWR)
    for thread in (accepting, *threads):
        thread.join(60.0)


def shake_hands(context: ssl.SSLContext, line: socket.socket) -> None:
    with context.wrap_socket(line, server_side=True) as secured:
        assert not secured.recv(4096), "something was said to a server that nobody vouches for"


def failure_of(kind: str, port: int, ca: Path) -> str:
    """What is said of a server that has this port, by one of those who connect to one."""
    if kind == "mqtt":
        broker = MqttRow(name="m", host="127.0.0.1", port=port, payload="json", ca=ca)
        with pytest.raises(SinkUnreachable) as unreached:
            JsonSink(broker, "secret", acknowledge=lambda *_: None).open({})
        return str(unreached.value)
    if kind == "influx":
        row = InfluxRow(name="i", url=f"https://127.0.0.1:{port}", bucket="b", ca=ca)
        with pytest.raises(SinkUnreachable) as unreached:
            InfluxSink(row, None, "secret").open({})
        return str(unreached.value)
    server = {"host": "127.0.0.1", "port": port, "sender": "a@example.com", "security": "tls", "ca": ca}
    section = NotifySection.model_validate({"smtp": server, "to": [{"name": "a", "email": "shift@example.com"}]})
    with pytest.raises(UndeliveredError) as undelivered:
        make_senders(section, NotifySecrets())["a"]([MESSAGE], EPOCH)
    return str(undelivered.value)


@pytest.mark.parametrize("kind", ["mqtt", "influx", "mail"])
def test_a_server_that_is_not_vouched_for_is_refused_with_what_is_wrong_and_told_nothing(
    kind: str, tmp_path: Path
) -> None:
    authority, other = make_authority(NOW, 10), make_authority(NOW, 10, "another authority")
    write(tmp_path, "ca", authority)
    long_ago = NOW - timedelta(days=20)
    servers = {
        "certificate has expired": issue(authority, "old", long_ago, 10, hosts=["127.0.0.1"]),
        "not yet valid": issue(authority, "early", NOW + timedelta(days=5), 2, hosts=["127.0.0.1"]),
        "IP address mismatch": issue(authority, "elsewhere", NOW, 10, hosts=["192.0.2.9", "else.example.com"]),
        "unable to get local issuer certificate": issue(other, "foreign", NOW, 10, hosts=["127.0.0.1"]),
        "self-signed certificate": make_authority(NOW, 10, "itself"),
    }
    for reason, signer in servers.items():
        write(tmp_path, "server", signer)
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(tmp_path / "server.pem", tmp_path / "server.key")
        with talking(partial(shake_hands, context)) as port:
            said = failure_of(kind, port, tmp_path / "ca.pem")
        assert "CERTIFICATE_VERIFY_FAILED" in said and reason in said and "secret" not in said, said


@pytest.mark.parametrize("kind", ["mqtt", "influx", "mail"])
def test_a_server_without_tls_is_told_nothing_in_plain(kind: str, tmp_path: Path) -> None:
    write(tmp_path, "ca", make_authority(NOW, 10))
    heard: list[bytes] = []

    def plain(line: socket.socket) -> None:
        heard.append(line.recv(4096))
        line.sendall(b"220 here speaks nobody TLS\r\n")
        heard.append(line.recv(4096))

    with talking(plain) as port:
        assert "it speaks another protocol there" in failure_of(kind, port, tmp_path / "ca.pem")
    assert all(not each or each[0] in (21, 22) for each in heard), "an alert and a handshake of TLS are all"
    assert heard[0][0] == 22


# ---------------------------------------------------------------- a certificate and its key


def damage(folder: Path, how: str, name: str = "server") -> None:
    key = folder / f"{name}.key"
    if how == "readable":
        key.chmod(0o644)
    elif how == "of another":
        make_all(folder / "other", hosts=["127.0.0.1"])
        key.write_bytes((folder / "other/server.key").read_bytes())
    elif how == "with a password":
        made = load_pem_private_key(key.read_bytes(), None)
        key.write_bytes(made.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, BestAvailableEncryption(b"x")))
    elif how == "cut":
        key.write_bytes(key.read_bytes()[:60])
    else:
        key.unlink()


DAMAGES = {
    "readable": "others may read the key (mode 644); chmod 600",
    "of another": "is not the key of",
    "with a password": "asks for a password",
    "cut": "are no certificate and its key",
    "gone": "cannot be read (no such file",
}


@pytest.mark.parametrize("how", DAMAGES)
def test_a_key_that_is_none_is_refused_with_what_is_wrong_of_it(how: str, tmp_path: Path) -> None:
    folder = make_all(tmp_path / "tls", hosts=["127.0.0.1"])
    pair = folder / "server.pem", folder / "server.key"
    load_pair(ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER), *pair)
    config = config_in(tmp_path, OVER_TLS, model=two_modes())
    check_page(config)
    damage(folder, how)
    with pytest.raises(ConfigError) as refused:
        check_page(config)
    (sentence,) = refused.value.problems
    assert "page.certificates: " in sentence and DAMAGES[how] in sentence
    # The broker's client has a pair of its own: it says so too, and connects with nothing.
    with talking(lambda line: None) as port:
        broker = MqttRow(
            name="m",
            host="127.0.0.1",
            port=port,
            payload="json",
            ca=folder / "ca.pem",
            certificate=pair[0],
            key=pair[1],
        )
        with pytest.raises(SinkUnreachable) as unreached:
            JsonSink(broker, None, acknowledge=lambda *_: None).open({})
    assert DAMAGES[how] in str(unreached.value)


def test_a_key_of_opc_ua_that_others_may_read_is_refused(tmp_path: Path) -> None:
    folder = make_application(tmp_path, hosts=["127.0.0.1"])
    assert application_problem(folder) is None
    damage(folder, "readable", "opcua")
    assert "others may read the key (mode 644)" in str(application_problem(folder))


# ---------------------------------------------------------------- the page


def secured(port: int, folder: Path) -> ssl.SSLSocket:
    """A connection to the page, by whose certificate `folder` knows it."""
    context = ssl.create_default_context(cafile=str(folder / "ca.pem"))
    line = socket.create_connection(("127.0.0.1", port), PATIENCE_S)
    return context.wrap_socket(line, server_hostname="127.0.0.1")


def test_who_ends_no_handshake_is_let_go_and_others_are_served(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(page_server, "IDLE_S", 0.5)
    folder = make_all(tmp_path / "tls", hosts=["127.0.0.1"])
    with served(tmp_path, OVER_TLS) as gateway:
        begun = (b"", b"\x16", b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03", b"GET / HTTP/1.1\r\n\r\n")
        lines = [socket.create_connection(("127.0.0.1", gateway.port), PATIENCE_S) for _ in begun]
        for line, said in zip(lines, begun, strict=True):
            line.sendall(said)
        with secured(gateway.port, folder) as well:
            assert well.version() in ("TLSv1.2", "TLSv1.3")
        for line in lines:
            answer = b""
            with suppress(ConnectionError), line:
                while data := line.recv(4096):
                    answer += data
            assert not answer or answer[0] == 21, "nothing but an alert of TLS is said in plain"


def test_a_certificate_that_is_renewed_is_shown_and_one_that_is_none_changes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(page_server, "CERTIFICATE_LOOK_S", 0.05, raising=False)
    folder = make_all(tmp_path / "tls", hosts=["127.0.0.1"])
    renewed = make_all(tmp_path / "renewed", hosts=["127.0.0.1"])

    def shown(by: Path) -> bool:
        with suppress(ssl.SSLCertVerificationError), secured(gateway.port, by):
            return True
        return False

    with served(tmp_path, OVER_TLS) as gateway:
        assert shown(folder) and not shown(renewed)
        # Between one file and the other the two do not belong together.
        (folder / "server.pem").write_bytes((renewed / "server.pem").read_bytes())
        eventually(lambda: [line for line in logged(tmp_path) if line["event"].startswith("the page keeps its former")])
        assert shown(folder) and not shown(renewed)
        (folder / "server.key").write_bytes((renewed / "server.key").read_bytes())
        eventually(lambda: shown(renewed))
        assert not shown(folder)
        with pytest.raises((ConnectionError, OSError)):
            Client(gateway.port).ask("GET", "/api/plant")
        (line,) = [line for line in logged(tmp_path) if line["event"] == "the page has a new certificate"]
        assert line["folder"] == str(folder)


# ---------------------------------------------------------------- OPC UA


def test_who_opens_no_session_of_opc_ua_is_let_go(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(opcua, "ACTIVATION_SECONDS", 0.5, raising=False)
    folder = make_application(tmp_path, hosts=["127.0.0.1"])

    async def hold() -> None:
        section = OpcUaSection(port=0, certificates=folder, most_clients=2)
        server = OpcUaServer(section, dict, tags=dict, historian=tmp_path / "none.sqlite")
        thread = threading.Thread(target=server.run, daemon=True)
        thread.start()
        try:
            assert await asyncio.to_thread(server.loaded.wait, 120.0)
            async with asyncio.timeout(29.0 + 60.0):
                while True:
                    with suppress(OSError):
                        silent = [await asyncio.open_connection("127.0.0.1", server.port) for _ in range(2)]
                        break
                    await asyncio.sleep(0.05)
            async with asyncio.timeout(25.0):  # once it was half a minute
                for reader, writer in silent:
                    assert await reader.read() == b""
                    writer.close()
        finally:
            server.close()
            await asyncio.to_thread(thread.join, 60.0)

    asyncio.run(hold())

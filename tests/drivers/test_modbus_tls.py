"""Modbus/TCP Security: who is not to be trusted is not, and each failure has a sentence of its own."""

import asyncio
import contextlib
import datetime as dt
import shutil
import socket
import ssl
import threading
import time
from collections.abc import AsyncIterator, Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from drivers.errors import DeviceException, LinkDown
from drivers.modbus.driver import ModbusDriver, open_modbus
from drivers.modbus.tls import cautions, load_identity, sentence
from drivers.tag import Quality, Tag
from gateway.network.certificates import Signer
from tests.drivers import certified
from tests.drivers.scripted import ScriptedPlc, mbap

A = Tag("a", "holding:10")


@pytest.fixture
async def secured(tmp_path: Path) -> AsyncIterator[ScriptedPlc]:
    plc = ScriptedPlc(context=certified.server_context(tmp_path / "server"))
    await plc.start()
    yield plc
    await plc.stop()


async def opened(plc: "ScriptedPlc | AlertingServer", folder: Path, **settings: Any) -> ModbusDriver:
    given = {"transport": "tls", "host": "127.0.0.1", "port": plc.port, "certificates": str(folder), **settings}
    driver = open_modbus(given, clock=time.time)
    try:
        await driver.open()
    except LinkDown:
        await driver.close()
        raise
    return driver


async def reason_of(plc: "ScriptedPlc | AlertingServer", folder: Path, **settings: Any) -> str:
    """Why nothing can be read: at once by our own check, or by the server's word with the first reading."""
    try:
        driver = await opened(plc, folder, **settings)
    except LinkDown as error:
        return str(error)
    (sample,) = await driver.read([A])
    await driver.close()
    assert sample.value is None and sample.quality.is_bad
    return sample.reason


class AlertingServer:
    """A server whose OpenSSL sends its alerts, as devices do; asyncio's closes the connection without a word."""

    def __init__(self, context: ssl.SSLContext) -> None:
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.port = self.listener.getsockname()[1]
        self.context = context
        self.thread = threading.Thread(target=self._serve, daemon=True)
        self.thread.start()

    def _serve(self) -> None:
        while True:
            try:
                connection, _ = self.listener.accept()
            except OSError:
                return
            secure = self.context.wrap_socket(connection, server_side=True, do_handshake_on_connect=False)
            with secure:
                with contextlib.suppress(OSError):
                    secure.do_handshake()
                # What is unread when a socket is closed makes the kernel reset the connection, and a
                # reset can overtake the alert that this server is here to send.
                with contextlib.suppress(OSError):
                    secure.settimeout(60)
                    secure.shutdown(socket.SHUT_WR)
                    while secure.recv(4096):
                        pass

    def close(self) -> None:
        self.listener.shutdown(socket.SHUT_RDWR)
        self.listener.close()
        self.thread.join(60)


@pytest.fixture
def alerting(tmp_path: Path) -> Iterator[Callable[[ssl.SSLContext], AlertingServer]]:
    servers: list[AlertingServer] = []

    def serve(context: ssl.SSLContext) -> AlertingServer:
        servers.append(AlertingServer(context))
        return servers[-1]

    yield serve
    for server in servers:
        server.close()


async def restarted(plc: ScriptedPlc, context: ssl.SSLContext | None) -> None:
    await plc.stop()
    plc.context = context
    await plc.start()


async def test_a_secured_reading_is_as_any_other_and_speaks_at_least_tls_1_2(
    secured: ScriptedPlc, tmp_path: Path
) -> None:
    driver = await opened(secured, certified.folder(tmp_path / "c"))
    (sample,) = await driver.read([A])
    assert (sample.value, sample.quality) == (10, Quality.GOOD)
    assert load_identity(tmp_path / "c").context.minimum_version == ssl.TLSVersion.TLSv1_2
    await driver.close()


async def test_a_reply_split_over_two_tls_records_is_put_together(secured: ScriptedPlc, tmp_path: Path) -> None:
    """pymodbus by itself takes each record for a frame; see tests/drivers/test_pymodbus_contract.py."""

    async def in_two(plc: ScriptedPlc, request: bytes, honest: bytes, writer: asyncio.StreamWriter) -> None:
        for part in (honest[:4], honest[4:9], honest[9:]):
            writer.write(part)
            await asyncio.sleep(0.01)

    secured.bend = in_two
    driver = await opened(secured, certified.folder(tmp_path / "c"))
    for _ in range(3):
        assert (await driver.read([A]))[0].value == 10
    await driver.close()


@pytest.mark.parametrize(
    ("server", "said"),
    [
        ({"of_server": certified.server(expired=True)}, "the PLC's certificate has expired"),
        ({"of_server": certified.server("another")}, "is not from the authority in ca.pem"),
        ({"of_server": certified.server(hosts=("plc.example",))}, "is for another"),
    ],
    ids=["expired", "wrong authority", "wrong name"],
)
async def test_a_server_that_is_not_to_be_trusted_is_said(
    secured: ScriptedPlc, tmp_path: Path, server: dict[str, Any], said: str
) -> None:
    await restarted(secured, certified.server_context(tmp_path / "other", **server))
    assert said in await reason_of(secured, certified.folder(tmp_path / "c"))


@pytest.mark.parametrize(
    ("of_client", "said"),
    [
        (certified.client(expired=True), "the PLC refuses our certificate (client.pem): it has expired"),
        (certified.client("another"), "the PLC does not know the authority of our certificate (client.pem)"),
    ],
    ids=["expired", "of another authority"],
)
async def test_a_server_that_refuses_us_is_quoted(
    alerting: Callable[[ssl.SSLContext], AlertingServer], tmp_path: Path, of_client: Signer, said: str
) -> None:
    server = alerting(certified.server_context(tmp_path / "server"))
    assert said in await reason_of(server, certified.folder(tmp_path / "c", of_client=of_client))


async def test_a_server_that_refuses_us_without_a_word_is_guessed_at(secured: ScriptedPlc, tmp_path: Path) -> None:
    folder = certified.folder(tmp_path / "c", of_client=certified.client("another"))
    assert "it may not accept our certificate" in await reason_of(secured, folder)


async def test_no_certificate_at_all_is_said(
    alerting: Callable[[ssl.SSLContext], AlertingServer], tmp_path: Path
) -> None:
    """A driver cannot be configured like this; the sentence is for what stands between and strips it."""
    server = alerting(certified.server_context(tmp_path / "server"))
    context = ssl.create_default_context(cafile=str(tmp_path / "server" / "trusted.pem"))
    reader, writer = await asyncio.open_connection("127.0.0.1", server.port, ssl=context)
    with pytest.raises(ssl.SSLError) as caught:
        await reader.readexactly(1)
    writer.close()
    assert sentence(caught.value) == "the PLC demands a client certificate and got none"


async def test_a_server_without_tls_and_one_that_closes_are_said(secured: ScriptedPlc, tmp_path: Path) -> None:
    folder = certified.folder(tmp_path / "c")

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.read(1)
        writer.write(mbap(1, 1, b"\x83\x01") + b"plain Modbus TCP")
        writer.close()

    await secured.stop()
    plain = await asyncio.start_server(serve, "127.0.0.1", secured.port)
    assert "speaks no TLS" in await reason_of(secured, folder, connect_timeout=0.3)
    plain.close()

    async def hang_up(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.transport.abort()

    closing = await asyncio.start_server(hang_up, "127.0.0.1", secured.port)
    assert "broke the connection off in the TLS handshake" in await reason_of(secured, folder)
    closing.close()
    await asyncio.sleep(0.02)


async def test_the_name_in_the_certificate_may_be_given(secured: ScriptedPlc, tmp_path: Path) -> None:
    other = certified.server_context(tmp_path / "other", of_server=certified.server(hosts=("plc.example",)))
    await restarted(secured, other)
    driver = await opened(secured, certified.folder(tmp_path / "c"), tls_name="plc.example")
    assert (await driver.read([A]))[0].value == 10
    await driver.close()


async def test_exception_1_says_that_it_may_be_the_role(secured: ScriptedPlc, tmp_path: Path) -> None:
    secured.exception = 1
    folder = certified.folder(tmp_path / "c", of_client=certified.client(role="Viewer"))
    setpoint = Tag("setpoint", "holding:20")
    given = {"transport": "tls", "host": "127.0.0.1", "port": secured.port, "certificates": str(folder)}
    driver = open_modbus(given, clock=time.time, write_map=(setpoint,))
    await driver.open()
    (sample,) = await driver.read([A])
    assert sample.reason.endswith("or the role 'Viewer' of our certificate does not allow it")
    with pytest.raises(DeviceException, match="role 'Viewer'"):
        await driver.write([(setpoint, 1)])
    await driver.close()


@pytest.mark.parametrize("later", ["Operator", None])
async def test_the_role_is_that_of_the_certificate_which_the_plc_was_shown(
    secured: ScriptedPlc, tmp_path: Path, later: str | None
) -> None:
    secured.exception = 1
    folder = certified.folder(tmp_path / "c", of_client=certified.client(role="Viewer"))
    driver = await opened(secured, folder)
    if later is None:
        (folder / "client.pem").unlink()
    else:
        certified.folder(folder, of_client=certified.client(role=later))
    (sample,) = await driver.read([A])
    assert sample.reason.endswith("or the role 'Viewer' of our certificate does not allow it")
    await driver.close()


# ------------------------------------------------------------------ our own files


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda folder: (folder / "client.key").unlink(), "has no client.key"),
        (lambda folder: (folder / "ca.pem").write_text("nothing"), "cannot be used"),
        (lambda folder: certified.write(folder, "client", certified.client("another")), ""),
        (lambda folder: (folder / "client.key").write_bytes((folder / "ca.key").read_bytes()), "KEY_VALUES_MISMATCH"),
    ],
    ids=["missing", "no certificate", "another pair is fine here", "key of another certificate"],
)
async def test_certificates_that_cannot_be_used_are_a_link_that_is_down_until_they_are_whole(
    secured: ScriptedPlc, tmp_path: Path, spoil: Any, said: str
) -> None:
    folder, whole = certified.folder(tmp_path / "c"), tmp_path / "whole"
    shutil.copytree(folder, whole)
    spoil(folder)
    given = {"transport": "tls", "host": "127.0.0.1", "port": secured.port, "certificates": str(folder)}
    driver = open_modbus({**given, "backoff_first": 0.01, "backoff_cap": 0.02}, clock=time.time)
    try:
        if not said:
            await driver.open()
            return
        with pytest.raises(LinkDown) as caught:
            await driver.open()
        assert said in str(caught.value) and str(folder) in str(caught.value)
        assert driver.cautions() == (str(caught.value),)
        (sample,) = await driver.read([A])
        assert said in sample.reason and sample.quality.is_bad
        for path in whole.iterdir():
            shutil.copy2(path, folder / path.name)
        async with asyncio.timeout(60.0):
            while not (await driver.read([A]))[0].quality.is_good:
                await asyncio.sleep(0.01)
        assert driver.cautions() == ()
    finally:
        await driver.close()


def test_a_key_that_others_may_read_an_end_that_is_near_and_a_missing_role_are_cautions(tmp_path: Path) -> None:
    folder = certified.folder(tmp_path / "c", of_client=certified.client(role=""))
    now = certified.NOW
    assert [said.split(" has no role")[0] for said in cautions(folder, now)] == [str(folder / "client.pem")]
    (folder / "client.key").chmod(0o640)
    said = cautions(folder, now + dt.timedelta(days=90))
    assert said[0].endswith("client.key can be read by others (mode 640): chmod 600 it")
    assert "expires in 9 days" in said[1] or "expires in 10 days" in said[1]
    assert "has expired" in cautions(folder, now + dt.timedelta(days=200))[1]


async def test_a_driver_gives_its_cautions_and_one_without_tls_has_none(tmp_path: Path) -> None:
    folder = certified.folder(tmp_path / "c")
    (folder / "client.key").chmod(0o644)
    given = {"transport": "tls", "host": "127.0.0.1", "certificates": str(folder)}
    assert len(open_modbus(given, clock=time.time).cautions()) == 1
    assert open_modbus({"host": "127.0.0.1"}, clock=time.time).cautions() == ()

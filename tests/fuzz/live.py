"""Sides that need more than bytes: TLS on both ends, the software PLC behind sockets and a terminal, control lines."""

import asyncio
import base64
import io
import os
import socket
import ssl
import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from itertools import count
from pathlib import Path
from random import Random
from typing import Any

from cryptography.hazmat.primitives.serialization import Encoding

from drivers import json_lines
from drivers.modbus import rtu
from drivers.modbus.tls import load_identity, sentence
from drivers.modbus.verify import split_frames
from gateway.machine import Machine
from gateway.plant.control import ControlScope, answer
from gateway.plant.log import open_log
from gateway.plant.status import snapshot
from sim.plc.control import obey
from sim.plc.modbus import serial_line
from sim.plc.modbus.framing import GAP_S
from sim.plc.modbus.serial_line import OWN_PAIR
from sim.plc.modbus.server import ModbusServer
from sim.plc.modbus.tls import certificate_role as role_at_server
from sim.plc.modbus.tls import server_context
from sim.plc.program import ModbusRequest, Plc
from sim.strict_json import strict
from tests.drivers import certified
from tests.fuzz.target import Run, check_sentence
from tests.gateway.support import Bench, JumpClock, as_driver, config_in
from tests.plc.bench import DECANTER
from tests.plc.test_pdu import plc_of

MakeFace = Callable[[Plc, Mapping[str, Any], Callable[[str], None]], Any]
"""Makes a face of the PLC from options of the command line."""
WITHIN = 20.0
ASKED_AGAIN = 20
IDENTIFY = b"\x2b\x0e\x01\x00"
RESET_ON_CLOSE = struct.pack("ii", 1, 0)


# ---------------------------------------------------------------- TLS


class Ends:
    """A client and a server of TLS, joined by memory."""

    def __init__(self, client: ssl.SSLContext, server: ssl.SSLContext) -> None:
        self._to_client, self._to_server = ssl.MemoryBIO(), ssl.MemoryBIO()
        self.client = client.wrap_bio(self._to_client, self._to_server, server_hostname="localhost")
        self.server = server.wrap_bio(self._to_server, self._to_client, server_side=True)

    def fed(self, side: ssl.SSLObject) -> ssl.MemoryBIO:
        """What a side reads from."""
        return self._to_client if side is self.client else self._to_server

    def handshake(self, side: ssl.SSLObject) -> bool:
        """As far as it goes now; True when it is over. Raises SSLError."""
        try:
            side.do_handshake()
        except ssl.SSLWantReadError:
            return False
        return True


def tls_side(of_server: bool) -> Callable[[Path], AbstractContextManager[Run]]:
    """One end of TLS, the other's records being cut, mixed and made up.

    The first byte says when: instead of the other's flight so many (0 to 2), as records after the handshake (3), or as
    what the other really sends inside TLS (4). What comes out of a made-up record is never data.
    """

    @contextmanager
    def bench(folder: Path) -> Iterator[Run]:
        certified.for_plc(folder)
        contexts = load_identity(folder).context, server_context(folder)

        def run(data: bytes) -> object:
            ends, when, rest = Ends(*contexts), (data[:1] or b"\0")[0] % 5, data[1:]
            side, other = (ends.server, ends.client) if of_server else (ends.client, ends.server)
            try:
                # The client speaks first; who is fuzzed sees the other's flights.
                for flight in range(4):
                    done = ends.handshake(other)
                    if flight == when:
                        ends.fed(side).read()
                        ends.fed(side).write(rest)
                    if ends.handshake(side) and done:
                        break
                sent = rest or b"\0"
                if when == 4:
                    other.write(sent)
                else:
                    ends.fed(side).write(rest)
                ends.fed(side).write_eof()
                read = side.read(1 << 16)
                assert when == 4 and read == sent, "data out of a record that nobody made"
                return split_frames(read)
            except ssl.SSLError as error:
                check_sentence(sentence(error))
                return None

        yield run

    return bench


def records() -> Sequence[bytes]:
    """For `tls_side`: made-up records of each kind, a hello of a real client, and a Modbus frame to be sent inside."""
    incoming, outgoing = ssl.MemoryBIO(), ssl.MemoryBIO()
    client = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT).wrap_bio(incoming, outgoing, server_hostname="localhost")
    with suppress(ssl.SSLWantReadError):
        client.do_handshake()
    alerts = b"\x15\3\3\0\2\2\x28", b"\x15\3\3\0\2\1\0"
    frame = b"\0\7\0\0\0\7\1\3\4\0\x0b\0\x16"
    return [
        b"\4" + frame, b"\0" + outgoing.read(), *(b"\1" + alert for alert in alerts), b"\2\x16\3\3\0\4\x0e\0\0\0",
        b"\3\x17\3\3\0\x20" + bytes(32), b"\3" + frame, b"\3\x14\3\3\0\1\1",
    ]  # fmt: skip


@contextmanager
def tls_files(folder: Path) -> Iterator[Run]:
    """A client's certificate (DER) in a folder whose other files are right, and its role at both ends."""
    certified.for_plc(folder)

    def run(data: bytes) -> object:
        role_at_server(data)
        body = base64.encodebytes(data).decode()
        (folder / "client.pem").write_text(f"-----BEGIN CERTIFICATE-----\n{body}-----END CERTIFICATE-----\n")
        return load_identity(folder).role

    yield run


def client_certificate() -> bytes:
    """A valid one, as DER."""
    return certified.client().certificate.public_bytes(Encoding.DER)


# ---------------------------------------------------------------- the software PLC's own servers


@contextmanager
def _served(make: MakeFace, options: Mapping[str, Any]) -> Iterator[tuple[asyncio.Runner, Any, bytes, bytes]]:
    """A face of a PLC on a loop of its own, a question that every input leaves alone (who are you?), and its answer.

    Fails for what a task of the face raised and nobody heard.
    """
    plc, unheard = plc_of(DECANTER), list[object]()
    framed = "serial" in options or "rtu_tcp" in options
    reply = plc.exchange(ModbusRequest("fuzz", 1, 1, IDENTIFY, rtu=framed), 0.0)
    assert reply is not None
    question = b"\1" + IDENTIFY + rtu.crc(b"\1" + IDENTIFY) if framed else b"\0\1\0\0\0\5\1" + IDENTIFY

    async def opened() -> Any:
        face = make(plc, {"host": "127.0.0.1", "max_clients": 8, **options}, unheard.append)
        await face.open()
        return face

    with asyncio.Runner() as runner:
        runner.get_loop().set_exception_handler(lambda _, context: unheard.append(context))
        face = runner.run(opened())
        try:
            yield runner, face, question, reply.frame()
        finally:
            runner.run(face.close())
    assert not unheard, unheard[0]


def make_tcp(plc: Plc, options: Mapping[str, Any], complain: Callable[[str], None]) -> ModbusServer:
    """The face that is always there."""
    return ModbusServer(plc, options["host"], 0, options["max_clients"], complain)


def plc_over_tcp(make: MakeFace, **options: Any) -> Callable[[Path], AbstractContextManager[Run]]:
    """A connection for each input; after it the PLC is asked on another one who it is, and says so."""

    @contextmanager
    def bench(folder: Path) -> Iterator[Run]:
        secured = {"tls": certified.for_plc(folder)} if "tls_port" in options else {}
        tls: dict[str, Any] = {"ssl": load_identity(folder).context, "server_hostname": "localhost"} if secured else {}
        with _served(make, {**options, **secured}) as (runner, face, question, answer_):
            reader, writer = runner.run(asyncio.open_connection("127.0.0.1", face.port, **tls))

            async def exchange(data: bytes) -> bytes:
                replies, hostile = await asyncio.open_connection("127.0.0.1", face.port)
                got = b""
                with suppress(ConnectionError):  # reset, as it had not read everything
                    hostile.write(data)
                    hostile.write_eof()
                    got = await asyncio.wait_for(replies.read(), WITHIN)
                # A reset, so that thousands of connections do not use up the ports.
                hostile.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESET_ON_CLOSE)
                hostile.transport.abort()
                writer.write(question)
                assert await asyncio.wait_for(reader.readexactly(len(answer_)), WITHIN) == answer_
                return got

            yield lambda data: runner.run(exchange(data))
            writer.transport.abort()

    return bench


@contextmanager
def plc_on_a_line(_: Path) -> Iterator[Run]:
    """Each input on the line, and after it the question: asked again, as a client does, until noise has passed."""
    with _served(serial_line.make, {"serial": OWN_PAIR, "baud": 19200, "parity": "N", "serial_echo": False}) as (
        runner,
        face,
        question,
        answer_,
    ):
        handle = os.open(face.path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)

        async def heard(wanted: bytes) -> bytes:
            got, clock = b"", asyncio.get_running_loop().time
            until = clock() + 2 * GAP_S
            while not got.endswith(wanted) and clock() < until:
                await asyncio.sleep(0.002)
                with suppress(BlockingIOError):
                    got += os.read(handle, 4096)
            return got

        async def exchange(data: bytes) -> None:
            os.write(handle, data)
            for _ in range(ASKED_AGAIN):
                os.write(handle, question)
                if (await heard(answer_)).endswith(answer_):
                    return
            raise AssertionError("the PLC does not say any more who it is")

        yield lambda data: runner.run(exchange(data))
        os.close(handle)


# ---------------------------------------------------------------- control lines


@contextmanager
def gateway_control(folder: Path) -> Iterator[Run]:
    """A line to a gateway at rest: one reply, which is JSON, and a reason in one line where nothing was done."""
    config, clock = config_in(folder), JumpClock()
    with open_log(None, "error", io.StringIO()) as log, asyncio.Runner() as runner:
        machine = Machine(config, driver=as_driver(Bench(config, clock)), clock=clock, log=log, rng=Random(0))

        def run(data: bytes) -> object:
            reply = strict(runner.run(answer(ControlScope({"decanter": machine}, snapshot), data)))
            json_lines.format_object(reply)
            if not reply["ok"]:
                check_sentence(reply["reason"])
            return reply

        yield run
        machine.close()


@contextmanager
def plc_control(_: Path) -> Iterator[Run]:
    """As `gateway_control`, for the software PLC; a cycle after each line does what it asked for."""
    plc = plc_of(DECANTER)
    moments = count()

    def run(data: bytes) -> object:
        now = 0.02 * next(moments)
        reply = obey(plc, data, now)
        json_lines.format_object(reply)
        if not reply["ok"]:
            check_sentence(str(reply["error"]))
        plc.cycle(now)
        plc.schedule.clear(None)
        return reply

    yield run

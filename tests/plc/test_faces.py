"""The faces beside Modbus TCP: one image behind all of them, each with its own frames, rights and faults."""

import os
import socket
import ssl
import struct
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from sim.plc.faces import FACES
from sim.plc.program.faults import FAULT_FACES, FAULTS
from sim.plc.record.recording import read_recording
from tests.drivers import certified
from tests.drivers.scripted_line import rtu
from tests.plc.bench import PATIENCE_S, Process, Raw, block, client, ramp, refusal, running, wait_until

READ = struct.pack(">BHH", 3, 101, 1)
"""Assorbimento, which the ramp moves."""


@contextmanager
def secured(plc: Process, folder: Path) -> Iterator[Raw]:
    context = ssl.create_default_context(cafile=str(folder / "ca.pem"))
    context.load_cert_chain(folder / "client.pem", folder / "client.key")
    place = ("127.0.0.1", plc.ready["faces"]["tls"]["port"])
    with (
        socket.create_connection(place, timeout=PATIENCE_S) as plain,
        context.wrap_socket(plain, server_hostname="localhost") as sock,
    ):
        yield Raw(sock)


def over_tcp(plc: Process, data: bytes, size: int) -> bytes:
    """Bytes to the RTU-over-TCP face, and so many back."""
    with socket.create_connection(("127.0.0.1", plc.ready["faces"]["rtu-tcp"]["port"]), timeout=PATIENCE_S) as sock:
        sock.sendall(data)
        return Raw(sock).exactly(size)


class Terminal:
    """The client's end of the PLC's pair."""

    def __init__(self, plc: Process) -> None:
        self.handle = os.open(plc.ready["faces"]["serial"]["path"], os.O_RDWR | os.O_NOCTTY)

    def ask(self, data: bytes, size: int, within: float = PATIENCE_S) -> bytes:
        """Bytes onto the line, and up to so many back."""
        os.write(self.handle, data)
        got, until = b"", time.monotonic() + within
        os.set_blocking(self.handle, False)
        while len(got) < size and time.monotonic() < until:
            try:
                got += os.read(self.handle, size - len(got))
            except BlockingIOError:
                time.sleep(0.002)
        return got


def test_all_faces_show_one_image_at_once(tmp_path: Path) -> None:
    folder = certified.for_plc(tmp_path / "c")
    options = ("--serial", "pty", "--rtu-tcp", "0", "--tls", folder, "--trace", ramp(tmp_path), "--hold")
    with running(*options) as plc, client(plc.port) as raw, secured(plc, folder) as tls:
        plc.order("force", tag="Assorbimento", value=123.4)
        wait_until(lambda: raw.words(101) == [1234])
        assert tls.words(101) == [1234]
        assert over_tcp(plc, rtu(1, READ), 7) == rtu(1, b"\x03\x02" + struct.pack(">H", 1234))
        assert Terminal(plc).ask(rtu(1, READ), 7) == rtu(1, b"\x03\x02" + struct.pack(">H", 1234))
        assert set(plc.ready["faces"]) >= {"tcp", "serial", "rtu-tcp", "tls"}


def test_a_block_over_one_face_is_taken_in_and_seen_over_another(tmp_path: Path) -> None:
    record = tmp_path / "plc.jsonl"
    with running("--serial", "pty", "--record", record) as plc, client(plc.port) as raw:
        words = block(sequence=5, heartbeat=9)
        pdu = struct.pack(f">BHHB{len(words)}H", 16, 400, len(words), 2 * len(words), *words)
        assert Terminal(plc).ask(rtu(1, pdu), 8) == rtu(1, struct.pack(">BHH", 16, 400, len(words)))
        assert raw.words(400, len(words)) == words
        assert plc.order("status")["accepted"] == 1
        plc.stop()
    (taken,) = read_recording(record).blocks
    assert taken.accepted and taken.peer.startswith("/dev/pts/")


def test_a_line_with_noise_before_and_between_requests_still_serves(tmp_path: Path) -> None:
    with running("--serial", "pty") as plc:
        line = Terminal(plc)
        assert line.ask(b"\x55\xaa\x01", 1, within=0.2) == b""
        assert len(line.ask(rtu(1, READ), 7)) == 7
        assert line.ask(rtu(1, READ)[:-1] + b"\0", 7, within=0.2) == b"", "a wrong CRC is passed over"
        assert line.ask(rtu(2, READ), 7, within=0.2) == b"", "another unit's request is passed over"
        assert line.ask(rtu(0, READ), 7, within=0.2) == b"", "nobody answers a broadcast"
        assert len(line.ask(rtu(1, READ), 7)) == 7


def test_an_adapters_echo_comes_before_the_reply() -> None:
    with running("--serial", "pty", "--serial-echo") as plc:
        request = rtu(1, READ)
        assert Terminal(plc).ask(request, 15).startswith(request + b"\x01\x03\x02")


def test_the_faults_of_single_faces_are_in_the_table_and_wrong_checksum_is_one(tmp_path: Path) -> None:
    assert set(FAULT_FACES) <= set(FAULTS)
    assert FAULT_FACES["wrong_checksum"] == ("serial", "rtu-tcp")
    with running("--serial", "pty", "--rtu-tcp", "0") as plc, client(plc.port) as raw:
        plc.fault("wrong_checksum")
        for reply in (Terminal(plc).ask(rtu(1, READ), 7), over_tcp(plc, rtu(1, READ), 7)):
            assert reply[:3] == b"\x01\x03\x02" and rtu(1, reply[1:-2]) != reply
        assert raw.ask(READ)[:2] == b"\x03\x02"


def test_a_fault_of_one_face_leaves_the_others_alone() -> None:
    with running("--rtu-tcp", "0") as plc, client(plc.port) as raw:
        plc.fault("exception", code=6, face="rtu-tcp")
        assert over_tcp(plc, rtu(1, READ), 5) == rtu(1, b"\x83\x06")
        assert raw.ask(READ)[0] == 3
        plc.order("clear")
        plc.fault("refuse", face="rtu-tcp")
        with pytest.raises(ConnectionRefusedError):
            over_tcp(plc, rtu(1, READ), 5)
        assert raw.ask(READ)[0] == 3


def test_a_fault_of_the_whole_plc_takes_no_face(plain_plc: Process) -> None:
    reply = plain_plc.order("fault", fault={"kind": "frozen", "face": "tcp"})
    assert not reply["ok"] and "strikes the program behind all faces; leave it out" in reply["error"]


# ------------------------------------------------------------------ roles


@pytest.fixture(scope="module")
def tls_record(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("tls") / "plc.jsonl"


@pytest.fixture(scope="module")
def tls_plc(tls_record: Path) -> Iterator[Process]:
    with running("--tls", certified.for_plc(tls_record.parent / "c"), "--record", tls_record) as plc:
        yield plc


@pytest.mark.parametrize(
    ("role", "reads", "writes"),
    [("Gateway", True, True), ("Viewer", True, False), ("Stranger", False, False), ("", False, False)],
)
def test_a_role_may_do_what_the_table_says_and_exception_1_is_the_answer_to_all_else(
    tls_plc: Process, tls_record: Path, tmp_path: Path, role: str, reads: bool, writes: bool
) -> None:
    folder = certified.folder(tmp_path / "c", of_client=certified.client(role=role))
    before = tls_plc.order("status")["accepted"]
    with secured(tls_plc, folder) as raw:
        assert raw.ask(READ)[0] == (3 if reads else 0x83)
        answer = raw.write(400, block(sequence=1, heartbeat=1))
        assert answer[0] == 16 if writes else answer == b"\x90\x01"
        assert tls_plc.order("status")["accepted"] - before == int(writes)
    recording = read_recording(tls_record)
    assert recording.requests[-1].exception == (None if writes else 1)
    assert [row for row in recording.events if row.event == "connected"][-1].detail["role"] == role


def test_the_roles_of_the_command_line_replace_the_shipped_ones(tmp_path: Path) -> None:
    folder = certified.for_plc(tmp_path / "c")
    with running("--tls", folder, "--tls-role", "Gateway=read") as plc, secured(plc, folder) as raw:
        assert raw.ask(READ)[0] == 3
        assert raw.write(400, block(sequence=1, heartbeat=1)) == b"\x90\x01"


def test_a_client_without_a_certificate_of_the_authority_is_not_served(tls_plc: Process, tmp_path: Path) -> None:
    folder = certified.folder(tmp_path / "c", of_client=certified.client("another"))
    with pytest.raises((OSError, EOFError)), secured(tls_plc, folder) as raw:
        raw.ask(READ)


# ------------------------------------------------------------------ the command line


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--tls", "nowhere"), "--tls: nowhere: there is no server.pem; make all with `decanter certificates nowhere`"),
        (("--serial", "/dev/nowhere"), "--serial: there is no '/dev/nowhere'; give a serial port"),
    ],
)
def test_a_face_that_cannot_be_made_is_one_sentence_and_code_2(options: tuple[str, ...], said: str) -> None:
    code, stderr = refusal(*options)
    assert code == 2 and said in stderr


def test_a_role_that_makes_no_sense_is_one_sentence(tmp_path: Path) -> None:
    folder = certified.for_plc(tmp_path / "c")
    code, stderr = refusal("--tls", folder, "--tls-role", "Gateway=all")
    assert code == 2 and "'Gateway=all' cannot be read; give ROLE=read or ROLE=write" in stderr


def test_every_face_is_asked_for_by_an_option_of_its_own() -> None:
    for name, kind in FACES.items():
        assert kind.option in {option.name for option in kind.options}, name

"""What the tests of the software PLC share: the process, and a raw client that hides nothing."""

import json
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from click.testing import CliRunner

from sim.plc.__main__ import main

ROOT = Path(__file__).parents[2]
DECANTER = ROOT / "config/devices/decanter_plc.toml"
PATIENCE_S = 300.0
"""For what only has to come at some time: on a busy machine all takes many times as long as on a quiet one."""
HEARTBEAT, PERMIT, ACKNOWLEDGE, ACCEPTED, REFUSED, REFUSAL, USABLE = range(112, 119)
BLOCK, BLOCK_WORDS = 400, 26


def trace_file(folder: Path, rows: Sequence[str], header: str = "time,MarciaDecanter,Assorbimento,TFango") -> Path:
    """A trace with a comment line, the header and the rows."""
    path = folder / "trace.csv"
    path.write_text("\n".join(["# made by a test", header, *rows]) + "\n", encoding="utf-8")
    return path


def ramp(folder: Path, rows: int = 50, step: float = 0.1) -> Path:
    """A trace in which row n has Assorbimento = n A, so that the row can be told from the value."""
    return trace_file(folder, [f"{index * step:.3f},{index % 2},{index},{index / 10}" for index in range(rows)])


@dataclass
class Process:
    """A running PLC: its ready line, and its control channel on stdin and stdout."""

    popen: subprocess.Popen[str]
    ready: dict[str, Any]
    events: list[dict[str, Any]] = field(default_factory=list)

    @property
    def port(self) -> int:
        return int(self.ready["port"])

    def line(self) -> dict[str, Any]:
        assert self.popen.stdout is not None
        text = self.popen.stdout.readline()
        assert text, "the PLC has closed its stdout"
        return dict(json.loads(text))

    def order(self, command: str, **keys: Any) -> dict[str, Any]:
        """Give a command and wait for its reply; other events on the way are kept."""
        assert self.popen.stdin is not None
        self.popen.stdin.write(json.dumps({"command": command, **keys}) + "\n")
        self.popen.stdin.flush()
        while (message := self.line())["event"] != "reply":
            self.events.append(message)
        return message

    def fault(self, kind: str, **keys: Any) -> int:
        """Order a fault from now on; gives its number once the program has taken it in."""
        reply = self.order("fault", fault={"kind": kind, **keys})
        assert reply["ok"], reply
        wait_until(lambda: any(f["in_force"] for f in self.order("status")["faults"]))
        before = self.order("status")["version"]
        wait_until(lambda: self.order("status")["version"] != before or not self.order("status")["running"])
        return int(reply["number"])

    def stop(self) -> None:
        self.popen.terminate()
        self.popen.wait(PATIENCE_S)


def command_line(*options: str | Path, map_path: Path = DECANTER) -> list[str]:
    return [sys.executable, "-m", "sim.plc", "--device", str(map_path), "--challenge", "1", *map(str, options)]


def refusal(*options: str | Path, map_path: Path = DECANTER) -> tuple[int, str]:
    """The exit code and the words on stderr of a PLC that must not start; run in this process."""
    done = CliRunner().invoke(main, ["--device", str(map_path), *map(str, options)])
    assert isinstance(done.exception, SystemExit) and done.stdout == ""
    return done.exit_code, done.stderr


@contextmanager
def running(*options: str | Path, map_path: Path = DECANTER) -> Iterator[Process]:
    """The PLC as a process of its own, stopped at the end whatever happens."""
    command = command_line("--stdin", *options, map_path=map_path)
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe, text=True, cwd=ROOT) as popen:
        try:
            assert popen.stdout is not None and popen.stderr is not None
            first = popen.stdout.readline()
            assert first, popen.stderr.read()
            yield Process(popen, json.loads(first))
        finally:
            popen.kill()


def wait_until(true: Callable[[], bool], patience_s: float = PATIENCE_S) -> None:
    """Return when it is true; fail if it never is."""
    deadline = time.monotonic() + patience_s
    while not true():
        assert time.monotonic() < deadline, "it never came true"
        time.sleep(0.01)


@dataclass
class Raw:
    """A Modbus client that shows every byte."""

    sock: socket.socket
    transaction: int = 0

    def send(self, pdu: bytes, unit: int = 1, protocol: int = 0) -> int:
        self.transaction += 1
        self.sock.sendall(struct.pack(">HHHB", self.transaction, protocol, len(pdu) + 1, unit) + pdu)
        return self.transaction

    def exactly(self, count: int) -> bytes:
        data = b""
        while len(data) < count:
            part = self.sock.recv(count - len(data))
            if not part:
                raise EOFError(f"closed after {data!r}")
            data += part
        return data

    def frame(self) -> tuple[int, int, bytes]:
        """The next frame: transaction, unit, PDU."""
        transaction, protocol, length, unit = struct.unpack(">HHHB", self.exactly(7))
        assert protocol == 0
        return transaction, unit, self.exactly(length - 1)

    def ask(self, pdu: bytes) -> bytes:
        """The PDU of the reply to one request."""
        sent = self.send(pdu)
        transaction, unit, reply = self.frame()
        assert (transaction, unit) == (sent, 1)
        return reply

    def words(self, address: int, count: int = 1, function: int = 3) -> list[int]:
        """Read registers; fails on anything but exactly them."""
        reply = self.ask(struct.pack(">BHH", function, address, count))
        assert reply[:2] == bytes((function, 2 * count)), reply
        return list(struct.unpack(f">{count}H", reply[2:]))

    def write(self, address: int, words: Sequence[int]) -> bytes:
        """The PDU of the reply to a function 16."""
        return self.ask(struct.pack(f">BHHB{len(words)}H", 16, address, len(words), 2 * len(words), *words))

    def silent_for(self, seconds: float) -> bool:
        """True if nothing at all arrives, neither bytes nor an end."""
        self.sock.settimeout(seconds)
        try:
            self.sock.recv(1)
        except TimeoutError:
            return True
        finally:
            self.sock.settimeout(PATIENCE_S)
        return False


@contextmanager
def client(port: int) -> Iterator[Raw]:
    with socket.create_connection(("127.0.0.1", port), timeout=PATIENCE_S) as sock:
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        yield Raw(sock)


def crc(words: Sequence[int]) -> int:
    """CRC-16/IBM-3740 by a table, unlike the PLC's bit by bit."""
    table = []
    for index in range(256):
        value = index << 8
        for _ in range(8):
            value = (value << 1 ^ (0x1021 if value & 0x8000 else 0)) & 0xFFFF
        table.append(value)
    register = 0xFFFF
    for word in words:
        for octet in (word >> 8, word & 0xFF):
            register = (register << 8 & 0xFF00) ^ table[register >> 8 ^ octet]
    return register


def block(
    sequence: int,
    heartbeat: int,
    validity: int = 1,
    version: int = 2,
    temperature: int = 4512,
    *,
    challenge: int = 1,
    writer: int = 4711,
) -> list[int]:
    """A whole write-back block of the decanter's layout."""
    words = [version, sequence, heartbeat, validity, 0, 3, 2, temperature, 4400, 4600, 300, 4500, 4700, 4900]
    words += [12, 0xFFFF, 0xFFFF, 0xFFFF, 1, 0, 50, 0xBEEF, challenge, writer]
    return [*words, crc(words), sequence]

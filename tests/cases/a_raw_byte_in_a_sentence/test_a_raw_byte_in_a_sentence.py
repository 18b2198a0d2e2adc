"""A raw byte stood in a sentence, and sentences were longer than 3,000 letters: what a file, a peer or a call had said.

Every sentence that a person reads is one line of printable characters that somebody can read to its end.
"""

import builtins
import os
import re
import subprocess
import sys
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread

import pytest

from drivers.settings import ConfigError
from gateway.entry import sentence
from gateway.outside.northbound import OutgoingRow, SinkUnreachable
from gateway.outside.northbound.influx import InfluxSink
from gateway.settings import InfluxRow, load_config
from gateway.store import AuditError, BackupError, HistorianError, SigningKeyError
from tests.cases.a_slow_recipient_silenced_the_others.test_a_slow_recipient_silenced_the_others import ROW
from tests.gateway.support import ROOT, plant_file

LONGEST = 3000
BUILT_IN = {name for name, kind in vars(builtins).items() if isinstance(kind, type) and issubclass(kind, BaseException)}
STEERING = "\x1b[2J\nadmin: armed\0\x85\u2028\u202e"
NO_SENTENCE = {
    "CsvRowError", "OutOfRequests", "Unable", "EndedUnasked", "PackedError", "Refused", "Abort", "Undefined",
    "ModbusRefusal", "TooManyQueriesError", "RecordFault", "Interrupted", "Unrepresentable",
}  # fmt: skip
"""Errors whose sentence reaches nobody: the caller catches them, and says something of its own."""
ARITHMETIC = ("sim/proof", "sim/lab/checking", "sim/effects", "sim/lab/learning")
"""What computes imports nothing of the floor below; what it says is made one line where it is said."""


def shown(text: str) -> None:
    assert all(line.isprintable() for line in text.split("\n")), text
    assert len(text) <= LONGEST, f"{len(text)} characters: {text[:300]}"


def test_every_error_that_says_something_to_a_person_is_one_line() -> None:
    """By the text of the whole product: names of classes are unique in it."""
    bases: dict[str, list[str]] = {}
    places: dict[str, Path] = {}
    for path in sorted(each for floor in ("drivers", "sim", "gateway") for each in (ROOT / floor).rglob("*.py")):
        for name, of in re.findall(r"^class (\w+)(?:\(([^)]*)\))?:", path.read_text(encoding="utf-8"), re.MULTILINE):
            bases[name] = [base.split("[")[0].split(".")[-1].strip() for base in of.split(",")]
            places[name] = path.relative_to(ROOT)

    def lineage(name: str) -> set[str]:
        return {name}.union(*(lineage(base) for base in bases.get(name, ()) if base != name))

    errors = {name: lineage(name) for name in bases if lineage(name) & BUILT_IN}
    loose = {
        name
        for name, line in errors.items()
        if not line & {"OneLineError", "ConfigError"} and name not in NO_SENTENCE
        if not any(places[name].is_relative_to(room) for room in ARITHMETIC)
    }
    assert len(errors) > 50 and not loose


@pytest.mark.parametrize("kind", [AuditError, BackupError, HistorianError, SigningKeyError, SinkUnreachable])
def test_what_an_error_quotes_is_escaped_and_cut(kind: type[Exception]) -> None:
    error = kind(f"file: begin {STEERING * 1000} end")
    shown(str(error))
    assert "\\x1b[2J" in str(error) and str(error).endswith(" end") and "\n" not in str(error)


@pytest.mark.parametrize(
    "error",
    [
        ValueError(f"x {STEERING * 1000}"),
        OSError(2, "No such file or directory", f"x/{STEERING}" * 300),
        LookupError(STEERING),
        ConfigError([f"plant.toml: key {number}: {STEERING * 90}" for number in range(400)]),
    ],
)
def test_what_a_command_ends_with_is_escaped_and_cut(error: Exception) -> None:
    shown(sentence(error))


def test_of_many_problems_the_first_are_said_and_the_others_counted(tmp_path: Path) -> None:
    keys = "".join(f"no_such_key_{number} = {number}\n" for number in range(500))
    path = plant_file(tmp_path)
    path.write_text(f"{keys}{'k' * 20_000} = 1\n{path.read_text()}")
    with pytest.raises(ConfigError) as refused:
        load_config(path)
    shown(str(refused.value))
    *said, last = str(refused.value).split("\n")
    assert len(refused.value.problems) == 501 and 3 < len(said) < 501
    assert last.startswith(f"and {501 - len(said)} more")
    assert "no_such_key_0" in str(refused.value)


CALLS: list[list[bytes | str]] = [
    [f"stat{STEERING[:1]}us"],
    ["status", "--config", STEERING.replace("\0", "")],
    ["status", f"--conf{STEERING[:4]}"],
    ["plc", "read", "--unit", STEERING.replace("\0", "")],
    ["plc", "read", "--watch", "--json", "x" * 9000],
    ["status", "--config", b"\xff\xfe\x1b"],
    ["trace", "show", b"\xff\x9b2J.csv", "--json"],
]


@pytest.mark.parametrize("words", CALLS, ids=str)
def test_what_a_call_quotes_of_itself_is_escaped_and_cut(words: list[bytes | str], tmp_path: Path) -> None:
    done = subprocess.run(
        [os.fsencode(sys.executable), b"-m", b"gateway.cli.main", *map(os.fsencode, words)],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT), "NO_COLOR": "1"},
        capture_output=True,
        check=False,
        timeout=120.0,
    )
    assert done.returncode == 2
    said = done.stderr.decode("utf-8")
    assert said.count("\n") == 1 and said.startswith("decanter: ")
    shown(said.removesuffix("\n"))


def test_what_a_server_says_is_escaped() -> None:
    class Rude(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            self.rfile.read(int(self.headers["Content-Length"]))
            body = STEERING.encode() * 200
            self.send_response(500)
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *_: object) -> None:
            return

    with ThreadingHTTPServer(("127.0.0.1", 0), Rude) as server:
        thread = Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        try:
            sink = InfluxSink(
                InfluxRow(name="x", url=f"http://127.0.0.1:{server.server_address[1]}", database="d"), None, None
            )
            sink.open({})
            with pytest.raises(SinkUnreachable, match="answers 500") as refused:
                list(sink.deliver([OutgoingRow(ROW, historical=False)]))
            sink.close()
        finally:
            server.shutdown()
            thread.join()
    shown(str(refused.value))
    assert "\n" not in str(refused.value)

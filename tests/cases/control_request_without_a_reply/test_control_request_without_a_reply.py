"""Nine of sixteen malformed requests ended in a traceback and no reply; line breaks in names reached log and audit."""

import asyncio
import io
import json
from pathlib import Path
from random import Random
from typing import Any

import pytest

from gateway.machine import Machine
from gateway.plant.control import MAX_REQUEST_BYTES, Control, ControlScope
from gateway.plant.log import open_log
from gateway.plant.status import snapshot
from tests.gateway.support import Bench, JumpClock, as_driver, config_in

REQUESTS = [
    b"",
    b"null",
    b"7",
    b'"status"',
    b"{",
    b'{"command": 7}',
    b'{"command": ["status"]}',
    b'{"command": "status", "more": 1}',
    b'{"command": "\\u001b[31m\\nopen"}',
    b'{"command": "' + b"x" * 5000 + b'"}',
    b'{"command": "st\xffatus"}',
    b"[" * 100_000,
    b'{"command": "read", "tags": [[]]}',
    b'{"command": "read", "tags": [{}]}',
    b'{"command": "read", "tags": "Assorbimento"}',
    b'{"command": "read", "tags": ' + b"[" * 300 + b"]" * 300 + b"}",
    b'{"command": "read", "addresses": [7]}',
    b'{"command": "read", "addresses": [{"address": "holding:1", "scale": "a"}]}',
    b'{"command": "read", "addresses": [{"address": "holding:1", "scale": 1e999}]}',
    b'{"command": "read", "addresses": [{"address": "holding:1", "bit": 99}]}',
    b'{"command": "read", "addresses": [{"address": "holding:1", "dtype": ["a"]}]}',
    b'{"command": "read", "addresses": [{"address": "holding:1", "dtype": "string", "length": 1e9}]}',
    b'{"command": "read", "addresses": [{"address": "holding:1", "dtype": "string", "length": 1000000000}]}',
    b'{"command": "read", "addresses": [{"address": "holding:1", "labels": [1]}]}',
    b'{"command": "read", "addresses": [{"address": "holding:1", "writable": true}]}',
    b'{"command": "arm"}',
    b'{"command": "arm", "by": "A", "reason": "r", "minutes": NaN}',
    b'{"command": "arm", "by": "A", "reason": "r", "minutes": 1e999}',
    b'{"command": "arm", "by": "A", "reason": "r", "minutes": true}',
    b'{"command": "arm", "by": "A", "reason": "r", "minutes": 1' + b"0" * 350 + b"}",
    b'{"command": "arm", "by": "A", "reason": "r", "minutes": 1' + b"0" * 5000 + b"}",
    b'{"command": "arm", "by": "A\\nB", "reason": "r", "minutes": 1}',
    b'{"command": "arm", "by": "\\ud800", "reason": "r", "minutes": 1}',
    b'{"command": "disarm", "by": "A\\u001b[2J", "reason": "r"}',
    b'{"command": "disarm", "by": "A", "reason": "one\\nadmin: armed"}',
    b'{"command": "disarm", "by": "A", "reason": "' + b"r" * 5000 + b'"}',
    b'{"command": "disarm", "by": ["A"], "reason": {}}',
]


async def test_every_request_gets_one_reply_with_a_reason_and_the_next_is_served(tmp_path: Path) -> None:
    config, clock, said = config_in(tmp_path), JumpClock(), io.StringIO()
    with open_log(None, "debug", said) as log:
        machine = Machine(config, driver=as_driver(Bench(config, clock)), clock=clock, log=log, rng=Random(0))
        control = Control(ControlScope({"decanter": machine}, snapshot), tmp_path / "s", log)
        await control.open()
        try:
            reader, writer = await asyncio.open_unix_connection(tmp_path / "s", limit=4 * MAX_REQUEST_BYTES)
            for request in (*REQUESTS[1:], b"x" * (MAX_REQUEST_BYTES + 10)):
                writer.write(request + b"\n")
                reply: dict[str, Any] = json.loads(await asyncio.wait_for(reader.readline(), 60.0))
                assert reply["ok"] is False and reply["reason"], request[:80]
                assert reply["reason"].isprintable() and len(reply["reason"]) < 1000, request[:80]
            writer.close()
            reader, writer = await asyncio.open_unix_connection(tmp_path / "s", limit=4 * MAX_REQUEST_BYTES)
            writer.write(b'{"command": "status"}\n')
            assert json.loads(await asyncio.wait_for(reader.readline(), 60.0))["ok"]
            writer.close()
        finally:
            await control.close()
            machine.close()
    assert "\x1b" not in said.getvalue() and "Traceback" not in said.getvalue()


@pytest.mark.parametrize("text", ["one\ntwo", "\x1b[2Jgone", "half \ud800", "next\u2028line", "\x9b31m"])
def test_what_others_say_cannot_steer_the_log(tmp_path: Path, text: str) -> None:
    said = io.StringIO()
    with open_log(tmp_path / "log.jsonl", "info", said) as log:
        log.warning("heard", reason=text)
    lines = (tmp_path / "log.jsonl").read_text(encoding="utf-8").splitlines()
    assert len(lines) == 1 and json.loads(lines[0])["reason"].isprintable()
    assert len(said.getvalue().splitlines()) == 1 and text not in said.getvalue()

"""JSON lines: what is no object is answered in a sentence, and a line without end costs its sender the connection."""

import asyncio
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from drivers import json_lines
from drivers.json_lines import NoObject


def test_an_object_is_read_from_text_and_from_bytes_and_written_as_one_line() -> None:
    assert json_lines.parse_object('{"a": 1}') == json_lines.parse_object(b'{"a": 1}\n') == {"a": 1}
    assert json_lines.format_object({"a": "\ud800\n"}) == b'{"a": "\\ud800\\n"}\n'


@pytest.mark.parametrize("line", ["[1]", "7", "", "{", "no json", b"\xff\n", "[" * 100_000])
def test_what_is_no_object_is_refused_in_one_sentence(line: str | bytes) -> None:
    with pytest.raises(NoObject, match="is no JSON object; give one, such as") as caught:
        json_lines.parse_object(line)
    assert len(str(caught.value)) < 200


async def test_lines_are_answered_in_order_until_one_has_no_end_or_the_client_is_not_admitted(tmp_path: Path) -> None:
    admitted = True

    async def answer(line: bytes) -> Mapping[str, Any]:
        return {"heard": line.decode().strip()}

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await json_lines.serve(reader, writer, answer, admitted=lambda: admitted)

    path = tmp_path / "s"
    async with await asyncio.start_unix_server(serve, path, limit=64):
        reader, writer = await asyncio.open_unix_connection(path)
        writer.write(b"one\n\ntwo\n")
        assert [json.loads(await reader.readline())["heard"] for _ in range(2)] == ["one", "two"]
        writer.write(b"x" * 65 + b"\n")
        refusal = json.loads(await reader.readline())
        assert not refusal["ok"] and "too long" in refusal["reason"]
        assert await reader.read() == b""
        writer.close()
        admitted = False
        reader, writer = await asyncio.open_unix_connection(path)
        assert await reader.read() == b""
        writer.close()

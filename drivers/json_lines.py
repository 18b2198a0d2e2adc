"""JSON lines, the protocol of the local control channels: one JSON object a line in, one a line out.

A line is bounded by its stream's limit, and what makes no sense is answered with a sentence; what the objects mean is
for those who serve them (the software PLC, the running gateway).
"""

import asyncio
import json
from collections.abc import Awaitable, Callable, Mapping
from typing import Any

from drivers.errors import OneLineError
from drivers.named_files import unusable

Answer = Callable[[bytes], Awaitable[Mapping[str, Any]]]
"""Gives the reply to one line; never raises for what the line holds."""


class NoObject(OneLineError, ValueError):
    """A line that holds no JSON object; the sentence goes into the reply."""


def parse_object(line: str | bytes, example: str = '{"command": "status"}') -> dict[str, Any]:
    """The object that a line holds; `example` is one that would be right. Raises NoObject."""
    try:
        text = line.decode() if isinstance(line, bytes) else line
    except UnicodeDecodeError as error:
        sentence = f"the request is not UTF-8 (byte {error.start}) and is no JSON object; give one, such as {example}"
        raise NoObject(sentence) from None
    # Lists nested without end exhaust the decoder's stack.
    try:
        content, ill = json.loads(text, parse_constant=_no_constant), ""
    except (ValueError, RecursionError):
        content, ill = None, "the request is not JSON: "
    if problem := unusable(content):
        raise NoObject(f"the request cannot be used: {problem}")
    if not isinstance(content, dict):
        raise NoObject(f"{ill}{text.strip()[:60]!r} is no JSON object; give one, such as {example}")
    return content


def _no_constant(name: str) -> float:
    raise ValueError(f"{name} is no JSON number")


def format_object(message: Mapping[str, Any]) -> bytes:
    """An object as a line. ASCII throughout: half a surrogate pair that came in by an escape can go out again."""
    return json.dumps(message).encode() + b"\n"


async def serve(
    reader: asyncio.StreamReader,
    writer: asyncio.StreamWriter,
    answer: Answer,
    *,
    admitted: Callable[[], bool] = lambda: True,
) -> None:
    """Answer line by line while the client is `admitted`; blank lines are passed over. Closes the writer, never raises.

    Ends when the client goes, after the reply to a line beyond the reader's limit, or when the task is cancelled.
    """
    try:
        while admitted():
            try:
                line = await reader.readline()
            except ValueError:  # beyond the limit: where the next line begins is not known any more
                writer.write(
                    format_object({"ok": False, "reason": "the line is too long for a request; give a shorter one"})
                )
                await writer.drain()
                break
            if not line:
                break
            if line.strip():
                writer.write(format_object(await answer(line)))
                await writer.drain()
    except (OSError, asyncio.CancelledError):
        pass  # the client has gone, or the process stops: nobody waits for an answer
    finally:
        writer.close()

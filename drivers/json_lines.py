"""JSON lines, the protocol of the local control channels: one JSON object a line in, one a line out.

A line is bounded by its stream's limit, and what makes no sense is answered with a sentence; what the objects mean is
for those who serve them (the software PLC, the running gateway).
"""

import asyncio
import json
from collections.abc import Awaitable, Callable, Mapping
from typing import Any

Answer = Callable[[bytes], Awaitable[Mapping[str, Any]]]
"""Gives the reply to one line; never raises for what the line holds."""


class NoObject(ValueError):
    """A line that holds no JSON object; the sentence goes into the reply."""


def parsed(line: str | bytes) -> dict[str, Any]:
    """The object that a line holds. Raises NoObject."""
    text = line.decode(errors="replace") if isinstance(line, bytes) else line
    # Lists nested without end exhaust the decoder's stack.
    try:
        content, ill = json.loads(text), ""
    except (ValueError, RecursionError):
        content, ill = None, "the request is not JSON: "
    if not isinstance(content, dict):
        example = '{"command": "status"}'
        raise NoObject(f"{ill}{text.strip()[:60]!r} is no JSON object; give one a line, such as {example}")
    return content


def packed(message: Mapping[str, Any]) -> bytes:
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

    Ends when the client goes, sends a line beyond the reader's limit, or the task is cancelled.
    """
    try:
        while admitted() and (line := await reader.readline()):
            if line.strip():
                writer.write(packed(await answer(line)))
                await writer.drain()
    except (OSError, ValueError, asyncio.CancelledError):
        pass  # the client has gone, sends without end, or the process stops: nobody waits for an answer
    finally:
        writer.close()

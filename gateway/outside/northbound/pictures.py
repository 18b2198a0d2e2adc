"""The machines' statuses for what answers from a loop of its own: taken in the gateway's loop, one after the other."""

import asyncio
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gateway.outside.status import GatewayStatus

Pictures = Callable[[], Mapping[str, Callable[[], "GatewayStatus"]]]
"""Gives what takes each machine's status, by its name; called in the gateway's loop."""
PATIENCE_SECONDS = 5.0


async def ask_statuses(pictures: Pictures, gateway_loop: asyncio.AbstractEventLoop) -> "dict[str, GatewayStatus]":
    """All pictures, asked from another loop. Raises TimeoutError or RuntimeError where the gateway does not answer."""

    async def take_all() -> "dict[str, GatewayStatus]":
        statuses = {}
        for name, take in pictures().items():
            statuses[name] = take()
            # Scans come between one and the next.
            await asyncio.sleep(0)
        return statuses

    work = take_all()
    try:
        asked = asyncio.run_coroutine_threadsafe(work, gateway_loop)
    except RuntimeError:
        work.close()
        raise
    async with asyncio.timeout(PATIENCE_SECONDS):
        return await asyncio.wrap_future(asked)

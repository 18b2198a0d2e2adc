"""What the page asks of the gateway, whose loop runs in another thread: the commands of the control socket."""

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from typing import Any

from drivers.json_lines import format_object
from gateway.outside.status import ControlError, GatewayStatus

PATIENCE_S = 60.0
"""A machine that is disarmed or stopped takes back what stands in its PLC first."""

Answer = Callable[[bytes], Awaitable[Mapping[str, Any]]]
"""Gives the reply to one request, a line of JSON, in the gateway's loop (`gateway.plant.control.answer`)."""


class GatewayCalls:
    """Asks the gateway from another thread's loop what its control socket is asked, by the same words."""

    def __init__(self, answer: Answer, loop: asyncio.AbstractEventLoop) -> None:
        self._answer, self._loop = answer, loop

    async def ask(self, command: str, **keys: Any) -> Mapping[str, Any]:
        """The reply to a command of the control socket. Raises ControlError where it is refused, or nobody answers."""
        line = format_object({"command": command, **keys})

        async def reply() -> Mapping[str, Any]:
            return await self._answer(line)

        try:
            call = asyncio.run_coroutine_threadsafe(reply(), self._loop)
        except RuntimeError:
            raise ControlError("the gateway is being stopped") from None
        try:
            async with asyncio.timeout(PATIENCE_S):
                answered = await asyncio.wrap_future(call)
        except TimeoutError:
            raise ControlError(f"the gateway has not answered for {PATIENCE_S:g} s") from None
        if not answered["ok"]:
            raise ControlError(str(answered["reason"]))
        return answered

    async def plant(self) -> dict[str, GatewayStatus]:
        """How all machines are now, by their names. Raises ControlError."""
        statuses = (await self.ask("plant"))["statuses"]
        return dict(statuses)

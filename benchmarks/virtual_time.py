"""An event loop that waits for no time to pass: what is measured by its clock is waiting alone, on any machine."""

import asyncio
import selectors


class VirtualSelector(selectors.DefaultSelector):
    """Waits for no time to pass: with nothing to do, `now` (s) goes on at once to what is due next."""

    now = 0.0

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        """What is ready; on loopback that is all that has been sent."""
        ready = super().select(0 if timeout is not None else None)
        if not ready and timeout:
            self.now += timeout
        return ready


def virtual_loop() -> asyncio.SelectorEventLoop:
    """An event loop whose time is virtual."""
    selector = VirtualSelector()
    loop = asyncio.SelectorEventLoop(selector)
    loop.time = lambda: selector.now  # type: ignore[method-assign]
    return loop

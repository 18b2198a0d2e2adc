"""What the service manager hears of the gateway (sd_notify(3)): that it is ready, that it stops, and its watchdog.

The watchdog is fed for completed scans and for nothing else. A gateway that is fed for being alive would stay alive
while its machines hang; one that hangs, in whatever part, completes no scan, and is started anew.
"""

import asyncio
import os
import socket
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Protocol

LOOKS_PER_WATCHDOG = 20
"""Looks at the scans within the watchdog's time."""
MAX_MISSED_SCANS = 5.0
"""Scans that a machine may miss before it counts as hanging, where that is longer than the unit's WatchdogSec."""
PATIENCE_SECONDS = 0.5
"""How long a service manager whose queue is full is waited for: no scan is done meanwhile."""


@dataclass(frozen=True, slots=True)
class ScanProgress:
    """How far a machine that is to be read has come: scans whose stages are all done, and how often it was begun anew
    after a failure."""

    completed: int = 0
    restarts: int = 0


class ScannedMachines(Protocol):
    """The machines of a running gateway."""

    def progress(self) -> Mapping[str, ScanProgress]:
        """How far each machine that is to be read has come, by name; none that is being stopped."""
        ...

    @property
    def longest_period(self) -> float:
        """The longest time from one scan of a machine to the next (real s)."""
        ...


class ServiceManager:
    """Tells the service manager at `address` (NOTIFY_SOCKET); `watchdog` are the seconds of its watchdog, 0 for none.

    Whoever was not started by one has an empty address, and tells nobody.
    """

    def __init__(self, address: str = "", watchdog: float = 0.0) -> None:
        self._address = f"\0{address[1:]}" if address.startswith("@") else address
        self._watchdog = watchdog if address else 0.0
        self._announced_patience = 0.0
        self._before: Mapping[str, ScanProgress] = {}

    def tell(self, state: str) -> None:
        """Tell it one or more lines NAME=VALUE. It is no reason for a gateway to stop that nobody listens."""
        if self._address:
            with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as line:
                line.settimeout(PATIENCE_SECONDS)
                line.sendto(state.encode(), self._address)

    def feed(self, machines: ScannedMachines) -> bool:
        """Feed the watchdog if every machine has come further since it was fed last; whether it was.

        A machine that failed and was begun anew has come further: that is the supervisor's to mend and an alarm to say,
        and no reason to stop those that are read. At least one scan has to have been completed, by any of them.
        """
        patience = max(self._watchdog, MAX_MISSED_SCANS * machines.longest_period)
        if patience != self._announced_patience:
            self.tell(f"WATCHDOG_USEC={round(patience * 1e6)}")
            self._announced_patience = patience
        now = machines.progress()
        last = {name: self._before.get(name, ScanProgress()) for name in now}
        moved = all(now[name] != last[name] for name in now)
        if not moved or not any(now[name].completed > last[name].completed for name in now):
            return False
        self._before = now
        self.tell(f"WATCHDOG=1\nSTATUS=scanned: {', '.join(now)}")
        return True

    async def watch(self, machines: ScannedMachines) -> None:
        """Feed the watchdog for as long as scans are completed; without one, do nothing."""
        while self._watchdog:
            self.feed(machines)
            await asyncio.sleep(self._watchdog / LOOKS_PER_WATCHDOG)
        await asyncio.Future()


def service_manager(environment: Mapping[str, str] = os.environ, pid: int | None = None) -> ServiceManager:
    """The one that has started this process (`pid`), by what it has put into the environment."""
    usec, meant = environment.get("WATCHDOG_USEC", ""), environment.get("WATCHDOG_PID", "")
    ours = meant in ("", str(os.getpid() if pid is None else pid))
    seconds = int(usec) / 1e6 if ours and usec.isdecimal() else 0.0
    return ServiceManager(environment.get("NOTIFY_SOCKET", ""), seconds)

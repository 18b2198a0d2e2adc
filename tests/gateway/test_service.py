"""What the service manager hears: ready, stopping, and a watchdog that only completed scans feed."""

import asyncio
import socket
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from drivers.tag import Sample, Tag
from gateway.plant.app import run
from gateway.plant.service import ScanProgress, ServiceManager, service_manager
from tests.gateway.support import Bench, PacedClock, config_in


@dataclass
class SystemdSocket:
    """The socket that systemd would listen at; `lines` are all that came so far."""

    path: str
    line: socket.socket
    lines: list[str] = field(default_factory=list)

    def heard(self) -> list[str]:
        while True:
            try:
                self.lines += self.line.recv(4096).decode().splitlines()
            except BlockingIOError:
                return self.lines


@pytest.fixture
def systemd(tmp_path: Path) -> Iterator[SystemdSocket]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as line:
        line.bind(str(tmp_path / "notify"))
        line.setblocking(False)
        yield SystemdSocket(str(tmp_path / "notify"), line)


@dataclass
class Counted:
    """Machines whose progress the test writes."""

    counts: Mapping[str, tuple[int, int]]
    longest_period: float = 1.0

    def progress(self) -> dict[str, ScanProgress]:
        return {name: ScanProgress(*pair) for name, pair in self.counts.items()}


@pytest.mark.parametrize(
    ("before", "after", "fed"),
    [
        ({"a": (1, 0), "b": (1, 0)}, {"a": (2, 0), "b": (2, 0)}, True),
        ({"a": (1, 0), "b": (1, 0)}, {"a": (99, 0), "b": (1, 0)}, False),  # one hangs
        ({"a": (1, 0), "b": (1, 0)}, {"a": (2, 0), "b": (1, 1)}, True),  # one failed, and is begun anew
        ({"a": (1, 0), "b": (1, 0)}, {"a": (1, 1), "b": (1, 1)}, False),  # nobody completes anything
        ({"a": (1, 0)}, {"a": (2, 0), "new": (0, 0)}, False),
        ({"a": (1, 0)}, {"a": (2, 0), "new": (1, 0)}, True),
        ({"a": (1, 0), "gone": (5, 0)}, {"a": (2, 0)}, True),
        ({"a": (1, 0)}, {}, False),
    ],
)
def test_the_watchdog_is_fed_when_every_machine_has_come_further(
    systemd: SystemdSocket, before: dict[str, tuple[int, int]], after: dict[str, tuple[int, int]], *, fed: bool
) -> None:
    service = ServiceManager(systemd.path, watchdog=60.0)
    assert service.feed(Counted(before))
    systemd.heard().clear()
    assert service.feed(Counted(after)) == fed
    assert ("WATCHDOG=1" in systemd.heard()) == fed


def test_slow_scans_are_given_the_time_they_need(systemd: SystemdSocket) -> None:
    service = ServiceManager(systemd.path, watchdog=60.0)
    service.feed(Counted({"a": (1, 0)}, longest_period=1.0))
    service.feed(Counted({"a": (2, 0)}, longest_period=600.0))
    service.feed(Counted({"a": (3, 0)}, longest_period=600.0))
    assert [line for line in systemd.heard() if "USEC" in line] == [
        "WATCHDOG_USEC=60000000",
        "WATCHDOG_USEC=3000000000",
    ]


def test_the_environment_says_whether_and_to_whom_anything_is_told(systemd: SystemdSocket) -> None:
    silent = service_manager({})
    silent.tell("READY=1")
    other = service_manager({"NOTIFY_SOCKET": systemd.path, "WATCHDOG_USEC": "500000", "WATCHDOG_PID": "2"}, pid=1)
    other.tell("READY=1")
    assert systemd.heard() == ["READY=1"]
    service_manager({"NOTIFY_SOCKET": "@nobody-listens-here"}).tell("READY=1")

    async def watched(environment: dict[str, str]) -> bool:
        task = asyncio.create_task(service_manager(environment, pid=1).watch(Counted({"a": (1, 0)})))
        await asyncio.sleep(0)
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        return "WATCHDOG=1" in systemd.heard()

    ours = {"NOTIFY_SOCKET": systemd.path, "WATCHDOG_USEC": "500000"}
    assert not asyncio.run(watched(ours | {"WATCHDOG_PID": "2"})), "the watchdog is another process's"
    assert not asyncio.run(watched({"NOTIFY_SOCKET": systemd.path})), "there is no watchdog"
    assert asyncio.run(watched(ours | {"WATCHDOG_PID": "1"}))


class HangingBench(Bench):
    """A device whose driver does not come back from a reading while `lost` is set."""

    lost = False

    async def read(self, tags: Sequence[Tag]) -> list[Sample]:
        while self.lost:
            await asyncio.sleep(0.01)
        samples: list[Sample] = await super().read(tags)
        return samples


async def test_a_gateway_that_hangs_in_a_scan_feeds_no_more_and_says_that_it_stops(
    systemd: SystemdSocket, tmp_path: Path
) -> None:
    bench = HangingBench(config_in(tmp_path), PacedClock(pause_s=0.002))
    service = ServiceManager(systemd.path, watchdog=0.2)
    stop = asyncio.Event()
    work: asyncio.Task[dict[str, Any]] = asyncio.create_task(
        run(bench.config, clock=bench.clock, stop=stop, driver=bench, service=service)
    )
    try:
        async with asyncio.timeout(60.0):
            while "WATCHDOG=1" not in systemd.heard():
                await asyncio.sleep(0.01)
            bench.lost = True
            reads = -1
            while reads != bench.reads:
                reads = bench.reads
                await asyncio.sleep(0.1)
            # What was completed before is fed once more at most; then it is looked ten times in vain.
            await asyncio.sleep(0.02)
            fed = systemd.heard().count("WATCHDOG=1")
            await asyncio.sleep(0.1)
            assert systemd.heard().count("WATCHDOG=1") == fed
            assert systemd.heard()[0] == "READY=1" and "STOPPING=1" not in systemd.heard()
            bench.lost = False
            while systemd.heard().count("WATCHDOG=1") == fed:
                await asyncio.sleep(0.01)
    finally:
        bench.lost = False
        stop.set()
        await work
    assert "STOPPING=1" in systemd.heard()

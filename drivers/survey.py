"""A device asked by hand, before anything is configured: what `decanter plc` scans, probes and reads with.

A driver hides addresses behind tags and heals what goes wrong; here every request is one request, and every failure is
raised as it is.
"""

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass
from typing import Any, Protocol

from drivers.driver import Clock, capabilities, load_function
from drivers.errors import DriverError
from drivers.tag import Sample, Tag


@dataclass(frozen=True, slots=True)
class Raw:
    """One tag as it lies in the device and as it is read: `raw` are registers, bits or bytes, None where none came.

    `place` is where it was asked for, in the notation of addresses; `count` how many addresses or bytes it covers.
    """

    tag: Tag
    sample: Sample
    place: str
    count: int
    raw: tuple[int, ...] | None = None


@dataclass(frozen=True, slots=True)
class ReadWords:
    """What one read request brought, and the seconds from its sending to the whole reply."""

    words: tuple[int, ...]
    seconds: float


@dataclass(frozen=True, slots=True, kw_only=True)
class PlannedRequest:
    """One request that would be sent: `kind` "read", "write" or "read back", `count` addresses from `place` on.

    `vain` of them belong to no tag; `seconds` is the longest that it can take.
    """

    kind: str
    place: str
    count: int
    vain: int
    tags: tuple[str, ...]
    seconds: float


@dataclass(frozen=True, slots=True, kw_only=True)
class ReadPlan:
    """The requests of one scan and of one write of the block, and the longest that either can take (s).

    `problems` are sentences: a tag without a place, a block that is no one write; `overlaps` are tags that share
    registers; `written_by` says by which function a block is written, and whether it is read back; `cautions` are
    settings that come to nothing.
    """

    requests: tuple[PlannedRequest, ...]
    writes: tuple[PlannedRequest, ...]
    problems: tuple[str, ...]
    seconds: float
    write_seconds: float
    overlaps: tuple[str, ...] = ()
    written_by: str = ""
    cautions: tuple[str, ...] = ()


class AsksRegisters(Protocol):
    """A Modbus device. All verbs raise DriverError by its kinds; `unit` None is the configured one."""

    async def read(self, area: str, start: int, count: int, unit: int | None = None) -> ReadWords:
        """One request for registers or bits (0 and 1) of a table, sent once."""
        ...

    async def identity(self, unit: int | None = None) -> Mapping[str, str]:
        """What the device says of itself (function 43/14): vendor, product, revision, ..."""
        ...

    async def server_id(self, unit: int | None = None) -> str:
        """What the device says of itself in its maker's own way (function 17)."""
        ...

    async def stranger(self) -> str:
        """Why the device is not the one that the settings pin; "" if it is, or none is pinned."""
        ...

    async def tags(self, tags: Sequence[Tag]) -> list[Raw]:
        """Each tag with its raw words, all from the fewest requests; a failure is a sample of bad quality."""
        ...

    def statistics(self) -> Mapping[str, float]:
        """Counters since it was made, by the names of the driver's."""
        ...


@dataclass(frozen=True, slots=True)
class BusFrame:
    """One CAN frame heard: `time` in seconds since listening began."""

    time: float
    id: int
    extended: bool
    data: bytes


class ListensToBus(Protocol):
    """A CAN bus."""

    async def listen(self, seconds: float) -> list[BusFrame]:
        """All data frames of so many seconds; nothing is sent. Raises LinkDown."""
        ...

    async def tags(self, tags: Sequence[Tag], node: int, timeout: float) -> list[Raw]:
        """Each tag of a CANopen node by SDO, with the bytes of its object; a failure is a sample of bad quality."""
        ...

    async def object(self, node: int, index: int, subindex: int, timeout: float) -> bytes:
        """One object of a CANopen node by SDO. Raises ReplyTimeout, DeviceException, ReplyMismatch or LinkDown."""
        ...

    def statistics(self) -> Mapping[str, float]:
        """Counters since it was made, by the names of the drivers'."""
        ...


def open_registers(
    driver: str, settings: Mapping[str, Any], *, clock: Clock
) -> AbstractAsyncContextManager[AsksRegisters]:
    """A connection to a device with registers, by its driver's settings. Raises DriverError; LinkDown on entering."""
    row = capabilities(driver)
    if not row.registers or not row.surveys:
        raise DriverError(f"{driver!r} has no registers that can be asked for by hand: {row.described_in} says more")
    opened: Callable[..., AbstractAsyncContextManager[AsksRegisters]] = load_function(row.surveys)
    return opened(settings, clock=clock)


def open_bus_survey(
    driver: str, settings: Mapping[str, Any], *, clock: Clock
) -> AbstractAsyncContextManager[ListensToBus]:
    """A CAN bus, by the settings of a driver that is on one. Raises DriverError; LinkDown on entering."""
    row = capabilities(driver)
    if not row.bus or not row.surveys:
        raise DriverError(f"{driver!r} is no CAN bus: give --link can or --link canopen, and --channel")
    opened: Callable[..., AbstractAsyncContextManager[ListensToBus]] = load_function(row.surveys)
    return opened(settings, clock=clock)


def read_plan(
    driver: str, settings: Mapping[str, Any], tags: Sequence[Tag], written: Sequence[Tag] = ()
) -> ReadPlan | None:
    """How a device of this driver would be read; None where a driver has no such plan. Raises DriverError."""
    target = capabilities(driver).plans
    if not target:
        return None
    planned: Callable[..., ReadPlan] = load_function(target)
    return planned(settings, tags, written)

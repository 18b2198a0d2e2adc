"""What a command of the commissioning works with."""

import time
from collections.abc import AsyncIterator, Mapping, Sequence
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from dataclasses import dataclass, field
from typing import Any, Protocol, TypeVar

from drivers.driver import Driver
from drivers.survey import AsksRegisters, ListensToBus, open_bus_survey, open_registers
from drivers.tag import Tag
from gateway.commission.session.evidence import Exchanges, FrameEvidence
from gateway.commission.session.target import Target
from gateway.settings import DeviceMap


class Counted(Protocol):
    """What has counters since it was opened."""

    def statistics(self) -> Mapping[str, float]:
        """The counters by their names."""
        ...


C = TypeVar("C", bound=Counted)


@dataclass(slots=True)
class Site:
    """One command at work: the device, the evidence of what was moved, and the counts for the line of frame loss.

    `notes` are sentences for the person that belong to no single row.
    """

    target: Target
    evidence: FrameEvidence
    exchanges: Exchanges = field(default_factory=Exchanges)
    notes: list[str] = field(default_factory=list)

    def count(self, statistics: Mapping[str, float]) -> None:
        """Take over a driver's counters."""
        self.exchanges.add(statistics, self.target.driver)

    @asynccontextmanager
    async def with_counters(self, opening: AbstractAsyncContextManager[C]) -> AsyncIterator[C]:
        """What is opened, with its counters taken over at its end."""
        async with opening as opened:
            try:
                yield opened
            finally:
                self.count(opened.statistics())

    def registers(self, **settings: Any) -> AbstractAsyncContextManager[AsksRegisters]:
        """The device's registers, with some settings others. Raises DriverError."""
        settings = {**self.target.settings, **settings}
        return self.with_counters(open_registers(self.target.driver, settings, clock=time.time))

    def bus(self) -> AbstractAsyncContextManager[ListensToBus]:
        """The CAN bus of the device. Raises DriverError."""
        return self.with_counters(open_bus_survey(self.target.driver, self.target.settings, clock=time.time))

    def driver(self, write_map: Sequence[Tag] = ()) -> AbstractAsyncContextManager[Driver]:
        """The device's driver with a connection. Raises DriverError."""
        return self.with_counters(self.target.open_driver(write_map))


PERIOD_S = 1.0
"""Without a plant file."""


def find_period(site: Site, period: float | None = None) -> float:
    """The period (s) that was given, else the plant file's, else a second."""
    if period is not None:
        return period
    return site.target.config.scan.period if site.target.config is not None else PERIOD_S


def require_device(site: Site) -> DeviceMap:
    """The device file. Raises ValueError where there is none."""
    if site.target.map is None:
        raise ValueError("which tags? Give the plant file (--config FILE) or the device file (--device FILE)")
    return site.target.map


def list_block_words(site: Site) -> tuple[Tag, ...]:
    """The words of all blocks, where something may be written."""
    config = site.target.config
    return () if config is not None and config.writeback.mode == "off" else require_device(site).block_words

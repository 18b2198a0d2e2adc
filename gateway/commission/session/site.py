"""What a command of the commissioning works with."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from drivers.tag import Tag
from gateway.commission.session.evidence import Exchanges, FrameEvidence
from gateway.commission.session.target import Target
from gateway.settings import DeviceMap


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


PERIOD_S = 1.0
"""Without a plant file."""


def period_of(site: Site, period: float | None = None) -> float:
    """The period (s) that was given, else the plant file's, else a second."""
    if period is not None:
        return period
    return site.target.config.scan.period if site.target.config is not None else PERIOD_S


def device_of(site: Site) -> DeviceMap:
    """The device file. Raises ValueError where there is none."""
    if site.target.map is None:
        raise ValueError("which tags? Give the plant file (--config FILE) or the device file (--device FILE)")
    return site.target.map


def words_of(site: Site) -> tuple[Tag, ...]:
    """The words of all blocks, where something may be written."""
    config = site.target.config
    return () if config is not None and config.writeback.mode == "off" else device_of(site).block_words

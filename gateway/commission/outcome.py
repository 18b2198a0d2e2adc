"""What a command of the commissioning works with, and what it gives."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from gateway.commission.evidence import Evidence, Exchanges
from gateway.commission.target import Target


@dataclass(slots=True)
class Site:
    """One command at work: the device, the evidence of what was moved, and the counts for the line of frame loss.

    `notes` are sentences for the person that belong to no single row.
    """

    target: Target
    evidence: Evidence
    exchanges: Exchanges = field(default_factory=Exchanges)
    notes: list[str] = field(default_factory=list)

    def count(self, statistics: Mapping[str, float]) -> None:
        """Take over a driver's counters."""
        self.exchanges.add(statistics, self.target.driver)


@dataclass(frozen=True, slots=True)
class Outcome:
    """A command's result: `data` for JSON and the records, the exit code, and a sentence where it is not 0."""

    data: Mapping[str, Any]
    code: int = 0
    complaint: str = ""

"""Whether good readings arrive at all, why they do not, and the outages so far."""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from drivers.tag import Quality
from gateway.machine.reading.scan import Scan
from gateway.repeated import drop_measurements

if TYPE_CHECKING:
    from structlog.typing import FilteringBoundLogger


MAX_KEPT_OUTAGES = 50


@dataclass(slots=True)
class Outage:
    """No good reading: the `last_good` scan, the scan that noticed, the first good one again (plant s UTC)."""

    last_good: float
    noticed: float
    recovered: float | None = None

    def plain(self, speed: float) -> dict[str, float | None]:
        """From the last good reading to the notice (`detected_s`) and to the first good one again, in real seconds."""
        back = None if self.recovered is None else (self.recovered - self.last_good) / speed
        return {
            "last_good": self.last_good,
            "detected_s": (self.noticed - self.last_good) / speed,
            "recovered_s": back,
        }


def main_reason(scan: Scan) -> str:
    """What most of the tags without a good reading say; of several the first in the map's order."""
    reasons = Counter(sample.reason for sample in scan.samples.values() if sample.reason)
    return reasons.most_common(1)[0][0] if reasons else ""


@dataclass(slots=True)
class LinkHealth:
    """Whether good readings arrive, since the start and by the outages so far (the newest are kept).

    `reason` is why none does: what most of the tags say, with address and exception; "" while readings arrive.
    """

    log: FilteringBoundLogger
    reason: str = ""
    alive: bool = False
    last_good: float | None = None
    outages: deque[Outage] = field(default_factory=lambda: deque(maxlen=MAX_KEPT_OUTAGES))
    count: int = 0
    garbled: set[str] = field(default_factory=set)

    def take(self, scan: Scan) -> None:
        """Take in whether the scan had a good reading; a change of that is logged."""
        qualities = [sample.quality for sample in scan.samples.values()]
        good = any(quality.is_good for quality in qualities)
        if good and not self.alive:
            if self.outages and self.outages[-1].recovered is None:
                self.outages[-1].recovered = scan.time
            self.log.info("good readings arrive", time=scan.time, outages=self.count)
        before, self.reason = self.reason, "" if good else main_reason(scan)
        if self.alive and not good and self.last_good is not None:
            self.outages.append(Outage(self.last_good, scan.time))
            self.count += 1
            self.log.warning("no good reading any more", time=scan.time, reason=self.reason)
        elif not good and drop_measurements(self.reason) != drop_measurements(before):
            # A device that connects and gives nothing has no outage to begin with: it is said at once, and by change.
            self.log.warning("no good reading", time=scan.time, reason=self.reason)
        doubted = self.garbled or Quality.DATA_ENCODING_INVALID in qualities
        for name, sample in scan.samples.items() if doubted else ():
            # Said once, until the tag is good again: a wrong order stays so until somebody corrects it.
            if sample.quality is Quality.DATA_ENCODING_INVALID and name not in self.garbled:
                self.garbled.add(name)
                self.log.warning(
                    "a tag is not what it is configured as", tag=name, time=scan.time, reason=sample.reason
                )
            elif sample.quality.is_good:
                self.garbled.discard(name)
        self.alive, self.last_good = good, scan.time if good else self.last_good

"""What the gateway shows of itself: one snapshot, rewritten as one JSON line that a reader never sees half."""

import os
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from sim.strict_json import json_text

OUTAGES, EVENTS, LATENCIES = 50, 20, 10_000


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


@dataclass(slots=True)
class Link:
    """Whether good readings arrive, since the start and by the outages so far (the newest are kept)."""

    alive: bool = False
    last_good: float | None = None
    outages: deque[Outage] = field(default_factory=lambda: deque(maxlen=OUTAGES))
    count: int = 0

    def heard(self, time: float, *, good: bool) -> str:
        """Take in whether the scan at `time` had a good reading; "lost" or "back" when that changed, else ""."""
        change = ""
        if good and not self.alive:
            change = "back"
            if self.outages and self.outages[-1].recovered is None:
                self.outages[-1].recovered = time
        elif self.alive and not good and self.last_good is not None:
            change = "lost"
            self.outages.append(Outage(self.last_good, time))
            self.count += 1
        self.alive, self.last_good = good, time if good else self.last_good
        return change


@dataclass(slots=True)
class Tally:
    """Counters since the start, and the newest events and latencies (ms)."""

    scans: int = 0
    early: int = 0
    missed: int = 0
    events: int = 0
    failures: int = 0
    last_failure: str = ""
    recent: deque[tuple[float, str, str]] = field(default_factory=lambda: deque(maxlen=EVENTS))
    latencies: deque[float] = field(default_factory=lambda: deque(maxlen=LATENCIES))


def write_status(path: Path, status: Mapping[str, Any]) -> None:
    """Replace the file by one JSON line, in one step. Raises OSError."""
    draft = path.with_name(f".{path.name}.{os.getpid()}")
    draft.write_text(json_text(status) + "\n", encoding="utf-8")
    draft.replace(path)

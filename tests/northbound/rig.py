"""What the tests of northbound share: a plant's historian that fills, and feeds from it."""

import random
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from drivers.supervision import Supervisor
from drivers.tag import DType, Quality, Tag
from gateway.outside.northbound import Sink, SinkFeed
from gateway.store import Historian, RowPosition, next_rows, open_historian, reading, row_streams, to_trace
from sim.sha import Trace
from tests.gateway.support import EPOCH

MACHINES = ("one", "two")
TAGS = {
    "T": Tag("T", "holding:1", unit="degC"),
    "Run": Tag("Run", "coil:1", dtype=DType.BOOL),
    "Load/A": Tag("Load/A", "holding:2", unit="A"),
    "Recipe": Tag("Recipe", "holding:3", dtype=DType.STRING, length=8),
}
TABLES = ("samples", "predictions", "forecasts", "events", "alarms")


MAPS = Path(__file__).parents[2] / "config/traces"


@dataclass
class KeptLog:
    """A log whose lines are kept."""

    lines: list[dict[str, Any]]

    def bind(self, **_: Any) -> "KeptLog":
        return self

    def __getattr__(self, level: str) -> Any:
        return lambda event, **keys: self.lines.append({"level": level, "event": event, **keys})


@dataclass
class Plant:
    """The historian of two machines, which is filled scan by scan."""

    folder: Path
    store: Historian = field(init=False)
    scans: int = 0
    rng: random.Random = field(default_factory=lambda: random.Random(7))
    feeds: list[SinkFeed] = field(default_factory=list)
    logged: list[dict[str, Any]] = field(default_factory=list)
    _counted: tuple[int, int] = (-1, 0)

    def __post_init__(self) -> None:
        self.supervisor = Supervisor()
        self.store = open_historian(self.folder / "h.sqlite", supervisor=self.supervisor)
        for machine in MACHINES:
            self.store.view(machine, TAGS.values())

    def now(self) -> float:
        return EPOCH + self.scans

    def scan(self, count: int = 1) -> None:
        """So many scans of both machines, a second apart; now and then one has no answer."""
        for _ in range(count):
            self.scans += 1
            time = self.now()
            for place, machine in enumerate(MACHINES):
                own, good = self.store.view(machine), self.rng.random() < 0.9
                values = {
                    "T": 20.0 + self.scans + place,
                    "Run": float(self.scans % 2),
                    "Load/A": -0.5,
                    "Recipe": "é,=\\",
                }
                quality = int(Quality.GOOD if good else Quality.TIMEOUT)
                own.put(
                    "samples",
                    [
                        (tag, time, value if good else None, quality, time - 0.1 if good else None)
                        for tag, value in values.items()
                    ],
                )
                own.put("scans", [(time, 0.1, 0)])
                followed = self.store.view(machine, (), "T")
                row = (time, "on", 1, values["T"], values["T"] + 0.5, 1.0, 2.0, float("nan"), 0.25, "green")
                followed.put("predictions", [row])
                if self.scans % 10 == 0:
                    followed.put("forecasts", [(time, 60.0, "[0.05, 0.5, 0.95]", "[1.0, 2.0, 3.0]", 0.25, 80.0, 21.0)])
                    followed.put("events", [(time, "W_ON", "on")])
                    own.put("alarms", [(time, "over limit T", "T", 1, "unacknowledged", 81.0, "")])
        assert self.store.flush(60.0)

    def feed(self, sink: Sink, **options: Any) -> SinkFeed:
        """A feed from this historian to a sink."""
        given: dict[str, Any] = {"backlog": 1e9, "tables": TABLES, "machines": lambda: MACHINES} | options
        feed = SinkFeed(
            "it",
            sink,
            path=self.store.path,
            view=self.store.view,
            now=self.now,
            supervisor=self.supervisor,
            log=KeptLog(self.logged),  # type: ignore[arg-type]
            **given,
        )
        self.feeds.append(feed)
        return feed

    def rows(self, table: str) -> list[tuple[str, int, Mapping[str, Any]]]:
        """(machine, key, values) of all rows on record of a table."""
        found = []
        with reading(self.store.path) as connection:
            for stream in row_streams(connection, MACHINES):
                position, batch = RowPosition(0, 0.0), None
                while stream.table == table and (batch is None or batch.rows):
                    batch = next_rows(connection, stream, position)
                    found += [(stream.machine, row.key, row.values) for row in batch.rows]
                    position = batch.rows[-1].position if batch.rows else position  # type: ignore[assignment]
        return found

    @property
    def count(self) -> int:
        """The rows on record that are handed on."""
        if self._counted[0] != self.scans:
            self._counted = self.scans, sum(len(self.rows(table)) for table in TABLES)
        return self._counted[1]

    def close(self) -> None:
        for feed in self.feeds:
            feed.stop()
        for feed in self.feeds:
            feed.join()
        self.store.close()


def assert_as_on_record(trace: Trace, plant: Plant) -> None:
    """What was read of rows elsewhere is what the historian itself says, at each of its scans."""
    own = to_trace(plant.store.path, machine=trace.machine)
    assert set(trace.signals) >= {"T", "Run", "Load/A"} == set(own.signals) - {"Recipe"}
    place = np.searchsorted(trace.times, own.times, side="right") - 1
    for name in ("T", "Run", "Load/A"):
        np.testing.assert_array_equal(trace.signals[name][place], own.signals[name])
        np.testing.assert_array_equal(trace.bad[name][place], own.bad[name])
    assert trace.bad["T"].any() and np.isfinite(trace.signals["T"]).sum() > 100

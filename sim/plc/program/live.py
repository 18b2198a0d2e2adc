"""A live plant in the place of a trace: its rows are made as the time comes, with the feed that the program gives."""

from array import array
from collections.abc import Sequence
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import Protocol

from drivers.tag import Value
from sim.plc.program.replay import TraceTable


class LiveProcess(Protocol):
    """A plant that is moved on row by row; `times` (s) are those of all rows to come, `trips` when its drum tripped."""

    signals: Sequence[str]
    times: Sequence[float]
    trips: Sequence[float]

    def row(self, feed: float) -> Sequence[float]:
        """The next row's readings in the order of `signals`, at this share (0..1) of the feed since the one before."""
        ...


class LivePlant:
    """A process as a table that grows: a replay over `table` finds each row made by the time it comes to it.

    `feed` (0..1) is the share of the feed that the program lets through; rows that are made keep what it was.
    """

    def __init__(self, process: LiveProcess, name: str) -> None:
        times = [float(time) for time in process.times]
        columns = {signal: array("d") for signal in process.signals}
        steps = [later - earlier for earlier, later in pairwise(times)]
        self.table = TraceTable(Path(name), times, columns, median(steps) if steps else 1.0)
        self.feed = 1.0
        self._process, self._columns, self._made = process, columns, 0
        self.move(0)

    @property
    def trips(self) -> int:
        """How often the drum has tripped."""
        return len(self._process.trips)

    def move(self, row: int) -> None:
        """Let the plant go on until the row is made."""
        while self._made <= row:
            for column, value in zip(self._columns.values(), self._process.row(self.feed), strict=True):
                column.append(value)
            self._made += 1


LIVE_PLANTS = {"heat": "sim.plant:heat_day"}
"""Where the plants are made, by name: called (seed, limit=degC) when one is asked for, as most runs need none."""


def live_plant(name: str, seed: int, limit: float) -> LivePlant:
    """A plant of LIVE_PLANTS; its drum trips at `limit` (degC)."""
    module, _, function = LIVE_PLANTS[name].partition(":")
    process = getattr(import_module(module), function)(seed, limit=limit)
    return LivePlant(process, f"live plant {name}, seed {seed}")


def status(plant: LivePlant | None) -> dict[str, Value] | None:
    """What the status says of a live plant; None where a trace is replayed."""
    return None if plant is None else {"feed": plant.feed, "tripped": plant.trips > 0}

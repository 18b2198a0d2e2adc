"""What a sink is: something that takes rows of the historian, in their order, and says which of them it has."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from threading import Event
from typing import Protocol

from drivers.errors import OneLineError
from drivers.tag import Tag
from gateway.store import FollowedRow


@dataclass(frozen=True, slots=True)
class OutgoingRow:
    """A row to hand on; `historical`: a newer one of its stream was there already when the sink was reached."""

    row: FollowedRow
    historical: bool


Present = Mapping[str, Sequence[FollowedRow]]
"""The newest row of each signal, by machine."""


Tags = Callable[[], Mapping[str, Mapping[str, Tag]]]
"""Gives the tags of each machine, by their names."""
Acknowledge = Callable[[str, Sequence[str], str], None]
"""Acknowledges alarms of a machine by their names, for somebody; it waits for nothing."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SinkContext:
    """What a sink may want of its gateway; `now` is the plant's time (s UTC)."""

    tags: Tags
    now: Callable[[], float]
    acknowledge: Acknowledge


class SinkUnreachable(OneLineError):
    """The sink cannot be reached, or does not answer: the rows are handed on again later. The message says why."""


class RowsRefused(OneLineError):
    """The sink will not have the next `count` rows, whenever they come. The message says why."""

    def __init__(self, count: int, reason: str) -> None:
        super().__init__(reason)
        self.count = count


class Sink(Protocol):
    """Used from one thread; `close` may be called at any time there, and several times."""

    @property
    def dropped(self) -> int:
        """The messages to this gateway that were left out: too many at a time, or not asked for."""

    def open(self, present: Present) -> None:
        """Begin a session; `present` is what stands now. Raises SinkUnreachable."""

    def deliver(self, rows: Sequence[OutgoingRow]) -> Iterator[int]:
        """Hand rows on; yields by how many more of them the sink has for sure.

        Raises SinkUnreachable, or RowsRefused for the rows that come next.
        """

    def idle(self, seconds: float, stop: Event) -> None:
        """Wait so long or until `stop`, and keep the session alive meanwhile. Raises SinkUnreachable."""

    def close(self) -> None:
        """End the session; what it has not said to have is handed on again."""

"""How far a feed has got: what it says to be handed on, the sink has."""

from collections.abc import Iterator, Sequence
from threading import Event

import pytest

from gateway.outside.northbound.feed import OutgoingRow
from gateway.outside.northbound.sink import Present, SinkUnreachable
from tests.northbound.rig import TABLES, Plant
from tests.rig.servers import until


class Faltering:
    """Takes so many rows in all, and is gone from then on."""

    dropped = 0

    def __init__(self, most: int) -> None:
        self.taken: list[tuple[str, str, int]] = []
        self.most = most
        self.refusals = 0

    def open(self, present: Present) -> None:
        """Always there."""

    def deliver(self, rows: Sequence[OutgoingRow]) -> Iterator[int]:
        for each in rows:
            if len(self.taken) == self.most:
                self.refusals += 1
                raise SinkUnreachable("it is gone")
            self.taken.append((each.row.stream.machine, each.row.stream.table, each.row.key))
            yield 1

    def idle(self, seconds: float, stop: Event) -> None:
        stop.wait(seconds)

    def close(self) -> None:
        """Nothing to end."""


@pytest.mark.parametrize("stops", [(0,), (1, 2), (137, 0, 3)])
def test_a_feed_that_ends_anywhere_leaves_out_no_row_that_its_sink_has_not(
    plant: Plant, stops: tuple[int, ...]
) -> None:
    """It saves where it is at each failure, and at its end, with rows of several streams in its hand."""
    plant.scan(60)
    taken: list[tuple[str, str, int]] = []
    for most in stops:
        sink = Faltering(most)
        feed = plant.feed(sink)
        until(lambda sink=sink: sink.refusals >= 2)
        feed.stop()
        feed.join()
        assert plant.store.flush(60.0)
        assert len(sink.taken) == feed.delivered == most
        taken += sink.taken
    wanted = {(machine, table, key) for table in TABLES for machine, key, _ in plant.rows(table)}
    last = Faltering(2 * len(wanted))
    plant.feed(last)
    until(lambda: wanted <= {*taken, *last.taken})
    taken += last.taken
    assert set(taken) == wanted
    # What was read at one time stays together: the sink gets its first part again, and nothing else.
    assert len(taken) - len(wanted) <= 3 * len(stops)

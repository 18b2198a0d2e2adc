"""Values as OPC UA has them, and their history, which is read from the historian: nothing is stored a second time."""

import asyncio
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from itertools import islice
from math import inf, nextafter
from pathlib import Path
from typing import Any

from asyncua import ua
from asyncua.server.history import HistoryStorageInterface

from drivers.tag import Quality
from gateway.outside.northbound.opcua_points import OpcUaPoint, PointType, make_point
from gateway.store import HistorianError, newest_scan, oldest_scan, reading, samples, stored_rows

MOST_VALUES = 10_000
"""Values in one answer; a client goes on by the continuation point."""
FIRST_WINDOW, LONGEST_WINDOW = 3600.0, 30 * 86_400.0
"""Seconds of the record that are read at a time: doubled while there is nothing, so that gaps cost little."""
TIME_RESOLUTION_S = 1e-6
"""A client is given times in whole microseconds, and asks by them for what is on record at finer ones."""

VARIANT_TYPES: Mapping[PointType, ua.VariantType] = {
    "double": ua.VariantType.Double,
    "boolean": ua.VariantType.Boolean,
    "string": ua.VariantType.String,
    "moment": ua.VariantType.DateTime,
}
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


class HistorianHistory(HistoryStorageInterface):  # type: ignore[misc]
    """Answers what clients ask of the past of readings (`Measured`) and predictions (`Predicted`)."""

    def __init__(self, path: Path, recorded: Callable[[ua.NodeId], OpcUaPoint | None]) -> None:
        super().__init__(MOST_VALUES)
        self._path, self._recorded = path, recorded

    async def init(self) -> None:
        """Nothing: the historian is the gateway's."""

    async def stop(self) -> None:
        """Nothing: the historian is the gateway's."""

    async def read_node_history(
        self, node_id: ua.NodeId, start: datetime | None, end: datetime | None, nb_values: int
    ) -> tuple[list[ua.DataValue], datetime | None]:
        """The recorded values of a node between two times, both included, backwards where `end` is before `start`.

        Without one of the times `nb_values` are given from the other. The second part is where to go on, or None.
        """
        point = self._recorded(node_id)
        if point is None:
            return [], None
        first, last = _seconds(start), _seconds(end)
        backwards = first is None or (last is not None and last < first)
        low, high = (last, first) if backwards and first is not None else (first, last)
        low = None if low is None else low - TIME_RESOLUTION_S
        high = None if high is None else high + TIME_RESOLUTION_S
        most = min(nb_values or MOST_VALUES, MOST_VALUES)

        def read() -> list[OpcUaPoint]:
            # One more, which says where to go on.
            return list(islice(recorded_points(self._path, point, low, high, backwards=backwards), most + 1))

        rows: list[OpcUaPoint] = []
        with suppress(HistorianError):  # of a machine that has no rows yet
            rows = await asyncio.to_thread(read)
        return [data_value(row) for row in rows[:most]], _moment(rows[most].time) if len(rows) > most else None


def recorded_points(
    historian: Path, point: OpcUaPoint, low: float | None, high: float | None, *, backwards: bool = False
) -> Iterator[OpcUaPoint]:
    """What a point was at low <= time <= high (s UTC; None: as far as the record goes), in the order of time.

    Raises HistorianError.
    """
    machine = point.path[0]
    with reading(historian) as connection:
        oldest, newest = oldest_scan(connection, machine=machine), newest_scan(connection, machine=machine)
    if oldest is None or newest is None:
        return
    # A reading may be older than its scan, and the clock may have been set back since.
    low = max(oldest - 60.0, -inf if low is None else low)
    high = min(newest + 86_400.0, inf if high is None else high)
    width = FIRST_WINDOW
    while low <= high:
        since, until = (max(high - width, low), high) if backwards else (low, min(low + width, high))
        # The store's own spans leave their end out.
        rows = _rows(historian, point, since, nextafter(until, inf))
        yield from reversed(rows) if backwards else rows
        if backwards:
            high = nextafter(since, -inf)
        else:
            low = nextafter(until, inf)
        width = FIRST_WINDOW if rows else min(2.0 * width, LONGEST_WINDOW)


def _rows(historian: Path, point: OpcUaPoint, since: float, until: float) -> list[OpcUaPoint]:
    """What it was at since <= time < until, in the order of time."""
    machine, folder, signal = point.path[:3]
    found: list[tuple[float, Any, Quality]]
    if folder == "Measured":
        found = [
            (one.time, one.value, one.quality) for one in samples(historian, signal, since, until, machine=machine)
        ]
    else:
        names = ("time", point.path[3], "known")
        with reading(historian) as connection:
            rows = stored_rows(connection, "predictions", names, since, until, machine=machine, temperature=signal)
        rows.sort(key=lambda row: row[0])
        # The zone says of itself what it is worth.
        sure = point.path[3] == "zone"
        found = [(time, value, Quality.GOOD if known or sure else Quality.UNCERTAIN) for time, value, known in rows]
    return [
        make_point(point.path, point.kind, value, quality, time=time, unit=point.unit, recorded=True)
        for time, value, quality in found
    ]


def data_value(point: OpcUaPoint) -> ua.DataValue:
    """A point as OPC UA has it: value, status code, source timestamp."""
    value: Any = point.value
    if value is not None and point.kind == "moment":
        value = _moment(value)
    kind = ua.VariantType.Null if value is None else VARIANT_TYPES[point.kind]
    status = ua.StatusCode(ua.UInt32(int(point.quality)))
    return ua.DataValue(ua.Variant(value, kind), StatusCode=status, SourceTimestamp=_moment(point.time))


def _moment(time: float) -> datetime:
    return _EPOCH + timedelta(seconds=time)


def _seconds(time: datetime | None) -> float | None:
    """A client's time in s UTC; None for none, which OPC UA writes as the year 1601."""
    if time is None or time.year < 1970:
        return None
    return (time if time.tzinfo else time.replace(tzinfo=UTC)).timestamp()

"""The historian's rows as tables that other programs read: which columns each has, their types, units and meanings.

One description for the export, for PostgreSQL and for the page of the documentation that shows it.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import TYPE_CHECKING, Any, Literal

from drivers.tag import Quality

if TYPE_CHECKING:
    from gateway.store.follow import FollowedRow

Kind = Literal["text", "real", "whole", "flag", "moment", "reals"]
Cells = tuple[str | float | int | bool | list[float] | None, ...]
"""One row; a moment is in s UTC."""


@dataclass(frozen=True, slots=True)
class TableColumn:
    """A column of a table; one that is `key` tells rows apart, together with the others."""

    name: str
    kind: Kind
    meaning: str
    key: bool = False


_MACHINE = TableColumn("machine", "text", "the machine's name", key=True)
_OF = TableColumn("temperature", "text", "the predicted temperature's tag", key=True)
_ROW = TableColumn("row", "whole", "the number of the row in the historian, which counts each table of a machine")


def _time(meaning: str) -> TableColumn:
    return TableColumn("time", "moment", meaning, key=True)


TABLE_COLUMNS: Mapping[str, Sequence[TableColumn]] = {
    "samples": (
        _MACHINE,
        TableColumn("tag", "text", "the tag's name", key=True),
        _time("of a good reading the moment it was read, of any other that of its scan"),
        TableColumn("value", "real", "the reading in `unit`, a bit as 0 or 1; none for a text, or without a reading"),
        TableColumn("text", "text", "the reading of a tag that is a text"),
        TableColumn("quality", "text", "OPC UA's status: GOOD, UNCERTAIN, TIMEOUT, ..."),
        TableColumn("unit", "text", "the unit of `value`"),
        _ROW,
    ),
    "predictions": (
        _MACHINE,
        _OF,
        _time("the scan's"),
        TableColumn("location", "text", "where the automaton was"),
        TableColumn("known", "flag", "whether that was known"),
        TableColumn("measured", "real", "what was read"),
        TableColumn("mean", "real", "what the model expected"),
        TableColumn("low", "real", "the lower end of its band"),
        TableColumn("high", "real", "the upper end of its band"),
        TableColumn("free_run", "real", "what the model alone, never corrected, has come to"),
        TableColumn("anomaly", "real", "how unlike the model what was read is, in standard deviations"),
        TableColumn("zone", "text", "how far the model is trusted: green, yellow, red"),
        _ROW,
    ),
    "forecasts": (
        _MACHINE,
        _OF,
        _time("when it was made"),
        TableColumn("horizon", "real", "how far it looks ahead, in s", key=True),
        TableColumn("levels", "reals", "the probabilities of `quantiles`"),
        TableColumn("quantiles", "reals", "the temperatures that are not passed with these probabilities"),
        TableColumn("p_limit", "real", "the probability that the limit is reached by then"),
        TableColumn("alarm_limit", "real", "that limit"),
        TableColumn("measured", "real", "what was read when it was made"),
        _ROW,
    ),
    "events": (
        _MACHINE,
        _OF,
        _time("of the event"),
        TableColumn("symbol", "text", "which it was, by the model's alphabet", key=True),
        TableColumn("location", "text", "where the automaton was after it"),
        _ROW,
    ),
    "alarms": (
        _MACHINE,
        TableColumn("condition", "text", "the alarm's name", key=True),
        _time("of the change"),
        TableColumn("tag", "text", "the tag that it watches"),
        TableColumn("priority", "whole", "from 1, the most urgent"),
        TableColumn("state", "text", "the state that it came into, by ISA-18.2"),
        TableColumn("value", "real", "what its condition looked at"),
        TableColumn("acknowledged_by", "text", "who had acknowledged it"),
        TableColumn("row", "whole", "the number of the row in the historian, which counts all alarms", key=True),
    ),
}
"""The columns of each table, in their order."""


def row_cells(row: FollowedRow) -> Cells:
    """A row's cells, in the order of TABLE_COLUMNS."""
    return tuple(_cell(column, row) for column in TABLE_COLUMNS[row.stream.table])


def _cell(column: TableColumn, row: FollowedRow) -> Any:
    values = row.values
    match column.name:
        case "machine":
            return row.stream.machine
        case "temperature":
            return row.stream.temperature
        case "row":
            return row.key
        case "alarm_limit":
            return values["limit"]
        case "quality":
            return Quality(values["quality"]).name
        case "text":
            return values["value"] if isinstance(values["value"], str) else None
    value = values[column.name]
    match column.kind:
        case "reals":
            return [float(one) for one in json.loads(value)]
        case "flag":
            return bool(value)
        case "real" if value is None or isinstance(value, str) or not isfinite(value):
            return None
        case "real":
            return float(value)
    return value

"""Readings as JSON keeps them: pairs of a time and a value, frames of columns, lists of readings within a row."""

import re
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

DATED = re.compile(r"(?:19|20)\d\d-\d\d|\d\d?:\d\d|1\d{9}(?:\d{3}){0,3}(?:\.|$)")
"""How a time begins, as text or as a count since 1970."""
_NAME_KEYS = ("name", "tag", "key", "field", "topic", "path", "signal", "metric", "sensor", "channel", "id")
"""What readings within a row may call their names, the likeliest first."""
_PLAIN_KEYS = {"v": "value", "val": "value", "t": "time"}
_LOOKED_AT = 50
"""Pairs that show which of their cells is the time."""


def name_pairs(document: Any) -> Any:
    """A document whose pairs [time, value], in either order, and frames of columns are objects with names."""
    if isinstance(document, list):
        at = _time_of_pairs(document)
        if at is not None:
            return [{"time": pair[at], "value": pair[1 - at]} for pair in document]
        return [name_pairs(each) if isinstance(each, dict | list) else each for each in document]
    if not isinstance(document, dict):
        return document
    if (frame := _frame(document)) is not None:
        return frame
    if isinstance(document.get("columns"), list):
        # Rows whose columns have names of their own.
        return document
    return {name: name_pairs(each) if isinstance(each, dict | list) else each for name, each in document.items()}


def _time_of_pairs(rows: Sequence[Any]) -> int | None:
    """Which cell of each of `rows` is a time, if all are pairs of single cells of which the other is a reading."""
    if len(rows) < 2 or not all(isinstance(row, list) and len(row) == 2 for row in rows):
        return None
    if any(isinstance(cell, dict | list) for row in rows for cell in row):
        return None
    shown = rows[:_LOOKED_AT]
    dated = [at for at in (0, 1) if all(DATED.match(str(row[at])) for row in shown)]
    rising = [at for at in dated or (0, 1) if _rises([row[at] for row in shown])]
    return (rising or dated)[0] if len(rising or dated) == 1 else None


def _rises(cells: Sequence[Any]) -> bool:
    try:
        counts = [float(cell) for cell in cells]
    except (TypeError, ValueError):
        return False
    return all(early < late for early, late in pairwise(counts)) or all(
        early > late for early, late in pairwise(counts)
    )


def _frame(document: dict[str, Any]) -> dict[str, Any] | None:
    """A data frame as dashboards hand it out: the fields of its schema, and a list of values for each."""
    schema, data = document.get("schema"), document.get("data")
    if not isinstance(schema, dict) or not isinstance(data, dict):
        return None
    fields, columns = schema.get("fields"), data.get("values")
    if not isinstance(fields, list) or not isinstance(columns, list) or len(fields) != len(columns) or not columns:
        return None
    if not all(isinstance(each, dict) and isinstance(each.get("name"), str) for each in fields):
        return None
    if not all(isinstance(column, list) and len(column) == len(columns[0]) for column in columns):
        return None
    # Of two columns the second is the series' reading, and what it is called stands beside them.
    named = [field["name"] for field in fields] if len(fields) > 2 else ["time", "value"]
    labels = (each["labels"] for each in fields if isinstance(each.get("labels"), dict))
    about: dict[str, Any] = {"name": schema["name"]} if isinstance(schema.get("name"), str) else next(labels, {})
    return {**about, "rows": [dict(zip(named, row, strict=True)) for row in zip(*columns, strict=True)]}


def spread_readings(row: dict[str, Any]) -> list[dict[str, Any]]:
    """A row that holds a list of readings with names as a row for each; any other as it is."""
    lists = {name: named for name, each in row.items() if (named := _name_of_readings(each))}
    if len(lists) != 1:
        return [row]
    ((within, named),) = lists.items()
    about = {name: each for name, each in row.items() if name != within}
    new = {**_PLAIN_KEYS, named: "name"}
    own = [{new.get(key, key): cell for key, cell in reading.items()} for reading in row[within]]
    # A clock of the row beside one of each reading says the same, under another name.
    timed = any("time" in reading for reading in own)
    about = {name: each for name, each in about.items() if not (timed and DATED.match(str(each)))}
    return [{**about, **reading} for reading in own]


def _name_of_readings(value: Any) -> str:
    """What each object of a list of readings calls its name; "" for what is no list of readings."""
    if not isinstance(value, list) or not value or not all(isinstance(each, dict) for each in value):
        return ""
    if not all(any(isinstance(each.get(key), str | bool) for key in _VALUE_NAMES) for each in value):
        return ""
    return next((key for key in _NAME_KEYS if all(isinstance(each.get(key), str) for each in value)), "")


_VALUE_NAMES = ("value", "v", "val")

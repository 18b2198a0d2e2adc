"""Readings as JSON keeps them: pairs of a time and a value, frames of columns, lists of readings within a row."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from sim.lab.recordings.clock_formats import tells_time
from sim.lab.recordings.load_report import TraceError

TIME_NAMES = frozenset(("t", "ts", "time", "timestamp", "date", "datetime"))
VALUE_NAMES = frozenset(("v", "val"))
"""What programs call a reading's value beside `value`."""
_NAME_KEYS = ("name", "tag", "key", "field", "topic", "path", "signal", "metric", "sensor", "channel", "id")
"""What readings within a row may call their names, the likeliest first."""
_LOOKED_AT = 50
"""Pairs that show which of their cells is a date."""
Pairs = list[list[Any]]


def name_pairs(document: Any) -> Any:
    """A document whose pairs of a date and a value, in either order, and frames of columns are objects with names.

    Raises TraceError, without the file's name, where nobody can tell a pair's time or the columns of a frame. Pairs
    that count from 0 are refused too: a spectrum is written like elapsed times.
    """
    lists = list(_pairs_within(document))
    dated = {id(rows): _dated_cells(rows) for rows in lists}
    times = {rows: at[0] for rows, at in dated.items() if len(at) == 1}
    # Few pairs of no time are limits, or places.
    lost = bool(lists) and not times and 4 * sum(map(len, lists)) > _count_cells(document)
    if lost or any(len(at) > 1 for at in dated.values()):
        raise TraceError(
            "its JSON has pairs of which nobody can tell the time: either cell may be one, or neither; give them as "
            'objects with "time" and "value", or a CSV'
        )
    return _named(document, times)


def _named(document: Any, times: Mapping[int, int]) -> Any:
    if (at := times.get(id(document))) is not None:
        return [{"time": pair[at], "value": pair[1 - at]} for pair in document]
    if isinstance(document, list):
        return [_named(each, times) for each in document]
    if not isinstance(document, dict) or _names_columns(document):
        return document
    return _frame(document) or {name: _named(each, times) for name, each in document.items()}


def _names_columns(document: Any) -> bool:
    """Whether the rows of an object have the names of their columns beside them."""
    return isinstance(document, dict) and isinstance(document.get("columns"), list)


def _frame_parts(document: Any) -> tuple[list[Any], list[Any]] | None:
    """The fields and the columns of a data frame; None for what is none."""
    if not isinstance(document, dict):
        return None
    schema, data = document.get("schema"), document.get("data")
    fields, columns = (
        part.get(key) if isinstance(part, dict) else None for part, key in ((schema, "fields"), (data, "values"))
    )
    return (fields, columns) if isinstance(fields, list) and isinstance(columns, list) else None


def _pairs_within(document: Any) -> Iterator[Pairs]:
    """The lists of a document that hold nothing but pairs of single cells."""
    if isinstance(document, list) and document and all(map(_is_pair, document)):
        yield document
        return
    holds = isinstance(document, list) or not (_names_columns(document) or _frame_parts(document))
    for each in (document.values() if isinstance(document, dict) else document) if holds else ():
        if isinstance(each, dict | list):
            yield from _pairs_within(each)


def _is_pair(row: Any) -> bool:
    return isinstance(row, list) and len(row) == 2 and not any(isinstance(cell, dict | list) for cell in row)


def _count_cells(document: Any) -> int:
    if not isinstance(document, dict | list):
        return 1
    return sum(map(_count_cells, document.values() if isinstance(document, dict) else document))


def _dated_cells(rows: Pairs) -> list[int]:
    """Which cells of pairs are dates, but for a damaged row, which costs itself."""
    shown = rows[:_LOOKED_AT]
    return [at for at in (0, 1) if 2 * sum(tells_time(str(row[at])) for row in shown) > len(shown)]


def _frame(document: dict[str, Any]) -> dict[str, Any] | None:
    """A data frame as dashboards hand it out: the fields of its schema, and a list of values for each."""
    parts, schema = _frame_parts(document), document.get("schema", {})
    if parts is None:
        return None
    fields, columns = parts
    if len(fields) != len(columns) or not columns:
        return None
    if not all(isinstance(each, dict) and isinstance(each.get("name"), str) for each in fields):
        return None
    if not all(isinstance(column, list) and len(column) == len(columns[0]) for column in columns):
        return None
    times = [at for at, field in enumerate(fields) if field.get("type") == "time"]
    times = times or [at for at, field in enumerate(fields) if field["name"].casefold() in TIME_NAMES]
    # A temperature is called T, too.
    times = [at for at in times if fields[at]["name"].casefold() != "t"] or times
    names = [_called(field) or field["name"] for field in fields]
    if len(fields) > 2 and len(set(names)) == len(names) and not any(map(_labels, fields)):
        about = {"name": schema["name"]} if isinstance(schema.get("name"), str) else {}
        return {**about, "rows": [dict(zip(names, row, strict=True)) for row in zip(*columns, strict=True)]}
    abouts = [_about(field, schema.get("name")) for at, field in enumerate(fields) if at not in times]
    readings = [column for at, column in enumerate(columns) if at not in times]
    if len(times) != 1 or any(about in abouts[:at] for at, about in enumerate(abouts)):
        raise TraceError(
            f"its JSON has a frame whose fields {', '.join(map(repr, names))} are not one time and readings that their "
            "names or labels tell apart; name each of them, or give a CSV"
        )
    return {
        "rows": [
            with_reading(about, {"time": time, "value": value})
            for about, values in zip(abouts, readings, strict=True)
            for time, value in zip(columns[times[0]], values, strict=True)
        ]
    }


def _called(field: Mapping[str, Any]) -> str:
    """What a dashboard shows a field as, or its own name; "" for a name that all fields have."""
    config = field.get("config")
    shown = [config.get(key) for key in ("displayNameFromDS", "displayName")] if isinstance(config, dict) else []
    own = "" if field["name"].casefold() in ("", "value", *VALUE_NAMES) else field["name"]
    return next((each for each in shown if isinstance(each, str) and each), own)


def _about(field: Mapping[str, Any], frame: Any) -> dict[str, Any]:
    """What tells the readings of a field from those of others: its name, its labels, the name of its frame."""
    name, labels = _called(field), _labels(field)
    if not isinstance(frame, str) or frame in ("", name):
        return with_reading(labels, {"name": name} if name else {})
    if not name and not labels:
        return {"name": frame}
    return with_reading({"frame": frame, **labels}, {"name": name} if name else {})


def _labels(field: Mapping[str, Any]) -> dict[str, Any]:
    labels = field.get("labels")
    own = labels if isinstance(labels, dict) else {}
    return {f"label.{key}" if key in ("time", "value") else key: each for key, each in own.items()}


def with_reading(about: Mapping[str, Any], reading: Mapping[str, Any]) -> dict[str, Any]:
    """A reading with what is said of where it comes from: of two names the other one is the machine's."""
    other = "machine.name" if "machine" in about else "machine"
    return {**{other if key == "name" and key in reading else key: each for key, each in about.items()}, **reading}


def spread_readings(row: dict[str, Any]) -> list[dict[str, Any]]:
    """A row that holds a list of readings with names as a row for each; any other as it is."""
    lists = {name: named for name, each in row.items() if (named := _name_of_readings(each))}
    if len(lists) != 1:
        return [row]
    ((within, named),) = lists.items()
    about = {name: each for name, each in row.items() if name != within}
    own = _clock([about], alone=True)
    clock = _clock(row[within], alone=not own)
    readings = [_plain(reading, named, clock) for reading in row[within]]
    if clock:
        # A clock of the row beside one of each reading says the same; it holds for a reading that has none.
        about = _plain(about, "name", own)
    return [with_reading(about, reading) for reading in readings]


def _clock(rows: Sequence[Mapping[str, Any]], *, alone: bool) -> str:
    """The only key of rows that is called like a time and mostly tells one; "" for none.

    T may be a temperature. Where it is `alone`, as nothing else may be the time, it may count from 0.
    """
    cells: dict[str, list[bool]] = {}
    for row in rows:
        for key in row:
            if key.casefold() in TIME_NAMES:
                cells.setdefault(key, []).append(tells_time(str(row[key])))
    clocks = [key for key, told in cells.items() if 2 * sum(told) > len(told)] or list(cells) * alone
    return clocks[0] if len(clocks) == 1 else ""


def _plain(row: Mapping[str, Any], named: str, clock: str) -> dict[str, Any]:
    """A row whose clock, only value and name are `time`, `value` and `name`; `tag.name` is a tag's other name."""
    new = {} if clock in ("", "time") else {clock: "time", "time": f"{clock}.time"}
    new |= {} if named == "name" else {named: "name", "name": f"{named}.name"}
    values = [key for key in row if key.casefold() in ("value", *VALUE_NAMES)]
    new |= dict.fromkeys(values, "value") if len(values) == 1 else {}
    return {new.get(key, key): cell for key, cell in row.items()}


def _name_of_readings(value: Any) -> str:
    """What each object of a list of readings calls its name; "" for what is no list of readings."""
    if not isinstance(value, list) or not value or not all(isinstance(each, dict) for each in value):
        return ""
    # A value that is null is a reading without one.
    keys = ("value", *VALUE_NAMES)
    if not all(any(key in each and not isinstance(each[key], dict | list) for key in keys) for each in value):
        return ""
    return next((key for key in _NAME_KEYS if all(isinstance(each.get(key), str) for each in value)), "")

"""The commands of `decanter historian`: the records as CSV, Parquet, JSON or a table on the terminal."""

from __future__ import annotations

import json
import os
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib import import_module
from itertools import islice
from math import inf, isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

from drivers.csv_rows import write_rows
from gateway.console import CommandResult, Part, Rows, conclude
from gateway.entry import sentences
from gateway.extras import missing_sentence
from gateway.settings import load_plant
from gateway.store import TABLE_COLUMNS, Cells, TableColumn, row_cells, sync_folder

if TYPE_CHECKING:
    from gateway.store import FollowedRow

Writer = Callable[[Sequence[Cells]], None]
ROWS_PER_WRITE = 20_000
"""Rows that are written at a time."""
PARQUET = {"text": "string", "real": "float64", "whole": "int64", "flag": "bool_"}
"""pyarrow's types of the kinds of columns, by the names of their functions."""
TREND_COLUMNS = ("start", "count", "low", "mean", "high")


@dataclass(frozen=True, slots=True)
class RecordsWindow:
    """Whose rows are meant: these `machines` of the historian at `path`, with start <= time < end (s UTC)."""

    path: Path
    machines: Sequence[str]
    start: float
    end: float


def _window(plant: Path, machine: str | None, since: str, until: str | None) -> RecordsWindow:
    """Raises ConfigError, HistorianError, and ValueError for a time that is none, or a machine that is not there."""
    from gateway.store import machines, newest_scan, parse_moment, reading  # loads numpy, as the readers below do

    path = load_plant(plant)[0].historian.path
    with reading(path) as connection:
        there = [name for name, _ in machines(connection)]
        if machine is not None and machine not in there:
            raise ValueError(f"{path}: has no rows of a machine {machine!r}; it has those of {', '.join(there)}")
        named = there if machine is None else [machine]
        newest = [time for name in named if (time := newest_scan(connection, machine=name)) is not None]
    if not newest:
        raise ValueError(f"{path}: has no scan yet; let the gateway run first")
    start = -inf if since == "all" else parse_moment(since, max(newest))
    end = inf if until is None else parse_moment(until, max(newest))
    if end <= start:
        raise ValueError(f"--until {until} is not after --since {since}; give a later one")
    return RecordsWindow(path, named, start, end)


def _rows(window: RecordsWindow, name: str, tag: str | None) -> Iterator[FollowedRow]:
    """The rows of a table; with a `tag` those that name it: a sample's, a predicted temperature's, an alarm's."""
    from gateway.store import reading, select_rows

    with reading(window.path) as connection:
        for row in select_rows(connection, window.machines, name, window.start, window.end):
            own = (row.values.get("tag"), row.values.get("condition"), row.stream.temperature or None)
            if tag is None or tag in own:
                yield row


# -------------------------------------------------------------------- export


def export(
    file: Path,
    name: str,
    tag: str | None,
    since: str,
    until: str | None,
    path: Path,
    machine: str | None,
    as_json: bool,
) -> None:
    """The work of `historian export`."""
    with sentences():
        if file.suffix not in WRITERS:
            raise ValueError(f"{file}: ends neither in .csv nor in .parquet; name it so")
        window = _window(path, machine, since, until)
        draft = file.with_name(f".{file.name}.{os.getpid()}")
        count = 0
        try:
            with WRITERS[file.suffix](draft, TABLE_COLUMNS[name]) as write:
                rows = map(row_cells, _rows(window, name, tag))
                while batch := list(islice(rows, ROWS_PER_WRITE)):
                    write(batch)
                    count += len(batch)
            with draft.open("rb") as written:
                os.fsync(written.fileno())
            draft.replace(file)
            sync_folder(file.absolute().parent)
        except OSError as error:
            raise ValueError(f"{file}: cannot be written ({(error.strerror or str(error)).lower()})") from None
        finally:
            draft.unlink(missing_ok=True)
    size = file.stat().st_size
    data = {"file": str(file), "table": name, "rows": count, "bytes": size}
    sentence = f"{file}: {count} rows of {name}, {size / 1e6:.2f} MB"
    conclude(CommandResult(data), lambda _: [sentence], as_json=as_json)


@contextmanager
def _csv_writer(path: Path, columns: Sequence[TableColumn]) -> Iterator[Writer]:
    with path.open("w", newline="", encoding="utf-8") as file:
        write_rows(file, [[column.name for column in columns]])
        kinds = [column.kind for column in columns]

        def write(rows: Sequence[Cells]) -> None:
            write_rows(file, ([_as_text(kind, cell) for kind, cell in zip(kinds, row, strict=True)] for row in rows))

        yield write


@contextmanager
def _parquet_writer(path: Path, columns: Sequence[TableColumn]) -> Iterator[Writer]:
    try:
        arrow, parquet = import_module("pyarrow"), import_module("pyarrow.parquet")
    except ImportError as error:
        raise ValueError(f"Parquet {missing_sentence('parquet', error)}; or export .csv") from None

    types = {kind: getattr(arrow, name)() for kind, name in PARQUET.items()}
    types |= {"moment": arrow.timestamp("us", tz="UTC"), "reals": arrow.list_(arrow.float64())}
    schema = arrow.schema(
        [arrow.field(one.name, types[one.kind], metadata={"meaning": one.meaning}) for one in columns]
    )
    with parquet.ParquetWriter(path, schema) as writer:

        def write(rows: Sequence[Cells]) -> None:
            cells = [
                [round(1e6 * cell) for cell in of_column] if column.kind == "moment" else list(of_column)
                for column, of_column in zip(columns, zip(*rows, strict=True), strict=True)
            ]
            arrays = [
                arrow.array(of_column, arrow.int64()).cast(field.type)
                if column.kind == "moment"
                else arrow.array(of_column, field.type)
                for column, of_column, field in zip(columns, cells, schema, strict=True)
            ]
            writer.write_table(arrow.Table.from_arrays(arrays, schema=schema))

        yield write


WRITERS = {".csv": _csv_writer, ".parquet": _parquet_writer}
"""How a file is written, by its ending."""


def _as_text(kind: str, cell: Any) -> Any:
    """A cell as CSV has it: times by ISO 8601, lists as JSON, nothing where there is nothing."""
    if kind == "moment":
        return _date(cell)
    if kind == "reals":
        return json.dumps(cell)
    return ("true" if cell else "false") if kind == "flag" else cell


def _date(seconds: float) -> str:
    return datetime.fromtimestamp(seconds, UTC).isoformat(timespec="microseconds").replace("+00:00", "Z")


# -------------------------------------------------------------------- query


def query(
    name: str,
    tag: str | None,
    since: str,
    until: str | None,
    last: int,
    every: str | None,
    path: Path,
    machine: str | None,
    as_json: bool,
) -> None:
    """The work of `historian query`."""
    with sentences():
        window = _window(path, machine, since, until)
        head: Sequence[str]
        if every is None:
            head = [column.name for column in TABLE_COLUMNS[name]]
            found = [row_cells(row) for row in deque(_rows(window, name, tag), last)]
        else:
            head, found = TREND_COLUMNS, _means(window, name, tag, int(every))[-last:]
    moment = next(place for place, column in enumerate(head) if column in ("time", "start"))
    shown = [[_date(cell) if place == moment else cell for place, cell in enumerate(row)] for row in found]  # type: ignore[arg-type]
    rows = [dict(zip(head, row, strict=True)) for row in shown]

    def show_rows() -> Iterator[Part]:
        yield Rows(f"{len(rows)} rows", head, [["–" if cell is None else cell for cell in row] for row in shown])

    conclude(CommandResult({"rows": rows}), lambda _: show_rows(), as_json=as_json)


def _means(window: RecordsWindow, name: str, tag: str | None, width: int) -> list[Cells]:
    if name != "samples" or tag is None:
        raise ValueError("--every is of a tag's samples; give `samples --tag TAG --every 60`")
    if len(window.machines) > 1:
        raise ValueError(f"--every is of one machine; name one of {', '.join(window.machines)} (--machine NAME)")
    from gateway.store import newest_scan, reading, trend

    with reading(window.path) as connection:
        newest = newest_scan(connection, machine=window.machines[0])
    end = window.end if isfinite(window.end) else (newest or 0.0) + width
    start = window.start if isfinite(window.start) else 0.0
    found = trend(window.path, tag, start, end, width=width, machine=window.machines[0])
    columns = (found.starts, found.count.astype(int), found.low, found.mean, found.high)
    return list(zip(*(column.tolist() for column in columns), strict=True))


def tables(as_json: bool) -> None:
    """The work of `historian tables`."""
    data = {
        name: [{"column": one.name, "kind": one.kind, "key": one.key, "meaning": one.meaning} for one in columns]
        for name, columns in TABLE_COLUMNS.items()
    }

    def show_tables() -> Iterator[Part]:
        for name, columns in TABLE_COLUMNS.items():
            yield Rows(name, ("column", "kind", "what it is"), [[one.name, one.kind, one.meaning] for one in columns])

    conclude(CommandResult({"tables": data}), lambda _: show_tables(), as_json=as_json)

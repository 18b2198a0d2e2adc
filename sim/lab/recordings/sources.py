"""Files of recordings as text: as they lie there, packed, or from a spreadsheet, a Parquet table or JSON.

Each kind has its kept library, which is imported where such a file is read.
"""

import gzip
import io
import json
import re
import zipfile
import zlib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from importlib import import_module
from itertools import chain
from pathlib import Path
from typing import Any, BinaryIO, cast

from drivers.csv_rows import write_rows
from drivers.named_files import regular
from sim.lab.recordings.clock_formats import tells_time
from sim.lab.recordings.foreign_tables import find_layout_of
from sim.lab.recordings.json_readings import TIME_NAMES, VALUE_NAMES, name_pairs, spread_readings, with_reading
from sim.lab.recordings.load_report import TraceError
from sim.lab.recordings.text_encoding import decode_head

UNPACK_ERRORS = (EOFError, zlib.error, zipfile.BadZipFile)
"""What a packed file raises that is cut off, while it is read."""
_PACKED_SUFFIXES = (".gz", ".zip", ".zst")
_JSON_SUFFIXES = (".json", ".jsonl", ".ndjson")
_TEXT_SUFFIXES = (".csv", ".txt", ".tsv", ".dat", ".log")


_DAMAGE_ERRORS = (KeyError, ValueError, RuntimeError, SyntaxError)
"""What the libraries raise beside: of a password, of a packing they do not know, of XML that is none."""


MAX_UNPACKED_BYTES = 512 << 20
"""Bytes of XML of a workbook, at most: a sheet of its greatest length, a million rows of ten columns."""


def open_source(path: Path) -> BinaryIO:
    """The bytes of a recording's text. Raises TraceError for a packed file that holds none or several, OSError."""
    suffix = path.suffix.lower()
    kind = _KINDS.get(suffix)
    if kind is None:
        stream = regular(path).open("rb")
        if not _holds_json(path, stream):
            return _as_table(path, stream)
        stream.close()
        kind = _json
    try:
        found = kind(regular(path))
        return _as_table(path, found) if suffix in _PACKED_SUFFIXES else found
    except (zipfile.BadZipFile, gzip.BadGzipFile, zlib.error, EOFError, *_DAMAGE_ERRORS) as error:
        if isinstance(error, TraceError):
            raise
        raise TraceError(f"{path}: it is no {path.suffix[1:]} file that can be unpacked ({error})") from None


_LAYOUT_BYTES = 16_384
"""Bytes of a text that show how it is laid out."""


def _as_table(path: Path, stream: BinaryIO) -> BinaryIO:
    """A text as it is, or as a CSV where it is laid out otherwise. Raises TraceError for one that cannot be read so."""
    stream.seek(0)
    try:
        head = stream.read(_LAYOUT_BYTES)
        encoding, text, _ = decode_head(path, head, "auto")
    except (TraceError, *UNPACK_ERRORS, *_DAMAGE_ERRORS):
        return stream  # no text, or cut off: that is refused where it is read
    finally:
        stream.seek(0)
    if (to_rows := find_layout_of(text)) is None:
        return stream
    with io.TextIOWrapper(stream, encoding=encoding, errors="replace", newline=None) as lines:
        try:
            return _write_rows(to_rows(_bounded(lines)))
        except TraceError as error:
            raise TraceError(f"{path}: {error}") from None
        except (ValueError, OverflowError) as error:
            raise TraceError(f"{path}: it is not laid out as its first lines say ({error}); export it anew") from None


_MAX_LINE = 1 << 17
"""Letters of a line, at most: no more are one cell for Python's csv."""


def _bounded(lines: io.TextIOWrapper) -> Iterator[str]:
    """The lines of a text whose rows are in memory. Raises TraceError, without the file's name, for too many."""
    letters = 0
    while line := lines.readline(_MAX_LINE + 1):
        letters += len(line)
        if len(line) > _MAX_LINE:
            raise TraceError(f"one of its lines has more than {_MAX_LINE} letters; export it anew")
        if letters > MAX_UNPACKED_BYTES:
            raise TraceError(f"its text is too long, {MAX_UNPACKED_BYTES >> 20} MiB are the most; give a CSV")
        yield line


def read_head(path: Path, size: int) -> bytes:
    """The first bytes of a recording's text. Raises TraceError for a packed file that ends too early, OSError."""
    try:
        with open_source(path) as stream:
            return stream.read(size)
    except UNPACK_ERRORS as error:
        raise TraceError(f"{path}: it ends within what was packed ({error}); give the whole file") from None


def recording_name(path: Path) -> str:
    """The name of a recording's file without what says how it is written."""
    packed = path.suffix.lower() in _PACKED_SUFFIXES and Path(path.stem).suffix
    return Path(path.stem).stem if packed else path.stem


def named_after(name: str, others: Iterable[str]) -> str:
    """The longest of other files' names that stands in a file's own as whole words; "" for none."""
    fitting = [other for other in others if re.search(rf"(?<![^\W_]){re.escape(other)}(?![^\W_])", name, re.IGNORECASE)]
    return max(fitting, key=len, default="")


def is_recording(path: Path) -> bool:
    """Whether a file of a folder is a recording by its name: a CSV, also packed, or a table of another program."""
    names = [suffix.lower() for suffix in path.suffixes]
    packed = names[-2:-1] == [".csv"] and names[-1] in _PACKED_SUFFIXES
    return names[-1:] in ([".csv"], [".xlsx"], [".parquet"], [".jsonl"], [".ndjson"]) or packed


def is_json(path: Path) -> bool:
    """Whether a file is JSON by its name: beside other recordings it tells of them, and is none."""
    return path.suffix.lower() in _JSON_SUFFIXES


def _zip(path: Path) -> BinaryIO:
    archive = zipfile.ZipFile(path)
    members = [name for name in archive.namelist() if Path(name).suffix.lower() in _TEXT_SUFFIXES]
    if len(members) != 1:
        raise TraceError(f"{path}: {len(members)} of its files are tables; unpack it, and give the one or the folder")
    return cast(BinaryIO, archive.open(members[0]))


def _zst(path: Path) -> BinaryIO:
    try:
        from compression import zstd  # type: ignore[import-not-found,unused-ignore]
    except ImportError:
        raise TraceError(f"{path}: this Python does not unpack .zst; unpack it, or pack it with gzip") from None
    return cast(BinaryIO, zstd.open(path, "rb"))


def _xlsx(path: Path) -> BinaryIO:
    from openpyxl import load_workbook

    with zipfile.ZipFile(path) as parts:
        # Sheets are XML that is packed to a twentieth, and a crafted one to a thousandth.
        size = sum(part.file_size for part in parts.infolist())
    if size > MAX_UNPACKED_BYTES:
        raise TraceError(
            f"{path}: its sheets are {size >> 20} MiB of XML, {MAX_UNPACKED_BYTES >> 20} MiB are the most that is "
            "opened; "
            "export it as CSV"
        )
    book = load_workbook(path, read_only=True, data_only=True)
    filled = [sheet for sheet in book.worksheets if sheet.max_row and sheet.max_row > 1]
    if len(filled) != 1:
        names = ", ".join(sheet.title for sheet in filled)
        raise TraceError(f"{path}: {len(filled)} of its sheets are tables ({names}); give a file with one")
    return _write_rows(filled[0].iter_rows(values_only=True))


def _parquet(path: Path) -> BinaryIO:
    try:
        arrow, parquet = import_module("pyarrow"), import_module("pyarrow.parquet")
    except ImportError:
        raise TraceError(f"{path}: reading .parquet needs the extra `parquet`; install it, or export a CSV") from None
    try:
        table = parquet.read_table(path)
    except arrow.ArrowInvalid as error:
        raise TraceError(f"{path}: it is no Parquet file: {error}") from None
    rows = zip(*(column.to_pylist() for column in table.columns), strict=True)
    return _write_rows([table.column_names, *rows])


_SHOWN_BYTES = 512
_MAX_DOCUMENT_BYTES = 64 << 20
"""Bytes of JSON that is one document, which is in memory as a whole and takes ten times as many there."""
_OBJECT = re.compile(rb'(?:\xef\xbb\xbf)?\s*(?:\[\s*)*\{\s*"[^"]*"\s*:')
"""How JSON begins that holds objects, whatever the name of its file."""
_BEGINS = re.compile(rb"(?:\xef\xbb\xbf)?\s*[\[{]")


def _holds_json(path: Path, stream: BinaryIO) -> bool:
    """Whether a file is JSON by what stands in it: one line of it may be what a CSV begins with."""
    head = stream.read(_SHOWN_BYTES)
    named = is_json(path)
    if b"\0" in head or not (_BEGINS if named else _OBJECT).match(head):
        return named and b"\0" in head
    stream.seek(0)
    filled = filter(None, map(bytes.strip, stream))
    first, second = next(filled, b""), next(filled, b"{")
    if second[:1] in (b"{", b"[", b"]"):
        return True
    try:
        # The columns of a CSV begin after what is whole by itself.
        json.loads(first)
    except ValueError:
        stream.seek(0)
        try:
            json.loads(stream.read(_MAX_DOCUMENT_BYTES + 1))
        except ValueError:
            return named
        return True
    return False


def _json(path: Path) -> BinaryIO:
    """Objects of one line each, or of one document: a row each, and a column for each name that one of them has."""
    size = path.stat().st_size
    if size > MAX_UNPACKED_BYTES:
        raise TraceError(f"{path}: {size >> 20} MiB of JSON, {MAX_UNPACKED_BYTES >> 20} MiB are the most; give a CSV")
    counts, objects = Counter[str](), 0
    for each in _objects(path):
        counts.update(list(each) if isinstance(each, Mapping) else ())
        objects += isinstance(each, Mapping)
    if len(counts) < 2:
        raise TraceError(f"{path}: its JSON holds no list of objects with a time and readings; give one, or a CSV")
    common = {name for name, count in counts.items() if 2 * count >= objects}

    def rows() -> Iterator[list[str]]:
        # What is no object, or says what the others are about, costs its row: that has one cell, and comes last.
        odd = list[str]()
        for each in _objects(path):
            if isinstance(each, Mapping) and not common.isdisjoint(each):
                yield [each.get(name, "") for name in counts]
            else:
                odd.append(each if isinstance(each, str) else json.dumps(each))
        yield from ([text] for text in odd)

    return _write_rows(chain([list(counts)], rows()))


def _objects(path: Path) -> Iterator[Mapping[str, str] | str]:
    """The objects with their texts, those within them by names with points; the text of a line that is none."""
    with path.open(encoding="utf-8-sig", errors="replace") as lines:
        first = next(filter(str.strip, lines), "")
        try:
            by_line = isinstance(_parse(first), dict) and any(map(str.strip, lines))
        except TraceError:
            # Too deep, and whole: it costs its row, as it does farther down.
            by_line = first.lstrip().startswith("{") and any(map(str.strip, lines))
        except ValueError:
            by_line = False
        lines.seek(0)
        if not by_line:
            if path.stat().st_size > _MAX_DOCUMENT_BYTES:
                raise TraceError(
                    f"{path}: its JSON is one document of {path.stat().st_size >> 20} MiB, {_MAX_DOCUMENT_BYTES >> 20} "
                    "MiB are the most; write an object a line"
                )
            try:
                document = _parse(lines.read())
            except TraceError as error:
                raise TraceError(f"{path}: {error}") from None
            except ValueError as error:
                raise TraceError(f"{path}: its JSON breaks off or is none ({error}); give the whole file") from None
            try:
                found_rows = _collect_rows(name_pairs(document))
            except TraceError as error:
                raise TraceError(f"{path}: {error}") from None
            yield from map(_flatten, found_rows)
            return
        for line in filter(str.strip, lines):
            try:
                found = _parse(line)
            except ValueError:
                found = None
            if isinstance(found, dict):
                yield from map(_flatten, spread_readings(found))
            else:
                yield line.strip()


_MAX_DEPTH = 50
"""Objects and lists within one another, at most: no reading lies deeper."""


def _parse(text: str) -> Any:
    """The JSON of a text. Raises ValueError for none, TraceError, without the file's name, for one that is too deep."""
    deep = f"its JSON holds lists or objects more than {_MAX_DEPTH} deep; give a list of objects, one a reading"
    try:
        # Numbers as they are written: the digits say how fine a reading is.
        found = json.loads(text, parse_float=str, parse_int=str)
    except RecursionError:
        raise TraceError(deep) from None
    level = [found] if text.count("{") + text.count("[") > _MAX_DEPTH else []
    for _ in range(_MAX_DEPTH):
        level = [
            within
            for each in level
            for within in (each.values() if isinstance(each, dict) else each)
            if isinstance(within, dict | list)
        ]
    if level:
        raise TraceError(deep)
    return found


def _collect_rows(document: Any) -> list[dict[str, Any]]:
    """The objects of a document: of its lists, each with what names it if there are several; of its columns.

    Raises TraceError, without the file's name, where it cannot be told what a reading is of.
    """
    if isinstance(document, list):
        document = _spread_rows(document)
        holders = [each for each in document if _holds_rows(each)]
        own = [_collect_rows(each) for each in holders]
        names = _names_apart(holders)
        if len(holders) > 1 and not all(names):
            keys = {key for rows in own for row in rows if isinstance(row, dict) for key in row}
            if (len(keys) == 2 and "value" in keys) or _as_readings(own) != own:
                raise TraceError(
                    "its JSON has lists of one reading a time, and no name tells them apart; give each its name, "
                    "or a CSV"
                )
        elif len(holders) > 1:
            own = [
                [with_reading(name, one) for one in rows] for name, rows in zip(names, _as_readings(own), strict=True)
            ]
        found = iter(own)
        return [one for each in document for one in (next(found) if _holds_rows(each) else [each])]
    if not isinstance(document, dict):
        return []
    if _is_table(document):
        rows, names = document["data"] if "data" in document else document["values"], document["columns"]
        for number, row in enumerate(rows, 1):
            if len(row) != len(names):
                raise TraceError(
                    f"row {number} of its JSON has {len(row)} cells, and it names {len(names)} columns; give each row "
                    "a cell for each of them, null where there is none"
                )
        return [dict(zip(map(str, names), row, strict=True)) for row in rows]
    columns = [list(each.values()) if isinstance(each, dict) else each for each in document.values()]
    plain = len(columns) > 1 and all(
        isinstance(each, list) and not _is_objects(each) and not any(map(_is_objects, each[:1])) for each in columns
    )
    if plain and len(set(map(len, columns))) == 1:
        return [dict(zip(document, row, strict=True)) for row in zip(*columns, strict=True)]
    lists = {name: each for name, each in document.items() if _is_objects(each)}
    if len(lists) == 1:
        return _collect_rows(next(iter(lists.values())))
    within = lists or {name: each for name, each in document.items() if isinstance(each, dict)}
    parts = {name: rows for name, each in within.items() if (rows := _collect_rows(each))}
    if len(parts) == 1:
        return next(iter(parts.values()))
    return [
        with_reading({"name": name}, one)
        for name, rows in zip(parts, _as_readings(list(parts.values())), strict=True)
        for one in rows
    ]


def _spread_rows(rows: list[Any]) -> list[Any]:
    """Rows of a moment with its readings as a row for each; lists that are of one reading each stay as they are.

    A row has each name once, and other rows have it again; the points of a series have one name, or a number each.
    """
    spread = [spread_readings(row) if isinstance(row, dict) else [row] for row in rows]
    names = [[one["name"] for one in own] for row, own in zip(rows, spread, strict=True) if own != [row]]
    if sum(map(len, names)) <= len({name for own in names for name in own}):
        return rows
    return [one for own in spread for one in own] if all(len(set(own)) == len(own) for own in names) else rows


def _names_apart(holders: list[Any]) -> list[dict[str, Any]]:
    """What objects that hold rows say of them in words, and not all the same: a name, tags; {} where one says none."""
    said = [
        {name: text for name, text in _flatten(_without_lists(each)).items() if text and not _NUMBER.fullmatch(text)}
        for each in holders
    ]
    same = set(said[0].items()).intersection(*(each.items() for each in said)) if said else set()
    return [dict(each.items() - same) for each in said]


def _without_lists(value: Any) -> dict[str, Any]:
    if not isinstance(value, dict):
        return {}
    return {
        name: _without_lists(each) if isinstance(each, dict) else each
        for name, each in value.items()
        if not isinstance(each, list)
    }


_NUMBER = re.compile(r"[-+.\deE]+|true|false")


def _as_readings(lists: list[list[dict[str, Any]]]) -> list[list[dict[str, Any]]]:
    """Several lists under names: of `time` and `value` if each row is of one time with one reading, else as they are.

    A list of temperatures stays what it is: that is of a machine of its own.
    """
    names = {name for rows in lists for row in rows if isinstance(row, dict) for name in row}
    first = next((row for rows in lists for row in rows if isinstance(row, dict) and len(row) > 1), {})
    times = [name for name in first if name.casefold() in TIME_NAMES or tells_time(str(first[name]))]
    values = [name for name in names if name.casefold() in VALUE_NAMES] if len(names) > 2 else names - set(times)
    if len(times) != 1 or len(values) != 1 or "value" in names:
        return lists
    (time,), (value,) = times, values
    if "temp" in value.casefold() or isinstance(first.get(value), dict | list):
        return lists
    new = {value: "value", **({time: "time"} if time.casefold() in ("t", "x") else {})}
    return [
        [{new.get(name, name): each for name, each in row.items()} if isinstance(row, dict) else row for row in rows]
        for rows in lists
    ]


def _holds_rows(value: Any) -> bool:
    """Whether what stands in a list is no row but holds rows."""
    return isinstance(value, list) or (
        isinstance(value, dict) and (_is_table(value) or any(map(_is_objects, value.values())))
    )


def _is_table(value: Mapping[str, Any]) -> bool:
    """Whether an object has the names of columns apart from their rows."""
    rows = value.get("data", value.get("values"))
    named = isinstance(value.get("columns"), list) and isinstance(rows, list)
    return named and all(isinstance(row, list) for row in rows)


def _is_objects(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and all(isinstance(each, dict) for each in value)


def _flatten(value: Any, within: str = "") -> dict[str, str]:
    """What an object holds as texts; a list is one text."""
    if not isinstance(value, dict):
        text = value if isinstance(value, str) else "" if value is None else json.dumps(value, ensure_ascii=False)
        return {within: text}
    return {
        name: text
        for key, each in value.items()
        for name, text in _flatten(each, f"{within}.{key}" if within else key).items()
    }


def _write_rows(rows: Iterable[Iterable[object]]) -> BinaryIO:
    stream = io.BytesIO()
    text = io.TextIOWrapper(stream, encoding="utf-8", newline="")
    write_rows(text, rows)
    text.detach()
    stream.seek(0)
    return stream


def _gz(path: Path) -> BinaryIO:
    stream = gzip.GzipFile(path)
    stream.peek(1)
    return cast(BinaryIO, stream)


_KINDS: dict[str, Callable[[Path], BinaryIO]] = {
    ".gz": _gz,
    ".zip": _zip,
    ".zst": _zst,
    ".xlsx": _xlsx,
    ".parquet": _parquet,
    ".jsonl": _json,
    ".ndjson": _json,
}

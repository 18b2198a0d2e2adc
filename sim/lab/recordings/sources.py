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
from sim.lab.recordings.load_report import TraceError

UNPACK_ERRORS = (EOFError, zlib.error, zipfile.BadZipFile)
"""What a packed file raises that is cut off, while it is read."""
_PACKED_SUFFIXES = (".gz", ".zip", ".zst")
_TEXT_SUFFIXES = (".csv", ".txt", ".tsv", ".dat", ".log")


_DAMAGE_ERRORS = (KeyError, ValueError, RuntimeError, SyntaxError)
"""What the libraries raise beside: of a password, of a packing they do not know, of XML that is none."""


MAX_UNPACKED_BYTES = 512 << 20
"""Bytes of XML of a workbook, at most: a sheet of its greatest length, a million rows of ten columns."""


def open_source(path: Path) -> BinaryIO:
    """The bytes of a recording's text. Raises TraceError for a packed file that holds none or several, OSError."""
    kind = _KINDS.get(path.suffix.lower())
    if kind is None:
        stream = regular(path).open("rb")
        if not _OBJECT.match(stream.peek(_SHOWN_BYTES)[:_SHOWN_BYTES]):
            return stream
        stream.close()
        kind = _json
    try:
        return kind(regular(path))
    except (zipfile.BadZipFile, gzip.BadGzipFile, zlib.error, EOFError, *_DAMAGE_ERRORS) as error:
        if isinstance(error, TraceError):
            raise
        raise TraceError(f"{path}: it is no {path.suffix[1:]} file that can be unpacked ({error})") from None


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
            except ValueError as error:
                raise TraceError(f"{path}: its JSON breaks off or is none ({error}); give the whole file") from None
            yield from map(_flatten, _collect_rows(document))
            return
        for line in filter(str.strip, lines):
            try:
                found = _parse(line)
            except ValueError:
                found = None
            yield _flatten(found) if isinstance(found, dict) else line.strip()


def _parse(text: str) -> Any:
    # Numbers as they are written: the digits say how fine a reading is.
    return json.loads(text, parse_float=str, parse_int=str)


def _collect_rows(document: Any) -> list[dict[str, Any]]:
    """The objects of a document: of its lists, each with the `name` of its own if there are several; of its columns."""
    if isinstance(document, list):
        return [one for each in document for one in (_collect_rows(each) if _holds_rows(each) else [each])]
    if not isinstance(document, dict):
        return []
    if _is_table(document):
        rows = document["data"] if "data" in document else document["values"]
        return [dict(zip(map(str, document["columns"]), row, strict=False)) for row in rows]
    columns = [list(each.values()) if isinstance(each, dict) else each for each in document.values()]
    plain = len(columns) > 1 and all(isinstance(each, list) and not _is_objects(each) for each in columns)
    if plain and len(set(map(len, columns))) == 1:
        return [dict(zip(document, row, strict=True)) for row in zip(*columns, strict=True)]
    lists = {name: each for name, each in document.items() if _is_objects(each)}
    if not lists:
        return [one for each in document.values() if isinstance(each, dict) for one in _collect_rows(each)]
    if len(lists) == 1:
        return _collect_rows(next(iter(lists.values())))
    return [{"name": name, **one} for name, each in lists.items() for one in each]


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
    text = io.StringIO()
    write_rows(text, rows)
    return io.BytesIO(text.getvalue().encode())


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
    ".json": _json,
    ".jsonl": _json,
    ".ndjson": _json,
}

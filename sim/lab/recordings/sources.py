"""Files of recordings as text: as they lie there, packed, or from a spreadsheet or a Parquet table.

Each kind has its kept library, which is imported where such a file is read.
"""

import gzip
import io
import re
import zipfile
import zlib
from collections.abc import Callable, Iterable
from importlib import import_module
from pathlib import Path
from typing import BinaryIO, cast

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
        return regular(path).open("rb")
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
    return names[-1:] in ([".csv"], [".xlsx"], [".parquet"]) or packed


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
}

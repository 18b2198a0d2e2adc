"""Tables that people make, CSV or XLSX, as rows of text with the line they come from."""

import csv
import io
import lzma
import re
import struct
import unicodedata
import zipfile
import zlib
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from drivers.errors import OneLineError
from drivers.named_files import MOST_BYTES, contents

HEADER_WITHIN = 40
"""So many lines of titles may stand above the header."""
SHEET_ROWS = 1 << 20
"""Rows of the largest sheet that there is (ECMA-376, Excel 2007 and later)."""
_FAR_ROW = re.compile(rb'<(?:\w+:)?row\b[^>]*?\sr\s*=\s*["\'](\d{7,18})')
_DELIMITERS = ";,\t|"
_PLAIN = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)(e[+-]?\d{1,2})?", re.IGNORECASE)
_GROUPED = re.compile(r"[+-]?\d{1,3}(?:(?P<group>[.,'])\d{3})(?:(?P=group)\d{3})*(?P<rest>[.,]\d*)?")
MOST_PARTS, MOST_ROWS, MOST_CELLS = 2000, 100_000, 2_000_000
_XLSX_RAISES = (
    zipfile.BadZipFile, zlib.error, OSError, EOFError, ValueError, KeyError, IndexError,
    TypeError, AttributeError, ArithmeticError, RuntimeError, SyntaxError, struct.error, lzma.LZMAError, AssertionError,
)  # fmt: skip
"""What zipfile, its decompressors, the XML parser and openpyxl raise for an archive that is no workbook."""
_ENCODINGS = ("utf-8-sig", "cp1252", "latin-1")


class ListError(OneLineError, ValueError):
    """The list cannot be used; the message says why and what would be right."""


class RowError(OneLineError, ValueError):
    """What is wrong with a row: the column and the rest of the sentence."""

    def __init__(self, column: str, reason: str) -> None:
        super().__init__(reason)
        self.column = column


@dataclass(frozen=True, slots=True)
class ListRow:
    """One row: its line in the file (1..) and its cells by the names of the columns that were recognised.

    `unread` has the cells of the columns that were not, in the order of `ListSheet.ignored`.
    """

    number: int
    cells: Mapping[str, str]
    unread: tuple[str, ...] = ()

    def get(self, column: str) -> str:
        """The cell without the spaces around it; "" where the column or the cell is not there."""
        return self.cells.get(column, "").strip()


@dataclass(frozen=True, slots=True)
class ListSheet:
    """A list as it was read: which header each column was recognised by, those that were not, and the rows.

    `left_out` is what of a list without columns is no row of it by its own rules, `notes` are sentences on what was not
    read of the whole.
    """

    path: Path
    header_line: int
    columns: Mapping[str, str]
    ignored: tuple[str, ...]
    lines: tuple[ListRow, ...]
    left_out: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    def where(self, line: ListRow, column: str = "") -> str:
        """File, line and the column's own header, to begin a sentence with."""
        header = self.columns.get(column, "")
        return f"{self.path}: line {line.number}" + (f", {header!r}" if header else "")


def read_sheet(
    path: Path,
    synonyms: Mapping[str, Sequence[str]],
    needed: Sequence[str],
    *,
    given: Mapping[str, str] | None = None,
    sheet: str | None = None,
    told_by: Mapping[str, Callable[[str, frozenset[str]], bool]] | None = None,
) -> ListSheet:
    """The list in `path`. The header is the first line that has every `needed` column.

    `synonyms` has the words by which each column is recognised; `given` (column -> header) wins over them. A column
    that no header tells is the one whose cells are, by `told_by`, no other's. Raises ListError, in one sentence, for a
    file that cannot be read and for a header that is not found.
    """
    rows = list(_rows(path, sheet))
    given = dict(given or {})
    for place, (number, cells) in enumerate(rows[:HEADER_WITHIN]):
        columns = _recognise_columns(cells, synonyms, given)
        if all(name in columns for name in (*needed, *given)):
            below = [row for _, row in rows[place + 1 :]]
            for name, tells in (told_by or {}).items():
                # `Size` may be that of a type, as s16.
                used = {at for column, at in columns.items() if (name, column) != ("dtype", "length")}
                if name not in columns and (at := _told_by(tells, used, cells, below)) is not None:
                    columns = {column: place for column, place in columns.items() if place != at} | {name: at}
            used = set(columns.values())
            unread = [at for at, cell in enumerate(cells) if at not in used and cell.strip()]
            lines = tuple(
                ListRow(
                    line,
                    {name: row[at] for name, at in columns.items() if at < len(row)},
                    tuple(row[at].strip() if at < len(row) else "" for at in unread),
                )
                for line, row in rows[place + 1 :]
                if any(cell.strip() for cell in row)
            )
            ignored = tuple(cells[at].strip() for at in unread)
            return ListSheet(path, number, {name: cells[at].strip() for name, at in columns.items()}, ignored, lines)
    if not rows:
        raise ListError(f"{path}: is empty; give a list with a header and one row a tag")
    # What was asked for by --column and is nowhere explains more than a header that was not recognised.
    first, headers = rows[0][0], ", ".join(repr(cell.strip()) for cell in rows[0][1] if cell.strip())
    known = {header_key(cell) for _, cells in rows[:HEADER_WITHIN] for cell in cells}
    for name, header in given.items():
        if header_key(header) not in known:
            raise ListError(f"{path}: no column is called {header!r} (--column {name}); line {first} has {headers}")
    # The line that has the most of what is needed is the likeliest header.
    place, found = max(
        ((place, _recognise_columns(cells, synonyms, given)) for place, (_, cells) in enumerate(rows[:HEADER_WITHIN])),
        key=lambda item: (
            *(sum(name in item[1] for name in needed), len(item[1])),
            *(sum(bool(cell.strip()) for cell in rows[item[0]][1]), -item[0]),
        ),
    )
    number, cells = rows[place]
    missing = [name for name in needed if name not in found]
    wanted = " and ".join(f"{name} ({', '.join(synonyms[name][:4])}, ...)" for name in missing)
    # `Registers` may be addresses.
    taken = {at for column, at in found.items() if column != "count"}
    free = [at for at in range(len(cells)) if cells[at].strip() and at not in taken]
    below = [row for _, row in rows[place + 1 :]]
    likely = {name: at for name in missing if (at := _by_content(name, free, below)) is not None}
    if not found and any(re.fullmatch(r"\d+|0x[0-9a-f]+", cell.strip().lower()) for cell in rows[0][1]):
        raise ListError(
            f"{path}: has no line of headers, its line {first} has {headers}; write one above it, such as Address;Name;"
            "Type;Scale;Unit"
        )
    perhaps = " ".join(f"--column {name}={cells[at].strip()!r}" for name, at in likely.items())
    headers = ", ".join(repr(cell.strip()) for cell in cells if cell.strip())
    raise ListError(
        f"{path}: no header was recognised in the first {HEADER_WITHIN} lines: the list needs a column for {wanted}; "
        f"its line {number} has {headers}; "
        + (f"perhaps {perhaps}" if perhaps else f"say which is which, as --column {missing[0]}=HEADER")
    )


def _by_content(name: str, columns: Sequence[int], rows: Sequence[Sequence[str]]) -> int | None:
    """The column that may be `name` by its cells, no two alike: whole numbers, or texts; None for none."""
    for at in columns:
        cells = [row[at].strip() if at < len(row) else "" for row in rows]
        told = {cell for cell in cells if cell}
        numbers = sum(cell.isdecimal() for cell in told)
        apart = len(cells) > 1 and len(told) == len(cells)
        if apart and numbers == (len(told) if name == "address" else 0) and name in ("name", "address"):
            return at
    return None


def _told_by(
    tells: Callable[[str, frozenset[str]], bool],
    used: Collection[int],
    headers: Sequence[str],
    rows: Sequence[Sequence[str]],
) -> int | None:
    """The first column that is not used, has a header, and whose cells tell what it is; None for none."""
    for at, header in enumerate(headers):
        told = frozenset(header_key(row[at]) for row in rows if at < len(row) and row[at].strip())
        key = header_key(header)
        if at not in used and key and _ALARMS.isdisjoint(key.split()) and told and tells(key, told):
            return at
    return None


def _recognise_columns(
    cells: Sequence[str], synonyms: Mapping[str, Sequence[str]], given: Mapping[str, str]
) -> dict[str, int]:
    """Column -> its place: the given header, else the exact synonym that comes first in the table, else one within.

    A header is used once; a synonym is found within a header as whole words only.
    """
    keys = [header_key(cell) for cell in cells]
    alarms = _alarm_limits(keys)
    taken: dict[str, int] = {}
    for name, header in given.items():
        if (wanted := header_key(header)) in keys:
            taken[name] = keys.index(wanted)
    # All exact names first: "offset" must not be taken by the column of "offset modbus" that stands before it.
    for exactly in (True, False):
        for name, words in synonyms.items():
            if name in taken:
                continue
            places = (
                at
                for word in words
                for at, key in enumerate(keys)
                if at not in taken.values() and key and _says(name, key, word, exactly=exactly)
                if name not in ("low", "high") or at not in alarms
            )
            if (place := next(places, None)) is not None:
                taken[name] = place
    return dict(sorted(taken.items(), key=lambda item: item[1]))


def _says(name: str, key: str, word: str, *, exactly: bool) -> bool:
    """Whether a header is a synonym of a column, written as one word or several, or has it within."""
    if exactly:
        return key.replace(" ", "") == word.replace(" ", "")
    words = key.split()
    ends = sum(not side.isdisjoint(words) for side in _ENDS)
    other = words.count(word) > 1 or not _NOT_BESIDE.get(name, frozenset()).isdisjoint(words)
    # `Range Low` is an end of a range, and `Min/Max` a range.
    other = other or ends == {"range": 1, "low": 2, "high": 2}.get(name)
    alone = word in _ALONE and _ALONE[word].isdisjoint(words)
    return not alone and not other and f" {word} " in f" {key} "


def _alarm_limits(keys: Sequence[str]) -> set[int]:
    """The places of limits that are alarms: `High` beside `High High`, `High Limit` beside `High Alarm Limit`."""
    levels = [" ".join(word for word in _LEVEL.sub("?", key).split() if word not in _OF_LIMITS) for key in keys]
    doubled = {level for key, level in zip(keys, levels, strict=True) if _DOUBLED.search(key)}
    alarms = {
        level
        for key, level in zip(keys, levels, strict=True)
        if "limit" in key.split() and not _ALARMS.isdisjoint(key.split())
    }
    return {
        at
        for at, (key, level) in enumerate(zip(keys, levels, strict=True))
        if "?" in level and (level in doubled or (level in alarms and "limit" in key.split()))
    }


_DOUBLED = re.compile(r"\b(?:high ?high|hi ?hi|hh|h h|low ?low|lo ?lo|ll|l l)\b")
_LEVEL = re.compile(rf"{_DOUBLED.pattern}|\b(?:high|hi|h|low|lo|l)\b")
_ENDS = (
    frozenset({"low", "lo", "lower", "min", "mini", "minimum", "minimo"}),
    frozenset({"high", "hi", "upper", "max", "maxi", "maximum", "massimo", "maximo"}),
)
_ALONE: Mapping[str, frozenset[str]] = {
    **dict.fromkeys(("anzahl", "cantidad", "quantity"), frozenset[str]()),
    **dict.fromkeys(
        ("order", "ordine", "ordre", "orden"),
        frozenset({"word", "words", "byte", "bytes", "octet", "octets", "register", "registers", "registri", "parole"})
        | {"mots", "palabras", "endian", "float", "real", "data", "dati", "modbus", "swap"},
    ),
}
"""Words that mean by themselves what they do not within others, but beside those: `Anzahl Nachkommastellen`."""
_PLACES = frozenset({
    "register", "registers", "registro", "registri", "adresse", "address", "indirizzo", "direccion", "word", "words",
    "wort", "byte", "bytes", "modbus", "protocol", "pdu", "start", "base", "based", "group",
})  # fmt: skip
_ALARMS = frozenset({
    "alarm", "alarms", "alarme", "allarme", "allarmi", "preallarme", "alarma", "avviso", "warning", "warn",
    "warnung", "vorwarnung", "trip", "blocco", "soglia", "schwelle", "seuil", "umbral", "setpoint", "sollwert",
    "consigne", "consigna",
})  # fmt: skip
_OF_LIMITS = _ALARMS | {"limit", "limits", "value", "level"}
_TIMES = frozenset({
    "age", "interval", "rate", "time", "delay", "period", "scan", "deadband", "hysteresis", "tempo", "ritardo",
    "zeit", "dauer",
})  # fmt: skip
_NOT_BESIDE: Mapping[str, frozenset[str]] = {
    **dict.fromkeys(("low", "high", "range"), _ALARMS | _TIMES | _PLACES | {"length", "gas", "raw"}),
    "offset": _PLACES | {"memory", "db", "bit", "eng", "eu"},
    "scale": frozenset({
        "register", "registers", "address", "poll", "polling", "priority", "historian", "deadband", "sampling",
        "adc", "display", "power", "turndown",
    }),
    "bit": frozenset({"mask", "maske", "maschera", "masque", "mascara", "shift"}),
    "decimals": frozenset({"display", "displayed", "shown", "hmi", "anzeige"}),
    "order": frozenset({"sort", "work", "tag", "display", "row", "scan"}),
    "unit": frozenset({"no", "nr", "number", "id", "modbus", "slave", "address", "per", "zero", "full"}).union(*_ENDS),
    "length": frozenset({"offset", "address", "order", "index", "max", "step"}),
    "name": frozenset({"size", "length", "type", "kind", "format", "width"}),
}  # fmt: skip
"""Words beside which a column's own mean something else: `High Alarm` is no end of a range, `Byte Offset` no offset."""
OF_SOMETHING_ELSE = _NOT_BESIDE["scale"] | {"service", "safety", "filter", "smoothing", "damping", "crest", "form"}
"""Words beside which a factor is none of a reading."""


def header_key(text: str) -> str:
    """A header without case, accents and signs: `Unità di misura [°C]` is `unita di misura c`."""
    plain = unicodedata.normalize("NFKD", text.casefold())
    letters = (char if char.isalnum() else " " for char in plain if not unicodedata.combining(char))
    return " ".join("".join(letters).split())


# ---------------------------------------------------------------- files


def _rows(path: Path, sheet: str | None) -> Iterator[tuple[int, list[str]]]:
    """Every row with its line. Raises ListError."""
    try:
        data = contents(path)
    except OSError as error:
        raise ListError(
            f"{path}: cannot be read ({(error.strerror or str(error)).lower()}); give a CSV or XLSX file"
        ) from None
    if data[:2] == b"PK":  # a ZIP archive, which an XLSX file is
        yield from _xlsx_rows(path, data, sheet)
        return
    if data[:4] == b"\xd0\xcf\x11\xe0":  # an OLE2 compound file
        raise ListError(f"{path}: is an old Excel file (.xls); save it as .xlsx or .csv")
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):  # Excel's "Unicode text"
        text = data.decode("utf-16", errors="replace")
    else:
        text = ""
        for encoding in _ENCODINGS:  # the last one, latin-1, decodes everything
            try:
                text = data.decode(encoding)
            except UnicodeDecodeError:
                continue
            break
    reader = csv.reader(io.StringIO(text, newline=""))
    try:
        reader = csv.reader(io.StringIO(text, newline=""), delimiter=find_delimiter(text))
        # A quoted cell may hold line breaks: a row is called by the line at which it begins.
        before = 0
        for row in reader:
            if any(cell.strip() for cell in row):
                yield before + 1, row
            before = reader.line_num
    except csv.Error as error:
        raise ListError(f"{path}: line {reader.line_num}: is not CSV ({error}); correct that line") from None


def find_delimiter(text: str) -> str:
    """What separates the cells: the sign that divides the most lines into the same number of two cells or more."""
    lines = [line for line in text.splitlines() if line.strip()][:HEADER_WITHIN]

    def evidence(delimiter: str) -> tuple[int, int]:
        counts = [len(row) for row in csv.reader(lines, delimiter=delimiter)]
        most = max(counts, default=1)
        return (counts.count(most), most) if most > 1 else (0, 0)

    return max(_DELIMITERS, key=evidence)


def _xlsx_rows(path: Path, data: bytes, sheet: str | None) -> Iterator[tuple[int, list[str]]]:
    from openpyxl import load_workbook
    from openpyxl.utils.exceptions import InvalidFileException

    try:
        _check_archive(path, data)
        book = load_workbook(io.BytesIO(data), read_only=True, data_only=True)
        if not book.worksheets:
            raise ListError(f"{path}: has no sheet with cells; give a workbook with a list")
        if sheet is not None and sheet not in (page.title for page in book.worksheets):
            raise ListError(f"{path}: has no sheet {sheet!r}; it has {', '.join(map(repr, book.sheetnames))}")
        page = book[sheet] if sheet is not None else book.worksheets[0]
        # What the sheet says of its own size is not looked at: it would be believed, a row being filled up to it.
        page.reset_dimensions()
        filled = lines = 0
        for number, row in enumerate(page.iter_rows(values_only=True), start=1):
            # A sheet that was formatted to its end has a million rows of nothing.
            if row.count(None) == len(row):
                continue
            filled, lines = filled + len(row), lines + 1
            if lines > MOST_ROWS or filled > MOST_CELLS:
                raise ListError(f"{path}: goes on beyond line {number}; a list has {MOST_ROWS} lines at most")
            # As it would be typed: XLSX knows no whole numbers, and 40101.0 is no address.
            cells = [
                str(int(value)) if isinstance(value, float) and value.is_integer() and abs(value) < 1e15 else str(value)
                for value in ("" if value is None else value for value in row)
            ]
            if any(cells):
                yield number, cells
    except ListError:
        raise
    except (InvalidFileException, *_XLSX_RAISES) as error:
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise ListError(f"{path}: is no XLSX workbook ({reason}); save it as .xlsx or .csv") from None


def _check_archive(path: Path, data: bytes) -> None:
    """Raises ListError for an archive that unpacks to more than a list has, or whose XML defines entities."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        parts = archive.infolist()
        unpacked = sum(part.file_size for part in parts)
        if len(parts) > MOST_PARTS or unpacked > MOST_BYTES:
            raise ListError(
                f"{path}: unpacks to {len(parts)} parts of {unpacked >> 20} MiB together, and {MOST_PARTS} parts of "
                f"{MOST_BYTES >> 20} MiB are the most; save the list alone as .xlsx or .csv"
            )
        for part in parts:
            if not part.filename.endswith((".xml", ".rels")):
                continue
            # No workbook has a document type, by which a few bytes of XML become gigabytes (ECMA-376-2, 9.1.4). It may
            # stand in UTF-16 as well, so zeros are passed over.
            body = archive.read(part).replace(b"\0", b"")
            if b"<!DOCTYPE" in body:
                raise ListError(f"{path}: its part {part.filename!r} has a document type, which no workbook has")
            # A row's number makes the reader count up to it.
            if (far := max(map(int, _FAR_ROW.findall(body)), default=0)) > SHEET_ROWS:
                raise ListError(f"{path}: has a row {far}, and the largest sheet {SHEET_ROWS}; save it anew")


def parse_decimal(text: str) -> float:
    """`0,1`, `0.1`, `1.234,5` and `1,234.5` as numbers; a single comma is a decimal one. Raises ValueError."""
    plain = "".join(text.split()).replace("\u2212", "-")
    match = _GROUPED.fullmatch(plain)
    if match and (match["rest"] or match["group"] == "'" or plain.count(match["group"]) > 1):
        plain = plain.removesuffix(match["rest"] or "").replace(match["group"], "") + (match["rest"] or "")
    elif not _PLAIN.fullmatch(plain):
        raise ValueError(f"{text!r} is no number")
    return float(plain.replace(",", "."))

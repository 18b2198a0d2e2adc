"""Cells of a CSV as numbers and booleans: empty is no reading, whatever else is no number is a fault that is told."""

import re
from collections.abc import Sequence
from typing import Literal

import numpy as np

from drivers.csv_rows import strip_guards
from sim.lab.recordings.unit_table import conversion, known_unit
from sim.sha import Array, Mask

Decimal = Literal["auto", ".", ","]
Points = Literal["decimal", "thousands"]
"""What a point without a comma is in a column of a file with decimal commas."""

SWITCH_WORDS: tuple[tuple[tuple[str, ...], tuple[str, ...]], ...] = (
    (("true", "t", "vero", "wahr", "vrai", "verdadero"), ("false", "f", "falso", "falsch", "faux")),
    (("on", "ein", "an", "acceso", "encendido"), ("off", "aus", "spento", "apagado")),
    (("yes", "y", "ja", "si", "sì", "sí", "oui"), ("no", "n", "nein", "non")),
    (("run", "running", "marcia", "marche", "marcha"), ("stop", "stopped", "fermo", "arrêt", "arret", "paro")),
    (("1", "-1"), ("0",)),
)
"""Words of two-valued signals that need no declaring, (on, off) by kind: English, Italian, German, French, Spanish."""

NO_VALUES = frozenset({"", "null", "(null)", "none", "nan", "n/a", "na", "-", "--", "\\n"})
"""What programs write where there is no value, in lower case."""
RUN_WORDS = frozenset(SWITCH_WORDS[3][0])
"""Of these the words of a machine that runs."""
_BLANKS = re.compile(r"(?<=\d)[ '’\xa0\u202f](?=\d{3}(?!\d))")
_SIGNED = re.compile(r"^([+-])\s+(?=[\d.,])")
"""A sign that stands apart from its number, as recorders print columns."""
_GROUPED_PATTERNS = {
    mark: re.compile(rf"[+-]?(?:\d{{1,3}}(?:[{mark}]\d{{3}})+|\d{{1,2}}(?:[{mark}]\d\d)+[{mark}]\d{{3}})")
    for mark in ".,"
}
"""Thousands, or hundreds above a thousand as India writes them, set apart by a mark; twice a mark is nothing else."""
_MINUS = "\N{MINUS SIGN}"
"""What typesetters and pandas' tables write before a number below 0."""
_LONE_POINT = re.compile(r"\s*[+-]?\s*[1-9]\d{0,2}\.\d{3}\s*")
"""1.234, whose point is a decimal one or sets apart thousands: the cell does not say which."""
_MEASURED = re.compile(r"([+-]?[\d.,'’\xa0\u202f ]*\d(?:[eE][+-]?\d+)?)\s*([^\d\s].*)")
"""A number and its unit in one cell, as dashboards show them."""

_BOOLEANS = {
    word: value for pair in SWITCH_WORDS for words, value in zip(pair, (1.0, 0.0), strict=True) for word in words
}


def _plain_floats(cells: Sequence[str]) -> Array | None:
    """All cells at once, if each is a plain number; exact to the last bit, as Python reads it."""
    try:
        values = np.fromiter(map(float, cells), dtype=float, count=len(cells))
    except ValueError:
        return None
    # Python reads 1_000 as a number; a plant's file does not mean one by it.
    return None if "_" in "".join(cells) or not np.isfinite(values).all() else values


def _number(cell: str, decimal: Decimal) -> float:
    if "_" in cell:
        return np.nan
    cell = _SIGNED.sub(r"\1", _BLANKS.sub("", cell))
    for mark in ".,":
        if cell.count(mark) > 1 and _GROUPED_PATTERNS[mark].fullmatch(cell):
            cell = cell.replace(mark, "")
    if decimal == ",":
        whole, comma, fraction = cell.partition(",")
        if "." in fraction or _LONE_POINT.fullmatch(cell):
            return np.nan
        cell = whole.replace(".", "") + comma.replace(",", ".") + fraction if comma else cell
    elif "," in cell:
        whole, point, fraction = cell.partition(".")
        if not _GROUPED_PATTERNS[","].fullmatch(whole):
            return np.nan
        cell = whole.replace(",", "") + point + fraction
    try:
        return float(cell)
    except ValueError:
        return np.nan


def parse_quantity(cell: str, decimal: Decimal) -> tuple[float, str]:
    """A cell's number and the unit behind it: "1.20 kW" is (1.2, "kW"); (NaN, "") for any other cell."""
    match = _MEASURED.fullmatch(cell.strip())
    decimal = decimal_mark([cell]) if decimal == "auto" else decimal
    unit = known_unit(match[2]) if match else ""
    return (_number(match[1].strip(), decimal), unit) if match and unit else (np.nan, "")


def decimal_mark(cells: Sequence[str]) -> Decimal:
    """The decimal mark of cells of which nobody has said it."""
    for cell in cells:
        if "," in cell and "." in cell:
            return "," if cell.rfind(",") > cell.rfind(".") else "."
        # 1,234,567 beside 950,123: no number has two decimal marks.
        if cell.count(",") > 1 and _GROUPED_PATTERNS[","].fullmatch(cell.strip()):
            return "."
    # A comma can only be inside a cell as a decimal comma, unless points show that it groups thousands.
    return "," if any("," in cell for cell in cells) and not any("." in cell for cell in cells) else "."


def is_lone_point(cell: str) -> bool:
    """Whether a cell is like 1.234, of which only its column can say what the point is."""
    return _LONE_POINT.fullmatch(cell) is not None


def rewrite_points(cells: Sequence[str], points: Points) -> list[str]:
    """Cells of a file with decimal commas, their lone points written as its commas or, of thousands, left out."""
    if points == "thousands":
        return [cell.replace(".", "") if _LONE_POINT.fullmatch(cell) else cell for cell in cells]
    return [cell.replace(".", ",") if "," not in cell and cell.count(".") == 1 else cell for cell in cells]


def numbers(cells: Sequence[str], decimal: Decimal = "auto", unit: str = "") -> tuple[Array, Mask]:
    """Values (NaN where there is none) and a mask of the cells that hold something, but no finite number.

    With `unit`, a cell that says its own unit is converted to it.
    """
    # What 1.234 is in a file with decimal commas its column says, and no batch of its cells: see `rewrite_points`.
    unsure = decimal == "," and any("." in cell and _LONE_POINT.fullmatch(cell) for cell in cells)
    plain = None if unsure else _plain_floats(cells)
    if plain is not None:
        return plain, np.zeros(plain.shape, dtype=bool)
    stripped = list(map(str.strip, cells))
    if _MINUS in "".join(stripped):
        stripped = [cell.replace(_MINUS, "-") for cell in stripped]
    decimal = decimal_mark(stripped) if decimal == "auto" else decimal
    filled = np.fromiter(map(bool, stripped), dtype=bool, count=len(stripped))
    texts = list(filter(None, stripped))
    # Blank cells among plain numbers, or decimal commas where nothing else has a mark, need no look at each cell.
    joined = "\n".join(texts)
    whole = texts if decimal == "." else joined.replace(",", ".").split("\n") if "." not in joined else []
    plain = _plain_floats(whole) if len(whole) == len(texts) else None
    values = np.full(len(stripped), np.nan)
    values[filled] = plain if plain is not None else [_number(cell, decimal) for cell in texts]
    values[np.isinf(values)] = np.nan
    for index in np.flatnonzero(np.isnan(values) & filled).tolist() if unit else ():
        value, own = parse_quantity(stripped[index], decimal)
        scale, offset = conversion(own, unit)
        values[index] = value * scale + offset
    return values, np.isnan(values) & filled


def booleans(cells: Sequence[str], on: Sequence[str] = (), off: Sequence[str] = ()) -> tuple[Array, Mask]:
    """As `numbers`, for two-valued signals: 1.0 and 0.0 from the words `on` and `off`, then from SWITCH_WORDS."""
    words = {**_BOOLEANS, **{word.casefold(): 1.0 for word in on}, **{word.casefold(): 0.0 for word in off}}
    counts = {0.0: 0.0, 1.0: 1.0, -1.0: 1.0}
    for given, value in ((on, 1.0), (off, 0.0)):
        counts |= {number: value for word in given if (number := _number(word.strip(), ".")) == number}
    table: dict[str, float] = {}
    # A two-valued column has few different cells, however many rows.
    for cell in set(cells):
        word = cell.strip().casefold()
        as_number = _number(word.replace(",", "."), ".")
        table[cell] = words[word] if word in words else counts.get(as_number, np.nan)
    values = np.array([table[cell] for cell in cells], dtype=float)
    wrong = np.isnan(values)
    wrong[[index for index in np.flatnonzero(wrong).tolist() if not cells[index].strip()]] = False
    return values, wrong


_AS_TEXT = re.compile(r'="(.*)"', re.DOTALL)
"""How exports keep a spreadsheet from reading a cell as anything but a text."""


def bare_cells(cells: Sequence[str]) -> list[str]:
    """Cells without what stands around them for spreadsheets: an apostrophe before them, or =" and "."""
    # One that a table of ours guards is a text as it stands.
    return [
        match[1].replace('""', '"') if cell.startswith('="') and (match := _AS_TEXT.fullmatch(cell.rstrip())) else plain
        for cell, plain in zip(cells, strip_guards(cells), strict=True)
    ]

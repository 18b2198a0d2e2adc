"""What all rows of a list together show of cells that may mean two things each.

One cell says neither whether 45000 is a reference number, nor what an accuracy of 10 or a length of 8 counts.
"""

import re
from collections.abc import Iterable, Sequence
from dataclasses import replace

from gateway.commission.files.cells import OF_SOMETHING_ELSE, ListError, ListSheet, header_key, parse_decimal
from gateway.commission.files.io_units import parse_factor

# ---------------------------------------------------------------- references or addresses

_LONG = re.compile(r"(\d{5,6})(?!\d)")
_FIRST_OF_A_TABLE = 1000
"""A list of references has one so near to the beginning of its table; addresses on the wire may begin anywhere."""
_LAST_ADDRESS = 65535
_OF_ONE_BIT = frozenset({"coil", "discrete"})


def doubt_of_references(cells: Iterable[tuple[str, str]]) -> str:
    """Why 45000 of a list may be a reference number or an address; "" where its other numbers show which.

    `cells` are its addresses in lower case, each with the table that its row names, "" for none.
    """
    listed = list(cells)
    long = [match[1] for text, _ in listed if (match := _LONG.match(text))]
    references = [text for text in long if _is_reference(text)]
    if not any(text[0] in "34" for text in references):
        return ""
    either = "give --numbers decimal (40101 is holding:100) or --numbers plain (it is the address itself)"
    others = (text for text in long if text not in references and int(text) <= _LAST_ADDRESS)
    if odd := next(others, None):
        return f"{odd!r} of this list is no reference number, so this one may be none: {either}"
    short = (text for text, table in listed if re.fullmatch(r"\d{1,4}", text) and table not in _OF_ONE_BIT)
    if odd := next(short, None):
        return f"{odd!r} of this list is no reference number, so this one may be none: {either}"
    if all(len(text) == 5 and text[0] in "34" and int(text[1:]) > _FIRST_OF_A_TABLE for text in references):
        return f"may be a reference number, though none of the list is near the first, or the address itself: {either}"
    return ""


def _is_reference(text: str) -> bool:
    return text[0] in "0134" and 1 <= int(text[1:]) <= _LAST_ADDRESS + 1


# ---------------------------------------------------------------- accuracy and precision

_FINENESS = re.compile(r"^(?:accuracy|precision|precisione|genauigkeit|prazision|exactitud)$")
"""Headers under which lists say units per count, counts per unit or decimals, or how well the device measures.

With a further word, as `Sensor accuracy`, they say the last.
"""
_MEASURED = re.compile(r"[%±°]|\+/?-|[^\W\d_]{2}|\d\s*[^\W\d_](?!\d)")
"""Of how well a device measures: `±0.5`, `0.1 °C`, `class 0.5`, `2 LSB`, `12 bit`."""
_POWER_OF_TEN = re.compile(r"0[.,]0*1|10{0,6}(?:[.,]0+)?")
_MOST_DECIMALS = 6
_FLOATS = re.compile(r"float|real|double|single|ieee|fp32|f32|f64|gleit|reel|réel|flot|virgol", re.IGNORECASE)
_SCALED_BY = frozenset({"scale", "decimals", "raw_high", "formula"})
_NO_SCALE = OF_SOMETHING_ELSE | frozenset({
    "default", "interval", "period", "cycle", "time", "deadband", "hysteresis", "delay", "tolerance", "version",
    "level", "zone", "zones", "alarm", "limit", "threshold", "setpoint", "example", "beispiel", "esempio", "value",
    "valore", "wert", "dead", "band", "totband", "hysterese", "isteresi", "refresh", "update", "rate", "abtastrate",
    "zykluszeit", "aktualisierung", "uncertainty", "unsicherheit", "accuracy", "messgenauigkeit", "class", "klasse",
    "classe", "error", "poll", "s", "sec", "ms", "min",
})  # fmt: skip
_FEWEST = 2


def take_fineness(sheet: ListSheet) -> ListSheet:
    """The list with the column of an accuracy, precision or of fractions alone as that of scales or decimals.

    Raises ListError for one whose cells leave open which it is.
    """
    if not _SCALED_BY.isdisjoint(sheet.columns):
        return sheet
    for at, header in enumerate(sheet.ignored):
        key = header_key(header)
        rows = [(cell, line) for line in sheet.lines if re.search(r"\d", cell := line.unread[at])]
        cells = [cell for cell, _ in rows]
        if "%" in header:
            continue
        if _FINENESS.search(key) and cells:
            return _taken_as(sheet, at, _meaning(sheet, header, cells))
        # A float is not made of counts.
        counts = [cell for cell, line in rows if not _FLOATS.search(line.get("dtype"))]
        fine = [cell for cell in counts if re.fullmatch(r"0[.,]0*1", cell)]
        if len(cells) >= _FEWEST and fine and _all_powers(cells) and _NO_SCALE.isdisjoint(key.split()):
            raise ListError(
                f"{sheet.path}: column {header!r} has {fine[0]} and other powers of ten, may say how readings are "
                f"scaled, and is not understood: give --column scale={header!r} if so, or --column no_scale={header!r}"
            )
    return sheet


def _all_powers(cells: Sequence[str]) -> bool:
    return all(_POWER_OF_TEN.fullmatch(cell) for cell in cells)


def _meaning(sheet: ListSheet, header: str, cells: Sequence[str]) -> str:
    """`scale` for several powers of ten, `decimals` for small numbers with 0, "" for `±0.5 %`. Raises ListError."""
    measured = [cell for cell in cells if _MEASURED.search(cell)]
    if len(measured) == len(cells):
        return ""
    whole = {int(cell) for cell in cells if cell.isdecimal() and len(cell) == 1}
    # A float is shown with so many digits, and not made of counts.
    floats = any(_FLOATS.search(line.get("dtype")) for line in sheet.lines)
    if _all_powers(cells) and len({parse_decimal(cell) for cell in cells}) >= _FEWEST and not floats:
        return "scale"
    # An accuracy of 0 there is not.
    if len(whole) == len(set(cells)) and 0 in whole and max(whole) <= _MOST_DECIMALS:
        return "decimals"
    raise ListError(
        f"{sheet.path}: column {header!r} ({cells[0]}) may say how readings are scaled, or how well they are measured: "
        f"give --column scale={header!r} for units per count, --column decimals={header!r} for decimals, or "
        f"--column no_scale={header!r}"
    )


def _taken_as(sheet: ListSheet, at: int, column: str) -> ListSheet:
    """The list with an unread column as one that is read."""
    if not column:
        return sheet
    lines = tuple(
        replace(
            line,
            cells={
                **line.cells,
                column: line.unread[at],
                "said": f"{column} by {sheet.ignored[at]} ({line.unread[at]})" if line.unread[at] else "",
            },
            unread=(*line.unread[:at], *line.unread[at + 1 :]),
        )
        for line in sheet.lines
    )
    ignored = (*sheet.ignored[:at], *sheet.ignored[at + 1 :])
    return replace(sheet, columns={**sheet.columns, column: sheet.ignored[at]}, ignored=ignored, lines=lines)


# ---------------------------------------------------------------- examples

_EXAMPLE = re.compile(r"(?<![\d.,=-])(\d{2,6})\s*=\s*(\d+(?:[.,]\d+)?)(?![\d.,]|\s*=)")
_EQUAL = 1e-9


def inverted_scales(sheet: ListSheet) -> dict[str, str]:
    """The scale's cells that an example in a remark contradicts (`*10` beside `450 = 45.0°C`), with that example."""
    found: dict[str, str] = {}
    for line in sheet.lines:
        match = _EXAMPLE.search(line.get("remark"))
        if match is None or not (text := line.get("scale")):
            continue
        try:
            number, value = parse_factor(text).number, parse_decimal(match[2])
        except ValueError:
            continue
        if number not in (0, 1) and value and abs(value * number / float(match[1]) - 1) < _EQUAL:
            found.setdefault(text, f"{match[0]!r} of line {line.number}")
    return found


# ---------------------------------------------------------------- lengths of texts

_REGISTER_BITS = 16
_COUNTED_IN = {1: _REGISTER_BITS, 2: 8, 16: 1}
"""How many bits each is of which a register has one, two (bytes) or sixteen."""


def bits_a_length(numbers: Iterable[tuple[int, int]]) -> int:
    """The bits of what a list's column of lengths counts, by its numbers; 0 where they show none.

    `numbers` are (registers by its type, length) of each row that is no text.
    """
    each = {length / registers for registers, length in numbers}
    return _COUNTED_IN.get(int(ratio), 0) if len(each) == 1 and (ratio := each.pop()).is_integer() else 0


_ROUND = 10


def is_length_of_registers(length: int, first: int, others: Iterable[int]) -> bool:
    """Whether a text of STRING[length] at `first` has so many registers: the list's next address is right behind.

    Round addresses lie where somebody put them, and not behind one another.
    """
    behind = min((other for other in others if other > first), default=None)
    is_round = first % _ROUND == 0 and (first + length) % _ROUND == 0
    return length > 1 and behind == first + length and not is_round

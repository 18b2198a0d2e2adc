"""An I/O list as tags: each row gives one, or one sentence that says what is wrong with it."""

import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from drivers.errors import OneLineError
from gateway.commission.files.cells import ListError, ListRow, ListSheet, key_of, number_of, read_sheet
from gateway.commission.files.io_words import COLUMNS, FUNCTIONS, KNOWN_TYPES, ORDERS, TABLES, type_of
from gateway.commission.survey import AddressTextError, Register, parse_register

_BIT = re.compile(r"(.+?)[.:/](?:bit\s*)?(\d{1,2})")
_SHORT = re.compile(r"([0134])x0*(\d{1,5})")
_IEC = re.compile(r"%?(m|mw|mx|mf|md|i|iw|ix|q|qw|qx)\s*(\d{1,5})")
_HEX = re.compile(r"(?:0x|16#)([0-9a-f]{1,4})|([0-9a-f]{1,4})h")
_REFERENCE_TABLES = {"0": "coil", "1": "discrete", "3": "input", "4": "holding"}
_IEC_TABLES = {"m": "coil", "mx": "coil", "q": "coil", "qx": "coil", "mw": "holding", "qw": "holding"} | {
    "i": "discrete", "ix": "discrete", "iw": "input", "mf": "holding", "md": "holding"
}  # fmt: skip
_UNITS = dict.fromkeys(("°c", "c", "deg c", "gradi c", "gradi"), "degC") | {"giri min": "rpm", "giri": "rpm"}
_SINGLE = frozenset({"bool", "int8", "uint8", "int16", "uint16", "bcd16", "string"})
_DIGITS = 9


class _RowError(OneLineError, ValueError):
    """What is wrong with a row: the column and the rest of the sentence."""

    def __init__(self, column: str, reason: str) -> None:
        super().__init__(reason)
        self.column = column


@dataclass(frozen=True, slots=True)
class Reading:
    """How a list is read where it does not say itself.

    `table` of bare numbers, `order` of values wider than a register, `shift` added to every address, `registers` False
    for other drivers' addresses, which are left as they are.
    """

    table: str = "holding"
    order: str = "ABCD"
    shift: int = 0
    registers: bool = True
    rename: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Listed:
    """A tag of the list: its keys as the device file has them (None: not written there), and its line."""

    name: str
    keys: Mapping[str, Any]
    line: int


@dataclass(frozen=True, slots=True)
class IoList:
    """A list as it was understood. `problems` are sentences, one for each row that is no tag."""

    sheet: ListSheet
    tags: tuple[Listed, ...]
    problems: tuple[str, ...]


def read_io_list(path: Path, how: Reading, columns: Mapping[str, str] | None = None, page: str | None = None) -> IoList:
    """The list in `path`; `columns` (our name -> its header) wins over the guess. Raises ListError."""
    if unknown := sorted(set(columns or {}) - set(COLUMNS)):
        raise ListError(f"--column {unknown[0]}=...: there is no such column; known are {', '.join(COLUMNS)}")
    sheet = read_sheet(path, COLUMNS, ("name", "address"), given=columns, sheet=page)
    tags: list[Listed] = []
    problems: list[str] = []
    for line in sheet.lines:
        try:
            tags.append(_listed(sheet, line, how, tags))
        except _RowError as error:
            problems.append(f"{sheet.where(line, error.column)}: {error}")
    if not tags and not problems:
        raise ListError(f"{path}: has a header in line {sheet.header_line} and no row under it; give one row a tag")
    return IoList(sheet, tuple(tags), tuple(problems))


def _listed(sheet: ListSheet, line: ListRow, how: Reading, before: Sequence[Listed]) -> Listed:
    listed = line.get("name")
    if not listed:
        raise _RowError("name", "is empty; give the tag's name, or take the row out")
    name = how.rename.get(listed, listed)
    if twice := next((tag for tag in before if tag.name == name), None):
        raise _RowError("name", f"{name!r} is in line {twice.line} already; give each tag a name of its own")
    address, bit = _address(sheet, line, how)
    dtype, length = _type(line, address, bit)
    low, high = _number(line, "low"), _number(line, "high")
    # Scale and offset as they are given, or from a raw range and the range in units.
    scale, offset = _number(line, "scale"), _number(line, "offset")
    raw_low, raw_high = _number(line, "raw_low"), _number(line, "raw_high")
    if scale == 0:
        raise _RowError("scale", "is 0, which would make every reading 0; give the units per count")
    if scale is None and raw_high is not None and high is not None:
        span, least = raw_high - (raw_low or 0.0), low or 0.0
        if span == 0 or high == least:
            raise _RowError("raw_high", "the raw range or the range in units is empty; give two different ends")
        slope = (high - least) / span
        scale, offset = round(slope, _DIGITS), round(least - slope * (raw_low or 0.0), _DIGITS)
    if low is not None and high is not None and not low < high:
        raise _RowError("low", f"{low:g} is not below the highest value {high:g}; swap or correct them")
    numeric, order = dtype not in ("bool", "string"), None
    if dtype not in _SINGLE:  # one register alone has no order of words, and its bytes are Modbus's
        text = line.get("order")
        order = ORDERS.get(key_of(text)) if text and text != "-" else how.order
        if order is None:
            raise _RowError("order", f"{text!r} is no order that is known here; give ABCD, CDAB, BADC or DCBA")
    unit = line.get("unit")
    keys = {
        "address": address,
        "dtype": dtype,
        "order": order,
        "scale": scale if numeric else None,
        "offset": offset if numeric else None,
        "bit": bit,
        "length": length or None,
        "unit": _UNITS.get(key_of(unit), unit) if numeric and unit not in ("", "-") else None,
        "low": low if numeric else None,
        "high": high if numeric else None,
        "sentinel": _whole(line, "sentinel") if numeric else None,
    }
    for other in before:
        # Two tags may share a register only where each takes another bit of it.
        bits = (bit, other.keys["bit"])
        if address == other.keys["address"] and (None in bits or bits[0] == bits[1]):
            sentence = f"{line.get('address')!r} is where {other.name!r} of line {other.line} lies"
            raise _RowError(
                "address", f"{sentence}; correct one of them (a spreadsheet shows bit 0 as no bit, and 10 as .1)"
            )
    return Listed(name, keys, line.number)


def _number(line: ListRow, column: str) -> float | None:
    text = line.get(column)
    if text in ("", "-", "–", "n/a", "n.a."):
        return None
    try:
        return round(number_of(text), 12)
    except ValueError:
        raise _RowError(column, f"{text!r} is no number; give one such as 0,1 or 0.1, or leave it empty") from None


def _whole(line: ListRow, column: str) -> int | None:
    text = line.get(column).lower()
    if match := _HEX.fullmatch(text):
        return int(match[1] or match[2], 16)
    number = _number(line, column)
    if number is not None and not number.is_integer():
        raise _RowError(column, f"{text!r} is no whole number; give the raw number that means 'not available'")
    return None if number is None else int(number)


def _type(line: ListRow, address: str, bit: int | None) -> tuple[str, int]:
    text = line.get("dtype")
    if not text:
        return ("bool", 0) if bit is not None or address.partition(":")[0] in ("coil", "discrete") else ("uint16", 0)
    kind = type_of(key_of(text))
    if kind is None:
        raise _RowError("dtype", f"{text!r} is no type that is known here; give one of {KNOWN_TYPES}")
    dtype, length = kind
    if dtype == "string":
        length = length or _whole(line, "length") or 0
        if length <= 0:
            raise _RowError("dtype", "a string needs its length in bytes: write STRING[16], or give a column Length")
    elif bit is not None:
        dtype = "bool"
    return dtype, length


# ---------------------------------------------------------------- addresses


def _address(sheet: ListSheet, line: ListRow, how: Reading) -> tuple[str, int | None]:
    """(address in the driver's notation, bit or None)."""
    text = line.get("address")
    if not text:
        raise _RowError("address", "is empty; give the address, or take the row out")
    if not how.registers:
        return text, _bit(line)
    plain, bit = text.lower().replace(" ", ""), _bit(line)
    match = _BIT.fullmatch(plain)
    if bit is None and match and not match[1].isalpha():
        plain, bit = match[1], int(match[2])
    if bit is not None and bit > 15:
        raise _RowError("bit", f"bit {bit} is not in a register, which has bits 0 to 15")
    register = _register(sheet, line, plain, text, how)
    moved = register.moved(how.shift)
    if not 0 <= moved.number <= 65535:
        raise _RowError("address", f"{text!r} moved by {how.shift} is outside 0 to 65535; give another --shift")
    return str(moved), None if moved.is_bit else bit


def _bit(line: ListRow) -> int | None:
    bit = _whole(line, "bit")
    if bit is not None and not 0 <= bit <= 15:
        raise _RowError("bit", f"bit {bit} is not in a register, which has bits 0 to 15")
    return bit


def _register(sheet: ListSheet, line: ListRow, plain: str, text: str, how: Reading) -> Register:
    """A place by whatever notation: holding:100, 40101, 4x101, %MW100, 0x64, or a bare number in a table."""
    if ":" in plain or len(plain) >= 5:  # fewer digits are no reference number, but a bare address
        with suppress(AddressTextError):
            return _within(parse_register(plain), text)
    # 4x101 counts from 1, as reference numbers do; %MW100 from 0.
    if (match := _SHORT.fullmatch(plain)) and match[2] != "0":
        return _within(Register(_REFERENCE_TABLES[match[1]], int(match[2]) - 1), text)
    if match := _IEC.fullmatch(plain):
        return _within(Register(_IEC_TABLES[match[1]], int(match[2])), text)
    # The table's own column is looked at last: an address that says its table needs none.
    table = _table(sheet, line) or how.table
    if match := _HEX.fullmatch(plain):
        return _within(Register(table, int(match[1] or match[2], 16)), text)
    if plain.isdecimal() and len(plain) <= 5:
        return _within(Register(table, int(plain)), text)
    raise _RowError("address", f"{text!r} is no address; give one such as 40101, 4x101, %MW100, holding:100 or 100")


def _within(register: Register, text: str) -> Register:
    if not 0 <= register.number <= 65535:
        raise _RowError("address", f"{text!r} is outside the addresses, which are 0 to 65535")
    return register


def _table(sheet: ListSheet, line: ListRow) -> str:
    """The row's own table; "" where it names none."""
    text = line.get("table")
    if not text:
        return ""
    key = key_of(text)
    if known := TABLES.get(key):
        return known
    header = key_of(sheet.columns.get("table", ""))
    if key in FUNCTIONS and any(word in header for word in ("func", "funz", "code", "codice", "fc")):
        return FUNCTIONS[key]
    raise _RowError("table", f"{text!r} is no register table; give holding, input, coil or discrete")

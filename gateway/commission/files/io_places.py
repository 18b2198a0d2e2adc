"""Where a row of an I/O list lies: reference numbers, bare ones, hexadecimal ones, IEC 61131-3 addresses by maker."""

import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace

from gateway.commission.files.cells import RowError
from gateway.commission.survey import AddressTextError, Register, parse_register

_BIT = re.compile(r"(.+?)(?:[.:/](?:bit|x)?|bit)(\d{1,2})")
_SHORT = re.compile(r"([134])x0*(\d{1,5})")
_NOUGHT = re.compile(r"0x([0-9a-f]{1,4})")
_HEX = re.compile(r"(?:16#|&h|\$)([0-9a-f]{1,4})|([0-9a-f]{1,4})h")
_X_HEX = re.compile(r"x([0-9a-f]{1,4})")
_BARE_HEX = re.compile(r"[0-9a-f]{1,4}")
_IEC = re.compile(r"%?(?P<area>[imq])(?P<size>[xbwdlf]?)(?P<number>\d{1,5})(?:\.(?P<bit>\d{1,2}))?")
_GERMAN = re.compile(r"%?([ea])([xbwd]?\d{1,5}(?:\.\d)?)")
"""Siemens's German mnemonics: E and A where others have I and Q."""
_TEXT = re.compile(r"(\d{1,6})\.(\d{1,3})([hl]?)")
_HEADED = re.compile(r"(hr|ir)(\d{1,5})")
_RANGE = re.compile(r"(.+?)(?:\.\.\.?|…|~|–|—|-|,|;|/|to)(.+)")
_ARRAY = re.compile(r"(.+?)\s*\[\s*(\d+)\s*\]")
_REFERENCE_TABLES = {"0": "coil", "1": "discrete", "3": "input", "4": "holding"}


@dataclass(frozen=True, slots=True)
class ListedPlace:
    """A row's place: register, bit of it, so many registers (0: not said), bytes of a text, and how it was taken."""

    register: Register
    bit: int | None = None
    count: int = 0
    length: int = 0
    note: str = ""
    swapped: bool = False


@dataclass(frozen=True, slots=True)
class Numbering:
    """How a list's bare numbers are meant: hexadecimal, counted from `first`, references among them or not.

    `doubt` says why short ones may be hexadecimal, `either` why long ones may be references or addresses.
    """

    hexadecimal: bool = False
    first: int = 0
    references: bool = True
    doubt: str = ""
    either: str = ""


@dataclass(frozen=True, slots=True)
class _Iec:
    """Where a maker puts one kind of IEC address: `table`, the first one, and so many of the table a number.

    `bits` of a byte or word, for addresses such as 1.3. With `halves` the number counts bytes, and a register has two.
    """

    table: str
    first: int = 0
    step: int = 1
    bits: int = 0
    halves: bool = False


_COMMON = {"qx": _Iec("coil", bits=8), "ix": _Iec("discrete", bits=8), "qw": _Iec("holding"), "iw": _Iec("input")}
MAKERS: Mapping[str, Mapping[str, _Iec]] = {
    "openplc": _COMMON | {"mw": _Iec("holding", 1024), "md": _Iec("holding", 2048, 2), "ml": _Iec("holding", 4096, 4)},
    "codesys": _COMMON
    | {"mw": _Iec("holding"), "md": _Iec("holding", 0, 2), "ml": _Iec("holding", 0, 4), "mx": _Iec("holding", bits=8)}
    | {"qd": _Iec("holding", 0, 2), "id": _Iec("input", 0, 2)},
    "schneider": {"m": _Iec("coil"), "mw": _Iec("holding"), "md": _Iec("holding"), "mf": _Iec("holding")}
    | {"i": _Iec("discrete"), "iw": _Iec("input"), "qw": _Iec("holding")},
    "wago": {"mw": _Iec("holding", 12288), "md": _Iec("holding", 12288, 2), "mx": _Iec("coil", 12288, bits=16)}
    | {"qw": _Iec("holding", 512), "qx": _Iec("coil", 512, bits=16)}
    | {"iw": _Iec("input"), "ix": _Iec("discrete", bits=16)},
    "siemens": {"i": _Iec("discrete", bits=8), "q": _Iec("coil", bits=8)}
    | {"iw": _Iec("input", halves=True), "id": _Iec("input", halves=True)},
}
"""IEC addresses by the runtime that serves them: OpenPLC's Modbus map, CODESYS by size in bytes, Schneider's %M, %MW
and %MD that overlap, Wago 750 with words of 16 bits from 12288, an S7's process image as MB_SERVER serves it."""
SIEMENS = "siemens"
_NO_PLACE = {
    SIEMENS: "an S7 serves its process image and the block at MB_HOLD_REG: of a tag in its memory or in another block "
    "give the register of that block, as holding:0"
}
_BLOCK = re.compile(r"%?db\d+\.db[xbwdl]\d+(?:\.\d)?")
_ANY = {key: MAKERS["schneider"][key] for key in ("m", "mw", "iw", "qw", "i")}
"""What is taken where no maker is named, and said to be: the word's or the bit's own number."""


@dataclass(frozen=True, slots=True)
class AddressCell:
    """An address cell with what its row says beside it.

    `kind` is the row's type, "" where it has none; `table` is that of bare numbers, `named` if the row itself names it.
    """

    text: str
    kind: str
    how: Numbering
    plc: str
    table: str
    named: bool = False


def parse_place(cell: AddressCell) -> ListedPlace:
    """The place that an address cell names. Raises RowError."""
    text, kind, plc = cell.text, cell.kind, cell.plc
    plain = text.lower().replace(" ", "")
    if match := _ARRAY.fullmatch(text.strip()):
        raise RowError("address", f"{text!r} is an array of {match[2]}, which is not supported; give each its own row")
    if kind == "string" and (match := _TEXT.fullmatch(plain)):
        place = _single(match[1], cell)
        return replace(place, length=int(match[2]), swapped=match[3] == "l")
    if _BLOCK.fullmatch(plain):
        raise RowError("address", f"{text!r} lies in a data block: {_NO_PLACE[SIEMENS]}")
    if (span := _stretch(plain, cell)) is not None:
        return span
    if plc == SIEMENS and (german := _GERMAN.fullmatch(plain)):
        plain = {"e": "i", "a": "q"}[german[1]] + german[2]
    if match := _IEC.fullmatch(plain):
        return _iec(match, text, plc)
    if (match := _BIT.fullmatch(plain)) and not match[1].isalpha():
        with suppress(RowError):
            place = _single(match[1], cell)
            return replace(place, bit=int(match[2]))
    return _single(plain, cell)


def _stretch(plain: str, cell: AddressCell) -> ListedPlace | None:
    """The first of a range of registers, with how many; None for what is no range."""
    text = cell.text
    match = _RANGE.fullmatch(plain)
    if match is None or (cell.kind == "bool" and "/" in plain):
        return None
    last = match[2]
    try:
        first = _single(match[1], cell)
        if last.isdecimal() and match[1].isdecimal() and len(last) < len(match[1]) and int(last) < int(match[1]):
            last = match[1][: -len(last)] + last
        if ":" in match[1] and last.isdecimal():
            last = f"{first.register.table}:{last}"
        end = _single(last, cell)
    except RowError:
        return None
    count = end.register.number - first.register.number + 1
    if end.register.table != first.register.table or not 1 <= count <= 125:
        raise RowError("address", f"{text!r} is no range of one table; give the first register")
    return replace(first, count=count)


def _single(plain: str, cell: AddressCell) -> ListedPlace:
    """A place by whatever notation: holding:100, 40101, 4x101, %MW100, 0x64, or a bare number in a table."""
    text, how, table = cell.text, cell.how, cell.table
    reference = how.references and not how.hexadecimal and len(plain) >= 5 and plain.isdecimal()
    if reference and how.either and plain[0] in _REFERENCE_TABLES:
        raise RowError("address", f"{text!r}: {how.either}")
    if ":" in plain or reference:  # fewer digits are no reference number, but a bare address
        with suppress(AddressTextError):
            register = parse_register(plain)
            if ":" not in plain and cell.named and register.table != table:
                raise RowError(
                    "address",
                    f"{text!r} is {register} as a reference number, and its row says {table}; where the list's numbers "
                    "are addresses as they go on the wire, give --numbers plain",
                )
            return ListedPlace(_check_range(register, text))
    if match := _SHORT.fullmatch(plain):  # counts from 1, as reference numbers do; %MW100 from 0
        register = Register(_REFERENCE_TABLES[match[1]], int(match[2]) - 1)
        if cell.named and register.table != table:
            raise RowError("address", f"{text!r} is {register}, and its row says {table}; correct one of them")
        return ListedPlace(_check_range(register, text))
    if match := _NOUGHT.fullmatch(plain):
        number = match[1]
        if number.isdecimal() and not how.hexadecimal and cell.kind in ("", "bool"):
            if table != "coil" or not cell.named:
                raise RowError(
                    "address", f"{text!r} is a coil's reference number, or hexadecimal; give --numbers hex, or coil:99"
                )
            return ListedPlace(_check_range(Register("coil", int(number) - 1), text))
        return ListedPlace(_check_range(Register(table, int(number, 16)), text))
    if match := _IEC.fullmatch(plain):
        return _iec(match, text, cell.plc)
    if match := _HEX.fullmatch(plain):
        return ListedPlace(_check_range(Register(table, int(match[1] or match[2], 16)), text))
    if match := _HEADED.fullmatch(plain):
        raise RowError(
            "address", f"{text!r}: {match[1].upper()} counts from 1 or from 0 by its server; give 40101 or holding:100"
        )
    if match := _X_HEX.fullmatch(plain):
        if not how.hexadecimal:
            raise RowError(
                "address",
                f"{text!r} may be hexadecimal, or a PLC's input X; give --numbers hex or holding:100",
            )
        plain = match[1]
    if how.hexadecimal and _BARE_HEX.fullmatch(plain):
        return ListedPlace(_check_range(Register(table, int(plain, 16) - how.first), text))
    if not how.hexadecimal and plain.isdecimal() and len(plain) <= 5:
        if how.doubt:
            raise RowError("address", f"{text!r}: {how.doubt}")
        return ListedPlace(_check_range(Register(table, int(plain) - how.first), text))
    raise RowError("address", f"{text!r} is no address; give one such as 40101, 4x101, %MW100, holding:100 or 100")


def _iec(match: re.Match[str], text: str, plc: str) -> ListedPlace:
    """An IEC 61131-3 address by its maker's map. Raises RowError where the maker decides and is not named."""
    letters, number = match["area"] + match["size"], int(match["number"])
    bit = None if match["bit"] is None else int(match["bit"])
    rule = (MAKERS[plc] if plc else _ANY).get(letters)
    # A bit of a word, as %MW100.3, is the same everywhere.
    if rule is None or (bit is None if rule.bits else bit is not None and letters != "mw"):
        unnamed = f"none is named; give --plc, one of {', '.join(MAKERS)}"
        why = _NO_PLACE.get(plc, f"{plc} has no such place") if plc else unnamed
        raise RowError("address", f"{text!r}: where it lies is for its maker to say, and {why}")
    if bit is not None and rule.bits:
        if bit >= rule.bits:
            raise RowError("address", f"{text!r} has bit {bit}, and {plc} counts {rule.bits} of them")
        if rule.table in ("holding", "input"):  # by bytes: two a register, the low one first
            return ListedPlace(
                _check_range(Register(rule.table, rule.first + number // 2), text), 8 * (number % 2) + bit, note=plc
            )
        return ListedPlace(_check_range(Register(rule.table, rule.first + rule.bits * number + bit), text), note=plc)
    if rule.halves and number % 2:
        raise RowError("address", f"{text!r} begins in the middle of a register, of which {plc} counts the bytes")
    register = Register(rule.table, rule.first + (number // 2 if rule.halves else rule.step * number))
    return ListedPlace(_check_range(register, text), bit, note=plc or f"%{letters.upper()} by its number: else --plc")


def _check_range(register: Register, text: str) -> Register:
    if not 0 <= register.number <= 65535:
        raise RowError("address", f"{text!r} is outside the addresses, which are 0 to 65535")
    return register

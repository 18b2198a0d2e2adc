"""An I/O list as tags: each row gives one, or one sentence that says what is wrong with it.

A row is read whole or refused: what a cell says and is not understood is never left out, and where two readings of it
are possible an option asks for the one.
"""

import csv
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

from drivers.codec import integer_range
from drivers.named_files import contents
from drivers.tag import DType
from gateway.commission.files.cells import (
    OF_SOMETHING_ELSE,
    ListError,
    ListRow,
    ListSheet,
    RowError,
    header_key,
    parse_decimal,
    read_sheet,
)
from gateway.commission.files.io_evidence import (
    bits_a_length,
    doubt_of_references,
    inverted_scales,
    is_length_of_registers,
    take_fineness,
)
from gateway.commission.files.io_halves import Listed, name_columns, other_name, part_halves, part_overlaps
from gateway.commission.files.io_models import ModelError, read_model
from gateway.commission.files.io_places import SIEMENS, AddressCell, ListedPlace, Numbering, parse_place
from gateway.commission.files.io_polls import by_formula, is_iobroker, of_iobroker, read_polls
from gateway.commission.files.io_templates import ListedUnit, TemplateError, read_yaml
from gateway.commission.files.io_units import CountFactor, parse_factor, parse_range, parse_unit
from gateway.commission.files.io_words import (
    COLUMNS,
    KNOWN_TYPES,
    LENGTHS_IN_BITS,
    LENGTHS_OF_NO_UNIT,
    ORDERS,
    TABLES,
    TOLD_BY,
    WIDTHS,
    TypeCell,
    parse_flag,
    parse_sign,
    parse_size,
    parse_tables,
    type_cell,
    widen_type,
)
from gateway.commission.survey import Register, parse_register

_HEX_NUMBER = re.compile(r"(?:0x|16#)([0-9a-f]{1,16})|([0-9a-f]{1,16})h")
_WHOLE_NUMBER = re.compile(r"[+-]?\d+")
_EMPTY = ("", "-", "–", "—", "--", "/", "n/a", "n.a.", "N/A", "N.A.")
_MOST_DIGITS = 20
"""A sign, and those of a whole number of 64 bits, or those alone."""
_SCALE_DECIMALS = 9
_MOST_EXPONENT = 9
_RANGE_TOLERANCE = 1e-3
"""A range ends where a type does if they differ by less, as a part of it."""
_SHORTS = frozenset({"short", "ushort", "unsigned short", "signed short"})
_INTS = frozenset({"int", "uint", "unsigned int", "signed int"})
_UNITS_OF_BITS = frozenset(
    {"bit", "bits", "bool", "boolean", "flag", "on off", "off on", "0 1", "state", "status", "1"}
)
_SINGLE = frozenset({"bool", "int8", "uint8", "int16", "uint16", "bcd16", "string"})


@dataclass(frozen=True, slots=True)
class Reading:
    """How a list is read where it does not say itself.

    `table` of bare numbers, `order` of values wider than a register ("": ABCD, or what the list's layout has), `shift`
    added to every address, `registers` False for other drivers' addresses, which are left as they are. `gain` (one of
    GAINS), `numbers` (one of NUMBERS) and `plc` (one of PLC_MAKERS) settle what a list leaves open; "" where nothing
    does. `unit` is the one that is meant of a list of several, `repeats` how often a group of a model is there. `wide`:
    the device has registers of 32 bits, each of which is one address.
    """

    table: str = "holding"
    order: str = ""
    shift: int = 0
    registers: bool = True
    gain: str = ""
    numbers: str = ""
    plc: str = ""
    unit: int | None = None
    wide: bool = False
    repeats: Mapping[str, int] = field(default_factory=dict)
    rename: Mapping[str, str] = field(default_factory=dict)


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
    sheet = _structured(path, how, page) or _of_units(
        read_sheet(path, COLUMNS, ("name", "address"), given=columns, sheet=page, told_by=TOLD_BY), how
    )
    how, numbering = _of_the_layout(sheet, how), _numbering(sheet, how)
    how = replace(how, gain=how.gain or _gain_of_the_list(sheet))
    tags: list[Listed] = []
    problems: list[str] = []
    shorts = any(header_key(line.get("dtype")) in _SHORTS for line in sheet.lines)
    shown = _Shown(name_columns(sheet), _bits_a_length(sheet), _raw_range(sheet), inverted_scales(sheet))
    for line in sheet.lines:
        try:
            tags.append(_read_row(_ListedRow(sheet, line, how, numbering, shorts, shown), tags))
        except RowError as error:
            problems.append(f"{sheet.where(line, error.column)}: {error}")
    if not tags and not problems and not sheet.columns:
        raise ListError(f"{path}: has no registers; give a list with one entry a tag")
    if not tags and not problems:
        raise ListError(f"{path}: has a header in line {sheet.header_line} and no row under it; give one row a tag")
    tags = _texts_of_registers(sheet, tags) if how.registers and not how.wide else tags
    tags, across = part_overlaps(sheet, tags) if how.registers and not how.wide else (tags, [])
    tags, torn, note = part_halves(sheet, tags)
    sheet = replace(sheet, notes=(*sheet.notes, note)) if note else sheet
    return IoList(sheet, tuple(tags), (*problems, *across, *torn))


def _structured(path: Path, how: Reading, page: str | None) -> ListSheet | None:
    """A list that is no table: a model of SunSpec, or YAML of another program; None for a table. Raises ListError."""
    kind = path.suffix.lower()
    if kind not in (".json", ".yaml", ".yml"):
        return _polled(path, how)
    try:
        text = contents(path).decode("utf-8-sig")
    except OSError as error:
        raise ListError(f"{path}: cannot be read ({(error.strerror or str(error)).lower()})") from None
    except UnicodeDecodeError as error:
        raise ListError(f"{path}: byte {error.start} is not UTF-8; save the file as UTF-8") from None
    try:
        if kind != ".json":
            return _of_one_unit(ListSheet(path, 0, {}, (), ()), read_yaml(text, page), how.unit)
        rows, left_out = read_model(text, how.repeats)
    except (ModelError, TemplateError) as error:
        raise ListError(f"{path}: {error}") from None
    if how.shift == 0:
        raise ListError(
            f"{path}: a SunSpec model lies where the device has it: give --shift, the address of its first register "
            "(decanter plc scan models)"
        )
    return ListSheet(path, 0, {}, (), tuple(rows), left_out=tuple(left_out))


def _polled(path: Path, how: Reading) -> ListSheet | None:
    """A configuration of modpoll; None for any other file."""
    with suppress(OSError, csv.Error):
        if (listed := read_polls(contents(path).decode("utf-8-sig", errors="replace"))) is not None:
            return _of_one_unit(ListSheet(path, 0, {}, (), ()), listed, how.unit)
    return None


_POWERS = r"\bpow(?:er)?s?(?: of)? ?(?:10|ten)\b|\bsf\b|^exp$|\bscal\w* exp\b|\bexpon|\bespon|zehnerpotenz"
_EXPONENTS = re.compile(rf"{_POWERS}|^power$|(?<!\d )\b10(?: ?(?:x|n|y|e|exp))?\b")
"""Headers of powers of ten, where 10 stands as the base: `SF`, `Scale 10^`, `Pow10`."""
_RAISED = re.compile(r"10\s*(?:\^|\*\*)")
_OVER_TEN = re.compile(r"10\W*[-−⁻]|[/÷]\s*10")
"""`10^-n`, which says decimals."""


def _power_word(header: str) -> str:
    """The words by which a header says powers of ten; "" for none."""
    found = _EXPONENTS.search(header_key(header)) or _RAISED.search(header)
    return found[0] if found else ""


_DECIMALS = re.compile(r"^(?:dec|dp|digits)$|komma|dezim|decim|precis|prazis")
_MIN_LETTERS = 2
_RAW = re.compile(
    r"\braw (?:\w+ )?(?:min|max|low|high|lo|hi|zero|full|span|range)\b|\b(?:min|max|low|high|range) (?:\w+ )?raw\b"
)
_FACTORS = re.compile(
    r"scaling|\bfact\b|factor(?!y)|fattor|faktor|\bfakt\b|facteur|\bgain|\bmult(?:\b|ip)|divis(?:or|eur)|(?<!in)divid|\bdiv\b"
    r"|coef|\bteiler|slope|convers|umrechn|\bper (?:count|bit|digit|lsb)s?\b|\b(?:count|digit)s? per\b"
    rf"|^10(?: ?[xn])?$|{_POWERS}"
)
_SCALES = re.compile(
    rf"{_FACTORS.pattern}|{_DECIMALS.pattern}|{_RAW.pattern}|(?<!fi)scal(?!at)|skalier|resol|risol|echel|\bteilung"
    r"|auflos|wertig|\blsb\b|quantum|increment|convert\b|pendenza|steigung|pente|divis|^(?:weight|poids|peso)$"
    r"|\b(?:pro|par|por) (?:digit|count|bit|punkt)\b"
)
_SUBTRACTS = re.compile(r"^sub$|^subtr")
_ADDS = re.compile(rf"\bbias\b|intercept|^add$|^addend$|^additive$|{_SUBTRACTS.pattern}")
_SAYS_A_NUMBER = re.compile(r"^\W*\d|(?:(?<![^\W\d_])x|[×*·/÷:=^+])\s*(?:[-+]\s*)?[.,]?\d", re.IGNORECASE)
"""A cell that is a number, or has an operation with one: `PT100 transmitter` has none."""
_SIGNS = re.compile(r"^(?:un)?signed$|^sign$|vorzeichen|^vorz$|con segno|^segno$|^signo$|^signe$|^sinal$")
_UNREAD = (
    (_SCALES, frozenset({"scale", "decimals", "raw_high", "formula"}), "scale", "how readings are scaled"),
    (_ADDS, frozenset({"offset"}), "offset", "what is added to readings"),
    (
        re.compile(r"\b(?:word|byte|register)s? order\b|endian|\bswap|wortfolge|bytefolge"),
        frozenset[str](),
        "order",
        "the order of words or bytes",
    ),
    (_SIGNS, frozenset({"dtype"}), "dtype", "which numbers have a sign"),
)
"""Headers of columns that nobody reads, unless one of those columns is there; as which column, what they may say."""


def _of_units(sheet: ListSheet, how: Reading) -> ListSheet:
    """A table in this reader's words, and of several units the rows of the one that is meant.

    Raises ListError for a column that nobody reads and that may say what readings are made of.
    """
    sheet = take_fineness(_with_access(sheet))
    _check_unread(sheet)
    headers = {header_key(text) for text in (*sheet.columns.values(), *sheet.ignored)}
    sheet = _without_plant_units(sheet, how.unit)
    own = is_iobroker(headers)
    rows = [replace(row, cells=of_iobroker(row.cells)) if own else row for row in sheet.lines]
    if "unit_id" in sheet.columns:
        return _of_one_unit(sheet, [ListedUnit(row, row.get("unit_id")) for row in rows], how.unit)
    return replace(sheet, lines=tuple(rows)) if own else sheet


def _with_access(sheet: ListSheet) -> ListSheet:
    """The list with a column `Type` that says R and R/W as that of access."""
    told = {header_key(line.get("dtype")) for line in sheet.lines} - {""}
    if "access" in sheet.columns or not told or not told <= _ACCESSES:
        return sheet
    columns = {("access" if name == "dtype" else name): text for name, text in sheet.columns.items()}
    lines = (
        replace(line, cells={("access" if name == "dtype" else name): cell for name, cell in line.cells.items()})
        for line in sheet.lines
    )
    return replace(sheet, columns=columns, lines=tuple(lines))


_ACCESSES = frozenset({"r", "w", "rw", "r w", "ro", "wo", "read", "write", "read write", "read only", "write only"})


def _check_unread(sheet: ListSheet) -> None:
    """Raises ListError for a column that nobody reads and whose cells may change readings."""
    _check_lines(sheet)
    _check_masks(sheet)
    for pattern, known, column, what in _UNREAD:
        first = next((sheet.columns[name] for name in sheet.columns if name in known), "")
        for at, header in enumerate(sheet.ignored):
            key = header_key(header)
            if not pattern.search(key) or (first and not _is_second(column, key)):
                continue
            for line in sheet.lines:
                cell = line.unread[at]
                if not _may_change(column, cell):
                    continue
                if first and _repeats(line, column, key, cell):
                    continue
                if first:
                    raise ListError(
                        f"{sheet.path}: line {line.number}: {header!r} ({cell}) may say {what} beside {first!r}, and "
                        "one of them is read: write both as one number, or take it out"
                    )
                none = f"--column no_scale={header!r}" if column == "scale" else "take it out"
                raise ListError(
                    f"{sheet.path}: column {header!r} may say {what}, and is not understood: "
                    f"{_advise(column, header, key)}, or {none}"
                )


_LINES = (
    *({"a": 1, "b": 0, "c": 0}, {"a1": 1, "a0": 0}),
    *({"m": 1, "b": 0}, {"m": 1, "c": 0}, {"m": 1, "q": 0}, {"k": 1, "b": 0}),
)
"""Headers of a letter each by which lists write y = a x + b and its like, with what changes nothing."""
_SLOPES = frozenset({"k", "m"})
_CONSTANTS = frozenset({"b", "c", "q"})


def _check_lines(sheet: ListSheet) -> None:
    """Raises ListError for columns such as `A` and `B`, or `m` and `b`, that make another number of what is read."""
    letters = {header_key(header): at for at, header in enumerate(sheet.ignored)}
    numbers = {key: [_factor_of(line.unread[at]) for line in sheet.lines] for key, at in letters.items()}
    # `A`, `B` and `C` may be phases, of which each row has some.
    chosen = {key for key, cells in numbers.items() if set(cells) <= {0, 1, None}}
    _check_constant(sheet, {key: letters[key] for key in _CONSTANTS & letters.keys() - chosen})
    for neutral in _LINES:
        places = {key: letters[key] for key in neutral if key in letters}
        slope = next(iter(neutral))
        if slope not in places or len(places) < _MIN_LETTERS:
            continue
        of_phases = "c" in places and slope == "a" and places.keys() - chosen <= {slope}
        if of_phases and all(number is None or number.is_integer() for number in numbers[slope]):
            continue
        for row, line in enumerate(sheet.lines):
            for key in places.keys() - chosen:
                at, number = places[key], numbers[key][row]
                if number is not None and number != neutral[key]:
                    named = " and ".join(repr(sheet.ignored[at]) for at in places.values())
                    raise ListError(
                        f"{sheet.path}: line {line.number}: columns {named} may say how readings are scaled "
                        f"({sheet.ignored[at]} is {line.unread[at]}), and are not understood: write units per count in "
                        "a column Scale and what is added in a column Offset, or take them out"
                    )


def _check_constant(sheet: ListSheet, constants: Mapping[str, int]) -> None:
    """Raises ListError for the one of these columns that is the b of y = k x + b, as the scale's header says k."""
    slope = sheet.columns.get("scale", "")
    if header_key(slope) not in _SLOPES or "offset" in sheet.columns or len(constants) != 1:
        return
    (at,) = constants.values()
    for line in sheet.lines:
        cell = line.unread[at]
        if cell not in _EMPTY and _factor_of(cell) is None:
            return
    raise ListError(
        f"{sheet.path}: column {sheet.ignored[at]!r} may say what is added to readings beside {slope!r}, and is not "
        f"understood: give --column offset={sheet.ignored[at]!r}, or take it out"
    )


_MASKS = re.compile(r"(?:bit ?)?(?:mask|maske|maschera|masque|mascara)(?: hex)?|r?shift|(?:bit|right) shift")
_WHOLE_MASKS = frozenset({0, 0xFF, 0xFFFF, 0xFFFFFFFF})
"""Masks that leave a number as it is, and 0 for a shift by nothing; 0xFF for a byte."""
_MOST_WORK_SHIFTS = 3
"""A plant's shifts of a day, which a column `Shift` may have."""


def _check_masks(sheet: ListSheet) -> None:
    """Raises ListError for a mask or shift, by which only some bits of a register are the value."""
    for at, header in enumerate(sheet.ignored):
        key = header_key(header)
        if not _MASKS.fullmatch(key) or (key == "shift" and _of_work([line.unread[at] for line in sheet.lines])):
            continue
        for line in sheet.lines:
            number = _mask_of(line.unread[at])
            if number is None or (number in _WHOLE_MASKS and (number != 0xFF or "8" in line.get("dtype"))):
                continue
            bit = _own_bit(sheet, line)
            if bit is not None and number == (bit if "shift" in key else 1 << bit):
                continue
            advice = "give the bit in a column Bit" if bit is None else f"the row itself says bit {bit}: correct one"
            raise ListError(
                f"{sheet.path}: line {line.number}: {header!r} ({line.unread[at]}) may say which bits are "
                f"the value, and is not understood: {advice}, or take it out"
            )


def _mask_of(cell: str) -> int | None:
    """A whole number, decimal or hexadecimal; None for what is none, as 255.255.255.0."""
    plain = cell.lower().removesuffix(".0")
    if match := _HEX_NUMBER.fullmatch(plain):
        return int(match[1] or match[2], 16)
    return int(plain) if plain.isdecimal() and len(plain) <= _MOST_DIGITS else None


def _of_work(cells: Sequence[str]) -> bool:
    """Whether the numbers of a column may be shifts of a day."""
    return all((_mask_of(cell) or 0) <= _MOST_WORK_SHIFTS for cell in cells)


def _own_bit(sheet: ListSheet, line: ListRow) -> int | None:
    """The bit that the row says, in its bit's column or behind the address's point; None where it says none."""
    with suppress(RowError):
        if (bit := _bit(_ListedRow(sheet, line, Reading(), Numbering()))) is not None:
            return bit
    match = _BIT_OF_ADDRESS.search(line.get("address"))
    return int(match[1]) if match else None


_BIT_OF_ADDRESS = re.compile(r"\d\.(\d{1,2})$")


def _is_second(column: str, key: str) -> bool:
    """Whether a column beside one that is read changes readings too: what is shown or polled does not."""
    if column == "offset":
        return True
    return column == "scale" and bool(_FACTORS.search(key)) and OF_SOMETHING_ELSE.isdisjoint(key.split())


def _may_change(column: str, cell: str) -> bool:
    """Whether a cell of a column that nobody reads may change a reading."""
    if column not in ("scale", "offset"):
        return cell not in _EMPTY
    return bool(_SAYS_A_NUMBER.search(cell)) and not (column == "offset" and _factor_of(cell) == 0)


def _repeats(line: ListRow, column: str, key: str, cell: str) -> bool:
    """Whether a cell changes nothing beside the row's own scale or offset: it is neutral, or says the same."""
    number = _factor_of(cell)
    if number in (0, 1) if column == "scale" else number == 0:
        return True
    own, decimals = _factor_of(line.get(column)), line.get("decimals")
    if column == "scale" and own is None and re.fullmatch(r"\d", decimals):
        own = 10.0 ** -int(decimals)
    if number is None or own is None or not _DIVISORS.isdisjoint(key.split()) or _SUBTRACTS.search(key):
        return False
    said = {number, 10.0**number} if _EXPONENTS.search(key) and abs(number) <= _MOST_EXPONENT else {number}
    return any(abs(own - one) <= 1e-9 * abs(own) for one in said)


def _factor_of(cell: str) -> float | None:
    try:
        return parse_factor(cell).number
    except ValueError:
        return None


def _advise(column: str, header: str, key: str) -> str:
    """How an unread column can be read by what it may be."""
    if column == "scale" and _RAW.search(key):
        return "give the ends of raw values in two columns, --column raw_low=HEADER and --column raw_high=HEADER"
    if column == "scale" and _power_word(header):
        return f"give --column decimals={header!r} for powers of ten, --column scale={header!r} for units per count"
    if column == "scale" and _DECIMALS.search(key):
        return f"give --column decimals={header!r}"
    if column == "offset" and _SUBTRACTS.search(key):
        return "write what is added to readings, with its sign, in a column Offset"
    return f"give --column {column}={header!r}"


_MOST_UNIT = 247
"""The last unit that a Modbus device has; 255 is a gateway itself."""
_UNITS_OF_PLANTS = re.compile(r"^(?!.*\b(?:modbus|slave)\b).*\bunit (?:no|number)\b")


def _without_plant_units(sheet: ListSheet, unit: int | None) -> ListSheet:
    """The list with `Unit No` as a column that nobody reads, where its cells are no units of Modbus or not the one."""
    header = sheet.columns.get("unit_id", "")
    units = {text for line in sheet.lines if (text := line.get("unit_id")) not in _EMPTY}
    of_modbus = all(text.isdecimal() and (int(text) <= _MOST_UNIT or int(text) == 255) for text in units)
    if not _UNITS_OF_PLANTS.search(header_key(header)) or (of_modbus and (unit is None or str(unit) in units)):
        return sheet
    columns = {name: text for name, text in sheet.columns.items() if name != "unit_id"}
    return replace(sheet, columns=columns, ignored=(*sheet.ignored, header))


def _of_one_unit(sheet: ListSheet, listed: Sequence[ListedUnit], unit: int | None) -> ListSheet:
    """The list with the rows of the unit that is meant, and a note on the others and on keys that were not taken.

    Where the unit is not said and there are several each row of them is refused.
    """
    units = sorted({one.unit for one in listed if one.unit})
    notes: list[str] = []
    if unit is not None and len(units) > 1:
        others = Counter(one.unit for one in listed if one.unit not in ("", str(unit)))
        notes += [
            f"{_count(number, 'row')} of unit {other} {'was' if number == 1 else 'were'} left out (--unit {unit})"
            for other, number in sorted(others.items())
        ]
        listed = [one for one in listed if one.unit in ("", str(unit))]
        if not any(one.unit for one in listed):
            raise ListError(f"{sheet.path}: has no row of unit {unit}; it has {', '.join(units)}: give --unit")
        units = [str(unit)]
    untaken = Counter(key for one in listed for key in one.untaken)
    notes += [f"{key} is not taken ({_count(number, 'row')})" for key, number in sorted(untaken.items())]
    if len(units) < 2:
        said = f"unit {units[0]}" if units else ""
        rows = [replace(one.row, cells=_beside(one.row.cells, said if one.unit else "")) for one in listed]
    else:
        several = f"is of unit {{}}, and the list has {', '.join(units)}: give --unit"
        rows = [
            replace(one.row, cells={"refused": several.format(one.unit), **one.row.cells}) if one.unit else one.row
            for one in listed
        ]
    return replace(sheet, lines=tuple(rows), notes=tuple(notes))


def _count(number: int, what: str) -> str:
    return f"{number} {what}" + ("" if number == 1 else "s")


def _beside(cells: Mapping[str, str], said: str) -> dict[str, str]:
    """The cells with a note beside what they say themselves."""
    note = "; ".join(text for text in (cells.get("said", ""), said) if text)
    return {**cells, "said": note}


@dataclass(frozen=True, slots=True)
class _Shown:
    """What the rows of a list show together: further columns of names (`name_columns`), the bits of what lengths count.

    `raw_range` is the line whose range is of raw counts, 0 for none; `inverted` the scales that examples contradict.
    """

    names: tuple[int, ...] = ()
    length_bits: int = 0
    raw_range: int = 0
    inverted: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class _ListedRow:
    """A row with what is known of its list; `shorts`: it has types of C, whose INT is no PLC's.

    `shown` is what its other rows show.
    """

    sheet: ListSheet
    line: ListRow
    how: Reading
    numbering: Numbering
    shorts: bool = False
    shown: _Shown = field(default_factory=_Shown)

    def get(self, column: str) -> str:
        return self.line.get(column)

    def header(self, column: str) -> str:
        """The column's header, as `header_key` writes it."""
        return header_key(self.sheet.columns.get(column, ""))


@dataclass(frozen=True, slots=True)
class _Scaling:
    """Engineering value = raw * scale + offset, the range in units, the unit's name, and how it was taken."""

    scale: float | None = None
    offset: float | None = None
    low: float | None = None
    high: float | None = None
    unit: str | None = None
    taken: str = ""


def _read_row(row: _ListedRow, before: Sequence[Listed]) -> Listed:
    line, how = row.line, row.how
    if refused := line.get("refused"):
        raise RowError("", f"{line.get('name')}: {refused}")
    listed, named = line.get("name"), ""
    if not listed:
        listed, named = other_name(row.sheet, line, row.shown.names)
    if not listed:
        raise RowError("name", "is empty; give the tag's name, or take the row out")
    name = how.rename.get(listed, listed)
    if twice := next((tag for tag in before if tag.name == name), None):
        raise RowError("name", f"{name!r} is in line {twice.line} already; give each tag a name of its own")
    if header_key(line.get("access")) in _WRITE_ONLY:
        raise RowError("access", f"{line.get('access')!r} says that it cannot be read; take the row out")
    cell = _type_cell(line)
    _check_sign(row.sheet, line, cell)
    address, place = _address(row, cell)
    dtype, length = _type(row, cell, place, address)
    numeric = dtype not in ("bool", "string")
    if place.bit is not None:
        _check_bit(row, cell, place.bit)
    scaling = _scaling(row, dtype) if numeric else _Scaling()
    order, said = _order(row, cell, dtype, place)
    shared = _share_note(before, row, address, place)
    keys = {
        "address": address,
        "dtype": dtype,
        "order": order,
        "scale": scaling.scale,
        "offset": scaling.offset,
        "bit": place.bit,
        "length": length or None,
        "unit": scaling.unit,
        "low": scaling.low,
        "high": scaling.high,
        "sentinel": _sentinel(line) if numeric else None,
        "scale_from": _factor_place(row, cell) if numeric else None,
        "period": _number(line, "period"),
    }
    taken = "; ".join(note for note in (named, place.note, said, scaling.taken, line.get("said"), shared) if note)
    unread = ""
    if numeric and scaling.scale is None and _SCALE_IN_WORDS.search(remark := line.get("remark")):
        unread = f"{row.sheet.where(line, 'remark')}: {remark!r} may say a scale, which is not read: give it a column"
    if numeric and not keys["sentinel"] and _NO_VALUE_IN_WORDS.search(remark := line.get("remark")):
        unread = f"{row.sheet.where(line, 'remark')}: {remark!r} may say a number that is no value, which is not read"
        unread += ": give it a column Sentinel"
    return Listed(name, keys, line.number, taken, line.get("address"), unread)


def _check_bit(row: _ListedRow, cell: TypeCell, bit: int) -> None:
    """Raises RowError for a number's factor or unit beside the address of one bit: one of them is something else."""
    try:
        factor = _scale_cell(row.line) or (None if row.line.get("exact") else parse_unit(row.get("unit"))[1])
    except (RowError, ValueError):
        factor = None  # such as `0=off, 1=on`, which is of no use for a bit
    unit = "" if row.get("unit") in _EMPTY else row.get("unit")
    unit = "" if header_key(unit) in _UNITS_OF_BITS or _NAMES_OF_VALUES.fullmatch(unit) else unit
    if (factor is not None and factor.number != 1) or (unit and cell.dtype not in ("", "bool")):
        what = f"the unit {unit!r}" if unit else f"the scale {row.get('scale')!r}"
        raise RowError("address", f"{row.get('address')!r} is bit {bit} of a register, and has {what}; correct one")


_SCALE_IN_WORDS = re.compile(
    r"(?:fakt|fact|fatt|scal|skal|escala|echelle|échelle|gain|mult|divi|teil|risol|resol|auflös|resoluc)\w*"
    r"(?: by| of| con| mit| par| por| per| durch)?\W{0,3}\d"
    r"|(?:^|[\s(\[])(?:[x×*/÷]\s?10*(?:[.,]0*1)?|0[.,]0*1)(?:$|\W)",
    re.IGNORECASE,
)
"""A scale in running text: `Faktor 0,1`, `x 0.1`, `/10`."""
_ABSENT = r"(?:not avail|not impl|unavail|invalid|no data|no value|non disp|ungültig|nicht verf|indisp|no disp)"
_NUMBER_OF_NOTHING = r"(?:0x[0-9a-f]{2,16}\b|-?\b(?:3276[78]|65535|2147483647|2147483648|4294967295)\b)"
_NO_VALUE_IN_WORDS = re.compile(
    rf"{_NUMBER_OF_NOTHING}.{{0,20}}{_ABSENT}|{_ABSENT}.{{0,20}}{_NUMBER_OF_NOTHING}", re.IGNORECASE
)
"""A sentinel in running text: `0xFFFF = not available`."""


def _share_note(before: Sequence[Listed], row: _ListedRow, address: str, place: ListedPlace) -> str:
    """With which tag it shares its place, to be printed; "" for none.

    Two tags may have one where each takes another bit of it, or where the list itself writes the place in two ways: it
    names it twice then. What is written alike is a line that was copied. Raises RowError.
    """
    text, shared = row.get("address"), ""
    for other in before:
        bits = (place.bit, other.keys["bit"])
        if address != other.keys["address"] or (None not in bits and bits[0] != bits[1]):
            continue
        if not row.line.get("exact") and (bits != (None, None) or text == other.written):
            raise RowError(
                "address",
                f"{text!r} is where {other.name!r} of line {other.line} lies; correct one of them (a spreadsheet shows "
                "bit 0 as no bit, and 10 as .1)",
            )
        shared = f"{address} is {other.name!r} of line {other.line} too"
        shared += "" if row.line.get("exact") else f", written {other.written!r}"
    return shared


def _factor_place(row: _ListedRow, cell: TypeCell) -> str | None:
    """The register of its factor, which is written as its own address is and moves with the list."""
    if text := row.get("scale_from"):
        return str(parse_register(text).shift(row.how.shift))
    _, text = by_formula(row.line)
    if not text:
        return None
    table = _table(row)
    place = parse_place(
        AddressCell(text, "int16", row.numbering, row.how.plc, table or row.how.table, named=bool(table))
    )
    return str(place.register.shift(row.how.shift))


_WRITE_ONLY = frozenset({"w", "wo", "write", "write only", "scrittura", "solo scrittura"})


def _number(line: ListRow, column: str) -> float | None:
    text = line.get(column)
    if text in _EMPTY:
        return None
    try:
        return round(parse_decimal(text), 12)
    except ValueError:
        raise RowError(column, f"{text!r} is no number; give one such as 0,1 or 0.1, or leave it empty") from None


def _whole(line: ListRow, column: str) -> int | None:
    number = _raw(line.get(column), column)
    if number is not None and not float(number).is_integer():
        raise RowError(column, f"{line.get(column)!r} is no whole number")
    return None if number is None else int(number)


def _raw(text: str, column: str) -> int | float | None:
    if text in _EMPTY:
        return None
    if match := _HEX_NUMBER.fullmatch(text.lower()):
        return int(match[1] or match[2], 16)
    if _WHOLE_NUMBER.fullmatch(text) and len(text) <= _MOST_DIGITS:
        return int(text)  # a float has 53 bits, and a raw number 64
    try:
        number = parse_decimal(text)
    except ValueError:
        raise RowError(column, f"{text!r} is no number; give the raw number, such as 0x7FFF or 32767") from None
    return int(number) if number.is_integer() else number


def _sentinel(line: ListRow) -> int | float | list[int | float] | None:
    """The raw number or numbers that mean "not available"; a float's NaN always does."""
    parts = [part for part in re.split(r"[;/|]|,\s+", line.get("sentinel")) if part.strip().lower() not in ("", "nan")]
    numbers = [number for part in parts if (number := _raw(part.strip(), "sentinel")) is not None]
    return numbers[0] if len(numbers) == 1 else numbers or None


# ---------------------------------------------------------------- what holds for the whole list


def _of_the_layout(sheet: ListSheet, how: Reading) -> Reading:
    """What an export of a known program has by default."""
    headers = {header_key(text) for text in (*sheet.columns.values(), *sheet.ignored)}
    if not how.plc and "logical address" in headers and any(header.startswith("hmi ") for header in headers):
        return replace(how, plc=SIEMENS)  # a tag table of TIA Portal
    if not how.order and {"respect data type", "client access"} <= headers:
        return replace(how, order=LOW_WORD_FIRST)
    return how


LOW_WORD_FIRST = "CDAB?"
"""The order by default of the OPC servers that export such lists, of which the table speaks."""


def _numbering(sheet: ListSheet, how: Reading) -> Numbering:
    header = set(header_key(sheet.columns.get("address", "")).split())
    cells = [line.get("address").lower() for line in sheet.lines]
    bare = [cell for cell in cells if re.fullmatch(r"[0-9a-f]{1,4}", cell)]
    based = bool(header & {"based", "base", "from"})
    if (wire := _WIRE.search(header_key(sheet.columns.get("address", "")))) and not how.numbers:
        numbers = [cell for cell in cells if cell.isdecimal()]
        if "offset" in wire[0] or not numbers or not all(_REFERENCE.fullmatch(cell) for cell in numbers):
            return Numbering(False, 0, False)
        either = "the header has addresses as they go on the wire, and all are like references: give --numbers decimal"
        return Numbering(either=f"{either} (40101 is holding:100) or --numbers plain (it is the address itself)")
    first = 1 if header & {"1", "one"} and based else 0
    if how.numbers or header & {"hex", "hexadecimal", "hexa", "esadecimale", "esa"}:
        hexadecimal = how.numbers == "hex" if how.numbers else not header & {"dec", "decimal", "decimale"}
        return Numbering(hexadecimal, first, how.numbers != "plain")
    if is_iobroker({header_key(text) for text in (*sheet.columns.values(), *sheet.ignored)}) and not how.numbers:
        either = (
            "ioBroker's table does not say whether its aliases are on: give --numbers decimal (40101 is holding:100)"
        )
        return Numbering(either=f"{either} or --numbers plain (it is the address itself)")
    if header & {"0", "zero"} and based:
        either = "the header counts from 0, as references do not: give --numbers decimal (40101 is holding:100)"
        return Numbering(either=f"{either} or --numbers plain (it is the address itself)")
    doubt = ""
    if odd := next((cell for cell in bare if not cell.isdecimal()), None):
        doubt = f"{odd!r} of this list is hexadecimal, so this number may be; give --numbers hex or --numbers decimal"
    elif len(bare) > 1 and all(len(cell) == 4 for cell in bare) and all(cell.startswith("0") for cell in bare[:1]):
        doubt = "numbers of four digits with noughts before them may be hexadecimal; give --numbers hex or decimal"
    tables = [TABLES.get(header_key(line.get("table")), "") or _table_of_bits(line) for line in sheet.lines]
    says = _SAYS_REFERENCES.search(sheet.columns.get("address", ""))
    return Numbering(False, first, True, doubt, "" if says else doubt_of_references(zip(cells, tables, strict=True)))


def _table_of_bits(line: ListRow) -> str:
    """`coil` for one bit without a table, whose number shows nothing of registers; "" for others."""
    return "coil" if type_cell(header_key(line.get("dtype"))).dtype == "bool" else ""


_SAYS_REFERENCES = re.compile(r"(?<![\dx])[34]x{2,5}\b|\b[34]x\b", re.IGNORECASE)
"""`Register 4xxxx`."""


_WIRE = re.compile(r"\bprotocol (?:address|offset)\b|\bpdu\b.*")
_REFERENCE = re.compile(r"[34]\d{4,5}")


def _gain_of_the_list(sheet: ListSheet) -> str:
    """What the rows whose range and type decide say of gains above 1; "" where none does, or they contradict."""
    found = set()
    for line in sheet.lines:
        try:
            factor = _scale_cell(line) or parse_unit(line.get("unit"))[1]
            if factor is None or not factor.either:
                continue
            dtype = widen_type(_type_cell(line).dtype, _whole(line, "count") or 0, wide=True)
            low, high, _ = _range(line)
        except (RowError, ValueError):
            continue
        found.add(_decide_gain(factor.number, dtype or _type_cell(line).dtype, low, high))
    found.discard("")
    return found.pop() if len(found) == 1 else ""


# ---------------------------------------------------------------- scale, range, unit


_MULTIPLIERS = frozenset(
    {"multiplier", "moltiplicatore", "factor", "fattore", "resolution", "risoluzione"}
    | {"faktor", "skalierungsfaktor", "auflosung", "facteur", "resolucion"}
)
_DIVISORS = frozenset(
    {"div", "divisor", "divider", "divisore", "teiler", "diviseur", "divide", "inverse", "inverso", "reciprocal"}
    | {"division", "divisione", "dividing", "divided", "kehrwert"}
)


_PER_UNIT = re.compile(r"\b(?:count|digit|bit)s? per (?:eng )?unit")


def _scale_cell(line: ListRow) -> CountFactor | None:
    """The factor of the scale's column; None for none. Raises RowError."""
    text = line.get("scale")
    if text in _EMPTY or header_key(text) in ("none", "nessuna", "no", "linear", "lineare"):
        return None
    try:
        return parse_factor(text)
    except ValueError as error:
        raise RowError("scale", str(error)) from None


def _range(line: ListRow) -> tuple[float | None, float | None, str]:
    """(low, high, the column they are from), from their own columns or from that of ranges."""
    low, high = _number(line, "low"), _number(line, "high")
    text = line.get("range")
    if low is None and high is None and text not in _EMPTY:
        if (found := parse_range(text)) is not None:
            return *found, "range"
        if re.search(r"\d", text) and not (_NAMES_OF_VALUES.fullmatch(text) or _HEXADECIMAL.search(text)):
            raise RowError("range", f"{text!r} is no range; give its two ends, such as 0..150, or leave it empty")
    return low, high, "high" if low is None else "low"


def _limits(dtype: str) -> tuple[float, float] | None:
    return integer_range(DType(dtype)) if dtype in set(DType) else None


def _decide_gain(number: float, dtype: str, low: float | None, high: float | None) -> str:
    """Whether a gain above 1 multiplies or divides, by the range and the type; "" where both are possible."""
    limits = _limits(dtype)
    if limits is None or high is None:
        return ""
    ends = {"multiply": limits[1] * number, "divide": limits[1] / number}
    exact = [gain for gain, end in ends.items() if abs(end - high) <= _RANGE_TOLERANCE * high]
    possible = [gain for gain, end in ends.items() if high <= end * (1 + _RANGE_TOLERANCE)]
    # Counts of 10 units give no 0.5, and no range that is smaller than one of them.
    if any(end is not None and not (end / number).is_integer() and abs(end) < 100 * number for end in (low, high)):
        possible = [gain for gain in possible if gain == "divide"]
    best = exact or possible
    return best[0] if len(best) == 1 else ""


_HEXADECIMAL = re.compile(r"0x[0-9a-f]|\b[0-9a-f]{2,}h\b", re.IGNORECASE)
_NAMES_OF_VALUES = re.compile(r"\s*\d+\s*=\s*[^=;,]+(?:[;,]\s*\d+\s*=\s*[^=;,]+)*[;,]?\s*")
"""`0=Off;1=On` in a unit's cell."""


def _scaling(row: _ListedRow, dtype: str) -> _Scaling:
    """Scale, offset and range as they are given, or from a raw range and the range in units. Raises RowError."""
    line = row.line
    low, high, column = _range(line)
    nothing = low == high == 0
    low, high = (None, None) if nothing else (low, high)
    offset = _number(line, "offset")
    raw_low, raw_high = _number(line, "raw_low"), _number(line, "raw_high")
    kind = header_key(line.get("scale"))
    if kind in ("square root", "radice quadrata"):
        raise RowError("scale", f"{line.get('scale')!r} is a curve, which is not supported; give a linear scale")
    unit_text = "" if line.get("unit") in _EMPTY else line.get("unit")
    try:
        # What another program writes there is a name alone.
        named = _NAMES_OF_VALUES.fullmatch(unit_text)
        unit, of_unit = (
            (unit_text, None) if not unit_text or line.get("exact") else parse_unit("" if named else unit_text)
        )
    except ValueError as error:
        raise RowError("unit", str(error)) from None
    scale, taken = _scale(row, dtype, of_unit, (None, None) if row.shown.raw_range else (low, high))
    raw = (raw_low, raw_high) != (None, None) and kind not in ("none", "nessuna", "no")
    if scale is None and raw and not line.get("scale_from"):
        if raw_high is None or low is None or high is None:
            given = "raw_low" if raw_high is None else "raw_high"
            raise RowError(given, "a raw range needs both ends of the range in units beside it; give them, or a scale")
        span = raw_high - (raw_low or 0.0)
        if span == 0 or high == low:
            raise RowError("raw_high", "the raw range or the range in units is empty; give two different ends")
        slope = (high - low) / span
        scale, offset = round(slope, _SCALE_DECIMALS), round(low - slope * (raw_low or 0.0), _SCALE_DECIMALS)
    elif kind in ("linear", "lineare"):
        raise RowError("scale", f"{line.get('scale')!r} needs the ends of both ranges beside it; give them")
    if header_key(line.get("negate")) in ("1", "true", "yes", "si"):
        scale, offset, taken = -(scale or 1.0), -(offset or 0.0), f"{taken}; negated".removeprefix("; ")
    if low is not None and high is not None and not low < high:
        raise RowError("low", f"{low:g} is not below the highest value {high:g}; swap or correct them")
    if row.shown.raw_range and scale not in (None, 1.0) and (low, high) != (None, None):
        ends = [end if end is None else round(end * scale + (offset or 0.0), _SCALE_DECIMALS) for end in (low, high)]
        low, high = ends if scale > 0 else reversed(ends)
        taken = "; ".join(note for note in (taken, f"range of raw counts, as line {row.shown.raw_range} shows") if note)
    low, high, said = _plausible(column, dtype, (scale, offset), (low, high))
    said = "0 to 0 is no range" if nothing else said
    names = f"names of values: {unit_text}" if named else ""
    taken = "; ".join(note for note in (taken, said, names) if note)
    return _Scaling(scale, offset, low=low, high=high, unit=unit or None, taken=taken)


def _scale(
    row: _ListedRow, dtype: str, of_unit: CountFactor | None, ends: tuple[float | None, float | None]
) -> tuple[float | None, str]:
    """(units per count, how it was taken), from the scale's cell, the unit's and the number of decimals."""
    line, header = row.line, set(row.header("scale").split())
    own = _scale_cell(line)
    power = _power_word(row.sheet.columns.get("scale", ""))
    # Of `SF` it was said by --column that it is the units a count, which are not negative.
    if own is not None and power and (power not in ("sf", "exp") or own.number < 0):
        raise RowError(
            "scale",
            f"{line.get('scale')!r} may be a power of ten: write the units per count, such as 0.1, or give --column "
            f"decimals={row.sheet.columns.get('scale')!r}",
        )
    if own is not None and own.number == 0:
        raise RowError("scale", "is 0, which would make every reading 0; give the units per count")
    if own is not None and line.get("exact"):
        own = CountFactor(own.number)
    elif own is not None and (header & _DIVISORS or _PER_UNIT.search(row.header("scale"))):
        own = CountFactor(1 / own.number)
    elif own is not None and header & _MULTIPLIERS:
        own = CountFactor(own.number)
    shown = ""
    if (decimals := _whole(line, "decimals")) is not None:
        decimals_header = row.sheet.columns.get("decimals", "")
        is_exponent = bool(_power_word(decimals_header)) and not _OVER_TEN.search(decimals_header)
        if is_exponent and abs(decimals) > _MOST_EXPONENT:
            raise RowError("decimals", f"{decimals} is no power of ten of a scale; give --column scale for a factor")
        if is_exponent or dtype not in _FLOATS:
            own = _same(own, CountFactor(10.0 ** (decimals if is_exponent else -decimals)), "decimals")
        elif decimals:
            shown = f"decimals ({decimals}) as they are shown: a {dtype} has its own point"
    if (by_hand := by_formula(line)[0]) is not None:
        own = _same(own, CountFactor(by_hand), "formula")
    if of_unit is not None:
        own = _same(own, of_unit, "unit")
    if own is None:
        return None, shown
    if said := row.shown.inverted.get(line.get("scale")):
        return round(1 / own.number, 12), f"{line.get('scale')} is what the register holds of one, as {said} says"
    if not own.either:
        said = f"scale {own.number:g} from the unit" if of_unit is not None else shown
        return round(own.number, 12), said
    column = "unit" if of_unit is not None else "scale"
    # Of a negative one the range is upside down.
    upright = ends if own.number > 0 else tuple(end if end is None else -end for end in reversed(ends))
    gain = _decide_gain(abs(own.number), dtype, *upright) or row.how.gain
    if not gain:
        raise RowError(
            column,
            f"{line.get(column)!r} may mean times {own.number:g} or divided by {own.number:g}, and no range decides; "
            "give --gain multiply or --gain divide",
        )
    if gain == "divide":
        return round(1 / own.number, 12), f"{row.sheet.columns.get(column)} {own.number:g} divides"
    return own.number, f"{row.sheet.columns.get(column)} {own.number:g} multiplies"


_FLOATS = frozenset({DType.FLOAT32, DType.FLOAT64})


_FEWEST_RANGES = 3
"""Of fewer one may be a slip."""


def _raw_range(sheet: ListSheet) -> int:
    """The first line whose range no reading in units can have, and all ranges of the list fit raw counts; 0 for none.

    A list has its ranges in counts or in units, so one row shows it for all.
    """
    found = ranges = 0
    for line in sheet.lines:
        with suppress(RowError):
            low, high, _ = _range(line)
            factor, limits = _scale_cell(line), _limits(_type_cell(line).dtype)
            if low is None or high is None or low == high:
                continue
            if factor is None or factor.number in (0, 1) or limits is None:
                continue
            ranges += 1
            if not (low.is_integer() and high.is_integer() and limits[0] <= low and high <= limits[1]):
                return 0
            fine = min(abs(factor.number), 1 / abs(factor.number))
            beyond = high > limits[1] * fine * (1 + _RANGE_TOLERANCE) or low < limits[0] * fine * (1 + _RANGE_TOLERANCE)
            found = found or line.number * beyond
    return found if ranges >= _FEWEST_RANGES else 0


def _same(own: CountFactor | None, other: CountFactor, column: str) -> CountFactor:
    """One factor of two cells that say the same. Raises RowError where they do not."""
    if own is None:
        return other
    if abs(own.number - other.number) <= 1e-9 * other.number:
        return CountFactor(own.number, own.either and other.either)
    if own.either and abs(own.number * other.number - 1) <= 1e-9:
        return other
    raise RowError(column, f"says {other.number:g} a count, and the row's scale {own.number:g}; correct one of them")


def _plausible(
    column: str, dtype: str, line: tuple[float | None, float | None], ends: tuple[float | None, float | None]
) -> tuple[float | None, float | None, str]:
    """The range in units, held against what the type can hold. Raises RowError where they contradict."""
    limits, (low, high) = _limits(dtype), ends
    if limits is None or (low is None and high is None):
        return low, high, ""
    scale, offset = line[0] or 1.0, line[1] or 0.0
    reach = sorted(limit * scale + offset for limit in limits)
    # Each end by its own size: what has no sign holds nothing below 0, however far it reaches above.
    slack = [_RANGE_TOLERANCE * abs(end) + abs(scale) for end in reach]
    outside = (high is not None and high > reach[1] + slack[1]) or (low is not None and low < reach[0] - slack[0])
    if outside and abs(scale) < 1 and high == limits[1] and low in (None, *limits, 0.0):
        # Its ends are the type's own: it is a range of raw counts.
        counts = [end if end is None else round(end * scale + offset, _SCALE_DECIMALS) for end in (low, high)]
        return counts[0], counts[1], "range of raw counts"
    shown = " to ".join("?" if end is None else f"{end:g}" for end in (low, high))
    if outside:
        raise RowError(
            column,
            f"the range {shown} is beyond what a {dtype} with scale {scale:g} holds; correct scale, type or range",
        )
    if scale == 1.0 and offset == 0.0 and any(end is not None and not float(end).is_integer() for end in (low, high)):
        raise RowError(column, f"the range {shown} has parts of a count, and the {dtype} no scale; give the scale")
    return low, high, ""


# ---------------------------------------------------------------- type and order


def _type_cell(line: ListRow) -> TypeCell:
    """The row's type; an empty one where it has none. Raises RowError for a word that is not understood."""
    text = line.get("dtype")
    if text in _EMPTY:
        return TypeCell()
    if re.search(r"\barray\b|\[\s*\d*\s*\.\.", text, re.IGNORECASE):
        raise RowError("dtype", f"{text!r} is an array, which is not supported; give each element its own row")
    cell = type_cell(header_key(text))
    if cell.unknown:
        word = "" if header_key(text) == cell.unknown else f": {cell.unknown!r} is not understood"
        raise RowError("dtype", f"{text!r} is no type that is known here{word}; give one of {KNOWN_TYPES}")
    return cell


def _type(row: _ListedRow, cell: TypeCell, place: ListedPlace, address: str) -> tuple[str, int]:
    line, text = row.line, row.get("dtype")
    bits = parse_size(header_key(line.get("length"))) or parse_size(header_key(line.get("count"))) or 0
    said = "length" if parse_size(header_key(line.get("length"))) else "count"
    count = -(-bits // 16) if bits and cell.dtype != "string" else 0 if bits else _whole(line, "count") or 0
    count = count or place.count
    if place.count and count != place.count:
        has = _count(place.count, "register")
        raise RowError("address", f"{row.get('address')!r} has {has}, and the row says {count}")
    if not cell.dtype:
        if place.bit is not None or address.partition(":")[0] in ("coil", "discrete"):
            return "bool", 0
        if count > 1:
            raise RowError("dtype", f"is empty, and the row has {count} registers; give one of {KNOWN_TYPES}")
        return "uint16", 0
    dtype, length = cell.dtype, cell.length
    if dtype == "string":
        if bits % 8:
            raise RowError(said, f"{line.get(said)!r} are no whole bytes; a text has 8 bits a byte")
        length = length or place.length or bits // 8 or _text_length(row) or 2 * count
        if length <= 0:
            raise RowError("dtype", "a string needs its length in bytes: write STRING[16], or give a column Length")
        return dtype, length
    if row.shorts and dtype in ("int16", "uint16") and header_key(text) in _INTS:
        if count in (1, 2):
            return f"{dtype[:-2]}{16 * count}", length
        raise RowError(
            "dtype",
            f"{text!r} has 16 bits in a PLC, and 32 where SHORT has 16, as in this list; write INT16, UINT16, INT32 or "
            "UINT32",
        )
    if place.bit is not None:
        if dtype in ("bool", "uint16") or (dtype == "int16" and line.get("bit")):
            return "bool", 0
        raise RowError("dtype", f"{text!r} is wider than bit {place.bit} of a register; give BOOL, or no bit")
    if count and row.how.registers:
        widened = widen_type(dtype, count, wide=cell.wide)
        if not widened:
            own = WIDTHS[dtype]
            raise RowError("dtype", f"{text!r} has {own} register{'s' * (own > 1)}, and the row says {count}")
        return widened, length
    size = None if bits else _whole(line, "length")
    if size is not None and size not in (WIDTHS[dtype], 2 * WIDTHS[dtype], 16 * WIDTHS[dtype], 1):
        raise RowError("length", f"is {size}, and {text!r} has {WIDTHS[dtype]} registers; correct one of them")
    if size is not None and not cell.wide and size not in (16, 32) and (size, dtype) != (4, "float32"):
        raise RowError("length", f"is {size}, of registers or bytes, and {text!r} says no width; write INT16 or INT32")
    return dtype, length


def _text_length(row: _ListedRow) -> int:
    """The bytes of a text by the length's column; 0 where it says none. Raises RowError where it may mean others."""
    size, header = _whole(row.line, "length") or 0, row.header("length")
    if row.shown.length_bits and header not in LENGTHS_IN_BITS and _LENGTHS_IN_BYTES.isdisjoint(header.split()):
        size, header = size * row.shown.length_bits, "bits"
    if size and header in LENGTHS_OF_NO_UNIT:
        raise RowError("length", f"is {size}, of bytes, characters or bits? Write STRING[n] with n bytes")
    if header not in LENGTHS_IN_BITS:
        return size
    if size % 8:
        raise RowError("length", f"is {size} bits, which are no whole bytes; a text has 8 bits a byte")
    return size // 8


_LENGTHS_IN_BYTES = frozenset({"byte", "bytes", "caratteri", "characters", "chars", "zeichen"})


def _bits_a_length(sheet: ListSheet) -> int:
    """What the list's column of lengths counts, by the rows whose type says how many registers it has."""
    if "length" not in sheet.columns:
        return 0
    numbers = []
    for line in sheet.lines:
        with suppress(RowError):
            cell, length = _type_cell(line), _whole(line, "length")
            if length and cell.wide and cell.dtype in WIDTHS and cell.dtype not in _HALVES:
                numbers.append((WIDTHS[cell.dtype], length))
    return bits_a_length(numbers)


_HALVES = frozenset({"bool", "int8", "uint8"})
"""What does not fill its register."""
_TEXT_OF = re.compile(r"[a-z ]+\[\s*\d+\s*\]", re.IGNORECASE)


def _texts_of_registers(sheet: ListSheet, tags: Sequence[Listed]) -> list[Listed]:
    """The tags, with STRING[n] of n registers where the list shows that: the next row lies right behind them."""
    cells = {line.number: line.get("dtype") for line in sheet.lines if _TEXT_OF.fullmatch(line.get("dtype"))}
    if not cells:
        return list(tags)
    places: dict[str, set[int]] = {}
    for tag in tags:
        register = parse_register(tag.keys["address"])
        places.setdefault(register.table, set()).add(register.number)

    def read(tag: Listed) -> Listed:
        length, register = tag.keys["length"] or 0, parse_register(tag.keys["address"])
        if tag.line not in cells or not is_length_of_registers(length, register.number, places[register.table]):
            return tag
        said = f"{cells[tag.line]} has {length} registers: the next row is right behind them"
        taken = "; ".join(note for note in (tag.taken, said) if note)
        return replace(tag, keys={**tag.keys, "length": 2 * length}, taken=taken)

    return [read(tag) for tag in tags]


def _order(row: _ListedRow, cell: TypeCell, dtype: str, place: ListedPlace) -> tuple[str | None, str]:
    """(order, how it was taken); None where the type has none."""
    text = row.get("order")
    own = ORDERS.get(header_key(text)) if text not in _EMPTY else ""
    if own is None:
        raise RowError("order", f"{text!r} is no order that is known here; give ABCD, CDAB, BADC or DCBA")
    if own and cell.order and own != cell.order:
        raise RowError("order", f"{text!r} is {own}, and the type's cell says {cell.order}; correct one of them")
    order = cell.order or own
    if dtype == "string":
        if order == "CDAB" and cell.order:
            raise RowError("dtype", f"{row.get('dtype')!r} swaps words, which a text has not; give STRING, or BADC")
        swapped = place.swapped or cell.order in ("BADC", "DCBA")
        return ("BADC", "low byte first") if swapped else (None, "")
    if (
        dtype in _SINGLE
    ):  # one register alone has no order of words, and its bytes are Modbus's unless it says otherwise
        if order == "BADC" or (cell.order == "DCBA" and dtype != "bool"):
            return "BADC", f"{row.get('dtype')}: bytes swapped" if cell.order else "bytes swapped"
        return None, ""
    if order:
        return order, f"{order} by its type" if cell.order else ""
    if row.how.order == LOW_WORD_FIRST:
        return "CDAB", "low word first, as such servers have it by default (else --order)"
    return row.how.order or "ABCD", ""


# ---------------------------------------------------------------- addresses


_SIGN_CELLS = {"±": True, "+/-": True, "-/+": True, "s": True, "y": True, "u": False, "+": False, "n": False}


def _check_sign(sheet: ListSheet, line: ListRow, cell: TypeCell) -> None:
    """Raises RowError for a type whose sign a column beside it contradicts (`INT16`, and `Sign` says unsigned)."""
    dtype = cell.dtype or "uint16"
    for header, text in zip(sheet.ignored, line.unread, strict=False):
        if text in _EMPTY or not _SIGNS.search(key := header_key(header)):
            continue
        said = header_key(text)
        signed = parse_sign(said)[0]
        if signed is None:
            signed = _SIGN_CELLS.get(text.lower(), parse_flag(said))
            signed = not signed if signed is not None and key.startswith("unsigned") else signed
        if signed is not None and dtype.startswith("uint" if signed else "int"):
            raise RowError(
                "dtype",
                f"{line.get('dtype')!r} is taken as {dtype}, and {header!r} says {text!r}: write INT16, UINT16 or "
                "another that says both",
            )


_NO_REGISTER = Register("", 0)


def _address(row: _ListedRow, cell: TypeCell) -> tuple[str, ListedPlace]:
    """(address in the driver's notation, its place)."""
    text, how = row.get("address"), row.how
    if not text:
        raise RowError("address", "is empty; give the address, or take the row out")
    own = _bit(row)
    if not how.registers:
        return text, ListedPlace(register=_NO_REGISTER, bit=own)
    end = _end(row)
    alone = end == text and not how.wide
    if end not in ("", text):
        text = f"{text}-{end}"
    table = _table(row)
    place = parse_place(AddressCell(text, cell.dtype, row.numbering, how.plc, table or how.table, named=bool(table)))
    place = replace(place, count=1) if alone and not place.count else place
    if own is not None and place.bit is None:
        place = replace(place, bit=own)
    if place.bit is not None and place.bit > 15:
        raise RowError("bit", f"bit {place.bit} is not in a register, which has bits 0 to 15")
    register = place.register.shift(how.shift)
    if not 0 <= register.number <= 65535:
        raise RowError("address", f"{text!r} moved by {how.shift} is outside 0 to 65535; give another --shift")
    if register.is_bit:
        if cell.dtype not in ("", "bool"):
            raise RowError("dtype", f"{row.get('dtype')!r} does not lie in {register}, which is one bit; correct one")
        place = replace(place, bit=None)
    return str(register), place


def _end(row: _ListedRow) -> str:
    """The row's last address; "" where it has none: a word is none, and no last one is 0 behind another."""
    end, first = row.get("end"), row.get("address")
    if end == first:
        return end
    letters = row.numbering.hexadecimal and re.fullmatch(r"[a-f]{1,4}", end.lower())
    is_number = letters or re.search(r"\d", end)
    return end if is_number and not re.fullmatch(r"(?:0x)?0+", end.lower()) else ""


def _bit(row: _ListedRow) -> int | None:
    """The bit of the bit's column, counted from 0 at the low end; its header may say that it counts otherwise."""
    bit, header = _whole(row.line, "bit"), row.header("bit")
    if bit is None:
        return None
    if re.search(r"\b1 (?:8|16)\b|\b1 based\b|\bfrom 1\b", header):
        bit -= 1
    if re.search(r"\bmsb 0\b|\b0 msb\b|\binver(?:se|ted|so)\b|\breversed?\b", header):
        bit = 15 - bit
    if not 0 <= bit <= 15:
        raise RowError("bit", f"bit {row.get('bit')} is not in a register, which has bits 0 to 15")
    return bit


def _table(row: _ListedRow) -> str:
    """The row's own table; "" where it names none."""
    text = row.get("table")
    if text in _EMPTY:
        return ""
    key, header = header_key(text).removeprefix("modbus "), row.header("table")
    if known := TABLES.get(key):
        return known
    if any(word in header for word in ("func", "funz", "code", "codice", "fc")) or "fc" in key:
        tables = parse_tables(key)
        if tables is not None and not tables:
            raise RowError("table", f"{text!r} only writes, and a tag is read; take the row out")
        if (tables is not None and len(set(tables)) == 1) or tables == ("holding", "input"):
            return tables[0]
    raise RowError("table", f"{text!r} is no register table; give holding, input, coil or discrete")

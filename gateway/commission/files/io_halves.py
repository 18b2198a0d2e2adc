"""Rows of a list that are the two words of one number: each by itself reads as a number that the plant does not have.

A row that names its word ("high word", "LSW") is believed; `Ppv H` above `Ppv L` may be two limits as well.
"""

import re
from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import dataclass
from typing import Any

from gateway.commission.files.cells import ListRow, ListSheet, header_key
from gateway.commission.files.io_words import WIDTHS
from gateway.commission.survey import parse_register

_WORD = r"(?:[ _-]?order)?[ _-]?(?:word|16[ _-]?bits?)"
_HIGH = re.compile(
    rf"\b(?:high|hi|upper|most[ _-]significant){_WORD}\b|(?<![a-z])msw(?![a-z])|h(?:ö|oe)herwertig\w*|\bhigh-?wort\b"
    r"|\bparola alta\b|\bpoids fort\b|\bpalabra alta\b",
    re.IGNORECASE,
)
_LOW = re.compile(
    rf"\b(?:low|lo|lower|least[ _-]significant){_WORD}\b|(?<![a-z])lsw(?![a-z])|niederwertig\w*|\blow-?wort\b"
    r"|\bparola bassa\b|\bpoids faible\b|\bpalabra baja\b",
    re.IGNORECASE,
)
_MAYBE_HIGH = re.compile(r"(?:(?<=[ _.-])|\()(?:h|hi|high)\)?$", re.IGNORECASE)
_MAYBE_LOW = re.compile(r"(?:(?<=[ _.-])|\()(?:l|lo|low)\)?$", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class Listed:
    """A tag of the list: its keys as the device file has them (None: not written there), its line, how it was taken.

    `written` is its address as the list has it; `unread` says what of the row may change its numbers and is not read.
    """

    name: str
    keys: Mapping[str, Any]
    line: int
    taken: str = ""
    written: str = ""
    unread: str = ""


def part_overlaps(sheet: ListSheet, tags: Sequence[Listed]) -> tuple[list[Listed], list[str]]:
    """(the tags that stay, a sentence for each that begins in the middle of another number and ends behind it).

    One of both is elsewhere or not so wide. What lies in another as a whole is a part of it, or another view of it.
    """
    wide = [tag for tag in tags if WIDTHS.get(tag.keys["dtype"], 0) > 1]
    places = {tag.line: parse_register(tag.keys["address"]) for tag in wide}
    ends = {tag.line: places[tag.line].number + WIDTHS[tag.keys["dtype"]] for tag in wide}
    said: dict[int, str] = {}
    around: list[Listed] = []
    for tag in sorted(wide, key=lambda tag: (places[tag.line].table, places[tag.line].number, tag.line)):
        own, end = places[tag.line], ends[tag.line]
        around = [o for o in around if places[o.line].table == own.table and ends[o.line] > own.number]
        across = next((o for o in around if places[o.line].number < own.number and ends[o.line] < end), None)
        if across is None:
            around.append(tag)
            continue
        said[tag.line] = (
            f"{sheet.path}: line {tag.line}: {tag.name!r}, {tag.keys['dtype']} at {tag.written!r}, shares registers "
            f"with {across.name!r} of line {across.line}, {across.keys['dtype']} at {across.written!r}: correct an "
            "address or a type (where each address has 32 bits, as of Enron's and Daniel's devices, give --keep "
            "wide_registers=RANGES)"
        )
    return [tag for tag in tags if tag.line not in said], list(said.values())


_NAMES = re.compile(
    r"^(?!.*\b(?:group|gruppo|groupe|grupo|device|dispositivo|appareil|unit|unita|unite|unidad|plant|impianto|planta"
    r"|machine|macchina|maquina)\b).*\b(?:name|nome|nom|nombre)$"
)
"""Headers of names; a group's or a machine's is no tag's."""
_DISTINCT = 0.75
"""Of the cells of a column so many parts at least are different ones, if it names the rows and not groups of them."""


def name_columns(sheet: ListSheet) -> tuple[int, ...]:
    """The columns that nobody reads and that name the rows, by their places among such."""
    found: list[int] = []
    for at, header in enumerate(sheet.ignored):
        if _NAMES.search(header_key(header)):
            cells = [line.unread[at] for line in sheet.lines if line.unread[at]]
            if cells and len(set(cells)) >= _DISTINCT * len(cells):
                found.append(at)
    return tuple(found)


def other_name(sheet: ListSheet, line: ListRow, columns: Sequence[int]) -> tuple[str, str]:
    """A row's name in one of `name_columns`, as `Documented Name` beside an empty `Name`, with that said."""
    for at in columns:
        if line.unread[at]:
            return line.unread[at], f"named by {sheet.ignored[at]!r}"
    return "", ""


def part_halves(sheet: ListSheet, tags: Sequence[Listed]) -> tuple[list[Listed], list[str], str]:
    """(the tags that stay, a sentence for each word that has a unit or a scale, a note on what may be words)."""
    columns = name_columns(sheet)
    remarks = {line.number: (line.get("remark"), other_name(sheet, line, columns)[0]) for line in sheet.lines}
    torn: dict[int, str] = {}
    doubted: list[tuple[Listed, Listed]] = []
    for first, second in _neighbours(tags):
        for certain, high, low in ((True, _HIGH, _LOW), (False, _MAYBE_HIGH, _MAYBE_LOW)):
            order = _order(first, second, remarks, high, low)
            if not order:
                continue
            if not certain:
                doubted.append((first, second))
            elif any(tag.keys.get(key) for tag in (first, second) for key in ("scale", "unit")):
                torn |= _said_torn(sheet, first, second, f", order {order}")
            break
    note = ""
    # Who writes a counter of energy as two rows writes power so too; of anything else they may be limits.
    if any(_may_be_words(pair, _ENERGIES, remarks) for pair in doubted):
        for first, second in doubted:
            if _may_be_words((first, second), _ENERGIES | _POWERS, remarks):
                torn |= _said_torn(sheet, first, second, "")
        doubted = [pair for pair in doubted if pair[0].line not in torn]
    if doubted:
        first, second = doubted[0]
        pairs = "1 pair of rows" if len(doubted) == 1 else f"{len(doubted)} pairs of rows"
        note = (
            f"{pairs} may be the two words of one number of 32 bits, as {first.name!r} and {second.name!r} (lines "
            f"{first.line} and {second.line}): where they are, give both one row of two registers"
        )
    return [tag for tag in tags if tag.line not in torn], list(torn.values()), note


_POWERS = frozenset(f"{prefix}{unit}" for prefix in ("", "k", "M") for unit in ("W", "var", "VA"))
_ENERGIES = frozenset(f"{unit}h" for unit in _POWERS)
_OF_TWO = re.compile(
    r"tarif|limit|alarm|warn|grenz|schwell|soglia|seuil|umbral|threshold|set ?point|sollwert", re.IGNORECASE
)
"""What has a high and a low one: both are numbers of their own."""


def _may_be_words(pair: tuple[Listed, Listed], units: Set[str], remarks: Mapping[int, Sequence[str]]) -> bool:
    """Whether both rows are of one of these units, without sign, and by their texts no two limits or tariffs."""
    return all(
        tag.keys.get("unit") in units
        and tag.keys["dtype"] == "uint16"
        and not any(_OF_TWO.search(text) for text in (tag.name, *remarks.get(tag.line, ())))
        for tag in pair
    )


def _said_torn(sheet: ListSheet, first: Listed, second: Listed, order: str) -> dict[int, str]:
    """The sentence of either word, by its line."""
    return {
        tag.line: f"{sheet.path}: line {tag.line}: {tag.name!r} is one word of a number of 32 bits, and the other is "
        f"in line {other.line}: give both one row of two registers, UINT32 or INT32{order}"
        for tag, other in ((first, second), (second, first))
    }


def _neighbours(tags: Sequence[Listed]) -> Iterator[tuple[Listed, Listed]]:
    """Tags of one register each at neighbouring addresses, in the order of these."""
    at: dict[tuple[str, int], Listed] = {}
    for tag in tags:
        table, _, number = str(tag.keys.get("address")).partition(":")
        if tag.keys.get("dtype") in ("int16", "uint16") and number.isdecimal():
            at.setdefault((table, int(number)), tag)
    for (area, first), tag in at.items():
        if (other := at.get((area, first + 1))) is not None:
            yield tag, other


def _order(
    first: Listed, second: Listed, remarks: Mapping[int, Sequence[str]], high: re.Pattern[str], low: re.Pattern[str]
) -> str:
    """The order in which two rows are the words of one number, by names or remarks; "" where they are not."""
    beside = zip(remarks.get(first.line, ()), remarks.get(second.line, ()), strict=False)
    for texts in ((first.name, second.name), *beside):
        for order, kinds in (("ABCD", (high, low)), ("CDAB", (low, high))):
            rests = [kind.sub("", text.strip()) for kind, text in zip(kinds, texts, strict=True)]
            differ = all(rest != text.strip() for rest, text in zip(rests, texts, strict=True))
            if differ and rests[0].casefold().split() == rests[1].casefold().split():
                return order
    return ""

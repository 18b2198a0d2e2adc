"""Columns of an undescribed table: which hold numbers, switches with their words, or nothing that can be used."""

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np

from sim.lab.recordings import (
    CONVERTED_UNITS,
    NO_VALUES,
    SWITCH_WORDS,
    booleans,
    conversion,
    find_codes,
    is_lone_point,
    numbers,
    parse_quantity,
)
from sim.lab.recordings.mapping.words import named_state, split_unit
from sim.sha import Array

Kind = Literal["number", "switch", "states", "text", "empty"]
_MAX_STATES = 12
"""Words of a column that says states; more are names or notes."""
_MIN_NUMBER_SHARE = 0.8
"""Share of the filled cells that must be numbers: exports write words where they have no value."""
_NO_VALUE = NO_VALUES | {"no data", "bad", "bad input", "undefined"}
_OPPOSITES = {word: value for pair in SWITCH_WORDS for words, value in zip(pair, (1, 0), strict=True) for word in words}
_ON = frozenset(
    {"active", "aktiv", "attivo", "actif", "activo", "open", "auf", "started", "gestartet", "läuft", "lauf"}
)
_OFF = frozenset({
    "inactive", "inaktiv", "inattivo", "inactif", "inactivo", "closed", "zu", "steht", "stillstand", "halt", "idle",
})  # fmt: skip


@dataclass(frozen=True, slots=True)
class FoundColumn:
    """A signal's column: the `header` it is read from, the signal's `name`, its `kind` and sample `values` in `unit`.

    A cell is made a value by `scale` and `offset`, but in a column that is `parse_quantity` each cell says its own
    unit; `bad` are the numbers in it that mean no reading. `words` are those of a switch (on, off) that are not known
    anyway; `states` are the few words of `cells` of which nobody has said yet which mean on.
    """

    header: str
    name: str
    unit: str
    kind: Kind
    values: Array
    words: tuple[tuple[str, ...], tuple[str, ...]] | None = None
    states: tuple[str, ...] = ()
    cells: tuple[str, ...] = ()
    scale: float = 1.0
    offset: float = 0.0
    measured: bool = False
    bad: tuple[float, ...] = ()
    beyond: int = 0
    """Readings of a temperature that no bearing reaches."""

    @property
    def moves(self) -> bool:
        """Whether its readings are not all the same."""
        finite = self.values[np.isfinite(self.values)]
        return finite.size > 0 and bool(np.ptp(finite) > 0)


def find_decimal(columns: Sequence[Sequence[str]], separator: str) -> Literal["auto", ".", ","]:
    """The decimal mark of a file; "auto" where nothing shows it."""
    cells = [cell for column in columns for cell in column]
    comma = _numbers_among([cell for cell in cells if "," in cell], ",") if separator != "," else 0
    point = _numbers_among([cell for cell in cells if "." in cell and "," not in cell], ".")
    # 1.234,5 has both: a comma that stands after a point is the decimal one.
    if comma > 0 and comma >= point:
        return ","
    return "." if point else "auto"


_POINTED = re.compile(r"[+-]?\d+\.\d+")
_COMMA = re.compile(r"[+-]?\d+(?:\.\d{3})*,(\d+)")
_GROUPED_TWICE = re.compile(r"[+-]?\d{1,3}(?:\.\d{3}){2,}")


def find_points(cells: Sequence[str]) -> Literal["", "decimal", "thousands", "either", "both"]:
    """What points without a comma are in a column of a file with decimal commas; "" where it has none.

    `either`: nothing in the column tells; `both`: some are decimal points, beside decimal commas.
    """
    distinct = set(cells)
    pointed = {cell for cell in distinct if _POINTED.fullmatch(cell)}
    fractions = [match for cell in distinct if (match := _COMMA.fullmatch(cell))]
    if not pointed:
        return ""
    if not all(map(is_lone_point, pointed)):
        return "both" if fractions else "decimal"
    digits = {len(cell.lstrip("+-")) for cell in distinct if cell.lstrip("+-").isdigit()}
    # 1234 beside 1.234 sets no thousands apart, and 2,501 beside 2.500 may be the same number in two writings.
    if max(digits, default=0) > len("999"):
        return "either"
    grouped = any("." in match[0] or len(match[1]) != len("000") for match in fractions)
    if grouped or any(map(_GROUPED_TWICE.fullmatch, distinct)) or (digits and not fractions):
        return "thousands"
    return "either"


def _numbers_among(cells: Sequence[str], decimal: Literal[".", ","]) -> int:
    """How many cells are numbers under a decimal mark, alone or with a unit."""
    values = numbers(cells, decimal)[0]
    others = [cells[index] for index in np.flatnonzero(np.isnan(values)).tolist()]
    return int(np.isfinite(values).sum()) + sum(bool(np.isfinite(parse_quantity(cell, decimal)[0])) for cell in others)


def describe_column(
    header: str,
    title: str,
    unit: str,
    cells: Sequence[str],
    decimal: Literal["auto", ".", ","],
    *,
    beside: Iterable[str] = (),
) -> FoundColumn:
    """What a column (or one signal of a long file) holds. `unit` is the one that a row of units gives, or "".

    `beside` are the titles of all of them.
    """
    bare, own_unit = split_unit(title, beside)
    name = signal_name(bare)
    unit = unit or own_unit
    filled = [cell for cell in cells if cell.casefold() not in _NO_VALUE]
    if not filled:
        return FoundColumn(header, name, unit, "empty", np.full(len(cells), np.nan))
    distinct = Counter(filled)
    if len(distinct) <= 2 and not (unit and unit != "degC"):
        as_switch, wrong = booleans(cells)
        if not wrong.any():
            return FoundColumn(header, name, "", "switch", as_switch, cells=tuple(cells))
    values, _ = numbers(cells, decimal)
    said = Counter() if np.isfinite(values).sum() >= _MIN_NUMBER_SHARE * len(filled) else _units(filled, decimal)
    if said:
        unit = said.most_common(1)[0][0]
        unit = CONVERTED_UNITS.get(unit, unit)
        values, _ = numbers(cells, decimal, unit)
    if np.isfinite(values).sum() >= _MIN_NUMBER_SHARE * len(filled):
        if len(distinct) <= _MAX_STATES and named_state(title) and all(word.lstrip("-").isdigit() for word in distinct):
            return FoundColumn(header, name, "", "states", values, states=tuple(distinct), cells=tuple(cells))
        codes = tuple(find_codes(values))
        values = np.where(np.isin(values, codes), np.nan, values)
        if said:
            return FoundColumn(header, name, unit, "number", values, measured=True, bad=codes)
        kept = CONVERTED_UNITS.get(unit, unit)
        scale, offset = conversion(unit, kept)
        return FoundColumn(header, name, kept, "number", values * scale + offset, scale=scale, offset=offset, bad=codes)
    if len(distinct) == 2 and all(len(word) <= 24 for word in distinct):
        on, off = _opposites(*distinct)
        if on:
            as_words = booleans(cells, (on,), (off,))[0]
            return FoundColumn(header, name, "", "switch", as_words, words=((on,), (off,)), cells=tuple(cells))
    if 2 <= len(distinct) <= _MAX_STATES and all(len(word) <= 24 for word in distinct):
        return FoundColumn(header, name, "", "states", values, states=tuple(distinct), cells=tuple(cells))
    return FoundColumn(header, name, "", "text", values)


def _units(cells: Sequence[str], decimal: Literal["auto", ".", ","]) -> Counter[str]:
    """The units that cells say themselves, if nearly all do."""
    said = Counter(unit for cell in cells if (unit := parse_quantity(cell, decimal)[1]))
    return said if said.total() >= _MIN_NUMBER_SHARE * len(cells) else Counter()


def _opposites(first: str, second: str) -> tuple[str, str]:
    """(on, off) of two words, or ("", "") where neither is known."""
    known = {**_OPPOSITES, **dict.fromkeys(_ON, 1), **dict.fromkeys(_OFF, 0)}
    meant = [
        {known[part] for part in (word.casefold(), *word.casefold().replace("_", " ").split()) if part in known}
        for word in (first, second)
    ]
    if meant[0] <= {1} and meant[1] <= {0} and meant[0] | meant[1]:
        return first, second
    if meant[0] <= {0} and meant[1] <= {1} and meant[0] | meant[1]:
        return second, first
    return "", ""


def signal_name(header: str) -> str:
    """A signal's name from a header: one that can be a column of our own CSV and a bare key's text in TOML."""
    kept = "".join(mark if mark.isprintable() and mark not in ',"#\\' else " " for mark in header)
    return "_".join(kept.split()) or "column"


def is_slow(values: Array) -> bool:
    """Whether readings move as a temperature in degC does: within -40 to 200, each near the one before, all apart."""
    finite = values[np.isfinite(values)]
    if finite.size < 10 or finite.min() < -40 or finite.max() > 200 or np.ptp(finite) < 1.0:
        return False
    span = float(np.ptp(finite))
    return float(np.median(np.abs(np.diff(finite)))) <= 0.02 * span and span <= 150.0


def dwells(states: Sequence[object]) -> bool:
    """Whether words stay for a while: fewer changes than a quarter of the rows."""
    return len(states) >= 10 and sum(a != b for a, b in pairwise(states)) < len(states) / 4


def has_levels(values: Array) -> bool:
    """Whether readings dwell at standstill and at work, as a motor's current does: near 0 and far from it, in turn."""
    finite = values[np.isfinite(values)]
    if finite.size < 10 or finite.max() <= 0 or finite.min() < -0.1 * finite.max():
        return False
    if np.all(np.diff(finite) > 0):
        return False  # the numbers of the rows
    low = finite < 0.1 * finite.max()
    return 0.02 < float(low.mean()) < 0.98 and dwells(low.tolist())

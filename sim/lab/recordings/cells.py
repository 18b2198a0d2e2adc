"""Cells of a CSV as numbers and booleans: empty is no reading, whatever else is no number is a fault that is told."""

from collections.abc import Sequence
from typing import Literal

import numpy as np

from sim.sha import Array, Mask

Decimal = Literal["auto", ".", ","]

SWITCH_WORDS: tuple[tuple[tuple[str, ...], tuple[str, ...]], ...] = (
    (("true", "t", "vero", "wahr", "vrai", "verdadero"), ("false", "f", "falso", "falsch", "faux")),
    (("on", "ein", "an", "acceso", "encendido"), ("off", "aus", "spento", "apagado")),
    (("yes", "y", "ja", "si", "sì", "sí", "oui"), ("no", "n", "nein", "non")),
    (("run", "running", "marcia", "marche", "marcha"), ("stop", "stopped", "fermo", "arrêt", "arret", "paro")),
    (("1", "-1"), ("0",)),
)
"""Words of two-valued signals that need no declaring, (on, off) by kind: English, Italian, German, French, Spanish."""

_BOOLEANS = {
    word: value for pair in SWITCH_WORDS for words, value in zip(pair, (1.0, 0.0), strict=True) for word in words
}


def _plain_floats(cells: Sequence[str]) -> Array | None:
    """All cells at once, if each is a plain number; exact to the last bit, as Python reads it."""
    try:
        values = np.array(list(map(float, cells)), dtype=float)
    except ValueError:
        return None
    # Python reads 1_000 as a number; a plant's file does not mean one by it.
    return None if "_" in "".join(cells) or not np.isfinite(values).all() else values


def _number(cell: str, decimal: Decimal) -> float:
    if "_" in cell:
        return np.nan
    if decimal == ",":
        whole, comma, fraction = cell.partition(",")
        if "." in fraction or ("." in whole and not comma):
            return np.nan
        cell = whole.replace(".", "") + comma.replace(",", ".") + fraction
    try:
        return float(cell)
    except ValueError:
        return np.nan


def numbers(cells: Sequence[str], decimal: Decimal = "auto") -> tuple[Array, Mask]:
    """Values (NaN where there is none) and a mask of the cells that hold something, but no finite number."""
    plain = _plain_floats(cells)
    if plain is not None:
        return plain, np.zeros(plain.shape, dtype=bool)
    if decimal == "auto":
        # A comma can only be inside a cell as a decimal comma, unless points show that it groups thousands.
        decimal = "," if any("," in cell for cell in cells) and not any("." in cell for cell in cells) else "."
    stripped = [cell.strip() for cell in cells]
    values = np.array([_number(cell, decimal) if cell else np.nan for cell in stripped], dtype=float)
    values[np.isinf(values)] = np.nan
    return values, np.isnan(values) & np.array([bool(cell) for cell in stripped], dtype=bool)


def booleans(cells: Sequence[str], on: Sequence[str] = (), off: Sequence[str] = ()) -> tuple[Array, Mask]:
    """As `numbers`, for two-valued signals: 1.0 and 0.0 from the words `on` and `off`, then from SWITCH_WORDS."""
    words = {**_BOOLEANS, **{word.casefold(): 1.0 for word in on}, **{word.casefold(): 0.0 for word in off}}
    table: dict[str, float] = {}
    # A two-valued column has few different cells, however many rows.
    for cell in set(cells):
        word = cell.strip().casefold()
        as_number = _number(word.replace(",", "."), ".")
        table[cell] = words[word] if word in words else {0.0: 0.0, 1.0: 1.0, -1.0: 1.0}.get(as_number, np.nan)
    values = np.array([table[cell] for cell in cells], dtype=float)
    return values, np.isnan(values) & np.array([bool(cell.strip()) for cell in cells], dtype=bool)

"""Names of locations as identifiers: one mapping for the query language and the export, so that a query fits both."""

import re
from collections.abc import Mapping, Sequence

_WORDS = (
    "A E U W R M Pr simulate true false deadlock and or not imply forall exists sum int bool clock chan broadcast "
    "urgent committed const double string void return if else while for do break continue switch case default "
    "struct typedef process system state guard sync assign before after location init trans priority progress "
    "meta rate inf sup bounds min max Temp time age m_1 p_1"
)
RESERVED = frozenset(_WORDS.split())
"""Words that no location may be called by: UPPAAL's own, and the exported model's."""


def identifiers(names: Sequence[str]) -> Mapping[str, str]:
    """Location name -> identifier (letters, digits, _), unique: "ON/200-300" -> "ON_200_300", "300+" -> "q_300_plus".

    A name that is an identifier already keeps it. What would collide gets _2, _3 ... in the given order.
    """
    chosen: dict[str, str] = {}
    kept = {name for name in names if _is_identifier(name)}
    taken = set(kept)
    for name in names:
        if name in kept:
            chosen[name] = name
            continue
        base = _spelled(name)
        candidate, number = base, 1
        while candidate in taken or candidate in RESERVED:
            number += 1
            candidate = f"{base}_{number}"
        taken.add(candidate)
        chosen[name] = candidate
    return chosen


def _is_identifier(name: str) -> bool:
    return re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", name) is not None and name not in RESERVED


def _spelled(name: str) -> str:
    """Signs that carry meaning become words, the rest an underscore; a digit never begins."""
    text = name
    for sign, word in (("+", "_plus"), ("?", "unknown"), ("<-", "below_minus_"), ("<", "below_"), (">", "above_")):
        text = text.replace(sign, word)
    text = re.sub(r"[^A-Za-z0-9]+", "_", text).strip("_") or "q"
    return text if text[0].isalpha() else f"q_{text}"

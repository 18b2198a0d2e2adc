"""Names of the exported model: one mapping for the query language and the export, so that a query fits both."""

import re
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Literal

PROCESS = "m_1"
"""The model's process in UPPAAL: `m_1.ON` is the location ON of it, and `ON` alone means the same here."""

QuantityKind = Literal["temperature", "time", "age"]
QUANTITIES: Mapping[str, QuantityKind] = MappingProxyType({"Temp": "temperature", "time": "time", "age": "age"})
"""What a run has at each instant, by the names that the exported model gives it in `m_1`."""

_KEYWORDS = (
    "const select guard sync assign probability process state branchpoint init trans urgent commit committed "
    "broadcast system true false and or xor not imply for while do if else default return typedef struct import "
    "meta before after before_update after_update progress gantt assert IO forall exists sum deadlock priority "
    "bool int double string chan clock void scalar control control_t simulation minE maxE minPr maxPr loadStrategy "
    "saveStrategy under imitate strategy simulate sat inf sup bounds Pmax Pr A E U W R M X hybrid dynamic spawn "
    "exit numOf foreach query location switch case continue break rate min max"
)
KEYWORDS = frozenset(_KEYWORDS.split())
"""What UPPAAL (4.1.20 to 5) keeps for itself in models or queries."""

_FUNCTIONS = (
    "abs fabs fmod fma fmax fmin fdim exp exp2 expm1 ln log log10 log2 log1p pow sqrt cbrt hypot sin cos tan asin "
    "acos atan atan2 sinh cosh tanh asinh acosh atanh erf erfc tgamma lgamma ceil floor trunc round fint ldexp "
    "ilogb logb nextafter copysign fpclassify isfinite isinf isnan isnormal signbit isunordered random "
    "random_arcsine random_beta random_gamma random_normal random_poisson random_tri random_weibull"
)
FUNCTIONS = frozenset(_FUNCTIONS.split())
"""UPPAAL's built-in functions: words too."""

RESERVED_WORDS = KEYWORDS | FUNCTIONS | {"Temp", "time", "age", "m_1", "p_1"}
"""Words that no location may be called by: UPPAAL's own, and the exported model's."""

MAX_IDENTIFIER_CHARS = 48
"""Signs of an identifier: older parsers of UPPAAL cut at 64, and the export puts prefixes before some."""


def identifiers(names: Sequence[str]) -> Mapping[str, str]:
    """Location name -> identifier (letters, digits, _), unique: "ON/200-300" -> "ON_200_300", "300+" -> "q_300_plus".

    A name that is an identifier already keeps it. What would collide gets _2, _3 ... in the given order.
    """
    chosen: dict[str, str] = {}
    plain = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
    kept = {
        name
        for name in names
        if plain.fullmatch(name) and name not in RESERVED_WORDS and len(name) <= MAX_IDENTIFIER_CHARS
    }
    taken = set(kept)
    for name in names:
        if name in kept:
            chosen[name] = name
            continue
        # Signs that carry meaning become words, the rest an underscore; a digit never begins.
        text = name
        for sign, word in (("+", "_plus"), ("?", "unknown"), ("<-", "below_minus_"), ("<", "below_"), (">", "above_")):
            text = text.replace(sign, word)
        text = re.sub(r"[^A-Za-z0-9]+", "_", text).strip("_") or "q"
        base = (text if text[0].isalpha() else f"q_{text}")[:MAX_IDENTIFIER_CHARS]
        candidate, number = base, 1
        while candidate in taken or candidate in RESERVED_WORDS:
            number += 1
            candidate = f"{base}_{number}"
        taken.add(candidate)
        chosen[name] = candidate
    return chosen

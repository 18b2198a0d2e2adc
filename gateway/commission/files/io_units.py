"""What a cell says of numbers beside the number itself: factors in it, units, ranges.

A cell is understood to its last digit or refused: a digit that nobody has read may be the factor that makes a reading
ten times too large.
"""

import re
from dataclasses import dataclass

from gateway.commission.files.cells import header_key, parse_decimal

_POWER = r"10\s*\^\s*[-+]?\d|10[⁺⁻]?[⁰¹²³⁴⁵⁶⁷⁸⁹]|1?[eE]-\d"
_FACTOR = rf"(?:{_POWER}|1\s*/\s*10*|\d+(?:[.,]\d+)?)"
_TIMES, _OVER = r"[x×*·]", r"[/÷:]"
_NAME = r"[^\d\s.,;()\[\]/÷:x×*·=-].*?|x(?=[a-z]{2}).*?"
_FORMS: tuple[tuple[re.Pattern[str], str], ...] = tuple(
    (re.compile(form, re.IGNORECASE), kind)
    for form, kind in (
        (rf"(?P<unit>){_TIMES}\s*(?P<factor>{_FACTOR})", "times"),
        (rf"(?P<unit>){_OVER}\s*(?P<factor>\d+)", "over"),
        (rf"(?P<unit>)\(?(?P<factor>{_FACTOR})\)?", "of"),
        (rf"{_TIMES}?\s*(?P<factor>{_FACTOR})\s*{_TIMES}?\s*(?P<unit>{_NAME})", "of"),
        (rf"(?P<unit>{_NAME})\s*{_TIMES}\s*(?P<factor>{_FACTOR})", "times"),
        (rf"(?P<unit>{_NAME})\s*{_OVER}\s*(?P<factor>10+)", "over"),
        (rf"(?P<unit>{_NAME})\s*[(\[]\s*{_OVER}\s*(?P<factor>10+)\s*[)\]]", "over"),
        (rf"(?P<unit>{_NAME})\s*[(\[]\s*{_TIMES}\s*(?P<factor>{_FACTOR})\s*[)\]]", "times"),
        (rf"(?P<unit>{_NAME})\s*[(\[]\s*(?P<factor>{_FACTOR})\s*(?P=unit)?\s*[)\]]", "of"),
        (rf"(?P<unit>{_NAME})[,;\s]\s*{_TIMES}?\s*(?P<factor>{_FACTOR})", "of"),
    )
)
"""How a factor stands in a cell: `of` a count (0.1 V), `times` and `over` what the register holds (V x 10, V / 10)."""
_WORDS = (
    (re.compile(r"(?:tenths?|decimi)\s+(?:of\s+(?:an?\s+)?|di\s+)", re.IGNORECASE), "0.1 "),
    (re.compile(r"(?:hundredths?|centesimi)\s+(?:of\s+(?:an?\s+)?|di\s+)", re.IGNORECASE), "0.01 "),
    (re.compile(r"\s*(?:/|\bper\b)\s*(?:bit|lsb|digit|count)s?\s*$", re.IGNORECASE), ""),
)
_DIGITS_OF_UNITS = re.compile(
    r"[a-z]*m[23]|(?:ft|in|yd|s)[23]|(?:min|s|h|m)\^?-1|1/(?:min|s|h)|100\s*km|(?:c|h|n|s|n)o?[2x]o?\d?|o2|nh3|ch4"
    r"|pm(?:10|2[.,]5|1)",
    re.IGNORECASE,
)
"""Digits that are a unit's own: m3/h, 1/min, mg/Nm3, CO2."""
_ROUND = re.compile(r"(?:1|2|2\.5|5)(?:e[+-]?\d+)?")
_UNITS = {
    **dict.fromkeys(("c", "oc", "deg c", "degc", "gradi c", "gradi", "celsius", "gradi celsius"), "degC"),
    **dict.fromkeys(("giri min", "giri", "1 min", "min 1", "u min", "rpm", "r min"), "rpm"),
}
_EXPONENT = r"(?:e[-+−]?\d+)?"
_TO = r"(?:\.\.\.?|…|~|to|bis|÷|/|;|-|–|—|a)"
_GOES_ON = rf"(?:[(\[]\s*)?(?:{_TO}|\*\*|[.,:'+−*^x×·]|e)\s*[-+−]?\s*\d|[⁰¹²³⁴⁵⁶⁷⁸⁹⁻⁺]"
"""What stands behind a range's upper end where that, or the range, goes on."""
_RANGE = re.compile(
    rf"[(\[]?\s*(?P<low>[-+−]?\d[\d.,']*?{_EXPONENT})\s*{_TO}\s*(?P<high>[-+−]?\d+(?:[.,']\d+)*{_EXPONENT})"
    rf"\s*[)\]]?\s*(?P<unit>(?!{_GOES_ON})[^\d\s].*)?",
    re.IGNORECASE,
)
_SUPERSCRIPTS = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻⁺", "0123456789-+")


@dataclass(frozen=True, slots=True)
class CountFactor:
    """A factor in a cell: `number` units a count; with `either` it may also be `1 / number`, which the list decides."""

    number: float
    either: bool = False


def parse_unit(text: str) -> tuple[str, CountFactor | None]:
    """The unit in a unit's cell and the factor beside it, None for none. Raises ValueError in words."""
    plain = " ".join(text.replace("\u00a0", " ").split())
    for pattern, instead in _WORDS:
        plain = pattern.sub(instead, plain)
    if not _has_residue(plain):
        return _name(plain), None
    for pattern, kind in _FORMS:
        match = pattern.fullmatch(plain)
        if match is None or _has_residue(match["unit"]):
            continue
        number = _number(match["factor"])
        if not number or (number > 1 and kind == "of" and not (match["unit"] and _is_round(number))):
            break
        factor = CountFactor(1 / number if kind == "over" else number, either=kind == "times" and number > 1)
        return _name(match["unit"]), factor
    raise ValueError(
        f"{text!r} has a number whose meaning is not known: write the unit alone, and units per count in a column Scale"
    )


def parse_factor(text: str) -> CountFactor:
    """A scale's cell: 0.1, x0.1, /10, 1/10, 10^-1, 0.1 V; a plain number above 1 may be inverse. Raises ValueError."""
    plain = "".join(text.split()) if not re.search(r"[a-z°%]", text, re.IGNORECASE) else text
    try:
        number = parse_decimal(plain)
    except ValueError:
        try:
            _, factor = parse_unit(
                re.sub(r"^(?:raw|value|valore|reg(?:ister)?|[nxuv])\s*(?=[x×*·/÷:])", "", text.strip())
            )
        except ValueError:
            factor = None
        if factor is None:
            raise ValueError(f"{text!r} is no number; give one such as 0,1 or 0.1, or leave it empty") from None
        # What is written as an operation says which way it goes.
        return CountFactor(factor.number)
    return CountFactor(round(number, 12), either=abs(number) > 1)


def parse_range(text: str) -> tuple[float, float] | None:
    """`-20..150`, `0 to 100`, `0÷10` as two numbers; None for what is no range of two."""
    match = _RANGE.fullmatch(text.strip())
    if match is None:
        return None
    try:
        low, high = parse_decimal(match["low"]), parse_decimal(match["high"])
    except ValueError:
        return None
    return (low, high) if low < high else None


def _has_residue(text: str) -> bool:
    """Whether digits or operators of division are in it that no unit has."""
    return re.search(r"\d|÷", _DIGITS_OF_UNITS.sub("", text.translate(_SUPERSCRIPTS))) is not None


def _name(text: str) -> str:
    return _UNITS.get(header_key(text), text)


def _number(text: str) -> float:
    plain = "".join(text.translate(_SUPERSCRIPTS).split()).lower()
    if "^" in plain or (plain.startswith("10") and len(plain) > 2 and plain[2] in "+-"):
        return 10.0 ** int(plain.partition("^")[2] or plain[2:])
    if "/" in plain:
        return 1.0 / float(plain.partition("/")[2])
    if plain.startswith(("e", "1e")):
        return float("1" + plain.removeprefix("1"))
    return parse_decimal(plain)


def _is_round(number: float) -> bool:
    mantissa, _, _ = f"{number:.3e}".partition("e")
    return bool(_ROUND.fullmatch(f"{float(mantissa):g}"))

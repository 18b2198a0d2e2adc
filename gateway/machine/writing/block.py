"""The write-back block as words: pure building from the layout, saturating and never wrapping."""

from binascii import crc_hqx
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import IntFlag
from functools import partial
from math import isfinite
from struct import pack
from typing import Literal, NamedTuple

from drivers.device_file import BlockField
from gateway.settings import WritebackLayout

NO_TEMPERATURE = 0x8000
"""The int16 word of a number that is not known (-32768): no real number saturates to it."""

NO_NUMBER = 0xFFFF
"""The uint16 word of a number or location that is not known (65535): no real number saturates to it."""

_VERBATIM = frozenset(
    {"layout_version", "sequence", "heartbeat", "validity", "alarms", "model_hash", "challenge", "writer"}
    | {"sequence_copy"}
)
_MINUTES = frozenset({"minutes_low", "minutes_median", "minutes_high"})

Values = Mapping[str, float | None]
"""A block's numbers by the names of their fields, in engineering units."""


class Validity(IntFlag):
    """The validity word. USABLE stands only where all the others but SHADOW do, and the model fits what it reads."""

    NONE = 0
    USABLE = 1
    INPUTS = 2
    LOCATION = 4
    FORECAST = 8
    MODEL = 16
    SHADOW = 32


def validity(
    *, inputs: bool, location: bool, forecast: bool, model: bool, familiar: bool = True, shadow: bool = False
) -> Validity:
    """The word from its parts.

    `familiar` False: the newest readings are out of the model's own distribution. That takes USABLE away and has no bit
    of its own: the field `zone` says red then.
    """
    parts = ((inputs, Validity.INPUTS), (location, Validity.LOCATION), (forecast, Validity.FORECAST))
    word = Validity.MODEL if model else Validity.NONE
    for true, bit in parts:
        word |= bit if true else Validity.NONE
    if inputs and location and forecast and model and familiar:
        word |= Validity.USABLE
    return word | Validity.SHADOW if shadow else word


@dataclass(frozen=True, slots=True)
class WritebackBlock:
    """One block as it goes on the wire: 16-bit words in the layout's order."""

    sequence: int
    validity: Validity
    words: tuple[int, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionWords:
    """The words by which the PLC tells a new block from a recorded one, and this writer from another.

    `challenge` is the PLC's, 1..65535 (0: none was read), `writer` the number of this start, 1..65535; `sequence`
    counts 0..65535, `heartbeat` 1..65535.
    """

    challenge: int
    writer: int
    sequence: int
    heartbeat: int


class _WordPlan(NamedTuple):
    """How one word is made: the ends (`low`, `high`) of a number by its scale, and the word that says "not known"."""

    name: str
    kind: Literal["crc", "verbatim", "number"]
    scale: float
    low: int
    high: int
    unknown: int


def block_builder(layout: WritebackLayout) -> Callable[[Values, Validity, SessionWords], WritebackBlock]:
    """`build` for one layout, what depends on the layout alone worked out once."""
    plans = tuple(map(partial(_word_plan, layout), layout.fields))

    def build(values: Values, validity: Validity, session: SessionWords) -> WritebackBlock:
        contents: dict[str, float | None] = {
            **values,
            "layout_version": layout.version,
            "sequence": session.sequence,
            "sequence_copy": session.sequence,
            "heartbeat": session.heartbeat,
            "challenge": session.challenge,
            "writer": session.writer,
            "validity": int(validity),
        }
        words: list[int] = []
        for name, kind, scale, low, high, unknown in plans:
            value = contents.get(name)
            if kind == "crc":
                words.append(crc(words))  # of the words before it; only the copy of the sequence follows
            elif kind == "verbatim":
                words.append(int(value or 0) & 0xFFFF)
            elif value is None or not isfinite(value):
                words.append(unknown)
            else:
                # Limited before it is rounded: the ends are whole, so that no rounding leads beyond them.
                raw = round(min(max(value / scale, low), high))
                # A device file may set any word aside for minutes that are not known: what is known says its neighbour.
                words.append((raw if raw != unknown else raw - 1 if raw > low else raw + 1) & 0xFFFF)
        return WritebackBlock(session.sequence, validity, tuple(words))

    return build


def build(layout: WritebackLayout, values: Values, validity: Validity, session: SessionWords) -> WritebackBlock:
    """The block that says `values` (field name -> engineering units; absent, None or not finite: not known).

    A number beyond its word saturates at the word's ends, short of the word that means "not known". Minutes that are
    infinite, and those not known, are the layout's `unknown`.
    """
    return block_builder(layout)(values, validity, session)


def read_numbers(layout: WritebackLayout, words: Sequence[int]) -> dict[str, float | None]:
    """The numbers that a PLC reads out of a block's words (field name -> engineering units); None: "not known"."""
    found: dict[str, float | None] = {}
    for field, word in zip(layout.fields, words, strict=True):
        plan = _word_plan(layout, field)
        if plan.kind == "number":
            raw = word - 0x10000 if field.signed and word > 0x7FFF else word
            found[field.name] = None if word == plan.unknown & 0xFFFF else raw * field.scale
    return found


def _word_plan(layout: WritebackLayout, field: BlockField) -> _WordPlan:
    kind: Literal["crc", "verbatim", "number"] = "number"
    if field.name == "crc" or field.name in _VERBATIM:
        kind = "crc" if field.name == "crc" else "verbatim"
    low, high = (-0x7FFF, 0x7FFF) if field.signed else (0, 0xFFFE)
    unknown = layout.unknown if field.name in _MINUTES else NO_TEMPERATURE if field.signed else NO_NUMBER
    return _WordPlan(field.name, kind, field.scale, low=low, high=high, unknown=unknown)


def crc(words: list[int]) -> int:
    """CRC-16/IBM-3740 (polynomial 0x1021, start 0xFFFF, not reflected) of the words, high byte first."""
    return crc_hqx(pack(f">{len(words)}H", *words), 0xFFFF)


def next_heartbeat(heartbeat: int) -> int:
    """1..65535 and round to 1: 0 means that nothing has ever been written."""
    return heartbeat % 0xFFFF + 1

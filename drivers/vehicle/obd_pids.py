"""The parameters of OBD-II service 01 (SAE J1979 / ISO 15031-5), as the DBC file beside this module has them.

The file describes the engine's answer in a single frame: length, 0x41, parameter, data bytes A to E. A new parameter is
its lines there: a signal `S01PXX_name` under the parameter's number, and its SG_MUL_VAL_ line. The last byte of its
signals is the last of its data; what is only there to be stepped over is called `_reserved`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, cast

from drivers.can import Bits, LayoutCondition, layout_conditions, signal_bits

if TYPE_CHECKING:
    from cantools.database.can import Signal


FILE = Path(__file__).with_name("obd.dbc")
ANSWER_TO_CURRENT = 0x41
_HEADER_BYTES = 3
_NAME = re.compile(r"S01P([0-9A-F]{2})_(\w+)")
_RESERVED = "reserved"


@dataclass(frozen=True, slots=True)
class PidField:
    """One number of a parameter: its bits in the single frame, and value = raw * scale + offset.

    It is there where the frame meets all `conditions`; `unused` are the raw numbers that say that it does not apply.
    """

    name: str
    bits: Bits
    conditions: tuple[LayoutCondition, ...]
    scale: float
    offset: float
    unit: str
    signed: bool
    unused: frozenset[int]


@dataclass(frozen=True, slots=True)
class Pid:
    """A parameter: its `length` in data bytes, and its fields in their order (none where it is only stepped over)."""

    number: int
    length: int
    fields: Mapping[str, PidField]


def single_frame(number: int, data: bytes) -> bytes:
    """A parameter's data as they lie in a single frame, wherever in an answer they came."""
    return (bytes((len(data) + 2, ANSWER_TO_CURRENT, number)) + data).ljust(8, b"\0")


@cache
def pids() -> Mapping[int, Pid]:
    """Service 01 by parameter number. A number that is not here can be neither bound to a tag nor stepped over."""
    import cantools
    from cantools.database.can import Database

    (message,) = cast(Database, cantools.database.load_file(FILE, database_format="dbc")).messages
    signals: dict[int, list[tuple[str, Signal]]] = {}
    for signal in message.signals:
        # The selectors (ParameterID, and the bits that say what is there) are no values of their own.
        if not signal.is_multiplexer and (match := _NAME.fullmatch(signal.name)):
            signals.setdefault(int(match[1], 16), []).append((match[2], signal))
    table = {}
    for number, named in signals.items():
        named.sort(key=lambda pair: signal_bits(pair[1]).end)
        length = max(signal_bits(signal).size for _, signal in named) - _HEADER_BYTES
        fields = {
            name: PidField(
                name=name,
                bits=signal_bits(signal),
                conditions=tuple(layout_conditions(message, signal)),
                scale=float(signal.scale),
                offset=float(signal.offset),
                unit=signal.unit or "",
                signed=signal.is_signed,
                unused=frozenset(signal.choices or ()),
            )
            for name, signal in named
            if name != _RESERVED
        }
        table[number] = Pid(number, length, fields)
    return table

"""Messages and signals of a DBC file: where a signal lies, what its number means, how often its message comes.

The address `dbc:Message.Signal` names a signal. Its place, sign, scale and offset are the file's; so are the range and
the unit where the tag has none. Names of values are not taken over: a DBC file may name the special ones only, and a
tag's labels name all that there are. Read with cantools, decoded by `drivers.can.fields`.

Attributes that are read: `GenMsgCycleTime` (ms), and for protected messages `E2EProfile` ("P05"), `E2EDataID` and
`E2EMaxDeltaCounter`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from drivers.can.dbc_parts import DbcStatement, readable, spell_numbers
from drivers.can.fields import Bits, Field, LayoutCondition, check_type, frame_key
from drivers.can.protection import MIN_CONFIRMING_FRAMES, PROFILE, Protection
from drivers.errors import AddressError, DriverError
from drivers.named_files import contents, decode_text, endless_number
from drivers.tag import DType, Tag

if TYPE_CHECKING:
    from cantools.database.can import Database, Message, Signal


PREFIX = "dbc:"
_SIZES = ((8, DType.INT8, DType.UINT8), (16, DType.INT16, DType.UINT16), (32, DType.INT32, DType.UINT32))
_LARGEST = (DType.INT64, DType.UINT64)


MOST_BYTES = 16 << 20
_LONGEST_MESSAGE = 1785
"""Bytes: what J1939 carries in several frames (SAE J1939-21, 5.10); a CAN FD frame has 64."""
_MOST_BITS = 1 << 25
_MOST_SELECTED = 10_000
_MOST_CONFIRMED = 255
"""Frames after a jump of a counter that has 256 numbers: more would not tell more."""
# Where cantools makes something of the size of a number in the file: a message's bytes, the bits up to the end of a
# signal, one layout for each number of a range of multiplexor values.
_MESSAGE = re.compile(r"\bBO_\s+\d+\s+\w+\s*:\s*(\d+)")
_PLACE = re.compile(r":\s*(\d+)\s*\|\s*(\d+)\s*@")
_SELECTION = re.compile(r"\bSG_MUL_VAL_\b([^;]*)")
_RANGE = re.compile(r"(\d+)\s*-\s*(\d+)")
_CANTOOLS_RAISES = (
    UnicodeError, ValueError, KeyError, IndexError, TypeError, AttributeError,
    ArithmeticError, RecursionError, StopIteration, AssertionError,
)  # fmt: skip
"""What cantools was seen to raise, or lets through, for text that is no DBC (`make fuzz TARGET=dbc`)."""


def _size_problem(text: str) -> str:
    """Which number of the text would make a database beyond any bus, with its line; "" if none does."""
    bits = selected = 0
    for found in _MESSAGE.finditer(text):
        bits += 8 * int(found[1])
        if int(found[1]) > _LONGEST_MESSAGE or bits > _MOST_BITS:
            return f"{_line(text, found)} has a message of {found[1]} bytes; the longest one has {_LONGEST_MESSAGE}"
    for found in _PLACE.finditer(text):
        end = int(found[1]) + int(found[2])
        bits += end
        if end > 8 * _LONGEST_MESSAGE + 64 or bits > _MOST_BITS:
            return f"{_line(text, found)} has a signal up to bit {end}; a message has {8 * _LONGEST_MESSAGE} at most"
    for selection in _SELECTION.finditer(text):
        for first, last in _RANGE.findall(selection[1]):
            selected += abs(int(last) - int(first)) + 1
        if selected > _MOST_SELECTED:
            return (
                f"{_line(text, selection)} brings the multiplexor values to {selected}, and {_MOST_SELECTED} are the "
                "most; give narrower ranges"
            )
    return ""


def _line(text: str, found: re.Match[str]) -> str:
    return f"line {text.count(chr(10), 0, found.start()) + 1}"


def _load_database(text: str) -> tuple[Database | None, str]:
    """The database in a text, or why there is none."""
    import cantools
    from cantools.database.can import Database

    try:
        # Not strict: that signals overlap, or lie outside their message, in other people's files is theirs to mend.
        loaded = cantools.database.load_string(text, database_format="dbc", strict=False)
    except (cantools.Error, *_CANTOOLS_RAISES) as error:
        return None, " ".join(str(error).split())[:200] or type(error).__name__
    return (loaded, "") if isinstance(loaded, Database) else (None, "it is of another kind")


@dataclass(frozen=True, slots=True)
class MessageFacts:
    """What a DBC file says of a whole message: `cycle` in s (None: not cyclic), `layouts` if multiplexed (else 1)."""

    name: str
    key: int
    length: int
    cycle: float | None
    layouts: int
    protection: Protection | None


class Dbc:
    """One DBC file. Raises DriverError if it cannot be read.

    `left_out` says of each part of it that cannot be used its line and what it is, and the first time why.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            text = decode_text(contents(path, MOST_BYTES))
        except OSError as error:
            raise DriverError(f"{path}: is no DBC file that can be used: {error.strerror or error}") from None
        if problem := endless_number(text) or _size_problem(text):
            raise DriverError(f"{path}: {problem}")
        left: list[DbcStatement] = []
        loaded, reason = _load_database(text)
        if loaded is None:
            text, left = readable(spell_numbers(text), lambda part: _load_database(part)[1])
            loaded = _load_database(text)[0] if text else None
        if loaded is None or (left and not loaded.messages):
            why = "".join(f"; {part}" for part in left[:1])
            raise DriverError(f"{path}: is no DBC file that can be used: {reason}{why}")
        self._messages: dict[str, Message] = {}
        self.left_out = tuple(f"{path}: {part}" for part in left)
        for message in loaded.messages:
            if self._messages.setdefault(message.name, message) is not message:
                self.left_out += (f"{path}: a second message {message.name!r} is left out",)

    @cached_property
    def messages(self) -> Mapping[str, MessageFacts]:
        """All messages by name."""
        return {name: self._facts(message) for name, message in self._messages.items()}

    def locate(self, tag: Tag) -> tuple[Tag, Field, MessageFacts]:
        """The tag as the file completes it, its place, and its message. Raises AddressError."""
        name, _, signal_name = tag.address.removeprefix(PREFIX).partition(".")
        message = self._messages.get(name)
        if message is None:
            why = "".join(f"; {part}" for part in self.left_out if f" {name}:" in part or f" {name} :" in part)
            raise AddressError(
                f"{tag.name}: {self.path} has no message {name!r}; it has {', '.join(self._messages)}{why}"
            )
        signals = {signal.name: signal for signal in message.signals}
        signal = signals.get(signal_name)
        if signal is None:
            raise AddressError(f"{tag.name}: {name} has no signal {signal_name!r}; it has {', '.join(signals)}")
        field = Field(self.messages[name].key, signal_bits(signal), tuple(layout_conditions(message, signal)))
        completed = _complete_tag(tag, signal)
        check_type(completed, field.bits)
        return completed, field, self.messages[name]

    def _facts(self, message: Message) -> MessageFacts:
        key = frame_key(message.frame_id, extended=message.is_extended_frame)
        try:
            cycle = message.cycle_time / 1000.0 if message.cycle_time else None
        except (TypeError, OverflowError):  # a text, or a number beyond any
            raise DriverError(f"{self.path}: message {message.name}: its GenMsgCycleTime is no time in ms") from None
        layouts = _layouts(message)
        protection = self._protection(message, layouts)
        return MessageFacts(
            name=message.name,
            key=key,
            length=message.length,
            cycle=cycle,
            layouts=layouts,
            protection=protection,
        )

    def _protection(self, message: Message, layouts: int) -> Protection | None:
        attributes = message.dbc.attributes if message.dbc is not None else {}
        e2e = {name: attributes[name].value for name in attributes if name.startswith("E2E")}
        profile = str(e2e.get("E2EProfile", "") or "")
        if profile in ("", "none"):
            return None
        where = f"{self.path}: message {message.name}"
        if profile != PROFILE:
            raise DriverError(f"{where}: E2EProfile {profile!r} is not known; {PROFILE!r} is")
        data_id, delta = e2e.get("E2EDataID", message.frame_id & 0xFFFF), e2e.get("E2EMaxDeltaCounter", 10)
        if not (isinstance(data_id, int) and 0 <= data_id <= 0xFFFF):
            raise DriverError(f"{where}: E2EDataID {data_id!r} must be a whole number in 0..65535")
        if not (isinstance(delta, int) and 1 <= delta <= 255):
            raise DriverError(f"{where}: E2EMaxDeltaCounter {delta!r} must be a whole number in 1..255")
        return Protection(data_id, delta, max(MIN_CONFIRMING_FRAMES, min(layouts, _MOST_CONFIRMED)))


def _layouts(message: Message) -> int:
    """How many sets of signals the frames of a message may hold, _MOST_SELECTED at most; 1 without multiplexors.

    Numbers of a multiplexor that select the same signals are one layout. A multiplexor below it has its own in each
    layout that holds it, so that of those which exclude one another one alone counts at a time.
    """
    selected: dict[str, dict[int, list[str]]] = {}
    for signal in message.signals:
        if (above := signal.multiplexer_signal) is not None:
            for number in signal.multiplexer_ids or ():
                selected.setdefault(above, {}).setdefault(number, []).append(signal.name)
    below = {name: {tuple(names) for names in numbers.values()} for name, numbers in selected.items()}
    tops = {signal.name for signal in message.signals if signal.name in below and not signal.multiplexer_ids}
    # From above downwards; multiplexors that select one another have none above them, and are in no frame.
    order, seen = list(tops), set(tops)
    for name in order:
        found = {other for names in below[name] for other in names if other in below} - seen
        order += found
        seen |= found
    layouts: dict[str, int] = {}
    for name in reversed(order):
        counts = (math.prod(layouts.get(other, 1) for other in names) for names in below[name])
        layouts[name] = min(sum(counts), _MOST_SELECTED)
    return min(math.prod(layouts[name] for name in tops), _MOST_SELECTED)


def signal_bits(signal: Signal) -> Bits:
    """Where a signal lies."""
    return Bits(signal.start, signal.length, signal.byte_order == "big_endian")


def layout_conditions(message: Message, signal: Signal) -> Iterator[LayoutCondition]:
    """The multiplexors that must hold the signal's numbers, its own first, then those above it."""
    signals = {other.name: other for other in message.signals}
    # So often at most: multiplexors that select one another would be followed for ever.
    for _ in signals:
        if not (signal.multiplexer_ids and signal.multiplexer_signal in signals):
            return
        selector = signals[signal.multiplexer_signal]
        yield LayoutCondition(signal_bits(selector), frozenset(signal.multiplexer_ids))
        signal = selector


def _complete_tag(tag: Tag, signal: Signal) -> Tag:
    """The tag with the file's type, scale and offset, and its range and unit where the tag has none."""
    if tag.scale != 1.0 or tag.offset != 0.0:
        raise AddressError(f"{tag.name}: the DBC file gives the scale and the offset of {tag.address}; leave them out")
    if tag.dtype is DType.STRING:
        return tag
    bit = tag.dtype is DType.BOOL and tag.bit is None
    if bit and signal.length != 1:
        raise AddressError(f"{tag.name}: a bool has 1 bit, and {tag.address} has {signal.length}; give its bit")
    # The tag says how one bit is read; any other number is what the file makes of it.
    is_number, dtype = not bit and tag.bit is None, DType(tag.dtype)
    if is_number and signal.is_float:
        kinds = {32: DType.FLOAT32, 64: DType.FLOAT64}
        if signal.length not in kinds:
            raise AddressError(f"{tag.name}: {tag.address} is a float of {signal.length} bits; 32 and 64 can be read")
        dtype = kinds[signal.length]
    elif is_number and signal.length > 64:
        raise AddressError(f"{tag.name}: {tag.address} has {signal.length} bits; a number has 64 at most")
    elif is_number:
        signed, plain = next(((signed, plain) for bits, signed, plain in _SIZES if signal.length <= bits), _LARGEST)
        dtype = signed if signal.is_signed else plain
    return replace(
        tag,
        dtype=dtype,
        scale=_finite(tag, signal.scale, "scale"),
        offset=_finite(tag, signal.offset, "offset"),
        low=_limit(tag, tag.low, signal.minimum, signal),
        high=_limit(tag, tag.high, signal.maximum, signal),
        unit=tag.unit or signal.unit or "",
    )


def _finite(tag: Tag, number: float, what: str) -> float:
    try:
        finite = float(number)
    except OverflowError:  # a whole number of more than 308 digits
        finite = math.inf
    if not math.isfinite(finite):
        raise AddressError(f"{tag.name}: the DBC file gives {tag.address} a {what} beyond any number; correct it there")
    return finite


def _limit(tag: Tag, own: float | None, limit: float | None, signal: Signal) -> float | None:
    """The tag's limit, else the file's; 0 and 0 in the file mean none (and cantools gives None for them)."""
    if own is not None or limit is None or signal.minimum == signal.maximum:
        return own
    if isinstance(limit, float) and not math.isfinite(limit):
        return own
    return _finite(tag, limit, "limit")

"""The PLC's CAN messages by a DBC file: payloads from the process image, and the write-back blocks from frames.

By a path of its own: cantools packs the bits, and the checksum is worked out here bit by bit, so that a mistake of the
gateway's decoder cannot cancel itself out in a round trip.
"""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cantools
from cantools.database.can import Database, Message, Signal
from pydantic import ConfigDict, Field

from drivers.device_file import TagTable
from drivers.tag import Value
from sim.plc.program import FileTable, InputError, list_words, read_device, validate_entry

_SIGNAL = re.compile(r"dbc:(\w+)\.(\w+)")
_BLOCK = re.compile(r"dbc:(\w+)\.\{field\}")
_HEADER_BYTES = 3  # of E2E profile 5: two bytes of CRC, one of counter
_CYCLE_MS = 100
"""The cycle (ms) of a message to which the DBC file gives none."""


class _BusDevice(FileTable):
    """The settings of the driver that hold for the device's side, too; all others are the gateway's business."""

    model_config = ConfigDict(extra="ignore", frozen=True, allow_inf_nan=False)
    dbc: str = Field(min_length=1, description="the path of a DBC file, relative to this one")
    echo: dict[str, str] = Field(default_factory=dict, description="a table of messages and their echoes, by name")


@dataclass(slots=True, eq=False)
class Sender:
    """One payload layout that the PLC sends: every `cycle` seconds, and when its content changes.

    `selected` are the numbers of the message's multiplexors, `contents` its signals and the tags that they show.
    `content` and `wire` are what was sent last, without and with checksum and counter.
    """

    message: Message
    selected: Mapping[str, int]
    contents: Sequence[tuple[Signal, TagTable]]
    cycle: float
    data_id: int | None
    content: bytes | None = None
    wire: bytes | None = None
    due: float = 0.0

    def payload(self, served: Mapping[str, Value | None]) -> bytes:
        """The message as the image has it, checksum and counter 0. A tag that the image has lost reads as 0."""
        raw: dict[str, float | str] = {signal.name: 0 for signal in self.message.signals}
        raw.update(self.selected)
        for signal, tag in self.contents:
            value = served.get(tag.name, "")
            number: float = 0  # of a text, too, which has no place in a signal
            if value is None:
                absent = math.nan if signal.is_float else 0
                number = tag.sentinel[0] if tag.sentinel else absent
            elif not isinstance(value, str):
                number = (value - float(signal.offset)) / float(signal.scale)
                if not signal.is_float:
                    # What does not fit stands at the limit of its bits.
                    half = 1 << signal.length - 1
                    low, high = (-half, half - 1) if signal.is_signed else (0, 2 * half - 1)
                    number = min(max(round(number), low), high)
            raw[signal.name] = number
        return bytes(self.message.encode(raw, scaling=False, strict=False))


@dataclass(slots=True)
class BlockMemory:
    """A write-back block as frames fill it, by field name; a frame brings the words of its own layout.

    `suffix` says which of the PLC's blocks it is.
    """

    message: Message
    echo: Message
    fields: Sequence[str]
    suffix: str = ""
    words: dict[str, int] = field(default_factory=dict)

    def put(self, data: bytes, *, store: bool) -> tuple[dict[str, int], bytes] | None:
        """Take one frame; give its words and the echo, which says what the memory now holds. None: no frame of ours."""
        if len(data) != self.message.length:
            return None
        try:
            decoded = self.message.decode(data, decode_choices=False, scaling=False)
        except cantools.Error:
            return None
        if not isinstance(decoded, dict):
            return None
        numbers = {name: number for name, number in decoded.items() if isinstance(number, int)}
        brought = {name: numbers[name] for name in self.fields if name in numbers}
        if not brought:
            return None
        if store:
            self.words |= brought
        held = {name: self.words.get(name, 0) for name in brought}
        return brought, bytes(self.echo.encode({**numbers, **held}, scaling=False, strict=False))


@dataclass(frozen=True, slots=True)
class Messages:
    """All that the raw-frame face says and hears."""

    path: Path
    senders: tuple[Sender, ...]
    blocks: tuple[BlockMemory, ...]


def read_messages(path: Path, known: Sequence[str]) -> Messages:
    """The messages of the device file in `path` for the image's tags. Raises InputError."""
    content = read_device(path)
    device = validate_entry(_BusDevice, content.device.model_extra or {}, f"{path}: [device]")
    dbc = path.parent / device.dbc
    try:
        database = cantools.database.load_file(dbc, database_format="dbc")
    except (OSError, UnicodeError, cantools.Error) as error:
        raise InputError(f"{dbc}: is no DBC file that can be used ({error}); give one") from None
    if not isinstance(database, Database):
        raise InputError(f"{dbc}: is no DBC file; give one")
    if strange := [row.name for row in content.tags if row.name not in known]:
        raise InputError(f"{path}: tag {strange[0]!r}: the register map has no such tag; known are {list_words(known)}")
    by_message: dict[str, dict[str, TagTable]] = {}
    for row in content.tags:
        where = f"{path}: tag {row.name!r}"
        match = _SIGNAL.fullmatch(row.address)
        if match is None:
            raise InputError(f"{where}: address: {row.address!r} is no signal; give 'dbc:Message.Signal'")
        _signal(database, match[1], match[2], where)
        by_message.setdefault(match[1], {})[match[2]] = row
    senders = [
        sender for name, rows in by_message.items() for sender in _senders(database.get_message_by_name(name), rows)
    ]
    blocks = []
    if (first := content.writeback) is not None:
        fields = [row.name for row in first.fields]
        places = [(f"{path}: [writeback]", first.address, "")]
        places += [(f"{path}: [[writeback.blocks]] {row.suffix}", row.address, row.suffix) for row in first.blocks]
        for where, address, suffix in places:
            match = _BLOCK.fullmatch(address)
            if match is None:
                raise InputError(f"{where}: address: {address!r} is no message; give 'dbc:Message.{{field}}'")
            name = match[1]
            if name not in device.echo:
                raise InputError(
                    f"{where}: [device.echo] names no echo of {name!r}; the PLC answers each frame with one"
                )
            for field_name in fields:
                _signal(database, name, field_name, where)
                _signal(database, device.echo[name], field_name, where)
            echo = database.get_message_by_name(device.echo[name])
            blocks.append(BlockMemory(database.get_message_by_name(name), echo, fields, suffix))
    return Messages(path, tuple(senders), tuple(blocks))


def _signal(database: Database, message: str, name: str, where: str) -> Signal:
    """The signal of a message. Raises InputError if the DBC file has none."""
    try:
        return database.get_message_by_name(message).get_signal_by_name(name)
    except KeyError as error:
        raise InputError(
            f"{where}: the DBC file has no {message}.{name} ({error.args[0]}); correct one of them"
        ) from None


def _senders(message: Message, rows: Mapping[str, TagTable]) -> list[Sender]:
    """One sender for each layout of the message that shows a tag; `rows` are the tags by their signals' names."""
    layouts: dict[tuple[tuple[str, int], ...], list[tuple[Signal, TagTable]]] = {}
    common: list[tuple[Signal, TagTable]] = []
    for signal in message.signals:
        if signal.name not in rows:
            continue
        # The multiplexors that select the signal, its own first; one of several numbers is as good as the others.
        selected: list[tuple[str, int]] = []
        selector = signal
        while selector.multiplexer_ids and selector.multiplexer_signal:
            selected.append((selector.multiplexer_signal, selector.multiplexer_ids[0]))
            selector = message.get_signal_by_name(selector.multiplexer_signal)
        # What no multiplexor selects is in every layout.
        (layouts.setdefault(tuple(selected), []) if selected else common).append((signal, rows[signal.name]))
    attributes = message.dbc.attributes if message.dbc is not None else {}
    plain: dict[str, Any] = {name: attribute.value for name, attribute in attributes.items()}
    data_id = plain.get("E2EDataID", message.frame_id & 0xFFFF) if plain.get("E2EProfile") == "P05" else None
    # The layouts of a multiplexed message take turns, so that the message keeps its cycle.
    layouts = layouts or {(): []}
    cycle = (message.cycle_time or _CYCLE_MS) / 1000.0 * len(layouts)
    return [Sender(message, dict(chosen), [*common, *own], cycle, data_id) for chosen, own in layouts.items()]


def protect_payload(data_id: int, counter: int, data: bytes) -> bytes:
    """The payload with E2E profile 5's counter and CRC-16/IBM-3740 (bit by bit) in its first three bytes."""
    body = bytes((counter & 0xFF,)) + data[_HEADER_BYTES:]
    register = 0xFFFF
    for octet in (*body, data_id & 0xFF, data_id >> 8 & 0xFF):
        register ^= octet << 8
        for _ in range(8):
            register = (register << 1 ^ 0x1021 if register & 0x8000 else register << 1) & 0xFFFF
    return bytes((register & 0xFF, register >> 8)) + body

"""The PLC's CAN messages by a DBC file: payloads from the process image, and the write-back block from frames.

By a path of its own: cantools packs the bits, and the checksum is worked out here bit by bit, so that a mistake of the
gateway's decoder cannot cancel itself out in a round trip.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cantools
from cantools.database.can import Database, Message, Signal
from pydantic import ConfigDict, Field

from drivers.tag import Value
from sim.plc.program import FileTable, InputError, listed, read_toml, validated

_PREFIX = "dbc:"
_HEADER = 3  # of E2E profile 5: two bytes of CRC, one of counter


class _BusDevice(FileTable):
    model_config = ConfigDict(extra="ignore", frozen=True, allow_inf_nan=False)
    dbc: str = Field(min_length=1, description="the path of a DBC file, relative to this one")
    echo: dict[str, str] = Field(default_factory=dict, description="a table of messages and their echoes, by name")


class _SignalEntry(FileTable):
    model_config = ConfigDict(extra="ignore", frozen=True, allow_inf_nan=False)
    name: str = Field(min_length=1, description="the tag's name")
    address: str = Field(pattern=rf"^{_PREFIX}\w+\.\w+$", description="'dbc:Message.Signal'")
    sentinel: int | None = Field(None, description="a whole number")


class _FieldEntry(FileTable):
    model_config = ConfigDict(extra="ignore", frozen=True, allow_inf_nan=False)
    name: str = Field(min_length=1, description="the field's name")


class _BlockMessageEntry(FileTable):
    model_config = ConfigDict(extra="ignore", frozen=True, allow_inf_nan=False)
    address: str = Field(pattern=rf"^{_PREFIX}\w+\.\{{field\}}$", description="'dbc:Message.{field}'")
    fields: list[_FieldEntry] = Field(min_length=1, description="the block's fields")


@dataclass(frozen=True, slots=True)
class _Content:
    """One signal of a payload: the tag that it shows, and the raw number that says "not available"."""

    signal: Signal
    tag: str
    sentinel: int | None


@dataclass(slots=True, eq=False)
class Sender:
    """One payload layout that the PLC sends: every `cycle` seconds, and when its content changes.

    `selected` are the numbers of the message's multiplexors. `content` and `wire` are what was sent last, without and
    with checksum and counter.
    """

    message: Message
    selected: Mapping[str, int]
    contents: Sequence[_Content]
    cycle: float
    data_id: int | None
    content: bytes | None = None
    wire: bytes | None = None
    due: float = 0.0

    def payload(self, served: Mapping[str, Value | None]) -> bytes:
        """The message as the image has it, checksum and counter 0. A tag that the image has lost reads as 0."""
        raw: dict[str, float | str] = {signal.name: 0 for signal in self.message.signals}
        raw.update(self.selected)
        for one in self.contents:
            raw[one.signal.name] = _raw(one, served[one.tag]) if one.tag in served else 0
        return bytes(self.message.encode(raw, scaling=False, strict=False))


@dataclass(slots=True)
class BlockMemory:
    """The write-back block as frames fill it, by field name; a frame brings the words of its own layout."""

    message: Message
    echo: Message
    fields: Sequence[str]
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
    block: BlockMemory | None


def read_messages(path: Path, known: Sequence[str]) -> Messages:
    """The messages of the device file in `path` for the image's tags. Raises InputError."""
    data = read_toml(path, "a device file such as config/devices/decanter_can.toml")
    device = validated(_BusDevice, data.get("device", {}), f"{path}: [device]")
    database = _database(path.parent / device.dbc)
    tags = [validated(_SignalEntry, row, f"{path}: tag {number}") for number, row in enumerate(data.get("tags", []), 1)]
    if strange := [tag.name for tag in tags if tag.name not in known]:
        raise InputError(f"{path}: tag {strange[0]!r}: the register map has no such tag; known are {listed(known)}")
    by_message: dict[str, dict[str, _SignalEntry]] = {}
    for tag in tags:
        name, _, signal = tag.address.removeprefix(_PREFIX).partition(".")
        _signal(database, name, signal, f"{path}: tag {tag.name!r}")
        by_message.setdefault(name, {})[signal] = tag
    senders = [
        sender for name, found in by_message.items() for sender in _senders(database.get_message_by_name(name), found)
    ]
    block = _block(data["writeback"], device, database, path) if "writeback" in data else None
    return Messages(path, tuple(senders), block)


def _database(path: Path) -> Database:
    try:
        database = cantools.database.load_file(path, database_format="dbc")
    except (OSError, UnicodeError, cantools.Error) as error:
        raise InputError(f"{path}: is no DBC file that can be used ({error}); give one") from None
    if not isinstance(database, Database):
        raise InputError(f"{path}: is no DBC file; give one")
    return database


def _signal(database: Database, message: str, name: str, where: str) -> Signal:
    try:
        return database.get_message_by_name(message).get_signal_by_name(name)
    except KeyError as error:
        raise InputError(
            f"{where}: the DBC file has no {message}.{name} ({error.args[0]}); correct one of them"
        ) from None


def _block(data: object, device: _BusDevice, database: Database, path: Path) -> BlockMemory:
    where = f"{path}: [writeback]"
    entry = validated(_BlockMessageEntry, data, where)
    name = entry.address.removeprefix(_PREFIX).partition(".")[0]
    if name not in device.echo:
        raise InputError(f"{where}: [device.echo] names no echo of {name!r}; the PLC answers each frame with one")
    fields = [row.name for row in entry.fields]
    for one in fields:
        _signal(database, name, one, where)
        _signal(database, device.echo[name], one, where)
    return BlockMemory(database.get_message_by_name(name), database.get_message_by_name(device.echo[name]), fields)


def _senders(message: Message, found: Mapping[str, _SignalEntry]) -> list[Sender]:
    """One sender for each layout of the message that shows a tag."""
    layouts: dict[tuple[tuple[str, int], ...], list[_Content]] = {}
    common: list[_Content] = []
    for signal in message.signals:
        if signal.name in found:
            tag = found[signal.name]
            content = _Content(signal, tag.name, tag.sentinel)
            selected = _selected(message, signal)
            (layouts.setdefault(selected, []) if selected else common).append(content)
    attributes = message.dbc.attributes if message.dbc is not None else {}
    plain: dict[str, Any] = {name: attribute.value for name, attribute in attributes.items()}
    data_id = plain.get("E2EDataID", message.frame_id & 0xFFFF) if plain.get("E2EProfile") == "P05" else None
    cycle = (message.cycle_time or 100) / 1000.0
    rows = layouts or {(): []}
    return [
        Sender(message, dict(selected), [*common, *own], cycle * len(rows), data_id) for selected, own in rows.items()
    ]


def _selected(message: Message, signal: Signal) -> tuple[tuple[str, int], ...]:
    """The multiplexors' numbers of the layout in which a signal lies."""
    chosen: list[tuple[str, int]] = []
    while signal.multiplexer_ids and signal.multiplexer_signal:
        chosen.append((signal.multiplexer_signal, signal.multiplexer_ids[0]))
        signal = message.get_signal_by_name(signal.multiplexer_signal)
    return tuple(chosen)


def _raw(one: _Content, value: Value | None) -> float:
    signal = one.signal
    if value is None:
        if one.sentinel is not None:
            return one.sentinel
        return math.nan if signal.is_float else 0
    if isinstance(value, str):
        return 0
    number = (value - float(signal.offset)) / float(signal.scale)
    if signal.is_float:
        return number
    low, high = (
        (-(1 << signal.length - 1), (1 << signal.length - 1) - 1) if signal.is_signed else (0, (1 << signal.length) - 1)
    )
    return min(max(round(number), low), high)


def protected(data_id: int, counter: int, data: bytes) -> bytes:
    """The payload with E2E profile 5's counter and CRC-16/IBM-3740 (bit by bit) in its first three bytes."""
    body = bytes((counter & 0xFF,)) + data[_HEADER:]
    register = 0xFFFF
    for octet in (*body, data_id & 0xFF, data_id >> 8 & 0xFF):
        register ^= octet << 8
        for _ in range(8):
            register = (register << 1 ^ 0x1021 if register & 0x8000 else register << 1) & 0xFFFF
    return bytes((register & 0xFF, register >> 8)) + body

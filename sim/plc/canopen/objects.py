"""The node's object dictionary: the EDS's objects, those that show tags of the process image, and the blocks."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from pydantic import ConfigDict, Field

from drivers.tag import DType, Order, Tag
from sim.plc.canopen import pdo, sdo
from sim.plc.canopen.eds import Address, EdsObject, read_eds
from sim.plc.canopen.sdo import Abort
from sim.plc.program import (
    BlockLayout,
    FileTable,
    InputError,
    Plc,
    Unrepresentable,
    encode,
    encode_absent,
    is_bool,
    read_device,
    validate_entry,
)

ERROR_REGISTER, ERRORS, STORE_EDS = (0x1001, 0), 0x1003, (0x1021, 0)
ACCEPTED_SEQUENCE, WHOLE_BLOCK = (1, 1), (2, 0)
"""Objects of config/decanter.eds that show no tag, counted from the index of a block's words: the last accepted block's
sequence, and the block as one object."""

_OBJECT = re.compile(r"0x([0-9A-Fa-f]{1,4}):(\d{1,3})")


class _NodeDevice(FileTable):
    """The settings of the driver that hold for the node, too; all others are the gateway's business."""

    model_config = ConfigDict(extra="ignore", frozen=True, allow_inf_nan=False)
    node: int = Field(1, strict=True, ge=1, le=63, description="a node id in 1..63")
    eds: str = Field(strict=True, min_length=1, description="the path of the EDS, relative to this file")


@dataclass(frozen=True, slots=True)
class NodeLayout:
    """What a device file says: node id, the EDS's objects and text, the tags at each object, each block's first word.

    `blocks` are in the order of the register map's.
    """

    node: int
    entries: Mapping[Address, EdsObject]
    text: str
    tags: Mapping[Address, Sequence[Tag]]
    blocks: tuple[Address, ...]


def read_layout(
    path: Path, known: Mapping[str, Tag], blocks: Sequence[BlockLayout], node: int | None = None
) -> NodeLayout:
    """The device file in `path` with its EDS; `known` are the image's tags, `blocks` the register map's.

    `node` is another node id than the file's. Raises InputError naming file, key, reason and remedy.
    """
    content = read_device(path)
    device = validate_entry(_NodeDevice, content.device.model_extra or {}, f"{path}: [device]")
    node = device.node if node is None else node
    entries, text = read_eds(path.parent / device.eds, node)
    tags: dict[Address, list[Tag]] = {}
    for number, row in enumerate(content.tags, start=1):
        where = f"{path}: tag {number}"
        if row.name not in known:
            raise InputError(f"{where}: name: the register map has no {row.name!r}; give one of its tags")
        # An order is of registers: what a node sends has the least byte first, whatever the file says of it.
        tag = replace(row.tag(), order=Order.ABCD)
        tags.setdefault(_address(row.address, entries, where), []).append(tag)
    places: list[Address] = []
    if (first := content.writeback) is not None:
        where, count = f"{path}: [writeback]", len(first.fields)
        addresses = {"": first.address, **{row.suffix: row.address for row in first.blocks}}
        if list(addresses) != [block.suffix for block in blocks]:
            raise InputError(f"{where}: blocks: the register map has others; give both files the same, in one order")
        if wrong := [block.place.words for block in blocks if block.place.words != count]:
            raise InputError(f"{where}: fields: {count} words, and the register map's has {wrong[0]}")
        places = [_address(address, entries, where) for address in addresses.values()]
    return NodeLayout(node, entries, text, tags, tuple(places))


def _address(text: str, entries: Mapping[Address, EdsObject], where: str) -> Address:
    match = _OBJECT.fullmatch(text)
    if match is None:
        raise InputError(f"{where}: address: must match index:sub-index, got {text!r}; give one such as '0x2001:1'")
    address = int(match[1], 16), int(match[2])
    if address not in entries:
        raise InputError(f"{where}: address: {text} is not in the EDS; give one of its objects")
    return address


class Objects:
    """The dictionary of one node. `beat` is told of a new heartbeat time in seconds. Reads and writes raise Abort."""

    def __init__(self, layout: NodeLayout, plc: Plc, beat: Callable[[float], None] = lambda _: None) -> None:
        self._layout, self._plc, self._beat = layout, plc, beat
        self.error_register, self.errors = 0, [0]
        self.store = True
        self._memory: dict[Address, bytes] = {}
        self._written: list[dict[int, int]] = [{} for _ in layout.blocks]
        self._pdos: dict[int, list[pdo.ActivePdo]] = {}

    def reset(self) -> None:
        """Back to the values of power-on."""
        self._memory.clear()
        self._written = [{} for _ in self._layout.blocks]
        self._pdos.clear()
        self.error_register, self.errors = 0, [0]

    def number(self, address: Address) -> int:
        """An object of the dictionary proper as an unsigned number; 0 where there is none."""
        entry = self._layout.entries.get(address)
        return 0 if entry is None else int.from_bytes(self._memory.get(address, entry.default), "little")

    def pdos(self, first: int) -> list[pdo.ActivePdo]:
        """The PDOs from `first` (RPDO or TPDO) on, as they are mapped now."""
        if first not in self._pdos:
            self._pdos[first] = list(pdo.pdos(self._layout.entries, first, self.number))
        return self._pdos[first]

    def announce(self, code: int, register: int) -> None:
        """Note an error (code 0: none any more) in the error register and the list of errors."""
        self.error_register = register
        if code:
            self.errors = [code, *self.errors[:3]]

    # ---------------------------------------------------------------- clients

    def read(self, address: Address) -> bytes:
        """An object's bytes at present."""
        entry = self._entry(address)
        if not entry.readable:
            raise Abort(sdo.WRITE_ONLY)
        if address in self._layout.tags:
            return self._of_tags(self._layout.tags[address], entry)
        if (word := self.word(address)) is not None:
            number, place = word
            return self._block_words(number, place, 1)
        return self._own(address, entry)

    def write(self, address: Address, data: bytes) -> None:
        """Store what a client writes."""
        entry = self._entry(address)
        if not entry.writable:
            raise Abort(sdo.READ_ONLY)
        if entry.size is not None and len(data) != entry.size:
            raise Abort(sdo.TOO_LONG if len(data) > entry.size else sdo.TOO_SHORT)
        if address in self._layout.tags:
            raise Abort(sdo.READ_ONLY)
        if (word := self.word(address)) is not None:
            self.put_words(word[0], {word[1]: int.from_bytes(data, "little")})
        elif (number := self._offset_block(address, WHOLE_BLOCK)) is not None:
            self._put_whole(number, data)
        else:
            self._keep(address, entry, data)

    def put_words(self, number: int, words: Mapping[int, int]) -> None:
        """Words of block `number` by their place from 0: kept until the last one comes, then taken as a whole."""
        if not self._plc.running:
            return
        place, written = self._plc.registers.blocks[number].place, self._written[number]
        written |= words
        if place.words - 1 in words:
            block = [written.get(word, 0) for word in range(place.words)]
            written.clear()
            if self.store:
                self._plc.write("canopen", place.table, place.address, block, self._plc.clock.monotonic())

    def word(self, address: Address) -> tuple[int, int] | None:
        """Which block's word an object is, and which of its words, both from 0; None for any other object."""
        for number, first in enumerate(self._layout.blocks):
            place = address[1] - first[1]
            if address[0] == first[0] and 0 <= place < self._plc.registers.blocks[number].place.words:
                return number, place
        return None

    # ---------------------------------------------------------------- inside

    def _entry(self, address: Address) -> EdsObject:
        entry = self._layout.entries.get(address)
        if entry is None:
            has_index = any(known[0] == address[0] for known in self._layout.entries)
            raise Abort(sdo.NO_SUBINDEX if has_index else sdo.NO_OBJECT)
        return entry

    def _own(self, address: Address, entry: EdsObject) -> bytes:
        if address == ERROR_REGISTER:
            return bytes([self.error_register])
        if address == STORE_EDS:
            return self._layout.text.encode("utf-8")
        if (number := self._offset_block(address, WHOLE_BLOCK)) is not None:
            return self._block_words(number, 0, self._plc.registers.blocks[number].place.words)
        if (number := self._offset_block(address, ACCEPTED_SEQUENCE)) is not None:
            return int(self._plc.intakes[number].block.get("sequence", 0)).to_bytes(2, "little")
        if address[0] == ERRORS:
            known = [error for error in self.errors if error]
            sub = address[1]
            return (
                bytes([len(known)]) if sub == 0 else (known[sub - 1] if sub <= len(known) else 0).to_bytes(4, "little")
            )
        return self._memory.get(address, entry.default)

    def _offset_block(self, address: Address, offset: Address) -> int | None:
        """The block whose words' index this object follows at the offset; None if it is no such object."""
        for number, first in enumerate(self._layout.blocks):
            if address == (first[0] + offset[0], offset[1]):
                return number
        return None

    def _block_words(self, number: int, first: int, count: int) -> bytes:
        place = self._plc.registers.blocks[number].place
        words = self._plc.image.read(place.table, place.address + first, count)
        return b"".join(word.to_bytes(2, "little") for word in words)

    def _put_whole(self, number: int, data: bytes) -> None:
        words = [int.from_bytes(data[at : at + 2], "little") for at in range(0, len(data), 2)]
        if len(data) != 2 * self._plc.registers.blocks[number].place.words:
            raise Abort(sdo.LENGTH)
        self.put_words(number, dict(enumerate(words)))

    def _keep(self, address: Address, entry: EdsObject, data: bytes) -> None:
        value = int.from_bytes(data, "little")
        if address == (ERRORS, 0):
            if value:
                raise Abort(sdo.VALUE)
            self.errors = [0]
            return
        pdo.check_write(self._layout.entries, self.number, address, value)
        if self.store:
            self._memory[address] = data
            self._pdos.clear()
        if address == (0x1017, 0):
            self._beat(self.number(address) / 1000.0)

    def _of_tags(self, tags: Sequence[Tag], entry: EdsObject) -> bytes:
        """The object's bytes from the tags that share it: bits side by side, or one value."""
        served, size = self._plc.image.client_values, entry.size or 0
        if is_bool(tags[0]):
            bits = sum(1 << (tag.bit or 0) for tag in tags if served.get(tag.name))
            return bits.to_bytes(size or 2, "little")
        (tag,) = tags
        if tag.name not in served:
            return bytes(size or tag.length)
        value = served[tag.name]
        if tag.dtype is DType.STRING:
            return str(value or "").encode("latin-1", errors="replace")[: tag.length]
        try:
            words: Sequence[int] = encode_absent(tag) if value is None else encode(tag, value)
        except Unrepresentable as error:
            words = error.nearest
        # Registers run from the most significant byte down, CANopen sends the least one first.
        return b"".join(word.to_bytes(2, "big") for word in words)[::-1][:size]

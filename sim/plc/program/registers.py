"""The register map (TOML) as the PLC reads it: which tag lies where, and where the gateway's block is taken in."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path

from pydantic import ConfigDict, Field

from drivers.device_file import BlockField
from drivers.tag import DType, Order, Tag
from sim.plc.program.checks import FileTable, InputError, read_device, validate_entry
from sim.plc.program.encoding import sentinel_fits, words_of_type

WORD_TABLES = ("holding", "input")
BIT_TABLES = ("coil", "discrete")
MAX_WORDS = 123
"""Registers that function 16 writes at most (MODBUS Application Protocol V1.1b3, 6.12)."""

_ADDRESS = "'holding:N', 'input:N', 'coil:N' or 'discrete:N' with N in 0..65535"
_MAX_STRING_BYTES = 250


@dataclass(frozen=True, slots=True)
class Place:
    """`words` neighbouring addresses of one table; for coils and discretes, one bit each."""

    table: str
    address: int
    words: int = 1

    def addresses(self) -> range:
        """Every address that the place covers."""
        return range(self.address, self.address + self.words)

    def __str__(self) -> str:
        return f"{self.table}:{self.address}"


@dataclass(frozen=True, slots=True)
class BlockLayout:
    """Where the gateway writes a block, what it holds, and for how long (s, real time) the PLC trusts it.

    It is block `number` (from 0) of `count` that the PLC takes in; the names of its own status tags end in `suffix`.
    `temperature` is the tag that it speaks of, "" where the file does not say.
    """

    place: Place
    version: int
    timeout_s: float
    fields: tuple[BlockField, ...]
    number: int = 0
    count: int = 1
    suffix: str = ""
    temperature: str = ""

    def index(self, name: str) -> int:
        """The position of a field, counted from 0."""
        return next(index for index, field in enumerate(self.fields) if field.name == name)


@dataclass(frozen=True, slots=True, kw_only=True)
class RegisterMap:
    """A device: its tags, where each lies, its limits, and the blocks that the gateway may write.

    `factors` are the registers with powers of ten, and the tags that have theirs there (`scale_from`).
    """

    path: Path
    device: str
    unit: int
    max_registers: int
    max_gap: int
    heartbeat: str | None
    tags: Mapping[str, Tag]
    places: Mapping[str, Place]
    blocks: tuple[BlockLayout, ...]
    factors: Mapping[Place, tuple[str, ...]] = field(default_factory=dict)

    @property
    def block(self) -> BlockLayout | None:
        """The first block; None where the PLC takes none in."""
        return self.blocks[0] if self.blocks else None


class _ServedDevice(FileTable):
    """The settings of the driver that hold for the device's side, too; all others are the gateway's business."""

    model_config = ConfigDict(extra="ignore", frozen=True, allow_inf_nan=False)
    unit: int = Field(1, strict=True, ge=0, le=255, description="a Modbus unit id in 0..255")
    max_registers: int = Field(125, strict=True, ge=1, le=125, description="the registers of one request, 1..125")
    max_gap: int = Field(0, strict=True, ge=0, description="how many unused registers may be read in vain")


def read_map(path: Path) -> RegisterMap:
    """The register map in `path`. Raises InputError with file, tag and key, reason and remedy."""
    content = read_device(path)
    device = content.device
    served = validate_entry(_ServedDevice, device.model_extra or {}, f"{path}: [device]")
    tags = {row.name: row.tag() for row in content.tags}
    for number, tag in enumerate(tags.values(), start=1):
        _check_tag(tag, f"{path}: tag {number} ({tag.name})")
    places = {name: tag_place(tag, str(path)) for name, tag in tags.items()}
    blocks: list[BlockLayout] = []
    if (first := content.writeback) is not None:
        count, fields = len(first.fields), tuple(row.field() for row in first.fields)
        rows = [("[writeback]", first.address, "", first.temperature)]
        rows += [
            (f"[[writeback.blocks]] {row.suffix}", row.address, row.suffix, row.temperature) for row in first.blocks
        ]
        for number, (name, text, suffix, temperature) in enumerate(rows):
            where = f"{path}: {name}"
            table, address = parse_address(text, f"{where}: address")
            if table != "holding":
                raise InputError(f"{where}: address: a {table} cannot be written by function 16; give 'holding:N'")
            if count > MAX_WORDS:
                raise InputError(
                    f"{where}: fields: there are {count}, and function 16 writes {MAX_WORDS}; leave some out"
                )
            if address + count > 0x10000:
                raise InputError(f"{where}: address: {count} registers from {address} run beyond 65535")
            blocks.append(
                BlockLayout(
                    Place(table, address, count),
                    first.layout_version,
                    first.timeout_s,
                    fields,
                    number=number,
                    count=len(rows),
                    suffix=suffix,
                    temperature=temperature or "",
                )
            )
    # Bits of one register may be tags of their own: what two of them must not share is a bit, not an address.
    owners: dict[tuple[str, int, int], str] = {}
    covered: list[tuple[str, Place, int | None]] = [
        (f"[writeback] {block.suffix}".strip(), block.place, None) for block in blocks
    ]
    covered += [(name, places[name], tag.bit) for name, tag in tags.items()]
    factors = _factors(tags, places, str(path))
    covered += [(f"the factor of {names[0]}", place, None) for place, names in factors.items()]
    covered = [one for one in covered if one[1] not in factors or one[0] not in tags]
    for name, place, bit in covered:
        for spot in product((place.table,), place.addresses(), range(16) if bit is None else (bit,)):
            if spot in owners:
                raise InputError(
                    f"{path}: tag {name!r}: address: {spot[0]}:{spot[1]} belongs to {owners[spot]!r} already; "
                    "move one of them"
                )
            owners[spot] = name
    if device.heartbeat is not None:
        beat = tags[device.heartbeat]
        if beat.dtype is not DType.UINT16 or beat.scale != 1 or beat.offset != 0:
            raise InputError(
                f"{path}: tag {beat.name!r}: a heartbeat is a plain uint16; leave dtype, scale and offset out"
            )
    return RegisterMap(
        path=path,
        device=device.name,
        unit=served.unit,
        max_registers=served.max_registers,
        max_gap=served.max_gap,
        heartbeat=device.heartbeat,
        tags=tags,
        places=places,
        factors=factors,
        blocks=tuple(blocks),
    )


def parse_address(text: str, where: str) -> tuple[str, int]:
    """`holding:100` -> ("holding", 100). Raises InputError."""
    table, _, number = text.partition(":")
    if table not in (*WORD_TABLES, *BIT_TABLES) or not number.isascii() or not number.isdecimal():
        raise InputError(f"{where}: address {text!r} cannot be read; give {_ADDRESS}")
    if int(number) > 0xFFFF:
        raise InputError(f"{where}: address {text!r} is beyond 65535; give {_ADDRESS}")
    return table, int(number)


def tag_place(tag: Tag, where: str) -> Place:
    """The registers that a tag covers. Raises InputError if the type cannot lie there."""
    table, address = parse_address(tag.address, f"{where}: tag {tag.name!r}: address")
    place = Place(table, address, 1 if table in BIT_TABLES else words_of_type(tag))
    if address + place.words > 0x10000:
        raise InputError(f"{where}: tag {tag.name!r}: its {place.words} registers from {place} run beyond 65535")
    return place


def _factors(tags: Mapping[str, Tag], places: Mapping[str, Place], where: str) -> dict[Place, tuple[str, ...]]:
    """The registers of powers of ten with the tags that have theirs there. Raises InputError."""
    factors: dict[Place, tuple[str, ...]] = {}
    for name, tag in tags.items():
        if tag.scale_from:
            table, address = parse_address(tag.scale_from, f"{where}: tag {name!r}: scale_from")
            if table in BIT_TABLES:
                raise InputError(f"{where}: tag {name!r}: scale_from: {tag.scale_from} is one bit; give a register")
            place = Place(table, address)
            factors[place] = (*factors.get(place, ()), name)
    for name, tag in tags.items():
        plain = (tag.dtype, tag.order, tag.scale, tag.offset, tag.bit) == (DType.INT16, Order.ABCD, 1.0, 0.0, None)
        if places[name] in factors and (not plain or tag.scale_from or tag.writable):
            raise InputError(
                f"{where}: tag {name!r}: dtype: it is the factor of {factors[places[name]][0]!r}, a plain int16 that "
                "is not written; correct it"
            )
    return factors


def _check_tag(tag: Tag, where: str) -> None:
    table = tag.address.partition(":")[0]
    for key, wrong, remedy in (
        ("bit", tag.bit is not None and words_of_type(tag) != 1, "it takes more than a register; set dtype = 'bool'"),
        ("bit", tag.bit is not None and table in BIT_TABLES, f"a {table} is a bit already; leave it out"),
        ("dtype", table in BIT_TABLES and tag.dtype is not DType.BOOL, f"a {table} holds a bool; set dtype = 'bool'"),
        ("length", tag.dtype is DType.STRING and tag.length == 0, "a string needs one; give its bytes, 1..250"),
        ("length", tag.length > _MAX_STRING_BYTES, f"a string has {_MAX_STRING_BYTES} bytes at most; give fewer"),
        ("length", tag.dtype is not DType.STRING and tag.length > 0, "only a string has one; leave it out"),
        ("sentinel", not sentinel_fits(tag), f"{tag.sentinel} is no {tag.dtype}; give a raw number that is"),
        ("writable", tag.writable and table in ("input", "discrete"), f"a {table} is read-only; leave it out"),
    ):
        if wrong:
            raise InputError(f"{where}: {key}: {remedy}")

"""The register map (TOML) as the PLC reads it: which tag lies where, and where the gateway's block is taken in."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field

from drivers.tag import DType, Order, Tag
from sim.plc.program.checks import FileTable, InputError, listed, read_toml, validated
from sim.plc.program.encode import sentinel_fits, words_of_type

WORD_TABLES = ("holding", "input")
BIT_TABLES = ("coil", "discrete")
BLOCK_FIELDS = ("layout_version", "sequence", "heartbeat", "validity", "crc", "sequence_copy")

Word = Annotated[int, Field(strict=True, ge=0, le=0xFFFF)]
Number = Annotated[float, Field(strict=True)]
Text = Annotated[str, Field(strict=True)]
_ADDRESS = "'holding:N', 'input:N', 'coil:N' or 'discrete:N' with N in 0..65535"
Address = Annotated[str, Field(strict=True, pattern=r"^(holding|input|coil|discrete):\d{1,5}$", description=_ADDRESS)]


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
class BlockField:
    """One 16-bit word of the gateway's block: value = raw * scale."""

    name: str
    signed: bool
    scale: float


@dataclass(frozen=True, slots=True)
class BlockLayout:
    """Where the gateway writes its block, what it holds, and for how long (s, real time) the PLC trusts it."""

    place: Place
    version: int
    timeout_s: float
    fields: tuple[BlockField, ...]

    def index(self, name: str) -> int:
        """The position of a field, counted from 0."""
        return next(index for index, field in enumerate(self.fields) if field.name == name)


@dataclass(frozen=True, slots=True)
class RegisterMap:
    """A device: its tags, where each lies, its limits, and the block that the gateway may write."""

    path: Path
    device: str
    unit: int
    max_registers: int
    max_gap: int
    heartbeat: str | None
    tags: Mapping[str, Tag]
    places: Mapping[str, Place]
    block: BlockLayout | None


class _Device(FileTable):
    model_config = ConfigDict(extra="ignore", frozen=True, allow_inf_nan=False)  # other keys are the gateway's business
    name: Text = Field("plc", description="a name in quotes")
    unit: int = Field(1, strict=True, ge=0, le=255, description="a Modbus unit id in 0..255")
    max_registers: int = Field(125, strict=True, ge=1, le=125, description="the registers of one request, 1..125")
    max_gap: int = Field(0, strict=True, ge=0, description="how many unused registers may be read in vain")
    heartbeat: Text | None = Field(None, description="the name of the tag that holds the PLC's heartbeat")


class _TagEntry(FileTable):
    name: Text = Field(min_length=1, description="the tag's name in quotes")
    address: Address
    dtype: DType = Field(DType.UINT16, description=f"one of {listed([d.value for d in DType])}")
    order: Order = Field(Order.ABCD, description=f"one of {listed([o.value for o in Order])}")
    scale: Number = Field(1.0, description="a number other than 0")
    offset: Number = Field(0.0, description="a number")
    unit: Text = Field("", description="the unit in quotes")
    low: Number | None = Field(None, description="a number")
    high: Number | None = Field(None, description="a number")
    bit: int | None = Field(None, strict=True, ge=0, le=15, description="a bit's number in 0..15")
    length: int = Field(0, strict=True, ge=0, le=250, description="the string's length in bytes, 1..250")
    sentinel: int | None = Field(None, strict=True, description="a whole number")
    deadband: Number = Field(0.0, description="a number")
    max_rate: Number | None = Field(None, description="a number")
    frozen_after: Number = Field(0.0, description="seconds")
    writable: bool = Field(False, strict=True, description="true or false")
    labels: dict[int, str] = Field(default_factory=dict, description='a table such as { 0 = "none" }')


class _BlockFieldEntry(FileTable):
    name: Text = Field(min_length=1, description="the field's name in quotes")
    dtype: Literal["uint16", "int16"] = Field("uint16", description="'uint16' or 'int16': every field is one word")
    scale: Number = Field(1.0, gt=0, description="a positive number")


class _BlockEntry(FileTable):
    address: Address
    layout_version: Word = Field(description="a number in 0..65535")
    timeout_s: Number = Field(gt=0, description="seconds, more than 0")
    unknown: Word = Field(0xFFFF, description="a number in 0..65535")
    fields: list[_BlockFieldEntry] = Field(min_length=1, max_length=123, description="1 to 123 tables { name, dtype }")


def read_map(path: Path) -> RegisterMap:
    """The register map in `path`. Raises InputError with file, tag and key, reason and remedy."""
    data = read_toml(path, "a register map such as config/devices/decanter_plc.toml")
    device = validated(_Device, data.get("device", {}), f"{path}: [device]")
    tags = _read_tags(data, path)
    places = {name: place_of(tag, str(path)) for name, tag in tags.items()}
    block = _read_block(data["writeback"], path) if "writeback" in data else None
    _check_overlaps(tags, places, block, path)
    if device.heartbeat is not None:
        _check_heartbeat(device.heartbeat, tags, path)
    limits = (device.unit, device.max_registers, device.max_gap)
    return RegisterMap(path, device.name, *limits, device.heartbeat, tags, places, block)


def parse_address(text: str, where: str) -> tuple[str, int]:
    """`holding:100` -> ("holding", 100). Raises InputError."""
    table, _, number = text.partition(":")
    if table not in (*WORD_TABLES, *BIT_TABLES) or not number.isascii() or not number.isdecimal():
        raise InputError(f"{where}: address {text!r} cannot be read; give {_ADDRESS}")
    if int(number) > 0xFFFF:
        raise InputError(f"{where}: address {text!r} is beyond 65535; give {_ADDRESS}")
    return table, int(number)


def place_of(tag: Tag, where: str) -> Place:
    """The registers that a tag covers. Raises InputError if the type cannot lie there."""
    table, address = parse_address(tag.address, f"{where}: tag {tag.name!r}: key 'address'")
    place = Place(table, address, 1 if table in BIT_TABLES else words_of_type(tag))
    if address + place.words > 0x10000:
        raise InputError(f"{where}: tag {tag.name!r}: its {place.words} registers from {place} run beyond 65535")
    return place


def _read_tags(data: Mapping[str, Any], path: Path) -> dict[str, Tag]:
    entries = data.get("tags", [])
    if not isinstance(entries, list) or not entries:
        raise InputError(f"{path}: key 'tags': there are none; give at least one [[tags]] table")
    tags: dict[str, Tag] = {}
    for number, entry in enumerate(entries, start=1):
        name = entry.get("name", "?") if isinstance(entry, dict) else "?"
        where = f"{path}: tag {number} ({name})"
        tag = Tag(**dict(validated(_TagEntry, entry, where)))
        if tag.name in tags:
            raise InputError(f"{where}: key 'name': {tag.name!r} is taken already; give each tag its own name")
        _check_tag(tag, where)
        tags[tag.name] = tag
    return tags


def _check_tag(tag: Tag, where: str) -> None:
    table = tag.address.partition(":")[0]
    for key, wrong, remedy in (
        ("scale", tag.scale == 0, "it is 0; give a number other than 0"),
        ("bit", tag.bit is not None and words_of_type(tag) != 1, "it takes more than a register; set dtype = 'bool'"),
        ("bit", tag.bit is not None and table in BIT_TABLES, f"a {table} is a bit already; leave it out"),
        ("dtype", table in BIT_TABLES and tag.dtype is not DType.BOOL, f"a {table} holds a bool; set dtype = 'bool'"),
        ("length", tag.dtype is DType.STRING and tag.length == 0, "a string needs one; give its bytes, 1..250"),
        ("length", tag.dtype is not DType.STRING and tag.length > 0, "only a string has one; leave it out"),
        ("sentinel", not sentinel_fits(tag), f"{tag.sentinel} is no {tag.dtype}; give a raw number that is"),
        ("writable", tag.writable and table in ("input", "discrete"), f"a {table} is read-only; leave it out"),
    ):
        if wrong:
            raise InputError(f"{where}: key {key!r}: {remedy}")


def _read_block(data: object, path: Path) -> BlockLayout:
    where = f"{path}: [writeback]"
    entry = validated(_BlockEntry, data, where)
    table, address = parse_address(entry.address, f"{where}: key 'address'")
    names = [field.name for field in entry.fields]
    if table != "holding":
        raise InputError(f"{where}: key 'address': a {table} cannot be written by function 16; give 'holding:N'")
    if len(set(names)) < len(names):
        raise InputError(f"{where}: key 'fields': a name occurs twice; give each field its own name")
    if missing := [name for name in BLOCK_FIELDS if name not in names]:
        raise InputError(f"{where}: key 'fields': {listed(missing)} missing; the contract needs them")
    if address + len(names) > 0x10000:
        raise InputError(f"{where}: key 'address': {len(names)} registers from {address} run beyond 65535")
    fields = tuple(BlockField(field.name, field.dtype == "int16", field.scale) for field in entry.fields)
    return BlockLayout(Place(table, address, len(fields)), entry.layout_version, entry.timeout_s, fields)


def _check_overlaps(
    tags: Mapping[str, Tag], places: Mapping[str, Place], block: BlockLayout | None, path: Path
) -> None:
    owners: dict[tuple[str, int, int], str] = {}
    for spot in _spots("[writeback]", None, block.place) if block else ():
        owners[spot] = "[writeback]"
    for name, tag in tags.items():
        for spot in _spots(name, tag, places[name]):
            if spot in owners:
                at = f"{spot[0]}:{spot[1]}"
                raise InputError(
                    f"{path}: tag {name!r}: key 'address': {at} belongs to {owners[spot]!r} already; move one of them"
                )
            owners[spot] = name


def _spots(name: str, tag: Tag | None, place: Place) -> Iterator[tuple[str, int, int]]:
    bits = range(16) if tag is None or tag.bit is None else (tag.bit,)
    return ((place.table, address, bit) for address in place.addresses() for bit in bits)


def _check_heartbeat(name: str, tags: Mapping[str, Tag], path: Path) -> None:
    tag = tags.get(name)
    if tag is None:
        raise InputError(f"{path}: [device]: key 'heartbeat': there is no tag {name!r}; name one of [[tags]]")
    if tag.dtype is not DType.UINT16 or tag.scale != 1 or tag.offset != 0:
        raise InputError(f"{path}: tag {name!r}: a heartbeat is a plain uint16; leave dtype, scale and offset out")

"""The device file: one device's tags, its driver's settings and the block that is written to it, as a TOML file.

This is the only schema. The gateway makes tags and a write map of what is read here, the software PLC its registers;
how a value lies in a register is no part of it, so that either keeps a path of its own for that.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, field_validator, model_validator

from drivers.derived import Derived
from drivers.driver import DRIVERS
from drivers.settings import ConfigError, Label, Name, Section, read_toml, validate_section
from drivers.tag import DType, Order, Tag

LONGEST_TEXT = 4096
LAYOUT_VERSION = 2
"""The version of the write-back contract: the one that both sides here keep."""

NEEDED_FIELDS = ("layout_version", "sequence", "heartbeat", "validity", "challenge", "writer", "crc", "sequence_copy")
"""Fields that every block has: by them the PLC checks it."""

REFUSALS: Mapping[str, int] = {
    "none": 0,
    "layout version": 1,
    "sequence and its copy differ": 2,
    "CRC": 3,
    "heartbeat did not change": 4,
    "length or start": 5,
    "another challenge": 6,
    "another writer": 7,
    "sequence not 1 to 100 ahead": 8,
    "no permit": 9,
}
"""Why a PLC refuses a block, and the contract's number; a map's labels of LastRefusal may number them differently."""
STATUS_TAGS = (
    "BlocksAccepted",
    "BlocksRefused",
    "LastRefusal",
    "PredictionUsable",
    "Challenge",
    "SessionWriter",
    "RefusedWriter",
)
"""The tags by which a PLC answers the blocks of one session; those of a further block end in its suffix."""
ACKNOWLEDGE_BITS = "AcknowledgeBits"
"""The word of acknowledged alarms: a further block's own by its suffix if the file has one, else the common one."""
_RAW_NUMBER = re.compile(r"-?[0-9]{1,20}")
_BLOCK_ADDRESS = r":\d+$|\{field\}"
_FIELD = "{field}"


class DeviceTable(BaseModel):
    """`[device]`: what is not listed here is a setting of the driver, which checks it."""

    model_config = ConfigDict(extra="allow", frozen=True, strict=True, defer_build=True)

    name: Name = Field(description="a short name for the device")
    driver: str = Field(description=f"one of {', '.join(sorted(DRIVERS))}")
    heartbeat: str | None = Field(None, description="the name of the tag that counts while the program runs")

    @field_validator("driver")
    @classmethod
    def _check_driver(cls, driver: str) -> str:
        if driver not in DRIVERS:
            raise ValueError(f"{driver!r} is no driver; give one of {', '.join(sorted(DRIVERS))}")
        return driver


def _sentinels(given: object) -> object:
    """One raw number or a list of them as a tuple. Raises ValueError for anything else."""
    numbers = given if isinstance(given, list | tuple) else [] if given is None else [given]
    if not all(isinstance(number, int | float) and type(number) is not bool and isfinite(number) for number in numbers):
        raise ValueError(
            f"must be a whole number, a number or a list of them, got {given!r}; give the raw number that means 'not "
            "available'"
        )
    return tuple(numbers)


_Sentinels = Annotated[tuple[int | float, ...], BeforeValidator(_sentinels)]


class TagTable(Section):
    """`[[tags]]`: one tag; see `drivers.tag.Tag`."""

    name: Name = Field(description="the tag's name")
    address: str = Field(min_length=1, description="the driver's own notation, such as 'holding:100'")
    dtype: Annotated[DType, Field(strict=False)] = Field(DType.UINT16, description=f"one of {', '.join(DType)}")
    order: Annotated[Order, Field(strict=False)] = Field(Order.ABCD, description=f"one of {', '.join(Order)}")
    scale: float = Field(1.0, description="engineering units per raw count, not 0")
    offset: float = Field(0.0, description="engineering units at raw 0")
    scale_from: str = Field(
        "", description="the address of a register with a power of ten beside the scale, such as 'holding:40084'"
    )
    unit: Label = Field("", description="the unit as text")
    low: float | None = Field(None, description="the lowest plausible value")
    high: float | None = Field(None, description="the highest plausible value")
    bit: int | None = Field(None, ge=0, le=15, description="a bit number from 0 to 15")
    length: int = Field(0, ge=0, le=LONGEST_TEXT, description=f"a string's length in bytes, at most {LONGEST_TEXT}")
    sentinel: _Sentinels = Field((), description="the raw number that means 'not available', or a list of them")
    deadband: float = Field(0.0, ge=0, description="the smallest change worth storing")
    max_rate: float | None = Field(None, gt=0, description="the fastest believable change in units per second")
    frozen_after: float = Field(
        0.0, ge=0, description="seconds without any change after which it is suspect, 0 = never"
    )
    period: float = Field(
        0.0, ge=0, le=86_400, description="the seconds between two readings, 0 = with every scan, at most 86400"
    )
    writable: bool = Field(False, description="true or false")
    labels: dict[str, Label] = Field(default_factory=dict, description='a table such as { 0 = "none", 1 = "busy" }')

    @field_validator("scale")
    @classmethod
    def _not_zero(cls, scale: float) -> float:
        if scale == 0:
            raise ValueError("scale 0 would make every reading 0; give the engineering units per raw count")
        return scale

    @model_validator(mode="after")
    def _sentinels_of_type(self) -> "TagTable":
        parts = [number for number in self.sentinel if isinstance(number, float) and not number.is_integer()]
        if parts and self.dtype not in (DType.FLOAT32, DType.FLOAT64):
            raise ValueError(
                f"sentinel {parts[0]:g} is never a raw {self.dtype}; give a whole number, or a float's dtype"
            )
        return self

    @field_validator("labels")
    @classmethod
    def _numbers(cls, labels: dict[str, str]) -> dict[str, str]:
        for key in labels:
            if not _RAW_NUMBER.fullmatch(key):
                raise ValueError(f'{key!r} is no raw number; give labels as {{ 0 = "none" }}')
        return labels

    def tag(self) -> Tag:
        """The tag that it describes."""
        first, others = (self.sentinel[0], self.sentinel[1:]) if self.sentinel else (None, ())
        labels = {int(key): text for key, text in self.labels.items()}
        return Tag(**{**dict(self), "labels": labels, "sentinel": first, "other_sentinels": others})


@dataclass(frozen=True, slots=True)
class BlockField:
    """One 16-bit word of the block: stored = round(value / scale), int16 or uint16."""

    name: str
    signed: bool
    scale: float


class BlockFieldTable(Section):
    """A row of `fields`."""

    name: str = Field(min_length=1, description="the field's name")
    dtype: Literal["uint16", "int16"] = Field("uint16", description="'uint16' or 'int16'")
    scale: float = Field(1.0, gt=0, description="engineering units per count, above 0")

    def field(self) -> BlockField:
        """The word that it describes."""
        return BlockField(self.name, self.dtype == "int16", self.scale)


class FurtherBlockTable(Section):
    """`[[writeback.blocks]]`: one more block of the same layout, a session of its own at the PLC."""

    temperature: str = Field(min_length=1, description="the name of the temperature's tag that the block speaks of")
    address: str = Field(pattern=_BLOCK_ADDRESS, description="as [writeback].address, elsewhere")
    suffix: str = Field(
        pattern=r"^[A-Za-z][A-Za-z0-9]{0,31}$",
        description="letters and digits that end the names of the block's own status tags, such as 'Feed' in "
        "BlocksAcceptedFeed",
    )


class BlockTable(Section):
    """`[writeback]`: the block that the device takes in, and with `blocks` one more for each further temperature."""

    temperature: str | None = Field(
        None, min_length=1, description="the name of the temperature's tag that the block speaks of"
    )

    address: str = Field(
        pattern=_BLOCK_ADDRESS,
        description="the first word in the driver's notation, from which the fields are counted up ('holding:400', "
        "'0x2100:1'), or a pattern with {field} for the field's name",
    )
    layout_version: int = Field(ge=0, le=65535, description="the layout's version, 0 to 65535")
    timeout_s: float = Field(gt=0, description="the PLC's timer in seconds, above 0")
    unknown: int = Field(65535, ge=0, le=65535, description="the word for 'not within the forecast'")
    fields: list[BlockFieldTable] = Field(min_length=1, description="the block's words in order")
    blocks: list[FurtherBlockTable] = Field(
        default_factory=list, description="[[writeback.blocks]] tables, one for each further temperature"
    )

    def addresses(self, address: str) -> list[str]:
        """The address of each word of a block at `address`.

        A pattern names each word; from any other address they are counted up: holding:400 -> holding:403,
        0x2100:1 -> 0x2100:4 for the word of index 3.
        """
        if _FIELD in address:
            return [address.replace(_FIELD, row.name) for row in self.fields]
        space, _, first = address.rpartition(":")
        return [f"{space}:{int(first) + index}" for index in range(len(self.fields))]

    @field_validator("layout_version")
    @classmethod
    def _of_this_contract(cls, version: int) -> int:
        if version < LAYOUT_VERSION:
            raise ValueError(
                f"version {version} has no sessions: a recorded block would count as a new one; give "
                f"{LAYOUT_VERSION}, the fields 'challenge' and 'writer' before 'crc', and the tags Challenge, "
                "SessionWriter and RefusedWriter, and make the PLC's side anew (decanter plc codegen)"
            )
        if version > LAYOUT_VERSION:
            raise ValueError(f"version {version} is not known here; give {LAYOUT_VERSION}")
        return version


class GroupTable(Section):
    """`[[groups]]`: a period for several tags that have none of their own."""

    period: float = Field(gt=0, le=86_400, description="the seconds between two readings, above 0 and at most 86400")
    tags: list[str] = Field(min_length=1, description='names of tags, with * for any letters, such as ["Energy*"]')


class DeviceFile(Section):
    """The whole file."""

    device: DeviceTable = Field(description="a [device] table")
    groups: list[GroupTable] = Field(default_factory=list, description="[[groups]] tables, each with a period")
    tags: list[TagTable] = Field(min_length=1, description="at least one [[tags]] entry")
    writeback: BlockTable | None = Field(None, description="a [writeback] table")
    derived: dict[Name, Derived] = Field(
        default_factory=dict,
        description='a [derived] table of signals that are made of tags, such as Running = { signal = "Current", '
        "above = 0.3 }",
    )


_OF_A_PLANT = frozenset({"alarms", "historian", "log", "machine", "model", "scan", "temperature"})
"""Sections that a plant file has, and no device file."""


def read_device_file(path: Path) -> DeviceFile:
    """The device file in `path`. Raises ConfigError with one sentence for each thing that is wrong."""
    data = read_toml(path)
    if "tags" not in data and not _OF_A_PLANT.isdisjoint(data):
        raise ConfigError([f"{path}: is a plant file and no device file; give it with --config"])
    content = validate_section(DeviceFile, data, path)
    content, problems_of_groups = _grouped(content)
    # What no single key shows: doubled names, ranges upside down, a heartbeat that is no tag, a block without CRC.
    names = [row.name for row in content.tags]
    problems = [
        f"tags[{index}].name: {name!r} is already used; give each tag a name of its own"
        for index, name in enumerate(names)
        if name in names[:index]
    ]
    problems += problems_of_groups
    problems += [
        f"tags[{index}].low: {row.low} is not below high {row.high} of {row.name!r}; swap or correct them"
        for index, row in enumerate(content.tags)
        if row.low is not None and row.high is not None and not row.low < row.high
    ]
    if content.device.heartbeat is not None and content.device.heartbeat not in names:
        problems.append(f"device.heartbeat: {content.device.heartbeat!r} is not a tag of this file; give a tag's name")
    problems += [
        f"tags[{index}].period: {row.name!r} has one, and {why}; take it out"
        for index, row in enumerate(content.tags)
        if row.period and (why := _period_problem(row, content.device))
    ]
    problems += [
        f"tags[{index}].scale_from: {row.name!r} has one, and {why}; take it out"
        for index, row in enumerate(content.tags)
        if row.scale_from and (why := _unscaled(row, content.device))
    ]
    numbers = {row.name for row in content.tags if row.dtype is not DType.STRING}
    for name, law in content.derived.items():
        if name in names:
            problems.append(f"derived.{name}: is the name of a tag already; give it another")
        problems += [
            f"derived.{name}: needs {source!r}, which is no tag of this file with a number; give a tag's name"
            for source in law.sources
            if source not in numbers
        ]
    if content.writeback is not None:
        fields = [row.name for row in content.writeback.fields]
        problems += [
            f"writeback.fields: {name!r} is there {fields.count(name)} times; keep one"
            for name in sorted(set(fields))
            if fields.count(name) > 1
        ]
        problems += [
            f"writeback.fields: {name!r} is missing; the PLC cannot check the block without it"
            for name in sorted(set(NEEDED_FIELDS) - set(fields))
        ]
        problems += _block_problems(content.writeback, {row.name: row for row in content.tags})
    if problems:
        raise ConfigError([f"{path}: {problem}" for problem in problems])
    return content


def _grouped(content: DeviceFile) -> tuple[DeviceFile, list[str]]:
    """The file with each group's period at its tags, and what is wrong with the groups.

    A tag's own period wins, then the first group that names it.
    """
    periods: dict[str, float] = {}
    problems = []
    for index, group in enumerate(content.groups):
        for name in group.tags:
            pattern = re.compile(re.escape(name).replace(r"\*", ".*"))
            # The heartbeat is read with every scan, and who means all others need not name them one by one.
            beat = content.device.heartbeat if "*" in name else None
            found = [row.name for row in content.tags if row.name != beat and pattern.fullmatch(row.name)]
            periods = dict.fromkeys(found, group.period) | periods
            if not found:
                problems.append(f"groups[{index}].tags: {name!r} is no tag of this file; give names of tags")
    rows = [
        row.model_copy(update={"period": periods[row.name]}) if not row.period and row.name in periods else row
        for row in content.tags
    ]
    return content.model_copy(update={"tags": rows}), problems


def _period_problem(tag: TagTable, device: DeviceTable) -> str:
    """Why a tag has no period of its own; "" where it may have one."""
    if tag.name == device.heartbeat:
        return "the heartbeat is read with every scan"
    if not DRIVERS[device.driver].registers:
        return f"what driver {device.driver!r} reads comes by itself"
    return ""


def _unscaled(tag: TagTable, device: DeviceTable) -> str:
    """Why a tag has no factor in a register; "" where it may have one."""
    if not DRIVERS[device.driver].registers:
        return f"a device of driver {device.driver!r} has no registers"
    if tag.writable:
        return "what is written has a scale of its own (writable)"
    return f"it is a {tag.dtype}" if tag.bit is not None or tag.dtype in (DType.BOOL, DType.STRING) else ""


def _block_problems(table: BlockTable, tags: Mapping[str, TagTable]) -> list[str]:
    """What is wrong with the blocks among one another and with their tags, one sentence each."""
    problems = []
    if table.blocks and table.temperature is None:
        problems.append(
            "writeback.temperature: is missing; beside further blocks the first one has to say of which tag it speaks"
        )
    spoken_of: dict[str, str] = {}
    owners: dict[str, str] = {}
    suffixes: set[str] = set()
    rows = [("writeback", table.temperature, table.address, "")]
    rows += [
        (f"writeback.blocks[{index}]", row.temperature, row.address, row.suffix)
        for index, row in enumerate(table.blocks)
    ]
    for where, temperature, address, suffix in rows:
        if temperature is not None:
            if temperature not in tags:
                problems.append(f"{where}.temperature: {temperature!r} is not a tag of this file; give a tag's name")
            if temperature in spoken_of:
                other = spoken_of[temperature]
                problems.append(f"{where}.temperature: {other} speaks of {temperature!r} already; give each its own")
            spoken_of.setdefault(temperature, where)
        words = table.addresses(address)
        if taken := [word for word in words if word in owners]:
            problems.append(
                f"{where}.address: {taken[0]} belongs to the block of {owners[taken[0]]} already; move one of them"
            )
        owners |= dict.fromkeys(words, where)
        if not suffix:
            continue
        if suffix in suffixes:
            problems.append(f"{where}.suffix: {suffix!r} is already used; give each block a suffix of its own")
        suffixes.add(suffix)
        if missing := [f"{name}{suffix}" for name in STATUS_TAGS if f"{name}{suffix}" not in tags]:
            problems.append(
                f"{where}.suffix: there is no tag {missing[0]!r}, by which the PLC answers this block; add it"
            )
        # One program checks all blocks, and its reasons have one number each.
        own, common = tags.get(f"LastRefusal{suffix}"), tags.get("LastRefusal")
        if own is not None and common is not None and own.labels != common.labels:
            problems.append(
                f"{where}.suffix: the labels of 'LastRefusal{suffix}' are not those of 'LastRefusal'; give it the same"
            )
    return problems

"""A device's register map as a file: its tags, what the driver must know, and the block that is written back."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator

from drivers.driver import DRIVERS, capabilities
from drivers.settings import ConfigError, Section, checked, read_toml
from drivers.tag import DType, Order, Tag

BLOCK_FIELDS = (
    "layout_version", "sequence", "heartbeat", "validity", "input_quality", "age", "location", "temperature_now",
    "band_low", "band_high", "horizon", "horizon_low", "horizon_median", "horizon_high", "p_limit", "minutes_low",
    "minutes_median", "minutes_high", "zone", "alarms", "anomaly", "model_hash", "crc", "sequence_copy",
)  # fmt: skip
"""Every field that the gateway can fill. A map may leave some out or order them differently, the last two apart."""


@dataclass(frozen=True, slots=True)
class BlockField:
    """One 16-bit word of the block: stored = round(value / scale), int16 or uint16."""

    name: str
    signed: bool
    scale: float


@dataclass(frozen=True, slots=True)
class WritebackLayout:
    """The block that the PLC expects. `words` are its registers as raw 16-bit tags, in order: the closed write map.

    `timeout` (s) is the PLC's own timer, `unknown` the word for minutes beyond the forecast.
    """

    version: int
    timeout: float
    unknown: int
    fields: tuple[BlockField, ...]
    words: tuple[Tag, ...]


@dataclass(frozen=True, slots=True)
class DeviceMap:
    """One device: how to open its driver, its tags, the tag of its heartbeat, and the block written to it."""

    path: Path
    name: str
    driver: str
    settings: Mapping[str, Any]
    heartbeat: str | None
    tags: tuple[Tag, ...]
    writeback: WritebackLayout | None

    @property
    def by_name(self) -> dict[str, Tag]:
        """The tags by their names (made anew at each call)."""
        return {tag.name: tag for tag in self.tags}


class _Device(BaseModel):
    """`[device]`: what is not listed here is a setting of the driver, which checks it."""

    model_config = ConfigDict(extra="allow", frozen=True, strict=True)

    name: str = Field(min_length=1, description="a short name for the device")
    driver: str = Field(description=f"one of {', '.join(sorted(DRIVERS))}")
    heartbeat: str | None = Field(None, description="the name of the tag that counts while the program runs")

    @field_validator("driver")
    @classmethod
    def _known(cls, driver: str) -> str:
        if driver not in DRIVERS:
            raise ValueError(f"{driver!r} is no driver; give one of {', '.join(sorted(DRIVERS))}")
        return driver


class _TagRow(Section):
    name: str = Field(min_length=1, description="the tag's name")
    address: str = Field(min_length=1, description="the driver's own notation, such as 'holding:100'")
    dtype: Annotated[DType, Field(strict=False)] = Field(DType.UINT16, description=f"one of {', '.join(DType)}")
    order: Annotated[Order, Field(strict=False)] = Field(Order.ABCD, description=f"one of {', '.join(Order)}")
    scale: float = Field(1.0, description="engineering units per raw count, not 0")
    offset: float = Field(0.0, description="engineering units at raw 0")
    unit: str = Field("", description="the unit as text")
    low: float | None = Field(None, description="the lowest plausible value")
    high: float | None = Field(None, description="the highest plausible value")
    bit: int | None = Field(None, ge=0, le=15, description="a bit number from 0 to 15")
    length: int = Field(0, ge=0, description="a string's length in bytes")
    sentinel: int | None = Field(None, description="the raw number that means 'not available'")
    deadband: float = Field(0.0, ge=0, description="the smallest change worth storing")
    max_rate: float | None = Field(None, gt=0, description="the fastest believable change in units per second")
    frozen_after: float = Field(
        0.0, ge=0, description="seconds without any change after which it is suspect, 0 = never"
    )
    writable: bool = Field(False, description="true or false")
    labels: dict[str, str] = Field(default_factory=dict, description='a table such as { 0 = "none", 1 = "busy" }')

    @field_validator("scale")
    @classmethod
    def _not_zero(cls, scale: float) -> float:
        if scale == 0:
            raise ValueError("scale 0 would make every reading 0; give the engineering units per raw count")
        return scale

    @field_validator("labels")
    @classmethod
    def _numbers(cls, labels: dict[str, str]) -> dict[str, str]:
        for key in labels:
            if not key.lstrip("-").isdigit():
                raise ValueError(f'{key!r} is no raw number; give labels as {{ 0 = "none" }}')
        return labels


class _BlockRow(Section):
    name: str = Field(description=f"one of {', '.join(BLOCK_FIELDS)}")
    dtype: Literal["uint16", "int16"] = Field("uint16", description="'uint16' or 'int16'")
    scale: float = Field(1.0, gt=0, description="engineering units per count, above 0")

    @field_validator("name")
    @classmethod
    def _fillable(cls, name: str) -> str:
        if name not in BLOCK_FIELDS:
            raise ValueError(f"{name!r} is nothing that the gateway fills; give one of {', '.join(BLOCK_FIELDS)}")
        return name


_FIELD = "{field}"
_BLOCK_ADDRESS = r":\d+$|\{field\}"


class _Writeback(Section):
    address: str = Field(
        pattern=_BLOCK_ADDRESS,
        description="the first word in the driver's notation, from which the fields are counted up ('holding:400', "
        "'0x2100:1'), or a pattern with {field} for the field's name",
    )
    layout_version: int = Field(ge=0, le=65535, description="the layout's version, 0 to 65535")
    timeout_s: float = Field(gt=0, description="the PLC's timer in seconds")
    unknown: int = Field(65535, ge=0, le=65535, description="the word for 'not within the forecast'")
    fields: list[_BlockRow] = Field(min_length=1, description="the block's words in order")


class _MapFile(Section):
    device: _Device = Field(description="a [device] table")
    tags: list[_TagRow] = Field(min_length=1, description="at least one [[tags]] entry")
    writeback: _Writeback | None = Field(None, description="a [writeback] table")


def complete_paths(driver: str, settings: Mapping[str, Any], home: Path) -> dict[str, Any]:
    """The driver's settings with the paths among them made complete: they are relative to the file they stand in."""
    files = capabilities(driver).files
    return {
        key: str(home / value) if key in files and isinstance(value, str) and value else value
        for key, value in settings.items()
    }


def load_device(path: Path) -> DeviceMap:
    """The register map in `path`. Raises ConfigError with one sentence for each thing that is wrong."""
    content = checked(_MapFile, read_toml(path), path)
    problems = _inconsistencies(content)
    if problems:
        raise ConfigError([f"{path}: {problem}" for problem in problems])
    return DeviceMap(
        path=path,
        name=content.device.name,
        driver=content.device.driver,
        settings=complete_paths(content.device.driver, content.device.model_extra or {}, path.parent),
        heartbeat=content.device.heartbeat,
        tags=tuple(_tag(row) for row in content.tags),
        writeback=_layout(content.writeback) if content.writeback else None,
    )


def _tag(row: _TagRow) -> Tag:
    given = row.model_dump()
    given["labels"] = {int(key): text for key, text in row.labels.items()}
    return Tag(**given)


def _layout(table: _Writeback) -> WritebackLayout:
    return WritebackLayout(
        version=table.layout_version,
        timeout=table.timeout_s,
        unknown=table.unknown,
        fields=tuple(BlockField(row.name, row.dtype == "int16", row.scale) for row in table.fields),
        words=tuple(
            Tag(f"Writeback.{row.name}", _word_address(table.address, index, row.name), writable=True)
            for index, row in enumerate(table.fields)
        ),
    )


def _word_address(pattern: str, index: int, name: str) -> str:
    """The address of the block's word `index`: `holding:400` -> `holding:403`, `0x2100:1` -> `0x2100:4` for index 3."""
    if _FIELD in pattern:
        return pattern.replace(_FIELD, name)
    space, _, first = pattern.rpartition(":")
    return f"{space}:{int(first) + index}"


def _inconsistencies(content: _MapFile) -> list[str]:
    """What no single key shows: doubled names, ranges upside down, a heartbeat that is no tag, a block without CRC."""
    names = [row.name for row in content.tags]
    problems = [
        f"tags[{index}].name: {name!r} is already used; give each tag a name of its own"
        for index, name in enumerate(names)
        if name in names[:index]
    ]
    problems += [
        f"tags[{index}].low: {row.low} is not below high {row.high} of {row.name!r}; swap or correct them"
        for index, row in enumerate(content.tags)
        if row.low is not None and row.high is not None and not row.low < row.high
    ]
    if content.device.heartbeat is not None and content.device.heartbeat not in names:
        problems.append(f"device.heartbeat: {content.device.heartbeat!r} is not a tag of this file; give a tag's name")
    if content.writeback is not None:
        problems += _block_problems([row.name for row in content.writeback.fields])
    return problems


def _block_problems(names: list[str]) -> list[str]:
    doubled = sorted({name for name in names if names.count(name) > 1})
    problems = [f"writeback.fields: {name!r} is there {names.count(name)} times; keep one" for name in doubled]
    needed = {"layout_version", "sequence", "heartbeat", "validity", "crc", "sequence_copy"}
    problems += [
        f"writeback.fields: {name!r} is missing; the PLC cannot check the block without it"
        for name in sorted(needed - set(names))
    ]
    if not problems and names[-2:] != ["crc", "sequence_copy"]:
        problems.append("writeback.fields: the last two must be 'crc' and 'sequence_copy', in this order")
    return problems

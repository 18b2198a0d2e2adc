"""A device's register map as a file: its tags, what the driver must know, and the block that is written back."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from drivers.derived import Derived
from drivers.device_file import ACKNOWLEDGE_BITS, REFUSALS, BlockField, read_device_file
from drivers.driver import capabilities
from drivers.named_files import normal_path
from drivers.settings import ConfigError
from drivers.tag import Tag

BLOCK_FIELDS = (
    "layout_version", "sequence", "heartbeat", "validity", "input_quality", "age", "location", "temperature_now",
    "band_low", "band_high", "horizon", "horizon_low", "horizon_median", "horizon_high", "p_limit", "minutes_low",
    "minutes_median", "minutes_high", "zone", "alarms", "anomaly", "model_hash", "challenge", "writer", "crc",
    "sequence_copy",
)  # fmt: skip
"""Every field that the gateway can fill. A map may leave some out or order them differently, the last two apart."""


@dataclass(frozen=True, slots=True)
class WritebackLayout:
    """A block that the PLC expects. `words` are its registers as raw 16-bit tags, in order: its closed write map.

    `timeout` (s) is the PLC's own timer, `unknown` the word for minutes beyond the forecast. `temperature` is the tag
    that the block speaks of (None: the file does not say), `place` its number among the device's blocks, from 0, of
    `blocks` in all. `suffix` ends the names of the tags by which the PLC answers it ("": the first block),
    `acknowledge_bits` is the tag of its acknowledged alarms.
    """

    version: int
    timeout: float
    unknown: int
    fields: tuple[BlockField, ...]
    words: tuple[Tag, ...]
    temperature: str | None = None
    suffix: str = ""
    acknowledge_bits: str = ACKNOWLEDGE_BITS
    place: int = 0
    blocks: int = 1

    def tag(self, name: str) -> str:
        """The block's own status tag of this name in the contract: BlocksAccepted, LastRefusal, Challenge, ..."""
        return f"{name}{self.suffix}"


@dataclass(frozen=True, slots=True)
class DeviceMap:
    """One device: how to open its driver, its tags, the tag of its heartbeat, and the blocks written to it.

    `derived` are the signals that are made of tags, by their names.
    """

    path: Path
    name: str
    driver: str
    settings: Mapping[str, Any]
    heartbeat: str | None
    tags: tuple[Tag, ...]
    writebacks: tuple[WritebackLayout, ...]
    derived: Mapping[str, Derived] = field(default_factory=dict)

    @property
    def signals(self) -> tuple[Tag, ...]:
        """What a scan gives: the tags, and what is made of them."""
        return (*self.tags, *(law.tag(name) for name, law in self.derived.items()))

    @property
    def writeback(self) -> WritebackLayout | None:
        """The first block; None where nothing is written."""
        return self.writebacks[0] if self.writebacks else None

    def find_block(self, temperature: str) -> WritebackLayout | None:
        """The block that speaks of this temperature, else a lone one of which the file does not say; None: no block."""
        for layout in self.writebacks:
            if layout.temperature in (temperature, None):
                return layout
        return None

    @property
    def block_words(self) -> tuple[Tag, ...]:
        """The words of all blocks: the device's closed write map."""
        return tuple(word for layout in self.writebacks for word in layout.words)

    @property
    def by_name(self) -> dict[str, Tag]:
        """The signals by their names (made anew at each call)."""
        return {tag.name: tag for tag in self.signals}

    @property
    def refusals(self) -> dict[str, int]:
        """The number of each reason to refuse a block: the label of LastRefusal, the contract's where it has none."""
        tag = self.by_name.get("LastRefusal")
        labels = {label: code for code, label in tag.labels.items()} if tag else {}
        return {reason: labels.get(reason, code) for reason, code in REFUSALS.items()}


def complete_paths(driver: str, settings: Mapping[str, Any], home: Path) -> dict[str, Any]:
    """The driver's settings with the paths among them made complete: they are relative to the file they stand in."""
    files = capabilities(driver).files
    return {
        key: str(normal_path(home / value)) if key in files and isinstance(value, str) and value else value
        for key, value in settings.items()
    }


def load_device(path: Path) -> DeviceMap:
    """The register map in `path`. Raises ConfigError with one sentence for each thing that is wrong."""
    content = read_device_file(path)
    if content.writeback is not None:
        names = [row.name for row in content.writeback.fields]
        problems = [
            f"{path}: writeback.fields[{index}].name: {name!r} is nothing that the gateway fills; give one of "
            f"{', '.join(BLOCK_FIELDS)}"
            for index, name in enumerate(names)
            if name not in BLOCK_FIELDS
        ]
        # The CRC is over the words before it, and the copy of the sequence shows that all of them have come.
        if not problems and tuple(names[-2:]) != BLOCK_FIELDS[-2:]:
            problems = [f"{path}: writeback.fields: the last two must be 'crc' and 'sequence_copy', in this order"]
        if problems:
            raise ConfigError(problems)
    table, layouts = content.writeback, []
    if table is not None:
        places = [(table.address, "", table.temperature)]
        places += [(row.address, row.suffix, row.temperature) for row in table.blocks]
        known = {row.name for row in content.tags}
        for place, (address, suffix, temperature) in enumerate(places):
            own = f"{ACKNOWLEDGE_BITS}{suffix}"
            layouts.append(
                WritebackLayout(
                    version=table.layout_version,
                    timeout=table.timeout_s,
                    unknown=table.unknown,
                    fields=tuple(row.field() for row in table.fields),
                    words=tuple(
                        Tag(f"Writeback{suffix}.{row.name}", word, writable=True)
                        for row, word in zip(table.fields, table.addresses(address), strict=True)
                    ),
                    temperature=temperature,
                    suffix=suffix,
                    acknowledge_bits=own if own in known else ACKNOWLEDGE_BITS,
                    place=place,
                    blocks=len(places),
                )
            )
    return DeviceMap(
        path=path,
        name=content.device.name,
        driver=content.device.driver,
        settings=complete_paths(content.device.driver, content.device.model_extra or {}, path.parent),
        heartbeat=content.device.heartbeat,
        tags=tuple(row.tag() for row in content.tags),
        writebacks=tuple(layouts),
        derived=content.derived,
    )

"""What `bind` and `import` change in the files, and the change carried out: shown, checked and written in one step."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import tomlkit

from drivers.device_file import LAYOUT_VERSION
from drivers.settings import ConfigError
from gateway.commission.files.device_file import (
    encoding,
    fields_that_fit,
    further_block,
    set_block,
    set_derived,
    set_device,
    set_tag,
)
from gateway.commission.files.plan_files import Files, device_edit, plant_edit, save
from gateway.commission.files.toml_edit import set_key
from gateway.settings import load_plant

_TIMER_S = 5.0
_MOST_WORDS = 123
"""Registers in one write by the protocol (MODBUS Application Protocol V1.1b3, 6.12)."""


@dataclass(frozen=True, slots=True)
class Binding:
    """One tag and its keys: those that say how it lies (all of them where `place` is true), and the others given."""

    name: str
    keys: Mapping[str, Any]
    place: bool


@dataclass(frozen=True, slots=True)
class BlockPlace:
    """The write-back block: its first address, its fields (None: as many as fit), the layout's version, the timer.

    `temperature` is the one that it speaks of; None: the device file's only block is meant.
    """

    address: str
    temperature: str | None = None
    fields: Sequence[str] | None = None
    version: int | None = None
    timer: float | None = None


@dataclass(frozen=True, slots=True)
class FileChange:
    """Everything that one `bind`, `import` or `init` changes; `derived` are signals that are made of tags."""

    tags: Sequence[Binding] = ()
    block: BlockPlace | None = None
    heartbeat: str | None = None
    device: Mapping[str, Any] = field(default_factory=dict)
    plant: Mapping[str, Any] = field(default_factory=dict)
    derived: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)


def put_block(document: tomlkit.TOMLDocument, block: BlockPlace, template: Path) -> None:
    """Put the block into the device file's document; the fields are those of all its blocks. Raises ConfigError."""
    table: Any = document.get("writeback", {})
    row = further_block(document, block.temperature)
    names = block.fields
    if names is None and "fields" not in table:
        # As many as the device takes in one write: the block goes out in one request or not at all.
        own: Any = document.get("device", {})
        most = min(_MOST_WORDS, own.get("max_registers", _MOST_WORDS))
        names = fields_that_fit(int(own.get("max_write_registers", most)))
    version = block.version if block.version is not None else LAYOUT_VERSION
    timer = block.timer if block.timer is not None else table.get("timeout_s", _TIMER_S)
    head: dict[str, Any] = {"layout_version": version, "timeout_s": timer}
    if row is not None:
        set_key(row, "address", block.address)
    else:
        head = {"address": block.address, **head}
        if block.temperature is not None:
            head["temperature"] = block.temperature
    set_block(document, head, names, template)


def plant_findings(plant: Path) -> list[str]:
    """What the judge of a plant file says of one that could be loaded, each with the machine or part that it is of."""
    from gateway.plant import check_plant  # loads all that a gateway runs

    return [f"{one.machine or one.part}: {one.sentence}" for one in check_plant(load_plant(plant))]


def apply_change(files: Files, wanted: FileChange, template: Path, *, dry_run: bool) -> dict[str, Any]:
    """Change the files; gives the diff and the backups. With `dry_run` nothing is written, and nothing is checked.

    `template` is the shipped register map, whose block's fields are the pattern. Raises ConfigError or OSError.
    """

    def change(document: tomlkit.TOMLDocument) -> None:
        set_device(document, wanted.device)
        if wanted.heartbeat is not None:
            set_device(document, {"heartbeat": wanted.heartbeat or None})
        for tag in wanted.tags:
            # A new place takes the old one's keys away too; of an old place only those change that were given.
            lies = encoding(tag.keys)
            place = lies if tag.place else {key: lies[key] for key in lies if key in tag.keys}
            rest = {key: value for key, value in tag.keys.items() if key not in lies}
            set_tag(document, tag.name, {**place, **rest})
        for name, law in wanted.derived.items():
            set_derived(document, name, law)
        if wanted.block is not None:
            put_block(document, wanted.block, template)

    of_device = (wanted.tags, wanted.block, wanted.heartbeat is not None, wanted.device, wanted.derived)
    # A change of the plant file alone makes no device file that is missing.
    device = device_edit(files, change) if any(of_device) or files.device.exists() else None
    plant = plant_edit(files, wanted.plant)
    if wanted.plant and plant is None:
        raise ConfigError([f"--keep {next(iter(wanted.plant))}: is a key of the plant file; give --config FILE"])
    edits = [edit for edit in (device, plant) if edit is not None and edit.has_changes]
    backups = [] if dry_run else save(device, plant)
    return {
        "files": [str(edit.path) for edit in edits],
        "new": [str(edit.path) for edit in edits if edit.before is None],
        "diff": "\n".join(edit.diff() for edit in edits),
        "changes": [{"file": str(edit.path), "new": edit.before is None, "diff": edit.diff()} for edit in edits],
        "backups": [str(path) for path in backups],
        "written": bool(edits) and not dry_run,
    }

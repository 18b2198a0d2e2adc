"""`bind` and `import` at work: the change is made in the file's own text, shown, checked and written in one step."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import tomlkit

from drivers.settings import ConfigError
from gateway.commission.files.device_file import ENCODING, encoding, fields_that_fit, set_block, set_device, set_tag
from gateway.commission.files.io_list import IoList
from gateway.commission.files.plan_files import Files, device_edit, plant_edit, save
from gateway.commission.outcome import Outcome
from gateway.commission.records import read_records

_LAYOUT, _TIMER_S = 1, 5.0
_MOST_WORDS = 123


@dataclass(frozen=True, slots=True)
class Binding:
    """One tag and its keys: those that say how it lies (all of them where `place` is true), and the others given."""

    name: str
    keys: Mapping[str, Any]
    place: bool


@dataclass(frozen=True, slots=True)
class Block:
    """The write-back block: its first address, its fields (None: as many as fit), the layout's version, the timer."""

    address: str
    fields: Sequence[str] | None = None
    version: int | None = None
    timer: float | None = None


@dataclass(frozen=True, slots=True)
class Wanted:
    """Everything that one `bind` or `import` changes."""

    tags: Sequence[Binding] = ()
    block: Block | None = None
    heartbeat: str | None = None
    device: Mapping[str, Any] = field(default_factory=dict)
    plant: Mapping[str, Any] = field(default_factory=dict)


def carry_out(files: Files, wanted: Wanted, template: Path, *, dry_run: bool) -> dict[str, Any]:
    """Change the files; gives the diff and the backups. With `dry_run` nothing is written, and nothing is checked.

    `template` is the shipped register map, whose block's fields are the pattern. Raises ConfigError or OSError.
    """

    def change(document: tomlkit.TOMLDocument) -> None:
        set_device(document, wanted.device)
        if wanted.heartbeat is not None:
            set_device(document, {"heartbeat": wanted.heartbeat or None})
        for tag in wanted.tags:
            set_tag(document, tag.name, _keys(tag))
        if wanted.block is not None:
            _put_block(document, wanted.block, template)

    device = device_edit(files, change)
    plant = plant_edit(files, wanted.plant)
    if wanted.plant and plant is None:
        raise ConfigError([f"--keep {next(iter(wanted.plant))}: is a key of the plant file; give --config FILE"])
    edits = [edit for edit in (device, plant) if edit is not None and edit.changed]
    backups = [] if dry_run else save(device, plant)
    return {
        "files": [str(edit.path) for edit in edits],
        "new": [str(edit.path) for edit in edits if edit.before is None],
        "diff": "\n".join(edit.diff() for edit in edits),
        "changes": [{"file": str(edit.path), "new": edit.before is None, "diff": edit.diff()} for edit in edits],
        "backups": [str(path) for path in backups],
        "written": bool(edits) and not dry_run,
    }


def _keys(tag: Binding) -> dict[str, Any]:
    rest = {key: value for key, value in tag.keys.items() if key not in encoding({})}
    own = encoding(tag.keys)
    return {**(own if tag.place else {key: own[key] for key in own if key in tag.keys}), **rest}


def _put_block(document: tomlkit.TOMLDocument, block: Block, template: Path) -> None:
    table: Any = document.get("writeback", {})
    names = block.fields
    if names is None and "fields" not in table:
        names = fields_that_fit(_room(document))
    version = block.version if block.version is not None else table.get("layout_version", _LAYOUT)
    timer = block.timer if block.timer is not None else table.get("timeout_s", _TIMER_S)
    set_block(document, {"address": block.address, "layout_version": version, "timeout_s": timer}, names, template)


def _room(document: tomlkit.TOMLDocument) -> int:
    """How many words the device takes in one write, by its settings."""
    device: Any = document.get("device", {})
    return int(device.get("max_write_registers", min(_MOST_WORDS, device.get("max_registers", _MOST_WORDS))))


# ---------------------------------------------------------------- from a guess


def guessed(records: Path, rank: int) -> dict[str, Any]:
    """The keys of the candidate of that rank (1 the best) of the newest guess in the records. Raises ConfigError."""
    found = [one for one in read_records(records) if one.command == "guess"] if records.exists() else []
    if not found:
        raise ConfigError(
            [f"{records}: holds no guess; run `decanter plc guess` first, or give the address and --type"]
        )
    result = found[-1].result
    candidates = result.get("candidates") or [{**one, "dtype": "bool"} for one in result.get("bits", [])]
    if not 1 <= rank <= len(candidates):
        raise ConfigError([f"--guess {rank}: the last guess has {len(candidates)} candidates; give 1 for the best"])
    one = candidates[rank - 1]
    return {key: one[key] for key in ENCODING if one.get(key) is not None}


# ---------------------------------------------------------------- from a list


def bindings(found: IoList) -> list[Binding]:
    """The list's tags; what the list says nothing of stays as it is in the file."""
    return [
        Binding(tag.name, {key: value for key, value in tag.keys.items() if value is not None or key == "bit"}, True)
        for tag in found.tags
    ]


def import_outcome(
    found: IoList, files: Files, wanted: Wanted, template: Path, *, dry_run: bool, skip: bool
) -> Outcome:
    """Write the list's tags, unless a row of it is wrong and `skip` is false. Raises ConfigError or OSError."""
    data: dict[str, Any] = {
        "list": str(found.sheet.path),
        "header_line": found.sheet.header_line,
        "columns": dict(found.sheet.columns),
        "ignored_columns": list(found.sheet.ignored),
        "tags": [{"name": tag.name, "line": tag.line, **_said(tag.keys)} for tag in found.tags],
        "problems": list(found.problems),
    }
    if found.problems and not skip:
        count = len(found.problems)
        said = f"{count} rows cannot be used, nothing was written: correct them, or give --skip-bad"
        return Outcome({**data, "diff": "", "written": False, "files": [], "backups": []}, 1, said)
    done = carry_out(files, wanted, template, dry_run=dry_run)
    left = [f"import: a row was left out: {problem}" for problem in found.problems]
    return Outcome({**data, **done, "open_points": left})


def _said(keys: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in keys.items() if value is not None}

"""`decanter plc import`: the tags of an I/O list into the device file, each bad row with its own sentence."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from drivers.driver import capabilities
from drivers.settings import read_toml
from gateway.commission.files import (
    MOST_REPEATS,
    Binding,
    FileChange,
    Files,
    IoList,
    Reading,
    apply_change,
    edit_files,
    read_io_list,
    split_settings,
    template,
)
from gateway.commission.options import SharedOptions
from gateway.console import CommandResult


def make_reading(options: Mapping[str, Any], **more: Any) -> Reading:
    """How a list is read, by the options of `list_options`."""
    given = {key: options[key] for key in ("order", "shift", "gain", "numbers", "plc") if options[key] is not None}
    return Reading(**given, **more)


def import_list(given: SharedOptions, path: Path, **options: Any) -> None:
    """The work of `plc import`."""

    def work(files: Files) -> CommandResult:
        device, plant = split_settings(options["keep"])
        registers = capabilities(files.driver).registers
        held = read_toml(files.device).get("device", {}) if files.device.exists() else {}
        how = make_reading(
            options,
            table=options["registers"],
            registers=registers,
            rename=options["rename"],
            unit=given.settings.get("unit"),
            wide="wide_registers" in {**held, **files.settings, **device},
            repeats=repeats_of(options["repeat"]),
        )
        io_list = read_io_list(path, how, options["columns"], options["sheet"])
        only, without = options["only"], options["without"]
        if only or without:
            known = [tag.name for tag in io_list.tags]
            if missing := [name for name in (*only, *without) if name not in known]:
                raise ValueError(f"{missing[0]!r}: the list has no usable row of that name; it has {', '.join(known)}")
            tags = tuple(tag for tag in io_list.tags if (not only or tag.name in only) and tag.name not in without)
            io_list = replace(io_list, tags=tags, problems=() if only else io_list.problems)
        wanted = FileChange(bindings(io_list), None, options["heartbeat"], device, plant)
        dry_run, skip = options["dry_run"], options["skip_bad"]
        return import_outcome(io_list, files, wanted, template(), dry_run=dry_run, skip=skip)

    arguments = {"list": str(path), **{key: value for key, value in options.items() if value not in (None, (), {})}}
    edit_files(given, "import", arguments, work)


def repeats_of(given: Mapping[str, str]) -> dict[str, int]:
    """How often each group is there. Raises ValueError."""
    for name, count in given.items():
        if not count.isdecimal() or int(count) > MOST_REPEATS:
            raise ValueError(f"--repeat {name}={count}: give a whole number from 0 to {MOST_REPEATS}")
    return {name: int(count) for name, count in given.items()}


def bindings(io_list: IoList) -> list[Binding]:
    """The list's tags; what the list says nothing of stays as it is in the file.

    But where a tag's bit or scale stands elsewhere now, what the file says of it goes.
    """
    return [
        Binding(
            tag.name,
            {
                key: value
                for key, value in tag.keys.items()
                if value is not None or key == "bit" or (key == "scale_from" and tag.keys["scale"] is not None)
            },
            True,
        )
        for tag in io_list.tags
    ]


def import_outcome(
    io_list: IoList, files: Files, wanted: FileChange, template: Path, *, dry_run: bool, skip: bool
) -> CommandResult:
    """Write the list's tags, unless a row of it is wrong and `skip` is false. Raises ConfigError or OSError."""
    data: dict[str, Any] = {
        "list": str(io_list.sheet.path),
        "header_line": io_list.sheet.header_line,
        "columns": dict(io_list.sheet.columns),
        "ignored_columns": list(io_list.sheet.ignored),
        "left_out": list(io_list.sheet.left_out),
        "not_taken": list(io_list.sheet.notes),
        "tags": [
            {
                "name": tag.name,
                "line": tag.line,
                **{key: value for key, value in tag.keys.items() if value is not None},
                **({"taken": tag.taken} if tag.taken else {}),
            }
            for tag in io_list.tags
        ],
        "problems": list(io_list.problems),
    }
    if io_list.problems and not skip:
        count = len(io_list.problems)
        sentence = f"{count} rows cannot be used, nothing was written: correct them, or give --skip-bad"
        return CommandResult({**data, "diff": "", "written": False, "files": [], "backups": []}, sentence)
    done = apply_change(files, wanted, template, dry_run=dry_run)
    left = [f"import: {note}" for note in io_list.sheet.notes]
    left += [f"import: a row was left out: {problem}" for problem in io_list.problems]
    left += [f"import: {tag.unread}" for tag in io_list.tags if tag.unread]
    return CommandResult({**data, **done, "open_points": left})

"""The files that `bind` and `import` change: a device file, and the plant file that leads to it; both may be new."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from os.path import lexists
from pathlib import Path
from typing import Any

import tomlkit
from tomlkit.items import AoT

from drivers.driver import DRIVERS, LINKS, capabilities
from drivers.settings import ConfigError, read_toml
from gateway.commission.files.device_file import PLACE_KEYS, set_device, starter
from gateway.commission.files.toml_edit import Edit, commit, edit_file, set_key
from gateway.commission.session import CONNECT_S, DEFAULT_DRIVER, Target, TargetError, make_target
from gateway.settings import ModelSection, is_common, load_config, load_device, load_plant

_PLANT = """\
# The gateway's configuration. Relative paths are relative to this file. `decanter plc check` says what is wrong.

[device]

[scan]
period = 1.0                 # s between two scans

[model]
temperature = "TCuscinettiRiduttore"   # the tag that is predicted and watched
# path = "models/decanter"   # a model; without it: monitoring and the threshold alarm only

[writeback]
mode = "off"                 # "off", "shadow" (computed and stored; `decanter arm` lets it be written) or "armed"

[alarms]
limit = 80.0                 # degC

[historian]
path = "out/historian.sqlite"

[log]
path = "out/gateway.log.jsonl"
"""
_SHORT_FORM = frozenset({"host", "port", "timeout"})


@dataclass(frozen=True, slots=True, kw_only=True)
class Files:
    """What is to be changed. `plant` is None where only a device file is given; `link` names one of the plant's.

    `machine` is the one whose tables are meant in a plant file with [[machine]] tables, None in any other.
    `place` are settings that say where the device is, `settings` those of the device file, `driver` that of a new one.
    """

    plant: Path | None
    device: Path
    driver: str
    link: str | None
    machine: str | None
    place: Mapping[str, Any]
    settings: Mapping[str, Any]

    @property
    def present(self) -> tuple[Path, ...]:
        """Those that are there."""
        return tuple(path for path in (self.plant, self.device) if path is not None and path.exists())


def find_files(
    plant: Path | None, device: Path | None, link: str | None, given: Mapping[str, Any], machine: str | None = None
) -> Files:
    """Which files are meant, and where each of the given settings belongs. Raises ConfigError or TargetError."""
    if machine is not None and (plant is None or not lexists(plant)):
        raise TargetError("--machine names one of a plant file that is there: give that with --config")
    if plant is None and device is None:
        raise TargetError(
            "which file? Give the plant file (--config FILE) or the device file (--device FILE); it is made"
        )
    # A link that leads nowhere is no file that is yet to be made.
    if plant is not None and lexists(plant):
        if device is not None:
            raise TargetError(f"--config and --device exclude each other: {plant} names its device file itself")
        tables = read_toml(plant)
        machine = _pick_machine(plant, tables, machine)
        row: Mapping[str, Any] = _device_file_row(plant, _device_table(tables, machine), link)
        path = plant.parent / row["file"]
    else:
        row = {}
        path = device or (plant or Path()).parent / "devices" / f"{(plant or Path()).stem}.toml"
    driver, all_settings = _find_driver(path, plant, link, given, row)
    place = {key: value for key, value in all_settings.items() if key in PLACE_KEYS}
    settings = {key: value for key, value in all_settings.items() if key not in PLACE_KEYS}
    return Files(plant=plant, device=path, driver=driver, link=link, machine=machine, place=place, settings=settings)


def _find_driver(
    path: Path, plant: Path | None, link: str | None, given: Mapping[str, Any], row: Mapping[str, Any]
) -> tuple[str, Mapping[str, Any]]:
    """(driver, settings): of the device file that is there, else by the link that is given, else as `row` has it.

    `row` is the plant file's own table of the device, which says where the device is though its file is not there yet.
    """
    if lexists(path):
        driver = read_toml(path).get("device", {}).get("driver")
        if not isinstance(driver, str):
            load_device(path)  # which says what else such a file may be
            raise ConfigError([f"{path}: device.driver: is missing; give one of {', '.join(sorted(DRIVERS))}"])
        if driver not in DRIVERS:
            known = ", ".join(sorted(DRIVERS))
            raise ConfigError([f"{path}: device.driver: {driver!r} is no driver; give one of {known}"])
        return driver, given
    there = {key: row[key] for key in PLACE_KEYS if key in row}
    kind = link if link in LINKS or not row else None  # of a plant file's rows a link is the name
    if (plant is None or row) and kind is None and not {*there, *given} & {"host", "serial", "channel"}:
        return DEFAULT_DRIVER, given
    target: Target = make_target(None, None, kind, {**there, **given})
    ours = {"transport": "tcp", "connect_timeout": CONNECT_S}  # what the commands fill in is no setting of the plant
    plain = {
        key: value
        for key, value in target.settings.items()
        if key in given or (key not in there and ours.get(key) != value)
    }
    return target.driver, plain


def _pick_machine(plant: Path, tables: Mapping[str, Any], machine: str | None) -> str | None:
    """The machine of the file whose tables are meant, by default its only one; None for a file without their tables.

    Raises ConfigError or TargetError.
    """
    rows = tables.get("machine")
    if rows is None:
        # A file of one machine calls it by its device file's name; whether that is so its configuration says.
        return None if machine is None or load_config(plant, machine=machine) else machine
    names = [str(row.get("name")) for row in rows if isinstance(row, dict)] if isinstance(rows, list) else []
    if machine is None and len(names) != 1:
        raise ConfigError([f"{plant}: has {len(names)} machines; name one of them with --machine: {', '.join(names)}"])
    if machine is not None and machine not in names:
        load_plant(plant)  # of a file that nobody can use that is said first
        raise ConfigError([f"{plant}: has no machine {machine!r}; it has {', '.join(names)}"])
    return names[0] if machine is None else machine


def _device_table(tables: Mapping[str, Any], machine: str | None) -> Mapping[str, Any]:
    """The [device] table of the file's only machine, or of the one of that name: its own over the common one."""
    common: Mapping[str, Any] = tables.get("device", {})
    if machine is None:
        return common
    own = next(row for row in tables["machine"] if row.get("name") == machine).get("device", {})
    return {**common, **own}


def _device_file_row(plant: Path, table: Mapping[str, Any], link: str | None) -> Mapping[str, Any]:
    """The table of a plant file that names a device `file`, of its first link or of the one called `link`."""
    links = table.get("links")
    if links is None and isinstance(table.get("file"), str):
        return dict(table)
    for row in links if isinstance(links, list) else ():
        if isinstance(row, dict) and link in (None, row.get("name")) and isinstance(row.get("file"), str):
            return row
    lacking = f"no link {link!r}" if link else "neither device.file nor a [[device.links]] table with a file"
    raise ConfigError([f"{plant}: has {lacking}; add it, or give --device FILE"])


# ---------------------------------------------------------------- changing


Change = Callable[[tomlkit.TOMLDocument], None]


def device_edit(files: Files, change: Change) -> Edit:
    """The device file with a change, and with the settings that were given. Raises ConfigError."""

    def apply(document: tomlkit.TOMLDocument) -> None:
        set_device(document, files.settings)
        change(document)

    return edit_file(files.device, apply, starter(files.device.stem, files.driver))


def plant_edit(files: Files, keep: Mapping[str, Any]) -> Edit | None:
    """The plant file with where the device is, and with the keys to `keep`; None without a plant file.

    A key is section.key, or temperature.TAG.key for that of a predicted temperature, which is added where it is new.
    In a file with [[machine]] tables all but what is common is put into the table of the machine that is meant.

    Raises ConfigError.
    """
    if files.plant is None:
        return None
    new = not files.plant.exists()

    def apply(document: tomlkit.TOMLDocument) -> None:
        own: Any = document
        if files.machine is not None:
            own = next(row for row in document["machine"] if row["name"] == files.machine)
        if new:
            _begin_device(document, files)
        elif files.place:
            row = _device_row(document, own, files)
            for key, value in files.place.items():
                set_key(row, key, value)
        for dotted, value in keep.items():
            section, *tag, key = dotted.split(".")
            if tag:
                set_key(_temperature_row(document, own, ".".join(tag)), key, value)
            else:
                set_key(_table(document if is_common(section, key) else own, section), key, value)

    return edit_file(files.plant, apply, _PLANT)


def _begin_device(document: tomlkit.TOMLDocument, files: Files) -> None:
    """The [device] table of a new plant file."""
    folder, device = (files.plant or Path()).parent.absolute(), files.device.absolute()
    file = (device.relative_to(folder) if device.is_relative_to(folder) else device).as_posix()
    # Relative paths in a plant file are relative to it, and those on the command line to where one stands.
    place = {key: str(Path(value).absolute()) if key == "certificates" else value for key, value in files.place.items()}
    table = _table(document, "device")
    if capabilities(files.driver).networked and set(place) <= _SHORT_FORM:
        table.update({"file": file, **place})
        return
    row = tomlkit.table()
    row.update({"name": files.link or files.driver, "file": file, **place})
    rows = tomlkit.aot()
    rows.append(row)
    table["links"] = rows


def _device_row(document: tomlkit.TOMLDocument, own: Any, files: Files) -> Any:
    """The table that says where the device of a plant file that is there lies: its [device], or one of its links."""
    table = _table(own, "device")
    rows = table.get("links")
    if rows is None and "links" in document.get("device", {}):
        raise ConfigError(
            [
                f"{files.plant}: device.links: is common to all machines; give machine {files.machine!r} "
                "[[machine.device.links]] tables of its own"
            ]
        )
    return table if rows is None else next(row for row in rows if files.link in (None, row.get("name")))


def _table(parent: Any, name: str) -> Any:
    """The table of this name, made where it is not there."""
    if name not in parent:
        parent[name] = tomlkit.table()
    return parent[name]


def _temperature_row(document: tomlkit.TOMLDocument, own: Any, tag: str) -> Any:
    """The [[temperature]] table of a tag, made where there is none; a [model] becomes the first of them.

    A machine that has temperatures of its own has none of the common ones: it begins with what those say.
    """
    if "temperature" not in own:
        rows = tomlkit.aot()
        model: Any = own.pop("model", None)
        if model is None and own is not document:
            common: Any = document.get("temperature", ())
            for row in common:
                rows.append(_make_table(row))
            model = document.get("model") if not len(rows) else None
        if model is not None:
            named = {"tag": model.get("temperature", ModelSection().temperature), "model": model.get("path")}
            rows.append(_make_table({**named, "correction": model.get("correction")}))
        own["temperature"] = rows
    rows = own["temperature"]
    if not isinstance(rows, AoT):
        raise ConfigError(["temperature: is written as a plain list; write each as a [[temperature]] table"])
    if (found := next((row for row in rows if row.get("tag") == tag), None)) is not None:
        return found
    rows.append(_make_table({"tag": tag}))
    return rows[-1]


def _make_table(row: Mapping[str, Any]) -> Any:
    table = tomlkit.table()
    table.update({key: value for key, value in row.items() if value is not None})
    return table


def save(device: Edit | None, plant: Edit | None) -> list[Path]:
    """Check both files and put them in their places, the device file first; gives the backups.

    Raises ConfigError (for the plant file: the device file stands then) or OSError.
    """
    written = device is not None and device.has_changes
    backups = [commit(device, load_device)] if device is not None and written else []
    if plant is not None and plant.has_changes:
        so_far = f"{device.path} is written" if device is not None and written else "nothing was written"
        backups.append(commit(plant, load_plant, so_far=so_far))
    return [path for path in backups if path is not None]


def split_settings(pairs: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """--keep KEY=VALUE: (settings of the device, keys of the plant file, which have a dot). Raises ConfigError."""
    plant = {key: value for key, value in pairs.items() if "." in key}
    for key in plant:
        section, *rest = key.split(".")
        if not all((section, *rest)) or (len(rest) < 2 if section == "temperature" else len(rest) != 1):
            raise ConfigError(
                [
                    f"--keep {key}: give section.key of the plant file, such as scan.period=1.0, or "
                    "temperature.TAG.key, such as temperature.TFeed.model=models/feed"
                ]
            )
    return {key: value for key, value in pairs.items() if "." not in key}, plant

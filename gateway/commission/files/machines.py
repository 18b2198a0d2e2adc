"""The machines of a plant file: adding and removing one; the file of a single machine becomes one of several."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import tomlkit

from drivers.settings import ConfigError
from gateway.commission.files.toml_edit import Edit, edit_file
from gateway.settings import load_plant


def with_machine(
    plant: Path, name: str, device: Mapping[str, Any], temperatures: Sequence[Mapping[str, Any]] = ()
) -> Edit:
    """The plant file with one more machine: `device` are the keys of its [machine.device], all else is the common one.

    A file of a single machine keeps what it says, as what is common, and gets a table with that machine's name. Raises
    ConfigError.
    """
    first = load_plant(plant)[0]
    if not first.several and first.machine == name:
        raise ConfigError([f"{plant}: has a machine {name!r} already, the only one; give the new one another name"])

    def change(document: tomlkit.TOMLDocument) -> None:
        rows: Any = document.get("machine")
        if rows is None:
            rows = tomlkit.aot()
            table = tomlkit.table()
            table["name"] = first.machine
            rows.append(table)
            # Its own device too: the common one is what the new machine's differs from.
            document["machine"] = rows
        table = tomlkit.table()
        table["name"] = name
        if device:
            own = tomlkit.table()
            own.update(device)
            table["device"] = own
        if temperatures:
            predicted = tomlkit.aot()
            for row in temperatures:
                one = tomlkit.table()
                one.update(row)
                predicted.append(one)
            table["temperature"] = predicted
        rows.append(table)

    return edit_file(plant, change)


def without_machine(plant: Path, name: str) -> Edit:
    """The plant file without a machine. Raises ConfigError for the last one, and for a name that is not there."""
    names = [config.machine for config in load_plant(plant)]
    if name not in names:
        raise ConfigError([f"{plant}: has no machine {name!r}; it has {', '.join(names)}"])
    if len(names) == 1:
        raise ConfigError([f"{plant}: {name!r} is its only machine; a gateway without one has nothing to do"])

    def change(document: tomlkit.TOMLDocument) -> None:
        rows: Any = document["machine"]
        del rows[names.index(name)]

    return edit_file(plant, change)

"""Several machines in one process: each a table with the options of the command line as its keys, and a name.

    [[machine]]
    name = "north"
    device = "decanter_plc.toml"
    port = 15020
    trace = "north.csv"

    [[machine]]
    name = "south"
    device = "decanter_plc.toml"
    behind = "north"     # the same port (and the same serial line), told apart by the unit
    unit = 2

What the command line itself says holds for every machine that does not say otherwise. Paths are relative to the file.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

from sim.plc.program import InputError, list_words, read_toml

OF_THE_PROCESS = frozenset(
    {"speed", "epoch", "monotonic", "cycle", "stdin", "control_port", "plant_file", "machine", "hold"}
)
"""Options that a machine cannot have for itself, by their parameters' names: there is one clock and one control."""


def machine_options(context: click.Context) -> list[dict[str, Any]]:
    """The options of each machine that the command line names, checked as those of a command line are; none if it names
    none. Raises InputError."""
    given: Mapping[str, Any] = context.params
    tables: list[tuple[str, Path, dict[str, Any]]] = []
    if given["plant_file"] is not None:
        path = given["plant_file"]
        data = read_toml(path, "a file of machines")
        rows = data.get("machine")
        if set(data) != {"machine"} or not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
            raise InputError(f"{path}: holds something else than [[machine]] tables; give one for each machine")
        tables += [(f"{path}: machine {number}", path.parent, row) for number, row in enumerate(rows, start=1)]
    for text in given["machine"]:
        pairs = [part.partition("=") for part in text.split(",")]
        if not all(key and equals for key, equals, _ in pairs):
            raise InputError(f"--machine: {text!r} is not readable; give name=north,device=FILE,port=15020")
        words: dict[str, Any] = {"true": True, "false": False}
        tables.append(("--machine", Path(), {key: words.get(value, value) for key, _, value in pairs}))
    defaults = {
        name: value
        for name, value in given.items()
        if context.get_parameter_source(name) is ParameterSource.COMMANDLINE and name not in OF_THE_PROCESS
    }
    machines: list[dict[str, Any]] = []
    for where, home, table in tables:
        name = table.get("name")
        if not isinstance(name, str) or not name:
            raise InputError(f"{where}: key 'name': is missing; give each machine a name of its own")
        if any(name == other["name"] for other in machines):
            raise InputError(f"{where}: key 'name': {name!r} is taken; give each machine a name of its own")
        arguments = _arguments(context.command, table, home, f"{where} ({name})")
        try:
            options = context.command.make_context(name, arguments, default_map=defaults).params
        except click.UsageError as error:
            raise InputError(f"{where} ({name}): {error.format_message()}") from None
        machines.append({**options, "name": name, **{key: given[key] for key in OF_THE_PROCESS}})
    return machines


def _arguments(command: click.Command, table: Mapping[str, Any], home: Path, where: str) -> list[str]:
    """The table as a command line would say it. Raises InputError for a key that is no option of a machine."""
    options = {
        name.removeprefix("--"): option
        for option in command.params
        if isinstance(option, click.Option) and option.name not in OF_THE_PROCESS and not option.is_eager
        if not option.hidden
        for name in option.opts
    }
    arguments: list[str] = []
    for key, value in table.items():
        if key == "name":
            continue
        option = options.get(key.replace("_", "-"))
        if option is None:
            raise InputError(f"{where}: key {key!r}: is not known; known are name, {list_words(sorted(options))}")
        values: Sequence[Any] = value if isinstance(value, list) else [value]
        if option.is_flag:
            if not isinstance(value, bool):
                raise InputError(f"{where}: key {key!r}: {value!r} is neither true nor false; give one of them")
            names = option.opts if value else option.secondary_opts
            arguments += names[:1]
            continue
        for one in values:
            shown = str(home / one) if isinstance(option.type, click.Path) and isinstance(one, str) else str(one)
            arguments += [option.opts[0], shown]
    return arguments

"""Where a running gateway can be asked, and what it keeps, also by a plant file that cannot be used any more.

To take an arming back, or to see how the gateway is, must not wait until a slip in a file is found: what is needed for
it are two or three paths, and they are taken from as much of the file as can be read.
"""

import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drivers.named_files import MOST_TOML_BYTES, contents, parse_toml
from drivers.settings import ConfigError
from gateway.settings.config import HistorianSection, historian_file, load_plant

_MOST_SPOILED = 100
"""Lines that are left out of a file that is no TOML until nothing more is expected of it."""
_LINE = re.compile(r"at line (\d+)")


@dataclass(frozen=True, slots=True)
class GatewayPlaces:
    """Of a gateway with a plant file: control `socket`, `historian`, `audit` log, and whether its machines have names.

    `problem` is why the file cannot be used; None for one that can.
    """

    socket: Path
    historian: Path
    audit: Path
    several: bool
    problem: ConfigError | None = None


def gateway_places(path: Path) -> GatewayPlaces:
    """The places by the plant file, or by what can still be read of it and the defaults. Never raises ConfigError."""
    try:
        first = load_plant(path)[0]
    except ConfigError as error:
        problem = error
    else:
        return GatewayPlaces(first.control_socket, first.historian.path, first.audit, first.several)
    tables, home = _readable(path), path.parent
    named = _path(tables, "historian", "path")
    # As for a file that can be used: the default, or where the records of former versions are.
    historian = historian_file(HistorianSection() if named is None else HistorianSection(path=named), home)
    socket, audit = _path(tables, "control", "path"), _path(tables, "writeback", "audit")
    return GatewayPlaces(
        socket=historian.with_suffix(".sock") if socket is None else home / socket,
        historian=historian,
        audit=historian.with_name("audit.sqlite") if audit is None else home / audit,
        several="machine" in tables,
        problem=problem,
    )


def _readable(path: Path) -> Mapping[str, Any]:
    """The tables of a TOML file without the lines at which its reading stops."""
    try:
        lines = contents(path, MOST_TOML_BYTES).decode(errors="replace").splitlines()
    except OSError:
        return {}
    for _ in range(_MOST_SPOILED):
        try:
            tables: Mapping[str, Any] = parse_toml("\n".join(lines))
        except tomllib.TOMLDecodeError as error:
            found = _LINE.search(str(error))
            # What is still open at the end begins nobody knows where: it is shortened until it is whole.
            at = int(found[1]) - 1 if found else len(lines) - 1
            if not 0 <= at < len(lines):
                break
            lines[at : at + 1] = [""] if found else []
        else:
            return tables
    return {}


def _path(tables: Mapping[str, Any], section: str, key: str) -> Path | None:
    table = tables.get(section)
    text = table.get(key) if isinstance(table, dict) else None
    return Path(text) if isinstance(text, str) and text else None

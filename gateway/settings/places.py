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

from drivers.driver import DRIVERS
from drivers.named_files import MOST_TOML_BYTES, contents, normal_path, parse_toml
from drivers.settings import ConfigError
from gateway.settings.config import FORMER_HISTORIAN, HistorianSection, historian_file, load_plant

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
    historian = historian_file(HistorianSection(), home) if named is None else home / named
    socket = _path(tables, "control", "path")
    return GatewayPlaces(
        socket=historian.with_suffix(".sock") if socket is None else home / socket,
        historian=historian,
        audit=_audit(tables, home, historian),
        several="machine" in tables,
        problem=problem,
    )


def named_files(plant: Path, contents: Mapping[Path, bytes]) -> Mapping[str, frozenset[Path]]:
    """Where the files of a gateway may lie by its plant file, by what they are to it; none of them has to be there.

    `contents` has the plant file and device files by their places. Of a model it is its file or its folder. What
    cannot be read names nothing.
    """
    home, document = plant.parent, _tables(contents.get(plant, b""))
    rows = document.get("machine")
    machines = [document, *(row for row in (rows if isinstance(rows, list) else ()) if isinstance(row, dict))]
    devices, models = set[Path](), set[Path]()
    for machine in machines:
        own = _table(machine, "device")
        for link in (own, *_rows(own, "links")):
            if not isinstance(file := link.get("file"), str):
                continue
            settings = _table(_tables(contents.get(place := normal_path(home / file), b"")), "device")
            driver = settings.get("driver")
            files = DRIVERS[driver].files if isinstance(driver, str) and driver in DRIVERS else frozenset[str]()
            # A link's own settings are relative to the plant file, those of the device file to that.
            named = [(place.parent, settings.get(key)) for key in files] + [(home, link.get(key)) for key in files]
            devices |= {
                place,
                *(normal_path(folder / name) for folder, name in named if isinstance(name, str) and name),
            }
        wanted = [_table(machine, "model").get("path"), *_names(_table(machine, "ensemble").get("members"))]
        wanted += [row.get("model") for row in _rows(machine, "temperature")]
        models |= {normal_path(home / name) for name in wanted if isinstance(name, str) and name}
    own_historian, users = _path(document, "historian", "path"), _path(document, "page", "users")
    key, heads = (_path(document, "writeback", name) for name in ("audit_key", "audit_heads"))
    # Where nothing is named the records are at the default, or where those of former versions are.
    historians = (
        {home / own_historian}
        if own_historian
        else {home / place for place in (HistorianSection().path, FORMER_HISTORIAN)}
    )
    audits = {_audit(document, home, historian) for historian in historians}
    keys = {home / key} if key else {audit.with_suffix(".key") for audit in audits}
    found = {
        "plant": {plant},
        "device": devices,
        "model": models,
        "accounts": {home / users} if users else {place.with_name("users.json") for place in historians},
        "key": keys,
        "public key": {place.with_suffix(".pub") for place in keys},
        "heads": {home / heads} if heads else {audit.with_suffix(".heads.jsonl") for audit in audits},
        "historian": historians,
        "audit": audits,
    }
    return {role: frozenset(map(normal_path, places)) for role, places in found.items()}


def _audit(tables: Mapping[str, Any], home: Path, historian: Path) -> Path:
    named = _path(tables, "writeback", "audit")
    return historian.with_name("audit.sqlite") if named is None else home / named


def _tables(content: bytes) -> Mapping[str, Any]:
    try:
        return parse_toml(content.decode())
    except (UnicodeDecodeError, tomllib.TOMLDecodeError):
        return {}


def _table(tables: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    table = tables.get(name)
    return table if isinstance(table, dict) else {}


def _rows(tables: Mapping[str, Any], name: str) -> list[Mapping[str, Any]]:
    return [row for row in _names(tables.get(name)) if isinstance(row, dict)]


def _names(value: object) -> list[Any]:
    return value if isinstance(value, list) else []


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
    text = _table(tables, section).get(key)
    return Path(text) if isinstance(text, str) and text else None

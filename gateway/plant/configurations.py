"""The configurations that a gateway has taken over, each kept with the files that it was made of.

They lie in the folder `configurations` beside the historian, numbered; each is a backup (`gateway.store.make_backup`)
of the plant file, the device files and what those name. What is taken over unchanged is not kept twice.
"""

from __future__ import annotations

import difflib
import re
import shutil
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from drivers.driver import capabilities
from drivers.named_files import normal_path
from gateway.settings import Config, named_files
from gateway.store import DAMAGED_AUDIT, ROLES, BackupError, Manifest, damaged_audit, make_backup, read_manifest

FOLDER = "configurations"
MOST_KEPT = 200
"""Configurations that are kept; of more the oldest go. A plant's take some ten kilobytes each."""
_NUMBER = re.compile(r"\d{4,9}")


@dataclass(frozen=True, slots=True)
class KeptConfiguration:
    """One configuration that was taken over: its number, its folder, and what is said of it."""

    number: int
    folder: Path
    manifest: Manifest

    @property
    def files(self) -> dict[Path, bytes]:
        """What was in each file, by the place where it lay. Raises OSError."""
        return {Path(file.original): (self.folder / file.stored).read_bytes() for file in self.manifest.files}


def history_folder(config: Config) -> Path:
    """Where the configurations of a gateway are kept."""
    return config.historian.path.with_name(FOLDER)


def configuration_files(machines: Sequence[Config]) -> list[tuple[str, Path]]:
    """The files that a gateway's configuration is made of, with what each is to it; the plant file first."""
    rows: list[tuple[str, Path]] = [("plant", machines[0].path)]
    for link in (link for machine in machines for link in machine.links):
        rows.append(("device", link.map.path))
        named = [link.settings.get(key) for key in capabilities(link.map.driver).files]
        rows += [("device", Path(name)) for name in named if isinstance(name, str) and Path(name).is_file()]
    return list({normal_path(file): (role, file) for role, file in rows}.values())


def kept_configurations(folder: Path) -> list[KeptConfiguration]:
    """All that are kept and whole, the oldest first. One that is damaged is left out. Raises OSError."""
    return list(_whole(_list_folders(folder)))


def _whole(folders: Iterable[Path]) -> Iterator[KeptConfiguration]:
    for path in folders:
        with suppress(BackupError):
            yield KeptConfiguration(int(path.name), path, read_manifest(path))


def keep_files(folder: Path, files: Sequence[tuple[str, Path]], *, now: float, note: str) -> KeptConfiguration | None:
    """Keep the files, unless they are as in the newest configuration; `note` is why. Raises BackupError or OSError."""
    numbered = _list_folders(folder)
    newest = next(_whole(reversed(numbered)), None)
    present = {normal_path(file): file.read_bytes() for _, file in files}
    if newest is not None and newest.files == present:
        return None
    number = int(numbered[-1].name) + 1 if numbered else 1
    folder.mkdir(parents=True, exist_ok=True)
    target = folder / f"{number:04d}"
    manifest = make_backup(target, files, now=now, program=version("decanter-gateway"), note=note)
    for old in [*numbered, target][:-MOST_KEPT]:
        shutil.rmtree(old)
    return KeptConfiguration(number, target, manifest)


def keep_configuration(machines: Sequence[Config], *, now: float, note: str) -> KeptConfiguration | None:
    """Keep what the machines have been configured by; None where that is kept already.

    Raises BackupError or OSError, also where the plant file has been changed since it was read.
    """
    first = machines[0]
    if first.path.stat().st_mtime != first.stamp:
        raise BackupError(f"{first.path}: was changed after it had been read; it is kept when it is taken over")
    return keep_files(history_folder(first), configuration_files(machines), now=now, note=note)


def require_named_places(
    manifest: Manifest, plant: Path, contents: Mapping[Path, bytes], *, roles: Container[str] = ROLES
) -> None:
    """Raise BackupError unless each file of a backup has one of the roles, and lies where the `plant` file in it says.

    `contents` has at least its plant file and device files by their places.
    """
    named = named_files(plant, contents)
    named = {**named, DAMAGED_AUDIT: frozenset(map(damaged_audit, named["audit"]))}
    for file in manifest.files:
        place, known = Path(file.original), named.get(file.role, frozenset[Path]())
        # A store of models is a folder.
        below = file.role == "model" and not known.isdisjoint(place.parents)
        if file.role not in roles or (place not in known and not below):
            raise BackupError(
                f"the backup has {file.original!r} as {file.role!r}, which the plant file in it, {plant}, does not "
                "name; nothing is restored, take another backup"
            )


def differences(before: Mapping[Path, bytes], after: Mapping[Path, bytes], names: tuple[str, str]) -> Iterator[str]:
    """What differs between the files of two configurations, as the lines of a unified diff."""
    for path in dict.fromkeys((*before, *after)):
        old, new = (files.get(path, b"").decode(errors="replace").splitlines() for files in (before, after))
        titles = [
            f"{path} ({name})" if path in files else "/dev/null"
            for name, files in zip(names, (before, after), strict=True)
        ]
        yield from difflib.unified_diff(old, new, titles[0], titles[1], lineterm="")


def without_arming(plant: bytes) -> bytes:
    """A plant file in which nothing is armed: an arming is given by a person, never by a file that comes back.

    Raises BackupError for what is no TOML.
    """
    # Here: a running gateway keeps its files and edits none.
    import tomlkit
    from tomlkit.exceptions import TOMLKitError

    try:
        document: Any = tomlkit.parse(plant.decode())
    except (TOMLKitError, UnicodeDecodeError) as error:
        raise BackupError(f"the plant file cannot be read: {error}") from None
    rows = document.get("machine", [])
    for table in (document, *(rows if isinstance(rows, list) else ())):
        section = table.get("writeback")
        if isinstance(section, dict) and section.get("mode") == "armed":
            section["mode"] = "shadow"
    return tomlkit.dumps(document).encode()


def _list_folders(folder: Path) -> list[Path]:
    """The folders of configurations, the oldest first."""
    if not folder.is_dir():
        return []
    return sorted((path for path in folder.iterdir() if _NUMBER.fullmatch(path.name)), key=lambda path: int(path.name))

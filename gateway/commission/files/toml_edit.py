"""TOML files changed in place: comments and order stay; a change is shown, checked, and written whole or not at all."""

import difflib
import os
import re
import time
import tomllib
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tomlkit
from tomlkit.exceptions import TOMLKitError

from drivers.named_files import name_write_errors
from drivers.settings import ConfigError, read_toml

_CROWDED = re.compile(r"^([^\n#\[ \t][^\n]*|[\])}][^\n]*)\n(?=\[)", re.MULTILINE)
_WIDE = re.compile(r"\n{3,}(?=\[)")
Change = Callable[[tomlkit.TOMLDocument], None]


@dataclass(frozen=True, slots=True)
class Edit:
    """A change of one file that is not written yet; `before` is None for a new file."""

    path: Path
    before: str | None
    after: str

    @property
    def has_changes(self) -> bool:
        """False where the file says it all already."""
        return self.before != self.after

    def diff(self) -> str:
        """The change as a unified diff; "" without one."""
        old, new = (self.before or "").splitlines(), self.after.splitlines()
        before = "(new)" if self.before is None else str(self.path)
        return "\n".join(difflib.unified_diff(old, new, before, str(self.path), n=2, lineterm=""))


def edit_file(path: Path, change: Change, starter: str = "") -> Edit:
    """The file with the change, or where there is none `starter` with it. Raises ConfigError for what is not TOML."""
    before = None
    if path.exists():
        read_toml(path)  # its errors are sentences with the line
        before = path.read_bytes().decode("utf-8")
    try:
        document = tomlkit.parse(starter if before is None else before)
        change(document)
        after = tomlkit.dumps(document).rstrip("\n") + "\n"
        # One blank line before each table; more of them only where the file has such already.
        spaced = _CROWDED.sub(r"\1\n\n", after)
        spaced = spaced if before is not None and _WIDE.search(before) else _WIDE.sub("\n\n", spaced)
        # A line of a multi-line string may look like a table: then the text stays as it is.
        after = spaced if tomllib.loads(spaced) == tomllib.loads(after) else after
    except TOMLKitError as error:
        raise ConfigError([f"{path}: cannot be changed ({error}); correct that place by hand"]) from None
    if before is not None and "\r\n" in before:
        after = after.replace("\r\n", "\n").replace("\n", "\r\n")
    return Edit(path, before, after)


def commit(
    edit: Edit,
    check: Callable[[Path], object],
    now: Callable[[], float] = time.time,
    *,
    so_far: str = "nothing was written",
) -> Path | None:
    """Check the new content, keep the old one beside it, and put the new one in its place in one step.

    `check` reads the new content under another name in the same folder, and raises ConfigError for what cannot be
    used; then nothing is changed, and the error says with `so_far` what the whole command has written until then. Gives
    the backup's path, None for a new file. Raises ConfigError or OSError.
    """
    path = edit.path
    path.parent.mkdir(parents=True, exist_ok=True)
    fresh = path.with_name(f".{path.name}.{os.getpid()}.new")
    try:
        # A web hook in a plant file may hold a token: who may not read the file may not read a copy of it.
        mode = path.stat().st_mode & 0o777 if path.exists() else 0o666
        _write(fresh, edit.after, mode)
        try:
            check(fresh)
        except ConfigError as error:
            # The sentences are about the file that the person knows, not about the copy that was checked.
            problems = [problem.replace(str(fresh), str(path)) for problem in error.problems]
            raise ConfigError([f"{problem} ({so_far})" for problem in problems]) from None
        # As late as can be: what somebody else saved since the file was read must not be lost.
        if (path.read_bytes().decode("utf-8") if path.exists() else None) != edit.before:
            raise ConfigError([f"{path}: was changed by somebody else meanwhile; {so_far}, try again"])
        backup = None
        if edit.before is not None:
            # The old content beside the file, under the time of the change; a second change in it gets a number.
            stamp = time.strftime("%Y%m%d-%H%M%S", time.gmtime(now()))
            names = [f"{path.name}.{stamp}{f'-{count}' if count else ''}.bak" for count in range(1000)]
            backup = next(place for name in names if not (place := path.with_name(name)).exists())
            _write(backup, edit.before, mode)
            for copy in (fresh, backup):
                copy.chmod(mode)
        fresh.replace(path)
    finally:
        with suppress(FileNotFoundError):
            fresh.unlink()
    # The new name is on the disk only when the folder is (fsync(2), notes).
    folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)
    return backup


def _write(path: Path, text: str, mode: int) -> None:
    file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC, mode)
    with name_write_errors(path), os.fdopen(file, "wb") as stream:
        stream.write(text.encode("utf-8"))
        stream.flush()
        os.fsync(stream.fileno())


def set_key(table: Any, key: str, value: object) -> None:
    """Set one key, in its place where it is there already; None takes it out. An equal value stays as it is written."""
    if value is None:
        if key in table:
            del table[key]
    elif key not in table or table[key] != value or type(table.get(key)) is bool or isinstance(value, bool):
        table[key] = value

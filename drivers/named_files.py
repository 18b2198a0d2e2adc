"""Files that a person names: only what ends is read, and a number or a nesting of any size is told by its sentence.

The one owner of both for all floors. Whoever reads such a file says where it stands and what would be right.
"""

import re
import stat
import tomllib
from errno import EINVAL
from pathlib import Path
from typing import Any

MOST_DIGITS = 400
"""Digits in a row of a number that anything here can hold: a 64-bit float ends below 1e309."""

_KINDS = {stat.S_IFIFO: "a named pipe", stat.S_IFSOCK: "a socket", stat.S_IFCHR: "a device", stat.S_IFBLK: "a device"}
_DIGITS = re.compile(rf"\d{{{MOST_DIGITS + 1},}}", re.ASCII)


def regular(path: Path) -> Path:
    """The path itself, if it may be opened: a pipe is waited for without end, and a device need not end either.

    Raises OSError, with the reason in `strerror`, for those and as `stat` does. A directory is for `open` to refuse.
    """
    kind = _KINDS.get(stat.S_IFMT(path.stat().st_mode))
    if kind is not None:
        raise OSError(EINVAL, f"it is {kind}, not a file", str(path))
    return path


def endless_number(text: str) -> str:
    """What is wrong with the first number of more than MOST_DIGITS digits in a row, with its line; "" without one."""
    # Python refuses int() of more than 4300 digits and needs time in their square below: looked for beforehand.
    found = _DIGITS.search(text)
    if found is None:
        return ""
    line = text.count("\n", 0, found.start()) + 1
    return f"line {line} has a number of {len(found[0])} digits, and {MOST_DIGITS} are the most; shorten it"


def parse_toml(text: str) -> dict[str, Any]:
    """The content of a TOML text. Raises TOMLDecodeError also for what tomllib has no error of its own for."""
    if problem := endless_number(text):
        raise tomllib.TOMLDecodeError(problem)
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise tomllib.TOMLDecodeError("lists or tables are nested too deep to be read") from None

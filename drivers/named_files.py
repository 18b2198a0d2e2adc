"""Files that a person names: only what ends is read, and a size, number or nesting of any size is told by its sentence.

The one owner of these bounds for all floors. Whoever reads such a file says where it stands and what would be right.
"""

import os
import re
import stat
import tomllib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from errno import EFBIG, EINVAL
from pathlib import Path
from typing import Any

MOST_DIGITS = 400
"""Digits in a row of a number that anything here can hold: a 64-bit float ends below 1e309."""
MOST_DEPTH = 64
"""Tables and lists within one another. The deepest document of ours has eight."""
MOST_BYTES = 64 << 20
"""Of a file that is held in memory whole."""
MOST_TOML_BYTES = 1 << 20
_MOST_DOTS = 200
_BESIDE_KEYS = re.compile(r"[=,#{}\n]")

_KINDS = {stat.S_IFIFO: "a named pipe", stat.S_IFSOCK: "a socket", stat.S_IFCHR: "a device", stat.S_IFBLK: "a device"}
_DIGITS = re.compile(rf"\d{{{MOST_DIGITS + 1},}}", re.ASCII)


@contextmanager
def name_write_errors(path: str | Path) -> Iterator[None]:
    """Names the file in an OSError that has none: a disk that is full says so when bytes go out, not on opening."""
    try:
        yield
    except OSError as error:
        if error.filename is None:
            error.filename = str(path)
        raise


def regular(path: Path) -> Path:
    """The path itself, if it may be opened: a pipe is waited for without end, and a device need not end either.

    Raises OSError, with the reason in `strerror`, for those and as `stat` does. A directory is for `open` to refuse.
    """
    kind = _KINDS.get(stat.S_IFMT(path.stat().st_mode))
    if kind is not None:
        raise OSError(EINVAL, f"it is {kind}, not a file", str(path))
    return path


def normal_path(path: Path) -> Path:
    """The whole path without `..`, by the name alone: nothing has to be there."""
    return Path(os.path.normpath(path.absolute()))


def contents(path: Path, most: int = MOST_BYTES) -> bytes:
    """All bytes of a file that has at most `most` of them. Raises OSError, with the reason in `strerror`."""
    with regular(path).open("rb") as stream:
        # Not more than was there at a look, as room is made for all that is asked; one byte more, as it may have grown.
        data = stream.read(min(most, os.fstat(stream.fileno()).st_size) + 1)
    if len(data) > most:
        raise OSError(EFBIG, f"it has more than {most >> 20} MiB, which is too much to be read at once", str(path))
    return data


def decode_text(data: bytes) -> str:
    """What other people's programs write: UTF-8 where the bytes are, UTF-16 where they say so, else Windows-1252.

    A byte that even that has no sign for becomes the sign for one; what is meant by it, nobody knows.
    """
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return data.decode("utf-16", errors="replace")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("cp1252", errors="replace")


def endless_number(text: str) -> str:
    """What is wrong with the first number of more than MOST_DIGITS digits in a row, with its line; "" without one."""
    # Python refuses int() of more than 4300 digits and needs time in their square below: looked for beforehand.
    found = _DIGITS.search(text)
    if found is None:
        return ""
    line = text.count("\n", 0, found.start()) + 1
    return f"line {line} has a number of {len(found[0])} digits, and {MOST_DIGITS} are the most; shorten it"


def unusable(document: object) -> str:
    """What of a parsed document (tables, lists, texts, numbers) no program here can hold; "" if all of it can be.

    A nesting beyond MOST_DEPTH, a whole number beyond MOST_DIGITS hexadecimal digits, a text that is no Unicode.
    """
    # Level by level and not by recursion, which a document could exhaust: so can comparing, copying or printing it.
    level: list[object] = [document]
    for _ in range(MOST_DEPTH):
        below: list[object] = []
        for value in level:
            if isinstance(value, Mapping):
                below += [*value.keys(), *value.values()]
            elif isinstance(value, list):
                below += value
            elif isinstance(value, int) and value.bit_length() > 4 * MOST_DIGITS:
                return f"a number has more than {MOST_DIGITS} hexadecimal digits; shorten it"
            # JSON's escapes can write half of a surrogate pair, which no file and no terminal takes.
            elif isinstance(value, str) and not value.isascii() and any("\ud800" <= c <= "\udfff" for c in value):
                return f"the text {value[:40]!a} holds half a surrogate pair, which is no character; take it out"
        if not below:
            return ""
        level = below
    return f"lists or tables are nested more than {MOST_DEPTH} deep, which is too deep to be read; flatten them"


def parse_toml(text: str) -> dict[str, Any]:
    """The content of a TOML text. Raises TOMLDecodeError also for what tomllib has no error of its own for."""
    if len(text) > MOST_TOML_BYTES:
        raise tomllib.TOMLDecodeError(f"it has more than {MOST_TOML_BYTES >> 20} MiB, which no such file needs")
    # tomllib needs time in the square of a dotted key's parts: looked for beforehand, as are endless numbers.
    if deep := next((piece for piece in _BESIDE_KEYS.split(text) if piece.count(".") > _MOST_DOTS), ""):
        line = text.count("\n", 0, text.index(deep)) + 1
        raise tomllib.TOMLDecodeError(f"line {line} has {deep.count('.')} dots in a row; tables are nested too deep")
    if problem := endless_number(text):
        raise tomllib.TOMLDecodeError(problem)
    try:
        document = tomllib.loads(text)
    except RecursionError:
        raise tomllib.TOMLDecodeError("lists or tables are nested too deep to be read") from None
    except tomllib.TOMLDecodeError:
        raise
    except ValueError as error:  # a number of 4301 digits with underscores between them, a date that is none
        raise tomllib.TOMLDecodeError(str(error)) from None
    if problem := unusable(document):
        raise tomllib.TOMLDecodeError(problem)
    return document

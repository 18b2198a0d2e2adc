"""Strict JSON as everything here writes it: what JSON has no word for becomes null, a plain value or a text.

The one owner of that for all floors above the drivers. It needs neither numpy nor any other package.
"""

import json
from collections import deque
from collections.abc import Mapping
from dataclasses import asdict, fields, is_dataclass
from functools import lru_cache
from math import isfinite
from typing import Any


def strict(value: object) -> Any:
    """The value in JSON's own types.

    Infinite and undefined numbers become null (JSON has no word for them, and `NaN` is refused by strict readers),
    dataclasses and mappings objects, numpy's scalars and arrays Python's numbers and lists, and anything else its text.
    """
    # Most of what comes is plain, and to ask for that is a tenth of asking what else it might be.
    if value is None or type(value) in (str, int, bool):
        return value
    if is_dataclass(value) and not isinstance(value, type):
        return strict(asdict(value))
    if hasattr(value, "tolist"):  # numpy's scalars and arrays, told by what they can do: numpy is not imported for it
        value = value.tolist()
    if isinstance(value, float):
        return value if isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): strict(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple | deque):
        return [strict(inner) for inner in value]
    return value if value is None or isinstance(value, str | int) else str(value)


def escape_text(value: Any) -> Any:
    """A text with every character that is not printable as its escape (`\\n`, `\\x1b`); anything else as it is.

    Texts in lists and mappings too, keys among them.
    """
    if value is None or type(value) in (int, float, bool):
        return value
    if isinstance(value, str):
        if value.isprintable():
            return value
        return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in value)
    if isinstance(value, Mapping):
        return {escape_text(key): escape_text(inner) for key, inner in value.items()}
    return [escape_text(inner) for inner in value] if isinstance(value, list | tuple) else value


def shallow_dict(value: Any) -> Any:
    """A dataclass as `dataclasses.asdict` gives it, but with what it holds itself and no copies: to be written at once.

    Those in its lists, tuples and mappings too.
    """
    if value is None or type(value) in (str, float, int, bool):
        return value
    if is_dataclass(value) and not isinstance(value, type):
        return {field.name: shallow_dict(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, tuple):
        return tuple(shallow_dict(inner) for inner in value)
    if isinstance(value, list):
        return [shallow_dict(inner) for inner in value]
    if isinstance(value, Mapping):
        return {key: shallow_dict(inner) for key, inner in value.items()}
    return value


def json_text(value: object, *, indent: int | None = None, sort_keys: bool = False) -> str:
    """The value as strict JSON, without a line break at its end; on one line unless an indent is given."""
    return _encoder(indent, sort_keys=sort_keys).encode(strict(value))


@lru_cache(maxsize=16)
def _encoder(indent: int | None, *, sort_keys: bool) -> json.JSONEncoder:
    """What `json.dumps` makes anew at each call: a row of the audit log is a text at every scan."""
    return json.JSONEncoder(indent=indent, sort_keys=sort_keys, ensure_ascii=False, allow_nan=False)

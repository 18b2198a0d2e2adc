"""Input that cannot be used comes back as one sentence: file or command, key, reason, what would be right."""

import inspect
import tomllib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

from pydantic import BaseModel, ConfigDict, TypeAdapter, ValidationError

from drivers.device_file import DeviceFile, read_device_file
from drivers.errors import OneLineError
from drivers.named_files import endless_number, parse_toml, regular
from drivers.settings import ConfigError, error_reason, sentences


class InputError(OneLineError, ValueError):
    """A file, an argument or a command that the PLC cannot use; the message is for the one who wrote it."""


class FileTable(BaseModel):
    """A table of a TOML or JSON file: unknown keys and wrong types are refused. A field's description is its remedy."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


E = TypeVar("E", bound=FileTable)


def read_text(path: Path, what: str) -> str:
    """The file as UTF-8 text (a byte order mark is dropped). Raises InputError."""
    try:
        text = regular(path).read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such file; give the path of {what}") from None
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: byte {error.start} is not UTF-8; save the file as UTF-8") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); make it a file that this user can read") from None
    if problem := endless_number(text):
        raise InputError(f"{path}: {problem}")
    return text


def read_toml(path: Path, what: str) -> dict[str, Any]:
    """The TOML file's content. Raises InputError, with the line where TOML has one."""
    try:
        return parse_toml(read_text(path, what))
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path}: is not TOML: {error}; correct that place") from None


def read_device(path: Path) -> DeviceFile:
    """The device file in `path` by the gateway's own schema. Raises InputError about the first thing that is wrong."""
    try:
        return read_device_file(path)
    except ConfigError as error:
        raise InputError(error.problems[0]) from None


def validate_entry(entry: type[E], data: object, where: str) -> E:
    """`data` as an `entry`. Raises InputError about the first thing that is wrong, naming `where` and the key."""
    try:
        return entry.model_validate(data)
    except ValidationError as error:
        raise InputError(sentences(entry, error, where)[0]) from None


def list_words(words: Sequence[str]) -> str:
    """The words in a row, as a sentence wants them."""
    return ", ".join(words) if words else "none"


def keyword_signature(function: Callable[..., object]) -> list[str]:
    """The keyword parameters of a table's function, with their defaults, as documentation prints them."""
    return [p.name if p.default is p.empty else f"{p.name} = {p.default!r}" for p in _keywords(function)]


def checked_arguments(function: Callable[..., object], values: Mapping[str, object], where: str) -> dict[str, Any]:
    """`values` as the function's keyword arguments, checked against its annotations. Raises InputError."""
    known = _keywords(function)
    names = [parameter.name for parameter in known]
    if unknown := [name for name in values if name not in names]:
        raise InputError(f"{where}: {unknown[0]}: there is no such key; known are {list_words(names)}")
    if missing := [p.name for p in known if p.default is p.empty and p.name not in values]:
        raise InputError(f"{where}: {missing[0]}: is missing; it must be given")
    hints = get_type_hints(function)
    arguments = {}
    for name, value in values.items():
        hint = hints[name]
        try:
            adapter = TypeAdapter(hint, config=ConfigDict(allow_inf_nan=False))
            arguments[name] = adapter.validate_python(value, strict=True)
        except ValidationError as error:
            details = error.errors()  # one for each member of a union: none of them alone is the reason
            reason = error_reason(details[0]) if len(details) == 1 else f"fits none of {hint}"
            raise InputError(f"{where}: {name}: {reason}, got {value!r}") from None
    return arguments


def _keywords(function: Callable[..., object]) -> list[inspect.Parameter]:
    parameters = inspect.signature(function).parameters.values()
    return [parameter for parameter in parameters if parameter.kind is parameter.KEYWORD_ONLY]

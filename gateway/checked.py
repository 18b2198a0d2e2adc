"""TOML in, checked values out; what is wrong comes back as sentences, all of them at once."""

import difflib
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar, get_args

from pydantic import BaseModel, ConfigDict, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails


class ConfigError(ValueError):
    """The configuration cannot be used. `problems` has one sentence each: file, key, reason, what would be right."""

    def __init__(self, problems: Sequence[str]) -> None:
        super().__init__("\n".join(problems))
        self.problems = tuple(problems)


class Section(BaseModel):
    """A table of a TOML file: unknown keys and wrong types are refused. A field's description is its remedy."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


S = TypeVar("S", bound=BaseModel)


def read_toml(path: Path) -> dict[str, Any]:
    """The file's content. Raises ConfigError, with the line where TOML has one."""
    try:
        with path.open("rb") as stream:
            return tomllib.load(stream)
    except FileNotFoundError:
        raise ConfigError([f"{path}: there is no such file; give the path of an existing TOML file"]) from None
    except OSError as error:
        raise ConfigError(
            [f"{path}: cannot be read ({error.strerror}); give a TOML file that this user can read"]
        ) from None
    except UnicodeDecodeError as error:
        raise ConfigError([f"{path}: byte {error.start} is not UTF-8; save the file as UTF-8"]) from None
    except tomllib.TOMLDecodeError as error:
        raise ConfigError([f"{path}: is not TOML: {error}; correct that place"]) from None


def checked(section: type[S], data: Mapping[str, Any], file: Path) -> S:
    """`data` as a `section`. Raises ConfigError with one sentence for each thing that is wrong."""
    try:
        return section.model_validate(data)
    except ValidationError as error:
        raise ConfigError([_sentence(section, detail, file) for detail in error.errors()]) from None


def _sentence(section: type[BaseModel], detail: ErrorDetails, file: Path) -> str:
    """file: key: reason; remedy."""
    place = detail["loc"]
    key = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in place).lstrip(".")
    if detail["type"] == "extra_forbidden":
        return f"{file}: {key}: there is no such key; {_nearest(_section_at(section, place[:-1]), str(place[-1]))}"
    remedy = _remedy(section, place)
    if detail["type"] == "missing":
        return f"{file}: {key}: is missing; {remedy or 'add it'}"
    reason = detail["msg"].removeprefix("Value error, ").removeprefix("Input should be ")
    if detail["type"] == "value_error":
        return f"{file}: {key}: {reason}" if key else f"{file}: {reason}"
    return f"{file}: {key}: must be {reason}, got {_short(detail['input'])}; {remedy or 'correct the value'}"


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 40 else text[:37] + "..."


def _nearest(section: type[BaseModel] | None, key: str) -> str:
    known = list(section.model_fields) if section else []
    close = difflib.get_close_matches(key, known, n=1, cutoff=0.5)
    return f"did you mean {close[0]!r}?" if close else f"known are {', '.join(known)}"


def _field_at(section: type[BaseModel], place: Sequence[str | int]) -> FieldInfo | None:
    parent = _section_at(section, place[:-1])
    return parent.model_fields.get(str(place[-1])) if parent and place else None


def _section_at(section: type[BaseModel], place: Sequence[str | int]) -> type[BaseModel] | None:
    """The model that lies at `place` below `section`, through lists and optional values."""
    if not place:
        return section
    if isinstance(place[-1], int):
        return _section_at(section, place[:-1])
    field = _field_at(section, place)
    return _model_in(field.annotation) if field else None


def _model_in(annotation: object) -> type[BaseModel] | None:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next((found for part in get_args(annotation) if (found := _model_in(part))), None)


def _remedy(section: type[BaseModel], place: Sequence[str | int]) -> str:
    names = [part for part in place if isinstance(part, str)]
    field = _field_at(section, names)
    return f"give {field.description}" if field and field.description else ""

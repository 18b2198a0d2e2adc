"""TOML in, checked settings out; what is wrong comes back as sentences: file, key, reason, what would be right.

It is the only place where such a sentence is made. A field's description is its remedy.
"""

import difflib
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_args

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from drivers.errors import DriverError


class ConfigError(ValueError):
    """The configuration cannot be used. `problems` has one sentence each: file, key, reason, what would be right."""

    def __init__(self, problems: Sequence[str]) -> None:
        super().__init__("\n".join(problems))
        self.problems = tuple(problems)


class Section(BaseModel):
    """A table of a TOML file: unknown keys and wrong types are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


Text = Annotated[str, Field(min_length=1)]


class Reconnecting(Section):
    """Settings of every driver that keeps a connection: the pauses between its attempts (see `drivers.link`)."""

    backoff_first: float = Field(
        0.2, ge=0.001, le=5.0, description="the seconds before the second attempt to connect, 0.001 to 5"
    )
    backoff_cap: float = Field(
        0.5, ge=0.001, le=5.0, description="the most seconds between two attempts to connect, 0.001 to 5"
    )


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
        raise ConfigError(sentences(section, error, str(file))) from None


def check_settings(driver: str, section: type[S], settings: Mapping[str, Any]) -> S:
    """A driver's settings; None stands for a key that is not given.

    Raises DriverError with the first thing that is wrong, in one sentence.
    """
    given = {key: value for key, value in settings.items() if value is not None}
    try:
        return section.model_validate(given)
    except ValidationError as error:
        raise DriverError(sentences(section, error, driver)[0]) from None


def sentences(section: type[BaseModel], error: ValidationError, place: str) -> list[str]:
    """What is wrong with the data of a `section`, each as `place: key: reason; what would be right`."""
    return [_sentence(section, detail, place) for detail in error.errors(include_url=False)]


def _sentence(section: type[BaseModel], detail: ErrorDetails, place: str) -> str:
    loc = detail["loc"]
    key = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in loc).lstrip(".")
    if detail["type"] == "extra_forbidden":
        return f"{place}: {key}: there is no such key; {_nearest(_section_at(section, loc[:-1]), str(loc[-1]))}"
    remedy = _remedy(section, loc)
    if detail["type"] == "missing":
        return f"{place}: {key}: is missing; {remedy or 'add it'}"
    if detail["type"] == "value_error":
        reason = detail["msg"].removeprefix("Value error, ")
        return f"{place}: {key}: {reason}" if key else f"{place}: {reason}"
    return f"{place}: {key}: {_reason(detail)}, got {_short(detail['input'])}; {remedy or 'correct the value'}"


_REASONS = {
    "int_type": "must be a whole number",
    "float_type": "must be a number",
    "string_type": "must be text",
    "bool_type": "must be true or false",
    "dict_type": "must be a table",
    "model_type": "must be a table",
    "list_type": "must be a list",
    "tuple_type": "must be a list",
    "greater_than_equal": "must be at least {ge:g}",
    "less_than_equal": "must be at most {le:g}",
    "greater_than": "must be more than {gt:g}",
    "less_than": "must be less than {lt:g}",
    "string_too_short": "must have {min_length} characters or more",
    "too_short": "must have {min_length} entries or more",
    "too_long": "must have {max_length} entries or fewer",
}
"""pydantic's kinds of errors in words that need no Python; its own words serve for the rest."""


def _reason(detail: ErrorDetails) -> str:
    if detail["input"] in ("", []) and detail["type"] in ("string_too_short", "too_short"):
        return "must not be empty"
    if detail["type"] in _REASONS:
        return _REASONS[detail["type"]].format(**detail.get("ctx", {}))
    # pydantic says "Input should be ...", "String should match ...": the key takes the place of the subject.
    _, should, rest = detail["msg"].partition(" should ")
    return f"must {rest}" if should else detail["msg"][0].lower() + detail["msg"][1:]


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 40 else text[:37] + "..."


def _nearest(section: type[BaseModel] | None, key: str) -> str:
    known = list(section.model_fields) if section else []
    close = difflib.get_close_matches(key, known, n=1, cutoff=0.6)
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

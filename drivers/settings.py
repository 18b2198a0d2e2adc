"""TOML in, checked settings out; what is wrong comes back as sentences: file, key, reason, what would be right.

It is the only place where such a sentence is made. A field's description is its remedy.
"""

import re
import tomllib
from collections.abc import Mapping, Sequence
from ipaddress import AddressValueError, IPv4Address, IPv6Address
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_args, get_origin
from unicodedata import bidirectional, category

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, ValidationInfo
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from drivers.errors import DriverError, did_you_mean, one_sentence
from drivers.named_files import MOST_TOML_BYTES, contents, parse_toml
from drivers.toml_slips import toml_remedy

MOST_CHARACTERS = 2500
"""Characters of all problems of a configuration that are said at a time."""


class ConfigError(ValueError):
    """The configuration cannot be used. `problems` has one sentence each: file, key, reason, what would be right.

    As text it says the first of them, where there are more than somebody reads, and how many more there are.
    """

    def __init__(self, problems: Sequence[str]) -> None:
        # Each is one line, whatever a key in the file is called.
        self.problems = tuple(map(one_sentence, problems))
        said = list[str]()
        for line in self.problems:
            if said and sum(map(len, said)) + len(line) > MOST_CHARACTERS:
                said.append(f"and {len(self.problems) - len(said)} more; mend these first")
                break
            said.append(line)
        super().__init__("\n".join(said))

    @property
    def in_one_line(self) -> str:
        """The text, where one line is wanted."""
        return "; ".join(str(self).split("\n"))


class Section(BaseModel):
    """A table of a TOML file: unknown keys and wrong types are refused."""

    # Most commands of the program import every section, and check a file by a few or none.
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False, defer_build=True)


Text = Annotated[str, Field(min_length=1)]


def _one_line(text: str) -> str:
    # Names, reasons and persons go into logs, records and terminals: a line break makes two rows of one there, and ESC
    # steers the terminal of whoever reads them.
    if not text.isprintable():
        raise ValueError(f"{text[:40]!r} is not one line of printable characters; take out what is not")
    return text


_ORDER_OF_READING = frozenset({"LRE", "RLE", "LRO", "RLO", "PDF", "LRI", "RLI", "FSI", "PDI"})
_NOT_IN_TEXT = frozenset({"Cc", "Cs", "Zl", "Zp"})


def is_in_names(character: str) -> bool:
    """Whether a name may hold a character: none that steers, breaks a line, turns what is read around, or is no text.

    A broker of MQTT ends the connection for one (MQTT 5, 1.5.4), and with it everybody's data.
    """
    code = ord(character)
    return not (
        category(character) in _NOT_IN_TEXT
        or bidirectional(character) in _ORDER_OF_READING
        or code & 0xFFFE == 0xFFFE
        or 0xFDD0 <= code <= 0xFDEF
    )


def _a_name(text: str) -> str:
    # A recording's columns may be called as they like, but for what other systems cannot be told.
    if not all(map(is_in_names, text)):
        raise ValueError(f"{text[:40]!r} is not one line without control characters; take out what is not")
    # In InfluxDB's line protocol nothing can stand for it there.
    if text.endswith("\\"):
        raise ValueError(f"{text[:40]!r} ends with a backslash; take it away")
    return text


_OTHER_PATH = re.compile(r"~|\$|%\w+%|[A-Za-z]:[\\/]|\\\\")
"""How paths begin that a shell or another system understands, and that here would be files of a strange name."""


def _in_its_home(path: Path, info: ValidationInfo) -> Path:
    if _OTHER_PATH.match(str(path)):
        raise ValueError(f"'{path}' is a path of a shell or of another system; write it out, with / between its parts")
    return path if info.context is None else info.context / path


Name = Annotated[str, Field(min_length=1, max_length=200), AfterValidator(_a_name)]
"""A tag's name: one line of 1 to 200 characters, none of control, not ending with a backslash."""
Label = Annotated[str, Field(max_length=200), AfterValidator(_a_name)]
"""What stands beside a number, as a unit: as a name is, or nothing."""
FilePath = Annotated[Path, Field(strict=False), AfterValidator(_in_its_home)]
"""A path, relative to the file that names it: `validate_section` makes it complete where it knows that file's
folder."""
Line = Annotated[str, Field(min_length=1, max_length=200), AfterValidator(_one_line)]
"""A person or a reason: one line of 1 to 200 printable characters."""


_SCHEME = re.compile(r"[a-z][a-z0-9+.-]*://", re.IGNORECASE)
_HOST = re.compile(r"[\w.:%-]+")
_NUMBERS = re.compile(r"[\d.,]+", re.ASCII)
_PORTS = re.compile(r"[^:]*:[\d:]*")
_PLACE = re.compile(r"(?:\[(?P<bracketed>[^\]\[]+)\]|(?P<plain>[^:\[\]]+))(?::(?P<port>\d{1,5}))?")


def split_place(host: str) -> tuple[str, int | None]:
    """A host as it is looked up, and the port that stands with it: `[::1]`, `plc.local:502`, `tcp://10.0.0.5:502/`.

    Raises ValueError for a port that is none, and for what can be no host; else it is left for whoever looks it up.
    """
    plain = _SCHEME.sub("", host.strip(), count=1).rstrip("/")
    match = _PLACE.fullmatch(plain)
    name = plain or host if match is None else match["bracketed"] or match["plain"]
    _refuse_no_host(name)
    if match is None or match["port"] is None:
        return name, None  # an IPv6 address without brackets, for one
    port = int(match["port"])
    if not 1 <= port <= 65535:
        raise ValueError(f"host {host!r} has port {port}; give one from 1 to 65535")
    return name, port


def _refuse_no_host(name: str) -> None:
    """Raises ValueError for what neither a name nor an address can be, however a system would complete it.

    Nothing at all is left for the one who says what a field must have.
    """
    if _NUMBERS.fullmatch(name) and not _is_address(IPv4Address, name):
        plain = re.sub(r"\b0+(?=\d)", "", name)
        remedy = "give four numbers from 0 to 255 with points"
        if _is_address(IPv4Address, plain):
            remedy = f"write its numbers without a 0 before them ({plain})"
        raise ValueError(f"host {name!r} is no IP address; {remedy}")
    if name and not _HOST.fullmatch(name):
        raise ValueError(f"host {name!r} holds what no name or address has; give the PLC's address or name")
    if _PORTS.fullmatch(name) and not _is_address(IPv6Address, name):
        raise ValueError(f"host {name!r} is no IPv6 address; give a port behind one colon, as in plc.local:502")


def _is_address(kind: type[IPv4Address | IPv6Address], text: str) -> bool:
    try:
        kind(text)
    except AddressValueError:
        return False
    return True


def with_place(settings: Mapping[str, Any]) -> dict[str, Any]:
    """The settings with their host as it is looked up, and the port that was written with it. Raises ValueError."""
    host, port = split_place(str(settings["host"]))
    if port is not None and settings.get("port", port) != port:
        raise ValueError(f"host says port {port}, and port is {settings['port']}; give one of them")
    return {**settings, "host": host, **({} if port is None else {"port": port})}


class Reconnecting(Section):
    """Settings of every driver that keeps a connection: the pauses between its attempts (see `drivers.link`)."""

    backoff_first: float = Field(
        0.2, ge=0.001, le=5.0, description="the seconds before the second attempt to connect, 0.001 to 5"
    )
    backoff_cap: float = Field(
        0.5, ge=0.001, le=5.0, description="the most seconds between two attempts to connect, 0.001 to 5"
    )


S = TypeVar("S", bound=BaseModel)
_ADDRESS = re.compile(r"[^/:\s]+:\d{1,5}|\[[0-9a-fA-F:]+\]:\d{1,5}")
"""A host and its port, which is taken for a file where one was asked for."""


def read_toml(path: Path) -> dict[str, Any]:
    """The file's content. Raises ConfigError, with the line where TOML has one."""
    text = ""
    try:
        text = contents(path, MOST_TOML_BYTES).decode()
        return parse_toml(text)
    except FileNotFoundError:
        what = "is an address and no file" if _ADDRESS.fullmatch(str(path)) else "there is no such file"
        raise ConfigError([f"{path}: {what}; give the path of an existing TOML file"]) from None
    except OSError as error:
        raise ConfigError(
            [f"{path}: cannot be read ({error.strerror}); give a TOML file that this user can read"]
        ) from None
    except UnicodeDecodeError as error:
        raise ConfigError([f"{path}: byte {error.start} is not UTF-8; save the file as UTF-8"]) from None
    except tomllib.TOMLDecodeError as error:
        raise ConfigError([f"{path}: is not TOML: {error}; {toml_remedy(text, str(error))}"]) from None


def validate_section(section: type[S], data: Mapping[str, Any], file: Path | str, *, home: Path | None = None) -> S:
    """`data` as a `section`, from a file or a place in it. Raises ConfigError, one sentence for each thing wrong.

    With the folder `home` each FilePath is completed by it.
    """
    try:
        return section.model_validate(data, context=home)
    except ValidationError as error:
        raise ConfigError(sentences(section, error, str(file))) from None


def check_settings(driver: str, section: type[S], settings: Mapping[str, Any]) -> S:
    """A driver's settings; None stands for a key that is not given.

    Raises DriverError with the first thing that is wrong, in one sentence.
    """
    present = {key: value for key, value in settings.items() if value is not None}
    try:
        return section.model_validate(present)
    except ValidationError as error:
        raise DriverError(sentences(section, error, driver)[0]) from None


def sentences(section: type[BaseModel], error: ValidationError, place: str) -> list[str]:
    """What is wrong with the data of a `section`, each as `place: key: reason; what would be right`."""
    return [_sentence(section, detail, place) for detail in error.errors(include_url=False)]


def first_sentence(section: type[BaseModel], error: ValidationError, place: str) -> str:
    """The one sentence that explains most: a slip in a key also makes the key that was meant a missing one."""
    found = sentences(section, error, place)
    return next((sentence for sentence in found if "did you mean" in sentence), found[0])


def _sentence(section: type[BaseModel], detail: ErrorDetails, place: str) -> str:
    unknown = detail["type"] == "extra_forbidden"
    key, models, field = _locate(section, detail["loc"], unknown=unknown)
    where = f"{place}: {key}" if key else place
    if unknown:
        known = list(dict.fromkeys(name for model in models for name in model.model_fields))
        remedy = did_you_mean(str(detail["loc"][-1]), known)
        return f"{where}: there is no such key; {remedy or 'known are ' + ', '.join(known)}"
    if detail["type"] == "value_error":
        return f"{where}: {detail['msg'].removeprefix('Value error, ')}"
    remedy = f"give {field.description}" if field and field.description else ""
    if detail["type"] == "missing":
        return f"{where}: is missing; {remedy or 'add it'}"
    value = repr(detail["input"])
    short = value if len(value) <= 40 else value[:37] + "..."
    return f"{where}: {error_reason(detail)}, got {short}; {remedy or 'correct the value'}"


_REASONS = {
    "int_type": "must be a whole number",
    "float_type": "must be a number",
    "string_type": "must be text",
    "int_parsing": "must be a whole number",
    "float_parsing": "must be a number",
    "union_tag_invalid": "{discriminator} must be one of {expected_tags}",
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


def error_reason(detail: ErrorDetails) -> str:
    """What is wrong with one value: "must be a whole number"."""
    if detail["input"] in ("", []) and detail["type"] in ("string_too_short", "too_short"):
        return "must not be empty"
    if detail["type"] in _REASONS:
        return _REASONS[detail["type"]].format(**detail.get("ctx", {}))
    # pydantic says "Input should be ...", "String should match ...": the key takes the place of the subject.
    _, should, rest = detail["msg"].partition(" should ")
    return f"must {rest}" if should else detail["msg"][0].lower() + detail["msg"][1:]


def _locate(
    section: type[BaseModel], loc: Sequence[str | int], *, unknown: bool
) -> tuple[str, Sequence[type[BaseModel]], FieldInfo | None]:
    """The key as the file has it, the models that may lie there, and the last field on the way.

    pydantic puts the member of a union that it has tried into the path, too; no file has that. The last part of the
    path of an `unknown` key is no field.
    """
    key, models, field, is_mapping = "", [section], None, False
    for number, part in enumerate(loc, start=1):
        if isinstance(part, int):
            key += f"[{part}]"
            continue
        own = next((model.model_fields[part] for model in models if part in model.model_fields), None)
        if own is not None and not is_mapping:
            key, field = f"{key}.{part}", own
            models, is_mapping = _annotation_models(own.annotation), get_origin(own.annotation) is dict
        elif is_mapping or not models or (unknown and number == len(loc)):
            key, is_mapping = f"{key}.{part}", False
        else:
            # The tag of a union's member: the model in which one field can be this word and no other.
            tagged = [m for m in models if any(get_args(f.annotation) == (part,) for f in m.model_fields.values())]
            models = tagged or models
    return key.lstrip("."), models, field


def _annotation_models(annotation: object) -> list[type[BaseModel]]:
    """All models that the annotation names, through lists, unions and optional values."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for part in get_args(annotation) for model in _annotation_models(part)]

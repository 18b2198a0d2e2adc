"""Column maps: which column of somebody's CSV is which signal, which is the clock, and what is done about faults."""

import tomllib
from collections.abc import Collection
from pathlib import Path
from typing import Annotated, Literal, Self
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError, available_timezones

from pydantic import (
    AliasChoices,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    field_validator,
    model_validator,
)

from drivers.derived import Derived
from drivers.errors import did_you_mean
from drivers.named_files import MOST_TOML_BYTES, contents, parse_toml
from drivers.settings import first_sentence
from sim.lab.recordings.alphabet_table import DECANTER_AUTO, alphabet_from_table
from sim.lab.recordings.cells import Points
from sim.lab.recordings.clock_counts import COUNTS
from sim.lab.recordings.load_report import TraceError
from sim.sha import Alphabet


def _as_list(value: object) -> object:
    return (value,) if isinstance(value, str) else value


Names = Annotated[tuple[str, ...], BeforeValidator(_as_list)]
"""One name or several: the first that the file has is taken."""


class _MapPart(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, defer_build=True)


class TimeOfDay(_MapPart):
    """The columns of a clock without a date. `fraction` counts in `fraction_unit` seconds."""

    hour: Names
    minute: Names
    second: Names
    fraction: Names = ()
    fraction_unit: Annotated[float, Field(gt=0, lt=1)] = 0.1


class ClockColumns(_MapPart):
    """One `column`, in one of the `formats`, or a `time_of_day` that rolls over at midnight.

    Formats, tried in order: a count of COUNTS, `ISO8601`, or a strptime pattern (months in any of the exporters'
    languages).
    Where the day stands in a column `date` of its own, its cell, a blank and that of `column` are what the formats
    read, also a day and a count since its midnight: `%Y-%m-%d hours`. A time without an offset is read in `timezone`.
    A time of day becomes seconds since midnight of the first row's day; one beyond a day, 25:10:00, is counted on.
    """

    column: Names = ()
    date: Names = ()
    formats: Names = ("ISO8601",)
    timezone: str = "UTC"
    time_of_day: TimeOfDay | None = None

    @property
    def daily(self) -> bool:
        """Whether its times are of a day that nothing names, so that they roll over at midnight."""
        dated = ("%d", "%j", "%u", "%x", "%c", "%D", "%F", "%s")
        return self.time_of_day is not None or (
            not self.date and all("%" in each and not any(mark in each for mark in dated) for each in self.formats)
        )

    @field_validator("timezone")
    @classmethod
    def _zone_exists(cls, zone: str) -> str:
        if problem := zone_problem(zone):
            raise ValueError(problem)
        return zone

    @field_validator("formats")
    @classmethod
    def _check_formats(cls, formats: tuple[str, ...]) -> tuple[str, ...]:
        for format_ in formats:
            if format_ not in (*COUNTS, "ISO8601") and "%" not in format_:
                known = f"{', '.join(map(repr, COUNTS))}, 'ISO8601' or a pattern like '%d/%m/%Y %H:%M:%S'"
                raise ValueError(f"{format_!r} is no format; give {known}")
        return formats

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        if bool(self.column) == (self.time_of_day is not None):
            raise ValueError("give either column or time_of_day")
        if self.date and self.time_of_day is not None:
            raise ValueError("date belongs to column; a time_of_day has none")
        return self


class SignalColumn(_MapPart):
    """Where a signal's readings are: value = cell * scale + offset, in `unit`.

    `column` is the header's name (in a long file, the name in the column of names); the signal's own name if not given.
    Cells in `bad` (numbers that mean no reading, before scaling; `missing` is its older name) and values outside
    `low`..`high` are of bad quality. A cell that says its own unit is converted to `unit`. `hold`: sent on change, the
    last value holds until the next reading, a bad one or a gap. `silence`: how long (s) a value holds in a recording
    that is stored on change, where this signal has another than the map. `on` and `off` are words of a two-valued
    signal, in any case of their letters, besides those that are known anyway; where they are given, `boolean` need not
    be.
    """

    column: Names = ()
    unit: str = ""
    scale: float = 1.0
    offset: float = 0.0
    boolean: bool = False
    on: Names = ()
    off: Names = ()
    hold: bool = False
    low: float | None = None
    high: float | None = None
    silence: Annotated[float, Field(gt=0)] | None = None
    bad: tuple[float, ...] = Field(default=(), validation_alias=AliasChoices("bad", "missing"))

    @model_validator(mode="before")
    @classmethod
    def _words_make_a_switch(cls, table: object) -> object:
        if isinstance(table, dict) and (table.get("on") or table.get("off")):
            return {"boolean": True, **table}
        return table

    @model_validator(mode="after")
    def _words_are_opposites(self) -> Self:
        both = {word.casefold() for word in self.on} & {word.casefold() for word in self.off}
        if both:
            raise ValueError(f"{sorted(both)[0]!r} stands in both on and off; leave it in the one that it means")
        if (self.on or self.off) and not self.boolean:
            raise ValueError("on and off are words of a two-valued signal; leave out boolean = false")
        return self


class Effects(_MapPart):
    """Which signal plays which part for `decanter diagnose`, where signals do not have the plant's names.

    Where the map has this table, a role without a signal is not there, and the effects that need it are not tested.
    """

    current: str | None = None
    torque: str | None = None
    speed: str | None = None
    vibration: str | None = None
    pump: str | None = None
    feed: str | None = None
    ambient: str | None = None

    @property
    def roles(self) -> dict[str, str]:
        """role -> signal, of the roles that are given."""
        return {role: signal for role, signal in self.model_dump().items() if signal is not None}


class Long(_MapPart):
    """The columns of a long file: one row a reading. Rows of objects that are not in `objects` are left aside.

    Of several columns of values, one a type, that which holds something is a row's.
    """

    name: Names
    value: Names
    object: Names = ()
    objects: tuple[str, ...] = ()


def zone_problem(zone: str) -> str:
    """What is wrong with the name of a time zone; "" if there is such a zone."""
    try:
        ZoneInfo(zone)
    except (ZoneInfoNotFoundError, OSError, ValueError):
        meant = did_you_mean(zone, available_timezones()) or "give a name like 'UTC' or 'Europe/Rome'"
        return f"there is no time zone {zone!r}; {meant}"
    return ""


class QualityColumn(_MapPart):
    """Which words of a `column` mean that a row's readings are `good`; of several columns each is of those before
    it."""

    column: Names
    good: Annotated[Names, Field(min_length=1)]


class ByColumn(_MapPart):
    """What the cells of a `column` say of each row: the machine that it is of, or the session."""

    column: Names


def _require_word(word: str, known: Collection[str]) -> str:
    return f"it must be one of {', '.join(known)}; {did_you_mean(word, known)}".rstrip("; ")


class ColumnMap(_MapPart):
    """How to read one kind of CSV.

    `separator` is tried first; another of `, ; tab |` is taken only if the header's names fit under it alone. `decimal`
    `auto` takes a comma inside a cell for a decimal comma unless the column also has decimal points. Beside decimal
    commas `points` says of a column what 1.234 is there, a `decimal` point or `thousands`; it is no number where nobody
    says it.
    `columns` are the names of a file without header. `parts` is a pattern of file names: all such files of one folder
    make one trace; a part may have some of the signals only, and `STEM/NAME` is the column NAME of the file STEM.csv
    alone.
    `duplicates` says what becomes of rows with the same time: they must `agree` (over 1 % that do not is refused), or
    it is the `average` of the readings (of booleans the last), the `last` reading of each signal, `keep`, or `spread`:
    evenly up to the next time, as by a clock that lost its seconds. `clock_back`: `refuse` the fewest rows
    that leave a clock which never goes back, `split` into traces there, or `sort`. `extra`: columns that the map does
    not name become signals too.
    `machine` says which machine a trace is of: each `folder` of files is one, each `file` is, all are the one that it
    names, or a `column` says it, as one may say the `session`: each has traces and a clock of its own; models learn how
    much machines differ.
    `quality`: a column whose words say whether a row's readings are good; others are of bad quality.
    `stored` `on change`: a value holds until the next one of its signal, for `silence` seconds at most (a signal may
    have its own), not over a step of more than the map's `silence` between rows, and stands in the trace every
    `interval` seconds; in a recording that has each row, silence is not known to mean anything.
    """

    format: Literal["wide", "long"]
    temperature: str
    clock: ClockColumns
    signals: dict[str, SignalColumn]
    derived: dict[str, Derived] = {}
    long: Long | None = None
    separator: Literal["auto", ",", ";", "tab", "|"] = "auto"
    decimal: Literal["auto", ".", ","] = "auto"
    points: dict[str, Points] = {}
    encoding: str = "auto"
    comment: str = "#"
    columns: tuple[str, ...] = ()
    parts: str = ""
    duplicates: Literal["agree", "average", "last", "keep", "spread"] = "agree"
    clock_back: Literal["refuse", "split", "sort"] = "refuse"
    extra: bool = False
    synthetic: bool = False
    machine: Annotated[str, Field(min_length=1)] | ByColumn = "folder"
    session: ByColumn | None = None
    quality: QualityColumn | None = None
    stored: Literal["each row", "on change"] = "each row"
    silence: Annotated[float, Field(gt=0)] = 3600.0
    interval: Annotated[float, Field(gt=0)] = 10.0
    effects: Effects | None = None
    alphabet: Alphabet = DECANTER_AUTO

    @field_validator("alphabet", mode="before")
    @classmethod
    def _alphabet(cls, table: object) -> object:
        if not isinstance(table, dict):
            return table
        try:
            return alphabet_from_table(table, "its")
        except ValueError as error:
            raise ValueError(str(error).removeprefix("its: ")) from None

    @field_validator("encoding")
    @classmethod
    def _encoding_exists(cls, encoding: str) -> str:
        try:
            "".encode("utf-8" if encoding == "auto" else encoding)
        except LookupError:
            raise ValueError(
                f"there is no encoding {encoding!r}; give 'auto' or a name like 'utf-8' or 'cp1252'"
            ) from None
        return encoding

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        if (self.format == "long") != (self.long is not None):
            raise ValueError("format 'long' needs a table [long], format 'wide' has none")
        if self.format == "long" and (self.clock_back != "sort" or self.duplicates in ("keep", "spread") or self.extra):
            raise ValueError(
                "a long map needs clock_back = 'sort', duplicates 'agree', 'last' or 'average', and no extra"
            )
        if self.points and self.decimal != ",":
            raise ValueError("points says what they are beside decimal commas; it needs decimal = ','")
        if self.temperature not in self.signals:
            raise ValueError(f"temperature names {self.temperature!r}; {_require_word(self.temperature, self.signals)}")
        for name, derived in self.derived.items():
            strange = [source for source in derived.sources if source not in self.signals]
            if strange:
                raise ValueError(f"derived.{name} needs {strange[0]!r}; {_require_word(strange[0], self.signals)}")
        self._check_roles()
        return self

    @property
    def roles(self) -> dict[str, str] | None:
        """role -> signal, as the table `effects` says; None where there is none."""
        return None if self.effects is None else self.effects.roles

    def _check_roles(self) -> None:
        known = (*self.signals, *self.derived)
        for role, signal in (self.roles or {}).items():
            if signal not in known and not self.extra:
                raise ValueError(f"effects.{role} names {signal!r}; {_require_word(signal, known)}")

    @property
    def by_column(self) -> tuple[Names, ...]:
        """The columns that tell machines and sessions apart, in this order; () for one that none does."""
        machine = self.machine.column if isinstance(self.machine, ByColumn) else ()
        return (machine, self.session.column if self.session else ())

    def signal_names(self, signal: str) -> tuple[str, ...]:
        """The column names under which a signal may come."""
        return self.signals[signal].column or (signal,)


def load_map(path: str | Path) -> ColumnMap:
    """The column map in a TOML file. Raises TraceError: file, key, reason and what would be right in one sentence."""
    try:
        text = contents(Path(path), MOST_TOML_BYTES).decode()
    except FileNotFoundError:
        beside = sorted(file.stem for file in Path(path).parent.glob("*.toml"))
        meant = did_you_mean(Path(path).stem, beside) or "the project's own are in config/traces"
        raise TraceError(f"{path}: there is no such column map; {meant}") from None
    except OSError as error:
        raise TraceError(f"{path}: this column map cannot be read: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise TraceError(f"{path}: this is not TOML: {error}") from None
    return parse_map(text, str(path))


def parse_map(text: str, where: str) -> ColumnMap:
    """The column map in a TOML text. Raises TraceError: one sentence that begins with `where`."""
    try:
        return ColumnMap.model_validate(parse_toml(text))
    except tomllib.TOMLDecodeError as error:
        raise TraceError(f"{where}: this is not TOML: {error}") from None
    except ValidationError as error:
        raise TraceError(first_sentence(ColumnMap, error, where)) from None

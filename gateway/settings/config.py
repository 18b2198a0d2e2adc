"""The gateway's configuration: one TOML file, checked whole before anything starts.

A file is that of one machine, or has a `[[machine]]` table for each of several. What stands at the top of such a file
is common: a machine has it too, key for key, where its own table says nothing else.
"""

import json
import os
import re
from collections.abc import Hashable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cache
from hashlib import sha256
from ipaddress import ip_address
from pathlib import Path
from stat import S_ISDIR
from typing import Annotated, Any, Literal

from pydantic import Field, StringConstraints, TypeAdapter, field_validator, model_validator

from drivers.driver import capabilities, load_function
from drivers.errors import DriverError, did_you_mean
from drivers.named_files import normal_path
from drivers.settings import ConfigError, FilePath, Line, Section, read_toml, validate_section
from drivers.tag import DType
from gateway.replacement import ReplacementError, files_version, has_newer_files, settle
from gateway.settings.alarm_kinds import ANOMALY_FLOOR, OF_PLANT, AlarmRow, alarm_problems
from gateway.settings.devices import DeviceMap, WritebackLayout
from gateway.settings.links import DeviceLink, DeviceSection, link_problems, make_links
from gateway.settings.northbound import NorthboundSection
from gateway.settings.notify import NotifySection

Names = Annotated[tuple[str, ...], Field(strict=False)]
Seconds = Annotated[tuple[float, ...], Field(strict=False)]

OF_THE_TYPE = (
    "the machine whose correction is taken, where the model is of a type of machine: this one's by its name without "
    "this key, none with an empty text"
)
MAX_ARMED_MINUTES = 480.0
A_DAY_S = 86_400.0
"""Delays, intervals and horizons beyond it would make of an alarm, a record or a forecast one that never comes."""
FORMER_HISTORIAN = Path("../out/historian.sqlite")
"""Where the records were by default, from the plant file on (record 0079)."""
MIN_BLOCKS_PER_SECOND = 10.0


class ScanSection(Section):
    """How often the device is read."""

    period: float = Field(1.0, ge=0.01, le=3600, description="the seconds between two scans, 0.01 to 3600")
    on_change: bool | None = Field(
        None,
        description="true: a device that speaks by itself is scanned at once when a tag of the model or of an alarm "
        "changes; false: at the period only; no key: true for a device that speaks by itself",
    )


class ModelSection(Section):
    """The model (a directory of artefacts or one JSON file) and the tag that holds its temperature."""

    path: FilePath | None = Field(None, description="a model directory or a model's JSON file, relative to this file")
    temperature: str = Field("TCuscinettiRiduttore", description="the tag of the temperature to be predicted")
    correction: str | None = Field(None, description=OF_THE_TYPE)


class TemperatureSection(Section):
    """`[[temperature]]`: one of several temperatures that a machine's model predict, each with a limit of its own."""

    tag: str = Field(description="the tag of the temperature")
    model: FilePath | None = Field(None, description="a model directory or a model's JSON file, relative to this file")
    limit: float | None = Field(None, description="its alarm limit, alarms.limit without this key")
    correction: str | None = Field(None, description=OF_THE_TYPE)


class WritebackSection(Section):
    """Whether anything is written to the PLC: `off`, `shadow` (computed and logged), `armed` (written)."""

    mode: Literal["off", "shadow", "armed"] = Field("off", description="'off', 'shadow' or 'armed'")
    armed_by: str = Field("", description="the name of the person who arms")
    reason: str = Field("", description="why the gateway is armed")
    minutes: float | None = Field(
        None, gt=0, le=MAX_ARMED_MINUTES, description=f"for how many minutes, at most {MAX_ARMED_MINUTES:g}"
    )
    horizon: float | None = Field(None, gt=0, description="one of forecast.horizons, in seconds")
    most_per_second: float | None = Field(
        None, ge=0.1, le=1000, description="the most blocks a real second, 0.1 to 1000, or no key for twice the scans"
    )
    max_age: float | None = Field(
        None,
        ge=0.05,
        le=60,
        description="how old a block's readings and its permit may be when it is sent, in real seconds from their "
        "first request on, or no key for two scans, at least 1 s and at most half of the PLC's timer",
    )
    audit: FilePath | None = Field(None, description="the path of the audit log, beside the historian without this key")
    audit_key: FilePath | None = Field(
        None, description="the path of the key that signs the audit log's heads, beside the log without this key"
    )
    audit_heads: FilePath | None = Field(
        None, description="the path of the file of signed heads, on another disk or share if there is one"
    )

    @model_validator(mode="after")
    def _check_signature(self) -> "WritebackSection":
        if self.mode == "armed":
            missing = [name for name in ("armed_by", "reason", "minutes") if not getattr(self, name)]
            if missing:
                raise ValueError(
                    f"mode 'armed' also needs {', '.join(missing)}; give a name, a reason and the minutes (at most "
                    f"{MAX_ARMED_MINUTES:g}), or set mode to 'shadow'"
                )
        return self


class AlarmSection(Section):
    """The independent threshold alarm, and when the model's own findings are worth an alarm."""

    limit: float = Field(80.0, description="the alarm limit in degC")
    deadband: float = Field(2.0, ge=0, description="degC below the limit at which the alarm returns")
    on_delay: float = Field(
        0.0, ge=0, le=A_DAY_S, description="seconds above the limit before the alarm is raised, at most a day"
    )
    off_delay: float = Field(
        10.0, ge=0, le=A_DAY_S, description="seconds below the limit before the alarm returns, at most a day"
    )
    tags: Names = Field((), description="the tags of the temperatures to watch")
    p_limit: float = Field(0.5, gt=0, le=1, description="the probability of passing the limit that is worth an alarm")
    anomaly: float | None = Field(
        None,
        gt=0,
        le=100,
        description="the anomaly score worth an alarm, at most 100 (minus the decimal logarithm of a chance), or no "
        f"key for what the model's own record says is passed once a week at most, {ANOMALY_FLOOR:g} at least",
    )
    unfamiliar: float = Field(
        1.2,
        ge=0.5,
        le=100,
        description="the strangeness of the present cycle that lowers confidence and is worth an alarm, 0.5 to 100 (1: "
        "as the strangest twentieth of the training's cycles)",
    )
    drift: float | None = Field(
        None, gt=0, description="degC of a cycle's free-run error that is drift, or no key for the model's own band"
    )
    drift_cycles: int = Field(3, ge=1, le=100, description="the cycles running beyond that which are worth an alarm")
    trend: float | None = Field(
        300.0,
        gt=0,
        le=86_400,
        description="the seconds within which a straight line reaches the limit that are worth an alarm; false: never",
    )
    sensors: bool = Field(True, description="whether the watched temperatures' sensors are looked after")
    twins: Names = Field(
        (), max_length=2, description="two tags of bearings that warm alike, or no key for two watched temperatures"
    )
    acknowledge: str | None = Field(
        None, description="the tag whose rise from 0 acknowledges all alarms of the machine, beside AcknowledgeBits"
    )
    longest_shelving: float = Field(
        480.0, gt=0, le=10_080, description="the most minutes for which an alarm may be shelved, at most 10080"
    )
    disk_mb: float = Field(200.0, ge=0, description="the megabytes left on the records' disk that are worth an alarm")
    certificate_days: float = Field(
        30.0, ge=0, le=3660, description="the days until a certificate runs out that are worth an alarm"
    )

    @field_validator("trend", mode="before")
    @classmethod
    def _seconds_or_never(cls, seconds: object) -> object:
        return None if seconds is False else seconds

    @field_validator("tags")
    @classmethod
    def _once(cls, tags: tuple[str, ...]) -> tuple[str, ...]:
        if len(set(tags)) != len(tags):
            raise ValueError(f"{list(tags)} name a tag twice; name each once")
        return tags

    @field_validator("twins")
    @classmethod
    def _two(cls, twins: tuple[str, ...]) -> tuple[str, ...]:
        if len(twins) == 1 or len(set(twins)) != len(twins):
            raise ValueError(f"{list(twins)} are not two tags; give two tags, or [] for none")
        return twins


class HistorianSection(Section):
    """The embedded historian."""

    path: FilePath = Field(Path("out/historian.sqlite"), description="the path of the database file")
    retention_days: float = Field(
        90.0, ge=0.04, description="the days after which measurements are deleted, at least 0.04 (an hour)"
    )
    max_mb: float = Field(4096.0, ge=1, description="the largest size of the file in megabytes, at least 1")
    max_interval: float = Field(
        5.0, gt=0, le=A_DAY_S, description="seconds after which an unchanged value is stored again, at most a day"
    )
    max_off_days: float = Field(
        7.0, gt=0, description="the days that the gateway may have been off before its clock is doubted"
    )
    disarm_after: float | None = Field(
        60.0,
        ge=1,
        description="seconds without records until an armed gateway disarms itself, at least 1; false: never",
    )

    @field_validator("disarm_after", mode="before")
    @classmethod
    def _seconds_or_never(cls, seconds: object) -> object:
        return None if seconds is False else seconds

    @model_validator(mode="after")
    def _check_retention(self) -> "HistorianSection":
        if self.max_interval > self.retention_days * A_DAY_S:
            raise ValueError(
                f"max_interval {self.max_interval:g} s is longer than the {self.retention_days:g} days of "
                "retention_days, so that what does not change would be deleted before it is stored again; give less"
            )
        return self


class LogSection(Section):
    """Structured log: JSON lines to a file, which is begun anew by size and age."""

    path: FilePath | None = Field(None, description="the path of the log file")
    level: Literal["debug", "info", "warning", "error"] = Field("info", description="debug, info, warning or error")
    max_mb: float = Field(10.0, ge=0.001, le=10_000, description="the largest size of one file in megabytes")
    max_days: float = Field(30.0, gt=0, le=3660, description="the days after which a new file is begun")
    keep: int = Field(9, ge=1, le=999, description="how many older files are kept, 1 to 999")


class ForecastSection(Section):
    """The fan of what may come: horizons, number of simulated runs, and how often it is made."""

    horizons: Seconds = Field((60.0, 300.0, 900.0), min_length=1, description="ascending seconds, such as [60, 900]")
    runs: int = Field(500, ge=20, le=100_000, description="the number of runs, 20 to 100000")
    period: float = Field(10.0, gt=0, le=A_DAY_S, description="the plant seconds between two forecasts, at most a day")
    seed: int = Field(0, ge=0, description="a whole number from 0")

    @field_validator("horizons")
    @classmethod
    def _check_order(cls, horizons: tuple[float, ...]) -> tuple[float, ...]:
        if any(later <= earlier for earlier, later in zip((0.0, *horizons), horizons, strict=False)):
            raise ValueError(f"{list(horizons)} must be positive and ascending; give seconds such as [60, 300, 900]")
        if horizons and horizons[-1] > A_DAY_S:
            raise ValueError(f"{list(horizons)} look beyond a day; give seconds such as [60, 300, 900]")
        return horizons


class VirtualSensorSection(Section):
    """For how long the model stands in for a bad sensor."""

    minutes: float = Field(120.0, gt=0, le=1440, description="the most minutes since the last good reading, up to 1440")
    width: float = Field(15.0, ge=0.1, description="the widest 90 % band, in degC from its lower to its upper end")


class EnsembleSection(Section):
    """Models that are followed beside the one of [model]; the forecast is then a mixture of them all."""

    members: Annotated[tuple[FilePath, ...], Field(strict=False)] = Field(
        (), description="a list of models beside model.path, each a directory or a JSON file"
    )
    weights: tuple[float, ...] | Literal["evidence", "equal"] = Field(
        "evidence", description="'evidence', 'equal' or one number a model, as [0.7, 0.3], model.path's first"
    )
    context: Literal["none", "running", "symbols", "familiarity"] = Field(
        "running",
        description="'none', 'running' (weights of their own for running and stopped), 'symbols' (for each "
        "combination of the alphabet's symbols) or 'familiarity' (as 'running', and apart for cycles unlike the "
        "training)",
    )
    plain: bool = Field(
        True, description="whether the model's plain members (persistence, a damped trend) take part in its forecast"
    )
    half_life: float = Field(
        8.0, ge=0.1, description="independent forecasts after which evidence counts half, at least 0.1"
    )
    floor: float = Field(0.02, ge=0, lt=1, description="the least weight that evidence leaves a model")

    @field_validator("weights", mode="before")
    @classmethod
    def _words_or_numbers(cls, weights: object) -> object:
        if isinstance(weights, list | tuple):
            numbers = all(
                isinstance(weight, int | float) and not isinstance(weight, bool) and weight >= 0 for weight in weights
            )
            if not numbers or abs(sum(weights) - 1.0) > 1e-6:
                raise ValueError(f"{list(weights)} must be numbers from 0 that sum to 1; give as many as models")
            return tuple(float(weight) for weight in weights)
        if weights not in ("evidence", "equal"):
            raise ValueError(f"must be 'evidence', 'equal' or a list of numbers such as [0.7, 0.3], got {weights!r}")
        return weights


class ControlSection(Section):
    """The local socket by which programs of the same user ask the running gateway."""

    path: FilePath | None = Field(None, description="the path of the socket, beside the historian without this key")


class ClockSection(Section):
    """Plant seconds per real second: other than 1 only for replays against a software PLC on this machine."""

    speed: float = Field(1.0, gt=0, le=10_000, description="plant seconds per real second, 1 for a real plant")
    tag: str | None = Field(None, description="the tag of the PLC's own clock, in seconds since 1970 UTC")


class ServeSection(Section):
    """What was read, served to peers as a Modbus TCP server that only answers reads; off without a port."""

    port: int | None = Field(None, ge=1, le=65535, description="a TCP port from 1 to 65535, or no key for no server")
    host: str = Field(
        "127.0.0.1", min_length=1, description="the address to listen on: this machine only, if not given"
    )
    unit: int = Field(1, ge=0, le=255, description="the unit id under which the machine is served, 0 to 255")
    address: int = Field(50000, ge=0, le=65535, description="the first register of qualities and ages, 0 to 65535")
    most_clients: int = Field(8, ge=1, le=256, description="how many peers are served at a time, 1 to 256")


PAGE_SUBJECT = "page"
"""The subject of the page's rows in the audit log, beside those of the machines by their names."""


class PageSection(Section):
    """The page: what a browser shows of the gateway, served by the gateway itself; off unless enabled."""

    enabled: bool = Field(False, description="true or false")
    host: str = Field(
        "127.0.0.1", min_length=1, description="the address to listen on: this machine only, if not given"
    )
    port: int = Field(8080, ge=0, le=65535, description="a TCP port from 1 to 65535, or 0 for a free one")
    certificates: FilePath | None = Field(
        None,
        description="a folder with server.pem and server.key, as `decanter certificates` makes them; the page is "
        "served over TLS then",
    )
    users: FilePath | None = Field(
        None, description="the path of the file of accounts, beside the historian without this key"
    )
    open_reading: bool = Field(
        True, description="true: whoever is on this machine may read without an account; elsewhere nobody may"
    )
    session_minutes: float = Field(30.0, ge=1, le=720, description="the idle minutes after which a session ends")
    most_clients: int = Field(64, ge=1, le=1000, description="how many browsers are served at a time, 1 to 1000")
    labels: dict[str, Line] = Field({}, description="words for people by the names of machines and tags")

    @property
    def loopback(self) -> bool:
        """Whether only this machine can reach it."""
        with suppress(ValueError):
            return ip_address(self.host).is_loopback
        return self.host == "localhost"

    @model_validator(mode="after")
    def _check_protection(self) -> "PageSection":
        if self.enabled and not self.loopback and self.certificates is None:
            raise ValueError(
                f"host {self.host!r} can be reached from other machines, and passwords would cross the network as they "
                "are; give certificates (`decanter certificates FOLDER --host NAME` makes them), or listen on 127.0.0.1"
            )
        return self


class _MachineName(Section):
    name: Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,59}$")] = Field(
        description="a name of letters, digits, '_', '-' and '.', 60 at most"
    )


class _PlantFile(Section):
    device: DeviceSection = Field(description="a [device] table with file and host")
    scan: ScanSection = Field(default_factory=ScanSection, description="a [scan] table")
    model: ModelSection = Field(default_factory=ModelSection, description="a [model] table")
    temperature: Annotated[tuple[TemperatureSection, ...], Field(strict=False)] = Field(
        (), description="[[temperature]] tables, where several temperatures are predicted"
    )
    writeback: WritebackSection = Field(default_factory=WritebackSection, description="a [writeback] table")
    alarms: AlarmSection = Field(default_factory=AlarmSection, description="an [alarms] table")
    alarm: Annotated[tuple[AlarmRow, ...], Field(strict=False)] = Field(
        (), max_length=1000, description="[[alarm]] tables, each with the name of a kind of alarm"
    )
    notify: NotifySection = Field(default_factory=NotifySection, description="a [notify] table")
    northbound: NorthboundSection = Field(default_factory=NorthboundSection, description="a [northbound] table")
    historian: HistorianSection = Field(default_factory=HistorianSection, description="a [historian] table")
    log: LogSection = Field(default_factory=LogSection, description="a [log] table")
    forecast: ForecastSection = Field(default_factory=ForecastSection, description="a [forecast] table")
    ensemble: EnsembleSection = Field(default_factory=EnsembleSection, description="an [ensemble] table")
    virtual_sensor: VirtualSensorSection = Field(
        default_factory=VirtualSensorSection, description="a [virtual_sensor] table"
    )
    control: ControlSection = Field(default_factory=ControlSection, description="a [control] table")
    clock: ClockSection = Field(default_factory=ClockSection, description="a [clock] table")
    serve: ServeSection = Field(default_factory=ServeSection, description="a [serve] table")
    page: PageSection = Field(default_factory=PageSection, description="a [page] table")


COMMON = ("historian", "log", "control", "notify", "northbound", "page")
"""Sections of the whole gateway: no machine has one of its own."""
COMMON_KEYS = {
    "clock": ("speed",),
    "writeback": ("audit", "audit_key", "audit_heads"),
    "serve": ("port", "host", "most_clients"),
}
"""Keys of the whole gateway in sections that a machine may have."""


def is_common(section: str, key: str) -> bool:
    """Whether a key of the plant file is of the whole gateway, so that no machine has one of its own."""
    return section in COMMON or key in COMMON_KEYS.get(section, ())


@dataclass(frozen=True, slots=True)
class Config:
    """The checked configuration of one machine; every path in it is complete.

    `machine` is its name, `several` whether its file has [[machine]] tables, `leads` whether it is the first of them,
    which looks after the alarms of the whole plant; `temperatures` are those that are predicted, `model` is the first
    one's. `stamp` is the file's time of change (s): two configurations that differ in nothing else are equal.
    """

    path: Path
    stamp: float = field(compare=False)
    machine: str
    device: DeviceSection
    scan: ScanSection
    model: ModelSection
    several: bool
    leads: bool
    temperatures: tuple[TemperatureSection, ...]
    writeback: WritebackSection
    alarms: AlarmSection
    alarm: tuple[AlarmRow, ...]
    notify: NotifySection
    northbound: NorthboundSection
    historian: HistorianSection
    log: LogSection
    forecast: ForecastSection
    ensemble: EnsembleSection
    virtual_sensor: VirtualSensorSection
    control: ControlSection
    clock: ClockSection
    serve: ServeSection
    page: PageSection
    links: tuple[DeviceLink, ...]

    @property
    def subject(self) -> str:
        """Whose armings the audit log's are: those of a gateway of one machine bear no name."""
        return self.machine if self.several else ""

    @property
    def arming_hash(self) -> str:
        """What an arming of this machine is for: the SHA-256 of all in the configuration that decides what is written
        where, short.

        Who armed, the mode, and what is common to all machines, such as the places of records, are no part of it; nor
        is how the plant file was named.
        """
        (plain,) = _plain_configs().dump_python((self,), exclude={"__all__": _NOT_WRITTEN_BY})
        text = json.dumps(plain, sort_keys=True, default=_plain_text)
        return sha256(text.encode()).hexdigest()[:_ARMED_FOR_LETTERS]

    @property
    def temperature_configs(self) -> tuple["Config", ...]:
        """This configuration once for each of its temperatures, with that one's model and limit."""
        own = []
        for place, row in enumerate(self.temperatures):
            limit = self.alarms.limit if row.limit is None else row.limit
            model = ModelSection(path=row.model, temperature=row.tag, correction=row.correction)
            # The models of an ensemble are followed beside the first one, and predict its temperature.
            ensemble = self.ensemble if place == 0 else self.ensemble.model_copy(update={"members": ()})
            alarms = self.alarms.model_copy(update={"limit": limit})
            own.append(replace(self, model=model, alarms=alarms, ensemble=ensemble, temperatures=(row,)))
        return tuple(own)

    @property
    def block_layout(self) -> WritebackLayout | None:
        """The block of the (first) predicted temperature; None where the device takes none of it."""
        return self.map.find_block(self.model.temperature)

    def find_limit(self, tag: str) -> float:
        """The alarm limit of a temperature under the threshold alarm."""
        return next(
            (row.limit for row in self.temperatures if row.tag == tag and row.limit is not None), self.alarms.limit
        )

    @property
    def map(self) -> DeviceMap:
        """The device file of the primary link: the tags, and the block that is written back."""
        return self.links[0].map

    @property
    def control_socket(self) -> Path:
        """Where the running gateway can be asked."""
        return self.control.path or self.historian.path.with_suffix(".sock")

    @property
    def users(self) -> Path:
        """The file of the page's accounts."""
        return self.page.users or self.historian.path.with_name("users.json")

    @property
    def audit(self) -> Path:
        """Where every write and refusal is accounted for."""
        return self.writeback.audit or self.historian.path.with_name("audit.sqlite")

    @property
    def audit_key(self) -> Path:
        """The key that signs the audit log's heads."""
        return self.writeback.audit_key or self.audit.with_suffix(".key")

    @property
    def audit_heads(self) -> Path:
        """The file of the audit log's signed heads."""
        return self.writeback.audit_heads or self.audit.with_suffix(".heads.jsonl")

    @property
    def written_files(self) -> dict[str, Path]:
        """The files that the gateway writes, by the keys that name them."""
        named = {
            "historian.path": self.historian.path,
            "writeback.audit": self.audit,
            "writeback.audit_key": self.audit_key,
            "writeback.audit_heads": self.audit_heads,
            "log.path": self.log.path,
            "control.path": self.control_socket,
        }
        return {key: path for key, path in named.items() if path is not None}

    @property
    def certificate_folders(self) -> tuple[Path, ...]:
        """The folders of the certificates without which the machine is not read; of the first one's those of the OPC UA
        server too, which the plant has once."""
        opcua = self.northbound.opcua
        named = [link.settings.get("certificates") for link in self.links]
        named += [opcua.certificates] if opcua.port is not None and self.leads else []
        return tuple(Path(str(each)) for each in named if each)

    @property
    def blocks_per_second(self) -> float:
        """The most blocks a real second: as configured, or twice the scans and at least MIN_BLOCKS_PER_SECOND."""
        return self.writeback.most_per_second or max(MIN_BLOCKS_PER_SECOND, 2.0 * self.clock.speed / self.scan.period)

    @property
    def block_max_age(self) -> float:
        """How old a block's readings and its permit may be when it is sent, real seconds: as configured, or by default.

        By default two scans and 1 s at least, and half of the PLC's timer at most.
        """
        block = self.map.writeback
        most = block.timeout / 2 if block is not None else 1.0
        return self.writeback.max_age or min(max(2.0 * self.scan.period / self.clock.speed, 1.0), most)

    @property
    def watched_temperatures(self) -> tuple[str, ...]:
        """The tags of the temperatures under the threshold alarm."""
        return watched_tags(self.alarms, [row.tag for row in self.temperatures])

    @property
    def twins(self) -> tuple[str, ...]:
        """The two tags of temperatures that warm alike: the named ones, or the two that are watched; () without."""
        named = "twins" in self.alarms.model_fields_set
        return self.alarms.twins if named or len(self.watched_temperatures) != 2 else self.watched_temperatures

    @property
    def block_horizon(self) -> float:
        """The horizon (s) of the forecast in the block: the configured one, or the longest."""
        return self.writeback.horizon or self.forecast.horizons[-1]


def watched_tags(alarms: AlarmSection, predicted: Sequence[str]) -> tuple[str, ...]:
    """The tags under the threshold alarm: the named ones, of several predicted temperatures these too."""
    return tuple(dict.fromkeys((*alarms.tags, *predicted)) if len(predicted) > 1 else alarms.tags or predicted)


_MOST_READINGS = 3
"""Of files that are replaced while they are read; anything else that comes and goes in their folder costs one too."""


def load_config(path: Path, overrides: Mapping[str, Any] | None = None, *, machine: str | None = None) -> Config:
    """The configuration of the file's only machine, or of the one of that name. Otherwise as `load_plant`."""
    machines = load_plant(path, overrides)
    names = ", ".join(config.machine for config in machines)
    if machine is not None:
        found = [config for config in machines if config.machine == machine]
        if not found:
            raise ConfigError([f"{path}: has no machine {machine!r}; it has {names}"])
        return found[0]
    if len(machines) > 1:
        raise ConfigError([f"{path}: has {len(machines)} machines; name one of them with --machine: {names}"])
    return machines[0]


def load_plant(path: Path, overrides: Mapping[str, Any] | None = None) -> tuple[Config, ...]:
    """The configurations of all machines of the file in `path`, with the register maps that they name.

    `overrides` replaces single keys before the check, written `section.key` ({"device.port": 15020}); relative paths
    in the file are relative to the file, in overrides to the working directory. Files that were replaced in part are
    put back first, and where they are replaced meanwhile, they are read again (`gateway.replacement`). Raises
    ConfigError with all that is wrong, one sentence each: file, key, reason, what would be right.
    """
    left = _MOST_READINGS
    while True:
        try:
            settle(path)
        except ReplacementError as error:
            raise ConfigError([str(error)]) from None
        before, left = files_version(path), left - 1
        try:
            machines = read_plant(path, overrides)
        except ConfigError:
            if not left or not has_newer_files(path, before):
                raise
        else:
            if not left or not has_newer_files(path, before):
                return machines


def read_plant(path: Path, overrides: Mapping[str, Any] | None = None) -> tuple[Config, ...]:
    """`load_plant` for who is replacing the files."""
    # Before it is read: what is saved meanwhile is later than what was read, and a disarming between them wins.
    stamp = path.stat().st_mtime if path.is_file() else 0.0
    # Overrides come before the check, so that they are held to the same rules as the file.
    data = {key: dict(value) if isinstance(value, dict) else value for key, value in read_toml(path).items()}
    if "tags" in data:
        raise ConfigError([f"{path}: is a device file and no plant file; give it with --device"])
    _drop_workers(data, path)
    rows = data.pop("machine", None)
    for key, value in (overrides or {}).items():
        section, _, name = key.partition(".")
        if rows is not None and not is_common(section, name):
            raise ConfigError([f"{path}: {key}: is each machine's own, and the file has several; change it there"])
        table = data.setdefault(section, {})
        if isinstance(table, dict):
            table[name] = str(value.absolute()) if isinstance(value, Path) else value
    if rows is None:
        return (_machine_config(path, data, str(path), stamp=stamp),)
    tables = _machine_tables(rows, path)
    machines, problems = list[Config](), list[str]()
    for name, table in tables.items():
        try:
            place = f"{path}: machine {name!r}"
            machines.append(
                _machine_config(path, _complete_table(data, table), place, name, stamp=stamp, leads=not machines)
            )
        except ConfigError as error:
            problems += error.problems
    problems = problems or [*_same_places(machines), *_plant_alarms(machines)]
    if problems:
        # What is wrong at the top is wrong for several machines: it is said once, and of none of them.
        bare = [re.sub(r": machine '[^']*'", "", problem, count=1) for problem in problems]
        raise ConfigError(
            list(
                dict.fromkeys(own if bare.count(own) > 1 else whole for own, whole in zip(bare, problems, strict=True))
            )
        )
    return tuple(machines)


def _drop_workers(data: dict[str, Any], path: Path) -> None:
    """Leave out `[plant] workers = 1`, which former versions had: it says what is so. Raises ConfigError for more."""
    plant = data.get("plant")
    if not isinstance(plant, dict) or "workers" not in plant:
        return
    workers = plant.pop("workers")
    if workers is True or workers != 1:
        raise ConfigError(
            [
                f"{path}: plant.workers: {workers!r} is no longer taken, as one process has all machines of a file; "
                "take the key out, or give each group of machines a plant file and a service of its own "
                "(/etc/decanter/GROUP/plant.toml, systemctl enable --now decanter@GROUP), with the same PostgreSQL, "
                "MQTT and Prometheus as their common view"
            ]
        )
    if not plant:
        del data["plant"]


_ARMED_FOR_LETTERS = 16
_NOT_WRITTEN_BY: Any = {
    **dict.fromkeys((*COMMON, "path", "stamp", "machine", "several", "leads", "clock", "serve"), True),
    "writeback": {"mode", "armed_by", "reason", "minutes", *COMMON_KEYS["writeback"]},
}
"""What of a configuration does not decide which block is written, with which content, to which device."""


def _plain_text(value: object) -> str:
    return str(normal_path(value) if isinstance(value, Path) else value)


@cache
def _plain_configs() -> TypeAdapter[tuple[Config, ...]]:
    return TypeAdapter(tuple[Config, ...])  # at its first use: few programs need it, and it takes its time


def _device_identity(link: DeviceLink) -> Hashable:
    """What tells a link's device from others, defaults and all; None where that cannot be told."""
    driver = capabilities(link.map.driver)
    if driver.identifies:
        # Settings that are wrong lead nowhere: the driver says so when it is made.
        with suppress(DriverError):
            found: Hashable = load_function(driver.identifies)(link.settings)
            return found
    if driver.bus:
        # Of a bus without nodes it is the messages that are a machine's, and the device file says which.
        bus = (link.settings.get("interface"), link.settings.get("channel"))
        return (link.map.driver, *bus, os.path.realpath(link.map.path))
    return None


def _same_places(machines: Sequence[Config]) -> list[str]:
    """Machines that are one and the same device, or are served to peers as one."""
    problems, known, served = [], dict[Hashable, str](), dict[int, str]()
    for config in machines:
        for link in config.links:
            if (device := _device_identity(link)) is None:
                continue
            other = known.setdefault(device, config.machine)
            if other != config.machine:
                problems.append(
                    f"{config.path}: machine {config.machine!r}: device: is at {link.place}, as machine {other!r} is; "
                    "give each machine a device of its own (host, port, unit, node)"
                )
        other = served.setdefault(config.serve.unit, config.machine)
        if config.serve.port is not None and other != config.machine:
            problems.append(
                f"{config.path}: machine {config.machine!r}: serve.unit: {config.serve.unit} is that of machine "
                f"{other!r}; give each machine's serve table a unit of its own"
            )
    return problems


def _plant_alarms(machines: Sequence[Config]) -> list[str]:
    """What machines say by themselves of alarms that the plant has once."""
    common = [row for row in machines[0].alarm if row.name in OF_PLANT]
    return [
        f"{config.path}: machine {config.machine!r}: alarm: {row.name!r} is the plant's, which has it once; write it "
        "at the top of the file"
        for config in machines[1:]
        for row in config.alarm
        if row.name in OF_PLANT and row not in common
    ]


def _complete_table(data: Mapping[str, Any], table: Mapping[str, Any]) -> dict[str, Any]:
    """A machine's whole table: its own over what is common; temperatures are named in one way only, its own if any."""
    common = dict(data)
    if "temperature" in table:
        common.pop("model", None)
    elif "model" in table:
        common.pop("temperature", None)
    whole = {key: _merge_tables(common.get(key), table.get(key)) for key in dict.fromkeys((*common, *table))}
    # The rows of a list go over one another: a machine's come after those that all have.
    if isinstance(rows := common.get("alarm"), list) and isinstance(own := table.get("alarm"), list):
        whole["alarm"] = [*rows, *own]
    return whole


def _merge_tables(common: object, own: object) -> object:
    """A machine's own table over the common one, key for key."""
    if isinstance(common, dict) and isinstance(own, dict):
        return {key: _merge_tables(common.get(key), own.get(key)) for key in dict.fromkeys((*common, *own))}
    return common if own is None else own


def _machine_tables(rows: object, path: Path) -> dict[str, dict[str, Any]]:
    """The `[[machine]]` tables by their names, without them. Raises ConfigError."""
    if not isinstance(rows, list) or not rows or not all(isinstance(row, dict) for row in rows):
        raise ConfigError(
            [f"{path}: machine: must be [[machine]] tables; write one for each machine, each with a name"]
        )
    problems, tables = [], dict[str, dict[str, Any]]()
    for index, row in enumerate(rows):
        try:
            name = validate_section(_MachineName, {"name": row["name"]} if "name" in row else {}, path).name
        except ConfigError as error:
            problems += [problem.replace(": name", f": machine[{index}].name", 1) for problem in error.problems]
            continue
        if name == PAGE_SUBJECT:
            problems.append(
                f"{path}: machine[{index}].name: {name!r} is what the audit log calls the gateway's own page; give "
                "another name"
            )
        if name in tables:
            problems.append(f"{path}: machine[{index}].name: {name!r} is already used; give each machine its own name")
        common = [section for section in COMMON if section in row]
        common += [
            f"{section}.{key}" for section, keys in COMMON_KEYS.items() for key in keys if key in _keys(row, section)
        ]
        problems += [
            f"{path}: machine {name!r}: {key}: is common to all machines; write it once, at the top of the file"
            for key in common
        ]
        tables[name] = {key: value for key, value in row.items() if key != "name"}
    if problems:
        raise ConfigError(problems)
    return tables


def _keys(row: Mapping[str, Any], section: str) -> Mapping[str, Any]:
    table = row.get(section)
    return table if isinstance(table, dict) else {}


def _machine_config(
    path: Path, data: Mapping[str, Any], place: str, name: str = "", *, stamp: float, leads: bool = True
) -> Config:
    """The configuration of one machine from its whole table; `place` begins each sentence. Raises ConfigError."""
    home = path.parent
    content = validate_section(_PlantFile, data, place, home=home)
    links = make_links(content.device, home)
    rows = content.temperature or (_only(content.model),)
    problems = _problems(content, rows, links)
    if problems:
        raise ConfigError([f"{place}: {problem}" for problem in problems])
    first = rows[0]
    own = {key: getattr(content, key) for key in type(content).model_fields if key != "temperature"}
    own["model"] = ModelSection(path=first.model, temperature=first.tag, correction=first.correction)
    own["historian"] = content.historian.model_copy(update={"path": historian_file(content.historian, home)})
    config = Config(
        path=path,
        stamp=stamp,
        machine=name or links[0].map.name,
        several=bool(name),
        leads=leads,
        temperatures=rows,
        links=links,
        **own,
    )
    if shared := _shared_places(config):
        raise ConfigError([f"{place}: {problem}" for problem in shared])
    return config


def _shared_places(config: Config) -> list[str]:
    """Files that would be one and the same.

    Each file that the gateway writes is written as if it were the only one: a log in a device file would spoil it, and
    records in a plant file would set it aside as a damaged database.
    """
    names = dict[tuple[int, int], Path]()

    def real(path: Path) -> Path:
        """The path without symbolic links; of two names of one file the first that was asked about."""
        # Not `resolve`, which raises a RuntimeError for a ring of links.
        place = Path(os.path.realpath(path))
        try:
            status = place.stat()
        except OSError:
            return place
        single = status.st_nlink == 1 or S_ISDIR(status.st_mode)
        return place if single else names.setdefault((status.st_dev, status.st_ino), place)

    written = {**config.written_files, "page.users": config.users}
    beside = {
        real(path.with_name(path.name + ending)): f"a file that the database of {key} keeps beside it"
        for key, path in (("historian.path", config.historian.path), ("writeback.audit", config.audit))
        for ending in ("-wal", "-shm", "-journal", ".lock")
    }
    folders = {real(row.model): row.tag for row in config.temperatures if row.model is not None}
    known = {real(config.path): "the plant file itself"}
    for place, link in enumerate(config.links):
        known.setdefault(real(link.map.path), "device.file" if len(config.links) == 1 else f"device.links[{place}]")
        for key in capabilities(link.map.driver).files:
            if isinstance(named := link.settings.get(key), str) and named:
                known.setdefault(real(Path(named)), f"the device's {key}")
    for row in config.temperatures:
        if row.model is not None:
            known.setdefault(real(row.model), f"the model of {row.tag}")
    for key, secrets in (("notify.secrets", config.notify.secrets), ("northbound.secrets", config.northbound.secrets)):
        if secrets is not None:
            known.setdefault(real(secrets), key)
    problems = []
    within = {folder: what for read, what in known.items() for folder in read.parents}
    for key, path in written.items():
        if (what := within.get(real(path))) is not None:
            # A folder where records belong is moved aside as damaged, with all that is in it.
            problems.append(f"{key}: {path} is a folder of {what}; give the path of a file")
            continue
        if (of := beside.get(real(path))) is not None:
            problems.append(f"{key}: {path} is {of}; give each a path of its own")
        elif path.exists() and (tag := next((folders[one] for one in real(path).parents if one in folders), "")):
            problems.append(f"{key}: {path} is a file of the model of {tag}; give each a path of its own")
        elif (other := known.setdefault(real(path), key)) != key:
            problems.append(f"{key}: {path} is the file of {other} too; give each a path of its own")
    return problems


def _only(model: ModelSection) -> TemperatureSection:
    """The one temperature of a file that names it in [model]."""
    return TemperatureSection(tag=model.temperature, model=model.path, correction=model.correction)


def historian_file(section: HistorianSection, home: Path) -> Path:
    """The database file: the one named, or the default beside the plant file.

    Of a plant file that names none and has its records where the default once was, those (record 0079).
    """
    if "path" in section.model_fields_set:
        return section.path
    file, former = home / section.path, home / FORMER_HISTORIAN
    return former if not file.exists() and former.exists() else file


_HOLDS_SECONDS = (DType.INT32, DType.UINT32, DType.INT64, DType.UINT64, DType.FLOAT64)
"""Kinds that can hold the seconds since 1970 to the second; a single float of them is minutes apart from the next."""


def _problems(content: _PlantFile, rows: Sequence[TemperatureSection], links: tuple[DeviceLink, ...]) -> list[str]:
    """What no single key shows: tags that the map lacks, models that are not there or do not go together, a speed for a
    real plant."""
    device = links[0].map
    tags = set(device.by_name)
    named = [("alarms.tags", tag) for tag in content.alarms.tags]
    key = "temperature[{}].tag" if content.temperature else "model.temperature"
    named = [*((key.format(place), row.tag) for place, row in enumerate(rows)), *named]
    named += [("alarms.twins", tag) for tag in content.alarms.twins]
    single = {"alarms.acknowledge": content.alarms.acknowledge, "clock.tag": content.clock.tag}
    named += [(key, tag) for key, tag in single.items() if tag is not None]
    problems = [
        f"{key}: {tag!r} is not a tag of {device.path}; {did_you_mean(tag, tags) or 'give one of its names'}"
        for key, tag in named
        if tag not in tags
    ]
    predicted = [row.tag for row in rows]
    heat = dict.fromkeys(tag for key, tag in named if not key.startswith(("clock", "alarms.ack")))
    switches = [tag for tag in heat if tag in tags and device.by_name[tag].is_switch]
    problems += [
        f"{next(key for key, named_tag in named if named_tag == tag)}: {tag!r} is a switch and no temperature; give a "
        f"tag of {device.path} that holds a number"
        for tag in switches
    ]
    if (tag := content.alarms.acknowledge) in heat:
        problems.append(
            f"alarms.acknowledge: {tag!r} is a temperature; give a tag that is 0 until somebody acknowledges"
        )
    if (tag := content.clock.tag) in tags and (tag in heat or device.by_name[tag].dtype not in _HOLDS_SECONDS):
        problems.append(
            f"clock.tag: {tag!r} cannot hold the seconds since 1970; give one that is a whole number of 32 bits"
        )
    problems += alarm_problems(content.alarm, tags, watched_tags(content.alarms, predicted), predicted, device.path)
    key = "temperature[{}].model" if content.temperature else "model.path"
    problems += [
        f"{key.format(place)}: there is nothing at {row.model}; give a model directory or JSON file, or "
        f"leave the key out to run without a model"
        for place, row in enumerate(rows)
        if row.model is not None and not row.model.exists()
    ]
    if content.temperature:
        problems += [
            f"model.{key}: stands beside [[temperature]]; write it into one of these tables, as temperature.TAG."
            f"{'model' if key == 'path' else 'tag'}"
            for key in sorted(content.model.model_fields_set)
        ]
        problems += [
            f"temperature[{place}].tag: {tag!r} is already predicted; name each temperature once"
            for place, tag in enumerate(predicted)
            if tag in predicted[:place]
        ]
    ensemble, models = content.ensemble, 1 + len(content.ensemble.members)
    problems += [
        f"ensemble.members: there is nothing at {path}; give a model directory or JSON file"
        for path in ensemble.members
        if not path.exists()
    ]
    if ensemble.members and rows[0].model is None:
        problems.append("ensemble.members: members are followed beside model.path, which is missing; give it too")
    if isinstance(ensemble.weights, tuple) and len(ensemble.weights) != models:
        problems.append(
            f"ensemble.weights: has {len(ensemble.weights)} weights for {models} models (model.path and "
            f"{models - 1} members); give one for each, model.path's first"
        )
    # The floor is every model's share at least: so many shares must leave something to be earned.
    if ensemble.floor * models >= 1:
        problems.append(
            f"ensemble.floor: {ensemble.floor:g} is too much for {models} models; give less than {1 / models:g}"
        )
    if content.writeback.mode != "off" and device.writeback is None:
        problems.append(f"writeback.mode: {device.path} has no [writeback] table; add one or set mode to 'off'")
    elif content.writeback.mode != "off" and device.find_block(rows[0].tag) is None:
        known = ", ".join(str(layout.temperature) for layout in device.writebacks)
        problems.append(
            f"writeback.mode: no block of {device.path} speaks of {rows[0].tag!r} (the first temperature), "
            f"only of {known}; add a [[writeback.blocks]] table for it or set mode to 'off'"
        )
    oldest = content.writeback.max_age
    if oldest is not None and device.writeback is not None and oldest >= device.writeback.timeout:
        problems.append(
            f"writeback.max_age: {oldest:g} s is no less than the PLC's own timer; give less than "
            f"{device.writeback.timeout:g} (timeout_s in {device.path})"
        )
    slowest = content.writeback.most_per_second
    if slowest is not None and device.writeback is not None and 1.0 / slowest >= device.writeback.timeout:
        problems.append(
            f"writeback.most_per_second: one block in {1.0 / slowest:g} s lets the PLC's own timer run out; "
            f"give more than {1.0 / device.writeback.timeout:g} (timeout_s is {device.writeback.timeout:g} in "
            f"{device.path})"
        )
    horizon = content.writeback.horizon
    if horizon is not None and horizon not in content.forecast.horizons:
        known = ", ".join(f"{value:g}" for value in content.forecast.horizons)
        problems.append(f"writeback.horizon: {horizon:g} is not among forecast.horizons; give one of {known}")
    return problems + link_problems(links, content.clock.speed)

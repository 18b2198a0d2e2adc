"""`[northbound]`: which other systems of the plant are told what is measured, predicted and alarmed, and how."""

from collections.abc import Mapping
from dataclasses import dataclass
from ipaddress import ip_address
from typing import Annotated, Any, ClassVar, Literal
from urllib.parse import urlsplit

from pydantic import Field, StringConstraints, field_validator, model_validator

from drivers.settings import ConfigError, FilePath, Line, Section
from gateway.settings.secrets import read_secrets, token_problems

_Table = Literal["samples", "predictions", "forecasts", "events", "alarms"]
TABLES: tuple[_Table, ...] = ("samples", "predictions", "forecasts", "events", "alarms")
"""What may be handed on: tables of the historian whose rows can be followed."""

_Tables = Annotated[tuple[_Table, ...], Field(strict=False)]
_Name = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,59}$")]
_HostName = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,252}$")]
NAME = "letters, digits, '_', '-' and '.', 60 at most"


@dataclass(frozen=True, slots=True)
class SinkKind:
    """What makes the sinks of a kind: `module` has their `make_sink`; `extra` is that of this package which they need
    ("": none), `needs` what of it has to be there. Nothing of it is loaded before a plant file asks for it."""

    module: str
    extra: str = ""
    needs: tuple[str, ...] = ()


class SinkRow(Section):
    """What every sink has. A kind of sink is a class derived from this, with its `kind`, and a field of
    NorthboundSection: alarm, checks, feeds and secrets follow from these. A private key's file is called `key`: what is
    in it is in no support bundle."""

    kind: ClassVar[SinkKind]
    name: _Name = Field(description=f"the name by which log, metrics and the saved place speak of it: {NAME}")
    tables: _Tables = Field(TABLES, min_length=1, description="the tables to hand on, of " + ", ".join(TABLES))

    @classmethod
    def __pydantic_init_subclass__(cls, **keys: Any) -> None:
        if "kind" not in vars(cls):
            raise TypeError(f"the sink {cls.__name__} has no kind: say which module makes it")

    @property
    def needs_password(self) -> bool:
        """Whether the file of secrets must have a password for it."""
        return False


class MqttRow(SinkRow):
    """`[[northbound.mqtt]]`: a broker, and what it is given: Sparkplug B, or plain JSON."""

    kind = SinkKind("gateway.outside.northbound.mqtt", "mqtt", ("paho.mqtt.client", "google.protobuf"))
    host: str = Field(min_length=1, description="the broker's name or address")
    port: int = Field(8883, ge=1, le=65535, description="a TCP port from 1 to 65535")
    version: Literal["5", "3.1.1"] = Field("5", description="the version of MQTT, '5' or '3.1.1'")
    payload: Literal["sparkplug", "json"] = Field("sparkplug", description="'sparkplug' (Sparkplug B) or 'json'")
    group: _Name = Field("decanter", description=f"Sparkplug's group, or the first level of JSON topics: {NAME}")
    node: _Name = Field("gateway", description=f"Sparkplug's edge node, or the second level of JSON topics: {NAME}")
    tls: bool = Field(True, description="true, or false for a broker on this machine")
    ca: FilePath | None = Field(
        None, description="the certificate of the authority to trust, the system's without this key"
    )
    certificate: FilePath | None = Field(None, description="this gateway's certificate, where the broker wants one")
    key: FilePath | None = Field(None, description="the key of that certificate")
    user: Line | None = Field(None, description="the name to log in with; its password is in the file of secrets")
    commands: bool = Field(
        False, description="true: alarms may be acknowledged by messages from the broker (docs/northbound.md)"
    )

    primary_host: _Name | None = Field(
        None,
        description=f"Sparkplug's primary host: rows are handed on only while its STATE says that it is online: {NAME}",
    )

    @property
    def needs_password(self) -> bool:
        """As who logs in has one."""
        return self.user is not None

    @model_validator(mode="after")
    def _check_protection(self) -> "MqttRow":
        if self.primary_host is not None and self.payload != "sparkplug":
            raise ValueError("primary_host is Sparkplug's; leave it out, or give payload = 'sparkplug'")
        if not self.tls and not is_loopback(self.host):
            raise ValueError(f"{self.host!r} would be told in the clear; leave tls true, or use a broker on 127.0.0.1")
        if (self.certificate is None) != (self.key is None):
            raise ValueError("certificate and key go together; give both, or neither")
        return self


class PostgresRow(SinkRow):
    """`[[northbound.postgres]]`: tables of a PostgreSQL database, made when they are not there."""

    kind = SinkKind("gateway.outside.northbound.postgres", "postgres", ("psycopg",))
    host: str = Field(min_length=1, description="the server's name or address, or the folder of its socket")
    port: int = Field(5432, ge=1, le=65535, description="a TCP port from 1 to 65535")
    database: Line = Field(description="the name of the database")
    user: Line = Field(description="the name to log in with; its password is in the file of secrets")
    table_schema: _Name = Field("decanter", description=f"the schema of the tables: {NAME}")
    node: _Name = Field("gateway", description=f"what tells this gateway's rows from another's: {NAME}")
    ca: FilePath | None = Field(
        None, description="the certificate of the authority to trust, the system's without this key"
    )

    @property
    def local(self) -> bool:
        """Whether nothing crosses a network."""
        return self.host.startswith("/") or is_loopback(self.host)


class InfluxRow(SinkRow):
    """`[[northbound.influx]]`: InfluxDB's line protocol over HTTP, by the interface of version 1 or of version 2."""

    kind = SinkKind("gateway.outside.northbound.influx")
    url: str = Field(description="the server's address, such as 'https://influx.example.com:8086'")
    database: Line | None = Field(None, description="the database of a server of version 1")
    bucket: Line | None = Field(None, description="the bucket of a server of version 2 or 3")
    organization: Line = Field("", description="the organization that the bucket belongs to")
    user: Line | None = Field(None, description="version 1: the name to log in with")
    node: _Name = Field("gateway", description=f"the tag that tells this gateway's points from another's: {NAME}")
    ca: FilePath | None = Field(
        None, description="the certificate of the authority to trust, the system's without this key"
    )

    @field_validator("url")
    @classmethod
    def _an_address(cls, url: str) -> str:
        parts = urlsplit(url)
        wrong = "give one such as 'https://influx.example.com:8086'"
        try:
            port = parts.port
        except ValueError:
            raise ValueError(f"the port of {url[:60]!r} is none; {wrong}") from None
        if (
            parts.scheme not in ("http", "https")
            or not parts.hostname
            or port == 0
            or not url.isascii()
            or not _is_plain(url)
        ):
            raise ValueError(f"{url[:60]!r} is no address of a server; {wrong}")
        if parts.username or parts.password or parts.path.strip("/") or parts.query:
            raise ValueError(f"the address is the server's alone, without log-in and path; {wrong}")
        if parts.scheme == "http" and not is_loopback(parts.hostname):
            raise ValueError(f"{url[:60]!r} would be told in the clear; {wrong}")
        return url

    @model_validator(mode="after")
    def _one_version(self) -> "InfluxRow":
        if (self.database is None) == (self.bucket is None):
            raise ValueError(f"{self.name!r} needs either database (version 1) or bucket (version 2); give one of them")
        return self


class MetricsSection(Section):
    """`[northbound.metrics]`: what Prometheus scrapes; off without a port."""

    port: int | None = Field(None, ge=0, le=65535, description="a TCP port, 0 for a free one, no key for no server")
    host: str = Field(
        "127.0.0.1", min_length=1, description="the address to listen on: this machine only, if not given"
    )
    names: Annotated[tuple[_HostName, ...], Field(strict=False)] = Field(
        (), max_length=20, description="the names by which it may be asked, beside addresses, 'localhost' and host"
    )


class OpcUaSection(Section):
    """`[northbound.opcua]`: an OPC UA server that plant systems read; off without a port."""

    port: int | None = Field(
        None, ge=0, le=65535, description="a TCP port (OPC UA's own is 4840), 0 for a free one, no key for no server"
    )
    host: str = Field(
        "127.0.0.1", min_length=1, description="the address to listen on: this machine only, if not given"
    )
    certificates: FilePath | None = Field(
        None,
        description="a folder with opcua.pem, opcua.key and trusted, as `decanter certificates --opcua` makes it; only "
        "clients whose certificates are in trusted are served then, by Basic256Sha256",
    )
    period: float = Field(1.0, ge=0.1, le=60, description="seconds between two looks at the machines, 0.1 to 60")
    most_clients: int = Field(16, ge=1, le=200, description="how many connections are served at a time, 1 to 200")

    @model_validator(mode="after")
    def _check_protection(self) -> "OpcUaSection":
        if self.port is not None and self.certificates is None and not is_loopback(self.host):
            raise ValueError(
                f"host {self.host!r} can be reached from other machines, and whoever reaches it would read all; give "
                "certificates (`decanter certificates FOLDER --opcua --host NAME` makes them), or listen on 127.0.0.1"
            )
        return self


class NorthboundSection(Section):
    """Who is handed what is on record, and the bound of what is kept for one that cannot be reached."""

    secrets: FilePath | None = Field(
        None, description="the file of secrets (TOML, readable by its owner alone), relative to this file"
    )
    backlog_hours: float = Field(
        72.0, gt=0, le=87_600, description="how old a row may be that is still handed on, in hours"
    )
    mqtt: Annotated[tuple[MqttRow, ...], Field(strict=False)] = Field(
        (), max_length=8, description="[[northbound.mqtt]] tables"
    )
    postgres: Annotated[tuple[PostgresRow, ...], Field(strict=False)] = Field(
        (), max_length=8, description="[[northbound.postgres]] tables"
    )
    influx: Annotated[tuple[InfluxRow, ...], Field(strict=False)] = Field(
        (), max_length=8, description="[[northbound.influx]] tables"
    )
    metrics: MetricsSection = Field(default_factory=MetricsSection, description="a [northbound.metrics] table")
    opcua: OpcUaSection = Field(default_factory=OpcUaSection, description="a [northbound.opcua] table")

    @property
    def sink_tables(self) -> Mapping[str, tuple[SinkRow, ...]]:
        """The tables of sinks by their keys, in the order in which they stand here."""
        of = {name: getattr(self, name) for name in type(self).model_fields}
        return {
            name: rows
            for name, rows in of.items()
            if isinstance(rows, tuple) and rows and all(isinstance(row, SinkRow) for row in rows)
        }

    @property
    def sinks(self) -> tuple[SinkRow, ...]:
        """All that is handed rows."""
        return tuple(row for rows in self.sink_tables.values() for row in rows)

    @property
    def enabled(self) -> bool:
        """Whether anybody is told anything."""
        return bool(self.sinks) or self.metrics.port is not None or self.opcua.port is not None

    @model_validator(mode="after")
    def _check_names(self) -> "NorthboundSection":
        names = [row.name for row in self.sinks]
        if twice := next((name for name in names if names.count(name) > 1), None):
            raise ValueError(f"{twice!r} is named twice; give each a name of its own")
        return self


class NorthboundSecrets(Section):
    """The file of secrets: by the sinks' names passwords, and tokens of InfluxDB."""

    passwords: Mapping[str, str] = Field({}, description="a table of passwords by the names of sinks", repr=False)
    tokens: Mapping[str, str] = Field({}, description="a table of tokens by the names of sinks", repr=False)


def load_northbound_secrets(section: NorthboundSection) -> NorthboundSecrets:
    """The secrets of `[northbound]`; none without a file.

    Raises ConfigError for one that others may read or that lacks what is needed. What it holds is in no sentence.
    """
    path = section.secrets
    if path is None:
        return NorthboundSecrets()
    found = read_secrets(NorthboundSecrets, path, page="docs/northbound.md")
    known = {row.name for row in section.sinks}
    problems = token_problems(path, found.tokens)
    problems += [
        f"{path}: {table}: there is no sink {name!r}; known are {', '.join(sorted(known)) or 'none'}"
        for table, names in (("passwords", found.passwords), ("tokens", found.tokens))
        for name in names
        if name not in known
    ]
    problems += [
        f"{path}: passwords: has none for {row.name!r}; add that of its user"
        for row in section.sinks
        if row.needs_password and row.name not in found.passwords
    ]
    if problems:
        raise ConfigError(problems)
    return found


def _is_plain(url: str) -> bool:
    return url.isprintable() and " " not in url


def is_loopback(host: str) -> bool:
    """Whether a host is this machine."""
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"

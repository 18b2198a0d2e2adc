"""What every driver is, and how one is opened by name.

A driver speaks one device. Polled and pushed inputs are two verbs: `Driver.read` asks, `Streams.stream` listens.
"""

from collections import Counter
from collections.abc import AsyncIterator, Callable, Iterator, Mapping, Sequence
from enum import Enum
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, Self, runtime_checkable

from drivers.capabilities import Capabilities, LinkKind
from drivers.connections import Connections
from drivers.errors import DriverError, missing_part
from drivers.tag import Sample, Tag, Value

if TYPE_CHECKING:
    from drivers.supervision import Supervisor  # asyncio with it, which no help needs

Clock = Callable[[], float]
BeforeSending = Callable[[], None]
"""What a write asks last of all, when it has waited for everything and the next thing is the wire: what it raises is
raised by the write, and nothing (more) is sent."""


def anyhow() -> None:
    """Send it: the BeforeSending of whoever has no objection."""


@runtime_checkable
class Driver(Protocol):
    """One device behind one connection.

    A driver keeps its own connection: after `open` it reconnects by itself until `close`. `read` never raises for
    what the link or the device does; it answers one Sample a tag, in the order asked, within the driver's deadline.
    """

    async def open(self) -> None:
        """Start the supervisor and try once. Raises DriverError if the first attempt fails (it goes on trying)."""
        ...

    async def close(self) -> None:
        """Stop the supervisor and close the connection. Never raises; may be called twice."""
        ...

    async def read(self, tags: Sequence[Tag]) -> list[Sample]:
        """Read all tags now; a failure is a Sample of bad quality with the reason."""
        ...

    @property
    def connected(self) -> bool:
        """True while a valid reply has arrived recently enough for the dead-peer rule."""
        ...

    def statistics(self) -> Mapping[str, float]:
        """Counters since `open`: requests, timeouts, mismatches, reconnects, quarantined, ..."""
        ...


@runtime_checkable
class Writes(Protocol):
    """A driver that can write to the tags of its closed write map."""

    async def write(self, values: Sequence[tuple[Tag, Value]], *, before_sending: BeforeSending = anyhow) -> None:
        """Write all values as one block, once on the wire, and verify by reading back.

        `before_sending` is called right before each request or frame leaves, after every lock and pause.

        Raises WriteForbidden, EncodingError or AddressError (nothing was sent), LinkDown, ReplyTimeout, ReplyMismatch,
        DeviceException or WriteUnverified. Never retries: whether to write again is the caller's decision.
        """
        ...


@runtime_checkable
class Streams(Protocol):
    """A driver whose device speaks by itself."""

    def stream(self, tags: Sequence[Tag]) -> AsyncIterator[Sample]:
        """Yield samples as they arrive, until `close`; silence beyond a deadline arrives as a sample of bad quality."""
        ...


class Recorded(Protocol):
    """A recording on its way through the decoder of a driver: iterate `samples` once; the rest is complete after that.

    `identifiers` counts its messages by (bus, name), `readings` its samples by (tag, quality).
    """

    identifiers: Counter[tuple[str, str]]
    readings: Counter[tuple[str, str]]

    def samples(self, progress: Callable[[str, float], None]) -> Iterator[Sample]:
        """Every reading in the recording's order and at its own times. Raises DriverError if it holds no message."""
        ...

    def counts(self) -> Mapping[str, int]:
        """What became of all records and messages."""
        ...

    @property
    def problem(self) -> str:
        """What of the recording could not be used, in words; "" if all could."""
        ...


class PlanKind(Enum):
    """What a line of a plan is about."""

    PROBLEM = "problem"  # a tag that cannot be read, and why
    HEARD = "heard"  # what comes by itself, and after how long without it it is late
    OTHER = "other"  # a request, a cost, a source


class PlanLine(str):
    """One sentence of a plan for people, and its kind for those who decide by it."""

    __slots__ = ("kind",)
    kind: PlanKind

    def __new__(cls, sentence: str, kind: PlanKind = PlanKind.OTHER) -> Self:
        line = super().__new__(cls, sentence)
        line.kind = kind
        return line


@runtime_checkable
class Explains(Protocol):
    """A driver that can say beforehand how it would read."""

    def explain(self, tags: Sequence[Tag]) -> tuple[PlanLine, ...]:
        """The plan in sentences: tags that cannot be read and why, each request, the worst-case cycle time."""
        ...


@runtime_checkable
class Cautions(Protocol):
    """A driver that knows what works today and should not stay so."""

    def cautions(self) -> tuple[str, ...]:
        """In sentences: a private key that others may read, a certificate that ends soon."""
        ...


@runtime_checkable
class Hears(Protocol):
    """A driver of a device that speaks by itself."""

    def validity_seconds(self, tags: Sequence[Tag]) -> Mapping[str, float]:
        """Seconds for which what was heard last is good, by tag; without the tags that are asked for."""
        ...


@runtime_checkable
class Complains(Protocol):
    """A driver that hears from the device, or from its bus, what is wrong with it."""

    def complaints(self) -> tuple[str, ...]:
        """What is wrong now, in sentences; empty where nothing is."""
        ...


@runtime_checkable
class Supervised(Protocol):
    """A driver that keeps threads or tasks of its own going."""

    supervisor: "Supervisor"
    """Knows all of them; whoever runs the driver takes it into his own."""


DRIVERS: dict[str, Capabilities] = {
    "can": Capabilities(
        opens="drivers.can.driver:open_can",
        surveys="drivers.canopen.survey:open_survey",
        decodes="drivers.vehicle.batch:decode_log",
        speaks=True,
        bus=True,
        block="frames",
        described_in="its DBC file",
        files=frozenset({"dbc"}),
        # It counts as a request each look at what it has heard; on the bus it asks nothing.
        requests=("sent", "obd_requests"),
    ),
    "can-log": Capabilities(
        opens="drivers.vehicle.replay:open_can_log",
        decodes="drivers.vehicle.batch:decode_log",
        speaks=True,
        described_in="its DBC file",
        files=frozenset({"log", "dbc"}),
        requests=(),
    ),
    "canopen": Capabilities(
        opens="drivers.canopen.driver:open_canopen",
        identifies="drivers.canopen.options:node_identity",
        surveys="drivers.canopen.survey:open_survey",
        speaks=True,
        nodes=True,
        bus=True,
        block="frames",
        described_in="its EDS file",
        files=frozenset({"eds"}),
    ),
    "modbus": Capabilities(
        opens="drivers.modbus.driver:open_modbus",
        surveys="drivers.modbus.survey:open_survey",
        plans="drivers.modbus.preview:plan_requests",
        locates="drivers.modbus.address:place_of_tag",
        shares="drivers.modbus.settings:shared_place",
        identifies="drivers.modbus.settings:device_identity",
        registers=True,
        units=True,
        block="words",
        networked=True,
        certificates=True,
        files=frozenset({"certificates"}),
    ),
    "soft": Capabilities(opens="drivers.soft.driver:open_soft", block="words", described_in="its recording"),
}
"""Every driver. A new one is its module, its row here, and its line in the contract suite."""

LINKS: dict[str, LinkKind] = {
    "modbus": LinkKind(
        driver="modbus",
        medium="tcp",
        needs=("host",),
        settings={"transport": "tcp"},
        mistaken_for="modbus-rtu-tcp",
    ),
    "modbus-tls": LinkKind(
        driver="modbus", medium="tcp", needs=("host", "certificates"), settings={"transport": "tls"}
    ),
    "modbus-rtu": LinkKind(
        driver="modbus",
        medium="serial",
        needs=("serial",),
        settings={"transport": "rtu"},
        sign="serial",
        line=True,
    ),
    "modbus-rtu-tcp": LinkKind(
        driver="modbus",
        medium="tcp",
        needs=("host", "port"),
        settings={"transport": "rtu-tcp"},
        line=True,
        mistaken_for="modbus",
    ),
    "modbus-ascii": LinkKind(
        driver="modbus", medium="serial", needs=("serial",), settings={"transport": "ascii"}, line=True
    ),
    "modbus-ascii-tcp": LinkKind(
        driver="modbus", medium="tcp", needs=("host", "port"), settings={"transport": "ascii-tcp"}, line=True
    ),
    "modbus-udp": LinkKind(driver="modbus", medium="udp", needs=("host",), settings={"transport": "udp"}),
    "canopen": LinkKind(driver="canopen", medium="can", needs=("channel",), defaults={"node": 1}),
    "can": LinkKind(driver="can", medium="can", needs=("channel",)),
}
"""Every link that `--link` names; of a driver's links the first one is meant where its settings do not say which."""


def capabilities(driver: str) -> Capabilities:
    """What the driver's devices are like. Raises DriverError with the list of known drivers for an unknown one."""
    try:
        return DRIVERS[driver]
    except KeyError:
        raise DriverError(f"unknown driver {driver!r}: known are {', '.join(sorted(DRIVERS))}") from None


def link_name(driver: str, settings: Mapping[str, Any]) -> str:
    """The name that `--link` would give to a driver with these settings: a key of LINKS, or the driver's own name."""
    own = {name: link for name, link in LINKS.items() if link.driver == driver}
    for name, link in own.items():
        if link.settings and all(settings.get(key) == value for key, value in link.settings.items()):
            return name
    distinct = {key for link in own.values() for key in link.settings if key in settings}
    if distinct:
        return f"{driver}-{settings[min(distinct)]}"  # no such link, which the caller says
    signs = (name for name, link in own.items() if link.sign and link.sign in settings)
    return next(signs, next(iter(own), driver))


def load_function(target: str) -> Callable[..., Any]:
    """The function that `module:function` names; only now is its module imported, with the libraries that it needs.

    Raises DriverError where that part of the program is not installed.
    """
    module, _, name = target.partition(":")
    try:
        function: Callable[..., Any] = getattr(import_module(module), name)
    except ModuleNotFoundError as error:
        if not (lacking := missing_part(error)):
            raise
        raise DriverError(f"{name} {lacking}") from None
    return function


def open_driver(
    kind: str,
    settings: Mapping[str, Any],
    *,
    clock: Clock,
    write_map: Sequence[Tag] = (),
    seed: int = 0,
    connections: Connections | None = None,
) -> Driver:
    """Make the driver called `kind` (a key of DRIVERS), not yet opened.

    `settings` are the driver's own (host, port, unit, ...), checked there. `clock` stamps the samples (seconds UTC).
    Only tags in `write_map` can ever be written. `seed` feeds the jitter of the back-off. Drivers that are
    given the same `connections` share what leads to several devices, where they can (`Capabilities.units`).

    Raises DriverError with the list of known kinds for an unknown one, and for a setting that the driver does not know
    or cannot use.
    """
    driver = capabilities(kind)
    factory: Callable[..., Driver] = load_function(driver.opens)
    shared = {"connections": connections} if driver.units else {}
    return factory(settings, clock=clock, write_map=tuple(write_map), seed=seed, **shared)


def open_recording(kind: str, path: Path, settings: Mapping[str, Any], tags: Sequence[Tag]) -> Recorded:
    """The recording at `path`, to be decoded at once as the driver called `kind` would decode it live.

    `settings` are the driver's own. Raises DriverError for a driver that has no recordings (it lists those that have),
    a setting, an address or a file that cannot be used.
    """
    target = capabilities(kind).decodes
    if not target:
        known = " or ".join(sorted(name for name, row in DRIVERS.items() if row.decodes))
        raise DriverError(f"driver {kind!r} has no recordings; give a device of {known}")
    decode: Callable[..., Recorded] = load_function(target)
    return decode(path, settings, tags)

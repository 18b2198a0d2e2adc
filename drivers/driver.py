"""What every driver is, and how one is opened by name.

A driver speaks one device. Polled and pushed inputs are two verbs: `Driver.read` asks, `Streams.stream` listens.
"""

from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from importlib import import_module
from typing import Any, Protocol, runtime_checkable

from drivers.errors import DriverError
from drivers.tag import Sample, Tag, Value

Clock = Callable[[], float]


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

    async def write(self, values: Sequence[tuple[Tag, Value]]) -> None:
        """Write all values as one block, once on the wire, and verify by reading back.

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


@runtime_checkable
class Explains(Protocol):
    """A driver that can say beforehand how it would read."""

    def explain(self, tags: Sequence[Tag]) -> tuple[str, ...]:
        """The plan in sentences: tags that cannot be read and why, each request, the worst-case cycle time."""
        ...


DRIVERS: dict[str, str] = {
    "modbus": "drivers.modbus:open_modbus",
    "soft": "drivers.soft:open_soft",
}


def open_driver(
    kind: str, settings: Mapping[str, Any], *, clock: Clock, write_map: Sequence[Tag] = (), seed: int = 0
) -> Driver:
    """Make the driver called `kind` (a key of DRIVERS), not yet opened.

    `settings` are the driver's own (host, port, unit, ...), checked there. `clock` stamps the samples (seconds UTC).
    Only tags in `write_map` can ever be written. `seed` feeds the jitter of the back-off. Raises DriverError with the
    list of known kinds for an unknown one, and for a setting that the driver does not know or cannot use.
    """
    target = DRIVERS.get(kind)
    if target is None:
        raise DriverError(f"unknown driver {kind!r}: known are {', '.join(sorted(DRIVERS))}")
    module, _, function = target.partition(":")
    factory: Callable[..., Driver] = getattr(import_module(module), function)
    return factory(settings, clock=clock, write_map=tuple(write_map), seed=seed)

"""Tags in messages of protocols above CAN, such as `obd:0C` or `spn:190`: their decoder, opened by name as drivers are.

This package knows frames and bit fields and none of those protocols. Whoever decodes them is given every frame of the
bus and tells which tags it has brought up to date; each tag has a slot of its own in the reception, so that it ages,
and starts anew with the connection, as a field does.
"""

from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from typing import Protocol

from drivers.can.frame import CanFrame
from drivers.can.reception import Channel, Reception, Slot
from drivers.can.settings import CanSettings
from drivers.codec import Reading
from drivers.driver import PlanLine
from drivers.errors import AddressError, missing_part
from drivers.supervision import Supervisor
from drivers.tag import Tag

PREFIXES = ("obd:", "spn:", "pgn:", "j1939:", "dm1:")
DECODER = "drivers.vehicle.live:LiveVehicle"
"""Beginnings of the addresses that are no fields of frames, and what is called with the driver's settings and the
reception to decode them: a MessageDecoder. It is also given what keeps its tasks going. Raises DriverError."""

Send = Callable[[int, bool, bytes], None]
"""Puts a frame on the bus: identifier, 29-bit, data. Raises DriverError if it cannot."""


class MessageDecoder(Protocol):
    """Tags of messages on a live bus. Moments are monotonic seconds."""

    @property
    def listens(self) -> bool:
        """True if there is any such tag: then all frames of the bus are needed."""
        ...

    def listen(self, tag: Tag, now: float) -> tuple[Channel, Slot]:
        """Listen for the tag from now on. Raises AddressError."""
        ...

    def take(self, frame: CanFrame, now: float) -> Sequence[Slot]:
        """The tags' slots that this frame has brought up to date."""
        ...

    def reading(self, slot: Slot) -> Reading:
        """What was read last for the slot's tag."""
        ...

    def describe(self) -> list[PlanLine]:
        """In sentences: the tags that are listened for with their timeouts, and what is asked for."""
        ...

    def counts(self) -> Mapping[str, int]:
        """What became of messages, and requests that were sent."""
        ...

    def start(self, send: Send) -> None:
        """Begin to ask, if the settings say so: the bus is there (anew)."""
        ...

    def stop(self) -> None:
        """Stop asking."""
        ...


def is_message_tag(tag: Tag) -> bool:
    """True for a tag of another notation than fields and DBC signals."""
    return tag.address.startswith(PREFIXES)


def message_decoder(settings: CanSettings, reception: Reception, supervisor: Supervisor) -> MessageDecoder:
    """The decoder of such tags; where none is installed, one that refuses them.

    Raises DriverError for a setting that it cannot use.
    """
    module, _, name = DECODER.partition(":")
    try:
        made = getattr(import_module(module), name)
    except ModuleNotFoundError as error:
        if not (lacking := missing_part(error)):
            raise
        return _NoDecoder(lacking)
    decoder: MessageDecoder = made(settings, reception, supervisor)
    return decoder


class _NoDecoder:
    """Stands for a decoder that is not installed: it refuses each tag of its notations, and hears and asks nothing."""

    listens = False

    def __init__(self, lacking: str) -> None:
        self._lacking = lacking

    def listen(self, tag: Tag, now: float) -> tuple[Channel, Slot]:
        raise AddressError(f"{tag.name}: {tag.address} {self._lacking}")

    def take(self, frame: CanFrame, now: float) -> Sequence[Slot]:
        return ()

    def reading(self, slot: Slot) -> Reading:
        raise LookupError("no tag was listened for")

    def describe(self) -> list[PlanLine]:
        return []

    def counts(self) -> Mapping[str, int]:
        return {}

    def start(self, send: Send) -> None:
        return

    def stop(self) -> None:
        return

"""OBD-II and J1939 tags on a live bus, beside the plain fields: each has a slot of its own in the reception."""

import asyncio
from collections.abc import Mapping, Sequence
from contextlib import suppress

from drivers.can import CanFrame, CanSettings, Channel, MessageRules, Reception, Send, Slot
from drivers.codec import Reading
from drivers.driver import PlanKind, PlanLine
from drivers.errors import AddressError, DriverError
from drivers.supervision import Supervisor
from drivers.tag import Quality, Tag
from drivers.vehicle.decoding import Vehicle
from drivers.vehicle.obd_poll import Poller

_RETRY_S = 1.0


class LiveVehicle:
    """What units tell by themselves, and with `poll = true` what they answer. Moments are monotonic seconds."""

    def __init__(self, settings: CanSettings, reception: Reception, supervisor: Supervisor) -> None:
        self._supervisor = supervisor
        self._vehicle = Vehicle(settings)
        self._reception = reception
        self._poller = Poller(lambda: self._vehicle.parameters, settings) if settings.poll else None
        self._polling: asyncio.Task[None] | None = None
        self._places: dict[str, tuple[Channel, Slot]] = {}
        self._readings: dict[int, Reading] = {}

    @property
    def listens(self) -> bool:
        """True if there is any such tag: then all frames of the bus are needed."""
        return bool(self._places)

    def listen(self, tag: Tag, now: float) -> tuple[Channel, Slot]:
        """Listen for the tag from now on. Raises AddressError."""
        self._vehicle.listen([tag])
        problem = self._vehicle.problems.get(tag.name)
        if problem is not None:
            raise AddressError(problem)
        if tag.name not in self._places:
            # No frame has a negative key: a slot of its own, which ages and restarts like the others.
            rules = MessageRules(-1 - len(self._places), tag.address)
            self._places[tag.name] = self._reception.listen(rules, (), self._vehicle.timeout(tag), now)
        return self._places[tag.name]

    def take(self, frame: CanFrame, now: float) -> Sequence[Slot]:
        """The tags' slots that this frame has brought up to date."""
        if not self._places:
            return ()
        timed = frame._replace(time=now)  # the protocols' timeouts do not depend on the driver's clock
        if self._poller is not None and self._polling is not None:
            with suppress(DriverError):  # the unit waits in vain, and is asked again in the next round
                self._poller.take(timed)
        fresh = []
        for reading in self._vehicle.take(timed):
            _, slot = self._places[reading.tag.name]
            slot.frame, slot.heard = frame, now
            self._readings[id(slot)] = reading.reading
            fresh.append(slot)
        if fresh:
            self._reception.heard = now
        return fresh

    def reading(self, slot: Slot) -> Reading:
        """What was told last for the slot's tag."""
        return self._readings.get(id(slot), (None, Quality.WAITING_FOR_INITIAL_DATA, ""))

    def describe(self) -> list[PlanLine]:
        """In sentences: the tags that are listened for with their timeouts, and what is asked for."""
        heard = [
            PlanLine(f"{slot.name}, bad after {slot.timeout:.3g} s: {name}", PlanKind.HEARD)
            for name, (_, slot) in self._places.items()
        ]
        return heard + ([] if self._poller is None else [PlanLine(line) for line in self._poller.describe()])

    def counts(self) -> Mapping[str, int]:
        """What became of messages, and requests that were sent."""
        return self._vehicle.counts() | (self._poller.counts if self._poller else {})

    def start(self, send: Send) -> None:
        """Begin to ask, if the settings say so: the bus is there (anew)."""
        self.stop()
        self._vehicle.restart()
        poller = self._poller
        if poller is None:
            return

        async def ask() -> None:
            # Until cancelled; a bus that takes no frame (nobody acknowledges, the queue is full) is tried again.
            while True:
                with suppress(DriverError):
                    await poller.run(send)
                await asyncio.sleep(_RETRY_S)

        self._polling = self._supervisor.task("OBD requests", ask)

    def stop(self) -> None:
        """Stop asking."""
        polling, self._polling = self._polling, None
        if polling is not None:
            polling.cancel()

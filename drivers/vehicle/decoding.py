"""Tags of every notation on frames from anywhere: plain fields, DBC signals, OBD-II and J1939."""

from collections.abc import Callable, Sequence
from pathlib import Path

from drivers.can import (
    CanFrame,
    Dbc,
    DecodingSettings,
    Field,
    FrameListener,
    Reception,
    SignalMap,
    TagReading,
    decode_value,
    frame_key,
    is_message_tag,
)
from drivers.errors import AddressError, DriverError
from drivers.tag import Tag
from drivers.vehicle import j1939, obd

_OBD = "obd:"


class Vehicle:
    """OBD-II and J1939 tags on one or more buses; tags join as they are asked for.

    `problems` says of a tag's name why its address means nothing. Raises DriverError for settings.
    """

    def __init__(self, settings: DecodingSettings) -> None:
        self._settings = settings
        self._dbc = None if settings.dbc is None else Dbc(Path(settings.dbc))
        self._timeouts: dict[str, float] = {}
        for name, seconds in settings.answer_timeouts.items():
            if isinstance(seconds, bool) or not isinstance(seconds, int | float) or not 0 < seconds <= 86_400:
                raise DriverError(f"can: answer_timeouts: {name}: {seconds!r} must be seconds above 0, at most a day")
            self._timeouts[name] = float(seconds)
        self._tags: dict[str, Tag] = {}
        self._listeners: list[FrameListener] = []
        self._obd: list[Tag] = []
        self.problems: dict[str, str] = {}

    @property
    def parameters(self) -> Sequence[obd.ObdTag]:
        """The OBD-II parameters that the tags need, for whoever asks for them."""
        return [obd.parse_tag(tag) for tag in self._obd]

    def listen(self, tags: Sequence[Tag]) -> None:
        """Add tags; those that are listened for already stay as they are."""
        fresh = [tag for tag in tags if is_message_tag(tag) and self._tags.get(tag.name) != tag]
        if not fresh:
            return
        self._tags |= {tag.name: tag for tag in fresh}
        self.problems = {}
        self._obd = self._meaningful(obd.parse_tag, obd_tags=True)
        source = self._settings.source
        trucks = self._meaningful(lambda tag: j1939.parse_tag(tag, source, self._dbc), obd_tags=False)
        self._listeners = [obd.ObdListener(self._obd)] if self._obd else []
        if trucks:
            s = self._settings
            self._listeners.append(
                j1939.J1939Listener(trucks, source=s.source, dbc=self._dbc, conversion=s.spn_conversion)
            )

    def take(self, frame: CanFrame) -> list[TagReading]:
        """What the frame, or the message that it completes, says of the tags."""
        return [reading for listener in self._listeners for reading in listener.take(frame)]

    def restart(self) -> None:
        """It is another connection: no message that began before it is gone on with."""
        for listener in self._listeners:
            listener.restart()

    def timeout(self, tag: Tag) -> float:
        """Seconds after which the tag's last value is too old."""
        return self._timeouts.get(tag.name, float(self._settings.answer_timeout))

    def counts(self) -> dict[str, int]:
        """What became of the frames and messages."""
        return {name: count for listener in self._listeners for name, count in listener.counts().items()}

    def _meaningful(self, meaning: Callable[[Tag], object], *, obd_tags: bool) -> list[Tag]:
        good = []
        for tag in self._tags.values():
            if tag.address.startswith(_OBD) is not obd_tags:
                continue
            try:
                meaning(tag)
            except AddressError as error:
                self.problems[tag.name] = str(error)
            else:
                good.append(tag)
        return good


class Decoder:
    """All tags of a device on recorded frames, on the frames' own clock.

    Fields and DBC signals are judged as the live driver judges them. Raises DriverError for settings; `problems` is
    about single tags.
    """

    def __init__(self, settings: DecodingSettings) -> None:
        self._signals = SignalMap(settings)
        self._reception = Reception()
        self._fields: dict[int, list[tuple[Tag, Field]]] = {}
        self._timeouts: dict[str, float] = {}
        self._tags: dict[str, Tag] = {}
        self.vehicle = Vehicle(settings)
        self.problems: dict[str, str] = {}

    def listen(self, tags: Sequence[Tag]) -> None:
        """Add tags; those that are listened for already stay as they are."""
        fresh = [tag for tag in tags if self._tags.get(tag.name) != tag]
        if not fresh:
            return
        self._tags |= {tag.name: tag for tag in fresh}
        self.vehicle.listen(fresh)
        self.problems = dict(self.vehicle.problems)
        self._reception, self._fields, self._timeouts = Reception(), {}, {}
        for tag in self._tags.values():
            if is_message_tag(tag):
                continue
            try:
                place = self._signals.place(tag)
            except AddressError as error:
                self.problems[tag.name] = str(error)
                continue
            _, slot = self._reception.listen(place.rules, place.field.conditions, place.timeout, 0.0)
            self._fields.setdefault(id(slot), []).append((place.tag, place.field))
            self._timeouts[tag.name] = place.timeout

    @property
    def omissions(self) -> tuple[str, ...]:
        """What of the DBC file cannot be used, in sentences."""
        return self._signals.omissions

    def take(self, frame: CanFrame) -> list[TagReading]:
        """What the frame, or the message that it completes, says of the tags.

        A frame of a wrong length, checksum or sequence says nothing.
        """
        readings = self.vehicle.take(frame)
        if self._fields:
            key = frame_key(frame.id, extended=frame.extended)
            for slot in self._reception.take(key, frame, frame.time):
                for tag, field in self._fields.get(id(slot), ()):
                    readings.append(TagReading(tag, decode_value(tag, field, frame.data)))
        return readings

    def timeout(self, tag: Tag) -> float:
        """Seconds after which the tag's last value is too old."""
        return self._timeouts.get(tag.name) or self.vehicle.timeout(tag)

    def counts(self) -> dict[str, int]:
        """What became of the frames and messages; `raw_`: frames of fields, used, refused, and of no tag."""
        raw = {f"raw_{name}": count for name, count in self._reception.counts.items()} if self._fields else {}
        return self.vehicle.counts() | raw

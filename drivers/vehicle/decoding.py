"""Tags of every notation on frames from anywhere: plain fields, DBC signals, OBD-II and J1939."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from drivers.can.dbc import Dbc
from drivers.can.frame import Found, Frame, Listener
from drivers.can.signals import SignalMap
from drivers.errors import AddressError, DriverError
from drivers.settings import Setting
from drivers.tag import Tag
from drivers.vehicle import j1939, obd
from drivers.vehicle.raw import RawListener

DECODING: dict[str, Setting] = {
    "dbc": Setting(str, optional=True),
    "exact_length": Setting(bool, True),
    "timeouts": Setting(dict, optional=True),
    "message_timeout": Setting(float, 2.0, 0.001, 86_400.0),
    "timeout_cycles": Setting(float, 3.0, 1.0, 1000.0),
    "least_timeout": Setting(float, 0.2, 0.001, 60.0),
}
"""The settings of the raw driver that say how frames are read; a recorded log takes the same."""

VEHICLE: dict[str, Setting] = {
    "source": Setting(int, j1939.ENGINE, 0, 0xFD),
    "spn_conversion": Setting(int, None, 1, 3, optional=True),
    "answer_timeout": Setting(float, 10.0, 0.001, 86_400.0),
    "answer_timeouts": Setting(dict, optional=True),
}
"""Settings for OBD-II and J1939 tags: whose parameters (`source`), how old codes write an SPN, and the longest age."""

_J1939 = ("spn:", "pgn:", "j1939:", "dm1:")
_OBD = ("obd:",)


def is_vehicle(tag: Tag) -> bool:
    """True for a tag of OBD-II or J1939: it comes in messages of its own, not in fields of frames."""
    return tag.address.startswith((*_OBD, *_J1939))


class Vehicle:
    """OBD-II and J1939 tags on one or more buses; tags join as they are asked for.

    `problems` says of a tag's name why its address means nothing. Raises DriverError for settings.
    """

    def __init__(self, settings: Mapping[str, Any]) -> None:
        self._settings = settings
        self._dbc = None if settings["dbc"] is None else Dbc(Path(settings["dbc"]))
        self._timeouts = {name: _seconds(name, s) for name, s in (settings["answer_timeouts"] or {}).items()}
        self._tags: dict[str, Tag] = {}
        self._listeners: list[Listener] = []
        self._obd: list[Tag] = []
        self.problems: dict[str, str] = {}

    @property
    def parameters(self) -> Sequence[obd.Wanted]:
        """The OBD-II parameters that the tags need, for whoever asks for them."""
        return [obd.wanted(tag) for tag in self._obd]

    def listen(self, tags: Sequence[Tag]) -> None:
        """Add tags; those that are listened for already stay as they are."""
        fresh = [tag for tag in tags if is_vehicle(tag) and self._tags.get(tag.name) != tag]
        if not fresh:
            return
        self._tags |= {tag.name: tag for tag in fresh}
        self.problems = {}
        self._obd = self._meant(_OBD, obd.wanted)
        trucks = self._meant(_J1939, lambda tag: j1939.wanted(tag, self._settings["source"], self._dbc))
        self._listeners = [obd.ObdListener(self._obd)] if self._obd else []
        if trucks:
            s = self._settings
            self._listeners.append(
                j1939.J1939Listener(trucks, source=s["source"], dbc=self._dbc, conversion=s["spn_conversion"])
            )

    def take(self, frame: Frame) -> list[Found]:
        """What the frame, or the message that it completes, says of the tags."""
        return [found for listener in self._listeners for found in listener.take(frame)]

    def timeout(self, tag: Tag) -> float:
        """Seconds after which the tag's last value is too old."""
        return self._timeouts.get(tag.name, float(self._settings["answer_timeout"]))

    def counts(self) -> dict[str, int]:
        """What became of the frames and messages."""
        return {name: count for listener in self._listeners for name, count in listener.counts().items()}

    def _meant(self, prefixes: tuple[str, ...], meaning: Callable[[Tag], object]) -> list[Tag]:
        good = []
        for tag in self._tags.values():
            if not tag.address.startswith(prefixes):
                continue
            try:
                meaning(tag)
            except AddressError as error:
                self.problems[tag.name] = str(error)
            else:
                good.append(tag)
        return good


class Decoder:
    """All tags of a device on recorded frames. Raises DriverError for settings; `problems` is about single tags."""

    def __init__(self, settings: Mapping[str, Any]) -> None:
        self._settings = settings
        self._signals = SignalMap(settings)
        self._raw: RawListener | None = None
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
        good = []
        for tag in self._tags.values():
            if is_vehicle(tag):
                continue
            try:
                self._signals.place(tag)
            except AddressError as error:
                self.problems[tag.name] = str(error)
            else:
                good.append(tag)
        self._raw = RawListener(good, self._signals) if good else None

    def take(self, frame: Frame) -> list[Found]:
        """What the frame, or the message that it completes, says of the tags."""
        found = self.vehicle.take(frame)
        return found if self._raw is None else [*found, *self._raw.take(frame)]

    def timeout(self, tag: Tag) -> float:
        """Seconds after which the tag's last value is too old."""
        raw = {} if self._raw is None else self._raw.timeouts
        return raw.get(tag.name) or self.vehicle.timeout(tag)

    def counts(self) -> dict[str, int]:
        """What became of the frames and messages."""
        return self.vehicle.counts() | ({} if self._raw is None else dict(self._raw.counts()))


def _seconds(name: str, seconds: object) -> float:
    if isinstance(seconds, bool) or not isinstance(seconds, int | float) or not 0 < seconds <= 86_400:
        raise DriverError(f"can: answer_timeouts: {name}: {seconds!r} must be seconds above 0, at most a day")
    return float(seconds)

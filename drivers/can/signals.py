"""From tags to places: which message a tag lies in, how that message is judged, and when it is too old."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from drivers.can.dbc import PREFIX, Dbc, MessageFacts
from drivers.can.fields import Field, frame_name, layout_name, parse_field, parse_frame
from drivers.can.reception import MessageRules
from drivers.can.settings import DecodingSettings
from drivers.errors import AddressError, DriverError
from drivers.tag import Tag


@dataclass(frozen=True, slots=True)
class SignalPlace:
    """A tag as it is decoded (with what a DBC file adds), its field, its message's rules and timeout (s).

    `length` is the message's length in bytes as a DBC file gives it, None where there is none.
    """

    tag: Tag
    field: Field
    rules: MessageRules
    timeout: float
    length: int | None


class SignalMap:
    """Locates tags by a driver's settings (`dbc`, `timeouts`, `message_timeout`, ...). Raises DriverError for those."""

    def __init__(self, settings: DecodingSettings) -> None:
        self._settings = settings
        self._dbc = None if settings.dbc is None else Dbc(Path(settings.dbc))
        self._messages = {} if self._dbc is None else {facts.key: facts for facts in self._dbc.messages.values()}
        self._timeouts: dict[int, float] = {}
        for name, seconds in settings.timeouts.items():
            key = self.key(name, "timeouts")
            if isinstance(seconds, bool) or not isinstance(seconds, int | float) or not 0 < seconds <= 86_400:
                raise DriverError(f"can: timeouts: {name}: {seconds!r} must be seconds above 0, at most a day")
            self._timeouts[key] = float(seconds)

    @property
    def omissions(self) -> tuple[str, ...]:
        """What of the DBC file cannot be used, in sentences."""
        return () if self._dbc is None else self._dbc.left_out

    def key(self, name: str, where: str) -> int:
        """The key of a message by its name in the DBC file, or of a frame by its id. Raises DriverError."""
        if self._dbc is not None and name in self._dbc.messages:
            return self._dbc.messages[name].key
        if re.match("0[xX]", name):
            return parse_frame(name, f"can: {where}")
        known = "" if self._dbc is None else f" or one of the messages {', '.join(self._dbc.messages)}"
        raise DriverError(f"can: {where}: {name!r} is no message; give a frame id such as 0x181{known}")

    def place(self, tag: Tag) -> SignalPlace:
        """Where the tag lies. Raises AddressError."""
        if tag.address.startswith(PREFIX):
            if self._dbc is None:
                raise AddressError(f"{tag.name}: address {tag.address!r} needs a DBC file; give its path as dbc")
            completed, field, _ = self._dbc.locate(tag)
        else:
            completed, field = tag, parse_field(tag)
        return self._make_place(completed, field)

    def with_key(self, place: SignalPlace, key: int) -> SignalPlace:
        """The same place in the frames of another id: an echo has the layout of what it echoes."""
        return self._make_place(place.tag, Field(key, place.field.bits, place.field.conditions))

    def _make_place(self, tag: Tag, field: Field) -> SignalPlace:
        facts = self._messages.get(field.key)
        name = frame_name(field.key) if facts is None else f"{facts.name} ({frame_name(field.key)})"
        length = None if facts is None else facts.length
        exact = length if self._settings.exact_length else None
        protection = None if facts is None else facts.protection
        rules = MessageRules(field.key, name, exact, protection)
        return SignalPlace(tag, field, rules, self._timeout(field.key, facts), length)

    def _timeout(self, key: int, facts: MessageFacts | None) -> float:
        """The message's own, else by its cycle (the layouts of a multiplexed message take turns), else the default."""
        if key in self._timeouts:
            return self._timeouts[key]
        if facts is None or facts.cycle is None:
            return float(self._settings.message_timeout)
        cycle = facts.cycle * facts.layouts
        return max(float(self._settings.least_timeout), float(self._settings.timeout_cycles) * cycle)


def describe(places: Sequence[SignalPlace]) -> list[str]:
    """The messages in sentences: one line a message and layout, with its signals and its timeout."""
    groups: dict[tuple[int, object], list[SignalPlace]] = {}
    for place in places:
        groups.setdefault((place.field.key, place.field.conditions), []).append(place)
    lines = []
    for _, group in sorted(groups.items(), key=lambda item: item[0][0]):
        rules, names = group[0].rules, ", ".join(place.tag.name for place in group)
        length = "any length" if rules.length is None else f"{rules.length} bytes"
        guarded = ", with CRC and counter" if rules.protection else ""
        layout = layout_name(group[0].field.conditions)
        lines.append(f"{rules.name}{layout}, {length}{guarded}, bad after {group[0].timeout:.3g} s: {names}")
    return lines

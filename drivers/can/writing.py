"""The closed write map as frames: which may ever be sent, what is in them, and the echo that verifies each (pure).

A frame that is sent holds the values of mapped tags, the numbers that select its layout, its checksum and counter
where its message has them, and zeros. It is sent whole or not at all: all its tags are written together. The device
answers each frame with its echo, a frame of another id and of the same layout that says what it has stored.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from drivers.can.fields import EXTENDED, Bits, LayoutCondition, encode_raw, frame_name
from drivers.can.protection import Protection, protect_frame
from drivers.can.signals import SignalMap, SignalPlace
from drivers.errors import AddressError, WriteForbidden
from drivers.tag import Tag, Value


@dataclass(frozen=True, slots=True)
class Outgoing:
    """One frame that may be sent: its tags' places by name, its length in bytes, and the id of its echo."""

    key: int
    conditions: tuple[LayoutCondition, ...]
    length: int
    places: Mapping[str, SignalPlace]
    echo: int
    protection: Protection | None

    @property
    def number(self) -> int:
        """The id without the flag of its length."""
        return self.key & ~EXTENDED

    @property
    def is_extended(self) -> bool:
        """True for a 29-bit id."""
        return bool(self.key & EXTENDED)

    def payload(self, values: Mapping[str, Value]) -> bytes:
        """The payload that holds the values of all the frame's tags. Raises EncodingError."""
        data = bytes(self.length)
        for condition in self.conditions:
            data = condition.bits.put(data, min(condition.values))
        for name, place in self.places.items():
            data = place.field.bits.put(data, encode_raw(place.tag, place.field, values[name]))
        return data

    def echo_problem(self, sent: bytes, heard: bytes) -> str:
        """Which of the tags the device's echo does not confirm, in words; "" if it confirms them all."""
        for name, place in self.places.items():
            bits = place.field.bits
            if len(heard) < bits.size:
                return f"the echo has {len(heard)} bytes, too few for {name}"
            if bits.get(heard) != bits.get(sent):
                return f"{name} was sent as {bits.get(sent)}, and the device holds {bits.get(heard)}"
        return ""


class WriteMap:
    """The frames of the closed write map. Raises AddressError for tags that cannot be written, and verified."""

    def __init__(self, tags: Sequence[Tag], signals: SignalMap, echoes: Mapping[str, object], pad: int) -> None:
        self._tags = {tag.name: tag for tag in tags}
        by_key = {signals.key(name, "echo"): signals.key(str(echo), "echo") for name, echo in echoes.items()}
        places = [(tag.name, signals.place(tag)) for tag in tags]
        self.frames = _frames(places, by_key, pad)
        self._counters = dict.fromkeys((frame.key for frame in self.frames), 0)
        self.echoes = {
            name: signals.with_key(place, frame.echo) for frame in self.frames for name, place in frame.places.items()
        }
        """The place of each tag's echo, by the tag's name."""

    def holds(self, tag: Tag) -> bool:
        """True if the tag, exactly as it is, is in the write map."""
        return self._tags.get(tag.name) == tag

    def compose(self, values: Sequence[tuple[Tag, Value]]) -> list[tuple[Outgoing, bytes]]:
        """The frames that write these values, in the order of the write map, without checksum and counter.

        Raises WriteForbidden for a tag outside the map, AddressError where a frame's other tags are not given, and
        EncodingError.
        """
        for tag, _ in values:
            if not self.holds(tag):
                raise WriteForbidden(f"{tag.name} ({tag.address}) is not in the write map; nothing was sent")
        by_name = {tag.name: value for tag, value in values}
        touched = [frame for frame in self.frames if not by_name.keys().isdisjoint(frame.places)]
        for frame in touched:
            if missing := [name for name in frame.places if name not in by_name]:
                raise AddressError(
                    f"frame {frame_name(frame.key)} is sent whole, and {missing[0]} is in it too; write it as well"
                )
        return [(frame, frame.payload(by_name)) for frame in touched]

    def seal(self, frame: Outgoing, data: bytes) -> bytes:
        """The payload as it goes on the wire. Raises WriteForbidden for a frame that is none of the map's."""
        if not any(frame is own for own in self.frames):
            raise WriteForbidden(f"frame {frame_name(frame.key)} is not in the write map; nothing was sent")
        if frame.protection is None:
            return data
        counter = self._counters[frame.key]
        self._counters[frame.key] = (counter + 1) % 256
        return protect_frame(frame.protection, counter, data)


def _frames(places: Sequence[tuple[str, SignalPlace]], echoes: Mapping[int, int], pad: int) -> tuple[Outgoing, ...]:
    groups: dict[tuple[int, tuple[LayoutCondition, ...]], dict[str, SignalPlace]] = {}
    for name, place in places:
        groups.setdefault((place.field.key, place.field.conditions), {})[name] = place
    frames = []
    for (key, conditions), group in groups.items():
        if key not in echoes:
            raise AddressError(
                f"{next(iter(group))}: frame {frame_name(key)} has no echo by which a write could be verified; "
                f'give the device\'s answer, such as echo = {{ "{frame_name(key)}" = "0x281" }}'
            )
        if echoes[key] == key:
            raise AddressError(f"echo: {frame_name(key)} is its own echo; give the id of the device's answer")
        _check_overlaps(group, conditions)
        first = next(iter(group.values()))
        needed = max(place.field.size for place in group.values())
        length = max(needed, pad) if first.length is None else first.length
        # Above 8 bytes a CAN FD frame has one of few lengths (ISO 11898-1): the next one is taken.
        length = next((size for size in (*range(9), 12, 16, 20, 24, 32, 48, 64) if size >= length), length)
        frames.append(
            Outgoing(
                key=key,
                conditions=conditions,
                length=length,
                places=group,
                echo=echoes[key],
                protection=first.rules.protection,
            )
        )
    return tuple(frames)


def _check_overlaps(group: Mapping[str, SignalPlace], conditions: Sequence[LayoutCondition]) -> None:
    """Two values in one bit cannot both be written."""
    owners: dict[int, str] = {}
    taken = [("the number of the layout", condition.bits) for condition in conditions]
    if next(iter(group.values())).rules.protection is not None:
        taken.append(("the checksum and the counter", Bits(0, 24)))
    for name, bits in (*taken, *((name, place.field.bits) for name, place in group.items())):
        numbers: Sequence[int] = range(bits.start, bits.end)
        if bits.motorola:  # its `end` counts from the payload's front, most significant bit first
            fronts = range(bits.end - bits.length, bits.end)
            numbers = [8 * (front // 8) + 7 - front % 8 for front in fronts]
        for bit in numbers:
            if bit in owners:
                raise AddressError(f"{name}: bit {bit} of its frame belongs to {owners[bit]} already; move one of them")
            owners[bit] = name
